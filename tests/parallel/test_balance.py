"""Balance of ranks: the cost of cells that the partition expects, and the work that runs measure."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from scenes import built, case

from mpi4py import MPI

from cellmig.case.load import from_dict
from cellmig.meshfree.scene import Scene
from cellmig.parallel.cost import CONTACT, cost_of_cells, near_others
from cellmig.parallel.partition import partition
from cellmig.runs.run import Run
from cellmig.solve.start import discretise


def packed(dimension: int, per_cell: int, apart: float) -> Scene:
    """A block of 4 x 3 cells that touch, and a row of four that stand alone."""
    name = {2: "one_cell", 3: "ball"}[dimension]
    tree = case(name, per_cell=per_cell).resolved()
    cell = tree["cells"][0]
    low = ["0 um"] * (dimension - 1)
    first = [[f"{x} um", *low[1:], "5.01 um"] for x in (0.0, 60.0)]
    tree["cells"] = [
        cell | {"name": "A-{}", "centre": first[0], "repeat": [4, 3],
                "pitch": [["10.01 um", *low], [*low, "10.01 um"]]},
        cell | {"name": "B-{}", "centre": first[1], "repeat": [4], "pitch": [[f"{apart} um", *low]]}]
    return discretise(from_dict(tree))


@pytest.mark.parametrize("dimension", [2, 3])
def test_cells_that_touch_others_cost_more_than_those_alone(dimension: int) -> None:
    scene = packed(dimension, 300, 14.0)
    cost, rows = cost_of_cells(scene, 0.5), cost_of_cells(scene)
    near = near_others(scene, 0.5)
    assert cost == pytest.approx(rows + CONTACT[dimension] * near)
    assert (near[12:] == 0).all() and (near[:12] > 0).all()
    corner, edge, inside = near[0], near[1], near[5]  # with two, three and four neighbours
    assert corner < edge < inside == pytest.approx(2.0 * corner, rel=0.1)
    assert near_others(scene, 0.5, most=int(scene.first_surface[-1]) // 3) == pytest.approx(near, abs=0.7 * inside)
    alone = partition(scene, 2, 0.5).first == partition(scene, 2, 0.5).first[-1]
    assert alone[12:].all() and alone.sum() > 8  # who has the cells alone has more cells


def test_the_work_of_a_rank_in_steps_is_measured_without_its_waiting(comm: MPI.Comm) -> None:
    with built(case("paper", per_cell=60), comm) as simulation:
        m = simulation.mechanics
        assert m.working == 0.0 and len(m.part.owners.load) == comm.size
        m.advance(200, 1e-12)
        once = m.working
        m.advance(2000, 1e-12)
        assert 0.0 < once < m.working


def test_a_run_on_several_ranks_tells_the_balance_it_expects_and_the_one_it_had(comm: MPI.Comm, tmp_path: Path) -> None:
    out = comm.bcast(tmp_path)
    Run(case("paper", "time.end=0.5 us", per_cell=60), out / "run", comm, quiet=True).go()
    lines = (out / "run" / "run.log").read_text().splitlines() if comm.rank == 0 else []
    told = [line for line in lines if line.startswith("balance")]
    assert len(told) == (2 if comm.size > 1 and comm.rank == 0 else 0), told
    over_mean = [float(re.search(r"ha[sd] ([0-9.]+) of the mean", line)[1]) for line in told]
    assert all(1.0 <= one <= comm.size for one in over_mean)
