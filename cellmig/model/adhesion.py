"""Adhesion along segments of surfaces: to the substrate, and between cells."""

from __future__ import annotations

from dataclasses import dataclass

from numpy import argmax, geomspace, maximum, minimum, sqrt, where

from ..case.pointwise import Vector, between, either
from .protocols import Adhesion, ClosedAdhesion, Value

GAUSS = ((0.11270166537925831, 5 / 18), (0.5, 8 / 18), (0.8872983346207417, 5 / 18))  # of order 5, on 0 to 1
GAUSS_OF_VERTEX = ((0.06943184420297371, 0.17392742256872693), (0.33000947820757187, 0.32607257743127307),
                   (0.6699905217924281, 0.32607257743127307), (0.9305681557970263, 0.17392742256872693))  # of order 7
SHORT = 0.18  # length of a piece beside a vertex over its distance, for which these are exact to 1e-9 [-]
SLOPED = 0.05  # change of the gap over the gap itself, above which the primitive of the potential is exact enough
TINY = 1e-30  # square of a distance below which a vertex on a segment has no direction, and exerts no force [µm²]
NARROW = 0.01  # least change of a gap over which a curvature is a difference of slopes, over the gap [-]


def knot_near(law: Adhesion, gap):
    """That of cap, equilibrium distance and cutoff of bonds which is nearest to a gap [µm]: derivatives jump there."""
    return where(gap < 0.5 * (law.cap + law.equilibrium_distance), law.cap,
                 where(gap < 0.5 * (law.equilibrium_distance + law.cutoff), law.equilibrium_distance, law.cutoff))


@dataclass(frozen=True)
class SegmentBonds:
    """The potential U of a bond, averaged over a segment whose gap goes linearly from gap1 to gap2.

    law : of adhesion, as Seifert is.
    """

    law: Adhesion

    def mean(self, gap1, gap2):
        """Mean energy of a bond [pN µm] and its derivatives by both gaps [pN]."""
        return self.of_any(gap1, gap2)

    def of_any(self, gap1, gap2):
        """The mean for any potential and gaps [pN µm], [pN]."""
        least = where(gap1 < gap2, gap1, gap2)
        sloped = abs(gap2 - gap1) > SLOPED * where(least > self.law.cap, least, self.law.cap)
        return either(sloped, self.by_primitive(gap1, where(sloped, gap2, gap1 + 1.0)), self.by_quadrature(gap1, gap2))

    def by_primitive(self, gap1, gap2):
        """The mean as the change of the primitive of U over that of the gap, exact [pN µm], [pN]."""
        change = gap2 - gap1
        mean = (self.law.primitive(gap2) - self.law.primitive(gap1)) / change
        return mean, (mean - self.law.potential(gap1)) / change, (self.law.potential(gap2) - mean) / change

    def by_quadrature(self, gap1, gap2):
        """The same where the gap hardly changes, and primitives cancel, between jumps of derivatives [pN µm], [pN]."""
        knot = knot_near(self.law, 0.5 * (gap1 + gap2))
        across = (knot - gap1) * (gap2 - knot) > 0.0
        part = (knot - gap1) / where(across, gap2 - gap1, 1.0)
        below, above = self.by_points(gap1, gap2, 0.0, part), self.by_points(gap1, gap2, part, 1.0)
        return either(across, tuple(first + second for first, second in zip(below, above, strict=True)),
                      self.by_points(gap1, gap2, 0.0, 1.0))

    def by_points(self, gap1, gap2, start, end):
        """The part of the mean from ξ = `start` to `end` by three Gauss points [pN µm], [pN]."""
        change, width = gap2 - gap1, end - start
        mean, by_gap1, by_gap2 = 0.0, 0.0, 0.0
        for share, weight in GAUSS:
            at, size = start + width * share, width * weight
            gap = gap1 + at * change
            slope = size * self.law.slope(gap)
            mean = mean + size * self.law.potential(gap)
            by_gap1 = by_gap1 + slope * (1.0 - at)
            by_gap2 = by_gap2 + slope * at
        return mean, by_gap1, by_gap2

    def curvature(self, gap1, gap2):
        """Mean of U'' over the segment, where it is positive [pN/µm]."""
        least, most = minimum(gap1, gap2), maximum(gap1, gap2)
        top, wide = minimum(most, self.soft), NARROW * abs(least)
        found, = either(least < self.soft, self.secant(least, top, most, wide), (0.0,))
        return found

    @property
    def soft(self) -> float:
        """Gap beyond which bonds pull each other closed, U'' < 0, to 0.5 % [µm]; 1.29 ε of Seifert's."""
        gaps = geomspace(self.law.equilibrium_distance, self.law.cutoff, 1000)
        return float(gaps[argmax(self.law.slope(gaps))])

    def secant(self, least, top, most, wide):
        """Change of U' from the gap `least` to `top` over that from least to most, at least a little `wide` [pN/µm]."""
        change = self.law.slope(top + 0.5 * wide) - self.law.slope(least - 0.5 * wide)
        return (change / maximum(most - least, top - least + wide),)

    def closed(self, gap1, gap2):
        """Mean energy over the depth of the well [-]: 1 where all bonds are closed, 0 or less where none is."""
        mean, _, _ = self.mean(gap1, gap2)
        return -mean / self.depth

    @property
    def depth(self) -> float:
        """Energy of a closed bond [pN µm]; infinite where there are none, so that none is closed."""
        return self.law.work / self.law.bond_density if self.law.work else float("inf")


