"""Random scenes end stable, stop with a message or are refused; runs that went wrong are noticed."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scenes import CASES, built, case, outlines

from mpi4py import MPI

from cellmig.case.load import load
from cellmig.case.messages import CaseError
from cellmig.case.registry import laws
from cellmig.geometry.polygons import crossing
from cellmig.meshfree.contact import Surfaces
from cellmig.meshfree.overlap import overlap
from cellmig.runs.batch import Job, JobResult, run_all
from cellmig.runs.run import Run
from cellmig.verify import random_cases, random_hours
from cellmig.verify import random_scenes as stress
from cellmig.verify.random_bodies import SHAPES
from cellmig.verify.random_cases import launch, scene, toml

pytestmark = pytest.mark.serial

JOB = Job("scene", Path("case.toml"), (), Path("run"))
FINE = {"energy_error": 0.01, "J_min": 0.97, "J_max": 1.02, "area": 0.002, "softness": 0.1, "steps": 100,
        "seconds": 1.0, "share": 1.0, "depth": 0.0, "dimension": 2}
SQUARE = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
CLEAN = ("the simulation failed at 0.05 µs: the energy error is 100 %, more than 5 %; particle 43 of cell 1 has "
         "J = 1; the step of 112 ns is 86 times the stable one, which contact sets: take time.step = \"auto\"")


# ------------------------------------------------------------------------------------------------------------- drawing


def test_a_scene_is_the_same_whenever_it_is_drawn() -> None:
    assert [scene(3, k) for k in range(20)] == [scene(3, k) for k in range(20)]
    assert len({json.dumps(scene(3, k)) for k in range(20)} | {json.dumps(scene(4, 0))}) == 21
    assert [launch(3, k) for k in range(20)] == [launch(3, k) for k in range(20)]


def test_all_that_a_case_may_have_is_drawn_and_much_of_it_left_out() -> None:
    drawn, launched = [scene(0, k) for k in range(200)], [launch(0, k) for k in range(200)]
    for key in ("director", "cortex", "friction", "body_force", "protrusion"):
        assert 10 < sum(key in tables for tables in drawn) < 190
    assert 10 < sum("pairs" in tables.get("adhesion", {}) for tables in drawn) < 190
    laws = {tables["director"]["law"] for tables in drawn if "director" in tables}
    plasm = [tables["materials"]["cytoplasm"] for tables in drawn]
    assert laws == {"frozen", "relaxing"} and {p["law"] for p in plasm} == {"nematic", "gel"}
    assert any("eta" in p for p in plasm) and any("zeta" in p for p in plasm)
    assert {ranks for ranks, _ in launched} == {1, 2, 3}
    assert len({tables["time"].get("integrator") for tables in drawn} | {options for _, options in launched}) > 5


@pytest.mark.parametrize("draw", [random_cases, random_hours], ids=["explicit", "overdamped"])
def test_cells_that_protrude_are_guided_in_all_ways(draw: ModuleType) -> None:
    drawn = [tables for number in range(400) if "protrusion" in (tables := draw.scene(0, number))]
    for key in ("polarity", "cues", "fields", "exchange", "substrate"):
        assert 10 < sum(key in tables for tables in drawn) < len(drawn) - 10
    cues = [cue for tables in drawn for cue in tables.get("cues", ())]
    assert {cue["law"] for cue in cues} == set(laws("cue")) and sum("receptors" in cue for cue in cues) > 3
    assert {tables["polarity"]["law"] for tables in drawn if "polarity" in tables} == set(laws("polarity"))
    responses = [tables["substrate"].get("response", {}).get("law") for tables in drawn if "substrate" in tables]
    assert set(responses) - {None} == set(laws("response"))
    for key in ("basal", "gate", "stall"):
        assert any(key in tables["protrusion"] for tables in drawn)
    pushes = [cell["push"] for tables in drawn for cell in tables["cells"] if "push" in cell]
    assert {key for push in pushes for key in push} == {"strength", "direction", "begin", "end"}


def test_scenes_are_cases_or_refused_with_a_message(tmp_path: Path) -> None:
    shapes, cells, refused = set(), set(), 0
    for number in range(60):
        (tmp_path / "case.toml").write_text(toml(scene(0, number)), encoding="utf-8")
        try:
            drawn = load(tmp_path / "case.toml")
        except CaseError as error:
            refused += 1
            assert str(error)
            continue
        shapes |= {c.shape.law for c in drawn.cells}
        cells.add(len(drawn.cells))
    assert shapes == {"disc", "ellipse", "polygon"} and len(cells) > 6 and 0 < refused < 20


def test_scenes_in_space_have_all_shapes_and_what_is_known_there(tmp_path: Path) -> None:
    shapes, refused = set(), 0
    for number in range(60):
        (tmp_path / "case.toml").write_text(toml(scene(0, number, 3)), encoding="utf-8")
        try:
            drawn = load(tmp_path / "case.toml")
        except CaseError as error:
            refused += 1
            assert "not there in three dimensions" not in str(error)
            continue
        assert drawn.dimension == 3 and not launch(0, number, 3)[1]
        shapes |= {c.shape.law for c in drawn.cells}
    assert shapes == set(SHAPES) and 0 < refused < 30


def test_a_scene_in_space_is_run_and_measured(tmp_path: Path) -> None:
    job = stress.prepare(tmp_path, 0, 17, (), 3)
    ended, = run_all([job], 1, limit=100.0)
    numbers, outlines = stress.measure(ended)
    assert stress.judge(ended, numbers, outlines).ended == "stable"
    assert numbers["depth"] == 0.0 and 0.0 < abs(numbers["area"]) < 0.01  # measured 1e-4
    assert stress.judge(ended, numbers | {"depth": 0.1}, outlines).ended == "bad"


@pytest.mark.parametrize("dimension", [2, 3])
def test_overdamped_scenes_are_cases_of_many_kinds(tmp_path: Path, dimension: int) -> None:
    shapes, laws, alone, ends = set(), set(), 0, []
    for number in range(40):
        assert random_hours.scene(1, number, dimension) == random_hours.scene(1, number, dimension)
        (tmp_path / "case.toml").write_text(toml(random_hours.scene(1, number, dimension)), encoding="utf-8")
        drawn = load(tmp_path / "case.toml")  # none is refused
        assert drawn.overdamped and drawn.dimension == dimension
        shapes |= {c.shape.law for c in drawn.cells}
        laws |= {drawn.materials["cytoplasm"].law, drawn.friction.law if drawn.friction else "none"}
        alone += drawn.medium is None
        ends.append(drawn.time.end)
    assert shapes == set(random_hours.SHAPES[dimension]) and 0 < alone < 40
    assert laws == {"nematic", "gel", "maxwell", "bonds", "bell", "none"}
    assert min(ends) < 10e6 and max(ends) > 3600e6
    launched = [random_hours.launch(1, number) for number in range(100)]
    assert {ranks for ranks, _ in launched} == {1, 2, 3} and len({options for _, options in launched}) == 3


def test_an_overdamped_scene_is_run_and_measured(tmp_path: Path) -> None:
    job = stress.prepare(tmp_path, 2, 10, (), overdamped=True)
    ended, = run_all([job], 1, limit=200.0)
    numbers, outlines = stress.measure(ended)
    assert stress.judge(ended, numbers, outlines).ended == "stable"
    assert numbers["share"] == 1.0 and numbers["energy_error"] < 1e-6  # measured 5e-8


def test_toml_holds_what_it_was_made_from(tmp_path: Path) -> None:
    many = [scene(0, number) for number in range(99)]
    for tables in (scene(0, 1), next(t for t in many if "pairs" in t.get("adhesion", {})),
                   next(t for t in many if any("push" in cell for cell in t["cells"]))):
        assert tomllib.loads(toml(tables)) == tables


def test_a_change_is_made_to_every_scene(tmp_path: Path) -> None:
    jobs = [stress.prepare(tmp_path, 0, number, ("materials.cytoplasm.stabilisation=2",)) for number in (1, 2)]
    assert {job.load().materials["cytoplasm"].stabilisation for job in jobs} == {2.0}
    assert all("stabilisation=2" in job.command() for job in jobs)


# ----------------------------------------------------------------------------------------------------------- judgement


@pytest.mark.parametrize(("code", "message", "ended"), [
    (0, "", "stable"), (4, CLEAN, "stopped"), (4, "the simulation failed", "bad"), (4, CLEAN.split("; the")[0], "bad"),
    (4, "the simulation failed at 2 h: cell 1, which exchanges with the field c, has left its box at x = 3; make "
        "fields.c.box larger", "stopped"),
    (2, "case.toml:3: cells.0: 'B' overlaps 'A' by 0.1 um", "refused"), (2, "", "bad"),
    (1, "Traceback", "bad"), (-11, "killed by signal 11", "bad"), (-9, "no end within 240 s", "bad"), (75, "", "bad"),
])
def test_how_a_run_ends_is_judged(code: int, message: str, ended: str) -> None:
    verdict = stress.judge(JobResult(JOB, code, message), FINE if code == 0 else {}, [SQUARE] if code == 0 else [])
    assert verdict.ended == ended
    assert verdict.command == "cellmig run case.toml --out run --quiet"


@pytest.mark.parametrize(("sets", "load"), [
    ((), 0.8 * 240.0 / 0.01), (("materials.cytoplasm.zeta='-1 MPa'",), 1e6),
    (("cortex.line_tension='1e5 pN/um'",), 1e5 / 0.7236), (("body_force.acceleration=['0 m/s^2', '-1e8 m/s^2']",), 1e6),
    (("director.law=frozen", "director.start=radial"), 5e4 / 0.7236**2), (("director.law=frozen",), 24e3),
])
def test_how_soft_a_case_is_follows_from_its_loads(sets: tuple, load: float) -> None:
    soft = case("one_cell", *sets, "materials.nucleus.volumetric_modulus='10 MPa'")
    assert stress.softness(soft) == pytest.approx(max(load, 24e3) / 5e6, rel=0.01)


@pytest.mark.parametrize(("numbers", "outlines", "why"), [
    ({"energy_error": 0.06}, [], "energy error"), ({"energy_error": np.nan}, [], "not finite"),
    ({"J_min": -0.1}, [], "J from"),
    ({"J_min": 0.69}, [], "J from"), ({"J_max": 1.31}, [], "J from"), ({"area": 0.05}, [], "area"),
    ({"depth": 0.03}, [], "a cell is 0.03 of its size within another"), ({"area": 0.09, "dimension": 3}, [], "volume"),
    ({}, [SQUARE[[0, 2, 1, 3]]], "cell 1 crosses itself"),
    ({}, [SQUARE, SQUARE + np.array([3.0, 0.5])], "cell 1 is 0.5 um within cell 2"),
])
def test_a_run_to_its_end_is_not_trusted(numbers: dict, outlines: list, why: str) -> None:
    verdict = stress.judge(JobResult(JOB, 0), FINE | numbers, outlines)
    assert verdict.ended == "bad" and why in verdict.why


def test_the_table_tells_what_to_run_again() -> None:
    verdicts = [stress.judge(JobResult(JOB, 0), FINE, [SQUARE]), stress.judge(JobResult(JOB, 1, "Traceback"), {}, [])]
    lines = stress.table(verdicts)
    assert lines[0].split() == ["stable", "1"] and lines[3].split() == ["bad", "1"]
    assert lines[-2:] == ["scene: exit code 1, Traceback", "    cellmig run case.toml --out run --quiet"]


@pytest.mark.parametrize("ranks", [1, 2])
def test_a_run_that_does_not_end_is_killed(tmp_path: Path, ranks: int) -> None:
    job = Job("long", CASES["all_protrude"], (), tmp_path / "long", ranks=ranks)
    ended, = run_all([job], 1, limit=1.0)
    assert ended.code and ended.message == "no end within 1 s"
    assert job.command().startswith("mpiexec -n 2 cellmig run" if ranks == 2 else "cellmig run")


# ------------------------------------------------------------------------------------------------- runs notice it alone


def test_a_run_whose_energy_does_not_add_up_ends_with_exit_code_4(tmp_path: Path) -> None:
    broken = case("one_cell", 'time.step="40 ns"', 'time.end="4 us"')
    run = Run(broken, tmp_path / "run", MPI.COMM_WORLD, quiet=True)
    assert run.go() == 4
    cause = json.loads((tmp_path / "run/manifest.json").read_text())["cause"]
    assert stress.CLEAN.search(cause) and 'take time.step = "auto"' in cause


def test_without_pruning_a_scene_without_substrate_may_lie_anywhere(tmp_path: Path) -> None:
    hashes = []
    for prune in (True, False):
        run = Run(case("nucleus", 'time.end="0.2 us"'), tmp_path / str(prune), MPI.COMM_WORLD, prune=prune, quiet=True)
        assert run.go() == 0
        hashes.append(json.loads((tmp_path / str(prune) / "manifest.json").read_text())["state_hash"])
    assert hashes[0] == hashes[1]


def test_cells_that_nothing_keeps_apart_end_a_run() -> None:
    with built(case("paper")) as sim:
        s, x = Surfaces.of(sim.scene), outlines(sim)
        assert overlap(s, x, True, True) is None
        apart = np.where(s.cell == 1, 0.4, 0.0)[:, None] * [1.0, 0.0]
        found = overlap(s, x + apart, True, False)
        assert "cell 1 and cell 2 overlap by 0.3" in found.cause and "static" in found.remedy
        assert "below the substrate" in overlap(s, x - [0.0, 0.5], True, True).cause
        assert overlap(s, x - [0.0, 0.5], False, True) is None
        landed = x.copy()  # on its neighbour, as where a membrane lies down on the substrate: no fold
        landed[6] = x[5] - 1e-3 * (x[6] - x[5])
        assert crossing(landed[s.cell == 0]) is not None and overlap(s, landed, False, True) is None
        turned = x.copy()
        turned[5] += 3.0 * (np.mean(x[s.cell == 0], axis=0) - x[5])  # through the cell and out on the other side
        found = overlap(s, turned, False, True)
        assert "the outline of cell 1 crosses itself" in found.cause and sim.scene.cell[found.particle] == 0


# ------------------------------------------------------------------------------------------------------------- the set


def verify(out: Path, *options: object) -> dict:
    done = subprocess.run([sys.executable, "-m", "cellmig", "verify", "--out", out, *map(str, options)], text=True,
                          capture_output=True)
    assert done.returncode == 0, done.stdout + done.stderr
    scenes = json.loads((out / "stress.json").read_text())["scenes"]
    assert not [s for s in scenes if s["ended"] == "bad"]
    return scenes


def test_six_scenes_end_as_they_may(tmp_path: Path) -> None:
    assert len(verify(tmp_path, "--stress", 6, "--seed", 57)) == 6


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_hundred_scenes_end_as_they_may(tmp_path: Path) -> None:
    assert len(verify(tmp_path, "--stress", 100, "--seed", 2)) == 100
