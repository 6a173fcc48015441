"""Reproducing-kernel shape functions: linear basis, cubic spline window (Liu, Li & Belytschko 1997)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from ..geometry import polygons
from ..geometry.delaunay import areas, triangles


def window(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cubic spline w(q) and dw/dq for the distance q in supports, w(0) = 2/3, w(1) = 0 [-]."""
    inner, s = q <= 0.5, 1.0 - q
    w = np.where(inner, 2.0 / 3.0 - 4.0 * q**2 + 4.0 * q**3, 4.0 / 3.0 * s**3)
    dw = np.where(inner, -8.0 * q + 12.0 * q**2, -4.0 * s**2)
    return np.where(q < 1.0, w, 0.0), np.where(q < 1.0, dw, 0.0)


def dual_cells(X: np.ndarray, segments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Median dual cells of the Delaunay triangulation of the body within its surface, the segments (m, 2 ends) int.

    Returns
    -------
    V : (n,) -- volumes per thickness [µm²];  edges : (m, 2) int -- Delaunay edges, each once, lower index first; of
    points on one circle all diagonals.

    Raises ValueError if the particles are too coarse for their outline, so that an edge crosses it.
    """
    def inside(tri: np.ndarray) -> np.ndarray:
        within = np.ones(len(tri), bool)
        between = np.flatnonzero(on[tri].all(axis=1))  # only these may lie outside, in a hollow
        within[between] = polygons.inside(X[tri[between]].mean(axis=1), X[segments])
        return within

    on = np.zeros(len(X), bool)
    on[segments] = True
    tri, share = triangles(X, inside)
    area = share * areas(X, tri)
    if abs(area.sum() - polygons.area(X[segments])) > 1e-9 * area.sum():
        raise ValueError("the particles are too coarse for their outline: take more of them")
    V = np.bincount(tri.ravel(), np.repeat(area / 3.0, 3), len(X))
    edges = np.sort(np.concatenate([tri[:, [0, 1]], tri[:, [1, 2]], tri[:, [2, 0]]]), axis=1)
    return V, np.unique(edges, axis=0)


def supports(X: np.ndarray, edges: np.ndarray, radius: float) -> np.ndarray:
    """Support radius of each particle (n,) [µm]: `radius`, and at least 1.15 times its longest edge."""
    length = np.linalg.norm(X[edges[:, 0]] - X[edges[:, 1]], axis=1)
    longest = np.zeros(len(X))
    np.maximum.at(longest, edges, length[:, None])
    return np.maximum(radius, 1.15 * longest)


def gradients(X: np.ndarray, support: np.ndarray, segments: np.ndarray | None = None) -> sparse.csr_matrix:
    """Gradients of the shape functions at the particles, G[I, J] = ∇N_J(X_I).

    Returned as a complex CSR matrix, ∂/∂X + i ∂/∂Y [1/µm]; linear fields are differentiated exactly.  The sparsity
    is symmetric.  Rows sum to zero: the diagonal is minus the sum of the others.  No kernel reaches across a hollow of
    the surface, the segments (m, 2 ends) int.
    """
    pairs = cKDTree(X).query_pairs(support.max(), output_type="ndarray")
    d = np.linalg.norm(X[pairs[:, 0]] - X[pairs[:, 1]], axis=1)
    pairs = pairs[d < np.maximum(support[pairs[:, 0]], support[pairs[:, 1]])]
    if segments is not None and not polygons.is_convex(X[segments]):
        pairs = pairs[polygons.visible(pairs, X, X[segments])]
    n, own = len(X), np.arange(len(X))
    I = np.concatenate([own, pairs[:, 0], pairs[:, 1]])
    J = np.concatenate([own, pairs[:, 1], pairs[:, 0]])
    order = np.lexsort((J, I))
    I, J = I[order], J[order]
    start = np.searchsorted(I, own)

    bounds, parts = np.append(start, len(I)), []
    for first in range(0, n, CHUNK):  # whose arrays stay in the cache
        some = bounds[first : first + CHUNK + 1]
        on = slice(some[0], some[-1])
        parts.append(_gradients_of(X[I[on]] - X[J[on]], support[J[on]], support.max(), some[:-1] - some[0]))
    return _closed(sparse.csr_matrix((np.concatenate(parts), J, bounds), (n, n)))


CHUNK = 2000  # particles


def _gradients_of(d: np.ndarray, a: np.ndarray, scale: float, start: np.ndarray) -> np.ndarray:
    """Gradients by entry, from particles less neighbours d (e, 2) and supports a (e,) [µm] of the neighbours.

    `start` : (k,) -- first entry of each particle;  `scale` : one for the basis, which has to be linear over all.
    """
    I = np.repeat(np.arange(len(start)), np.diff(np.append(start, len(d))))
    z = d / a[:, None]
    q = np.linalg.norm(z, axis=1)
    w, dw = window(q)
    p = np.column_stack([np.ones_like(q), d / scale])
    slope = np.divide(dw, q, out=np.zeros_like(q), where=q > 0) / a
    dw = slope[:, None] * z  # ∂w/∂x_k
    pp = p[:, :, None] * p[:, None, :]
    M = np.add.reduceat(pp * w[:, None, None], start)
    if np.linalg.cond(M).max() > 1e8:
        raise ValueError("a particle has too few neighbours for a linear basis: raise the dilation")
    b = np.linalg.solve(M, np.broadcast_to(np.array([[1.0], [0.0], [0.0]]), (len(start), 3, 1)))[:, :, 0]
    G = np.zeros((len(d), 2))
    for k in range(2):
        dp = np.zeros_like(p)
        dp[:, 1 + k] = 1.0 / scale
        sym = dp[:, :, None] * p[:, None, :]
        dM = np.add.reduceat((sym + sym.transpose(0, 2, 1)) * w[:, None, None] + pp * dw[:, k, None, None], start)
        db = -np.linalg.solve(M, np.einsum("nij,nj->ni", dM, b)[:, :, None])[:, :, 0]
        G[:, k] = np.einsum("ei,ei->e", db[I], p) * w + np.einsum("ei,ei->e", b[I], dp) * w
        G[:, k] += np.einsum("ei,ei->e", b[I], p) * dw[:, k]
    return G[:, 0] + 1j * G[:, 1]


def _closed(G: sparse.csr_matrix) -> sparse.csr_matrix:
    """G with its diagonal minus the sum of the other entries of the row."""
    G.setdiag(G.diagonal() - np.asarray(G.sum(axis=1)).ravel())
    return G


def interpolation(X: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Particles (k,) and weights (k,) that give a field at the point x (2,), linear fields exactly."""
    distance, near = cKDTree(X).query(x, min(13, len(X)))
    if distance[0] < 1e-9 * distance[-1]:
        return near[:1], np.ones(1)
    # The last has no weight: which it is of those as far does not matter.
    support = distance[-1] * (1.0 if len(near) < len(X) else 1.01)
    w = window(distance / support)[0]
    p = np.column_stack([np.ones(len(near)), (X[near] - x) / support])
    return near, w * (p @ np.linalg.solve(p.T @ (w[:, None] * p), np.array([1.0, 0.0, 0.0])))


def surface_normals(X: np.ndarray, segments: np.ndarray) -> np.ndarray:
    """Integral of the outward normal times the surface shape functions (n, 2) [µm], over segments (m, 2 ends) int."""
    along = X[segments[:, 1]] - X[segments[:, 0]]
    half = 0.5 * np.column_stack([along[:, 1], -along[:, 0]])
    b = np.zeros_like(X)
    np.add.at(b, segments[:, 0], half)
    np.add.at(b, segments[:, 1], half)
    return b


def factorised(A: sparse.csc_matrix, b: np.ndarray) -> np.ndarray:
    """Solution x (n, k) of A x = b for a symmetric positive definite A (n, n)."""
    return splu(A, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}).solve(b)


