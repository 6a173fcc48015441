"""Collectives: arrays gathered in global order, broadcast from rank 0, and results that rank 0 computes for all."""

from __future__ import annotations

import io
import math
import mmap
import os
import pickle
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from mpi4py import MPI

from ..case.registry import laws

AT_ONCE = 1 << 30  # largest message [B]: MPI counts in 32 bits
LARGE = 1 << 20  # a result of more than so many bytes is in the memory of a machine once, not on each rank
ALIGNED = 64  # bytes to whose multiples arrays are aligned
SHARED = "/dev/shm"  # files in memory


def gathered(comm: MPI.Comm, numbers: np.ndarray, values: np.ndarray, size: int) -> np.ndarray | None:
    """Distributed values in global order.

    Parameters
    ----------
    numbers : (n,) int -- global numbers of the values of this rank.
    values : (n, ...) -- in any unit.
    size : int -- number of all values.

    Returns
    -------
    (size, ...) on rank 0, None on others; collective.
    """
    parts = comm.gather((numbers, np.ascontiguousarray(values)))
    if parts is None:
        return None
    out = np.zeros((size, *values.shape[1:]), values.dtype)
    for at, some in parts:
        out[at] = some
    return out


def fetched(comm: MPI.Comm, owner: np.ndarray, wanted: np.ndarray,
            give: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """What the owners of particles know of them; collective.

    Parameters
    ----------
    owner : (k,) int -- ranks.
    wanted : (k,) int -- what is asked of these, such as global ids.
    give : function -- on each rank, of (n,) int that others want of it, returns the answers (n, ...), in any unit.

    Returns
    -------
    (k, ...) -- the answers.
    """
    order = np.argsort(owner, kind="stable")
    count = np.bincount(owner, minlength=comm.size).astype(np.int64)
    asked = np.empty_like(count)
    comm.Alltoall(count, asked)
    names = np.empty(asked.sum(), np.int64)
    comm.Alltoallv((wanted[order].astype(np.int64), count), (names, asked))
    given = np.ascontiguousarray(give(names))
    width = math.prod(given.shape[1:])
    answers = np.empty((len(wanted), *given.shape[1:]), given.dtype)
    comm.Alltoallv((given, width * asked), (answers, width * count))
    out = np.empty_like(answers)
    out[order] = answers
    return out


@dataclass(frozen=True, eq=False)
class Rows:
    """The rows of an array that one rank has, of an array that all ranks have together.

    number : (n,) int -- which they are;  values : (n, ...) -- in any unit;  size : int -- number of rows of all ranks.
    """

    number: np.ndarray
    values: np.ndarray
    size: int

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the whole array."""
        return (self.size, *self.values.shape[1:])

    def whole(self, comm: MPI.Comm) -> np.ndarray | None:
        """The whole array (size, ...), of any unit, on rank 0, None on others; collective."""
        return gathered(comm, self.number, self.values, self.size)


def on_root(comm: MPI.Comm, arrays: Mapping[str, np.ndarray | Rows]) -> dict[str, Any]:
    """The `arrays` of rank 0, by name and of any shape, with those that all ranks have in `Rows`, whole; collective."""
    return {name: values.whole(comm) if isinstance(values, Rows) else values for name, values in sorted(arrays.items())}


def broadcast(comm: MPI.Comm, arrays: Mapping[str, np.ndarray | Rows]) -> dict[str, np.ndarray]:
    """The `arrays` of rank 0, by name and of any shape, and those of all ranks in `Rows`, on all ranks; collective."""
    here = on_root(comm, arrays)
    shapes = comm.bcast({name: (a.shape, a.dtype.str) for name, a in here.items() if a is not None})
    out = {}
    for name, (shape, kind) in shapes.items():
        out[name] = np.ascontiguousarray(here[name]) if comm.rank == 0 else np.empty(shape, kind)
        comm.Bcast(out[name].view(np.uint8).reshape(-1) if out[name].ndim else out[name])
    return out


class Arrays(Protocol):
    """Arrays by name, of which a rank takes what it needs."""

    @property
    def names(self) -> list[str]:
        """Their names."""

    def shape(self, name: str) -> tuple[int, ...]:
        """Shape of an array."""

    def __getitem__(self, name: str) -> np.ndarray:
        """An array (n, ...), in its unit."""

    def rows(self, name: str, number: np.ndarray) -> np.ndarray:
        """Rows `number` (k,) int of an array (k, ...), in its unit."""


class Whole:
    """Arrays that every rank has as a whole."""

    def __init__(self, comm: MPI.Comm, arrays: Mapping[str, np.ndarray | Rows]):
        """From those of rank 0, and those that ranks have in `Rows`; collective."""
        self._arrays = broadcast(comm, arrays)

    @property
    def names(self) -> list[str]:
        """Their names."""
        return list(self._arrays)

    def shape(self, name: str) -> tuple[int, ...]:
        """Shape of an array."""
        return self._arrays[name].shape

    def __getitem__(self, name: str) -> np.ndarray:
        """An array (n, ...), in its unit."""
        return self._arrays[name]

    def rows(self, name: str, number: np.ndarray) -> np.ndarray:
        """Rows `number` (k,) int of an array (k, ...), in its unit."""
        return self._arrays[name][number]


def computed_on_root(comm: MPI.Comm, make: Callable[[], Any]) -> Any:
    """The result of `make` on rank 0, on all ranks to the bit; collective.

    Processors of different kinds differ in the last bits of sines and factorisations, so that ranks which computed the
    result themselves could take different decisions.

    Raises on all ranks what `make` raises on rank 0.
    """
    if comm.size == 1:
        return make()
    value, failed, text = None, None, io.BytesIO()
    buffers: list[Any] = []
    if comm.rank == 0:
        try:
            value = make()
        except Exception as error:
            failed = error
        _Pickler(text, 5, buffer_callback=lambda b: buffers.append(b.raw())).dump((value, failed))
    arrival = comm.Ibarrier()
    while not arrival.Test():  # a blocking call would keep the processor from rank 0
        time.sleep(1e-3)
    data, sizes = comm.bcast((text.getvalue(), [b.nbytes for b in buffers]))
    if sum(sizes) > LARGE:
        value = failed = None  # rank 0 uses the copy of its machine, too
        value, failed = pickle.loads(data, buffers=_on_each_machine(comm, buffers, sizes))
    else:
        buffers = buffers or [bytearray(n) for n in sizes]
        for b in buffers:
            comm.Bcast([b, MPI.BYTE])
        if comm.rank:
            value, failed = pickle.loads(data, buffers=buffers)
    if failed is not None:
        raise failed
    return value


def _on_each_machine(comm: MPI.Comm, buffers: list[Any], sizes: list[int]) -> list[memoryview]:
    """The `buffers` of rank 0, of these `sizes` [B], read-only in memory that ranks of a machine share; collective."""
    near = comm.Split_type(MPI.COMM_TYPE_SHARED)
    first_ones = comm.Split(0 if near.rank == 0 else MPI.UNDEFINED)
    ends = np.cumsum([-(-n // ALIGNED) * ALIGNED for n in sizes]).tolist()
    starts, path, room = [0, *ends[:-1]], None, memoryview(b"")
    if near.rank == 0:
        path, room = _room(ends[-1])
        for at, own in zip(starts, buffers, strict=False):  # rank 0 alone has any
            room[at : at + own.nbytes] = own
        for at in range(0, ends[-1], AT_ONCE):
            first_ones.Bcast([room[at : at + AT_ONCE], MPI.BYTE])
        first_ones.Free()
    path = near.bcast(path)
    if path is None:
        room = room if near.rank == 0 else memoryview(bytearray(ends[-1]))
        for at in range(0, ends[-1], AT_ONCE):
            near.Bcast([room[at : at + AT_ONCE], MPI.BYTE])
    else:
        with open(path, "rb") as file:
            room = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
        near.Barrier()
        if near.rank == 0:
            os.unlink(path)  # the memory is free when the last rank does without it
    near.Free()
    return [room[at : at + n].toreadonly() for at, n in zip(starts, sizes, strict=True)]


def _room(size: int) -> tuple[str | None, memoryview]:
    """Path and content of a new file of a `size` [B] in shared memory; if that is full none, and memory of the rank."""
    path = None
    try:
        handle, path = tempfile.mkstemp(prefix="cellmig-", dir=SHARED)
        try:
            os.posix_fallocate(handle, 0, size)
            return path, memoryview(mmap.mmap(handle, size))
        finally:
            os.close(handle)
    except OSError:
        if path is not None:
            os.unlink(path)
        return None, memoryview(bytearray(size))


def collected(comm: MPI.Comm, thing: Any) -> list[Any] | None:
    """A `thing` of each rank, in their order, on rank 0, None on others; collective."""
    text = io.BytesIO()
    if comm.rank > 0:
        _Pickler(text, 5).dump(thing)
    parts = comm.gather(text.getvalue())
    return None if parts is None else [thing, *map(pickle.loads, parts[1:])]


class _Pickler(pickle.Pickler):
    """Pickles the class of a law by its name, as laws from files of the user's belong to no importable module."""

    def reducer_override(self, thing: Any) -> Any:
        """Function and arguments that give the class of a law; NotImplemented for all else."""
        known = isinstance(thing, type) and laws(getattr(thing, "kind", "")).get(getattr(thing, "law", "")) is thing
        return (_law, (thing.kind, thing.law)) if known else NotImplemented


def _law(kind: str, name: str) -> type:
    return laws(kind)[name]
