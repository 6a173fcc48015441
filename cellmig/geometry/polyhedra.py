"""Pieces of a triangle T of one surface beside faces, edges and vertices of another, for the contact of cells in space.

Points of T are shares of its corners, three numbers [-].  Each piece is convex, and all that contact needs of it goes
linearly over it, or along the lines into which it is cut.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from ..model.adhesion import GAUSS_OF_VERTEX
from ..model.triangles import RADON

Point = tuple[float, float, float]
CORNERS: list[Point] = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
TURN = 0.45  # largest angle from the first to the last line of a strip of a wedge [rad]
LITTLE = 3e-3  # share of T below which there is little of it in a strip of a wedge or a triangle of a cone [-]
# Each where there is more of T, and where there is little:
CHANGE = 1.2, 3.0  # largest change of a distance from the first to the last line of a strip, over the distance [-]
SIZE = 0.8, 1.5  # largest side of a triangle of a cone, over its distance from the vertex [-]
LEVEL = 1e-9  # sine of the angle of an edge below which it has no wedge [-]
THIN = 1e-12  # least width of a strip, over that of the wedge [-]
EVEN = 0.27  # most that the widths of the four lines of a strip bend, over their sum [-]
PARTS = 16  # most halvings of a strip
HALVINGS = 40  # most of a triangle of a cone


@dataclass(frozen=True)
class Polyhedron:
    """Faces, edges and rings of a closed surface of triangles.

    Attributes
    ----------
    faces : (m, 3) int -- corners, in positive order as seen from outside.
    edges : (3m/2, 4) int -- both ends, and the third corners of the faces on the left and on the right.
    rings : for each vertex its neighbours, in positive order as seen from outside.
    """

    faces: np.ndarray
    edges: np.ndarray
    rings: list[list[int]]

    @classmethod
    def of(cls, faces: np.ndarray) -> Polyhedron:
        """The polyhedron with these faces (m, 3) int."""
        left, after = {}, [{} for _ in range(int(faces.max()) + 1)]  # type: ignore[var-annotated]
        for corners in faces.tolist():
            for a, b, c in (corners, corners[1:] + corners[:1], corners[2:] + corners[:2]):
                left[a, b] = c
                after[a][b] = c
        edges = [(a, b, c, left[b, a]) for (a, b), c in left.items() if a < b]
        rings = []
        for following in after:
            ring = list(following)[:1]
            while ring and following[ring[-1]] != ring[0]:
                ring.append(following[ring[-1]])
            rings.append(ring)
        return cls(faces, np.array(edges), rings)

    @cached_property
    def sides(self) -> np.ndarray:
        """Numbers of the edges of the faces (m, 3) int."""
        number = {tuple(sorted(ends)): k for k, ends in enumerate(self.edges[:, :2].tolist())}
        return np.array([[number[tuple(sorted(side))] for side in ((a, b), (b, c), (c, a))]
                         for a, b, c in self.faces.tolist()])


def clipped(polygon: list[Point], values: Sequence[float]) -> list[Point]:
    """The part of a convex polygon on T where something linear is positive, with `values` at T's corners [any unit]."""
    at = [p[0] * values[0] + p[1] * values[1] + p[2] * values[2] for p in polygon]
    if min(at, default=0.0) >= 0.0:
        return polygon
    part: list[Point] = []
    for k in range(len(polygon)):
        p, q, here, there = polygon[k - 1], polygon[k], at[k - 1], at[k]
        if (here < 0.0) != (there < 0.0):
            part.append(mixed(p, q, here / (here - there)))
        if there >= 0.0:
            part.append(q)
    return part


def mixed(p: Point, q: Point, share: float) -> Point:
    """The point at a share [-] of the way from p to q."""
    return (p[0] + share * (q[0] - p[0]), p[1] + share * (q[1] - p[1]), p[2] + share * (q[2] - p[2]))


def crossed(p: Point, q: Point, r: Point, s: Point) -> float:
    """Area between the vectors from p to q and from r to s, over twice that of T [-]."""
    return (q[1] - p[1]) * (s[2] - r[2]) - (q[2] - p[2]) * (s[1] - r[1])


def fan(polygon: list[Point]) -> Iterator[tuple[Point, Point, Point, float]]:
    """Triangles of a convex polygon and their shares of the area of T [-]."""
    for q, r in pairwise(polygon[1:]):
        yield polygon[0], q, r, abs(crossed(polygon[0], q, polygon[0], r))


@dataclass(frozen=True)
class FacePiece:
    """A triangle of the part of T over a face: shares at its corners of T and of the face, gaps [µm], part of T [-]."""

    on: list[Point]
    below: list[tuple]
    gaps: list[float]
    part: float


