"""Which part of a command line is PETSc's, known before it is started; and its start."""

from __future__ import annotations

import os
import re
import sys
from typing import Any

_NUMBER = re.compile(r"-?(\d|\.\d)")


def split_arguments(arguments: list[str]) -> tuple[list[str], list[str]]:
    """(ours, PETSc's): a word with one dash, and the value after it, are PETSc's; all else is ours."""
    ours, theirs, option_open = [], [], False
    for word in arguments:
        option = word.startswith("-") and not word.startswith("--") and not _NUMBER.match(word) and word != "-h"
        if option or (option_open and not word.startswith("--")):
            theirs.append(word)
        else:
            ours.append(word)
        option_open = option
    return ours, theirs


def start_petsc(options: list[str]) -> Any:
    """Start MPI and PETSc with its options, unless that is done; returns the communicator of all ranks."""
    # Open MPI would start a daemon beside a process that mpiexec has not started: a quarter of a second for nothing.
    os.environ.setdefault("OMPI_MCA_ess_singleton_isolated", "1")
    import petsc4py
    from mpi4py import MPI

    # PETSc's own handler meets a signal with a trace of its stack, even where a reader of the output has just left.
    handler = [] if "-no_signal_handler" in options else ["-no_signal_handler"]
    petsc4py.init([sys.argv[0], *options, *handler])
    return MPI.COMM_WORLD
