"""The program as its users start it: what a run leaves, how it ends, and what it says when something is wrong."""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest
from scenes import CASES

from cellmig.kernel import toolchain as compiler
from cellmig.output.manifest import read_manifest
from cellmig.output.tables import HISTORY, LEDGER, MOTION, read_table
from cellmig.output.xdmf import frames
from cellmig.parallel.launch import on_ranks
from cellmig.plot.view import _on_substrate

pytestmark = pytest.mark.serial

COARSE = ("--set", "particles.per_cell=150")
SHORT = (*COARSE, "--until", "0.1 us")
PAPER = CASES["all_protrude"]
PARTICLES = 450

Ended = subprocess.CompletedProcess


@pytest.fixture(scope="module")
def alone(cellmig: Callable[..., Ended]) -> Callable[..., Ended]:
    """`alone("info", …)`: the program in one process, without mpiexec."""
    return partial(cellmig, 1)


@pytest.fixture(scope="module")
def runs(cellmig: Callable[..., Ended], tmp_path_factory: pytest.TempPathFactory) -> dict[int | str, Path]:
    """A short run of the paper's scene on 1, 2, 3 and 4 ranks, and on 2 without pruning."""
    home = tmp_path_factory.mktemp("runs")
    made = {}
    for name, ranks, more in [(1, 1, ()), (2, 2, ()), (3, 3, ()), (4, 4, ()), ("whole", 2, ("--no-prune",))]:
        made[name] = home / f"run-{name}"
        done = cellmig(ranks, PAPER, *SHORT, *more, "--out", made[name])
        assert (done.returncode, done.stderr) == (0, ""), done
    return made


