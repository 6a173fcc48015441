"""Cells that protrude, on one rank: the push of a cell depends on all of its surface, wherever the rank has a part."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..kernel.kernel import Kernel
from ..kernel.layout import Numbering
from ..meshfree.contact import Surfaces


def depth(law: Any) -> float:
    """Energy of a bond that is closed [pN µm]; infinite where there are none, so that none is closed."""
    return law.work / law.bond_density if law.work else math.inf


class Push:
    """The protruding cells of which a rank owns a part of the surface.

    surface : (m,) int -- all surface particles of these cells, ascending, of which the rank needs copies.
    """

    def __init__(self, surfaces: Surfaces, protruding: np.ndarray, own: np.ndarray):
        """`protruding` (cells,) bool; `own` (size,) bool -- the particles of this rank."""
        here = np.isin(surfaces.cell, surfaces.cell[own[surfaces.ids]])
        self._surfaces, self._protruding = surfaces, protruding
        self.surface = np.flatnonzero(protruding[surfaces.cell] & surfaces.outer & here)

    def fill(self, kernel: Kernel, base: Numbering, law: Any, work: float, alpha: np.ndarray, segments: np.ndarray,
             acts: np.ndarray) -> None:
        """Set the kernel's arrays for its `segments` (e,), of which those push that `acts` (e,) bool.

        `work` : N σ [pN/µm];  `alpha` : (m,) -- random factors, as `random_factor` gives them.
        """
        k, s = kernel, self._surfaces
        ends = np.column_stack([segments, s.after[segments]])
        k["push"] = np.where(acts[:, None], 0.5 * law.protrusion_ratio * work * alpha[ends], 0.0)
        k["pushed"] = np.zeros(ends.shape)
        cells, first, count = np.unique(s.cell[self.surface], return_index=True, return_counts=True)
        share = 0.5 * (s.length + s.length[s.before])[self.surface]
        k["mover_weight"] = share / np.repeat(np.add.reduceat(share, first) if len(first) else share, count)
        k["n_movers"], k["first_mover"] = len(cells), np.append(first, len(self.surface))
        k["mover"], k["mover_of"] = base.local(s.ids[self.surface]), np.searchsorted(cells, s.cell[segments])
        k["firm"], k["middle"], k["hold"] = law.height, np.zeros(len(cells)), np.zeros(len(cells))
        self._pushed = self._protruding[s.cell[segments]] & s.outer[segments]

    def renew(self, kernel: Kernel, low: np.ndarray) -> None:
        """Search lists: the segments of the protruding cells that are `low` (e,) bool, within the reach of bonds."""
        kernel["grip"] = grip = np.flatnonzero(low & self._pushed)
        cells = np.arange(len(kernel["hold"]) + 1)
        kernel["first_grip"] = np.searchsorted(kernel["mover_of"][grip], cells)
