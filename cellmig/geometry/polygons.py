"""Polygons and outlines.

A polygon is the array of its corners (k, 2) [µm], closed, and counterclockwise unless stated otherwise.
An outline is a polygon, or the edges (k, 2 ends, 2) [µm] of several loops: the outer one, and its holes clockwise.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

STRAIGHT = 1e-4  # turn of an edge [rad] that is none
TINY = 1e-9  # lengths below this fraction of the size of an outline are rounding errors


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Out-of-plane component (...) of the products a × b of vectors a, b (..., 2) [unit of a · unit of b]."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def edges(outline: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and second ends (k, 2) [µm] of the edges of an `outline` (k, 2) or (k, 2 ends, 2)."""
    return (outline, np.roll(outline, -1, axis=0)) if outline.ndim == 2 else (outline[:, 0], outline[:, 1])


def joined(loops: list[np.ndarray]) -> np.ndarray:
    """Several closed `loops`, (k, 2) [µm] each, as one outline (k, 2) or (k, 2 ends, 2) [µm]."""
    return loops[0] if len(loops) == 1 else np.concatenate([np.stack(edges(loop), axis=1) for loop in loops])


def circle(n: int) -> np.ndarray:
    """Evenly spaced points (n, 2) [-] of the unit circle, counterclockwise from the lowest one.

    Extended precision is rounded to a grid: left and right are mirror images, and every processor gives the same bits.
    """
    turn = 8.0 * np.arctan(np.longdouble(1.0)) * np.arange(n) / n
    return snapped(np.column_stack([np.sin(turn), -np.cos(turn)]), 50)


def snapped(X: np.ndarray, bits: int = 48) -> np.ndarray:
    """Points X (n, 2) [µm] rounded to a grid of 2^-bits of their size, so that no library's last bits matter."""
    grid = 2.0 ** float(np.frexp(1.1 * float(np.abs(X).max()))[1] - bits)
    return (np.rint(X / grid) * grid).astype(float)


