"""cellmig: collective cell migration by a meshfree particle method (Bai, Lin & Zeng 2019).

From Python: `load` a case, `change` it, `run` it, look at its `Record`; `open` the record of any run.  `build` gives
the simulation itself, to be driven step by step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

__version__ = "0.1.0.dev0"
__all__ = ["build", "change", "load", "open", "run"]


def load(path: str | PathLike, sets: Sequence[str] = ()) -> Any:
    """The case in a file, with changes such as "particles.per_cell=500"; raises CaseError with all its mistakes."""
    from . import simulation  # noqa: F401 -- registers the laws
    from .case.load import load as read

    return read(path, sets)


def change(case: Any, changes: Mapping[str, Any]) -> Any:
    """The case with other values, as in a case file; the old one stays as it is.

    >>> finer = change(case, {"particles.per_cell": 3000, "adhesion.cells.bonds": "2000 /um^2"})
    """
    from .case.load import change as changed

    return changed(case, changes)


def build(case: Any, comm: Any = None) -> Any:
    """A Simulation of a case on the ranks of an MPI communicator, all of them by default; collective.

    >>> simulation = build(load("cases/one_cell.toml"))
    >>> simulation.go(20.0)                      # µs
    >>> history, ledger = simulation.sample()
    """
    from .simulation import Simulation

    return Simulation(case) if comm is None else Simulation(case, comm)


def run(case: Any, out: str | PathLike | None = None, until: str | None = None, quiet: bool = False) -> Any:
    """Run a case and return the Record of what it left; collective.

    Parameters
    ----------
    case : Case.
    out : Path -- directory of the run, by default output/<name of the case>; a run that is there is moved aside.
    until : str -- end earlier or later than the case says, such as "40 us".
    quiet : bool -- show neither log nor progress.

    Raises NumericsError or OutputError if the run breaks; what it left until then can be opened.
    """
    from .case.units import number
    from .study.session import run_here

    directory = Path("output") / case.name if out is None else Path(out)
    return run_here(case, directory, None if until is None else number(until, "us"), quiet)


def open(directory: str | PathLike) -> Any:
    """The Record of a run that is there, finished or not: its case, tables and frames."""
    from .study.record import Record

    return Record(Path(directory))
