"""PETSc's TS drives the steps: our symplectic scheme as a TS type of its own, or any explicit type of PETSc's."""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np

from petsc4py import PETSc

from ..parallel.options import defaulted, own_errors, step_asked
from .accounts import accounts
from .mechanics import Mechanics
from .step import NumericsError, StepControl, binding

BATCH = 200  # steps between two looks at the stable step
PRESSED, SHORT = 0.25, 20  # share of the contacts' step, and steps to the next look, while bonds are pressed
RECOVERY = 0.02  # of the bonds' range, by which the gaps that are expected widen from batch to batch
LEAST_STEP = 1e-7  # µs: below, the scene has broken
_COUNTED = ("dt", "mechanism", "stable", "count", "redone", "extremes")
VOLUME = 0.5  # how far J may be from 1: beyond, no fluid of the model keeps its volume


class Integrator:
    """Takes a Mechanics from stop to stop.

    steps : number of steps taken;  dt : last step [µs];  mechanism : what set it;  count : steps by mechanism;
    gaps : (2,) -- least gaps that are expected, to the substrate and between cells [µm];  redone : steps taken again.
    """

    def __init__(self, mechanics: Mechanics, control: StepControl, kind: str, fixed_step: float | None, factor: float):
        """`kind` : "leapfrog" or a TS type;  `fixed_step` [µs] or None for `factor` times the stable one."""
        self.mechanics, self.control, self.factor = mechanics, control, factor
        self.touches, self.redone = control.touches, 0
        self.mechanism, self.dt, self.stable, self.count = "", 0.0, math.inf, {}
        self.extremes = {"J_min": math.inf, "J_max": -math.inf, "dt_min": math.inf, "dt_max": 0.0}
        self.after_batch: Callable[[float], None] = lambda time: None
        self.halted = False
        self.report: Callable[[str], None] = lambda text: None
        self.fixed_step = step_asked(fixed_step)
        self.whole_step = self.fixed_step  # that no stop cuts
        self.ts = self._ts(kind)
        self.leapfrog = self.ts.getType() == PETSc.TS.Type.PYTHON
        self._connect()
        # PETSc's types take no batch again: for them any contact may close as far as it can
        self.gaps = control.typical if self.leapfrog else 0.0 * control.typical
        self._loss: dict[str, np.ndarray] = {}

    def _connect(self) -> None:
        """Tell TS the equations."""
        if self.leapfrog:
            self.ts.setPythonContext(Leapfrog(self))
            self.ts.setPostStep(lambda ts: self.after_batch(ts.getTime()))
        else:
            self.ts.setRHSFunction(self._rate, self.mechanics.solution.duplicate())
            self.ts.setPostStep(self._after_step)

    def _ts(self, kind: str) -> PETSc.TS:
        """A TS of this type, or of that of the options; steps are ours to choose unless -ts_adapt_type is given."""
        ts = PETSc.TS().create(comm=self.mechanics.comm)
        ts.setProblemType(PETSc.TS.ProblemType.NONLINEAR)
        ts.setTime(0.0)
        ts.setMaxSteps(2**31 - 1)
        ts.setErrorIfStepFails(False)  # it is told with what to do about it
        ts.setExactFinalTime(PETSc.TS.ExactFinalTime.MATCHSTEP)
        ts.setType(PETSc.TS.Type.PYTHON if kind == "leapfrog" else kind)
        self._obey(ts)
        return ts

    def _obey(self, ts: PETSc.TS) -> None:
        """The options; steps are ours to choose unless they say otherwise."""
        with defaulted({"ts_adapt_type": "none"}):
            ts.setFromOptions()

    @property
    def steps(self) -> int:
        """Steps taken so far."""
        return self.ts.getStepNumber()

    @property
    def between_samples(self) -> bool:
        """Whether its state can be saved after any batch; what PETSc's types keep to themselves is gone at a sample."""
        return self.leapfrog

    @property
    def said(self) -> str:
        """What it is, for the log."""
        return "leapfrog" if self.leapfrog else f"{self.ts.getType()} of PETSc"

    @property
    def time(self) -> float:
        """Time reached [µs]."""
        return self.ts.getTime()

    steps_said = ""  # of implicit types, for the log

    def record(self) -> dict[str, Any]:
        """Counts for the manifest."""
        return {}

    def halt(self) -> None:
        """Take no further step."""
        self.halted = True
        self.ts.setConvergedReason(PETSc.TS.ConvergedReason.CONVERGED_USER)

    def saved(self) -> dict[str, Any]:
        """What decides its next steps and what it counts, for a checkpoint."""
        numbers = {name: getattr(self, name) for name in ("time", "steps", *_COUNTED)}
        return deepcopy(numbers) | {"gaps": self.gaps.tolist()}

    def restore(self, about: dict[str, Any]) -> None:
        """Go on from what was saved; the mechanics have been restored."""
        for name in _COUNTED:
            setattr(self, name, deepcopy(about[name]))
        self.gaps = np.array(about["gaps"])
        self.ts.setTime(about["time"])
        self.ts.setStepNumber(about["steps"])

    def rate(self) -> np.ndarray:
        """(v, a) of the owned particles (n_owned, 4); F and reactions are brought up to date; collective."""
        return self.mechanics.rate()

    @property
    def finished(self) -> bool:
        """Whether it was told to stop, or TS has no steps left (-ts_max_steps)."""
        return self.halted or self.steps >= self.ts.getMaxSteps()

    def to(self, stop: float) -> float:
        """Go on to the time `stop` [µs] or until TS has taken all its steps; returns the time reached; collective.

        Steps of a fixed length are not cut: they end as near to `stop` as they can.
        """
        ts, m = self.ts, self.mechanics
        if self.whole_step:
            stop = round(stop / self.whole_step) * self.whole_step
            if stop <= ts.getTime():
                return ts.getTime()
        ts.setMaxTime(stop)
        if not self.leapfrog:
            self.look()
            ts.setTimeStep(min(self.dt, stop - ts.getTime()))
            ts.restartStep()  # a rate kept from the last step is not that of a state which was saved
            self._account_start()
        elif not self.steps:  # for -ts_monitor, whose first line comes before the first batch
            self.look()
            ts.setTimeStep(self.evenly(stop)[1])
        with own_errors():
            ts.solve(m.solution)
        if ts.getConvergedReason() < 0:
            self.broken("PETSc rejected a step as often as it may",
                        remedy="try a larger -ts_rtol or -ts_atol, or time.integrator = \"leapfrog\"")
        if not self.leapfrog:
            self._take(m.solution)
            m.state.exchange()
        self._seen()
        return ts.getTime()

    def evenly(self, stop: float) -> tuple[int, float]:
        """How many steps are left to a stop, and their length [µs]."""
        left = stop - self.time
        if self.fixed_step:
            return round(left / self.dt), self.dt
        count = max(1, math.ceil(left / self.dt * (1.0 - 1e-12)))
        return count, left / count

    def look(self) -> int:
        """Renew the search lists if need be and choose the step; returns how many steps they allow; collective."""
        m = self.mechanics
        m.undo.take_up()
        self.limits = limits = self._seen()
        if self.touches and limits["displaced"] > 0.2 * m.skin:
            m.renew_lists()
            limits["displaced"] = 0.0
        self.choose()
        if self.dt < LEAST_STEP:
            self.broken(f"the stable step fell to {self.dt:.2g} µs (set by {self.mechanism})")
        if not self.touches:
            return BATCH
        m.least_gaps()  # those of the steps to come count
        room = 0.5 * m.skin - limits["displaced"]
        most = SHORT if self._pressed(self.gaps) > 0.5 else BATCH
        return max(1, min(most, int(0.5 * room / (self.dt * limits["speed"] + 1e-300))))

    def choose(self) -> None:
        """The step for the state as it was looked at and the gaps that are expected."""
        self.mechanism, self.stable = binding(self.control.stable(self.limits, self.gaps))
        self.dt = self.fixed_step or self.factor * self._accurate(self.gaps)

    def _pressed(self, gaps: np.ndarray) -> float:
        """How far bonds are compressed, 0 at half of their range, 1 at a quarter, as where cells start too low [-]."""
        there = self.control.ranges > 0.0
        share = np.clip(2.0 - 4.0 * gaps[there] / self.control.ranges[there], 0.0, 1.0)
        return float(share.max(initial=0.0)) if self.leapfrog else 0.0

    def _accurate(self, gaps: np.ndarray) -> float:
        """The stable step for these gaps, less where pressed bonds fling surfaces apart: energy wants finer steps."""
        steps = self.control.stable(self.limits, gaps)
        if pressed := self._pressed(gaps):
            steps["contact"] *= 1.0 - (1.0 - PRESSED) * pressed
        return self.mechanics.comm.bcast(binding(steps)[1])  # ranks may be on unlike processors

    def was_stable(self, dt: float) -> bool:
        """Whether no gap of the last batch closed so far that `dt` was too large; what is expected next; collective."""
        seen = self.mechanics.least_gaps()
        if self.fixed_step or dt <= min(1.0, 1.2 * self.factor) * self._accurate(seen):
            self.gaps = np.minimum(seen, self.gaps + RECOVERY * self.control.ranges)
            return True
        self.gaps = seen - RECOVERY * self.control.ranges
        return False

    def _seen(self) -> dict[str, float]:
        """Limits of the state as it is, which is sound; collective."""
        limits = self.mechanics.limits()
        if not all(math.isfinite(limits[n]) for n in ("viscous", "elastic", "speed", "displaced")):
            self.broken("a value is not finite any more")
        if limits["J_min"] <= 0.0:
            self.broken("a particle is inverted")
        if max(1.0 - limits["J_min"], limits["J_max"] - 1.0) > VOLUME:
            self.broken(f"a particle does not keep its volume: J is to stay between {1 - VOLUME:g} and {1 + VOLUME:g}",
                        remedy=f"try {self._lighter('a larger modulus (reduced_bulk_modulus, lame)')}")
        if not self.leapfrog:  # which takes no step to see it undone, and looks at all of them
            self._note_volumes(limits["J_min"], limits["J_max"])
        return limits

    def look_at_volumes(self) -> None:
        """Note the extremes of J in the steps of leapfrog since this was last called; collective."""
        self._note_volumes(*self.mechanics.volumes())

    def _note_volumes(self, least: float, most: float) -> None:
        self.extremes["J_min"] = min(self.extremes["J_min"], least)
        self.extremes["J_max"] = max(self.extremes["J_max"], most)

    def _lighter(self, *others: str) -> str:
        """What might help: less of the loads that the scene has, and others."""
        t = self.mechanics.terms
        loads = {"a weaker protrusion": t.protrusion is not None, "a smaller eta": t.director != "none",
                 "a smaller zeta": t.active, "a smaller line_tension": t.cortex is not None,
                 "a weaker body_force": t.acceleration is not None}
        *most, last = [name for name, there in loads.items() if there] + list(others)
        return f"{', '.join(most)} or {last}" if most else last

    def broken(self, cause: str, particle: int | None = None, remedy: str = "") -> None:
        """End the run, with a particle, by default that which is worst off, and a remedy; collective."""
        particle, J = self.mechanics.worst_particle(particle)
        scene = self.mechanics.scene
        other = [] if self.leapfrog else ['time.integrator = "leapfrog"']
        remedy = remedy or f"try {self._lighter('a smaller time.step_factor', 'finer particles', *other)}"
        if self.fixed_step and self.fixed_step > self.stable:
            remedy = (f"the step of {1e3 * self.fixed_step:.3g} ns is {self.fixed_step / self.stable:.2g} times the "
                      f"stable one, which {self.mechanism} sets: take time.step = \"auto\"")
        raise NumericsError(f"the numbers broke at {self.ts.getTime():.6g} µs: {cause}; particle {particle} of cell "
                            f"{int(scene.cell[particle]) + 1} has J = {J:.4g}; {remedy}")

    # ------------------------------------------------------------ PETSc's own types

    def _take(self, vec: PETSc.Vec) -> None:
        values = vec.getArray(readonly=True).reshape(-1, 4)
        if not np.shares_memory(values, self.mechanics.state.owned):
            self.mechanics.state.owned[:] = values

    def _rate(self, ts: Any, t: float, u: PETSc.Vec, out: PETSc.Vec) -> None:
        m = self.mechanics
        kept = m.state.owned.copy()
        self._take(u)
        m.prescribe(t)
        out.setArray(m.rate().ravel())
        m.state.owned[:] = kept

    def _after_step(self, ts: Any) -> None:
        m = self.mechanics
        self._take(ts.getSolution())
        m.prescribe(ts.getTime())
        m.state.exchange()
        dt = ts.getTime() - self._last_time
        self._last_time = ts.getTime()
        m.relax_director(dt)
        self._account(dt)
        self.count[self.mechanism] = self.count.get(self.mechanism, 0) + 1
        self._note_step(dt)
        if not np.isfinite(ts.getSolution().norm()):
            self.broken("a value is not finite any more")
        if self._seen()["displaced"] > 0.5 * m.skin:
            m.renew_lists()
            ts.restartStep()
        self.after_batch(ts.getTime())

    def _note_step(self, dt: float) -> None:
        self.extremes["dt_min"] = min(self.extremes["dt_min"], dt)
        self.extremes["dt_max"] = max(self.extremes["dt_max"], dt)

    def _account_start(self) -> None:
        self._loss, self._last_time = self.mechanics.powers(), self.ts.getTime()

    def _account(self, dt: float) -> None:
        """Losses and work over a step by the trapezoidal rule."""
        now = self.mechanics.powers()
        for name, values in accounts(self.mechanics).items():
            before = np.zeros_like(now[name])
            before[: len(self._loss[name])] = self._loss[name]  # contacts that are new had no force
            values += 0.5 * dt * (before + now[name])
        self._loss = now

    def destroy(self) -> None:
        """Free the PETSc object."""
        self.ts.destroy()


