"""Run time against error: fronts and gains on made-up points, and what an accuracy picks or refuses."""

import dataclasses
import itertools
import re

import numpy as np
import pytest
from scenes import CASES

from cellmig import usage
from cellmig.bench import modulus, space
from cellmig.bench.accuracy import accuracy_table, plan, report
from cellmig.bench.pareto import Broken, Point, gain, gains, pareto, time_at, verdict, with_median_times
from cellmig.bench.problems import PROBLEMS, Setting, columns, crawling, judge_disc, judge_drop, judge_scene, ringing
from cellmig.case import accuracy
from cellmig.case.load import load
from cellmig.case.messages import CaseError
from cellmig.case.schema import Numerics
from cellmig.commands import bench
from cellmig.usage import UsageError, parse

pytestmark = pytest.mark.serial
SPEED = np.sqrt(2.0 * (2126.0 + 170.0) / 1000.0)  # of shear waves in the nucleus [µm/µs]


def point(cost, error, problem="disc", **setting):
    """A made-up point that takes `cost` seconds."""
    return Point(problem, Setting(**setting), 1, 1, 1e9 * cost, cost, error)


def curve(speed, problem="disc", **setting):
    """Error 1 / cost, `speed` times as fast."""
    return [point(n / speed, 1.0 / n, problem, per_cell=n, **setting) for n in (100, 200, 400)]


def test_the_front_holds_what_no_other_beats():
    a, b, beaten, same = point(1, 0.5), point(3, 0.1), point(2, 0.5), point(3, 0.1)
    assert pareto([beaten, b, a, same]) == [a, b] and pareto([]) == []


def test_time_to_an_error_is_read_between_points_and_beyond_them():
    assert [time_at(curve(1.0), 1.0 / n) for n in (150, 50, 800)] == pytest.approx([150, 50, 800])
    assert np.isnan(time_at(curve(1.0)[:1], 0.1))
    flat = [point(1.0, 0.0501), point(8.0, 0.05)]  # what does not fall with the spacing is not extrapolated for ever
    assert time_at(flat, 0.025) == pytest.approx(64.0)


def test_a_setting_counts_by_its_gain_on_the_worst_problem():
    points = []
    for name in PROBLEMS:
        once, other = (3.0, 9.0) if name == "drop" else (2.0, 0.5)
        points += curve(1.0, name) + curve(once, name, bulk_viscosity=0.0) + curve(other, name, bulk_viscosity=0.2)
    assert gain([p for p in points if p.problem == "disc"], {"bulk_viscosity": 0.0}) == pytest.approx(2.0)
    rows = gains(points)
    assert [change for change, _ in rows] == [{"bulk_viscosity": 0.0}, {"bulk_viscosity": 0.2}]
    assert "defaults should be: bulk viscosity 0.0" in verdict(rows) and "should stay: no change" in verdict(rows[1:])


def test_a_change_with_which_runs_break_gains_nothing_and_one_that_was_not_measured_is_no_default():
    points = [p for name in ("cell", "scene") for p in curve(1.0, name) + curve(2.0, name, modulus=1.25)]
    points += curve(2.0, "cell", modulus=2.5)
    broken = [Broken("scene", Setting(per_cell=n, modulus=1.25), "at 7 µs") for n in (150, 200)]
    rows = {change["modulus"]: row for change, row in gains(points, broken[:1])}  # the defaults were not run at 150
    assert rows[1.25] == pytest.approx({"cell": 2.0, "scene": 2.0}) and np.isnan(rows[2.5]["scene"])
    assert gains(points, broken)[-1] == ({"modulus": 1.25}, pytest.approx({"cell": 2.0, "scene": 0.0}))
    assert "defaults should be: modulus 1.25" in verdict(gains(points))
    assert "should stay: no change" in verdict(gains(points, broken))
    assert any("cell" not in line and "at 7 µs" in line for line in report(points, broken, {}))


