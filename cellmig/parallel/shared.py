"""Ghosts through memory that the ranks of one machine share: no messages are sent during a step."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from mpi4py import MPI

from ..kernel.toolchain import library

SOURCE = Path(__file__).with_name("shared.c")
LINE = 8  # doubles in a cache line
PATIENCE = 20_000  # polls, about 100 µs, for another rank before the processor is yielded, which it may be waiting for


class _Copies(ctypes.Structure):
    """The struct `Copies` of shared.c."""

    _fields_ = [(name, ctypes.c_void_p if name in ("rows", "window", "sent", "source", "peer") else ctypes.c_long)
                for name in ("rows", "window", "width", "n_owned", "mine", "half", "n_sent", "sent", "n_copies",
                             "source", "n_peers", "peer", "counter", "turn", "patience")]


class SharedCopies:
    """Updates the ghosts of a field as VecGhostUpdateBegin and VecGhostUpdateEnd do, to the bit."""

    def __init__(self, comm: MPI.Intracomm, memory: np.ndarray, n_owned: int, n_shared: int):
        """For a field in `memory` (>= n_local, width), of any unit, with `n_owned` owned rows; collective.

        At most `n_shared` of them are copied by other ranks.
        """
        self.comm, width = comm, memory.shape[1]
        self.starts = np.cumsum([0, *comm.allgather(n_owned)])
        half = -(-comm.allreduce(int(n_shared), MPI.MAX) * width // LINE) * LINE
        self.segment = LINE + 2 * half
        self.window = MPI.Win.Allocate_shared(8 * self.segment, 8, comm=comm)
        own: Any = self.window.Shared_query(comm.rank)[0]
        np.frombuffer(own, np.int64)[0] = 0
        at = comm.rank * self.segment
        cores = set().union(*comm.allgather(os.sched_getaffinity(0)))  # each rank may be bound to one core
        patience = PATIENCE if len(cores) >= comm.size else 0
        self._c = _Copies(rows=memory.ctypes.data, window=self.window.Shared_query(0)[0].address, width=width,
                          n_owned=n_owned, mine=at + LINE, half=half, counter=at, patience=patience)

    def connect(self, ghosts: np.ndarray) -> None:
        """Choose the rows `ghosts` (n_ghosts,) int to copy, by their numbers in PETSc's order; collective."""
        owner = np.searchsorted(self.starts, ghosts, side="right") - 1
        needed = [ghosts[owner == r] - self.starts[r] for r in range(self.comm.size)]
        wanted = self.comm.alltoall(needed)
        sent = np.unique(np.concatenate(wanted))
        slots = self.comm.alltoall([np.searchsorted(sent, w) for w in wanted])
        source = np.empty(len(ghosts), np.int64)
        for r, slot in enumerate(slots):
            source[owner == r] = r * self.segment + LINE + slot * self._c.width
        peers = [r for r in range(self.comm.size) if len(needed[r]) or len(wanted[r])]
        self._arrays = sent.astype(np.int64), source, np.array(peers, np.int64) * self.segment
        for name, values in zip(("sent", "source", "peer"), self._arrays, strict=True):
            setattr(self._c, name, values.ctypes.data)
        self._c.n_sent, self._c.n_copies, self._c.n_peers = map(len, self._arrays)

    @property
    def handle(self) -> int:
        """Address of the object that the `exchange_functions` take as their first argument."""
        return ctypes.addressof(self._c)

    def destroy(self) -> None:
        """Free the window; collective."""
        self.window.Free()


def on_one_machine(comm: MPI.Intracomm) -> bool:
    """Whether there are several ranks and all are on one machine; collective."""
    near = comm.Split_type(MPI.COMM_TYPE_SHARED)
    found = near.size == comm.size > 1
    near.Free()
    return found


def working_time() -> float:
    """CPU time of this process without what went into waiting for other ranks within steps [s]."""
    return process_time() - ctypes.c_double.in_dll(library(SOURCE), "waited").value


def messages(begin: int, end: int) -> tuple[int, ...]:
    """Addresses of the C functions that begin and end an exchange by messages, of which `end` is timed."""
    timed = library(SOURCE)
    ctypes.c_void_p.in_dll(timed, "messages_end").value = end
    return begin, *addresses(timed, "timed_messages_end")


def exchange_functions() -> tuple[int, ...]:
    """Addresses of the C functions that begin and end the update of `SharedCopies`."""
    return addresses(library(SOURCE), "copies_begin", "copies_end")


def addresses(of: ctypes.CDLL, *names: str) -> tuple[int, ...]:
    """Addresses of the functions `names` of a library, for C to call."""
    return tuple(ctypes.cast(getattr(of, name), ctypes.c_void_p).value or 0 for name in names)
