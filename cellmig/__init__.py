"""cellmig: collective cell migration by a meshfree particle method (Bai, Lin & Zeng 2019)."""

from __future__ import annotations

from typing import Any

__version__ = "0.1.0.dev0"
__all__ = ["build", "load"]


def load(path: Any, sets: tuple[str, ...] = ()) -> Any:
    """The case in a file, with changes such as "particles.per_cell=500"; raises CaseError with all its mistakes."""
    from . import simulation  # noqa: F401 -- registers the laws
    from .case.load import load as read

    return read(path, sets)


def build(case: Any, comm: Any = None) -> Any:
    """A Simulation of a case on the ranks of an MPI communicator, all of them by default; collective.

    >>> simulation = build(load("cases/one_cell.toml"))
    >>> simulation.go(20.0)                      # µs
    >>> history, ledger = simulation.sample()
    """
    from .simulation import Simulation

    return Simulation(case) if comm is None else Simulation(case, comm)
