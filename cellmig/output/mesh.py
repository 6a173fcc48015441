"""The triangles and tetrahedra between the particles of a run in three dimensions, in the file mesh.h5."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import h5py
import numpy as np

from ..meshfree.scene import Scene, joined
from ..parallel.owners import Owners
from .directory import OutputError, replace, together

if TYPE_CHECKING:
    from mpi4py import MPI

NAME, KIND = "mesh.h5", "kind"


class Elements:
    """The elements of a rank, those whose first corner it owns, and the particles of other ranks at their corners.

    Attributes
    ----------
    local : dict -- by the names of the parts corners (m, 3) or (m, 4) int32, by places in what `complete` returns.
    """

    def __init__(self, comm: MPI.Intracomm, owners: Owners, ids: np.ndarray) -> None:
        """Choose those of this rank's cells; collective.

        owners : of the particles of the scene;  ids : (n_owned,) int -- of this rank's particles, ascending.
        """
        self._comm, scene = comm, owners.scene
        cells = owners.cells(comm.rank)
        used = [(start, scene.templates[k]) for start, k in zip(scene.offset[cells], scene.kind[cells], strict=True)]
        found = {"triangles": joined((start + t.facets for start, t in used), (0, 3)),
                 "tetrahedra": joined((start + t.simplices for start, t in used), (0, 4))}
        mine = {name: corners[owners.of(corners[:, 0]) == comm.rank] for name, corners in found.items()}
        others = np.setdiff1d(np.concatenate([corners.ravel() for corners in mine.values()]), ids)
        owner = owners.of(others)
        others = others[np.argsort(owner, kind="stable")]
        wanted = np.split(others, np.searchsorted(np.sort(owner), np.arange(1, comm.size)))
        self._given = [np.searchsorted(ids, some) for some in comm.alltoall(wanted)]
        every = np.concatenate([ids, others])
        order = np.argsort(every)
        self.local = {name: order[np.searchsorted(every, corners, sorter=order)].astype(np.int32)
                      for name, corners in mine.items()}

    def complete(self, values: np.ndarray) -> np.ndarray:
        """Values (n_owned, ...) of this rank's particles, and after them those of the others at its elements."""
        return np.concatenate([values, *self._comm.alltoall([values[some] for some in self._given])])


def write_mesh(directory: Path, comm: MPI.Intracomm, scene: Scene) -> None:
    """Write the elements of the scene's kinds of cells, and of which kind each cell is; collective, rank 0 writes."""
    def write() -> None:
        with h5py.File("mesh", "w", driver="core", backing_store=False) as file:
            file.create_dataset(KIND, data=scene.kind)
            for number, t in enumerate(scene.templates):
                group = file.create_group(str(number))
                group.attrs["particles"] = len(t.X)
                group.create_dataset("triangles", data=t.facets)
                group.create_dataset("tetrahedra", data=t.simplices)
            file.flush()
            content = file.id.get_file_image()
        replace(directory / NAME, content)

    together(comm, write, root_only=True)


def read_mesh(directory: Path) -> dict[str, np.ndarray]:
    """Triangles (m, 3) int of the surfaces and tetrahedra (k, 4) int, by ids of particles.  Raises OutputError."""
    try:
        with h5py.File(directory / NAME, "r", locking=False) as file:
            kind = file[KIND][()]
            size = np.array([file[str(number)].attrs["particles"] for number in range(kind.max() + 1)])[kind]
            parts = {name: [file[f"{number}/{name}"][()] for number in range(kind.max() + 1)]
                     for name in ("triangles", "tetrahedra")}
        first = np.cumsum(size) - size
        return {name: np.concatenate([start + of_kind[k] for start, k in zip(first, kind, strict=True)])
                for name, of_kind in parts.items()}
    except (OSError, KeyError) as error:
        raise OutputError(f"cannot read '{directory / NAME}': {error}") from error
