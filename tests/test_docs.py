"""The documentation does what it says: commands run, links lead somewhere, the reference is that of the code."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from scenes import ROOT

pytestmark = pytest.mark.serial

DOCS = ROOT / "docs"
PAGES = sorted([*DOCS.glob("*.md"), ROOT / "README.md"])
BLOCK = re.compile(r"^```(bash|python)\n(.*?)^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory that looks like a checkout: the cases, and a `./run` on one rank."""
    home = tmp_path_factory.mktemp("checkout")
    (home / "cases").symlink_to(ROOT / "cases")
    launcher = home / "run"
    launcher.write_text(f'#!/bin/bash\nexec "{sys.executable}" -m cellmig "$@"\n')
    launcher.chmod(0o755)
    return home


def blocks(page: str, language: str = "") -> list[tuple[str, str]]:
    """(language, text) of the blocks of code of a page that a user would type."""
    return [found for found in BLOCK.findall((ROOT / page).read_text()) if not language or found[0] == language]


def obeyed(place: Path, environment: dict[str, str], language: str, text: str) -> str:
    """What a block says when it is run as a user would."""
    shell = ["bash", "-euo", "pipefail", "-c"] if language == "bash" else [sys.executable, "-c"]
    env = environment | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run([*shell, text], cwd=place, env=env, text=True, capture_output=True, timeout=200)
    assert done.returncode == 0, f"{text}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def test_every_command_of_the_tutorial_runs(place: Path, outside_mpi: dict[str, str]) -> None:
    said = [obeyed(place, outside_mpi, *block) for block in blocks("docs/tutorial.md")]
    assert len(said) == 8
    assert "done: 40 µs" in said[0] and "time_us,cell" in said[2] and "300 particles at 40 us" in said[-1]
    pictures = {path.name for path in (place / "output/first").glob("*.png")}
    assert pictures == {"shapes.png", "displacement.png", "ledger.png", "traction.png"}
    assert (place / "output/bonds/sweep.png").exists() and (place / "output/softer/manifest.json").exists()


@pytest.mark.parametrize("page", ["README.md", "docs/howto.md"])
def test_python_of_a_page_runs(page: str, place: Path, outside_mpi: dict[str, str]) -> None:
    pytest.importorskip("pandas", reason="no pandas here: apt install python3-pandas")
    if not (place / "output/one_cell").exists():  # the page takes for granted that there is a run
        obeyed(place, outside_mpi, "bash", "./run cases/one_cell.toml --set particles.per_cell=60 --until '1 us'")
    found = blocks(page, "python")
    assert found
    for block in found:
        obeyed(place, outside_mpi, *block)


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_links_lead_somewhere(page: Path) -> None:
    lost = []
    for target in LINK.findall(page.read_text()):
        name, _, anchor = target.partition("#")
        if re.match(r"[a-z]+:", target):
            continue
        path = (page.parent / name).resolve() if name else page
        if not path.exists() or (anchor and anchor not in anchors(path)):
            lost.append(target)
    assert not lost


def anchors(page: Path) -> set[str]:
    """What the headings of a page are called in links."""
    heads = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"\s+", "-", re.sub(r"[^\w\s-]", "", head).strip().lower()) for head in heads}


def test_every_page_is_in_the_contents() -> None:
    listed = set(re.findall(r"(\w+\.md)", (ROOT / "mkdocs.yml").read_text()))
    assert listed == {path.name for path in DOCS.glob("*.md")}


def test_the_reference_is_that_of_the_code() -> None:
    """After a change: cellmig schema --markdown > docs/reference.md."""
    done = subprocess.run([sys.executable, "-m", "cellmig", "schema", "--markdown"], cwd=ROOT, capture_output=True)
    assert done.stdout.decode() == (DOCS / "reference.md").read_text()


def test_the_example_of_a_law_is_the_one_that_is_told_of() -> None:
    told = re.search(r"^```text\n(.*?)^```", (DOCS / "laws.md").read_text(), re.MULTILINE | re.DOTALL)[1]
    assert told in (ROOT / "examples/adhesion_law.py").read_text()


@pytest.mark.skipif(not shutil.which("mkdocs"), reason="no mkdocs here: apt install mkdocs mkdocs-material")
def test_the_site_is_built_without_a_warning(tmp_path: Path, outside_mpi: dict[str, str]) -> None:
    done = subprocess.run(["mkdocs", "build", "--strict", "--site-dir", tmp_path / "site"], cwd=ROOT, text=True,
                          env=outside_mpi, capture_output=True, timeout=120)
    assert done.returncode == 0, done.stderr  # which a warning costs, by --strict
    assert "Keys and laws of a case" in (tmp_path / "site/reference.html").read_text()


@pytest.mark.skipif(not shutil.which("codespell"), reason="no codespell here: apt install codespell")
def test_words_are_spelt_as_they_are() -> None:
    found = subprocess.run(["codespell", "--ignore-words-list=ans,fro", *PAGES, ROOT / "CHANGELOG.md"], text=True,
                           capture_output=True)
    assert found.returncode == 0, found.stdout
