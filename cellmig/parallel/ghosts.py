"""Ghosted PETSc vectors: fields on the particles of a rank, and on ghosts of the others that its forces need."""

from __future__ import annotations

import ctypes
from functools import cache

import numpy as np

from mpi4py import MPI
from petsc4py import PETSc

from . import shared


class GhostedField:
    """A field of a few numbers per particle: the particles of this rank, then the ghosts chosen by `set_ghosts`.

    Ghosts are current after `exchange`.  The memory is the caller's; its address never changes.
    """

    def __init__(self, comm: MPI.Intracomm, memory: np.ndarray, n_owned: int, n_shared: int):
        """Field in `memory` (>= n_local, width), of any unit, with `n_owned` owned particles; collective.

        At most `n_shared` of them become ghosts of other ranks.
        """
        self._comm, self._memory, self._n_owned = comm, memory, n_owned
        self._copies = shared.SharedCopies(comm, memory, n_owned, n_shared) if shared.on_one_machine(comm) else None
        self.owned = memory[:n_owned]
        self.vec: PETSc.Vec = None  # until `set_ghosts`

    def set_ghosts(self, ghosts: np.ndarray) -> None:
        """Choose the particles `ghosts` (n_ghosts,) int, by their numbers in PETSc's order; collective."""
        if self.vec is not None:
            self.vec.destroy()
        n_owned, width = self._n_owned, self._memory.shape[1]
        self.array = self._memory[: n_owned + len(ghosts)]
        self.vec = PETSc.Vec().createGhostWithArray(ghosts.astype(PETSc.IntType), self.array.ravel(),
                                                    size=(n_owned * width, None), bsize=width, comm=self._comm)
        if self._copies is not None:
            self._copies.connect(ghosts)

    def exchange(self) -> None:
        """Update the ghosts; collective."""
        self.vec.ghostUpdate(PETSc.InsertMode.INSERT_VALUES, PETSc.ScatterMode.FORWARD)

    @property
    def handle(self) -> int:
        """Address of the object that the `exchange_functions` take as their first argument."""
        return self.vec.handle if self._copies is None else self._copies.handle

    @property
    def exchange_functions(self) -> tuple[int, ...]:
        """Addresses of the C functions that begin and end `exchange`, so that computation can overlap it."""
        return _petsc_functions() if self._copies is None else shared.exchange_functions()

    def destroy(self) -> None:
        """Free the objects of PETSc and MPI; collective."""
        self.vec.destroy()
        if self._copies is not None:
            self._copies.destroy()


@cache
def _petsc_functions() -> tuple[int, ...]:
    """Addresses of VecGhostUpdateBegin and VecGhostUpdateEnd."""
    begin, end = shared.addresses(ctypes.CDLL(petsc_library()), "VecGhostUpdateBegin", "VecGhostUpdateEnd")
    return shared.messages(begin, end)


def petsc_library() -> str:
    """Path of the PETSc library that this process has loaded.

    Raises OSError where it is not in the memory map of the process.
    """
    with open("/proc/self/maps", encoding="utf-8", errors="surrogateescape") as maps:
        for line in maps:
            if "/libpetsc" in line:
                return line.split(maxsplit=5)[5].strip()
    raise OSError("the PETSc library of this process was not found in its memory map")
