"""Checkpoint files: whole or absent, two of them, and damage is seen."""

from __future__ import annotations

import resource

import h5py
import numpy as np
import pytest

from mpi4py import MPI

from cellmig.output import checkpoint
from cellmig.output.checkpoint import Checkpoint, newest, write
from cellmig.output.directory import OutputError
from cellmig.parallel.collect import Rows

COMM = MPI.COMM_WORLD


def state(number: int) -> Checkpoint:
    """A state of which each rank has its rows, and that says its number."""
    own = np.arange(50)[COMM.rank :: COMM.size]
    u = np.column_stack([own, np.full(len(own), number / 7)])
    arrays = {"u": Rows(own, u, 50), "no": Rows(own[:0], own[:0], 0)}
    arrays |= {"few": np.zeros((0, 3)), "whole": np.arange(5.0)} if COMM.rank == 0 else {}
    return Checkpoint({"number": number, "case": {"title": "µ" * 50_000}, "time": 1 / 3}, arrays)


@pytest.fixture
def three(shared_tmp):
    """A directory in which three were written."""
    for number in range(3):
        write(shared_tmp, COMM, state(number))
    return shared_tmp


def read(directory):
    """The number of the newest, and what was said."""
    said = []
    found = newest(directory, COMM, said.append)
    if found:
        stored, some = found.stored, np.array([7, 3, 49])
        assert stored.shape("u") == (50, 2) and stored.shape("few") == (0, 3) and stored.shape("no") == (0,)
        assert (stored.rows("u", some) == np.column_stack([some, np.full(3, found.about["number"] / 7)])).all()
        assert stored["few"].shape == (0, 3) and (stored["whole"] == np.arange(5.0)).all()
        assert sorted(stored.names) == ["few", "no", "u", "whole"]
    return found and found.about["number"], said


def only_rank_0(action):
    """Do something to files."""
    if COMM.rank == 0:
        action()
    COMM.barrier()


def test_the_last_two_are_kept_and_the_newest_is_read_on_all_ranks(three):
    assert [path.name for path in sorted((three / "checkpoint").iterdir())] == ["c00000002.h5", "c00000003.h5"]
    COMM.barrier()
    assert read(three) == (2, [])


def test_hdf5_opens_it_as_it_is(three):
    with h5py.File(three / "checkpoint" / "c00000003.h5", locking=False) as file:
        assert (file["u"][:, 0] == np.arange(50)).all() and (file["u"][:, 1] == 2 / 7).all()


def test_where_nothing_was_written_there_is_none(shared_tmp):
    assert read(shared_tmp) == (None, [])


@pytest.mark.parametrize("damage", ["a bit", "cut", "empty", "of the seal"])
def test_a_damaged_one_is_passed_over_with_a_message_for_the_one_before(three, damage):
    path = three / "checkpoint" / "c00000003.h5"

    def harm():
        content = bytearray(path.read_bytes())
        if damage == "a bit":
            content[len(content) // 2] ^= 1
        elif damage == "of the seal":
            content[-1] ^= 1
        path.write_bytes(content if "of" in damage or "bit" in damage else content[:-700] if damage == "cut" else b"")

    only_rank_0(harm)
    number, said = read(three)
    assert number == 1
    assert len(said) == 1 and "c00000003.h5' is damaged" in said[0] and "passed over" in said[0]
    write(three, COMM, state(5))
    only_rank_0(lambda: (three / "checkpoint" / "c00000003.h5").write_bytes(b""))
    assert read(three)[0] == 1  # a damaged one does not drive a whole one out


def test_if_none_is_whole_that_is_an_error(three):
    only_rank_0(lambda: [path.write_bytes(b"rubbish") for path in (three / "checkpoint").iterdir()])
    with pytest.raises(OutputError, match=r"no checkpoint in .* is whole: .*c00000003.*c00000002"):
        read(three)


def test_a_full_disk_leaves_those_that_are_there(three):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, limits[1]))
    try:
        with pytest.raises(OutputError, match="cannot write"):
            write(three, COMM, state(7))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not list((three / "checkpoint").glob("*.part"))
    COMM.barrier()
    assert read(three) == (2, [])


def test_one_that_was_being_written_when_the_run_was_killed_is_none(three):
    only_rank_0(lambda: (three / "checkpoint" / "c00000004.h5.part").write_bytes(b"half"))
    assert read(three) == (2, [])
    write(three, COMM, state(4), keep=1)
    assert [number for number, _ in checkpoint.listed(three / checkpoint.FOLDER)] == [4]
