"""What public docstrings leave out: `python tests/docstrings.py [ROOM…]` lists it, one offender a line.

In the rooms of ROOMS, a public function, method or class says

- of arrays their shape, `(n, 2)`, and every parameter that is one has its name in the docstring;
- of numbers and arrays their unit, `[µm]` or `[-]`, unless all arrays are `(n,) int` or `(n,) bool`; values of any
  unit are said to be so in words with "unit" in them;
- under `Raises` what it raises;
- of a formula where it comes from, if neither its class nor its module does: `Source:`, an equation or a year.

Annotations tell which are arrays and numbers.  A method of a law has none: it is a number.  A class answers for the
parameters of its constructor, a dataclass for its fields.  Below a heading every entry has its own shape and unit.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent.parent / "cellmig"
ROOMS = ["case", "model", "geometry", "meshfree", "kernel", "parallel", "cues", "solve"]

ARRAY, NUMBER = re.compile(r"\bndarray\b"), re.compile(r"\bfloat\b")
CONTAINER = re.compile(r"\b(?:dict|Mapping|Callable)\[.*\]")  # what is in it has its own description
SHAPE = re.compile(r"\([^()\[\]]*,[^()\[\]]*\)")
DISCRETE = re.compile(SHAPE.pattern + r"(?= (?:int|bool)\b)")
NAME = r"(?:[µkMGnf]?(?:m|s|Pa|N|g|B|flop)|pN|rad|kg|min|h|K)(?![A-Za-z])"
UNIT = re.compile(rf"\[(?:-(?:, -)*|[\d/(·, ]*{NAME}(?:[\d\s/·,()²³⁴⁻¹½^-]|\^\(?D[\s\d+-]*|{NAME})*)\]|\bunits?\b")
SOURCE = re.compile(r"Source:|[Ee]quations? \(|\(\d+[a-z]?\)|\b(?:19|20)\d\d\b|appendix", re.IGNORECASE)
FORMULA = re.compile(r"(?<![=<>!:`]) = (?=.*[-+/*^²³√Σ∮∇]).*[A-Za-zα-ωΑ-Ω]")

Function = ast.FunctionDef | ast.AsyncFunctionDef


def offenders(room: str) -> list[str]:
    """`file:line: name: what is missing` for all that is public in a room."""
    found = []
    for path in sorted((PACKAGE / room).rglob("*.py")):
        module = ast.parse(path.read_text(encoding="utf-8"), str(path))
        for node, owner in public(module):
            above = " ".join(ast.get_docstring(n) or "" for n in (module, owner) if n is not None)
            name = f"{owner.name}.{node.name}" if owner is not None else node.name
            found += [f"{path.relative_to(PACKAGE.parent)}:{node.lineno}: {name}: {what}"
                      for what in missing(node, owner, above)]
    return found


def public(module: ast.Module) -> Iterator[tuple[Function | ast.ClassDef, ast.ClassDef | None]]:
    """Functions and classes of a module and methods of its classes, with the class."""
    for node in module.body:
        if isinstance(node, Function | ast.ClassDef) and not node.name.startswith("_"):
            yield node, None
            for method in getattr(node, "body", []) if isinstance(node, ast.ClassDef) else []:
                if isinstance(method, Function) and not method.name.startswith("_"):
                    yield method, node


def missing(node: Function | ast.ClassDef, owner: ast.ClassDef | None, above: str) -> Iterator[str]:
    """What the docstring of a node should say and does not; `above` are those of its class and module."""
    text = ast.get_docstring(node) or ""
    if not text:
        yield "no docstring"
        return
    if isinstance(node, ast.ClassDef):
        start = next((n for n in node.body if isinstance(n, Function) and n.name == "__init__"), None)
        text += "\n" + ((start and ast.get_docstring(start)) or "")
        kinds, result, raising = (parameters(start) if start else fields(node)), "", start
    else:
        kinds, result, raising = parameters(node), returned(node, owner), node
    arrays = [name for name, kind in kinds.items() if ARRAY.search(kind)]
    numbers = any(NUMBER.search(kind) for kind in (*kinds.values(), result))
    for name in arrays:
        if not re.search(rf"(?<!\w){re.escape(name)}(?!\w)", text):
            yield f"the array {name} is not in it"
    if (arrays or ARRAY.search(result)) and not SHAPE.search(text):
        yield "no shape, such as (n, 2)"
    real = (arrays or ARRAY.search(result)) and len(DISCRETE.findall(text)) < len(SHAPE.findall(text))
    if (numbers or real) and not UNIT.search(text):
        yield "no unit, such as [µm] or [-], nor int or bool"
    for name, entry in entries(text):
        annotated = kinds.get(name, "")
        if ARRAY.search(annotated) and not SHAPE.search(entry):
            yield f"no shape of {name}"
        real = NUMBER.search(annotated) or (ARRAY.search(annotated) and not DISCRETE.search(entry))
        if real and not UNIT.search(entry):
            yield f"no unit of {name}, nor int or bool"
    if raising is not None and raises(raising) and not re.search(r"\bRaises?\b", text):
        yield "raises, and does not say so (Raises)"
    if FORMULA.search(text) and not SOURCE.search(text + above):
        yield "a formula without its source"


def parameters(function: Function) -> dict[str, str]:
    """Names of the parameters and what they are annotated with."""
    every = (*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs)
    return {a.arg: kind(a.annotation) for a in every if a.annotation is not None}


def returned(function: Function, owner: ast.ClassDef | None) -> str:
    """What the result is annotated with; that of a law's formula, which is not, is a number."""
    if function.returns is not None:
        return kind(function.returns)
    return "float" if owner is not None else ""


def fields(node: ast.ClassDef) -> dict[str, str]:
    """Fields of a dataclass and their types, but for quantities of laws, which are declared with their unit."""
    return {n.target.id: kind(n.annotation) for n in node.body
            if isinstance(n, ast.AnnAssign) and not n.target.id.startswith("_")
            and not (isinstance(n.value, ast.Call) and getattr(n.value.func, "id", "") in ("quantity", "parameter"))}


def kind(annotation: ast.expr) -> str:
    """The text of an annotation without what containers hold."""
    return CONTAINER.sub("", ast.unparse(annotation))


def raises(node: ast.AST) -> bool:
    """Whether it raises an error of its own: a bare `raise` hands on another's."""
    return any(isinstance(n, ast.Raise) and n.exc is not None for n in ast.walk(node))


def entries(text: str) -> Iterator[tuple[str, str]]:
    """Name and text of each entry `name : …` of a docstring, several of which may share a line."""
    for entry in re.split(r"(?:^|(?<=;  ))(?=`?\w+(?:`?, `?\w+)*`? : )|\n\s*\n", text, flags=re.MULTILINE):
        names, colon, _ = entry.partition(" : ")
        if colon and re.fullmatch(r"[\w`, ]+", names):
            yield from ((name.strip(" `"), entry) for name in names.split(","))


if __name__ == "__main__":
    for chosen in sys.argv[1:] or ROOMS:
        for line in offenders(chosen):
            print(line)
