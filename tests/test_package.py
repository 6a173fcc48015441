"""The package: what travels in it, that it works far from any checkout, and that all its papers tell one version."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
from scenes import ROOT

from cellmig.case.shipped import names
from cellmig.version import __version__

pytestmark = pytest.mark.serial

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
FOLDERS = {"cellmig": "cellmig", "cases": "cellmig/cases", "examples": "cellmig/examples"}


def done(*command: str | Path, cwd: Path, env: dict[str, str]) -> str:
    """What a command says that ends well."""
    ended = subprocess.run(command, cwd=cwd, env=env, text=True, capture_output=True, timeout=120)
    assert ended.returncode == 0, f"{command}\n{ended.stdout}\n{ended.stderr}"
    return ended.stdout


@pytest.fixture(scope="module")
def outside(outside_mpi: dict[str, str]) -> dict[str, str]:
    """An environment without this checkout."""
    return {key: value for key, value in outside_mpi.items() if not key.startswith("PYTHON")}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory, outside: dict[str, str]) -> Path:
    """A wheel from an sdist from a copy of the files, in which no earlier build has left any."""
    place = tmp_path_factory.mktemp("package")
    source = place / "source"
    for name in FOLDERS:
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    build = "import setuptools.build_meta as b; b.build_sdist('..')"
    done(sys.executable, "-W", "ignore", "-c", build, cwd=source, env=outside)
    done(sys.executable, "-m", "pip", "wheel", "--no-index", "--no-deps", "--no-build-isolation", "--wheel-dir", place,
         place / f"cellmig-{__version__}.tar.gz", cwd=place, env=outside)
    return place / f"cellmig-{__version__}-py3-none-any.whl"


@pytest.fixture(scope="module")
def installed(wheel: Path, outside: dict[str, str]) -> Path:
    """The folder of the programs of an environment over the system's packages with the wheel."""
    home = wheel.parent / "environment"
    done(sys.executable, "-m", "venv", "--system-site-packages", home, cwd=wheel.parent, env=outside)
    done(home / "bin/python", "-m", "pip", "install", "--no-index", "--no-deps", wheel, cwd=wheel.parent, env=outside)
    return home / "bin"


def test_every_file_of_the_package_its_cases_and_examples_travels(wheel: Path) -> None:
    expected = {f"{there}/{path.relative_to(ROOT / here)}" for here, there in FOLDERS.items()
                for path in (ROOT / here).rglob("*") if path.is_file() and "__pycache__" not in path.parts}
    inside = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert len(expected) > 300 and inside == expected


def test_every_room_is_listed_as_a_package() -> None:
    rooms = {".".join(path.parent.relative_to(ROOT).parts) for path in (ROOT / "cellmig").rglob("*.py")}
    assert set(PROJECT["tool"]["setuptools"]["packages"]) == rooms | {"cellmig.cases", "cellmig.examples"}


def test_a_case_from_the_wheel_runs_on_two_ranks_in_an_empty_folder(installed: Path, outside: dict[str, str],
                                                                    tmp_path: Path) -> None:
    site = next(installed.parent.glob("lib/python*/site-packages/cellmig"))
    before = {path for path in site.rglob("*") if "__pycache__" not in path.parts}
    program = installed / "cellmig"
    assert done(program, "--version", cwd=tmp_path, env=outside).split() == ["cellmig", __version__]
    told = done(program, "cases", cwd=tmp_path, env=outside)
    assert all(re.search(f"^{re.escape(name)} ", told, re.MULTILINE) for name in names())
    done(program, "cases", "all_protrude", "first_look.py", cwd=tmp_path, env=outside)
    said = done(installed / "python", "-m", "cellmig.parallel.launch", "2", program, "all_protrude.toml", "--until",
                "1 us", "--set", "particles.per_cell=100", cwd=tmp_path, env=outside)
    assert "2 ranks" in said and "done: 1 µs" in said
    assert "Three monocytes, all protrude" in done(program, "info", "output/all_protrude", cwd=tmp_path, env=outside)
    done(program, "report", "output/all_protrude", cwd=tmp_path, env=outside)
    assert "uPlot" in (tmp_path / "output/all_protrude/report.html").read_text(encoding="utf-8")
    pytest.importorskip("pandas", reason="no pandas here: apt install python3-pandas")
    done(installed / "python", "first_look.py", cwd=tmp_path, env=outside)
    assert (tmp_path / "output/first_look/shapes.png").exists()
    assert {path for path in site.rglob("*") if "__pycache__" not in path.parts} == before  # nothing is written there


def test_all_papers_tell_one_version() -> None:
    citation = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)[1]
    released = re.search(r"^## \[?(\d[^\s\]]*)\]? - ([\d-]+)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    codemeta = json.loads((ROOT / "codemeta.json").read_text())
    recipe = re.search(r"^  version: (\S+)$", (ROOT / "packaging/recipe.yaml").read_text(), re.MULTILINE)[1]
    assert {citation, codemeta["version"], released[1], recipe} == {__version__}
    assert released[2] == codemeta["dateModified"]
    assert f"date-released: {released[2]}\n" in (ROOT / "CITATION.cff").read_text()


def test_codemeta_and_the_package_tell_the_same() -> None:
    codemeta, project = json.loads((ROOT / "codemeta.json").read_text()), PROJECT["project"]
    assert codemeta["name"] == project["name"] and codemeta["description"] in (ROOT / "README.md").read_text()
    assert codemeta["runtimePlatform"] == f"Python {project['requires-python'].removeprefix('>=')} or later"
    needed = [item["name"] for item in codemeta["softwareRequirements"]]
    assert needed == [*project["dependencies"], "petsc4py"]


def test_the_recipe_needs_what_the_package_does() -> None:
    run = (ROOT / "packaging/recipe.yaml").read_text().partition("  run:\n")[2].partition("\n\n")[0]
    names = {line.split()[1].replace("matplotlib-base", "matplotlib") for line in run.splitlines()}
    assert names - {"python", "c-compiler", "__unix"} == {*PROJECT["project"]["dependencies"], "petsc4py"}
