"""Delaunay triangles without chance: where points lie on one circle, all ways to part them have the same share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay

from . import polygons

SAME = 1e-8  # four points are on one circle if the sine of two opposite angles together is less
FLAT = 1e-9  # of the mean area: Qhull may add slivers along a straight edge


def triangles(X: np.ndarray, wanted: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Delaunay triangles (k, 3) int of the points X (n, 2), those that are wanted, and the share (k,) of each.

    Points on one circle are the corners of a polygon; each fan of diagonals from one of its corners has the same share:
    of four points, either diagonal has half.  Sums over triangles times shares so have the symmetries of the points,
    and are the same where rounding or a turn would choose other diagonals.

    `wanted` : which (k,) bool of triangles (k, 3).
    """
    mesh = Delaunay(X)
    tri, beside = mesh.simplices, mesh.neighbors
    size = areas(X, tri)
    whole = size > FLAT * size.mean()
    keep = whole.copy()
    keep[whole] = wanted(tri[whole])
    polygon, count = _polygons(X, tri, beside, whole)
    alone = count[polygon] == 1
    found, share = [tri[keep & alone]], [np.ones((keep & alone).sum())]
    kept = np.bincount(polygon, keep) > 0
    for n in np.unique(count[kept & (count > 1)]):
        of = np.flatnonzero((kept & (count == n))[polygon])
        fans = _fans(X, tri[of[np.argsort(polygon[of], kind="stable")]].reshape(-1, 3 * n))
        fans = fans[wanted(fans)]
        found.append(fans)
        share.append(np.full(len(fans), 1.0 / (n + 2)))
    return np.concatenate(found), np.concatenate(share)


def areas(X: np.ndarray, tri: np.ndarray) -> np.ndarray:
    """Areas (k,) of triangles (k, 3) int of the points X (n, 2)."""
    return 0.5 * np.abs(polygons.cross(X[tri[:, 1]] - X[tri[:, 0]], X[tri[:, 2]] - X[tri[:, 0]]))


def _polygons(X: np.ndarray, tri: np.ndarray, beside: np.ndarray, whole: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The polygon that each triangle is of (k,) int, and how many triangles each polygon has."""
    one, corner = np.nonzero((beside > np.arange(len(tri))[:, None]) & (whole[:, None] & whole[beside]))
    other, a = beside[one, corner], tri[one, corner]
    p, q = tri[one[:, None], (corner[:, None] + [1, 2]) % 3].T
    b = tri[other].sum(axis=1) - p - q
    (u, v), (s, t) = ((X[p] - X[x], X[q] - X[x]) for x in (a, b))
    sine = [np.abs(polygons.cross(*sides)) for sides in ((u, v), (s, t))]
    cosine = [(x * y).sum(axis=1) for x, y in ((u, v), (s, t))]
    lengths = np.sqrt(np.prod([(x**2).sum(axis=1) for x in (u, v, s, t)], axis=0))
    same = np.abs(sine[0] * cosine[1] + cosine[0] * sine[1]) < SAME * lengths
    links = coo_array((np.ones(same.sum()), (one[same], other[same])), shape=(len(tri), len(tri)))
    polygon = connected_components(links, directed=False)[1]
    return polygon, np.bincount(polygon)


def _fans(X: np.ndarray, tri: np.ndarray) -> np.ndarray:
    """All triangles (k, 3) of all fans of convex polygons (c, corners of their triangles)."""
    tri = np.sort(tri, axis=1)
    fresh = np.diff(tri, axis=1, prepend=-1) > 0
    n = tri.shape[1] // 3 + 2
    corners = tri[fresh].reshape(-1, n)
    x, y = (X[corners] - X[corners].mean(axis=1, keepdims=True)).transpose(2, 0, 1)
    corners = np.take_along_axis(corners, np.argsort(np.arctan2(y, x), axis=1), axis=1)
    apex, step = np.repeat(np.arange(n), n - 2), np.tile(np.arange(1, n - 1), n)
    return corners[:, np.stack([apex, (apex + step) % n, (apex + step + 1) % n], axis=1)].reshape(-1, 3)
