"""Implicit steps: Newton's order, orders in time, accounts, ranks, steps that are cut, and what leapfrog finds."""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import BAR, DAMPED, LEFT, RIGHT, bent, built, case, everywhere

from mpi4py import MPI
from petsc4py import PETSc

from cellmig.case.load import from_dict
from cellmig.case.schema import Case
from cellmig.output.manifest import read_manifest
from cellmig.output.tables import read_table
from cellmig.parallel.options import IMPLICIT
from cellmig.runs.run import Run
from cellmig.runs.trial import choose
from cellmig.simulation import Simulation
from cellmig.solve.implicit import LONGEST
from cellmig.verify.specimens import RAMP, piece

SOFT_BONDS = ('adhesion.substrate.equilibrium_distance="40 nm"', 'cells.0.centre=["0 um", "5.04 um"]')
RINGING = ("plates=[]", 'materials.cytoplasm.reduced_bulk_modulus="0.5 MPa"',
           'cells.0.velocity=["0.5*x um/us", "-0.3*y um/us", "-0.2*z um/us"]')  # for ball_nucleus.toml


def stepped(name: str, integrator: str, step: Any, *sets: str, per_cell: int = 150) -> Case:
    """A case with a fixed step [ns]."""
    step = f"{step} ns" if step != "auto" else step
    return case(name, f'time.step="{step}"', f'time.integrator="{integrator}"', *sets, per_cell=per_cell)


def after(case: Case, time: float, comm: MPI.Comm = MPI.COMM_WORLD) -> np.ndarray:
    """State of all particles (size, 2 d) at a time."""
    with built(case, comm) as sim:
        sim.sample()
        assert sim.go(time) == time
        return everywhere(sim, sim.mechanics.state.owned)


def positions(case: Case, time: float) -> np.ndarray:
    """Displacements of all particles (size, d) at a time."""
    return after(case, time)[:, : case.dimension]


def residuals(sim: Simulation, time: float) -> list[np.ndarray]:
    """Norms of what is out of balance in Newton's steps, solve by solve, up to a time."""
    solves: list[list[float]] = []

    def note(snes: Any, iteration: int, norm: float) -> None:
        if iteration == 0:
            solves.append([])
        solves[-1].append(norm)

    sim.integrator.ts.getSNES().setMonitor(note)
    sim.go(time)
    return [np.array(norms) for norms in solves]


@pytest.mark.serial
@pytest.mark.parametrize("integrator", ["alpha2", "bdf"])
@pytest.mark.parametrize(("name", "step"), [("one_cell", 10), ("all_protrude", 10), ("ball", 200)])
def test_newton_converges_quadratically_where_cells_adhere_and_touch(name: str, step: int, integrator: str) -> None:
    with built(stepped(name, integrator, step, per_cell=93)) as sim:
        solves = residuals(sim, 0.01 * step)
        assert len(solves) >= 10
        drops = [np.log(r[1:] / r[:-1]) for r in solves if len(r) > 3]
        assert all(len(r) < 8 for r in solves)
        assert len(drops) >= 3
        assert np.median([d[-1] for d in drops]) < -8.0  # measured -9 to -13
        assert np.median([d[-1] / d[-2] for d in drops]) > 1.4, solves  # linear: 1; measured 1.5 to 1.9
        assert sim.integrator.failures == 0


@pytest.mark.serial
@pytest.mark.parametrize(("name", "integrator", "order"), [
    ("nucleus", "beuler", 1), ("nucleus", "theta", 2), ("nucleus", "cn", 2), ("nucleus", "alpha2", 2),
    ("nucleus", "bdf", 2), ("ball_nucleus", "beuler", 1), ("ball_nucleus", "alpha2", 2), ("ball_nucleus", "bdf", 2)])
def test_integrators_converge_with_their_order(name: str, integrator: str, order: int) -> None:
    """A ringing disc with all of its damping, and a ball of fluid with tension and a nucleus."""
    sets = DAMPED if name == "nucleus" else RINGING
    x = [positions(stepped(name, integrator, step, *sets, per_cell=93), 0.4) for step in (20, 10, 5)]
    change = [np.sqrt(((a - b) ** 2).mean()) for a, b in pairwise(x)]
    assert np.log2(change[0] / change[1]) == pytest.approx(order, abs=0.25), change


