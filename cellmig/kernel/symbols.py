"""Symbols, which stand for the numbers of a formula and record what it does with them."""

from __future__ import annotations

import inspect
import linecache
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..case import pointwise

# Functions that formulas may have, by numpy's names: how many arguments, in C of a number, of four at a time.
FUNCTIONS = {"log": (1, "log", "v4_log"), "sqrt": (1, "sqrt", "v4_sqrt"), "cbrt": (1, "cbrt", "v4_cbrt"),
             "minimum": (2, "d_minimum", "v4_minimum"), "maximum": (2, "d_maximum", "v4_maximum"),
             "power": (2, "pow", "v4_pow")}
FUNCTIONS |= {name: (1, c, f"v4_of_{c}") for name, c in (
    ("exp", "exp"), ("sin", "sin"), ("cos", "cos"), ("tan", "tan"), ("arctan", "atan"), ("sinh", "sinh"),
    ("cosh", "cosh"), ("tanh", "tanh"), ("absolute", "fabs"))}
OPERATORS = {"add": "+", "subtract": "-", "multiply": "*", "divide": "/"}
COMPARISONS = {"less": "<", "less_equal": "<=", "greater": ">", "greater_equal": ">="}
CHOICE = "either"  # beginning of the operation of a number that `either` chooses
NUMBER = "number"  # the kind of an attribute whose value a formula does not depend on
_MOST = 64  # a whole power up to which is a product
_NOT_OF_LAWS = (__file__, pointwise.__file__, inspect.__file__)


class LawError(ValueError):
    """A law that cannot be translated to C; the message has its file and line, and is for the user."""


class Symbol(np.lib.mixins.NDArrayOperatorsMixin):
    """A number, or a condition, of a formula: an operation on others, by numpy's name.

    one : whether it is the same for all particles;  number : the later made, the higher.
    """

    __slots__ = ("number", "one", "operands", "operation", "trace")
    __hash__ = object.__hash__

    def __init__(self, trace: Trace, operation: str, operands: tuple, one: bool, number: int):
        self.trace, self.operation, self.operands, self.one, self.number = trace, operation, operands, one, number

    @property
    def truth(self) -> bool:
        """Whether it is a condition."""
        return self.operation in COMPARISONS

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        """Operators and functions of numpy."""
        name = ufunc.__name__
        if method != "__call__" or options or name not in {*FUNCTIONS, *OPERATORS, *COMPARISONS, "negative"}:
            raise LawError(f"a formula has + - * / **, comparisons, where, {', '.join(sorted(FUNCTIONS))}, not {name}")
        return self.trace.operation(name, *inputs)

    def __array_function__(self, function: Any, types: Any, inputs: tuple, options: dict) -> Any:
        """np.where, the only function of arrays that a formula has."""
        if function is not np.where:
            raise LawError(f"a formula has no {function.__name__}")
        if len(inputs) != 3:
            raise LawError("where takes 3 arguments")
        yes, a, b = inputs
        return self.trace.node("where", yes, a, b) if isinstance(yes, Symbol) else a if yes else b

    def either(self, one: tuple, other: tuple) -> tuple:
        """Nested numbers of one tuple where this condition holds, else of the other."""
        return self.trace.either(self, one, other)

    def __bool__(self) -> bool:
        raise LawError("what depends on a value is where(condition, a, b), not if, and, or, a < b < c")


class Trace:
    """What a method did: symbols, each operation on the same operands once.

    parameters : list of str -- attributes of the law that it used;  choices : list -- conditions of `either`, and both
    nested tuples;  seen : dict -- kinds of all attributes that it read, on which alone the symbols depend.
    """

    def __init__(self, parameters: list[str]):
        self.parameters = parameters
        self.seen: dict[str, Any] = {}
        self.choices: list[tuple[Symbol, tuple, tuple]] = []
        self._known: dict[tuple, Symbol] = {}

    def node(self, operation: str, *operands: Any, one: bool = True) -> Symbol:
        """The symbol of an operation on symbols and numbers, which is `one` if these are.

        Raises LawError for operands that are neither.
        """
        for i, a in enumerate(operands):
            is_number = isinstance(a, Symbol | int | float | np.number)
            if not is_number or (isinstance(a, Symbol) and a.truth != (operation == "where" and i == 0)):
                raise LawError("a number, or in where first a condition, is needed")
        values: tuple[Any, ...] = tuple(a if isinstance(a, Symbol) else float(a) for a in operands)
        names = [repr(a) if isinstance(a, float) else f"x{a.number}" for a in values]
        key = (operation, *(sorted(names) if operation in ("add", "multiply") else names))
        if key not in self._known:
            one = one and all(a.one for a in values if isinstance(a, Symbol))
            self._known[key] = Symbol(self, operation, values, one, len(self._known))
        return self._known[key]

    def operation(self, name: str, a: Any, b: Any = None) -> Any:
        """An operation, but what 0 and 1 leave of a number, and whole powers, which are products."""
        left, right = (None if isinstance(x, Symbol) else x for x in (a, b))
        if name == "power" and right is not None and right in range(1, _MOST + 1):
            product = a
            for _ in range(int(right) - 1):
                product = product * a
            return product
        if (name == "multiply" and 0.0 in (left, right)) or (name == "divide" and left == 0.0):
            return 0.0
        if (name in ("multiply", "divide") and right == 1.0) or (name in ("add", "subtract") and right == 0.0):
            return a
        if (name == "multiply" and left == 1.0) or (name == "add" and left == 0.0):
            return b
        if (name == "subtract" and left == 0.0) or (name == "multiply" and left == -1.0):
            return -b
        return self.node(name, a) if b is None else self.node(name, a, b)

    def either(self, yes: Symbol, one: tuple, other: tuple) -> tuple:
        """Numbers of one of two nested tuples.  Raises LawError where these have different shapes."""
        if shape_of(one) != shape_of(other):
            raise LawError("either takes two tuples of the same shape")
        self.choices.append((yes, one, other))
        name = f"{CHOICE}_{len(self.choices) - 1}"
        return mapped(lambda place: self.node(place, one=False), indexed(name, shape_of(one)))