def test_the_verdict_on_some_problems_says_that_defaults_are_chosen_by_all():
    points = {name: [*curve(1.0, name), *curve(2.0, name, bulk_viscosity=0.0)] for name in PROBLEMS}
    assert "all problems; by turn alone:  The defaults should be" in report(points["turn"], [], {})[-1]
    assert report([p for some in points.values() for p in some], [], {})[-1].startswith("The defaults should be")


def test_what_gains_and_is_unfit_is_named_and_does_not_become_the_default():
    unfit, fit = (({key: value}, dict.fromkeys(PROBLEMS, gained)) for key, value, gained in (
        ("stabilisation", 0.25, 5.0), ("modulus", 1.25, 2.0)))
    assert "best is stabilisation 0.25 (5 times" in verdict([unfit, fit])
    assert "defaults should be: modulus 1.25 (2 times" in verdict([unfit, fit])
    assert "should stay, as what gains is unfit (stabilisation: with less, short waves" in verdict([unfit])


def test_runs_whose_steps_do_the_same_work_get_the_same_time():
    times = [(3.0, {}), (5.0, {"modulus": 20.0}), (4.0, {"step_factor": 0.4}), (9.0, {"dilation": 3.0}),
             (2.0, {"bulk_viscosity": 0.0})]
    found = with_median_times([point(t, 0.1, **change) for t, change in times])
    assert [p.ns for p in found] == [4e9, 4e9, 4e9, 9e9, 2e9]


def test_exact_answers_have_no_error_and_wrong_ones_theirs():
    t = np.array(PROBLEMS["disc"].times)
    a2 = ringing(t)
    assert judge_disc(t, {"a": a2, "b": -a2}, None)["error"] < 1e-12
    assert judge_disc(t, {"a": 1.1 * a2, "b": -1.1 * a2}, None)["error"] == pytest.approx(0.1)
    exact = {"a": np.array([5.08760, 5.15571, 5.28614]), "b": np.array([4.91357, 4.84742, 4.72173])}
    assert judge_drop(t, exact, None)["error"] < 1e-12
    assert judge_drop(t, exact | {"a": exact["a"] + 0.0028614}, None)["error"] == pytest.approx(0.01)


@pytest.mark.parametrize(("name", "key", "exact"), [
    ("twist", "twist", lambda t: np.sin(space.TWIST * SPEED * t) / (space.TWIST * SPEED)),
    ("turn", "flow", lambda t: np.exp(-space.TURN**2 * t))])
def test_motions_in_space_begin_as_the_exact_ones_and_have_their_error(name, key, exact):
    problem = PROBLEMS[name]
    t = np.array([0.0, *problem.times])
    with problem.simulation(Setting(200)) as sim:
        first = problem.measure(sim)[key]
        sim.go(0.1)
        later = problem.measure(sim)[key]
    assert first == pytest.approx(exact(0.0), abs=1e-9)
    assert later - first == pytest.approx(exact(0.1) - exact(0.0), rel=0.1)  # measured 0.0005 and 0.04
    assert problem.judge(t, {key: exact(t)}, None)["error"] < 1e-12
    assert problem.judge(t, {key: 1.1 * exact(t)}, None)["error"] == pytest.approx(0.1)


