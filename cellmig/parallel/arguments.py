"""Which part of a command line is PETSc's, known before it is started; and its start."""

from __future__ import annotations

import os
import re
import sys
import tempfile
from collections.abc import Callable
from typing import Any

from ..exits import WRONG
from .launch import launcher_size

_NUMBER = re.compile(r"-?(\d|\.\d)")


class OptionError(ValueError):
    """A PETSc option, or what a case says of PETSc, cannot be followed; the message is for the user."""


class LaunchError(RuntimeError):
    """The ranks do not know of each other; the message is for the user."""


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
    """Start MPI and PETSc with its options, unless that is done; returns the communicator of all ranks.

    Raises LaunchError where a launcher has started several ranks and this MPI library knows of one.
    """
    # Open MPI would start a daemon beside a process that mpiexec has not started: a quarter of a second for nothing.
    os.environ.setdefault("OMPI_MCA_ess_singleton_isolated", "1")
    import petsc4py
    from mpi4py import MPI

    # PETSc's own handler meets a signal with a trace of its stack, even where a reader of the output has just left.
    handler = [] if "-no_signal_handler" in options else ["-no_signal_handler"]
    if wrong := _refused(lambda: petsc4py.init(["cellmig", *options, *handler])):
        error = OptionError(f"PETSc cannot read its options: {wrong}")
        if MPI.COMM_WORLD.size > 1 and MPI.COMM_WORLD.rank == 0:  # it alone reads files, and the others wait for it
            print(f"cellmig: {error}", file=sys.stderr, flush=True)
            MPI.COMM_WORLD.Abort(WRONG)
        raise error
    names, told = launcher_size()
    if told > 1 == MPI.COMM_WORLD.size:
        library = MPI.Get_library_version().split(",")[0].strip()
        raise LaunchError(
            f"by {' and '.join(names)} this is one of {told} ranks, but the MPI library here ({library}) knows of one: "
            "each would compute the whole case.  Start the ranks with './run -n' or the mpiexec of that library, under "
            f"Slurm with 'srun --mpi=pmix'; for {told} runs of their own, unset {' and '.join(names)}")
    return MPI.COMM_WORLD


def _refused(start: Callable[[], None]) -> str:
    """Why PETSc does not start, of all that it writes about it; "" if it does."""
    with tempfile.TemporaryFile() as said:
        screen = os.dup(2)
        os.dup2(said.fileno(), 2)
        try:
            start()
            wrong = ""
        except (RuntimeError, UnicodeError) as error:
            wrong = str(error)
        finally:
            os.dup2(screen, 2)
            os.close(screen)
        said.seek(0)
        written = said.read()
    if not wrong:
        os.write(2, written)
        return ""
    lines = re.findall(r"PETSC ERROR: (.*)", written.decode("utf-8", "replace"))
    return lines[2] if len(lines) > 2 else wrong  # after a rule and the kind of error
