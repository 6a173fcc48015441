"""Fields that diffuse: some of the references, and what holds for every field, on any ranks."""

from __future__ import annotations

from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scenes import built, case

from mpi4py import MPI
from petsc4py import PETSc

from cellmig.case.messages import CaseError
from cellmig.case.schema import Case
from cellmig.model.diffusing import Diffusing, Walls
from cellmig.output.tables import read_table
from cellmig.runs.run import Run
from cellmig.solve import diffusing
from cellmig.solve.diffusing import DiffusingField
from cellmig.solve.exchange import Exchanging
from cellmig.solve.grid import Grid
from cellmig.solve.step import NumericsError
from cellmig.solve.waves import Waves
from cellmig.verify.reference import REFERENCES, judge
from cellmig.verify.references.diffusing import D, S, circle, field, nowhere, share_inside, surface

WORLD = MPI.COMM_WORLD
QUICK = ("spreading-disc", "secreting-disc", "channel", "channel-in-time", "sink-in-a-box")

# Three coarse cells in a row for some µs, of a field as fast as that: D = 1e6 µm²/s.
LIVING = ('polarity.persistence="2 us"',
          'fields.c={law="diffusing", diffusion="1e6 um^2/s", decay="1e3 /s", box=[["-30 um", "0 um"], '
          '["50 um", "30 um"]], spacing="2 um", start="5 + 0.1*x nM", walls={right="10 nM"}}',
          'exchange=[{field="c", cells=["Cell-1"], secretion="1e6 /um^2/s"}, {field="c", uptake="1e6 /um^2/s", '
          'half="5 nM"}]', 'cues=[{law="occupancy", field="c", affinity="10 nM"}]')


def busy(comm: MPI.Comm, **law: Any) -> tuple[DiffusingField, np.ndarray]:
    """A field with a flow, all kinds of walls, and a cell that secretes and takes up; and where its surface is."""
    x, edges = circle(5.0, 60)
    of_all = {"diffusion": D, "decay": 0.01 * S, "flow": (5.0 * S, 0.0), "box": ((-30.0, -20.0), (30.0, 20.0)),
              "spacing": 2.0, "start": 0.3, "walls": Walls(left=0.6, right="open", top=0.0)}
    exchanging = surface(edges, 5.0 * S, 20.0 * S, 3.0)
    return DiffusingField("c", Diffusing(**of_all | law), exchanging, 1, comm), x


def gone(run: DiffusingField, x: np.ndarray, first: int, last: int) -> DiffusingField:
    """The field after intervals of 10 s, in each of which the cell goes 1 µm; collective."""
    for k in range(first, last + 1):
        run.advance(10.0 * k / S, x + np.array([0.9 * k, 0.0]))
    return run


# ------------------------------------------------------------------------------------------------------ exact answers


@pytest.mark.serial
@pytest.mark.parametrize("name", QUICK)
def test_fields_converge_to_exact_solutions(name: str) -> None:
    """All of them, and how well, are in `cellmig verify`; these take less than four seconds each."""
    r = REFERENCES[name]
    found = [r.measure(at) for at in r.at]
    for error, expected in r.expected.items():
        verdict = judge(name, error, expected, found)
        assert not verdict.why, (error, verdict.errors, verdict.why)


# ------------------------------------------------------------------------------------------------- grids and surfaces


@pytest.mark.serial
@pytest.mark.parametrize("d", [2, 3])
def test_what_is_linear_is_read_exactly_and_shares_of_a_point_are_not_negative_and_add_up_to_one(d: int) -> None:
    grid = Grid(PETSc.COMM_SELF, ((-3.0,) * d, (4.0,) * d), (7, 5, 6)[:d])
    x = np.random.default_rng(1).uniform(-2.0, 3.0, (50, d))  # farther from walls than the centres next to them
    number, weight = grid.weights(x)
    assert (weight >= 0.0).all()
    assert np.allclose(weight.sum(axis=1), 1.0, atol=1e-15)
    slope = np.arange(1.0, d + 1.0)
    assert np.abs((weight * (grid.centres @ slope)[number]).sum(axis=1) - x @ slope).max() < 1e-13  # rounding: 4e-15
    grid.close()


