"""The triangles and tetrahedra between the particles of a run in three dimensions, in the file mesh.h5."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import h5py
import numpy as np

from .directory import OutputError, replace, together

if TYPE_CHECKING:
    from mpi4py import MPI

NAME = "mesh.h5"


class Elements:
    """The elements of a rank, those whose first corner it owns, and the particles of other ranks at their corners.

    Attributes
    ----------
    local : dict -- by the names of the parts corners (m, 3) or (m, 4) int32, by places in what `complete` returns.
    """

    def __init__(self, comm: MPI.Intracomm, parts: dict[str, np.ndarray], ids: np.ndarray) -> None:
        """Choose from `parts`: by name corners (m, 3) or (m, 4) int of all elements, by ids of particles; collective.

        ids : (n_owned,) int -- of the particles of this rank.
        """
        self._comm = comm
        everyone = comm.allgather(ids)
        owner, place = np.empty((2, sum(map(len, everyone))), int)
        for rank, some in enumerate(everyone):
            owner[some], place[some] = rank, np.arange(len(some))
        mine = {name: corners[owner[corners[:, 0]] == comm.rank] for name, corners in parts.items()}
        used = np.unique(np.concatenate([corners.ravel() for corners in mine.values()]))
        wanted = [used[owner[used] == rank] if rank != comm.rank else used[:0] for rank in range(comm.size)]
        self._given = [place[some] for some in comm.alltoall(wanted)]
        others = np.concatenate(wanted)
        place[others] = len(ids) + np.arange(len(others))
        self.local = {name: place[corners].astype(np.int32) for name, corners in mine.items()}

    def complete(self, values: np.ndarray) -> np.ndarray:
        """Values (n_owned, ...) of this rank's particles, and after them those of the others at its elements."""
        return np.concatenate([values, *self._comm.alltoall([values[some] for some in self._given])])


def write_mesh(directory: Path, comm: MPI.Intracomm, parts: dict[str, np.ndarray]) -> None:
    """Write `parts`: by name corners (m, 3) or (m, 4) int, by ids of particles; collective, rank 0 writes."""
    def write() -> None:
        with h5py.File("mesh", "w", driver="core", backing_store=False) as file:
            for name, corners in parts.items():
                file.create_dataset(name, data=corners)
            file.flush()
            content = file.id.get_file_image()
        replace(directory / NAME, content)

    together(comm, write, root_only=True)


def read_mesh(directory: Path) -> dict[str, np.ndarray]:
    """Triangles (m, 3) int of the surfaces and tetrahedra (k, 4) int, by ids of particles.  Raises OutputError."""
    try:
        with h5py.File(directory / NAME, "r", locking=False) as file:
            return {name: data[()] for name, data in file.items()}
    except OSError as error:
        raise OutputError(f"cannot read '{directory / NAME}': {error}") from error
