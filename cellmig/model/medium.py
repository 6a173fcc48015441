"""Drag of the liquid around the cells: an addition to the model of Bai, Lin & Zeng (2019), absent by default."""

from __future__ import annotations

from ..case.registry import law, quantity


@law("medium", "stokes")
class StokesDrag:
    r"""Traction t = -(3η/2R) v per reference area of a cell's surface, on the substrate and off it.

    It is what a liquid of viscosity η exerts, uniformly, on a sphere of radius R that moves through it at the velocity
    v, 6πηR v in all; R is the radius of the ball of the cell's volume.  In two dimensions it is that of the disc of the
    cell's area, and the traction acts per length of the outline, 3πη v in all per thickness: Stokes' equations have no
    drag of a cylinder that is alone, it depends on what is around by a logarithm, and this one is of its size.

    It holds on to what nothing else does, a cell off the substrate above all.  The liquid itself is at rest: it carries
    no motion from cell to cell, a wall near by does not hold it, and a cell that deforms has the drag v of each point.

    Source: Stokes (1851), Trans. Cambridge Philos. Soc. 9:8-106; uniform traction: Batchelor (1967), An Introduction to
    Fluid Dynamics, section 4.9.
    """

    viscosity: float = quantity("Pa s", "viscosity η of the liquid: water at 37 °C has 0.7 mPa s", minimum=0)

    @property
    def coefficient(self) -> float:
        """Traction over speed, times the radius [Pa µs]."""
        return 1.5 * self.viscosity

    def force(self, size, velocity):
        """Force [pN/µm] at a velocity [µm/µs] on a length over R of `size` [-]; in space [pN], area, [µm]."""
        return tuple(-(self.coefficient * size * v) for v in velocity)
