"""Ranks: sums, random numbers, partition and particles that do not depend on them; one run, the same bits."""

from __future__ import annotations

import ctypes
import math
import os
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scenes import NETWORK, built, case
from scipy.sparse import csr_array

from mpi4py import MPI

from cellmig.case.messages import CaseError, Mistake
from cellmig.case.registry import laws
from cellmig.case.schema import Case
from cellmig.geometry import polygons
from cellmig.meshfree.contact import ContactLists, Surfaces, acting, contact_pairs
from cellmig.meshfree.scene import Scene
from cellmig.parallel import shared
from cellmig.parallel.collect import computed_on_root
from cellmig.parallel.ghosts import GhostedField
from cellmig.parallel.owners import Owners
from cellmig.parallel.partition import BALANCE, bisection, partition
from cellmig.parallel.random import uniform
from cellmig.parallel.reduce import exact_sum, global_maximum
from cellmig.parallel.swarm import Swarm
from cellmig.solve.accounts import ACCOUNTS
from cellmig.solve.start import discretise
from cellmig.solve.surface_exchange import SurfacePlaces

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
    assert global_maximum(comm, values).tolist() == [comm.size - 1.0, 0.0, np.inf]


# --------------------------------------------------------------------------------------------- partition, randomness


@pytest.mark.serial
@pytest.mark.parametrize("ranks", [1, 2, 3, 4, 7, 13])
@pytest.mark.parametrize("n", [0, 5, 1000, 1001])
def test_parts_are_equal_to_one_particle_and_always_the_same(ranks: int, n: int) -> None:
    X = np.random.default_rng(n).uniform(0, 1, (n, 2)) * [3.0, 1.0]
    owner = bisection(X, ranks)
    sizes = np.bincount(owner, minlength=ranks)
    assert sizes.sum() == n and len(sizes) == ranks
    assert np.ptp(sizes) <= 1
    assert np.array_equal(owner, bisection(X.copy(), ranks))


@pytest.mark.serial
def test_parts_are_cut_across_the_longer_side() -> None:
    X = np.random.default_rng(0).uniform(0, 1, (1000, 2)) * [3.0, 1.0]
    owner = bisection(X, 3)
    assert X[owner == 0, 0].max() <= X[owner > 0, 0].min()


def alone_rows(n: int) -> csr_array:
    """Fifteen entries in each of n rows, that need no others."""
    at = np.repeat(np.arange(n), 15)
    return csr_array((np.ones(15 * n), at, 15 * np.arange(n + 1)), shape=(n, n))