def consistent(G: sparse.csr_matrix, X: np.ndarray, V: np.ndarray, support: np.ndarray, segments: np.ndarray,
               solve: Callable[..., np.ndarray] = factorised) -> sparse.csr_matrix:
    r"""Gradients next to G for which the divergence theorem holds: Σ_I V_I G_IJ = ∮ n N_J, with the pattern of G.

    Nodal integration violates it, and a uniform stress then does work inside the body.  The change D is the smallest,
    Σ D_IJ² / w_IJ with the window w, that keeps linear fields exact: D_IJ = V_I w_IJ (γ_J less its weighted linear fit
    about I), where γ solves a symmetric system.  In the spirit of Chen, Hillman & Rüter (2013), but for trial and test
    functions alike, so that forces have an energy.  `solve` is for symmetric positive systems.
    """
    n = len(X)
    rows = np.repeat(np.arange(n), np.diff(G.indptr))
    d = X[G.indices] - X[rows]
    w = window(np.linalg.norm(d, axis=1) / support[G.indices])[0]
    p = np.column_stack([np.ones(len(d)), d])
    M = np.add.reduceat(w[:, None, None] * p[:, :, None] * p[:, None, :], G.indptr[:-1])
    fit = np.linalg.solve(np.linalg.cholesky(M)[rows], (w[:, None] * p)[:, :, None])[:, :, 0]
    Y = [sparse.csr_matrix((f, G.indices, G.indptr), G.shape) for f in fit.T]
    V2 = sparse.diags(V**2)
    A = sparse.diags(np.bincount(G.indices, V[rows] ** 2 * w, n)) - sum(y.T @ V2 @ y for y in Y)
    missing = surface_normals(X, segments) - np.column_stack([(V @ G).real, (V @ G).imag])
    free = np.ones(n, bool)
    free[_three(X, segments[:, 0])] = False  # γ is known up to a linear function, which changes nothing
    gamma = np.zeros((n, 2))
    gamma[free] = solve(A.tocsc()[free][:, free], missing[free])
    part = w[:, None] * gamma[G.indices] - sum(f[:, None] * (y @ gamma)[rows] for f, y in zip(fit.T, Y, strict=True))
    D = V[rows] * (part[:, 0] + 1j * part[:, 1])
    return _closed(sparse.csr_matrix((G.data + D, G.indices, G.indptr), G.shape))


def _three(X: np.ndarray, surface: np.ndarray) -> np.ndarray:
    """Three surface particles that are not on one line (3,) int."""
    three = surface[np.arange(3) * len(surface) // 3]
    a, b, c = X[three]
    if abs(polygons.cross(b - a, c - a)) < 0.1 * (np.ptp(X[surface], axis=0) ** 2).min():  # as may be, with holes
        second = surface[np.linalg.norm(X[surface] - a, axis=1).argmax()]
        third = surface[np.abs(polygons.cross(X[second] - a, X[surface] - a)).argmax()]
        three = np.array([three[0], second, third])
    return three
