"""The largest stretch of the fluid, and the limit beyond which a fixed reference configuration loses accuracy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..output.view import View
from ..parallel.reduce import largest

# In shear flow between cylinders, with a thousand particles, the torque has grown by 5 % at this stretch, by 14 % at
# 3.9 (docs/fluid.md).
STRETCH_LIMIT = 3.0
FOLDED = -0.99  # cosine of the angle between the normals at an edge below which a surface is folded [-]
LONG = 4.0  # length of a segment of the surface of a fluid beyond which a run warns [spacings]


def _doublings(stretch: float, limit: float = STRETCH_LIMIT) -> int:
    """How many of 1, 2, 4, 8 times the `limit`, and so on, are below a stretch [-]."""
    return max(0, math.ceil(math.log2(stretch / limit)))


def stretch(F: np.ndarray) -> np.ndarray:
    """Largest singular value of F (d, d, ...) [-], the largest principal stretch.

    Source: for 2×2 a closed form, derived here from the parts of F that commute and anticommute with rotations.
    """
    if len(F) == 3:
        C = np.einsum("ki...,kj...->...ij", F, F)
        return np.sqrt(np.linalg.eigvalsh(np.nan_to_num(C))[..., -1])
    (a, b), (c, d) = F
    return 0.5 * (np.hypot(a + d, b - c) + np.hypot(a - d, b + c))


def lips(m: View) -> str:
    """End of a message: what helps where a lip of fluid slides along another cell; empty where lips are held.

    A film that a force draws thins at a constant speed, and is cut after a finite time: see docs/tension.md.
    """
    pull = m.terms.lip_pull
    if not pull or not any(getattr(law, "fluid", False) for law in m.scene.materials):
        return ""
    return (f"; where a lip slides along another cell it thins until it is cut, however fine the particles: bonds draw "
            f"it by {pull:.3g} pN/um more than its membrane holds; try a line_tension of {m.terms.work_between:.3g} "
            "pN/um ([cortex])")


class StrainWatch:
    """The largest stretch of the fluid in a run; warns at 1, 2, 4, 8 times the limit, and so on.

    The stretch is that since the neighbours were found.

    largest : stretch [-], None without a fluid;  crossed_at : when it exceeded the limit [µs], None if it did not;
    longest : segment of a surface where neighbours are found anew, which its segments are not [spacings];
    folded : whether a surface in space was folded where it is near another cell.

    Source: derived here, from the error of shear flow between cylinders.
    """

    def __init__(self, mechanics: View):
        """Watch the particles of viscous materials: an elastic solid depends on its reference at any strain."""
        self.mechanics = mechanics
        viscous = np.array([law.viscosity > 0.0 for law in mechanics.scene.materials])
        self._fluid = viscous[mechanics.part.owned.material]
        self.largest: float | None = 1.0 if viscous.any() else None
        self.crossed_at: float | None = None
        self.longest, self.folded = 1.0, False

    def check(self, time: float) -> str:
        """Warning, or an empty string, at the time [µs] of a sample, when F is up to date; collective."""
        stretched = "" if self.largest is None else self._stretched(time) or self._coarse(time)
        return "\n".join(filter(None, [stretched, self._folded(time)]))

    def _folded(self, time: float) -> str:
        """Warning where a surface in space is folded at another cell, as it may then go through itself; collective."""
        m = self.mechanics
        if self.folded or m.scene.dimension == 2 or m.terms.contacts is None:
            return ""
        cosine, particle = min(m.comm.allgather(m.segments.sharpest()))
        self.folded = cosine < FOLDED
        if not self.folded:
            return ""
        cell = int(m.scene.cell_of(particle)) + 1
        return (f"WARNING at {m.scene.time_unit.text(time)}: the surface of cell {cell} is folded at particle "
                f"{particle}: if that edge goes on through the fold, the energy of its contact jumps, and the cell may "
                "go through itself; weaker bonds or finer particles may keep it smooth")

    def _coarse(self, time: float) -> str:
        """Warning where a surface has become coarse by flow; collective."""
        m, before = self.mechanics, self.longest
        if m.terms.renewal is None:
            return ""
        ends, x = m.segments.owned()
        spacing = np.array([t.spacing for t in m.scene.templates])[m.scene.kind]  # of each cell
        sides = np.linalg.norm(np.roll(x, -1, axis=1) - x, axis=2).max(axis=1)
        self.longest = max(before, largest(m.comm, sides / spacing[m.part.owned.cell[ends[:, 0]]]))
        if _doublings(self.longest, LONG) <= _doublings(before, LONG):
            return ""
        side = "a segment" if m.scene.dimension == 2 else "an edge"
        return (f"WARNING at {m.scene.time_unit.text(time)}: {side} of a surface is {self.longest:.3g} spacings "
                "long: surfaces have as many particles as at the start, and are coarse where they have grown; take "
                "finer particles")

    def _stretched(self, time: float) -> str:
        """Warning where neighbours are too far apart; collective."""
        m, before = self.mechanics, self.largest
        assert before is not None
        stretches = stretch(m.state.since_renewal())
        found = np.where(self._fluid, stretches, 0.0)
        i = int(found.argmax()) if len(found) else -1
        most, particle = max(m.comm.allgather((float(found[i]), -int(m.ids[i])) if i >= 0 else (0.0, 0)))
        self.largest = largest = max(before, most)
        if _doublings(largest) <= _doublings(before):
            return ""
        cell = int(m.scene.cell_of(-particle)) + 1
        text = (f"WARNING at {m.scene.time_unit.text(time)}: particle {-particle} of cell {cell} is stretched "
                f"{most:.3g}-fold, ")
        if self.crossed_at is not None:
            return (f"{text}{most / STRETCH_LIMIT:.2g} times the limit of {STRETCH_LIMIT:g}: there neighbours are too "
                    "far apart for any flow but one that is nearly uniform")
        self.crossed_at = time
        return (f"{text}beyond the limit of {STRETCH_LIMIT:g}: from here on neighbours are so far apart there that "
                f"flow may be resisted by 5 % too much; see whether finer particles give the same answer{lips(m)}")

    def summary(self) -> str:
        """Warning for the end of a run, empty if the limit was not exceeded."""
        if self.crossed_at is None:
            return ""
        since = self.mechanics.scene.time_unit.text(self.crossed_at)
        return (f"WARNING: from {since} on fluid was stretched beyond the limit of "
                f"{STRETCH_LIMIT:g}, up to {self.largest:.3g}-fold: see whether finer particles give the same answer"
                f"{lips(self.mechanics)}")

    def saved(self) -> dict[str, Any]:
        """State for a checkpoint."""
        return {"largest": self.largest, "crossed_at": self.crossed_at, "longest": self.longest}

    def restore(self, about: dict[str, Any]) -> None:
        """Set the state from `about`, which `saved` returned."""
        self.largest, self.crossed_at, self.longest = (about[name] for name in ("largest", "crossed_at", "longest"))

    def record(self) -> dict[str, Any] | None:
        """Entries for the manifest; None without a fluid."""
        if self.largest is None:
            return None
        about = {"largest": self.largest, "limit": STRETCH_LIMIT, "crossed_at_us": self.crossed_at}
        m = self.mechanics
        renewed = {"neighbours_found_anew": m.renewals, "longest_segment_spacings": self.longest}
        return about | (renewed if m.terms.renewal is not None else {})
