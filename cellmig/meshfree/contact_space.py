"""The search for triangles of surfaces that are near faces, edges and vertices of the surface of another cell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from ..geometry.surfaces import ClosedSurface
from ..geometry.triangles import area_vectors, dot, lengths, on_triangles
from .contact import NodeLists, Surfaces
from .scene import Scene, joined


@dataclass(frozen=True)
class Features:
    """Faces, edges and vertices of all surfaces in space, by indices of `Surfaces`.

    Attributes
    ----------
    faces : (f, 3) int -- corners, as the facets.
    edges : (e, 4) int -- both ends, and the third corners of the faces on the left and on the right.
    edges_of : (f, 3) int -- edges of the faces.
    first_ring : (m + 1,) int -- where the neighbours of each vertex begin in `ring`.
    ring : (…,) int -- these, in positive order as seen from outside.
    """

    faces: np.ndarray
    edges: np.ndarray
    edges_of: np.ndarray
    first_ring: np.ndarray
    ring: np.ndarray

    @classmethod
    def of(cls, scene: Scene, surfaces: Surfaces) -> Features:
        """Features of the `surfaces` of a scene; those of copies are found once."""
        cells = np.unique(surfaces.cell)
        kinds, of = np.unique(scene.kind[cells], return_inverse=True)
        solids = [scene.templates[k].polyhedron for k in kinds]
        sizes = [np.array([len(ring) for ring in p.rings]) for p in solids]
        start = np.searchsorted(surfaces.cell, cells)
        first = np.cumsum([len(solids[k].edges) for k in of]) - [len(solids[k].edges) for k in of]
        edges = joined((a + solids[k].edges for a, k in zip(start, of, strict=True)), (0, 4))
        edges_of = joined((a + solids[k].sides for a, k in zip(first, of, strict=True)), (0, 3))
        ring = joined(a + np.concatenate(solids[k].rings) for a, k in zip(start, of, strict=True))
        return cls(surfaces.facets, edges, edges_of, np.append(0, np.cumsum(joined(sizes[k] for k in of))), ring)

    def rings(self, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the neighbours of `vertices` (k,) int begin (k + 1,) int, and these (…,) int."""
        count = self.first_ring[vertices + 1] - self.first_ring[vertices]
        first = np.append(0, np.cumsum(count))
        at = np.arange(first[-1]) - np.repeat(first[:-1] - self.first_ring[vertices], count)
        return first, self.ring[at]


KINDS = ("face", "edge", "vertex")
TURNED = 0.5  # cosine of the least angle between the normals of triangles of a fold [-]
Pairs = dict[str, np.ndarray]  # by kind of feature, triangles and features (p, 2) int, sorted


