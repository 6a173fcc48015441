"""Formulas of the position, and of the time, such as "0.02*x um/us", in place of numbers of a case file."""

from __future__ import annotations

import ast
import math
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import units
from .time_unit import SIZES

FUNCTIONS = {name: getattr(np, name) for name in ("sin", "cos", "tan", "exp", "log", "sqrt", "hypot", "tanh")}
FUNCTIONS |= {"abs": np.abs, "atan2": np.arctan2, "min": np.minimum, "max": np.maximum}
NAMES = ("x", "y", "z", "r", "pi")
TIMES = {f"t_{symbol}": size for symbol, size in SIZES.items()}  # the time in each unit, by name, and its size [µs]
_OPERATORS = {ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply, ast.Div: np.divide, ast.Pow: np.power}
_PLACE = r"(?<![\w.])(?:" + "|".join([*NAMES, *TIMES, *FUNCTIONS]) + r")(?!\w)"
_FORMULA = re.compile(_PLACE + r"|^[-+\s]*[\d.]+([eE][-+]?\d+)?\s*\*")


@dataclass(frozen=True)
class Expression:
    """A formula of x, y, z and the distance r [µm] from an origin, followed by the unit of its values.

    The origin is the centre of the cell, or for a field that of the case.  In two dimensions there is no z; pure
    numbers have no unit.

    Attributes
    ----------
    text : str -- formula and unit, as in the case file.
    unit : str -- any unit of the expected kind.
    dimension : int -- of the points.
    timed : bool -- whether it may depend on the time, t_s in seconds, t_h in hours … (TIMES).

    Raises ValueError for a text that is no such formula; the message is for the user.
    """

    text: str
    unit: str
    dimension: int = 2
    timed: bool = False

    def __post_init__(self) -> None:
        """Check the formula by evaluating it."""
        self._split()
        self(np.array([[0.3, 0.4, 0.5]])[:, : self.dimension])

    def __call__(self, X: np.ndarray, time: float = 0.0) -> np.ndarray:
        """Values (n,) in the code's units at points X (n, d) [µm] from the origin, at a `time` [µs] if it is timed."""
        formula, scale = self._split()
        r = np.hypot(X[:, 0], X[:, 1]) if self.dimension == 2 else np.linalg.norm(X, axis=1)
        names = {**dict(zip("xyz", X.T, strict=False)), "r": r, "pi": math.pi}
        names |= {name: time / size for name, size in TIMES.items()} if self.timed else {}
        with np.errstate(all="ignore"):  # the caller checks that values are finite
            return np.broadcast_to(scale * self._value(formula, names), len(X)).astype(float)

    def _split(self) -> tuple[ast.expr, float]:
        """The formula and the factor of its unit: the text is split at the first blank that leaves both valid."""
        text = units.plain(self.text).strip()
        for blank in [*(m.start() for m in re.finditer(r"\s", text)), len(text)]:
            formula, unit = text[:blank], text[blank:].strip()
            try:
                return ast.parse(formula, mode="eval").body, units.number(f"1 {unit}", self.unit)
            except (SyntaxError, units.UnitError):
                continue
        kind = "formula with a unit" if self.unit else "formula"
        raise ValueError(f"'{self.text}' is not a {kind}, such as '{units.written('0.1*x', self.unit)}'")

    def _value(self, node: ast.expr, names: dict[str, Any]) -> Any:
        match node:
            case ast.Constant(value=number) if type(number) in (int, float):
                return float(number)
            case ast.Name(id=name) if name in names:
                return names[name]
            case ast.UnaryOp(op=ast.USub() | ast.UAdd() as sign, operand=operand):
                return self._value(operand, names) * (-1.0 if isinstance(sign, ast.USub) else 1.0)
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
                return _OPERATORS[type(op)](self._value(left, names), self._value(right, names))
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if name in FUNCTIONS:
                if len(arguments) != FUNCTIONS[name].nin:
                    raise ValueError(f"'{self.text}': {name} takes {FUNCTIONS[name].nin}")
                return FUNCTIONS[name](*[self._value(a, names) for a in arguments])
        if self.timed and getattr(node, "id", "") == "t":
            raise ValueError(f"'{self.text}': the time has a unit: write t_s for seconds, t_h for hours …")
        raise ValueError(f"'{self.text}': '{ast.unparse(node)}' is not known; a formula has numbers, "
                         f"{', '.join([*names, *FUNCTIONS])} and + - * / **")


def is_formula(text: Any) -> bool:
    """Whether a text is a formula rather than a quantity: it has a name such as x or sin, or a product."""
    return isinstance(text, str) and _FORMULA.search(units.plain(text)) is not None


def unit_of(text: str) -> str:
    """The unit at the end of a formula, of any kind, "" of pure numbers.  Raises ValueError for what is no formula."""
    text = units.plain(text).strip()
    for blank in [*(m.start() for m in re.finditer(r"\s", text)), len(text)]:
        formula, unit = text[:blank], text[blank:].strip()
        try:
            ast.parse(formula, mode="eval")
            units.number(f"1 {unit}", unit)
            return unit
        except (SyntaxError, units.UnitError):
            continue
    raise ValueError(f"'{text}' is not a formula with a unit, such as '5 + 0.02*x nM'")


def evaluate(value: float | Expression, X: np.ndarray) -> np.ndarray:
    """Values (n,) of a number or a formula, in the code's units, at points X (n, d) [µm] from the cell's centre."""
    return value(X) if isinstance(value, Expression) else np.full(len(X), float(value))
