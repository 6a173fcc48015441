"""cellmig: collective cell migration by a meshfree particle method (Bai, Lin & Zeng 2019).

From Python: `load` a case, `change` it, `run` it and use the `Record` of its results; `open` gives the record of any
run, `build` the simulation itself, to advance it step by step.  `CASES` is the folder of the cases that come with it.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from glob import glob
from os import PathLike
from pathlib import Path
from typing import Any

from .case.shipped import FOLDER as CASES
from .version import __version__

# Debian's petsc4py, last in the path: its own petsc4py.pth finds it only with PETSC_DIR or libpetsc-dev.
sys.path += sorted(glob("/usr/lib/petscdir/petsc*/*-real/lib/python3/dist-packages"))[-1:]
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded: the ranks are the threads

__all__ = ["CASES", "__version__", "build", "change", "load", "open", "run", "sweep"]


def load(path: str | PathLike, sets: Sequence[str] = ()) -> Any:
    """The case in a file, with changes such as "particles.per_cell=500".  Raises CaseError with all mistakes."""
    from .case.load import load as read

    _start()
    return read(path, sets)


def change(case: Any, changes: Mapping[str, Any]) -> Any:
    """A copy of a case with other values, as in a case file.

    >>> finer = change(case, {"particles.per_cell": 3000, "adhesion.cells.bond_density": "2000 /um^2"})
    """
    from .case.load import change as changed

    return changed(case, changes)


def build(case: Any, comm: Any = None) -> Any:
    """A Simulation of a case on the ranks of an MPI communicator, all of them by default; collective.

    >>> simulation = build(load("cases/one_cell.toml"))
    >>> simulation.go(20.0)                      # µs
    >>> history, ledger = simulation.sample()
    """
    _start()
    from mpi4py import MPI

    from .runs.trial import choose
    from .simulation import Simulation

    comm = MPI.COMM_WORLD if comm is None else comm
    return Simulation(choose(case, comm)[0], comm)


def _start() -> None:
    """Start PETSc, which leaves signals to Python here, and register the laws."""
    from .laws import register
    from .parallel.arguments import start_petsc

    start_petsc([])
    register()


def run(case: Any, out: str | PathLike | None = None, until: str | None = None, quiet: bool = False,
        start: str | PathLike | None = None) -> Any:
    """Run a case and return the Record of its results; collective.

    Parameters
    ----------
    case : Case.
    out : Path -- directory of the run, by default output/<name of the case>; an existing run is moved aside.
    until : str -- end in place of the case's, such as "40 us".
    quiet : bool -- show neither log nor progress.
    start : Path -- directory of a run of the same particles, whose last state is the initial state, at time 0.

    Raises NumericsError or OutputError if the run fails; its results until then can be opened.
    """
    from .case.units import number
    from .runs.api import run_here

    directory = Path("output") / case.name if out is None else Path(out)
    return run_here(case, directory, None if until is None else number(until, "us"), quiet,
                    None if start is None else Path(start))


def sweep(path: str | PathLike, vary: Mapping[str, Sequence[Any]], out: str | PathLike, sets: Sequence[str] = (),
          jobs: int | None = None) -> list[dict[str, Any]]:
    """Run a case file for all combinations of values, in parallel; complete runs are not repeated.

    Parameters
    ----------
    path : Path -- case file.
    vary : dict -- dotted key to its values: ``{"adhesion.cells.bond_density": ["1000 /um^2", "2000 /um^2"],
        "seed": [1, 2]}``.
    out : Path -- directory of the runs and of sweep.csv, sweep.png and sweep.pdf.
    sets : list of str -- changes of all runs, such as "particles.per_cell=300".
    jobs : int -- runs at a time; by default one for each core.

    Returns
    -------
    list of dict -- a row for each complete run and cell (0 is the aggregate), and one without a cell for each run that
        failed, with its cause, as ``pandas.DataFrame(rows)`` accepts them.
    """
    from .runs.sweep import Sweep, sweep

    plan = Sweep(Path(path), dict(vary), Path(out), tuple(sets))
    sweep(plan, jobs)
    return list(plan.rows(plan.jobs()))


def open(directory: str | PathLike) -> Any:
    """The Record of a run, complete or not: its case, tables and frames."""
    from .runs.record import Record

    return Record(Path(directory))
