"""Directories of runs: new ones, locks, files that are complete or absent."""

from __future__ import annotations

import fcntl
import os
import shutil
import weakref
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any

from ..case.messages import nearest

if TYPE_CHECKING:
    from mpi4py import MPI

MANIFEST, INDEX = "manifest.json", "cells.xdmf"
READABLE = "utf-8", "backslashreplace"  # encoding of all texts: names of files may contain invalid UTF-8
PATIENCE = 15.0  # time that ranks may take to end after their launcher was killed [s]


class OutputError(OSError):
    """A run cannot be written or read; the message is for the user and the same on all ranks."""


def existing_run(directory: Path) -> Path:
    """The directory of an existing run.  Raises OutputError if it is none."""
    directory = Path(directory)
    if any((directory / name).exists() for name in (MANIFEST, INDEX)):
        return directory
    raise OutputError(f"'{directory}' is not the directory of a run{run_near(directory)}")


def run_near(directory: Path) -> str:
    """End of a message about a directory that is not that of a run: which is."""
    if directory.suffix == ".toml":
        return f" but a case: a run of it leaves 'output/{directory.stem}'"
    if (page := directory / "report.html").is_file() and (directory / "runs").is_dir():
        return f" but that of many, in '{directory / 'runs'}'; '{page}' is their page"
    if inside := _runs_in(directory):
        return f", but holds some, such as '{directory / inside[0]}'"
    near = nearest(directory.name, [name for name in _runs_in(directory.parent) if name != directory.name])
    return f"; did you mean '{directory.parent / near}'?" if near else ""


def _runs_in(folder: Path) -> list[str]:
    """Names of the directories of runs in a folder."""
    return sorted(path.parent.name for path in folder.glob(f"*/{MANIFEST}"))


def at_work(directory: Path) -> bool:
    """Whether a run or a command holds the lock of a directory; False where the file system has no locks."""
    handle = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    finally:
        os.close(handle)
    return False


def together(comm: MPI.Intracomm, action: Callable[[], Any], root_only: bool = False) -> list[Any]:
    """Call `action` on every rank, or on rank 0 alone; raise the error of one rank on all.

    Parameters
    ----------
    comm : mpi4py communicator; collective.
    action : callable without arguments.
    root_only : bool -- rank 0 alone calls it; the results of the others are None.

    Returns
    -------
    list -- the results by rank.

    Raises
    ------
    OutputError -- where `action` raised an OSError on any rank.
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
    """Replace a file as a whole: if the process is killed or the disk is full, the old one stays.

    lasting : flush it to the disk, so that it survives a power cut.  Raises OutputError where it cannot be written.
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
    """Flush a file, or the names in a directory, to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


class Claim:
    """A lock of a directory for one run or one command, until it is released or the process ends.

    It leaves no file in the directory; file systems without locks grant every claim.
    """

    def __init__(self, path: Path, comm: MPI.Intracomm, make: bool = False) -> None:
        """Lock the directory on rank 0, after a run that is ending; collective.

        make : create the directory if it is missing; it is removed again if it stays empty.  Raises OutputError where
        another run is at work in it.
        """
        self.path, self._comm = Path(path), comm
        handle, made = together(comm, lambda: _locked(self.path, make), root_only=True)[comm.rank] or (None, False)
        self.release: Callable[[], Any] = lambda: None
        if handle is not None:
            self.release = weakref.finalize(self, _release, self.path, handle, made)

    def __enter__(self) -> Claim:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def clear(self) -> Path | None:
        """Empty the directory for a new run and mark it as that of a run; collective, rank 0 does it.

        Existing files are moved to ``path.1`` or the next free number, which is returned, or None if there were none.
        The directory itself stays, as it may be a working directory or the target of a link.

        Raises
        ------
        OutputError -- where the directory holds other files than those of a run, or cannot be written.
        """
        return together(self._comm, lambda: _clear(self.path), root_only=True)[0]


def _locked(path: Path, make: bool) -> tuple[int, bool] | None:
    """Handle of the locked directory, and whether it was created here; None if it does not exist."""
    give_up, made = monotonic() + PATIENCE, False
    while True:
        try:
            if make and not path.is_dir():
                Path(os.path.realpath(path)).mkdir(parents=True, exist_ok=True)  # the target of a link may be missing
                made = True
            handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
        except OSError as error:
            if not make and isinstance(error, FileNotFoundError | NotADirectoryError):
                return None
            if monotonic() > give_up or not isinstance(error, FileNotFoundError):  # another process may have removed it
                raise _cannot_write(path, error) from error
            sleep(0.05)
            continue
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            if monotonic() > give_up:
                raise _in_use(path) from None
            sleep(0.05)
            continue
        except OSError:
            return handle, made
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(handle), os.stat(path)):
                return handle, made
        os.close(handle)  # the directory was replaced


def _release(path: Path, handle: int, made: bool) -> None:
    if made:
        with suppress(OSError):
            path.rmdir()
    os.close(handle)


def _in_use(path: Path) -> OutputError:
    return OutputError(f"another run is at work in '{path}'; wait for its end, or choose another place with --out DIR")


def _cannot_write(path: Path, error: OSError) -> OutputError:
    return OutputError(f"cannot write in '{path}' ({error.strerror}); choose another place with --out DIR")


def _clear(path: Path) -> Path | None:
    try:
        aside = _move_aside(path) if any(path.iterdir()) else None
        with open(path / MANIFEST, "x", encoding="utf-8") as manifest:
            manifest.write("{}\n")  # marks the directory of a run even if it is killed now
        return aside
    except OutputError:
        raise
    except FileExistsError as error:  # the file system has no locks
        raise _in_use(path) from error
    except OSError as error:
        raise _cannot_write(path, error) from error


def _move_aside(path: Path) -> Path:
    # The index of frames moves first, the manifest last: if this is killed, both parts are still recognised as runs.
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
    """A new directory beside `path`, with the next free number."""
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
