"""Triangles and tetrahedra between the particles: volumes, edges, and gradients of linear finite elements.

A simplex of D dimensions has D + 1 corners: a triangle or a tetrahedron.  Those of a body fill it without overlap, but
for the triangles of cocircular particles, which overlap and share their weight.
"""

from __future__ import annotations

from itertools import combinations, combinations_with_replacement
from math import factorial

import numpy as np
from scipy import sparse

from ..model.tensors import cofactors, dot

Gradient = tuple[sparse.csr_matrix, ...]  # derivatives by the directions, of one pattern
EXCHANGES, EXCHANGED = 2, 0.7  # how often neighbours exchange mass; share, over their number and one [-]


def shape_gradients(X: np.ndarray, simplices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of the linear shape functions of finite elements.

    Parameters
    ----------
    X : (n, D) -- positions of the particles [µm].
    simplices : (k, D + 1) int -- corners of the simplices.

    Returns
    -------
    slope : (k, D + 1, D) -- gradient of the function of each corner [1/µm].
    volume : (k,) -- of the simplices, negative if their corners run the other way [µm^D].
    """
    D = X.shape[1]
    sides = (X[simplices[:, 1:]] - X[simplices[:, :1]]).transpose(1, 2, 0)
    cofactor = cofactors(tuple(map(tuple, sides)))
    det = dot(sides[0], cofactor[0])
    slope = (np.array(cofactor) / det).transpose(2, 0, 1)
    return np.concatenate([-slope.sum(axis=1, keepdims=True), slope], axis=1), det / factorial(D)


def nodal_volumes(n: int, simplices: np.ndarray, volume: np.ndarray) -> np.ndarray:
    """Volumes of the median dual cells of n particles (n,) [µm^D]: an equal part of each simplex for each corner.

    simplices : (k, D + 1) int -- corners;  volume : (k,) -- times the weight of each simplex [µm^D].
    """
    corners = simplices.shape[1]
    return np.bincount(simplices.ravel(), np.repeat(volume / corners, corners), n)


def by_area(X: np.ndarray, V: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Volumes (n,) [µm³] whose mass the particles carry: those on the surface share theirs by their areas.

    Dual cells at the surface differ by a factor of six, with the tetrahedra that end there; the lightest particles
    limit the step, and where along the surface a mass is matters little.

    X : (n, 3) -- positions [µm];  V : (n,) -- volumes of the dual cells [µm³];  triangles : (m, 3) int -- the surface.

    Source: derived here; steps of sound and of viscosity are 17 and 20 % larger in a ball of 4,000 particles.
    """
    a, b, c = (X[corner] for corner in triangles.T)
    area = nodal_volumes(len(V), triangles, 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))
    on = area > 0.0
    return np.where(on, area * (V[on].sum() / area.sum()), V)


