"""`resume` as users call it: on other ranks, from damaged checkpoints, with another case, with nothing there."""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from scenes import CASES, ROOT

from mpi4py import MPI

from cellmig.output.directory import Claim
from cellmig.output.manifest import read_manifest
from cellmig.output.xdmf import frames
from cellmig.runs.diff import diff

pytestmark = pytest.mark.serial

COARSE = ("--set", "particles.per_cell=150", "--set", "time.samples=200")
PAPER = (CASES["all_protrude"], *COARSE, "--until", "9 us")
SQUEEZED = (CASES["squeezed_disc"], "--set", "particles.per_cell=300", "--set", "time.samples=4",
            "--set", "time.frames=4")
A_BATCH = ("--wall-time", "1 s")  # less than is kept back for the end: it stops after the first steps

Ended = subprocess.CompletedProcess


def ended(done: Ended, code: int, *parts: str) -> None:
    """Whether a call ended with this code and one message, or none, that has these parts."""
    assert done.returncode == code, done
    assert "Traceback" not in done.stderr and done.stderr.count("cellmig: ") == bool(parts), done.stderr
    for part in parts:
        assert part in done.stderr, done.stderr


@pytest.fixture(scope="module")
def whole(cellmig, tmp_path_factory) -> dict[str, Path]:
    """Runs that nothing interrupted."""
    home = tmp_path_factory.mktemp("whole")
    for name, words in (("paper", PAPER), ("squeezed", SQUEEZED)):
        ended(cellmig(1, *words, "--quiet", "--out", home / name), 0)
    return {name: home / name for name in ("paper", "squeezed")}


@pytest.fixture(scope="module")
def stopped(cellmig, tmp_path_factory) -> Path:
    """A run on two ranks with two checkpoints, stopped before its end."""
    run = tmp_path_factory.mktemp("stopped") / "run"
    ended(cellmig(2, *PAPER, "--quiet", "--out", run, *A_BATCH), 75)
    for _ in range(2):
        ended(cellmig(2, "resume", run, "--quiet", *A_BATCH), 75)
    assert len(list((run / "checkpoint").iterdir())) == 2
    return run


@pytest.fixture
def copy(stopped, tmp_path) -> Path:
    """A copy of that run."""
    return Path(shutil.copytree(stopped, tmp_path / "run"))


def is_whole(run: Path, like: Path) -> None:
    """Whether a run came to the same as another, bit for bit, and left nothing behind."""
    same, lines = diff(run, like)
    assert same, lines
    tables = {path.name for path in like.glob("*.csv")}
    assert tables == {path.name for path in run.glob("*.csv")} and {"history.csv", "ledger.csv"} <= tables
    for name in tables:
        assert (run / name).read_bytes() == (like / name).read_bytes(), name
    a, b = read_manifest(run), read_manifest(like)
    for name in ("state_hash", "steps", "list_renewals", "worst_energy_error", "J", "dt_us", "frames", "strain"):
        assert a.get(name) == b.get(name), name
    assert a["exit_status"] == 0 and len(list((run / "checkpoint").iterdir())) == 1
    files = {path for frame in frames(run) for path in frame.files}
    assert set(run.glob("rank*/*")) == files


# ----------------------------------------------------------------------------------------------------- the same bits


@pytest.mark.parametrize("ranks", [1, 3, *(pytest.param(ranks, marks=pytest.mark.slow) for ranks in (2, 4))])
def test_a_run_of_two_ranks_goes_on_with_the_same_bits(cellmig, whole, copy, ranks):
    ended(cellmig(ranks, "resume", copy, "--quiet"), 0)
    is_whole(copy, whole["paper"])
    assert [entry["ranks"] for entry in read_manifest(copy)["resumed"]] == [2, 2, ranks]


def test_two_ranks_then_one_then_three_then_four(cellmig, whole, copy):
    for ranks in (1, 3):
        ended(cellmig(ranks, "resume", copy, "--quiet", *A_BATCH), 75)
    ended(cellmig(4, "resume", copy, "--quiet"), 0)
    is_whole(copy, whole["paper"])


def test_equilibria_go_on_with_the_same_bits(cellmig, whole, tmp_path):
    ended(cellmig(1, *SQUEEZED, "--quiet", "--out", tmp_path / "run", *A_BATCH), 75)
    for _ in range(2):
        ended(cellmig(1, "resume", tmp_path / "run", "--quiet", *A_BATCH), 75)
    ended(cellmig(1, "resume", tmp_path / "run", "--quiet"), 0)
    is_whole(tmp_path / "run", whole["squeezed"])


