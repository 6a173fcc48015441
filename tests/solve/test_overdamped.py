"""Motion without inertia: forces in balance, scales that do not matter, drag against load, leapfrog at a small Reynolds
number, orders in time, ranks, checkpoints.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scenes import built, case, everywhere

from mpi4py import MPI

from cellmig.case.load import from_dict
from cellmig.case.schema import Case
from cellmig.model.adhesion import bonds_of
from cellmig.parallel.options import OVERDAMPED, default_options
from cellmig.simulation import Simulation
from cellmig.solve import mechanics
from cellmig.solve.stencils import FRICTION
from cellmig.solve.step import NumericsError
from cellmig.solve.stiffness import Stiffness

GEL = {"law": "gel", "density": "1000 kg/m^3", "viscosity": "100 Pa s", "shear_modulus": "200 Pa",
       "bulk_modulus": "1 MPa", "reduced_bulk_modulus": "1 MPa"}
BONDS = {"bond_density": "8000 /um^2", "well_depth": "0.03 pN um", "equilibrium_distance": "50 nm", "cutoff": "1 um"}
BOX = {"name": "Box", "shape": "rectangle", "width": "6 um", "height": "3 um", "centre": ["0 um"]}
DISC = {"name": "Disc", "shape": "disc", "radius": "3 um", "centre": ["0 um"]}


def crawler(body: dict = DISC, count: int = 93, *, material: dict | None = None, time: dict | None = None,
            friction: str = "3000 Pa s/um", **tables: Any) -> Case:
    """A cell of gel that rests on the substrate, with friction."""
    clock = {"end": "100 s", "samples": 10, "frames": 1, "integrator": "overdamped"} | (time or {})
    return from_dict({"time": clock, "particles": {"per_cell": count}, "materials": {"gel": GEL | (material or {})},
                      "cells": [body | {"rest": True, "material": "gel"}], "adhesion": {"substrate": BONDS},
                      "friction": {"coefficient": friction}, **tables})


def at(sim: Simulation, seconds: float) -> np.ndarray:
    """Displacements of all particles (size, d) at a time [s]."""
    sim.sample()
    sim.go(1e6 * seconds)
    return everywhere(sim, sim.mechanics.state.u)


def positions(scene: Case, seconds: float, comm: MPI.Comm = MPI.COMM_WORLD) -> np.ndarray:
    """The same of a case."""
    with built(scene, comm) as sim:
        return at(sim, seconds)


def test_what_ends_a_run_without_inertia_has_a_remedy_that_is_one() -> None:
    with built(crawler()) as sim, pytest.raises(NumericsError, match="-ts_atol or finer particles") as ended:
        sim.integrator.fail("the energy error is 6 %, more than 5 %")
    assert "leapfrog" not in str(ended.value) and "step_factor" not in str(ended.value)


def bonded(sim: Simulation) -> float:
    """Length of closed bonds on the substrate [µm]."""
    ends, x = sim.scene.templates[0].facets, sim.scene.X + everywhere(sim, sim.mechanics.state.u)
    closed = bonds_of(sim.terms.substrate).closed(*x[ends, 1].T)
    return float(sim.scene.templates[0].facet_size @ np.clip(closed, 0.0, 1.0))


def test_forces_are_in_balance_at_every_step() -> None:
    with built(crawler(cortex={"line_tension": "50 pN/um"})) as sim:
        at(sim, 1.0)
        assert sim.integrator.steps > 20
        assert sim.integrator.record()["out_of_balance"] <= 1e-6  # of the typical force
        entries = sim.sample()[1]
        assert entries["kinetic_pn"] == 0.0
        assert entries["energy_error"] < 1e-4  # measured 2e-6


@pytest.mark.serial
@pytest.mark.parametrize("stiff", [1.0, 3.0])
def test_a_loaded_box_slides_with_force_over_drag(stiff: float) -> None:
    """v = F / (c L) with the length L of closed bonds, whatever viscosity and stiffness."""
    force = 0.5  # pN/µm³: 9 pN/µm
    scene = crawler(BOX, material={"viscosity": f"{100 * stiff} Pa s", "shear_modulus": f"{2000 * stiff} Pa"},
                    loads=[{"name": "pull", "body": [f"{force} Pa/um", "0 Pa/um"]}])
    with built(scene) as sim:
        at(sim, 100.0)
        speed = 1e6 * everywhere(sim, sim.mechanics.state.v)[:, 0]
        assert speed == pytest.approx(18.0 * force / (3000.0 * bonded(sim)), rel=1e-3)  # measured 1e-4


BELL = {"law": "bell", "bonds": "500 /um^2", "stiffness": "0.5 pN/nm", "on": "1 /s", "off": "5 /s", "force": "2 pN"}


@pytest.mark.serial
@pytest.mark.parametrize("share", [0.3, 0.75])
def test_a_loaded_box_slides_at_the_speed_at_which_bonds_bear_the_load(share: float) -> None:
    """Bell's bonds bear 55 Pa at most, 334 pN/µm on 6 µm; a `share` of that is the load."""
    force = share * 334.0 / 18.0
    pull = {"name": "pull", "body": [f"{force} Pa/um", "0 Pa/um"], "load_curve": {"law": "ramp", "duration": "1 s"}}
    scene = crawler(BOX, material={"shear_modulus": "2000 Pa"}, loads=[pull])
    with built(from_dict(scene.resolved() | {"friction": BELL})) as sim:
        at(sim, 20.0)
        speed, law = everywhere(sim, sim.mechanics.state.v)[:, 0].mean(), sim.case.friction
        assert bonded(sim) * law.drag(1.0, speed) == pytest.approx(18.0 * force, rel=3e-3)  # measured 1.2e-3, 1e-5
        assert sim.sample()[1]["energy_error"] < 1e-6  # measured 1e-14


