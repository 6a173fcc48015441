"""Equilibria: Newton's order, what leapfrog comes to rest at, accounts, plates, ranks, and what is refused."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from scenes import BALL, BAR, BEAM, DISC, LEFT, RIGHT, bent, built, everywhere, squeezed
from scipy.optimize import fsolve

from mpi4py import MPI
from petsc4py import PETSc

from cellmig.case.load import from_dict
from cellmig.case.messages import CaseError
from cellmig.case.pointwise import pointwise
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
    """Of all particles (size, d) [µm]."""
    return everywhere(sim, sim.mechanics.state.u)


IN_BOTH = pytest.mark.parametrize("d", [2, 3], ids=["plane", "space"])
UP = {2: "force_y_pn_per_um", 3: "force_z_pn"}


@pytest.mark.serial
@IN_BOTH
def test_newton_converges_quadratically(d: int) -> None:
    with built(bent(220, {2: 200.0, 3: 20.0}[d], 1, d)) as sim:
        solved(sim)
        norms = np.array(sim.integrator.newton[-1][1])
        assert len(norms) < 9
        drop = np.log(norms[1:] / norms[:-1])
        assert drop[-1] < -12.0  # measured -14.4, -14.3; of a tangent that is nearly right: -5
        assert drop[-1] / drop[-2] > 1.8, norms  # measured 3.6, 2.1


@pytest.mark.serial
@IN_BOTH
def test_the_ledger_closes_to_second_order_in_the_load_step(d: int) -> None:
    errors = []
    for samples in (4, 8):
        with built(bent(150, 200.0, samples, d)) as sim:
            entries = solved(sim)[1]
            errors.append(entries["energy_error"])
            assert entries["external_work_pn" if d == 2 else "external_work_pn_um"] > 50.0
    assert errors[1] < 0.001
    assert errors[1] < 0.27 * errors[0], errors
    with built(squeezed(200, 0.2, 8, d)) as sim:  # contacts that come within a load step make it uneven
        assert solved(sim)[1]["energy_error"] < 0.004  # measured 0.0018; 0.0003 with 16


@IN_BOTH
def test_supports_bear_what_loads_and_plates_push_with(d: int) -> None:
    with built(bent(150, 200.0, 2, d)) as sim:
        whole = solved(sim)[0][0]
        assert whole[f"left_{UP[d]}"] == pytest.approx({2: -400.0, 3: -800.0}[d], rel=1e-9)
        assert abs(whole[f"left_{UP[d]}".replace("force_y", "force_x").replace("force_z", "force_x")]) < 1e-6
        held = np.isclose(sim.scene.X[:, 0], -2.0)
        assert not displacement(sim)[held].any()
    with built(squeezed(200, dimension=d)) as sim:
        whole = solved(sim)[0][0]
        assert whole[f"top_{UP[d]}"] == pytest.approx(-whole[f"bottom_{UP[d]}"], rel=1e-6)
        x = sim.scene.X + displacement(sim)
        assert 0.8 * 1.415 - x[:, -1].max() == pytest.approx(0.0, abs=1e-9)
        assert sim.integrator.plates.gaps().min(initial=0.0) > -1e-9


@pytest.mark.serial
@pytest.mark.parametrize(("make", "d"), [(partial(bent, 60, 100.0), 2), (partial(bent, 60, 50.0), 3),
                                         (partial(squeezed, 60, 0.1), 3)], ids=["bar", "beam", "ball between plates"])
def test_leapfrog_under_slow_loads_ends_at_the_same(make, d: int) -> None:
    with built(make(dimension=d)) as sim:
        still = solved(sim)[0][0]
        u = displacement(sim)
    damped = {"material": {"stabilisation": 1.0}, "numerics": {"bulk_viscosity": 0.5}}
    clock = {"integrator": "leapfrog", "end": "200 us", "samples": 1}
    tree = make(dimension=d, time=clock, **damped).resolved()
    for item in [*tree.get("loads", []), *tree.get("plates", [])]:
        item["load_curve"] = {"law": "smooth", "duration": "200 us"}
    with built(from_dict(tree)) as sim:
        moving = solved(sim)[0][0]
        apart = (displacement(sim) - u)[:, -1]  # the ball may turn about its axis
        assert np.abs(apart).max() < 1e-4 * np.abs(u).max()  # measured 4e-5, 2e-5, 1e-6; 3e-4 in 100 µs
        held = [name for name in still if UP[d] in name]
        assert [moving[name] for name in held] == pytest.approx([still[name] for name in held], rel=2e-4, abs=1e-6)


@IN_BOTH
@pytest.mark.parametrize("make", [bent, squeezed])
def test_any_number_of_ranks_finds_the_same(make, d: int) -> None:
    scene = make(200, dimension=d)
    with built(scene) as sim, built(scene, MPI.COMM_SELF) as alone:
        rows, entries = solved(sim)
        expected, ledger = solved(alone)
        apart = displacement(sim) - displacement(alone)
        if make is squeezed:  # nothing holds it along the plates
            along = apart[:, :-1].mean(axis=0)
            assert np.abs(along).max() < 1e-6  # measured 2e-8
            apart[:, :-1] -= along
        assert np.abs(apart).max() < 1e-12  # measured 2e-15
        for name, value in ledger.items():
            assert entries[name] == pytest.approx(value, rel=1e-6, abs=1e-6)
        for name, value in expected[0].items():
            assert rows[0][name] == pytest.approx(value, rel=1e-6, abs=1e-6)


@pytest.mark.serial
@IN_BOTH
def test_pressure_makes_a_disc_or_a_ball_smaller_as_the_law_says(d: int) -> None:
    """Under a pressure p all round, σ = -p everywhere: F = λ I."""
    load = {"name": "p", "pressure": "100 kPa", "load_curve": RAMP}
    with built(piece(DISC if d == 2 else BALL, 300, 2, dimension=d, loads=[load])) as sim:
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
     "'nematic' has a viscosity; time.integrator = \"overdamped\" follows it"),
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


@pytest.mark.serial
@pytest.mark.parametrize("pull", [100.0, 1500.0])
def test_a_bar_between_smooth_walls_is_stretched_as_its_law_says(pull: float) -> None:
    """Uniaxial tension in finite strain, which linear shape functions hold exactly: Rivlin's (1948), compressible."""
    wall = ["free", "free", "free"]
    supports = [{"name": part, "parts": [part], "displacement": [*wall[:k], "0 um", *wall[k + 1 :]]}
                for k, part in enumerate(("left", "front", "bottom"))]
    load = {"name": "pull", "parts": ["right"], "traction": [f"{pull} Pa", "0 Pa", "0 Pa"], "load_curve": RAMP}
    with built(piece(BEAM, 150, 1, dimension=3, supports=supports, loads=[load])) as sim:
        solved(sim)

        def stresses(stretches: np.ndarray) -> np.ndarray:
            F = np.diag([stretches[0], stretches[1], stretches[1]])[:, :, None]
            P = np.array(pointwise(sim.scene.materials[0], "stress", {"F": F}))[..., 0]
            return np.array([P[0, 0] - pull, P[1, 1]])

        along, across = fsolve(stresses, [1.0, 1.0], xtol=1e-12)
        u = displacement(sim)
        exact = (sim.scene.X - sim.scene.X.min(axis=0)) * (np.array([along, across, across]) - 1.0)
        assert np.abs(u - exact).max() < 1e-9 * np.abs(exact).max()  # measured 4e-12, 1e-14
