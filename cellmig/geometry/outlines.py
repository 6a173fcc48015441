"""Shapes that are given by an outline: ellipse, polygon, rectangle, and the base class of all shapes from outlines."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from ..case import outline_file
from ..case.outline_file import named
from ..case.registry import law, parameter, quantity
from . import holes, polygons
from .disc import Layout
from .fill import fill

MOST = 1e6  # largest coordinate of a corner [µm]
MOST_EXCHANGED = 3  # pairs of corners that may be in the wrong order: an outline that turns back more often is rough


class Outlined:
    """Base class of shapes that are given by an outline.

    Attributes
    ----------
    _border : (k, 2) -- the outer loop, counterclockwise [µm].
    _loops : list of (k, 2) -- the outer loop, then the holes, clockwise [µm].
    _edges : dict -- by name of a part, the number of its edges, counted through all loops.
    _fixed : list of (c,) int -- for each loop, the corners at which there has to be a particle; None if there are none.
    """

    dimension = 2

    @property
    def hint(self) -> str:
        """End of a message about particles that do not suit the outline."""
        return ""

    @property
    def _border(self) -> np.ndarray:
        raise NotImplementedError

    @property
    def _loops(self) -> list[np.ndarray]:
        return [self._border]

    @property
    def _edges(self) -> dict[str, Any]:
        return {}

    @property
    def _fixed(self) -> Any:
        return None

    @property
    def has_nucleus(self) -> bool:
        """Whether the cell has a nucleus."""
        return False

    @property
    def _nucleus(self) -> list[np.ndarray]:
        return []

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the parts of the surface: all of it, the outer loop, named edges, holes."""
        inner = (f"hole-{n}" for n in range(1, len(self._loops)))
        return tuple(dict.fromkeys(["surface", "outline", *self._edges, *inner]))

    @property
    def area(self) -> float:
        """Area without the holes [µm²]."""
        return polygons.area(polygons.joined(self._loops))

    def outline(self, n: int = 64) -> np.ndarray:
        """Polygon (m, 2) [µm], m >= n, of the outer loop, with points between the corners."""
        length = polygons.sides(self._border)
        return _divided(self._border, np.ceil(n * length / length.sum()).astype(int))

    def lowest(self) -> float:
        """Height of the lowest point above the centre [µm], usually negative."""
        return float(self._border[:, 1].min())

    def particles(self, count: int, refinement: float = 1.0) -> Layout:
        """Exactly `count` particles, along the surface `refinement` times as dense [-] as inside."""
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
    """Shapes with holes and a nucleus that is a smaller copy of the outline."""

    nucleus_ratio: float | None = quantity("", "size of the nucleus over that of the cell", None, above=0, maximum=0.95)
    nucleus_offset: tuple | None = quantity("um", "vector from the cell's centre of area to that of the nucleus", None,
                                            shape=(2,))
    holes: tuple = quantity("um", "circular holes: x and y of the centre, from the cell's centre, and radius", (),
                            shape=(None, 3))
    cutouts: tuple = quantity("um", "holes of any shape: their corners from the cell's centre, in either sense; they "
                              "are numbered after the circular holes", (), shape=(None, None, 2))

    def __post_init__(self) -> None:
        """Check the nucleus and the holes.

        Raises ValueError where they do not fit into the outline; the message is for the user.
        """
        if self.nucleus_offset is not None and self.nucleus_ratio is None:
            raise ValueError("nucleus_offset: needs nucleus_ratio, the size of the nucleus, which is missing")
        for loop in self._nucleus if self.has_nucleus else ():
            if polygons.touch(loop, self._border) or not polygons.inside(loop[:1], self._border).all():
                what = ("nucleus_corners: the nucleus" if self.nucleus_ratio is None else
                        "nucleus_offset: the nucleus there" if self.nucleus_offset is not None else
                        "nucleus_ratio: a copy of the outline of that size, about the centre of its area,")
                raise ValueError(f"{what} does not lie within it")
        holes.check(self, self._border)

    @property
    def has_nucleus(self) -> bool:
        """Whether the cell has a nucleus."""
        return self.nucleus_ratio is not None

    @cached_property
    def _loops(self) -> list[np.ndarray]:
        return [self._border, *holes.loops(self)]

    @property
    def _nucleus(self) -> list[np.ndarray]:
        """Loop around the nucleus, counterclockwise, as a list of one (k, 2) [µm]: a smaller copy of the outline."""
        c = self._centre
        return [c + np.array(self.nucleus_offset or (0.0, 0.0)) + self.nucleus_ratio * (self._border - c)]

    @property
    def _centre(self) -> np.ndarray:
        """Centre of area of the outer loop (2,) [µm]."""
        return np.zeros(2)


