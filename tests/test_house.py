"""The rules of the house, executable: floors, sizes, docstrings, documented laws, nothing of one machine.

What is not yet so has a ceiling, which only falls.  `python tests/docstrings.py` lists what docstrings leave out.
"""

from __future__ import annotations

import ast
import dataclasses
import io
import re
import shutil
import subprocess
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import docstrings
import numpy as np
import pytest

from cellmig.case import registry, units
from cellmig.laws import register

pytestmark = pytest.mark.serial

ROOT = docstrings.PACKAGE.parent
# From the ground up; each imports only from its own floor and those below.  `cellmig` is the package's own front door.
FLOORS = ["exits", "version", "case", "model", "geometry", "meshfree", "kernel", "parallel", "cues", "laws", "output",
          "solve", "plot", "report", "simulation", "runs", "paper", "guidance", "bench", "verify", "doctor", "cellmig",
          "usage", "commands", "__main__"]
SIBLINGS = {"paper", "guidance", "bench", "verify"}  # beside each other: none imports another
PETSC_ROOMS = {"parallel", "solve", "__main__"}
LONGEST, LONGEST_FUNCTION = {".py": 400, ".c": 300, ".h": 300}, 60
LARGEST_ROOM = 0.2  # of the lines of the package
CONDITIONS = 4  # lines `#if…` in C
# Words that a reader would not look up, and what is meant.
JARGON = {"foot": "the closest point", "lent": "shared, or ghosts of other ranks", "homes?": "stencil",
          "whoever": "who it is", "that which": "what it is", "worst off": "of the largest …", "fling": "what happens",
          "kicked": "accounted", "lags? behind": "the time since", "tangled?": "overlap"}
# Patterns that know of two dimensions, and how often they may yet stand.
PLANAR = {"unpackings of two by two": (r"\(\w+, \w+\), \(\w+, \w+\) = ", 23),
          "determinants by hand": (r"\b(\w)(?:00|\[0\]\[0\]) \* \1(?:11|\[1\]\[1\]) - |\ba \* d - b_? \* c", 2),
          "gradients as complex numbers": (r"\b1j\b|\.real\b|\.imag\b|\w*complex\w+", 0),
          "angles for directions": (r"\b\w*theta\w*\b|θ|\b(?:arc|a)tan2\b", 14),
          "components by their place": (r"\b(?:state|X)(?:\[| \+ )[24]L? \*", 10)}
FLAT = ("cellmig/verify/", "cellmig/bench/", "cellmig/plot/")
WRITTEN = {"scaling.md", "verify.md"}  # by the program, where it runs

# "cellmig.case.units" -> its syntax tree; a package goes by its own name.
PATHS = {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
         for path in sorted((ROOT / "cellmig").rglob("*.py"))}
TREES = {module: ast.parse(path.read_text(), str(path)) for module, path in PATHS.items()}


def test_imports_go_downward_only() -> None:
    """Lazy imports and those for type checkers too: what is known above is not known below."""
    upward = [f"{place(module, line)}: {room(module)} imports {target}, which is above or beside it"
              for module in TREES for target, line in imports(module)
              if (target in PATHS and floor(target) > floor(module)) or (room(module) != room(target)
              and {room(module), room(target)} <= SIBLINGS)]
    assert not upward, report(upward)


def test_every_module_stands_on_a_floor() -> None:
    homeless = [f"{place(module, 1)}: no floor is called '{room(module)}'"
                for module in TREES if room(module) not in FLOORS]
    assert not homeless, report(homeless)


def test_no_modules_import_each_other_in_a_circle() -> None:
    below = {module: {target for target, _ in imports(module) if target in PATHS} for module in TREES}
    # Take away what imports nothing that is left, or is imported by nothing that is left: circles remain.
    while ends := {module for module in below if not below[module] or module not in set().union(*below.values())}:
        below = {module: targets - ends for module, targets in below.items() if module not in ends}
    circle = [f"{module} -> {', '.join(sorted(targets))}" for module, targets in below.items()]
    assert not circle, report(circle)


def test_petsc_is_imported_in_parallel_and_solve_only() -> None:
    astray = [f"{place(module, line)}: imports {target}"
              for module in TREES if room(module) not in PETSC_ROOMS
              for target, line in imports(module) if target.split(".")[0] == "petsc4py"]
    assert not astray, report(astray)


