"""Shapes that an outline bounds: particles evenly along it, the others evenly within."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.spatial import Delaunay

from ..case.registry import law, parameter, quantity
from . import polygons
from .shapes import Layout

CORNER = np.radians(30.0)  # an outline that turns by more has a corner there, in which a particle is put
CLEARANCE = 0.6  # least distance of inner particles from the outline at first, in spacings
ROUNDS = 30  # in which the inner particles spread evenly
FINE = 2000  # points of the polygon that stands for an ellipse


@law("shape", "ellipse")
class Ellipse:
    """Ellipse with semi-axes a along x and b along y, and a nucleus that is like it, about the same centre."""

    a: float = quantity("um", "semi-axis a along x", above=0)
    b: float = quantity("um", "semi-axis b along y", above=0)
    nucleus_ratio: float | None = quantity("", "size of the nucleus over that of the cell", None, above=0, maximum=0.95)

    parts = ("surface",)

    @property
    def area(self) -> float:
        """Area π a b [µm²]."""
        return float(np.pi * self.a * self.b)

    def outline(self, n: int = 64) -> np.ndarray:
        """Polygon of the surface about the centre (n, 2) [µm]."""
        t = 2.0 * np.pi * np.arange(n) / n - 0.5 * np.pi
        return np.column_stack([self.a * np.cos(t), self.b * np.sin(t)])

    def lowest(self) -> float:
        """Height of the lowest point over the centre [µm], negative."""
        return -self.b

    def particles(self, count: int, refinement: float = 1.0) -> Layout:
        """`count` particles, along the outline `refinement` times as dense as within."""
        X, m = fill(self.outline(FINE), count, refinement)
        level = ((X / [self.a, self.b]) ** 2).sum(axis=1)
        return Layout(X, innermost(level, m, self.nucleus_ratio), np.arange(m))


@law("shape", "polygon")
class Polygon:
    """Polygon, convex or not, given by its corners about the cell's centre in either sense.

    A nucleus is a smaller copy about the centre of the area, from where all of the outline has to be in sight.
    """

    corners: tuple = parameter("corners, in order, or the name of a CSV file of them, under 'x_um,y_um'", unit="um",
                               minimum=-1e6, maximum=1e6, shape=(None, 2), or_file=True)
    nucleus_ratio: float | None = quantity("", "size of the nucleus over that of the cell", None, above=0, maximum=0.95)

    def __post_init__(self):
        """Refuse what bounds no area; the messages are for the user."""
        if len(p := self._distinct()) < 3:
            raise ValueError("corners: a polygon has at least three")
        if (pair := polygons.crossing(p)) is not None:
            i, j = ("({:.4g}, {:.4g}) um".format(*p[n]) for n in pair)
            raise ValueError(f"corners: the outline crosses or touches itself: the edge from {i} meets that from {j}")
        size = np.ptp(self._polygon, axis=0).max()
        if not self.area > 1e-6 * size**2:
            raise ValueError("corners: the polygon has no area")
        if self.nucleus_ratio is not None and not self._sides().min() > 1e-9 * size**2:
            raise ValueError("nucleus_ratio: a nucleus needs an outline all of which is in sight from the centre of "
                             "its area")

    def _distinct(self) -> np.ndarray:
        """Corners without those that occur twice in a row (k, 2)."""
        p = np.array(self.corners)
        return p[(p != np.roll(p, -1, axis=0)).any(axis=1)]

    @cached_property
    def _polygon(self) -> np.ndarray:
        """Corners counterclockwise (k, 2)."""
        p = self._distinct()
        return p if polygons.area(p) > 0 else p[::-1]

    def _sides(self) -> np.ndarray:
        """Twice the area of the triangle from the centroid to each edge [µm²]."""
        d = self._polygon - polygons.centroid(self._polygon)
        return polygons.cross(d, np.roll(d, -1, axis=0))

    parts = ("surface",)

    @property
    def area(self) -> float:
        """Area [µm²]."""
        return abs(polygons.area(self._polygon))

    def outline(self, n: int = 64) -> np.ndarray:
        """Polygon of the surface (at least n, 2) [µm], with points between the corners."""
        length = polygons.sides(self._polygon)
        return _divided(self._polygon, np.ceil(n * length / length.sum()).astype(int))

    def lowest(self) -> float:
        """Height of the lowest point over the centre [µm]."""
        return float(self._polygon[:, 1].min())

    def particles(self, count: int, refinement: float = 1.0) -> Layout:
        """`count` particles, along the outline `refinement` times as dense as within."""
        X, m = fill(self._polygon, count, refinement)
        level = np.zeros(len(X)) if self.nucleus_ratio is None else self._level(X)
        return Layout(X, innermost(level, m, self.nucleus_ratio), np.arange(m))

    def _level(self, X: np.ndarray) -> np.ndarray:
        """Size of the copy of the outline about the centroid on which each of the points X lies (n,) [-]."""
        c = polygons.centroid(self._polygon)
        level, d = np.zeros(len(X)), X - c
        for p, q in zip(self._polygon - c, np.roll(self._polygon, -1, axis=0) - c, strict=True):
            towards = (polygons.cross(p, d) >= 0) & (polygons.cross(d, q) >= 0)
            level[towards] = polygons.cross(d[towards], q - p) / polygons.cross(p, q)
        return level


def fill(polygon: np.ndarray, count: int, refinement: float) -> tuple[np.ndarray, int]:
    """`count` particles in a polygon (k, 2): positions (count, 2), those of the surface first, and the number of these.

    Along the outline they are `refinement` times as dense as within.

    Raises ValueError if they are too few for the outline.
    """
    # As for a disc in rings: each particle takes 1.047 h², those on the surface half as much.
    a, b = polygons.area(polygon) / 1.047, (0.5 * refinement - 0.25) * polygons.sides(polygon).sum()
    h = a / (np.sqrt(b**2 + a * (count - 1.0)) - b)
    surface = _along(polygon, h / refinement)
    if len(surface) >= count or polygons.crossing(surface) is not None:
        raise ValueError(f"{count} particles are too few for such an outline")
    inner = _lattice(surface, h, count - len(surface))
    return _spread(np.concatenate([surface, inner]), len(surface)), len(surface)


def innermost(level: np.ndarray, m: int, ratio: float | None) -> np.ndarray:
    """Which particles are nucleus (n,) bool: those of the least `level`, as many as its area takes; `m` are surface."""
    nucleus = np.zeros(len(level), bool)
    if ratio is not None:
        number = np.clip(round(ratio**2 * (len(level) - 0.5 * m)), 1, len(level) - m)
        nucleus[m + np.argsort(level[m:], kind="stable")[:number]] = True
    return nucleus


def _along(polygon: np.ndarray, h: float) -> np.ndarray:
    """Points in the corners of an outline, as far as they are apart, and evenly about `h` apart between them."""
    edge = np.roll(polygon, -1, axis=0) - polygon
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(edge, axis=1))])
    before = np.roll(edge, 1, axis=0)
    turn = np.abs(np.arctan2(polygons.cross(before, edge), (before * edge).sum(axis=1)))
    kept: list[float] = []
    for s in arc[:-1][turn > CORNER]:
        if not kept or min(s - kept[-1], kept[0] + arc[-1] - s) > 0.5 * h:
            kept.append(float(s))
    kept = kept or [0.0]
    places = []
    for s, t in zip(kept, [*kept[1:], kept[0] + arc[-1]], strict=True):
        n = max(1 if len(kept) > 2 else 3, round((t - s) / h))
        places.append(s + (t - s) * np.arange(n) / n)
    closed = np.concatenate([polygon, polygon[:1]])
    s = np.concatenate(places) % arc[-1]
    return np.column_stack([np.interp(s, arc, closed[:, k]) for k in range(2)])


def _divided(polygon: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """A polygon whose edges are divided into `parts` (k,) each."""
    ends = np.roll(polygon, -1, axis=0)
    return np.concatenate([p + (q - p) * (np.arange(n) / n)[:, None] for p, q, n in zip(polygon, ends, parts,
                                                                                       strict=True)])


def _lattice(polygon: np.ndarray, h: float, count: int) -> np.ndarray:
    """`count` points of the widest triangular lattice that has as many inside a polygon, clear of the outline."""
    low, high = 0.3 * h, 2.0 * h
    for _ in range(25):
        s = 0.5 * (low + high)
        enough = len(_points(polygon, s, CLEARANCE * min(s, h))) >= count
        low, high = (s, high) if enough else (low, s)
    points = _points(polygon, low, CLEARANCE * min(low, h))
    if len(points) < count:
        raise ValueError(f"{count} particles do not fit inside such an outline")
    return points[np.sort(np.argsort(-polygons.distance(points, polygon), kind="stable")[:count])]


def _points(polygon: np.ndarray, s: float, clearance: float) -> np.ndarray:
    """Points of a triangular lattice with spacing s inside a polygon, one of them in the centre of its area."""
    c = polygons.centroid(polygon)
    low, high = polygon.min(axis=0) - c, polygon.max(axis=0) - c
    rows = np.arange(np.floor(low[1] / (s * np.sqrt(0.75))), np.ceil(high[1] / (s * np.sqrt(0.75))) + 1)
    columns = np.arange(np.floor(low[0] / s) - 1, np.ceil(high[0] / s) + 1)
    x = s * (columns[None, :] + 0.5 * (rows[:, None] % 2))
    y = np.broadcast_to(s * np.sqrt(0.75) * rows[:, None], x.shape)
    points = c + np.column_stack([x.ravel(), y.ravel()])
    points = points[polygons.inside(points, polygon)]
    return points[polygons.distance(points, polygon) > clearance]


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
