"""Partition of the particles among the ranks: cells are dealt out, and divided where whole ones would not balance."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..meshfree.scene import Scene
from .cost import cost_of_cells

BALANCE = 0.02  # imbalance that is accepted for whole cells: cost of the fullest rank over the mean, minus 1
EXTRA = 0.1  # work of a rank over the mean that cells cut in space add at least: rows at cuts are computed twice
THICK = 15.0  # least thickness of a slice of a cell [spacings]: a thinner one has almost as many ghosts as particles
MANY = 2  # cells per rank from which only those on the cuts between ranks are divided


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
    """

    scene: Scene
    first: np.ndarray
    team: int = 1
    pieces: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    free: dict[int, np.ndarray] = field(default_factory=dict)
    load: np.ndarray = field(default_factory=lambda: np.ones(1))

    @cached_property
    def _apart(self) -> np.ndarray:
        """Cells that are in `pieces` or `free` (k,) int, ascending."""
        return np.array(sorted({*self.pieces, *self.free}), np.int64)

    def _within(self, cell: int) -> np.ndarray:
        """Owners of the particles of a cell (n,) int."""
        if cell in self.free:
            return self.free[cell]
        template = self.scene.templates[self.scene.kind[cell]]
        if cell in self.pieces:
            ends, ranks = self.pieces[cell]
            return ranks[np.searchsorted(ends, fractions(template.nucleus), side="right")]
        return self.first[cell] + slices(template.nucleus, self.team)

    def of(self, ids: np.ndarray) -> np.ndarray:
        """Owners (k,) int of the particles `ids` (k,) int."""
        p = self.scene.particles(ids)
        out = self.first[p.cell].astype(np.int64)
        if self.team > 1:
            for kind, on, at in p.by_kind():
                out[on] += slices(self.scene.templates[kind].nucleus, self.team)[at]
        for cell in np.intersect1d(p.cell, self._apart).tolist():
            on = p.cell == cell
            out[on] = self._within(cell)[p.at[on]]
        return out

    def cells(self, rank: int) -> np.ndarray:
        """Cells (k,) int of which a rank has a part, ascending."""
        mine = (self.first <= rank) & (rank < self.first + self.team)
        for cell in self._apart.tolist():
            mine[cell] = rank in (self.pieces[cell][1] if cell in self.pieces else self.free[cell])
        return np.flatnonzero(mine)

    def ids(self, rank: int) -> np.ndarray:
        """Global ids (n,) int of a rank's particles, ascending."""
        cells = self.cells(rank)
        ids = self.scene.ids_of(cells)
        return ids if self.team == 1 and not len(self._apart) else ids[self.of(ids) == rank]

    def loaded(self, cost: np.ndarray, ranks: int) -> Owners:
        """The same with the `load` of each of `ranks` for cells of a `cost` (cells,) [-]."""
        whole = cost.copy()
        whole[self._apart] = 0.0
        load = np.zeros(ranks)
        for slice_ in range(self.team):
            load += np.bincount(self.first + slice_, whole / self.team, ranks)
        for cell, (ends, shared_by) in self.pieces.items():
            load += np.bincount(shared_by, cost[cell] * np.diff(ends, prepend=0.0, append=1.0), ranks)
        for cell, owner in self.free.items():
            load += np.bincount(owner, minlength=ranks) * cost[cell] / len(owner)
        return replace(self, load=load / load.mean())

    def heads(self, rank: int) -> np.ndarray:
        """Cells (k,) int, ascending, whose first particle a rank owns: each cell is one rank's."""
        cells = self.cells(rank)
        return cells[self.of(self.scene.offset[cells]) == rank]


def partition(scene: Scene, ranks: int, reach: float = 0.0) -> Owners:
    """Owners of the particles of a `scene` among a number of `ranks`.

    Each rank gets whole cells if that balances their cost: then only contacts are exchanged.  Of many cells those on
    the cuts between ranks are divided else.  Few are given to teams of ranks, as small as balance allows, and each rank
    of a team gets the same slice of all cells of its team: the coefficients that cells of a kind share are then in the
    cache of one rank only.  Where slices would be too thin, space is bisected.

    reach : largest distance at which surfaces of two cells act on each other [µm], 0 without contacts.
    """
    cost = cost_of_cells(scene, reach) if ranks > 1 else np.ones(len(scene.kind))
    return _dealt(scene, ranks, cost).loaded(cost, ranks)