@pytest.fixture(scope="module")
def nucleus(alone: Callable[..., Ended], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short run of the elastic disc."""
    directory = tmp_path_factory.mktemp("nucleus") / "run"
    assert alone(CASES["nucleus"], *SHORT, "--out", directory).returncode == 0
    return directory


def refused(ended: Ended, code: int, *parts: str) -> None:
    """Whether a call ended with this code and one message that has these parts."""
    assert ended.returncode == code, ended
    assert ended.stderr.startswith("cellmig: ") and ended.stderr.count("cellmig: ") == 1, ended.stderr
    assert "Traceback" not in ended.stderr and "PETSC ERROR" not in ended.stderr, ended.stderr
    for part in parts:
        assert part in ended.stderr


# --------------------------------------------------------------------------------------------------- what a run leaves


def test_a_run_has_the_same_bits_on_1_to_4_ranks_and_without_pruning(runs):
    hashes = {name: read_manifest(run)["state_hash"] for name, run in runs.items()}
    assert len(set(hashes.values())) == 1 and len(hashes[1]) == 64, hashes
    assert len({read_manifest(run)["worst_energy_error"] for name, run in runs.items() if name != "whole"}) == 1


@pytest.mark.parametrize("ranks", [1, 2, 3, 4])
def test_a_run_leaves_the_files_of_the_contract(runs, ranks):
    run = runs[ranks]
    names = [f"rank{rank:04d}" for rank in range(ranks)]
    assert {path.name for path in run.iterdir()} == {"cells.xdmf", "history.csv", "ledger.csv", "substrate.csv",
                                                     "neighbours.csv", "manifest.json", "run.log", "checkpoint", *names,
                                                     *(f"{name}.xdmf" for name in names)}
    assert (run / "history.csv").read_text().splitlines()[0] == (
        "time_us,cell,x_um,y_um,ux_um,uy_um,substrate_contact_um,cell_contact_um,area_um2,perimeter_um,"
        "effective_stress_pa,sigma11_lower_centre_pa,vx_um_per_us,vy_um_per_us,speed_um_per_us,neighbours,name")
    assert (run / "ledger.csv").read_text().splitlines()[0] == (
        "time_us,kinetic_pn,elastic_pn,compression_pn,director_pn,adhesion_substrate_pn,adhesion_cells_pn,"
        "external_work_pn,viscous_loss_pn,network_loss_pn,friction_loss_pn,medium_loss_pn,artificial_dissipation_pn,"
        "renewal_loss_pn,energy_error")


def test_the_tables_have_a_row_for_every_sample_and_cell_and_the_ledger_closes(runs):
    history, ledger = (read_table(runs[2] / name) for name in ("history.csv", "ledger.csv"))
    assert tuple(history) == (*HISTORY[2], *MOTION[2], "neighbours", "name") and tuple(ledger) == LEDGER[2]
    assert history["name"].tolist() == ["all", "Cell-1", "Cell-2", "Cell-3"] * 2
    assert all(np.isnan(history[name]).tolist() == [True] * 4 + [False] * 4 for name in MOTION[2])
    assert history["cell"].tolist() == [0, 1, 2, 3] * 2
    assert ledger["time_us"].tolist() == [0.0, 0.1]
    assert all(np.isfinite(history[name]).all() for name in HISTORY[2])
    assert all(np.isfinite(column).all() for column in ledger.values())
    assert np.allclose(history["area_um2"][1:4], np.pi * 25, rtol=0.02)
    assert ledger["energy_error"].max() < 0.01
    assert ledger["kinetic_pn"][1] > 0 > ledger["external_work_pn"][1] - abs(ledger["adhesion_substrate_pn"][1])


def test_a_frame_has_all_fields_of_every_particle_on_some_rank(runs):
    fields: dict[str, list[np.ndarray]] = {}
    for rank in range(3):
        with meshio.xdmf.TimeSeriesReader(runs[3] / f"rank{rank:04d}.xdmf") as reader:
            points, _ = reader.read_points_cells()
            moment, data, _ = reader.read_data(reader.num_steps - 1)
        assert moment == 0.1 and len(points) == len(data["id"])
        for name, values in data.items():
            fields.setdefault(name, []).append(values)
    whole = {name: np.concatenate(parts) for name, parts in fields.items()}
    assert whole.keys() >= {"id", "cell", "material", "X", "u", "v", "stress", "effective_stress", "J", "pressure",
                            "adhesion_force", "contact_force", "protrusion_force"}
    assert sorted(whole["id"].ravel()) == list(range(PARTICLES))
    index = (runs[3] / "cells.xdmf").read_text(encoding="utf-8")
    assert '<Attribute Name="v" AttributeType="Vector" Center="Node" Unit="um/us">' in index
    assert all(np.isfinite(values).all() for values in whole.values())
    assert {name: values.size // PARTICLES for name, values in whole.items() if values.size > PARTICLES} == {
        "X": 3, "u": 3, "v": 3, "stress": 9, "adhesion_force": 3, "contact_force": 3, "protrusion_force": 3}
    assert np.allclose(whole["J"], 1.0, atol=0.02) and whole["effective_stress"].max() > 0
    assert np.unique(whole["cell"]).tolist() == [1, 2, 3] and np.unique(whole["material"]).tolist() == [0, 1]
    assert np.abs(whole["adhesion_force"]).max() > 0 and np.abs(whole["protrusion_force"]).max() > 0


def test_a_frame_lacks_the_fields_that_the_scene_has_not(nucleus):
    assert not {"director", "adhesion_force", "contact_force", "protrusion_force"} & frames(nucleus)[-1].units().keys()


def test_the_manifest_tells_what_the_run_was_and_did(runs):
    manifest = read_manifest(runs[3])
    assert manifest["case"]["particles"]["per_cell"] == 150 and manifest["ranks"] == 3 and manifest["seed"] == 2019
    assert (manifest["exit_status"], manifest["time_us"], manifest["particles"]) == (0, 0.1, PARTICLES)
    assert manifest["steps"] == sum(manifest["steps_by_mechanism"].values()) > 0
    assert manifest["steps"] * manifest["dt_us"]["most"] == pytest.approx(0.1)
    assert manifest["dt_set_by"] in manifest["steps_by_mechanism"]
    assert manifest["wall_seconds"] > 0 and manifest["ns_per_particle_step"] > 0
    assert "active stress (zeta)" in manifest["skipped"] and manifest["unused_options"] == []
    assert manifest.keys() >= {"cellmig", "petsc", "mpi", "python", "numpy", "state_hash", "worst_energy_error"}


def test_a_second_run_moves_the_first_aside(nucleus, alone):
    before = read_manifest(nucleus)
    assert alone(CASES["nucleus"], *SHORT, "--out", nucleus, "--quiet").stdout == ""
    assert read_manifest(nucleus.with_name("run.1")) == before
    assert f"; what was there is now in {nucleus}.1\n" in (nucleus / "run.log").read_text()
    assert read_manifest(nucleus)["state_hash"] == before["state_hash"]


def test_the_log_is_the_same_on_screen_and_in_the_file_and_starts_within_a_screen(alone, tmp_path):
    done = alone(PAPER, *SHORT, "--out", tmp_path / "run")
    assert (tmp_path / "run/run.log").read_text() == done.stdout
    lines = done.stdout.splitlines()
    header = next(number for number, line in enumerate(lines) if line.startswith("done: "))
    assert header < 24 and max(map(len, lines)) < 125
    for part in ("450 in 3 cells", "spacing 0.7236 µm", "reduced from 2200 to 5 MPa", "240 pN/µm", "zeta is zero"):
        assert part in done.stdout


# ------------------------------------------------------------------------------------------ what is wrong with the call


@pytest.mark.parametrize(("call", "parts"), [
    (["nowhere.toml"], ["nowhere.toml", "no such file"]),
    ([PAPER, "--utnil", "2 us"], ["--utnil"]),
    ([PAPER, "--set", "particles.per_cel=3"], ["did you mean 'per_cell'"]),
    ([PAPER, "-ts_type", "arkimex"], ["-ts_type", "'arkimex' splits", "leapfrog, euler, rk, ssp"]),
    ([PAPER, *SHORT, "--quiet", "-ts_dt", "quick"], ["no numeric value"]),
])
def test_a_wrong_call_gets_one_message_from_all_ranks_together(cellmig, tmp_path, call, parts):
    done = cellmig(3, *call, cwd=tmp_path)
    refused(done, 2, *parts)
    assert done.stdout == ""


@pytest.mark.parametrize(("call", "parts"), [
    ([], ["'cellmig cases' lists the cases"]),
    (["validat", "x.toml"], ["did you mean 'validate'"]),
    (["diff", "one"], ["directory", "'cellmig diff --help' tells more"]),
    ([PAPER, "--until", "3"], ["--until", "no unit"]),
    ([PAPER, "--until", "3", "us"], ["'us' after '3' stands alone", '"3 us"']),
    (["validate", PAPER, "--sett", "seed=1"], ["unknown option '--sett'; did you mean '--set'?"]),
    ([PAPER.parent / "all_protrud"], ["no such file; did you mean", "all_protrude.toml"]),
    ([PAPER.parent.parent / "nucleus.toml"], ["no such file; did you mean", "cases/nucleus.toml"]),
    ([PAPER, "--until", "0 us"], ["not after the start"]),
    ([PAPER, "--until", "2 kPa"], ["--until", "kPa"]),
    ([PAPER, "--set", "time.end='4 Pa'"], ["time.end"]),
    ([PAPER, "--set", "seed"], ["key=value"]),
    ([PAPER, "-ts_type", "rkk"], ["-ts_type", "did you mean 'rk'"]),
    ([PAPER, "--set", "time.integrator='rosw'"], ["time.integrator", "'rosw'"]),
])
def test_a_wrong_call_says_what_would_be_right(alone, tmp_path, call, parts):
    done = alone(*call, cwd=tmp_path)
    refused(done, 2, *parts)
    assert done.stdout == "" and not list(tmp_path.iterdir())


def test_all_mistakes_of_a_case_are_told_with_their_lines(alone, tmp_path):
    text = PAPER.read_text().replace("cells = [", 'cels = ["Cell-9"]\nheight = "1 kPa"\ncells = [')
    (tmp_path / "case.toml").write_text(text.replace('"paper.toml"', f'"{PAPER.with_name("paper.toml")}"'))
    done = alone("case.toml", cwd=tmp_path)
    refused(done, 2, "case.toml:6: ", "did you mean 'cells'", "case.toml:7: ", "kPa")
    assert not (tmp_path / "output").exists()


def test_a_place_that_cannot_be_written_or_holds_other_files_is_refused(cellmig, tmp_path):
    (tmp_path / "file").touch()
    refused(cellmig(2, PAPER, *SHORT, "--out", tmp_path / "file/run"), 5, "--out DIR")
    refused(cellmig(2, PAPER, *SHORT, "--out", tmp_path), 5, "not a run's")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_help_and_what_looks_at_runs_come_once_on_several_ranks(cellmig, runs):
    for call, first in ((["--help"], "usage: cellmig CASE.toml"), (["run", "--help"], "usage: cellmig run"),
                        (["info", runs[1]], "directory"), (["validate", CASES["nucleus"], *COARSE], "An elastic")):
        done = cellmig(2, *call)
        assert (done.returncode, done.stderr, done.stdout.count(first)) == (0, "", 1), done


# -------------------------------------------------------------------------------------------- what the machine may lack


@pytest.mark.parametrize(("ranks", "rc", "more", "said"), [
    (2, "hello world", (), ".petscrc line 1: hello"), (2, "-ts_dt", (), "-ts_dt: expects a step"),
    (1, "-ts_dt -1", (), "-ts_dt: expects a step"), (1, "-ts_dt abc", (), "abc"),
    (2, "", ("-a", os.fsdecode(b"\xe9")), "utf-8")])
def test_options_of_petsc_that_cannot_be_read_are_told_in_one_line(cellmig, tmp_path, ranks, rc, more, said):
    (tmp_path / ".petscrc").write_text(f"{rc}\n")
    done = cellmig(ranks, PAPER, *SHORT, *more, "--out", "run", "--quiet", cwd=tmp_path,
                   env={"PYTHONPATH": str(PAPER.parent.parent)})
    told = [line for line in done.stderr.splitlines() if line.startswith("cellmig: ")]
    assert done.returncode == 2 and len(told) == 1 and said in told[0] and "Traceback" not in done.stderr, done


def test_options_of_petsc_from_anywhere_are_in_the_manifest_and_have_to_be_the_same_to_go_on(alone, tmp_path):
    (tmp_path / ".petscrc").write_text("-ts_dt 1e-4\n")
    path = {"PYTHONPATH": str(PAPER.parent.parent)}
    here = {"cwd": tmp_path, "env": {"PETSC_OPTIONS": "-snes_rtol 1e-9"} | path}
    done = alone(PAPER, *SHORT, "--out", "run", "--quiet", "--wall-time", "1 s", "-log_view", ":log", **here)
    assert done.returncode == 75
    found = read_manifest(tmp_path / "run")["petsc_options"]
    assert found == {"log_view": ":log", "snes_rtol": "1e-9", "ts_dt": "1e-4"}
    (tmp_path / ".petscrc").write_text("-ts_dt 1e-4\n-snes_rtol 1e-8\n")
    done = alone("resume", "run", "--quiet", cwd=tmp_path, env=path)
    assert done.returncode == 5 and "-snes_rtol 1e-9 then, -snes_rtol 1e-8 now" in done.stderr, done
    assert alone("resume", "run", "--quiet", "-ts_monitor", **here).returncode == 0


@pytest.mark.parametrize(("case", "step"), [("all_protrude", "0.5 ns"), ("nucleus", "auto")])
def test_the_monitor_of_petsc_begins_with_the_step_that_is_taken(alone, tmp_path, case, step):
    done = alone(CASES[case], *SHORT, "--out", tmp_path / "run", "--quiet", "--set", f"time.step={step}", "-ts_monitor")
    first, second = ([float(line.split()[at]) for at in (0, 3, 5)] for line in done.stdout.splitlines()[:2])
    assert first[0] == first[2] == 0.0
    assert first[1] == pytest.approx(second[2] / second[0], rel=1e-5)  # six digits are printed


ANSWER = "int answer(void) {{ return {}; }}"


@pytest.mark.parametrize("left", [0, 100, 0.5, -1], ids=["nothing", "100 bytes", "half", "all but a byte"])
def test_a_compiled_kernel_that_was_cut_short_is_made_anew(left, tmp_path, monkeypatch):
    monkeypatch.setenv("CELLMIG_CACHE", str(tmp_path))
    source = ANSWER.format(40)
    path = compiler.compiled(source)
    whole = path.read_bytes()
    assert path.parent == tmp_path and compiler.compiled(source) == path
    path.write_bytes(whole[:int(left * len(whole)) if isinstance(left, float) else left])
    assert compiler.loaded(source).answer() == 40
    assert path.stat().st_size == len(whole) and [*tmp_path.iterdir()] == [path]


def test_ranks_that_need_the_same_kernel_at_once_have_it_compiled_by_one(on_ranks, tmp_path):
    slow, calls, cache = tmp_path / "slow", tmp_path / "calls", tmp_path / "cache"
    slow.write_text(f'#!/bin/sh\necho >>"{calls}"\nsleep 1\nexec cc "$@"\n')
    slow.chmod(0o755)
    answer = f"loaded('{ANSWER.format(43)}').answer()"
    done = on_ranks(3, "-c", f"from cellmig.kernel.toolchain import loaded; print({answer})",
                    env={"CC": str(slow), "CELLMIG_CACHE": str(cache)})
    assert (done.returncode, done.stdout.split()) == (0, ["43"] * 3), done
    assert calls.read_text() == "\n" and len([*cache.iterdir()]) == 1


def test_what_two_kernels_share_is_compiled_once(tmp_path, monkeypatch):
    counting, calls, shared = tmp_path / "counting", tmp_path / "calls", "int half(void) { return 22; }"
    counting.write_text(f'#!/bin/sh\necho >>"{calls}"\nexec cc "$@"\n')
    counting.chmod(0o755)
    monkeypatch.setenv("CELLMIG_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("CC", str(counting))
    for own, answer in {"2 * half()": 44, "half() + 23": 45, "2 * half() ": 44}.items():
        assert compiler.loaded(shared, f"int half(void);\n{ANSWER.format(own)}").answer() == answer
    assert len(calls.read_text()) == 1 + 3 * 2


def test_a_kernel_on_a_disk_where_nothing_is_executed_is_loaded_from_memory_or_a_remedy_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv("CELLMIG_CACHE", str(tmp_path))
    load = ctypes.CDLL

    def refuse(path, places):
        if path.startswith(places):
            raise OSError("failed to map segment from shared object")
        return load(path)

    monkeypatch.setattr("ctypes.CDLL", lambda path: refuse(path, (str(tmp_path),)))
    assert compiler.loaded(ANSWER.format(41)).answer() == 41
    monkeypatch.setattr("ctypes.CDLL", lambda path: refuse(path, (str(tmp_path), "/proc")))
    with pytest.raises(compiler.CompilerError, match=r"failed to map segment.*noexec, set CELLMIG_CACHE"):
        compiler.loaded(ANSWER.format(42))


def _daemon(place: Path) -> None:
    """Open MPI 4 cannot start without its daemon; 5 has none."""
    if orted := shutil.which("orted"):
        (place / "orted").symlink_to(orted)


def test_without_a_compiler_the_message_says_what_to_install(alone, tmp_path):
    (tmp_path / "bin").mkdir()
    _daemon(tmp_path / "bin")
    lacks = {"PATH": str(tmp_path / "bin"), "OMPI_MCA_plm": "isolated", "CELLMIG_CACHE": str(tmp_path / "cache")}
    refused(alone(PAPER, *SHORT, "--out", tmp_path / "run", env=lacks), 3, "apt install gcc libc6-dev")


def test_without_a_compiler_of_the_system_that_of_ziglang_is_taken(alone, tmp_path):
    (tmp_path / "bin").mkdir()
    _daemon(tmp_path / "bin")
    (tmp_path / "ziglang").mkdir()
    (tmp_path / "ziglang/__main__.py").write_text(
        "import os, pathlib, sys\npathlib.Path(__file__).with_name('called').touch()\n"
        "call = [a.replace('x86_64_', 'x86-64-') for a in sys.argv[2:]]\n"  # as Zig spells it, and no other compiler
        f"os.environ['PATH'] = '{os.environ['PATH']}'\nos.execvp(sys.argv[1], [sys.argv[1], *call])\n")
    env = {"PATH": str(tmp_path / "bin"), "OMPI_MCA_plm": "isolated", "CELLMIG_CACHE": str(tmp_path / "cache"),
           "PYTHONPATH": str(tmp_path)}
    done = alone(PAPER, *SHORT, "--out", tmp_path / "run", env=env)
    assert (done.returncode, done.stderr) == (0, "") and (tmp_path / "ziglang/called").exists()


def test_a_compiler_that_is_not_there_is_named(cellmig, tmp_path):
    lacks = {"CC": "/nonexistent", "CELLMIG_CACHE": str(tmp_path / "cache")}
    refused(cellmig(2, PAPER, *SHORT, "--out", tmp_path / "run", env=lacks), 3, "/nonexistent")


def test_a_kernel_cache_that_cannot_be_written_does_not_keep_a_run_from_running(cellmig, tmp_path):
    (tmp_path / "file").touch()
    done = cellmig(2, PAPER, *SHORT, "--out", tmp_path / "run",
                   env={"CELLMIG_CACHE": str(tmp_path / "file/cache")})
    assert (done.returncode, done.stderr) == (0, "")


def test_the_doctor_finds_nothing_missing_here_and_says_what_mends_what_is(alone, tmp_path):
    well = alone("doctor")
    assert (well.returncode, well.stderr) == (0, "") and "nothing is missing" in well.stdout
    for part in ("Python", "PETSc", "MPI", "h5py", "meshio", "C compiler", "kernel cache", "cores", "memory"):
        assert part in well.stdout
    blocked = tmp_path / "blocked"
    blocked.mkdir()
    (blocked / "h5py.py").write_text("raise ImportError('no HDF5')\n")
    (tmp_path / "file").touch()
    lacks = {"PYTHONPATH": str(blocked), "CC": "/nonexistent", "CELLMIG_CACHE": str(tmp_path / "file/cache")}
    ill = alone("doctor", env=lacks)
    assert (ill.returncode, ill.stderr) == (3, "")
    assert "apt install gcc libc6-dev python3-h5py" in ill.stdout and "set CELLMIG_CACHE" in ill.stdout


def test_a_missing_module_is_named_with_what_installs_it(alone, tmp_path):
    (tmp_path / "h5py.py").write_text("raise ModuleNotFoundError('No module named h5py', name='h5py')\n")
    done = alone(PAPER, *SHORT, "--out", tmp_path / "run", env={"PYTHONPATH": str(tmp_path)})
    refused(done, 3, "h5py", "cellmig doctor")


def test_a_petsc_of_another_python_is_told_with_the_python_that_it_goes_with(alone, tmp_path):
    """As that of Debian is for a Python of conda's, whose NumPy is another one."""
    place = tmp_path / "petscdir/petsc4py"
    place.mkdir(parents=True)
    (place / "__init__.py").write_text("raise ValueError('dtype size changed, may indicate binary incompatibility')\n")
    other = {"PYTHONPATH": str(place.parent)}
    refused(alone(PAPER, *SHORT, "--out", tmp_path / "run", env=other), 3, "binary incompatibility", "cellmig doctor")
    told = alone("doctor", env=other)
    assert told.returncode == 3 and "/usr/bin/python3 -m venv --system-site-packages DIR" in told.stdout


# ------------------------------------------------------------------------------------------------------- how a run ends


@pytest.mark.parametrize("ranks", [1, 2])
def test_a_step_far_too_large_is_refused_by_the_numbers_with_cause_and_remedy(cellmig, tmp_path, ranks):
    done = cellmig(ranks, PAPER, *COARSE, "--until", "5 us", "--set", "time.step=20 ns", "--out",
                   tmp_path / "run")
    refused(done, 4, "the simulation failed at", "particle ", "of cell ", "times the stable one", 'time.step = "auto"')
    assert "TOO LARGE" in done.stdout and "20 ns as given" in done.stdout
    manifest = read_manifest(tmp_path / "run")
    assert manifest["exit_status"] == 4 and manifest["cause"] in done.stderr and manifest["state_hash"] is None
    assert [len(frame.read()["id"]) for frame in frames(tmp_path / "run")] == [PARTICLES] * manifest["frames"]
    assert manifest["cause"] in (tmp_path / "run/run.log").read_text()


def asked_to_stop(command: list[str], case: Path, run: Path, number: int, env: dict[str, str], rows: int) -> int:
    """Start a run, send a signal when it has written `rows` rows of its ledger; its exit code, after 5 s at most."""
    child = subprocess.Popen([*command, "-m", "cellmig", str(case), *COARSE, "--out", str(run)], env=env,
                             stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + 30
        while not (run / "ledger.csv").exists() or len((run / "ledger.csv").read_text().splitlines()) < 1 + rows:
            assert child.poll() is None and time.monotonic() < deadline
            time.sleep(0.02)
        time.sleep(0.3)  # into the steps
        child.send_signal(number)
        return child.wait(timeout=5)
    finally:
        child.kill()
        child.wait()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGUSR1, signal.SIGINT])