def test_a_module_is_read_in_one_sitting() -> None:
    """C as well as Python."""
    lines = {name: text.count("\n") for name, text in package().items()}
    long = [f"{name}: {n} lines, of {most}" for name, n in lines.items() if n > (most := LONGEST[Path(name).suffix])]
    assert not long, report(long)


def test_no_room_holds_more_than_a_fifth_of_the_package() -> None:
    lines = Counter()
    for name, text in package().items():
        lines[Path(name).parts[1]] += text.count("\n")
    large = [f"cellmig/{room}: {n} of {lines.total()} lines" for room, n in lines.items()
             if n > LARGEST_ROOM * lines.total()]
    assert not large, report(large)


def test_every_folder_of_tests_is_that_of_a_room() -> None:
    astray = [f"{path.relative_to(ROOT)}:1: there is no cellmig/{path.parent.name}"
              for path in (ROOT / "tests").glob("*/test_*.py") if not (ROOT / "cellmig" / path.parent.name).is_dir()]
    assert not astray, report(astray)


def test_c_says_what_it_is_and_its_lines_fit_as_those_of_python_do() -> None:
    wrong = []
    for name, text in package(".c", ".h").items():
        wrong += [f"{name}:1: no comment says what the file is"] * (not text.startswith("/*"))
        for number, line in enumerate(text.splitlines(), 1):
            wrong += [f"{name}:{number}: {len(line)} characters"] * (len(line) > 120)
            wrong += [f"{name}:{number}: a tab, or blanks at the end"] * ("\t" in line or line != line.rstrip())
    assert not wrong, report(wrong)


def test_a_comment_says_what_a_c_function_computes() -> None:
    """In front of each that is longer than five lines; preprocessor lines may stand between."""
    function = re.compile(r"^(?!#)[A-Za-z_][\w *]*?\b(\w+)\([^;{}]*\)\s*\{.*?(?:^\}|\}$)", re.MULTILINE | re.DOTALL)
    silent = []
    for name, text in package(".c", ".h").items():
        for match in function.finditer(text):
            above = [line for line in text[:match.start()].splitlines() if line.strip() and not line.startswith("#")]
            if match[0].count("\n") >= 5 and not (above and above[-1].endswith("*/")):
                silent.append(f"{name}:{line_of(text, match.start())}: {match[1]}")
    assert not silent, report(silent)


def test_c_is_compiled_under_few_conditions_and_uses_all_it_is_given() -> None:
    conditions, unused = (matches(pattern, package(".c", ".h")) for pattern in (r"^ *# *if", r"\(void\) *\w"))
    assert len(conditions) <= CONDITIONS, f"{len(conditions)}, of {CONDITIONS}:" + report(conditions)
    assert not unused, report(unused)


def test_comments_and_docstrings_use_the_words_of_the_field() -> None:
    texts = prose()
    quaint = [f"{found}  (better: {meant})" for word, meant in JARGON.items()
              for found in matches(rf"\b{word}\b", texts, re.IGNORECASE)]
    assert not quaint, report(quaint)


@pytest.mark.parametrize("what", PLANAR)
def test_the_number_of_dimensions_is_in_no_more_places(what: str) -> None:
    """Where solvers, kernel and geometry are written for the plane; exact solutions and pictures may be."""
    pattern, most = PLANAR[what]
    rooms = {name: text for name, text in package().items() if not name.startswith(FLAT)}
    found = matches(pattern, rooms)
    assert len(found) <= most, f"{len(found)} {what}, of {most}:" + report(found)


@pytest.mark.skipif(not shutil.which("mypy"), reason="no mypy here: apt install mypy")
@pytest.mark.skipif(np.lib.NumpyVersion(np.__version__) >= "2.0.0",
                    reason="arrays of NumPy 2 have their dimensions in their type, which ours do not say")
def test_the_types_of_the_core_are_sound() -> None:
    """Those of the rooms that pyproject.toml lists."""
    found = subprocess.run(["mypy", "--python-executable", sys.executable], cwd=ROOT, capture_output=True, text=True)
    assert found.returncode == 0, found.stdout + found.stderr


