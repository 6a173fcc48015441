"""Orders in time: fixed particles, against the solution of the same particles with far smaller steps."""

from __future__ import annotations

import numpy as np

from cellmig.verify.reference import Measured, converges, exact, reference

from .scenes import DAMPED, altered, built, case, displaced, displacement, relative_rms, velocity

STRAINED = {"velocity_gradient": [["0.1 /us", "0 /us"], ["0 /us", "-0.1 /us"]]}
COUNT, END = 100, 1.0  # particles, µs
KINDS = {"leapfrog": 2, "euler": 1, "rk 2a": 2, "rk 3bs": 3, "rk 4": 4, "rk 5dp": 5, "ssp": 2}


def after(kind: str, step: float, *sets: str) -> np.ndarray:
    """Displacements (size, 2) [µm] of a vibrating disc at END, by a TS type with steps [ns]."""
    ts_type, _, runge_kutta = kind.partition(" ")
    words = (f'time.step="{step} ns"', f'time.integrator="{ts_type}"', *sets)
    return displaced(altered(case("nucleus", COUNT, *words), STRAINED), runge_kutta, END)


def relative_error(kind: str, step: float, *sets: str) -> float:
    """Relative error of the displacements, against a method of fifth order with steps of 0.25 ns [-]."""
    return relative_rms(after(kind, step, *sets), after("rk 5dp", 0.25, *sets))


@reference("step", shows="elastic disc of 100 particles vibrates for 1 µs by each integrator; the step is the size",
           source="against -ts_rk_type 5dp at 0.25 ns", unit="ns", at=(2.0, 1.0, 0.5), seconds=15.0,
           expected={kind: converges(order, "PETSc's manual, TS" if kind != "leapfrog" else
                                     "symplectic Euler with v half a step late is Störmer-Verlet (Hairer et al. 2003)",
                                     floor=1e-10) for kind, order in KINDS.items() if kind != "euler"})
def step(ns: float) -> Measured:
    """There is no damping."""
    return Measured(ns, {kind: relative_error(kind, ns) for kind in KINDS if kind != "euler"})


@reference("step-damped", shows="the same with the damping of solids",
           source="against -ts_rk_type 5dp at 0.25 ns", unit="ns", at=(4.0, 2.0, 1.0), seconds=10.0,
           expected={"leapfrog": converges(1, "damping sees the velocity of half a step before"),
                     "euler": converges(1, "PETSc's manual, TS"), "rk 3bs": converges(3, "PETSc's manual, TS")})
def step_damped(ns: float) -> Measured:
    """The viscous stabilisation is 0.05 ρ c h, the bulk viscosity 0.05 ρ c h."""
    return Measured(ns, {kind: relative_error(kind, ns if kind != "euler" else 0.1 * ns, *DAMPED)
                         for kind in ("leapfrog", "euler", "rk 3bs")})


@reference("free-fall", shows="a cell falls: any integrator is exact; the step is the size",
           source="u = g t²/2, v = g t", unit="ns", at=(5.0, 2.5, 1.0), seconds=3.0,
           expected={"leapfrog": exact(1e-11, "Störmer-Verlet has no error where a is constant; v is half a step late"),
                     "rk": exact(1e-11, "constant acceleration: any order above 1 is exact")})
def free_fall(ns: float) -> Measured:
    """Errors are relative to g t²/2 and g t at 0.5 µs."""
    pull, t, found = np.array([0.1, -0.2]), 0.5, {}
    for kind in ("leapfrog", "rk"):
        fall = ('body_force.acceleration=["1e5 m/s^2", "-2e5 m/s^2"]', f'time.step="{ns} ns"',
                f'time.integrator="{kind}"', 'cells.0.centre=["0 um", "50 um"]')
        with built(case("one_cell", 100, *fall)) as sim:
            sim.go(t)
            late = 0.5e-3 * ns if kind == "leapfrog" else 0.0
            found[kind] = float(max(np.abs(displacement(sim) / (0.5 * pull * t**2) - 1.0).max(),
                                    np.abs(velocity(sim) / (pull * (t - late)) - 1.0).max()))
    return Measured(ns, found)