@pytest.mark.serial
def test_a_cell_spreads_on_bonds_that_yield_far_below_its_speed() -> None:
    """They bear 1 kPa at 0.03 µm/s, the contact line advances at 1 µm/s: in the speed friction is nearly a kink."""
    sharp = {"law": "bell", "bonds": "700 /um^2", "stiffness": "0.16 pN/nm", "on": "1 /s", "off": "0.25 /s",
             "force": "2 pN"}
    tree = crawler(medium={"viscosity": "10 mPa s"}).resolved()
    with built(from_dict(tree | {"friction": sharp})) as sim:
        at(sim, 0.002)  # without a line search no step is short enough from 0.04 ms on
        assert sim.integrator.failures < 10  # measured 1
        assert sim.sample()[1]["energy_error"] < 1e-3  # measured 8e-5


@pytest.mark.serial
def test_a_cell_begins_to_push_on_bonds_that_yield_at_once() -> None:
    """Its membrane goes from rest to a hundred times the speed at which bonds yield, part by part."""
    sharp = BELL | {"bonds": "300 /um^2", "stiffness": "0.2 pN/nm", "off": "0.25 /s"}
    spread = {"name": "Cell", "shape": "segment", "width": "3.7 um", "height": "1.8 um", "centre": ["0 um"]}
    push = {"cells": ["Cell"], "protrusion_ratio": 0.2, "height": "0.6 um", "random": True}
    tree = crawler(spread, cortex={"line_tension": "80 pN/um"}, protrusion=push).resolved()
    with built(from_dict(tree | {"friction": sharp})) as sim:
        at(sim, 1e-4)
        assert sim.integrator.failures == 0  # by the slope of friction alone no step is short enough
        assert sim.integrator.record()["out_of_balance"] <= 1e-6