def test_cells_on_ligands_and_a_graded_gel_go_on_with_the_same_bits(cellmig, tmp_path):
    given = ('substrate.ligand="0.5 + 0.4*sin(0.9*x)"', 'substrate.stiffness="9 + 0.2*x kPa"',
             'substrate.response={half="10 kPa"}', "time.samples=400")
    words = (*PAPER[:-1], "2 us", *(word for one in given for word in ("--set", one)), "--quiet")
    ended(cellmig(1, *words, "--out", tmp_path / "whole"), 0)
    ended(cellmig(2, *words, "--out", tmp_path / "run", *A_BATCH), 75)
    ended(cellmig(3, "resume", tmp_path / "run", "--quiet"), 0)
    is_whole(tmp_path / "run", tmp_path / "whole")
    assert (tmp_path / "run" / "substrate.xdmf").exists()


def test_another_integrator_goes_on_from_the_last_sample_with_the_same_bits(cellmig, tmp_path):
    words = (*PAPER[:-1], "0.5 us", "--set", "time.samples=1600", "-ts_type", "rk", "--quiet")  # two samples
    ended(cellmig(1, *words, "--out", tmp_path / "whole"), 0)
    ended(cellmig(2, *words, "--out", tmp_path / "run", *A_BATCH), 75)
    ended(cellmig(1, "resume", tmp_path / "run", "--quiet"), 5, "integrator rk of PETSc, not leapfrog", "PETSc options")
    ended(cellmig(3, "resume", tmp_path / "run", "--quiet", "-ts_type", "rk"), 0)
    is_whole(tmp_path / "run", tmp_path / "whole")


