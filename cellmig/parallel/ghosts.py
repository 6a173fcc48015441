"""Ghosted PETSc vectors: fields of a rank's own particles, with copies of the others' that its forces need."""

from __future__ import annotations

import ctypes
from functools import cache

import numpy as np

from mpi4py import MPI
from petsc4py import PETSc

from . import shared


class GhostedField:
    """A field of some numbers a particle: this rank's particles first, then the copies asked for by `set_ghosts`.

    They are current after `exchange`.  The memory is the caller's and stays where it is, whatever copies are asked for.
    """

    def __init__(self, comm: MPI.Comm, memory: np.ndarray, n_owned: int, n_shared: int):
        """`memory` : (>= n_local, width);  `n_shared` : how many own particles others may ask for; collective."""
        self._comm, self._memory, self._n_owned = comm, memory, n_owned
        self._copies = shared.SharedCopies(comm, memory, n_owned, n_shared) if shared.on_one_machine(comm) else None
        self.owned, self.vec = memory[:n_owned], None

    def set_ghosts(self, ghosts: np.ndarray) -> None:
        """Copies are of these particles from now on, by their numbers in PETSc's order (n_ghosts,); collective."""
        if self.vec is not None:
            self.vec.destroy()
        n_owned, width = self._n_owned, self._memory.shape[1]
        self.array = self._memory[: n_owned + len(ghosts)]
        self.vec = PETSc.Vec().createGhostWithArray(ghosts.astype(PETSc.IntType), self.array.ravel(),
                                                    size=(n_owned * width, None), bsize=width, comm=self._comm)
        if self._copies is not None:
            self._copies.connect(ghosts)

    def exchange(self) -> None:
        """Bring the copies up to date; collective."""
        self.vec.ghostUpdate(PETSc.InsertMode.INSERT_VALUES, PETSc.ScatterMode.FORWARD)

    @property
    def handle(self) -> int:
        """What `exchange_functions` work on, for C."""
        return self.vec.handle if self._copies is None else self._copies.handle

    @property
    def exchange_functions(self) -> tuple[int, int]:
        """Addresses of the two halves of `exchange`, so that steps in C can overlap it with work."""
        return _petsc_functions() if self._copies is None else shared.exchange_functions()

    def destroy(self) -> None:
        """Free what is PETSc's and MPI's; collective."""
        self.vec.destroy()
        if self._copies is not None:
            self._copies.destroy()


@cache
def _petsc_functions() -> tuple[int, int]:
    """Addresses of VecGhostUpdateBegin and VecGhostUpdateEnd."""
    return shared.addresses(ctypes.CDLL(petsc_library()), "VecGhostUpdateBegin", "VecGhostUpdateEnd")


def petsc_library() -> str:
    """File of the PETSc library that this process has loaded."""
    with open("/proc/self/maps", encoding="utf-8", errors="surrogateescape") as maps:
        for line in maps:
            if "/libpetsc" in line:
                return line.split(maxsplit=5)[5].strip()
    raise OSError("the PETSc library of this process was not found in its memory map")
