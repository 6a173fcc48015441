"""The directory of a run: made fresh, never over an old one, and files in it that are whole or absent."""

from __future__ import annotations

import fcntl
import os
import weakref
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from ..case.messages import nearest

MANIFEST, INDEX = "manifest.json", "cells.xdmf"
PATIENCE = 15.0  # seconds that ranks of a run whose launcher was killed may take to follow it


class OutputError(OSError):
    """The run cannot write, or a run cannot be read; the message is for the user and the same on all ranks."""


def the_run(directory: Path) -> Path:
    """The directory of a run that is there, finished or not."""
    directory = Path(directory)
    if any((directory / name).exists() for name in (MANIFEST, INDEX)):
        return directory
    beside = {path.parent.name for path in directory.parent.glob(f"*/{MANIFEST}")}
    near = nearest(directory.name, sorted(beside))
    meant = f"; did you mean '{directory.parent / near}'?" if near else ""
    if directory.suffix == ".toml":
        meant = f" but a case: a run of it leaves 'output/{directory.stem}'"
    raise OutputError(f"'{directory}' is not the directory of a run{meant}")


def together(comm: Any, action: Callable[[], Any], root_only: bool = False) -> list[Any]:
    """Do `action` on every rank, or on rank 0 alone, and stop all ranks together if it fails on one.

    Parameters
    ----------
    comm : mpi4py communicator; collective.
    action : callable without arguments; an OSError of it becomes an OutputError on all ranks.
    root_only : bool -- only rank 0 acts; the result of the others is None.

    Returns
    -------
    list -- the results by rank.
    """
    result, error = None, None
    if comm.rank == 0 or not root_only:
        try:
            result = action()
        except OSError as failure:
            error = str(failure)
    outcome = comm.allgather((result, error))
    for rank, (_, message) in enumerate(outcome):
        if message:
            raise OutputError(message if root_only else f"rank {rank}: {message}")
    return [value for value, _ in outcome]


def replace(path: Path, content: str | bytes, lasting: bool = False) -> None:
    """Write a file that is either the old one or the new one, whole, whenever the run is killed or the disk full.

    `lasting` : it is on the disk when this returns, and outlives a power cut.
    """
    part = path.with_name(path.name + ".part")
    try:
        part.write_bytes(content.encode() if isinstance(content, str) else content)
        if lasting:
            sync(part)
        os.replace(part, path)
        if lasting:
            sync(path.parent)
    except OSError as error:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise OutputError(f"cannot write '{path}' ({error.strerror})") from error


def sync(path: Path) -> None:
    """Have the disk hold what was written to a file, or the names in a directory."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def fresh_directory(path: Path, comm: Any) -> Path | None:
    """Make an empty directory for a new run, marked as a run's; collective, rank 0 does it.

    A run that is already there is moved aside to ``path.1``, ``path.2`` …, the next number that is free: where it is
    now, None if there was none.

    Parameters
    ----------
    path : Path -- where the run is to leave its files.
    comm : mpi4py communicator.

    Raises
    ------
    OutputError -- something that is not a run is there, or the place cannot be written.
    """
    return together(comm, lambda: _make(Path(path)), root_only=True)[0]


class Claim:
    """A directory that this run alone writes in, until it is released or the process ends, however that is.

    It leaves no trace in the directory; file systems that know no locks grant every claim.
    """

    def __init__(self, path: Path, comm: Any) -> None:
        """Wait for a run that is dying; collective, rank 0 does it.  Raises OutputError if another run stays there."""
        handle = together(comm, lambda: _locked(Path(path)), root_only=True)[comm.rank]
        self.release = weakref.finalize(self, os.close, handle) if handle is not None else lambda: None


def _locked(path: Path) -> int | None:
    """Handle of a directory that is locked; None if it is not there."""
    try:
        handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    except (FileNotFoundError, NotADirectoryError):
        return None
    give_up = monotonic() + PATIENCE
    while True:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return handle
        except BlockingIOError:
            if monotonic() > give_up:
                os.close(handle)
                raise OutputError(f"another run is at work in '{path}'; wait for its end, or choose another place with "
                                  "--out DIR") from None
            sleep(0.05)
        except OSError:
            return handle


def _make(path: Path) -> Path | None:
    aside = None
    try:
        if path.is_dir() and any(path.iterdir()):
            handle = _locked(path)
            aside = _move_aside(path)
            os.close(handle)
        path.mkdir(parents=True, exist_ok=True)
        (path / MANIFEST).write_text("{}\n")  # marks a run that was killed before it wrote anything
        return aside
    except OutputError:
        raise
    except OSError as error:
        message = f"cannot write in '{path}' ({error.strerror}); choose another place with --out DIR"
        raise OutputError(message) from error


def _move_aside(path: Path) -> Path:
    if not any((path / name).exists() for name in (MANIFEST, INDEX)):
        raise OutputError(f"'{path}' holds files that are not a run's; empty it or choose another place with --out DIR")
    number = 1
    while (aside := path.with_name(f"{path.name}.{number}")).exists():
        number += 1
    path.rename(aside)
    return aside
