"""Terminals, locales and names of files that are not UTF-8: signs are replaced, and nothing ends in a trace."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import pytest
from scenes import CASES

from cellmig.output.manifest import read_manifest

pytestmark = pytest.mark.serial

ASCII_LOCALE = {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}
TINY = ("--set", "particles.per_cell=60", "--until", "0.1 us")
CAFE = os.fsdecode(b"caf\xe9")  # in Latin-1, as old archives have it


@pytest.fixture
def here(outside_mpi, tmp_path):
    """`here("info", …)`: the program in a directory with a case whose name is no UTF-8; what it wrote, as bytes."""
    for source, name in (("one_cell", CAFE), ("paper", "paper")):
        shutil.copy(CASES[source], tmp_path / f"{name}.toml")

    def start(*words: str, code: int = 0, **env: str) -> bytes:
        done = subprocess.run([sys.executable, "-m", "cellmig", *words], env=outside_mpi | env, cwd=tmp_path,
                              stdin=subprocess.DEVNULL, capture_output=True, timeout=60)
        assert done.returncode == code and b"Traceback" not in done.stderr, done
        return done.stdout

    return start


@pytest.mark.parametrize("env", [{"PYTHONIOENCODING": "ascii"}, {"PYTHONIOENCODING": "latin-1"}, ASCII_LOCALE],
                         ids=["ASCII terminal", "Latin-1 terminal", "ASCII locale"])
def test_a_run_and_what_is_said_of_it_come_through_any_encoding(here, tmp_path, env):
    said = here("paper.toml", *TINY, "--out", "run", **env)
    assert b"spacing" in said and said.isascii() == ("latin-1" not in env.values())
    assert "µm" in (tmp_path / "run/run.log").read_text(encoding="utf-8")
    here("--help", **env)
    here("schema", **env)


def test_files_whose_names_are_no_utf_8_are_read_and_written(here, tmp_path):
    here(f"{CAFE}.toml", *TINY, "--out", CAFE)
    assert read_manifest(tmp_path / CAFE)["case_file"] == f"{CAFE}.toml"
    for words in (("plot", CAFE, "--format", "png"), ("resume", CAFE)):
        here(*words)
    assert (tmp_path / CAFE / "shapes.png").stat().st_size > 1000
    here(f"{CAFE}s.toml", code=2)
