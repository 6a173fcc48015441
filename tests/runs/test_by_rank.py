"""What `validate --ranks N` says each rank has, beside what ranks then have."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scenes import case

from cellmig.bench.speed import measured
from cellmig.bench.timing import Scene as Row
from cellmig.case.load import load
from cellmig.case.schema import Case
from cellmig.case.shipped import FOLDER
from cellmig.meshfree.terms import find_terms
from cellmig.parallel.partition import partition
from cellmig.runs.by_rank import ALIKE, kinds_of, memory, of_ranks, standing_for
from cellmig.runs.preflight import report
from cellmig.solve.start import discretise
from cellmig.solve.subdomain import Subdomain

pytestmark = pytest.mark.serial

GRID = ("cells.0.repeat=[4, 5]", 'cells.0.pitch=[["10.01 um", "0 um"], ["0 um", "10.01 um"]]')


class Rank:
    """A rank that does not run: what a `Subdomain` asks of a communicator."""

    def __init__(self, rank: int):
        self.rank = rank


@pytest.mark.parametrize(("found", "ranks"), [
    (case("paper", *GRID, per_cell=100), 3), (case("paper", per_cell=1000), 2), (case("three_balls", per_cell=200), 2)])
def test_cells_particles_and_copies_are_those_that_ranks_will_have(found: Case, ranks: int) -> None:
    parts, terms = of_ranks(found, found, ranks), find_terms(found)
    owners, none = partition(discretise(found), ranks, terms.reach, terms.low), np.zeros(len(found.cells), bool)
    there = [Subdomain.of(Rank(rank), owners, terms, none) for rank in range(ranks)]
    particles = [s.n_owned for s in there]
    assert parts.particles == pytest.approx(particles, abs=1.0 * len(found.cells))
    assert parts.cells.sum() == pytest.approx(len(found.cells)) and parts.load == pytest.approx(owners.load)
    fullest = there[int(np.argmax(parts.particles))]
    copies = len(fullest.numbering.ids) - fullest.n_owned
    assert 0.7 * copies <= parts.copies <= copies  # measured 0.74 to 1; ends of segments are not counted


@pytest.mark.usefixtures("hasty")
def test_few_kinds_stand_for_sixty_cells_that_are_all_different() -> None:
    found = load(FOLDER / "tissue.toml", ())
    kinds = kinds_of(found)
    alike = standing_for(kinds)
    assert len(kinds) == 60 and len(set(alike.values())) == ALIKE
    assert all(0.5 < kinds[alike[kind]] / kinds[kind] < 2.0 for kind in kinds)  # measured 0.6 to 1.4
    said = report(found, 4)
    assert re.search(r"^ranks +4, with 1[0-9.]+-1[0-9.]+ cells, ", said, re.MULTILINE), said
    assert re.search(r"^memory +\S+ \S+ in all, \S+ \S+ on the fullest rank$", said, re.MULTILINE), said


@pytest.mark.usefixtures("hasty")
@pytest.mark.parametrize("name", ["one_cell", "nucleus", "beam"])
def test_of_a_single_rank_nothing_is_told(name: str) -> None:
    assert "ranks" not in report(case(name, per_cell=60))


@pytest.mark.usefixtures("hasty")
def test_ranks_are_told_of_cases_whose_steps_are_solved_for() -> None:
    for found in (case("beam", per_cell=60), case("one_cell", "time.integrator=bdf", "time.end=2 us", per_cell=60)):
        assert re.search(r"^ranks +3, with", report(found, 3), re.MULTILINE)


@pytest.mark.slow
@pytest.mark.parametrize(("row", "ranks"), [(Row(100, 1485), 1), (Row(1, 20_000), 2)])
def test_memory_is_estimated_within_fifteen_percent(row: Row, ranks: int) -> None:
    probe, n = measured(row, ranks, repeats=1), row.particles / ranks
    guess = sum(memory(row.case(), probe["kernel_bytes"], n, not rank) for rank in range(ranks))
    assert guess == pytest.approx(probe["peak_bytes"] * row.particles, rel=0.15)  # measured 0.01 and 0.05
