"""Laws and forces in C: pointwise methods, written once in Python, as inline C functions.

A method is called once, with symbols in place of numbers.  So it may have loops, functions and tuples as Python has
them; what depends on a value is `where`, or `either`.  Numbers among the attributes become entries of a parameter
vector, so that a law is compiled once for all values.
"""

from __future__ import annotations

import inspect
import re
from functools import reduce
from operator import attrgetter
from typing import Any

from ..model.director import numbers
from .symbols import (
    CHOICE,
    COMPARISONS,
    FUNCTIONS,
    OPERATORS,
    Symbol,
    Trace,
    indexed,
    kind_of,
    leaves,
    mapped,
    shape_of,
    traced,
)

# Shapes of tensors by their names, in d dimensions with m numbers of a director.
TENSORS = {"F": "dd", "Fdot": "dd", "gradient": "md", "director": "d", "bend": "d", "bend_rate": "d",
           "network": "dd", "velocity": "d"}
ANNOTATED = {"Vector": (2,), "Vector3": (3,)}  # shapes of others by their annotation; the rest are scalars
_ZERO = {1: " = {{0}}", 2: " = {{{0}}}"}  # initial values of nested vectors
_FUNCTIONS: dict[tuple, list[tuple]] = {}  # of methods: what they saw, the parameters then, and their C


class Translator:
    """Translates methods of one law; `parameters` lists the attributes they use, in order of the vector `p`."""

    def __init__(self, law: Any, number: str, dimension: int = 2):
        """`number` is the C type of a quantity: "double", or "v4" for four particles at a time."""
        self.law, self.number, self.dimension = law, number, dimension
        self.parameters: list[str] = []

    def function(self, method: str, name: str, results: tuple[str, ...] = ()) -> str:
        """C source of the `static inline` function `name` for a method.

        A number is returned; a tuple is written to the argument `out`, or, part by part, to arguments called `results`.
        The source of before is taken where the method sees attributes of the same kinds.

        Raises LawError.
        """
        law = type(self.law)
        known = _FUNCTIONS.setdefault((law, getattr(law, method), name, results, self.number, self.dimension,
                                       *self.parameters), [])
        for seen, parameters, source in known:
            if all(_kind(self.law, path) == kind for path, kind in seen.items()):
                self.parameters[:] = parameters
                return source
        trace, source = self._translated(method, name, results)
        known.append((trace.seen, list(self.parameters), source))
        return source

    def _translated(self, method: str, name: str, results: tuple[str, ...]) -> tuple[Trace, str]:
        trace, shapes = Trace(self.parameters), shapes_of(getattr(type(self.law), method), self.dimension)
        given = [mapped(lambda text: trace.node(text, one=False), indexed(a, shape)) for a, shape in shapes.items()]
        result = traced(self.law, method, trace, given)
        declared = [f"const {self.number} {a}{_brackets(shape)}" for a, shape in shapes.items()]
        text = _Text(trace, self.number, result)
        kind, returned = "void", []
        if isinstance(result, tuple):
            for part, value in zip(results, result, strict=True) if results else [("out", result)]:
                declared.append(f"{self.number} {part}{_brackets(shape_of(value)) or '[1]'}")
                returned += text.stored(part, value if isinstance(value, tuple) else (value,))
        else:
            kind, returned = self.number, [f"return {text.spread(result)};"]
        body = "\n".join("    " + line for line in text.lines + returned)
        head = f"static inline {kind} {name}({', '.join(['const double *p', *declared])})"
        return trace, f"{head} {{\n{body}\n}}\n"

    def vector(self) -> list[float]:
        """Values of `parameters` of this law, in their units."""
        return [float(attrgetter(name)(self.law)) for name in self.parameters]


