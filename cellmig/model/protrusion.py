"""Protrusion F_d of equation (2): the push of the leading edge."""

from __future__ import annotations

from numpy import maximum, minimum

from ..case.registry import law, parameter, quantity


@law("protrusion", "edge")
class EdgeProtrusion:
    r"""Push along +x, proportional to the adhesion energy that the advancing edge is about to gain.

    On the front half of a cell's surface a membrane at height g carries β α N σ S'(g) per reference length, with
    S = u² (3 - 2u), u = g/ℓ between 0 and 1: nothing where it is bonded (g = 0) or high (g > ℓ).  α in [0, 1]
    differs from place to place.  It is integrated exactly along surface segments; ℓ makes it independent of them.
    The front half begins gradually, over ℓ, so that no particle is switched on by chance.
    """

    cells: tuple = parameter("names of the cells that protrude", items="cell")
    strength: float = quantity("", "ratio β of the push to the adhesion energy", 0.06, minimum=0)
    height: float = quantity("um", "height ℓ of the pushing edge", "1 um", above=0)
    random: bool = parameter("whether α is random in [0, 1]; else it is 1/2 everywhere", True)
    patch: float = quantity("um", "distance of the points where α is drawn, linear between them", "0.4 um", above=0)

    def front(self, x):
        """Share of the push at a distance x [µm] ahead of the mean of the cell's surface [-]: 0 behind, 1 ahead."""
        return minimum(maximum(0.5 + x / self.height, 0.0), 1.0)

    def ramp(self, g):
        """S(g) [-]: share of the adhesion energy that lies below the height g [µm]."""
        u = minimum(maximum(g / self.height, 0.0), 1.0)
        return u * u * (3.0 - 2.0 * u)

    def ramp_slope(self, g):
        """dS/dg [1/µm]."""
        u = minimum(maximum(g / self.height, 0.0), 1.0)
        return 6.0 * u * (1.0 - u) / self.height
