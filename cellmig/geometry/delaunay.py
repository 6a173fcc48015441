"""Delaunay triangles that are unique: cocircular points, which may be split in several ways, are split in all of them.

Rounding alone decides which triangulation of cocircular points a library returns.  Here, every fan of diagonals from a
corner of their polygon counts, with equal weights, so that results have the symmetries of the points.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial import Delaunay

from . import polygons

COCIRCULAR = 1e-8  # bound on the sine of the sum of two opposite angles of a quadrilateral
FLAT = 1e-9  # bound on an area over the mean one: Qhull may add slivers along a straight edge


def triangles(X: np.ndarray, wanted: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Delaunay triangles of the points X (n, 2) [µm] for which `wanted`, of triangles (k, 3) int, is true (k,) bool.

    Returns
    -------
    tri : (k, 3) int -- corners of the triangles; those of cocircular points overlap.
    weight : (k,) [-] -- of each triangle in a sum: 1, or 1/m for the fans from the m corners of a cocircular polygon.

    Source: derived here, as the mean over the fan triangulations of each cocircular polygon.
    """
    mesh = Delaunay(X)
    tri, beside = mesh.simplices, mesh.neighbors
    size = areas(X, tri)
    whole = size > FLAT * size.mean()
    counts = whole.copy()
    counts[whole] = wanted(tri[whole])
    polygon, count = _polygons(X, tri, beside, whole)
    alone = count[polygon] == 1
    found, weight = [tri[counts & alone]], [np.ones((counts & alone).sum())]
    split = np.bincount(polygon, counts) > 0
    for n in np.unique(count[split & (count > 1)]):
        of = np.flatnonzero((split & (count == n))[polygon])
        fans = _fans(X, tri[of[np.argsort(polygon[of], kind="stable")]].reshape(-1, 3 * n))
        fans = fans[wanted(fans)]
        found.append(fans)
        weight.append(np.full(len(fans), 1.0 / (n + 2)))
    return np.concatenate(found), np.concatenate(weight)


def areas(X: np.ndarray, tri: np.ndarray) -> np.ndarray:
    """Areas (k,) [µm²] of the triangles `tri` (k, 3) int of the points X (n, 2) [µm]."""
    return 0.5 * np.abs(polygons.cross(X[tri[:, 1]] - X[tri[:, 0]], X[tri[:, 2]] - X[tri[:, 0]]))


def _polygons(X: np.ndarray, tri: np.ndarray, beside: np.ndarray, whole: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Number of the cocircular polygon of each triangle (k,) int, and the number of triangles of each polygon."""
    one, corner = np.nonzero((beside > np.arange(len(tri))[:, None]) & (whole[:, None] & whole[beside]))
    other, a = beside[one, corner], tri[one, corner]
    p, q = tri[one[:, None], (corner[:, None] + [1, 2]) % 3].T
    b = tri[other].sum(axis=1) - p - q
    (u, v), (s, t) = ((X[p] - X[x], X[q] - X[x]) for x in (a, b))
    sine = [np.abs(polygons.cross(*sides)) for sides in ((u, v), (s, t))]
    cosine = [(x * y).sum(axis=1) for x, y in ((u, v), (s, t))]
    lengths = np.sqrt(np.prod([(x**2).sum(axis=1) for x in (u, v, s, t)], axis=0))
    same = np.abs(sine[0] * cosine[1] + cosine[0] * sine[1]) < COCIRCULAR * lengths
    polygon = polygons.clusters(np.column_stack([one, other])[same], len(tri))
    return polygon, np.bincount(polygon)


def _fans(X: np.ndarray, tri: np.ndarray) -> np.ndarray:
    """All triangles (k, 3) of all fans of convex polygons, given by the corners of some triangles of each (c, 3 n)."""
    tri = np.sort(tri, axis=1)
    fresh = np.diff(tri, axis=1, prepend=-1) > 0
    n = tri.shape[1] // 3 + 2
    corners = tri[fresh].reshape(-1, n)
    x, y = (X[corners] - X[corners].mean(axis=1, keepdims=True)).transpose(2, 0, 1)
    corners = np.take_along_axis(corners, np.argsort(np.arctan2(y, x), axis=1), axis=1)
    apex, step = np.repeat(np.arange(n), n - 2), np.tile(np.arange(1, n - 1), n)
    return corners[:, np.stack([apex, (apex + step) % n, (apex + step + 1) % n], axis=1)].reshape(-1, 3)
