"""Leapfrog, as a type of PETSc's TS written in Python."""

from __future__ import annotations

import math
from typing import Any

from petsc4py import PETSc

from .step import widen

CROSSED = 250  # batches in turn after which surfaces cross, which end the run: edges pass within 140


class Leapfrog:
    """TS type of leapfrog: v += dt a(u, v), then u += dt v, with velocities half a step behind positions.

    PETSc calls `step` once a batch.  Without a fixed step, the steps of a batch are such that equal ones end exactly at
    the time of `TS.setMaxTime`.  TS counts single steps, so that -ts_max_steps has its usual meaning.

    Source: Verlet (1967); Hairer, Lubich & Wanner (2003).
    """

    def __init__(self, integrator: Any):
        self._integrator = integrator

    def step(self, ts: PETSc.TS) -> None:
        """Take one batch of steps, and repeat it with a smaller step where it was not stable; collective."""
        run, m = self._integrator, self._integrator.mechanics
        allowed = run.begin_batch()
        t, stop, taken = ts.getTime(), ts.getMaxTime(), ts.getStepNumber()
        if run.touches:
            m.save()
        while True:
            left, dt = run.equal_steps(stop)
            m.set_clock(t, *((0.0, taken) if run.fixed_step else (t, 0)))
            n = min(allowed, left, ts.getMaxSteps() - taken)
            m.advance(n, dt, run.gaps[1], 0.0 if run.fixed_step else 1.0)  # who looks at fixed steps changes no bit
            m.meet()
            seen = m.extremes()
            late = seen.displaced > 0.5 * m.segments.skin
            gaps = run.control.gaps(seen.gap, seen.contact)
            if not run.touches or (run.was_stable(dt, gaps) and not (late and n > 1)):
                break
            m.go_back()
            run.choose()
            run.redone += n
            allowed = max(1, n // 4) if late else allowed
        run.crossed = run.crossed + 1 if math.isinf(seen.contact) else 0
        if run.crossed > CROSSED:
            run.fail("surfaces of cells cross and do not part",
                     remedy="try a smaller load, a slower impact or finer particles")
        widen(run.extremes, "J", seen.J_min, seen.J_max)
        m.state.solution.stateIncrease()
        run.count[run.mechanism] = run.count.get(run.mechanism, 0) + n
        widen(run.extremes, "dt", dt, dt)
        ts.setTimeStep(dt)
        ts.setTime(stop if n == left else (taken + n) * dt if run.fixed_step else t + n * dt)
        ts.setStepNumber(taken + n - 1)  # PETSc adds the last step itself