@law("shape", "ellipse")
class Ellipse(_Solid):
    """Ellipse with semi-axes a along x and b along y; its nucleus has the same ratio of axes."""

    a: float = quantity("um", "semi-axis a along x", above=0)
    b: float = quantity("um", "semi-axis b along y", above=0)

    @cached_property
    def _border(self) -> np.ndarray:
        return self.outline(holes.FINE)

    @property
    def area(self) -> float:
        """Area π a b, less the holes [µm²]."""
        polygonal = sum(map(polygons.area, holes.loops(self)[len(self.holes):]))  # negative
        return float(np.pi * self.a * self.b) - sum(np.pi * r**2 for *_, r in self.holes) + polygonal

    def outline(self, n: int = 64) -> np.ndarray:
        """Polygon (n, 2) [µm] of the outer loop, with the centre as origin."""
        return polygons.circle(n) * [self.a, self.b]

    def lowest(self) -> float:
        """Height of the lowest point above the centre [µm], -b."""
        return -self.b


@law("shape", "polygon")
class Polygon(_Solid):
    """Polygon, convex or not, given by its corners in either sense, from the cell's centre or as in an image.

    Parts of its surface: edge-1 from the first corner to the second, and so on.  The nucleus is given by its corners,
    or is a smaller copy of the outline about its centre of area; it has to be inside the outline.
    """

    corners: tuple = parameter("corners, in order, or the name of a CSV file with the header 'x_um,y_um'", unit="um",
                               minimum=-MOST, maximum=MOST, shape=(None, 2), or_file=outline_file.corners, scaled=True)
    unit: float | None = quantity("um", "length of one unit of corners and nucleus_corners, such as the size of a "
                                  "pixel; these are then pure numbers, in a file with the header 'x_px,y_px' or as "
                                  "ImageJ writes it", None, above=0)
    y_down: bool = parameter("whether the y axis of the corners points down, as in images", False)
    centred: bool = parameter("whether the cell's centre is the centre of area, instead of the origin of the corners",
                              False)
    nucleus_corners: tuple | None = parameter("corners of the nucleus, or the name of a file, as for the cell", None,
                                              unit="um", minimum=-MOST, maximum=MOST, shape=(None, 2),
                                              or_file=outline_file.corners, scaled=True)

    def __post_init__(self) -> None:
        """Check that the corners bound an area.

        Raises ValueError where they do not; the message is for the user.
        """
        self._bounds("corners", self.corners)
        if self.nucleus_corners is not None:
            if self.nucleus_ratio is not None:
                raise ValueError("nucleus_ratio: the nucleus has corners already")
            self._bounds("nucleus_corners", self.nucleus_corners)
        super().__post_init__()

    def _bounds(self, key: str, corners: Any) -> None:
        """Raise ValueError for corners that bound no area."""
        if len(set(corners)) < 3:
            raise ValueError(f"{key}: a polygon has at least three")
        p = self._scaled(corners)
        if not (abs(p) <= MOST).all():
            raise ValueError(f"{key}: reach further than {MOST:.0e} um, with 1 as {self.unit:.4g} um")
        found = polygons.distinct(p)
        if len(p := p[found]) > 3 and (pair := polygons.crossing(p)) is not None:
            i, j = ("({:.4g}, {:.4g}) um".format(*p[n]) for n in pair)
            raise ValueError(f"{key}: the outline crosses or touches itself: the edge from {i} meets that from {j}, "
                             + named(corners, found[list(pair)]) + _exchanged(corners, found, p))
        if len(p) < 3 or polygons.is_flat(p):
            raise ValueError(f"{key}: the polygon has no area")

    def _scaled(self, corners: Any) -> np.ndarray:
        """Corners in the given order, with y upwards (k, 2) [µm]."""
        return (self.unit or 1.0) * np.array(corners) * [1.0, -1.0 if self.y_down else 1.0]

    def _loop(self, corners: Any) -> np.ndarray:
        """Corners that bound an area, from the cell's centre, counterclockwise (k, 2) [µm]."""
        return polygons.simplified(self._scaled(corners)) - (self._origin if self.centred else 0.0)

    @cached_property
    def _origin(self) -> np.ndarray:
        """Centre of area in the corners' own coordinates (2,) [µm]; the same bits for any first corner and sense."""
        return polygons.centroid(polygons.simplified(self._scaled(self.corners)))

    @property
    def hint(self) -> str:
        """End of a message about particles that do not suit the outline: corners that may be in the wrong order."""
        p = self._scaled(self.corners)
        found = polygons.distinct(p)
        return _exchanged(self.corners, found, p[found])

    @cached_property
    def _border(self) -> np.ndarray:
        return self._loop(self.corners)

    @property
    def has_nucleus(self) -> bool:
        """Whether the cell has a nucleus."""
        return self.nucleus_ratio is not None or self.nucleus_corners is not None

    @property
    def _nucleus(self) -> list[np.ndarray]:
        return super()._nucleus if self.nucleus_corners is None else [self._loop(self.nucleus_corners)]

    @property
    def _centre(self) -> np.ndarray:
        return polygons.centroid(self._border)

    @cached_property
    def _edges(self) -> dict[str, Any]:
        """Numbers of the edges of `_border`, by names that count the corners in the given order."""
        p = self._scaled(self.corners)
        p = p[polygons.distinct(p)]
        start = polygons.counterclockwise(p)
        edge = start if polygons.area(p) > 0 else np.roll(start, -1)
        return {f"edge-{k + 1}": i for i, k in enumerate(edge.tolist())}


