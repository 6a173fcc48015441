"""Linear operators of a discretised body, and their largest eigenvalues."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse.linalg import LinearOperator, eigsh

from .simplices import Gradient


def strain_operator(G: Gradient, V: np.ndarray, shear: np.ndarray, volumetric: np.ndarray) -> LinearOperator:
    """Operator v ↦ Σ_I V_I (2 shear d + volumetric tr(d) I) ∇N_J on vectors of x components, then y, z (D n,).

    G : (n, n) CSR for each direction -- gradients [1/µm];  V : (n,) -- volumes [µm^D];  shear, volumetric : (n,) --
    moduli [Pa] or viscosities [Pa µs].  Source: isotropic linear elasticity, in nodal integrals.
    """
    n, D = len(V), len(G)

    def apply(v: np.ndarray) -> np.ndarray:
        L = [[g @ part for g in G] for part in v.reshape(D, n)]
        p = volumetric * sum(L[k][k] for k in range(D))
        s = [[V * 2 * shear * (0.5 * (L[i][j] + L[j][i])) for j in range(D)] for i in range(D)]
        for k in range(D):
            s[k][k] = V * (2 * shear * L[k][k] + p)
        return np.concatenate([sum(g.T @ part for g, part in zip(G, row, strict=True)) for row in s])

    return LinearOperator((D * n, D * n), apply, dtype=float)


def largest(operator: Any, n: int) -> float:
    """Largest eigenvalue of a symmetric operator (n, n), in its unit [1/µs], [1/µs²] or [1/µm²], rounded up to three
    digits: its last bits do not matter.
    """
    start = np.cos(np.arange(n) ** 1.5)
    if not (operator @ start).any():  # versions of ARPACK differ in what they make of a zero matrix
        return 0.0
    top = eigsh(operator, 1, which="LA", tol=1e-4, v0=start, return_eigenvectors=False)[0]
    return float(f"{max(top, 0.0) * 1.01:.2e}")
