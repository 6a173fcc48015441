"""What happens when a rank fails: all end together, or the others are ended, who would wait for it for ever."""

from __future__ import annotations

import sys
from time import monotonic, sleep
from typing import Any

PATIENCE = 5.0  # time that ranks may take to meet the same error [s]


def world() -> Any:
    """The communicator of all ranks, None where MPI does not run or there is one rank."""
    MPI: Any = sys.modules.get("mpi4py.MPI")
    if MPI is None or not MPI.Is_initialized() or MPI.Is_finalized() or MPI.COMM_WORLD.size == 1:
        return None
    return MPI.COMM_WORLD


def all_here(comm: Any, patience: float = PATIENCE) -> bool:
    """Whether all ranks call this within `patience` [s]: if not, what happened did so on some ranks alone."""
    meeting, end = comm.Ibarrier(), monotonic() + patience
    while not meeting.Test():
        if monotonic() > end:
            return False
        sleep(0.01)
    return True


def require_all(comm: Any, error: Exception) -> None:
    """Raise RuntimeError if some ranks alone met an `error` after which all have more to do together."""
    if not all_here(comm):
        raise RuntimeError("some ranks alone met an error of all") from error
