"""A given cue: a direction by hand, for leaders, a wire or light."""

from __future__ import annotations

import numpy as np

from ..case.expression import Expression
from ..case.registry import law, parameter
from .cue import Cue, Sites
from .surroundings import Surroundings


@law("cue", "given")
class Given(Cue):
    """A vector along the substrate: numbers, or formulas of place and time.

    The time has its unit in its name: t_s in seconds, t_h in hours.  Two tables, each with its `cells`, make leaders.
    """

    vector: tuple = parameter("the vector: one number in two dimensions, + to the right, two in three; may be "
                              "formulas of the place of the cell's centre and of time", unit="", shape=("d-1",),
                              formula=True, timed=True)

    def largest(self, sites: Sites) -> tuple[np.ndarray, bool]:
        """Largest sizes of the vector at the sites (n,) [-] at any of the times."""
        found = [[value(sites.centre, time) if isinstance(value, Expression) else value + 0.0 * sites.radius
                  for value in self.vector] for time in sites.times]
        return abs(self.gain) * np.linalg.norm(found, axis=1).max(axis=0), True

    def sensed(self, around: Surroundings) -> np.ndarray:
        """The cue of all cells without its gain (cells, d - 1) [-]."""
        at, count = around.centre, len(around.names)
        return np.column_stack([value(at, around.time) if isinstance(value, Expression) else np.full(count, value)
                                for value in self.vector])
