"""Whether inertia matters: what validate and the log say of it, what auto chooses, what motion without it takes."""

from __future__ import annotations

import pytest
from scenes import case

from mpi4py import MPI

from cellmig.case.load import change
from cellmig.case.messages import CaseError
from cellmig.case.schema import Case
from cellmig.runs import preflight
from cellmig.runs.estimates import inertia_is_gone
from cellmig.runs.preflight import report
from cellmig.runs.summary import describe_scene
from cellmig.runs.trial import choose

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


def test_validate_tells_what_motion_without_inertia_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(preflight, "PATIENCE", 0.5)
    told, explicit = report(CRAWL), report(change(CRAWL, {"time.integrator": "leapfrog"}))
    assert "on one core, as a trial of 60 particles took" in told
    assert "leapfrog takes" in told
    assert '"overdamped" takes' in explicit


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
