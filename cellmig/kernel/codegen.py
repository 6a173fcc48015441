"""Laws and forces in C: pointwise methods, written once in Python, as inline C functions.

The subset is what a formula needs: assignments, tuples, arithmetic, powers, the functions below, calls of pointwise
methods of the law or of laws that are its attributes and of functions of the module, loops over a constant of the
module, and one `return`.  Numbers among the attributes become entries of a parameter vector, so that a law is compiled
once for all values.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from operator import attrgetter
from typing import Any

SHAPES = {"F": (2, 2), "Fdot": (2, 2), "gradient": (2,), "director": (2,), "bend": (2,), "bend_rate": (2,)}  # by name
ANNOTATED = {"Vector": (2,)}  # of others by their annotation; the rest are scalars
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
        self._variables = 0
        self._place: list[tuple] = []  # methods under way: function, file, first line, object and how the law names it

    def function(self, method: str, name: str, results: tuple[str, ...] = ()) -> str:
        """C source of the `static inline` function `name` for a method.

        A number is returned; a tuple is written to the argument `out`, or, part by part, to arguments called `results`.

        Raises LawError.
        """
        self._lines, self._variables = [], 0
        shapes = shapes_of(getattr(type(self.law), method))
        result = self._method(self.law, "", method, [_indexed(a, shape) for a, shape in shapes.items()])
        declared = [f"const {self.number} {a}{_brackets(shape)}" for a, shape in shapes.items()]
        kind, returned = "void", []
        if isinstance(result, tuple):
            parts = zip(results, result, strict=True) if results else [("out", result)]
            for part, value in parts:
                declared.append(f"{self.number} {part}{_brackets(_shape(value)) or '[1]'}")
                returned += _stored(part, value if isinstance(value, tuple) else (value,), self._spread)
        else:
            kind, returned = self.number, [f"return {self._spread(result)};"]
        body = "\n".join("    " + line for line in self._lines + returned)
        return f"static inline {kind} {name}({', '.join(['const double *p', *declared])}) {{\n{body}\n}}\n"

    def _method(self, law: Any, path: str, method: str, arguments: list) -> Any:
        """Result of a method of the law, or of one that is its attribute `path`, such as "bonds."."""
        return self._result(inspect.unwrap(getattr(type(law), method)), law, path, arguments, 1)

    def _result(self, function: Any, law: Any, path: str, arguments: list, first_argument: int = 0) -> Any:
        """Result of a function, or of a method without its first argument."""
        lines, first = inspect.getsourcelines(function)
        if len(self._place) > 20:
            raise self._error(None, "calls itself")
        self._place.append((function, inspect.getsourcefile(function), first, law, path))
        tree: Any = ast.parse(textwrap.dedent("".join(lines))).body[0]
        given = [a.arg for a in tree.args.args[first_argument:]]
        if len(given) != len(arguments):
            raise self._error(tree, f"takes {len(given)} arguments, not {len(arguments)}")
        names: dict[str, Any] = {}
        for name, value in zip(given, arguments, strict=True):
            if isinstance(value, tuple) or value.isidentifier() or value[-1] == "]":
                names[name] = value
            else:
                self._assign(ast.Name(name), value, names)
        for statement in tree.body:
            if isinstance(statement, ast.Return) and statement.value is not None:
                result = self._value(statement.value, names)
                self._place.pop()
                return result
            self._statement(statement, names)
        raise self._error(tree, "returns nothing")

    def _statement(self, statement: ast.stmt, names: dict) -> None:
        """An assignment; a loop over a constant, unrolled; a docstring."""
        match statement:
            case ast.Assign(targets=[target]):
                self._assign(target, self._value(statement.value, names), names)
            case ast.For(iter=ast.Name(id=name), orelse=[]) if isinstance(self._constant(name), tuple):
                for item in self._constant(name):
                    self._assign(statement.target, _numbers(item), names)
                    for inner in statement.body:
                        self._statement(inner, names)
            case ast.Expr(value=ast.Constant()):
                pass
            case _:
                raise self._error(statement, f"'{ast.unparse(statement)}' is no assignment, nor the return at its end")

    def _constant(self, name: str) -> Any:
        """What the module of the method under way calls so."""
        return self._place[-1][0].__globals__.get(name)

    def _error(self, node: ast.AST | None, what: str) -> LawError:
        function, file, first, *_ = self._place[-1]
        return LawError(f"{file}:{first + getattr(node, 'lineno', 1) - 1}: {function.__qualname__}: {what}")

    def _assign(self, target: ast.expr, value: Any, names: dict) -> None:
        if isinstance(target, ast.Tuple) and isinstance(value, tuple) and len(target.elts) == len(value):
            for t, v in zip(target.elts, value, strict=True):
                self._assign(t, v, names)
        elif not isinstance(target, ast.Name):
            raise self._error(target, f"nothing can be assigned to '{ast.unparse(target)}'")
        elif isinstance(value, tuple) or target.id == "_":
            names[target.id] = value
        else:
            kind = type(value)
            names[target.id] = kind(f"{target.id}_{self._variables}")
            self._variables += 1
            self._lines.append(f"const {'double' if kind is _One else self.number} {names[target.id]} = {value};")

    def _value(self, node: Any, names: dict) -> Any:
        match node:
            case ast.Tuple():
                return tuple(self._value(e, names) for e in node.elts)
            case ast.Name() if node.id in names:
                return names[node.id]
            case ast.Name() if type(number := self._constant(node.id)) in (int, float):
                return _numbers(number)
            case ast.Constant() if type(node.value) in (int, float):
                return _numbers(node.value)
            case ast.Attribute() if owner := self._object(node.value):
                law, path = owner
                if not isinstance(getattr(law, node.attr, None), int | float):
                    raise self._error(node, f"'{ast.unparse(node)}' is no number")
                if path + node.attr not in self.parameters:
                    self.parameters.append(path + node.attr)
                return _One(f"p[{self.parameters.index(path + node.attr)}]")
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
            case ast.Call(func=ast.Attribute(value=of, attr=method), keywords=[]) if owner := self._object(of):
                law, path = owner
                if not callable(getattr(type(law), method, None)):
                    raise self._error(node, f"has no method '{method}'")
                return self._method(law, path, method, [self._value(a, names) for a in node.args])
            case ast.Call(func=ast.Name(id="either"), args=[yes, a, b], keywords=[]):
                return self._either(yes, a, b, names)
            case ast.Call(func=ast.Name(id=name) | ast.Attribute(value=ast.Name(id="np" | "numpy"), attr=name),
                          keywords=[]) if name in FUNCTIONS:
                return self._call(node, name, names)
            case ast.Call(func=ast.Name(id=name), keywords=[]) if inspect.isfunction(self._constant(name)):
                *_, law, path = self._place[-1]
                return self._result(self._constant(name), law, path, [self._value(a, names) for a in node.args])
        raise self._error(node, f"'{ast.unparse(node)}' is not translated to C; a formula has numbers, parameters of "
                                f"the law, + - * / **, comparisons, other methods, {', '.join(sorted(FUNCTIONS))}")

    def _object(self, node: ast.expr) -> tuple[Any, str] | None:
        """What `self`, or `self.bonds` and so on, is in the method under way, and how the law names it."""
        match node:
            case ast.Name(id="self"):
                *_, law, path = self._place[-1]
                return law, path
            case ast.Attribute() if owner := self._object(node.value):
                return getattr(owner[0], node.attr, None), f"{owner[1]}{node.attr}."
        return None

    def _number(self, node: ast.expr, names: dict) -> str:
        value = self._value(node, names)
        if isinstance(value, tuple):
            raise self._error(node, f"'{ast.unparse(node)}' is a tuple, not a number")
        return value

    def _power(self, node: ast.BinOp, names: dict) -> str:
        base, power = self._number(node.left, names), node.right
        if isinstance(power, ast.Constant) and type(power.value) in (int, float) and power.value in range(1, _MOST + 1):
            return type(base)("(" + "*".join([f"({base})"] * int(ast.literal_eval(power))) + ")")
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

    def _either(self, yes: ast.expr, a: ast.expr, b: ast.expr, names: dict) -> Any:
        """One of two results of several numbers, of which C computes only the one that is chosen."""
        condition, lines, branches = self._number(yes, names), self._lines, []
        for node in (a, b):
            self._lines = []
            value = self._value(node, names)
            branches.append((self._lines, value))
        self._lines = lines
        shape, name = _shape(branches[0][1]), f"either_{self._variables}"
        if self.number != "double" or not shape or shape != _shape(branches[1][1]):
            raise self._error(yes, "either takes two tuples of the same shape, one number at a time")
        self._variables += 1
        self._lines.append(f"double {name}{_brackets(shape)};")
        for start, (inner, value) in zip((f"if ({condition}) {{", "} else {"), branches, strict=True):
            self._lines += [start, *("    " + line for line in inner + _stored(name, value))]
        self._lines.append("}")
        return _indexed(name, shape)

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
        """Values of `parameters` of this law, in their units."""
        return [float(attrgetter(name)(self.law)) for name in self.parameters]


def shapes_of(method: Any) -> dict[str, tuple]:
    """Shapes of the arguments of a pointwise method."""
    arguments = list(inspect.signature(method).parameters.values())[1:]
    return {a.name: SHAPES.get(a.name, ANNOTATED.get(a.annotation, ())) for a in arguments}


def _numbers(value: Any) -> Any:
    """C of constants, nested as they are."""
    return tuple(map(_numbers, value)) if isinstance(value, tuple) else _One(repr(float(value)))


def _stored(name: str, value: Any, spread: Any = str) -> list[str]:
    """Assignments of nested values to an array of C."""
    if not isinstance(value, tuple):
        return [f"{name} = {spread(value)};"]
    return [line for i, v in enumerate(value) for line in _stored(f"{name}[{i}]", v, spread)]


def _indexed(name: str, shape: tuple) -> Any:
    if not shape:
        return name
    return tuple(_indexed(f"{name}[{i}]", shape[1:]) for i in range(shape[0]))


def _shape(value: Any) -> tuple:
    return (len(value), *_shape(value[0])) if isinstance(value, tuple) else ()


def _brackets(shape: tuple) -> str:
    return "".join(f"[{n}]" for n in shape)
