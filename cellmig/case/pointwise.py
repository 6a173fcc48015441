"""Calls of pointwise methods of laws, whose parameters are quantities by name."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np


def pointwise(law: Any, method: str, quantities: dict[str, np.ndarray]) -> Any:
    """Result of a pointwise `method` of a law; `quantities` (..., n), in the code's units, are passed by name."""
    names = list(inspect.signature(getattr(type(law), method)).parameters)[1:]
    return getattr(law, method)(*[quantities[n] for n in names])
