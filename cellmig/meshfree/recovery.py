"""Recovered stress: the noise from particle to particle is fitted away, linear fields stay."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from .rkpm import window


def recovery(X: np.ndarray, pattern: sparse.csr_matrix, support: np.ndarray, region: np.ndarray) -> sparse.csr_matrix:
    """Matrix R (n, n): values at the particles of the window-weighted linear fits over their neighbours.

    A fit stays within its own `region` (n,), as stress jumps between materials; where that leaves too few neighbours
    for a linear one it is constant.  Rows sum to one.
    """
    rows = np.repeat(np.arange(len(X)), np.diff(pattern.indptr))
    d = X[pattern.indices] - X[rows]
    w = window(np.linalg.norm(d, axis=1) / support[pattern.indices])[0] * (region[rows] == region[pattern.indices])
    p = np.column_stack([np.ones(len(d)), d / support.max()])
    M = np.add.reduceat(w[:, None, None] * p[:, :, None] * p[:, None, :], pattern.indptr[:-1])
    thin = np.linalg.cond(M) > 1e4
    M[thin] = np.diag([0.0, 1.0, 1.0]) + M[thin, :1, :1] * np.diag([1.0, 0.0, 0.0])
    first = np.linalg.solve(M, np.broadcast_to(np.array([[1.0], [0.0], [0.0]]), (len(X), 3, 1)))[:, :, 0]
    values = w * np.einsum("ei,ei->e", first[rows], p)
    return sparse.csr_matrix((values, pattern.indices.copy(), pattern.indptr.copy()), pattern.shape)


class Recovery:
    """The matrices R of a rank's cells as one operator from its rows to its own particles, ``recovery @ values``."""

    def __init__(self, scene: Any, ids: np.ndarray, n_owned: int):
        """`ids` : (n_rows,) global ids of the rows, those of the own particles first."""
        self.n_owned, order = n_owned, np.argsort(ids, kind="stable")
        bounds = np.searchsorted(ids[order], scene.offset)
        self._parts = []
        for c in np.unique(scene.cell[ids[:n_owned]]):
            rows = order[bounds[c] : bounds[c + 1]]
            at, own, R = ids[rows] - scene.offset[c], rows < n_owned, scene.templates[scene.kind[c]].R
            self._parts.append((R if own.all() and len(own) == R.shape[0] else R[at[own]], rows, at, rows[own]))

    def __matmul__(self, values: np.ndarray) -> np.ndarray:
        """Recovered values (n_owned, ...) of values of all rows (n_rows, ...)."""
        out = np.empty((self.n_owned, *values.shape[1:]))
        for R, rows, at, own in self._parts:
            of_cell = np.zeros((R.shape[1], *values.shape[1:]))
            of_cell[at] = values[rows]
            out[own] = (R @ of_cell.reshape(len(of_cell), -1)).reshape(-1, *values.shape[1:])
        return out