@pytest.mark.serial
@pytest.mark.parametrize("name", ["one_cell", "nucleus", "ball"])
@pytest.mark.parametrize("integrator", ["beuler", "alpha2"])
def test_implicit_and_explicit_agree_as_steps_shrink(name: str, integrator: str) -> None:
    sets = {"nucleus": DAMPED, "one_cell": SOFT_BONDS, "ball": SOFT_BONDS[:1]}[name]
    exact = positions(stepped(name, "leapfrog", 0.1, *sets, per_cell=93), 0.1)

    def difference(step: float) -> float:
        x = positions(stepped(name, integrator, step, *sets, per_cell=93), 0.1)
        return float(np.abs(x - exact).max() / np.abs(exact).max())

    coarse, fine = difference(4.0), difference(1.0)
    assert fine < 0.35 * coarse  # measured 0.32 with the first order, 0.25 to leapfrog's own error with the second
    assert fine < 0.01  # measured 5e-3


@pytest.mark.parametrize(("name", "integrator"), [*(("all_protrude", kind) for kind in IMPLICIT), ("ball", "alpha2"),
                                                  ("three_balls", "bdf")])
def test_any_number_of_ranks_finds_the_same(name: str, integrator: str) -> None:
    scene = stepped(name, integrator, 5, per_cell=60)
    ours, alone = after(scene, 0.03), after(scene, 0.03, MPI.COMM_SELF)
    assert np.abs(ours - alone).max() < 1e-8 * np.abs(alone).max()


@pytest.mark.serial
@pytest.mark.parametrize(("name", "time", "integrator"), [
    *((*scene, kind) for scene in (("all_protrude", 0.1), ("director_radial", 0.2)) for kind in IMPLICIT),
    ("ball_nucleus", 0.1, "bdf")])
def test_the_ledger_closes_whatever_the_scheme_takes(name: str, time: float, integrator: str) -> None:
    with built(stepped(name, integrator, 10, *(RINGING if name == "ball_nucleus" else ()), per_cell=93)) as sim:
        sim.sample()
        sim.go(time)
        entries = sim.sample()[1]
        assert entries["energy_error"] < 1e-3
        assert entries["viscous_loss_pn_um" if sim.case.dimension == 3 else "viscous_loss_pn"] > 1.0


@pytest.mark.parametrize("d", [2, 3])
def test_supports_and_loads_act_in_implicit_steps(d: int) -> None:
    def moved(integrator: str, step: str) -> tuple[np.ndarray, float]:
        clock = {"integrator": integrator, "step": step, "end": "1 us"}
        with built(bent(100, 200.0, 2, d, time=clock)) as sim:
            sim.sample()
            sim.go(1.0)
            return everywhere(sim, sim.mechanics.state.u), sim.sample()[1]["energy_error"]

    (implicit, error), (explicit, _) = moved("alpha2", "5 ns"), moved("leapfrog", "0.5 ns")
    assert np.abs(implicit - explicit).max() < 1e-4 * np.abs(explicit).max()  # measured 1.7e-5
    assert error < 1e-10  # measured 1e-14


def test_a_step_without_solution_is_cut_and_the_run_goes_on() -> None:
    said: list[str] = []
    with built(stepped("one_cell", "bdf", 4000, per_cell=93)) as sim:
        sim.integrator.report = said.append
        sim.sample()
        assert sim.go(8.0) == 8.0
        assert sim.integrator.failures >= sum("the step is cut" in line for line in said) > 0
        assert sim.sample()[1]["energy_error"] < 0.01


@pytest.mark.parametrize("integrator", ["beuler", "alpha2", "overdamped"])
def test_a_run_that_is_to_stop_within_a_step_has_the_state_before_it(integrator: str) -> None:
    sets = ['medium.viscosity="1 Pa s"'] if integrator == "overdamped" else []
    with built(stepped("three_balls", integrator, "auto", *sets, per_cell=60)) as sim:
        run, state, seen = sim.integrator, sim.mechanics.state, []
        sim.go(1e-3)
        before = state.owned.copy()

        def note() -> None:
            seen.append(run.trying)
            if len(seen) == 2:
                run.halt()

        run.within_step = note
        assert sim.go(10.0) == 1e-3 and run.finished
        assert seen[:2] == [1, 2]  # the iterations of the first solve
        assert np.array_equal(state.owned, before)