class _Text:
    """C of the symbols that results need.  One that is used once stands where it is used, others have names.

    lines : statements, in order.
    """

    def __init__(self, trace: Trace, number: str, results: Any):
        """Note what uses each symbol: others, the branches of choices, the result."""
        self.lines: list[str] = []
        self._trace, self._number = trace, number
        self._names: dict[Any, str] = {}
        self._users: dict[Symbol, list] = {}
        self._note(leaves(results), "result")

    def _note(self, values: list, user: Any) -> None:
        for value in values:
            if not isinstance(value, Symbol):
                continue
            seen = value in self._users
            self._users.setdefault(value, []).append(user)
            if seen:
                continue
            self._note(list(value.operands), value)
            if value.operation.startswith(CHOICE) and (choice := _choice(value)) not in self._names:
                self._names[choice] = ""
                for branch, needed in enumerate(self._trace.choices[choice]):
                    self._note(leaves(needed), (choice, branch))

    def of(self, value: Any) -> str:
        """C of a number; statements that it needs are added to the lines."""
        if not isinstance(value, Symbol):
            return repr(float(value))
        if value in self._names:
            return self._names[value]
        if not value.operands:
            if value.operation.startswith(CHOICE):
                self._choose(_choice(value))
            return value.operation
        text = self._expression(value)
        if len(self._users[value]) == 1:
            return text
        kind = "double" if value.one or self._number == "double" else "i4" if value.truth else self._number
        name = self._names[value] = f"x{value.number}"
        self.lines.append(f"const {kind} {name} = {text};")
        return name

    def _expression(self, value: Symbol) -> str:
        """C of an operation."""
        name, operands, one = value.operation, value.operands, value.one or self._number == "double"
        if name == "negative":
            return f"(-{self.of(operands[0])})"
        if name in ("add", "subtract") and not one and (fused := self._fused(name, *operands)):
            return fused
        if name in OPERATORS:
            return f"({self.of(operands[0])} {OPERATORS[name]} {self.of(operands[1])})"
        known = [self.of(a) if one or (isinstance(a, Symbol) and a.truth) else self.spread(a) for a in operands]
        if name in COMPARISONS:
            return f"{known[0]} {COMPARISONS[name]} {known[1]}"
        if name == "where":
            return "(({}) ? {} : {})".format(*known) if one or operands[0].one else f"v4_where({', '.join(known)})"
        return f"{FUNCTIONS[name][1 if one else 2]}({', '.join(known)})"

    def _fused(self, name: str, left: Any, right: Any) -> str:
        """C of a sum or difference with a product that nothing else uses, rounded once; "" if there is none."""
        for product, other, function in ((left, right, {"add": "fma4", "subtract": "fms4"}[name]),
                                         (right, left, {"add": "fma4", "subtract": "fnma4"}[name])):
            if (isinstance(product, Symbol) and product.operation == "multiply" and not product.one
                    and product not in self._names and len(self._users[product]) == 1):
                return f"{function}({', '.join(map(self.spread, (*product.operands, other)))})"
        return ""

    def spread(self, value: Any) -> str:
        """A number as one for each particle."""
        same = not isinstance(value, Symbol) or value.one
        return f"splat({self.of(value)})" if self._number == "v4" and same else self.of(value)

    def stored(self, name: str, value: Any) -> list[str]:
        """Assignments of nested values to an array of C."""
        if not isinstance(value, tuple):
            return [f"{name} = {self.spread(value)};"]
        return [line for i, v in enumerate(value) for line in self.stored(f"{name}[{i}]", v)]

    def _choose(self, choice: int) -> None:
        """Statements of `either`: what only one branch needs stands in it, and of four both where some need each."""
        if self._names[choice]:
            return
        name = self._names[choice] = f"{CHOICE}_{choice}"
        yes, *branches = self._trace.choices[choice]
        condition = self.of(yes)
        for branch, values in enumerate(branches, 1):
            needed: list[Any] = _needed(values)
            only: set[Any] = {(choice, branch)}
            for value in reversed(needed):
                if only.issuperset(self._users[value]):
                    only.add(value)
            for value in needed:
                if value not in only and len(self._users[value]) > 1:
                    self.of(value)
        shape, each = shape_of(branches[0]), self._number == "v4" and not yes.one
        self.lines.append(f"{self._number} {name}{_brackets(shape)}{_ZERO[len(shape)] if each else ''};")
        starts = [f"if ({condition}) {{", "} else {"]
        if each:
            self.lines += [f"const i4 {name}_is = {condition};", f"const int {name}_of = signs((v4){name}_is);"]
            starts = [f"if ({name}_of) {{", f"}}\nif ({name}_of != 15) {{"]
        outer, known = self.lines, dict(self._names)
        for start, values in zip(starts, branches, strict=True):
            self.lines, self._names = [], dict(known)
            assigned = self.stored(name, values)
            if each and values is branches[1]:
                assigned = [re.sub("(.*) = (.*);", rf"\1 = v4_where({name}_is, \1, \2);", line) for line in assigned]
            outer += [*start.split("\n"), *("    " + line for line in self.lines + assigned)]
        self.lines, self._names = [*outer, "}"], known


def _choice(value: Symbol) -> int:
    """The number of the choice that a symbol is of."""
    return int(value.operation.removeprefix(f"{CHOICE}_").partition("[")[0])


def _needed(values: tuple) -> list[Symbol]:
    """Symbols that some need, operands first."""
    found, stack = set(), [v for v in leaves(values) if isinstance(v, Symbol)]
    while stack:
        if (value := stack.pop()) not in found:
            found.add(value)
            stack += [v for v in value.operands if isinstance(v, Symbol)]
    return sorted(found, key=lambda v: v.number)


def _kind(law: Any, path: str) -> Any:
    """The kind of an attribute of a law, or of one of a law in it."""
    return kind_of(reduce(lambda owner, name: getattr(owner, name, None), path.split("."), law))


def shapes_of(method: Any, dimension: int = 2) -> dict[str, tuple]:
    """Shapes of the arguments of a pointwise method."""
    size = {"d": dimension, "m": numbers(dimension)}
    return {a.name: ANNOTATED.get(a.annotation) or tuple(size[n] for n in TENSORS.get(a.name, ""))
            for a in list(inspect.signature(method).parameters.values())[1:]}


def _brackets(shape: tuple) -> str:
    return "".join(f"[{n}]" for n in shape)
