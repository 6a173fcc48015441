"""Cells whose clutches pull on both sides go to where they pull most, and find it themselves."""

from __future__ import annotations

from copy import deepcopy

import numpy as np
import pytest
from scenes import ROOT, built, case, everywhere

from mpi4py import MPI

import cellmig
from cellmig.case.schema import Case
from cellmig.parallel.collect import broadcast

SECOND = 1e6  # µs
# Clutches a million times as fast as those of filopodia, for cells of the paper; a knot every 0.1 µs.
FAST = ("protrusion.basal=1", 'polarity={persistence="2 us", spread=0.5}', 'substrate.stiffness="1400*exp(x/5) Pa"',
        'substrate.response={law="clutches", on="1 1/us", off="0.1 1/us", speed="0.12 m/s", force="2 pN"}')


def pulled(centre: float, stiffness: str = "1.4*exp(x/20) kPa", seed: int = 1) -> Case:
    """The cell of the case, coarse, for ten minutes."""
    found = cellmig.load(ROOT / "cases" / "durotaxis_clutches.toml")
    return cellmig.change(found, {"particles.per_cell": 100, "time.end": "10 min", "seed": seed,
                                  "cells.0.centre": [f"{centre} um"], "substrate.stiffness": stiffness})


def run(found: Case) -> tuple[float, float]:
    """Displacement along x [µm], and the mean over the knots of what the right side pulls more than the left [-]."""
    more = []
    with built(found) as sim:
        step = found.polarity.interval
        for knot in range(1, round(found.time.end / step) + 1):
            left, right = sim.guidance.saved()[0]["pull"][0][::-1]
            more.append(right - left)
            sim.go(knot * step)
        moved = everywhere(sim, sim.mechanics.state.u)[:, 0].mean()
    return float(moved), float(np.mean(more))


@pytest.mark.serial
@pytest.mark.parametrize("seed", [1, 2])
def test_a_cell_goes_to_its_optimum_from_both_sides_and_nowhere_on_a_uniform_substrate(seed: int) -> None:
    """Isomursu et al. (2022): negative durotaxis above the optimum, positive below it; the law has no stiffness."""
    soft, stiff, even = (run(pulled(*where, seed=seed)) for where in ((-40.0,), (40.0,), (0.0, "1.4 kPa")))
    assert soft[0] > 0.25 and stiff[0] < -0.8  # measured 0.43 and 0.36, -1.13 and -1.09 µm
    assert abs(even[0]) < 0.05  # measured -0.010 and -0.005 µm
    for moved, more in (soft, stiff):  # 50 µm/h by the full push on one side alone, as in crawl.toml; measured 46
        assert moved == pytest.approx(50.0 / 6.0 * more, rel=0.12)
    assert soft[0] / soft[1] == pytest.approx(stiff[0] / stiff[1], rel=0.03)  # forces are in balance; measured 1 %


def test_all_ranks_together_and_each_alone_come_to_the_same_bits() -> None:
    runs = []
    for comm in {MPI.COMM_WORLD.size: MPI.COMM_WORLD, 1: MPI.COMM_SELF}.values():
        with built(case("all_protrude", *FAST), comm) as sim:
            sim.go(1.0)
            pull = sim.guidance.saved()[0]["pull"]
            runs.append((sim.state_hash(), pull))
            assert len(np.unique(pull)) == 6  # each side of each cell has a module
    assert runs == runs[:1] * len(runs)
    assert MPI.COMM_WORLD.bcast(runs[0]) == runs[0]


def test_a_run_that_goes_on_from_a_checkpoint_has_the_same_clutches() -> None:
    with built(case("all_protrude", *FAST)) as whole, built(case("all_protrude", *FAST)) as second:
        whole.go(0.55)
        whole.sample()
        second.restore(*whole.saved())
        whole.go(1.0)
        second.go(1.0)
        assert second.state_hash() == whole.state_hash()
        (about, arrays), (too, more) = whole.saved(), second.saved()
        assert too["guidance"] == about["guidance"]
        if whole.comm.rank == 0:
            assert (more["guidance clutches"] == arrays["guidance clutches"]).all()


@pytest.mark.serial
def test_without_inertia_too_a_run_goes_on_with_the_same_clutches() -> None:
    found = pulled(-40.0)
    with built(found) as whole, built(found) as second:
        whole.go(95.0 * SECOND)
        whole.sample()
        second.restore(*whole.saved())
        whole.go(190.0 * SECOND)
        second.go(190.0 * SECOND)
        assert second.state_hash() == whole.state_hash()
        assert second.saved()[0]["guidance"] == whole.saved()[0]["guidance"]


def test_what_is_saved_stays_as_it_is_while_the_run_goes_on() -> None:
    """Without inertia a checkpoint is that of the last sample, and may be written much later."""
    with built(case("all_protrude", *FAST)) as sim:
        sim.go(0.55)
        about, arrays = sim.saved()
        before = deepcopy((about, arrays))
        sim.go(1.0)
        assert about == before[0]
        now, then = (broadcast(sim.comm, found) for found in (arrays, before[1]))
        assert all(np.array_equal(values, then[name]) for name, values in now.items())


def test_without_clutches_cells_have_no_sides_and_nothing_is_stored() -> None:
    with built(case("all_protrude", *FAST[:3])) as sim:
        stored = sim.saved()[1]
        assert "guidance clutches" not in stored
    with built(case("all_protrude", FAST[1])) as sim:
        assert sim.mechanics.terms.sides == 1
    with built(case("all_protrude", *FAST[1:])) as sim:  # and with them, even where only the leading side pushes
        assert sim.mechanics.terms.sides == 2


def test_on_a_rigid_and_on_a_soft_substrate_the_push_is_that_of_the_clutches() -> None:
    with built(case("all_protrude", *FAST[:2], 'substrate.stiffness="1 GPa"', FAST[3])) as sim:
        sim.go(2.0)
        pull = np.array(sim.guidance.saved()[0]["pull"])
        assert 0.05 < pull.mean() < 0.2  # 0.106 in the long run