def test_a_signal_ends_a_run_within_seconds_and_leaves_its_files_whole(outside_mpi, tmp_path, number):
    run = tmp_path / "run"
    assert asked_to_stop([sys.executable], PAPER, run, number, outside_mpi, rows=3) == 75
    manifest, ledger = read_manifest(run), read_table(run / "ledger.csv")
    assert (manifest["exit_status"], manifest["cause"]) == (75, "asked to stop")
    assert ledger["time_us"][-1] == manifest["time_us"] < 400 and np.isfinite(ledger["energy_error"]).all()
    assert frames(run)[-1].time == manifest["time_us"] and len(frames(run)[-1].read()["id"]) == PARTICLES


def test_a_signal_ends_a_run_on_two_ranks_between_two_samples(outside_mpi, tmp_path):
    launcher = on_ranks(2, [sys.executable])
    case, run = tmp_path / "case.toml", tmp_path / "run"
    case.write_text(f'extends = "{PAPER}"\n[time]\nsamples = 1\nframes = 1\n')
    assert asked_to_stop(launcher, case, run, signal.SIGUSR1, outside_mpi, rows=1) == 75
    manifest = read_manifest(run)
    assert manifest["exit_status"] == 75 and 0 < manifest["time_us"] < 400
    assert read_table(run / "ledger.csv")["time_us"].tolist() == [0.0, manifest["time_us"]]
    assert [frame.time for frame in frames(run)] == [0.0, manifest["time_us"]]


