"""Forces on the corners of the triangles of a surface in space, by the substrate z = 0 and by the cortex."""

from __future__ import annotations

from dataclasses import dataclass

from numpy import maximum, minimum, sqrt

from ..case.pointwise import Vector, Vector3
from .protocols import Cortex, Friction, ProtrusionLaw
from .tensors import cross, dot
from .triangles import RampSlope, TriangleBonds

CORNERS = 3
TINY = 1e-30  # square of a speed or of an area, beside which those of a cell are large [µm²/µs², µm⁴]


@dataclass(frozen=True)
class TriangleAdhesion:
    """F_cs of equation (2) in space: bonds of a triangle to the plane z = 0, N of them per reference area.

    bonds : TriangleBonds.
    """

    bonds: TriangleBonds

    def facet(self, area, gap1, gap2, gap3):
        """Forces on three corners along z [pN] and energy [pN µm]; area in µm²."""
        mean, *by_gaps = self.bonds.mean(gap1, gap2, gap3)
        size = self.bonds.law.bond_density * area
        return tuple(-(size * slope) for slope in by_gaps), size * mean

    def kind(self, gap1, gap2, gap3):
        """Which way that goes [-]."""
        return self.bonds.kind(gap1, gap2, gap3)

    def force(self, area, gap1, gap2, gap3):
        """Forces on three corners [pN]."""
        return tuple((0.0, 0.0, along) for along in self.facet(area, gap1, gap2, gap3)[0])

    def energy(self, area, gap1, gap2, gap3):
        """Energy [pN µm]."""
        return self.facet(area, gap1, gap2, gap3)[1]

    def stiffness(self, area, gap1, gap2, gap3):
        """Bound of the row sums of the tangent where levers are 1 [pN/µm]."""
        return self.bonds.law.bond_density * area * self.bonds.curvature(gap1, gap2, gap3)


@dataclass(frozen=True)
class CortexTension:
    """Tension of a triangle, of which `edge1` and `edge2` go from its first corner to the others [µm].

    The energy per reference area is that of the law at the stretch of the area; line tension, in pN/µm, is in space the
    energy per current area.  Source: the law of Young (1805) and Laplace.

    law : of the cortex, as LineTension is.
    """

    law: Cortex

    def force(self, area, edge1: Vector3, edge2: Vector3):
        """Forces on three corners [pN]; `area` at rest [µm²]."""
        normal, size = self.normal(edge1, edge2)
        tension = 0.5 * self.law.tension(0.5 * size / area) / size
        second, third = cross(edge2, normal), cross(normal, edge1)
        second, third = (tuple(-(tension * x) for x in v) for v in (second, third))
        return tuple(-(x + y) for x, y in zip(second, third, strict=True)), second, third

    def energy(self, area, edge1: Vector3, edge2: Vector3):
        """Energy [pN µm]."""
        _, size = self.normal(edge1, edge2)
        return area * self.law.energy(0.5 * size / area)

    def normal(self, edge1: Vector3, edge2: Vector3):
        """The normal, as long as twice the area, and this length [µm²]."""
        normal = cross(edge1, edge2)
        return normal, sqrt(dot(normal, normal) + TINY)


@dataclass(frozen=True)
class SlidingFriction:
    """Drag of the closed bonds of a triangle, a third of it on each corner, against its velocity along the plane.

    law : of friction, as BondFriction is;  bonds : TriangleBonds of the substrate.
    """

    law: Friction
    bonds: TriangleBonds

    def force(self, area, gap1, gap2, gap3, velocity1: Vector, velocity2: Vector, velocity3: Vector):
        """Forces on three corners [pN] for their velocities along the substrate [µm/µs]; µm² and µm."""
        share = minimum(maximum(self.bonds.closed(gap1, gap2, gap3), 0.0), 1.0)
        return tuple(self.drag(area / CORNERS, share, v) for v in (velocity1, velocity2, velocity3))

    def drag(self, area, share, velocity: Vector):
        """Force [pN] on an area [µm²] with a share of closed bonds [-]."""
        vx, vy = velocity
        speed = sqrt(vx * vx + vy * vy + TINY)
        drag = -(area * self.law.drag(share, speed) / speed)
        return drag * vx, drag * vy, 0.0


