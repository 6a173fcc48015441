"""Viscous stabilisation: damps what nodal integration does not see, and nothing that is linear in space."""

from __future__ import annotations

import numpy as np
from scipy import sparse


def stabilisation(X: np.ndarray, V: np.ndarray, edges: np.ndarray, viscosity: np.ndarray) -> sparse.csr_matrix:
    r"""Symmetric positive matrix S; the force on the particles is -S v, the power lost v·S v.

    About each particle I, with the weights κ_IJ = V_I / (E_I |X_J - X_I|²) of its E_I edges, the velocity differences
    v_J - v_I less their best linear fit are resisted with the viscosity μs of I.

    The same matrix made with a modulus in place of the viscosity gives elastic forces -E u with the energy u·E u/2;
    as it sees only what is not linear, it is indifferent to rotations.

    Parameters
    ----------
    X : (n, 2) -- reference positions [µm];  V : (n,) -- volumes [µm²];
    edges : (m, 2) int -- neighbours, each pair once;  viscosity : (n,) -- μs [Pa µs].

    Returns
    -------
    S : (n, n) CSR [Pa µs], zero row sums, zero on linear velocity fields.
    """
    n = len(X)
    if not viscosity.any():
        return sparse.csr_matrix((n, n))
    I = np.concatenate([edges[:, 0], edges[:, 1]])
    J = np.concatenate([edges[:, 1], edges[:, 0]])
    order = np.lexsort((J, I))
    I, J = I[order], J[order]
    e = np.arange(len(I))
    d = X[J] - X[I]
    weight = viscosity[I] * V[I] / (np.bincount(I, minlength=n)[I] * (d**2).sum(axis=1))

    B = sparse.csr_matrix((np.tile([-1.0, 1.0], len(I)), (np.repeat(e, 2), np.column_stack([I, J]).ravel())))
    A = np.zeros((n, 2, 2))
    np.add.at(A, I, weight[:, None, None] * d[:, :, None] * d[:, None, :])
    root = np.linalg.cholesky(A + 1e-300 * np.eye(2)) if (viscosity > 0).all() else _safe_root(A)
    fit = np.linalg.solve(root[I], (weight[:, None] * d)[:, :, None])[:, :, 0]  # whitened least squares, per edge
    Y = [sparse.csr_matrix((fit[:, k], (I, e)), (n, len(I))) @ B for k in range(2)]
    S = B.T @ sparse.diags(weight) @ B - Y[0].T @ Y[0] - Y[1].T @ Y[1]
    S = 0.5 * (S + S.T)
    S = (S - sparse.diags(S.diagonal())).tocsr()
    return (S - sparse.diags(np.asarray(S.sum(axis=1)).ravel())).tocsr()


def _safe_root(A: np.ndarray) -> np.ndarray:
    """Cholesky factors, the identity where nothing is to be stabilised."""
    none = A[:, 0, 0] == 0.0
    return np.linalg.cholesky(np.where(none[:, None, None], np.eye(2), A))
