"""Recovered stress: a local linear fit removes the noise from particle to particle and keeps linear fields."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from .rkpm import window


def recovery(X: np.ndarray, pattern: sparse.csr_matrix, support: np.ndarray, region: np.ndarray) -> sparse.csr_matrix:
    """Matrix that replaces values at the particles by those of window-weighted linear fits over their neighbours.

    Parameters
    ----------
    X : (n, D) -- reference positions [µm].
    pattern : (n, n) CSR -- its pattern tells the neighbours of each particle.
    support : (n,) -- support radii [µm].
    region : (n,) int or bool -- neighbours of another region are left out, as stress jumps between materials.

    Returns
    -------
    (n, n) CSR [-] -- rows sum to one; with too few neighbours the fit is constant instead of linear.

    Source: moving least squares (Lancaster & Salkauskas 1981).
    """
    rows = np.repeat(np.arange(len(X)), np.diff(pattern.indptr))
    d = X[pattern.indices] - X[rows]
    w = window(np.linalg.norm(d, axis=1) / support[pattern.indices])[0] * (region[rows] == region[pattern.indices])
    p = np.column_stack([np.ones(len(d)), d / support.max()])
    M = np.add.reduceat(w[:, None, None] * p[:, :, None] * p[:, None, :], pattern.indptr[:-1])
    thin = np.linalg.cond(M) > 1e4
    one = np.eye(p.shape[1])[:, :1]
    M[thin] = np.where(one @ one.T > 0.0, M[thin, :1, :1], np.eye(len(one)))
    first = np.linalg.solve(M, np.broadcast_to(one, (len(X), *one.shape)))[:, :, 0]
    values = w * np.einsum("ei,ei->e", first[rows], p)
    return sparse.csr_matrix((values, pattern.indices.copy(), pattern.indptr.copy()), pattern.shape)


class Recovery:
    """The matrices `recovery` of the cells of a rank as one operator: ``Recovery(…) @ values``, in any unit."""

    def __init__(self, scene: Any, ids: np.ndarray, n_owned: int):
        """`ids` (n_rows,) int are global ids of the rank's particles, the `n_owned` owned ones first, then ghosts."""
        self.n_owned, order = n_owned, np.argsort(ids, kind="stable")
        bounds = np.searchsorted(ids[order], scene.offset)
        self._parts = []
        for c in np.unique(scene.cell_of(ids[:n_owned])):
            rows = order[bounds[c] : bounds[c + 1]]
            at, own, R = ids[rows] - scene.offset[c], rows < n_owned, scene.templates[scene.kind[c]].R
            self._parts.append((R if own.all() and len(own) == R.shape[0] else R[at[own]], rows, at, rows[own]))

    def __matmul__(self, values: np.ndarray) -> np.ndarray:
        """Recovered values (n_owned, ...) from `values` (n_rows, ...) of owned particles and ghosts."""
        out = np.empty((self.n_owned, *values.shape[1:]))
        for R, rows, at, own in self._parts:
            of_cell = np.zeros((R.shape[1], *values.shape[1:]))
            of_cell[at] = values[rows]
            out[own] = (R @ of_cell.reshape(len(of_cell), -1)).reshape(-1, *values.shape[1:])
        return out