@pytest.mark.serial
@pytest.mark.parametrize("d", [2, 3])
def test_no_flux_to_a_neighbour_grows_with_its_concentration(d: int) -> None:
    """The matrix is an M-matrix at any flow and walls: nothing off the diagonal is positive, and columns add up."""
    rng = np.random.default_rng(2)
    grid = Grid(PETSc.COMM_SELF, ((0.0,) * d, (6.0, 5.0, 4.0)[:d]), (6, 5, 4)[:d])
    for flow in (np.zeros(d), rng.normal(size=d), 1e4 * rng.normal(size=d)):
        walls = [(0.5, "open"), ("closed", 0.2), (0.1, "closed")][:d]
        matrix, leak, inflow, rows = grid.fluxes(0.7, flow, walls)
        A = matrix[:, :]
        off = A - np.diag(np.diag(A))
        assert (off <= 0.0).all()
        assert (leak >= 0.0).all() and (inflow >= 0.0).all()
        assert np.abs(A.sum(axis=0) - leak).max() < 1e-12 * np.abs(A).max()  # what leaves a volume arrives in another
        assert np.abs(A.sum(axis=1) - rows).max() < 1e-12 * np.abs(A).max()
        matrix.destroy()
    grid.close()


@pytest.mark.serial
def test_what_leaves_a_cell_arrives_wherever_its_surface_is() -> None:
    x, edges = circle(3.3, 17)
    for shift in np.random.default_rng(3).uniform(-10.0, 10.0, (5, 2)):
        run = field(surface(edges, 2.0 * S), diffusion=D, box=((-20.0, -20.0), (20.0, 20.0)), spacing=1.7)
        run.advance(0.0, x + shift)
        run.advance(1.0 / S, x + shift)
        length = np.linalg.norm(x[edges[:, 1]] - x[edges[:, 0]], axis=1).sum()
        assert run.molecules.secreted[0] == pytest.approx(2.0 * length, rel=1e-12)
        assert run.whole.sum() * run.transport.grid.volume == pytest.approx(2.0 * length, rel=1e-12)
        run.close()


@pytest.mark.serial
def test_a_cell_secretes_and_takes_up_by_the_length_that_it_has_now() -> None:
    x, edges = circle(3.0, 40)
    run = field(surface(edges, 2.0 * S), diffusion=D, box=((-20.0, -20.0), (20.0, 20.0)), spacing=2.0, step=0.1 / S)
    run.advance(0.0, x)
    before = run.molecules.secreted[0]
    run.advance(1.0 / S, 2.0 * x)
    # Lengths at the ends of ten steps: 1.1, 1.2 … 2 of that at the start, 1.55 on average.
    assert run.molecules.secreted[0] - before == pytest.approx(1.55 * 2.0 * 40 * np.linalg.norm(x[1] - x[0]), rel=1e-12)
    run.close()


# -------------------------------------------------------------------------------------------------- never negative


@pytest.mark.serial
@pytest.mark.parametrize("order", [1, 2])
def test_concentrations_are_never_negative_however_much_is_taken_up(order: int) -> None:
    """Uptake of a thousand times what is there, in steps of a thousand times h²/D."""
    x, edges = circle(5.0, 60)
    run = field(surface(edges, uptake=1e5 * S, half=1e-3), diffusion=D, box=((-20.0, -20.0), (20.0, 20.0)),
                spacing=1.0, start=1.0, step=10.0 / S, time_order=order)
    run.advance(0.0, x)
    for k in range(1, 6):
        run.advance(10.0 * k / S, x)
        assert run.whole.min() >= 0.0
        assert abs(run.molecules.lost) <= 1e-12 * run.molecules.turnover  # measured 3e-16
    assert run.molecules.taken[0] == pytest.approx(run.molecules.start, rel=0.1)
    run.close()