def test_a_reader_that_leaves_ends_nothing_and_gets_no_trace(outside_mpi, tmp_path):
    disc, run = CASES["nucleus"], tmp_path / "run"
    for call in (["schema"], ["validate", disc, *COARSE], [disc, *SHORT, "--out", run]):
        reading, writing = os.pipe()
        child = subprocess.Popen([sys.executable, "-m", "cellmig", *map(str, call)], env=outside_mpi, stdout=writing,
                                 stderr=subprocess.PIPE, text=True)
        os.close(writing)
        os.close(reading)
        assert (child.communicate(timeout=60)[1], child.returncode) == ("", 0)
    assert read_manifest(run)["exit_status"] == 0


# -------------------------------------------------------------------------------------------------- PETSc's own options


def test_an_adaptation_of_petsc_that_gives_up_ends_a_run_with_a_remedy(alone, tmp_path):
    strict = "-ts_type rk -ts_rk_type 5dp -ts_adapt_type basic -ts_max_reject 1 -ts_rtol 1e-13 -ts_atol 1e-16"
    done = alone(PAPER, *SHORT, "--out", tmp_path / "run", *strict.split())
    refused(done, 4, "rejected a step", "particle", "try a larger -ts_rtol")


@pytest.mark.parametrize(("options", "integrator", "steps"), [
    (["-ts_type", "rk", "-ts_rk_type", "4"], "rk of PETSc", None),
    (["-ts_type", "ssp"], "ssp of PETSc", None),
    (["-ts_type", "euler", "-ts_dt", "1e-4"], "euler of PETSc", 1000),  # which makes energy: 16 % at 1 ns
    (["-ts_dt", "1e-3"], "leapfrog", 100),
    (["-ts_type", "leapfrog", "-ts_dt", "1e-3", "-ts_max_steps", "7", "-ts_monitor"], "leapfrog", 7),
    (["-ts_type", "rk", "-ts_dt", "1e-3", "-ts_max_steps", "7", "-ts_monitor"], "rk of PETSc", 7),
])
def test_options_of_petsc_are_obeyed(alone, runs, tmp_path, options, integrator, steps):
    done = alone(PAPER, *SHORT, "--out", tmp_path / "run", *options)
    assert (done.returncode, done.stderr) == (0, "")
    assert f"integrator     {integrator}\n" in done.stdout and "nothing used" not in done.stdout
    manifest = read_manifest(tmp_path / "run")
    assert manifest["steps"] == (steps or manifest["steps"]) > 0 and manifest["unused_options"] == []
    if "-ts_dt" in options:
        dt = float(options[options.index("-ts_dt") + 1])
        assert manifest["dt_us"] == pytest.approx({"least": dt, "most": dt})
    assert ("7 TS dt" in done.stdout) == ("-ts_monitor" in options)
    assert manifest["time_us"] == pytest.approx(0.1 if steps != 7 else 7e-3)
    if steps != 7:
        u, reference = (frames(run)[-1].read()["u"] for run in (tmp_path / "run", runs[1]))
        error = 0.3 if "euler" in options else 0.05  # of the first and of higher orders
        assert np.abs(u - reference).max() < error * np.abs(reference).max()


