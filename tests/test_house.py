"""The rules of the house, executable: floors, sizes, docstrings, documented laws, nothing of one machine.

What is not yet so has a ceiling, which only falls.  `python tests/docstrings.py` lists what docstrings leave out.
"""

from __future__ import annotations

import ast
import dataclasses
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import docstrings
import pytest

from cellmig.case import registry, units
from cellmig.laws import register

pytestmark = pytest.mark.serial

ROOT = Path(__file__).resolve().parent.parent
# From the ground up; each imports only from its own floor and those below.  `cellmig` is the package's own front door.
FLOORS = ["exits", "version", "case", "model", "geometry", "laws", "meshfree", "kernel", "parallel", "output", "solve",
          "plot", "simulation", "runs", "paper", "bench", "verify", "doctor", "cellmig", "usage", "__main__"]
SIBLINGS = {"paper", "bench", "verify"}  # beside each other: none imports another
PETSC_ROOMS = {"parallel", "solve", "__main__"}
LONGEST_MODULE, LONGEST_FUNCTION = 400, 60
LONGER = {"cellmig/kernel/c/step.c": 1010}  # to be split
SILENT = {"model": 3, "geometry": 43, "meshfree": 48, "kernel": 18, "solve": 69}  # docstrings, to be completed
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
    """C as well as Python; what is longer so far may only fall."""
    paths = [path for path in tracked_files() if path.suffix in (".py", ".c") and path.is_relative_to(ROOT / "cellmig")]
    assert {path.name for path in paths} >= {"step.c", "simulation.py"}
    lines = {str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines()) for path in paths}
    long = [f"{name}: {n} lines, of {LONGER.get(name, LONGEST_MODULE)}" for name, n in lines.items()
            if n > LONGER.get(name, LONGEST_MODULE)]
    assert not long, report(long)
    short = [f"{name} is down to {lines[name]}: so is its limit" for name, n in LONGER.items() if lines[name] < n - 20]
    assert not short, report(short)


def test_c_says_what_it_is_and_its_lines_fit_as_those_of_python_do() -> None:
    wrong = []
    for path in tracked_files():
        if path.suffix != ".c":
            continue
        text = path.read_text(encoding="utf-8")
        wrong += [f"{path.relative_to(ROOT)}:1: no comment says what the file is"] * (not text.startswith("/*"))
        for number, line in enumerate(text.splitlines(), 1):
            wide = len(line) > 120 and str(path.relative_to(ROOT)) not in LONGER
            wrong += [f"{path.relative_to(ROOT)}:{number}: {len(line)} characters"] * wide
            wrong += [f"{path.relative_to(ROOT)}:{number}: a tab, or blanks at the end"] * (
                "\t" in line or line != line.rstrip())
    assert not wrong, report(wrong)


def test_no_text_cites_a_page_that_is_not_in_the_project() -> None:
    """A reader cannot open it: the source itself is cited, or the derivation."""
    pages = {path.name for path in tracked_files() if path.suffix == ".md"}
    found = []
    for path in tracked_files():
        if path.suffix not in (".py", ".c", ".md", ".toml", ".ipynb", ".yml", ".sh", ".def", ""):
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
    assert len(silent) <= SILENT[room], f"{len(silent)}, of {SILENT[room]}:" + report(silent)


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
        except (UnicodeDecodeError, FileNotFoundError):  # a picture; a file that is about to go
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


def tracked_files() -> list[Path]:
    """What git keeps; without git, what is in no hidden and no output directory."""
    listed = subprocess.run(["git", "-C", str(ROOT), "ls-files", "-z"], capture_output=True, text=True)
    if listed.returncode == 0:
        return [ROOT / name for name in listed.stdout.split("\0") if name]
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
