"""What PETSc refers to is destroyed before Python ends: PETSc finalises later, and would call Python."""

from __future__ import annotations

import atexit
from itertools import count
from typing import Any
from weakref import WeakValueDictionary

_NUMBERS = count()
_ALIVE: WeakValueDictionary[int, Any] = WeakValueDictionary()


def kept(thing: Any) -> None:
    """Have a thing destroyed at the end, in the order in which things were made."""
    _ALIVE[next(_NUMBERS)] = thing


def destroyed(thing: Any) -> bool:
    """Whether a thing is still to be destroyed; it is no longer afterwards."""
    numbers = [number for number, other in _ALIVE.items() if other is thing]
    for number in numbers:
        del _ALIVE[number]
    return bool(numbers)


@atexit.register
def _destroy_all() -> None:
    for number in sorted(_ALIVE):
        _ALIVE[number].destroy()
