"""Implicit time integration by PETSc's TS: a nonlinear system for each step, solved by SNES with the exact tangent."""

from __future__ import annotations

from typing import Any

import numpy as np

from petsc4py import PETSc

from ..parallel.options import default_options
from ..parallel.reduce import exact_sum, largest
from .at_exit import destroyed, kept
from .equations import Equations
from .integrate import Integrator
from .reduction import Reduction
from .segments import SKIN as EXPLICIT_SKIN
from .static import DEFAULTS
from .step import widen

SKIN = 4.0  # margin of the search lists [spacings]: larger lists cost nothing beside an implicit step
FINE = 0.04  # length of pieces in which the work of a step is added up, if no bonds set it [spacings]
BALANCE = 1e-8  # root mean square residual of a particle, over largest modulus × spacing [-]
LOOSE = 1e-6  # the same if PETSc chooses the steps, whose error is far larger
FORCING = "1e-2"  # relative tolerance of Krylov methods in a Newton step
LONGEST = 0.14  # largest displacement of a Newton step [spacings]
HALVINGS = 6  # number of times that a Newton step is halved where surfaces cross
RELAXING = 0.5  # parts of a step in which directors relax, over the stable one
CUTS = 20  # number of times that a step may be cut
MANY, OFTEN = 10, 0.1  # solves that failed, and their share of the steps, above which the log says what is cheaper
START = 10.0  # first step over the stable one of explicit schemes, if PETSc chooses the steps [-]
STEPS = {"snes_max_it": "14", "snes_max_linear_solve_fail": "1000000"}  # those of Newton's method may be inexact
DIVERGED = 1e8  # a solve fails where its residual has grown by this factor
ACCURACY = {"ts_adapt_type": "basic", "ts_atol": "1e-2", "ts_rtol": "0"}  # error of a step: 10 nm and 10 nm/µs
STIFF = 1e-6  # smallest shear modulus in the scale of residuals, over the modulus of sound: far above rounding errors