def test_a_run_whose_steps_end_at_a_sample_ends_there(alone, tmp_path):
    words = ("--set", "time.samples=10", "--set", "time.frames=1", "-ts_dt", "1e-3", "-ts_max_steps", "20")
    done = alone(PAPER, *SHORT, *words, "--out", tmp_path / "run")
    assert (done.returncode, done.stderr) == (0, "") and "the 20 steps of -ts_max_steps are taken" in done.stdout
    assert read_manifest(tmp_path / "run")["time_us"] == pytest.approx(0.02)


def test_an_option_that_nothing_uses_is_reported(cellmig, tmp_path):
    done = cellmig(2, PAPER, *SHORT, "--out", tmp_path / "run", "-ts_typ", "rk")
    assert done.returncode == 0 and "nothing has asked for -ts_typ rk so far: is it misspelt?" in done.stdout
    assert done.stdout.count("PETSc options that nothing used: -ts_typ rk\n") == 1
    assert read_manifest(tmp_path / "run")["unused_options"] == ["-ts_typ rk"]


# ---------------------------------------------------------------------------------------------- before and after a run


def test_validate_tells_of_cases_one_after_the_other_and_beforehand_of_what_takes_long(alone):
    paths = [CASES["crawl"], CASES["nucleus"]]
    done = alone("validate", *paths, *COARSE)
    assert done.returncode == 0 and done.stderr and all(line.endswith("…") for line in done.stderr.splitlines())
    assert [Path(report.split(":")[0]) for report in done.stdout.strip().split("\n\n")] == paths