@dataclass(frozen=True)
class ClosedBonds(SegmentBonds):
    """The same for a law that has the mean in closed form for some gaps."""

    law: ClosedAdhesion

    def mean(self, gap1, gap2):
        """Mean energy of a bond [pN µm] and its derivatives by both gaps [pN]."""
        closed = self.law.closed_form(gap1, gap2) > 0.0
        return either(closed, self.law.mean(where(closed, gap1, self.law.equilibrium_distance),
                                            where(closed, gap2, self.law.equilibrium_distance)),
                      self.of_any(gap1, gap2))


def bonds_of(law: Adhesion) -> SegmentBonds:
    """The averages of a law of adhesion."""
    return ClosedBonds(law) if isinstance(law, ClosedAdhesion) else SegmentBonds(law)


@dataclass(frozen=True)
class SubstrateAdhesion:
    """F_cs of equation (2): bonds of a segment to the plane y = 0, N of them per reference area.

    bonds : SegmentBonds.
    """

    bonds: SegmentBonds

    def facet(self, length, gap1, gap2, dt):
        """Forces on both ends [pN/µm], energy [pN] and impulses along y of a time dt [pN µs/µm]; length in µm."""
        mean, by_gap1, by_gap2 = self.bonds.mean(gap1, gap2)
        size = self.bonds.law.bond_density * length
        force = (0.0, -(size * by_gap1)), (0.0, -(size * by_gap2))
        return force, size * mean, (-(dt * size * by_gap1), -(dt * size * by_gap2))

    def force(self, length, gap1, gap2):
        """Forces on both ends [pN/µm]."""
        return self.facet(length, gap1, gap2, 0.0)[0]

    def energy(self, length, gap1, gap2):
        """Energy [pN]."""
        return self.facet(length, gap1, gap2, 0.0)[1]


