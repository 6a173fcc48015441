"""How far the fluid is stretched, and how far the method carries: the fixed reference of a fluid has a limit."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

# Shear flow between cylinders, a thousand particles: up to this stretch its torque is within 5 % of that at the start,
# at 2.4 it is 24 % too large, at 3.6 twice as large (docs/fluid.md).
STRETCH_LIMIT = 1.6


def _doublings(stretch: float) -> int:
    """How many of the limit, twice it, four times it … are below a stretch."""
    return max(0, math.ceil(math.log2(stretch / STRETCH_LIMIT)))


def stretch(F: np.ndarray) -> np.ndarray:
    """Largest principal stretch of F (2, 2, ...) [-]; no rotation changes it."""
    (a, b), (c, d) = F
    return 0.5 * (np.hypot(a + d, b - c) + np.hypot(a - d, b + c))


class StrainWatch:
    """The largest stretch that the fluid of a run has had, and when it crossed the limit; twice that is told anew.

    largest : stretch [-], None without a fluid;  crossed_at : time [µs], None if it has not.
    """

    def __init__(self, mechanics: Any):
        """Of the particles of viscous materials; an elastic solid belongs to its reference at any strain."""
        self.mechanics = mechanics
        viscous = np.array([law.viscosity > 0.0 for law in mechanics.scene.materials])
        self._fluid = viscous[mechanics.scene.material[mechanics.ids]]
        self.largest = 1.0 if viscous.any() else None
        self.crossed_at: float | None = None

    def check(self, time: float) -> str:
        """At a sample, with F up to date: a warning when the limit, or 2, 4 … times it, is crossed; collective."""
        m = self.mechanics
        if self.largest is None:
            return ""
        found = stretch(m.tensors()[0][..., : m.n_owned])
        found = np.where(self._fluid, found, 0.0)
        i = int(found.argmax()) if len(found) else -1
        most, particle = max(m.comm.allgather((float(found[i]), -int(m.ids[i])) if i >= 0 else (0.0, 0)))
        before, self.largest = self.largest, max(self.largest, most)
        if _doublings(self.largest) <= _doublings(before):
            return ""
        cell = int(m.scene.cell[-particle]) + 1
        said = f"WARNING at {time:.6g} µs: particle {-particle} of cell {cell} is stretched {most:.3g}-fold, "
        if self.crossed_at is not None:
            return (f"{said}{most / STRETCH_LIMIT:.2g} times the limit of {STRETCH_LIMIT:g}: there the numerical "
                    "stabilisation resists all but uniform flow more than the viscosity does")
        self.crossed_at = time
        return (f"{said}beyond the limit of {STRETCH_LIMIT:g}: from here on the numerical stabilisation may "
                "resist flow there by more than 5 %; see whether finer particles give the same answer")

    def summary(self) -> str:
        """At the end: a warning if the limit was crossed, else nothing."""
        if self.crossed_at is None:
            return ""
        return (f"WARNING: from {self.crossed_at:.6g} µs on fluid was stretched beyond the limit of "
                f"{STRETCH_LIMIT:g}, up to {self.largest:.3g}-fold: see whether finer particles give the same answer")

    def saved(self) -> dict[str, Any]:
        """What was seen so far, for a checkpoint."""
        return {"largest": self.largest, "crossed_at": self.crossed_at}

    def restore(self, about: dict[str, Any]) -> None:
        """Go on from what was saved."""
        self.largest, self.crossed_at = about["largest"], about["crossed_at"]

    def record(self) -> dict[str, Any] | None:
        """For the manifest; None without a fluid."""
        if self.largest is None:
            return None
        return {"largest": self.largest, "limit": STRETCH_LIMIT, "crossed_at_us": self.crossed_at}
