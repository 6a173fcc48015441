"""How firmly cells push on a substrate by its stiffness: additions to the model of Bai, Lin & Zeng (2019)."""

from __future__ import annotations

from ..case.registry import law, quantity


@law("response", "saturating")
class SaturatingResponse:
    """Push that grows with the stiffness and saturates, g = E/(E + H), so that it is half of the full one at E = H.

    Source: that cells exert larger active tractions on stiffer substrates, and tissues then go up a gradient, is from
    Alert & Casademunt (2019), Langmuir 35:7571-7577; the formula is the simplest that saturates.
    """

    half: float = quantity("Pa", "stiffness H of half the full push", above=0)

    def factor(self, stiffness):
        """Factor of the push g [-] at a stiffness E [Pa]."""
        return stiffness / (stiffness + self.half)


@law("response", "optimum")
class OptimumResponse:
    """Push that is largest at an optimal stiffness O, g = 2q/(1 + q²) with q = E/O.

    Cells then go towards O from both sides, up the gradient and down.
    Source: the optimum is that of Isomursu et al. (2022), Nature Materials 21:1081-1090; the formula is the simplest
    with one, of equal slopes on both sides in log E, and derived here.
    """

    optimum: float = quantity("Pa", "stiffness O of the full push", above=0)

    def factor(self, stiffness):
        """Factor of the push g [-] at a stiffness E [Pa]."""
        q = stiffness / self.optimum
        return 2.0 * q / (1.0 + q * q)
