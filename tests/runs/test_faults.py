"""What may go wrong under a run: it ends within seconds on all ranks, with one message, and files that open.

`pytest -m slow -s` prints the table of docs/robustness.md.
"""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from scenes import CASES, ROOT

from cellmig.output.manifest import read_manifest
from cellmig.output.tables import read_table
from cellmig.output.xdmf import frames
from cellmig.parallel.launch import on_ranks

pytestmark = [pytest.mark.serial, pytest.mark.slow]

CASE = (CASES["all_protrude"], "--set", "particles.per_cell=150", "--set", "time.frames=400", "--quiet")
PATIENCE = 20.0  # seconds from the fault to the end of all ranks, at most
CAN_MOUNT = subprocess.run(["unshare", "-m", "true"], capture_output=True).returncode == 0


def call(run: Path, *words: object, ranks: int = 2) -> str:
    """The shell's line for a run on some ranks."""
    program = [*map(str, (sys.executable, "-m", "cellmig", *CASE, "--out", run, *words))]
    return shlex.join(on_ranks(ranks, program) if ranks > 1 else program)


# What is put into a run: text of a module that Python imports at its start, on rank RANK alone where that matters.
PATCHED = """
import os
if "OMPI_COMM_WORLD_RANK" in os.environ:  # not in the launcher, which is run as a module
    from cellmig.solve import mechanics
    calls, advance = [], mechanics.Mechanics.advance
    def once(self, n, dt):
        advance(self, n, dt)
        calls.append(n)
        if len(calls) == 20 and os.environ["OMPI_COMM_WORLD_RANK"] == "{rank}":
            {what}
    mechanics.Mechanics.advance = once
"""
ALONE = """
import os
if os.environ.get("OMPI_COMM_WORLD_RANK") == "1":
    from cellmig.{module} import {name}
    def fails(*_, **__):
        raise {what}
    {name}.{method} = fails
"""
PATCHES = {
    "a rank raises what nobody expects in set-up": ALONE.format(
        module="solve.segments", name="Segments", method="renew", what="RuntimeError('a bug')"),
    "a rank alone refuses the case": ALONE.format(
        module="solve.mechanics", name="Mechanics", method="_load",
        what="__import__('cellmig.case.messages').case.messages.CaseError([])"),
    "a rank alone cannot read a file of laws": ALONE.format(
        module="case", name="own_laws", method="include", what="own_laws.LawFileError('law.py cannot be read')"),
    "a rank alone fails by its numbers": PATCHED.format(
        rank=1, what="from cellmig.solve.step import NumericsError as E; raise E('not finite')"),
    "a law gives NaN": PATCHED.format(rank=1, what="self.state.owned[7, 2] = float('nan')"),
    "a particle is inverted": PATCHED.format(rank=0, what="self.kernel['F'][3, 0] *= -1.0"),
    "a limit of file size": PATCHED.format(
        rank=1, what="import resource as r; r.setrlimit(r.RLIMIT_FSIZE, (20_000, 20_000))"),
    "a rank raises what nobody expects": PATCHED.format(rank=1, what="raise RuntimeError('a bug')"),
    "the directory is taken away": PATCHED.format(rank=0, what="import shutil; shutil.rmtree(os.environ['RUN'])"),
    "history.csv cannot be written": PATCHED.format(
        rank=0, what="os.remove(os.environ['RUN'] + '/history.csv'); os.mkdir(os.environ['RUN'] + '/history.csv')"),
    "memory runs out on a rank": PATCHED.format(rank=1, what="raise MemoryError"),
    "h5py is missing": "import sys\nsys.modules['h5py'] = None\n",
    "PETSc is missing": "import sys\nsys.modules['petsc4py'] = None\n",
}
# Fault: exit code, a part of the message, and how the program is started.
FAULTS: dict[str, tuple[int, str, Callable[[Path], str]]] = {
    "a full disk, at a frame": (5, "No space left", lambda run: disk(run, "size=80m", filled=True)),
    "a full disk, at a checkpoint": (5, "No space left", lambda run: disk(run, "size=400k", "--set", "time.frames=1",
                                                                         "--checkpoint-time", "1 us")),
    "a disk that is full at once": (3, "does not fit", lambda run: disk(run, "size=4k")),
    "a limit of file size": (5, "File too large", call),
    "a directory that cannot be written": (5, "Read-only file system", lambda run: disk(run, "ro")),
    "a step below the least": (4, "stable step fell", lambda run: call(
        run, "--set", "materials.cytoplasm.viscosity='1e6 Pa s'")),
    "a law gives NaN": (4, "not finite", call), "a particle is inverted": (4, "inverted", call),
    "history.csv cannot be written": (5, "history.csv", call), "the directory is taken away": (5, "cannot write", call),
    "a rank raises what nobody expects": (1, "a bug", call),
    "a rank raises what nobody expects in set-up": (1, "a bug", call),
    "a rank alone refuses the case": (1, "some ranks alone", call),
    "a rank alone fails by its numbers": (1, "some ranks alone", call),
    "a rank alone cannot read a file of laws": (2, "rank 1 alone: law.py cannot be read", lambda run: call(
        run, "--law", ROOT / "examples/cortex_law.py")),
    "memory runs out on a rank": (3, "rank 1 has no memory left", call),
    "h5py is missing": (3, "h5py", call), "PETSc is missing": (3, "petsc4py", call),
    "no compiler": (3, "C compiler", lambda run: f"CC={run}/cc CELLMIG_CACHE={run.parent}/cache {call(run)}"),
}


