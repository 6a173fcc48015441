"""What all cues have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..case.registry import parameter, quantity
from .surroundings import Surroundings


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

    @abstractmethod
    def sensed(self, around: Surroundings) -> np.ndarray:
        """The cue of all cells without its gain (cells, d - 1) [-]."""
