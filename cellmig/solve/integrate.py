"""Explicit time integration by PETSc's TS: leapfrog, as a TS type written in Python, or an explicit type of PETSc."""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np

from petsc4py import PETSc

from ..parallel.collect import Arrays, computed_on_root
from ..parallel.options import default_options, original_errors, requested_integrator, requested_step
from .leapfrog import Leapfrog
from .mechanics import Mechanics
from .renewal import due, renew
from .step import NO_EXTREMES, TYPICAL, NumericsError, StepControl, binding, widen

BATCH = 200  # largest number of steps before the stable step is computed again
STRAIN = 0.1  # largest change of the deformation until then [-]
PRESSED, SHORT = 0.25, 20  # while bonds are compressed: share of the stable step of contacts, largest number of steps
RECOVERY = 0.02  # growth of the expected gaps from batch to batch, over the equilibrium distance [-]
CLOSED = 0.8  # gap for which PETSc's types choose their steps, over the equilibrium distance [-]
LEAST_STEP = 1e-7  # a shorter stable step ends the run [µs]
_COUNTED = ("dt", "mechanism", "stable", "held", "count", "redone", "crossed", "extremes")
VOLUME = 0.5  # a larger |J - 1| ends the run: the fluids of the model are nearly incompressible


class Integrator:
    """Explicit time integration of the equation of motion of a Mechanics.

    Steps are taken in batches.  The stable step of a batch follows from the state at its begin and from the smallest
    gaps of contacts that are expected in it.  A batch of leapfrog in which a gap closed further is undone and repeated.

    Attributes
    ----------
    dt, stable : float -- step, and largest stable step [µs].
    held : float -- stiffness of bonds for which the modes were followed last [Pa/µm]; None before.
    mechanism : str -- what limits the stable step, a key of `StepControl.stable`.
    count : dict -- steps by mechanism.
    gaps : (2,) float -- smallest gaps that are expected, to the substrate and between cells [µm].
    redone : int -- steps that were undone and repeated.
    crossed : int -- batches in turn, up to the last, after which surfaces crossed.
    extremes : dict -- smallest and largest J [-] and step [µs].

    Source: leapfrog of Verlet (1967), as in Hairer, Lubich & Wanner (2003); batches that are repeated: derived here.
    """

    finer, instead = "time.step_factor", 'time.integrator = "leapfrog"'  # remedies by name, "" for none

    def __init__(self, mechanics: Mechanics, control: StepControl, kind: str, fixed_step: float | None, factor: float):
        """Create the TS; collective.

        kind : "leapfrog" or a TS type;  fixed_step : [µs], or None for `factor` [-] times the stable step.
        """
        self.mechanics, self.control, self.factor = mechanics, control, factor
        self.touches, self.redone, self.crossed, self.halted = control.touches, 0, 0, False
        self.mechanism, self.dt, self.stable, self._last_time = "", 0.0, math.inf, 0.0
        self.held: float | None = None
        self.count: dict[str, int] = {}
        self.extremes = dict(NO_EXTREMES)
        self.after_batch: Callable[[float], None] = lambda time: None
        self.within_step: Callable[[], None] = lambda: None  # called in each Newton step of implicit types
        self.report: Callable[[str], None] = lambda text: None
        self.fixed_step = requested_step(fixed_step)
        self.whole_step = self.fixed_step  # output times are rounded to whole numbers of it
        self.ts = self._ts(kind)
        self.leapfrog = self.ts.getType() == PETSc.TS.Type.PYTHON
        self._connect()
        # PETSc's types cannot repeat a batch: they assume that any gap may close this far
        self.gaps = control.typical if self.leapfrog else CLOSED / TYPICAL * control.typical
        self._loss: dict[str, np.ndarray] = {}

    def _connect(self) -> None:
        """Give TS the equations of motion."""
        if self.leapfrog:
            self.ts.setPythonContext(Leapfrog(self))
            self.ts.setPostStep(self._after_batch)
        else:
            self.ts.setRHSFunction(self._rate, self.mechanics.state.solution.duplicate())
            self.ts.setPostStep(self._after_step)

    def _ts(self, kind: str) -> PETSc.TS:
        """A TS of this type, unless -ts_type names another one."""
        ts = PETSc.TS().create(comm=self.mechanics.comm)
        ts.setProblemType(PETSc.TS.ProblemType.NONLINEAR)
        ts.setTime(0.0)
        ts.setMaxSteps(2**31 - 1)
        ts.setErrorIfStepFails(False)  # `advance_to` reports it, with a remedy
        ts.setExactFinalTime(PETSc.TS.ExactFinalTime.MATCHSTEP)
        ts.setType(PETSc.TS.Type.PYTHON if kind == "leapfrog" else requested_integrator(kind))
        self._configure(ts)
        return ts

    def _configure(self, ts: PETSc.TS) -> None:
        """Set the TS from the options; without -ts_adapt_type, StepControl chooses the steps."""
        with default_options({"ts_adapt_type": "none"}):
            ts.setFromOptions()

    @property
    def steps(self) -> int:
        """Number of steps taken."""
        return self.ts.getStepNumber()

    @property
    def between_samples(self) -> bool:
        """Whether a checkpoint can be written after any batch: PETSc's types can be saved only at samples."""
        return self.leapfrog

    @property
    def description(self) -> str:
        """Name of the integrator, for the log."""
        return "leapfrog" if self.leapfrog else f"{self.ts.getType()} of PETSc"

    @property
    def time(self) -> float:
        """Time reached [µs]."""
        return self.ts.getTime()

    @property
    def step_description(self) -> str:
        """Length of the steps, for the log; of explicit types "", whose stable step is described."""
        return ""

    @property
    def closing(self) -> str:
        """Further counts for the end of the log, if any."""
        return ""

    def record(self) -> dict[str, Any]:
        """Further counts for the manifest."""
        return {}

    def halt(self) -> None:
        """End `advance_to` after the current batch."""
        self.halted = True
        self.ts.setConvergedReason(PETSc.TS.ConvergedReason.CONVERGED_USER)

    def saved(self) -> dict[str, Any]:
        """State of the integrator for a checkpoint: what determines the next steps, and all counts."""
        numbers = {name: getattr(self, name) for name in ("time", "steps", *_COUNTED)}
        return deepcopy(numbers) | {"gaps": self.gaps.tolist()}

    def restore(self, about: dict[str, Any], arrays: Arrays) -> None:
        """Set the state from `about`, which `saved` returned, and `arrays` of the checkpoint, of any shape and unit.

        Call it after the state of the mechanics was restored.
        """
        for name in _COUNTED:
            setattr(self, name, deepcopy(about[name]))
        self.gaps = np.array(about["gaps"])
        if self.mechanics.renewals:
            self._take_neighbours()
        self.ts.setTime(about["time"])
        self.ts.setStepNumber(about["steps"])

    def rate(self) -> np.ndarray:
        """(v, a) of the owned particles (n_owned, 4) [µm/µs], [µm/µs²]; updates F and the reactions; collective."""
        return self.mechanics.rate()

    def arrays(self) -> dict[str, np.ndarray]:
        """Further arrays of a checkpoint, of any shape and unit, on rank 0."""
        return {}

    @property
    def finished(self) -> bool:
        """Whether `halt` was called or the number of steps of -ts_max_steps is reached."""
        return self.halted or self.steps >= self.ts.getMaxSteps()

    def advance_to(self, stop: float) -> float:
        """Integrate to the time `stop` [µs]; collective.

        Steps of a fixed length are not cut: the last one ends as near to `stop` as possible.

        Returns
        -------
        float -- the time reached [µs], earlier than `stop` where `finished`.

        Raises
        ------
        NumericsError -- where the state or the step is not sound (see `fail`).
        """
        ts, m = self.ts, self.mechanics
        if self.whole_step:
            stop = round(stop / self.whole_step) * self.whole_step
            if stop <= ts.getTime():
                return ts.getTime()
        ts.setMaxTime(stop)
        while True:
            self._go(stop)
            if self.finished or ts.getTime() >= stop or not due(m):
                return ts.getTime()

    def _go(self, stop: float) -> None:
        """Integrate to the time `stop` [µs], or until neighbours are to be found anew; collective."""
        ts, m = self.ts, self.mechanics
        self.follow_neighbours()
        if not self.leapfrog:
            self._expect_gaps()
            self.begin_batch()
            ts.setTimeStep(min(self.dt, stop - ts.getTime()))
            ts.restartStep()  # a checkpoint does not hold the rate that TS would reuse
            self._account_start()
        elif not self.steps:  # -ts_monitor prints the step before the first batch
            self.begin_batch()
            ts.setTimeStep(self.equal_steps(stop)[1])
        with original_errors():
            ts.solve(m.state.solution)
        if ts.getConvergedReason() < 0:
            self.fail("PETSc rejected a step as often as it may",
                      remedy="try a larger -ts_rtol or -ts_atol, or time.integrator = \"leapfrog\"")
        if not self.leapfrog:
            self._store(m.state.solution)
            m.state.exchange()
        self._checked_limits()

    def follow_neighbours(self) -> None:
        """Find neighbours anew where they are due, with the bounds of the step that follow; collective."""
        m = self.mechanics
        if m.terms.renewal is None:
            return
        m.resume()
        if due(m):
            renew(m, self.time)
            self._take_neighbours()
            self.held = None  # with others another mode may limit the step

    def _take_neighbours(self) -> None:
        """Set what depends on the neighbours, after they were found anew; collective."""
        m = self.mechanics
        self.control = computed_on_root(m.comm, lambda: StepControl(m.scene, m.terms))

    def _after_batch(self, ts: PETSc.TS) -> None:
        """Tell that a batch is done, and end the solve where neighbours are to be found anew."""
        self.after_batch(ts.getTime())
        if due(self.mechanics):
            ts.setConvergedReason(PETSc.TS.ConvergedReason.CONVERGED_USER)

    def equal_steps(self, stop: float) -> tuple[int, float]:
        """Number of equal steps from now to the time `stop` [µs], and their length [µs]."""
        left = stop - self.time
        if self.fixed_step:
            return round(left / self.dt), self.dt
        count = max(1, math.ceil(left / self.dt * (1.0 - 1e-12)))
        return count, left / count

    def begin_batch(self) -> int:
        """Choose the step, after new search lists where surfaces moved far; collective.

        Returns
        -------
        int -- number of steps for which step and search lists may serve.

        Raises
        ------
        NumericsError -- where the state is not sound or the stable step is below LEAST_STEP.
        """
        m = self.mechanics
        m.resume()
        limits = self._checked_limits()
        limits |= self.control.follow(m.modes, limits, self.gaps, self.stable, self.held if self.leapfrog else None)
        self.limits, self.held = limits, limits["held"]
        if self.touches and limits["displaced"] > m.segments.worn:
            m.renew_lists()
            limits["displaced"] = 0.0
        self.choose()
        if self.dt < LEAST_STEP:
            self.fail(f"the stable step fell to {self.dt:.2g} µs (set by {self.mechanism})")
        most = [BATCH, STRAIN / (self.dt * limits["strain_rate"] + 1e-300)]
        if self.touches:
            m.state.forget_contacts()
            room = 0.5 * m.segments.skin - limits["displaced"]
            pressed = self.leapfrog and self.control.compression(self.gaps) > 0.5
            most += [0.5 * room / (self.dt * limits["speed"] + 1e-300)] + [SHORT] * pressed
        return max(1, int(min(most)))

    def choose(self) -> None:
        """Set the step for the limits of the state at the begin of the batch and for the expected gaps."""
        self.mechanism, self.stable = binding(self.control.stable(self.limits, self.gaps))
        self.dt = self.fixed_step or self.factor * self._accurate_step(self.gaps)

    def _accurate_step(self, gaps: np.ndarray) -> float:
        """The step [µs] for these gaps (2,) [µm]: the stable one, or less where bonds are compressed.

        Compressed bonds release their energy within few steps: there accuracy, not stability, limits the step.
        """
        steps = self.control.stable(self.limits, gaps)
        if self.leapfrog and (pressed := self.control.compression(gaps)):
            steps["contact"] *= 1.0 - (1.0 - PRESSED) * pressed
        return self.mechanics.comm.bcast(binding(steps)[1])  # processors may differ in the last bit

    def was_stable(self, dt: float, seen: np.ndarray) -> bool:
        """Whether `dt` [µs] was stable at the least gaps `seen` (2,) [µm]; sets the expected gaps; collective."""
        if self.fixed_step or dt <= min(1.0, 1.2 * self.factor) * self._accurate_step(seen):
            self.gaps = np.minimum(seen, self.gaps + RECOVERY * self.control.eps)
            return True
        self.gaps = seen - RECOVERY * self.control.eps
        return False

    def _checked_limits(self) -> dict[str, float]:
        """Limits of the state (see `Mechanics.limits`), which is checked to be finite, with J near 1; collective.

        Raises NumericsError where a check fails.
        """
        limits = self.mechanics.limits()
        if not all(math.isfinite(limits[n]) for n in ("viscous", "elastic", "speed", "displaced")):
            self.fail("a value is not finite any more")
        if limits["J_min"] <= 0.0:
            self.fail("a particle is inverted")
        if max(1.0 - limits["J_min"], limits["J_max"] - 1.0) > VOLUME:
            self.fail(f"a particle does not keep its volume: J is to stay between {1 - VOLUME:g} and {1 + VOLUME:g}",
                      remedy=f"try {self._remedy('a larger modulus (reduced_bulk_modulus, volumetric_modulus)')}")
        if not self.leapfrog:  # the kernel follows J through the steps of leapfrog
            widen(self.extremes, "J", limits["J_min"], limits["J_max"])
        return limits

    def _remedy(self, *others: str) -> str:
        """A remedy for a message: smaller loads of those that the scene has, or `others`."""
        t = self.mechanics.terms
        tension, modulus = (getattr(t.cortex, name, None) for name in ("line_tension", "area_modulus"))
        loads = {"a weaker protrusion": t.protrusion is not None, "a smaller eta": t.director != "none",
                 "a smaller zeta": t.active, "a smaller line_tension": bool(tension),
                 "a smaller area_modulus": bool(modulus),
                 "a weaker cortex": t.cortex is not None and tension is None and modulus is None,
                 "a weaker body_force": t.acceleration is not None}
        *most, last = [name for name, there in loads.items() if there] + list(others)
        return f"{', '.join(most)} or {last}" if most else last

    def fail(self, cause: str, particle: int | None = None, remedy: str = "") -> None:
        """End the run with a message that names a particle, by default that with the largest |ln J|; collective.

        Raises NumericsError, always.
        """
        step, other = "time.step" if self.fixed_step else self.finer, "" if self.leapfrog else self.instead
        remedy = remedy or f"try {self._remedy(f'a smaller {step}', 'finer particles', *filter(None, [other]))}"
        if self.fixed_step and self.fixed_step > self.stable:
            remedy = (f"the step of {1e3 * self.fixed_step:.3g} ns is {self.fixed_step / self.stable:.2g} times the "
                      f"stable one, which {self.mechanism} sets: take time.step = \"auto\"")
        raise NumericsError.at(self.mechanics, self.time, cause, particle, remedy)

    # ------------------------------------------------------------ PETSc's own types

    def _expect_gaps(self) -> None:
        """Expect gaps of types that cannot repeat a batch: those of now, or smaller ones; collective."""
        self.mechanics.meet()
        seen = self.mechanics.extremes()
        self.gaps = np.minimum(CLOSED / TYPICAL * self.control.typical, self.control.gaps(seen.gap, seen.contact))

    def _store(self, vec: PETSc.Vec) -> None:
        """Copy a state from PETSc, unless it is in the same memory."""
        values = vec.getArray(readonly=True).reshape(-1, 2 * self.mechanics.scene.dimension)
        if not np.shares_memory(values, self.mechanics.state.owned):
            self.mechanics.state.owned[:] = values

    def _rate(self, ts: PETSc.TS, t: float, u: PETSc.Vec, out: PETSc.Vec) -> None:
        """Right-hand side for TS: the rate of the state `u` at the time t [µs]."""
        m = self.mechanics
        before = m.state.owned.copy()
        self._store(u)
        m.prescribe(t)
        out.setArray(m.rate(t - self._last_time).ravel())
        m.state.owned[:] = before

    def _after_step(self, ts: PETSc.TS) -> None:
        """Update director, accounts, extremes and search lists after a step of a PETSc type."""
        m = self.mechanics
        self._store(ts.getSolution())
        m.prescribe(ts.getTime())
        m.state.exchange()
        dt = ts.getTime() - self._last_time
        self._last_time = ts.getTime()
        m.end_step(dt)
        self._account(dt)
        self.count[self.mechanism] = self.count.get(self.mechanism, 0) + 1
        widen(self.extremes, "dt", dt, dt)
        if not np.isfinite(ts.getSolution().norm()):
            self.fail("a value is not finite any more")
        if self._checked_limits()["displaced"] > 0.5 * m.segments.skin:
            m.renew_lists()
            ts.restartStep()
        self._after_batch(ts)

    def _account_start(self) -> None:
        self._loss, self._last_time = self.mechanics.powers(), self.ts.getTime()

    def _account(self, dt: float) -> None:
        """Add dissipation, work and impulses of a step, by the trapezoidal rule."""
        now = self.mechanics.powers()
        for name, values in self.mechanics.accounts.everything.items():
            before = np.zeros_like(now[name])
            before[: len(self._loss[name])] = self._loss[name]  # contacts that are new had no force before
            values += 0.5 * dt * (before + now[name])
        self._loss = now

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.ts.destroy()