def scene_of(sizes: np.ndarray, seed: int = 1) -> Scene:
    """Cells in rows of eight, each of its own kind, a seventh of their particles of the nucleus, by height."""
    rng, kinds = np.random.default_rng(seed), []
    for n in sizes.tolist():
        X, nucleus = rng.uniform(0, 1, (n, 2)), np.arange(n) < n // 7
        kinds.append(SimpleNamespace(X=X[np.lexsort((X[:, 1], ~nucleus))], nucleus=nucleus,
                                     surface=np.arange(round(4 * math.sqrt(n))), G=[alone_rows(n)]))
    cell = np.arange(len(sizes))
    return Scene(kinds, cell, 2.0 * np.column_stack([cell % 8, cell // 8]), [], [(0, 1)] * len(sizes))


def whole(scene: Scene, ranks: int) -> tuple[Owners, np.ndarray, np.ndarray]:
    """Owners of all particles, as what stores them and one by one, and the cost of each rank over the mean."""
    owners = partition(scene, ranks)
    owner, cost = owners.of(np.arange(scene.size)), np.zeros(ranks)
    for cell, t in enumerate(scene.templates):
        cost += np.bincount(owner[scene.cell == cell], minlength=ranks) / len(t.X) * t.G[0].nnz
    assert owners.load == pytest.approx(cost / cost.mean(), abs=0.02)  # cells are cut at whole particles
    return owners, owner, cost / cost.mean()


@pytest.mark.serial
def test_cells_stay_whole_where_the_ranks_then_have_as_much_to_do() -> None:
    scene = scene_of(np.random.default_rng(1).integers(90, 110, 40))
    _, owner, cost = whole(scene, 4)
    assert all(np.ptp(owner[scene.cell == c]) == 0 for c in range(40))
    assert cost.max() <= 1.0 + BALANCE


@pytest.mark.serial
@pytest.mark.parametrize("ranks", [2, 3, 5, 7, 12])
def test_of_many_cells_of_mixed_sizes_few_are_divided(ranks: int) -> None:
    scene = scene_of(np.random.default_rng(ranks).integers(50, 1000, 40))
    _, owner, cost = whole(scene, ranks)
    assert cost.max() <= 1.05  # measured 1.003 to 1.027
    shared = [len(np.unique(owner[scene.cell == c])) for c in range(40)]
    assert sum(n > 1 for n in shared) < ranks and max(shared) <= 3


@pytest.mark.serial
@pytest.mark.parametrize(("ranks", "team"), [(2, 2), (4, 4), (6, 2), (8, 8)])
def test_else_teams_of_ranks_share_whole_cells_cut_alike(ranks: int, team: int) -> None:
    scene = scene_of(np.full(3, 7 * 2100))
    _, owner, cost = whole(scene, ranks)
    assert np.ptp(cost) <= 0.001
    for c in range(3):
        own, nucleus = owner[scene.cell == c], scene.templates[c].nucleus
        assert len(np.unique(own)) == team
        assert np.array_equal(own % team, owner[scene.cell == 0] % team)  # the same slice of every cell
        assert all((np.diff(own[nucleus == part]) >= 0).all() for part in (True, False))  # slices, by height


@pytest.mark.serial
def test_cells_are_cut_in_space_where_slices_would_be_thin() -> None:
    scene = scene_of(np.full(3, 400))
    _, owner, _ = whole(scene, 2)
    assert np.ptp(np.bincount(owner)) <= 1
    assert scene.X[owner == 0, 0].max() <= scene.X[owner == 1, 0].min()


@pytest.mark.serial
@pytest.mark.parametrize(("count", "size", "ranks"), [(40, 100, 4), (40, 700, 7), (3, 14700, 4), (3, 400, 2)])
def test_each_rank_finds_its_particles_and_every_cell_has_one_head(count: int, size: int, ranks: int) -> None:
    scene = scene_of(np.random.default_rng(3).integers(size // 2, size, count) if ranks == 7 else np.full(count, size))
    owners, owner, _ = whole(scene, ranks)
    for rank in range(ranks):
        ids = owners.ids(rank)
        assert np.array_equal(ids, np.flatnonzero(owner == rank))
        assert np.array_equal(owners.cells(rank), np.unique(scene.cell[ids]))
    assert sorted(np.concatenate([owners.heads(rank) for rank in range(ranks)]).tolist()) == list(range(count))


@pytest.mark.parametrize("full", [False, True])
def test_a_large_result_is_in_the_memory_of_a_machine_once(comm: MPI.Comm, full: bool, monkeypatch) -> None:
    if full:
        monkeypatch.setattr("cellmig.parallel.collect.SHARED", "/nowhere")
    shapes = [(200_000,), (3, 50_000), (0, 2), (7,)]
    found = computed_on_root(comm, lambda: [np.arange(float(math.prod(s))).reshape(s) + comm.rank for s in shapes])
    for values, shape in zip(found, shapes, strict=True):
        assert np.array_equal(values, np.arange(math.prod(shape)).reshape(shape))
        assert values.flags.writeable is (comm.size == 1)
        assert values.ctypes.data % 64 == 0 or comm.size == 1 or full
    comm.Barrier()
    assert not [path for path in Path("/dev/shm").glob("cellmig-*") if path.stat().st_uid == os.getuid()]


def test_random_numbers_belong_to_seed_purpose_and_name(comm: MPI.Comm) -> None:
    a = uniform(1, "protrusion", "A", 100)
    assert np.array_equal(a, uniform(1, "protrusion", "A", 100))
    assert np.array_equal(a[:10], uniform(1, "protrusion", "A", 10))
    for other in ((2, "protrusion", "A"), (1, "noise", "A"), (1, "protrusion", "B")):
        assert np.abs(np.corrcoef(a, uniform(*other, 100))[0, 1]) < 0.35
    assert 0.0 <= a.min() and a.max() < 1.0
    assert uniform(1, "protrusion", "A", 100000).mean() == pytest.approx(0.5, abs=0.004)  # 4 standard deviations
    assert all(np.array_equal(a, b) for b in comm.allgather(a))


# ------------------------------------------------------------------------------------- decisions, swarm and ghosts


def test_what_rank_0_decides_is_the_same_bits_everywhere(comm: MPI.Comm) -> None:
    law = laws("shape")["disc"](radius=3.0)
    value = computed_on_root(comm, lambda: {"a": np.arange(10.0) + comm.rank, "law": law, "empty": np.zeros((0, 2)),
                                            "turned": np.ones((3, 4)).T * comm.rank})
    assert np.array_equal(value["a"], np.arange(10.0)) and value["law"] == law and value["empty"].shape == (0, 2)
    assert not value["turned"].any()
    value["a"] += 1.0  # it is this rank's own


def test_what_fails_on_rank_0_fails_everywhere(comm: MPI.Comm) -> None:
    def fail() -> None:
        raise CaseError([Mistake("case.toml", None, "particles", f"rank {comm.rank}")])

    with pytest.raises(CaseError, match=r"case\.toml: particles: rank 0"):
        computed_on_root(comm, fail)


def test_particles_take_all_their_fields_to_their_owner(comm: MPI.Comm) -> None:
    n = 101
    rng = np.random.default_rng(3)
    widths = {"X": 2, "u": 2, "v": 2, "director": 1, "loss": len(ACCOUNTS)}
    whole = {name: rng.standard_normal((n, width)) if width > 1 else rng.standard_normal(n)
             for name, width in widths.items()} | {"id": np.arange(n)}
    mine = rng.integers(0, comm.size, n) == comm.rank
    owner = rng.integers(0, comm.size, n)
    swarm = Swarm(comm, {name: values[mine] for name, values in whole.items()})
    for target in (owner, (owner + 1) % comm.size, np.zeros(n, int)):
        swarm.migrate(target[swarm["id"]])
        assert np.array_equal(swarm["id"], np.flatnonzero(target == comm.rank))
        for name, values in whole.items():
            assert np.array_equal(swarm[name], values[target == comm.rank]), name
    swarm.destroy()


WAYS = pytest.mark.parametrize("near", [True, False], ids=["shared memory", "messages"])


@WAYS
def test_ghosts_have_their_owners_values_after_an_exchange(comm: MPI.Comm, near: bool, monkeypatch) -> None:
    monkeypatch.setattr(shared, "on_one_machine", lambda ranks: near and ranks.size > 1)
    n = 40  # particles of each rank, with the neighbours' first and last as ghosts
    around = sorted({(comm.rank - 1) % comm.size, (comm.rank + 1) % comm.size} - {comm.rank})
    memory = np.full((n * comm.size + 3, 4), -1.0)
    field = GhostedField(comm, memory, n, n)
    begin, end = (ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_int, ctypes.c_int)(f)
                  for f in field.exchange_functions)
    for turn in range(12):
        if turn % 4 == 0:  # other copies are asked for, in the end some of this rank alone
            which = ((0, n - 1), range(n), (3,) if comm.rank == 0 else ())[turn // 4]
            ghosts = np.array([r * n + i for r in around for i in which], int)
            memory[n:] = -1.0
            field.set_ghosts(ghosts)
        field.owned[:] = (comm.rank * n + np.arange(n))[:, None] + 0.1 * np.arange(4) + 1e3 * turn
        if turn % 4 == 3:
            field.exchange()
        else:
            assert begin(field.handle, 1, 0) == 0
            field.owned[:] += 0.5  # what is on its way is what it was
            assert end(field.handle, 1, 0) == 0
        assert np.array_equal(field.array[n:], ghosts[:, None] + 0.1 * np.arange(4) + 1e3 * turn)
        assert (memory[n + len(ghosts):] == -1.0).all()
    field.destroy()


@pytest.mark.parametrize("seed", range(3))
def test_a_rank_knows_where_surfaces_near_its_own_are_and_lists_all_their_contacts(comm: MPI.Comm, seed: int) -> None:
    grid = 'cells.0.pitch=[["10.01 um", "0 um"], ["0 um", "10.01 um"]]'
    rng, scene = np.random.default_rng(seed), discretise(case("paper", "cells.0.repeat=[4, 3]", grid))
    everything = Surfaces.of(scene)
    x = scene.X[everything.ids] + rng.uniform(-0.3, 0.3, (len(everything.ids), 2))
    free = rng.integers(0, comm.size, np.diff(scene.offset)[5])
    owners = replace(partition(scene, comm.size), free={5: free})
    own = owners.of(everything.ids) == comm.rank
    surfaces = Surfaces.of(scene, owners.cells(comm.rank))
    mine = np.flatnonzero(owners.of(surfaces.ids) == comm.rank)
    places = SurfacePlaces(comm, scene, owners, surfaces, mine)
    found = places.everywhere(x[own])
    assert found is None if comm.rank else np.array_equal(found, x)
    near, known = places.near(x[own], 0.8)
    assert np.array_equal(known, x[near.place]) and set(surfaces.cells) <= set(near.cells)

    def within(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.where(a == b, 0.3, 0.8)

    pairs = [near.place[acting(near, contact_pairs(near, known, 0.8, within, near.turn), own[near.place])],
             acting(everything, contact_pairs(everything, x, 0.8, within, everything.turn), own)]
    assert len(pairs[0]) > 20
    assert np.array_equal(*pairs)


@pytest.mark.serial
def test_contact_lists_have_a_node_for_each_particle_and_cell_that_it_is_near() -> None:
    grid = 'cells.0.pitch=[["10.01 um", "0 um"], ["0 um", "10.01 um"]]'
    scene = discretise(case("paper", "cells.0.repeat=[2, 2]", grid))
    surfaces = Surfaces.of(scene)
    pairs = contact_pairs(surfaces, scene.X[surfaces.ids], 0.8, lambda a, b: np.where(a == b, -1.0, 0.8),
                          surfaces.turn)
    assert (surfaces.cell[pairs[:, 0]] != surfaces.cell[pairs[:, 1]]).all()
    lists = ContactLists.of(surfaces, pairs)
    of_pair = np.repeat(np.arange(len(lists.source)), np.diff(lists.first))
    source, edge = lists.node[lists.segment[of_pair, 0]], lists.node[lists.edge[:, 0]]
    assert np.array_equal(np.column_stack([source, edge]), pairs)
    for nodes in (lists.segment, lists.edge[:, :2], lists.edge[:, 1:]):
        assert np.array_equal(surfaces.after[lists.node[nodes[:, 0]]], lists.node[nodes[:, 1]])
    assert np.array_equal(lists.other[lists.edge[:, 0]], surfaces.cell[source])
    assert np.array_equal(lists.other[lists.segment[of_pair, 0]], surfaces.cell[edge])


# ------------------------------------------------------------------------------------------------------- same bits

RUNS: dict[str, Callable[[], Case]] = {
    "three cells": lambda: case("all_protrude"),
    "two cells": lambda: case("paper", "cells.0.repeat=[2]", 'protrusion.cells=["Cell-2"]', per_cell=93),
    "nucleus": lambda: case("nucleus", per_cell=151),
    "not stiffened": lambda: case("nucleus", "materials.nucleus.hourglass_modulus=0.0"),
    "relaxing director": lambda: case("director_radial"),
    "frozen director": lambda: case("one_cell", 'materials.cytoplasm.eta="200 pN"', 'director.law="frozen"',
                                    'director.start="radial"'),
    "three active cells under a body force": lambda: case("all_protrude", 'materials.cytoplasm.zeta="-300 Pa"',
                                              'body_force.acceleration=["1e5 m/s^2", "-2e5 m/s^2"]'),
    "three cells with a network": lambda: case("all_protrude", *NETWORK),
    "three cells with a stiff cortex": lambda: case("all_protrude", 'cortex.law="elastic"',
                                                    'cortex.line_tension="1 pN/um"', 'cortex.area_modulus="1e6 pN/um"'),
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


def same_as_alone(comm: MPI.Comm, name: str) -> bool:
    """Whether a run has the bits that it has on one rank."""
    hashes = []
    for ranks in (MPI.COMM_SELF, comm):
        with built(RUNS[name](), ranks) as sim:
            sim.go(AS_LONG)
            hashes.append(sim.state_hash())
    return hashes[0] == hashes[1]


@pytest.mark.parametrize("name", ["three cells", "relaxing director"])
def test_it_has_them_when_copies_are_sent_in_messages(comm: MPI.Comm, name: str, monkeypatch) -> None:
    monkeypatch.setattr(shared, "on_one_machine", lambda ranks: False)
    assert same_as_alone(comm, name)


@pytest.mark.parametrize("name", ["two cells", "frozen director"])
def test_it_has_them_when_every_rank_has_a_slice_of_all_cells(comm: MPI.Comm, name: str, monkeypatch) -> None:
    monkeypatch.setattr("cellmig.parallel.partition.THICK", 2.0)
    assert same_as_alone(comm, name)


@pytest.mark.parametrize("name", ["all_protrude", "director_radial"])
def test_ranks_whose_sines_differ_run_the_same_run(comm: MPI.Comm, name: str, monkeypatch) -> None:
    found = case(name, 'time.end="0.5 us"', per_cell=60)
    with built(found, MPI.COMM_SELF) as sim:
        sim.go(0.2)
        expected = comm.bcast(sim.state_hash())
    plain = polygons.circle
    if comm.rank > 0:  # as if its processor were unlike that of rank 0, and worse
        monkeypatch.setattr(polygons, "circle", lambda n: plain(n) * (1.0 + 1e-7))
    with built(found) as sim:
        sim.go(0.2)
        assert sim.state_hash() == expected


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
        assert np.array_equal(sim.swarm["director"], m.director.values[at, 0])
        assert np.array_equal(sim.swarm["loss"][:, 0], m.kernel["viscous_loss"][at])
