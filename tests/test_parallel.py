"""Ranks: sums, random numbers, partition and particles that do not depend on them; one run, the same bits."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from scenes import built, case

from mpi4py import MPI

from cellmig.case.schema import Case
from cellmig.parallel.ghosts import GhostedField
from cellmig.parallel.partition import BALANCE, bisection, partition
from cellmig.parallel.random import uniform
from cellmig.parallel.reduce import exact_sum, extreme
from cellmig.parallel.swarm import FIELDS, Swarm

# ----------------------------------------------------------------------------------------------------------- sums


def numbers(n: int, seed: int) -> np.ndarray:
    """Random numbers of both signs over eighty powers of two, which nearly cancel."""
    rng = np.random.default_rng(seed)
    a = rng.standard_normal(n) * 2.0 ** rng.integers(-70, 10, n)
    return np.concatenate([a, -a[::-1] * (1 + 1e-12)])


def share(comm: MPI.Comm, values: np.ndarray, seed: int) -> np.ndarray:
    """This rank's part of values dealt out at random."""
    rng = np.random.default_rng(seed)
    return rng.permutation(values)[rng.integers(0, comm.size, len(values)) == comm.rank]


@pytest.mark.parametrize("seed", range(5))
def test_sum_depends_neither_on_order_nor_on_partition(comm: MPI.Comm, seed: int) -> None:
    values = numbers(3000, seed)
    sums = {float(exact_sum(comm, share(comm, values, s))) for s in range(8)}
    sums.add(float(exact_sum(MPI.COMM_SELF, values)))
    assert len(sums) == 1
    # 90 bits below the largest value, for a sum that is 1e-12 of its parts; measured 3e-14
    assert sums.pop() == pytest.approx(math.fsum(values), rel=2e-13)


def test_sum_of_columns_and_groups_is_that_of_each(comm: MPI.Comm) -> None:
    rng = np.random.default_rng(1)
    values, group = rng.standard_normal((500, 3)) * [1.0, 1e9, 1e-9], rng.integers(0, 4, 500)
    mine = rng.integers(0, comm.size, 500) == comm.rank
    found = exact_sum(comm, values[mine], group[mine], 5)
    expected = [[math.fsum(values[group == g, c]) for c in range(3)] for g in range(5)]
    assert found.shape == (5, 3)
    assert np.allclose(found, expected, rtol=1e-14, atol=0.0)
    assert not found[4].any()
    assert np.allclose(exact_sum(comm, values[mine]), [math.fsum(c) for c in values.T], rtol=1e-14, atol=0.0)


def test_sum_says_when_a_value_is_not_finite(comm: MPI.Comm) -> None:
    values = np.array([1.0, np.nan if comm.rank == comm.size - 1 else 2.0])
    assert math.isnan(exact_sum(comm, values))
    assert exact_sum(comm, np.zeros(0)) == 0.0
    assert exact_sum(comm, np.array([0.0, -0.0])) == 0.0


def test_extreme_is_the_largest_and_infinite_for_nan(comm: MPI.Comm) -> None:
    values = np.array([float(comm.rank), -float(comm.rank), np.nan if comm.rank == 0 else 0.0])
    assert extreme(comm, values).tolist() == [comm.size - 1.0, 0.0, np.inf]


# --------------------------------------------------------------------------------------------- partition, randomness


@pytest.mark.parametrize("ranks", [1, 2, 3, 4, 7, 13])
@pytest.mark.parametrize("n", [0, 5, 1000, 1001])
def test_parts_are_equal_to_one_particle_and_always_the_same(ranks: int, n: int) -> None:
    X = np.random.default_rng(n).uniform(0, 1, (n, 2)) * [3.0, 1.0]
    owner = bisection(X, ranks)
    sizes = np.bincount(owner, minlength=ranks)
    assert sizes.sum() == n and len(sizes) == ranks
    assert np.ptp(sizes) <= 1
    assert np.array_equal(owner, bisection(X.copy(), ranks))


def test_parts_are_cut_across_the_longer_side() -> None:
    X = np.random.default_rng(0).uniform(0, 1, (1000, 2)) * [3.0, 1.0]
    owner = bisection(X, 3)
    assert X[owner == 0, 0].max() <= X[owner > 0, 0].min()


