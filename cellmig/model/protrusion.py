"""Protrusion F_d of equation (2): the push of the leading edge."""

from __future__ import annotations

from numpy import maximum, minimum

from ..case.registry import law, parameter, quantity


@law("protrusion", "edge")
class EdgeProtrusion:
    r"""Push along +x, proportional to the adhesion: to its energy, which the advancing edge is about to gain, and to
    the bonds by which the front half holds on.

    On the front half of a cell's surface a membrane at height g carries β α c N σ S'(g) per reference length, with
    S = u² (3 - 2u), u = g/ℓ between 0 and 1: nothing where it is bonded (g = 0) or high (g > ℓ; ℓ is at most the cutoff
    of the bonds).  α in [0, 1] differs from place to place.  c = min(1, B/ℓ), B being the length of closed bonds under
    the front half: a cell beyond the reach of bonds is not pushed, one that they barely reach hardly (at 30 ε by less
    than 0.2 % of the push of one that holds on).  Both S' and B are integrated exactly along surface segments; ℓ makes
    them independent of the spacing, which the attraction itself, N U'(g), is not: it is felt over ε, far less than a
    segment.  The front half begins gradually, over ℓ, at the mean of the surface along x, so that no particle is
    switched on by chance; it is looked for in every step.
    """

    cells: tuple = parameter("names of the cells that protrude", items="cell")
    protrusion_ratio: float = quantity("", "ratio β of the push to the adhesion energy", 0.06, minimum=0,
                                       formerly="strength")
    height: float = quantity("um", "height ℓ of the pushing edge, at most the cutoff of the bonds", "1 um", above=0)
    random: bool = parameter("whether α is random in [0, 1]; else it is 1/2 everywhere", True)
    correlation_length: float = quantity("um", "distance of the points where α is drawn, linear between them", "0.4 um",
                                         above=0, formerly="patch")

    def front(self, x):
        """Share of the push at a distance x [µm] ahead of the mean of the cell's surface [-]: 0 behind, 1 ahead."""
        return minimum(maximum(0.5 + x / self.height, 0.0), 1.0)

    def hold(self, bonded):
        """Share c of the push [-] for a length [µm] of closed bonds under the front half."""
        return minimum(bonded / self.height, 1.0)

    def ramp(self, g):
        """S(g) [-]: share of the adhesion energy that lies below the height g [µm]."""
        u = minimum(maximum(g / self.height, 0.0), 1.0)
        return u * u * (3.0 - 2.0 * u)

    def ramp_slope(self, g):
        """dS/dg [1/µm]."""
        u = minimum(maximum(g / self.height, 0.0), 1.0)
        return 6.0 * u * (1.0 - u) / self.height
