"""Shapes that an outline bounds: particles evenly along it, the others evenly within."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ..case.outline_file import corners
from ..case.registry import law, parameter, quantity
from . import hollow, polygons
from .fill import fill
from .hollow import FINE
from .shapes import Layout


class Outlined:
    """A shape by its outline: what is common to them.

    `_border` is the outer loop, counterclockwise (k, 2);  `_loops` are that and, clockwise, the holes;  `_edges` names
    edges by their numbers, counted through all loops;  `_fixed` holds, of each loop, corners in which there has to be a
    particle.
    """

    _edges: ClassVar[dict[str, int]] = {}
    _fixed: ClassVar[Any] = None

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
        nucleus = None if self.nucleus_ratio is None else self._nucleus
        X, edge, inner = fill(self._loops, count, refinement, self._fixed, nucleus)
        sizes = [len(e) for e in edge]
        m, start = sum(sizes), np.cumsum([0, *sizes])
        after = np.concatenate([a + np.roll(np.arange(k), -1) for a, k in zip(start, sizes, strict=False)])
        first = np.cumsum([0, *map(len, self._loops)])
        number = np.concatenate([k + e for k, e in zip(first, edge, strict=False)])
        parts = {"outline": np.arange(start[1])}
        parts |= {f"hole-{n}": np.arange(start[n], start[n + 1]) for n in range(1, len(sizes))}
        parts |= {name: np.flatnonzero(np.isin(number, n)) for name, n in self._edges.items()}
        return Layout(X, inner, np.arange(m), after, parts)


@dataclass(frozen=True, kw_only=True)
class _Solid(Outlined):
    """What shapes that a case describes have in common: a nucleus that is like the cell, and holes."""

    nucleus_ratio: float | None = quantity("", "size of the nucleus over that of the cell", None, above=0, maximum=0.95)
    holes: tuple = quantity("um", "circular holes: x and y of the middle, from the cell's centre, and radius", (),
                            shape=(None, 3))
    cutouts: tuple = quantity("um", "holes of any shape: their corners from the cell's centre, in either sense; they "
                              "are counted after those that are circles", (), shape=(None, None, 2))

    def __post_init__(self):
        """Refuse holes where none can be; the messages are for the user."""
        hollow.check(self, self._border)

    @cached_property
    def _loops(self) -> list[np.ndarray]:
        return [self._border, *hollow.loops(self)]


@law("shape", "ellipse")
class Ellipse(_Solid):
    """Ellipse with semi-axes a along x and b along y, and a nucleus that is like it, about the same centre."""

    a: float = quantity("um", "semi-axis a along x", above=0)
    b: float = quantity("um", "semi-axis b along y", above=0)

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

    @property
    def _nucleus(self) -> list[np.ndarray]:
        return [self.nucleus_ratio * self._border]


class _Cornered(_Solid):
    """A shape with corners.  A nucleus is a smaller copy about the centre of the area."""

    def __post_init__(self):
        """Refuse a nucleus or holes where none can be; the messages are for the user."""
        if self.nucleus_ratio is not None:
            c, copy = polygons.centroid(self._border), self.outline(FINE)
            if not polygons.inside(c + self.nucleus_ratio * (copy - c), self._border).all():
                raise ValueError("nucleus_ratio: a copy of the outline of that size, about the centre of its area, "
                                 "does not lie within it")
        super().__post_init__()

    @property
    def _nucleus(self) -> list[np.ndarray]:
        c = polygons.centroid(self._border)
        return [c + self.nucleus_ratio * (self._border - c)]


@law("shape", "polygon")
class Polygon(_Cornered):
    """Polygon, convex or not, given by its corners about the cell's centre in either sense.

    Parts of its surface: edge-1 from the first corner to the second, and so on.  A nucleus is a smaller copy about the
    centre of the area, and has to lie within.
    """

    corners: tuple = parameter("corners, in order, or the name of a CSV file of them, under 'x_um,y_um'", unit="um",
                               minimum=-1e6, maximum=1e6, shape=(None, 2), or_file=corners)

    def __post_init__(self):
        """Refuse what bounds no area; the messages are for the user."""
        if len(p := self._distinct()) < 3:
            raise ValueError("corners: a polygon has at least three")
        if (pair := polygons.crossing(p)) is not None:
            i, j = ("({:.4g}, {:.4g}) um".format(*p[n]) for n in pair)
            raise ValueError(f"corners: the outline crosses or touches itself: the edge from {i} meets that from {j}")
        if polygons.is_flat(p):
            raise ValueError("corners: the polygon has no area")
        super().__post_init__()

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

    _edges: ClassVar[dict[str, int]] = {"bottom": 0, "right": 1, "top": 2, "left": 3}

    @cached_property
    def _border(self) -> np.ndarray:
        return 0.5 * np.array([self.width, self.height]) * [[-1, -1], [1, -1], [1, 1], [-1, 1]]


def _divided(polygon: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """A polygon whose edges are divided into `parts` (k,) each."""
    ends = np.roll(polygon, -1, axis=0)
    return np.concatenate([p + (q - p) * (np.arange(n) / n)[:, None] for p, q, n in zip(polygon, ends, parts,
                                                                                       strict=True)])
