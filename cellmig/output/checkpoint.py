"""Checkpoints: files that are complete or absent, with a checksum; the last two of a run are kept.

A checkpoint is an HDF5 file with arrays in global order, so that any number of ranks can read it, and a text in JSON.
The sha256 of the HDF5 data follows after their end, where HDF5 ignores it.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from .directory import OutputError, replace, together

if TYPE_CHECKING:
    from mpi4py import MPI

FOLDER, KEEP = "checkpoint", 2
_ABOUT = "about"
_NAME = re.compile(r"c(\d{8})\.h5")
_SEAL = b"\nsha256 "  # before the 64 digits of the checksum
_SEALED = len(_SEAL) + 64


@dataclass(frozen=True)
class Checkpoint:
    """A state of a run.

    about : dict -- everything but arrays, in the types of JSON; the same on all ranks.
    arrays : dict -- arrays by name, in global order, on rank 0; empty on the others.
    """

    about: dict[str, Any]
    arrays: dict[str, np.ndarray]


def write(directory: Path, comm: MPI.Intracomm, checkpoint: Checkpoint, keep: int = KEEP) -> Path:
    """Write a checkpoint of a run to the disk and delete all but the last `keep`; collective, rank 0 writes.

    Returns its path.  Raises OutputError where it cannot be written.
    """
    return together(comm, lambda: _write(Path(directory) / FOLDER, checkpoint, keep), root_only=True)[0]


def _write(folder: Path, checkpoint: Checkpoint, keep: int) -> Path:
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write '{folder}' ({error.strerror})") from error
    numbers = [number for number, _ in listed(folder)]
    path = folder / f"c{max(numbers, default=0) + 1:08d}.h5"
    image = _image(checkpoint)
    replace(path, image + _SEAL + hashlib.sha256(image).hexdigest().encode(), lasting=True)
    for old in [old for _, old in listed(folder)[:-keep]] + (list(folder.glob("*.damaged")) if keep == 1 else []):
        old.unlink(missing_ok=True)
    return path


def _image(checkpoint: Checkpoint) -> bytes:
    # The file is made in memory, as HDF5 would crash where the disk is full.
    with h5py.File("checkpoint", "w", driver="core", backing_store=False) as file:
        file.create_dataset(_ABOUT, data=np.frombuffer(json.dumps(checkpoint.about).encode(), np.uint8))
        for name, values in checkpoint.arrays.items():
            file.create_dataset(name, data=values)
        file.flush()
        return file.id.get_file_image()


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
                found = _read(path)
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
    about = comm.bcast(found.about if found else None)
    return None if about is None else Checkpoint(about, found.arrays if found else {})


class _DamagedError(Exception):
    """A damaged file; the message says how."""


def _read(path: Path) -> Checkpoint:
    content = path.read_bytes()
    image, seal = content[:-_SEALED], content[-_SEALED:]
    if not seal.startswith(_SEAL):
        raise _DamagedError("it ends too early")
    if hashlib.sha256(image).hexdigest().encode() != seal[len(_SEAL):]:
        raise _DamagedError("its checksum is another")
    with h5py.File(io.BytesIO(image), "r") as file:
        arrays = {name: data[()] for name, data in file.items()}
    return Checkpoint(json.loads(bytes(arrays.pop(_ABOUT))), arrays)
