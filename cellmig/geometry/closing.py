"""Makes a closed surface of triangles in any order and sense, or says which triangles prevent it, and where."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from .surfaces import ClosedSurface
from .triangles import area_vectors, cross, dot, edges_of, lengths, unit

TINY = 1e-9  # lengths below this fraction of the size of a surface are rounding errors


def counted(triangle: int) -> str:
    """Text for a triangle, given by its index, in a message: "triangle 1" for the first."""
    return f"triangle {triangle + 1}"


def closed(vertices: np.ndarray, triangles: np.ndarray, part: np.ndarray | None = None,
           name: Callable[[int], str] = counted) -> ClosedSurface:
    """The closed surface of one piece that triangles form, oriented outward, the same in any order of the list.

    Parameters
    ----------
    vertices : (k, 3) -- positions [µm]; those that coincide, as in files that list each triangle by itself, are one.
    triangles : (m, 3) int -- vertices of each triangle, in any sense.
    part : (m,) int -- number of the part to which each triangle belongs; None if there is one only.
    name : function -- text for a triangle, given by its index, in messages.

    Raises ValueError for triangles that bound no volume; the message is for the user.
    """
    vertices, found, place, piece = _mended(vertices, triangles, name)
    if piece.max() > 0:
        raise ValueError(f"the triangles are {piece.max() + 1} pieces, not one")
    number = np.zeros(len(found), int)
    if part is not None:
        number[place[place >= 0]] = np.asarray(part, int)[place >= 0]
    order = np.lexsort(found.T)
    return ClosedSurface(vertices, found[order], number[order])


def _mended(vertices: np.ndarray, triangles: np.ndarray,
           name: Callable[[int], str] = counted) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Closed pieces that triangles form, each oriented outward, without triangles that are listed twice or are a line.

    Parameters
    ----------
    vertices : (k, 3) -- positions, in any unit; those that coincide are one.
    triangles : (m, 3) int -- vertices of each triangle, in any sense.
    name : function -- text for a triangle, given by its index, in messages.

    Returns
    -------
    vertices : (j, 3) -- sorted by place.
    triangles : (n, 3) int -- counterclockwise when seen from outside the piece, the lowest vertex first.
    place : (m,) int -- where each given triangle is among these; -1 if two of its corners coincide.
    piece : (n,) int -- number of the piece of each.

    Raises ValueError for triangles that bound no volume, with all that is wrong; the message is for the user.
    """
    vertices, triangles = np.asarray(vertices, float), np.asarray(triangles, int)
    if triangles.ndim != 2 or triangles.shape[1:] != (3,) or vertices.ndim != 2 or vertices.shape[1:] != (3,):
        raise ValueError("a surface has vertices of three coordinates and triangles of three vertices")
    _refuse(((triangles < 0) | (triangles >= len(vertices))).any(axis=1), "has a vertex that is not there", name)
    _refuse(~np.isfinite(vertices[triangles]).all(axis=(1, 2)), "has a coordinate that is no number", name)
    if len(triangles) < 4:
        raise ValueError("a closed surface has at least four triangles")
    vertices, triangles = _welded(vertices, triangles)
    one, place = _listed_once(triangles)
    triangles = triangles[one]
    if len(triangles) < 4:
        raise ValueError(f"only {len(triangles)} of its triangles differ and have an area")
    surface = _Checked(vertices, triangles, lambda k: name(int(one[k])))
    wrong = [*surface.flat(), *surface.lone()]
    if not wrong:
        wrong = [*surface.one_sided(), *surface.pinched()]
    wrong += surface.crossing()
    if wrong:
        raise ValueError("; ".join(wrong))
    return vertices, surface.outward(), place, surface.piece


def _refuse(wrong: np.ndarray, what: str, name: Callable[[int], str]) -> None:
    """Raise ValueError for the first triangle that is `wrong` (m,) bool."""
    if wrong.any():
        raise ValueError(f"{name(int(np.flatnonzero(wrong)[0]))} {what}")


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
    return p[first[order]], place[group[flat.reshape(-1)]].reshape(-1, 3)


