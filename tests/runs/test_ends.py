"""Where runs end, and what begins there: an end of many digits, a later end, another case that starts from there."""

from __future__ import annotations

import subprocess
import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scenes import CASES

from cellmig.case.times import output_times
from cellmig.output.manifest import read_manifest
from cellmig.output.tables import read_table
from cellmig.output.xdmf import frames
from cellmig.runs.diff import diff
from cellmig.runs.stops import stop_requests

pytestmark = pytest.mark.serial

CASE = (CASES["two_three"], "--set", "particles.per_cell=60", "--set", "time.end=1 us", "--set", "time.samples=4",
        "--set", "time.frames=2", "--set", "time.step=2 ns", "--quiet")
TABLES = ("history.csv", "ledger.csv", "substrate.csv", "neighbours.csv")


# ------------------------------------------------------------------------------------------------- when a run looks up


@pytest.mark.parametrize("end", [1 / 3, 0.3333333333333333, 400.0, 1e-7, 0.1, 123456.789012345, 2 / 7 * 1e9])
@pytest.mark.parametrize("more", [1.0, 0.37, 2.0, 10 / 3])
def test_every_sample_and_the_end_come_once_whatever_digits_they_have(end, more):
    case = SimpleNamespace(time=SimpleNamespace(end=end, samples=12, frames=8))
    found = output_times(case, more * end)
    times = np.array([time for time, _, _ in found])
    assert times[0] == 0.0 and times[-1] == more * end and np.diff(times).min() > 1e-3 * end
    for kind, count in ((1, 12), (2, 8)):
        own = np.array([stop[0] for stop in found if stop[kind]])
        expected = end / count * np.arange(np.ceil(more * count * (1 - 1e-12)))
        assert own[-1] == more * end and np.allclose(own[:-1], expected, rtol=4e-16, atol=0.0)  # measured 2.2e-16


def test_what_falls_together_is_one_time_with_any_number_of_samples():
    cases = (SimpleNamespace(time=SimpleNamespace(end=1 / 3, samples=n, frames=1)) for n in (6, 6000))
    few, many = ({stop[0] for stop in output_times(case, 1 / 3)} for case in cases)
    assert few < many


# ------------------------------------------------------------------------------------------------------ a later end


@pytest.fixture(scope="module")
def cellmig(cellmig) -> Callable[..., str]:
    """`cellmig(3, "resume", …)`: the program on some ranks; what it said went wrong."""

    def start(ranks: int, *words: object, code: int = 0) -> str:
        done: subprocess.CompletedProcess = cellmig(ranks, *words)
        assert done.returncode == code and "Traceback" not in done.stderr, done
        return done.stderr

    return start


@pytest.fixture(scope="module")
def made(cellmig, tmp_path_factory) -> Path:
    """Runs to 1 µs and to 2 µs."""
    home = tmp_path_factory.mktemp("ends")
    cellmig(1, *CASE, "--out", home / "short")
    cellmig(1, *CASE, "--out", home / "long", "--until", "2 us")
    return home


@pytest.mark.parametrize("ranks", [1, 3])
def test_a_run_that_is_done_goes_on_to_a_later_end_with_the_bits_of_one_that_had_it(cellmig, made, tmp_path, ranks):
    cellmig(ranks, *CASE, "--out", tmp_path / "run")
    assert len(list((tmp_path / "run/checkpoint").iterdir())) == 1
    cellmig(4 - ranks, "resume", tmp_path / "run", "--until", "2 us", "--quiet")
    same, lines = diff(tmp_path / "run", made / "long")
    assert same, lines
    for name in TABLES:
        assert (tmp_path / "run" / name).read_bytes() == (made / "long" / name).read_bytes()
    a, b = read_manifest(tmp_path / "run"), read_manifest(made / "long")
    assert [a[key] == b[key] for key in ("state_hash", "steps", "end_us", "frames", "worst_energy_error")] == [True] * 5
    assert [(entry["time_us"], entry["until_us"]) for entry in a["resumed"]] == [(1.0, 2.0)]
    assert a["run_id"] != b["run_id"] and a["exit_status"] == 0


def test_an_end_between_samples_stays_in_the_tables_and_the_samples_go_on_in_their_rhythm(cellmig, tmp_path):
    cellmig(1, *CASE, "--out", tmp_path / "run", "--until", "0.6 us")
    cellmig(1, "resume", tmp_path / "run", "--until", "1 us", "--quiet")
    assert read_table(tmp_path / "run/ledger.csv")["time_us"].tolist() == [0.0, 0.25, 0.5, 0.6, 0.75, 1.0]
    assert [frame.time for frame in frames(tmp_path / "run")] == [0.0, 0.5, 0.6, 1.0]


