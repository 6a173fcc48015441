"""Shapes of bodies in space, and the layout of their particles: ball, ellipsoid, cap, box, cylinder."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ..case.registry import law, quantity
from . import base_surfaces
from .fill_body import fill
from .surfaces import ClosedSurface
from .triangles import lengths

NUCLEI = ("nucleus_ratio", "nucleus_file", "nucleus_region")  # keys that give a nucleus, of which a shape has some


class Layout3(NamedTuple):
    """Particles of one body, with the body's centre as origin, and the tetrahedra between them.

    Attributes
    ----------
    X : (n, 3) -- reference positions [µm], those of surface particles first.
    nucleus : (n,) bool -- whether a particle belongs to the nucleus.
    triangles : (m, 3) int -- particles at the corners of the surface's triangles, counterclockwise from outside.
    tetrahedra : (k, 4) int -- particles at the corners of the tetrahedra, which fill the surface; positively oriented.
    parts : dict of (j,) int -- by name of a part of the surface, indices in `triangles`.
    """

    X: np.ndarray
    nucleus: np.ndarray
    triangles: np.ndarray
    tetrahedra: np.ndarray
    parts: dict[str, np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Body:
    """Base class of bodies, with a nucleus that is a smaller copy of the surface.

    Attributes
    ----------
    _surface : ClosedSurface -- fine triangles of the surface.
    _numbers : dict -- by name of a part of the surface, its numbers in `_surface.part`.
    """

    nucleus_ratio: float | None = quantity("", "size of the nucleus over that of the cell", None, above=0, maximum=0.95)
    nucleus_offset: tuple | None = quantity("um", "vector from the cell's centre of volume to that of the nucleus",
                                            None, shape=(3,))

    dimension = 3

    def __post_init__(self) -> None:
        """Check the nucleus.

        Raises ValueError where it does not fit into the body; the message is for the user.
        """
        if self.nucleus_offset is not None and self.nucleus_ratio is None:
            raise ValueError("nucleus_offset: needs nucleus_ratio, the size of the nucleus, which is missing")
        surface, nucleus = self._surface, self._nucleus
        if nucleus is not None and not surface.inside(nucleus.vertices).all():
            key = next(k for k in ("nucleus_offset", *NUCLEI) if getattr(self, k, None) is not None)
            away = surface.distance(nucleus.vertices)
            at = "({:.3g}, {:.3g}, {:.3g})".format(*np.round(nucleus.vertices[away.argmax()], 6) + 0.0)
            raise ValueError(f"{key}: the nucleus does not lie within the body: it is {max(away.max(), 0.0):.3g} um "
                             f"out of it at {at} um from the cell's centre")

    @property
    def _surface(self) -> ClosedSurface:
        raise NotImplementedError

    @property
    def _numbers(self) -> dict[str, Any]:
        return {}

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the parts of the surface: all of it, and those that the shape has."""
        return ("surface", *self._numbers)

    @property
    def volume(self) -> float:
        """Volume [µm³]."""
        return self._surface.volume

    @property
    def surface_area(self) -> float:
        """Area of the surface's triangles [µm²]."""
        return self._surface.area

    @property
    def has_nucleus(self) -> bool:
        """Whether the cell has a nucleus."""
        return self._nucleus is not None

    def outline(self, n: int = 64) -> np.ndarray:
        """At least n points (m, 3) [µm] of the surface, with the centre as origin."""
        points = self._surface.vertices  # the lowest one is among them
        more = n - len(points)
        return points if more <= 0 else np.concatenate([points, self._surface.sampled(more)[0]])

    def distances(self, points: np.ndarray) -> np.ndarray:
        """Distances (n,) [µm] of points (n, 3) [µm] from the surface, negative inside."""
        return self._surface.distance(points)

    def lowest(self) -> float:
        """Height of the lowest point above the centre [µm], usually negative."""
        return float(self._surface.vertices[:, 2].min())

    @property
    def _nucleus(self) -> ClosedSurface | None:
        if self.nucleus_ratio is None:
            return None
        surface, c = self._surface, self._surface.centroid
        centre = c + np.array(self.nucleus_offset or (0.0, 0.0, 0.0))
        return surface.moved(centre + self.nucleus_ratio * (surface.vertices - c))

    def _exact(self, points: np.ndarray) -> np.ndarray:
        """Points (n, 3) of the triangles, moved to the curved surface [µm]."""
        return points

    def particles(self, count: int, refinement: float = 1.0) -> Layout3:
        """Exactly `count` particles, along the surface `refinement` times as dense [-] as inside.

        Raises ValueError if they are too few for the surface; the message is for the user.
        """
        surface = self._surface
        X, nucleus, tet, triangles, origin = fill(surface, count, refinement, self._nucleus, self._exact)
        of = surface.part[origin]
        parts = {"surface": np.arange(len(triangles))}
        parts |= {name: np.flatnonzero(np.isin(of, numbers)) for name, numbers in self._numbers.items()}
        return Layout3(X, nucleus, triangles, tet, parts)


