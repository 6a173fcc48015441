"""Arrays in global order on rank 0, and from there on all ranks; what rank 0 decides for all."""

from __future__ import annotations

import io
import pickle
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from mpi4py import MPI

from ..case.registry import laws

AT_ONCE = 1 << 30  # bytes of a message: MPI counts in 32 bits


def gathered(comm: MPI.Comm, numbers: np.ndarray, values: np.ndarray, size: int) -> np.ndarray | None:
    """Values (size, ...) in the order of their global numbers, of which each rank has some; on rank 0 alone."""
    parts = comm.gather((numbers, np.ascontiguousarray(values)))
    if parts is None:
        return None
    out = np.zeros((size, *values.shape[1:]), values.dtype)
    for where, some in parts:
        out[where] = some
    return out


def broadcast(comm: MPI.Comm, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays of rank 0 on all ranks; collective."""
    shapes = comm.bcast({name: (a.shape, a.dtype.str) for name, a in arrays.items()})
    out = {}
    for name, (shape, kind) in shapes.items():
        out[name] = np.ascontiguousarray(arrays[name]) if comm.rank == 0 else np.empty(shape, kind)
        comm.Bcast(out[name].view(np.uint8).reshape(-1) if out[name].ndim else out[name])
    return out


def computed_on_root(comm: MPI.Comm, make: Callable[[], Any]) -> Any:
    """What `make` returns on rank 0, on all ranks to the bit; what it raises there is raised on all; collective.

    Ranks may be on unlike processors, whose sines and factorisations differ in the last bit; and where one bit decides,
    so would the ranks.
    """
    if comm.size == 1:
        return make()
    value, failed, buffers, text = None, None, [], io.BytesIO()
    if comm.rank == 0:
        try:
            value = make()
        except Exception as error:
            failed = error
        _Pickler(text, 5, buffer_callback=lambda b: buffers.append(b.raw())).dump((value, failed))
    here = comm.Ibarrier()
    while not here.Test():  # leaving the processor to rank 0
        time.sleep(1e-3)
    said, sizes = comm.bcast((text.getvalue(), [b.nbytes for b in buffers]))
    buffers = buffers or [bytearray(n) for n in sizes]
    for b in map(memoryview, buffers):
        for first in range(0, b.nbytes, AT_ONCE):
            comm.Bcast([b[first : first + AT_ONCE], MPI.BYTE])
    if comm.rank:
        value, failed = pickle.loads(said, buffers=buffers)
    if failed is not None:
        raise failed
    return value


class _Pickler(pickle.Pickler):
    """Sends laws by their names: wherever they were defined, all ranks have them."""

    def reducer_override(self, thing: Any) -> Any:
        """How to find the class of a law."""
        known = isinstance(thing, type) and laws(getattr(thing, "kind", "")).get(getattr(thing, "law", "")) is thing
        return (_law, (thing.kind, thing.law)) if known else NotImplemented


def _law(kind: str, name: str) -> type:
    return laws(kind)[name]