def over_face(T: np.ndarray, face: np.ndarray, within: float) -> list[FacePiece]:
    """Pieces of T over a face, on its outer side; corners (3, 3) each [µm], out of reach beyond `within` [µm]."""
    a, b, c = face
    normal = np.cross(b - a, c - a)
    square = normal @ normal
    gaps = (T - a) @ normal / np.sqrt(square)
    if gaps.max() <= 0.0 or gaps.min() >= within:
        return []
    on_c = (T - a) @ np.cross(normal, b - a) / square
    on_b = (T - a) @ np.cross(c - a, normal) / square
    shares = np.array([1.0 - on_b - on_c, on_b, on_c])
    polygon = CORNERS
    for values in (*shares, gaps):
        polygon = clipped(polygon, values.tolist())
    return [FacePiece(points := [p, q, r], [tuple(shares @ k) for k in points],
                      [float(gaps @ k) for k in points], part) for p, q, r, part in fan(polygon)]


@dataclass(frozen=True)
class EdgePiece:
    """A line across the wedge over an edge, on T, with the width that it stands for.

    Attributes
    ----------
    ends : of the line, on T.
    along : places of these along the edge [-].
    distances : of these from the edge [µm].
    widths : shares of T for the length of the line, at its ends, with the sign of the edge [-].
    away : (3,) -- direction from the edge [-].
    """

    ends: tuple[Point, Point]
    along: tuple[float, float]
    distances: tuple[float, float]
    widths: tuple[float, float]
    away: np.ndarray


class Wedge:
    """The part of T beside an edge, between the normals of its faces."""

    def __init__(self, T: np.ndarray, edge: np.ndarray):
        """Corners of T (3, 3); ends of the edge and third corners of its faces (4, 3) [µm]."""
        p, q, left, right = edge
        along = q - p
        size = np.sqrt(along @ along)
        along = along / size
        n1, n2 = np.cross(along, left - p), np.cross(right - p, along)
        n1, n2 = n1 / np.sqrt(n1 @ n1), n2 / np.sqrt(n2 @ n2)
        turn = np.cross(n1, n2) @ along
        self.sign = 1.0 if turn > 0.0 else -1.0
        self.flat = abs(turn) < LEVEL
        self.along = (T - p) @ along / size
        self.away = T - p - np.outer((T - p) @ along, along)
        first = -self.sign * (self.away @ np.cross(along, n2))
        last = -self.sign * (self.away @ np.cross(n1, along))
        polygon = CORNERS
        for values in (self.along, 1.0 - self.along, first, last):
            polygon = clipped(polygon, values.tolist())
        self.polygon = polygon
        self.first = [float(first @ k) for k in polygon]
        self.last = [float(last @ k) for k in polygon]

    def lines(self, within: float, smooth: float) -> Iterator[EdgePiece]:
        """Lines of equal direction from the edge, at Gauss points between the directions of the corners.

        within, smooth : float -- distances beyond which there are no bonds, and below which they have no scale [µm].
        """
        if self.flat or len(self.polygon) < 3:
            return
        at = [max(b, 0.0) / max(max(a, 0.0) + max(b, 0.0), 1e-300) for a, b in zip(self.first, self.last, strict=True)]
        for low, high in pairwise(sorted(set(at))):
            middle, n = 0.5 * (low + high), len(at)
            sides = [(k - 1, k) for k in range(n) if (at[k - 1] < middle) != (at[k] < middle)]
            if high - low < THIN or len(sides) != 2:
                continue
            place, whole = 0, 2**PARTS
            while place < whole:  # halves of halves of all
                size = place & -place or whole
                while True:
                    start, part = (low + (high - low) * place / whole, (high - low) * size / whole)
                    first, *_, last = directions = [start + share * part for share, _ in GAUSS_OF_VERTEX]
                    lines = [self.line(one, weight * part, sides)
                             for one, (_, weight) in zip(directions, GAUSS_OF_VERTEX, strict=True)]
                    width = [abs(sum(line.widths)) for line in lines]
                    little = sum(width) < 2.0 * LITTLE
                    if size == 1 or (self.even(width) and self.short(first, last, sides, smooth, CHANGE[little])):
                        break
                    size //= 2
                yield from (line for line in lines if min(line.distances) < within)
                place += size

    @staticmethod
    def even(width: list[float]) -> bool:
        """Whether the widths of four lines [-], times their weights, are nearly linear: else most of a strip may be
        between the last line and the end, as of a triangle with one side along a sharp edge.
        """
        first, one, other, last = (w / weight for w, (_, weight) in zip(width, GAUSS_OF_VERTEX, strict=True))
        return abs(first - one - other + last) <= EVEN * (first + one + other + last)

    def short(self, start: float, end: float, sides: list, smooth: float, most: float) -> bool:
        """Whether distances change at `most` so [-] between two directions [-], beside a distance `smooth` [µm]."""
        for side in sides:
            one, other = (self.away.T @ self.crossing(at, side)[0] for at in (start, end))
            r1, r2 = np.sqrt(one @ one), np.sqrt(other @ other)
            if abs(r2 - r1) > most * max(min(r1, r2), smooth) or one @ other < np.cos(TURN) * r1 * r2:
                return False
        return True

    def crossing(self, at: float, side: tuple[int, int]) -> tuple[Point, Point]:
        """The point of a side of the polygon in a direction, and its derivative by the direction [-]."""
        i, j = side
        here, there = ((1.0 - at) * self.last[k] - at * self.first[k] for k in side)
        sum1, sum2 = (self.first[k] + self.last[k] for k in side)
        rate = (there * sum1 - here * sum2) / (here - there) ** 2
        p, q = self.polygon[i], self.polygon[j]
        return mixed(p, q, here / (here - there)), (rate * (q[0] - p[0]), rate * (q[1] - p[1]), rate * (q[2] - p[2]))

    def line(self, at: float, weight: float, sides: list) -> EdgePiece:
        """The line in a direction; `weight` of the direction [-]."""
        (p, moved1), (q, moved2) = (self.crossing(at, side) for side in sides)
        zero = (0.0, 0.0, 0.0)
        widths = [2.0 * weight * self.sign * abs(crossed(zero, moved, p, q)) for moved in (moved1, moved2)]
        away = [self.away.T @ k for k in (p, q)]
        r1, r2 = (float(np.sqrt(y @ y)) for y in away)
        return EdgePiece((p, q), (float(self.along @ p), float(self.along @ q)), (r1, r2), (widths[0], widths[1]),
                         away[0] / r1 if r1 > r2 else away[1] / r2)