class _SeenLaw:
    """A law as its methods see it: numbers are parameters, objects laws of their own, methods those of its class."""

    def __init__(self, trace: Trace, law: Any, path: str = ""):
        self.__dict__.update(_trace=trace, _law=law, _path=path)

    def __getattr__(self, name: str) -> Any:
        law, path, known = self._law, self._path + name, self._trace.parameters
        method = getattr(type(law), name, None)
        if callable(method):
            return partial(inspect.unwrap(method), self)
        value = getattr(law, name, None)
        kind = self._trace.seen[path] = kind_of(value)
        if kind is NUMBER:
            if path not in known:
                known.append(path)
            return self._trace.node(f"p[{known.index(path)}]")
        if value is None or isinstance(value, str | tuple):
            raise LawError(f"'self.{path}' is no number")
        return value if isinstance(value, bool) else _SeenLaw(self._trace, value, f"{path}.")


def kind_of(value: Any) -> Any:
    """What a method sees of an attribute: that it is a number, whether it is true, else its class."""
    return value if isinstance(value, bool) else NUMBER if isinstance(value, int | float) else type(value)


def traced(law: Any, method: str, trace: Trace, arguments: list) -> Any:
    """Result of a method, a symbol or nested tuples of them.

    Raises LawError with the place of what it cannot do.
    """
    function = inspect.unwrap(getattr(type(law), method))
    try:
        result = function(_SeenLaw(trace, law), *arguments)
    except Exception as error:
        frames = [at for at in traceback.walk_tb(error.__traceback__) if _of_law(at[0].f_code.co_filename)]
        code, line = function.__code__, function.__code__.co_firstlineno
        if frames:
            code, line = frames[-1][0].f_code, frames[-1][1]
        place, text = f"{code.co_filename}:{line}: {code.co_qualname}", linecache.getline(code.co_filename, line)
        said = "it calls itself" if isinstance(error, RecursionError) else str(error)
        raise LawError(f"{place}: '{text.partition('  #')[0].strip()}' is not translated to C: {said}") from error
    if any(not isinstance(value, Symbol | int | float | np.number) for value in leaves(result)):
        place = f"{inspect.getsourcefile(function)}:{function.__code__.co_firstlineno}: {function.__qualname__}"
        raise LawError(f"{place}: returns nothing, or what is no number")
    return result


def _of_law(file: str) -> bool:
    """Whether a file may be a law's."""
    return not file.startswith(("<", str(Path(np.__file__).parent))) and file not in _NOT_OF_LAWS


def mapped(function: Callable[[Any], Any], value: Any) -> Any:
    """A function of all numbers of a nested tuple, in the same nesting."""
    return tuple(mapped(function, v) for v in value) if isinstance(value, tuple) else function(value)


def leaves(value: Any) -> list:
    """All numbers of a nested tuple, in order."""
    return [leaf for v in value for leaf in leaves(v)] if isinstance(value, tuple) else [value]


def indexed(name: str, shape: tuple[int, ...]) -> Any:
    """C of the numbers of an array with this shape, in nested tuples."""
    if not shape:
        return name
    return tuple(indexed(f"{name}[{i}]", shape[1:]) for i in range(shape[0]))


def shape_of(value: Any) -> tuple[int, ...]:
    """Shape of a nested tuple."""
    return (len(value), *shape_of(value[0])) if isinstance(value, tuple) else ()
