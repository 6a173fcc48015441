"""Which rank owns which particle."""

from __future__ import annotations

import numpy as np


def bisection(X: np.ndarray, ranks: int) -> np.ndarray:
    """Owner (n,) of particles at X (n, d): recursive coordinate bisection, sizes equal to one particle."""
    owner = np.zeros(len(X), np.int32)

    def split(ids: np.ndarray, first: int, count: int) -> None:
        if count == 1 or len(ids) == 0:
            owner[ids] = first
            return
        axis = int(np.argmax(np.ptp(X[ids], axis=0)))
        ids = ids[np.lexsort((ids, X[ids, axis]))]
        half = count // 2
        cut = round(len(ids) * half / count)
        split(ids[:cut], first, half)
        split(ids[cut:], first + half, count - half)

    split(np.arange(len(X)), 0, ranks)
    return owner