@law("shape", "rectangle")
class Rectangle(_Solid):
    """Rectangle whose centre is the cell's; parts of its surface: bottom, right, top, left."""

    width: float = quantity("um", "width, along x", above=0)
    height: float = quantity("um", "height, along y", above=0)

    @property
    def _edges(self) -> dict[str, Any]:
        return {"bottom": 0, "right": 1, "top": 2, "left": 3}

    @cached_property
    def _border(self) -> np.ndarray:
        return 0.5 * np.array([self.width, self.height]) * [[-1, -1], [1, -1], [1, 1], [-1, 1]]


@law("shape", "segment")
class Segment(_Solid):
    """Segment of a circle that rests with its base, a chord, on a line, as a spread cell does; the base has the origin.

    It is given by its width and either its height or its contact angle.  Parts of its surface: base, cap.
    """

    width: float = quantity("um", "width of the base, along x", above=0)
    height: float | None = quantity("um", "height of the top above the base", None, above=0)
    contact_angle: float | None = quantity("rad", "angle between base and cap, measured inside", None, above=0)

    def __post_init__(self) -> None:
        """Check height and contact angle.

        Raises ValueError unless there is one of them that a segment can have; the message is for the user.
        """
        if (self.height is None) == (self.contact_angle is None):
            raise ValueError("expects one of height and contact_angle")
        if self.contact_angle is not None and self.contact_angle >= np.pi:
            raise ValueError("contact_angle: is less than 180 degrees, that of a whole circle")
        super().__post_init__()

    @property
    def _angle(self) -> float:
        """Contact angle, which is half of the angle of the arc as well [rad]."""
        return self.contact_angle or 2.0 * float(np.arctan(2.0 * (self.height or 0.0) / self.width))

    @property
    def _edges(self) -> dict[str, Any]:
        return {"base": holes.FINE, "cap": np.arange(holes.FINE)}

    @cached_property
    def _border(self) -> np.ndarray:
        """The arc from the right to the left end of the base, which is the last edge."""
        angle = np.longdouble(self._angle)
        at = angle * np.linspace(1.0, 0.0, holes.FINE // 2 + 1)  # from the top
        unit = np.column_stack([np.sin(at), np.cos(at) - np.cos(angle)])
        right = polygons.snapped(0.5 * self.width / np.sin(angle) * unit)
        return np.concatenate([right, right[-2::-1] * [-1.0, 1.0]])

    @property
    def _centre(self) -> np.ndarray:
        return polygons.centroid(self._border)


def _exchanged(corners: tuple, numbers: np.ndarray, p: np.ndarray) -> str:
    """End of a message: adjacent ones of the corners p = corners[numbers] (k, 2) that may be in the wrong order.

    At both of them the outline turns back, and exchanging them makes it shorter.
    """
    a, b, c, d = (np.roll(p, 1 - k, axis=0) for k in range(4))
    back = (((b - a) * (c - b)).sum(axis=1) < 0.0) & (((c - b) * (d - c)).sum(axis=1) < 0.0)
    length = [sum(np.linalg.norm(q - r, axis=1) for q, r in pairwise(way))
              for way in ((a, b, c, d), (a, c, b, d))]
    found = np.flatnonzero(back & (length[1] < length[0]))
    if not 0 < len(found) <= MOST_EXCHANGED:
        return ""
    pairs = (named(corners, numbers[[n, (n + 1) % len(p)]]) for n in found)
    return f"; are {', '.join(pairs)} in the right order?"


def _divided(polygon: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """The polygon (k, 2) with each edge divided into the number of `parts` (k,) that belongs to it."""
    if (parts == 1).all():
        return polygon
    ends = np.roll(polygon, -1, axis=0)
    return np.concatenate([p + (q - p) * (np.arange(n) / n)[:, None] for p, q, n in zip(polygon, ends, parts,
                                                                                       strict=True)])