def test_a_run_that_was_killed_goes_on_from_its_last_checkpoint(outside_mpi, cellmig, whole, tmp_path):
    run = tmp_path / "run"
    command = [sys.executable, "-m", "cellmig", *map(str, PAPER), "--out", str(run), "--checkpoint-time", "1 us"]
    child = subprocess.Popen(command, env=outside_mpi, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    while len(list(run.glob("checkpoint/c*.h5"))) < 2:
        assert child.poll() is None
        time.sleep(0.001)
    child.send_signal(signal.SIGKILL)
    child.wait()
    ended(cellmig(2, "resume", run, "--quiet"), 0)
    is_whole(run, whole["paper"])


@pytest.mark.slow
def test_without_pruning_too(cellmig, whole, tmp_path):
    run = tmp_path / "run"
    ended(cellmig(2, *PAPER, "--no-prune", "--quiet", "--out", run, *A_BATCH), 75)
    ended(cellmig(1, "resume", run, "--quiet"), 0)
    assert read_manifest(run)["prune"] is False
    assert read_manifest(run)["state_hash"] == read_manifest(whole["paper"])["state_hash"]


# --------------------------------------------------------------------------------------------------- from which state


@pytest.mark.parametrize("damage", ["cut", pytest.param("flipped", marks=pytest.mark.slow)])
def test_a_damaged_last_checkpoint_is_passed_over_with_a_message(cellmig, whole, copy, damage):
    last = max((copy / "checkpoint").iterdir())
    content = bytearray(last.read_bytes())
    content[len(content) // 3] ^= 4
    last.write_bytes(content if damage == "flipped" else content[:5000])
    done = cellmig(1, "resume", copy)
    ended(done, 0)
    assert f"'{last}' is damaged" in done.stdout and "passed over" in done.stdout
    is_whole(copy, whole["paper"])


def test_if_no_checkpoint_is_whole_nothing_is_begun(cellmig, copy):
    for path in (copy / "checkpoint").iterdir():
        path.write_bytes(path.read_bytes()[:-1])
    ended(cellmig(2, "resume", copy, "--quiet"), 5, "no checkpoint in", "is whole")


def test_a_run_killed_before_its_first_checkpoint_begins_anew(cellmig, whole, copy):
    shutil.rmtree(copy / "checkpoint")
    ended(cellmig(1, "resume", copy, "--quiet"), 0)
    is_whole(copy, whole["paper"])
    assert copy.with_name("run.1").exists()


def test_a_checkpoint_of_another_version_is_refused(cellmig, copy, tmp_path):
    other = tmp_path / "sitecustomize.py"
    other.write_text("import cellmig.version\ncellmig.version.__version__ = '99.0'\n")
    paths = f"{tmp_path}:{ROOT}"
    done = cellmig(1, "resume", copy, "--quiet", env={"PYTHONPATH": paths})
    ended(done, 5, "the run that is there is of cellmig 0.", "this is 99.0")


@pytest.fixture(scope="module")
def other(cellmig, tmp_path_factory) -> Path:
    """The same case with another seed, stopped as early, on three ranks."""
    run = tmp_path_factory.mktemp("other") / "run"
    ended(cellmig(3, *PAPER, "--set", "seed=5", "--set", "particles.per_cell=140", "--quiet",
                  "--out", run, *A_BATCH), 75)
    return run


def edited(path: Path) -> None:
    """The first number of a table becomes another, of as many letters."""
    head, rows = path.read_text().split("\n", 1)
    assert rows.startswith("0.0,")
    path.write_text(f"{head}\n0.1{rows[3:]}")


FOREIGN = {
    "its checkpoint": (lambda run, other: (shutil.rmtree(run / "checkpoint"),
                                           shutil.copytree(other / "checkpoint", run / "checkpoint")), "manifest"),
    "its manifest": (lambda run, other: shutil.copy(other / "manifest.json", run), "manifest"),
    "its history": (lambda run, other: shutil.copy(other / "history.csv", run), "history.csv' is not the table"),
    "its ledger": (lambda run, other: shutil.copy(other / "ledger.csv", run), "ledger.csv' "),
    "a row that was edited": (lambda run, other: edited(run / "ledger.csv"), "ledger.csv' is not the table"),
    "a frame of a rank": (lambda run, other: shutil.copy(other / "rank0001/s00000000.h5", run / "rank0001"),
                          "rank0001/s00000000.h5' is of another run"),
    "a rank more": (lambda run, other: (shutil.copy(other / "rank0002.xdmf", run),
                                        shutil.copytree(other / "rank0002", run / "rank0002")),
                    "rank0002/s00000000.h5' is of another run")}


@pytest.mark.parametrize("what", FOREIGN)
def test_what_is_of_another_run_is_refused_and_nothing_is_changed(cellmig, copy, other, what):
    put, said = FOREIGN[what]
    put(copy, other)
    before = {path: path.read_bytes() for path in copy.rglob("*") if path.is_file() and path.name != "run.log"}
    ended(cellmig(1, "resume", copy, "--quiet"), 5, said)
    assert before == {path: path.read_bytes() for path in before}


def test_rows_that_were_lost_are_noticed(cellmig, copy):
    (copy / "history.csv").write_text("time_us,cell\n")
    ended(cellmig(1, "resume", copy, "--quiet"), 5, "history.csv' has 13 bytes where a checkpoint has")


@pytest.mark.parametrize("there", ["nothing", "other files", "a marked directory"])
def test_where_there_is_nothing_to_resume_that_is_said(cellmig, tmp_path, there):
    run = tmp_path / "run"
    if there != "nothing":
        run.mkdir()
    if there == "other files":
        (run / "thesis.tex").write_text("years")
    if there == "a marked directory":
        (run / "manifest.json").write_text("{}\n")
    ended(cellmig(1, "resume", run), 5, f"there is nothing to resume in '{run}'")


def test_what_is_done_is_not_done_again(cellmig, whole):
    before = (whole["paper"] / "manifest.json").read_bytes()
    for words in (("resume", whole["paper"]), (*PAPER, "--out", whole["paper"], "--resume", "auto")):
        done = cellmig(2, *words)
        ended(done, 0)
        assert done.stdout == f"'{whole['paper']}' is done already\n"
    assert (whole["paper"] / "manifest.json").read_bytes() == before


# ------------------------------------------------------------------------------------------------------ batch scripts


def test_resume_auto_begins_and_goes_on_with_the_same_line(cellmig, whole, tmp_path):
    line = (*PAPER, "--out", tmp_path / "run", "--resume", "auto", "--quiet")
    for _ in range(2):
        ended(cellmig(2, *line, *A_BATCH), 75)
    ended(cellmig(3, *line), 0)
    is_whole(tmp_path / "run", whole["paper"])
    assert len(read_manifest(tmp_path / "run")["resumed"]) == 2 and not (tmp_path / "run.1").exists()


@pytest.mark.parametrize(("words", "said"), [
    (("--set", 'cells.0.radius="4.9 um"'), "cells.0.radius: is not what it was"),
    (("--until", "8 us"), "--until: is not what it was")])
def test_a_checkpoint_of_another_case_is_refused(cellmig, copy, words, said):
    done = cellmig(1, *PAPER, *words, "--out", copy, "--resume", "auto", "--quiet")
    ended(done, 2, said)
    assert len(list((copy / "checkpoint").glob("*.h5"))) == 2


def test_checkpoints_come_by_simulated_time_and_by_wall_time(cellmig, tmp_path):
    written = []
    for words in (("--checkpoint-time", "2 us"), ("--checkpoint-wall", "0.02 s")):
        ended(cellmig(1, *PAPER, "--quiet", "--out", tmp_path / "run", *words), 0)
        written.append(read_manifest(tmp_path / "run")["checkpoints"]["written"])
    assert written[0] == 4 and written[1] > 0


@pytest.mark.parametrize(("option", "text", "said"), [
    ("--wall-time", "2", "has no unit"), ("--checkpoint-time", "0 us", "is not after the start")])
def test_times_that_are_none_are_refused(cellmig, tmp_path, option, text, said):
    ended(cellmig(1, *PAPER, "--out", tmp_path / "run", f"{option}={text}"), 2, option, said)
    assert not (tmp_path / "run").exists()


def test_two_runs_do_not_write_in_one_directory(cellmig, copy, tmp_path):
    other = tmp_path / "sitecustomize.py"  # less patience
    other.write_text("import cellmig.output.directory\ncellmig.output.directory.PATIENCE = 0.2\n")
    env = {"PYTHONPATH": f"{tmp_path}:{ROOT}"}
    before = sorted(copy.rglob("*"))
    claim = Claim(copy, MPI.COMM_SELF)
    for words in (("resume", copy), (*PAPER, "--out", copy), (*PAPER, "--out", copy, "--resume", "auto")):
        ended(cellmig(1, *words, "--quiet", env=env), 5, "another run is at work")
    claim.release()
    assert sorted(copy.rglob("*")) == before
    ended(cellmig(1, "resume", copy, "--quiet", *A_BATCH, env=env), 75)


@pytest.mark.parametrize("lines", [
    [("run",), ("run",), ("run",)], [("run",), ("resume",)], [("resume",), ("resume",)], [("auto",), ("auto",)]],
    ids=["three runs", "a run and resume", "twice resume", "twice auto"])
def test_of_two_that_start_at_once_in_one_directory_none_writes_in_the_files_of_the_other(
        outside_mpi, whole, copy, lines):
    if lines[0] == ("auto",):
        shutil.rmtree(copy)
    words = {"run": [*PAPER, "--out", copy], "resume": ["resume", copy],
             "auto": [*PAPER, "--out", copy, "--resume", "auto"]}
    started = [subprocess.Popen([sys.executable, "-m", "cellmig", *map(str, words[line]), "--quiet"], env=outside_mpi,
                                stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) for line, in lines]
    for process in started:
        process.communicate(timeout=60)
    codes = [process.returncode for process in started]
    assert set(codes) <= {0, 5} and 0 in codes, codes
    tables = [(path / "history.csv").read_bytes() for path in copy.parent.glob("run*")
              if read_manifest(path).get("exit_status") == 0]
    assert tables and set(tables) == {(whole["paper"] / "history.csv").read_bytes()}


def test_what_a_checkpoint_has_of_the_run_is_json_and_nothing_to_execute(stopped):
    import h5py

    with h5py.File(max((stopped / "checkpoint").iterdir()), locking=False) as file:
        about = json.loads(bytes(file["about"][()]))
        assert all(data.dtype.kind in "fiu" for data in file.values())
    assert re.fullmatch(r"[0-9a-f]{64}", about["method"]["kernel"]) and about["run"]["case"]["seed"] == 2019


def test_equilibria_on_two_ranks_go_on_to_what_their_solver_keeps(cellmig, tmp_path):
    """MUMPS adds what other ranks send as it comes: two runs on two ranks alone differ in the last bits."""
    words = (CASES["cook"], "--set", "particles.per_cell=700", "--quiet")
    ended(cellmig(2, *words, "--out", tmp_path / "whole"), 0)
    ended(cellmig(2, *words, "--out", tmp_path / "run", *A_BATCH), 75)
    ended(cellmig(2, "resume", tmp_path / "run", "--quiet"), 0)
    u, whole = (frames(tmp_path / name)[-1].read()["u"] for name in ("run", "whole"))
    assert np.abs(u - whole).max() < 1e-12 * np.abs(whole).max()  # measured 2e-15; of two whole runs as much
