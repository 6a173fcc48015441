"""Clutches in time: modules of motors and clutches, one for each side of a cell, from knot to knot."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ..kernel.source import FOLDER
from ..kernel.toolchain import library
from ..meshfree.contact import Surfaces
from ..parallel.random import stream

if TYPE_CHECKING:
    from ..model.clutch import Clutches

OPEN = -1.0  # in place of the force on a clutch


def traction(law: Clutches, forces: np.ndarray, spring: float, duration: float, draws: np.random.Philox) -> float:
    """Mean traction F [pN] of a module over a duration [µs], after which `forces` is its state.

    forces : (n_c,) float64 -- force on each clutch [pN], OPEN (-1) on an open one; changed;
    spring : κ_s of the substrate [pN/µm];  draws : what the times of events are drawn from.

    Source: the rules of Chan & Odde (2008); that events are exact is derived in kernel/c/clutches.c.
    """
    spring = max(spring, 1e-9 * law.stiffness)  # of a substrate without stiffness: nothing loads the clutches
    advance = library(FOLDER / "clutches.c").advance_clutches
    advance.restype = ctypes.c_double
    room, bits = np.empty_like(forces), draws.ctypes
    numbers = (law.stall, law.speed, spring, law.stiffness, law.on, law.off, law.force, duration)
    arrays = (ctypes.c_void_p(array.ctypes.data) for array in (forces, room))
    impulse = advance(ctypes.c_long(len(forces)), *arrays, *map(ctypes.c_double, numbers), bits.next_double, bits.state)
    return max(impulse / duration, 0.0)


def mean_traction(law: Clutches, spring: float, duration: float, seed: int, blocks: int = 20) -> tuple[float, float]:
    """Mean traction in the long run and its standard error [pN, pN], over a `duration` [µs] after a tenth of it.

    The error is that of the mean of blocks, which are to be longer than cycles of load and fail.

    Source: Flyvbjerg & Petersen (1989), J. Chem. Phys. 91:461-466, for means of blocks.
    """
    forces, draws = np.full(law.clutches, OPEN), stream(seed, "clutches alone", f"{spring}")
    traction(law, forces, spring, 0.1 * duration, draws)
    means = [traction(law, forces, spring, duration / blocks, draws) for _ in range(blocks)]
    return float(np.mean(means)), float(np.std(means, ddof=1) / blocks**0.5)


def edges(surfaces: Surfaces, x: np.ndarray, ways: np.ndarray) -> np.ndarray:
    """Places on the substrate below the ends of each cell along some directions (cells, sides, d) [µm].

    x : (m, d) float64 -- positions of all surface particles [µm];  ways : (sides, d - 1) float64 -- directions along
    the substrate [-].
    """
    bounds = np.searchsorted(surfaces.cell, np.arange(surfaces.cell[-1] + 2))
    found = np.array([x[a + (x[a:b, :-1] @ ways.T).argmax(axis=0)] for a, b in pairwise(bounds)])
    found[..., -1] = 0.0
    return found


class Modules:
    """The modules of all cells that pull, on each of their sides.

    forces : (cells, sides, n_c) float64 -- on the clutches [pN], OPEN (-1) on open ones: the state, to be kept.
    """

    def __init__(self, law: Clutches, seed: int, names: Sequence[str], pulling: Sequence[str], sides: int):
        """Open clutches; `names` : of all cells, by which random numbers are keyed;  `pulling` : of those that pull."""
        self.law, self.seed, self.names, self.pulling = law, seed, names, set(pulling)
        self.forces = np.full((len(names), sides, law.clutches), OPEN)

    def advance(self, knot: int, duration: float, modulus: np.ndarray) -> np.ndarray:
        """Factors of the pushes (cells, sides) [-]: mean tractions over F_s in a time up to a knot; 1 for others.

        duration : [µs];  modulus : (cells, sides) float64 -- Young's modulus E of the substrate below each side [Pa].

        Source: Chan & Odde (2008).
        """
        factor = np.ones(modulus.shape)
        for (cell, side), E in np.ndenumerate(modulus):
            if self.names[cell] not in self.pulling:
                continue
            draws = stream(self.seed, "clutches", f"{self.names[cell]}\0{side}\0{knot}")
            spring = float(self.law.spring(E))
            factor[cell, side] = traction(self.law, self.forces[cell, side], spring, duration, draws) / self.law.stall
        return factor