@law("shape", "ellipsoid")
class Ellipsoid(Body):
    """Ellipsoid with semi-axes a, b, c along x, y, z; its nucleus has the same ratios of axes."""

    a: float = quantity("um", "semi-axis a along x", above=0)
    b: float = quantity("um", "semi-axis b along y", above=0)
    c: float = quantity("um", "semi-axis c along z", above=0)

    @property
    def _axes(self) -> np.ndarray:
        return np.array([self.a, self.b, self.c])

    @cached_property
    def _surface(self) -> ClosedSurface:
        unit = base_surfaces.ball()
        return unit.moved(unit.vertices * self._axes)

    @property
    def volume(self) -> float:
        """Volume 4/3 π a b c [µm³]; Source: Archimedes."""
        return float(4.0 / 3.0 * np.pi * np.prod(self._axes))

    def _exact(self, points: np.ndarray) -> np.ndarray:
        return points / lengths(points / self._axes)[:, None]


@law("shape", "ball")
class Ball(Body):
    """Ball of radius R with a nucleus that is a ball."""

    radius: float = quantity("um", "radius R", above=0)

    @cached_property
    def _surface(self) -> ClosedSurface:
        unit = base_surfaces.ball()
        return unit.moved(self.radius * unit.vertices)

    @property
    def volume(self) -> float:
        """Volume 4/3 π R³ [µm³]; Source: Archimedes."""
        return float(4.0 / 3.0 * np.pi * self.radius**3)

    def _exact(self, points: np.ndarray) -> np.ndarray:
        return self.radius * points / lengths(points)[:, None]


@law("shape", "cap")
class Cap(Body):
    """Cap of a spheroid that rests with its flat base on a plane, as a spread cell does; the base has the origin.

    Without a contact angle it is the cap of a sphere.  Parts of its surface: base, cap.
    """

    contact_radius: float = quantity("um", "radius of the base", above=0)
    height: float = quantity("um", "height of the top above the base", above=0)
    contact_angle: float | None = quantity("rad", "angle between base and cap, measured inside; above "
                                           "atan(2 height/contact_radius)", None, above=0)

    def __post_init__(self) -> None:
        """Check the contact angle.

        Raises ValueError if no spheroid has it; the message is for the user.
        """
        if self.contact_angle is not None:
            least = float(np.arctan(2.0 * self.height / self.contact_radius))
            if not least < self.contact_angle < np.pi:
                raise ValueError(f"contact_angle: a spheroid of this height has one between {least:.4g} rad, that of a "
                                 f"paraboloid, and {np.pi:.4g} rad")
        super().__post_init__()

    @property
    def _numbers(self) -> dict[str, Any]:
        return {"base": 0, "cap": 1}

    @property
    def _centre(self) -> float:
        """Height of the spheroid's centre over its vertical semi-axis [-]."""
        if self.contact_angle is None:
            return (self.height**2 - self.contact_radius**2) / (self.height**2 + self.contact_radius**2)
        return 1.0 / (1.0 - self.contact_radius / self.height * math.tan(self.contact_angle))

    @property
    def _axes(self) -> np.ndarray:
        across = self.contact_radius / np.sqrt(1.0 - self._centre**2)
        return np.array([across, across, self.height / (1.0 + self._centre)])

    @cached_property
    def _surface(self) -> ClosedSurface:
        return base_surfaces.cap(self.contact_radius, self.height, self._centre)

    @property
    def volume(self) -> float:
        """Volume π A² B (2/3 + ζ - ζ³/3) [µm³], with semi-axes A, B and centre at the height ζ B.

        Source: integral of the circles' areas over the height.
        """
        (a, _, b), z = self._axes, self._centre
        return float(np.pi * a**2 * b * (2.0 / 3.0 + z - z**3 / 3.0))

    def _exact(self, points: np.ndarray) -> np.ndarray:
        centre = np.array([0.0, 0.0, self._centre * self._axes[2]])
        above = points[:, 2] > 1e-9 * self.height
        p = points[above] - centre
        exact = points.copy()
        exact[above] = centre + p / lengths(p / self._axes)[:, None]
        return exact


@law("shape", "box")
class Box(Body):
    """Box whose centre is the cell's; parts of its surface: left, right, front, back, bottom, top."""

    a: float = quantity("um", "length along x", above=0)
    b: float = quantity("um", "length along y", above=0)
    c: float = quantity("um", "length along z", above=0)

    @property
    def _numbers(self) -> dict[str, Any]:
        return {"left": 0, "right": 1, "front": 2, "back": 3, "bottom": 4, "top": 5}

    @cached_property
    def _surface(self) -> ClosedSurface:
        return base_surfaces.box(self.a, self.b, self.c)


@law("shape", "cylinder")
class Cylinder(Body):
    """Cylinder with its axis along z; parts of its surface: side, bottom, top."""

    radius: float = quantity("um", "radius R", above=0)
    length: float = quantity("um", "length L along z", above=0)

    @property
    def _numbers(self) -> dict[str, Any]:
        return {"side": 0, "bottom": 1, "top": 2}

    @cached_property
    def _surface(self) -> ClosedSurface:
        return base_surfaces.cylinder(self.radius, self.length)

    @property
    def volume(self) -> float:
        """Volume π R² L [µm³]; Source: Archimedes."""
        return float(np.pi * self.radius**2 * self.length)

    def _exact(self, points: np.ndarray) -> np.ndarray:
        away = lengths(points * [1.0, 1.0, 0.0])
        side = away > base_surfaces.INSCRIBED * self.radius
        exact = points.copy()
        exact[side, :2] *= (self.radius / away[side])[:, None]
        return exact
