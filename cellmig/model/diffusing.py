"""Fields that diffuse, decay, are carried by a flow, and are secreted and taken up by cells."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..case.registry import law, parameter, quantity

MOST = 50_000_000  # volumes, of which each takes about a kilobyte
SIDES = {2: ("left", "right", "bottom", "top"), 3: ("left", "right", "front", "back", "bottom", "top")}
_WALL = "\"closed\": nothing passes; \"open\": the flow carries out what it has, and brings nothing in; or the " \
        "concentration there"


def _wall(which: str) -> Any:
    return quantity("nM", f"wall {which}.  {_WALL}", "closed", minimum=0, words=("closed", "open"))


@dataclass(frozen=True, kw_only=True)
class Walls:
    """The walls of the box of a diffusing field, "closed", "open", or concentrations there [1/µm³].

    The substrate is at the bottom.
    """

    left: float | str = _wall("at the least x")
    right: float | str = _wall("at the largest x")
    front: float | str = _wall("at the least y, in three dimensions only")
    back: float | str = _wall("at the largest y, in three dimensions only")
    bottom: float | str = _wall("at the least y, in three dimensions z")
    top: float | str = _wall("at the largest y, in three dimensions z")

    def of(self, dimension: int) -> tuple[tuple[float | str, float | str], ...]:
        """Both walls of each axis, "closed", "open" or a concentration [1/µm³]."""
        both = [getattr(self, name) for name in SIDES[dimension]]
        return tuple(zip(both[::2], both[1::2], strict=True))


@law("field", "diffusing")
class Diffusing:
    r"""∂c/∂t = D Δc - k c - ∇·(w c) + what cells secrete - what they take up, in a box.

    Cells secrete and take up along their surfaces, and do not keep the field out of their inside.  In two dimensions
    amounts are per µm of thickness.

    Source: Fick's second law with first-order decay (Crank 1975, The Mathematics of Diffusion).
    """

    diffusion: float = quantity("um^2/s", "diffusion coefficient D", above=0)
    decay: float = quantity("1/s", "rate k at which molecules decay", "0 /s", minimum=0)
    flow: tuple = quantity("um/s", "uniform velocity w of the medium", (0.0, 0.0), shape=("d",))
    box: tuple = quantity("um", "two opposite corners of the box, which contains all cells that exchange with the "
                          "field", shape=(None, "d"))
    spacing: float = quantity("um", "size of the volumes, rounded so that the box has a whole number of them", above=0)
    walls: Walls | None = parameter("walls of the box, such as { right = \"0 nM\" }; by default all are closed", None,
                                    record=Walls)
    start: Any = quantity("nM", "concentration at the start; may be a formula of x, y (and z)", "0 nM", minimum=0,
                          formula=True)
    quasi_steady: bool = parameter("whether the field is in equilibrium with its sources at all times: for large D",
                             False)
    step: float | str = quantity("us", "longest time step; \"auto\": as long as errors allow", "auto", above=0,
                                 words=("auto",))
    time_order: int = parameter("order of the steps in time: 1, never negative (backward Euler), or 2 (Alexander's "
                                "SDIRK), where a step that might become negative is taken with order 1 instead", 1,
                                minimum=1, maximum=2)

    def __post_init__(self) -> None:
        """Check what several parameters have to do with each other.

        Raises ValueError for a box without an inside, or walls that leave an equilibrium open; the message is for the
        user.
        """
        if len(self.box) != 2 or not all(a < b for a, b in zip(*self.box, strict=True)):
            raise ValueError('box: expects two opposite corners, the lower first, such as '
                             '[["-100 um", "0 um"], ["100 um", "50 um"]]')
        if min(self.volumes) < 2:
            raise ValueError("spacing: the box has to be at least two volumes wide")
        if math.prod(self.volumes) > MOST:
            raise ValueError(f"spacing: there would be {math.prod(self.volumes):.3g} volumes, more than {MOST:,}")
        given, walls = self.walls or Walls(), self.sides
        if self.dimension == 2 and (given.front, given.back) != ("closed", "closed"):
            raise ValueError("walls: front and back are there in three dimensions only")
        if any("open" in pair and not w for pair, w in zip(walls, self.flow, strict=True)):
            raise ValueError('walls: "open" is for a flow through the wall; give a concentration instead')
        if self.quasi_steady and not (self.decay or any(wall != "closed" for pair in walls for wall in pair)):
            raise ValueError("quasi_steady: without decay and with closed walls there is no equilibrium")

    unit, steady = "nM", False

    @property
    def dimension(self) -> int:
        """Number of dimensions of the box."""
        return len(self.box[0])

    @property
    def sides(self) -> tuple[tuple[float | str, float | str], ...]:
        """Both walls of each axis: "closed", "open" or a concentration [1/µm³]."""
        return (self.walls or Walls()).of(self.dimension)

    @property
    def volumes(self) -> tuple[int, ...]:
        """Number of volumes along each axis."""
        return tuple(round((b - a) / self.spacing) for a, b in zip(*self.box, strict=True))

    def started(self, x: np.ndarray) -> np.ndarray:
        """Concentration at the start (n,) [1/µm³] at positions x (n, d) [µm]."""
        return self.start(x) if callable(self.start) else np.full(len(x), self.start)
