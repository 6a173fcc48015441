"""Contact inhibition of locomotion: cells turn away from those that they touch."""

from __future__ import annotations

import numpy as np

from ..case.level import Level, level
from ..case.registry import law, parameter, quantity
from .cue import Cue, Sites
from .surroundings import Surroundings


@law("cue", "contact")
class Contact(Cue):
    r"""Away from the cells in contact: -β Σ_j s_j n_j, with a negative gain towards them.

    s_j is the share of the own outer surface that is within reach of the cell j; n_j is the part along the substrate of
    the unit vector from the middle of the own surface to the middle of that contact.  The cue of a cell between two
    equal contacts is zero.  The strength β is 1, or, where a field is named, the share c/(c + K) of occupied receptors
    in the mean over the own surface.  Then the mean cue of a row of cells, each of which is as strong as the level at
    its place, is towards higher levels, though no cell compares levels: β' g d (N - 1)/N times the share of an end
    contact, for N cells at a distance d in a gradient g.

    Source: Stramer & Mayor (2017), Nat. Rev. Mol. Cell Biol. 18:43-55; of polarities: Smeets et al. (2016), PNAS,
    PMC5187738, and Zimmermann et al. (2016), PNAS 113:2660-2665; stronger where an attractant is: Camley, Zimmermann,
    Levine & Rappel (2016), Phys. Rev. Lett. 116:098101.
    """

    reach: float = quantity("um", "distance up to which surfaces are in contact: fully up to half of it", "1 um",
                            above=0)
    field: str | None = parameter("name of a field that makes the cue stronger; by default none", None, refers="field")
    affinity: Level | None = level("level K of the field at which the cue has half of its strength, such as \"10 nM\"; "
                                   "goes with `field`", None)

    def __post_init__(self) -> None:
        """Check the strength.

        Raises ValueError unless field and affinity are given together; the message is for the user.
        """
        if (self.field is None) != (self.affinity is None):
            raise ValueError("expects both field and affinity, or none of them")

    def largest(self, sites: Sites) -> tuple[np.ndarray, bool]:
        """That of cells half of whose surface is in contact, on one side (n,) [-]; how much will be is not known."""
        return np.full(len(sites.radius), 0.5 * abs(self.gain)), False

    def sensed(self, around: Surroundings) -> np.ndarray:
        """The cue of all cells without its gain (cells, d - 1) [-]."""
        contacts = around.near(self.reach)
        own = contacts.pair[:, 0]
        away = around.centre[own] - contacts.middle
        away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-300)
        out = np.zeros_like(around.polarity)
        np.add.at(out, own, contacts.share[:, None] * away[:, :-1])
        if self.field is not None and self.affinity is not None:
            out *= around.mean(around.occupancy(self.field, self.affinity.value))[:, None]
        return out
