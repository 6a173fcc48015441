"""Whether inertia matters: what validate and the log say of it, what auto chooses, what motion without it takes."""

from __future__ import annotations

from pathlib import Path

import pytest
from scenes import CASES, built, case

from mpi4py import MPI

from cellmig.case.gaps import arrangement
from cellmig.case.load import change
from cellmig.case.messages import CaseError
from cellmig.case.schema import Case
from cellmig.commands import validate
from cellmig.runs.api import run_here
from cellmig.runs.batch import Job, _costs
from cellmig.runs.estimates import expected, inertia_is_gone
from cellmig.runs.preflight import report
from cellmig.runs.summary import describe_scene
from cellmig.runs.trial import choose
from cellmig.solve.step import NumericsError
from cellmig.usage import parse

pytestmark = pytest.mark.serial
CRAWL, PAPER = case("crawl", per_cell=60), case("one_cell", per_cell=60)
ANY_FRICTION = {"friction.coefficient": "3000 Pa s/um"}


def warnings(found: Case) -> str:
    """Warnings of the log."""
    return "\n".join(text for name, text in describe_scene(found, found.time.end) if name == "WARNING")


def test_each_regime_suits_its_integrator_and_no_other() -> None:
    assert "momentum" not in warnings(CRAWL)
    assert "momentum" not in warnings(PAPER)
    assert "leaves inertia out" in warnings(change(CRAWL, {"time.integrator": "leapfrog"}))
    assert "inertia counts here" in warnings(change(PAPER, {"time.integrator": "overdamped"} | ANY_FRICTION))


def test_auto_leaves_inertia_out_where_it_is_gone_and_something_holds_each_cell() -> None:
    loose = change(CRAWL, {"time.integrator": "auto"}), change(PAPER, {"time.integrator": "auto"})
    assert choose(loose[0], MPI.COMM_SELF)[0].time.integrator == "overdamped"
    assert inertia_is_gone(loose[0])
    assert not inertia_is_gone(loose[1])
    assert not inertia_is_gone(change(loose[0], {"friction": None, "medium": None}))


@pytest.mark.usefixtures("hasty")
def test_validate_tells_what_motion_without_inertia_takes() -> None:
    told, explicit = report(CRAWL), report(change(CRAWL, {"time.integrator": "leapfrog"}))
    assert "on one core, as a trial of 60 particles took" in told
    assert "leapfrog takes" in told
    assert '"overdamped" takes' in explicit
    often = change(CRAWL, {"protrusion": {"cells": ["Cell-1"]}, "polarity": {"persistence": "1 ms"}})
    assert "knots of the polarity takes one step" in report(often)
    assert "if steps are as long as given" in report(change(CRAWL, {"time.step": "10 ms"}))


@pytest.mark.parametrize("integrator", ["overdamped", "bdf"])
@pytest.mark.usefixtures("hasty")
def test_validate_tells_all_else_where_its_trial_fails(
        integrator: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    def fails(*_: object) -> None:
        raise NumericsError("no step was short enough; try more friction")

    monkeypatch.setattr("cellmig.runs.preflight.try_implicit", fails)
    options = parse(["validate", str(CASES["crawl"]), "--set", f"time.integrator={integrator}", "--set",
                     "particles.per_cell=60", "--until", "1 ms"])
    assert validate(options) == 4
    lines = {line.split("  ")[0]: line for line in capsys.readouterr().out.splitlines()}
    assert lines["FAILED"].endswith("no step was short enough; try more friction")
    assert {"particles", "scene", "drag", "speeds", "memory", "disk", "skipped"} <= lines.keys()
    assert ("WARNING" in lines) == (integrator == "bdf")  # inertia does not matter for as long


@pytest.mark.parametrize(("changes", "message"), [
    ({"friction": None, "medium": None}, "nothing holds 'Cell-1'"),
    ({"medium": None, "cells.0.rest": False, "cells.0.centre": ["0 um", "9 um"]}, "nothing holds 'Cell-1'"),
    ({"cells.0.velocity": ["1 um/s", "0 um/s"]}, "forces alone decide velocities")])
def test_what_has_no_answer_without_inertia_is_refused(changes: dict, message: str) -> None:
    with pytest.raises(CaseError, match=message):
        change(CRAWL, changes)


@pytest.mark.parametrize("changes", [{"friction": None}, {"medium": None}, {
    "friction": None, "medium": None, "supports": [{"name": "base", "parts": ["base"]}]}])
def test_a_medium_or_friction_or_supports_hold_a_cell(changes: dict) -> None:
    assert change(CRAWL, changes).overdamped


def test_a_cell_that_supports_hold_is_not_said_to_fall() -> None:
    found = change(CRAWL, {"friction": None, "medium": None, "supports": [{"name": "base", "parts": ["base"]}],
                           "body_force": {"acceleration": ["0 m/s^2", "-9.81 m/s^2"]}, "protrusion": None})
    e = expected(found, arrangement(found), found.time.end)
    assert (e.speed, e.distance) == (0.0, 0.0)
    assert "inertia counts" not in warnings(found)


def test_the_push_that_validate_tells_counts_bonded_membrane() -> None:
    told = expected(CRAWL, arrangement(CRAWL), CRAWL.time.end).push
    with built(CRAWL, MPI.COMM_SELF) as s:
        s.go(1e6)
        pushed = s.sampler.fields()["protrusion_force"][:, 0].sum()
    assert told == pytest.approx(pushed, rel=0.3)  # 122 and 128 pN/µm


def test_the_log_of_auto_does_not_ask_for_what_it_has_chosen(tmp_path: Path) -> None:
    quick = change(CRAWL, {"time.integrator": "auto", "time.end": "2 s", "time.samples": 1, "time.frames": 1})
    run_here(quick, tmp_path / "run", None, True, None)
    log = (tmp_path / "run" / "run.log").read_text()
    assert "chosen      overdamped" in log
    assert "leaves inertia out" not in log


def test_no_time_is_told_of_many_runs_without_inertia() -> None:
    job = Job("crawl", CASES["crawl"], (), Path("output"))
    assert _costs([job]) == {job: 0.0}