@pytest.mark.serial
@pytest.mark.parametrize("term", FRICTION)
def test_the_secant_of_friction_has_its_force_and_resists_where_its_slope_falls(term: str) -> None:
    """Of a box on the substrate, and on another one."""
    tree = crawler(BOX).resolved() | {"friction": BELL}
    if term == "sliding":
        tree["cells"] = [tree["cells"][0] | {"name": name, "rest": False, "centre": ["0 um", height]}
                         for name, height in (("Below", "1.55 um"), ("Above", "4.6 um"))]
        tree["adhesion"] = {"substrate": BONDS, "cells": BONDS,
                            "pairs": [{"cells": [["Below"], ["Above"]], **BONDS, "friction": BELL}]}
    with built(from_dict(tree)) as sim:
        m, rng = sim.mechanics, np.random.default_rng(3)
        above = 1.0 + (sim.scene.X[m.ids, 1] > 3.0)
        m.state.v[:] = 1e-6 * above[:, None] * rng.uniform(0.2, 2.0, m.state.v.shape)  # bonds bear most at 0.02 µm/s
        m.state.u[:, 1] = 1e-3 * rng.uniform(0.0, 1.0, len(above))
        m.state.v[:2] = 0.0
        m.state.exchange()
        m.rate()
        v = m.state.v.copy()
        slope, secant = ((Stiffness(m).surfaces(0.0, 1.0, (term,), secant=of) @ v.ravel()).reshape(v.shape)
                         for of in (False, True))
        force = m.surface_force(term)[0]
        assert np.abs(force).max() > 0.0
        assert np.abs(secant + force).max() <= 1e-13 * np.abs(secant).max()  # measured 1e-16 and 1.2e-14
        assert np.vdot(v, secant) > 0.0 > np.vdot(v, slope)


@pytest.mark.serial
def test_a_round_cell_spreads_without_a_solve_that_fails() -> None:
    """Its particles snap to the substrate, one or two within a step: the tangent is indefinite on the way."""
    with built(case("spreads", per_cell=150)) as sim:
        at(sim, 20.0)
        assert sim.integrator.failures == 0  # 5 where steps had to reduce the norm of the forces
        assert sim.sample()[1]["energy_error"] < 1e-4  # measured 9e-9


def test_a_newton_step_goes_down_in_energy_where_the_tangent_is_indefinite() -> None:
    """A box is lifted by as much as its bonds are long, to where they pull the less the farther it is."""
    with built(crawler(BOX, medium={"viscosity": "10 Pa s"})) as sim:
        at(sim, 0.01)
        equations, ksp = sim.integrator.equations, sim.integrator.ts.getSNES().getKSP()
        t, by_v = sim.integrator.ts.getTime(), 1e-9  # of a step of 1,000 s
        u, rest = sim.mechanics.state.u + np.array([0.0, 0.05]), np.zeros_like(sim.mechanics.state.u)
        step, residual = equations.matrix.createVecs()
        residual.setArray(equations.imbalance(t, u, rest).ravel())
        equations.exact = 1
        equations.linearise(t, u, rest, by_v, 1.0, ksp, ksp.getPC(), True)
        ksp.solve(residual, step)
        assert residual.dot(step) < 0.0
        assert equations.descend(residual, step, ksp) == residual.dot(step) > 0.0


@pytest.mark.parametrize("share", [0.95, -12.0])
def test_a_surface_that_tension_has_gathered_is_named_with_its_remedy(share: float) -> None:
    """One segment is left with a twentieth of its size, or has 13 times that."""
    with built(crawler(cortex={"line_tension": "50 pN/um"})) as sim:
        at(sim, 0.01)
        with pytest.raises(NumericsError, match="more friction"):
            sim.integrator.fail("nothing", remedy=sim.integrator.remedy)
        one, other = sim.mechanics.kernel["facet"][0]
        state = sim.mechanics.state
        ahead = state.x(np.array([other])) - state.x(np.array([one]))
        state.memory[other, :2] -= share * ahead[0]
        with pytest.raises(NumericsError, match=r"have 0.05 to|to 13.1 times .*area_modulus"):
            sim.integrator.fail("nothing", remedy=sim.integrator.remedy)