def test_a_run_asked_to_stop_in_the_first_step_after_a_sample_ends_with_that_sample(shared_tmp: Path) -> None:
    given = stepped("three_balls", "beuler", "auto", 'time.end="1 us"', "time.samples=100", per_cell=60)
    run, signals = Run(given, shared_tmp / "run", MPI.COMM_WORLD, quiet=True), []
    ts = run.simulation.integrator.ts
    ts.getSNES().setMonitor(lambda snes, iteration, norm: signals.extend([15] * (ts.getTime() == 0.02)))
    assert run.go(signals) == 75
    manifest = read_manifest(run.directory)
    assert (manifest["time_us"], manifest["cause"]) == (0.02, "asked to stop")
    assert read_table(run.directory / "ledger.csv")["time_us"].tolist() == [0.0, 0.01, 0.02]


def thrown(integrator: str, speed: float) -> Case:
    """Two balls of gel without bonds, 0.2 µm apart, that fly towards each other at a speed [µm/µs]."""
    gel = {"law": "gel", "viscosity": "1 mPa s", "shear_modulus": "2 kPa", "bulk_modulus": "0.1 MPa",
           "reduced_bulk_modulus": "0.1 MPa", "density": "1000 kg/m^3"}
    cells = [{"name": name, "shape": "ball", "radius": "5 um", "material": "gel",
              "centre": [f"{x} um", "0 um", "0 um"], "velocity": [f"{v} um/us", "0 um/us", "0 um/us"]}
             for name, x, v in (("A", 0, speed), ("B", 10.1, -speed))]
    return from_dict({"dimension": 3, "seed": 7, "time": {"integrator": integrator, "end": "1 us"}, "cells": cells,
                      "particles": {"per_cell": 120}, "materials": {"gel": gel}})


@pytest.mark.serial
@pytest.mark.parametrize("speed", [0.3, 0.8])
def test_edges_of_cells_without_bonds_that_meet_at_speed_cross_and_part(speed: float) -> None:
    """The wall is 8 nm thin, and its energy where two edges meet is less than that of their particles."""
    pushed = []
    for integrator in ("leapfrog", "bdf"):
        with built(thrown(integrator, speed)) as sim:
            sim.sample()
            sim.go(1.0)
            motion = everywhere(sim, sim.mechanics.state.owned)[:, 3]
            pushed.append([float(motion[sim.scene.cell == cell].mean()) for cell in (0, 1)])
            assert sim.sample()[1]["energy_error"] < 5e-3  # measured 5e-5 to 1.4e-3
            if integrator == "bdf":
                assert sim.integrator.steps < 90  # measured 11, 58
    assert np.abs(np.diff(pushed, axis=0)).max() < 0.02 * speed, pushed  # measured 0.005, 0.011


@pytest.mark.serial
@pytest.mark.parametrize("integrator", IMPLICIT)
def test_what_moves_slowly_goes_on_in_long_steps(integrator: str) -> None:
    """All that is out of balance at the start of a step is a velocity, less than Newton's method asks for."""
    scene = stepped("nucleus", integrator, 1000, 'time.end="10 us"', per_cell=93)
    cell = dataclasses.replace(scene.cells[0], velocity=(1e-6, 0.0), velocity_gradient=((0.0, 0.0), (0.0, 0.0)))
    moved = after(dataclasses.replace(scene, cells=(cell,)), 10.0)[:, 0]
    assert np.abs(moved - 1e-5).max() < 1e-8  # measured 1e-13


TRUE_MODULUS = 'materials.cytoplasm.reduced_bulk_modulus="2.2 GPa"'


