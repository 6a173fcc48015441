"""Many runs at once: one that fails stops no other, a request to stop ends all, and a loss of energy is told."""

from __future__ import annotations

import time
from dataclasses import replace

import pytest

from cellmig.case.shipped import FOLDER
from cellmig.runs.batch import Job, run_all, unsound

pytestmark = pytest.mark.serial


def test_a_failed_run_is_told_with_its_message_and_stops_no_other(tmp_path):
    wrong, right = (Job(name, FOLDER / "nucleus.toml", (f"particles.per_cell={n}", "time.end=0.1 us"), tmp_path / name)
                    for name, n in (("wrong", -1), ("right", 61)))
    ended = {e.job.name: e for e in run_all([wrong, right], 2)}
    assert ended["wrong"].code == 2 and "per_cell" in ended["wrong"].message
    assert ended["right"].code == 0 and right.is_done() and not wrong.is_done()
    assert not replace(right, sets=("particles.per_cell=62", "time.end=0.1 us")).is_done()


def test_a_request_to_stop_ends_what_runs(tmp_path):
    job, asked, start = Job("long", FOLDER / "all_protrude.toml", (), tmp_path / "long"), [], time.monotonic()
    quick = replace(job, name="quick", case=FOLDER / "nowhere.toml")
    for _ in run_all([quick, job], 2, asked):
        asked.append(15)
    assert time.monotonic() - start < 20 and not job.is_done()


def test_a_run_whose_energy_does_not_add_up_does_not_count(tmp_path):
    jobs = [Job(str(error), FOLDER / "nucleus.toml", (), tmp_path / str(error)) for error in (1e-3, 0.2)]
    for job in jobs:
        job.directory.mkdir()
        (job.directory / "manifest.json").write_text(f'{{"worst_energy_error": {job.name}}}')
    assert list(unsound(jobs)) == jobs[1:]
