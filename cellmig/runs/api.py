"""A run from Python: in a script, on the ranks of mpiexec, or in a notebook."""

from __future__ import annotations

import threading
from contextlib import nullcontext
from pathlib import Path

from mpi4py import MPI

from cellmig.case.schema import Case
from cellmig.exits import DONE, FAILED, STOPPED
from cellmig.output.directory import OutputError
from cellmig.solve.step import NumericsError

from .record import Record
from .run import Run
from .stops import stop_requests


def run_here(case: Case, directory: Path, until: float | None, quiet: bool, start: Path | None) -> Record:
    """Run a case on all ranks; returns its record, also if ^C or a signal ended it early (status 75); collective.

    until : end [µs] in place of the case's;  start : directory of a run, whose last state is the initial one.

    Raises NumericsError or OutputError where the run failed.
    """
    # Python allows signal handlers in the main thread only.
    watched = threading.current_thread() is threading.main_thread()
    with stop_requests() if watched else nullcontext([]) as stop_signals:
        run = Run(case, directory, MPI.COMM_WORLD, until=until, quiet=quiet, origin=start)
        status = run.go(stop_signals)
        run.simulation.destroy()
    if status not in (DONE, STOPPED):
        raise (NumericsError if status == FAILED else OutputError)(run.manifest["cause"])
    return Record(directory)
