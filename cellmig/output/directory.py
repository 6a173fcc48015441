"""The directory of a run: made fresh, never over an old one, and files in it that are whole or absent."""

from __future__ import annotations

import fcntl
import os
import shutil
import weakref
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from ..case.messages import nearest

MANIFEST, INDEX = "manifest.json", "cells.xdmf"
READABLE = "utf-8", "backslashreplace"  # of all texts: names of files may have bytes that are no UTF-8
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
    part = path.with_name(f"{path.name}.{os.getpid()}.part")  # of this process alone
    try:
        part.write_bytes(content.encode(*READABLE) if isinstance(content, str) else content)
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


class Claim:
    """A directory that one run, or one command that does many, has for itself, until released or the process ends.

    It leaves no trace in the directory; file systems that know no locks grant every claim.
    """

    def __init__(self, path: Path, comm: Any, make: bool = False) -> None:
        """Wait for a run that is dying; collective, rank 0 does it.  Raises OutputError if another run stays there.

        `make` : the directory where there is none; it goes again if it is left empty.
        """
        self.path, self._comm = Path(path), comm
        handle, made = together(comm, lambda: _locked(self.path, make), root_only=True)[comm.rank] or (None, False)
        self.release = weakref.finalize(self, _let_go, self.path, handle, made) if handle is not None else lambda: None

    def __enter__(self) -> Claim:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def clear(self) -> Path | None:
        """Empty it for a new run and mark it as a run's; collective, rank 0 does it.

        What is there is moved to ``path.1``, ``path.2`` …, the next number that is free: where it is now, None if
        there was nothing.  The directory itself stays: it may be where the user is, or a link points to it.

        Raises
        ------
        OutputError -- something that is not a run is there, or the place cannot be written.
        """
        return together(self._comm, lambda: _clear(self.path), root_only=True)[0]


def _locked(path: Path, make: bool) -> tuple[int, bool] | None:
    """Handle of a directory that is locked, and whether it was made here; None if it is not there."""
    give_up, made = monotonic() + PATIENCE, False
    while True:
        try:
            if make and not path.is_dir():
                Path(os.path.realpath(path)).mkdir(parents=True, exist_ok=True)  # a link may point to what is not there
                made = True
            handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
        except OSError as error:
            if not make and isinstance(error, FileNotFoundError | NotADirectoryError):
                return None
            if monotonic() > give_up or not isinstance(error, FileNotFoundError):  # another may have taken it away
                raise _cannot_write(path, error) from error
            sleep(0.05)
            continue
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            if monotonic() > give_up:
                raise _at_work(path) from None
            sleep(0.05)
            continue
        except OSError:
            return handle, made
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(handle), os.stat(path)):
                return handle, made
        os.close(handle)  # another directory is there now


def _let_go(path: Path, handle: int, made: bool) -> None:
    if made:
        with suppress(OSError):
            path.rmdir()
    os.close(handle)


def _at_work(path: Path) -> OutputError:
    return OutputError(f"another run is at work in '{path}'; wait for its end, or choose another place with --out DIR")


def _cannot_write(path: Path, error: OSError) -> OutputError:
    return OutputError(f"cannot write in '{path}' ({error.strerror}); choose another place with --out DIR")


def _clear(path: Path) -> Path | None:
    try:
        aside = _move_aside(path) if any(path.iterdir()) else None
        with open(path / MANIFEST, "x", encoding="utf-8") as manifest:
            manifest.write("{}\n")  # marks a run that was killed before it wrote anything
        return aside
    except OutputError:
        raise
    except FileExistsError as error:  # where there are no locks
        raise _at_work(path) from error
    except OSError as error:
        raise _cannot_write(path, error) from error


def _move_aside(path: Path) -> Path:
    # Its list of frames first and its manifest last: if this is killed, either part is still known for a run.
    names = sorted(os.listdir(path), key=lambda name: (name == MANIFEST, name != INDEX))
    if not {MANIFEST, INDEX} & set(names):
        raise OutputError(f"'{path}' holds files that are not a run's; empty it or choose another place with --out DIR")
    aside = _numbered(Path(os.path.realpath(path)))
    try:
        shutil.copymode(path, aside)
        for name in names:
            os.rename(path / name, aside / name)
    except OSError as error:
        with suppress(OSError):
            aside.rmdir()
        raise OutputError(f"the run in '{path}' cannot be moved to '{aside}' ({error.strerror}); choose another place "
                          "with --out DIR") from error
    return aside if path.is_absolute() else Path(os.path.relpath(aside))


def _numbered(path: Path) -> Path:
    """A new directory beside another, with the next number that is free."""
    number = 1
    while True:
        aside = path.with_name(f"{path.name}.{number}")
        try:
            aside.mkdir()
            return aside
        except FileExistsError:
            number += 1
        except OSError as error:
            raise OutputError(f"the run in '{path}' cannot be moved to '{aside}' ({error.strerror}); choose another "
                              "place with --out DIR") from error