def disk(run: Path, how: str, *words: object, filled: bool = False) -> str:
    """A run on a disk of its own, whose files are copied from it in the end; others fill it once it has frames."""
    place = run.parent / "disk"
    keep = f"mkdir -p {run}; cp -r {place}/run/. {run} 2>/dev/null"
    begun = f"while [ ! -e {place}/run/cells.xdmf ]; do sleep 0.05; done"
    other = f"({begun}; cat /dev/zero >{place}/other 2>/dev/null) & " if filled else ""
    ours = f"{call(place / 'run', *words)}; code=$?; {keep}; exit $code"
    inner = f"mount -t tmpfs -o {how} none {place} && {{ {other}{ours}; }}"
    return f"mkdir -p {place}; unshare -m sh -c {shlex.quote(inner)}"


def files_open(run: Path) -> int:
    """Whether all files of a run open; the number of its frames."""
    read_manifest(run)
    for frame in frames(run):
        assert len(frame.read()["id"]) == 450
    for name in ("history.csv", "ledger.csv"):
        if (run / name).is_file():
            assert not (text := (run / name).read_bytes()) or text.endswith(b"\n")
            read_table(run / name)
    assert not list(run.rglob("*.part"))
    return len(frames(run))


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_ends_a_run_with_a_message_and_files_that_open(fault, tmp_path, outside_mpi):
    code, said, line = FAULTS[fault]
    run = tmp_path / "run"
    if "unshare" in line(run) and not CAN_MOUNT:
        pytest.skip("needs to mount a file system")
    (tmp_path / "sitecustomize.py").write_text(PATCHES.get(fault, ""))
    env = outside_mpi | {"PYTHONPATH": f"{tmp_path}:{ROOT}", "RUN": str(run)}
    begin = time.monotonic()
    done = subprocess.run(line(run), shell=True, env=env, capture_output=True, text=True, timeout=60,
                          stdin=subprocess.DEVNULL)
    seconds = time.monotonic() - begin
    print(f"\n| {fault} | {done.returncode} | {seconds:.1f} | {done.stderr.strip().splitlines()[-1:]} |")
    assert done.returncode == code, done
    assert said in done.stderr, done.stderr
    if code not in (1, 3):
        assert done.stderr.startswith("cellmig: ") and done.stderr.count("cellmig: ") == 1, done.stderr
    if code != 1:
        assert "Traceback" not in done.stderr
    assert seconds < PATIENCE
    if run.exists():
        files_open(run)


@pytest.mark.parametrize("ranks", [1, 2])
def test_a_killed_rank_ends_all_within_seconds(tmp_path, outside_mpi, ranks):
    run = tmp_path / "run"
    child = subprocess.Popen(shlex.split(call(run, ranks=ranks)), env=outside_mpi, stdin=subprocess.DEVNULL,
                             stderr=subprocess.PIPE)
    while not (run / "cells.xdmf").exists():
        time.sleep(0.01)
    time.sleep(0.5)
    found = subprocess.run(["ps", "--ppid", str(child.pid), "-o", "pid="], capture_output=True, text=True)
    begin = time.monotonic()
    os.kill(int(found.stdout.split()[-1]) if ranks > 1 else child.pid, signal.SIGKILL)
    child.communicate(timeout=PATIENCE)
    print(f"\n| a killed rank, of {ranks} | {child.returncode} | {time.monotonic() - begin:.1f} |")
    assert child.returncode in (-9, 137) and files_open(run)


@pytest.mark.parametrize("moment", [0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.2, 1.5, 2.0, 3.0])
def test_ctrl_c_at_any_moment_ends_a_run_without_a_trace(tmp_path, outside_mpi, moment):
    run = tmp_path / "run"
    child = subprocess.Popen(shlex.split(call(run, ranks=1)), env=outside_mpi, stdin=subprocess.DEVNULL,
                             stderr=subprocess.PIPE, text=True)
    time.sleep(moment)
    begin = time.monotonic()
    child.send_signal(signal.SIGINT)
    said = child.communicate(timeout=PATIENCE)[1]
    print(f"\n| ^C after {moment} s | {child.returncode} | {time.monotonic() - begin:.1f} | {said.splitlines()[-1:]}")
    assert child.returncode in (75, 130, -2) and "Traceback" not in said, said
    if child.returncode == 75:
        assert files_open(run) and list(run.glob("checkpoint/*.h5"))
    shutil.rmtree(run, ignore_errors=True)
