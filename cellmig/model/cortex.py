"""Tension of the cell cortex: an addition to the model of Bai, Lin & Zeng (2019), absent by default."""

from __future__ import annotations

from dataclasses import dataclass

from numpy import sqrt

from ..case.pointwise import Vector
from ..case.registry import law, quantity
from .protocols import Cortex


@law("cortex", "line-tension")
class LineTension:
    """Constant tension T of the surface [pN/µm], as of a liquid: T is the energy per current length, in space area.

    A disc of radius R is under the pressure p = T/R, a ball under 2 T/R.  Neutrophils have about 30 pN/µm (Hochmuth,
    2000, J. Biomech. 33:15-22).  Source: the law of Young (1805) and Laplace.
    """

    line_tension: float = quantity("pN/um", "tension T of the surface", minimum=0)

    def energy(self, stretch):
        """Energy per reference length [pN/µm]; `stretch` is the current over the reference length [-]."""
        return self.line_tension * stretch

    def tension(self, stretch):
        """Tension [pN/µm], the derivative of the energy by the stretch [-]."""
        return self.line_tension + 0.0 * stretch


@law("cortex", "elastic")
class ElasticTension:
    """Tension T + K (s - 1) of a surface stretched s-fold [pN/µm]: that of a membrane with a reserve of folds.

    Cells that flow need the modulus K.  Bonds belong to the membrane, they pull it down, not along: at the edge of the
    contact the tension falls by the work of adhesion, from outside to inside, and a membrane of the same tension
    everywhere would gather in the contact without an end.  With K well above the work of adhesion, the angle of contact
    is that of Young and Dupré, with the tension outside.

    Neutrophils have T = 24 pN/µm and K = 39 pN/µm up to a stretch by half of the area, and a far larger K where the
    reserve is used up.  Source: Needham & Hochmuth (1992), Biophys. J. 61:1664-1670.
    """

    line_tension: float = quantity("pN/um", "tension T of the surface at its reference length", minimum=0)
    area_modulus: float = quantity("pN/um", "modulus K: tension over strain of the surface", above=0)

    def energy(self, stretch):
        """Energy per reference length [pN/µm]; `stretch` is the current over the reference length [-]."""
        strain = stretch - 1.0
        return self.line_tension * stretch + 0.5 * self.area_modulus * strain * strain

    def tension(self, stretch):
        """Tension [pN/µm], the derivative of the energy by the stretch [-]."""
        return self.line_tension + self.area_modulus * (stretch - 1.0)


@dataclass(frozen=True)
class CortexForce:
    """Tension of a segment along its edge, the vector from its first to its second end [µm]; length at rest in µm.

    law : of the cortex, as LineTension is.
    """

    law: Cortex

    def force(self, length, edge: Vector):
        """Forces on both ends [pN/µm]."""
        dx, dy = edge
        now = sqrt(dx * dx + dy * dy)
        tension = self.law.tension(now / length) / now
        return (tension * dx, tension * dy), (-(tension * dx), -(tension * dy))

    def energy(self, length, edge: Vector):
        """Energy [pN]."""
        dx, dy = edge
        return length * self.law.energy(sqrt(dx * dx + dy * dy) / length)
