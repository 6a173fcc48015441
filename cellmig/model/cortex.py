"""Cortex of a cell: an addition to the paper's model, absent unless a case asks for it."""

from __future__ import annotations

from ..case.registry import law, quantity


@law("cortex", "line-tension")
class LineTension:
    """Constant tension T of the surface, as of a liquid: its energy is T per current length, pressure inside T/R."""

    line_tension: float = quantity("pN/um", "tension T of the surface", minimum=0)

    def energy(self, stretch):
        """Energy per reference length [pN/µm] of a surface stretched to `stretch` times its reference length [-]."""
        return self.line_tension * stretch

    def tension(self, stretch):
        """Tension [pN/µm], d(energy)/d(stretch)."""
        return self.line_tension + 0.0 * stretch
