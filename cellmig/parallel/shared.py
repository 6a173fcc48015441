"""Copies through memory that the ranks of one machine share: no message is sent in a step."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

import numpy as np

from mpi4py import MPI

from ..kernel.toolchain import library

SOURCE = Path(__file__).with_name("shared.c")
LINE = 8  # doubles of a cache line
PATIENCE = 20_000  # looks, some 100 µs, at what another rank has ready, before it is thought to wait for this processor


class _Copies(ctypes.Structure):
    """`Copies` of shared.c."""

    _fields_ = [(name, ctypes.c_void_p if name in ("rows", "window", "sent", "source", "peer") else ctypes.c_long)
                for name in ("rows", "window", "width", "n_owned", "mine", "half", "n_sent", "sent", "n_copies",
                             "source", "n_peers", "peer", "counter", "turn", "patience")]


class SharedCopies:
    """Brings the copies of a field up to date like VecGhostUpdateBegin and VecGhostUpdateEnd, to the bit."""

    def __init__(self, comm: MPI.Comm, memory: np.ndarray, n_owned: int, n_shared: int):
        """`memory` : (>= n_local, width);  `n_shared` : how many own rows others may ask for; collective."""
        self.comm, width = comm, memory.shape[1]
        self.starts = np.cumsum([0, *comm.allgather(n_owned)])
        half = -(-comm.allreduce(int(n_shared), MPI.MAX) * width // LINE) * LINE
        self.segment = LINE + 2 * half
        self.window = MPI.Win.Allocate_shared(8 * self.segment, 8, comm=comm)
        own, _ = self.window.Shared_query(comm.rank)
        np.frombuffer(own, np.int64)[0] = 0
        at = comm.rank * self.segment
        cores = set().union(*comm.allgather(os.sched_getaffinity(0)))  # each rank may be bound to one
        patience = PATIENCE if len(cores) >= comm.size else 0
        self._c = _Copies(rows=memory.ctypes.data, window=self.window.Shared_query(0)[0].address, width=width,
                          n_owned=n_owned, mine=at + LINE, half=half, counter=at, patience=patience)

    def connect(self, ghosts: np.ndarray) -> None:
        """Copies are of these rows from now on, in PETSc's order (n_ghosts,); collective."""
        owner = np.searchsorted(self.starts, ghosts, side="right") - 1
        asked = [ghosts[owner == r] - self.starts[r] for r in range(self.comm.size)]
        wanted = self.comm.alltoall(asked)
        sent = np.unique(np.concatenate(wanted))
        slots = self.comm.alltoall([np.searchsorted(sent, w) for w in wanted])
        source = np.empty(len(ghosts), np.int64)
        for r, slot in enumerate(slots):
            source[owner == r] = r * self.segment + LINE + slot * self._c.width
        peers = [r for r in range(self.comm.size) if len(asked[r]) or len(wanted[r])]
        self._kept = sent.astype(np.int64), source, np.array(peers, np.int64) * self.segment
        for name, values in zip(("sent", "source", "peer"), self._kept, strict=True):
            setattr(self._c, name, values.ctypes.data)
        self._c.n_sent, self._c.n_copies, self._c.n_peers = map(len, self._kept)

    @property
    def handle(self) -> int:
        """Address for the functions of `exchange_functions`."""
        return ctypes.addressof(self._c)

    def destroy(self) -> None:
        """Free the window; collective."""
        self.window.Free()


def on_one_machine(comm: MPI.Comm) -> bool:
    """Whether all ranks are, and there are several; collective."""
    near = comm.Split_type(MPI.COMM_TYPE_SHARED)
    found = near.size == comm.size > 1
    near.Free()
    return found


def exchange_functions() -> tuple[int, ...]:
    """Addresses of functions that do for `SharedCopies` what those of PETSc do for a Vec with ghosts."""
    return addresses(library(SOURCE), "copies_begin", "copies_end")


def addresses(of: ctypes.CDLL, *names: str) -> tuple[int, ...]:
    """Where functions of a library are, for C to call."""
    return tuple(ctypes.cast(getattr(of, name), ctypes.c_void_p).value for name in names)
