"""Fields that diffuse, in time: steps as long as errors allow, and no molecule lost."""

from __future__ import annotations

import math
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from mpi4py import MPI

from ..model.diffusing import Diffusing
from ..parallel.collect import computed_on_root
from .exchange import Exchanging, Molecules
from .step import NumericsError
from .transport import SOLVED, Transport

DIRECT = {2: 100_000, 3: 20_000}  # volumes up to which a field in a flow is solved on rank 0 alone, with the same bits
BY_WAVES = 5  # times as many without a flow
ACCURACY = 1e-3  # largest error of a step, over the largest concentration [-]
SAFETY, SHORTER, LONGER = 0.8, 0.2, 2.0  # of the next step: share of the expected one, limits of its change
BALANCED = 1e-12  # error of the account of molecules, over its entries [-]
GAMMA = 1.0 - math.sqrt(0.5)  # of SDIRK of second order (Alexander 1977, SIAM J. Numer. Anal. 14:1006-1021)


@dataclass(frozen=True)
class _Stage:
    """Concentrations (n,) [1/µm³] that a stage of a step leads to; what flows there, over the time `weight` [µs]."""

    c: np.ndarray
    weight: float
    imbalance: np.ndarray
    rates: dict[str, Any]


class DiffusingField:
    """A field on a grid, and the molecules that it exchanges with cells.

    What a solve leaves over goes into the next step, so that the account of molecules closes for ever.

    Attributes
    ----------
    time : float -- up to which the field is known [µs].
    seconds : float -- wall time that it has taken here [s].
    whole : (volumes,) -- concentrations on rank 0, along x first [1/µm³]; None on others.
    molecules : Molecules -- on rank 0.
    steps, redone, lowered : int -- steps taken, those repeated for accuracy, those of second order that might have been
        negative.
    """

    def __init__(self, name: str, law: Diffusing, exchanging: Exchanging, cells: int, comm: MPI.Intracomm):
        """Begin with the start of the law; collective.

        name : of the field, and prefix of PETSc's options for its solver;  cells : number of cells of the scene.
        """
        self.name, self.law, self._comm = name, law, comm
        self._alone = math.prod(law.volumes) <= DIRECT[law.dimension] * (1 if any(law.flow) else BY_WAVES)
        self._here = comm.rank == 0 or not self._alone
        self.time = self.seconds = self._last = self._dt = 0.0
        self.steps = self.redone = self.lowered = 0
        self.molecules = Molecules(np.zeros(cells), np.zeros(cells))
        self.whole: Any = None
        self._surfaces: np.ndarray | None = None  # where they were at the time [µm]
        if self._here:
            world = MPI.COMM_SELF if self._alone else comm
            self.transport = t = Transport(name, law, exchanging, cells, world, self._alone)
            self._c = law.started(t.grid.centres)
            self._carried, self._rate = np.zeros(len(self._c)), np.zeros(len(self._c))
            if not law.quasi_steady:
                self.molecules.start = self.molecules.inside = t.total(t.grid.volume * self._c)
            self.whole = t.grid.gather(self._c)

    def value(self, x: np.ndarray, time: float) -> np.ndarray:
        """Concentrations (n,) [1/µm³] at x (n, d) [µm] at the time up to which it is known [µs]; on rank 0.

        Outside the box they are as at the nearest point of it.
        """
        number, weight = self.transport.grid.weights(x)
        return (weight * self.whole[number]).sum(axis=1)

    def exchange_by(self, exchanging: Exchanging) -> None:
        """Exchange with other facets of the same surfaces from now on."""
        if self._here:
            self.transport.exchanging = exchanging

    # ------------------------------------------------------------ time

    def advance(self, until: float, x: Any) -> None:
        """Go on to a time [µs] at which surface particles are at x (m, d) [µm], None but on rank 0; collective.

        Between the times of two calls they move evenly.  The first call, at the time 0, says where they start.

        Raises NumericsError where a cell that exchanges has left the box, or molecules are lost.
        """
        begun = perf_counter()
        if self._alone:
            self.time = computed_on_root(self._comm, lambda: self._advance(until, x))
        else:
            self.time = self._advance(until, self._comm.bcast(x))
        self.seconds += perf_counter() - begun

    def _advance(self, until: float, x: np.ndarray) -> float:
        interval, before = until - self.time, x if self._surfaces is None else self._surfaces
        if self.law.quasi_steady:
            self.transport.find_surfaces(x)
            found = self._stage(self._c, math.inf, interval)
            self._c = found.c
            self.molecules.enter(found.rates, interval)
        elif not isinstance(self.law.step, str):
            count = math.ceil(interval / self.law.step * (1.0 - 1e-12))
            for k in range(count):
                self._step(interval / count, _between(before, x, k / count, (k + 1) / count))
        elif interval > 0.0:
            self._steps_by_error(interval, before, x)
        self._surfaces = np.array(x)
        self.whole = self.transport.grid.gather(self._c)
        lost, turnover = self.molecules.lost, self.molecules.turnover
        allowed = self.molecules.rounded if self.law.quasi_steady else 0.0  # else the next step has what was rounded
        if not abs(lost) <= BALANCED * turnover + allowed:
            raise NumericsError(f"field {self.name}: {lost:.3g} of {turnover:.6g} molecules are lost to rounding: "
                                + self._remedy(interval))
        return until

    def _remedy(self, interval: float) -> str:
        """What to do where rounding of fluxes, over an `interval` [µs], is more than the account allows."""
        crossed = float(np.max(self.transport.grid.size * self.transport.grid.count)) ** 2 / self.law.diffusion
        if crossed < interval and not self.law.quasi_steady:
            return (f"it crosses the box in {1e-6 * crossed:.2g} s, far less than the {1e-6 * interval:.2g} s from one "
                    f"time to the next at which it is known: fields.{self.name}.quasi_steady = true is for such fields")
        return f"a larger fields.{self.name}.spacing, or a smaller diffusion, loses less"

    def _steps_by_error(self, interval: float, before: np.ndarray, x: np.ndarray) -> None:
        """As few equal steps as errors allow; their number is found anew after each."""
        # In the first step molecules go as far as the next volume.
        self._dt = self._dt or 0.5 * float(self.transport.grid.size.min()) ** 2 / self.law.diffusion
        at = 0.0
        while at < 1.0:
            parts = math.ceil((1.0 - at) * interval / self._dt)
            to = at + (1.0 - at) / parts if parts > 1 else 1.0
            if self._step((to - at) * interval, _between(before, x, at, to), True):
                at = to

    def _step(self, dt: float, ends: tuple[np.ndarray, np.ndarray], by_error: bool = False) -> bool:
        """Take a step [µs] in which surfaces move between two `ends` (m, d) [µm], unless it is too wrong `by_error`.

        Surfaces are where they are at the time of each stage.
        """
        t = self.transport
        start = self._start()
        stages = self._of_second_order(start, dt, ends) if self.law.time_order == 2 else []
        if not stages:
            t.find_surfaces(ends[1])
            stages = [self._stage(start, dt, dt)]
        c = stages[-1].c
        rate, last = (c - self._c) / dt, self._last or dt
        error = t.largest(dt**2 / (dt + last) * (rate - self._rate)) / max(t.largest(c), 1e-300)
        self._dt = dt * min(max(SAFETY * math.sqrt(ACCURACY / max(error, 1e-300)), SHORTER), LONGER)
        if by_error and self._last and error > ACCURACY:
            self.redone += 1
            return False
        self._carried = t.grid.volume * (start - c)
        for stage in stages:
            self._carried += stage.weight * stage.imbalance
            self.molecules.enter(stage.rates, stage.weight)
        self._c, self._rate, self._last = c, rate, dt
        self.steps += 1
        # In a steady state what rounding of fluxes loses has one sign: the next step has that, too.
        inside = t.total(c)
        self.molecules.inside = t.grid.volume * inside
        rest = -self.molecules.lost - t.total(self._carried)
        self._carried += rest / max(inside, 1e-300) * c
        return True

    def _start(self) -> np.ndarray:
        """Concentrations (n,) [1/µm³] before a step, with what the last one left over, of which none is negative."""
        t = self.transport
        start = self._c + self._carried / t.grid.volume
        if not t.largest(np.minimum(start.min(initial=0.0), 0.0)):
            return start
        above = np.maximum(start, 0.0)  # what is missing elsewhere is taken from all of it
        return above * (t.total(start) / t.total(above)) if t.total(start) > 0.0 else start

    def _stage(self, base: np.ndarray, tau: float, weight: float) -> _Stage:
        """Solve a stage from `base` over `tau` [µs], of which what flows counts for the time `weight` [µs]."""
        c, imbalance = self.transport.solved(base, tau, self._c)
        return _Stage(c, weight, imbalance, self.transport.rates(c))

    def _of_second_order(self, start: np.ndarray, dt: float, ends: tuple[np.ndarray, np.ndarray]) -> list[_Stage]:
        """Both stages of a step; none if the second one would begin with negative concentrations, and may stay so."""
        t, (before, x) = self.transport, ends
        t.find_surfaces(before + GAMMA * (x - before))
        first = self._stage(start, GAMMA * dt, (1.0 - GAMMA) * dt)
        base = start + (1.0 - GAMMA) / GAMMA * (first.c - start)
        if t.largest(np.minimum(base, 0.0)) > SOLVED * t.largest(first.c):
            self.lowered += 1
            return []
        t.find_surfaces(x)
        return [first, self._stage(np.maximum(base, 0.0), GAMMA * dt, GAMMA * dt)]

    # ------------------------------------------------------------ checkpoints

    def saved(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """State as JSON, and arrays on rank 0: by number of volume (volumes,), by cell, by particle; collective."""
        about = {"time": self.time, "last": self._last, "dt": self._dt, "steps": self.steps, "redone": self.redone,
                 "lowered": self.lowered, "molecules": self.molecules.saved()}
        arrays: dict[str, Any] = {}
        if self._here:
            about["iterations"] = self.transport.iterations
            arrays = {name: self.transport.grid.gather(values) for name, values in self._of_volumes().items()}
        if self._surfaces is not None:
            arrays["surfaces"] = self._surfaces
        return self._comm.bcast(about), arrays if self._comm.rank == 0 else {}

    def _of_volumes(self) -> dict[str, np.ndarray]:
        return {"c": self._c, "carried": self._carried, "rate": self._rate, "factored": self.transport.on_diagonal}

    def restore(self, about: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
        """Set the state that `saved` returned, on any number of ranks; collective."""
        self.time, self._last, self._dt = about["time"], about["last"], about["dt"]
        self.steps, self.redone, self.lowered = about["steps"], about["redone"], about["lowered"]
        self.molecules = Molecules.restored(about["molecules"])
        if self._here:
            grid = self.transport.grid
            self._c, self._carried, self._rate, factored = (
                grid.scatter(arrays.get(name)) for name in self._of_volumes())
            self.transport.factor(factored, about["iterations"])
            surfaces = arrays.get("surfaces")
            self._surfaces = surfaces if self._alone else self._comm.bcast(surfaces)
            self.whole = grid.gather(self._c)

    def close(self) -> None:
        """Free the PETSc objects; collective."""
        if self._here:
            self.transport.close()


def _between(before: np.ndarray, x: np.ndarray, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions at both ends of the part from `low` to `high` of the way from `before` to x."""
    return before + low * (x - before), before + high * (x - before)