def triangle_pairs(surfaces: Surfaces, features: Features, x: np.ndarray, farthest: float,
                   within: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Pairs:
    """Pairs of a triangle and a feature of another cell that may be near each other, by their bounding spheres; of the
    same cell where that can meet itself, if they face each other across its outside.

    Parameters
    ----------
    x : (m, 3) -- positions of the surface particles [µm].
    farthest : float -- largest distance of a pair [µm].
    within : function -- of two cells (k,) int each, distance up to which they are near (k,) [µm], < 0 if they never
        are.
    """
    on = np.flatnonzero(surfaces.outer)
    middle = x[surfaces.facets[on]].mean(axis=1)
    radius = lengths(x[surfaces.facets[on]] - middle[:, None]).max(axis=1, initial=0.0)
    reach = (farthest + 2.0 * radius.max(initial=0.0)) * (1.0 + 1e-9)
    cell = surfaces.cell[surfaces.facets[on, 0]]
    itself = within(cell, cell) >= 0.0
    some = near_boxes(middle, cell, reach) | itself
    on, middle, radius, cell = on[some], middle[some], radius[some], cell[some]
    i, j = cKDTree(middle).query_pairs(reach, output_type="ndarray").T
    if not itself.any():
        other = cell[i] != cell[j]
        i, j = i[other], j[other]
    most = within(cell[i], cell[j])
    near = (most >= 0.0) & (lengths(middle[i] - middle[j]) <= most + radius[i] + radius[j])
    own = np.flatnonzero(near & (cell[i] == cell[j]))
    near[own] = face_outside(surfaces, x, on[i[own]], on[j[own]])
    i, j, most = np.append(i[near], j[near]), np.append(j[near], i[near]), np.tile(most[near], 2)
    limit = np.zeros(len(on))
    order = np.argsort(i, kind="stable")
    first = np.flatnonzero(np.diff(i[order], prepend=-1))
    limit[i[order][first]] = np.maximum.reduceat(most[order], first) if len(first) else 0.0
    faces = sparse.csr_array((np.ones(len(i), np.int8), (on[i], on[j])), (len(surfaces.facets),) * 2)
    number = np.zeros(len(surfaces.facets), np.int64)
    number[on] = np.arange(len(on))
    found = {"face": entries(faces)}
    for kind, table, corners in (("edge", features.edges_of, features.edges[:, :2]),
                                 ("vertex", features.faces, np.arange(len(x))[:, None])):
        incident = sparse.csr_array((np.ones(table.size, np.int8), table.ravel(), np.arange(0, table.size + 1, 3)),
                                    (len(table), len(corners)))
        pairs = entries(faces @ incident)
        place = x[corners]
        centre = place.mean(axis=1)
        size = lengths(place - centre[:, None]).max(axis=1, initial=0.0)
        k, feature = number[pairs[:, 0]], pairs[:, 1]
        found[kind] = pairs[lengths(middle[k] - centre[feature]) <= limit[k] + radius[k] + size[feature]]
    return found


def face_outside(surfaces: Surfaces, x: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Whether two triangles of a cell, a and b (k,) int, are in a fold of it, for particles at x (m, 3) [µm]: its
    outside is between them, or between neighbours of each; (k,) bool.  Triangles with a common corner are not.

    Across a lip so thin that its sides have passed through each other they face each other, too, but the surface there
    goes -1 times around what is between: a force on its outside would make that more.
    """
    apart = (surfaces.facets[a][:, :, None] != surfaces.facets[b][:, None]).all(axis=(1, 2))
    middle, normal = x[surfaces.facets].mean(axis=1), area_vectors(x[surfaces.facets])
    way, turned = middle[b] - middle[a], dot(normal[a], normal[b]) < TURNED * lengths(normal[a]) * lengths(normal[b])
    facing = np.flatnonzero(apart & turned & (dot(normal[a], way) > 0.0) & (dot(normal[b], way) < 0.0))
    cell = surfaces.cell[surfaces.facets[:, 0]]
    outside = np.zeros(len(facing), bool)
    for c in np.unique(cell[a[facing]]):
        mine = np.flatnonzero(cell[a[facing]] == c)
        on, between = np.flatnonzero(surfaces.cell == c), middle[a[facing[mine]]] + 0.5 * way[facing[mine]]
        triangles = surfaces.facets[(cell == c) & surfaces.outer] - on[0]
        outside[mine] = ClosedSurface(x[on], triangles, np.zeros(len(triangles), int)).winding(between) == 0
    i, j = a[facing[outside]], b[facing[outside]]
    if not len(i):
        return np.zeros(len(a), bool)
    n, size = len(cell), surfaces.facets.size
    at = sparse.csr_array((np.ones(size, np.int32), surfaces.facets.ravel(), np.arange(0, size + 1, 3)), (n, len(x)))
    pairs = sparse.csr_array((np.ones(2 * len(i), np.int32), (np.append(i, j), np.append(j, i))), (n, n))
    corners = at.T @ pairs @ at  # of triangles that face each other
    return apart & ((at[a] @ corners).multiply(at[b]).sum(axis=1) > 0)


def entries(matrix: sparse.csr_array) -> np.ndarray:
    """Rows and columns of the entries of a matrix (p, 2) int, sorted."""
    matrix.sort_indices()
    return np.column_stack([np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr)), matrix.indices])


def near_boxes(x: np.ndarray, cell: np.ndarray, reach: float) -> np.ndarray:
    """Which points x (n, 3) [µm], of cells `cell` (n,) int, are within `reach` [µm] of another's box (n,) bool."""
    cells, place = np.unique(cell, return_inverse=True)
    low, high = np.full((len(cells), 3), np.inf), np.full((len(cells), 3), -np.inf)
    np.minimum.at(low, place, x)
    np.maximum.at(high, place, x)
    near, order = np.zeros(len(x), bool), np.argsort(place, kind="stable")
    for c, mine in enumerate(np.split(order, np.cumsum(np.bincount(place))[:-1]) if len(cells) else ()):
        meets = ((low <= high[c] + reach) & (high >= low[c] - reach)).all(axis=1)
        meets[c] = False
        for other in np.flatnonzero(meets):
            near[mine] |= ((x[mine] >= low[other] - reach) & (x[mine] <= high[other] + reach)).all(axis=1)
    return near


def acting_triangles(surfaces: Surfaces, features: Features, pairs: Pairs, own: np.ndarray,
                     holding: np.ndarray) -> Pairs:
    """All `pairs` of triangles that are in `holding` (f,) bool, or exert forces on particles in `own` (m,) bool in one
    of them, in the same order.
    """
    corners = {"face": features.faces, "edge": features.edges[:, :2], "vertex": np.arange(len(own))[:, None]}
    acting = own[surfaces.facets].any(axis=1) | holding
    for kind, of in pairs.items():
        acting[of[own[corners[kind][of[:, 1]]].any(axis=1), 0]] = True
    return {kind: of[acting[of[:, 0]]] for kind, of in pairs.items()}


@dataclass(frozen=True)
class TriangleLists(NodeLists):
    """Pairs of a triangle and a feature of another surface that are near each other.

    Attributes
    ----------
    first : dict of (s + 1,) int -- by kind of feature, where those near each triangle begin in `number`.
    number : dict of (p,) int -- by kind, features in the next three.
    face : (k, 3) int -- nodes of the faces.
    edge : (k, 4) int -- nodes of the edges.
    vertex : (k,) int -- nodes of the vertices.
    first_ring : (k + 1,) int -- where the neighbours of each begin in `ring`.
    ring : (p,) int -- nodes of these.
    """

    first: dict[str, np.ndarray]
    number: dict[str, np.ndarray]
    face: np.ndarray
    edge: np.ndarray
    vertex: np.ndarray
    first_ring: np.ndarray
    ring: np.ndarray

    def distances(self, x: np.ndarray) -> np.ndarray:
        """Distances (s, 3) [µm] of the triangles' corners from the faces near them, for nodes at x (n, 3) [µm]."""
        first, out = self.first["face"], np.full((len(self.source), 3), np.inf)
        source = np.repeat(np.arange(len(self.source)), np.diff(first))
        face = self.number["face"]
        middle = x[self.face].mean(axis=1)
        radius = lengths(x[self.face] - middle[:, None]).max(axis=1, initial=0.0)
        for k in range(3):
            p = x[self.segment[source, k]]
            away, nearest = lengths(p - middle[face]), np.full(len(out), np.inf)
            np.minimum.at(nearest, source, away)
            near = away - radius[face] <= (1.0 + 1e-9) * nearest[source]  # one of these is the nearest
            p = p[near]
            np.minimum.at(out[:, k], source[near], lengths(p - on_triangles(p, x[self.face[face[near]]])))
        return out

    @classmethod
    def of(cls, surfaces: Surfaces, features: Features, pairs: Pairs) -> TriangleLists:
        """The lists of `pairs`, as `triangle_pairs` returns them."""
        cell, n_cells, m = surfaces.cell, int(surfaces.cell.max(initial=0)) + 1, max(1, len(surfaces.ids))
        corner = {"face": features.faces, "edge": features.edges, "vertex": np.arange(len(cell))[:, None]}
        of_cell = {kind: cell[corner[kind][:, 0]] for kind in KINDS}
        # A source is a triangle near one cell; a feature is one near the cell of the triangle.
        near = np.concatenate([of[:, 0] * n_cells + of_cell[kind][of[:, 1]] for kind, of in pairs.items()])
        source_key = np.unique(near)
        sources = np.column_stack(np.divmod(source_key, n_cells))
        own = cell[surfaces.facets[:, 0]]
        used, first, number = {}, {}, {}
        for kind, of in pairs.items():
            key, number[kind] = np.unique(of[:, 1] * n_cells + own[of[:, 0]], return_inverse=True)
            used[kind] = key // n_cells, key % n_cells
            place = np.searchsorted(source_key, of[:, 0] * n_cells + of_cell[kind][of[:, 1]])
            order = np.argsort(place, kind="stable")
            number[kind] = number[kind].ravel()[order]
            first[kind] = np.searchsorted(place[order], np.arange(len(sources) + 1))
        vertex, near = used["vertex"]
        first_ring, ring = features.rings(vertex)
        parts = [(surfaces.facets[sources[:, 0]], sources[:, 1]), (features.faces[used["face"][0]], used["face"][1]),
                 (features.edges[used["edge"][0]], used["edge"][1]), (vertex[:, None], near),
                 (ring[:, None], np.repeat(near, np.diff(first_ring)))]
        keys = [(cell[p] * n_cells + other[:, None]) * m + p for p, other in parts]
        key, flat = np.unique(np.concatenate([k.ravel() for k in keys]), return_inverse=True)
        ends = np.cumsum([k.size for k in keys])[:-1]
        segment, face, edge, vertex, ring = (n.reshape(k.shape) for n, k in zip(np.split(flat.ravel(), ends), keys,
                                                                                strict=True))
        return cls(key % m, key // m % n_cells, segment, sources[:, 0], surfaces, first, number, face, edge,
                   vertex[:, 0], first_ring, ring[:, 0])
