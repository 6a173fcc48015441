"""What all cues have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..case.registry import parameter, quantity
from .surroundings import Surroundings


@dataclass(frozen=True)
class Sites:
    """Where cells are at the start, for estimates.

    centre : (n, d) float -- of cells [µm];  radius : (n,) float -- their half length along the substrate [µm];
    fields : by name, what has `value(x, time)` if it is known;  times : some times of the case [µs].
    """

    centre: np.ndarray
    radius: np.ndarray
    fields: Mapping[str, Any]
    times: tuple[float, ...]

    def occupied(self, name: str, affinity: float, shift: np.ndarray) -> np.ndarray | None:
        """Shares c/(c + K) [-] at the start, `shift` (d,) radii from the centres (n,); None if not known."""
        if not hasattr(self.fields[name], "value"):
            return None
        level = np.maximum(self.fields[name].value(self.centre + self.radius[:, None] * shift, 0.0), 0.0)
        return level / (level + affinity)


@dataclass(frozen=True, kw_only=True)
class Cue(ABC):
    """Base class of cues, which turn the polarity of cells towards a vector along the substrate."""

    law: ClassVar[str]
    cells: tuple = parameter("names of the cells that it turns; by default all", (), items="cell")
    gain: float = quantity("", "factor of the cue", 1.0)

    def value(self, around: Surroundings) -> np.ndarray:
        """The cue of all cells (cells, d - 1) [-], with its gain; zero for cells that it does not turn."""
        concerned = around.concerned(self.cells)
        return np.where(concerned[:, None], self.gain * self.sensed(around), 0.0)

    def largest(self, sites: Sites) -> tuple[np.ndarray, bool]:
        """About the size of the cue, with its gain, at the start (n,) [-], and True; or a bound of it, and False."""
        return np.full(len(sites.radius), abs(self.gain)), True

    @abstractmethod
    def sensed(self, around: Surroundings) -> np.ndarray:
        """The cue of all cells without its gain (cells, d - 1) [-]."""
