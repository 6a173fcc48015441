"""Stabilisation: damps modes that nodal integration does not see, and no velocity field that is linear in space."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from ..model.plane_strain import PlaneStrain


def stabilisation(X: np.ndarray, V: np.ndarray, edges: np.ndarray, viscosity: np.ndarray) -> sparse.csr_matrix:
    r"""Symmetric positive semidefinite matrix S: the forces on the particles are -S v, the dissipated power is v·S v.

    v·S v = Σ_I μs_I Σ_J κ_IJ |w_IJ|² with w_IJ = v_J - v_I - A_I (X_J - X_I) over the E_I edges of each particle I,
    where κ_IJ = V_I / (E_I |X_J - X_I|²) and A_I is the gradient of the κ-weighted linear fit: linear fields, such as
    rigid motions, are not resisted.  A modulus in place of μs gives elastic forces -E u with the energy u·E u/2.

    Parameters
    ----------
    X : (n, 2) -- reference positions [µm].
    V : (n,) -- volumes per unit thickness [µm²].
    edges : (m, 2) int -- neighbours, each pair once.
    viscosity : (n,) -- μs [Pa µs], or a modulus [Pa].

    Returns
    -------
    (n, n) CSR [Pa µs] or [Pa] -- rows sum to zero.

    Source: derived here, as a hourglass control (Flanagan & Belytschko 1981) on the edges of the particles.
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
    fit = np.linalg.solve(root[I], (weight[:, None] * d)[:, :, None])[:, :, 0]  # root⁻¹ κ d, where A = root rootᵀ
    Y = [sparse.csr_matrix((fit[:, k], (I, e)), (n, len(I))) @ B for k in range(2)]
    S = B.T @ sparse.diags(weight) @ B - Y[0].T @ Y[0] - Y[1].T @ Y[1]
    S = 0.5 * (S + S.T)
    S = (S - sparse.diags(S.diagonal())).tocsr()
    return (S - sparse.diags(np.asarray(S.sum(axis=1)).ravel())).tocsr()


def _safe_root(A: np.ndarray) -> np.ndarray:
    """Cholesky factors (n, 2, 2) of A (n, 2, 2), the identity where A is zero: nothing is stabilised there."""
    none = A[:, 0, 0] == 0.0
    return np.linalg.cholesky(np.where(none[:, None, None], np.eye(2), A))


class BulkDamping(PlaneStrain):
    """Numerical damping of sound: a pressure against the rate of dilation tr d, as the bulk viscosity of hydrocodes."""

    def stress(self, viscosity, F, Fdot):
        """First Piola-Kirchhoff stress viscosity tr d J F⁻ᵀ [Pa], minus its pressure [Pa] and J̇ [1/µs]; viscosity in
        Pa µs.
        """
        (F00, F01), (F10, F11) = F
        (R00, R01), (R10, R11) = Fdot
        rate = R00 * F11 - R01 * F10 - R10 * F01 + R11 * F00
        pressure = viscosity * rate * (1.0 / self.volume_ratio(F))
        return ((pressure * F11, -pressure * F10), (-pressure * F01, pressure * F00)), pressure, rate
