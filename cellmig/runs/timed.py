"""Parts of large cases that are timed or tried in place of all: fewer cells, coarser ones, side by side."""

from __future__ import annotations

import dataclasses
from time import process_time

import numpy as np

from mpi4py import MPI

from cellmig.case.schema import Case, particle_count
from cellmig.meshfree.body import Template
from cellmig.meshfree.scene import Scene
from cellmig.meshfree.terms import find_terms
from cellmig.simulation import Simulation
from cellmig.solve.start import kind_of
from cellmig.solve.step import binding

from .by_rank import kinds_of, size_of, standing_for

# Largest number of particles of a timed scene, by dimensions: more than caches hold; and of one that is tried.
PROBE, FEWER = {2: 200_000, 3: 40_000}, 20_000
KIND = 5_000  # largest number of particles of a cell in a timed scene
COPIES = 20  # of cells of KIND particles, that are timed side by side for larger ones
STILL = 1e-3  # length of timed steps over the stable one: nothing moves
STEPS, FEWEST, LONGEST = 2e6, 5, 1.0  # particle-steps that are timed, steps at least, and seconds at most


def part_of(case: Case, most: int) -> tuple[Case, float]:
    """Part of a case, of about `most` particles in all, of few kinds as in the case and KIND in a cell; spacing of the
    case over that of the part.
    """
    cells = some_cells(case, max(1, most * len(case.cells) // size_of(case)))
    largest = max(particle_count(case, shape) for shape in {c.shape for c in cells})
    count, p = min(most, KIND), case.particles
    ratio = min(1.0, count / largest) ** (1.0 / case.dimension)
    if ratio < 1.0:
        p = dataclasses.replace(p, per_cell=p.per_cell and count, spacing=p.spacing and p.spacing / ratio)
    return dataclasses.replace(case, cells=cells, particles=p), ratio


def some_cells(case: Case, count: int) -> tuple:
    """About `count` cells of a case, of few kinds by their shares of the cells, those of each side by side."""
    if count >= len(case.cells):
        return case.cells
    alike = standing_for(kinds_of(case))
    kind, place = [alike[kind_of(cell)] for cell in case.cells], np.array([cell.centre for cell in case.cells])
    chosen: set[int] = set()
    for one in dict.fromkeys(kind):
        mine = np.flatnonzero([k is one for k in kind])
        near = np.linalg.norm(place[mine] - place[mine[0]], axis=1)
        chosen |= {*mine[np.argsort(near, kind="stable")[: max(1, count * len(mine) // len(kind))]].tolist()}
    return tuple(case.cells[n] for n in sorted(chosen))


def finer(t: Template, ratio: float) -> Template:
    """A template with its lengths times `ratio`."""
    viscous = max(m.numerical_viscosity(ratio * t.spacing) / v for m in t.laws
                  if m and (v := m.numerical_viscosity(t.spacing))) if t.bending_weight.any() else 1.0
    d = t.X.shape[1]
    return dataclasses.replace(t, X=ratio * t.X, V=ratio**d * t.V, G=tuple(g / ratio for g in t.G), C=t.C / ratio**2,
                               bending_weight=viscous * ratio ** (d + 2) * t.bending_weight,
                               bending_modulus=ratio ** (d + 2) * t.bending_modulus,
                               missed=ratio ** (d + 2) * t.missed,
                               spacing=ratio * t.spacing, damping=ratio * t.damping) if ratio < 1.0 else t


def copied(case: Case, scene: Scene, times: int) -> tuple[Case, Scene]:
    """A case and its scene `times` side by side, each with kinds of cells of its own: their coefficients leave the
    caches, as those of larger cells do.
    """
    if times < 2 or case.fields or case.plates:
        return case, scene
    wide = np.ptp(scene.centre[:, 0]) + 1.5 * max(np.ptp(t.X[:, 0]) for t in scene.templates)
    kinds, along = len(scene.templates), np.arange(times).repeat(len(case.cells))
    cells = [dataclasses.replace(cell, name=f"{cell.name} {k}" if k else cell.name,
                                 centre=(cell.centre[0] + k * wide, *cell.centre[1:]))
             for k in range(times) for cell in case.cells]
    scene = dataclasses.replace(
        scene, templates=scene.templates * times, material_of=scene.material_of * times,
        kind=np.tile(scene.kind, times) + kinds * along, centre=np.array([c.centre for c in cells]))
    return dataclasses.replace(case, cells=tuple(cells)), scene


def timed(case: Case, scene: Scene, single: bool, largest: int) -> tuple[float, float]:
    """Time per particle-step on this core [s], and memory per particle of the kernel's arrays [B], of a part of a case
    with its `scene`; it is CPU time, as other programs may run now.  Pieces of contact in space serve for as many steps
    as in a run: in steps of a given length for one, else for fewer the more surfaces slip in a whole step.

    single : whether coefficients are in single precision;  largest : particles of the case's largest cell.
    """
    case, scene = copied(case, scene, min(COPIES, round(largest / KIND)))
    terms = dataclasses.replace(find_terms(case), single=single)
    with Simulation(case, MPI.COMM_SELF, parts=(scene, terms)) as s:
        m, dt = s.mechanics, STILL * binding(s.control.stable())[1]
        how = dt, s.control.typical[1], STILL if case.time.step == "auto" else 0.0
        m.advance(3, *how)
        one = _seconds(m, FEWEST, *how) / FEWEST
        n = max(FEWEST, round(min(STEPS / s.scene.size, LONGEST / max(one, 1e-9))))
        spent = min(_seconds(m, n, *how) for _ in range(3))
        return spent / (n * s.scene.size), m.kernel.bytes / s.scene.size


def _seconds(mechanics, n: int, dt: float, gap: float, share: float) -> float:
    start = process_time()
    mechanics.advance(n, dt, gap, share)
    return process_time() - start
