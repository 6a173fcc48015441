"""Short coarse runs, whose pages are looked at."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LENGTHS = {"all_protrude": (60, "20 us"), "cap": (200, "5 us"), "chemotaxis": (60, "10 min"),
           "crawl": (60, "1 h")}  # particles, end


@pytest.fixture(scope="session")
def coarse(tmp_path_factory: pytest.TempPathFactory, outside_mpi: dict[str, str]) -> Callable[[str], Path]:
    """`coarse("cap")`: the directory of a short run of a case, computed once."""
    place, made = tmp_path_factory.mktemp("coarse"), {}

    def run(name: str) -> Path:
        if name not in made:
            particles, until = LENGTHS[name]
            subprocess.run([sys.executable, "-m", "cellmig", ROOT / f"cases/{name}.toml", "--quiet", "--out",
                            place / name, "--until", until, "--set", f"particles.per_cell={particles}"],
                           check=True, env=outside_mpi)
            made[name] = place / name
        return made[name]

    return run


@pytest.fixture
def watched() -> Iterator[Callable[[Path], tuple[subprocess.Popen[str], str]]]:
    """`watched(run)`: `cellmig watch` of a run and its address; it ends with the test, however that ends."""
    started = []

    def watch(run: Path) -> tuple[subprocess.Popen[str], str]:
        process = subprocess.Popen([sys.executable, "-m", "cellmig", "watch", str(run)], stdout=subprocess.PIPE,
                                   encoding="utf-8")
        started.append(process)
        return process, re.match(r"http://127\.0\.0\.1:\d+/", process.stdout.readline())[0]

    yield watch
    for process in started:
        process.kill()
        process.communicate()
