"""PETSc's implicit TS types drive the steps: each a nonlinear system, solved by SNES with the tangent of all forces."""

from __future__ import annotations

import atexit
from itertools import count, product
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from petsc4py import PETSc

from ..meshfree.boundary import GAUSS
from ..parallel.options import defaulted
from ..parallel.reduce import exact_sum, extreme
from .equations import Equations
from .integrate import Integrator
from .mechanics import SKIN as EXPLICIT_SKIN
from .reduction import Reduction
from .static import DEFAULTS

SKIN = 4.0  # spacings: search lists last longer, whose cost is nothing against that of a step
FINE, MOST_PARTS = 0.04, 20  # pieces of a step's path in which its work is integrated, and most of them: ranges of
# bonds, where there are any, else so many spacings
BALANCE = 1e-8  # what forces may be out of balance, over the largest modulus x spacing, in the mean over particles
LOOSE = 1e-6  # the same if PETSc chooses the steps: their error is far larger
FORCING = "1e-2"  # by which Krylov methods reduce what is out of balance in a step of Newton's method
# Where the foot of a contact is as near on two segments, forces jump from one to the other and no state is in balance:
# that is taken from which Newton's steps lead no further, if they move particles by less than this in the mean
# [spacings, spacings/µs], and what is out of balance is less than ROUGH in the measure of BALANCE.
SETTLED, ROUGH = 4e-5, 1e-4
CUTS = 20  # times that a step may be cut
START = 10.0  # of the stable step of explicit schemes: the first step, if PETSc chooses them
STEPS = {"snes_max_it": "10"}  # of Newton's method: what has not converged then wants a shorter step in time
DIVERGED = 1e8  # times what was out of balance at first
ACCURACY = {"ts_adapt_type": "basic", "ts_atol": "1e-2", "ts_rtol": "0"}  # error of a step: 10 nm and 10 nm/µs
STIFF = 1e-6  # of the modulus of sound: what rounding leaves of forces is less by far


_NUMBERS = count()
_ALIVE: WeakValueDictionary[int, Any] = WeakValueDictionary()


@atexit.register
def _destroy_all() -> None:
    """PETSc's end comes after that of Python, in which the parts written in Python live: they go before."""
    for number in sorted(_ALIVE):
        _ALIVE[number].destroy()