@pytest.mark.serial
@pytest.mark.parametrize("quasi_steady", [False, True])
def test_a_small_uptake_beside_a_high_concentration_is_accounted_for(quasi_steady: bool) -> None:
    """A sink of 1e-6 of what a wall could give, in 10 µM: what rounding of concentrations moves is more than 1e-12."""
    x, edges = circle(5.0, 60)
    run = field(surface(edges, uptake=0.1 * S, half=600.0), diffusion=D, box=((-30.0, -30.0), (30.0, 30.0)),
                spacing=2.0, start=6022.0, quasi_steady=quasi_steady,
                walls=dict.fromkeys(("left", "right", "bottom", "top"), 6022.0))
    for k in range(5):
        run.advance(k * 100.0 / S, x)
    account = run.molecules
    assert account.taken[0] == pytest.approx(400.0 * 0.1 * 60 * np.linalg.norm(x[1] - x[0]) * 6022 / 6622, rel=1e-4)
    # Measured: 1e-10 of what is taken up, 4e-14 of all molecules.
    assert abs(account.lost) <= (1e-9 * account.taken[0] if quasi_steady else 1e-12 * account.turnover)
    run.close()


@pytest.mark.serial
def test_a_step_of_second_order_that_would_be_negative_is_taken_with_first_order_and_counted() -> None:
    run = field(diffusion=D, box=((-20.0, -20.0), (20.0, 20.0)), spacing=1.0, start=share_inside(3.0, 1.0),
                step=1.0 / S, time_order=2)
    run.advance(0.0, nowhere(2))
    run.advance(3.0 / S, nowhere(2))
    assert run.lowered > 0
    assert run.whole.min() >= 0.0
    run.close()


@pytest.mark.serial
@pytest.mark.parametrize("dimension", [2, 3])
def test_standing_waves_solve_diffusion_between_walls_of_any_kind(dimension: int) -> None:
    """All combinations of walls that are closed and that have a concentration."""
    count, high = (7, 5, 4)[:dimension], (5.0, 3.0, 2.0)[:dimension]
    grid, left = Grid(MPI.COMM_SELF, [(0.0,) * dimension, high], count), np.random.default_rng(1).random(np.prod(count))
    for given in product(product([False, True], repeat=2), repeat=dimension):
        walls = [tuple(3.0 if one else "closed" for one in both) for both in given]
        matrix = grid.fluxes(0.7, (0.0,) * dimension, walls)[0]
        found = Waves(count, 0.7 * grid.volume / grid.size**2, given).solved(left, 0.3)
        x, y = matrix.createVecs()
        x.setArray(found)
        matrix.mult(x, y)
        assert np.abs(y.getArray() + 0.3 * found - left).max() < 1e-14  # measured 3e-15
        for thing in (matrix, x, y):
            thing.destroy()
    grid.close()


@pytest.mark.serial
def test_a_field_that_is_too_fast_for_steps_is_told_to_be_quasi_steady() -> None:
    fast = ('fields.c.diffusion="1e14 um^2/s"', "fields.c.quasi_steady=false")
    with pytest.raises(NumericsError, match=r"fields\.c\.quasi_steady = true is for such fields"):
        with built(case("all_protrude", *LIVING, *fast, per_cell=60)) as sim:
            sim.go(2.0)


# ------------------------------------------------------------------------------------------ ranks, checkpoints, time


def test_a_small_field_has_the_same_bits_on_any_ranks() -> None:
    together, x = busy(WORLD)
    alone, _ = busy(MPI.COMM_SELF)
    gone(together, x, 0, 3), gone(alone, x, 0, 3)
    assert together.time == alone.time
    if WORLD.rank == 0:
        assert np.array_equal(together.whole, alone.whole)
        assert together.molecules.saved() == alone.molecules.saved()
    together.close(), alone.close()