def _listed_once(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the triangles (m, 3) without those of fewer corners and those listed before; where each is of them."""
    corners = np.sort(triangles, axis=1)
    first, same = np.unique(corners, axis=0, return_index=True, return_inverse=True)[1:]
    whole = (np.diff(corners, axis=1) > 0).all(axis=1)
    one = np.sort(first[whole[first]])
    return one, np.where(whole, np.searchsorted(one, first[same.reshape(-1)]), -1)


class _Checked:
    """Checks of triangles that differ and have three corners each; each check yields messages for the user."""

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, name: Callable[[int], str]):
        self.vertices, self.triangles, self.name = vertices, triangles, name
        self.edges, self.edge = edges_of(triangles)

    def at(self, *points: np.ndarray) -> str:
        """Text for one or more points."""
        return " to ".join("({:.4g}, {:.4g}, {:.4g})".format(*p) for p in points)

    def flat(self) -> list[str]:
        """Triangles whose corners are in a line."""
        corners = self.vertices[self.triangles]
        longest = lengths(corners - np.roll(corners, 1, axis=1)).max(axis=1)
        flat = lengths(area_vectors(corners)) <= TINY * longest * np.ptp(self.vertices, axis=0).max()
        return [f"{self.name(k)} has no area: its corners are in a line, about {self.at(corners[k].mean(axis=0))}"
                + _more(flat.sum() - 1) for k in np.flatnonzero(flat)[:1].tolist()]

    def lone(self) -> list[str]:
        """Edges that are not of two triangles each."""
        count, found = np.bincount(self.edge.ravel()), []
        for wrong, what in ((count == 1, "is not closed: {} has no neighbour at its edge from {}"),
                            (count > 2, "branches: {} shares with more than one other triangle its edge from {}")):
            if wrong.any():
                t, k = np.argwhere(wrong[self.edge])[0]
                ends = self.vertices[self.edges[self.edge[t, k]]]
                found.append("the surface " + what.format(self.name(t), self.at(*ends)) + _more(wrong.sum() - 1))
        return found

    @cached_property
    def beside(self) -> tuple[np.ndarray, ...]:
        """Triangles on both sides of each edge, and which of their edges it is, of a closed surface: s, i, t, j."""
        order = np.argsort(self.edge.ravel(), kind="stable")
        (s, i), (t, j) = np.divmod(order[0::2], 3), np.divmod(order[1::2], 3)
        return s, i, t, j

    @cached_property
    def piece(self) -> np.ndarray:
        """Number of the piece of each triangle (m,) int."""
        s, _, t, _ = self.beside
        return _connected(s, t, len(self.triangles))

    @cached_property
    def half(self) -> np.ndarray:
        """Of each triangle twice, as it is and turned: which half it belongs to (2 m,) int, each a consistent sense."""
        m, (s, i, t, j) = len(self.triangles), self.beside
        same = (self.triangles[s, i] == self.triangles[t, j]).astype(int)  # both run in one sense: one has to turn
        return _connected(np.concatenate([s, s + m]), np.concatenate([t + m * same, t + m * (1 - same)]), 2 * m)

    def one_sided(self) -> list[str]:
        """Pieces without an outside."""
        m = len(self.triangles)
        return [f"{self.name(k)} has no outside: the surface is one-sided"
                for k in np.flatnonzero(self.half[:m] == self.half[m:])[:1].tolist()]

    def pinched(self) -> list[str]:
        """Vertices around which the triangles are not one fan."""
        s, i, t, j = self.beside
        one, other = np.concatenate([3 * s + i, 3 * s + (i + 1) % 3]), np.concatenate([3 * t + (j + 1) % 3, 3 * t + j])
        swapped = self.triangles[s, i] == self.triangles[t, j]
        other = np.where(np.tile(swapped, 2), np.concatenate([3 * t + j, 3 * t + (j + 1) % 3]), other)
        fan = _connected(one, other, self.triangles.size)
        vertex = self.triangles.ravel()[np.unique(fan, return_index=True)[1]]
        twice = np.flatnonzero(np.bincount(vertex, minlength=len(self.vertices)) > 1)
        return [f"{self.name(int(np.flatnonzero((self.triangles == v).any(axis=1))[0]))} touches others in a vertex "
                f"only, at {self.at(self.vertices[v])}" + _more(len(twice) - 1) for v in twice[:1]]

    def crossing(self) -> list[str]:
        """Two triangles that cross each other."""
        pair = crossing(self.vertices[self.triangles], self.triangles)
        if pair is None:
            return []
        one, other = (self.name(k) for k in pair)
        middle = self.vertices[self.triangles[list(pair)]].mean(axis=(0, 1))
        return [f"{one} and {other} cross each other, about {self.at(middle)}"]

    def outward(self) -> np.ndarray:
        """The triangles (m, 3) int, each piece oriented outward, the lowest vertex of each first."""
        half = self.half[:len(self.triangles)]
        turned = half != half[np.unique(self.piece, return_index=True)[1]][self.piece]
        p, q, r = (self.vertices - self.vertices[0])[self.triangles].transpose(1, 0, 2)
        size = np.bincount(self.piece, np.where(turned, -1.0, 1.0) * dot(p, cross(q, r)))
        turned ^= (size < 0.0)[self.piece]
        triangles = np.where(turned[:, None], self.triangles[:, ::-1], self.triangles)
        first = triangles.argmin(axis=1)
        return np.take_along_axis(triangles, (first[:, None] + np.arange(3)) % 3, axis=1)


def _more(number: int) -> str:
    """End of a message about the first of several faults."""
    return f", and {number} more" if number else ""


def _connected(one: np.ndarray, other: np.ndarray, n: int) -> np.ndarray:
    """Number of the group of each of n things (n,) int, of which `one` (k,) int and `other` (k,) int are connected."""
    return connected_components(coo_array((np.ones(len(one)), (one, other)), shape=(n, n)), directed=False)[1]


def crossing(corners: np.ndarray, triangles: np.ndarray) -> tuple[int, int] | None:
    """Two triangles that cross each other, other than at a common edge; None if there are none.

    Parameters
    ----------
    corners : (m, 3, 3) -- places of their corners, in any unit.
    triangles : (m, 3) int -- vertices at these.
    """
    low, high = corners.min(axis=1), corners.max(axis=1)
    depth, found = TINY * (high.max(axis=0) - low.min(axis=0)).max(), []
    for i, j in _close(corners):
        near = ((low[i] <= high[j]) & (low[j] <= high[i])).all(axis=1)
        i, j = i[near], j[near]
        apart = (triangles[i][:, :, None] == triangles[j][:, None, :]).sum(axis=(1, 2)) < 2
        i, j = i[apart], j[apart]
        met = _pierced(corners[i], corners[j], depth) | _pierced(corners[j], corners[i], depth)
        found += np.sort(np.column_stack([i[met], j[met]]), axis=1).tolist()
    return min(((a, b) for a, b in found), default=None)


def _close(corners: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Pairs of triangles, of corners (m, 3, 3), whose spheres meet; those of about one size together."""
    centre = corners.mean(axis=1)
    radius = lengths(corners - centre[:, None]).max(axis=1)
    size = np.frexp(radius)[1]  # within a factor of two
    for one in np.unique(size):
        own, smaller = np.flatnonzero(size == one), np.flatnonzero(size < one)
        tree, most = cKDTree(centre[own]), radius[own].max()
        yield own[tree.query_pairs(2.0 * most, output_type="ndarray").T]
        if len(smaller):
            reach = most + radius[smaller].max()
            pairs = tree.sparse_distance_matrix(cKDTree(centre[smaller]), reach, output_type="ndarray")
            yield own[pairs["i"]], smaller[pairs["j"]]


def _pierced(one: np.ndarray, other: np.ndarray, depth: float) -> np.ndarray:
    """Whether an edge of each of the triangles `one` (n, 3, 3) passes through `other` (n, 3, 3), `depth` or deeper."""
    first, normal = other[:, 0], unit(area_vectors(other))
    height = dot(one - first[:, None], normal[:, None])
    met = np.zeros(len(one), bool)
    for k, m in ((0, 1), (1, 2), (2, 0)):
        s, t = height[:, k], height[:, m]
        through = np.flatnonzero((s * t < 0.0) & (np.minimum(np.abs(s), np.abs(t)) > depth))
        p, q = one[through, k], one[through, m]
        a, b, c = (other[through, n] - p for n in range(3))
        sides = np.stack([dot(q - p, cross(u, w)) for u, w in ((a, b), (b, c), (c, a))], axis=1)
        met[through] |= (sides > 0.0).all(axis=1) | (sides < 0.0).all(axis=1)
    return met
