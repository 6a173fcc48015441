"""The kernel of a scene: its C source, compiled once, and the structure that it works on."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..meshfree.terms import Terms
from .fields import Field, step_memory
from .source import FOLDER, c_source, parameters
from .toolchain import library, loaded

_NUMBERS = {"double": ctypes.c_double, "long": ctypes.c_long}  # all else is a pointer
_DTYPES = {"double *": np.float64, "uint32_t *": np.uint32, "int32_t *": np.int32, "long *": np.int64}
LINE = 64  # bytes of a cache line


def aligned_zeros(shape: Any, dtype: Any = float) -> np.ndarray:
    """Zeros of a shape, such as (n, 2), and any unit, aligned to cache lines as the kernel's vectors need them."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    memory = np.zeros(size + LINE, np.uint8)
    start = -memory.ctypes.data % LINE
    return memory[start : start + size].view(dtype).reshape(shape)


class Kernel:
    """Compiled functions of a scene and the structure they work on.

    Set an array or a number with ``kernel["name"] = value``: the kernel keeps the array, or a copy that begins with a
    cache line, and passes its address; ``kernel["name"]`` is the array that it works on.
    """

    def __init__(self, materials: list, terms: Terms, fields: Sequence[Field]):
        """Compile the step of a scene with these material laws and terms; `fields` : all that its files of C name."""
        units, vectors = c_source(materials, terms, fields)
        self._types = {f.name: f.ctype for f in [*fields, *parameters(materials)]}
        ghosts: list[tuple[str, Any]] = [("ghost_begin", ctypes.c_void_p), ("ghost_end", ctypes.c_void_p)]
        members = ghosts + [(name, _NUMBERS.get(kind, ctypes.c_void_p)) for name, kind in self._types.items()]
        self._dtypes: dict[str, Any] = {**_DTYPES, "coefficient *": np.float32 if terms.single else np.float64,
                                        "StepMemory *": step_memory(terms)}
        self._structure = type("KernelData", (ctypes.Structure,), {"_fields_": members})()
        self._address = ctypes.byref(self._structure)
        self._arrays: dict[str, np.ndarray] = {}
        self.source = "\n".join(units)
        self.library = loaded(*units)
        for name, values in vectors.items():
            self[name] = np.array(values or [0.0])

    def __setitem__(self, name: str, value: Any) -> None:
        kind = self._types.get(name)
        if kind in self._dtypes and value is not None:
            value = np.ascontiguousarray(value, self._dtypes[kind])
            if value.ctypes.data % LINE:
                value, unaligned = aligned_zeros(value.shape, value.dtype), value
                value[...] = unaligned
            self._arrays[name] = value
            value = value.ctypes.data
        setattr(self._structure, name, value)

    def __getitem__(self, name: str) -> np.ndarray:
        return self._arrays[name]

    def __call__(self, function: str, *arguments: Any) -> int:
        """Call a C function on the scene; arrays are passed by address, floats and ints by value."""
        return getattr(self.library, function)(self._address, *[_argument(a) for a in arguments])

    def repeated(self, n: int, function: str, *arguments: Any) -> None:
        """Call a C function `n` times, with as little in between as Python can."""
        call, given = getattr(self.library, function), [_argument(a) for a in arguments]
        for _ in range(n):
            call(self._address, *given)

    @property
    def bytes(self) -> int:
        """Size of all arrays that it works on [B]."""
        return sum(a.nbytes for a in self._arrays.values())


def _argument(a: Any) -> Any:
    if isinstance(a, np.ndarray):
        return ctypes.c_void_p(a.ctypes.data)
    if isinstance(a, float):
        return ctypes.c_double(a)
    return ctypes.c_long(a) if isinstance(a, int) else a


def assemble(*arguments: Any) -> None:
    """The function of assemble.c; integers in arrays are of type long."""
    library(FOLDER / "assemble.c").assemble(*[_argument(a) for a in arguments])