def test_the_error_of_the_scene_is_the_largest_of_its_displacement_and_contacts_and_stresses_stand_beside():
    problem, sets = PROBLEMS["scene"], {"per_cell": 91}
    case = problem.case(Setting(**sets, surface_refinement=2.0, modulus=1.25, step_factor=0.95))
    assert (case.particles.surface_refinement, case.time.step_factor) == (2.0, 0.95)
    with problem.simulation(Setting(**sets)) as sim:
        rows = [crawling(sim)]
        sim.go(1.0)
        rows.append(crawling(sim))
    assert rows[1]["uy0"] < 0.0 < rows[1]["stress"] and 0.0 < rows[1]["energy"] < 0.01  # measured 0.0036
    t, finest = np.array([10.0, 30.0]), columns(rows[1:] * 2) | {"cell": np.ones(2)}  # they do not yet touch
    parts = ("displacement", "substrate", "cells", "each", "stress", "nucleus")
    assert judge_scene(t, finest, finest) == dict.fromkeys(("error", *parts), 0.0) | {"energy": rows[1]["energy"]}
    wrong = {"ux0": 1.1, "substrate": 1.2, "cell": 1.0, "ux1": 1.0, "stress": 3.0}
    found = judge_scene(t, {name: wrong.get(name, 1.0) * values for name, values in finest.items()}, finest)
    assert found["error"] == found["substrate"] == pytest.approx(0.2) and found["stress"] == pytest.approx(2.0)
    assert found["displacement"] == pytest.approx(0.1) and found["cells"] == found["each"] == 0.0
    apart = finest | {"cell": 1.5 * finest["cell"]}  # depends on the spacing without a cortex, and counts with one
    assert [PROBLEMS[name].judge(t, apart, finest)["error"] for name in ("scene", "tension")] == [0.0, 0.5]


@pytest.mark.parametrize("quick", [False, True])
def test_the_plan_holds_every_run_once_and_the_problems_that_are_asked_for(quick):
    listed = plan(quick, ["scene"])
    assert {problem.name for problem, _ in listed} == {"scene"} and len(set(listed)) == len(listed)
    assert {s.integrator for _, s in listed} == {"leapfrog"}  # PETSc's types take minutes
    assert {(s.surface_refinement, s.modulus) for _, s in listed} > set(itertools.product((1.0, 2.0), (1.25, 5.0)))
    assert {"rk", "bdf"} < {s.integrator for _, s in plan(quick, ["cell"])}


@pytest.mark.parametrize(("words", "message"), [
    (["--error", "--problem", "beam"], "no problem 'beam'; there are disc, drop, cell, scene, tension, twist"),
    (["--problem", "disc"], "--problem belongs to --error")])
def test_a_problem_that_there_is_not_is_refused(words, message):
    with pytest.raises(UsageError, match=message):
        bench(parse(["bench", *words]))


def test_what_goes_with_one_over_the_modulus_is_extrapolated_and_what_does_not_is_told():
    t = np.linspace(0.0, 1.0, 5)
    seen = {k: {"a": t * (1.0 + 0.5 / k), "stress": t * (1.0 + 0.5 / k**2)} for k in (*modulus.MODULI, modulus.CHECK)}
    a, stress = modulus.judge(PROBLEMS["drop"], 91, seen)
    assert a.orders == pytest.approx((1.0, 1.0)) and a.limit == pytest.approx(1.0)
    assert a.error == pytest.approx(0.1) and a.known < 1e-12
    assert stress.orders == pytest.approx((2.0, 2.0)) and stress.known == pytest.approx(0.001645, rel=1e-3)
    assert "cost the drop's a most: 10 %" in modulus.report([a, stress])[-1]


def test_the_reduced_modulus_costs_a_drop_less_than_its_spacing_does():
    seen = {k: modulus.measure_problem(PROBLEMS["drop"], Setting(91, modulus=k))
            for k in (*modulus.MODULI, modulus.CHECK)}
    rows = {row.quantity: row for row in modulus.judge(PROBLEMS["drop"], 91, seen)}
    assert list(rows) == ["a", "b", "stress", "pressure"]
    assert 1e-5 < max(rows["a"].error, rows["b"].error) < 0.01  # measured 0.0073; of the spacing 0.042


def test_an_accuracy_picks_the_cheapest_point_below_it_and_refuses_what_nobody_measured():
    points = {"fluid": {"points": [{"error": e, "cost_s": c, "per_cell": n} for e, c, n in
                                   ((0.04, 1.0, 91), (0.01, 9.0, 631), (0.02, 3.0, 331))]}}
    assert accuracy.pick(points, "fluid", 0.03)["per_cell"] == 331
    assert accuracy.pick(points, "fluid", 0.01)["per_cell"] == 631
    with pytest.raises(ValueError, match=r"0.5 % was not measured.*the least is 1 %"):
        accuracy.pick(points, "fluid", 0.005)
    with pytest.raises(ValueError, match="no scene of this kind was"):
        accuracy.pick(points, None, 0.5)
    with pytest.raises(ValueError, match=r"no scene of this kind \(fluid in space\) was measured; there are: fluid"):
        accuracy.pick(points, "fluid in space", 0.5)


