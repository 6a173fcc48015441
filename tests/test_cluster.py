"""Scripts for clusters and for ParaView: what they start, with stand-ins for Slurm, PBS and mpiexec."""

from __future__ import annotations

import os
import py_compile
import re
import shlex
import shutil
import subprocess
import time
from pathlib import Path

import pytest
from scenes import CASES, ROOT

import cellmig

pytestmark = pytest.mark.serial

SCRIPTS = sorted((ROOT / "cluster").glob("*.sh"))
STAND_IN = "#!/bin/bash\necho \"$(basename \"$0\"): $*\"\nexit ${CODE-0}\n"


@pytest.fixture
def submit(tmp_path: Path):
    """`submit("slurm.sh", "case.toml", SLURM_JOB_ID="7")`: what the script starts, and how it ends."""
    for name in ("srun", "scontrol", "mpiexec", "qsub", "qstat"):
        (tmp_path / name).write_text(STAND_IN)
        (tmp_path / name).chmod(0o755)

    def start(script: str, *arguments: str, **environment: str) -> tuple[list[str], int]:
        path = {"PATH": f"{tmp_path}:{os.environ['PATH']}", "CELLMIG": "cellmig"}
        done = subprocess.run(["bash", ROOT / "cluster" / script, *arguments], env=path | environment, text=True,
                              cwd=tmp_path, capture_output=True)
        return done.stdout.splitlines() + done.stderr.splitlines(), done.returncode

    return start


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_a_batch_script_is_read_by_bash_and_shellcheck(script: Path) -> None:
    assert script.stat().st_mode & 0o111
    assert subprocess.run(["bash", "-n", script]).returncode == 0
    if shutil.which("shellcheck"):
        found = subprocess.run(["shellcheck", script], capture_output=True, text=True)
        assert found.returncode == 0, found.stdout


def test_slurm_goes_on_and_stops_before_the_limit(submit) -> None:
    lines, code = submit("slurm.sh", "case.toml", "-ts_dt", "1e-3", SLURM_JOB_ID="7",
                         SLURM_JOB_END_TIME=str(int(time.time()) + 3600))
    start, _, rest = lines[0].partition(" --wall-time ")
    assert (start, code) == ("srun: cellmig run case.toml -ts_dt 1e-3", 0) and len(lines) == 1
    assert rest.endswith(" s --resume auto") and 3290 < int(rest.split()[0]) <= 3300


def test_slurm_queues_again_what_was_stopped_and_nothing_else(submit) -> None:
    array = {"SLURM_JOB_ID": "7", "SLURM_ARRAY_JOB_ID": "5", "SLURM_ARRAY_TASK_ID": "3"}
    lines, code = submit("slurm.sh", "cases/case.toml", CODE="75", **array)
    assert lines == ["srun: cellmig run cases/case.toml --set seed=3 --out output/case-seed3 --resume auto",
                     "scontrol: requeue 5_3"] and code == 75
    assert submit("slurm.sh", "case.toml", CODE="75", SLURM_JOB_ID="7")[0][1] == "scontrol: requeue 7"
    assert submit("slurm.sh", "case.toml", CODE="4", SLURM_JOB_ID="7") == (
        ["srun: cellmig run case.toml --resume auto"], 4)


def test_pbs_goes_on_and_queues_again_what_was_stopped(submit) -> None:
    lines, code = submit("pbs.sh", CASE="a/case.toml", OPTIONS="--until 9us", CODE="75", PBS_ARRAY_INDEX="2")
    assert lines == [
        "mpiexec: cellmig run a/case.toml --until 9us --set seed=2 --out output/case-seed2 --resume auto "
        "--wall-time 14100 s",
        "qsub: -v CASE=a/case.toml,OPTIONS=--until 9us --set seed=2 --out output/case-seed2 cluster/pbs.sh"]
    assert code == 75
    assert submit("pbs.sh")[1] == 2


@pytest.mark.parametrize(("seconds", "wall"), [(60, 54), (300, 270), (3600, 3300)])
def test_a_short_batch_job_has_a_wall_time_within_its_limit(submit, seconds: int, wall: int) -> None:
    lines, code = submit("slurm.sh", "case.toml", SLURM_JOB_ID="7", SLURM_JOB_END_TIME=str(int(time.time()) + seconds))
    told = int(lines[0].partition(" --wall-time ")[2].split()[0])
    assert code == 0 and wall - 5 <= told <= wall
    assert f"--wall-time {wall} s" in submit("pbs.sh", CASE="case.toml", PBS_WALLTIME=str(seconds))[0][0]


def test_words_with_spaces_stay_whole_in_a_chain_of_pbs_jobs(submit) -> None:
    given = {"CASE": "a b/my case.toml", "OPTIONS": "--until '9 us'", "PBS_ARRAY_INDEX": "2"}
    lines, _ = submit("pbs.sh", CODE="75", **given)
    again = lines[1].partition("OPTIONS=")[2].rpartition(" ")[0]
    assert shlex.split(again) == ["--until", "9 us", "--set", "seed=2", "--out", "output/my case-seed2"]
    assert submit("pbs.sh", CASE=given["CASE"], OPTIONS=again)[0][0] == lines[0]


def test_a_container_gets_what_the_checkout_has() -> None:
    docker, apptainer = (ROOT / "Dockerfile").read_text(), (ROOT / "cluster/cellmig.def").read_text()
    for text in (docker, apptainer):
        assert re.search(r"debian:(13|\$\{DEBIAN\})-slim", text) and "/opt/cellmig/run doctor" in text
    assert {".venv", "output", ".git"} <= set((ROOT / ".dockerignore").read_text().split())


def test_the_script_for_paraview_compiles(tmp_path: Path) -> None:
    py_compile.compile(str(ROOT / "docs/paraview/open_run.py"), str(tmp_path / "made"), doraise=True)


@pytest.mark.slow  # two virtual displays that start at once may get the same number
@pytest.mark.skipif(not (shutil.which("pvpython") and shutil.which("xvfb-run")),
                    reason="no ParaView here: apt install python3-paraview xvfb")
def test_paraview_draws_a_run(tmp_path: Path) -> None:
    case = cellmig.change(cellmig.load(CASES["one_cell"]), {
        "particles.per_cell": 100, "time.end": "2 us", "time.frames": 2})
    cellmig.run(case, out=tmp_path / "run", quiet=True)
    words = ["xvfb-run", "-a", "pvpython", ROOT / "docs/paraview/open_run.py", tmp_path / "run"]
    for field in ("effective_stress", "u"):
        picture = tmp_path / f"{field}.png"
        done = subprocess.run([*words, "--field", field, "--picture", picture], capture_output=True, text=True,
                              timeout=120)
        assert done.returncode == 0 and picture.stat().st_size > 10_000, done.stderr