def test_validate_estimates_the_steps_and_the_disk_of_a_run(alone, runs):
    lines = dict(line.split(maxsplit=1) for line in alone("validate", PAPER, *COARSE).stdout.splitlines()[1:] if line)
    steps = int(lines["steps"].split()[0])
    # The gaps between surfaces are taken as typical ones; at the start, all bonds are at their equilibrium.
    assert 0.5 < steps * read_manifest(runs[1])["dt_us"]["most"] / 400 < 2
    written = [path.stat().st_size for path in (runs[1] / "rank0000").iterdir()]
    size, unit = lines["disk"].split()[:2]
    assert float(size) * {"MB": 1e6, "GB": 1e9}[unit] == pytest.approx(101 * np.mean(written), rel=0.3)


def test_validate_reports_the_good_case_and_the_mistakes_of_the_other(alone, tmp_path):
    broken = tmp_path / "broken.toml"
    broken.write_text(f'extends = "{PAPER}"\nsed = 1\n')
    done = alone("validate", broken, CASES["nucleus"], *COARSE)
    refused(done, 2, "broken.toml:2: ", "did you mean 'seed'")
    assert "An elastic disc rings" in done.stdout and "skipped" in done.stdout


def test_validate_says_how_far_a_step_is_from_the_stable_one(alone):
    done = alone("validate", CASES["nucleus"], *COARSE, "--set", "time.step=1 us")
    assert done.returncode == 0 and "1e+03 ns as given" in done.stdout and "TOO LARGE" in done.stdout


