"""Shape functions of the reproducing kernel particle method (RKPM), with linear basis and cubic spline window.

The number of dimensions D, 2 or 3, is that of the positions.

Source: Liu, Jun & Zhang (1995); Liu, Li & Belytschko (1997), whose moving least squares give the same functions.
"""

from __future__ import annotations

from collections.abc import Callable
from math import ceil

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from ..geometry import polygons
from ..geometry.delaunay import areas, triangles
from .simplices import Gradient, edges_of, nodal_volumes, surface_normals, zero_row_sums

NEAR = {2: 13, 3: 28}  # particles from which is interpolated, by the number of dimensions
CHUNK = 2000  # particles whose arrays fit into the processor's cache


def window(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cubic spline window w(q) and its derivative dw/dq, (n,) each [-], at distances q (n,) in supports [-].

    w = 2/3 - 4 q² + 4 q³ up to q = 1/2, then 4/3 (1 - q)³ up to q = 1, and 0 beyond.
    """
    inner, s = q <= 0.5, 1.0 - q
    w = np.where(inner, 2.0 / 3.0 - 4.0 * q**2 + 4.0 * q**3, 4.0 / 3.0 * s**3)
    dw = np.where(inner, -8.0 * q + 12.0 * q**2, -4.0 * s**2)
    return np.where(q < 1.0, w, 0.0), np.where(q < 1.0, dw, 0.0)


def dual_cells(X: np.ndarray, segments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Median dual cells of the Delaunay triangulation of a body in the plane.

    Parameters
    ----------
    X : (n, 2) -- positions of the particles [µm].
    segments : (m, 2) int -- ends of the segments of the surface.

    Returns
    -------
    V : (n,) -- volumes per unit thickness [µm²], a third of the triangles around each particle.
    edges : (k, 2) int -- Delaunay edges, each once, lower index first; all diagonals of cocircular particles.

    Raises ValueError as `triangulated`.
    """
    tri, share = triangulated(X, segments)
    return nodal_volumes(len(X), tri, share * areas(X, tri)), edges_of(tri)


def triangulated(X: np.ndarray, segments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Delaunay triangles of a body in the plane, and their weights in sums (k,) [-], as `delaunay.triangles`.

    X : (n, 2) -- positions of the particles [µm];  segments : (m, 2) int -- ends of the segments of the surface.

    Raises ValueError if the particles are too coarse for the outline, so that an edge crosses it.
    """
    def inside(tri: np.ndarray) -> np.ndarray:
        within = np.ones(len(tri), bool)
        between = np.flatnonzero(on[tri].all(axis=1))  # only these may be outside, where the surface is concave
        within[between] = polygons.inside(X[tri[between]].mean(axis=1), X[segments])
        return within

    on = np.zeros(len(X), bool)
    on[segments] = True
    tri, share = triangles(X, inside)
    area = float((share * areas(X, tri)).sum())
    if abs(area - polygons.area(X[segments])) > 1e-9 * area:
        raise ValueError("the particles are too coarse for their outline: take more of them")
    return tri, share


def supports(X: np.ndarray, edges: np.ndarray, radius: float) -> np.ndarray:
    """Support radii (n,) [µm] of particles at X (n, D) [µm]: `radius` [µm], but at least 1.15 times the longest edge.

    `edges` (m, 2) int are pairs of neighbours.
    """
    longest = np.zeros(len(X))
    np.maximum.at(longest, edges, _lengths(X, edges)[:, None])
    return np.maximum(radius, 1.15 * longest)


def neighbours(X: np.ndarray, support: np.ndarray, segments: np.ndarray | None = None,
               edges: np.ndarray | None = None) -> np.ndarray:
    """Pairs of particles (m, 2) int, each once, of which one lies in the support of the other.

    Parameters
    ----------
    X : (n, D) -- positions of the particles [µm].
    support : (n,) -- support radii [µm].
    segments : (m, 2) int -- ends of the segments of a surface in the plane, across which no kernel reaches.
    edges : (k, 2) int -- edges of tetrahedra, of which at most as many lead from one of a pair to the other as the
        largest support holds of mean length, rounded up: no kernel reaches across a gap.
    """
    pairs = cKDTree(X).query_pairs(support.max(), output_type="ndarray")
    d = np.linalg.norm(X[pairs[:, 0]] - X[pairs[:, 1]], axis=1)
    pairs = pairs[d < np.maximum(support[pairs[:, 0]], support[pairs[:, 1]])]
    if segments is not None and not polygons.is_convex(X[segments]):
        pairs = pairs[polygons.visible(pairs, X, X[segments])]
    if edges is not None:
        pairs = pairs[_linked(pairs, edges, ceil(support.max() / _lengths(X, edges).mean()), len(X))]
    return pairs


def _linked(pairs: np.ndarray, edges: np.ndarray, rings: int, n: int) -> np.ndarray:
    """Whether at most so many `edges` (k, 2) int lead from one of n particles to the other, for `pairs` (m, 2) int."""
    step = sparse.csr_matrix((np.ones(len(edges)), edges.T), (n, n))
    step = step + step.T + sparse.eye(n)
    reach = step
    for _ in range(rings - 1):
        reach = reach @ step
    return np.asarray(reach[pairs[:, 0], pairs[:, 1]]).ravel() > 0.0


def _lengths(X: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Lengths (m,) [µm] of the `edges` (m, 2) int between points X (n, D) [µm]."""
    return np.linalg.norm(X[edges[:, 0]] - X[edges[:, 1]], axis=1)


def gradients(X: np.ndarray, support: np.ndarray, segments: np.ndarray | None = None,
              edges: np.ndarray | None = None) -> Gradient:
    """Gradients of the shape functions at the particles, G[k][I, J] = ∂N_J/∂X_k at X_I.

    Parameters
    ----------
    X : (n, D) -- positions of the particles [µm].
    support : (n,) -- support radii [µm].
    segments : (m, 2) int -- ends of the segments of a surface in the plane, as for `neighbours`.
    edges : (k, 2) int -- edges of tetrahedra, as for `neighbours`.

    Returns
    -------
    (n, n) CSR [1/µm] for each direction, of one symmetric pattern -- exact for linear fields; rows sum to zero.

    Raises ValueError if a particle has too few neighbours for a linear basis.

    Source: Liu, Jun & Zhang (1995), the derivative of N_J = b(x)·p(x - X_J) w with the moment matrix M(x) b = p(0).
    """
    pairs = neighbours(X, support, segments, edges)
    n, own = len(X), np.arange(len(X))
    I = np.concatenate([own, pairs[:, 0], pairs[:, 1]])
    J = np.concatenate([own, pairs[:, 1], pairs[:, 0]])
    order = np.lexsort((J, I))
    I, J = I[order], J[order]
    start = np.searchsorted(I, own)

    bounds, parts = np.append(start, len(I)), []
    for first in range(0, n, CHUNK):
        some = bounds[first : first + CHUNK + 1]
        on = slice(some[0], some[-1])
        parts.append(_gradients_of(X[I[on]] - X[J[on]], support[J[on]], support.max(), some[:-1] - some[0]))
    return zero_row_sums(np.concatenate(parts), J, bounds)


def _gradients_of(d: np.ndarray, a: np.ndarray, scale: float, start: np.ndarray) -> np.ndarray:
    """Gradients (e, D) [1/µm] of the entries of k particles.

    Entry e has the vector d (e, D) [µm] from a neighbour to the particle, and the support a (e,) [µm] of the neighbour;
    `start` (k,) is the first entry of each particle, `scale` [µm] makes the basis dimensionless.
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
    b = np.linalg.solve(M, np.broadcast_to(np.eye(p.shape[1])[:, :1], (len(start), p.shape[1], 1)))[:, :, 0]
    G = np.zeros_like(d)
    for k in range(d.shape[1]):
        dp = np.zeros_like(p)
        dp[:, 1 + k] = 1.0 / scale
        sym = dp[:, :, None] * p[:, None, :]
        dM = np.add.reduceat((sym + sym.transpose(0, 2, 1)) * w[:, None, None] + pp * dw[:, k, None, None], start)
        db = -np.linalg.solve(M, np.einsum("nij,nj->ni", dM, b)[:, :, None])[:, :, 0]
        G[:, k] = np.einsum("ei,ei->e", db[I], p) * w + np.einsum("ei,ei->e", b[I], dp) * w
        G[:, k] += np.einsum("ei,ei->e", b[I], p) * dw[:, k]
    return G


def interpolation(X: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Particles (k,) int among those at X (n, D) [µm], and weights (k,) [-], that interpolate a field to x (D,) [µm].

    Linear fields are interpolated exactly.  Source: moving least squares, as Liu, Li & Belytschko (1997).
    """
    distance, near = cKDTree(X).query(x, min(NEAR[X.shape[1]], len(X)))
    if distance[0] < 1e-9 * distance[-1]:
        return near[:1], np.ones(1)
    # The window vanishes at the last one: which of several equally far particles it is does not matter.
    support = distance[-1] * (1.0 if len(near) < len(X) else 1.01)
    w = window(distance / support)[0]
    p = np.column_stack([np.ones(len(near)), (X[near] - x) / support])
    return near, w * (p @ np.linalg.solve(p.T @ (w[:, None] * p), np.eye(p.shape[1])[0]))


def factorised(A: sparse.csc_matrix, b: np.ndarray) -> np.ndarray:
    """Solution x (n, k) of A x = b, for a symmetric positive definite A (n, n) and b (n, k), of any units.

    Raises ValueError where A is singular.
    """
    try:
        return splu(A, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}).solve(b)
    except RuntimeError as error:
        raise ValueError("particles are too close together, or a part of the body is too thin for them") from error


def consistent(G: Gradient, X: np.ndarray, V: np.ndarray, support: np.ndarray, facets: np.ndarray,
               solve: Callable[..., np.ndarray] = factorised) -> Gradient:
    r"""Gradients closest to G for which nodal integration satisfies the divergence theorem, Σ_I V_I G_IJ = ∮ n N_J dA.

    Without the correction D a uniform stress causes forces inside the body.  D minimises Σ D_IJ² / w_IJ, where w is the
    window, under the condition that linear fields remain exact: D_IJ = V_I w_IJ times the deviation of γ_J from its
    weighted linear fit about I, where γ solves a symmetric positive definite system.

    Parameters
    ----------
    G : (n, n) CSR [1/µm] for each direction -- as `gradients` returns them.
    X : (n, D) -- positions [µm].
    V : (n,) -- volumes [µm^D].
    support : (n,) -- support radii [µm].
    facets : (m, D) int -- corners of the segments or triangles of the surface, as for `surface_normals`.
    solve : function -- of A, b as `factorised`.

    Returns
    -------
    (n, n) CSR [1/µm] for each direction -- with the pattern of G.

    Raises ValueError where the neighbours of a particle are in one plane.

    Source: derived here, as a variationally consistent integration (Chen, Hillman & Rüter 2013) in which trial and test
    functions have the same corrected gradients, so that the forces have an energy.
    """
    n, column, start = len(X), G[0].indices, G[0].indptr
    rows = np.repeat(np.arange(n), np.diff(start))
    d = X[column] - X[rows]
    w = window(np.linalg.norm(d, axis=1) / support[column])[0]
    p = np.column_stack([np.ones(len(d)), d])
    M = np.add.reduceat(w[:, None, None] * p[:, :, None] * p[:, None, :], start[:-1])
    try:
        fit = np.linalg.solve(np.linalg.cholesky(M)[rows], (w[:, None] * p)[:, :, None])[:, :, 0]
    except np.linalg.LinAlgError as error:
        raise ValueError("a part of the body is too thin for the particles") from error
    Y = [sparse.csr_matrix((f, column, start), (n, n)) for f in fit.T]
    V2 = sparse.diags(V**2)
    A = sparse.diags(np.bincount(column, V[rows] ** 2 * w, n)) - sum(y.T @ V2 @ y for y in Y)
    missing = surface_normals(X, facets) - np.column_stack([V @ g for g in G])
    free = np.ones(n, bool)
    free[_spanning(X, facets[:, 0])] = False  # γ is determined up to a linear function, which does not change D
    gamma = np.zeros_like(X)
    gamma[free] = solve(A.tocsc()[free][:, free], missing[free])
    part = w[:, None] * gamma[column] - sum(f[:, None] * (y @ gamma)[rows] for f, y in zip(fit.T, Y, strict=True))
    entries = np.column_stack([g.data for g in G]) + V[rows, None] * part
    return zero_row_sums(entries, column, start)


def _spanning(X: np.ndarray, surface: np.ndarray) -> np.ndarray:
    """Particles (D + 1,) int among `surface` (m,) int that are not on one line or plane."""
    if X.shape[1] == 3:
        chosen, away = surface[:1], X[surface] - X[surface[0]]
        for _ in range(3):  # next the one that is farthest from the line or plane of those before
            far = (away**2).sum(axis=1).argmax()
            chosen, along = np.append(chosen, surface[far]), away[far] / np.linalg.norm(away[far])
            away = away - np.outer(away @ along, along)
        return chosen
    three = surface[np.arange(3) * len(surface) // 3]
    a, b, c = X[three]
    if abs(polygons.cross(b - a, c - a)) < 0.1 * (np.ptp(X[surface], axis=0) ** 2).min():  # possible if there are holes
        second = surface[np.linalg.norm(X[surface] - a, axis=1).argmax()]
        third = surface[np.abs(polygons.cross(X[second] - a, X[surface] - a)).argmax()]
        three = np.array([three[0], second, third])
    return three
