"""Shapes that an outline bounds: particles evenly along it, the others evenly within."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from ..case import outline_file
from ..case.outline_file import named
from ..case.registry import law, parameter, quantity
from . import holes as hollow
from . import polygons
from .disc import Layout
from .fill import fill
from .holes import FINE

MOST = 1e6  # µm from the centre
MOST_EXCHANGED = 3  # neighbours that are asked for: an outline that turns back more often is rough


class Outlined:
    """A shape by its outline: what is common to them.

    `_border` is the outer loop, counterclockwise (k, 2);  `_loops` are that and, clockwise, the holes;  `_edges` names
    edges by their numbers, counted through all loops;  `_fixed` holds, of each loop, corners in which there has to be a
    particle.
    """

    doubt: ClassVar[str] = ""
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
        nucleus = self._nucleus if self.has_nucleus else None
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
    nucleus_offset: tuple | None = quantity("um", "from the middle of the cell's area to that of the nucleus", None,
                                            shape=(2,))
    holes: tuple = quantity("um", "circular holes: x and y of the middle, from the cell's centre, and radius", (),
                            shape=(None, 3))
    cutouts: tuple = quantity("um", "holes of any shape: their corners from the cell's centre, in either sense; they "
                              "are counted after those that are circles", (), shape=(None, None, 2))

    def __post_init__(self):
        """Refuse a nucleus or holes where none can be; the messages are for the user."""
        if self.nucleus_offset is not None and self.nucleus_ratio is None:
            raise ValueError("nucleus_offset: is where a nucleus of the size nucleus_ratio lies, which is missing")
        for loop in self._nucleus if self.has_nucleus else ():
            if polygons.touch(loop, self._border) or not polygons.inside(loop[:1], self._border).all():
                what = ("nucleus_corners: the nucleus" if self.nucleus_ratio is None else
                        "nucleus_offset: the nucleus there" if self.nucleus_offset is not None else
                        "nucleus_ratio: a copy of the outline of that size, about the centre of its area,")
                raise ValueError(f"{what} does not lie within it")
        hollow.check(self, self._border)

    @property
    def has_nucleus(self) -> bool:
        """Whether it has a nucleus."""
        return self.nucleus_ratio is not None

    @cached_property
    def _loops(self) -> list[np.ndarray]:
        return [self._border, *hollow.loops(self)]

    @property
    def _nucleus(self) -> list[np.ndarray]:
        """Loop around the nucleus, counterclockwise: a smaller copy of the outline."""
        c = self._centre
        return [c + np.array(self.nucleus_offset or (0.0, 0.0)) + self.nucleus_ratio * (self._border - c)]

    @property
    def _centre(self) -> np.ndarray:
        """Centre of its area without holes (2,) [µm]."""
        return np.zeros(2)


@law("shape", "ellipse")
class Ellipse(_Solid):
    """Ellipse with semi-axes a along x and b along y, and a nucleus that is like it."""

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
        return polygons.circle(n) * [self.a, self.b]

    def lowest(self) -> float:
        """Height of the lowest point over the centre [µm], negative."""
        return -self.b


@law("shape", "polygon")
class Polygon(_Solid):
    """Polygon, convex or not, given by its corners about the cell's centre in either sense, or as a picture has them.

    Parts of its surface: edge-1 from the first corner to the second, and so on.  A nucleus has corners of its own, or
    is a smaller copy about the centre of the area; it has to lie within.
    """

    corners: tuple = parameter("corners, in order, or the name of a CSV file of them, under 'x_um,y_um'", unit="um",
                               minimum=-MOST, maximum=MOST, shape=(None, 2), or_file=outline_file.corners, scaled=True)
    unit: float | None = quantity("um", "length that 1 is in corners and nucleus_corners, such as the size of a pixel: "
                                  "they are numbers then, in a file under 'x_px,y_px' or as ImageJ writes it", None,
                                  above=0)
    y_down: bool = parameter("whether y of the corners runs down, as in pictures", False)
    centred: bool = parameter("whether the middle of the area is the cell's centre, in place of the corners' zero",
                              False)
    nucleus_corners: tuple | None = parameter("corners of the nucleus, or a file of them, as those of the cell", None,
                                              unit="um", minimum=-MOST, maximum=MOST, shape=(None, 2),
                                              or_file=outline_file.corners, scaled=True)

    def __post_init__(self):
        """Refuse what bounds no area; the messages are for the user."""
        self._bounds("corners", self.corners)
        if self.nucleus_corners is not None:
            if self.nucleus_ratio is not None:
                raise ValueError("nucleus_ratio: the nucleus has corners already")
            self._bounds("nucleus_corners", self.nucleus_corners)
        super().__post_init__()

    def _bounds(self, key: str, corners: Any) -> None:
        """Refuse corners that bound no area."""
        if len(set(corners)) < 3:
            raise ValueError(f"{key}: a polygon has at least three")
        p = self._scaled(corners)
        if not (abs(p) <= MOST).all():
            raise ValueError(f"{key}: reach further than {MOST:.0e} um, with 1 as {self.unit:.4g} um")
        kept = polygons.distinct(p)
        if len(p := p[kept]) > 3 and (pair := polygons.crossing(p)) is not None:
            i, j = ("({:.4g}, {:.4g}) um".format(*p[n]) for n in pair)
            raise ValueError(f"{key}: the outline crosses or touches itself: the edge from {i} meets that from {j}, "
                             + named(corners, kept[list(pair)]) + _exchanged(corners, kept, p))
        if len(p) < 3 or polygons.is_flat(p):
            raise ValueError(f"{key}: the polygon has no area")

    def _scaled(self, corners: Any) -> np.ndarray:
        """Corners as they are, with y upwards (k, 2) [µm]."""
        return (self.unit or 1.0) * np.array(corners) * [1.0, -1.0 if self.y_down else 1.0]

    def _loop(self, corners: Any) -> np.ndarray:
        """Corners that bound an area, about the cell's centre, counterclockwise (k, 2) [µm]."""
        p = self._scaled(corners)
        p = p[polygons.distinct(p)]
        return p[polygons.order(p)] - (self._middle if self.centred else 0.0)

    @cached_property
    def _middle(self) -> np.ndarray:
        """Centre of the area as the corners have it (2,) [µm], to the last bit for any first corner and sense."""
        p = self._scaled(self.corners)
        p = p[polygons.distinct(p)]
        return polygons.centroid(p[polygons.order(p)])

    @property
    def doubt(self) -> str:
        """What may be wrong where particles do not suit the outline, as the end of a message."""
        p = self._scaled(self.corners)
        kept = polygons.distinct(p)
        return _exchanged(self.corners, kept, p[kept])

    @cached_property
    def _border(self) -> np.ndarray:
        return self._loop(self.corners)

    @property
    def has_nucleus(self) -> bool:
        """Whether it has a nucleus."""
        return self.nucleus_ratio is not None or self.nucleus_corners is not None

    @property
    def _nucleus(self) -> list[np.ndarray]:
        return super()._nucleus if self.nucleus_corners is None else [self._loop(self.nucleus_corners)]

    @property
    def _centre(self) -> np.ndarray:
        return polygons.centroid(self._border)

    @cached_property
    def _edges(self) -> dict[str, int]:
        """Edges by their names, in the order of the corners as they are given: numbers of those of `_border`."""
        p = self._scaled(self.corners)
        p = p[polygons.distinct(p)]
        start = polygons.order(p)
        edge = start if polygons.area(p) > 0 else np.roll(start, -1)
        return {f"edge-{k + 1}": i for i, k in enumerate(edge.tolist())}


