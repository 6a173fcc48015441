"""Separation of PETSc's options from our own arguments on a command line, and the start of MPI and PETSc."""

from __future__ import annotations

import os
import re
import sys
import tempfile
from collections.abc import Callable
from typing import Any

from ..exits import INVALID_INPUT
from .launch import launcher_size

_NUMBER = re.compile(r"-?(\d|\.\d)")


class OptionError(ValueError):
    """An option of PETSc, or an integrator of a case, that cannot be used; the message is for the user."""


class LaunchError(RuntimeError):
    """Ranks that a launcher has started without a common communicator; the message is for the user."""


def split_arguments(arguments: list[str]) -> tuple[list[str], list[str]]:
    """Our arguments and PETSc's: a word with one dash, and the value after it, are PETSc's."""
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
    """Start MPI and PETSc with its options, if they are not running; returns the communicator of all ranks.

    Raises
    ------
    OptionError -- where PETSc cannot read its options.
    LaunchError -- where a launcher has started several ranks but this MPI library knows of one.
    """
    # Without this, Open MPI starts a daemon for a process without mpiexec, which takes a quarter of a second.
    os.environ.setdefault("OMPI_MCA_ess_singleton_isolated", "1")
    import petsc4py
    from mpi4py import MPI

    # PETSc's signal handler prints a stack trace even for a broken pipe.
    handler = [] if "-no_signal_handler" in options else ["-no_signal_handler"]
    if wrong := _refused(lambda: petsc4py.init(["cellmig", *options, *handler])):
        error = OptionError(f"PETSc cannot read its options: {wrong}")
        if MPI.COMM_WORLD.size > 1 and MPI.COMM_WORLD.rank == 0:  # only rank 0 reads files, and the others wait
            print(f"cellmig: {error}", file=sys.stderr, flush=True)
            MPI.COMM_WORLD.Abort(INVALID_INPUT)
        raise error
    names, size = launcher_size()
    if size > 1 == MPI.COMM_WORLD.size:
        library = MPI.Get_library_version().split(",")[0].strip()
        raise LaunchError(
            f"by {' and '.join(names)} this is one of {size} ranks, but the MPI library here ({library}) knows of one: "
            "each would compute the whole case.  Start the ranks with './run -n' or the mpiexec of that library, under "
            f"Slurm with 'srun --mpi=pmix'; for {size} separate runs, unset {' and '.join(names)}")
    return MPI.COMM_WORLD


def _refused(start: Callable[[], None]) -> str:
    """The reason, among all that PETSc prints, why `start` fails; "" if it succeeds."""
    with tempfile.TemporaryFile() as output:
        screen = os.dup(2)
        os.dup2(output.fileno(), 2)
        try:
            start()
            wrong = ""
        except (RuntimeError, UnicodeError) as error:
            wrong = str(error)
        finally:
            os.dup2(screen, 2)
            os.close(screen)
        output.seek(0)
        written = output.read()
    if not wrong:
        os.write(2, written)
        return ""
    lines = re.findall(r"PETSC ERROR: (.*)", written.decode("utf-8", "replace"))
    return lines[2] if len(lines) > 2 else wrong  # the third line, after a rule and the kind of error
