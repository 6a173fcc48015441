"""Which rank owns which particle."""

from __future__ import annotations

import numpy as np

BALANCE = 0.03  # by how much the fullest rank may exceed its share for the sake of whole cells
THICK = 15.0  # spacings: a slice of a cell that is thinner has almost as many ghosts as particles


def partition(X: np.ndarray, cell: np.ndarray, material: np.ndarray, ranks: int) -> np.ndarray:
    """Owner (n,) of particles at X (n, d) in cells, from 0 (n,), of materials (n,), numbered in strips in each.

    Whole cells where the ranks then are as full: they exchange nothing but what touches.  Else teams of ranks have
    whole cells, as small as they balance, and every rank of a team has the same slice of all cells of its team:
    coefficients that cells of a kind share then fill the caches of one rank alone.  Where slices would be thin, parts
    of space.
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
    """Slice (n,) of particles that are numbered by cell and material, and in these by height: as many in each."""
    start = np.flatnonzero(np.diff(cell, prepend=-1) | np.diff(material, prepend=-1))
    length = np.diff(np.append(start, len(cell)))
    within = np.arange(len(cell)) - np.repeat(start, length)
    return within * count // np.repeat(length, length)


def bisection(X: np.ndarray, ranks: int, weight: np.ndarray | None = None) -> np.ndarray:
    """Owner (n,) of things at X (n, d) of some weight (n,): recursive coordinate bisection, equal to one of them."""
    owner = np.zeros(len(X), np.int32)
    weight = np.ones(len(X)) if weight is None else weight

    def split(ids: np.ndarray, first: int, count: int) -> None:
        if count == 1 or len(ids) == 0:
            owner[ids] = first
            return
        axis = int(np.argmax(np.ptp(X[ids], axis=0)))
        ids = ids[np.lexsort((ids, X[ids, axis]))]
        half, heavy = count // 2, np.cumsum(weight[ids])
        cut = int(np.searchsorted(heavy - 0.5 * weight[ids], heavy[-1] * half / count))
        split(ids[:cut], first, half)
        split(ids[cut:], first + half, count - half)

    split(np.arange(len(X)), 0, ranks)
    return owner
