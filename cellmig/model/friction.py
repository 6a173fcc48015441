"""Friction of closed bonds: an addition to the model of Bai, Lin & Zeng (2019), absent by default."""

from __future__ import annotations

from dataclasses import dataclass

from numpy import maximum, minimum, sqrt

from ..case.pointwise import Vector, between
from ..case.registry import law, quantity
from .adhesion import Pieces, SegmentBonds
from .protocols import Friction


@law("friction", "bonds")
class BondFriction:
    """Viscous drag t = c s v of a membrane on the substrate, with the share s of closed bonds and the sliding speed v.

    Source: derived here, as the friction of bonds that break and form again, linear in the speed.
    """

    coefficient: float = quantity("Pa us/um", "drag c of a fully bonded membrane, per reference area and speed",
                                  minimum=0)

    def drag(self, share, speed):
        """Traction t [Pa] against the motion; `share` of closed bonds s [-], `speed` along the substrate v [µm/µs]."""
        return self.coefficient * share * speed


@dataclass(frozen=True)
class FrictionForce:
    """Drag of the closed bonds of a segment, half of it on either end.

    law : of friction, as BondFriction is;  bonds : SegmentBonds of the substrate.
    """

    law: Friction
    bonds: SegmentBonds

    def force(self, length, gap1, gap2, speed1, speed2):
        """Forces on both ends [pN/µm] for their speeds along the substrate [µm/µs]; length and gaps in µm."""
        share = minimum(maximum(self.bonds.closed(gap1, gap2), 0.0), 1.0)
        return ((-(0.5 * length * self.law.drag(share, speed1)), 0.0),
                (-(0.5 * length * self.law.drag(share, speed2)), 0.0))


@dataclass(frozen=True)
class SurfaceFriction(Pieces):
    r"""Drag of the closed bonds between a segment S and the edges of another outline, half of them from either side.

    A point x of S is beside an edge e from a to b, at its share s = (x - a)·e/|e|² and at the gap g.  It slides at the
    speed w = |e| ds/dt, at which its closest point moves along the material of the edge: bodies that move as one do not
    slide.  The traction T(w) has the power -T w = Σ f·v with f = -T |e| ∂s/∂x on each of x, a and b: -T along the edge
    on x, and the opposite on the edge, with a couple T g.  So forces and moments are in balance to rounding.
    The bonds of S beside a vertex do not drag: their length is the gap times the turn of the outline there.

    Source: derived here.

    law : of friction, as BondFriction is;  bonds : SegmentBonds of the two bodies.
    """

    law: Friction
    bonds: SegmentBonds

    def force(self, length, low, high, end1: Vector, end2: Vector, start: Vector, end: Vector,
              velocity1: Vector, velocity2: Vector, start_velocity: Vector, end_velocity: Vector):
        """Forces on both ends of S and of the edge [pN/µm], and power that is lost [pN/µs], of the piece from ξ = low
        to high, half of it at either limit; reference length and places in µm, velocities in µm/µs.
        """
        ex, ey = between(start, end)
        span = 1.0 / sqrt(ex * ex + ey * ey)
        tx, ty = ex * span, ey * span
        limits = self.limits(low, high, (end1, end2), (start, end))
        share = minimum(maximum(self.bonds.closed(limits[0][2], limits[1][2]), 0.0), 1.0)
        size, turn = 0.25 * length * (high - low), between(start_velocity, end_velocity)
        forces: list = []
        loss = 0.0
        for xi, at, gap in limits:
            wx, wy = (u + xi * (w - u) - s - at * r for u, w, s, r in
                      zip(velocity1, velocity2, start_velocity, turn, strict=True))
            speed = tx * wx + ty * wy + gap * span * (ty * turn[0] - tx * turn[1])
            drag = size * self.law.drag(share, speed)
            forces, loss = [*forces, -drag], loss + drag * speed
        return self.opposed(limits, forces, (start, end)), loss
