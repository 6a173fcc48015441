"""Partition of the particles among the ranks: cells are dealt out, and divided where whole ones would not balance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..meshfree.scene import Scene
from .cost import Work, work_of
from .owners import Owners

BALANCE = 0.02  # imbalance that is accepted for whole cells: cost of the fullest rank over the mean, minus 1
# By how much cells cut in space have to be better: a rank computes rows of cells that share coefficients at once, which
# in the plane is 20 (stress) and 27 % (divergence) faster with three cells than with one.
EXTRA = {2: 0.25, 3: 0.05}
TRIES = 24  # most partitions that are tried
STEP = 0.7  # power of a rank's load by which what it has counts more in the next one
THICK = 15.0  # least thickness of a slice of a cell [spacings]: a thinner one has almost as many ghosts as particles
MANY = 2  # cells per rank from which only those on the cuts between ranks are divided


def partition(scene: Scene, ranks: int, reach: float = 0.0, low: float = 0.0,
              moved: np.ndarray | None = None) -> Owners:
    """Owners of the particles of a `scene` among a number of `ranks`.

    Each rank gets whole cells if that balances their cost: then only contacts are exchanged.  Of many cells those on
    the cuts between ranks are divided else.  Few are given to teams of ranks, as small as balance allows, and each rank
    of a team gets the same slice of all cells of its team: the coefficients that cells of a kind share are then in the
    cache of one rank only.  Where slices would be too thin or cost more, space is bisected.

    reach : largest distance at which surfaces of two cells act on each other [µm], 0 without contacts;  low : largest
    height at which they act on the substrate [µm], 0 without one;  moved : (m, D) displacements of all surface
    particles [µm], None in the reference configuration.
    """
    if ranks == 1:
        return Owners(scene, np.zeros(len(scene.kind), np.int32))
    work = work_of(scene, reach, low, moved)
    return _many(work, ranks) if ranks * MANY <= len(scene.kind) else _few(work, ranks)


def _many(work: Work, ranks: int) -> Owners:
    """Owners where ranks have several cells each."""
    scene, cost = work.scene, work.of_cells
    whole = _improved(work, ranks, cost, lambda cost: Owners(scene, bisection(work.centre, ranks, cost)))
    if whole.load.max() <= 1.0 + BALANCE:
        return whole
    divided = _improved(work, ranks, cost, lambda cost: Owners(scene, *cut(work.centre, cost, ranks)))
    return min(whole, divided, key=lambda one: one.most)


def _few(work: Work, ranks: int) -> Owners:
    """Owners where cells are few."""
    scene, cost, cells = work.scene, work.of_cells, len(work.rows)
    thick = np.sqrt(np.diff(scene.offset).min()) / THICK
    found: list[Owners] = []
    for team in (p for p in range(1, ranks + 1) if ranks % p == 0 and p <= max(1.0, thick)):
        first = bisection(work.centre, ranks // team, cost)
        found.append(work.loaded(Owners(scene, team * first, team), ranks))
        if found[-1].load.max() <= 1.0 + BALANCE:
            break
    count, x = scene.offset[1:-1], scene.X

    def cut_in_space(cost: np.ndarray | None) -> Owners:
        owner = np.split(bisection(x, ranks, cost), count)
        return Owners(scene, np.zeros(cells, np.int32), free=dict(enumerate(owner)))

    free = min(_improved(work, ranks, work.of_particles, cut_in_space), work.loaded(cut_in_space(None), ranks),
               key=lambda one: one.most)
    best = min(found, key=lambda one: one.most)
    return best if best.most <= (1.0 + EXTRA[scene.dimension]) * free.most else free


def _improved(work: Work, ranks: int, cost: np.ndarray, deal: Callable[[np.ndarray], Owners]) -> Owners:
    """The best of what `deal` gives for a `cost` of cells (cells,) or particles (n,) [-], which is raised where a rank
    has too much: what it costs to have others elsewhere depends on the cuts.
    """
    found: list[Owners] = []
    while len(found) < TRIES and (not found or found[-1].load.max() > 1.0 + BALANCE):
        found.append(work.loaded(deal(cost), ranks))
        last, more = found[-1], found[-1].load**STEP
        cost = cost * (more[last.of(np.arange(len(cost)))] if last.free else last.among(more))
    return min(found, key=lambda one: one.most)


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
