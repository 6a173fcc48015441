"""Stabilisation: what nodal integration misses of short waves, by Laplacians that vanish for linear fields."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from ..model.continuum import Continuum
from ..model.tensors import applied, cofactors, combined, contracted, outer

# Of the power μ V |∇v|² of shear waves, nodal integration with a support of 2.2 spacings in the plane misses this share
# of μ V ℓ² |∇²v|², where ℓ² is the mean of the squared distances of neighbours: then waves of 4 spacings and more lose
# within 0.5 % what they should (tests/meshfree/test_meshfree.py).
MISSED = 0.3
# The same in space by supports of RKPM [spacings], and of averages of finite elements by dimensions.  Then waves of 4.5
# spacings and more lose within 1 % what they should, with a support of 2.2 within 0.4 %, in a ball of 4,000
# particles (tests/meshfree/test_space.py).
MISSED_IN_SPACE = ((1.8, 2.2), (0.213, 0.255))
MISSED_BY_AVERAGES = {2: 0.26, 3: 0.213}


def missed(D: int, dilation: float) -> float:
    """Share [-] that nodal integration misses in D dimensions with RKPM's support of `dilation` spacings [-].

    A `dilation` of 0 stands for averaged gradients of finite elements.  Source: measured, see above.
    """
    if not dilation:
        return MISSED_BY_AVERAGES[D]
    return MISSED if D == 2 else float(np.interp(dilation, *MISSED_IN_SPACE))


def laplacian(X: np.ndarray, edges: np.ndarray) -> tuple[sparse.csr_matrix, np.ndarray]:
    r"""Laplacians at the particles, which vanish for linear fields, from neighbours alone.

    Row I is 2 D/E_I Σ_J (f_J - f_I - g·(X_J - X_I)) / |X_J - X_I|² over the E_I edges of I, where g is the gradient of
    the linear fit with the weights 1/|X_J - X_I|².

    Parameters
    ----------
    X : (n, D) -- reference positions [µm].
    edges : (m, 2) int -- neighbours, each pair once.

    Returns
    -------
    C : (n, n) CSR [1/µm²] -- rows sum to zero.
    square : (n,) -- mean of the squared distances of the neighbours of each particle ℓ² [µm²].

    Source: derived here, second differences along the edges less their linear fit.
    """
    n, D = X.shape
    I, J = _both_ways(edges)
    d = X[J] - X[I]
    square = (d**2).sum(axis=1)
    weight = 2.0 * D / (np.bincount(I, minlength=n)[I] * square)
    M, first = np.zeros((n, D, D)), np.zeros((n, D))
    np.add.at(M, I, weight[:, None, None] * d[:, :, None] * d[:, None, :])
    np.add.at(first, I, weight[:, None] * d)
    fit = np.linalg.solve(M, first[:, :, None])[:, :, 0]
    c, at = weight * (1.0 - (fit[I] * d).sum(axis=1)), np.arange(n)
    values, row, column = (np.concatenate(a) for a in ((c, -np.bincount(I, c, n)), (I, at), (J, at)))
    return sparse.csr_matrix((values, (row, column)), (n, n)), np.bincount(I, square, n) / np.bincount(I, minlength=n)


def _both_ways(edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and second particle of each edge in both directions, (2 m,) int each, in order."""
    I, J = np.concatenate([edges, edges[:, ::-1]]).T
    order = np.lexsort((J, I))
    return I[order], J[order]


class Stabilisation(Continuum):
    """Viscosity against Laplacians of v; no field that is linear in the current positions x is resisted.

    The power is weight |r|² / (F : F - (D - 1) J), with r = C v - Ḟ F⁻¹ C u, where C are the Laplacians of `laplacian`:
    r is zero for v = A x + b, as C x = C u, so that forces have no torque.  Waves along a stretch λ have Laplacians λ²
    times as large as those of x; the divisor, which is about λ² and positive (in space for J < 3.4), leaves λ², as the
    squared distances of neighbours have grown.
    Source: derived here, as an hourglass control (Flanagan & Belytschko 1981) of second differences.
    """

    def stress(self, weight, F, Fdot, bend, bend_rate):
        """Stress q [pN µm], conjugate to C v, and -q ⊗ F⁻¹ C u [pN], to Ḟ; bend is C u [1/µm], bend_rate C v in
        1/(µm µs), the weight in pN µs µm².
        """
        w = self.pulled_back(F, bend)
        k = weight / (contracted(F, F) - (len(F) - 1.0) * self.volume_ratio(F))
        q = tuple(k * (r - a) for r, a in zip(bend_rate, applied(Fdot, w), strict=True))
        return q, combined((-1.0, outer(q, w)))


class BulkDamping(Continuum):
    """Numerical damping of sound: a pressure against the rate of dilation tr d, as the bulk viscosity of hydrocodes."""

    def stress(self, viscosity, F, Fdot):
        """First Piola-Kirchhoff stress viscosity tr d J F⁻ᵀ [Pa], minus its pressure [Pa] and J̇ [1/µs]; viscosity in
        Pa µs.
        """
        cofactor = cofactors(F)
        rate = contracted(Fdot, cofactor)
        pressure = viscosity * rate * (1.0 / self.volume_ratio(F))
        return combined((pressure, cofactor)), pressure, rate
