"""A run that does not fit is refused before it starts, with the numbers."""

from __future__ import annotations

import shutil
from collections import namedtuple
from collections.abc import Callable
from pathlib import Path

import pytest
from scenes import CASES

from mpi4py import MPI

import cellmig
from cellmig.runs import resources as room


@pytest.mark.serial
def test_a_run_that_lacks_memory_is_refused_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "free_memory", lambda: 50e6)
    with pytest.raises(room.InsufficientResources, match=r"takes 1\d\d MB of memory at least, of which 50 MB are free"):
        room.require_resources(cellmig.load(CASES["one_cell"]), tmp_path / "run", MPI.COMM_SELF)
    assert not (tmp_path / "run").exists()


@pytest.mark.serial
def test_a_run_that_lacks_disk_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(2000, 1000, 1000))
    with pytest.raises(room.InsufficientResources, match="of which 1 kB are free"):
        room.require_resources(cellmig.load(CASES["one_cell"]), tmp_path / "run", MPI.COMM_SELF)


@pytest.mark.serial
def test_a_hundred_million_particles_end_with_exit_code_3(cellmig: Callable, tmp_path: Path) -> None:
    done = cellmig(2, CASES["one_cell"], "--out", tmp_path / "run", "--set", "particles.per_cell=100000000")
    assert done.returncode == 3
    assert done.stderr.count("TB of memory at least") == 1
    assert not (tmp_path / "run").exists()


@pytest.mark.serial
def test_the_paper_s_scene_fits_in_a_quarter_of_a_gigabyte_and_not_in_much_less(tmp_path: Path,
                                                                              monkeypatch: pytest.MonkeyPatch) -> None:
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(10**9, 0, 10**9))
    case = cellmig.load(CASES["all_protrude"])
    monkeypatch.setattr(room, "free_memory", lambda: 250e6)
    room.require_resources(case, tmp_path / "run", MPI.COMM_SELF)
    monkeypatch.setattr(room, "free_memory", lambda: 120e6)
    with pytest.raises(room.InsufficientResources):
        room.require_resources(case, tmp_path / "run", MPI.COMM_SELF)