@law("shape", "rectangle")
class Rectangle(_Solid):
    """Rectangle about its centre; parts of its surface: bottom, right, top, left."""

    width: float = quantity("um", "width, along x", above=0)
    height: float = quantity("um", "height, along y", above=0)

    _edges: ClassVar[dict[str, int]] = {"bottom": 0, "right": 1, "top": 2, "left": 3}

    @cached_property
    def _border(self) -> np.ndarray:
        return 0.5 * np.array([self.width, self.height]) * [[-1, -1], [1, -1], [1, 1], [-1, 1]]


def _exchanged(corners: tuple, kept: np.ndarray, p: np.ndarray) -> str:
    """End of a message: which neighbours among the corners p = corners[kept] (k, 2) seem to be in the wrong order.

    The outline turns back at both, and is shorter if they are exchanged.
    """
    a, b, c, d = (np.roll(p, 1 - k, axis=0) for k in range(4))
    back = (((b - a) * (c - b)).sum(axis=1) < 0.0) & (((c - b) * (d - c)).sum(axis=1) < 0.0)
    length = [sum(np.linalg.norm(q - r, axis=1) for q, r in pairwise(way))
              for way in ((a, b, c, d), (a, c, b, d))]
    found = np.flatnonzero(back & (length[1] < length[0]))
    if not 0 < len(found) <= MOST_EXCHANGED:
        return ""
    pairs = (named(corners, kept[[n, (n + 1) % len(p)]]) for n in found)
    return f"; are {', '.join(pairs)} in the right order?"


def _divided(polygon: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """A polygon whose edges are divided into `parts` (k,) each."""
    ends = np.roll(polygon, -1, axis=0)
    return np.concatenate([p + (q - p) * (np.arange(n) / n)[:, None] for p, q, n in zip(polygon, ends, parts,
                                                                                       strict=True)])
