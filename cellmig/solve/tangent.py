"""Consistent tangents: derivatives of any law, exact to rounding, by forward differentiation of its formulas.

A dual number carries a value and its derivatives in some directions through a formula, with rules for all operations
that formulas may have (see kernel/codegen.py), so that a law does not declare its tangent.

Source: forward automatic differentiation, Griewank & Walther (2008).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ..case.pointwise import pointwise
from ..model.protocols import Value


class Dual:
    """Dual numbers.

    value : (...);  slope : (k, ...) -- its derivatives in k directions.
    """

    __slots__ = ("slope", "value")

    def __init__(self, value: Value, slope: Value):
        self.value, self.slope = value, slope

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        """Arithmetic and functions by the chain rule; comparisons of values."""
        values = [getattr(x, "value", x) for x in inputs]
        if method != "__call__" or options:
            return NotImplemented
        if ufunc in COMPARISONS:
            return ufunc(*values)
        if ufunc not in RULES:
            return NotImplemented
        partial = RULES[ufunc](*values)
        terms = [p * x.slope for p, x in zip(partial, inputs, strict=False) if isinstance(x, Dual)]
        return Dual(ufunc(*values), sum(terms[1:], terms[0]))

    # The same rules for operators, which most of a formula are, without the detour through numpy.

    def __add__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.value + other.value, self.slope + other.slope)
        return Dual(self.value + other, self.slope)

    def __sub__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.value - other.value, self.slope - other.slope)
        return Dual(self.value - other, self.slope)

    def __rsub__(self, other: Any) -> Dual:
        return Dual(other - self.value, -self.slope)

    def __mul__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.value * other.value, other.value * self.slope + self.value * other.slope)
        return Dual(self.value * other, other * self.slope)

    def __truediv__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            share = self.value / other.value
            return Dual(share, (self.slope - share * other.slope) / other.value)
        return Dual(self.value / other, self.slope / other)

    def __rtruediv__(self, other: Any) -> Dual:
        share = other / self.value
        return Dual(share, -share / self.value * self.slope)

    def __neg__(self) -> Dual:
        return Dual(-self.value, -self.slope)

    def __pow__(self, power: Any) -> Any:
        return self.__array_ufunc__(np.power, "__call__", self, power)

    def __rpow__(self, base: Any) -> Any:
        return self.__array_ufunc__(np.power, "__call__", base, self)

    def __abs__(self) -> Any:
        return self.__array_ufunc__(np.absolute, "__call__", self)

    def __eq__(self, other: object) -> bool:
        raise TypeError("a formula compares numbers by < and >, not by ==")

    def __lt__(self, other: Any) -> Any:
        return self.value < getattr(other, "value", other)

    def __le__(self, other: Any) -> Any:
        return self.value <= getattr(other, "value", other)

    def __gt__(self, other: Any) -> Any:
        return self.value > getattr(other, "value", other)

    def __ge__(self, other: Any) -> Any:
        return self.value >= getattr(other, "value", other)

    __radd__, __rmul__ = __add__, __mul__

    def __array_function__(self, function: Any, types: Any, inputs: Any, options: Any) -> Any:
        """The function `where`, for values and derivatives."""
        if function is not np.where or options or len(inputs) != 3:
            return NotImplemented
        yes, a, b = inputs
        value = np.where(yes, getattr(a, "value", a), getattr(b, "value", b))
        return Dual(value, np.where(yes, getattr(a, "slope", 0.0), getattr(b, "slope", 0.0)))


COMPARISONS = (np.less, np.less_equal, np.greater, np.greater_equal)
RULES: dict[np.ufunc, Callable[..., tuple]] = {  # partial derivatives
    np.add: lambda a, b: (1.0, 1.0),
    np.subtract: lambda a, b: (1.0, -1.0),
    np.multiply: lambda a, b: (b, a),
    np.divide: lambda a, b: (1.0 / b, -a / b**2),
    np.negative: lambda a: (-1.0,),
    np.power: lambda a, n: (n * a ** (n - 1), np.log(np.where(a > 0.0, a, 1.0)) * a**n),
    np.exp: lambda a: (np.exp(a),),
    np.sin: lambda a: (np.cos(a),),
    np.cos: lambda a: (-np.sin(a),),
    np.tan: lambda a: (1.0 / np.cos(a) ** 2,),
    np.arctan: lambda a: (1.0 / (1.0 + a**2),),
    np.sinh: lambda a: (np.cosh(a),),
    np.cosh: lambda a: (np.sinh(a),),
    np.tanh: lambda a: (1.0 / np.cosh(a) ** 2,),
    np.log: lambda a: (1.0 / a,),
    np.sqrt: lambda a: (0.5 / np.sqrt(a),),
    np.cbrt: lambda a: (np.cbrt(a) / (3.0 * a),),
    np.absolute: lambda a: (np.sign(a),),
    np.minimum: lambda a, b: (np.less(a, b), np.greater_equal(a, b)),
    np.maximum: lambda a, b: (np.greater(a, b), np.less_equal(a, b)),
}


def derivative(formula: Callable[..., Any], *arguments: Any) -> tuple[np.ndarray, np.ndarray]:
    """Values of a formula and its derivatives by all entries of its arguments, in their units.

    Parameters
    ----------
    formula : takes numbers, or tuples of them, and returns such;
    arguments : each (shape, ..., n) or (n,) -- scalars, vectors and tensors with points last.

    Returns
    -------
    value : (result, n);  slope : (result, entries, n) -- by the entries of all arguments in turn, row by row.
    """
    given = [np.asarray(a, float) for a in arguments]
    entries = [a.reshape(math.prod(a.shape[:-1]), a.shape[-1]) for a in given]
    unit = np.eye(sum(map(len, entries)))[:, :, None]
    duals, k = [], 0
    for a, e in zip(given, entries, strict=True):
        duals.append(_nested([Dual(row, unit[k + i]) for i, row in enumerate(e)], a.shape[:-1]))
        k += len(e)
    points = np.broadcast_shapes(*(e.shape[-1:] for e in entries))
    result = formula(*duals)
    return _unfolded(result, (), points), _unfolded(result, (k,), points)


def tangent(law: Any, method: str, quantities: dict[str, np.ndarray], by: str = "F") -> np.ndarray:
    """Derivative of a law's pointwise method, such as "stress" (2, 2, n), by an argument, such as F, in their units.

    `quantities` : by name, as `pointwise` takes them.  Returns (2, 2, 2, 2, n) for a tensor by a tensor: dP_ij/dF_kl.
    """
    return mixed(lambda **moved: pointwise(law, method, {**quantities, **moved}), {by: (quantities[by], 1.0)})


def mixed(formula: Callable[..., Any], arguments: dict[str, tuple[np.ndarray, float]]) -> np.ndarray:
    """Sum of a formula's derivatives by arguments of one shape, each times a factor: (result, shape, n), any units.

    `arguments` : value (shape, n) and factor by name.  It is the derivative by one change d that moves each argument
    by its factor times d.
    """
    shape = np.shape(next(iter(arguments.values()))[0])

    def moved(change: Value) -> Value:
        return formula(**{name: _moved(value, factor, change) for name, (value, factor) in arguments.items()})

    slope = derivative(moved, np.zeros(shape))[1]
    return slope.reshape(*slope.shape[:-2], *shape)


def _moved(value: np.ndarray, factor: float, change: Any) -> Any:
    """Values plus a factor times nested duals, in the same nesting."""
    if isinstance(change, tuple):
        return tuple(_moved(v, factor, c) for v, c in zip(value, change, strict=True))
    return value + factor * change


def _nested(entries: list, shape: tuple) -> Any:
    """Entries, row by row, as nested tuples of a shape."""
    if not shape:
        return entries[0]
    step = len(entries) // shape[0]
    return tuple(_nested(entries[i * step : (i + 1) * step], shape[1:]) for i in range(shape[0]))


def _unfolded(result: Any, directions: tuple, points: tuple) -> np.ndarray:
    """Values, or derivatives in some directions, of nested tuples as an array."""
    if isinstance(result, tuple):
        return np.array([_unfolded(r, directions, points) for r in result])
    part: Any = getattr(result, "slope" if directions else "value", 0.0 if directions else result)
    return np.broadcast_to(part, (*directions, *points))
