"""Initial state of a case: reference configuration, and displacements, velocities and director from formulas."""

from __future__ import annotations

import numpy as np

from ..case.expression import evaluate
from ..case.messages import CaseError, Mistake
from ..case.schema import Case, particle_count
from ..meshfree import formulas
from ..meshfree.body import template
from ..meshfree.rkpm import factorised
from ..meshfree.scene import Scene
from ..model.director import initial, numbers
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


def discretise(case: Case) -> Scene:
    """The reference configuration of a case: one template for each kind of cell.

    Raises CaseError where particles do not suit a shape, or formulas have no value at them.
    """
    used = [name for name in case.materials if any(name in (c.material, c.nucleus) for c in case.cells)]
    kinds: dict = {}
    for cell in case.cells:
        kinds.setdefault((cell.shape, cell.material, cell.nucleus, cell.relative_stiffness), len(kinds))
    templates, material_of = [], []
    for shape, body, nucleus, grade in kinds:
        pair = (case.materials[body], case.materials[nucleus] if nucleus else None)
        try:
            count = particle_count(case, shape)
            solve = solve_positive if count > LARGE else factorised
            dilation = case.particles.dilation if case.dimension == 2 else 0.0  # averages of finite elements in space
            templates.append(template(shape, count, dilation, pair, case.numerics.bulk_viscosity,
                                      case.particles.surface_refinement, solve, grade))
        except ValueError as error:  # the particles do not suit the shape
            name = next(c.name for c in case.cells if c.shape == shape)
            told = f"'{name}': {error}{getattr(shape, 'hint', '')}"
            raise CaseError([Mistake(case.path, None, "particles", told)]) from error
        material_of.append((used.index(body), used.index(nucleus or body)))
    scene = Scene(
        templates=templates, material_of=material_of, materials=[case.materials[name] for name in used],
        kind=np.array([kinds[c.shape, c.material, c.nucleus, c.relative_stiffness] for c in case.cells]),
        centre=np.array([c.centre for c in case.cells]), time_unit=case.time_unit)
    formulas.check(case, scene)
    return scene
