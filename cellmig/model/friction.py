"""Friction on the substrate: an addition to the model of Bai, Lin & Zeng (2019), absent by default."""

from __future__ import annotations

from dataclasses import dataclass

from numpy import maximum, minimum

from ..case.registry import law, quantity
from .adhesion import SegmentBonds
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
