"""Which rank owns which particle."""

from __future__ import annotations

import numpy as np

BALANCE = 0.03  # by how much the fullest rank may exceed its share for the sake of whole cells


def partition(X: np.ndarray, cell: np.ndarray, ranks: int) -> np.ndarray:
    """Owner (n,) of particles at X (n, d) in cells, from 0 (n,): whole cells where the ranks then are as full.

    Between ranks that have whole cells nothing is exchanged but what touches.
    """
    size = np.bincount(cell)
    centre = np.column_stack([np.bincount(cell, x) for x in X.T]) / size[:, None]
    of_cell = bisection(centre, ranks, size)
    fullest = np.bincount(of_cell, size, ranks).max()
    if fullest * ranks <= (1.0 + BALANCE) * len(X):
        return of_cell[cell]
    return bisection(X, ranks)


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
