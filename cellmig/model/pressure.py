"""Pressure on surfaces, from outside."""

from __future__ import annotations

from ..case.pointwise import Vector


class Pressure:
    """Pressure on a segment, whose outside is to the right of its edge, the vector from end to end [µm]."""

    def force(self, pressure, edge: Vector):
        """Forces on both ends [pN/µm], half on each; pressure in Pa."""
        half, (dx, dy) = 0.5 * pressure, edge
        force = -half * dy, half * dx
        return force, force
