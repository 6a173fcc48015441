"""Holes are free surfaces: no bonds, no protrusion; what acts on the outer loop does not see them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenes import built, case, surfaces

from mpi4py import MPI

from cellmig.case.load import from_dict
from cellmig.case.messages import CaseError

HOLE = ["0 um", "-2.5 um", "1.4 um"]  # leaves 0.1 um below it: bonds would reach it


def hollow(*more: dict, protrusion: bool = False, **shape: Any) -> dict:
    """Round cells near the substrate, each with a hole just above it."""
    tables = case("one_cell", per_cell=300).resolved()
    cell = {"name": "A", "shape": "ellipse", "a": "4 um", "b": "4 um", "material": "cytoplasm", "holes": [HOLE],
            "centre": ["0 um", "4.01 um"]} | shape
    tables["cells"] = [cell, *[cell | change for change in more]]
    tables["protrusion"]["cells"] = ["A"] if protrusion else []
    return tables


def in_holes(sim) -> np.ndarray:
    """Which particles are around holes (size,) bool."""
    found, s = np.zeros(sim.scene.size, bool), surfaces(sim)
    found[s.ids[~s.outer]] = True
    return found


def of_all(sim, term: str) -> np.ndarray:
    force = np.zeros((sim.scene.size, 2))
    force[sim.mechanics.ids] = sim.mechanics.surface_force(term)[0]
    return force


@pytest.mark.serial
def test_bonds_and_protrusion_do_not_reach_a_hole() -> None:
    with built(from_dict(hollow(protrusion=True))) as sim:
        inner = in_holes(sim)
        assert inner.sum() > 8 and sim.scene.X[inner, 1].min() < 0.5 * sim.terms.substrate.cutoff
        for term in ("substrate", "protrusion"):
            force = of_all(sim, term)
            assert np.abs(force).max() > 0.0 and not force[inner].any()


@pytest.mark.serial
def test_cells_touch_with_their_outer_loops_alone() -> None:
    beside = {"name": "B", "centre": ["-8.01 um", "4.01 um"], "holes": [["2.5 um", "0 um", "1.4 um"]]}
    with built(from_dict(hollow(beside, holes=[["-2.5 um", "0 um", "1.4 um"]]))) as sim:
        inner, force = in_holes(sim), of_all(sim, "contact")
        assert np.abs(force).max() > 0.0 and not force[inner].any()
        assert not inner[sim.mechanics.segments.lists.ids].any()


@pytest.mark.serial
def test_area_and_perimeter_are_those_with_the_hole() -> None:
    with built(from_dict(hollow())) as sim:
        t, (_, row) = sim.scene.templates[0], sim.sample()[0]
        assert row["area_um2"] == pytest.approx(t.V.sum(), rel=1e-12)
        assert row["perimeter_um"] == pytest.approx(2 * np.pi * 5.4, rel=0.02)  # measured 0.008: polygons for circles


def test_a_hollow_cell_keeps_its_energy_and_the_same_bits_on_any_number_of_ranks() -> None:
    stirred = from_dict(hollow(protrusion=True, velocity=["0.1*sin(y) um/us", "0.1*cos(2*x) um/us"]))
    hashes = []
    for comm in (MPI.COMM_WORLD, MPI.COMM_SELF):
        with built(stirred, comm) as sim:
            sim.go(0.4)
            assert sim.sample()[1]["energy_error"] < 0.003  # measured 0.0019
            hashes.append(sim.state_hash())
    assert hashes[0] == hashes[1]


def um(*corners: tuple[float, float]) -> list:
    return [[f"{x} um", f"{y} um"] for x, y in corners]


@pytest.mark.serial
@pytest.mark.parametrize(("cutouts", "message"), [
    ([um((0, 0), (1, 0))], "cutouts: that of 2 corners at (0, 0) um has no area"),
    ([[]], "cutouts: that of 0 corners has no area"),
    ([um((0, 0), (1, 1), (1, 0), (0, 1))], "cutouts: that of 4 corners at (0, 0) um crosses or touches itself"),
    ([um((0, 0), (5, 0), (0, 1))], "is not inside the outline"), ([um((5, 5), (6, 5), (6, 6))], "is not inside"),
    ([um((-3.9, 0.5), (3.9, 0.5), (0, -0.5)), um((0, 0), (0.5, 0), (0, 0.2))], "and another hole overlap"),
    ([um((0, 0), (2, 0), (0, -3))], "at (0, 0) um and another hole overlap"),  # a circle
    ([um((-0.1, -2.5), (0.1, -2.5), (0, -2.4))], "and another hole overlap"),  # within the circle
])
def test_holes_that_are_none_are_refused(cutouts: list, message: str) -> None:
    with pytest.raises(CaseError) as error:
        from_dict(hollow(cutouts=cutouts))
    assert message in str(error.value)


@pytest.mark.serial
def test_a_hole_too_small_for_its_particles_is_a_mistake_of_the_case() -> None:
    small = from_dict(hollow(holes=[["0 um", "1 um", "0.2 um"]]))
    with pytest.raises(CaseError, match=r"'A': 300 particles are too few for the hole at .*, 1\) um"), built(small):
        pass


@pytest.mark.serial
def test_a_uniform_stress_balances_tractions_on_all_loops() -> None:
    """What the body pulls at its particles is what the stress pulls along the outline and around the holes."""
    hook = um((-2, -2), (1, -2), (1, -1), (-1, -1), (-1, 0.5), (-2, 0.5))
    with built(from_dict(hollow(holes=[["0 um", "2 um", "1 um"]], cutouts=[hook]))) as sim:
        t, stress = sim.scene.templates[0], np.array([[3.0, -1.0], [-1.0, 2.0]])
        pulled = np.column_stack([sum(g.T @ (t.V * stress[i, j]) for j, g in enumerate(t.G))
                                  for i in range(2)])
        ends = t.X[t.facets]
        along = ends[:, 1] - ends[:, 0]
        traction = 0.5 * np.column_stack([along[:, 1], -along[:, 0]]) @ stress
        expected = np.zeros_like(t.X)
        for k in range(2):
            np.add.at(expected, t.facets[:, k], traction)
        assert np.abs(pulled - expected).max() < 1e-11  # measured 3e-14
        for loop in range(3):
            assert np.abs(along[t.loop == loop].sum(axis=0)).max() < 1e-13  # measured 3e-15: so do normals