class Implicit(Integrator):
    """Takes a Mechanics from stop to stop in steps as long as is asked for.

    newton : Newton steps so far;  krylov : iterations of linear solvers;  failures : solves that failed, each of which
    cut its step;  scheme_loss : what the scheme itself took from the motion, of all ranks' particles [pN].
    """

    def _connect(self) -> None:
        """Tell TS the equations, and SNES how to solve them."""
        m, ts = self.mechanics, self.ts
        self.whole_step = None
        m.skin *= SKIN / EXPLICIT_SKIN
        m.renew_lists()
        self.equations = Equations(m)
        self.newton = self.failures = 0
        self.scheme_loss = np.zeros(m.n_owned)
        _ALIVE[next(_NUMBERS)] = self
        ranges = self.control.ranges[self.control.ranges > 0.0]
        self._fine = float(ranges.min()) if len(ranges) else FINE * self.equations.spacing
        self._clipped, self.second_order = False, ts.getType() == PETSc.TS.Type.ALPHA2
        if self.second_order:
            self._x, self._v = (PETSc.Vec().createMPI((2 * m.n_owned, None), bsize=2, comm=m.comm) for _ in range(2))
            ts.setI2Function(self._residual2, self._x.duplicate())
            applied = self.equations.matrix
            if self.equations.matrix_free:
                applied = PETSc.Mat().createPython(applied.getSizes(), self.equations, comm=m.comm)
            ts.setI2Jacobian(self._tangent2, applied, self.equations.matrix)
            ts.setSolution2(self._x, self._v)
            with defaulted(self._defaults()):
                ts.setFromOptions()
        else:
            self._x = m.solution.duplicate()
            with defaulted(self._defaults()):
                self.reduction = Reduction(self.equations, ts.getSNES().getKSP())
                ts.setFromOptions()
            ts.setIFunction(self._residual, self._x.duplicate())
            ts.setIJacobian(self._tangent, self.reduction.matrix)
            ts.setSolution(self._x)

    def _configure(self, ts: PETSc.TS) -> None:
        """What is to be solved, before the options say how; a solve that fails cuts its step, as often as need be."""
        m = self.mechanics
        ts.setType(PETSc.Options().getString("ts_type", ts.getType()))
        modulus = max(max(l.shear_modulus, STIFF * l.density * l.sound_speed**2) for l in m.scene.materials)
        force = modulus * max(t.spacing for t in m.scene.templates) * np.sqrt(m.scene.size)
        balance = LOOSE if self.adaptive else BALANCE
        ts.getSNES().setTolerances(rtol=balance, atol=balance * force, stol=0.0)
        ts.getSNES().setConvergenceTest(self._converged)
        self._rough = ROUGH * force
        ts.setMaxSNESFailures(-1)
        ts.setMaxStepRejections(CUTS)

    @property
    def adaptive(self) -> bool:
        """Whether PETSc chooses the steps."""
        return self.fixed_step is None

    def _defaults(self) -> dict[str, str]:
        """Options but those that are given."""
        direct = PETSc.Options().getString("pc_type", DEFAULTS["pc_type"]) in ("lu", "cholesky")
        steps = STEPS | (ACCURACY if self.adaptive else {"ts_adapt_type": "none"})
        krylov = {"ksp_type": "gmres", "ksp_rtol": FORCING, "ksp_max_it": "20"} if self.equations.matrix_free else {}
        if not self.second_order:
            krylov = {f"reduction_{k}": v for k, v in (krylov or {"ksp_type": "preonly"}).items()}
        steps = steps | {"snes_max_linear_solve_fail": "1000000"}  # a direction that is not exact is one all the same
        return steps | krylov | {k: v for k, v in DEFAULTS.items()
                                 if k not in krylov and k not in steps and (direct or k != "pc_factor_mat_solver_type")}

    @property
    def step_description(self) -> str:
        """How long the steps are and how they are solved, for the log."""
        solver, ksp = self.ts.getSNES(), self.ts.getSNES().getKSP() if self.second_order else self.reduction.solver
        how = f"{solver.getType()} with {ksp.getType()} and {ksp.getPC().getType()}"
        if self.equations.matrix_free:
            how = f"{solver.getType()} with {solver.getKSP().getType()}, preconditioned by tangents that are kept"
        if self.adaptive:
            allowed = 1e3 * self.ts.getTolerances()[1]
            return f"PETSc's adaptivity to an error of {allowed:.3g} nm and nm/µs a step; {how}"
        return (f"{1e3 * self.fixed_step:.3g} ns as given, {self.fixed_step / self._stable():.3g} times the stable one "
                f"of leapfrog; {how}")

    def _converged(self, snes: Any, iteration: int, norms: tuple[float, float, float]) -> int:
        """Whether Newton's method is done, after one step at least: without it slow motion stops in long steps."""
        reason, (_, moved, norm) = PETSc.SNES.ConvergedReason, norms
        rtol, atol, _, _ = snes.getTolerances()
        if iteration == 0:
            self._norms = [norm]
            return reason.ITERATING if np.isfinite(norm) else reason.DIVERGED_FNORM_NAN
        first, last = self._norms[0], self._norms[-1]
        self._norms.append(norm)
        if not np.isfinite(norm):
            return reason.DIVERGED_FNORM_NAN
        if norm < max(atol, rtol * first):
            return reason.CONVERGED_FNORM_ABS
        if norm > DIVERGED * first:
            return reason.DIVERGED_DTOL
        near = SETTLED * self.equations.spacing * np.sqrt(2.0 * self.mechanics.scene.size)
        settled = moved < near and 0.5 * last < norm < self._rough
        return reason.CONVERGED_SNORM_RELATIVE if settled else reason.ITERATING

    # ------------------------------------------------------------ equations

    def _residual2(self, ts: Any, t: float, u: PETSc.Vec, v: PETSc.Vec, a: PETSc.Vec, out: PETSc.Vec) -> None:
        u, v, a = (x.getArray(readonly=True).reshape(-1, 2) for x in (u, v, a))
        out.setArray(self.equations.residual(t, u, v, a).ravel())

    def _tangent2(self, ts: Any, t: float, u: PETSc.Vec, v: PETSc.Vec, a: PETSc.Vec, by_v: float, by_a: float,
                  J: PETSc.Mat, P: PETSc.Mat) -> None:
        u, v = (x.getArray(readonly=True).reshape(-1, 2) for x in (u, v))
        ksp = ts.getSNES().getKSP()
        self.equations.linearise(t, u, v, by_v, by_a, ksp, ksp.getPC())
        J.assemble()

    def _residual(self, ts: Any, t: float, x: PETSc.Vec, rate: PETSc.Vec, out: PETSc.Vec) -> None:
        x, rate = (y.getArray(readonly=True).reshape(-1, 4) for y in (x, rate))
        second = self.equations.residual(t, x[:, :2], x[:, 2:], rate[:, 2:])
        out.setArray(np.hstack([rate[:, :2] - x[:, 2:], second]).ravel())

    def _tangent(self, ts: Any, t: float, x: PETSc.Vec, rate: PETSc.Vec, shift: float, J: PETSc.Mat,
                 P: PETSc.Mat) -> None:
        x = x.getArray(readonly=True).reshape(-1, 4)
        self.reduction.linearise(t, x[:, :2], x[:, 2:], shift)

    # ------------------------------------------------------------ steps

    def advance_to(self, stop: float) -> float:
        """Go on to the time `stop` [µs] or until TS has taken all its steps; returns the time reached; collective."""
        ts, m = self.ts, self.mechanics
        ts.setMaxTime(stop)
        self._checked_limits()
        m.renew_lists()
        self._give()
        while ts.getTime() < stop and not self.finished:
            self._choose(stop)
            self._step()
        m.state.exchange()
        self._checked_limits()
        return ts.getTime()

    def _choose(self, stop: float) -> None:
        """The length of the next step: as PETSc's adaptivity says; or as asked for, in equal steps to the stop."""
        left = stop - self.ts.getTime()
        if self.adaptive:
            last = self.dt if self._clipped else 0.0
            self.dt = max(self.ts.getTimeStep(), last) if self.dt else self.mechanics.comm.bcast(START * self._stable())
            self._clipped = self.dt > left
            self.ts.setTimeStep(min(self.dt, left))
            return
        self.dt = min(self.fixed_step, 2.0 * self.dt) if self.dt else self.fixed_step
        self.ts.setTimeStep(left / np.ceil(left / self.dt * (1.0 - 1e-12)))

    def _stable(self) -> float:
        """The stable step of explicit schemes at rest [µs]."""
        return min(self.control.stable().values())

    def _step(self) -> None:
        """One step of TS, or several tries."""
        ts, m, failed = self.ts, self.mechanics, self.ts.getSNESFailures()
        before, start = m.state.owned.copy(), ts.getTime()
        ts.step()
        failed = ts.getSNESFailures() - failed
        dt = ts.getTime() - start
        if ts.getConvergedReason() < 0 or not dt > 0.0:
            m.state.owned[:] = before
            m.rate()
            self.fail("no step was short enough for Newton's method", remedy="try a smaller time.step")
        if failed:
            self.failures += failed
            self.report(f"no solution at {start:.6g} µs: the step is cut to {dt:.3g} µs")
            self.dt = dt
        self._finish(before, start, dt)

    def _finish(self, before: np.ndarray, start: float, dt: float) -> None:
        """Accounts, director, lists and extremes after a step from `before`; collective."""
        ts, m = self.ts, self.mechanics
        self._receive()
        m.prescribe(ts.getTime())
        self._account_path(before, start, dt)
        m.relax_director(dt)
        limits = self._checked_limits()
        if limits["displaced"] > 0.2 * m.skin:
            m.renew_lists()
        self._give()
        self.newton = ts.getSNESIterations()
        self._note_step(dt)
        self.count["implicit"] = self.steps
        ts.monitor(self.steps, ts.getTime())
        self.after_batch(ts.getTime())

    def record(self) -> dict[str, Any]:
        """Counts for the manifest, and what the scheme took [pN]; collective."""
        taken = float(exact_sum(self.mechanics.comm, self.scheme_loss))
        return {"newton_steps": self.newton, "tangents": self.equations.assembled, "scheme_loss_pN": taken,
                "force_evaluations": self.equations.evaluated, "failed_solves": self.failures}

    def _receive(self) -> None:
        """The state from TS."""
        m = self.mechanics
        if self.second_order:
            u, v = self.ts.getSolution2()
            m.state.owned[:] = np.hstack([x.getArray(readonly=True).reshape(-1, 2) for x in (u, v)])
        else:
            m.state.owned[:] = self.ts.getSolution().getArray(readonly=True).reshape(-1, 4)
        m.state.exchange()

    def _give(self) -> None:
        """The state to TS."""
        owned = self.mechanics.state.owned
        if self.second_order:
            for vec, columns in zip(self.ts.getSolution2(), (owned[:, :2], owned[:, 2:]), strict=True):
                vec.setArray(columns.ravel())
        else:
            self.ts.getSolution().setArray(owned.ravel())

    def _account_path(self, before: np.ndarray, start: float, dt: float) -> None:
        """Losses and work along the straight path that the step took; what the scheme itself took is a loss, too."""
        m = self.mechanics
        after, mass = m.state.owned.copy(), self.equations.mass
        moved, work = after[:, :2] - before[:, :2], np.zeros(m.n_owned)
        longest = extreme(m.comm, np.array([np.abs(moved).max(initial=0.0)]))[0]
        parts = int(min(max(1.0, np.ceil(longest / self._fine)), MOST_PARTS))
        for part, (at, weight) in product(range(parts), GAUSS):
            at, share = (part + at) / parts, weight / parts
            a = self.equations.accelerate(start + at * dt, before[:, :2] + at * moved, moved / dt)
            work += share * (mass * a * moved).sum(axis=1)
            m.kernel("account", share * dt)
        m.set_clock(start + dt)
        m.state.owned[:] = after
        m.rate()
        motion = 0.5 * (mass * (after[:, 2:] ** 2 - before[:, 2:] ** 2)).sum(axis=1)
        self.scheme_loss += work - motion
        m.kernel["numerical_loss"][: m.n_owned] += work - motion

    def destroy(self) -> None:
        """Free the PETSc objects."""
        for number in [n for n, other in _ALIVE.items() if other is self]:
            del _ALIVE[number]
            self.ts.destroy()
            if not self.second_order:
                self.reduction.close()
            self.equations.close()