def test_a_large_field_is_on_all_ranks_and_the_same_to_the_tolerance_of_solvers(monkeypatch) -> None:
    small, x = busy(WORLD)
    monkeypatch.setattr(diffusing, "DIRECT", {2: 0, 3: 0})
    large, _ = busy(WORLD)
    assert large.transport.grid.own.size < large.transport.grid.total or WORLD.size == 1
    gone(small, x, 0, 3), gone(large, x, 0, 3)
    if WORLD.rank == 0:
        assert np.abs(small.whole - large.whole).max() < 1e-9 * small.whole.max()  # measured 3e-13
        assert abs(large.molecules.lost) <= 1e-12 * large.molecules.turnover
    small.close(), large.close()


@pytest.mark.parametrize("large", [False, True])
def test_a_field_that_is_saved_goes_on(large: bool, monkeypatch) -> None:
    """With the same bits if it is small; multigrid begins anew."""
    if large:
        monkeypatch.setattr(diffusing, "DIRECT", {2: 0, 3: 0})
    once, x = busy(WORLD)
    twice, _ = busy(WORLD)
    again, _ = busy(WORLD)
    gone(once, x, 0, 5)
    again.restore(*gone(twice, x, 0, 2).saved())
    gone(again, x, 3, 5)
    if WORLD.rank == 0:
        assert np.abs(again.whole - once.whole).max() <= (1e-9 * once.whole.max() if large else 0.0)
        assert again.molecules.taken == pytest.approx(once.molecules.taken, rel=1e-9 if large else 0.0)
    for run in (once, twice, again):
        run.close()


@pytest.mark.serial
def test_steps_grow_until_a_steady_state_takes_one_for_each_interval() -> None:
    run, x = busy(MPI.COMM_SELF, flow=(0.0, 0.0), walls=Walls(left=0.6))
    for k in range(40):
        before = run.steps
        run.advance(30.0 * k / S, x)
    assert run.steps - before == 1
    steady, _ = busy(MPI.COMM_SELF, flow=(0.0, 0.0), walls=Walls(left=0.6), quasi_steady=True)
    steady.advance(0.0, x)
    assert np.abs(run.whole / steady.whole - 1.0).max() < 1e-3  # measured 2e-5
    run.close(), steady.close()


def test_a_cell_that_leaves_the_box_is_told_on_all_ranks() -> None:
    run, x = busy(WORLD)
    run.advance(0.0, x)
    with pytest.raises(NumericsError, match="cell 1, which exchanges with the field c, has left its box at x = 3"):
        run.advance(10.0 / S, x + np.array([28.0, 0.0]))
    run.close()


# -------------------------------------------------------------------------------------------------------- in a scene


def living(*sets: str) -> Case:
    """Three cells that follow a field which one of them secretes and all of them take up."""
    return case("all_protrude", *LIVING, *sets)


def test_cells_and_their_field_come_to_the_same_bits_on_any_ranks() -> None:
    runs = []
    for comm in {WORLD.size: WORLD, 1: MPI.COMM_SELF}.values():
        with built(living(), comm) as sim:
            sim.go(1.0)
            sampled = sim.fields.rows() if comm.rank == 0 else None
            runs.append((sim.state_hash(), sim.guidance.p.tolist(), comm.bcast(str(sampled))))
    assert runs == runs[:1] * len(runs)
    assert WORLD.bcast(runs[0]) == runs[0]


def test_a_scene_that_is_saved_between_knots_goes_on_with_the_same_bits() -> None:
    with built(living()) as once, built(living()) as before, built(living()) as after:
        once.go(1.0)
        before.go(0.45)
        after.restore(*before.saved())
        after.go(1.0)
        assert after.state_hash() == once.state_hash()
        assert after.guidance.p.tolist() == once.guidance.p.tolist()
        if WORLD.rank == 0:
            assert str(after.fields.rows()) == str(once.fields.rows())


def test_in_space_molecules_are_accounted_for_on_any_ranks() -> None:
    box = '[["-30 um", "-20 um", "0 um"], ["40 um", "20 um", "20 um"]]'
    scene = case("three_balls", 'polarity.persistence="2 us"', *[s.replace(
        '[["-30 um", "0 um"], ["50 um", "30 um"]]', box) for s in LIVING[1:]])
    with built(scene) as sim:
        sim.go(0.2)
        account = sim.fields.diffusing["c"].molecules
        if WORLD.rank == 0:
            assert account.secreted[0] > 0.0 and (account.taken > 0.0).all()
            assert abs(account.lost) <= 1e-12 * account.turnover
            assert sim.fields.grids()["c"].count == [35, 20, 10]