class Pieces:
    """Pieces of a segment S between two places, at ξ from 0 to 1, beside an edge and beside a vertex of an outline."""

    def beside(self, point: Vector, start: Vector, end: Vector):
        """Of a point the places along an edge and across it, outwards, times the length of the edge [µm²]."""
        ex, ey = between(start, end)
        px, py = between(start, point)
        return px * ex + py * ey, px * ey - py * ex

    def part(self, low, high, value1, value2):
        """The part of a range [low, high] where a value is positive that goes from value1 at 0 to value2 at 1 [-]."""
        change = value1 - value2
        zero = value1 / where(abs(change) > 0.0, change, 1.0)
        return (where(value1 < 0.0, where(value2 < 0.0, 1.0, maximum(low, zero)), low),
                where(value2 < 0.0, where(value1 < 0.0, 0.0, minimum(high, zero)), high))

    def pieces(self, x: tuple, within: Value):
        """Limits of the pieces of pairs of a segment and an edge that are nearer than a distance `within` [µm].

        x : places of both ends of S, both ends of the edge and the end of the next edge, two arrays each [µm].

        Returns
        -------
        low, high of the piece of the edge, low, high and sign of that of the vertex at its end [-]; a piece is empty if
        low ≥ high.
        """
        s1, s2, a, b, c = x
        ex, ey = between(a, b)
        qx, qy = between(b, c)
        next1, next2 = self.beside(s1, b, c)[0], self.beside(s2, b, c)[0]
        square, sign = ex * ex + ey * ey, where(ex * qy - ey * qx < 0.0, -1.0, 1.0)
        before1, before2 = square - self.beside(s1, a, b)[0], square - self.beside(s2, a, b)[0]
        low, high = self.piece(s1, s2, a, b, within)
        # What is on the border of an edge and the next belongs to the next.
        some = where(sign > 0.0, maximum(-next1, -next2), maximum(before1, before2))
        first, last = self.part(0.0, where(some > 0.0, 1.0, 0.0), -sign * before1, -sign * before2)
        first, last = self.part(first, last, -sign * next1, -sign * next2)
        foot, away = self.foot(s1, s2, b)
        dx, dy = between(s1, s2)
        reach = sqrt(maximum(within * within / (dx * dx + dy * dy) - away * away, 0.0))
        return low, high, maximum(first, foot - reach), minimum(last, foot + reach), sign

    def piece(self, end1: Vector, end2: Vector, start: Vector, end: Vector, within: Value):
        """Limits of the piece beside an edge that is nearer than a distance `within` [µm] [-]; see `pieces`."""
        ex, ey = between(start, end)
        along1, across1 = self.beside(end1, start, end)
        along2, across2 = self.beside(end2, start, end)
        square = ex * ex + ey * ey
        before1, before2, most = square - along1, square - along2, within * sqrt(square)
        low, high = self.part(0.0, where(maximum(before1, before2) > 0.0, 1.0, 0.0), along1, along2)
        for value1, value2 in ((before1, before2), (across1, across2), (most - across1, most - across2)):
            low, high = self.part(low, high, value1, value2)
        return low, high

    def limits(self, low, high, ends: tuple, edge: tuple):
        """Both limits of a piece of S beside an edge: the places on S and on the edge [-], and the gap [µm].

        ends, edge : places of both ends of S and of the edge, two vectors each [µm].
        """
        ex, ey = between(*edge)
        span, found = 1.0 / sqrt(ex * ex + ey * ey), []
        of_ends = [self.beside(x, *edge) for x in ends]
        for xi in (low, high):
            along, across = ((1.0 - xi) * a + xi * b for a, b in zip(*of_ends, strict=True))
            found.append((xi, along * span * span, across * span))
        return found

    def opposed(self, limits: list, forces: list, edge: tuple):
        """Forces on both ends of S and of an edge [pN/µm] of two `forces` [pN/µm] along the edge at the `limits` on S.

        The edge has the opposite, with a couple, so that they have neither a sum nor a moment.
        """
        ex, ey = between(*edge)
        span = 1.0 / sqrt(ex * ex + ey * ey)
        tx, ty = ex * span, ey * span
        first = second = tail = head = couple = 0.0
        for (xi, at, gap), f in zip(limits, forces, strict=True):
            first, second = first + (1.0 - xi) * f, second + xi * f
            tail, head, couple = tail - (1.0 - at) * f, head - at * f, couple - gap * span * f
        across = couple * ty, -(couple * tx)
        return ((first * tx, first * ty), (second * tx, second * ty),
                (tail * tx + across[0], tail * ty + across[1]), (head * tx - across[0], head * ty - across[1]))

    def foot(self, end1: Vector, end2: Vector, vertex: Vector):
        """Place ξ on the line of S nearest to a vertex, and its distance over the length of S [-]."""
        dx, dy = between(end1, end2)
        px, py = between(end1, vertex)
        square = dx * dx + dy * dy
        return (px * dx + py * dy) / square, abs(px * dy - py * dx) / square

    def short(self, start, foot, away):
        """End of a piece beside a vertex that begins at `start` and is short beside its distance [-]."""
        width = where(start < foot, SHORT / (1.0 + SHORT), SHORT)
        return start + width * sqrt(away * away + (start - foot) * (start - foot))


