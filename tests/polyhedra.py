"""Contact between two surfaces of triangles, added up from its pieces; and surfaces to try it on."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from cellmig.geometry.polyhedra import Polyhedron, Wedge, beside_vertex, over_face
from cellmig.model.polyhedra import PolyhedronAdhesion


class Contact:
    """Loads and energy of triangles near a surface, piece by piece."""

    def __init__(self, term: PolyhedronAdhesion, T: np.ndarray, x: np.ndarray, surface: Polyhedron):
        """Triangles T (n, 3, 3) and vertices x (m, 3) of a surface [µm]; a triangle's reference area is its area."""
        self.term, self.T = term, T
        self.energy = dict.fromkeys(("face", "edge", "vertex"), 0.0)
        self.force_on_T, self.force_on_x = np.zeros_like(T), np.zeros_like(x)
        self.pieces = dict.fromkeys(self.energy, 0)
        within, smooth = term.bonds.law.cutoff, term.bonds.law.cap
        a, b, c = T.transpose(1, 0, 2)
        area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
        faces, edges, points = [], [], []
        for n, t in enumerate(T):
            for face in surface.faces:
                faces += [(n, face, piece) for piece in over_face(t, x[face], within)]
            for edge in surface.edges:
                edges += [(n, edge[:2], piece) for piece in Wedge(t, x[edge]).lines(within, smooth)]
            for v, ring in enumerate(surface.rings):
                points += [(n, [v], piece) for piece in beside_vertex(t, x[v], x[ring], within, smooth)]
        if faces:
            self.add("face", x, *self.of_faces(area, faces, x))
        if edges:
            self.add("edge", x, *self.of_edges(area, edges))
        if points:
            self.add("vertex", x, *self.of_points(area, points))

    def of_faces(self, area: np.ndarray, found: list, x: np.ndarray) -> tuple:
        size = np.array([area[n] * piece.part for n, _, piece in found])
        loads, energy, _ = self.term.face(size, *np.array([piece.gaps for _, _, piece in found]).T)
        a, b, c = np.array([x[face] for _, face, _ in found]).transpose(1, 0, 2)
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        return found, loads, energy, [p.on for *_, p in found], [p.below for *_, p in found], normal

    def of_edges(self, area: np.ndarray, found: list) -> tuple:
        width = np.array([area[n] * np.array(piece.widths) for n, _, piece in found]).T
        loads, energy, _ = self.term.edge(*width, *np.array([piece.distances for *_, piece in found]).T)
        below = [[(1.0 - t, t) for t in piece.along] for *_, piece in found]
        return found, loads, energy, [p.ends for *_, p in found], below, np.array([p.away for *_, p in found])

    def of_points(self, area: np.ndarray, found: list) -> tuple:
        size = np.array([area[n] * piece.weight for n, _, piece in found])
        away = np.array([piece.away for *_, piece in found])
        r = np.linalg.norm(away, axis=1)
        load, energy, _ = self.term.vertex(size, r)
        return found, load, energy, [[p.on] for *_, p in found], [[(1.0,)]] * len(found), away / r[:, None]

    def add(self, kind: str, x: np.ndarray, found: list, loads: Any, energy: Any, on: list, below: list,
            away: np.ndarray) -> None:
        """Loads to the corners of T and of the feature by their shares."""
        self.energy[kind], self.pieces[kind] = energy.sum(), len(found)
        force = np.array(loads).T[:, :, None] * away[:, None]  # (piece, point, 3)
        on_T = -np.einsum("pqk,pqi->pki", np.array(on), force)
        on_x = np.einsum("pqk,pqi->pki", np.array(below), force)
        np.add.at(self.force_on_T, [n for n, *_ in found], on_T)
        np.add.at(self.force_on_x, np.array([nodes for _, nodes, _ in found]), on_x)

    @property
    def total(self) -> float:
        return sum(self.energy.values())


def sphere(n: int, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) on a sphere, evenly [µm], and triangles (m, 3) turned outwards."""
    k = np.arange(n) + 0.5
    z, turn = 1.0 - 2.0 * k / n, np.pi * (1.0 + 5.0**0.5) * k
    x = radius * np.column_stack([np.sqrt(1.0 - z * z) * np.cos(turn), np.sqrt(1.0 - z * z) * np.sin(turn), z])
    triangles = ConvexHull(x).simplices
    a, b, c = x[triangles].transpose(1, 0, 2)
    inward = np.einsum("ni,ni->n", np.cross(b - a, c - a), a + b + c) < 0.0
    triangles[inward] = triangles[inward][:, ::-1]
    return x, triangles


def blocks(cells: list[tuple[int, int, int]], size: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) [µm] and faces (m, 3) of some cubes of a lattice."""
    places: dict[tuple, int] = {}
    faces = []
    for cell in cells:
        for axis in range(3):
            for side in (0, 1):
                beyond = tuple(cell[k] + (2 * side - 1) * (k == axis) for k in range(3))
                if beyond in cells:
                    continue
                one, two = (axis + 1) % 3, (axis + 2) % 3
                quad = []
                for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)) if side else ((0, 0), (0, 1), (1, 1), (1, 0)):
                    corner = list(cell)
                    corner[axis] += side
                    corner[one] += a
                    corner[two] += b
                    quad.append(places.setdefault(tuple(corner), len(places)))
                faces += [(quad[0], quad[1], quad[2]), (quad[0], quad[2], quad[3])]
    return size * np.array(list(places), float), np.array(faces)


def relief(height: np.ndarray, spacing: float, below: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
    """A closed slab: heights (n, n) of its upper side on a grid, -below of its lower side [µm].

    Vertices (2 n², 3), those of the upper side first, and faces.
    """
    n = len(height)
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    xy = spacing * (np.column_stack([i.ravel(), j.ravel()]) - 0.5 * (n - 1))
    x = np.concatenate([np.column_stack([xy, height.ravel()]), np.column_stack([xy, np.full(n * n, -below)])])
    faces = []
    for a in range(n - 1):
        for b in range(n - 1):
            p, q, r, s = a * n + b, (a + 1) * n + b, (a + 1) * n + b + 1, a * n + b + 1
            faces += [(p, q, r), (p, r, s)]
    upper = np.array(faces)
    rim = [k * n for k in range(n)] + [(n - 1) * n + k for k in range(1, n)]
    rim += [(n - 1 - k) * n + n - 1 for k in range(1, n)] + [n - 1 - k for k in range(1, n - 1)]
    side = []
    for p, q in zip(rim, rim[1:] + rim[:1], strict=True):
        side += [(q, p, p + n * n), (q, p + n * n, q + n * n)]
    return x, np.concatenate([upper, upper[:, ::-1] + n * n, np.array(side)])
