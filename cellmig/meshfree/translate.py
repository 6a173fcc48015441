"""Laws in C: the pointwise methods of a law, written once in Python, as inline C functions.

The subset is what a formula needs: assignments, tuples, arithmetic, powers with whole exponents, `log`, `cbrt`, `sqrt`,
`where`, `minimum`, `maximum`, calls of other pointwise methods, and one `return`.  Attributes of the law become
entries of a parameter vector, so that a law is compiled once for all values.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from typing import Any

SHAPES = {"F": (2, 2), "Fdot": (2, 2), "gradient": (2,), "director": (2,)}  # of arguments; others are scalars
_OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
_COMPARISONS = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">="}


class Translator:
    """Translates methods of one law; `parameters` lists the attributes they use, in order of the vector `p`."""

    def __init__(self, law: Any, number: str):
        """`number` is the C type of a quantity: "double", or "v4" for four particles at a time."""
        self.law, self.number = law, number
        self.parameters: list[str] = []
        self._lines: list[str] = []

    def function(self, method: str, name: str) -> str:
        """C source of `static inline` function `name` for a method; results are written to `out`."""
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
            return [f"out{index} = {result};" if index else f"return {result};"]
        return [line for i, r in enumerate(result) for line in self._returned(r, f"{index}[{i}]")]

    def _method(self, method: str, arguments: list) -> Any:
        source = textwrap.dedent(inspect.getsource(getattr(type(self.law), method)))
        tree = ast.parse(source).body[0]
        names = dict(zip([a.arg for a in tree.args.args[1:]], arguments, strict=True))
        for statement in tree.body:
            if isinstance(statement, ast.Assign):
                self._assign(statement.targets[0], self._value(statement.value, names), names)
            elif isinstance(statement, ast.Return):
                return self._value(statement.value, names)
            elif not (isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)):
                raise SyntaxError(f"{type(self.law).__name__}.{method}: '{ast.unparse(statement)}' is not translated")
        raise SyntaxError(f"{type(self.law).__name__}.{method} returns nothing")

    def _assign(self, target: ast.expr, value: Any, names: dict) -> None:
        if isinstance(target, ast.Tuple):
            for t, v in zip(target.elts, value, strict=True):
                self._assign(t, v, names)
        elif isinstance(value, tuple):
            names[target.id] = value
        else:
            names[target.id] = f"{target.id}_{len(self._lines)}"
            self._lines.append(f"const {self.number} {names[target.id]} = {value};")

    def _value(self, node: ast.expr, names: dict) -> Any:
        match node:
            case ast.Tuple():
                return tuple(self._value(e, names) for e in node.elts)
            case ast.Name():
                return names[node.id]
            case ast.Constant():
                return repr(float(node.value))
            case ast.Attribute(value=ast.Name(id="self")):
                if node.attr not in self.parameters:
                    self.parameters.append(node.attr)
                return f"p[{self.parameters.index(node.attr)}]"
            case ast.UnaryOp(op=ast.USub()):
                return f"(-{self._value(node.operand, names)})"
            case ast.BinOp(op=ast.Pow()):
                base = self._value(node.left, names)
                return "(" + "*".join([f"({base})"] * int(node.right.value)) + ")"
            case ast.BinOp():
                return f"({self._value(node.left, names)} {_OPERATORS[type(node.op)]} {self._value(node.right, names)})"
            case ast.Compare():
                sign = _COMPARISONS[type(node.ops[0])]
                return f"{self._value(node.left, names)} {sign} {self._value(node.comparators[0], names)}"
            case ast.Call(func=ast.Attribute(value=ast.Name(id="self"))):
                return self._method(node.func.attr, [self._value(a, names) for a in node.args])
            case ast.Call(func=ast.Name(id="where")):
                yes, a, b = (self._value(a, names) for a in node.args)
                return f"(({yes}) ? {a} : {b})"
            case ast.Call(func=ast.Name()):
                prefix = "v4_" if self.number == "v4" else "d_"
                return f"{prefix}{node.func.id}({', '.join(self._value(a, names) for a in node.args)})"
        raise SyntaxError(f"{type(self.law).__name__}: '{ast.unparse(node)}' is not translated")

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
