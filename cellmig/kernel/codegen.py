"""Laws in C: the pointwise methods of a law, written once in Python, as inline C functions.

The subset is what a formula needs: assignments, tuples, arithmetic, powers, the functions below, calls of other
pointwise methods, and one `return`.  Attributes of the law become entries of a parameter vector, so that a law is
compiled once for all values.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from typing import Any

SHAPES = {"F": (2, 2), "Fdot": (2, 2), "gradient": (2,), "director": (2,)}  # of arguments; others are scalars
_OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
_COMPARISONS = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">="}
# Functions of numpy's names: how many arguments, in C of a number, of four at a time.
FUNCTIONS = {"log": (1, "log", "v4_log"), "sqrt": (1, "sqrt", "v4_sqrt"), "cbrt": (1, "cbrt", "v4_cbrt"),
             "minimum": (2, "d_minimum", "v4_minimum"), "maximum": (2, "d_maximum", "v4_maximum"),
             "where": (3, "", "v4_where")}
FUNCTIONS |= {name: (1, c, f"v4_of_{c}") for name, c in (
    ("exp", "exp"), ("sin", "sin"), ("cos", "cos"), ("tan", "tan"), ("arctan", "atan"), ("sinh", "sinh"),
    ("cosh", "cosh"), ("tanh", "tanh"), ("abs", "fabs"))}
_MOST = 64  # a whole power up to which is a product


class LawError(ValueError):
    """A law that cannot be translated to C; the message has its file and line, and is for the user."""


class _One(str):
    """C of a number that is the same for all particles: in a vector of four it has to be spread."""

    __slots__ = ()


class Translator:
    """Translates methods of one law; `parameters` lists the attributes they use, in order of the vector `p`."""

    def __init__(self, law: Any, number: str):
        """`number` is the C type of a quantity: "double", or "v4" for four particles at a time."""
        self.law, self.number = law, number
        self.parameters: list[str] = []
        self._lines: list[str] = []
        self._place: list[tuple] = []  # of the methods that are under way: function, its file and first line

    def function(self, method: str, name: str) -> str:
        """C source of `static inline` function `name` for a method; results are written to `out`.

        Raises LawError.
        """
        self._lines = []
        arguments = list(inspect.signature(getattr(type(self.law), method)).parameters)[1:]
        values = {a: _indexed(a, SHAPES.get(a, ())) for a in arguments}
        result = self._method(method, list(values.values()))
        declared = [f"const {self.number} {a}{_brackets(SHAPES.get(a, ()))}" for a in arguments]
        body = "\n".join("    " + line for line in self._lines + self._returned(result))
        kind = "void" if isinstance(result, tuple) else self.number
        out = [f"{self.number} out{_brackets(_shape(result))}"] if isinstance(result, tuple) else []
        signature = ", ".join(["const double *p", *declared, *out])
        return f"static inline {kind} {name}({signature}) {{\n    (void)p;\n{body}\n}}\n"

    def _returned(self, result: Any, index: str = "") -> list[str]:
        if not isinstance(result, tuple):
            return [f"out{index} = {self._spread(result)};" if index else f"return {self._spread(result)};"]
        return [line for i, r in enumerate(result) for line in self._returned(r, f"{index}[{i}]")]

    def _method(self, method: str, arguments: list) -> Any:
        function = inspect.unwrap(getattr(type(self.law), method))
        lines, first = inspect.getsourcelines(function)
        if len(self._place) > 20:
            raise self._error(None, "calls itself")
        self._place.append((function, inspect.getsourcefile(function), first))
        tree = ast.parse(textwrap.dedent("".join(lines))).body[0]
        given = [a.arg for a in tree.args.args[1:]]
        if len(given) != len(arguments):
            raise self._error(tree, f"takes {len(given)} arguments, not {len(arguments)}")
        names = dict(zip(given, arguments, strict=True))
        for statement in tree.body:
            if isinstance(statement, ast.Assign) and len(statement.targets) == 1:
                self._assign(statement.targets[0], self._value(statement.value, names), names)
            elif isinstance(statement, ast.Return) and statement.value is not None:
                result = self._value(statement.value, names)
                self._place.pop()
                return result
            elif not (isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)):
                raise self._error(statement, f"'{ast.unparse(statement)}' is no assignment, nor the return at its end")
        raise self._error(tree, "returns nothing")

    def _error(self, node: ast.AST | None, what: str) -> LawError:
        function, file, first = self._place[-1]
        return LawError(f"{file}:{first + getattr(node, 'lineno', 1) - 1}: {function.__qualname__}: {what}")

    def _assign(self, target: ast.expr, value: Any, names: dict) -> None:
        if isinstance(target, ast.Tuple) and isinstance(value, tuple) and len(target.elts) == len(value):
            for t, v in zip(target.elts, value, strict=True):
                self._assign(t, v, names)
        elif not isinstance(target, ast.Name):
            raise self._error(target, f"nothing can be assigned to '{ast.unparse(target)}'")
        elif isinstance(value, tuple):
            names[target.id] = value
        else:
            kind = type(value)
            names[target.id] = kind(f"{target.id}_{len(self._lines)}")
            self._lines.append(f"const {'double' if kind is _One else self.number} {names[target.id]} = {value};")

    def _value(self, node: ast.expr, names: dict) -> Any:
        match node:
            case ast.Tuple():
                return tuple(self._value(e, names) for e in node.elts)
            case ast.Name() if node.id in names:
                return names[node.id]
            case ast.Name() if type(number := self._place[-1][0].__globals__.get(node.id)) in (int, float):
                return _One(repr(float(number)))
            case ast.Constant() if type(node.value) in (int, float):
                return _One(repr(float(node.value)))
            case ast.Attribute(value=ast.Name(id="self")):
                if not isinstance(getattr(self.law, node.attr, None), int | float):
                    raise self._error(node, f"'self.{node.attr}' is no number")
                if node.attr not in self.parameters:
                    self.parameters.append(node.attr)
                return _One(f"p[{self.parameters.index(node.attr)}]")
            case ast.UnaryOp(op=ast.USub()):
                operand = self._number(node.operand, names)
                return type(operand)(f"(-{operand})")
            case ast.BinOp(op=ast.Pow()):
                return self._power(node, names)
            case ast.BinOp() if type(node.op) in _OPERATORS:
                a, b = self._number(node.left, names), self._number(node.right, names)
                return self._kind(a, b)(f"({a} {_OPERATORS[type(node.op)]} {b})")
            case ast.Compare() if len(node.ops) == 1 and type(node.ops[0]) in _COMPARISONS:
                a, b = self._number(node.left, names), self._number(node.comparators[0], names)
                kind = self._kind(a, b)
                a, b = (a, b) if kind is _One else (self._spread(a), self._spread(b))
                return kind(f"{a} {_COMPARISONS[type(node.ops[0])]} {b}")
            case ast.Call(func=ast.Attribute(value=ast.Name(id="self")), keywords=[]):
                if not callable(getattr(type(self.law), node.func.attr, None)):
                    raise self._error(node, f"has no method '{node.func.attr}'")
                return self._method(node.func.attr, [self._value(a, names) for a in node.args])
            case ast.Call(func=ast.Name(id=name) | ast.Attribute(value=ast.Name(id="np" | "numpy"), attr=name),
                          keywords=[]) if name in FUNCTIONS:
                return self._call(node, name, names)
        raise self._error(node, f"'{ast.unparse(node)}' is not translated to C; a formula has numbers, parameters of "
                                f"the law, + - * / **, comparisons, other methods, {', '.join(sorted(FUNCTIONS))}")

    def _number(self, node: ast.expr, names: dict) -> str:
        value = self._value(node, names)
        if isinstance(value, tuple):
            raise self._error(node, f"'{ast.unparse(node)}' is a tuple, not a number")
        return value

    def _power(self, node: ast.BinOp, names: dict) -> str:
        base, power = self._number(node.left, names), node.right
        if isinstance(power, ast.Constant) and type(power.value) in (int, float) and power.value in range(1, _MOST + 1):
            return type(base)("(" + "*".join([f"({base})"] * int(power.value)) + ")")
        return self._applied("pow", "v4_pow", [base, self._number(power, names)])

    def _call(self, node: ast.Call, name: str, names: dict) -> str:
        """A call of one of FUNCTIONS."""
        number, one, four = FUNCTIONS[name]
        if len(node.args) != number:
            raise self._error(node, f"'{ast.unparse(node)}': {name} takes {number}")
        arguments = [self._number(a, names) for a in node.args]
        if name != "where":
            return self._applied(one, four, arguments)
        yes, a, b = arguments
        if self.number == "double" or self._kind(yes) is _One:
            spread = (a, b) if self._kind(a, b) is _One else (self._spread(a), self._spread(b))
            return self._kind(a, b)("(({}) ? {} : {})".format(yes, *spread))
        return f"v4_where({yes}, {self._spread(a)}, {self._spread(b)})"

    def _applied(self, one: str, four: str, arguments: list[str]) -> str:
        """A C function of numbers, or of vectors of four."""
        if self.number == "double" or self._kind(*arguments) is _One:
            return self._kind(*arguments)(f"{one}({', '.join(arguments)})")
        return f"{four}({', '.join(map(self._spread, arguments))})"

    def _kind(self, *values: str) -> type:
        """Whether what is made of some values is the same for all particles."""
        return _One if all(isinstance(v, _One) for v in values) else str

    def _spread(self, value: str) -> str:
        """A value as one for each particle."""
        return f"splat({value})" if self.number == "v4" and isinstance(value, _One) else value

    def vector(self) -> list[float]:
        """Values of `parameters` for this law."""
        return [float(getattr(self.law, name)) for name in self.parameters]


def _indexed(name: str, shape: tuple) -> Any:
    if not shape:
        return name
    return tuple(_indexed(f"{name}[{i}]", shape[1:]) for i in range(shape[0]))


def _shape(value: Any) -> tuple:
    return (len(value), *_shape(value[0])) if isinstance(value, tuple) else ()


def _brackets(shape: tuple) -> str:
    return "".join(f"[{n}]" for n in shape)