def _dealt(scene: Scene, ranks: int, cost: np.ndarray) -> Owners:
    """Owners for cells of a `cost` (cells,) [-]."""
    size, middle = np.diff(scene.offset), np.array([t.X.mean(axis=0) for t in scene.templates])
    centre, cells = scene.centre + middle[scene.kind], len(scene.kind)
    most = (1.0 + BALANCE) * cost.sum() / ranks
    if ranks * MANY <= cells:
        first = bisection(centre, ranks, cost)
        return Owners(scene, first) if np.bincount(first, cost).max() <= most else Owners(
            scene, *cut(centre, cost, ranks))
    teams: list[Owners] = []
    for team in (p for p in range(1, ranks + 1) if ranks % p == 0 and p * THICK <= max(THICK, np.sqrt(size.min()))):
        of_cell = bisection(centre, ranks // team, cost)
        found = Owners(scene, team * of_cell, team)
        if np.bincount(of_cell, cost).max() / team <= most:
            return found
        teams.append(found.loaded(cost, ranks))
    owner = np.split(bisection(scene.X, ranks), scene.offset[1:-1])
    cut_in_space = Owners(scene, np.zeros(cells, np.int32), free=dict(enumerate(owner))).loaded(cost, ranks)
    best = min(teams, key=lambda one: one.load.max())
    return best if best.load.max() <= cut_in_space.load.max() + EXTRA else cut_in_space


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


def cut(centre: np.ndarray, cost: np.ndarray,
        ranks: int) -> tuple[np.ndarray, int, dict[int, tuple[np.ndarray, np.ndarray]]]:
    """First ranks (cells,), a team of one, and `Owners.pieces`: cells at `centre` (cells, d) [µm] of a `cost` (cells,)
    [-] by recursive coordinate bisection, which divides a cell that a cut would leave too far on one side.
    """
    first, pieces = np.zeros(len(cost), np.int32), dict[int, list[tuple[float, int]]]()
    accepted = 0.5 * BALANCE * cost.sum() / ranks

    def split(cell: np.ndarray, low: np.ndarray, high: np.ndarray, rank: int, count: int) -> None:
        if count == 1 or len(cell) == 0:
            first[cell] = rank
            for c, begin, end in zip(cell.tolist(), low.tolist(), high.tolist(), strict=True):
                if begin > 0.0 or end < 1.0:
                    pieces.setdefault(c, []).append((begin, rank))
            return
        axis = int(np.argmax(np.ptp(centre[cell], axis=0)))
        order = np.lexsort((cell, centre[cell, axis]))
        cell, low, high = cell[order], low[order], high[order]
        heavy, half = np.cumsum(cost[cell] * (high - low)), count // 2
        target = heavy[-1] * half / count
        at = int(np.searchsorted(heavy, target))
        before = heavy[at - 1] if at else 0.0
        if heavy[at] - target <= accepted:
            at += 1
        elif target - before > accepted:
            where = low[at] + (target - before) / cost[cell[at]]
            split(cell[: at + 1], low[: at + 1], np.append(high[:at], where), rank, half)
            split(cell[at:], np.append(where, low[at + 1 :]), high[at:], rank + half, count - half)
            return
        split(cell[:at], low[:at], high[:at], rank, half)
        split(cell[at:], low[at:], high[at:], rank + half, count - half)

    split(np.arange(len(cost)), np.zeros(len(cost)), np.ones(len(cost)), 0, ranks)
    found = {c: tuple(map(np.array, zip(*sorted(parts), strict=True))) for c, parts in pieces.items()}
    return first, 1, {c: (begin[1:], rank) for c, (begin, rank) in found.items()}


def bisection(X: np.ndarray, ranks: int, weight: np.ndarray | None = None) -> np.ndarray:
    """Owner of each point (n,) int, by recursive coordinate bisection; ranks are balanced to one point.

    X (n, d) [µm] are the points, `weight` (n,) [-] their weights; None for equal ones.

    Source: Berger & Bokhari (1987).
    """
    owner = np.zeros(len(X), np.int32)
    load = np.ones(len(X)) if weight is None else weight

    def split(ids: np.ndarray, first: int, count: int) -> None:
        if count == 1 or len(ids) == 0:
            owner[ids] = first
            return
        axis = int(np.argmax(np.ptp(X[ids], axis=0)))
        ids = ids[np.lexsort((ids, X[ids, axis]))]
        half, heavy = count // 2, np.cumsum(load[ids])
        cut = int(np.searchsorted(heavy - 0.5 * load[ids], heavy[-1] * half / count))
        split(ids[:cut], first, half)
        split(ids[cut:], first + half, count - half)

    split(np.arange(len(X)), 0, ranks)
    return owner
