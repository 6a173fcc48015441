"""Many runs of one case: what is varied, what is kept, the table, the picture, the array for a cluster."""

from __future__ import annotations

import csv
import dataclasses
import json
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from scenes import CASES

from cellmig.case.messages import CaseError
from cellmig.commands import sweep as command
from cellmig.commands import validate
from cellmig.output.manifest import read_manifest
from cellmig.parallel.options import options_given
from cellmig.runs.sweep import Sweep, _column, _in_a_name, _toml, array_script, sweep, variation
from cellmig.usage import UsageError, parse
from cellmig.version import __version__

pytestmark = pytest.mark.serial

ONE = CASES["one_cell"]
COARSE = ("particles.per_cell=60", "time.end=1 us", "time.samples=2", "time.frames=1")


@pytest.mark.parametrize(("text", "key", "values"), [
    ("a.b=1,2,4", "a.b", (1, 2, 4)),
    ("a.b=0.5, 1e-3", "a.b", (0.5, 1e-3)),
    ("a.b=1,2,4 kPa", "a.b", ("1 kPa", "2 kPa", "4 kPa")),
    ("a.b=900 Pa, 2 kPa", "a.b", ("900 Pa", "2 kPa")),
    ("a.b=7,1.5,1e-3,many", "a.b", (7, 1.5, 1e-3, "many")),
    ("seed=1:3", "seed", (1, 2, 3)),
    ("time.integrator=leapfrog,rk", "time.integrator", ("leapfrog", "rk")),
    ('cells=["Cell-1"],["Cell-1","Cell-2"]', "cells", (["Cell-1"], ["Cell-1", "Cell-2"])),
])
def test_what_is_varied_is_read_with_its_unit(text, key, values):
    assert variation(text) == (key, values)


@pytest.mark.parametrize("text", ["a.b", "=1,2", "a.b=", "a.b=1,,x", "seed=8:1"])
def test_what_varies_nothing_is_refused(text):
    with pytest.raises(ValueError, match=r"KEY=|no values|empty"):
        variation(text)


def test_a_key_that_is_varied_twice_is_a_wrong_call():
    with pytest.raises(UsageError, match="'seed' is given twice"):
        command(parse(["sweep", str(ONE), "--vary", "seed=1:2", "--vary", "seed=5"]))


def test_a_value_that_does_not_suit_is_told_with_its_option_before_anything_runs(tmp_path):
    vary = {"adhesion.substrate.bond_density": ["1 /um^2", "1 um", "-1 /um^2"], "seed": [1, 2]}
    plan = Sweep(ONE, vary, tmp_path / "out", ("particles.per_cel=60",))
    with pytest.raises(CaseError) as error:
        sweep(plan)
    said = [str(mistake).split(": ")[:2] for mistake in error.value.mistakes]
    assert sorted(said) == [["--set particles.per_cel=60", "particles.per_cel"],
                            ['--vary adhesion.substrate.bond_density="-1 /um^2"', "adhesion.substrate.bond_density"],
                            ['--vary adhesion.substrate.bond_density="1 um"', "adhesion.substrate.bond_density"]]
    assert not (tmp_path / "out").exists()


def test_a_former_key_that_is_varied_is_told_with_the_present_one(tmp_path):
    plan = Sweep(ONE, {"adhesion.substrate.bonds": ["1 /um^2"]}, tmp_path / "out")
    with pytest.raises(CaseError, match=r"--vary .*: adhesion.substrate.bonds: is called 'bond_density' now"):
        sweep(plan)


