r"""Adhesion between cells in space: bonds of a triangle T to the outside of another surface B of triangles.

The energy is ½ N A ∫ Φ dA over T, of the reference area A, with the sum over all critical points of the distance from x

    Φ(x) = Σ_faces U(g) + Σ_edges ± U(d) + Σ_vertices i U(|x - v|).

A face counts where x is over it, on its outer side at the gap g.  An edge counts where x is between the normals of its
faces, with + if it is convex and - if it is reflex; a vertex with 1 less the number of arcs of its ring on the side of
x (Banchoff, 1970).  Φ and its gradient are continuous outside of B.  Derivatives of the limits of pieces cancel.
"""

from __future__ import annotations

from dataclasses import dataclass

from numpy import maximum, minimum, where

from ..case.pointwise import either
from .adhesion import GAUSS_OF_VERTEX
from .triangles import TriangleBonds


@dataclass(frozen=True)
class PolyhedronAdhesion:
    """F_cc of equation (2) in space, half of it from either side: what acts on pieces of T.

    Every piece gives loads at points of T, along the direction from the feature of B: positive loads pull T and B
    together.  Loads go to the corners of T and of the feature by their shares.

    bonds : TriangleBonds.
    """

    bonds: TriangleBonds

    def face(self, area, gap1, gap2, gap3):
        """Loads at the corners of a piece [pN], energy [pN µm], 1 where it may be stiff, else 0 [-]; its reference area
        in µm².
        """
        mean, by_gap1, by_gap2, by_gap3 = self.bonds.mean(gap1, gap2, gap3)
        size = 0.5 * self.bonds.law.bond_density * area
        stiff = self.may_be_stiff(minimum(minimum(gap1, gap2), gap3))
        return (size * by_gap1, size * by_gap2, size * by_gap3), size * mean, stiff

    def face_kind(self, gap1, gap2, gap3):
        """Which way that goes [-]."""
        return self.bonds.kind(gap1, gap2, gap3)

    def edge(self, width1, width2, distance1, distance2):
        """Loads at both ends of a line [pN], energy [pN µm], 1 where it may be stiff, else 0 [-].

        `width` : reference area for its length at the ends [µm²].  The distance from the edge goes linearly along it,
        so that this is exact.
        """
        size = 0.5 * self.bonds.law.bond_density
        ordered = distance1 < distance2
        x, y = where(ordered, distance1, distance2), where(ordered, distance2, distance1)
        start, end = where(ordered, width1, width2), where(ordered, width2, width1)
        left, right, first, both, last = self.moments(x, y)
        low, high = size * (start * first + end * both), size * (start * both + end * last)
        return ((where(ordered, low, high), where(ordered, high, low)), size * (start * left + end * right),
                self.may_be_stiff(x))

    def edge_kind(self, distance1, distance2):
        """Which way that goes, 0 or 1 [-]."""
        return where(self.bonds.apart(minimum(distance1, distance2), maximum(distance1, distance2)), 0.0, 1.0)

    def moments(self, x, y):
        """Integrals of (1 - t) U and t U [pN µm], of (1 - t)² U', t (1 - t) U' and t² U' [pN] for x + t (y - x)."""
        apart = self.bonds.apart(x, y)
        return either(apart, self.by_differences(x, where(apart, y, x + 1.0)), self.by_points(x, y - x))

    def by_differences(self, x, y):
        """The same by divided differences of the second primitive [pN µm], [pN]."""
        bonds, change = self.bonds, y - x
        mean = (bonds.second_primitive(y) - bonds.second_primitive(x)) / change
        left, right = (mean - bonds.primitive(x)) / change, (bonds.primitive(y) - mean) / change
        return (left, right, (2.0 * left - bonds.value(x)) / change, (right - left) / change,
                (bonds.value(y) - 2.0 * right) / change)

    def by_points(self, x, change):
        """The same by Gauss points, where the distance hardly changes [pN µm], [pN]."""
        left, right, first, both, last = 0.0, 0.0, 0.0, 0.0, 0.0
        for at, weight in self.bonds.points(x, change, GAUSS_OF_VERTEX):
            r, rest = x + at * change, 1.0 - at
            value, slope = weight * self.bonds.value(r), weight * self.bonds.law.slope(r)
            left, right = left + rest * value, right + at * value
            first, both, last = first + rest * rest * slope, both + rest * at * slope, last + at * at * slope
        return left, right, first, both, last

    def vertex(self, area, distance):
        """Load at a point [pN], energy [pN µm], 1 where it may be stiff, else 0 [-]; `area` : reference area of the
        point, with its sign [µm²].
        """
        size = 0.5 * self.bonds.law.bond_density * area
        return ((size * self.bonds.law.slope(distance),), size * self.bonds.law.potential(distance),
                self.may_be_stiff(distance))

    def may_be_stiff(self, least):
        """1 where bonds of the length `least` [µm] push each other apart, so that they have a stiffness, else 0 [-]."""
        return where(least < self.bonds.soft, 1.0, 0.0)

    def face_tangent(self, area, gap1, gap2, gap3):
        """Changes of the loads on a piece over a face with the gaps of its corners: 11, 22, 33, 23, 31, 12 [pN/µm]."""
        size = 0.5 * self.bonds.law.bond_density * area
        return (tuple(size * part for part in self.bonds.tangent(gap1, gap2, gap3)),)

    def edge_tangent(self, width1, width2, distance1, distance2):
        """The same of the loads at the ends of a line with the distances: 11, 12 and 22 [pN/µm]."""
        size = 0.5 * self.bonds.law.bond_density
        ordered = distance1 < distance2
        x, y = where(ordered, distance1, distance2), where(ordered, distance2, distance1)
        start, end = size * where(ordered, width1, width2), size * where(ordered, width2, width1)
        apart = self.bonds.apart(x, y)
        first, near, far, last = either(apart, self.bent(x, where(apart, y, x + 1.0)), self.bent_near(x, y - x))
        low, both, high = start * first + end * near, start * near + end * far, start * far + end * last
        return ((where(ordered, low, high), both, where(ordered, high, low)),)

    def bent(self, x, y):
        """Integrals of (1 - t)³ U'', t (1 - t)² U'', t² (1 - t) U'' and t³ U'' for x + t (y - x) [pN/µm]."""
        change, (_, _, first, both, last) = y - x, self.by_differences(x, y)
        return ((3.0 * first - self.bonds.law.slope(x)) / change, (2.0 * both - first) / change,
                (last - 2.0 * both) / change, (self.bonds.law.slope(y) - 3.0 * last) / change)

    def bent_near(self, x, change):
        """The same by Gauss points, where the distance hardly changes [pN/µm]."""
        first, near, far, last = 0.0, 0.0, 0.0, 0.0
        for at, weight in self.bonds.points(x, change, GAUSS_OF_VERTEX):
            bend, rest = weight * self.bonds.bend(x + at * change), 1.0 - at
            first, near = first + rest * rest * rest * bend, near + at * rest * rest * bend
            far, last = far + at * at * rest * bend, last + at * at * at * bend
        return first, near, far, last

    def vertex_tangent(self, area, distance):
        """The same of the load at a point with the distance [pN/µm]."""
        return ((0.5 * self.bonds.law.bond_density * area * self.bonds.bend(distance),),)

    def face_stiffness(self, area, gap1, gap2, gap3):
        """Bound of the row sums of the tangent of a piece over a face, where levers are 1 [pN/µm]."""
        return (self.bonds.law.bond_density * area * self.bonds.curvature_of(gap1, gap2, gap3),)

    def edge_stiffness(self, width1, width2, distance1, distance2):
        """The same of a line over a convex edge [pN/µm]."""
        size = 0.5 * self.bonds.law.bond_density * (width1 + width2)
        return (size * self.bonds.curvature_of(distance1, distance2, 0.5 * (distance1 + distance2)),)

    def vertex_stiffness(self, area, distance):
        """The same of a point over a vertex that adds energy [pN/µm]."""
        return (self.bonds.law.bond_density * area * self.bonds.curvature_of(distance, distance, distance),)
