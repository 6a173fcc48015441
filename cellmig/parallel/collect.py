"""Arrays in global order on rank 0, and from there on all ranks."""

from __future__ import annotations

import numpy as np

from mpi4py import MPI


def collected(comm: MPI.Comm, numbers: np.ndarray, values: np.ndarray, size: int) -> np.ndarray | None:
    """Values (size, ...) in the order of their global numbers, of which each rank has some; on rank 0 alone."""
    parts = comm.gather((numbers, np.ascontiguousarray(values)))
    if parts is None:
        return None
    out = np.zeros((size, *values.shape[1:]), values.dtype)
    for where, some in parts:
        out[where] = some
    return out


def shared(comm: MPI.Comm, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays of rank 0 on all ranks; collective."""
    shapes = comm.bcast({name: (a.shape, a.dtype.str) for name, a in arrays.items()})
    out = {}
    for name, (shape, kind) in shapes.items():
        out[name] = np.ascontiguousarray(arrays[name]) if comm.rank == 0 else np.empty(shape, kind)
        comm.Bcast(out[name].view(np.uint8).reshape(-1) if out[name].ndim else out[name])
    return out
