"""Polarity of cells: the vector p along which a cell pushes, which cues turn and chance, too.

p has a component for each direction along the substrate: one in the side view, two in space.  It is found at knots,
which are fixed in time, and is linear in between.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..case.registry import law, parameter, quantity

KNOTS = 20  # in a persistence time


@dataclass(frozen=True, kw_only=True)
class _Polarity:
    """What laws of polarity have in common."""

    persistence: float
    start: tuple = quantity("", "p at the start: [1] or [-1], in space [x, y]; by default drawn at random", (),
                            shape=(None,))
    cells: tuple = parameter("names of cells that have a polarity; by default, and where none is named, all that "
                             "protrude", (), items="cell")

    @property
    def interval(self) -> float:
        """Time from knot to knot h [µs]."""
        return self.persistence / KNOTS

    def begun(self, start):
        """Polarities (…, n) [-] at the start, for a given `start` (n,) [-]."""
        return np.array(start)

    @property
    def kept(self) -> float:
        """Share of the polarity that is left after an interval, e^(-h/τ) [-]."""
        return math.exp(-1.0 / KNOTS)


@law("polarity", "relaxing")
class RelaxingPolarity(_Polarity):
    r"""Polarity that relaxes towards the sum of all cues, with Gaussian noise: τ dp/dt = -p + Σ cues + noise.

    This is an Ornstein-Uhlenbeck process, whose exact solution is taken from knot to knot: without cues each of the n
    components of p has the variance spread²/n, so that <p²> is spread², and a correlation that falls as e^(-t/τ).  A
    cell whose velocity is v p then has the mean square displacement 2 v² τ (t - τ (1 - e^(-t/τ))).

    Source: Uhlenbeck & Ornstein (1930), Phys. Rev. 36:823-841, for the exact step Gillespie (1996), Phys. Rev. E
    54:2084-2091; as a law of cell migration Dunn & Brown (1987), J. Cell Sci. Suppl. 8:81-102.
    """

    persistence: float = quantity("s", "persistence time τ", above=0)
    spread: float = quantity("", "root mean square of p without cues", 1.0, minimum=0)

    def drawn(self, towards, noise):
        """Polarities (…, n) [-] in the steady state, for cues `towards` and normal numbers `noise` (…, n) [-]."""
        return towards + self.spread / math.sqrt(noise.shape[-1]) * noise

    def next(self, p, towards, noise, chance):
        """Polarities (…, n) [-] at the next knot for cues `towards` (…, n) [-] and normal numbers `noise` (…, n) [-].

        chance : (…,) float -- in [0, 1) [-], which only other laws need.
        """
        size = self.spread * math.sqrt((1.0 - self.kept**2) / noise.shape[-1])
        return self.kept * p + (1.0 - self.kept) * towards + size * noise


@law("polarity", "switching")
class SwitchingPolarity(_Polarity):
    r"""Polarity of constant size that takes new directions at random times, at the rate 1/τ.

    A new direction is that of a Gaussian vector about the sum of all cues, whose components have the variance 1/n: a
    telegraph process in the side view, a run-and-tumble process in space.  Without cues its correlation falls as
    e^(-t/τ), and the mean square displacement is that of the relaxing polarity.

    Source: Goldstein (1951), Q. J. Mech. Appl. Math. 4:129-156; Berg (1993), Random Walks in Biology; the bias is
    derived here.
    """

    persistence: float = quantity("s", "mean time τ between new directions", above=0)
    spread: float = quantity("", "size of p", 1.0, minimum=0)
    start: tuple = quantity("", "direction of p at the start, of any length: [1] or [-1], in space [x, y]; by default "
                            "drawn at random", (), shape=(None,))

    def begun(self, start):
        """Polarities (…, n) [-] at the start along a given `start` (n,) [-]."""
        return self.spread * np.array(start) / np.linalg.norm(start)

    def drawn(self, towards, noise):
        """Polarities (…, n) [-] in a new direction, for cues `towards` and normal numbers `noise` (…, n) [-]."""
        way = towards + noise / math.sqrt(noise.shape[-1])
        return self.spread * way / np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-300)

    def next(self, p, towards, noise, chance):
        """Polarities (…, n) [-] at the next knot, new ones where `chance` (…,) [-] in [0, 1) is small enough."""
        return np.where((chance < 1.0 - self.kept)[..., None], self.drawn(towards, noise), p)