def test_validate_tells_what_implicit_steps_take(alone):
    asked = ("validate", CASES["one_cell"], "--set", "particles.per_cell=93", "--set", "time.integrator=bdf")
    lines = alone(*asked, "--set", "time.step=20 ns").stdout.splitlines()[1:]
    given = dict(line.split("  ", 1) for line in lines if line)
    assert given["steps"].split()[:2] == ["20000", "to"]
    number, unit = given["one step"].split(",")[0].split()
    assert 1e-3 < float(number) * {"ms": 1e-3, "s": 1.0}[unit] < 5.0  # measured 0.02
    open_ended = alone(*asked).stdout
    assert "as many as the motion asks for" in open_ended and "leapfrog takes" in open_ended
    chosen = alone("validate", CASES["nucleus"], *COARSE, "--set", "time.integrator=auto").stdout
    assert "leapfrog: as a trial went, 20 µs take" in chosen and "stable step" in chosen


def test_validate_warns_of_bonds_that_start_pressed(alone):
    low = ("--set", 'cells.0.centre=["10.01 um", "5.004 um"]', "--set", 'cells.0.pitch=[["-10.003 um", "0 um"]]')
    assert "WARNING" not in alone("validate", PAPER, *COARSE).stdout
    said = [line for line in alone("validate", PAPER, *low).stdout.splitlines() if "WARNING" in line]
    assert "set the centre of the lowest cell higher by 6 nm" in said[0]
    assert "set the cells apart by a further 7 nm" in said[1] and len(said) == 2


