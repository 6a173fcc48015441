"""Makes a closed surface of triangles in any order and sense, or says which triangle prevents it."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from .surfaces import ClosedSurface
from .triangles import area_vectors, cross, dot, edges_of, lengths, ranks, volume

TINY = 1e-9  # lengths below this fraction of the size of a surface are rounding errors
BLOCK = 2_000_000  # pairs that are looked at together


def closed(vertices: np.ndarray, triangles: np.ndarray, part: np.ndarray | None = None) -> ClosedSurface:
    """The closed surface of one piece that triangles form, oriented outward, the same in any order of the list.

    Parameters
    ----------
    vertices : (k, 3) -- positions [µm]; those that coincide, as in files that list each triangle by itself, are one.
    triangles : (m, 3) int -- vertices of each triangle, in any sense.
    part : (m,) int -- number of the part to which each triangle belongs; None if there is one only.

    Raises ValueError for triangles that bound no volume; the message, for the user, counts them from 1.
    """
    vertices, triangles = np.asarray(vertices, float), np.asarray(triangles, int)
    if triangles.ndim != 2 or triangles.shape[1:] != (3,) or vertices.ndim != 2 or vertices.shape[1:] != (3,):
        raise ValueError("a surface has vertices of three coordinates and triangles of three vertices")
    _refuse(((triangles < 0) | (triangles >= len(vertices))).any(axis=1), "has a vertex that is not there")
    _refuse(~np.isfinite(vertices[triangles]).all(axis=(1, 2)), "has a coordinate that is no number")
    if len(triangles) < 4:
        raise ValueError("a closed surface has at least four triangles")
    vertices, triangles = _welded(vertices, triangles)
    a, b, c = triangles.T
    longest = lengths(vertices[triangles] - vertices[np.roll(triangles, 1, axis=1)]).max(axis=1)
    flat = lengths(area_vectors(vertices[triangles])) <= TINY * longest * np.ptp(vertices, axis=0).max()
    _refuse((a == b) | (b == c) | (c == a) | flat, "has no area")
    triangles = _oriented(vertices, triangles)
    _refuse_pinched(vertices, triangles)
    if volume(vertices, triangles) < 0.0:
        triangles = triangles[:, ::-1]
    first = triangles.argmin(axis=1)
    triangles = np.take_along_axis(triangles, (first[:, None] + np.arange(3)) % 3, axis=1)
    if (pair := _crossing(vertices[triangles], triangles)) is not None:
        raise ValueError(f"triangles {pair[0] + 1} and {pair[1] + 1} cross each other")
    order = np.lexsort(triangles.T)
    part = np.zeros(len(triangles), int) if part is None else np.asarray(part, int)
    return ClosedSurface(vertices, triangles[order], part[order])


def _refuse(wrong: np.ndarray, what: str) -> None:
    """Raise ValueError for the first triangle that is `wrong` (m,) bool."""
    if wrong.any():
        raise ValueError(f"triangle {int(np.flatnonzero(wrong)[0]) + 1} {what}")


def _welded(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices that triangles have, sorted by place, those that coincide but for rounding being one."""
    used, flat = np.unique(triangles, return_inverse=True)
    p = vertices[used]
    tree = cKDTree(p)
    pairs = tree.query_pairs(TINY * max(np.ptp(p, axis=0).max(), 1e-300), output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(p), len(p)))
    group = connected_components(links, directed=False)[1]
    first = np.unique(group, return_index=True)[1]
    order = np.lexsort(p[first].T)
    place = np.empty(len(order), int)
    place[order] = np.arange(len(order))
    return p[first[order]], place[group[flat]].reshape(-1, 3)


