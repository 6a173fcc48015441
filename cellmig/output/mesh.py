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