@pytest.mark.serial
@pytest.mark.parametrize("tangents", ["assembled", "by differences"])
def test_turns_with_the_true_bulk_modulus_are_solved(tangents: str) -> None:
    """The square of a turn makes a false pressure of megapascals, which must not enter the tangent."""
    PETSc.Options()["matrix_free"] = "true" if tangents == "by differences" else "false"
    try:
        with built(stepped("all_protrude", "bdf", 100, TRUE_MODULUS, per_cell=93), MPI.COMM_SELF) as sim:
            sim.sample()
            sim.go(2.0)
            assert sim.integrator.failures <= 2  # measured 0
            assert sim.integrator.newton < 11 * sim.integrator.steps  # measured 5.7
            assert sim.sample()[1]["energy_error"] < 1e-3  # measured 1.3e-4
    finally:
        PETSc.Options().delValue("matrix_free")


@pytest.mark.serial
@pytest.mark.parametrize("integrator", ["bdf", "alpha2"])
def test_newton_steps_are_short_and_let_no_surfaces_cross(integrator: str) -> None:
    with built(stepped("all_protrude", integrator, 10, per_cell=93), MPI.COMM_SELF) as sim:
        sim.go(0.02)
        run, m = sim.integrator, sim.mechanics
        width = 2 if run.second_order else 4
        x = run._x.duplicate()
        step = x.duplicate()
        state = m.state.owned if width == 4 else m.state.owned[:, :2]
        x.setArray(state.ravel())
        towards = np.zeros((m.n_owned, width))
        towards[m.scene.cell == 0, 0] = -10.0  # the step is subtracted
        step.setArray(towards.ravel())
        assert run._shorten(x, step)
        assert 0.0 < step.norm(PETSc.NormType.INFINITY) <= LONGEST * run.equations.spacing
        x.axpy(-1.0, step)
        u = x.getArray().reshape(-1, width)[:, :2]
        assert np.isfinite(run.equations.acceleration(run.time, u, m.state.v.copy())).all()


@pytest.mark.serial
@pytest.mark.parametrize("integrator", ["bdf", "alpha2"])
def test_tangents_applied_by_differences_lead_to_the_same(integrator: str) -> None:
    scene = stepped("all_protrude", integrator, 5, per_cell=93)
    expected = after(scene, 0.05)
    options = PETSc.Options()
    options["matrix_free"] = "true"
    try:
        with built(scene) as sim:
            sim.go(0.05)
            assert sim.integrator.equations.assembled < 0.5 * sim.integrator.newton
            found = everywhere(sim, sim.mechanics.state.owned)
    finally:
        options.delValue("matrix_free")
    assert np.abs(found - expected).max() < 1e-5 * np.abs(expected).max()


@pytest.mark.serial
def test_adaptive_steps_grow_beyond_the_stable_one() -> None:
    with built(stepped("one_cell", "bdf", "auto", per_cell=93)) as sim:
        sim.go(8.0)
        assert sim.integrator.extremes["dt_max"] > 30.0 * min(sim.control.stable().values())
        assert sim.sample()[1]["energy_error"] < 0.01


@pytest.mark.parametrize(("duration", "chosen"), [("1 us", "leapfrog"), ("100 ms", "bdf")])
def test_the_cheaper_integrator_is_chosen_with_a_reason(duration: str, chosen: str) -> None:
    supports = [{"name": "left", "box": LEFT}]
    loads = [{"name": "up", "box": RIGHT, "traction": ["0 Pa", "200 Pa"],
              "load_curve": {"law": "smooth", "duration": duration}}]
    slow = piece(BAR, 100, 2, time={"integrator": "auto", "end": duration}, supports=supports, loads=loads)
    found, reason = choose(slow, MPI.COMM_WORLD)
    with built(found) as sim:
        assert found.time.integrator == chosen
        assert reason.startswith(f"{chosen}: as a trial went")
        if chosen == "bdf":
            sim.go(sim.case.time.end)
            assert sim.integrator.steps < 100
            with built(piece(BAR, 100, 2, supports=supports, loads=[loads[0] | {"load_curve": RAMP}])) as still:
                still.go(1.0)
                apart = (sim.mechanics.state.owned - still.mechanics.state.owned)[:, :2]
                assert np.abs(apart).max() < 1e-6  # measured 3e-9
