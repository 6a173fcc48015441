"""Shapes that an outline bounds: particles evenly along it, the others evenly within."""

from __future__ import annotations

from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from scipy.spatial import Delaunay

from ..case.outline_file import corners
from ..case.registry import law, parameter, quantity
from . import hollow, polygons
from .resample import along
from .shapes import Layout

COARSE = 0.6  # least area of a hole's particles over its own, below which it is not resolved
CLEARANCE = 0.6  # least distance of inner particles from the outline at first, in spacings
ROUNDS = 30  # in which the inner particles spread evenly
FINE = 2000  # points of the polygon that stands for an ellipse


class Outlined:
    """A shape by its outline: what is common to them.

    `_border` is the outer loop, counterclockwise (k, 2);  `_edges` names edges by their numbers, counted through all
    loops;  `_fixed` holds, of each loop, corners in which there has to be a particle.
    """

    _fixed: ClassVar[Any] = None

    @cached_property
    def _loops(self) -> list[np.ndarray]:
        """Outer loop, and clockwise the holes."""
        return [self._border, *hollow.loops(self)]

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of parts of its surface: all of it, its outer loop, edges of that, holes."""
        inner = (f"hole-{n}" for n in range(1, len(self._loops)))
        return tuple(dict.fromkeys(["surface", "outline", *self._edges, *inner]))

    @property
    def area(self) -> float:
        """Area [µm²]."""
        return polygons.area(polygons.joined(self._loops))

    def outline(self, n: int = 64) -> np.ndarray:
        """Polygon of the outer surface (at least n, 2) [µm], with points between the corners."""
        length = polygons.sides(self._border)
        return _divided(self._border, np.ceil(n * length / length.sum()).astype(int))

    def lowest(self) -> float:
        """Height of the lowest point over the centre [µm]."""
        return float(self._border[:, 1].min())

    def particles(self, count: int, refinement: float = 1.0) -> Layout:
        """`count` particles, along the surface `refinement` times as dense as within."""
        X, edge = fill(self._loops, count, refinement, self._fixed)
        sizes = [len(e) for e in edge]
        m, start = sum(sizes), np.cumsum([0, *sizes])
        after = np.concatenate([a + np.roll(np.arange(k), -1) for a, k in zip(start, sizes, strict=False)])
        first = np.cumsum([0, *map(len, self._loops)])
        number = np.concatenate([k + e for k, e in zip(first, edge, strict=False)])
        parts = {"outline": np.arange(start[1])}
        parts |= {f"hole-{n}": np.arange(start[n], start[n + 1]) for n in range(1, len(sizes))}
        parts |= {name: np.flatnonzero(np.isin(number, n)) for name, n in self._edges.items()}
        level = self._level(X) if self.nucleus_ratio is not None else np.zeros(len(X))
        return Layout(X, innermost(level, m, self.nucleus_ratio), np.arange(m), after, parts)


@law("shape", "ellipse")
class Ellipse(Outlined):
    """Ellipse with semi-axes a along x and b along y, and a nucleus that is like it, about the same centre."""

    a: float = quantity("um", "semi-axis a along x", above=0)
    b: float = quantity("um", "semi-axis b along y", above=0)
    nucleus_ratio: float | None = quantity("", "size of the nucleus over that of the cell", None, above=0, maximum=0.95)
    holes: tuple = hollow.circles()
    cutouts: tuple = hollow.cutouts()

    _edges: ClassVar[dict[str, int]] = {}

    def __post_init__(self):
        """Refuse holes where none can be; the messages are for the user."""
        hollow.check(self, self._border)

    @cached_property
    def _border(self) -> np.ndarray:
        return self.outline(FINE)

    @property
    def area(self) -> float:
        """Area [µm²]: π a b less the holes."""
        polygonal = sum(map(polygons.area, hollow.loops(self)[len(self.holes):]))  # negative
        return float(np.pi * self.a * self.b) - sum(np.pi * r**2 for *_, r in self.holes) + polygonal

    def outline(self, n: int = 64) -> np.ndarray:
        """Polygon of the outer surface about the centre (n, 2) [µm]."""
        t = 2.0 * np.pi * np.arange(n) / n - 0.5 * np.pi
        return np.column_stack([self.a * np.cos(t), self.b * np.sin(t)])

    def lowest(self) -> float:
        """Height of the lowest point over the centre [µm], negative."""
        return -self.b

    def _level(self, X: np.ndarray) -> np.ndarray:
        return ((X / [self.a, self.b]) ** 2).sum(axis=1)


class _Cornered(Outlined):
    """A shape with corners.  A nucleus is a smaller copy about the centre of the area."""

    def _check(self) -> None:
        """Refuse a nucleus or holes where none can be; the messages are for the user."""
        if self.nucleus_ratio is not None:
            c, copy = polygons.centroid(self._border), self.outline(FINE)
            if not polygons.inside(c + self.nucleus_ratio * (copy - c), self._border).all():
                raise ValueError("nucleus_ratio: a copy of the outline of that size, about the centre of its area, "
                                 "does not lie within it")
        hollow.check(self, self._border)

    def _level(self, X: np.ndarray) -> np.ndarray:
        """Size of the copy of the outline about the centroid on which each of the points X lies (n,) [-]."""
        c = polygons.centroid(self._border)
        level, d = np.zeros(len(X)), X - c
        for p, q in zip(self._border - c, np.roll(self._border, -1, axis=0) - c, strict=True):
            towards = (polygons.cross(p, d) >= 0) & (polygons.cross(d, q) >= 0)
            size = polygons.cross(d[towards], q - p) / polygons.cross(p, q)
            level[towards] = np.maximum(level[towards], size)  # of several edges that way, the nearest
        return level


@law("shape", "polygon")
class Polygon(_Cornered):
    """Polygon, convex or not, given by its corners about the cell's centre in either sense.

    Parts of its surface: edge-1 from the first corner to the second, and so on.  A nucleus is a smaller copy about the
    centre of the area, and has to lie within.
    """

    corners: tuple = parameter("corners, in order, or the name of a CSV file of them, under 'x_um,y_um'", unit="um",
                               minimum=-1e6, maximum=1e6, shape=(None, 2), or_file=corners)
    nucleus_ratio: float | None = quantity("", "size of the nucleus over that of the cell", None, above=0, maximum=0.95)
    holes: tuple = hollow.circles()
    cutouts: tuple = hollow.cutouts()

    def __post_init__(self):
        """Refuse what bounds no area; the messages are for the user."""
        if len(p := self._distinct()) < 3:
            raise ValueError("corners: a polygon has at least three")
        if (pair := polygons.crossing(p)) is not None:
            i, j = ("({:.4g}, {:.4g}) um".format(*p[n]) for n in pair)
            raise ValueError(f"corners: the outline crosses or touches itself: the edge from {i} meets that from {j}")
        if not abs(polygons.area(p)) > 1e-6 * np.ptp(p, axis=0).max() ** 2:
            raise ValueError("corners: the polygon has no area")
        self._check()

    def _distinct(self) -> np.ndarray:
        """Corners without those that occur twice in a row (k, 2)."""
        return polygons.distinct(np.array(self.corners))

    @cached_property
    def _border(self) -> np.ndarray:
        p = self._distinct()
        return p if polygons.area(p) > 0 else p[::-1]

    @cached_property
    def _edges(self) -> dict[str, int]:
        """Edges by their names, in the order of the corners as they are given: numbers of those of `_border`."""
        p = self._distinct()
        n = np.arange(len(p))
        number = n if polygons.area(p) > 0 else (len(p) - 2 - n) % len(p)
        return {f"edge-{k}": int(i) for k, i in enumerate(number, 1)}


@law("shape", "rectangle")
class Rectangle(_Cornered):
    """Rectangle about its centre; parts of its surface: bottom, right, top, left."""

    width: float = quantity("um", "width, along x", above=0)
    height: float = quantity("um", "height, along y", above=0)
    nucleus_ratio: float | None = quantity("", "size of the nucleus over that of the cell", None, above=0, maximum=0.95)
    holes: tuple = hollow.circles()
    cutouts: tuple = hollow.cutouts()

    _edges: ClassVar[dict[str, int]] = {"bottom": 0, "right": 1, "top": 2, "left": 3}

    def __post_init__(self):
        """Refuse holes where none can be; the messages are for the user."""
        self._check()

    @cached_property
    def _border(self) -> np.ndarray:
        return 0.5 * np.array([self.width, self.height]) * [[-1, -1], [1, -1], [1, 1], [-1, 1]]


def fill(loops: list[np.ndarray], count: int, refinement: float, fixed: list[np.ndarray] | None = None
         ) -> tuple[np.ndarray, list[np.ndarray]]:
    """`count` particles in closed loops: positions (count, 2), those of the surface first.

    Of each loop, the edges (m,) as well on which the segments from its particles to the next lie.  Along the surface
    particles are `refinement` times as dense as within.

    Raises ValueError if they are too few for the outline.
    """
    outline = polygons.joined(loops)
    # As for a disc in rings: each particle takes 1.047 h², those on the surface half as much.
    a, b = polygons.area(outline) / 1.047, (0.5 * refinement - 0.25) * polygons.sides(outline).sum()
    h = a / (np.sqrt(b**2 + a * (count - 1.0)) - b)
    corners = fixed or [None] * len(loops)
    rings, edge = zip(*(along(loop, h / refinement, at) for loop, at in zip(loops, corners, strict=True)), strict=True)
    for ring, loop in zip(rings[1:], loops[1:], strict=True):
        if polygons.area(ring) > COARSE * polygons.area(loop):  # both are negative
            raise ValueError(f"{count} particles are too few for the hole at "
                             "({:.4g}, {:.4g}) um".format(*polygons.centroid(loop)))
    surface = np.concatenate(rings)
    if len(surface) >= count or any(polygons.crossing(ring) is not None for ring in rings):
        raise ValueError(f"{count} particles are too few for such an outline")
    inner = _lattice(polygons.joined(list(rings)), h, count - len(surface))
    return _spread(np.concatenate([surface, inner]), len(surface)), list(edge)


def innermost(level: np.ndarray, m: int, ratio: float | None) -> np.ndarray:
    """Which particles are nucleus (n,) bool: those of the least `level`, as many as its area takes; `m` are surface."""
    nucleus = np.zeros(len(level), bool)
    if ratio is not None:
        number = np.clip(round(ratio**2 * (len(level) - 0.5 * m)), 1, len(level) - m)
        nucleus[m + np.argsort(level[m:], kind="stable")[:number]] = True
    return nucleus


def _divided(polygon: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """A polygon whose edges are divided into `parts` (k,) each."""
    ends = np.roll(polygon, -1, axis=0)
    return np.concatenate([p + (q - p) * (np.arange(n) / n)[:, None] for p, q, n in zip(polygon, ends, parts,
                                                                                       strict=True)])


def _lattice(outline: np.ndarray, h: float, count: int) -> np.ndarray:
    """`count` points of the widest triangular lattice that has as many inside an outline, clear of it."""
    low, high = 0.3 * h, 2.0 * h
    for _ in range(25):
        s = 0.5 * (low + high)
        enough = len(_points(outline, s, CLEARANCE * min(s, h))) >= count
        low, high = (s, high) if enough else (low, s)
    points = _points(outline, low, CLEARANCE * min(low, h))
    if len(points) < count:
        raise ValueError(f"{count} particles do not fit inside such an outline")
    return points[np.sort(np.argsort(-polygons.distance(points, outline), kind="stable")[:count])]


def _points(outline: np.ndarray, s: float, clearance: float) -> np.ndarray:
    """Points of a triangular lattice with spacing s inside an outline, one of them in the centre of its area."""
    c, corners = polygons.centroid(outline), outline.reshape(-1, 2)
    low, high = corners.min(axis=0) - c, corners.max(axis=0) - c
    rows = np.arange(np.floor(low[1] / (s * np.sqrt(0.75))), np.ceil(high[1] / (s * np.sqrt(0.75))) + 1)
    columns = np.arange(np.floor(low[0] / s) - 1, np.ceil(high[0] / s) + 1)
    x = s * (columns[None, :] + 0.5 * (rows[:, None] % 2))
    y = np.broadcast_to(s * np.sqrt(0.75) * rows[:, None], x.shape)
    points = c + np.column_stack([x.ravel(), y.ravel()])
    points = points[polygons.inside(points, outline)]
    return points[polygons.distance(points, outline) > clearance]


def _spread(X: np.ndarray, m: int) -> np.ndarray:
    """Points of which the first m are the outline and stay; the others move into the middle of what surrounds them."""
    for _ in range(ROUNDS):
        tri = Delaunay(X).simplices
        tri = tri[(tri >= m).any(axis=1)]  # the others lie between points of the outline alone, maybe outside
        corners = X[tri]
        size = 0.5 * np.abs(polygons.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
        weight = np.bincount(tri.ravel(), np.repeat(size, 3), len(X))
        middle = size[:, None] * corners.mean(axis=1)
        total = np.column_stack([np.bincount(tri.ravel(), np.repeat(middle[:, k], 3), len(X)) for k in range(2)])
        X = np.concatenate([X[:m], (total / np.maximum(weight, 1e-300)[:, None])[m:]])
    return X
