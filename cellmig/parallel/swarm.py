"""The particles of a rank in a PETSc DMSwarm, which holds their fields and sends them to their owners."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from mpi4py import MPI
from petsc4py import PETSc


class Swarm:
    """Particles of this rank, with their fields.

    These are id; positions X and displacements u (n, d) [µm], velocities v (n, d) [µm/µs], directors (n,) [rad] or
    (n, 3) [-], and the losses and impulses accumulated so far (n, k).
    """

    def __init__(self, comm: MPI.Intracomm, fields: dict[str, np.ndarray]):
        """Swarm of the particles whose `fields`, by name, this rank has, whichever rank is to own them; collective."""
        self.comm = comm
        self.dm = PETSc.DMSwarm().create(comm=comm)
        self._width = {name: int(np.prod(values.shape[1:])) for name, values in fields.items()}
        self.dm.setDimension(self._width["X"])
        self.dm.setType(PETSc.DMSwarm.Type.BASIC)
        self.dm.initializeFieldRegister()
        for name, width in self._width.items():
            self.dm.registerField(name, width, dtype=PETSc.IntType if name == "id" else PETSc.RealType)
        self.dm.finalizeFieldRegister()
        self.dm.setLocalSizes(len(fields["id"]), 16)
        for name, values in fields.items():
            self[name] = values

    @contextmanager
    def field(self, name: str) -> Iterator[np.ndarray]:
        """A field as an array to read or write in place, (n,) or (n, width), in its unit."""
        width = self._width.get(name, 1)
        try:
            values = self.dm.getField(name)
            yield values.reshape(-1, width) if width > 1 else values
        finally:
            self.dm.restoreField(name)

    def __setitem__(self, name: str, values: np.ndarray) -> None:
        with self.field(name) as f:
            f[:] = values.reshape(f.shape)

    def __getitem__(self, name: str) -> np.ndarray:
        with self.field(name) as f:
            return f.copy()

    def migrate(self, owner: np.ndarray) -> None:
        """Send each particle to the rank `owner` (n,) int, and sort the particles of a rank by id; collective."""
        self["DMSwarm_rank"] = owner
        self.dm.migrate(remove_sent_points=True)
        order = np.argsort(self["id"], kind="stable")
        for name in self._width:
            self[name] = self[name][order]

    def destroy(self) -> None:
        """Free the PETSc object."""
        self.dm.destroy()
