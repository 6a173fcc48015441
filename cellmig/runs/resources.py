"""Checks that free memory and disk space suffice for a run."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from mpi4py import MPI

from cellmig.case.schema import Case
from cellmig.output.directory import together
from cellmig.output.manifest import memory_sizes
from cellmig.parallel.options import IMPLICIT, requested_integrator

from .by_rank import CELL_BYTES, HELD_BYTES, KIND_BYTES, RANK_BYTES, kinds_of, of_cells, scene_bytes
from .preflight import bytes_text, disk_bytes, solver_bytes

_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")  # of a container


class InsufficientResources(Exception):
    """The run needs more memory or disk space than this machine has free."""


def require_resources(case: Case, directory: Path, comm: Any) -> None:
    """Raise InsufficientResources for a run that cannot fit, before it writes files; collective.

    The estimate is a lower bound: a run that passes may still be short of memory.
    """
    here = comm.Split_type(MPI.COMM_TYPE_SHARED)
    ranks = here.size
    here.Free()
    lacks = together(comm, lambda: list(_lacks(case, Path(directory), ranks, comm.size)))
    if lacks := list(dict.fromkeys(line for lines in lacks for line in lines or ())):
        raise InsufficientResources(f"{case.path}: the run does not fit: {'; '.join(lacks)}; "
                     "take fewer particles or frames, or a larger machine")


def _lacks(case: Case, directory: Path, ranks: int, everywhere: int) -> Iterable[str]:
    """What a machine with some of the ranks lacks; they have their share of the particles."""
    counts, share = of_cells(case), ranks / everywhere
    kinds = sum(kinds_of(case).values())
    needed = share * scene_bytes(case) * sum(counts) + KIND_BYTES * kinds + HELD_BYTES * kinds * (ranks - 1)
    needed += (RANK_BYTES + CELL_BYTES * len(counts)) * ranks
    if requested_integrator(case.time.integrator) in ("static", *IMPLICIT):
        needed += share * solver_bytes(case)
    if needed > (free := free_memory()):
        yield f"it takes {bytes_text(needed)} of memory at least, of which {bytes_text(free)} are free"
    existing = next((p for p in (directory.absolute(), *directory.absolute().parents) if p.exists()), None)
    with suppress(OSError):
        if existing and (needed := disk_bytes(case, sum(counts))) > (free := shutil.disk_usage(existing).free):
            yield f"it leaves {bytes_text(needed)} in '{directory}', of which {bytes_text(free)} are free"


def free_memory() -> float:
    """Free memory of this machine or its container [B]; infinite where the system does not report it."""
    free = float("inf")
    with suppress(OSError, KeyError):
        free = memory_sizes()["MemAvailable"]
    for limit in _LIMITS:
        with suppress(OSError, ValueError):
            free = min(free, float(Path(limit).read_text(encoding="utf-8")))
    return free
