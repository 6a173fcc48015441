"""How ranks are started: by either Open MPI, under another launcher, in a folder with modules of its own."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from scenes import CASES, ROOT

from cellmig import usage
from cellmig.output.manifest import read_manifest
from cellmig.parallel import launch
from cellmig.parallel.launch import outside_mpi

pytestmark = pytest.mark.serial

SMALL = ("--set", "particles.per_cell=60", "--until", "0.1 us", "--quiet")
RULE = "-" * 74
# What Open MPI 4 says of a program that ends with another code than 0, and 5 of one that it cannot start.
ENDED = f"{RULE}\nmpiexec detected that one or more processes exited with non-zero status, thus causing\n{RULE}"
REFUSED = f"{RULE}\nThere are not enough slots available in the system\n{RULE}"


@pytest.fixture
def started_by(tmp_path: Path, on_ranks: Callable) -> Callable[[str], subprocess.CompletedProcess[str]]:
    """`started_by(script)`: nine ranks by a stand-in for mpiexec, in Bash."""

    def start(script: str) -> subprocess.CompletedProcess[str]:
        path = tmp_path / "mpiexec.openmpi"
        path.write_text(f"#!/bin/bash\n{script}\n")
        path.chmod(0o755)
        return on_ranks(9, "-c", "", env={"PATH": f"{tmp_path}:{os.environ['PATH']}"})

    return start


@pytest.mark.parametrize(("script", "code", "said"), [
    (f"echo '{REFUSED}' >&2; exit 1", 3, ["enough slots", "could not start 9 ranks"]),
    (f"echo '{REFUSED}' >&2; exit 213", 3, ["enough slots", "exit code was 213"]),
    ("exit 1", 3, ["could not start 9 ranks"]),
    (f"[[ $* == *mpi4py* ]] && exit; echo '{ENDED}' >&2; exit 1", 1, []),  # the program's own code
    (f"echo 'cellmig: wrong' >&2; echo '{ENDED}' >&2; exit 2", 2, ["cellmig: wrong"]),
    ("kill -9 $$", 137, []),
])
def test_where_ranks_cannot_start_there_is_a_reason_and_exit_code_3(started_by, script, code, said) -> None:
    done = started_by(script)
    assert done.returncode == code
    assert all(part in done.stderr for part in said) and "non-zero" not in done.stderr
    assert bool(done.stderr) == bool(said)


def test_a_transport_that_is_not_there_has_open_mpis_reason(cellmig: Callable) -> None:
    done = cellmig(2, CASES["one_cell"], *SMALL, env={"OMPI_MCA_btl": "nosuch"})
    assert done.returncode == 3 and "nosuch" in done.stderr and "could not start 2 ranks" in done.stderr


def test_there_may_be_more_ranks_than_cores_and_they_say_nothing_of_their_own(on_ranks: Callable) -> None:
    many = len(os.sched_getaffinity(0)) + 1
    done = on_ranks(many, "-c", "from mpi4py import MPI; print(MPI.COMM_WORLD.allreduce(1))")
    assert (done.stdout.count(str(many)), done.stderr) == (many, "")


def test_what_a_launcher_tells_its_ranks_is_kept_from_their_children(monkeypatch: pytest.MonkeyPatch) -> None:
    told = ["OMPI_COMM_WORLD_SIZE", "OMPI_UNIVERSE_SIZE", "OMPI_MCA_ess_base_vpid", "OMPI_MCA_orte_hnp_uri",
            "OMPI_MCA_PREFIXES", "OMPI_MCA_num_procs", "PMIX_RANK", "PMI_SIZE", "PRTE_LAUNCHED", "MPI_LOCALNRANKS",
            "SLURM_STEP_NUM_TASKS", "SLURM_PROCID"]
    own = ["OMPI_MCA_btl", "OMPI_MCA_orte_default_hostfile", "PRTE_MCA_plm", "OMPI_ALLOW_RUN_AS_ROOT", "SLURM_JOB_ID"]
    for name in told + own:
        monkeypatch.setenv(name, "7")
    left = outside_mpi()
    assert not set(told) & set(left) and all(left[name] == "7" for name in own)


@pytest.mark.slow
def test_a_sweep_on_ranks_runs_though_it_is_on_ranks_itself(cellmig: Callable, tmp_path: Path) -> None:
    done = cellmig(2, "sweep", CASES["one_cell"], "--vary", "seed=1:2", "--ranks", "2", *SMALL[:2],
                   "--set", "time.end=0.1 us", "--out", tmp_path / "sweep")
    assert (done.returncode, done.stderr) == (0, "")
    runs = [read_manifest(run) for run in (tmp_path / "sweep/runs").iterdir()]
    assert [(run["ranks"], run["exit_status"]) for run in runs] == [(2, 0)] * 2


# ------------------------------------------------------------------------------------------- ranks that do not meet


def alone(cwd: Path, env: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """A small run on one rank."""
    command = [*launch.PYTHON, "-m", "cellmig", CASES["one_cell"], *SMALL, "--out", "run"]
    return subprocess.run(command, cwd=cwd, env=launch.outside_mpi() | env, capture_output=True, text=True)


@pytest.mark.parametrize(("told", "name"), [
    ({"PMI_SIZE": "2", "PMI_RANK": "0", "MPI_LOCALNRANKS": "2"}, "PMI_SIZE and MPI_LOCALNRANKS"),
    ({"OMPI_COMM_WORLD_SIZE": "2", "OMPI_COMM_WORLD_RANK": "0"}, "OMPI_COMM_WORLD_SIZE"),
    ({"SLURM_STEP_ID": "0", "SLURM_STEP_NUM_TASKS": "2", "SLURM_PROCID": "0"}, "SLURM_STEP_NUM_TASKS"),
    ({"SLURM_STEP_ID": "0", "SLURM_NTASKS": "2", "SLURM_PROCID": "0"}, "SLURM_NTASKS"),
])
def test_whole_copies_that_a_foreign_launcher_starts_are_refused(tmp_path, told: dict[str, str], name: str) -> None:
    done = alone(tmp_path, told)
    assert done.returncode == 3 and not (tmp_path / "run").exists()
    assert all(said in done.stderr for said in ("one of 2 ranks", "srun --mpi=pmix", f"unset {name}"))


@pytest.mark.parametrize("told", [
    {"SLURM_JOB_ID": "7", "SLURM_NTASKS": "4", "SLURM_PROCID": "0"},  # a batch script's own process, without srun
    {"SLURM_STEP_ID": "0", "SLURM_STEP_NUM_TASKS": "1", "SLURM_NTASKS": "4", "SLURM_PROCID": "0"},  # srun -n 1
    {"PMI_SIZE": "1", "PMI_RANK": "0"},
])
def test_a_run_alone_in_a_larger_allocation_is_none_of_many(tmp_path: Path, told: dict[str, str]) -> None:
    assert alone(tmp_path, told).returncode == 0


# ---------------------------------------------------------------------------------------------- modules of one's own


def test_modules_in_the_current_folder_or_from_elsewhere_do_not_matter(tmp_path: Path) -> None:
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    for name in ("random", "tqdm", "numpy", "cellmig"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('a module of one\\'s own')")
        (foreign / f"{name}.py").write_text("raise SystemExit('a module from elsewhere')")
    env = outside_mpi() | {"PYTHONPATH": str(foreign)}
    for ranks in ("1", "2"):
        done = subprocess.run([ROOT / "run", "-n", ranks, CASES["one_cell"], *SMALL, "--out", f"run{ranks}"],
                              cwd=tmp_path, env=env, capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (0, "")
    done = subprocess.run([Path(sys.executable).with_name("cellmig"), "sweep", CASES["one_cell"], "--vary", "seed=1:2",
                           "--set", "particles.per_cell=60", "--set", "time.end=0.1 us", "--out", "sweep"],
                          cwd=tmp_path, env=outside_mpi(), capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_launcher_starts_from_the_folder_above_the_clone(tmp_path: Path) -> None:
    (tmp_path / "cellmig").symlink_to(ROOT)
    for ranks in ("1", "2"):
        done = subprocess.run(["cellmig/run", "-n", ranks, "cases/one_cell.toml", *SMALL, "--out", f"run{ranks}"],
                              cwd=tmp_path, env=outside_mpi(), capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (0, "")


# ------------------------------------------------------------------------------------------------- how many ranks


@pytest.mark.parametrize(("words", "ranks"), [
    (["cases/one_cell.toml", "--set", "particles.per_cell=2499"], 1),
    (["cases/one_cell.toml", "--set", "particles.per_cell=2500"], 2),
    (["--quiet", "cases/all_protrude.toml"], 2),  # 4,455 particles
    (["cases/all_protrude.toml", "-n", "1"], 1),
])
def test_a_case_is_run_on_as_many_ranks_as_it_is_worth(tmp_path: Path, words: list[str], ranks: int) -> None:
    if len(os.sched_getaffinity(0)) == 1 and "-n" not in words:
        pytest.skip("one core")
    done = subprocess.run([ROOT / "run", *words, "--until", "0.001 us", "--quiet", "--out", tmp_path / "run"],
                          env=outside_mpi(), capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert read_manifest(tmp_path / "run")["ranks"] == ranks


@pytest.mark.parametrize(("ranks", "particles"), [("400", "300"), ("76", "303")])
def test_ranks_that_would_have_nothing_to_do_are_refused_before_they_start(ranks: str, particles: str) -> None:
    done = subprocess.run([ROOT / "run", "-n", ranks, CASES["one_cell"], "--set", f"particles.per_cell={particles}"],
                          env=outside_mpi(), capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.startswith(f"cellmig: -n: {ranks} ranks for {particles} particles") and done.stdout == ""


def test_ranks_that_a_foreign_mpiexec_starts_are_refused_likewise(cellmig: Callable, tmp_path: Path) -> None:
    done = cellmig(3, CASES["one_cell"], "--set", "particles.per_cell=11", "--out", tmp_path / "run")
    assert done.returncode == 2 and done.stderr.count("3 ranks for 11 particles") == 1


def test_an_option_of_mpiexec_is_not_given_to_petsc() -> None:
    done = subprocess.run([*launch.PYTHON, "-m", "cellmig", CASES["one_cell"], "-n", "2"], capture_output=True,
                          env=outside_mpi(), text=True)
    assert done.returncode == 2 and "mpiexec -n 2 cellmig" in done.stderr


# ---------------------------------------------------------------------------------------------------------- the help


@pytest.mark.parametrize("command", ["", *usage.COMMANDS])
def test_help_is_no_wider_than_eighty_columns(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    top = usage.parser()
    choices = next(action.choices for action in top._actions if action.dest == "command")
    text = (choices[command] if command else top).format_help()
    assert 40 < max(map(len, text.splitlines())) <= 80


def test_help_of_the_launcher_is_no_wider_than_eighty_columns() -> None:
    told = subprocess.run([ROOT / "run", "--help"], capture_output=True, text=True)
    assert max(map(len, told.stdout.splitlines())) <= 80


@pytest.mark.parametrize(("words", "first"), [
    (["--quiet", "a.toml"], "a.toml"), (["--out", "b.toml", "a.toml"], "a.toml"), (["--set=x=1", "a.toml"], "a.toml"),
    (["--until", "2 us", "resume", "x"], "resume"), (["info", "a.toml"], "info"), (["a", "b"], "a"),
])
def test_a_case_may_come_after_options(words: list[str], first: str) -> None:
    assert usage.what_first(words)[0] == first and sorted(usage.what_first(words)) == sorted(words)


# ------------------------------------------------------------------------------------------------- the other Debian


@pytest.mark.slow
@pytest.mark.timeout(0)
@pytest.mark.skipif(os.geteuid() != 0 or not shutil.which("debootstrap"), reason="needs root and debootstrap")
def test_all_tests_pass_on_the_other_debian(outside_mpi: dict[str, str]) -> None:
    here = platform.freedesktop_os_release()["VERSION_CODENAME"]
    other = next(suite for suite in ("trixie", "bookworm") if suite != here)
    assert subprocess.run([ROOT / ".ci/other-debian", other, "./run", "test"], env=outside_mpi).returncode == 0