def test_cells_stay_whole_where_the_ranks_are_then_as_full() -> None:
    rng = np.random.default_rng(1)
    cell = np.repeat(np.arange(40), rng.integers(90, 110, 40))
    X = rng.uniform(0, 1, (len(cell), 2)) + np.column_stack([2.0 * (cell % 8), 2.0 * (cell // 8)])
    owner = partition(X, cell, 4)
    assert all(np.ptp(owner[cell == c]) == 0 for c in range(40))
    assert np.bincount(owner).max() <= (1.0 + BALANCE) * len(X) / 4
    few = cell < 3  # three cells on two ranks: one of them is cut
    owner = partition(X[few], cell[few], 2)
    assert np.ptp(np.bincount(owner)) <= 1


def test_random_numbers_belong_to_seed_purpose_and_cell(comm: MPI.Comm) -> None:
    a = uniform(1, "protrusion", 0, 100)
    assert np.array_equal(a, uniform(1, "protrusion", 0, 100))
    assert np.array_equal(a[:10], uniform(1, "protrusion", 0, 10))
    for other in ((2, "protrusion", 0), (1, "noise", 0), (1, "protrusion", 1)):
        assert np.abs(np.corrcoef(a, uniform(*other, 100))[0, 1]) < 0.35
    assert 0.0 <= a.min() and a.max() < 1.0
    assert uniform(1, "protrusion", 0, 100000).mean() == pytest.approx(0.5, abs=0.004)  # 4 standard deviations
    assert all(np.array_equal(a, b) for b in comm.allgather(a))


# ------------------------------------------------------------------------------------------------ swarm and ghosts


def test_particles_take_all_their_fields_to_their_owner(comm: MPI.Comm) -> None:
    n = 101
    rng = np.random.default_rng(3)
    whole = {name: rng.standard_normal((n, width)) if width > 1 else rng.standard_normal(n)
             for name, (width, _) in FIELDS.items()} | {"id": np.arange(n)}
    mine = rng.integers(0, comm.size, n) == comm.rank
    owner = rng.integers(0, comm.size, n)
    swarm = Swarm(comm, {name: values[mine] for name, values in whole.items()})
    for target in (owner, (owner + 1) % comm.size, np.zeros(n, int)):
        swarm.migrate(target[swarm["id"]])
        assert np.array_equal(swarm["id"], np.flatnonzero(target == comm.rank))
        for name, values in whole.items():
            assert np.array_equal(swarm[name], values[target == comm.rank]), name
    swarm.destroy()


def test_ghosts_have_their_owners_values_after_an_exchange(comm: MPI.Comm) -> None:
    n = 4  # particles of each rank, with the neighbours' first and last as ghosts
    around = sorted({(comm.rank - 1) % comm.size, (comm.rank + 1) % comm.size} - {comm.rank})
    ghosts = np.array([r * n + i for r in around for i in (0, n - 1)], int)
    memory = np.full((n + len(ghosts) + 3, 2), -1.0)
    field = GhostedField(comm, memory, n, ghosts)
    for turn in range(2):
        field.owned[:] = np.column_stack([comm.rank * n + np.arange(n), np.full(n, turn)])
        field.exchange()
        assert np.array_equal(field.array[n:, 0], ghosts.astype(float))
        assert (field.array[n:, 1] == turn).all()
        assert (memory[n + len(ghosts):] == -1.0).all()
    field.destroy()


# ------------------------------------------------------------------------------------------------------- same bits

RUNS: dict[str, Callable[[], Case]] = {
    "three cells": lambda: case("all_protrude"),
    "two cells": lambda: case("paper", "cells.0.repeat=[2]", 'protrusion.cells=["Cell-2"]', per_cell=93),
    "nucleus": lambda: case("nucleus", per_cell=151),
    "not stiffened": lambda: case("nucleus", "materials.nucleus.stiffening=0.0"),
    "relaxing director": lambda: case("director_radial"),
    "frozen director": lambda: case("one_cell", 'materials.cytoplasm.eta="200 pN"', 'director.law="frozen"',
                                    'director.start="radial"'),
    "three active cells under a body force": lambda: case("all_protrude", 'materials.cytoplasm.zeta="-300 Pa"',
                                              'body_force.acceleration=["1e5 m/s^2", "-2e5 m/s^2"]'),
    "a cell from a mesh": lambda: case("mesh"),
    "rk": lambda: case("paper", "cells.0.repeat=[2]", 'time.integrator="rk"', 'time.step="1 ns"'),
}
AS_LONG = 0.2  # µs


def result(name: str, comm: MPI.Comm, prune: bool) -> tuple:
    """Bits, history and ledger of a run, and the cells that each rank has a part of."""
    with built(RUNS[name](), comm, prune) as sim:
        start = sim.state_hash()
        sim.sample()
        assert sim.go(AS_LONG) == AS_LONG
        assert sim.integrator.steps > 20
        hashed = sim.state_hash()
        assert hashed != start
        history, ledger = sim.sample()
        return hashed, history, ledger, comm.allgather(set(sim.scene.cell[sim.mechanics.ids].tolist()))


@cache
def alone(name: str) -> list:
    """The same on one rank, of what the scene needs."""
    return list(result(name, MPI.COMM_SELF, True)[:3])


@pytest.mark.parametrize("prune", [True, False])
@pytest.mark.parametrize("name", RUNS)
def test_a_run_has_the_same_bits_on_any_number_of_ranks(comm: MPI.Comm, name: str, prune: bool) -> None:
    *together, parts = result(name, comm, prune)
    cells = len(set.union(*parts))
    assert cells % comm.size == 0 or sum(map(len, parts)) > cells  # cells are cut, unless each rank gets whole ones
    assert together[0] == alone(name)[0]
    if prune:  # without pruning, terms that are zero are summed, too
        assert together[1:] == alone(name)[1:]
    assert len(set(comm.allgather(together[0]))) == 1


@pytest.mark.parametrize("name", ["paper", "director_radial"])
def test_looking_at_a_run_changes_its_last_bits_only(name: str) -> None:
    def end(looks: int) -> np.ndarray:
        with built(case(name, 'time.step="2 ns"')) as sim:
            for i in range(looks):
                sim.go(AS_LONG * (i + 1) / looks)
                sim.sample()
            return sim.mechanics.state.owned.copy()

    once, often = end(1), end(4)
    assert np.abs(once).max() > 0.0
    assert np.abs(often - once).max() < 1e-9 * np.abs(once).max()  # measured 1e-12: F is made anew at every look


def test_the_swarm_holds_the_particles_as_they_were_looked_at(comm: MPI.Comm) -> None:
    with built(case("director_radial", per_cell=90), comm) as sim:
        sim.go(0.1)
        sim.sample()
        m, at = sim.mechanics, np.argsort(sim.mechanics.ids)
        assert np.array_equal(sim.swarm["id"], m.ids[at]) and np.array_equal(sim.swarm["X"], sim.scene.X[m.ids[at]])
        assert np.array_equal(np.hstack([sim.swarm["u"], sim.swarm["v"]]), m.state.owned[at])
        assert np.array_equal(sim.swarm["theta"], m.theta.owned[at, 0])
        assert np.array_equal(sim.swarm["loss"][:, 0], m.kernel["viscous_loss"][at])
