"""A campaign: runs are killed at any moment, leave files that open, and go on to the same bits."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import meshio
import pytest
from scenes import CASES

from cellmig.output.manifest import read_manifest
from cellmig.output.tables import read_table
from cellmig.output.xdmf import frames

pytestmark = [pytest.mark.serial, pytest.mark.slow]

KILLS, SEED = (int(os.environ.get(f"CELLMIG_KILLS{name}", usual)) for name, usual in (("", 200), ("_SEED", 8)))
COLONY = f"""
extends = '{CASES["paper"]}'
particles.per_cell = 60
time = {{ end = "30 us", samples = 50, frames = 25 }}
[protrusion]
cells = ["Large-{{}}"]
[[cells]]
name = "Large-{{}}"
shape = "disc"
radius = "5 um"
nucleus_ratio = 0.283
material = "cytoplasm"
nucleus = "nucleus"
rest = true
repeat = [6]
[[cells]]
name = "Small-{{}}"
shape = "disc"
radius = "4 um"
material = "cytoplasm"
rest = true
repeat = [6]
[[colony]]
law = "random"
box = [["0 um"], ["110 um"]]
"""
THREE = f"""
extends = '{CASES["all_protrude"]}'
particles.per_cell = 100
time = {{ end = "40 us", samples = 40, frames = 20 }}
"""
BALLS = f"""
extends = '{CASES["three_balls"]}'
particles.per_cell = 100
time = {{ end = "20 us", samples = 40, frames = 20 }}
materials.cytoplasm = {{ eta = "100 pN", zeta = "-5 Pa" }}
director = {{ law = "relaxing", start = "radial", anchoring = "surface" }}
"""
SCENES = {"three cells": THREE, "a colony": COLONY, "balls with a director": BALLS}
EQUAL = ("history.csv", "neighbours.csv")  # the same to the last byte
START = 1.0  # seconds in which a run has no more than begun
PATIENCE = 600.0  # seconds after which a run that goes on hangs, on a machine that has other work


def program(ranks: int, *words: object) -> list[str]:
    """The command of a run."""
    return ["mpiexec.openmpi", "-q", "-n", str(ranks), sys.executable, "-m", "cellmig", *map(str, words), "--quiet"]


def ranks_of(launcher: int) -> list[int]:
    """Processes that a launcher has started."""
    found = subprocess.run(["ps", "--ppid", str(launcher), "-o", "pid="], capture_output=True, text=True)
    return [int(word) for word in found.stdout.split()]


def kill(child: subprocess.Popen, what: str, chance: random.Random) -> None:
    """SIGKILL one rank, all ranks, or the launcher."""
    ranks = ranks_of(child.pid)
    for victim in {"a rank": ranks and [chance.choice(ranks)], "all ranks": ranks, "the launcher": [child.pid]}[what]:
        try:
            os.kill(victim, signal.SIGKILL)
        except ProcessLookupError:
            pass
    child.wait()


def all_opens(run: Path) -> None:
    """Whether every frame that is listed opens, and every table, without a last line that the kill cut."""
    for frame in frames(run):
        assert len(frame.read()["id"]) == read_manifest(run)["particles"]
    for path in run.glob("rank*.xdmf"):
        with meshio.xdmf.TimeSeriesReader(path) as reader:
            reader.read_points_cells()
            for number in range(reader.num_steps):
                assert len(reader.read_data(number)[1]["u"]) == len(reader.read_data(number)[1]["id"])
    for name in ("history.csv", "ledger.csv", "substrate.csv", "neighbours.csv"):
        if (run / name).exists():
            read_table(run / name)


@pytest.mark.timeout(0)
@pytest.mark.parametrize("scene", SCENES)
def test_runs_killed_at_random_moments_go_on_to_the_same_bits(tmp_path, outside_mpi, scene):
    case = tmp_path / "case.toml"
    case.write_text(SCENES[scene])
    options = {"env": outside_mpi, "stdin": subprocess.DEVNULL, "text": True}
    whole = tmp_path / "whole"
    begin = time.monotonic()
    subprocess.run(program(2, case, "--out", whole), check=True, **options)
    length, expected = time.monotonic() - begin, read_manifest(whole)["state_hash"]
    chance, ended, wrong, number = random.Random(SEED), Counter(), [], 0
    while ended.total() < KILLS:
        number += 1
        run, what = tmp_path / f"run{number}", chance.choice(["a rank", "all ranks", "the launcher"])
        line = program(2, case, "--out", run, "--checkpoint-time", "2 us")
        child = subprocess.Popen(line, stderr=subprocess.DEVNULL, **options)
        time.sleep(chance.uniform(START, length))
        if child.poll() is not None:  # it came to its end before: no kill
            continue
        kill(child, what, chance)
        if run.exists():
            all_opens(run)
        there = "a checkpoint" if list(run.glob("checkpoint/*.h5")) else "no checkpoint"
        ranks = chance.choice([1, 2, 2, 2, 3, 4])
        line = ("resume", run) if read_manifest(run) else (case, "--out", run, "--resume", "auto")
        again = subprocess.run(program(ranks, *line), capture_output=True, timeout=PATIENCE, **options)
        ended[what, there] += 1
        if again.returncode or read_manifest(run).get("state_hash") != expected or (
                any((run / name).read_bytes() != (whole / name).read_bytes() for name in EQUAL)):
            wrong.append((number, what, there, ranks, again.returncode, again.stderr))
        print(f"{ended.total()}: {what}, {there}, on {ranks} ranks; wrong so far: {len(wrong)}", flush=True)
        shutil.rmtree(run)
    print(f"\n{scene}: {KILLS} kills in {time.monotonic() - begin:.0f} s: {dict(ended)}; wrong: {wrong}")
    assert not wrong, wrong