def test_a_column_that_a_run_will_not_have_is_refused_before_anything_runs(tmp_path):
    with pytest.raises(CaseError, match=r"--show: history.csv has no column 'area'; did you mean 'area_um2'\?"):
        sweep(Sweep(ONE, {"seed": [1, 2]}, tmp_path / "out", COARSE), shown=("ux_um", "area"))
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A sweep of two values and two seeds, done."""
    plan = Sweep(ONE, {"adhesion.substrate.bond_density": ["4000 /um^2", "8000 /um^2"], "seed": [1, 2]},
                 tmp_path_factory.mktemp("sweep"), COARSE)
    assert sweep(plan, at_once=2) == 0
    return plan


def table(out: Path) -> list[dict[str, str]]:
    with open(out / "sweep.csv", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_the_table_has_a_row_for_each_run_and_cell(done):
    rows = table(done.out)
    assert len(rows) == 2 * 2 * 2
    assert {row["adhesion.substrate.bond_density [/um^2]"] for row in rows} == {"4000.0", "8000.0"}
    assert {(row["seed"], row["cell"], row["time_us"], row["exit_status"]) for row in rows} == {
        (seed, cell, "1.0", "0") for seed in "12" for cell in "01"}
    assert (Path(rows[0]["directory"]) / "history.csv").exists()
    assert (done.out / "sweep.png").stat().st_size > 10_000 and (done.out / "sweep.pdf").exists()


def test_what_is_done_is_kept_and_more_values_add_runs(done, capsys):
    before = {path: path.stat().st_mtime_ns for path in done.out.rglob("manifest.json")}
    wider = Sweep(done.case, done.vary | {"seed": [1, 2, 3]}, done.out, done.sets)
    assert sweep(wider, at_once=2) == 0
    assert "6 runs; 4 of them are there already" in capsys.readouterr().out
    assert before == {path: path.stat().st_mtime_ns for path in before}
    assert len(list(done.out.rglob("manifest.json"))) == 6


def test_a_run_that_was_stopped_goes_on_in_its_middle_if_it_is_of_the_same_case(tmp_path, outside_mpi):
    plan = Sweep(ONE, {"seed": [1]}, tmp_path, COARSE)
    job, = plan.jobs().values()
    words = [sys.executable, "-m", "cellmig", *job.arguments(), "--wall-time", "1 s"]
    assert subprocess.run(words, env=outside_mpi).returncode == 75
    assert job.is_resumable() and not dataclasses.replace(job, sets=(*job.sets, "seed=2")).is_resumable()
    assert sweep(plan) == 0
    manifest = read_manifest(job.directory)
    assert manifest["exit_status"] == 0 and len(manifest["resumed"]) == 1 and not job.is_resumable()


def test_a_run_that_fails_stops_no_other_and_gives_its_exit_code(tmp_path, capsys):
    plan = Sweep(ONE, {"time.step": ["auto", "100 ns"]}, tmp_path, COARSE)
    assert sweep(plan, at_once=2) == 4
    *good, bad = table(tmp_path)
    assert [(row["time.step"], row["cell"], row["exit_status"], row["cause"]) for row in good] == [
        ("auto", cell, "0", "") for cell in "01"]
    assert (bad["time.step"], bad["cell"], bad["exit_status"], bad["ux_um"]) == ("100 ns", "", "4", "")
    assert "the simulation failed at" in bad["cause"] and Path(bad["directory"]).is_dir()
    ended, small, J, broken = capsys.readouterr().out.splitlines()[-4:]
    assert ended == "1 of 2 runs came to their end" and broken.startswith("step=100_ns ended with exit code 4: the sim")
    assert small.startswith("1 of them with an energy error of 0.5 % or less") and small.endswith("(step=auto)")
    assert [float(good[0][f"J_{end}"]) for end in ("least", "most")] == pytest.approx([1.0, 1.0], abs=0.05)
    assert J.startswith("J from ") and 1.0 < float(good[0]["stretch"]) < 1.6
    told = list(plan.rows(plan.jobs()))[-1]  # as from Python: its manifest tells
    assert told["exit_status"] == 4 and "the simulation failed at" in told["cause"]


def test_lists_of_who_protrudes_are_varied_in_directories_of_their_own(tmp_path):
    plan = Sweep(ONE.with_name("all_protrude.toml"), dict([variation('protrusion.cells=["Cell-1"],["Cell-2"]')]),
                 tmp_path, (*COARSE, "time.end='0.1 us'"))
    assert sweep(plan, at_once=2) == 0
    rows = table(tmp_path)
    assert [row["protrusion.cells"] for row in rows] == ['["Cell-1"]'] * 4 + ['["Cell-2"]'] * 4
    assert len({row["directory"] for row in rows}) == 2
    assert [job.load().protrusion.cells for job in plan.jobs().values()] == [("Cell-1",), ("Cell-2",)]


@pytest.mark.parametrize("values", [
    ("x*10 Pa", "x/10 Pa", "x+10 Pa", "x-10 Pa"), ("4 /um", "4 um", "4_um", "4 um^2", "4 um ", "4um"),
    (1, True, 1.0, "1", "true"), (["a", "b"], ["a b"], ["ab"], [["a"], "b"]), ({"law": "a"}, {"law": ["a"]}, "law a")])
def test_values_that_differ_have_names_that_differ_and_do_not_hang_on_the_others(values):
    names = [_in_a_name(value) for value in values]
    assert len(set(names)) == len(values)
    assert all(re.fullmatch(r"[\w.+^-]+", name) for name in names)


def test_names_of_usual_values_are_plain():
    values = (4000, 0.5, True, "8000 /um^2", "2 kPa", "leapfrog", "1e-3 µm")
    assert [_in_a_name(value) for value in values] == [
        "4000", "0.5", "true", "8000_per_um^2", "2_kPa", "leapfrog", "1e-3_µm"]


@pytest.mark.parametrize(("values", "column", "shown"), [
    (("900 Pa", "2 kPa"), "a.b [Pa]", [900.0, 2000.0]), (("1 kPa", "3 kPa"), "a.b [kPa]", [1.0, 3.0]),
    (("10*x Pa", "10/x Pa"), "a.b", ["10*x Pa", "10/x Pa"]), (("auto", "100 ns"), "a.b", ["auto", "100 ns"]),
    (("1 Pa", "1 um"), "a.b", ["1 Pa", "1 um"]), ((1, 2.5), "a.b", [1, 2.5]), ((["a"], []), "a.b", ['["a"]', "[]"])])
def test_a_column_of_what_is_varied_has_numbers_in_one_unit_or_the_values_as_they_are(values, column, shown):
    name, by_text = _column("a.b", values)
    assert (name, list(by_text.values())) == (column, shown)


@pytest.mark.parametrize("value", [
    1, 0.5, 1e-300, float("inf"), True, "a \"b\" µ", ["x", ["y", 1]], {"law": "a", "k b": [1.5]}])
def test_a_value_is_the_same_after_it_was_written_for_set(value):
    assert tomllib.loads(f"a = {_toml(value)}")["a"] == value


def test_results_of_another_version_do_not_count_and_are_told(tmp_path, capsys):
    plan = Sweep(ONE, {"seed": [1, 2]}, tmp_path, COARSE)
    assert sweep(plan, at_once=2) == 0
    old, _ = plan.jobs().values()
    path = old.directory / "manifest.json"
    path.write_text(re.sub(r'"version": "[^"]*"', '"version": "0.0.1"', path.read_text()))
    assert not old.is_done() and {row["seed"] for row in plan.rows(plan.jobs())} == {2}
    capsys.readouterr()
    assert sweep(plan, at_once=2) == 0
    assert "1 of them are there already; 1 are there of another version" in capsys.readouterr().out
    assert read_manifest(old.directory)["version"] != "0.0.1"
    assert read_manifest(old.directory.with_name("seed=1.1"))["version"] == "0.0.1"


def test_the_array_for_slurm_has_a_task_for_each_run_with_its_words_whole(done, tmp_path):
    script = array_script(Sweep(ONE, done.vary, tmp_path / "a place", COARSE, ranks=4))
    text = script.read_text()
    assert "#SBATCH --array=1-4\n" in text and "#SBATCH --ntasks=4\n" in text
    assert subprocess.run(["bash", "-n", script]).returncode == 0
    stand_in = 'srun() { printf "%s\\n" "$@"; return 75; }; scontrol() { echo "$*"; }; export -f srun scontrol; '
    told = subprocess.run(["bash", "-c", stand_in + f"SLURM_ARRAY_JOB_ID=7 SLURM_ARRAY_TASK_ID=3 bash '{script}'"],
                          text=True, capture_output=True)
    words = told.stdout.splitlines()
    assert told.returncode == 75 and words[-1] == "requeue 7_3"
    assert 'adhesion.substrate.bond_density="8000 /um^2"' in words and "seed=1" in words and str(ONE) in words
    assert words[-3:-1] == ["--resume", "auto"]


def test_runs_under_other_options_of_petsc_do_not_count_as_done(tmp_path):
    job, = Sweep(ONE, {"seed": [1]}, tmp_path, COARSE).jobs().values()
    case = job.load()
    manifest = {"version": __version__, "end_us": case.time.end, "petsc_options": options_given(),
                "case": json.loads(json.dumps(case.resolved()))}
    fixed = {**manifest, "petsc_options": options_given() | {"ts_dt": "1e-4", "log_view": ""}}
    assert job.matches(manifest) and not job.matches(fixed)
    with_step = dataclasses.replace(job, options=("-ts_dt", "1e-4", "-ts_monitor"))
    assert with_step.matches(fixed) and not with_step.matches(manifest)


@pytest.mark.parametrize(("folder", "case"), [("a place", "one cell"), ("100 % \"new\" #1", "it's")])
def test_the_array_for_slurm_quotes_names_with_spaces_and_signs(tmp_path, folder, case):
    (tmp_path / f"{case}.toml").write_text(f'extends = "{ONE}"\n', encoding="utf-8")
    out = tmp_path / folder
    text = array_script(Sweep(tmp_path / f"{case}.toml", {"seed": [1, 2]}, out, COARSE)).read_text(encoding="utf-8")
    directives = dict(word.split("=", 1) for line in text.splitlines() if line.startswith("#SBATCH")
                      for word in shlex.split(line[8:]) if "=" in word)
    assert directives["--job-name"] == f"cellmig-{case}"
    assert directives["--output"] == str(out).replace("%", "%%") + "/task%a.log"


@pytest.mark.parametrize("seconds", [60, 300, 7200])
def test_a_task_of_the_array_stops_before_its_limit_however_short(done, tmp_path, seconds):
    script = array_script(Sweep(ONE, done.vary, tmp_path, COARSE))
    told = subprocess.run(["bash", "-c", f'srun() {{ echo "${{@: -1}}"; }}; export -f srun; SLURM_ARRAY_TASK_ID=1 '
                           f"SLURM_JOB_END_TIME=$(($(date +%s) + {seconds})) bash '{script}'"],
                          text=True, capture_output=True)
    number, unit = told.stdout.split()
    assert unit == "s" and 0.8 * seconds < int(number) <= seconds - min(0.1 * seconds, 300)


def test_a_sweep_can_end_all_its_runs_earlier(tmp_path):
    plan = Sweep(ONE, {"seed": [1, 2]}, tmp_path, COARSE, until=0.5)
    assert sweep(plan, at_once=2) == 0
    assert {row["time_us"] for row in table(tmp_path)} == {"0.5"}
    assert all(job.is_done() for job in plan.jobs().values())
    assert not any(job.is_done() for job in dataclasses.replace(plan, until=0.6).jobs().values())


def test_what_is_told_before_is_of_the_end_that_is_asked_for(capsys):
    assert validate(parse(["validate", str(ONE), "--set", "particles.per_cell=60", "--until", "4 us"])) == 0
    said = capsys.readouterr().out
    assert " to 4 µs" in said and "in 2 frames" in said
