"""Ghosted PETSc vectors: fields of a rank's own particles, with copies of the others' that its forces need."""

from __future__ import annotations

import ctypes
from functools import cache

import numpy as np

from petsc4py import PETSc


class GhostedField:
    """A field of some numbers a particle: this rank's particles first, then copies, current after `exchange`.

    The memory is the caller's and stays where it is when other copies are asked for.
    """

    def __init__(self, comm: PETSc.Comm, memory: np.ndarray, n_owned: int, ghosts: np.ndarray):
        """`memory` : (>= n_owned + n_ghosts, width);  `ghosts` : (n_ghosts,) -- their numbers in PETSc's order."""
        n_local, width = n_owned + len(ghosts), memory.shape[1]
        self.array = memory[:n_local]
        self.owned = memory[:n_owned]
        self.vec = PETSc.Vec().createGhostWithArray(
            ghosts.astype(PETSc.IntType), self.array.ravel(), size=(n_owned * width, None), bsize=width, comm=comm)

    def exchange(self) -> None:
        """Bring the copies up to date; collective."""
        self.vec.ghostUpdate(PETSc.InsertMode.INSERT_VALUES, PETSc.ScatterMode.FORWARD)

    @property
    def handle(self) -> int:
        """Address of the Vec, for C."""
        return self.vec.handle

    def destroy(self) -> None:
        """Free the PETSc object."""
        self.vec.destroy()


@cache
def exchange_functions() -> tuple[int, int]:
    """Addresses of VecGhostUpdateBegin and VecGhostUpdateEnd, so that steps in C can exchange ghosts."""
    library = ctypes.CDLL(petsc_library())
    return tuple(ctypes.cast(getattr(library, name), ctypes.c_void_p).value
                 for name in ("VecGhostUpdateBegin", "VecGhostUpdateEnd"))


def petsc_library() -> str:
    """File of the PETSc library that this process has loaded."""
    with open("/proc/self/maps") as maps:
        for line in maps:
            if "/libpetsc" in line:
                return line.split(maxsplit=5)[5].strip()
    raise OSError("the PETSc library of this process was not found in its memory map")
