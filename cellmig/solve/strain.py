"""The largest stretch of the fluid, and the limit beyond which a fixed reference configuration loses accuracy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..output.view import View

# In shear flow between cylinders, with a thousand particles, the torque has grown by 5 % at this stretch, by 14 % at
# 3.9 (docs/fluid.md).
STRETCH_LIMIT = 3.0


def _doublings(stretch: float) -> int:
    """How many of 1, 2, 4, 8 times the limit, and so on, are below a stretch [-]."""
    return max(0, math.ceil(math.log2(stretch / STRETCH_LIMIT)))


def stretch(F: np.ndarray) -> np.ndarray:
    """Largest singular value of F (d, d, ...) [-], the largest principal stretch.

    Source: for 2×2 a closed form, derived here from the parts of F that commute and anticommute with rotations.
    """
    if len(F) == 3:
        C = np.einsum("ki...,kj...->...ij", F, F)
        return np.sqrt(np.linalg.eigvalsh(np.nan_to_num(C))[..., -1])
    (a, b), (c, d) = F
    return 0.5 * (np.hypot(a + d, b - c) + np.hypot(a - d, b + c))


class StrainWatch:
    """The largest stretch of the fluid in a run; warns at 1, 2, 4, 8 times the limit, and so on.

    largest : stretch [-], None without a fluid;  crossed_at : when it exceeded the limit [µs], None if it did not.

    Source: derived here, from the error of shear flow between cylinders.
    """

    def __init__(self, mechanics: View):
        """Watch the particles of viscous materials: an elastic solid depends on its reference at any strain."""
        self.mechanics = mechanics
        viscous = np.array([law.viscosity > 0.0 for law in mechanics.scene.materials])
        self._fluid = viscous[mechanics.scene.material[mechanics.ids]]
        self.largest: float | None = 1.0 if viscous.any() else None
        self.crossed_at: float | None = None

    def check(self, time: float) -> str:
        """Warning, or an empty string, at the time [µs] of a sample, when F is up to date; collective."""
        m = self.mechanics
        if self.largest is None:
            return ""
        stretches = stretch(m.state.tensors()[0][..., : m.n_owned])
        found = np.where(self._fluid, stretches, 0.0)
        i = int(found.argmax()) if len(found) else -1
        most, particle = max(m.comm.allgather((float(found[i]), -int(m.ids[i])) if i >= 0 else (0.0, 0)))
        before = self.largest
        self.largest = largest = max(before, most)
        if _doublings(largest) <= _doublings(before):
            return ""
        cell = int(m.scene.cell[-particle]) + 1
        text = (f"WARNING at {m.scene.time_unit.text(time)}: particle {-particle} of cell {cell} is stretched "
                f"{most:.3g}-fold, ")
        if self.crossed_at is not None:
            return (f"{text}{most / STRETCH_LIMIT:.2g} times the limit of {STRETCH_LIMIT:g}: there neighbours are too "
                    "far apart for any flow but one that is nearly uniform")
        self.crossed_at = time
        return (f"{text}beyond the limit of {STRETCH_LIMIT:g}: from here on neighbours are so far apart there that "
                "flow may be resisted by 5 % too much; see whether finer particles give the same answer")

    def summary(self) -> str:
        """Warning for the end of a run, empty if the limit was not exceeded."""
        if self.crossed_at is None:
            return ""
        since = self.mechanics.scene.time_unit.text(self.crossed_at)
        return (f"WARNING: from {since} on fluid was stretched beyond the limit of "
                f"{STRETCH_LIMIT:g}, up to {self.largest:.3g}-fold: see whether finer particles give the same answer")

    def saved(self) -> dict[str, Any]:
        """State for a checkpoint."""
        return {"largest": self.largest, "crossed_at": self.crossed_at}

    def restore(self, about: dict[str, Any]) -> None:
        """Set the state from `about`, which `saved` returned."""
        self.largest, self.crossed_at = about["largest"], about["crossed_at"]

    def record(self) -> dict[str, Any] | None:
        """Entries for the manifest; None without a fluid."""
        if self.largest is None:
            return None
        return {"largest": self.largest, "limit": STRETCH_LIMIT, "crossed_at_us": self.crossed_at}
