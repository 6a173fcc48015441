"""`history.csv` and `ledger.csv`: what every cell did and where the energy went, one row per sample."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .directory import OutputError, sync, together

HISTORY = ("time_us", "cell", "x_um", "y_um", "ux_um", "uy_um", "substrate_contact_um", "cell_contact_um", "area_um2",
           "perimeter_um", "effective_stress_pa", "sigma11_lower_centre_pa")
LEDGER = ("time_us", "kinetic", "elastic", "compression", "director", "adhesion_substrate", "adhesion_cells",
          "protrusion_work", "viscous_loss", "numerical_loss", "closure")


def further_columns(probes: Iterable[str], holders: Iterable[str]) -> tuple[str, ...]:
    """Columns of history.csv beside HISTORY: of probes, then of supports and plates, by their names."""
    return (*(f"{name}_{what}_um" for name in probes for what in ("x", "y", "ux", "uy")),
            *(f"{name}_force_{c}_pn_per_um" for name in holders for c in "xy"))


class _Table:
    """Rows at the end of a file, by rank 0; all rows of a sample leave in one call, so a killed run cuts no line."""

    name: str
    columns: tuple[str, ...]

    def __init__(self, directory: Path, comm: Any, more: tuple[str, ...] = (), size: int = 0) -> None:
        """`more` : columns that this scene has besides;  `size` : of the file up to where it is to go on [bytes]."""
        self._comm, self._path, self.columns = comm, Path(directory) / self.name, (*self.columns, *more)
        together(comm, lambda: self._cut(size) if size else self._begin(), root_only=True)

    def _begin(self) -> None:
        if not self._path.exists():
            self._append(",".join(self.columns) + "\n")

    def _cut(self, size: int) -> None:
        there = self._path.stat().st_size if self._path.exists() else 0
        if there < size:
            raise OutputError(f"'{self._path}' has {there} bytes where a checkpoint has {size}: it cannot go on there")
        os.truncate(self._path, size)

    def size(self) -> int:
        """Of the file [bytes], from where to go on; rank 0 alone."""
        return self._path.stat().st_size

    def settle(self) -> None:
        """Have the disk hold all rows; collective."""
        together(self._comm, lambda: sync(self._path), root_only=True)

    def _append(self, text: str) -> None:
        data = text.encode()
        try:
            with open(self._path, "ab", buffering=0) as file:
                whole = file.tell()
                try:
                    if file.write(data) != len(data):
                        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                except OSError:
                    file.truncate(whole)
                    raise
        except OSError as error:
            raise OutputError(f"cannot write '{self._path}' ({error.strerror})") from error

    def _write(self, rows: Callable[[], Iterable[Mapping[str, float]]]) -> None:
        together(self._comm, lambda: self._append("".join(map(self._line, rows()))), root_only=True)

    def _line(self, row: Mapping[str, float]) -> str:
        if foreign := row.keys() - set(self.columns):
            raise ValueError(f"{self.name} has no column {sorted(foreign)}")
        return ",".join(_text(row.get(column, np.nan)) for column in self.columns) + "\n"


def _text(value: float) -> str:
    """Shortest text that reads back as the same bits."""
    return str(int(value)) if isinstance(value, (int, np.integer)) else repr(float(value))


class History(_Table):
    """Writer of `history.csv`; collective; the numbers of rank 0 count, the others may pass None."""

    name, columns = "history.csv", HISTORY

    def write(self, time: float, rows: Sequence[Mapping[str, float]]) -> None:
        """Add a sample at `time` [us]: `rows[k]` has the columns of cell k, without time and cell; 0 is the aggregate.

        What a row lacks, because the scene has it not, is written as nan.
        """
        self._write(lambda: ({"time_us": float(time), "cell": cell, **row} for cell, row in enumerate(rows)))


class Ledger(_Table):
    """Writer of `ledger.csv`; collective; the numbers of rank 0 count, the others may pass None."""

    name, columns = "ledger.csv", LEDGER

    def write(self, time: float, entries: Mapping[str, float]) -> None:
        """Add a sample at `time` [us]: the entries [pN], energy per thickness, and the closure [-]; absent is nan."""
        self._write(lambda: [{"time_us": float(time), **entries}])


_COLUMNS = {table.name: table.columns for table in (History, Ledger)}


def read_table(path: Path) -> dict[str, np.ndarray]:
    """Columns of a table by name, (rows,) each, float64 (`cell`: int64); a run may still be writing it."""
    try:
        lines = Path(path).read_text(encoding="utf-8").split("\n")[:-1]  # after the last newline is no whole line
        if not lines:
            return {}
        names, rows = lines[0].split(","), [line.split(",") for line in lines[1:]]
        if lacking := [name for name in _COLUMNS.get(Path(path).name, ()) if name not in names]:
            raise ValueError(f"it has no column {', '.join(lacking)}")
        columns = zip(*rows, strict=True) if rows else [()] * len(names)
        return {name: np.array(column, dtype=str).astype(np.int64 if name == "cell" else np.float64)
                for name, column in zip(names, columns, strict=True)}
    except ValueError as error:
        raise OutputError(f"'{path}' is not a table of numbers: {error}") from error