def test_a_run_that_was_stopped_gets_another_end_but_none_before_where_it_is(cellmig, made, tmp_path):
    cellmig(1, *CASE, "--out", tmp_path / "run", "--wall-time", "1 s", code=75)
    assert "µs already, beyond 1e-06 µs" in cellmig(1, "resume", tmp_path / "run", "--until", "1 ps", code=2)
    cellmig(3, "resume", tmp_path / "run", "--until", "2 us", "--quiet")
    same, lines = diff(tmp_path / "run", made / "long")
    assert same, lines


# ------------------------------------------------------------------------------------------------------ another case


@pytest.mark.parametrize("ranks", [1, 3])
def test_another_case_starts_at_zero_with_the_last_state_of_a_run(cellmig, made, tmp_path, ranks):
    before = {path: path.read_bytes() for path in made.rglob("*") if path.is_file()}
    words = (*CASE, "--from", made / "short", "--out", tmp_path / "run", "--set", "seed=4",
             "--set", "adhesion.cells.bond_density=500 /um^2")
    cellmig(ranks, *words)
    assert before == {path: path.read_bytes() for path in made.rglob("*") if path.is_file()}
    parent, child = read_manifest(made / "short"), read_manifest(tmp_path / "run")
    assert child["from"]["run_id"] == parent["run_id"] and child["from"]["time_us"] == 1.0
    assert child["run_id"] != parent["run_id"] and child["time_us"] == 1.0
    last, first = frames(made / "short")[-1], frames(tmp_path / "run")[0]
    assert first.time == 0.0
    for name in ("X", "u", "v"):
        assert np.array_equal(last.read()[name], first.read()[name]), name
    ledger, old = read_table(tmp_path / "run/ledger.csv"), read_table(made / "short/ledger.csv")
    assert ledger["time_us"].tolist() == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert ledger["viscous_loss_pn"][0] == 0.0 < old["viscous_loss_pn"][-1]
    assert child["worst_energy_error"] < 1e-3  # measured 5e-9: the ledger counts from the state that it began with


def test_a_case_that_started_from_a_run_goes_on_like_any_other(cellmig, made, tmp_path):
    words = (*CASE, "--from", made / "short")
    cellmig(1, *words, "--out", tmp_path / "whole")
    cellmig(1, *words, "--out", tmp_path / "run", "--wall-time", "1 s", code=75)
    cellmig(3, "resume", tmp_path / "run", "--quiet")
    same, lines = diff(tmp_path / "run", tmp_path / "whole")
    assert same, lines
    assert read_manifest(tmp_path / "run")["from"] == read_manifest(tmp_path / "whole")["from"]


@pytest.mark.parametrize("change", ["particles.per_cell=61", "cells.0.nucleus_ratio=0.4"])
def test_a_case_of_other_particles_cannot_start_from_a_run(cellmig, made, tmp_path, change):
    said = cellmig(1, *CASE, "--from", made / "short", "--out", tmp_path / "run", "--set", change, code=2)
    assert "--from: the run to start from has other particles" in said
    assert read_manifest(tmp_path / "run")["exit_status"] == 2


def test_where_there_is_no_run_to_start_from_that_is_said(cellmig, tmp_path):
    said = cellmig(1, *CASE, "--from", tmp_path / "none", "--out", tmp_path / "run", code=5)
    assert "none' has no checkpoint to start from" in said and not (tmp_path / "run").exists()


def test_outputs_of_a_fixed_step_are_at_whole_steps_each_once(cellmig, tmp_path):
    few = ("particles.per_cell=60", "time.step=3 ns", "time.samples=1000", "time.frames=3", "time.end=100 ns")
    cellmig(1, CASES["one_cell"], *(word for change in few for word in ("--set", change)), "--out", tmp_path / "run")
    steps = read_table(tmp_path / "run/ledger.csv")["time_us"] / 3e-3
    assert np.abs(steps - np.arange(34)).max() < 1e-6  # 0.1 µs are 33.3 steps; the samples want 30 of each
    assert np.abs(np.array([f.time for f in frames(tmp_path / "run")]) / 3e-3 - [0, 11, 22, 33]).max() < 1e-9


@pytest.mark.serial
def test_a_thread_that_cannot_hear_signals_runs_all_the_same() -> None:
    found: list[list[int]] = []

    def listen() -> None:
        with stop_requests() as signals:
            found.append(signals)

    thread = threading.Thread(target=listen)
    thread.start()
    thread.join()
    assert found == [[]]
