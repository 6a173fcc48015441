"""Equilibria: Newton's order, what leapfrog comes to rest at, accounts, plates, ranks, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import BAR, DISC, LEFT, RIGHT, bent, built, everywhere, squeezed

from mpi4py import MPI
from petsc4py import PETSc

from cellmig.case.load import from_dict
from cellmig.case.messages import CaseError
from cellmig.case.times import output_times
from cellmig.output.manifest import read_manifest
from cellmig.runs.run import FAILED, Run
from cellmig.simulation import Simulation
from cellmig.solve.step import NumericsError
from cellmig.verify.specimens import RAMP, piece


def solved(sim: Simulation) -> tuple[list[dict], dict]:
    """The rows of history and the ledger at the end of all load steps."""
    for stop, _, _ in output_times(sim.case, sim.case.time.end):
        sim.go(stop)
        rows, entries = sim.sample()
    return rows, entries


def displacement(sim: Simulation) -> np.ndarray:
    """Of all particles (size, 2) [µm]."""
    return everywhere(sim, sim.mechanics.state.owned[:, :2])


@pytest.mark.serial
def test_newton_converges_quadratically() -> None:
    with built(bent(220, samples=1)) as sim:
        solved(sim)
        norms = np.array(sim.integrator.newton[-1][1])
        assert len(norms) < 9
        drop = np.log(norms[1:] / norms[:-1])
        assert drop[-1] < -12.0  # measured -14.4; of a tangent that is nearly right: -5
        assert drop[-1] / drop[-2] > 1.8, norms  # measured 3.6


def test_the_ledger_closes_to_second_order_in_the_load_step() -> None:
    errors = []
    for samples in (4, 8):
        with built(bent(150, samples=samples)) as sim:
            entries = solved(sim)[1]
            errors.append(entries["energy_error"])
            assert entries["external_work_pn"] > 50.0
    assert errors[1] < 0.001
    assert errors[1] < 0.27 * errors[0], errors
    with built(squeezed(200, samples=8)) as sim:  # contacts that come within a load step make it uneven
        assert solved(sim)[1]["energy_error"] < 0.004  # measured 0.0018; 0.0003 with 16


def test_supports_bear_what_loads_and_plates_push_with() -> None:
    with built(bent(150)) as sim:
        whole = solved(sim)[0][0]
        assert whole["left_force_y_pn_per_um"] == pytest.approx(-400.0, rel=1e-9)
        assert abs(whole["left_force_x_pn_per_um"]) < 1e-6
        held = np.isclose(sim.scene.X[:, 0], -2.0)
        assert not displacement(sim)[held].any()
    with built(squeezed(200)) as sim:
        whole = solved(sim)[0][0]
        assert whole["top_force_y_pn_per_um"] == pytest.approx(-whole["bottom_force_y_pn_per_um"], rel=1e-6)
        x = sim.scene.X + displacement(sim)
        assert 0.8 * 1.415 - x[:, 1].max() == pytest.approx(0.0, abs=1e-9)
        assert sim.integrator.plates.gaps().min(initial=0.0) > -1e-9


@pytest.mark.serial
def test_leapfrog_under_slow_loads_ends_at_the_same() -> None:
    with built(bent(60, 100.0)) as sim:
        still = solved(sim)[0][0]
        u = displacement(sim)
    damped = {"material": {"stabilisation": 1.0}, "numerics": {"bulk_viscosity": 0.5}}
    tree = bent(60, 100.0, time={"integrator": "leapfrog", "end": "200 us", "samples": 1}, **damped).resolved()
    tree["loads"][0]["load_curve"] = {"law": "smooth", "duration": "200 us"}
    with built(from_dict(tree)) as sim:
        moving = solved(sim)[0][0]
        assert np.abs(displacement(sim) - u).max() < 1e-4 * np.abs(u).max()  # measured 4e-5; 3e-4 in 100 µs
        assert moving["left_force_y_pn_per_um"] == pytest.approx(still["left_force_y_pn_per_um"], rel=2e-4)


@pytest.mark.parametrize("make", [bent, squeezed])
def test_any_number_of_ranks_finds_the_same(make) -> None:
    with built(make(200)) as sim, built(make(200), MPI.COMM_SELF) as alone:
        rows, entries = solved(sim)
        expected, ledger = solved(alone)
        apart = displacement(sim) - displacement(alone)
        if make is squeezed:  # nothing holds it along the plates
            assert np.abs(apart[:, 0].mean()) < 1e-6  # measured 2e-8
            apart[:, 0] -= apart[:, 0].mean()
        assert np.abs(apart).max() < 1e-12  # measured 2e-15
        for name, value in ledger.items():
            assert entries[name] == pytest.approx(value, rel=1e-6, abs=1e-6)
        for name, value in expected[0].items():
            assert rows[0][name] == pytest.approx(value, rel=1e-6, abs=1e-6)


@pytest.mark.serial
def test_pressure_makes_a_disc_smaller_as_the_law_says() -> None:
    """Under a pressure p all round, σ = -p everywhere: F = λ I."""
    with built(piece(DISC, 300, 2, loads=[{"name": "p", "pressure": "100 kPa", "load_curve": RAMP}])) as sim:
        solved(sim)
        stress = sim.sampler.nodal_stress()[0][: sim.mechanics.n_owned]
        assert np.abs(stress[:, 0, 0] + 1e5).max() < 1e-3
        assert np.abs(stress[:, 0, 1]).max() < 1e-3


def test_a_load_that_has_no_equilibrium_ends_with_a_message() -> None:
    """A pull on both ends that nothing holds across: the bar is torn; too much for the law."""
    loads = [{"name": "pull", "box": RIGHT, "traction": ["900 kPa", "0 Pa"], "load_curve": RAMP}]
    with built(piece(BAR, 60, 2, supports=[{"name": "left", "box": LEFT}], loads=loads)) as sim, pytest.raises(
            NumericsError, match=r"no equilibrium was found at .* though the load step was cut 8 times"):
        solved(sim)


@pytest.mark.serial
def test_a_run_that_finds_no_equilibrium_ends_with_code_4(tmp_path, capsys) -> None:
    run = Run(bent(60, 9e5), tmp_path / "torn", MPI.COMM_SELF)
    assert run.go() == FAILED == 4
    said = capsys.readouterr()
    assert "no equilibrium was found" in said.err
    assert "integrator  static: newtonls of PETSc with preonly and lu" in said.out
    assert "viscous stabilisation, bulk damping: nothing moves in a static case" in said.out
    run = Run(bent(60), tmp_path / "bent", MPI.COMM_SELF)
    assert run.go() == 0
    assert "steps of Newton, out of balance by" in capsys.readouterr().out
    times, norms = zip(*read_manifest(tmp_path / "bent")["newton"], strict=True)
    assert times == (0.5, 1.0)
    assert all(n[-1] < 1e-8 * n[0] for n in norms)
    assert (tmp_path / "bent" / "history.csv").read_text().count("\n") == 1 + 2 * 3


@pytest.mark.serial
@pytest.mark.parametrize(("change", "message"), [
    ({"protrusion": {"cells": ["Bar"]}}, "it has no protrusion yet"),
    ({"adhesion": {"substrate": {"bond_density": "8000 /um^2", "well_depth": "0.03 pN um",
                                 "equilibrium_distance": "10 nm"}}}, "it has no adhesion yet"),
    ({"body_force": {"acceleration": ["0 m/s^2", "-9.81 m/s^2"]}}, "it has no body force yet"),
    ({"loads": [{"name": "up", "traction": ["0 Pa", "1 Pa"]}]}, "loads that grow with time from zero"),
    ({"materials": {"nucleus": {"law": "nematic", "viscosity": "1 mPa s", "bulk_modulus": "1 MPa",
                                "reduced_bulk_modulus": "1 MPa"}}},
     "'nematic' flows, and bears no load that stays"),
    ({"cells": [BAR | {"velocity": ["1 um/us", "0 um/us"]}]}, "nothing moves at the start"),
])
def test_what_cannot_be_static_is_refused(change: dict, message: str) -> None:
    cell = BAR | {"centre": ["0 um", "9 um"]}
    tree = piece(cell, 60, 2).resolved() | change
    with pytest.raises(CaseError, match=message):
        from_dict(tree)


def test_a_static_case_leaves_no_options_of_petsc_behind() -> None:
    """Who solves one from Python has the defaults again afterwards."""
    before = PETSc.Options().getAll()
    with built(bent(120)) as sim:
        assert sim.integrator.snes.getType() == "newtonls" and sim.integrator.snes.getKSP().getPC().getType() == "lu"
    assert PETSc.Options().getAll() == before
