"""Number of ranks of a run, chosen before MPI starts, for `./run` without -n."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence

from cellmig.case.messages import CaseError, Mistake
from cellmig.case.schema import Case, particle_count
from cellmig.output.manifest import read_manifest
from cellmig.parallel.launch import on_ranks

REQUESTED = "CELLMIG_RANKS"  # set by `./run`: "auto", or a number to be checked
ENOUGH = 2500  # particles from which two ranks are faster than one
LEAST = 4  # smallest number of particles of a rank


def start_again(options: argparse.Namespace, words: Sequence[str], load: Callable[[], Case]) -> None:
    """Replace this process by the launcher of several ranks, if they are wanted and the run is large; else return."""
    requested = os.environ.pop(REQUESTED, "")
    if not requested:
        return
    if options.command == "run":
        particles = size(load())
    else:
        particles = read_manifest(options.directory).get("particles") or ENOUGH
    two = particles >= ENOUGH and len(os.sched_getaffinity(0)) > 1
    ranks = int(requested) if requested.isdecimal() else 1 + two
    check_ranks(particles, ranks)
    if ranks > 1:
        command = on_ranks(ranks, [sys.executable, "-m", "cellmig", *words])
        os.execv(command[0], command)


def size(case: Case) -> int:
    """Particles of all cells."""
    return sum(particle_count(case, cell.shape) for cell in case.cells)


def check_ranks(particles: int, ranks: int) -> None:
    """Raise CaseError where a rank would have fewer than LEAST particles."""
    if ranks > 1 and particles < LEAST * ranks:
        message = (f"{ranks} ranks for {particles} particles: a rank needs {LEAST}, and is worth it from some "
                   f"{ENOUGH // 2} on; take fewer ranks")
        raise CaseError([Mistake("-n", None, "", message)])
