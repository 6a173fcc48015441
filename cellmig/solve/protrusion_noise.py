"""The random factor α of the protrusion: a function of arc length that does not depend on the spacing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..meshfree.contact import Surfaces
from ..model.protocols import ProtrusionLaw
from ..parallel.random import uniform


def random_factor(surfaces: Surfaces, law: ProtrusionLaw | None, seed: int, names: Sequence[str]) -> np.ndarray:
    """α of all surface particles (m,) [-]: zero but on the outer loops of the cells that protrude.

    law : the protrusion or None;  names : of all cells, in order, since random numbers belong to the name of a cell.

    Source: derived here: random numbers at equal distances, linear interpolation, means over dual arcs.
    """
    alpha, bounds = np.zeros(len(surfaces.ids)), np.searchsorted(surfaces.cell, np.arange(len(names) + 1))
    for c, name in enumerate(names):
        if law is not None and name in law.cells:
            on = np.arange(*bounds[c : c + 2])
            on = on[surfaces.outer[on]]
            alpha[on] = _of_cell(surfaces.size[on], law, seed, name)
    return alpha


def _of_cell(length: np.ndarray, law: ProtrusionLaw, seed: int, name: str) -> np.ndarray:
    """α of a cell's outer loop (m,) [-], for lengths (m,) [µm] of its segments."""
    if not law.random:
        return np.full(len(length), 0.5)
    arc = np.concatenate([[0.0], np.cumsum(length)])
    n = max(3, round(arc[-1] / law.correlation_length))
    step, a = arc[-1] / n, uniform(seed, "protrusion", name, n)
    ring = np.append(a, a[0])
    whole = np.concatenate([[0.0], np.cumsum(0.5 * step * (ring[1:] + ring[:-1]))])

    def integral(s: np.ndarray) -> np.ndarray:
        turn, s = np.divmod(s, arc[-1])
        i = np.minimum((s / step).astype(int), n - 1)
        t = s - i * step
        return turn * whole[-1] + whole[i] + t * (ring[i] + 0.5 * t / step * (ring[i + 1] - ring[i]))

    low, high = arc[:-1] - 0.5 * np.roll(length, 1), arc[:-1] + 0.5 * length
    return (integral(high) - integral(low)) / (high - low)