@pytest.mark.serial
def test_a_medium_alone_holds_a_cell_without_a_substrate() -> None:
    """A body force f moves a disc at f A/(3πη), whatever the disc is of."""
    force, eta = 1e-4, 0.7e-3  # pN/µm³, Pa s
    pull = {"name": "pull", "body": [f"{force} Pa/um", f"{0.5 * force} Pa/um"]}
    tree = crawler(loads=[pull], medium={"viscosity": f"{eta} Pa s"}).resolved()
    del tree["adhesion"], tree["friction"]
    with built(from_dict(tree | {"cells": [tree["cells"][0] | {"rest": False}]})) as sim:
        at(sim, 1.0)
        v = 1e6 * everywhere(sim, sim.mechanics.state.v)
        area, round_about = sim.scene.field("V").sum(), sim.scene.templates[0].facet_size.sum()
        held = 1.5 * eta / sim.scene.templates[0].radius * round_about
        assert held == pytest.approx(3.0 * np.pi * eta, rel=2e-3)  # measured 1.5e-3, of the polygon
        assert v == pytest.approx(np.outer(np.ones(len(v)), [1.0, 0.5]) * force * area / held, rel=1e-5)
        entries = sim.sample()[1]
        assert entries["medium_loss_pn"] == pytest.approx(entries["external_work_pn"], rel=1e-5)  # measured 1e-6


@pytest.mark.serial
def test_the_density_does_not_matter() -> None:
    """Not even in the last bit."""
    light, heavy = (positions(crawler(material={"density": f"{rho} kg/m^3"}), 0.2) for rho in (1000.0, 10000.0))
    assert np.array_equal(light, heavy)
    assert np.abs(light).max() > 0.01


@pytest.mark.serial
def test_all_viscosities_and_times_together_scale_time_alone() -> None:
    slow = crawler(material={"viscosity": "1000 Pa s"}, friction="30000 Pa s/um")
    fast, slow = positions(crawler(), 0.2), positions(slow, 2.0)
    assert np.abs(slow - fast).max() < 1e-9 * np.abs(fast).max()  # measured 1e-13


@pytest.mark.serial
def test_a_body_force_moves_a_heavier_body_faster() -> None:
    """The force is ρ times the acceleration, though the density counts nowhere else."""
    force = {"acceleration": ["300 m/s^2", "0 m/s^2"]}
    x = [positions(crawler(BOX, material={"density": f"{rho} kg/m^3", "shear_modulus": "2000 Pa"}, body_force=force),
                   20.0)[:, 0].mean() for rho in (1000.0, 2000.0)]
    assert x[0] == pytest.approx(20.0 * 0.3 * 18.0 / (3000.0 * 6.0), rel=0.1)  # settling: 0.077
    assert x[1] == pytest.approx(2.0 * x[0], rel=0.01)


@pytest.mark.serial
@pytest.mark.parametrize("kind", OVERDAMPED)
def test_steps_converge_with_the_order_of_their_type(kind: str) -> None:
    """A bar that is held on the left and pulled on the right."""
    def bar(step: float) -> np.ndarray:
        clock = {"integrator": "overdamped", "end": "1 s", "step": f"{step} s", "samples": 1, "frames": 1}
        body = {"name": "Bar", "shape": "rectangle", "width": "4 um", "height": "2 um", "centre": ["0 um", "0 um"],
                "material": "gel"}
        pull = {"name": "pull", "parts": ["right"], "traction": ["200 Pa", "0 Pa"],
                "load_curve": {"law": "smooth", "duration": "0.8 s"}}
        soft = {"bulk_modulus": "5 kPa", "reduced_bulk_modulus": "5 kPa"}
        scene = from_dict({"time": clock, "particles": {"per_cell": 60}, "materials": {"gel": GEL | soft},
                           "cells": [body], "supports": [{"name": "left", "parts": ["left"]}], "loads": [pull]})
        return positions(scene, 1.0)

    with default_options({"ts_type": kind}):
        x = [bar(step) for step in (0.05, 0.025, 0.0125)]
    change = [np.abs(a - b).max() for a, b in pairwise(x)]
    order = 1 if kind == "beuler" else 2
    assert math.log2(change[0] / change[1]) == pytest.approx(order, abs=0.25), change