def exchanged(V: np.ndarray, density: np.ndarray, X: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Masses (n,) [fg] after neighbours of the same density have exchanged a share of what one has more than the other.

    Particles of the surface are the lightest, and limit the step.  Momentum, moment and kinetic energy of any velocity
    that is linear in X stay as they were, of what has the same density: see `_exchanged`.

    V : (n,) -- volumes [µm^D];  density : (n,) [kg/m³];  X : (n, D) -- positions [µm];  edges : (m, 2) int --
    neighbours.
    """
    mass = density * V
    for one in np.unique(density):
        alike = density == one
        number = np.cumsum(alike) - 1
        within = edges[alike[edges].all(axis=1)]
        if len(within):
            mass[alike] = _exchanged(mass[alike], X[alike], number[within])
    return mass


def _exchanged(mass: np.ndarray, X: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Masses (n,) [fg] of particles at X (n, D) [µm] after exchange along `edges` (m, 2) int.

    They are multiplied by a quadratic polynomial near 1 in the end; those of few particles, of which it would take more
    than half from the lightest, are left as they were.

    Source: derived here, diffusion along the edges; what it gains and costs is in docs/stability.md.
    """
    I, J = edges.T
    count = np.bincount(edges.ravel(), minlength=len(mass))
    share, after = EXCHANGED / (np.maximum(count[I], count[J]) + 1.0), mass
    for _ in range(EXCHANGES):
        flow = share * (after[I] - after[J])
        after = after - np.bincount(I, flow, len(mass)) + np.bincount(J, flow, len(mass))
    x = (X - X.mean(axis=0)) / np.abs(X - X.mean(axis=0)).max()
    pairs = combinations_with_replacement(range(X.shape[1]), 2)
    moments = np.column_stack([np.ones(len(x)), x, *(x[:, i] * x[:, j] for i, j in pairs)])
    gram, missing = moments.T @ (after[:, None] * moments), moments.T @ (mass - after)
    after = after * (1.0 + moments @ np.linalg.lstsq(gram, missing, rcond=1e-10)[0])  # two columns have no own x²
    return after if after.min() > 0.5 * mass.min() else mass


def edges_of(simplices: np.ndarray) -> np.ndarray:
    """Edges (m, 2) int of `simplices` (k, D + 1) int, each once, lower index first, in order."""
    edges = np.concatenate([simplices[:, pair] for pair in combinations(range(simplices.shape[1]), 2)])
    return np.unique(np.sort(edges, axis=1), axis=0)


def averaged(X: np.ndarray, simplices: np.ndarray, weight: np.ndarray) -> Gradient:
    r"""Gradients of linear finite elements, averaged at the particles: V_I G_IJ = Σ_T V_T ∂N_J/(D + 1).

    This is no meshfree gradient, but that of smoothed finite elements, constant on the median dual cells.  Nodal
    integration with it obeys the divergence theorem Σ_I V_I G_IJ = ∮ n N_J dA, and linear fields are exact.  Neighbours
    are the particles of one simplex.

    Parameters
    ----------
    X : (n, D) -- positions [µm].
    simplices : (k, D + 1) int -- corners of the simplices.
    weight : (k,) -- of each simplex in sums [-].

    Returns
    -------
    (n, n) CSR [1/µm] for each direction, of one symmetric pattern -- rows sum to zero.

    Source: Dohrmann, Heinstein, Jung, Key & Witkowski (2000).
    """
    n, corners = len(X), simplices.shape[1]
    slope, volume = shape_gradients(X, simplices)
    volume = weight * np.abs(volume)
    I, J = np.repeat(simplices, corners, axis=1), np.tile(simplices, corners)
    V = nodal_volumes(n, simplices, volume)
    G = []
    for part in np.moveaxis(slope, 2, 0):
        values = np.tile((volume / corners)[:, None] * part, corners)
        matrix = sparse.csr_matrix((values.ravel(), (I.ravel(), J.ravel())), (n, n))
        matrix.data /= np.repeat(V, np.diff(matrix.indptr))
        G.append(matrix)
    return zero_row_sums(np.column_stack([g.data for g in G]), G[0].indices, G[0].indptr)


def zero_row_sums(entries: np.ndarray, indices: np.ndarray, indptr: np.ndarray) -> Gradient:
    """Matrices (n, n) CSR of `entries` (e, D) of any unit, with a diagonal that makes their rows sum to zero.

    indices : (e,) int -- columns of the entries;  indptr : (n + 1,) int -- first entry of each row.
    """
    n, G = len(indptr) - 1, []
    for part in entries.T:
        matrix = sparse.csr_matrix((np.ascontiguousarray(part), indices, indptr), (n, n))
        matrix.setdiag(matrix.diagonal() - np.asarray(matrix.sum(axis=1)).ravel())
        G.append(matrix)
    return tuple(G)


def facet_sizes(x: np.ndarray) -> np.ndarray:
    """Lengths [µm] or areas [µm²] (m,) of segments or triangles with the corners x (m, D, D) [µm]."""
    if x.shape[1] == 2:
        return np.linalg.norm(x[:, 1] - x[:, 0], axis=1)
    normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    return 0.5 * np.linalg.norm(normal, axis=1)


def volumes_below(x: np.ndarray) -> np.ndarray:
    """Volumes [µm^D] (m,) between the origin and facets with the corners x (m, D, D) [µm], whose sum is that inside."""
    if x.shape[1] == 2:
        return 0.5 * (x[:, 0, 0] * x[:, 1, 1] - x[:, 1, 0] * x[:, 0, 1])
    return (x[:, 0] * np.cross(x[:, 1], x[:, 2])).sum(axis=1) / 6.0


def share_below(gaps: np.ndarray, height: float) -> np.ndarray:
    """Share of each facet below a `height` [µm], with gaps (f, d) [µm] of its corners between which it is flat [-]."""
    below, above = np.maximum(height - gaps, 0.0), np.maximum(gaps - height, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        if gaps.shape[1] == 2:
            part = below.sum(axis=1) / (below.sum(axis=1) + above.sum(axis=1))
        else:  # the corner alone on its side cuts off a similar triangle
            under = (gaps < height).sum(axis=1)
            lone = np.where(under == 1, gaps.min(axis=1), gaps.max(axis=1))
            others = np.sort(gaps, axis=1)
            others = np.where((under == 1)[:, None], others[:, 1:], others[:, :2])
            corner = ((height - lone)[:, None] / (others - lone[:, None])).prod(axis=1)
            part = np.choose(under, [np.zeros(len(gaps)), corner, 1.0 - corner, np.ones(len(gaps))])
    return np.where(np.isfinite(gaps).all(axis=1), np.nan_to_num(part), 0.0)


def surface_normals(X: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Integrals ∮ n N_J dA (n, D) [µm^(D-1)] of the outward normal times functions that are linear on each facet.

    X : (n, D) -- positions [µm];  facets : (m, D) int -- segments of a closed surface in the plane, counterclockwise,
    or triangles in space, counterclockwise from outside.
    """
    if X.shape[1] == 2:
        along = X[facets[:, 1]] - X[facets[:, 0]]
        share = 0.5 * np.column_stack([along[:, 1], -along[:, 0]])
    else:
        a, b, c = (X[corner] for corner in facets.T)
        share = np.cross(b - a, c - a) / 6.0
    total = np.zeros_like(X)
    for corner in facets.T:
        np.add.at(total, corner, share)
    return total
