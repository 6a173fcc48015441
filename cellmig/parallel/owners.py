"""Which rank owns each particle of a scene."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..meshfree.scene import Scene


@dataclass(frozen=True)
class Owners:
    """Which rank owns each particle of a scene, in a few bytes a cell.

    Attributes
    ----------
    scene : Scene.
    first : (cells,) int -- the first of the ranks that share a cell.
    team : int -- number of ranks that do, each of which has a slice: see `slices`.
    pieces : dict -- cells that ranks share otherwise: the fractions (k - 1,) at which slices end [-], their ranks (k,)
        int.
    free : dict -- cells that are cut in space: owners (n,) int of their particles.
    load : (ranks,) -- expected work of each rank in a step over the mean [-].
    most : float -- the largest, in neighbours of a row [-].
    """

    scene: Scene
    first: np.ndarray
    team: int = 1
    pieces: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    free: dict[int, np.ndarray] = field(default_factory=dict)
    load: np.ndarray = field(default_factory=lambda: np.ones(1))
    most: float = 0.0

    @cached_property
    def apart(self) -> np.ndarray:
        """Cells that are in `pieces` or `free` (k,) int, ascending."""
        return np.array(sorted({*self.pieces, *self.free}), np.int64)

    def within(self, cell: int) -> np.ndarray:
        """Owners of the particles of a cell (n,) int."""
        if cell in self.free:
            return self.free[cell]
        if cell in self.pieces:
            ends, ranks = self.pieces[cell]
            nucleus = self.scene.templates[self.scene.kind[cell]].nucleus
            return ranks[np.searchsorted(ends, fractions(nucleus), side="right")]
        return self.first[cell] + self.slices_of(self.scene.kind[cell])

    def slices_of(self, kind: int) -> np.ndarray:
        """Slices of a team (n,) int of the particles of a kind of cells."""
        return slices(self.scene.templates[kind].nucleus, self.team)

    def of(self, ids: np.ndarray) -> np.ndarray:
        """Owners (k,) int of the particles `ids` (k,) int."""
        p = self.scene.particles(ids)
        out = self.first[p.cell].astype(np.int64)
        if self.team > 1:
            for kind, on, at in p.by_kind():
                out[on] += self.slices_of(kind)[at]
        for cell in np.intersect1d(p.cell, self.apart).tolist():
            on = p.cell == cell
            out[on] = self.within(cell)[p.at[on]]
        return out

    def cells(self, rank: int) -> np.ndarray:
        """Cells (k,) int of which a rank has a part, ascending."""
        mine = (self.first <= rank) & (rank < self.first + self.team)
        for cell in self.apart.tolist():
            mine[cell] = rank in (self.pieces[cell][1] if cell in self.pieces else self.free[cell])
        return np.flatnonzero(mine)

    def ids(self, rank: int) -> np.ndarray:
        """Global ids (n,) int of a rank's particles, ascending."""
        cells = self.cells(rank)
        ids = self.scene.ids_of(cells)
        return ids if self.team == 1 and not len(self.apart) else ids[self.of(ids) == rank]

    def shares(self, of: np.ndarray, ranks: int) -> np.ndarray:
        """Sums by rank (ranks,) of what cells have (cells,), in its unit, of which ranks have shares by particles."""
        whole, load = of.copy(), np.zeros(ranks)
        whole[self.apart] = 0.0
        for slice_ in range(self.team):
            load += np.bincount(self.first + slice_, whole / self.team, ranks)
        for cell in self.apart.tolist():
            owner = self.within(cell)
            load += np.bincount(owner, minlength=ranks) * of[cell] / len(owner)
        return load

    def among(self, of: np.ndarray) -> np.ndarray:
        """Means (cells,) of what ranks have (ranks,), in its unit, over those that share each cell."""
        found = np.mean([of[self.first + slice_] for slice_ in range(self.team)], axis=0)
        for cell in self.apart.tolist():
            found[cell] = of[self.within(cell)].mean()
        return found

    def heads(self, rank: int) -> np.ndarray:
        """Cells (k,) int, ascending, whose first particle a rank owns: each cell is one rank's."""
        cells = self.cells(rank)
        return cells[self.of(self.scene.offset[cells]) == rank]


def fractions(nucleus: np.ndarray) -> np.ndarray:
    """Place of each particle of a cell among those of its part (n,) [-], from 0 to below 1.

    Particles are numbered part by part, then in strips; `nucleus` (n,) bool says of which part they are.
    """
    start = np.flatnonzero(np.diff(nucleus, prepend=~nucleus[:1]))
    length = np.diff(np.append(start, len(nucleus)))
    return (np.arange(len(nucleus)) - np.repeat(start, length)) / np.repeat(length, length)


def slices(nucleus: np.ndarray, count: int) -> np.ndarray:
    """Slice of each particle of a cell (n,) int, from 0: `count` equal ones of both parts, `nucleus` (n,) bool as
    for `fractions`.
    """
    ends = np.arange(1, count) / count
    return np.searchsorted(ends, fractions(nucleus), side="right")
