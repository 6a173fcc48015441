"""Pointwise formulas, of laws and of forces: how they are called, and what they are written with."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np

Vector = tuple  # two numbers, or arrays of them
Vector3 = tuple  # three


def either(yes: Any, one: tuple, other: tuple) -> tuple:
    """Nested numbers of one tuple where `yes`, else of the other; C computes only what is chosen."""
    if hasattr(yes, "either"):
        return yes.either(one, other)
    return tuple(either(yes, a, b) if isinstance(a, tuple) else np.where(yes, a, b)
                 for a, b in zip(one, other, strict=True))


def between(start: Vector, end: Vector) -> Vector:
    """The vector from one place to another."""
    return tuple(b - a for a, b in zip(start, end, strict=True))


def pointwise(law: Any, method: str, quantities: dict[str, np.ndarray]) -> Any:
    """Result of a pointwise `method` of a law; `quantities` (..., n), in the code's units, are passed by name.

    One that has a default may be absent.
    """
    names = list(inspect.signature(getattr(type(law), method)).parameters)[1:]
    return getattr(law, method)(**{n: quantities[n] for n in names if n in quantities})
