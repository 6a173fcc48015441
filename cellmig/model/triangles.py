"""Means over triangles of functions of a gap, exact where the gap is linear: adhesion of flat triangles.

The mean of U over a triangle whose corners have the gaps a ≤ b ≤ c is 2 F[a, b, c], the second divided difference of
the second primitive F of U.  Its derivatives by the gaps are 2 F[a, a, b, c] and so on.
Source: the formula of Hermite and Genocchi for divided differences (Hermite, 1878; de Boor, 2005).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from numpy import maximum, minimum, sqrt, where

from ..case.pointwise import either
from .adhesion import GAUSS, GAUSS_OF_VERTEX, NARROW, SegmentBonds, knot_near
from .protocols import ProtrusionLaw, SurfaceBonds

FLAT = 0.02  # change of the gap over a triangle, over the gap itself, below which divided differences cancel [-]
NEAR = 0.01  # the same of two corners [-]
NARROWLY = 1e-3  # change of a gap over which U'' is a difference of slopes, over the gap [-]
_NEAR_MIDDLE, _NEAR_CORNER = (6.0 + sqrt(15.0)) / 21.0, (6.0 - sqrt(15.0)) / 21.0
# Shares of three corners and weights of seven points, of order 5.  Source: Radon (1948).
RADON = ((1 / 3, 1 / 3, 1 / 3, 9 / 40), *(
    (*(1.0 - 2.0 * at if k == corner else at for k in range(3)), weight)
    for at, weight in ((float(_NEAR_CORNER), float((155.0 - sqrt(15.0)) / 1200.0)),
                       (float(_NEAR_MIDDLE), float((155.0 + sqrt(15.0)) / 1200.0))) for corner in range(3)))


class TriangleMean(ABC):
    """The mean of a function over a triangle on which its argument, a gap, is linear.

    Subclasses have the function as `value`, its primitives, its `scale` and the place where it is not smooth.
    """

    @abstractmethod
    def value(self, gap):
        """The function, in its unit."""

    @abstractmethod
    def primitive(self, gap):
        """Its primitive [its unit times µm]."""

    @abstractmethod
    def second_primitive(self, gap):
        """The primitive of that [its unit times µm²]."""

    @abstractmethod
    def scale(self, least):
        """Length over which the function changes, at a gap `least` and above [µm]."""

    @abstractmethod
    def knot(self, middle):
        """The gap near `middle` where a derivative jumps [µm]."""

    def average(self, gap1, gap2, gap3):
        """The mean, in the unit of the function."""
        a, b, c = self.sorted(gap1, gap2, gap3)
        flat = c - a < FLAT * self.scale(a)
        mean, = either(flat, self.by_levels(a, b, c), self.by_differences(a, b, where(flat, c + 1.0, c))[:1])
        return mean

    def kind(self, gap1, gap2, gap3):
        """Which way that goes, from 0 to 3 [-]: means of one kind are computed together."""
        a, b, c = self.sorted(gap1, gap2, gap3)
        knot = self.knot(0.5 * (a + c))
        flat = where((knot - a) * (c - knot) > 0.0, 3.0, 2.0)
        pairs = where(self.apart(a, b), where(self.apart(b, c), 0.0, 1.0), 1.0)
        return where(c - a < FLAT * self.scale(a), flat, pairs)

    def sorted(self, gap1, gap2, gap3):
        """Three gaps from the least to the largest [µm]."""
        low, high = minimum(gap1, gap2), maximum(gap1, gap2)
        return minimum(low, gap3), maximum(low, minimum(high, gap3)), maximum(high, gap3)

    def by_differences(self, a, b, c):
        """The mean and its derivatives by the gaps a ≤ b ≤ c, of which a and c are not near each other, in any unit."""
        return self.of_pairs(self.pair(a, b), self.pair(b, c), c - a)

    def of_pairs(self, lower, upper, span):
        """The same by the divided differences of a and b, and of b and c; `span` : c - a [µm]."""
        (below, left, right), (above, after, last) = lower, upper
        middle = (above - below) / span
        scale = 2.0 / span
        return 2.0 * middle, scale * (middle - left), scale * (after - right), scale * (last - middle)

    def pair(self, x, y):
        """Divided differences F[x, y], F[x, x, y] and F[x, y, y] of the second primitive, in any unit."""
        change, apart = y - x, self.apart(x, y)
        return either(apart, self.differences(x, y, where(apart, change, 1.0)), self.near(x, change, self.primitive(x)))

    def apart(self, x, y):
        """Whether divided differences of the gaps x ≤ y [µm] do not cancel."""
        return y - x > NEAR * self.scale(x)

    def differences(self, x, y, change):
        """Divided differences of gaps that are not near each other, as `pair`, in any unit."""
        mean = (self.second_primitive(y) - self.second_primitive(x)) / change
        return mean, (mean - self.primitive(x)) / change, (self.primitive(y) - mean) / change

    def near(self, x, change, start):
        """The same for gaps that are near each other, by quadrature, in any unit; `start` is the primitive at x."""
        left, right = 0.0, 0.0
        for at, weight in self.points(x, change, GAUSS):
            value = weight * self.value(x + at * change)
            left, right = left + (1.0 - at) * value, right + at * value
        return start + change * left, left, right

    def points(self, x, change, rule):
        """Places [-] and weights [-] of a rule between two gaps, in two parts where the knot is between them."""
        part = minimum(maximum((self.knot(x + 0.5 * change) - x) / where(change > 0.0, change, 1.0), 0.0), 1.0)
        rest = 1.0 - part
        return [(part * at, part * weight) for at, weight in rule] + [
            (part + rest * at, rest * weight) for at, weight in rule]

    def by_levels(self, a, b, c):
        """The mean where the gaps are near each other, weighted by the lengths of the level lines, in any unit."""
        part, below, above = self.parts(a, b, c)
        mean = 0.0
        for at, weight in self.points(a, below, GAUSS):
            mean = mean + 2.0 * part * weight * at * self.value(a + at * below)
        for at, weight in self.points(b, above, GAUSS):
            mean = mean + 2.0 * (1.0 - part) * weight * (1.0 - at) * self.value(b + at * above)
        return (mean,)

    def parts(self, a, b, c):
        """Share of the triangle below the level of b [-], and the changes of the gap below and above it [µm]."""
        span = c - a
        return (b - a) / where(span > 0.0, span, 1.0), b - a, c - b


@dataclass(frozen=True)
class TriangleBonds(TriangleMean):
    """The potential U of a bond, averaged over a flat triangle above a plane.

    law : of adhesion, as Seifert is.
    """

    law: SurfaceBonds

    def value(self, gap):
        """Energy of a bond [pN µm]."""
        return self.law.potential(gap)

    def primitive(self, gap):
        """Its primitive [pN µm²]."""
        return self.law.primitive(gap)

    def second_primitive(self, gap):
        """The primitive of that [pN µm³]."""
        return self.law.second_primitive(gap)

    def scale(self, least):
        """The least gap [µm], or that below which the potential is quadratic."""
        return maximum(least, self.law.cap)

    def knot(self, middle):
        """That of cap, equilibrium distance and cutoff which is nearest [µm]."""
        return knot_near(self.law, middle)

    def mean(self, gap1, gap2, gap3):
        """Mean energy of a bond [pN µm] and its derivatives by the gaps [pN]."""
        a, b, c = self.sorted(gap1, gap2, gap3)
        flat = c - a < FLAT * self.scale(a)
        mean, by_a, by_b, by_c = either(flat, self.of_flat(a, b, c), self.by_differences(a, b, where(flat, c + 1.0, c)))
        return mean, *self.unsorted((gap1, gap2, gap3), a, c, by_a, by_b, by_c)

    def unsorted(self, gaps, a, c, by_a, by_b, by_c):
        """Derivatives by three gaps, of which a is the least and c the largest, in their order [pN]."""
        return [where(gap <= a, by_a, where(gap >= c, by_c, by_b)) for gap in gaps]

    def of_flat(self, a, b, c):
        """The mean and its derivatives where the gaps are near each other [pN µm], [pN]."""
        knot = self.knot(0.5 * (a + c))
        return either((knot - a) * (c - knot) > 0.0, self.across_knot(a, b, c), self.by_points(a, b, c))

    def by_points(self, a, b, c):
        """The same by seven points [pN µm], [pN]."""
        mean, by_a, by_b, by_c = 0.0, 0.0, 0.0, 0.0
        for at_a, at_b, at_c, weight in RADON:
            gap = a + at_b * (b - a) + at_c * (c - a)
            slope = weight * self.law.slope(gap)
            mean = mean + weight * self.law.potential(gap)
            by_a, by_b, by_c = by_a + at_a * slope, by_b + at_b * slope, by_c + at_c * slope
        return mean, by_a, by_b, by_c

    def across_knot(self, a, b, c):
        """The same along the gap, in parts between which a derivative of the potential jumps [pN µm], [pN]."""
        part, below, above = self.parts(a, b, c)
        mean, by_a, by_b, by_c = 0.0, 0.0, 0.0, 0.0
        for at, weight in self.points(a, below, GAUSS_OF_VERTEX):
            size, gap = 2.0 * part * weight * at, a + at * below
            slope = size * self.law.slope(gap)
            mean = mean + size * self.law.potential(gap)
            by_b, by_c = by_b + 0.5 * at * slope, by_c + 0.5 * part * at * slope
            by_a = by_a + (1.0 - 0.5 * at * (1.0 + part)) * slope
        rest = 1.0 - part
        for at, weight in self.points(b, above, GAUSS_OF_VERTEX):
            size, gap = 2.0 * rest * weight * (1.0 - at), b + at * above
            slope = size * self.law.slope(gap)
            mean = mean + size * self.law.potential(gap)
            by_a, by_b = by_a + 0.5 * rest * (1.0 - at) * slope, by_b + 0.5 * (1.0 - at) * slope
            by_c = by_c + (1.0 - 0.5 * (1.0 - at) * (1.0 + rest)) * slope
        return mean, by_a, by_b, by_c

    def tangent(self, gap1, gap2, gap3):
        """Second derivatives of the mean by the gaps: 11, 22, 33, 23, 31 and 12 [pN/µm]."""
        gaps = gap1, gap2, gap3
        a, b, c = self.sorted(*gaps)
        flat = c - a < FLAT * self.scale(a)
        aa, bb, cc, bc, ca, ab = either(flat, self.bent_flat(a, b, c), self.bent(a, b, where(flat, c + 1.0, c)))
        return (*self.unsorted(gaps, a, c, aa, bb, cc), *self.unsorted(gaps, a, c, bc, ca, ab))

    def bent(self, a, b, c):
        """The same by the gaps a ≤ b ≤ c, of which a and c are not near each other: aa, bb, cc, bc, ca, ab [pN/µm]."""
        span = c - a
        (below, left, right), (above, after, last) = self.pair(a, b), self.pair(b, c)
        (aaab, aabb, abbb), (bbbc, bbcc, bccc) = self.triple(a, b, left, right), self.triple(b, c, after, last)
        middle = (above - below) / span
        aabc, abbc, abcc = (middle - left) / span, (after - right) / span, (last - middle) / span
        twice, once = 4.0 / span, 2.0 / span
        return (twice * (aabc - aaab), twice * (bbbc - abbb), twice * (bccc - abcc),
                once * (bbcc - abbc), once * (abcc - aabc), once * (abbc - aabb))

    def triple(self, x, y, left, right):
        """F[x, x, x, y], F[x, x, y, y] and F[x, y, y, y] by F[x, x, y] and F[x, y, y], `left` and `right` [pN]."""
        change, apart = y - x, self.apart(x, y)
        over = 1.0 / where(apart, change, 1.0)
        start, end = 0.5 * self.value(x), 0.5 * self.value(y)
        return either(apart, ((left - start) * over, (right - left) * over, (end - right) * over),
                      self.triple_near(x, change))

    def triple_near(self, x, change):
        """The same by quadrature [pN]."""
        first, both, last = 0.0, 0.0, 0.0
        for at, weight in self.points(x, change, GAUSS):
            slope, rest = weight * self.law.slope(x + at * change), 1.0 - at
            first, both = first + 0.5 * rest * rest * slope, both + rest * at * slope
            last = last + 0.5 * at * at * slope
        return first, both, last

    def bent_flat(self, a, b, c):
        """As `bent` where the gaps are near each other, by seven points [pN/µm]."""
        aa, bb, cc, bc, ca, ab = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for at_a, at_b, at_c, weight in RADON:
            bend = weight * self.bend(a + at_b * (b - a) + at_c * (c - a))
            aa, bb, cc = aa + at_a * at_a * bend, bb + at_b * at_b * bend, cc + at_c * at_c * bend
            bc, ca, ab = bc + at_b * at_c * bend, ca + at_c * at_a * bend, ab + at_a * at_b * bend
        return aa, bb, cc, bc, ca, ab

    def bend(self, gap):
        """U'' as a difference of slopes [pN/µm]."""
        half = NARROWLY * self.scale(gap)
        return (self.law.slope(gap + half) - self.law.slope(gap - half)) / (2.0 * half)

    def curvature(self, gap1, gap2, gap3):
        """Mean of U'' over the triangle, where it is positive, over a slightly wider range of gaps [pN/µm]."""
        a, b, c = self.sorted(gap1, gap2, gap3)
        found, = either(a < self.soft, self.secant(a, b, c), (0.0,))
        return found

    def curvature_of(self, gap1, gap2, gap3):
        """The same without choices [pN/µm]."""
        a, b, c = self.sorted(gap1, gap2, gap3)
        found, = self.secant(a, b, c)
        return where(a < self.soft, found, 0.0)

    def secant(self, a, b, c):
        """Twice the second divided difference of U over a slightly wider range than the gaps a ≤ b ≤ c [pN/µm].

        U goes on straight beyond the gap `soft`.
        """
        wide = NARROW * self.scale(a)
        a, c = a - wide, c + wide
        first, second, third = self.stretched(a), self.stretched(b), self.stretched(c)
        return (2.0 * ((third - second) / (c - b) - (second - first) / (b - a)) / (c - a),)

    def stretched(self, gap):
        """U up to the gap `soft`, straight from there on [pN µm]."""
        near = minimum(gap, self.soft)
        return self.law.potential(near) + (gap - near) * self.law.slope(near)

    @property
    def soft(self) -> float:
        """Gap beyond which bonds pull each other closed, U'' < 0 [µm]."""
        return SegmentBonds(self.law).soft

    def closed(self, gap1, gap2, gap3):
        """Mean energy over the depth of the well [-]: 1 where all bonds are closed, 0 or less where none is."""
        return -self.average(gap1, gap2, gap3) / self.depth

    @property
    def depth(self) -> float:
        """Energy of a closed bond [pN µm]; infinite where there are none, so that none is closed."""
        return SegmentBonds(self.law).depth

    def share(self, area, stored):
        """Share of closed bonds [-] over an area [µm²] where half of them have the energy `stored` [pN µm]."""
        return minimum(maximum(-stored / (0.5 * area * self.law.bond_density * self.depth), 0.0), 1.0)


@dataclass(frozen=True)
class RampSlope(TriangleMean):
    """The slope of the ramp of a protrusion, averaged over a flat triangle above a plane.

    law : of protrusion, as EdgeProtrusion is.
    """

    law: ProtrusionLaw

    def value(self, gap):
        """Slope of the ramp [1/µm]."""
        return self.law.ramp_slope(gap)

    def primitive(self, gap):
        """The ramp [-]."""
        return self.law.ramp(gap)

    def second_primitive(self, gap):
        """Its primitive [µm]."""
        return self.law.ramp_primitive(gap)

    def scale(self, least):
        """The height of the pushing edge [µm]."""
        return self.law.height + 0.0 * least

    def knot(self, middle):
        """The lower or the upper end of the ramp [µm]."""
        return where(middle < 0.5 * self.law.height, 0.0, self.law.height)
