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
