"""Triangles in space: vectors, areas, edges, the closest points on them, and the volume that closed ones bound."""

from __future__ import annotations

import numpy as np


def volume(X: np.ndarray, triangles: np.ndarray) -> float:
    """Volume [µm³] inside the closed `triangles` (m, 3) int of the points X (n, 3) [µm].

    Source: the divergence theorem.
    """
    p = X[triangles] - X[triangles[0, 0]]
    return float(dot(p[:, 0], cross(p[:, 1], p[:, 2])).sum() / 6.0)


def area_vectors(corners: np.ndarray) -> np.ndarray:
    """Areas times normals (m, 3) [µm²] of triangles with these `corners` (m, 3, 3) [µm]."""
    return 0.5 * cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Products a × b of vectors a, b (..., 3) [unit of a · unit of b]; three times as fast as NumPy's."""
    (a0, a1, a2), (b0, b1, b2) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Products a · b (...) of vectors a, b (..., 3) [unit of a · unit of b]."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def lengths(a: np.ndarray) -> np.ndarray:
    """Lengths (...) of vectors a (..., 3) [unit of a]."""
    return np.sqrt(dot(a, a))


def unit(a: np.ndarray) -> np.ndarray:
    """Vectors a (..., 3), of any unit, divided by their lengths [-]."""
    return a / np.maximum(lengths(a), 1e-300)[..., None]


def ranks(sizes: np.ndarray) -> np.ndarray:
    """For groups of these `sizes` (k,) int in a row, the number of each member in its group (n,) int."""
    return np.arange(sizes.sum()) - np.repeat(np.cumsum(sizes) - sizes, sizes)


def edges_of(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges of `triangles` (m, 3) int.

    Returns
    -------
    edges : (k, 2) int -- both ends of each edge, the lower number first.
    edge : (m, 3) int -- number of the edge from each corner of a triangle to the next one.
    """
    ends = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    key, edge = np.unique(ends[:, 0] * (ends.max() + 1) + ends[:, 1], return_inverse=True)
    return np.column_stack(np.divmod(key, ends.max() + 1)), edge.reshape(-1, 3)


def on_triangles(p: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Closest points (..., 3) [µm] to the points p (..., 3) [µm] on triangles with these `corners` (..., 3, 3) [µm].

    Source: the projection along the normal where that is in the triangle, else the closest one on an edge.
    """
    a, b, c = (corners[..., k, :] for k in range(3))
    n = cross(b - a, c - a)
    square = np.maximum(dot(n, n), 1e-300)
    v, w = dot(cross(p - a, c - a), n) / square, dot(cross(b - a, p - a), n) / square
    best = a + v[..., None] * (b - a) + w[..., None] * (c - a)
    least = np.where((v >= 0.0) & (w >= 0.0) & (v + w <= 1.0), 0.0, np.inf)
    for s, e in ((a, b), (b, c), (c, a)):
        along = e - s
        share = dot(p - s, along) / np.maximum(dot(along, along), 1e-300)
        t = np.clip(share, 0.0, 1.0)
        q = s + t[..., None] * (e - s)
        away = dot(q - p, q - p)
        closer = away < least
        best, least = np.where(closer[..., None], q, best), np.where(closer, away, least)
    return best


def shares(p: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Shares (n, 3) [-] of the `corners` (n, 3, 3) [µm] of triangles at points p (n, 3) [µm] on these."""
    a, b, c = (corners[:, k] for k in range(3))
    n = cross(b - a, c - a)
    square = np.maximum(dot(n, n), 1e-300)
    v, w = dot(cross(p - a, c - a), n) / square, dot(cross(b - a, p - a), n) / square
    found = np.maximum(np.column_stack([1.0 - v - w, v, w]), 0.0)
    return found / found.sum(axis=1, keepdims=True)
