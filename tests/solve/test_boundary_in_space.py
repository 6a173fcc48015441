"""Supports, loads, plates and probes in three dimensions: against exact solutions, balanced, accounted for."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import CASES, built, everywhere
from scipy.optimize import brentq

from mpi4py import MPI

from cellmig.case.load import from_dict, load
from cellmig.case.schema import Case
from cellmig.simulation import Simulation

STRETCH = np.array([[0.02, 0.01, 0.0], [-0.01, -0.015, 0.005], [0.0, 0.004, 0.01]])
AREA, TRACTION = 4.0, 100.0


def bar(*sets: str, case: str = "bar", size: int = 300) -> Case:
    """The bar of the cases, coarser."""
    return load(CASES[case], [f"particles.per_cell={size}", *sets])


def row(sim: Simulation) -> dict[str, float]:
    """The row of the first cell in history.csv."""
    return sim.sample()[0][1]


@pytest.mark.serial
def test_a_bar_comes_to_rest_where_its_modulus_says() -> None:
    """Smooth walls at two sides let it become thinner: the stretch is the same everywhere, traction over modulus."""
    walls = ('supports=[{name="left", parts=["left"], displacement=["0 um", "free", "free"]},'
             '{name="front", parts=["front"], displacement=["free", "0 um", "free"]},'
             '{name="bottom", parts=["bottom"], displacement=["free", "free", "0 um"]}]')
    with built(bar(walls, "materials.gel.viscosity=20 mPa s")) as sim:
        sim.sample()  # the start of the ledger
        sim.go(200.0)
        found, (_, ledger) = row(sim), sim.sample()
        stretch = brentq(lambda s: 1e3 * (s - s**-2) - TRACTION, 1.0, 1.1) + TRACTION / 9e6  # Rivlin (1948), and 1/9K
        right = 10.0 * (stretch - 1.0)
        assert found["end_ux_um"] == pytest.approx(right, rel=1e-3)  # measured 1e-5
        assert found["left_force_x_pn"] == pytest.approx(-AREA * TRACTION, rel=1e-4)  # measured 2e-6
        assert abs(found["front_force_y_pn"]) + abs(found["bottom_force_z_pn"]) < 0.01  # pN; measured 2e-4
        assert ledger["energy_error"] < 1e-4  # measured 6e-13, at rest
        u = everywhere(sim, sim.mechanics.state.u)
        along = sim.scene.X[:, 0] + 5.0
        assert np.abs(u[:, 0] - right * along / 10.0).max() < 1e-4 * right  # measured 1e-5


@pytest.mark.serial
def test_a_surface_that_is_moved_linearly_stretches_all_of_the_inside() -> None:
    value = ", ".join(f'"{a}*x + {b}*y + {c}*z um"' for a, b, c in STRETCH)
    hold = f'supports=[{{name="all", displacement=[{value}], load_curve={{law="smooth", duration="20 us"}}}}]'
    with built(bar(hold, "loads=[]", "probes=[]", "materials.gel.viscosity=20 mPa s")) as sim:
        sim.go(60.0)
        u, x = everywhere(sim, sim.mechanics.state.u), sim.scene.X - sim.scene.centre[0]
        assert np.abs(u - x @ STRETCH.T).max() < 1e-5 * np.abs(u).max()  # measured 2e-6
        assert sum(abs(row(sim)[f"all_force_{c}_pn"]) for c in "xyz") < 1e-4  # pN; measured 2e-7


@pytest.mark.serial
def test_a_pressure_all_around_has_no_resultant_and_compresses(comm: MPI.Comm) -> None:
    free = ("supports=[]", "probes=[]", "materials.gel.viscosity=50 mPa s",
            'loads=[{name="p", pressure="2 kPa", load_curve={law="smooth", duration="4 us"}}]')
    with built(bar(*free)) as sim:
        sim.go(15.0)
        m = sim.mechanics
        m.rate()
        force = everywhere(sim, m.loads.add_to(np.zeros((m.n_owned, 3))))
        x = everywhere(sim, m.scene.X[m.ids] + m.state.u)
        size = np.abs(force).sum()
        assert size > 1.7e5  # pN; measured 1.76e5
        assert np.abs(force.sum(axis=0)).max() < 1e-13 * size  # measured 2e-16
        assert np.abs(np.cross(x, force).sum(axis=0)).max() < 1e-12 * size  # µm; measured 1e-16
        J = everywhere(sim, m.state.J_of_rows[: m.n_owned])
        assert J.mean() == pytest.approx(1.0 - 2e3 / 1e6, abs=2e-4)  # measured 2e-6


def test_plates_press_with_equal_forces_whose_work_is_accounted_for() -> None:
    with built(bar(case="ball_nucleus")) as sim:
        sim.sample()
        sim.go(30.0)
        found, (_, ledger) = row(sim), sim.sample()
        x = everywhere(sim, sim.mechanics.scene.X[sim.mechanics.ids] + sim.mechanics.state.u)
        assert x[:, 2].min() >= -1e-12 and x[:, 2].max() <= 10.0 - 3.0 * 30.0 / 40.0 + 1e-12
        assert found["bottom_force_z_pn"] > 1000.0 and found["top_force_z_pn"] < -1000.0  # measured 2905
        assert abs(found["bottom_force_x_pn"]) + abs(found["top_force_y_pn"]) == 0.0  # they are smooth
        assert ledger["energy_error"] < 1e-4  # measured 1e-6


def test_a_probe_of_a_point_follows_a_body_that_turns() -> None:
    sets = ("supports=[]", "loads=[]", 'cells.0.velocity=["-0.1*y um/us", "0.1*x um/us", "0.05 um/us"]',
            'probes=[{name="point", point=["1 um", "0.5 um", "-0.3 um"]}]')
    with built(bar(*sets)) as sim:
        sim.go(0.02)
        found = row(sim)
        moved = [found[f"point_u{c}_um"] for c in "xyz"]
        assert moved == pytest.approx([-0.05 * 0.02, 0.1 * 0.02, 0.05 * 0.02], rel=2e-3)  # measured 2e-4
        assert found["point_z_um"] == pytest.approx(2.0 - 0.3 + moved[2], abs=1e-12)


def slab(dimension: int, size: int) -> Case:
    """A beam of gel that is held at its left end and bent by a shear at the other, in space between smooth walls."""
    gel = {"law": "gel", "shear_modulus": "1 kPa", "viscosity": "5 mPa s", "bulk_modulus": "2.2 GPa",
           "reduced_bulk_modulus": "1 MPa"}
    plane, left = dimension == 2, {"name": "left", "parts": ["left"]}
    shape = {"shape": "rectangle", "width": "10 um", "height": "2 um"} if plane else {
        "shape": "box", "a": "10 um", "b": "1 um", "c": "2 um"}
    walls = [{"name": "walls", "parts": ["front", "back"], "displacement": ["free", "0 um", "free"]}]
    across = [] if plane else ["0 Pa"]
    shear = {"name": "shear", "parts": ["right"], "traction": ["0 Pa", *across, "5 Pa"],
             "load_curve": {"law": "smooth", "duration": "20 us"}}
    cell = {"name": "Beam", "material": "gel", "centre": ["0 um", *["0 um"] * (not plane), "5 um"], **shape}
    return from_dict({"dimension": dimension, "time": {"end": "40 us"}, "particles": {"per_cell": size},
                      "materials": {"gel": gel}, "cells": [cell], "loads": [shear],
                      "supports": [left] if plane else [*walls, left],
                      "probes": [{"name": "end", "parts": ["right"]}]})


@pytest.mark.serial
def test_a_slab_between_smooth_walls_moves_as_in_plane_strain() -> None:
    """Finite elements in space and reproducing kernels in the plane: they have no gradient in common."""
    ends = []
    for dimension, size in ((2, 1200), (3, 700)):
        with built(slab(dimension, size)) as sim:
            sim.go(40.0)
            ends.append([row(sim)[f"end_u{c}_um"] for c in ("y" if dimension == 2 else "z", "x")])
    assert ends[0][0] > 0.7 and ends[0][1] < -0.03  # µm; measured 0.760, -0.0329
    assert ends[1] == pytest.approx(ends[0], rel=0.01)  # measured 0.0034, 0.0042


def test_supports_and_loads_in_space_have_the_same_bits_on_any_ranks(comm: MPI.Comm) -> None:
    with built(bar()) as sim:
        sim.go(2.0)
        mine = sim.state_hash()
    if comm.rank == 0:
        with Simulation(bar(), MPI.COMM_SELF) as alone:
            alone.go(2.0)
            assert alone.state_hash() == mine
