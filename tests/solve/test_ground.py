"""Cells push as firmly as the stiffness below them lets them, and as many bonds as there are."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scenes import built, case, outlines

from mpi4py import MPI

from cellmig.case.schema import Case
from cellmig.model.ground import fields_of, push_factor

HALF, OPTIMUM = '{law="saturating", half="10 kPa"}', '{law="optimum", optimum="10 kPa"}'


def on_gel(stiffness: str, response: str, *sets: str) -> Case:
    """One cell of the paper, which pushes along +x, on a substrate with a stiffness."""
    return case("one_cell", f'substrate.stiffness="{stiffness}"', f"substrate.response={response}",
                'protrusion.cells=["Cell-1"]', "protrusion.random=false", *sets)


def push(found: Case) -> float:
    """Impulse of the push after half a microsecond [pN µs/µm]."""
    with built(found) as sim:
        sim.go(0.5)
        return sim.mechanics.accounts.protrusion_impulse()


@pytest.mark.serial
@pytest.mark.parametrize(("response", "stiffness", "factor"), [
    (HALF, "10 kPa", 0.5), (HALF, "30 kPa", 0.75), (OPTIMUM, "10 kPa", 1.0), (OPTIMUM, "20 kPa", 0.8),
    (OPTIMUM, "5 kPa", 0.8)])
def test_a_push_on_a_uniform_substrate_is_the_share_of_the_response(response: str, stiffness: str,
                                                                     factor: float) -> None:
    """To what the ever so different motion of the cell changes: measured 3e-4 at most."""
    full = push(dataclasses.replace(on_gel(stiffness, response), ground=None))
    assert full > 0.0 and push(on_gel(stiffness, response)) == pytest.approx(factor * full, rel=2e-3)


def test_the_push_follows_the_membrane_from_knot_to_knot() -> None:
    """The kernel has the factors of the places where the membrane was at the last knot, on any ranks."""
    found = on_gel("10000 + 2000*x Pa", HALF, 'time.end="1 us"', "time.samples=4")
    with built(found) as sim:
        before = sim.mechanics.kernel["push"].copy()
        x = outlines(sim)
        sim.go(0.25)
        k, ends = sim.mechanics.kernel, sim.mechanics.segments.ends
        then, now = (push_factor(found.ground, fields_of(found), at, 0.0)[ends]
                     for at in (x, outlines(sim)))
        np.testing.assert_allclose(k["push"] * then, before * now, rtol=1e-12)
        assert sim.comm.allreduce(bool((k["push"] != before).any()), MPI.LOR)


def test_a_push_by_the_stiffness_has_the_same_bits_on_any_ranks() -> None:
    hashes = set()
    for comm in (MPI.COMM_WORLD, MPI.COMM_SELF):
        found = on_gel("10000 + 2000*x Pa", HALF, 'substrate.ligand="0.5 + 0.02*x"', 'time.end="1 us"')
        with built(found, comm) as sim:
            sim.go(0.5)
            hashes.add(sim.state_hash())
    assert len(hashes) == 1


def both_sides(stiffness: str, response: str) -> Case:
    """A spread cell without a polarity, which pushes outwards on both of its sides, without inertia."""
    return case("crawl", f'substrate.stiffness="{stiffness}"', f"substrate.response={response}", "protrusion.basal=1",
                'polarity={spread=0, persistence="10 min"}', per_cell=300)


def way(found: Case) -> float:
    """Way of a cell in half an hour [µm]."""
    with built(found, MPI.COMM_SELF) as sim:
        before = sim.sample()[0][0]["x_um"]
        sim.go(1.8e9)
        return sim.sample()[0][0]["x_um"] - before


@pytest.mark.serial
@pytest.mark.parametrize(("stiffness", "response", "sign"), [
    ("10000 + 0*x Pa", HALF, 0), ("6000 + 200*x Pa", OPTIMUM, 1), ("16000 + 200*x Pa", OPTIMUM, -1)])
def test_a_cell_goes_up_the_stiffness_below_the_optimum_and_down_above_it(stiffness: str, response: str,
                                                                           sign: int) -> None:
    """Measured 6e-13, 3.64 and -1.43 µm."""
    moved = way(both_sides(stiffness, response))
    assert sign * moved > 1.0 if sign else abs(moved) < 1e-9
