"""The study of sensitivity: what is varied, how a contact line that sticks is measured, what the tables say."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

import cellmig.verify.sensitivity as study
from cellmig.commands import verify as command
from cellmig.runs import batch
from cellmig.runs.outcome import Outcome
from cellmig.usage import UsageError, parse
from cellmig.verify.sensitivity import choices, compare, measure, plan, plateau, sensitivity, spreading

pytestmark = pytest.mark.serial

TIME = np.arange(0.0, 401.0)
CASE = SimpleNamespace(**{
    "seed": 2019, "time": SimpleNamespace(step_factor=0.8, end=400.0), "particles": SimpleNamespace(per_cell=1485),
    "substrate": SimpleNamespace(equilibrium_distance=0.01), "numerics": SimpleNamespace(bulk_viscosity=0.05),
    "materials": {"cytoplasm": SimpleNamespace(reduced_bulk_modulus=5e6, stabilisation=1.0),
                  "nucleus": SimpleNamespace(hourglass_modulus=0.16)}})
MANIFEST = {"steps": 9, "worst_energy_error": 1e-3, "state_hash": "a",
            "case": {"materials": {"nucleus": {}, "cytoplasm": {}},
                     "cells": [{"material": "cytoplasm", "nucleus": "nucleus"}]}}


@dataclass(frozen=True)
class Picture:
    """A frame of 1,000 particles of cytoplasm with stresses up to `peak` [Pa], and some of nucleus far above."""

    time: float
    peak: float

    def read(self):
        stress = np.append(np.linspace(0.0, self.peak, 1001), np.full(50, 1e6))
        return {"effective_stress": stress, "material": np.repeat([1, 0], [1001, 50])}


def outcome(displacement=10.0, contact=20.0, peak=100.0, state="a"):
    """A run to 400 us: accelerates to `displacement` [um], spreads to `contact` [um]."""
    rows = {"ux_um": displacement * (TIME / 400) ** 2, "substrate_contact_um": contact * np.sqrt(TIME / 400),
            "cell_contact_um": 0.5 * contact * np.sqrt(TIME / 400)}
    history = {"time_us": TIME, "cell": np.zeros(401), **rows}
    pictures = [Picture(t, peak * (50 if t in (100.0, 350.0) else 1)) for t in np.arange(0.0, 401.0, 10.0)]
    return Outcome(history, MANIFEST | {"state_hash": state}, pictures)


@pytest.mark.parametrize("quick", [False, True])
def test_the_default_runs_once_and_every_other_run_changes_one_thing(tmp_path, quick):
    jobs = plan(tmp_path, quick)
    cases = {key: job.load().resolved() for key, job in jobs.items()}
    default = cases.pop(("default", ""))
    assert [key for key, case in cases.items() if case == default] == [("ranks", "2")]
    assert len({job.directory for job in jobs.values()}) == len(jobs)
    changed = {key: differences(default, case) for key, case in cases.items()
               if key[0] not in ("spreading", "equilibrium_distance")}
    assert changed.pop(("ranks", "2")) == [] and jobs["ranks", "2"].ranks == 2
    assert all(len(names) == 1 and names[0].endswith(key[0]) for key, names in changed.items()), changed
    assert {name for name, _ in jobs} == {"default", "spreading", *(c.name for c in choices(quick, 2019))}
    spacings = ("150", "331") if quick else ("331", "631")
    assert {("per_cell", n) for n in spacings} < set(jobs) and ("spreading", spacings[0]) in jobs


def test_bonds_of_another_range_do_the_same_work_from_their_equilibrium_distance(tmp_path):
    jobs = plan(tmp_path, quick=False)
    case, default = jobs["equilibrium_distance", "20"].load(), jobs["default", ""].load()
    assert case.substrate.equilibrium_distance == case.contact.equilibrium_distance == pytest.approx(0.02)
    assert (case.substrate.work, case.contact.work) == (default.substrate.work, default.contact.work)
    right, middle, left = (np.array(cell.centre) for cell in case.cells)
    assert right == pytest.approx([10.02, 5.02]) and middle == pytest.approx([0.0, 5.02], abs=1e-9)
    assert left == pytest.approx([-10.02, 5.02])


def test_a_staircase_has_the_plateaus_of_its_steps_and_a_smooth_curve_those_of_its_slope():
    steps = np.floor(TIME / 40)  # jumps by 1 um in the microsecond before 40, 80, …
    found = plateau(TIME, steps)
    assert found.start % 40 == 0 and found.ended and found.length == pytest.approx(39.05)
    assert plateau(TIME, 0.01 * TIME).length == pytest.approx(5.0)  # 0.05 um at 0.01 um/us, from anywhere on
    slowing = plateau(TIME, np.sqrt(TIME))
    assert slowing.ended and slowing.length == pytest.approx(0.05 * 2 * 20, rel=0.05)  # slope 1/(2 sqrt t) at the end
    back = plateau(TIME, np.where(TIME < 200, 0.1 * TIME, 20.0 - 0.01 * (TIME - 200)))  # a retreat is no growth
    assert not back.ended and back.length == pytest.approx(200, abs=2)
    assert plateau(TIME, np.where(TIME < 18, 0.0, TIME)).length < 1  # what is over by 20 us does not count


def test_the_peak_stress_is_that_of_the_cytoplasm_and_no_single_burst():
    found = measure(outcome(peak=100.0))
    assert found["peak_stress_pa"] == pytest.approx(99.0)
    assert found["displacement_um"] == 10.0 and found["cell_contact_um"] == 10.0


def test_the_table_holds_every_change_relative_to_the_default_and_tells_whether_ranks_change_bits():
    results = {"default": {"": outcome()}, "per_cell": {"331": outcome(displacement=12.0)},
               "ranks": {"2": outcome(state="b")}, "spreading": {"331": outcome(contact=5.0)}}
    rows = compare(results, choices(False, 2019), CASE)
    assert [row["varied"] for row in rows] == ["default", "per_cell", "ranks"]
    assert rows[1]["displacement_um_change"] == pytest.approx(0.2) and rows[1]["peak_stress_pa_change"] == 0.0
    assert [row["same_bits"] for row in rows] == ["", "", "no"]
    curves = spreading(results)
    assert curves[0]["step_um"] == pytest.approx(5.0 * (np.sqrt(21) - np.sqrt(20)) / 20)
    text = "\n".join(study._report(rows, curves, CASE))
    assert "| particles per cell (1485) | 331" in text and "12 (+20.0 %)" in text and "2, OTHER BITS" in text
    assert len({len(line) for line in text.splitlines()[:5]}) == 1  # aligned
    assert compare({"per_cell": results["per_cell"]}, choices(False, 2019), CASE)[0]["same_bits"] == ""


def test_the_time_that_runs_will_take_is_that_of_the_cores_and_the_longest_run():
    jobs = [batch.Job(str(n), None, (), None, ranks=1 + (n == 3)) for n in range(4)]
    seconds = dict(zip(jobs, (10.0, 20.0, 10.0, 40.0), strict=True))
    assert batch.expected(seconds, 2, load=0.0, cores=2) == 40.0
    assert batch.expected(seconds, 4, load=0.0, cores=8) == 20.0  # the longest, on two ranks
    assert batch.expected(seconds, 2, load=2.0, cores=2) == 80.0  # as many processes of others


@pytest.mark.parametrize(("words", "message"), [
    (["--stress", "6", "--sensitivity"], "not allowed with"), (["--seed", "3"], "--seed is for"),
    (["--only", "none-such"], "no reference or group 'none-such'; 'verify --list' lists them"),
    (["--only", "spce"], "no reference or group 'spce'; did you mean 'space'?"),
    (["--stress", "6", "--only", "laws"], "--only is"),
    (["--sensitivity", "--seed", "3"], "--seed is for"), (["--stress", "6", "--quick"], "--quick is for"),
    (["--set", "time.step_factor=0.9"], "--set is for")])
def test_what_there_is_to_verify_has_to_be_said(words, message):
    with pytest.raises(UsageError, match=message):
        command(parse(["verify", *words]))


@pytest.mark.slow
def test_the_study_runs_once_and_says_the_same_again(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(study, "_QUICK_SPACINGS", (61, 91))
    monkeypatch.setattr(study, "_QUICK", ("time.samples=25", "time.end=25 us"))
    assert sensitivity(tmp_path, 2, quick=True) == 0
    text = capsys.readouterr().out
    assert "14 to go" in text and "2, same bits" in text and "at 25 µs" in text
    written = {path.name: path.read_bytes() for path in tmp_path.glob("sensitivity.*")}
    rows = list(csv.DictReader(written["sensitivity.csv"].decode().splitlines()))
    assert len(rows) == 14 and written["sensitivity.md"].decode().split("\n\n", 2)[2].strip() in text

    monkeypatch.setattr(batch.Job, "start", lambda *_: pytest.fail("a run that is there was started again"))
    assert sensitivity(tmp_path, 2, quick=True) == 0
    assert written == {path.name: path.read_bytes() for path in tmp_path.glob("sensitivity.*")}


def differences(a, b, path=""):
    """Paths at which two trees of tables and lists differ."""
    if isinstance(a, dict) and isinstance(b, dict):
        return [d for key in {**a, **b} for d in differences(a.get(key), b.get(key), f"{path}.{key}")]
    return [path] if a != b else []