def test_no_text_cites_a_page_that_is_not_in_the_project() -> None:
    """A reader cannot open it: the source itself is cited, or the derivation."""
    pages = {path.name for path in tracked_files() if path.suffix == ".md"}
    found = []
    for path in tracked_files():
        if path.suffix not in (".py", ".c", ".h", ".md", ".toml", ".ipynb", ".yml", ".sh", ".def", ""):
            continue
        text = path.read_text(encoding="utf-8", errors="replace")
        found += [f"{path.relative_to(ROOT)}:{number}: {match[0]}" for number, line in enumerate(text.splitlines(), 1)
                  for match in re.finditer(r"\b[\w-]+\.md\b", line) if match[0] not in pages | WRITTEN]
    assert not found, report(found)


def test_a_function_fits_on_a_screen() -> None:
    long = []
    for module, tree in TREES.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                body = node.body[1:] if ast.get_docstring(node) is not None else node.body
                lines = node.end_lineno - body[0].lineno + 1 if body else 0
                if lines > LONGEST_FUNCTION:
                    long.append(f"{place(module, node.lineno)}: {node.name} has {lines} lines, of {LONGEST_FUNCTION}")
    assert not long, report(long)


def test_every_public_name_says_what_it_is() -> None:
    silent = []
    for module, tree in TREES.items():
        public = [node for node in tree.body if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
                  and not node.name.startswith("_")]
        silent += [f"{place(module, 1)}: the module has no docstring" for _ in [0] if not ast.get_docstring(tree)]
        silent += [f"{place(module, node.lineno)}: {node.name} has no docstring"
                   for node in public if not ast.get_docstring(node)]
    assert not silent, report(silent)


@pytest.mark.parametrize("room", docstrings.ROOMS)
def test_public_docstrings_give_shapes_units_errors_and_sources(room: str) -> None:
    """What tests/docstrings.py asks for."""
    silent = docstrings.offenders(room)
    assert not silent, report(silent)


def test_no_file_names_a_place_on_one_machine_or_a_package_index() -> None:
    # Put together here, so that this file may be searched as well.
    directories = "|".join(["root", "work", "home", "tmp/"])
    hosts = "|".join(r"\.".join(host) for host in [
        ("pypi", "org"), ("pythonhosted", "org"), ("anaconda", "org"), ("npmjs", "org"), ("crates", "io"),
        ("deb", "debian", "org"), ("ghcr", "io"), ("docker", "io")])
    forbidden = re.compile(rf"(?<![\w.$}}/-])/(?:{directories})(?![\w-])|\b(?:{hosts})\b")
    found = []
    for path in tracked_files():
        try:
            text = path.read_text()
        except UnicodeDecodeError:  # a picture
            continue
        found += [f"{path.relative_to(ROOT)}:{number}: {match[0]}"
                  for number, line in enumerate(text.splitlines(), 1) for match in forbidden.finditer(line)]
    assert not found, report(found)


def test_every_text_is_read_and_written_in_an_encoding_that_is_said() -> None:
    """The locale's would be another on another machine; the program's files, C and pipes are UTF-8."""
    opening = {"open", "fdopen", "read_text", "write_text", "TemporaryFile", "NamedTemporaryFile"}
    paths = [path for path in tracked_files() if path.suffix == ".py" and path.relative_to(ROOT).parts[0] != "tests"]
    silent = []
    for path in paths:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), str(path))):
            if not isinstance(node, ast.Call):
                continue
            name = getattr(node.func, "attr", getattr(node.func, "id", ""))
            said = {keyword.arg: keyword.value for keyword in node.keywords}
            modes = [value.value for value in [*node.args, *said.values()]
                     if isinstance(value, ast.Constant) and re.fullmatch(r"[rwax+]*b[rwax+]*", str(value.value))]
            binary = modes or (name.endswith("TemporaryFile") and not {"mode"} & said.keys() and not node.args)
            in_locale = name in opening and not binary and ast.unparse(node.func) not in ("os.open", "cellmig.open")
            if (in_locale or {"text", "universal_newlines"} & said.keys()) and "encoding" not in said:
                silent.append(f"{path.relative_to(ROOT)}:{node.lineno}: {ast.unparse(node)[:60]}")
    assert not silent, report(silent)


def test_no_number_is_written_by_its_repr() -> None:
    """NumPy 2 writes np.float64(0.1) there, which no case file, formula or reader knows; str has the same digits."""
    texts = {"text", "name", "word", "value"}
    found = [f"{place(module, node.lineno)}: {ast.unparse(node)}" for module, tree in TREES.items()
             for node in ast.walk(tree) if isinstance(node, ast.FormattedValue) and node.conversion == ord("r")
             and not (isinstance(node.value, ast.Name) and node.value.id in texts)]
    assert not found, report(found)