class Implicit(Integrator):
    """Implicit time integration of the equation of motion of a Mechanics.

    ALPHA2 solves the equation of second order for u; types of first order solve for (u, v), reduced to u (`Reduction`).

    Attributes
    ----------
    newton, failures : int -- Newton steps, and solves that failed, each of which cut its step.
    trying : int -- iterations of Newton's method in the step that is being taken, of all lengths that were tried.
    advice : str -- said once where many solves fail, if there is any.
    scheme_loss : (n_owned,) float -- what the scheme took: work of all forces less kinetic energy [pN, in 3D pN µm].

    Source: ALPHA2 by Chung & Hulbert (1993), BDF, THETA, CN and BEULER as in PETSc's manual.
    """

    finer = "-ts_atol"
    advice = ("surfaces that snap to each other want steps of ns, which cost less with time.integrator = \"leapfrog\"; "
              "'cellmig validate' tells what both take")

    def _connect(self) -> None:
        """Give TS the equations, and SNES its solvers."""
        m, ts = self.mechanics, self.ts
        self.whole_step = None
        m.segments.skin *= SKIN / EXPLICIT_SKIN
        m.renew_lists()
        self.equations = self._equations()
        self.newton = self.failures = self.trying = 0
        self.scheme_loss = np.zeros(m.n_owned)
        kept(self)
        eps = self.control.eps[self.control.eps > 0.0]
        self._piece = float(eps.min()) if len(eps) else FINE * self.equations.spacing
        self.reduction: Any = None  # of types of first order
        self._clipped, self.second_order = False, ts.getType() == PETSc.TS.Type.ALPHA2
        self._pose()

    def _equations(self) -> Equations:
        return Equations(self.mechanics)

    def _pose(self) -> None:
        """Give TS the residual, its tangent and the unknowns."""
        m, ts = self.mechanics, self.ts
        if self.second_order:
            self._x, self._v = (self._displacements() for _ in range(2))
            ts.setI2Function(self._residual2, self._x.duplicate())
            ts.setI2Jacobian(self._tangent2, self.equations.applied(), self.equations.matrix)
            ts.setSolution2(self._x, self._v)
            with default_options(self._defaults()):
                ts.setFromOptions()
        else:
            self._x = m.state.solution.duplicate()
            with default_options(self._defaults()):
                self.reduction = Reduction(self.equations, ts.getSNES().getKSP())
                ts.setFromOptions()
            ts.setIFunction(self._residual, self._x.duplicate())
            ts.setIJacobian(self._tangent, self.reduction.matrix)
            ts.setSolution(self._x)

    def _take_neighbours(self) -> None:
        """Set equations, tangent and bounds of the step anew; the next step is one without a history; collective."""
        super()._take_neighbours()
        counted = self.equations.evaluated, self.equations.assembled
        self._close_equations()
        self.equations = self._equations()
        self.equations.evaluated, self.equations.assembled = counted
        self._pose()
        self._to_petsc()
        self.ts.restartStep()

    def _close_equations(self) -> None:
        """Free the PETSc objects of the equations."""
        if self.reduction is not None:
            self.reduction.close()
        self.equations.close()

    def _displacements(self) -> PETSc.Vec:
        """A Vec of the components of vectors (n_owned, d); collective."""
        d = self.mechanics.scene.dimension
        return PETSc.Vec().createMPI((d * self.mechanics.n_owned, None), bsize=d, comm=self.mechanics.comm)

    def _configure(self, ts: PETSc.TS) -> None:
        """Set tolerances before options are read; a solve that fails cuts its step, up to CUTS times."""
        m = self.mechanics
        ts.setType(PETSc.Options().getString("ts_type", ts.getType()))
        modulus = max(max(l.shear_modulus, STIFF * l.density * l.sound_speed**2) for l in m.scene.materials)
        size = max(t.spacing for t in m.scene.templates) ** (m.scene.dimension - 1)
        force = modulus * size * np.sqrt(m.scene.size)
        balance = LOOSE if self.adaptive else BALANCE
        ts.getSNES().setTolerances(rtol=balance, atol=balance * force, stol=0.0)
        ts.getSNES().setConvergenceTest(self._converged)
        ts.getSNES().setLineSearchPreCheck(self._shorten)
        ts.setMaxSNESFailures(-1)
        ts.setMaxStepRejections(CUTS)

    @property
    def reduced(self) -> bool:
        """Whether the unknowns are (u, v), of which v is eliminated."""
        return not self.second_order

    @property
    def adaptive(self) -> bool:
        """Whether PETSc's error control chooses the steps."""
        return self.fixed_step is None

    def _defaults(self) -> dict[str, str]:
        """Default options."""
        direct = PETSc.Options().getString("pc_type", DEFAULTS["pc_type"]) in ("lu", "cholesky")
        steps = STEPS | (ACCURACY if self.adaptive else {"ts_adapt_type": "none"})
        krylov = {"ksp_type": "gmres", "ksp_rtol": FORCING, "ksp_max_it": "20"} if self.equations.matrix_free else {}
        if self.reduced:
            krylov = {f"reduction_{k}": v for k, v in (krylov or {"ksp_type": "preonly"}).items()}
        return steps | krylov | {k: v for k, v in DEFAULTS.items()
                                 if k not in krylov and k not in steps and (direct or k != "pc_factor_mat_solver_type")}

    @property
    def remedy(self) -> str:
        """What to try where no step is short enough."""
        return "try a smaller time.step"

    @property
    def solvers(self) -> str:
        """Solvers, for the log."""
        solver = self.ts.getSNES()
        if self.equations.matrix_free:
            return f"{solver.getType()} with {solver.getKSP().getType()}, preconditioned by tangents that are kept"
        ksp = self.reduction.solver if self.reduced else solver.getKSP()
        return f"{solver.getType()} with {ksp.getType()} and {ksp.getPC().getType()}"

    @property
    def step_description(self) -> str:
        """Length of the steps, and solvers, for the log."""
        if self.fixed_step is None:
            allowed = 1e3 * self.ts.getTolerances()[1]
            return f"PETSc's adaptivity to an error of {allowed:.3g} nm and nm/µs a step; {self.solvers}"
        given, ratio = self.mechanics.scene.time_unit.step(self.fixed_step), self.fixed_step / self._stable()
        return f"{given} as given, {ratio:.3g} times the stable one of leapfrog; {self.solvers}"

    def _converged(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int:
        """Reason to end Newton's method, else 0; one step at least is taken, else slow motion would not begin."""
        reason, (_, _, norm) = PETSc.SNES.ConvergedReason, norms
        self.trying += 1
        self.within_step()
        if self.halted:  # all lengths of the step fail at once, and it is undone
            return reason.DIVERGED_FUNCTION_DOMAIN
        rtol, atol, _, _ = snes.getTolerances()
        if iteration == 0:
            self._first = norm
            return reason.ITERATING if np.isfinite(norm) else reason.DIVERGED_FNORM_NAN
        if not np.isfinite(norm):
            return reason.DIVERGED_FNORM_NAN
        if norm < max(atol, rtol * self._first):
            return reason.CONVERGED_FNORM_ABS
        if norm > DIVERGED * self._first:
            return reason.DIVERGED_DTOL
        return reason.ITERATING

    def _shorten(self, x: PETSc.Vec, step: PETSc.Vec) -> bool:
        """Shorten a Newton step to LONGEST, and until no surfaces cross and no particle is inverted; collective.

        Returns whether it was shortened.  Source: step limits of incremental potential contact, Li et al. (2020).
        """
        most = LONGEST * self.equations.spacing / max(largest(self.mechanics.comm, self._move(step)), 1e-300)
        share = min(1.0, most)
        trial, out = x.duplicate(), x.duplicate()
        for _ in range(HALVINGS):
            trial.waxpy(-share, step, x)
            self.ts.getSNES().computeFunction(trial, out)
            better = self._better(share, most, step, out)
            if better == share:
                break
            share = better
        step.scale(share)
        trial.destroy()
        out.destroy()
        return share < 1.0

    def _better(self, share: float, most: float, step: PETSc.Vec, out: PETSc.Vec) -> float:
        """The share of a Newton step [-], up to `most`, to take in place of one whose end has the residual `out`, nan
        where surfaces cross [pN/µm]; the same one if it may stay.
        """
        return share if np.isfinite(out.norm()) else 0.5 * share

    def _move(self, step: PETSc.Vec) -> np.ndarray:
        """Displacements (n_owned, d) [µm] of a Newton step."""
        return self._vectors(step) if self.second_order else self.equations.halves(step)[0]

    # ------------------------------------------------------------ equations

    def _residual2(self, ts: PETSc.TS, t: float, u: PETSc.Vec, v: PETSc.Vec, a: PETSc.Vec, out: PETSc.Vec) -> None:
        u, v, a = (self._vectors(x) for x in (u, v, a))
        out.setArray(self.equations.residual(t, u, v, a).ravel())

    def _tangent2(self, ts: PETSc.TS, t: float, u: PETSc.Vec, v: PETSc.Vec, a: PETSc.Vec, by_v: float, by_a: float,
                  J: PETSc.Mat, P: PETSc.Mat) -> None:
        u, v = (self._vectors(x) for x in (u, v))
        ksp = ts.getSNES().getKSP()
        self.equations.linearise(t, u, v, by_v, by_a, ksp, ksp.getPC(), self._first_iteration)
        J.assemble()

    def _residual(self, ts: PETSc.TS, t: float, x: PETSc.Vec, rate: PETSc.Vec, out: PETSc.Vec) -> None:
        (u, v), (rate_of_u, a) = (self.equations.halves(y) for y in (x, rate))
        out.setArray(np.hstack([rate_of_u - v, self.equations.residual(t, u, v, a)]).ravel())

    def _tangent(self, ts: PETSc.TS, t: float, x: PETSc.Vec, rate: PETSc.Vec, shift: float, J: PETSc.Mat,
                 P: PETSc.Mat) -> None:
        u, v = self.equations.halves(x)
        self.reduction.linearise(t, u, v, shift, self._first_iteration)

    def _vectors(self, x: PETSc.Vec) -> np.ndarray:
        """Vectors (n_owned, d) of a Vec."""
        return x.getArray(readonly=True).reshape(self.equations.free.shape)

    @property
    def _first_iteration(self) -> bool:
        return self.ts.getSNES().getIterationNumber() == 0

    # ------------------------------------------------------------ steps

    def advance_to(self, stop: float) -> float:
        """Integrate to the time `stop` [µs]; collective.

        Returns
        -------
        float -- the time reached [µs], earlier than `stop` where `finished`.

        Raises
        ------
        NumericsError -- where no step is short enough, or the state is not sound.
        """
        ts, m = self.ts, self.mechanics
        ts.setMaxTime(stop)
        self._checked_limits()
        m.renew_lists()
        self._to_petsc()
        accepted = True
        while ts.getTime() < stop and not self.finished:
            if accepted:  # TS begins a step that is repeated where the last one began, with the unknowns of then
                self.follow_neighbours()
            self._choose_step(stop)
            accepted = self._step()
        m.state.exchange()
        self._checked_limits()
        return ts.getTime()

    def _choose_step(self, stop: float) -> None:
        """Set the next step: that of PETSc's error control, else equal ones to `stop` [µs], at most the fixed one."""
        left = stop - self.ts.getTime()
        if self.fixed_step is None:
            last = self.dt if self._clipped else 0.0
            self.dt = max(self.ts.getTimeStep(), last) if self.dt else self.mechanics.comm.bcast(START * self._stable())
            self._clipped = self.dt > left
            self.ts.setTimeStep(min(self.dt, left))
            return
        self.dt = min(self.fixed_step, 2.0 * self.dt) if self.dt else self.fixed_step
        self.ts.setTimeStep(left / np.ceil(left / self.dt * (1.0 - 1e-12)))

    def _stable(self) -> float:
        """Stable step of leapfrog on the reference configuration [µs]."""
        return min(self.control.stable().values())

    def _step(self) -> bool:
        """Take one step of TS, which may try several lengths; whether it was accepted."""
        ts, m, failed = self.ts, self.mechanics, self.ts.getSNESFailures()
        before, start = m.state.owned.copy(), ts.getTime()
        self.equations.begin(start)
        self.trying = 0
        ts.step()
        failed = ts.getSNESFailures() - failed
        dt = ts.getTime() - start
        if self.halted and not dt > 0.0:
            self._undo(before)
            return False
        if ts.getConvergedReason() < 0 or not dt > 0.0:
            m.state.owned[:] = before
            m.rate(0.0)
            self.fail("no step was short enough for Newton's method", remedy=self.remedy)
        if failed:
            self._cut(failed, start, dt)
        if self._accept(before, dt):
            self._finish(before, start, dt)
            return True
        self.redone += 1
        ts.rollBack()
        self._undo(before)
        return False

    def _undo(self, before: np.ndarray) -> None:
        """Take back the state (n_owned, 2 d) of before a step; collective."""
        self.mechanics.state.owned[:] = before
        self.mechanics.state.exchange()

    def _cut(self, failed: int, start: float, dt: float) -> None:
        """Note that so many solves have failed before the step from `start` was short enough, dt [µs]; collective."""
        self.failures, self.dt, unit = self.failures + failed, dt, self.mechanics.scene.time_unit
        self.report(f"no solution at {unit.text(start)}: the step is cut to {unit.text(dt, 3)}")
        if self.advice and self.failures > max(MANY, OFTEN * self.steps):
            self.report(f"{self.failures} solves failed in {self.steps} steps: {self.advice}")
            self.advice = ""

    def _accept(self, before: np.ndarray, dt: float) -> bool:
        """Whether a step of dt [µs] from the state `before` is accurate, which PETSc's error control sees to."""
        return True

    def _finish(self, before: np.ndarray, start: float, dt: float) -> None:
        """Update accounts, director, search lists and extremes after a step from the state `before`; collective."""
        ts, m = self.ts, self.mechanics
        self._from_petsc()
        m.prescribe(ts.getTime())
        self._account_path(before, start, dt)
        m.end_step(dt, RELAXING * self.control.director)
        limits = self._checked_limits()
        if limits["displaced"] > 0.2 * m.segments.skin:
            m.renew_lists()
        self._to_petsc()
        self.newton = ts.getSNESIterations()
        widen(self.extremes, "dt", dt, dt)
        self.count["implicit"] = self.steps
        ts.monitor(self.steps, ts.getTime())
        self.after_batch(ts.getTime())

    def record(self) -> dict[str, Any]:
        """Counts, and the dissipation of the scheme [pN, in space pN µm], for the manifest; collective."""
        d, taken = self.mechanics.scene.dimension, float(exact_sum(self.mechanics.comm, self.scheme_loss))
        return {"newton_steps": self.newton, "tangents": self.equations.assembled, "failed_solves": self.failures,
                f"scheme_loss_{'pN' if d == 2 else 'pN_um'}": taken, "force_evaluations": self.equations.evaluated}

    def _from_petsc(self) -> None:
        """Copy the state from TS."""
        m = self.mechanics
        if self.second_order:
            m.state.owned[:] = np.hstack([self._vectors(x) for x in self.ts.getSolution2()])
        else:
            m.state.owned[:] = self.ts.getSolution().getArray(readonly=True).reshape(m.state.owned.shape)
        m.state.exchange()

    def _to_petsc(self) -> None:
        """Copy the state to TS."""
        state = self.mechanics.state
        if self.second_order:
            for vec, columns in zip(self.ts.getSolution2(), (state.u, state.v), strict=True):
                vec.setArray(columns.ravel())
        else:
            self.ts.getSolution().setArray(state.owned.ravel())

    def _account_path(self, before: np.ndarray, start: float, dt: float) -> None:
        """Add dissipation and work along the straight path of the step, by Gauss quadrature; collective.

        The work of all forces exceeds the gain of kinetic energy by the dissipation of the scheme.
        """
        m, after, mass = self.mechanics, self.mechanics.state.owned.copy(), self.equations.mass
        (u, v_before), (u_after, v) = (np.split(state, 2, axis=1) for state in (before, after))
        work = self.equations.work_along(u, u_after - u, start, dt, self._piece)
        m.set_clock(start + dt)
        m.state.owned[:] = after
        m.rate(dt)
        motion = 0.5 * (mass * (v**2 - v_before**2)).sum(axis=1)
        self.scheme_loss += work - motion
        m.accounts.of_particles["artificial_dissipation"] += work - motion

    def destroy(self) -> None:
        """Free the PETSc objects."""
        if destroyed(self):
            self.ts.destroy()
            self._close_equations()
