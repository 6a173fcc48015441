"""Initial state of a case: reference configuration, and displacements, velocities and director from formulas."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mpi4py import MPI

from ..case.expression import evaluate
from ..case.messages import CaseError, Mistake
from ..case.schema import Case, Cell, particle_count
from ..meshfree import formulas
from ..meshfree.body import Template, template
from ..meshfree.rkpm import factorised
from ..meshfree.scene import Scene
from ..model.director import initial, numbers
from ..parallel.collect import collected
from ..parallel.direct import solve_positive
from .accounts import ACCOUNTS

LARGE = 5_000  # particles of a cell from which MUMPS is faster than SuperLU in the setup


def at_start(case: Case, scene: Scene, cells: np.ndarray) -> dict[str, np.ndarray]:
    """Initial fields of the particles of `cells` (k,) int, by their names in the swarm.

    These are id; X, u (n, d) [µm], v (n, d) [µm/µs], director (n, 1) [rad] or (n, 3) [-], accounts (n, k), zero.
    """
    particles = scene.particles(scene.ids_of(cells))
    n, X, end = len(particles.ids), particles.X, 0
    u, v, director = np.zeros(X.shape), np.zeros(X.shape), np.zeros((n, numbers(case.dimension)))
    for i in cells.tolist():
        c, place = case.cells[i], scene.templates[scene.kind[i]].X
        on = slice(end, end := end + len(place))
        u[on] = np.column_stack([evaluate(value, place) for value in c.displacement])
        v[on] = np.column_stack([evaluate(value, place) for value in c.velocity])
        v[on] += place @ np.array(c.velocity_gradient).T
        director[on] = initial(case.director, X[on] - np.array(c.centre))
    return {"id": particles.ids, "X": X, "u": u, "v": v, "director": director, "loss": np.zeros((n, len(ACCOUNTS)))}


def discretise(case: Case, made: Sequence[Template | CaseError] | None = None) -> Scene:
    """The reference configuration of a case: one template for each kind of cell.

    made : the results of `templates`, if they are known.

    Raises CaseError where particles do not suit a shape, or formulas have no value at them.
    """
    used = [name for name in case.materials if any(name in (c.material, c.nucleus) for c in case.cells)]
    kinds, found = _kinds(case), list[Template]()
    for one in made if made is not None else (_template(case, kind) for kind in kinds):
        if isinstance(one, CaseError):
            raise one
        found.append(one)
    material_of = [(used.index(body), used.index(nucleus or body)) for _, body, nucleus, _ in kinds]
    scene = Scene(
        templates=found, material_of=material_of, materials=[case.materials[name] for name in used],
        kind=np.array([kinds[kind_of(cell)] for cell in case.cells]),
        centre=np.array([c.centre for c in case.cells]), time_unit=case.time_unit)
    formulas.check(case, scene)
    return scene


def templates(case: Case, comm: MPI.Intracomm) -> list[Template | CaseError] | None:
    """Templates of the kinds of cells of a case, each made by one rank, or why one cannot be; on rank 0; collective."""
    kinds = list(_kinds(case))
    made = [_template(case, kind) for kind in kinds[comm.rank :: comm.size]]
    for one in made:
        if isinstance(one, Template) and not case.static:
            _ = one.rates  # goes with it: the automatic step takes those of all
    parts = collected(comm, made)
    return None if parts is None else [parts[k % comm.size][k // comm.size] for k in range(len(kinds))]


def _kinds(case: Case) -> dict[tuple, int]:
    """Numbers of the kinds of cells."""
    kinds: dict = {}
    for cell in case.cells:
        kinds.setdefault(kind_of(cell), len(kinds))
    return kinds


def kind_of(cell: Cell) -> tuple:
    """What decides the template of a cell: shape, materials of body and nucleus, grade of stiffness."""
    return cell.shape, cell.material, cell.nucleus, cell.relative_stiffness


def _template(case: Case, kind: tuple) -> Template | CaseError:
    """The template of a kind of cell, or why the particles do not suit its shape."""
    shape, body, nucleus, grade = kind
    pair = (case.materials[body], case.materials[nucleus] if nucleus else None)
    try:
        count = particle_count(case, shape)
        solve = solve_positive if count > LARGE else factorised
        dilation = case.particles.dilation if case.dimension == 2 else 0.0  # averages of finite elements in space
        return template(shape, count, dilation, pair, case.numerics.bulk_viscosity,
                        case.particles.surface_refinement, solve, grade)
    except ValueError as error:
        name = next(c.name for c in case.cells if c.shape == shape)
        told = f"'{name}': {error}{getattr(shape, 'hint', '')}"
        return CaseError([Mistake(case.path, None, "particles", told)])