def test_molecules_and_values_are_written_beside_the_cells(shared_tmp) -> None:
    import h5py

    run = Run(living("time.end=\"1 us\"", "time.samples=4", "time.frames=2"), shared_tmp / "run", WORLD, quiet=True)
    assert run.go() == 0
    run.simulation.destroy()
    table = read_table(shared_tmp / "run" / "molecules.csv")
    assert len(table["field"]) == 5 * 4  # samples times all cells and each
    of_all = table["cell"] == 0
    assert np.abs(table["lost_per_um"][of_all]).max() <= 1e-12 * table["inside_per_um"][of_all].max()
    assert table["taken_up_per_um"][-3:].sum() == pytest.approx(table["taken_up_per_um"][-4])
    assert (table["secreted_per_um"][-3:] > 0.0).tolist() == [True, False, False]
    with h5py.File(shared_tmp / "run" / "fields" / "s00000002.h5", "r") as file:
        assert file["c"].shape == (15, 40)
        assert file["c"].attrs["unit"] == "nM"
        assert 0.0 < file["c"][0, 0] < file["c"][-1, -1] < 11.0
    assert (shared_tmp / "run" / "fields.xdmf").read_text().count('Name="c" GridType="Uniform"') == 3


@pytest.mark.serial
@pytest.mark.parametrize(("sets", "message"), [
    (['exchange=[{field="d", secretion="1 /um^2/s"}]'], "no field 'd'"),
    (['exchange=[{field="given", secretion="1 /um^2/s"}]'], "whose law is \"diffusing\""),
    (['exchange=[{field="c"}]'], "expects secretion or uptake"),
    (['exchange=[{field="c", uptake="1 /um^2/s"}]'], "uptake and half belong together"),
    (['fields.c.box=[["-30 um", "0 um"], ["10 um", "30 um"]]'], "does not contain 'Cell-"),
    (['fields.c.walls={right="open"}'], "is for a flow through the wall"),
    (['fields.c.walls={front="open"}'], "in three dimensions only"),
    (['fields.c.walls={right="ajar"}'], "'closed' or 'open'"),
    (['fields.c.quasi_steady=true', 'fields.c.decay="0 /s"', "fields.c.walls={}"], "there is no equilibrium"),
    (['fields.c.box=[["50 um", "0 um"], ["-30 um", "30 um"]]'], "two opposite corners, the lower first"),
    (['substrate.stiffness="c"'], "expects a field in a unit such as Pa"),
    (['fields.c.start="x nM"'], "in the box: an amount is finite and at least 0"),
])
def test_what_makes_no_sense_is_refused_with_what_would_be_right(sets: list[str], message: str) -> None:
    with pytest.raises(CaseError) as refused:
        living('fields.given={formula="5 nM"}', *sets)
    assert message in str(refused.value)


@pytest.mark.serial
def test_exchange_is_found_by_the_names_of_cells_and_on_the_outer_surface_alone() -> None:
    surfaces = SimpleNamespace(cell=np.array([0, 0, 1, 1]), facets=np.array([[0, 1], [1, 0], [2, 3], [3, 2]]),
                               outer=np.array([True, False, True, True]))
    both = SimpleNamespace(cells=(), secretion=2.0, uptake=0.0, half=None)
    one = SimpleNamespace(cells=("B",), secretion=0.0, uptake=3.0, half=4.0)
    found = Exchanging.of(surfaces, ["A", "B"], [both, one])
    assert found.cell.tolist() == [0, 1, 1, 1, 1]
    assert found.secretion.tolist() == [2.0, 2.0, 2.0, 0.0, 0.0]
    assert found.uptake.tolist() == [0.0, 0.0, 0.0, 3.0, 3.0]