def turn(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Angles (k,) [rad] from the directions `before` (k, 2) to those `after` (k, 2), positive to the left."""
    return np.arctan2(cross(before, after), (before * after).sum(axis=1))


def convex(polygon: np.ndarray) -> bool:
    """Whether a counterclockwise `polygon` (k, 2) [µm] nowhere turns right by more than STRAIGHT."""
    start, end = edges(polygon)
    return bool((turn(end - start, np.roll(end - start, -1, axis=0)) > -STRAIGHT).all())


def first_corner(polygon: np.ndarray) -> int:
    """Index of the leftmost of the lowest corners of a `polygon` (k, 2) [µm]: the same wherever its list begins."""
    x, y = polygon.T
    low = np.flatnonzero(y <= y.min() + 1e-9 * np.ptp(polygon, axis=0).max())
    return int(low[np.argmin(x[low])])


def counterclockwise(polygon: np.ndarray) -> np.ndarray:
    """Counterclockwise order (k,) int of the corners of a `polygon` (k, 2) [µm] of any sense, from `first_corner`."""
    k = np.arange(len(polygon))
    k = k if area(polygon) > 0.0 else k[::-1]
    return np.roll(k, -first_corner(polygon[k]))


def distinct(polygon: np.ndarray) -> np.ndarray:
    """Indices (m,) int of the corners of a `polygon` (k, 2) [µm] that bound its area.

    Left out are corners that coincide with the next one but for rounding, as the closing point of a curve does, and
    tips of no width, in which the polygon turns back along itself.
    """
    left = np.arange(len(polygon))
    tiny = TINY * np.ptp(polygon, axis=0).max() if len(polygon) else 0.0
    while True:
        p = polygon[left]
        before, after = p - np.roll(p, 1, axis=0), np.roll(p, -1, axis=0) - p
        size, other = np.linalg.norm(after, axis=1), np.linalg.norm(before, axis=1)
        same = size <= tiny
        tip = (np.abs(cross(before, after)) <= tiny * np.minimum(size, other)) & ((before * after).sum(axis=1) < 0.0)
        if not (same | tip).any():
            return left
        left = left[~(same if same.any() else tip)]


def simplified(polygon: np.ndarray) -> np.ndarray:
    """Corners (m, 2) [µm] that bound the area of a `polygon` (k, 2) [µm] of any sense, counterclockwise."""
    p = polygon[distinct(polygon)]
    return p[counterclockwise(p)] if len(p) else p


def area(outline: np.ndarray) -> float:
    """Area [µm²] of an `outline` (k, 2) or (k, 2 ends, 2), negative if it runs clockwise."""
    return 0.5 * float(cross(*edges(outline)).sum())


def is_flat(polygon: np.ndarray) -> bool:
    """Whether the area of a `polygon` (k, 2) [µm] vanishes compared with its extent squared."""
    return not abs(area(polygon)) > 1e-6 * np.ptp(polygon, axis=0).max() ** 2


def sides(outline: np.ndarray) -> np.ndarray:
    """Lengths (k,) [µm] of the edges of an `outline` (k, 2) or (k, 2 ends, 2)."""
    p, q = edges(outline)
    return np.linalg.norm(q - p, axis=1)


def centroid(outline: np.ndarray) -> np.ndarray:
    """Centre of area (2,) [µm] of an `outline` (k, 2) or (k, 2 ends, 2)."""
    p, q = edges(outline)
    origin = p[0]  # far from zero, differences of large products would lose digits
    p, q = p - origin, q - origin
    c = cross(p, q)
    return origin + (c[:, None] * (p + q)).sum(axis=0) / (3.0 * c.sum())


def is_convex(outline: np.ndarray) -> bool:
    """Whether an `outline` (k, 2) or (k, 2 ends, 2) [µm] is one loop that turns right in no corner."""
    p, q = edges(outline)
    along = q - p
    turns = cross(along, np.roll(along, -1, axis=0)) >= -1e-9 * (along**2).sum(axis=1).max()
    return bool((q == np.roll(p, -1, axis=0)).all() and turns.all())


def inside(points: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """Whether each of the `points` (n, 2) [µm] is inside an `outline` of either sense, (n,) bool.

    Source: the crossings of a ray along +x are counted (even-odd rule; Shimrat 1962).
    """
    within = np.zeros(len(points), bool)
    x, y = points.T
    for p, q in zip(*edges(outline), strict=True):
        if p[1] != q[1]:
            across = (p[1] <= y) != (q[1] <= y)
            within ^= across & (x < p[0] + (y - p[1]) * ((q[0] - p[0]) / (q[1] - p[1])))
    return within


def distance(points: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """Distances (n,) [µm] of the `points` (n, 2) [µm] from an `outline` (k, 2) or (k, 2 ends, 2)."""
    return nearest_edge(points, outline)[0]


def nearest_edge(points: np.ndarray, outline: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances (n,) [µm] of the `points` (n, 2) [µm] from an `outline`, and the first edge (n,) of that distance."""
    least, edge = np.full(len(points), np.inf), np.zeros(len(points), dtype=int)
    for k, (p, q) in enumerate(zip(*edges(outline), strict=True)):
        d, e = points - p, q - p
        along = np.minimum(np.maximum(d @ e / max(float(e @ e), 1e-300), 0.0), 1.0)
        x, y = (d - along[:, None] * e).T
        away = np.sqrt(x * x + y * y)
        edge[away < least] = k
        least = np.minimum(least, away)
    return least, edge


def depth(a: np.ndarray, b: np.ndarray) -> float:
    """Largest depth [µm] of a corner of the polygon a (k, 2) inside the polygon b (m, 2); 0 if none is inside."""
    boxed = ((a > b.min(axis=0)) & (a < b.max(axis=0))).all(axis=1)
    within = a[boxed][inside(a[boxed], b)]
    return float(distance(within, b).max(initial=0.0))


def crossing(polygon: np.ndarray) -> tuple[int, int] | None:
    """First corners of two edges of a `polygon` (k, 2) [µm] that meet but are not adjacent; None if it is simple."""
    found = crossings(polygon).tolist()
    first, second = min(found) if found else (-1, -1)
    return (first, second) if found else None


def crossings(polygon: np.ndarray) -> np.ndarray:
    """First corners (n, 2) int of all pairs of edges of a `polygon` (k, 2) [µm] that meet but are not adjacent."""
    n, p, q = len(polygon), polygon, np.roll(polygon, -1, axis=0)
    longest = np.linalg.norm(q - p, axis=1).max()
    near = cKDTree(0.5 * (p + q)).query_pairs(longest * (1.0 + 1e-9), output_type="ndarray")
    apart = (near[:, 1] - near[:, 0]) % n
    near = near[(apart > 1) & (apart < n - 1)]
    i, j = near.T
    return near[intersect(p[i], q[i], p[j], q[j])]


def overlap_of_edges(a: np.ndarray, b: np.ndarray) -> float:
    """Least distance [µm] of an end of one of two edges that cross, a and b (2, 2) [µm], from the other edge."""
    return float(min(distance(p, q[None]).min() for p, q in ((a, b), (b, a))))


def touch(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether any edges of the outlines a and b, (k, 2) or (k, 2 ends, 2) [µm] each, meet."""
    (p, q), (r, s) = sorted((edges(a), edges(b)), key=lambda ends: len(ends[0]))
    low, high = np.minimum(p, q).min(axis=0), np.maximum(p, q).max(axis=0)
    near = ((np.minimum(r, s) <= high) & (np.maximum(r, s) >= low)).all(axis=1)
    return any(intersect(i, j, r[near], s[near]).any() for i, j in zip(p, q, strict=True))


def intersect(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Whether the segments from a to b and from c to d, (n, 2) [µm] each, share a point, (n,) bool; ends count."""
    sides = [np.sign(s) for s in (cross(b - a, c - a), cross(b - a, d - a), cross(d - c, a - c), cross(d - c, b - c))]
    boxes = (np.maximum(np.minimum(a, b), np.minimum(c, d)) <= np.minimum(np.maximum(a, b), np.maximum(c, d))).all(-1)
    return boxes & (sides[0] * sides[1] <= 0) & (sides[2] * sides[3] <= 0)


def visible(pairs: np.ndarray, X: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """Whether the line between each of the `pairs` stays inside an outline, (n,) bool.

    A line that leaves by less than a tenth of its length, as where the outline is slightly concave, counts as inside.

    Parameters
    ----------
    pairs : (n, 2) int -- indices of points.
    X : (k, 2) -- positions of the points [µm], which may be ends of edges of the outline.
    outline : (m, 2) or (m, 2 ends, 2) [µm].

    Source: the visibility criterion of Belytschko, Lu & Gu (1994).
    """
    a, b = X[pairs[:, 0]], X[pairs[:, 1]]
    p, q = edges(outline)
    length = np.linalg.norm(b - a, axis=1)
    middle = 0.5 * (a + b)
    reach = 0.5 * (length.max() + np.linalg.norm(q - p, axis=1).max())
    near = cKDTree(middle).sparse_distance_matrix(cKDTree(0.5 * (p + q)), reach, output_type="coo_matrix")
    i, j = near.row, near.col
    s, t = cross(b[i] - a[i], p[j] - a[i]), cross(b[i] - a[i], q[j] - a[i])
    u, w = cross(q[j] - p[j], a[i] - p[j]), cross(q[j] - p[j], b[i] - p[j])
    tiny = 1e-9 * length[i] * length.max()
    through = (s * t < 0) & (u * w < 0) & (np.minimum.reduce([abs(s), abs(t), abs(u), abs(w)]) > tiny)
    sees = np.ones(len(pairs), bool)
    sees[i[through]] = False
    check = np.unique(i[sees[i]])  # lines between two points of the outline may be outside all along
    out = check[~inside(middle[check], outline)]
    sees[out[distance(middle[out], outline) > 0.1 * length[out]]] = False
    return sees


def clusters(pairs: np.ndarray, n: int) -> np.ndarray:
    """Number, from 0, of the connected component of each of n points (n,) int that `pairs` (m, 2) int link."""
    links = coo_array((np.ones(len(pairs)), pairs.T), shape=(n, n))
    return connected_components(links, directed=False)[1]