@pytest.mark.parametrize(("name", "sets", "kind"), [
    ("one_cell", (), "cell on substrate"), ("all_protrude", (), "cells on a substrate"), ("nucleus", (), "elastic"),
    ("all_protrude", ("cortex.line_tension=30 pN/um",), "cells with a cortex on a substrate"),
    ("all_protrude", ("cells.0.repeat=[1]", 'protrusion.cells=["Cell-1"]'), "cell on substrate"),
    ("ball", (), "cell on substrate in space"), ("three_balls", (), None)])
def test_cells_that_touch_each_other_on_a_substrate_are_a_kind_of_their_own(name, sets, kind):
    assert accuracy.kind_of(load(CASES[name], sets).resolved()) == kind


def test_an_accuracy_is_not_below_what_the_reference_is_known_to_and_its_energy_adds_up():
    points = [point(1.0, 0.2, "scene", per_cell=150), point(2.0, 0.03, "scene", modulus=1.25),
              point(3.0, 0.02, "scene"), point(0.5, 0.01, "scene", stabilisation=0.25),
              dataclasses.replace(point(0.5, 0.01, "scene", step_factor=0.95), parts={"energy": 0.011})]
    rows = accuracy_table(points, {"scene": 0.05})["scene"]
    assert [(row["per_cell"], row["error"], row["modulus"]) for row in rows] == [(150, 0.2, 5.0), (1485, 0.05, 1.25)]


@pytest.mark.parametrize("text", ["0 %", "150 %", "fine", "1 um", True])
def test_what_is_no_accuracy_is_refused(text):
    with pytest.raises(ValueError, match="expects an accuracy"):
        accuracy.fraction(text)
    assert accuracy.fraction("1%") == accuracy.fraction(0.01) == pytest.approx(0.01)


@pytest.mark.parametrize("name", ["one_cell", "all_protrude", "outline", "nucleus"])
def test_the_accuracy_that_the_help_gives_as_an_example_suits_all_kinds_of_scenes(name):
    commands = usage.parser()._subparsers._group_actions[0].choices.values()
    asked = {action.metavar for command in commands for action in command._actions
             if "--accuracy" in action.option_strings}
    assert len(asked) == 1
    assert load(CASES[name], [f"numerics.accuracy={asked.pop()}"]).chosen.startswith("20 %")
    example = re.search(r'such as "([^"]*%)"', Numerics.__dataclass_fields__["accuracy"].metadata["doc"])[1]
    assert load(CASES[name], [f"numerics.accuracy={example}"]).chosen.startswith("20 %")


def test_a_case_leaves_open_what_its_accuracy_fills_and_keeps_what_it_gives(tmp_path):
    text = CASES["nucleus"].read_text().replace("per_cell = 1485\ndilation = 2.2\n", "")
    (tmp_path / "open.toml").write_text(text)
    case = load(tmp_path / "open.toml", ["numerics.accuracy=2%"])
    chosen = accuracy.pick(accuracy.measurements(), "elastic", 0.02)
    assert (case.particles.per_cell, case.particles.dilation) == (chosen["per_cell"], chosen["dilation"])
    assert f"per_cell = {chosen['per_cell']}" in case.chosen and "of the displacement in time; chosen" in case.chosen

    kept = load(CASES["one_cell"], ["numerics.accuracy=20%", "particles.per_cell=97"])
    assert kept.particles.per_cell == 97 and "not changed" in kept.chosen and "per_cell = 97" in kept.chosen
    with pytest.raises(CaseError, match="was not measured"):
        load(CASES["one_cell"], ["numerics.accuracy=0.001%"])