class Leapfrog:
    """TS type: v += dt a(u, v), u += dt v, in batches of equal steps that end exactly at the time asked for, but for
    steps of a fixed length, which stay as they are.

    TS counts single steps; -ts_dt, -ts_max_steps and -ts_monitor (once a batch) mean what they say.
    """

    def __init__(self, integrator: Integrator):
        self._integrator = integrator

    def step(self, ts: PETSc.TS) -> None:
        """One batch."""
        run = self._integrator
        allowed = run.look()
        t, stop, taken = ts.getTime(), ts.getMaxTime(), ts.getStepNumber()
        if run.touches:
            run.mechanics.undo.keep()
        while True:
            left, dt = run.evenly(stop)
            run.mechanics.set_clock(t, *((0.0, taken) if run.fixed_step else (t, 0)))
            n = min(allowed, left, ts.getMaxSteps() - taken)
            run.mechanics.advance(n, dt)
            if not run.touches:
                break
            late = run.mechanics.lists_are_late()
            if run.was_stable(dt) and not (late and n > 1):
                break
            run.mechanics.undo.go_back()
            run.choose()
            run.redone += n
            allowed = max(1, n // 4) if late else allowed
        run.look_at_volumes()
        run.mechanics.solution.stateIncrease()
        run.count[run.mechanism] = run.count.get(run.mechanism, 0) + n
        run._note_step(dt)
        ts.setTimeStep(dt)
        ts.setTime(stop if n == left else (taken + n) * dt if run.fixed_step else t + n * dt)
        ts.setStepNumber(taken + n - 1)  # TS adds the last one itself
