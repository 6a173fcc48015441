"""The documentation does what it says: commands run, links lead somewhere, the reference is that of the code."""

from __future__ import annotations

import inspect
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest
from scenes import ROOT

from cellmig.case.load import load
from cellmig.laws import register
from cellmig.parallel.arguments import split_arguments
from cellmig.runs.sweep import variation
from cellmig.usage import parse, what_first
from cellmig.verify.verify import load_references

pytestmark = pytest.mark.serial

DOCS = ROOT / "docs"
PAGES = sorted([*DOCS.rglob("*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md"])
BLOCK = re.compile(r"^```(bash|python)\n(.*?)^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory that looks like a checkout: what is read is there, `./run` and `.venv/bin/python` are on one rank."""
    home = tmp_path_factory.mktemp("checkout")
    for name in ("cases", "cellmig", "examples", "tests", "pyproject.toml"):
        (home / name).symlink_to(ROOT / name)
    for name in ("docs", ".venv/bin"):
        (home / name).mkdir(parents=True)
    for name, words in (("run", "-m cellmig"), (".venv/bin/python", "")):
        (home / name).write_text(f'#!/bin/bash\nexec "{sys.executable}" {words} "$@"\n')
        (home / name).chmod(0o755)
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


def test_the_commands_of_the_readme_run(place: Path, outside_mpi: dict[str, str]) -> None:
    first, *others = blocks("README.md", "bash")
    assert re.findall(r"^(\./run(?: \w+)?)  ", first[1], re.MULTILINE) == ["./run", "./run test"]  # of test_launcher
    said = [obeyed(place, outside_mpi, *block) for block in others]
    assert len(said) == 1 and "done: 20 µs" in said[0] and "one_cell" in said[0]


@pytest.mark.parametrize("number", [pytest.param(i, marks=[pytest.mark.slow] * ("bench" in text)) for i, (_, text)
                                    in enumerate(blocks("CONTRIBUTING.md"))])
def test_every_command_of_contributing_runs(number: int, place: Path, outside_mpi: dict[str, str]) -> None:
    obeyed(place, outside_mpi, *blocks("CONTRIBUTING.md")[number])


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_command_of_a_page_is_one(page: Path) -> None:
    """Parsed as the program does; of a case that is there, `--set` and `--vary` name keys and have values."""
    register()
    for words in commands(page):
        options = parse(what_first(split_arguments(words)[0]))
        case = getattr(options, "case", None) or next(iter(getattr(options, "cases", [])), None)
        if (options.command == "verify" and options.stress) or options.command == "paper":
            case = Path("cases/all_protrude.toml")
        if case and (ROOT / case).is_file() and not getattr(options, "laws", []):
            varied = [f"{key}={values[0]!r}" for key, values in map(variation, getattr(options, "vary", []))]
            load(ROOT / case, [*options.sets, *varied])


def commands(page: Path) -> Iterator[list[str]]:
    """The words of each command of cellmig's in the blocks of a page, without `./run`, its ranks and its tests."""
    for _, text in BLOCK.findall(page.read_text()):
        for line in text.replace("\\\n", " ").splitlines():
            words = re.match(r"(?:\./run|cellmig)(?: (.*))?$", line.partition("  #")[0].partition(" ||")[0].rstrip())
            if not words or " > " in line or "$" in line:
                continue
            words = shlex.split(words[1] or "cases/all_protrude.toml")
            words = words[2:] if words[0] == "-n" else words
            if words[0] != "test":
                yield [str(next(iter(ROOT.glob(word)), word)) if "*" in word else word for word in words]


@pytest.mark.parametrize("page", ["README.md", "docs/howto.md", "docs/speed.md"])
def test_python_of_a_page_runs(page: str, place: Path, outside_mpi: dict[str, str]) -> None:
    pytest.importorskip("pandas", reason="no pandas here: apt install python3-pandas")
    if not (place / "output/one_cell").exists():  # the page takes for granted that there is a run
        obeyed(place, outside_mpi, "bash", "./run cases/one_cell.toml --set particles.per_cell=60 --until '1 us'")
    found = blocks(page, "python")
    assert found
    for block in found:
        obeyed(place, outside_mpi, *block)


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
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


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_that_a_page_names_are_there(page: Path) -> None:
    """From the root or from the package; NAME stands for any."""
    told = set(re.findall(r"`([\w/]+/\w+\.(?:py|c|h|sh|toml|md))`", page.read_text()))
    assert not [name for name in told if "NAME" not in name and not (ROOT / name).exists()
                and not (ROOT / "cellmig" / name).exists()]


def test_every_page_is_in_the_contents() -> None:
    assert set(contents()) == {path.name for path in DOCS.glob("*.md")}


def contents() -> list[str]:
    """The pages of the site's navigation."""
    return re.findall(r"(\w+\.md)", (ROOT / "mkdocs.yml").read_text())


@pytest.mark.parametrize("page", contents())
def test_a_page_says_first_what_question_it_answers(page: str) -> None:
    assert question(page)


def test_the_index_lists_every_page_by_its_question() -> None:
    listed = dict(re.findall(r"^- \[(.+?)\]\((\w+\.md)\)$", (DOCS / "index.md").read_text(), re.MULTILINE))
    assert listed == {question(page): page for page in contents() if page != "index.md"}


def question(page: str) -> str:
    """The question with which the first paragraph of a page begins, or its sentence of what the page tells."""
    title, first, *_ = (DOCS / page).read_text().split("\n\n")
    found = re.match(r"[^.?]+\?|This page tells [^.]+\.", " ".join(first.split()))
    assert re.fullmatch("# .+", title) and found, f"{page} begins with neither a question nor 'This page tells …'"
    return found[0]


def test_the_page_of_verification_has_the_verdicts_of_its_tables() -> None:
    tables = (DOCS / "data/verify.md").read_text()
    listed = {(name, error) for name, rows in re.findall(r"^## ([\w-]+) .*?\n(.*?)(?=^## |\Z)", tables, re.M | re.S)
              for error in re.findall(r"^\| (?!error |-)(.+?) \|", rows, re.MULTILINE)}
    assert listed == {(r.name, error) for r in load_references().values() for error in r.expected}
    told = re.search(r"(\d+) of (\d+) errors hold", (DOCS / "verification.md").read_text())
    failed = tables.count("**does not hold**")
    assert [int(n) for n in told.groups()] == [len(listed) - failed, len(listed)]


def test_the_gallery_is_that_of_its_table(tmp_path: Path) -> None:
    """After a change: .venv/bin/python docs/gallery.py, with the names of the cases whose pictures are other ones."""
    spec = spec_from_file_location("gallery", DOCS / "gallery.py")
    gallery = module_from_spec(spec)
    spec.loader.exec_module(gallery)
    assert gallery.page() == (DOCS / "gallery.md").read_text()
    sizes = {path.stem: path.stat().st_size for path in (DOCS / "gallery").iterdir()}
    assert sizes.keys() == {picture.case for picture in gallery.GALLERY} and max(sizes.values()) < 150_000


def names(column: int) -> list[str]:
    """The names in code in a column of the notation's tables."""
    rows = re.findall(r"^\|(.+)\|$", (DOCS / "notation.md").read_text(), re.MULTILINE)
    return sorted({name for row in rows for name in re.findall(r"`([\w.]+)`", row.split("|")[column])})


@pytest.mark.parametrize("name", names(2))
def test_a_name_of_the_notation_is_in_the_code(name: str) -> None:
    """`room.module.Thing.attribute`: a field, a property, a parameter, or an entry of a table of fields."""
    room, module, thing, *more = name.split(".")
    found: Any = getattr(import_module(f"cellmig.{room}.{module}"), thing)
    for part in more:
        there = (part in found if isinstance(found, dict) else hasattr(found, part)
                 or part in getattr(found, "__annotations__", {}) or part in inspect.signature(found).parameters)
        assert there, f"'{name}': there is no '{part}'"
        found = found[part] if isinstance(found, dict) else getattr(found, part, None)


def test_a_name_of_the_notation_is_in_the_kernel() -> None:
    kernel = "".join(path.read_text() for path in sorted((ROOT / "cellmig/kernel").rglob("*")) if path.is_file()
                     and path.suffix in (".c", ".h", ".py"))
    assert len(names(3)) > 10 and not [name for name in names(3) if not re.search(rf"\b{name}\b", kernel)]


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
    assert '"location":"fit.html' in (tmp_path / "site/search/search_index.json").read_text()


@pytest.mark.skipif(not shutil.which("codespell"), reason="no codespell here: apt install codespell")
def test_words_are_spelt_as_they_are() -> None:
    found = subprocess.run(["codespell", "--ignore-words-list=ans,fro", *PAGES, ROOT / "CHANGELOG.md"], text=True,
                           capture_output=True)
    assert found.returncode == 0, found.stdout
