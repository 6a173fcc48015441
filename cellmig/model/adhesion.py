"""Adhesion along segments of surfaces: to the substrate, and between cells."""

from __future__ import annotations

from dataclasses import dataclass

from numpy import maximum, minimum, sqrt, where

from ..case.pointwise import Vector, either
from .protocols import Adhesion

GAUSS = ((0.11270166537925831, 5 / 18), (0.5, 8 / 18), (0.8872983346207417, 5 / 18))  # of order 5, on 0 to 1
SLOPED = 0.05  # change of the gap over the gap itself, above which the primitive of the potential is exact enough


@dataclass(frozen=True)
class SegmentBonds:
    """The potential U of a bond, averaged over a segment whose gap goes linearly from gap1 to gap2.

    law : of adhesion, as Seifert is.
    """

    law: Adhesion

    def mean(self, gap1, gap2):
        """Mean energy of a bond [pN µm] and its derivatives by both gaps [pN]."""
        least = where(gap1 < gap2, gap1, gap2)
        sloped = abs(gap2 - gap1) > SLOPED * where(least > self.law.cap, least, self.law.cap)
        return either(sloped, self.by_primitive(gap1, where(sloped, gap2, gap1 + 1.0)), self.by_quadrature(gap1, gap2))

    def by_primitive(self, gap1, gap2):
        """The mean as the change of the primitive of U over that of the gap, exact [pN µm], [pN]."""
        change = gap2 - gap1
        mean = (self.law.primitive(gap2) - self.law.primitive(gap1)) / change
        return mean, (mean - self.law.potential(gap1)) / change, (self.law.potential(gap2) - mean) / change

    def by_quadrature(self, gap1, gap2):
        """The mean by three Gauss points, where the gap hardly changes: the primitives cancel [pN µm], [pN]."""
        change = gap2 - gap1
        mean, by_gap1, by_gap2 = 0.0, 0.0, 0.0
        for at, weight in GAUSS:
            gap = gap1 + at * change
            slope = weight * self.law.slope(gap)
            mean = mean + weight * self.law.potential(gap)
            by_gap1 = by_gap1 + slope * (1.0 - at)
            by_gap2 = by_gap2 + slope * at
        return mean, by_gap1, by_gap2

    def closed(self, gap1, gap2):
        """Mean energy over the depth of the well [-]: 1 where all bonds are closed, 0 or less where none is."""
        mean, _, _ = self.mean(gap1, gap2)
        return -mean / self.depth

    @property
    def depth(self) -> float:
        """Energy of a closed bond [pN µm]; infinite where there are none, so that none is closed."""
        return self.law.work / self.law.bond_density if self.law.work else float("inf")


@dataclass(frozen=True)
class SubstrateAdhesion:
    """F_cs of equation (2): bonds of a segment to the plane y = 0, N of them per reference area.

    bonds : SegmentBonds.
    """

    bonds: SegmentBonds

    def segment(self, length, gap1, gap2, dt):
        """Forces on both ends [pN/µm], energy [pN] and impulses along y of a time dt [pN µs/µm]; length in µm."""
        mean, by_gap1, by_gap2 = self.bonds.mean(gap1, gap2)
        size = self.bonds.law.bond_density * length
        force = (0.0, -(size * by_gap1)), (0.0, -(size * by_gap2))
        return force, size * mean, (-(dt * size * by_gap1), -(dt * size * by_gap2))

    def force(self, length, gap1, gap2):
        """Forces on both ends [pN/µm]."""
        return self.segment(length, gap1, gap2, 0.0)[0]


@dataclass(frozen=True)
class CellAdhesion:
    """F_cc of equation (2): bonds of a segment to another cell's surface, half of them from either side.

    bonds : SegmentBonds.
    """

    bonds: SegmentBonds

    def closest(self, point: Vector, start: Vector, end: Vector):
        """Of the segment from start to end [µm] the place nearest to a point: its share of the way [-], the vector from
        there to the point [µm] and its square [µm²].
        """
        x, y = point
        (x1, y1), (x2, y2) = start, end
        ex, ey, px, py = x2 - x1, y2 - y1, x - x1, y - y1
        share = minimum(maximum((px * ex + py * ey) / (ex * ex + ey * ey), 0.0), 1.0)
        dx, dy = px - share * ex, py - share * ey
        return share, (dx, dy), dx * dx + dy * dy

    def gap(self, side, away: Vector, square):
        """Gap [µm], < 0 inside the other cell, where `side` is -1 instead of 1; its gradient, the unit normal [-]."""
        (dx, dy), distance = away, sqrt(square)
        return side * distance, (side * dx / distance, side * dy / distance)

    def segment(self, length, gap1, gap2):
        """Forces on both ends along their normals [pN/µm], and energy [pN]; length in µm."""
        mean, by_gap1, by_gap2 = self.bonds.mean(gap1, gap2)
        size = 0.5 * self.bonds.law.bond_density * length
        return (-(size * by_gap1), -(size * by_gap2)), size * mean

    def spread(self, size, normal: Vector, share):
        """A force along the normal on a particle, and its opposite on the ends of the segment closest to it [pN/µm]."""
        nx, ny = normal
        x, y = size * nx, size * ny
        return (x, y), ((share - 1.0) * x, (share - 1.0) * y), (-share * x, -share * y)

    def force(self, length, side1, side2, x: tuple):
        """Forces [pN/µm] on six particles at x [µm]: an end of a segment, both ends of that closest to it; the same of
        the other end.
        """
        share1, away1, square1 = self.closest(*x[:3])
        share2, away2, square2 = self.closest(*x[3:])
        gap1, normal1 = self.gap(side1, away1, square1)
        gap2, normal2 = self.gap(side2, away2, square2)
        (size1, size2), _ = self.segment(length, gap1, gap2)
        return (*self.spread(size1, normal1, share1), *self.spread(size2, normal2, share2))