@dataclass(frozen=True)
class SurfaceSliding:
    r"""Drag of the closed bonds between a triangle T and the faces of another surface, half of them from either side.

    A point x of T is over a face with corners a_k, at its shares s_k of these and at the gap g.  It slides at the
    velocity w = Σ a_k ds_k/dt, at which its closest point moves through the material of the face, so that bodies that
    move as one do not slide: w = P (v - Σ s_k v_k) + g Σ (n·v_k) ∇s_k, with P = 1 - n nᵀ.  The traction T(w) has the
    power T·w = Σ f·v, with f = T on x and f_k = -s_k T + g (T·∇s_k) n on the corners of the face, so that forces and
    moments are in balance to rounding.  The part of T over a face drags as a whole, at its centre.  Bonds beside edges
    and vertices do not drag: their area is the gap times the turn of the surface there.

    Source: derived here.

    law : of friction, as BondFriction is;  bonds : TriangleBonds of the two bodies.
    """

    law: Friction
    bonds: TriangleBonds

    def drag(self, area, stored, velocity: Vector3):
        """Force on a part of T [pN], of a reference area [µm²], for its velocity w [µm/µs].

        stored : the energy of its bonds, half of them [pN µm].
        """
        share = self.bonds.share(area, stored)
        speed = sqrt(dot(velocity, velocity) + TINY)
        drag = -(0.5 * area * self.law.drag(share, speed) / speed)
        return tuple(drag * part for part in velocity)


@dataclass(frozen=True)
class SurfacePush:
    """Push of a cell off another body, such as a gel: of a triangle T of its surface over the faces of that.

    It is the push off the substrate, with the gap to the face as the height, and the bonds between both bodies.  On the
    cell it acts along the face, as much as that is along p̂; on the face it is opposite, with a couple, as of
    SurfaceSliding.  The part of T over a face pushes as a whole, at its centre; membrane beside edges and vertices does
    not.

    Source: derived here.

    law : of protrusion, as EdgeProtrusion is;  bonds : TriangleBonds of the two bodies.
    """

    law: ProtrusionLaw
    bonds: TriangleBonds

    def grip(self, area, stored, ahead):
        """Area of closed bonds [µm²] of a part of T, of a reference area [µm²], that counts to the front half.

        stored : the energy of its bonds, half of them [pN µm];  ahead : of the middle of the cell, along p̂ [µm].
        """
        return area * self.bonds.share(area, stored) * self.law.front(ahead)

    def hold(self, bonded):
        """Share of the push [-] for an area of closed bonds [µm²] under the front half, full from that of ℓ² on."""
        return self.law.hold(bonded / self.law.height)

    def edge(self, gap1, gap2, gap3):
        """Mean slope of the ramp [1/µm]."""
        return RampSlope(self.law).average(gap1, gap2, gap3)

    def force(self, size, hold, edge, ahead):
        """Push of a part of T along the face, over the share of p̂ along that [pN].

        size : β α N σ [pN/µm];  hold : see there;  edge : the area times the mean slope of the ramp [µm];
        ahead : of the middle of the cell, along p̂ [µm].
        """
        return size * hold * edge * self.law.front(ahead)


@dataclass(frozen=True)
class ProtrusionPush:
    """Push of a cell on a triangle of its surface along one direction, which is x in what follows.

    law : of protrusion, as EdgeProtrusion is;  bonds : TriangleBonds of the substrate.
    """

    law: ProtrusionLaw
    bonds: TriangleBonds

    def grip(self, area, ahead, gap1, gap2, gap3):
        """Area of closed bonds [µm²] that counts to the front half; `ahead` of the middle of the cell [µm]."""
        return maximum(self.bonds.closed(gap1, gap2, gap3), 0.0) * area * self.law.front(ahead)

    def grip_kind(self, gap1, gap2, gap3):
        """Which way that goes [-]."""
        return self.bonds.kind(gap1, gap2, gap3)

    def hold(self, bonded):
        """Share of the push [-] for an area of closed bonds [µm²] under the front half, full from that of ℓ² on."""
        return self.law.hold(bonded / self.law.height)

    def force(self, size: Vector3, hold, area, ahead: Vector3, gap: Vector3):
        """Forces on three corners along x [pN]; `size` : β α N σ/3 at these [pN/µm]; `ahead` and `gap` of them [µm];
        `hold` : see there.
        """
        share = hold * area * self.edge(*gap)
        return tuple((share * one * self.law.front(x), 0.0, 0.0) for one, x in zip(size, ahead, strict=True))

    def front(self, ahead):
        """Factor of the front half [-]; `ahead` of the middle of the cell [µm]."""
        return self.law.front(ahead)

    def edge(self, gap1, gap2, gap3):
        """Mean slope of the ramp [1/µm]."""
        return RampSlope(self.law).average(gap1, gap2, gap3)

    def kind(self, gap1, gap2, gap3):
        """Which way that goes [-]."""
        return RampSlope(self.law).kind(gap1, gap2, gap3)
