"""Checkpoints: files that are complete or absent, with a checksum; the last two of a run are kept.

A checkpoint is an HDF5 file with arrays in global order, so that any number of ranks can read it, and a text in JSON.
Each rank writes and reads its own rows.  The sha256 of the HDF5 data follows after their end, where HDF5 ignores it.
"""

from __future__ import annotations

import errno
import hashlib
import json
import math
import mmap
import os
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from ..parallel.collect import Arrays, Rows
from .directory import OutputError, sync, together

if TYPE_CHECKING:
    from mpi4py import MPI

FOLDER, KEEP = "checkpoint", 2
_ABOUT = "about"
_NAME = re.compile(r"c(\d{8})\.h5")
_SEAL = b"\nsha256 "  # before the 64 digits of the checksum
_SEALED = len(_SEAL) + 64
_AT_ONCE = 1 << 24  # bytes that are read at a time
_NOWHERE = b"\x03\x01" + b"\xff" * 8  # begin of the layout message of a contiguous dataset without memory in the file
_END = slice(40, 48)  # where the superblock of HDF5, of version 0, has the end of the file


@dataclass(frozen=True)
class Checkpoint:
    """A state of a run.

    about : dict -- everything but arrays, in the types of JSON; the same on all ranks.
    arrays : dict -- to write: arrays by name, on rank 0 or in `Rows`.
    stored : Arrays -- that were read; None if they are to be written.
    """

    about: dict[str, Any]
    arrays: Mapping[str, np.ndarray | Rows] = field(default_factory=dict)
    stored: Arrays | None = None


class Stored:
    """Arrays in the file of a checkpoint, which may be deleted meanwhile; only what is asked for is read."""

    def __init__(self, path: Path):
        """Open the file.  Raises OutputError where it cannot be read."""
        try:
            with path.open("rb") as file:
                self._bytes = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            with h5py.File(path, "r", locking=False) as file:
                self._at = {name: (data.id.get_offset(), data.shape, data.dtype) for name, data in file.items()}
        except OSError as error:
            raise OutputError(f"cannot read '{path}': {error}") from error

    @property
    def names(self) -> list[str]:
        """Their names."""
        return [name for name in self._at if name != _ABOUT]

    def shape(self, name: str) -> tuple[int, ...]:
        """Shape of an array."""
        return self._at[name][1]

    def __getitem__(self, name: str) -> np.ndarray:
        """An array (n, ...), in its unit."""
        return np.array(self._mapped(name))

    def rows(self, name: str, number: np.ndarray) -> np.ndarray:
        """Rows `number` (k,) int of an array (k, ...), in its unit."""
        return np.array(self._mapped(name)[number])

    def _mapped(self, name: str) -> np.ndarray:
        at, shape, kind = self._at[name]
        if at is None or 0 in shape:
            return np.zeros(shape, kind)
        return np.frombuffer(self._bytes, kind, math.prod(shape), at).reshape(shape)


def write(directory: Path, comm: MPI.Intracomm, checkpoint: Checkpoint, keep: int = KEEP) -> Path:
    """Write a checkpoint of a run to the disk and delete all but the last `keep`; collective.

    Rank 0 writes the file but for what ranks have in `Rows`, then each rank its rows.  Returns its path.  Raises
    OutputError where it cannot be written.
    """
    folder = Path(directory) / FOLDER
    path, part, places = together(comm, lambda: _begin(folder, checkpoint), root_only=True)[0]
    try:
        together(comm, lambda: _fill(part, checkpoint, places))
        together(comm, lambda: _end(part, path, keep), root_only=True)
    except OutputError:
        if comm.rank == 0:
            part.unlink(missing_ok=True)
        raise
    return path


def _begin(folder: Path, checkpoint: Checkpoint) -> tuple[Path, Path, dict[str, int]]:
    """Path of a checkpoint, the file to be filled, with room for all, and places of the rows of ranks, by name."""
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write '{folder}' ({error.strerror})") from error
    path = folder / f"c{max((number for number, _ in listed(folder)), default=0) + 1:08d}.h5"
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    image, places, end = _image(checkpoint)
    try:
        part.write_bytes(image)
        with part.open("r+b") as file:
            _make_room(file.fileno(), end)
    except OSError as error:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise OutputError(f"cannot write '{path}' ({error.strerror})") from error
    return path, part, places


def _make_room(handle: int, end: int) -> None:
    """Make a file so long, and claim the disk for it where the file system can."""
    os.truncate(handle, end)
    try:
        os.posix_fallocate(handle, 0, end)
    except OSError as error:
        if error.errno not in (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS):
            raise


