"""Laws called at points: each quantity that a method asks for, by its name."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np


def pointwise(law: Any, method: str, quantities: dict[str, np.ndarray]) -> Any:
    """A pointwise method of a law, given those of the quantities that it asks for by name."""
    names = list(inspect.signature(getattr(type(law), method)).parameters)[1:]
    return getattr(law, method)(*[quantities[n] for n in names])
