"""Short trials that measure the speed of integrators, and choose the faster of two."""

from __future__ import annotations

import dataclasses
from time import perf_counter
from typing import NamedTuple

from mpi4py import MPI

from cellmig.case.schema import Case
from cellmig.output.log import duration, simulated
from cellmig.parallel.options import requested_integrator
from cellmig.simulation import Simulation
from cellmig.solve.implicit import Implicit
from cellmig.solve.step import NumericsError, binding

from .estimates import inertia_is_gone

TRIAL, TRIAL_EXPLICIT = 8, 500  # steps in each part of a trial, implicit and explicit
GROWING = 1.5  # a trial of implicit steps continues while its speed grows by this factor


def choose(case: Case, comm: MPI.Comm) -> tuple[Case, str]:
    """The case with its integrator, for "auto" the faster one in a short trial, and the reason; collective."""
    if requested_integrator(case.time.integrator) != "auto":
        return case, ""

    def with_(kind: str) -> Case:
        return dataclasses.replace(case, time=dataclasses.replace(case.time, integrator=kind))

    if case.plates:
        return with_("leapfrog"), "implicit steps have no plates"
    if inertia_is_gone(case):
        return with_("overdamped"), "overdamped: momentum spreads in far less than the run lasts"
    speeds = {kind: _speed(with_(kind), comm) for kind in ("leapfrog", "bdf")}
    best = max(speeds, key=lambda kind: speeds[kind])
    end, took = case.time.end, [duration(case.time.end / v) if v else "for ever" for v in speeds.values()]
    return with_(best), (f"{best}: as a trial went, {simulated(end, case.time_unit)} take {took[0]} with explicit "
                         f"steps and {took[1]} with implicit ones")


def _speed(case: Case, comm: MPI.Comm) -> float:
    """Simulated over wall time in a trial [µs/s], 0 where no step succeeds; collective."""
    try:
        with Simulation(case, comm) as s:
            return try_implicit(s).speed if isinstance(s.integrator, Implicit) else _explicit(s)
    except NumericsError:
        return 0.0


def _explicit(simulation: Simulation) -> float:
    """Simulated over wall time [µs/s] of the second half of a trial of explicit steps; collective."""
    half, comm, at = TRIAL_EXPLICIT * binding(simulation.control.stable())[1], simulation.comm, [(0.0, perf_counter())]
    for stop in (half, 2.0 * half):
        at.append((simulation.go(min(stop, simulation.case.time.end)), comm.allreduce(perf_counter(), MPI.MAX)))
    (before, begin), (time, end) = at[-2:]
    return comm.bcast((time - before) / (end - begin) if time > before else at[1][0] / (at[1][1] - at[0][1]))


class Trial(NamedTuple):
    """Result of a trial of implicit steps at the start of a run.

    simulated [µs], wall [s], steps, newton : simulated and wall time, steps and Newton steps of its later half;
    taken : steps in all;  reached : simulated time at its end [µs];  particles : of the scene.
    """

    simulated: float
    wall: float
    steps: int
    newton: int
    taken: int
    reached: float
    particles: int

    @property
    def speed(self) -> float:
        """Simulated over wall time [µs/s]."""
        return self.simulated / self.wall


def try_implicit(simulation: Simulation, burst: int = TRIAL, least: float = 0.0) -> Trial:
    """Take implicit steps until they are no longer growing, and for at least `least` seconds; collective.

    PETSc's error control starts from ten times the stable explicit step and doubles it, so that the first dozens of
    steps of a stiff case say little about later ones.  Bursts of steps go on until two in a row are not faster than
    before, as a single one may contain an event.
    """
    run, comm, end = simulation.integrator, simulation.comm, simulation.case.time.end

    def now() -> tuple[float, float, int, int]:
        return simulation.time, comm.allreduce(perf_counter(), MPI.MAX), run.steps, run.newton

    at, best, idle = [now()], 0.0, 0
    while simulation.time < end and (idle < 2 or at[-1][1] - at[0][1] < least):
        run.ts.setMaxSteps(run.steps + burst)
        simulation.go(end)
        at.append(now())
        speed = (at[-1][0] - at[-2][0]) / (at[-1][1] - at[-2][1])
        idle = 0 if speed > GROWING * best else idle + 1
        best = max(best, speed)
    taken = (b - a for a, b in zip(at[len(at) // 2 - 1 if len(at) > 3 else 0], at[-1], strict=True))
    return Trial(*taken, run.steps, simulation.time, simulation.scene.size)
