"""Pressure on surfaces, from outside."""

from __future__ import annotations

from ..case.pointwise import Vector, Vector3
from .tensors import cross


class Pressure:
    """Pressure on a segment, whose outside is to the right of its edge, the vector from end to end [µm]."""

    def force(self, pressure, edge: Vector):
        """Forces on both ends [pN/µm], half on each; pressure in Pa."""
        half, (dx, dy) = 0.5 * pressure, edge
        force = -half * dy, half * dx
        return force, force


class TrianglePressure:
    """Pressure on a triangle, of which `edge1` and `edge2` go from its first corner to the others [µm], in positive
    order as seen from outside.
    """

    def force(self, pressure, edge1: Vector3, edge2: Vector3):
        """Forces on three corners [pN], a third on each; pressure in Pa."""
        force = tuple(-(pressure / 6.0) * n for n in cross(edge1, edge2))
        return force, force, force