def _image(checkpoint: Checkpoint) -> tuple[bytes, dict[str, int], int]:
    """Begin of the file, places of the rows of ranks in it, by name, and its end.

    The begin is made in memory, as HDF5 would crash where the disk is full.  It declares the arrays that ranks have in
    `Rows`, which are never in one memory: the address of their data, which HDF5 has left open, is set here.
    """
    with h5py.File("checkpoint", "w", driver="core", backing_store=False) as file:
        file.create_dataset(_ABOUT, data=np.frombuffer(json.dumps(checkpoint.about).encode(), np.uint8))
        headers = {}
        for name, values in checkpoint.arrays.items():
            if isinstance(values, Rows) and 0 not in values.shape:
                data = file.create_dataset(name, values.shape, values.values.dtype)
                headers[name] = h5py.h5o.get_info(data.id).addr
            else:
                file.create_dataset(name, data=values.values if isinstance(values, Rows) else values)
        file.flush()
        image = bytearray(file.id.get_file_image())
    end, places = -(-len(image) // 8) * 8, {}
    for name, header in headers.items():
        at = image.index(_NOWHERE, header) + 2
        image[at : at + 8] = end.to_bytes(8, "little")
        places[name] = end
        values = checkpoint.arrays[name]
        end += math.prod(values.shape) * values.values.dtype.itemsize  # type: ignore[union-attr]
    image[_END] = end.to_bytes(8, "little")
    return bytes(image), places, end


def _fill(part: Path, checkpoint: Checkpoint, places: Mapping[str, int]) -> None:
    """Write this rank's rows to their places."""
    handle = os.open(part, os.O_WRONLY)
    try:
        for name, at in places.items():
            rows = checkpoint.arrays[name]
            assert isinstance(rows, Rows)
            values = np.ascontiguousarray(rows.values)
            width = values.dtype.itemsize * math.prod(values.shape[1:])
            for first, last in _runs(rows.number):
                _put(handle, values[first:last].reshape(-1).view(np.uint8), at + width * int(rows.number[first]))
        os.fsync(handle)
    finally:
        os.close(handle)


def _runs(number: np.ndarray) -> Iterator[tuple[int, int]]:
    """Where the integers of `number` (n,) int follow each other: first and last place, exclusive, of each run."""
    ends = np.concatenate([[0], np.flatnonzero(np.diff(number) != 1) + 1, [len(number)]]).tolist()
    return ((a, b) for a, b in pairwise(ends) if b > a)


def _put(handle: int, content: np.ndarray, at: int) -> None:
    """Write bytes (n,) int at a place of a file."""
    done = 0
    while done < len(content):
        done += os.pwrite(handle, content[done:].data, at + done)


def _end(part: Path, path: Path, keep: int) -> None:
    """Seal a file that is filled, give it its name, and delete all but the last `keep`."""
    try:
        with part.open("r+b") as file:
            digest = _digest(file)
            file.write(_SEAL + digest.encode())
        sync(part)
        os.replace(part, path)
        sync(path.parent)
    except OSError as error:
        raise OutputError(f"cannot write '{path}' ({error.strerror})") from error
    folder = path.parent
    for old in [old for _, old in listed(folder)[:-keep]] + (list(folder.glob("*.damaged")) if keep == 1 else []):
        old.unlink(missing_ok=True)


def _digest(file: Any, count: int | None = None) -> str:
    """The sha256 of the next `count` bytes of a file, by default of all that follow."""
    found, left = hashlib.sha256(), count
    while some := file.read(_AT_ONCE if left is None else min(_AT_ONCE, left)):
        found.update(some)
        left = None if left is None else left - len(some)
    return found.hexdigest()


def listed(folder: Path) -> list[tuple[int, Path]]:
    """Numbers and paths of all checkpoints in a folder, the oldest first, damaged ones included."""
    found = [(int(match[1]), path) for path in folder.glob("c*.h5") if (match := _NAME.fullmatch(path.name))]
    return sorted(found)


def newest(directory: Path, comm: MPI.Intracomm, report: Callable[[str], None]) -> Checkpoint | None:
    """The newest intact checkpoint of a run, None if it has no checkpoints; collective.

    Damaged ones are renamed and told to `report`.  Raises OutputError if all are damaged.
    """
    found, remarks = None, []

    def search() -> None:
        nonlocal found
        known = listed(Path(directory) / FOLDER)
        for _, path in reversed(known):
            try:
                found = path, _read(path)
                break
            except _DamagedError as damage:
                with suppress(OSError):  # a damaged one does not count as one of the last two
                    path.rename(f"{path}.damaged")
                remarks.append(f"checkpoint '{path}' is damaged ({damage}) and passed over")
        if known and found is None:
            raise OutputError(f"no checkpoint in '{known[0][1].parent}' is whole: {'; '.join(remarks)}")

    together(comm, search, root_only=True)
    for remark in comm.bcast(remarks):
        report(remark)
    there = comm.bcast(found)
    if there is None:
        return None
    path, about = there
    return Checkpoint(about, stored=_opened(path, comm))


def _opened(path: Path, comm: MPI.Intracomm) -> Stored:
    """The arrays of a checkpoint; collective.  Raises OutputError on all ranks where one cannot read it."""
    found: list[Stored] = []
    together(comm, lambda: found.append(Stored(path)))
    return found[0]


class _DamagedError(Exception):
    """A damaged file; the message says how."""


def _read(path: Path) -> dict[str, Any]:
    """The text of a checkpoint, whose checksum is right."""
    length = path.stat().st_size - _SEALED
    with path.open("rb") as file:
        digest = _digest(file, max(0, length))
        seal = file.read()
    if length < 0 or not seal.startswith(_SEAL):
        raise _DamagedError("it ends too early")
    if digest.encode() != seal[len(_SEAL):]:
        raise _DamagedError("its checksum is another")
    with h5py.File(path, "r", locking=False) as file:
        return json.loads(bytes(file[_ABOUT][()]))
