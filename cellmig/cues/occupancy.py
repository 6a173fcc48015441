"""Chemotaxis, or haptotaxis in a field of ligand: the difference of occupied receptors across a cell."""

from __future__ import annotations

import numpy as np

from ..case.level import Level, level
from ..case.registry import law, parameter, quantity
from .cue import Cue, Sites
from .surroundings import Surroundings


@law("cue", "occupancy")
class Occupancy(Cue):
    r"""Difference ΔΘ of the share of occupied receptors across a cell, towards where more of them are occupied.

    A receptor is occupied with the probability Θ = c/(c + K) at the level c of the field.  The cell compares receptors
    all over its own outer surface: ΔΘ = L M⁻¹ <Θ r>, M = <r rᵀ>, with means < > over the surface as it is now, the
    vector r along the substrate from its middle, and the length L of the cell.  That is the slope of the line, in space
    of the plane, which fits Θ(r) best, times L.  It is bounded, and largest at c = K where ΔC/C is the same, where
    HL60 cells orient best, too (Herzmark et al. 2007, PNAS).

    N `receptors`, 30 at least and evenly on the surface, are occupied or not by chance: at each knot of the
    polarity ΔΘ then has normal noise of covariance (L²/N) M⁻¹ <Θ (1 - Θ) r rᵀ> M⁻¹, which is that of the fit. In a
    weak gradient the variance of ΔC/C, as the cell finds it, is L² (c + K)²/(N c K) M⁻¹: 8 (c + K)²/(N c K) for a
    ring or for a disc seen from the side, 12 (c + K)²/(N c K) for a ball, 4 (c + K)²/(N c K) for receptors at two
    ends.

    Source: occupied receptors and their noise: Tranquillo, Lauffenburger & Zigmond (1988), J. Cell Biol. 106:303-309;
    the limit for cells of any shape: Hu, Chen, Rappel & Levine (2011), Phys. Rev. E 83:021917; the fit: derived here.
    """

    gain: float = quantity("", "factor of ΔΘ: with 50, a difference of 2 % turns a cell as much as chance does", 50.0)
    field: str = parameter("name of the field, of a chemical or of ligand", refers="field")
    affinity: Level = level("level K of the field at which half of the receptors are occupied, such as \"10 nM\"")
    receptors: float | None = quantity("", "number N of receptors of a cell; by default so many that chance does not "
                                       "count", None, minimum=30)

    def largest(self, sites: Sites) -> tuple[np.ndarray, bool]:
        """Differences from end to end (n,) [-] of a known field; in any field they are at most 3/2, of a step of Θ."""
        square = np.zeros(len(sites.radius))
        for axis in np.eye(sites.centre.shape[1])[:-1]:
            ends = [sites.occupied(self.field, self.affinity.value, shift) for shift in (axis, -axis)]
            if ends[0] is None or ends[1] is None:
                return np.full(len(square), 1.5 * abs(self.gain)), False
            square += (ends[0] - ends[1]) ** 2
        return abs(self.gain) * np.sqrt(square), True

    def sensed(self, around: Surroundings) -> np.ndarray:
        """ΔΘ of all cells, with the noise of finite receptors (cells, d - 1) [-]."""
        occupied, r = around.occupancy(self.field, self.affinity.value), around.arm
        square = r[:, :, None] * r[:, None, :]
        inverse = np.linalg.inv(around.mean(square))
        slope = np.einsum("kij,kj->ki", inverse, around.mean(occupied[:, None] * r))
        if self.receptors is not None:
            spread = around.mean((occupied * (1.0 - occupied))[:, None, None] * square)
            variance = inverse @ spread @ inverse / self.receptors
            size, axes = np.linalg.eigh(variance)
            root = axes * np.sqrt(np.maximum(size, 0.0))[:, None, :]
            drawn = around.normal(f"occupancy of {self.field} at {self.affinity.value:.17g}")
            slope = slope + np.einsum("kij,klj,kl->ki", root, axes, drawn)
        return around.length[:, None] * slope