@dataclass(frozen=True)
class CellAdhesion(Pieces):
    r"""F_cc of equation (2): bonds of a segment S to the outside of another outline B, half of them from either side.

    The energy is ½ N L ∫ Φ dξ along S, x(ξ) = x1 + ξ (x2 - x1), L its reference length, with

        Φ(x) = Σ_edges U(g) + Σ_vertices ± U(|x - v|).

    An edge counts where x is beside it, on its outer side at the gap g.  A convex vertex adds the wedge between the
    normals of its edges; a reflex one subtracts the wedge in which both edges count.  Φ and its gradient are continuous
    outside of B, so that no closest feature has to be found, and none jumps.  Derivatives of the limits of pieces
    cancel between an edge and its vertices.

    Source: inclusion and exclusion of edges and vertices, derived here; in the spirit of the convergent potentials of
    Li et al. (2023).

    bonds : SegmentBonds.
    """

    bonds: SegmentBonds

    def edge(self, length, low, high, along: Vector, across: Vector, start: Vector, end: Vector):
        """Forces on both ends of S and of the edge [pN/µm], and energy [pN], of the piece from ξ = low to high.

        `along` and `across` are those of both ends of S [µm²]; `start` and `end` in µm.
        """
        ex, ey = between(start, end)
        span = 1.0 / sqrt(ex * ex + ey * ey)
        at1, at2 = self.at(low, high, along, span * span)
        gap1, gap2 = self.at(low, high, across, span)
        mean, by_gap1, by_gap2 = self.bonds.mean(gap1, gap2)
        size = 0.5 * self.bonds.law.bond_density * length * (high - low)
        f1, f2 = size * span * by_gap1, size * span * by_gap2
        s1, s2 = (low - 1.0) * f1 + (high - 1.0) * f2, -low * f1 - high * f2
        e1, e2 = (1.0 - at1) * f1 + (1.0 - at2) * f2, at1 * f1 + at2 * f2
        return ((s1 * ey, -s1 * ex), (s2 * ey, -s2 * ex), (e1 * ey, -e1 * ex), (e2 * ey, -e2 * ex)), size * mean

    def at(self, low, high, values: Vector, factor):
        """A value that is linear along S, times a factor [1/µm or 1/µm²], at both ends of a piece [-] or [µm]."""
        first, last = values
        return (first + low * (last - first)) * factor, (first + high * (last - first)) * factor

    def edge_stiffness(self, length, low, high, across: Vector, start: Vector, end: Vector):
        """Bound of the row sums of the tangent of that piece, where levers are 1 [Pa]."""
        ex, ey = between(start, end)
        gap1, gap2 = self.at(low, high, across, 1.0 / sqrt(ex * ex + ey * ey))
        return self.bonds.law.bond_density * length * (high - low) * self.bonds.curvature(gap1, gap2)

    def vertex(self, length, low, high, end1: Vector, end2: Vector):
        """Forces on both ends of S and on the vertex [pN/µm], and energy [pN], of the piece from ξ = low to high.

        `length` [µm] has the sign of the vertex; `end1` and `end2` are the ends of S from there [µm].
        """
        points = [(weight * (high - low) * length, low + at * (high - low)) for at, weight in GAUSS_OF_VERTEX]
        fx1, fy1, fx2, fy2 = (sum(parts) for parts in zip(*(self.vertex_force(*point, end1, end2) for point in points),
                                                          strict=True))
        energy = sum(self.vertex_energy(*point, end1, end2) for point in points)
        return ((fx1, fy1), (fx2, fy2), (-fx1 - fx2, -fy1 - fy2)), energy

    def vertex_force(self, length, share, end1: Vector, end2: Vector):
        """Forces on the first and on the second end of S [pN/µm] of a length at ξ = share."""
        x, y, r = self.from_vertex(share, end1, end2)
        pull = -(0.5 * self.bonds.law.bond_density * length) * self.bonds.law.slope(r) / r
        fx, fy = pull * x, pull * y
        return fx - share * fx, fy - share * fy, share * fx, share * fy

    def vertex_energy(self, length, share, end1: Vector, end2: Vector):
        """Energy [pN] of a length at ξ = share."""
        _, _, r = self.from_vertex(share, end1, end2)
        return 0.5 * self.bonds.law.bond_density * length * self.bonds.law.potential(r)

    def from_vertex(self, share, end1: Vector, end2: Vector):
        """Place of ξ = share from a vertex, and its distance [µm]."""
        x1, y1 = end1
        dx, dy = between(end1, end2)
        x, y = x1 + share * dx, y1 + share * dy
        return x, y, sqrt(x * x + y * y + TINY)

    def vertex_stiffness(self, length, low, high, end1: Vector, end2: Vector):
        """Bound of the row sums of the tangent of that piece, where levers are 1 [Pa]."""
        _, _, first = self.from_vertex(low, end1, end2)
        _, _, last = self.from_vertex(high, end1, end2)
        return self.bonds.law.bond_density * length * (high - low) * self.bonds.curvature(first, last)
