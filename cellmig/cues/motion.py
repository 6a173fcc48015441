"""Feedback of motion: cells turn to where they move, also where others pull or push them."""

from __future__ import annotations

import numpy as np

from ..case.registry import law, quantity
from .cue import Cue
from .surroundings import Surroundings


@law("cue", "motion")
class Motion(Cue):
    r"""Own velocity v over √(v² + v_s²), with a speed scale v_s: its direction, for a cell that moves faster than that.

    The velocity along the substrate is the mean since the last knot of the polarity.  Cells that pull each other
    then align, though none knows the polarity of others.

    Source: polarity that turns to the velocity, Szabó et al. (2006), Phys. Rev. E 74:061908; the scale: derived here,
    so that the cue is bounded and a cell at rest has none.
    """

    speed: float = quantity("um/us", "speed scale v_s, such as \"0.5 um/min\"", above=0)

    def sensed(self, around: Surroundings) -> np.ndarray:
        """The cue of all cells without its gain (cells, d - 1) [-]."""
        v = around.velocity
        return v / np.sqrt((v * v).sum(axis=1, keepdims=True) + self.speed**2)
