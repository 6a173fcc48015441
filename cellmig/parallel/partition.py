"""Partition of the particles among the ranks."""

from __future__ import annotations

import numpy as np

BALANCE = 0.03  # imbalance that is accepted for whole cells: particles of the fullest rank over the mean, minus 1
THICK = 15.0  # least thickness of a slice of a cell [spacings]: a thinner one has almost as many ghosts as particles


def partition(X: np.ndarray, cell: np.ndarray, material: np.ndarray, ranks: int) -> np.ndarray:
    """Owner of each particle (n,) int.

    Each rank gets whole cells if that balances: then only contacts are exchanged.  Otherwise whole cells are given to
    teams of ranks, as small as balance allows, and each rank of a team gets the same slice of all cells of its team:
    the coefficients that cells of a kind share are then in the cache of one rank only.  Where slices would be too thin,
    space is bisected.

    Parameters
    ----------
    X : (n, d) -- positions [µm].
    cell : (n,) int -- cell of each particle, from 0.
    material : (n,) int -- material; particles are numbered by cell, then by material, then in strips.
    ranks : int -- number of ranks.
    """
    size = np.bincount(cell)
    centre = np.column_stack([np.bincount(cell, x) for x in X.T]) / size[:, None]
    for team in (p for p in range(1, ranks + 1) if ranks % p == 0 and p * THICK <= max(THICK, np.sqrt(size.min()))):
        of_cell = bisection(centre, ranks // team, size)
        fullest = np.bincount(of_cell, size).max() / team
        if fullest * ranks <= (1.0 + BALANCE) * len(X):
            return team * of_cell[cell] + slices(cell, material, team)
    return bisection(X, ranks)


def slices(cell: np.ndarray, material: np.ndarray, count: int) -> np.ndarray:
    """Slice of each particle (n,) int, from 0: `count` slices of equal size of each cell and material.

    Particles are numbered by `cell` (n,) int, then by `material` (n,) int, then in strips.
    """
    start = np.flatnonzero(np.diff(cell, prepend=-1) | np.diff(material, prepend=-1))
    length = np.diff(np.append(start, len(cell)))
    within = np.arange(len(cell)) - np.repeat(start, length)
    return within * count // np.repeat(length, length)


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
