"""`cellmig verify`: orders and verdicts on numbers made up, what every reference says of itself, and one end to end."""

from __future__ import annotations

import csv
import json
import math

import pytest

from cellmig.commands import verify as command
from cellmig.exits import DONE
from cellmig.usage import parse
from cellmig.verify import verify as study
from cellmig.verify.reference import FAILS, HOLDS, Expected, Measured, Reference, converges, exact, judge, orders

pytestmark = pytest.mark.serial

SIZES = (0.4, 0.2, 0.1)


def judged(expected: Expected, errors: tuple, particles: tuple = (100, 400, 1600), failed: tuple = ()) -> tuple:
    found = [Measured(h, {"e": e}, n) for h, e, n in zip(SIZES, errors, particles, strict=True)]
    v = judge("made up", "e", expected, found[::-1], failed)
    return v.verdict, v.why


@pytest.mark.parametrize("order", [1.0, 2.0, 3.7])
def test_orders_are_those_of_a_power_law(order: float) -> None:
    assert orders(SIZES, [7.0 * h**order for h in SIZES]) == pytest.approx((order, order))


def test_order_of_the_two_finest_and_over_all_are_told_apart() -> None:
    pairwise, fitted = orders(SIZES, [0.16, 0.04, 0.02])
    assert pairwise == pytest.approx(1.0) and fitted == pytest.approx(1.5)
    assert all(map(math.isnan, orders(SIZES, [0.1, 0.01, 0.0])))


@pytest.mark.parametrize(("expected", "errors", "verdict"), [
    (converges(2, ""), (0.16, 0.04, 0.01), HOLDS),
    (converges(2, ""), (0.16, 0.04, 0.0114), HOLDS),  # 1.81
    (converges(2, ""), (0.16, 0.04, 0.012), FAILS),  # 1.74 between the two finest
    (converges(2, ""), (0.1, 0.04, 0.01), FAILS),  # 1.66 over all
    (converges(2, ""), (0.16, 0.04, 0.0), HOLDS),  # nothing is left of the error
    (converges(2, "", floor=0.02), (0.16, 0.04, 0.018), HOLDS),
    (converges(2, "", {1600: 0.02}), (0.16, 0.04, 0.01), HOLDS),
    (converges(2, "", {1600: 0.005}), (0.16, 0.04, 0.01), FAILS),
    (converges(2, "", {1500: 0.005}), (0.16, 0.04, 0.01), HOLDS),  # 400 are too few to try 1,500
    (converges(2, "", {5000: 0.005}), (0.16, 0.04, 0.01), HOLDS),
    (converges(2, ""), (0.16, 0.04, math.nan), FAILS),
    (exact(1e-12, ""), (1e-13, 0.0, 5e-13), HOLDS),
    (exact(1e-12, ""), (2e-12, 0.0, 5e-13), FAILS)])
def test_verdict(expected: Expected, errors: tuple, verdict: str) -> None:
    found, why = judged(expected, errors)
    assert found == verdict and bool(why) == (verdict == FAILS)


@pytest.mark.parametrize(("last", "quick", "verdict"), [
    (0.0119, True, HOLDS), (0.0121, True, FAILS), (0.0119, False, FAILS), (0.004, True, HOLDS)])
def test_where_quick_is_too_coarse_for_an_order_the_error_is_what_was_measured(last: float, quick: bool,
                                                                               verdict: str) -> None:
    found = [Measured(h, {"e": e}, 100) for h, e in zip(SIZES, (0.03, 0.02, last), strict=True)]
    assert judge("made up", "e", converges(2, ""), found, coarse=0.01 if quick else 0.0).verdict == verdict


def test_a_resolution_that_failed_is_no_success() -> None:
    assert judged(converges(2, ""), (0.16, 0.04, 0.01), failed=("at 9: no",)) == (FAILS, ("at 9: no",))


def test_every_reference_says_what_it_is_and_what_theory_expects() -> None:
    found = study.load_references()
    assert len(found) >= 6
    for r in found.values():
        assert r.shows and r.source and r.expected and r.seconds > 0, r.name
        assert all(e.why and (e.order or e.tolerance) for e in r.expected.values()), r.name
        assert len(set(r.at)) >= 3 and len(set(r.quick)) >= 3, r.name
        assert "," not in r.name and r.name == r.name.lower(), r.name
        assert set(r.coarse) <= set(r.expected), r.name


def test_a_quick_reference_from_end_to_end(tmp_path, capsys) -> None:
    words = ["verify", "--quick", "--only", "simple-shear, seifert", "--out", str(tmp_path), "--jobs", "1"]
    assert command(parse(words)) == DONE
    said = capsys.readouterr().out
    assert "2 references at 6 points" in said and "3 of 3 hold" in said
    verdicts = json.loads((tmp_path / "verify.json").read_text())["verdicts"]
    with open(tmp_path / "verify.csv", newline="") as file:
        assert [row["error"] for row in csv.DictReader(file)] == [v["error"] for v in verdicts]
    pull = next(v for v in verdicts if v["error"] == "strongest pull")
    assert pull["order"] == pytest.approx(2.0, abs=0.05) and pull["verdict"] == HOLDS  # measured 1.99
    page = (tmp_path / "verify.md").read_text()
    assert page.startswith("# ") and "`cellmig verify --quick`" in page and "## seifert (laws)" in page
    assert "| strongest pull |" in page


def test_what_does_not_hold_or_breaks_is_told_and_costs_the_exit_code(tmp_path, capsys, monkeypatch) -> None:
    broken = Reference("broken", "made up", "nothing", "none", {"e": exact(1e-12, "none")}, (1, 2, 3), (1, 2, 3),
                       lambda n: Measured(n, {"e": 0.0}))
    monkeypatch.setitem(study.load_references(), "broken", broken)  # the processes do not know it
    assert command(parse(["verify", "--only", "broken", "--out", str(tmp_path), "--jobs", "1"])) == study.DIFFERENT
    said = capsys.readouterr().out
    assert "at 3: KeyError: 'broken'" in said and "0 of 1 hold, 1 does not" in said


def test_the_list_tells_orders_and_reasons(capsys) -> None:
    assert command(parse(["verify", "--list", "--only", "laws"])) == DONE
    said = capsys.readouterr().out
    assert "seifert (laws)" in said and "strongest pull: order 2; " in said and "viscous-drop" not in said