@dataclass(frozen=True)
class VertexPiece:
    """A point that counts for a vertex.

    Attributes
    ----------
    on : (3,) -- shares of the corners of T [-].
    weight : share of T that it stands for, with its sign [-].
    away : (3,) -- its place from the vertex [µm].
    """

    on: np.ndarray
    weight: float
    away: np.ndarray


def beside_vertex(T: np.ndarray, vertex: np.ndarray, ring: np.ndarray, within: float,
                  smooth: float) -> Iterator[VertexPiece]:
    """Points of T (3, 3) in the cones over a vertex with the neighbours `ring` (n, 3) [µm].

    A point counts with 1 less the number of arcs of the ring on its side, the index of the distance from it, if it is
    on the outer side of the mean normal.
    `within`, `smooth` : as of the lines of a wedge [µm].
    Source: Banchoff (1970); the weights of the normals are those of Max (1999).
    """
    away, spokes = T - vertex, ring - vertex
    if np.sqrt((away * away).sum(axis=1)).min() - np.sqrt(((T - T[[1, 2, 0]]) ** 2).sum(axis=1)).max() > within:
        return
    values = away @ spokes.T
    square = (spokes * spokes).sum(axis=1)
    weights = 1.0 / (square * np.roll(square, -1))
    outward = away @ (weights @ np.cross(spokes, np.roll(spokes, -1, axis=0)))
    cells = [CORNERS]
    for column in values.T:
        if column.min() < 0.0 < column.max():
            cells = [part for cell in cells for side in (column, -column)
                     if len(part := clipped(cell, side.tolist())) > 2]
    for cell in cells:
        centre = np.mean(cell, axis=0)
        towards = (centre @ values) > 0.0
        index = 1 - int((towards & ~np.roll(towards, -1)).sum())
        if index and centre @ outward > 0.0:
            nearest = int(np.argmin(((np.array(cell) @ away) ** 2).sum(axis=1)))
            for p, q, r, share in fan(cell[nearest:] + cell[:nearest]):
                points, weights = graded(away, np.array([p, q, r]), index * share, within, smooth)
                yield from map(VertexPiece, points, weights, points @ away)


def graded(away: np.ndarray, triangle: np.ndarray, part: float, within: float,
           smooth: float) -> tuple[np.ndarray, np.ndarray]:
    """Seven points in each of the parts of a triangle that are short beside their distance from a vertex.

    Parameters
    ----------
    away : (3, 3) -- places of the corners of T from the vertex [µm].
    triangle : (3, 3) -- corners of the triangle, on T [-].
    part : float -- its share of T, with its sign [-].
    within, smooth : float -- as of the lines of a wedge [µm].

    Returns
    -------
    on : (n, 3) -- points on T [-];  weight : (n,) -- shares of T that they stand for [-].
    """
    shares, found, weights = np.array(RADON), [np.empty((0, 3))], [np.empty(0)]
    waiting = triangle[None]
    for _ in range(HALVINGS):
        places = waiting @ away
        sides = np.sqrt(((np.roll(places, -1, axis=1) - np.roll(places, 1, axis=1)) ** 2).sum(axis=2))
        near, most = np.sqrt((places * places).sum(axis=2)).min(axis=1), sides.max(axis=1)
        short = most <= SIZE[abs(part) < LITTLE] * np.maximum(near, smooth)
        found.append((shares[:, :3] @ waiting[short]).reshape(-1, 3))
        weights.append(np.tile(part * shares[:, 3], int(short.sum())))
        split = ~short & (near - most < within)
        if not split.any():
            break
        k = (np.argmax(sides[split], axis=1)[:, None] + np.arange(3)) % 3
        apex, a, b = np.take_along_axis(waiting[split], k[:, :, None], axis=1).transpose(1, 0, 2)
        middle, part = 0.5 * (a + b), 0.5 * part
        waiting = np.concatenate([np.stack([apex, a, middle], axis=1), np.stack([apex, middle, b], axis=1)])
    return np.concatenate(found), np.concatenate(weights)