def _oriented(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The triangles (m, 3) int of a closed surface with one sense for all; raises ValueError if there is none."""
    edges, edge = edges_of(triangles)
    count = np.bincount(edge.ravel())[edge]
    for wrong, what in ((count == 1, "has no neighbour at its edge"), (count > 2, "shares with more than one other "
                                                                       "triangle its edge")):
        if wrong.any():
            t, k = np.argwhere(wrong)[0]
            ends = ("({:.4g}, {:.4g}, {:.4g}) um".format(*vertices[v]) for v in edges[edge[t, k]])
            raise ValueError(f"triangle {t + 1} {what} from {' to '.join(ends)}")
    m, order = len(triangles), np.argsort(edge.ravel(), kind="stable")
    (s, i), (t, j) = np.divmod(order[0::2], 3), np.divmod(order[1::2], 3)
    same = (triangles[s, i] == triangles[t, j]).astype(int)  # both run along the edge in one sense: one has to turn
    # Each triangle twice, as it is and turned: one of the two connected halves is a consistent choice.
    one, other = np.concatenate([s, s + m]), np.concatenate([t + m * same, t + m * (1 - same)])
    label = connected_components(coo_array((np.ones(len(one)), (one, other)), shape=(2 * m, 2 * m)), directed=False)[1]
    pieces = connected_components(coo_array((np.ones(len(s)), (s, t)), shape=(m, m)), directed=False)[0]
    if pieces > 1:
        raise ValueError(f"the triangles are {pieces} pieces, not one")
    _refuse(label[:m] == label[m:], "has no outside: the surface is one-sided")
    return np.where((label[:m] == label[0])[:, None], triangles, triangles[:, ::-1])


def _refuse_pinched(vertices: np.ndarray, triangles: np.ndarray) -> None:
    """Raise ValueError where the triangles around a vertex are not one fan."""
    edge = edges_of(triangles)[1]
    order = np.argsort(edge.ravel(), kind="stable")
    (s, i), (t, j) = np.divmod(order[0::2], 3), np.divmod(order[1::2], 3)
    one, other = np.concatenate([3 * s + i, 3 * s + (i + 1) % 3]), np.concatenate([3 * t + (j + 1) % 3, 3 * t + j])
    links = coo_array((np.ones(len(one)), (one, other)), shape=(triangles.size, triangles.size))
    fan = connected_components(links, directed=False)[1]
    vertex = triangles.ravel()[np.unique(fan, return_index=True)[1]]
    twice = np.flatnonzero(np.bincount(vertex, minlength=len(vertices)) > 1)
    if len(twice):
        raise ValueError("triangle {} touches others in a vertex only, at ({:.4g}, {:.4g}, {:.4g}) um".format(
            int(np.flatnonzero((triangles == twice[0]).any(axis=1))[0]) + 1, *vertices[twice[0]]))


def _crossing(corners: np.ndarray, triangles: np.ndarray) -> tuple[int, int] | None:
    """Two triangles without a common vertex that cross each other; None if there are none."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    order = np.argsort(low[:, 0], kind="stable")
    until = np.searchsorted(low[order, 0], high[order, 0], side="right") - np.arange(len(order)) - 1
    for block in np.split(np.arange(len(order)), np.flatnonzero(np.diff(np.cumsum(until) // BLOCK)) + 1):
        i = np.repeat(block, until[block])
        j = order[i + 1 + ranks(until[block])]
        i = order[i]
        near = ((low[i, 1:] <= high[j, 1:]) & (low[j, 1:] <= high[i, 1:])).all(axis=1)
        i, j = i[near], j[near]
        apart = ~(triangles[i][:, :, None] == triangles[j][:, None, :]).any(axis=(1, 2))
        i, j = i[apart], j[apart]
        met = _pierced(corners[i], corners[j]) | _pierced(corners[j], corners[i])
        if met.any():
            pairs = np.sort(np.column_stack([i[met], j[met]]), axis=1)
            first, second = min(pairs.tolist())
            return first, second
    return None


def _pierced(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Whether an edge of each of the triangles `one` (n, 3, 3) passes through the triangle `other` (n, 3, 3)."""
    a, b, c = (other[:, k] for k in range(3))
    n = cross(b - a, c - a)
    met = np.zeros(len(one), bool)
    for k in range(3):
        p, q = one[:, k], one[:, (k + 1) % 3]
        s, t = dot(p - a, n), dot(q - a, n)
        sides = np.stack([dot(q - p, cross(u - p, w - p)) for u, w in ((a, b), (b, c), (c, a))], axis=1)
        met |= (s * t < 0.0) & ((sides > 0.0).all(axis=1) | (sides < 0.0).all(axis=1))
    return met
