"""The random factor α of the protrusion: a function of the place on the surface that does not depend on the spacing."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from ..meshfree.contact import Surfaces
from ..meshfree.scene import Scene
from ..model.protocols import ProtrusionLaw
from ..parallel.random import uniform

PERIOD = 64  # of the random numbers in space along each axis [correlation lengths]: a cell is smaller


def random_factor(scene: Scene, surfaces: Surfaces, law: ProtrusionLaw, seed: int,
                  names: Sequence[str]) -> np.ndarray:
    """α of the particles of `surfaces` (m,) [-]: zero but on the outer surfaces of the cells that protrude.

    names : of all cells of the scene, in order, since random numbers belong to the name of a cell.

    Source: derived here: random numbers at equal distances, linear interpolation, in the plane means over dual arcs.
    """
    alpha, outside = np.zeros(len(surfaces.ids)), surfaces.on_outside
    pushing, bounds = set(law.cells), np.append(np.searchsorted(surfaces.cell, surfaces.cells), len(alpha))
    for k, c in enumerate(surfaces.cells.tolist()):
        if names[c] in pushing:
            on = np.arange(*bounds[k : k + 2])
            on = on[outside[on]]
            if scene.dimension == 2:
                alpha[on] = _along_loop(surfaces.size[on], law, seed, names[c])
            else:
                alpha[on] = _in_space(scene.particles(surfaces.ids[on]).X - scene.centre[c], law, seed, names[c])
    return alpha


def _in_space(X: np.ndarray, law: ProtrusionLaw, seed: int, name: str) -> np.ndarray:
    """α at reference positions X (m, 3) [µm] from the cell's centre (m,) [-], linear between the points of a grid."""
    if not law.random:
        return np.full(len(X), 0.5)
    numbers = uniform(seed, "protrusion", name, PERIOD**3).reshape(PERIOD, PERIOD, PERIOD)
    first = np.floor(X / law.correlation_length)
    part, out = X / law.correlation_length - first, np.zeros(len(X))
    for corner in product((0, 1), repeat=3):
        weight = np.where(corner, part, 1.0 - part).prod(axis=1)
        out += weight * numbers[tuple((first.astype(int) + corner).T % PERIOD)]
    return out


def _along_loop(length: np.ndarray, law: ProtrusionLaw, seed: int, name: str) -> np.ndarray:
    """α of a cell's outer loop (m,) [-], for lengths (m,) [µm] of its segments."""
    if not law.random:
        return np.full(len(length), 0.5)
    arc = np.concatenate([[0.0], np.cumsum(length)])
    n = max(3, round(arc[-1] / law.correlation_length))
    step, a = arc[-1] / n, uniform(seed, "protrusion", name, n)
    ring = np.append(a, a[0])
    parts = 0.5 * step * (ring[1:] + ring[:-1])
    whole = np.concatenate([[0.0], np.cumsum(parts)])

    def integral(s: np.ndarray) -> np.ndarray:
        turn, s = np.divmod(s, arc[-1])
        i = np.minimum((s / step).astype(int), n - 1)
        t = s - i * step
        return turn * whole[-1] + whole[i] + t * (ring[i] + 0.5 * t / step * (ring[i + 1] - ring[i]))

    low, high = arc[:-1] - 0.5 * np.roll(length, 1), arc[:-1] + 0.5 * length
    return (integral(high) - integral(low)) / (high - low)
