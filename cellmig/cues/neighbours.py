"""Alignment: cells turn as those do that they touch."""

from __future__ import annotations

import numpy as np

from ..case.amounts import MOST
from ..case.registry import law, quantity
from .cue import Cue, Sites
from .surroundings import Surroundings


@law("cue", "neighbours")
class Neighbours(Cue):
    r"""Mean of p_j - p_i over the cells j in contact with the cell i.

    A cell counts fully if its surface comes as near as half the reach, and gradually less up to the reach.  Leaders are
    cells that this cue does not turn; a cell that does not push has no polarity, p_j = 0.

    Source: alignment with neighbours, Vicsek et al. (1995), Phys. Rev. Lett. 75:1226-1229; of cells in an epithelium,
    with leaders, Sepúlveda et al. (2013), PLoS Comput. Biol. 9:e1002944.
    """

    gain: float = quantity("", "factor of the cue; beyond 10, in sum over such cues, polarities would overshoot from "
                           "knot to knot, below 0 differences would grow without end", 1.0, minimum=0, maximum=MOST)
    reach: float = quantity("um", "distance up to which surfaces are in contact: fully up to half of it", "1 um",
                            above=0)

    def largest(self, sites: Sites) -> tuple[np.ndarray, bool]:
        """Zeros (n,) [-]: who follows others has no larger polarity than they."""
        return np.zeros(len(sites.radius)), True

    def sensed(self, around: Surroundings) -> np.ndarray:
        """The cue of all cells without its gain (cells, d - 1) [-]."""
        contacts, p = around.near(self.reach), around.polarity
        i, j = contacts.pair.T
        total, count = np.zeros_like(p), np.zeros(len(p))
        np.add.at(total, i, contacts.close[:, None] * (p[j] - p[i]))
        np.add.at(count, i, contacts.close)
        return total / np.maximum(count, 1.0)[:, None]