def test_any_number_of_ranks_finds_the_same() -> None:
    ours, alone = positions(crawler(), 0.1), positions(crawler(), 0.1, MPI.COMM_SELF)
    assert np.abs(ours - alone).max() < 1e-6 * np.abs(alone).max()


@pytest.mark.serial
@pytest.mark.parametrize("name", ["crawler", "row"])
def test_a_resumed_run_goes_on_with_the_same_bits(name: str) -> None:
    """Of cells in contact, too, of which tangents have had more entries than they have."""
    scene, halves = (crawler(), (0.1, 0.2)) if name == "crawler" else (case("row_chemotaxis", per_cell=60), (240, 480))
    with built(scene) as sim:
        for part in np.linspace(0.0, halves[0], 5)[1:]:
            at(sim, part)
        about, arrays = sim.saved()
        expected = at(sim, halves[1])
    with built(scene) as sim:
        sim.restore(about, arrays)
        assert np.array_equal(at(sim, halves[1]), expected)


@pytest.mark.serial
def test_errors_of_steps_follow_the_tolerance() -> None:
    def moved(tolerance: float) -> np.ndarray:
        with default_options({"ts_atol": str(tolerance)}):
            return positions(crawler(), 0.5)

    loose, tight, finest = map(moved, (8e-3, 1e-3, 2.5e-4))
    # An eighth of the tolerance makes √8 times as many steps of first order: 0.35 of the error; measured 0.29.
    assert np.sqrt(((tight - finest) ** 2).mean() / ((loose - finest) ** 2).mean()) < 0.4


@pytest.mark.serial
def test_large_scenes_reuse_factors_of_earlier_tangents() -> None:
    steps = crawler(BOX, time={"step": "0.2 s"}, loads=[{"name": "pull", "body": ["10 Pa/um", "0 Pa/um"]}])
    with default_options({"matrix_free": "true"}), built(steps) as sim:
        u = at(sim, 4.0)
        assert sim.integrator.equations.assembled < 0.5 * sim.integrator.newton
    assert np.abs(u - positions(steps, 4.0)).max() < 1e-6 * np.abs(u).max()

@pytest.mark.serial
def test_directors_that_have_come_to_rest_cost_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = crawler(material={"eta": "100 pN"}, director={"law": "relaxing", "start": "radial"}, time={"end": "1 ms"})

    def relaxed(rests: float) -> tuple[np.ndarray, int]:
        calls, part = [], mechanics.Mechanics.relax_director
        with monkeypatch.context() as patched, built(scene) as sim:
            patched.setattr(mechanics, "RESTS", rests)
            patched.setattr(mechanics.Mechanics, "relax_director", lambda m, dt: (calls.append(dt), part(m, dt))[1])
            return at(sim, 1e-3), len(calls)

    (x, few), (exact, all_parts) = relaxed(mechanics.RESTS), relaxed(0.0)
    assert np.abs(x - exact).max() < 1e-9 * np.abs(exact).max()  # measured: 2e-14
    assert few < 0.8 * all_parts


@pytest.mark.serial
def test_what_directors_lose_as_they_relax_is_what_their_energy_falls_by() -> None:
    """Their parts are half as long as stability allows: torques at the start of each would lose up to twice of it."""
    field = {"law": "relaxing", "start": "uniform", "direction": [1, "0.5*x"]}
    with built(crawler(material={"eta": "1000 pN"}, director=field)) as sim:
        assert sim.sample()[1]["director_pn"] > 1000.0
        at(sim, 1e-3)
        ledger = sim.sample()[1]
        assert ledger["director_pn"] < 1e-6  # at rest
        assert ledger["energy_error"] < 1e-4  # measured 1e-5, by the torques at the start 0.06