def test_every_parameter_of_every_law_has_a_meaning_and_a_unit() -> None:
    register()
    known = [(f"{kind} '{name}'", law) for kind in registry._LAWS for name, law in registry.laws(kind).items()]
    assert known, "no law is registered"
    wrong = [f"{name}: {mistake}" for name, law in known for field in dataclasses.fields(law)
             for mistake in mistakes(field)]
    assert not wrong, report(wrong)


# ----------------------------------------------------------------------------------------------------------- helpers


def imports(module: str) -> Iterator[tuple[str, int]]:
    """All modules that `module` imports anywhere in it, by their full name, with the line."""
    package = module if PATHS[module].name == "__init__.py" else module.rpartition(".")[0]
    for node in ast.walk(TREES[module]):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            up = package.split(".")[:len(package.split(".")) - node.level + 1] if node.level else []
            source = ".".join([*up, *filter(None, [node.module])])
            for alias in node.names:
                inner = f"{source}.{alias.name}"
                yield (inner if inner in PATHS else source), node.lineno


def room(module: str) -> str:
    """The part of the house that a module belongs to."""
    return [*module.split("."), "cellmig"][1]


def floor(module: str) -> int:
    """How high it lies."""
    return FLOORS.index(room(module)) if room(module) in FLOORS else -1


def place(module: str, line: int) -> str:
    """Where, as editors understand it."""
    return f"{PATHS[module].relative_to(ROOT)}:{line}"


def report(offenders: list[str]) -> str:
    """One offender a line."""
    return "\n  ".join(["", *offenders])


def package(*suffixes: str) -> dict[str, str]:
    """Texts of the package by their name from the root: Python and C, or those of these suffixes."""
    return {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
            for path in sorted((ROOT / "cellmig").rglob("*")) if path.suffix in (suffixes or LONGEST)}


def matches(pattern: str, texts: dict[str, str], flags: int = 0) -> list[str]:
    """Where in these texts a pattern is found, with the line."""
    return [f"{name}:{number}: {line.strip()}" for name, text in texts.items()
            for number, line in enumerate(text.splitlines(), 1) for _ in re.finditer(pattern, line, flags)]


def prose() -> dict[str, str]:
    """Comments and docstrings of the package, each in its line, by the name of the file."""
    return {name: "\n".join(remarks(text)) if name.endswith(".py") else
            re.sub(r"(?s)(?:^|(?<=\*/)).*?(?:(?=/\*)|$)", lambda code: "\n" * code[0].count("\n"), text)
            for name, text in package().items()}


def remarks(text: str) -> list[str]:
    """Lines of Python without what is not comment or docstring."""
    lines = [""] * (text.count("\n") + 1)
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        docstring = token.type == tokenize.STRING and token.line.lstrip(" r").startswith('"""')
        if docstring or token.type == tokenize.COMMENT:
            for number, line in enumerate(token.string.splitlines(), token.start[0] - 1):
                lines[number] += line
    return lines


def line_of(text: str, place: int) -> int:
    """The number of the line of a place in a text."""
    return text.count("\n", 0, place) + 1


def tracked_files() -> list[Path]:
    """What git keeps; without git, what is in no hidden and no output directory."""
    listed = subprocess.run(["git", "-C", str(ROOT), "ls-files", "-z"], capture_output=True, text=True)
    if listed.returncode == 0:
        return [path for name in listed.stdout.split("\0") if name and (path := ROOT / name).is_file()]
    beside = {"output", "build"}
    return [path for path in ROOT.rglob("*") if path.is_file()
            and not any(part.startswith(".") or part in beside for part in path.relative_to(ROOT).parts)]


def mistakes(field: dataclasses.Field) -> Iterator[str]:
    """What a parameter of a law fails to say."""
    if not field.metadata.get("doc"):
        yield f"{field.name} has no doc"
    if "float" in str(field.type) and "unit" not in field.metadata:
        yield f"{field.name} is a number without a unit (\"\" where there is none)"
    elif unit := field.metadata.get("unit"):
        try:
            units.number(f"1 {unit}", unit)
        except units.UnitError as error:
            yield f"{field.name}: {error}"
