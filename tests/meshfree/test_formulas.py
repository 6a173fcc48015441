"""Formulas, supports, loads and plates of a case: each has a value where it acts, or a message with its place."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import CASES, built, case, piece

from cellmig.case.expression import Expression, evaluate
from cellmig.case.load import load
from cellmig.case.messages import CaseError
from cellmig.case.registry import laws
from cellmig.meshfree import formulas
from cellmig.solve.start import discretise

pytestmark = pytest.mark.serial


@pytest.mark.parametrize(("text", "value"), [
    ("0.1*x um", 0.1 * 0.3), ("-x + 2*y um", 0.5), ("sin(pi*x) nm", 1e-3 * np.sin(0.3 * np.pi)),
    ("max(x, y) um", 0.4), ("r**2 um", 0.25), ("1e-2*hypot(x, y) / (1 + x) um", 5e-3 / 1.3), ("0.5 um", 0.5)])
def test_a_formula_has_the_value_that_it_says(text: str, value: float) -> None:
    assert evaluate(Expression(text, "um"), np.array([[0.3, 0.4]])) == pytest.approx([value], rel=1e-14)


@pytest.mark.parametrize("text", ["__import__('os').system('true') um", "x.real um", "(lambda: x)() um", "z um",
                                  "x if x else y um", "[x][0] um", "x um um", "sin(x, y) um", "x Pa", "x", "'x' um",
                                  "x; y um", "exp um", "x*True um", "f'{x}' um", "(x:=1) um", "9**9**9**x um um",
                                  "sin(x=1) um"])
def test_a_formula_that_is_none_is_refused_and_runs_nothing(text: str) -> None:
    with pytest.raises(ValueError):
        Expression(text, "um")


@pytest.mark.parametrize(("sections", "message"), [
    ({"supports": [{"name": "a", "parts": ["surfaec"]}]}, "'Piece' has no part 'surfaec'; did you mean 'surface'?"),
    ({"supports": [{"name": "a", "cells": ["Peice"]}]}, "did you mean 'Piece'?"),
    ({"supports": [{"name": "a b"}]}, "names a column"),
    ({"supports": [{"name": "a"}, {"name": "a"}]}, "is that of another support, plate or probe: 'a'"),
    ({"supports": [{"name": "a", "displacement": ["0.1*z um", "free"]}]}, "'z' is not known"),
    ({"supports": [{"name": "a", "displacement": ["1 um", "fre"]}]}, "fre"),
    ({"supports": [{"name": "a", "box": [["0 um", "0 um"]]}]}, "two opposite corners"),
    ({"supports": [{"name": "a", "load_curve": {"law": "rmp"}}]}, "did you mean 'ramp'?"),
    ({"supports": [{"name": "a", "load_curve": {"law": "ramp"}}]}, "duration"),
    ({"loads": [{"name": "a"}]}, "one of traction, pressure and body"),
    ({"loads": [{"name": "a", "traction": ["1 Pa", "0 Pa"], "pressure": "1 Pa"}]}, "expects one of"),
    ({"loads": {"name": "a"}}, "[[loads]]"),
    ({"loads": [{"name": "a", "body": ["1 Pa/um", "0 Pa/um"], "parts": ["edge-1"]}]}, "acts on all of the cells"),
    ({"plates": [{"name": "a", "point": ["0 um", "0 um"], "normal": [0, 0]}]}, "normal: expects a direction"),
    ({"plates": [{"name": "a", "point": ["0 um", "0 um"], "normal": [0, 1]}], "integrator": "rk"},
     "'rk' has no plates"),
    ({"plates": [{"name": "a", "point": ["0 um", "0.3 um"], "normal": [0, 2]}]}, "behind the face, where nothing"),
    ({"plates": [{"name": "a", "point": ["0 um", "-9 um"], "normal": [0, -1]}]}, "the normal points to where"),
    ({"plates": [{"name": "a", "point": ["0 um", "9 um"], "normal": [0, -1], "displacement": ["0 um", "-9 um"]}]},
     "plates.0.point: 'Piece' begins"),
])
def test_a_mistake_in_a_test_piece_is_told(sections: dict[str, Any], message: str) -> None:
    with pytest.raises(CaseError) as caught:
        piece(**sections)
    assert message in str(caught.value), caught.value


def test_a_plate_may_dent_a_cell_at_the_start_or_come_later() -> None:
    for plate in ({"point": ["0 um", "0.1 um"], "normal": [0, 1]},
                  {"point": ["0 um", "9 um"], "normal": [0, -1], "displacement": ["0 um", "-9 um"],
                   "load_curve": {"law": "ramp", "duration": "1 us"}}):
        piece(plates=[{"name": "a", **plate}])


SINGULAR = [
    ('cells.0.velocity=["1/x um/us", "0 um/us"]', "cells.0.velocity: '1/x um/us'", "it is inf there"),
    ('cells.0.velocity=["0 um/us", "log(r) um/us"]', "cells.0.velocity: 'log(r) um/us'", "it is -inf there"),
    ('cells.0.displacement=["0 um", "sqrt(x) um"]', "cells.0.displacement: 'sqrt(x) um'", "it is nan there"),
    ('loads=[{name="l", traction=["1/x Pa", "0 Pa"]}]', "loads.0.traction: '1/x Pa'", "there"),
    ('loads=[{name="l", pressure="log(x) Pa"}]', "loads.0.pressure: 'log(x) Pa'", "it is -inf there"),
    ('loads=[{name="l", body=["1/r Pa/um", "0 Pa/um"]}]', "loads.0.body: '1/r Pa/um'", "it is inf there"),
    ('supports=[{name="s", displacement=["log(y) um", "free"]}]', "supports.0.displacement: 'log(y) um'", "it is nan"),
]


@pytest.mark.parametrize(("sets", "key", "what"), SINGULAR)
def test_a_formula_without_a_value_at_a_particle_is_told_with_its_key_and_place(sets: str, key: str, what: str) -> None:
    broken = load(CASES["nucleus"], ["particles.per_cell=60", sets])
    with pytest.raises(CaseError) as error, built(broken):
        pass
    assert f"--set {sets}: {key} has no value that can be computed with at (" in str(error.value)
    assert what in str(error.value) and "um from the centre of 'Nucleus'" in str(error.value)


def test_a_formula_in_a_file_is_told_with_its_line_and_all_of_them_at_once(tmp_path: Path) -> None:
    text = CASES["nucleus"].read_text(encoding="utf-8") + 'velocity = ["1/x um/us", "log(r) um/us"]\n'
    (tmp_path / "case.toml").write_text(text.replace("1485", "60"), encoding="utf-8")
    with pytest.raises(CaseError) as error, built(load(tmp_path / "case.toml")):
        pass
    told = str(error.value).splitlines()
    assert len(told) == 2 and all(f"case.toml:{text.count(chr(10))}: cells.0.velocity: '" in line for line in told)


TURNED = ["-2*x um", "0 um"], ["0 um", "-0.6*y**2 um"], ["y um", "x um"]


@pytest.mark.parametrize("displacement", TURNED)
def test_a_displacement_that_turns_a_cell_inside_out_is_told_with_its_line(
        displacement: list[str], tmp_path: Path) -> None:
    text = CASES["nucleus"].read_text(encoding="utf-8") + f"displacement = {json.dumps(displacement)}\n"
    (tmp_path / "case.toml").write_text(text.replace("1485", "60"), encoding="utf-8")
    told = rf"case\.toml:{text.count(chr(10))}: cells\.0\.displacement: turns 'Nucleus' inside out at .* J = "
    with pytest.raises(CaseError, match=told):
        discretise(load(tmp_path / "case.toml"))


def test_a_displacement_that_turns_a_ball_inside_out_is_told() -> None:
    with pytest.raises(CaseError, match=r"displacement: turns 'Cell-1' inside out at .* J = -0\.\d+ there"):
        discretise(case("ball", 'cells.0.displacement=["0 um", "0 um", "-1.5*z um"]', per_cell=60))


def test_a_formula_that_has_a_value_at_all_particles_is_taken() -> None:
    with built(case("nucleus", 'cells.0.velocity=["0.01/(r+1) um/us", "0 um/us"]', per_cell=60)) as sim:
        sim.go(0.1)


BEYOND = 'box=[["8 um", "8 um"], ["9 um", "9 um"]]'


@pytest.mark.parametrize(("sets", "message"), [
    (f'supports=[{{name="s", {BEYOND}}}]', "supports.s.box: holds no particle of the surface of"),
    (f'loads=[{{name="l", pressure="1 Pa", {BEYOND}}}]', "loads.l.box: holds no whole piece of the surface of"),
    (f'probes=[{{name="p", {BEYOND}}}]', "probes.p.box: holds no whole piece of the surface of"),
    ('probes=[{name="p", point=["95 um", "0 um"]}]', "probes.p.point: is outside of 'Nucleus', whose nearest")])
def test_what_is_nowhere_on_its_cell_is_refused(sets: str, message: str) -> None:
    with pytest.raises(CaseError) as error, built(case("nucleus", sets, per_cell=60)):
        pass
    assert message in str(error.value) and "from the cell's centre" in str(error.value)


def test_a_load_curve_without_a_value_is_told_with_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(laws("load_curve")["ramp"], "value", lambda self, t: 1.0 / (t - 10.0) if t != 10.0 else np.inf)
    broken = load(CASES["nucleus"], ["particles.per_cell=60", 'loads=[{name="l", traction=["1 Pa", "0 Pa"], '
                                     'load_curve={law="ramp", duration="1 us"}}]'])
    with pytest.raises(CaseError, match=r"loads\.l\.load_curve: has no finite value and rate at 10 us"):
        formulas.check(broken, discretise(case("nucleus", per_cell=60)))


def test_numbers_whose_inverse_cannot_be_computed_with_are_refused() -> None:
    with pytest.raises(CaseError, match=r"load_curve\.duration: expects a number of a size that can be computed with"):
        load(CASES["nucleus"], ['loads=[{name="l", traction=["1 Pa", "0 Pa"], '
                                'load_curve={law="ramp", duration="1e-310 us"}}]'])
