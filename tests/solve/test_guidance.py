"""Polarities in the mechanics: where cells push, from when on, and the same bits on any ranks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes import built, case, everywhere

from mpi4py import MPI

from cellmig.case.load import change
from cellmig.case.messages import CaseError
from cellmig.runs.run import Run
from cellmig.simulation import Simulation
from cellmig.solve.step import NumericsError

POLAR = ('polarity.persistence="2 us"',)  # of three cells: a knot every 0.1 µs


def push(sim: Simulation) -> np.ndarray:
    """Sum of the push of each cell (cells, d) [pN/µm]; collective."""
    m = sim.mechanics
    of_all = everywhere(sim, m.surface_force("protrusion")[0])
    return np.array([of_all[sim.scene.cell == c].sum(axis=0) for c in range(len(sim.scene.kind))])


@pytest.mark.parametrize("law", ["relaxing", "switching"])
def test_all_ranks_together_and_each_alone_come_to_the_same_bits(law: str) -> None:
    runs = []
    for comm in {MPI.COMM_WORLD.size: MPI.COMM_WORLD, 1: MPI.COMM_SELF}.values():
        with built(case("all_protrude", *POLAR, f'polarity.law="{law}"', "protrusion.basal=0.3"), comm) as sim:
            sim.go(3.0)
            runs.append((sim.state_hash(), sim.guidance.now().tolist()))
    assert runs == runs[:1] * len(runs)
    assert MPI.COMM_WORLD.bcast(runs[0]) == runs[0]


def test_polarities_do_not_depend_on_where_runs_stop() -> None:
    with built(case("all_protrude", *POLAR)) as often, built(case("all_protrude", *POLAR)) as once:
        for time in np.linspace(0.07, 1.5, 20):
            often.go(time)
        once.go(1.5)
        assert np.array_equal(often.guidance.p, once.guidance.p)
        assert np.array_equal(often.guidance.then, once.guidance.then)


def test_fixed_steps_have_the_same_bits_however_often_one_looks() -> None:
    fixed = case("all_protrude", *POLAR, 'time.step="2 ns"')
    with built(fixed) as often, built(fixed) as once:
        for time in np.linspace(0.026, 0.52, 20):
            often.go(time)
        once.go(0.52)
        assert often.state_hash() == once.state_hash()


def test_the_work_of_pushes_that_turn_closes_the_energy_without_inertia() -> None:
    with built(case("crawl_row", 'polarity.persistence="20 s"', per_cell=60)) as sim:
        sim.go(40e6)
        assert abs(sim.sample()[1]["energy_error"]) < 1e-5  # measured 6e-7; 0.05 where the clock of the push is lost


@pytest.mark.parametrize(("name", "persistence"), [("all_protrude", "2 us"), ("crawl_row", "20 s")])
def test_knots_and_samples_that_differ_by_rounding_are_at_one_time(name: str, persistence: str) -> None:
    with built(case(name, f'polarity.persistence="{persistence}"', per_cell=60)) as sim:
        interval = sim.guidance.due
        for knot, other in ((1, np.inf), (2, 0.0), (3, np.inf)):
            stop = float(np.nextafter(interval * knot, other))
            assert sim.go(stop) == stop and sim.guidance.knot == knot
        assert sim.integrator.extremes["dt_min"] > 1e-4 * interval


@pytest.mark.serial
@pytest.mark.parametrize("name", ["all_protrude", "three_balls"])
def test_a_polarity_that_stays_is_the_push_along_x(name: str) -> None:
    """To the bit, but for where steps end."""
    same = case(name, 'polarity={persistence="1 s", spread=0, start=[1]}' if name == "all_protrude" else
                'polarity={persistence="1 s", spread=0, start=[1, 0]}')
    with built(same) as polar, built(case(name)) as plain:
        for sim in (polar, plain):
            sim.go(1.0)
        assert np.abs(push(plain)).max() > 0.0
        # In a persistence time without cues the polarity falls e-fold: by 1e-6 in 1 µs; measured 1e-9.
        assert np.abs(push(polar) - push(plain)).max() < 1e-5 * np.abs(push(plain)).max()


def test_cells_push_where_they_are_told_and_when() -> None:
    told = ('cells.Cell-1.push={direction=[-2]}', 'cells.Cell-2.push={strength=0.5}',
            'cells.Cell-3.push={begin="1 us", end="2 us"}')
    with built(case("all_protrude", *told)) as sim, built(case("all_protrude")) as plain:
        for one in (sim, plain):
            one.go(0.5)
            one.sample()
        found, usual = push(sim)[:, 0], push(plain)[:, 0]
        assert found[0] < -0.1 * usual[0]  # another side of the cell, whose α is another: measured -0.74
        assert found[1] == pytest.approx(0.5 * usual[1], rel=0.02)  # measured 0.002
        assert found[2] == 0.0 < usual[2]
        sim.go(1.5)
        assert push(sim)[2, 0] > 0.0
        sim.go(2.5)
        assert push(sim)[2, 0] == 0.0


def test_neighbours_that_do_not_push_have_no_polarity() -> None:
    given = ('protrusion.cells=["Cell-2"]', "polarity.spread=0", "polarity.start=[1]", 'cues=[{law="neighbours"}]')
    with built(case("all_protrude", *POLAR, *given)) as sim:
        assert sim.guidance.p[:, 0].tolist() == [0.0, 1.0, 0.0]
        cue, = sim.guidance.parts.values()
        assert cue[1, 0] == pytest.approx(-1.0)  # of two at rest on either side


def test_a_polarity_of_constant_size_begins_in_the_given_direction_with_that_size() -> None:
    small = ("polarity.law=switching", "polarity.spread=0.5", "polarity.start=[-5]")
    with built(case("all_protrude", *POLAR, *small)) as sim:
        assert sim.guidance.p[:, 0].tolist() == [-0.5, -0.5, -0.5]


def test_in_space_the_push_is_along_the_polarity() -> None:
    with built(case("three_balls", "protrusion.direction=[3, 4]")) as sim:
        sim.go(1.0)
        found = push(sim)
        size = np.linalg.norm(found, axis=1)
        assert size.min() > 0.0
        assert np.abs(found @ [0.6, 0.8, 0.0] - size).max() < 1e-12 * size.max()  # measured 2e-16


@pytest.mark.serial
@pytest.mark.parametrize("name", ["one_cell", "ball"])
def test_a_basal_push_spreads_a_cell_and_leaves_it_where_it_is(name: str) -> None:
    body = case(name).cells[0].name
    tree = {"protrusion": {"cells": [body], "random": False, "basal": 1.0},
            "polarity": {"persistence": "1 s", "spread": 0}}
    with built(change(case(name), tree)) as sim:
        sim.go(1.0)
        m = sim.mechanics
        force = everywhere(sim, m.surface_force("protrusion")[0])
        along = (force[:, 0] * (everywhere(sim, m.state.u)[:, 0] + sim.scene.X[:, 0] - sim.scene.centre[0, 0])).sum()
        assert along > 0.0  # outwards


@pytest.mark.serial
@pytest.mark.parametrize(("sets", "key"), [
    (['polarity.start=[1, 0]'], "polarity.start"), (["protrusion.direction=[0]"], "protrusion.direction"),
    (["protrusion.direction=[-1]"], "protrusion.direction: cells with a polarity push along that"),
    (["cells.Cell-1.push.direction=[-1]"], "push.direction: cells with a polarity push along that"),
    (['cells.Cell-1.push={begin="2 us", end="1 us"}'], "push.end"), (["protrusion.cells=[]"], "polarity")])
def test_what_makes_no_sense_is_refused_with_its_key(sets: list[str], key: str) -> None:
    with pytest.raises(CaseError, match=key):
        case("all_protrude", *POLAR, *sets)


@pytest.mark.parametrize(("sets", "part"), [
    (['cues=[{law="given", vector=["sqrt(0.25 - t_us)"]}]'], "0.3 µs: the cue 0_given of 'Cell-1' is not finite"),
    (['fields.c={formula="sqrt(0.25 - t_us) nM"}', 'cues=[{law="occupancy", field="c", affinity="1 nM"}]'],
     "0.3 µs: the cue 0_occupancy of 'Cell-1' is not finite"),
    (['cues=[{law="given", vector=["1/t_us"], cells=["Cell-2"]}]'], "0 µs: the cue 0_given of 'Cell-2' is not finite"),
    (['substrate={stiffness="1 + exp(1000 - 0*x) kPa", response={law="saturating", half="1 kPa"}}'],
     "an amount is finite and at least 0")])
def test_what_is_not_finite_is_told_by_its_name_and_time(sets: list[str], part: str) -> None:
    with pytest.raises((NumericsError, CaseError), match=part), built(case("all_protrude", *POLAR, *sets)) as sim:
        sim.go(0.5)


@pytest.mark.serial
def test_cells_whose_push_is_zero_may_have_a_polarity(tmp_path: Path) -> None:
    idle = case("all_protrude", *POLAR, "protrusion.protrusion_ratio=0", "protrusion.basal=0.5", 'time.end="0.01 us"')
    with built(idle) as sim:
        assert sim.guidance is None and not sim.polar and sim.mechanics.terms.sides == 1
    assert Run(idle, tmp_path / "run", MPI.COMM_SELF, quiet=True).go() == 0
    assert not (tmp_path / "run" / "cues.csv").exists()


def test_without_polarity_nothing_is_compiled_or_stored() -> None:
    with built(case("all_protrude")) as plain, built(case("all_protrude", *POLAR)) as polar:
        assert plain.guidance is None and "guidance" not in plain.saved()[0]
        assert "turn_drives" not in plain.mechanics.kernel.source
        assert "turn_drives" in polar.mechanics.kernel.source and "guidance" in polar.saved()[0]
