"""Cost of a step, from which particles are dealt out: rows by their neighbours, and what surfaces do where they are."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from ..meshfree.body import Template
from ..meshfree.scene import Scene, joined, ranges
from .owners import Owners

# Costs over that of a neighbour of a row, which is the same in all materials, at 300 to 3,000 particles a cell.  Of a
# surface particle near another cell: measured 90 to 100 in the plane, and in space 1,010 to 1,220 where pieces are
# found in each step, 0.3 of that as they serve; of one near the substrate, beyond what others cost there, with
# a push: 14 and 82.
CONTACT, LOW = {2: 95.0, 3: 330.0}, {2: 14.0, 3: 82.0}
STRESS = 0.65  # share of the cost of a row in its stress, which is computed of others' rows, too: 0.61 and 0.67
MOST = 300_000  # surface particles that are looked at: of more, each second, third …


@dataclass(frozen=True)
class Work:
    """What a step costs in all, in neighbours of a row.

    Attributes
    ----------
    scene : Scene.
    centre : (cells, D) -- middle of each cell [µm].
    rows : (cells,) -- of the rows of each cell [-].
    near : (k,) int -- surface particles near another cell, by global id; of many, some stand for all.
    contact : (k,) -- half the cost [-] of what each does there with the other cell's: ranks that have but one of both
        sides compute both.
    pairs : (p, 2) int -- those of `near` that take part in the contacts of each other, by their places in it.
    low : (l,) int -- surface particles near the substrate, by global id; of many, some stand for all.
    beneath : (l,) -- the cost of each of them [-].
    """

    scene: Scene
    centre: np.ndarray
    rows: np.ndarray
    near: np.ndarray
    contact: np.ndarray
    pairs: np.ndarray
    low: np.ndarray
    beneath: np.ndarray

    @property
    def of_cells(self) -> np.ndarray:
        """Cost of each cell whose neighbours are on other ranks (cells,) [-]."""
        cell = self.scene.cell_of(np.concatenate([self.near, self.low]))
        return self.rows + np.bincount(cell, np.concatenate([2.0 * self.contact, self.beneath]), len(self.rows))

    @property
    def of_particles(self) -> np.ndarray:
        """Cost of each particle whose neighbours are on its rank (size,) [-], for scenes of few cells."""
        of_kind = [np.diff(t.G[0].indptr).astype(float) for t in self.scene.templates]
        cost = np.concatenate([of_kind[kind] for kind in self.scene.kind])
        cost[self.near] += self.contact
        cost[self.low] += self.beneath
        return cost

    def of_ranks(self, owners: Owners, ranks: int) -> np.ndarray:
        """Cost of each of `ranks` whose particles are those of `owners` (ranks,) [-]."""
        own, at = owners.of(self.near), np.arange(len(self.near))
        here, there = np.concatenate([np.column_stack([at, at]), self.pairs, self.pairs[:, ::-1]]).T
        key = np.unique(here * ranks + own[there])  # all that have particles of a contact compute it
        between = np.bincount(key % ranks, self.contact[key // ranks], ranks)
        return self._of_rows(owners, ranks) + between + np.bincount(owners.of(self.low), self.beneath, ranks)

    def loaded(self, owners: Owners, ranks: int) -> Owners:
        """The `owners`, who know what each of `ranks` has of this work: infinitely much where one has none."""
        cost = self.of_ranks(owners, ranks)
        return replace(owners, load=cost / cost.mean(), most=float(cost.max()) if cost.min() > 0.0 else math.inf)

    def _of_rows(self, owners: Owners, ranks: int) -> np.ndarray:
        scene, whole, load = self.scene, self.rows.copy(), np.zeros(ranks)
        for cell in owners.apart.tolist():
            whole[cell] = 0.0
            load += of_rows(scene.templates[scene.kind[cell]], owners.within(cell), ranks)
        if owners.team == 1:
            return load + np.bincount(owners.first, whole, ranks)
        for kind, one in enumerate(scene.templates):
            first = owners.first[(scene.kind == kind) & (whole > 0.0)]
            for number, cost in enumerate(of_rows(one, owners.slices_of(kind), owners.team)):
                load += cost * np.bincount(first + number, minlength=ranks)
        return load


def of_rows(template: Template, owner: np.ndarray, ranks: int) -> np.ndarray:
    """Cost of the rows of a cell for each rank (ranks,) [-], with those of others that it needs, where ranks `owner`
    (n,) int share its particles.
    """
    n, count = len(owner), np.diff(template.G[0].indptr)
    of, needed = np.repeat(owner, count), template.G[0].indices
    other = of != owner[needed]
    ghost = np.unique(of[other].astype(np.int64) * n + needed[other])
    return np.bincount(owner, count, ranks) + STRESS * np.bincount(ghost // n, count[ghost % n], ranks)


def work_of(scene: Scene, reach: float = 0.0, low: float = 0.0, moved: np.ndarray | None = None,
            most: int = MOST) -> Work:
    """What a step of a scene costs.

    reach : largest distance at which surfaces of two cells act on each other [µm], 0 without contacts;  low : largest
    height at which they act on the substrate [µm], 0 without one;  moved : (m, D) displacements of all surface
    particles [µm], None in the reference configuration;  most : about as many of them are looked at.
    """
    rows = np.array([t.G[0].nnz for t in scene.templates], float)[scene.kind]
    centre = scene.centre + np.array([t.X.mean(axis=0) for t in scene.templates])[scene.kind]
    every = -(-int(scene.first_surface[-1]) // most)
    ids, place, stands = _surface(scene, every)
    cell, x = scene.cell_of(ids), scene.particles(ids).X
    if moved is not None:
        count = np.bincount(cell, minlength=len(rows))
        x = x + moved[place]
        centre = centre + np.column_stack([np.bincount(cell, u, len(rows)) for u in moved[place].T]) / count[:, None]
    near, pairs = joined([]), np.zeros((0, 2), np.int64)
    if reach:
        apart = max(t.spacing for t in scene.templates) * every ** (1.0 / (scene.dimension - 1))
        found = cKDTree(x).query_pairs(reach + 0.5 * apart, output_type="ndarray")
        near = np.unique(found[cell[found[:, 0]] != cell[found[:, 1]]])
        pairs = cKDTree(x[near]).query_pairs(reach + apart, output_type="ndarray") if len(near) else pairs
    down = np.flatnonzero(x[:, -1] < low)
    return Work(scene, centre, rows, ids[near], 0.5 * CONTACT[scene.dimension] * stands[near], pairs, ids[down],
                LOW[scene.dimension] * stands[down])


def _surface(scene: Scene, every: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Surface particles of all cells by global id (n,) int, only some if `every` is not 1, their numbers in the surface
    of the scene (n,) int, and for how many each of them stands (n,) [-].
    """
    some = [t.surface[::every] for t in scene.templates]
    stands = np.array([len(t.surface) / len(at) for t, at in zip(scene.templates, some, strict=True)])
    count = np.array([len(at) for at in some])[scene.kind]
    end = np.cumsum(count)
    at = np.zeros(end[-1], np.int64)
    for kind, of_kind in enumerate(some):
        mine = np.flatnonzero(scene.kind == kind)
        at[ranges(end[mine] - len(of_kind), end[mine])] = np.tile(of_kind, len(mine))
    place = np.repeat(scene.first_surface[:-1], count) + every * ranges(0 * end, count)
    return np.repeat(scene.offset[:-1], count) + at, place, np.repeat(stands[scene.kind], count)