def test_info_tells_what_a_run_was(alone, runs):
    done = alone("info", runs[3])
    assert (done.returncode, done.stderr) == (0, "")
    for part in ("all_protrude.toml", "3 ranks", "state hash", "frames", "aggregate", "energy error"):
        assert part in done.stdout


def test_diff_finds_runs_on_other_ranks_equal_and_tells_where_others_part(alone, runs, tmp_path):
    same = alone("diff", runs[1], runs[4])
    assert same.returncode == 0 and same.stdout.count("the same, bit for bit") == 5
    assert alone(PAPER, *SHORT, "--set", "seed=1", "--out", tmp_path / "other").returncode == 0
    other = alone("diff", runs[1], tmp_path / "other")
    assert (other.returncode, other.stderr) == (1, "")
    frame = other.stdout.splitlines()[-1]
    assert "of particle" in frame and "at 0" in frame and "us" in frame, frame


def test_what_is_not_a_run_or_is_damaged_is_named(alone, nucleus, tmp_path):
    refused(alone("info", tmp_path), 5, str(tmp_path), "not the directory of a run")
    refused(alone("plot", CASES["nucleus"]), 5, "but a case: a run of it leaves 'output/nucleus'")
    broken = tmp_path / "broken"
    shutil.copytree(nucleus, broken)
    picture = broken / "rank0000/s00000000.h5"
    picture.write_bytes(picture.read_bytes()[:999])
    refused(alone("diff", nucleus, broken), 5, "s00000000.h5")
    (broken / "manifest.json").write_text("{")
    refused(alone("info", broken), 5, "manifest.json")


def test_plot_draws_a_run_with_a_substrate_where_there_is_one(alone, runs, nucleus, tmp_path):
    done = alone("plot", nucleus, "--out", tmp_path, "--times", "0 us,0.1 us")
    assert (done.returncode, done.stderr) == (0, "")
    made = [Path(line) for line in done.stdout.splitlines()]
    assert {path.name for path in made} == {f"{name}.{kind}" for kind in ("png", "pdf")
                                               for name in ("shapes", "displacement", "ledger")}
    assert all(path.stat().st_size > 5000 for path in made)
    assert _on_substrate(runs[1]) and not _on_substrate(nucleus)
    refused(alone("plot", nucleus, "--field", "stres"), 2, "no field 'stres'")


def test_the_schema_is_json_and_fits_every_case(alone):
    schema = json.loads(alone("schema").stdout)
    assert schema["$schema"].startswith("https://json-schema.org") and "cells" in schema["properties"]
    jsonschema = pytest.importorskip("jsonschema")
    import tomllib

    for path in CASES.values():
        jsonschema.validate(tomllib.loads(path.read_text()), schema)


def test_the_schema_that_editors_use_is_the_one_of_this_program_and_all_in_it_has_a_description(alone):
    """After a change: cellmig schema > docs/case.schema.json."""
    kept = (PAPER.parent.parent / "docs/case.schema.json").read_text()
    assert kept == alone("schema").stdout
    silent = []

    def walk(node, path=()):
        for name, item in node.get("properties", {}).items():
            silent.extend([".".join((*path, name))] if not item.get("description") else [])
            walk(item, (*path, name))
        for item in [*node.get("anyOf", ()), *(node[key] for key in ("items", "additionalProperties") if
                                               isinstance(node.get(key), dict))]:
            walk(item, path)

    walk(json.loads(kept))
    assert not silent


def test_every_file_of_a_frame_says_its_units(runs):
    paths = list(runs[4].glob("rank*/s*.h5"))
    assert len(paths) >= 4
    for path in paths:
        with h5py.File(path, locking=False) as file:
            assert file["stress"].attrs["unit"] == "Pa" and file["u"].attrs["unit"] == "um"
