"""Tables of a run: history and tracks of cells, their cues, energy ledger, traction, forces between cells."""

from __future__ import annotations

import csv
import errno
import hashlib
import os
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..case.time_unit import MICROSECOND, TimeUnit
from .directory import OutputError, sync, together

if TYPE_CHECKING:
    from mpi4py import MPI

# Contacts with substrate and cells, content and surface of cells, by the number of dimensions.
MEASURES = {2: ("substrate_contact_um", "cell_contact_um", "area_um2", "perimeter_um"),
            3: ("substrate_contact_um2", "cell_contact_um2", "volume_um3", "surface_um2")}
FORM = {2: (), 3: ("height_um", "sphericity")}  # height of the top over the substrate; that of Wadell (1935)
HISTORY = {d: ("time_us", "cell", *(f"{axis}_um" for axis in "xyz"[:d]), *(f"u{axis}_um" for axis in "xyz"[:d]),
               *MEASURES[d], *FORM[d], "effective_stress_pa", "sigma11_lower_centre_pa") for d in (2, 3)}
MOTION = {d: (*(f"v{axis}_um_per_us" for axis in "xyz"[:d]), "speed_um_per_us") for d in (2, 3)}  # means
ENERGIES = ("kinetic", "elastic", "compression", "director", "adhesion_substrate", "adhesion_cells",
            "external_work", "viscous_loss", "network_loss", "friction_loss", "medium_loss", "artificial_dissipation",
            "renewal_loss")
ENERGY = {2: "pn", 3: "pn_um"}  # unit of energies: in two dimensions per µm of thickness
ON_GELS = {d: (f"strain_energy_{unit}", f"dipole_{unit}") for d, unit in ENERGY.items()}  # of bodies that drag others
IMPULSE = {2: "pN_us_per_um", 3: "pN_us"}  # units of momentum, as in names of keys
LEDGER = {d: ("time_us", *(f"{name}_{unit}" for name in ENERGIES), "energy_error") for d, unit in ENERGY.items()}

_BOTH = ("", "_now")  # mean since the last sample, and current value
ALONG = {2: ("",), 3: ("_x", "_y")}  # axes of the substrate, in names of columns
FORCE = {2: "pn_per_um", 3: "pn"}  # unit of forces
SUBSTRATE = {d: ("time_us", "cell", *(f"{axis}_um" for axis in "xy"[: d - 1]),
                 *(f"{what}{kind}_pa" for kind in _BOTH for what in (
                     "normal", *(f"tangential{axis}" for axis in along), *(f"friction{axis}" for axis in along))),
                 "name") for d, along in ALONG.items()}
NEIGHBOURS = {d: ("time_us", "cell", "neighbour",
                  *(f"{what}{kind}_{unit}" for kind in _BOTH for what in (
                      *(f"force_{axis}" for axis in "xyz"[:d]), "pull")),
                  MEASURES[d][1], "name", "neighbour_name") for d, unit in FORCE.items()}
TRACKS = {d: ("id", "time_us", *(f"{axis}_um" for axis in "xyz"[:d])) for d in (2, 3)}  # in celltrackR's order
CUES = {d: ("time_us", "cell", "name", *(f"polarity{axis}" for axis in ALONG[d]),
            *(f"push{axis}_{FORCE[d]}" for axis in ALONG[d])) for d in (2, 3)}
_AMOUNTS = ("secreted", "taken_up", "inside", "out", "decayed", "start", "lost")
MOLECULES = {d: ("time_us", "cell", *(f"{name}{unit}" for name in _AMOUNTS), "name", "field")
             for d, unit in ((2, "_per_um"), (3, ""))}
PROBED = {2: ("x", "y", "ux", "uy"), 3: ("x", "y", "z", "ux", "uy", "uz")}
HELD = {d: tuple(f"{axis}_{unit}" for axis in "xyz"[:d]) for d, unit in FORCE.items()}  # of supports and plates
ALL = "all"  # name of the aggregate of all cells
_WHOLE, _TEXT = ("cell", "neighbour"), ("name", "neighbour_name", "id", "field")
# Columns that had another name in older runs.
_FORMERLY = {**{name: f"{name}_pn" for name in ENERGIES}, "protrusion_work": "external_work_pn",
             "numerical_loss": "artificial_dissipation_pn", "closure": "energy_error"}


def further_columns(probes: Iterable[str], holders: Iterable[str], dimension: int = 2, gels: bool = False,
                    touching: bool = False) -> tuple[str, ...]:
    """Columns of history.csv besides HISTORY: velocities, probes, supports and plates, name of the cell; with `gels`
    what bodies do to each other that rub or push off each other; with `touching` the number of neighbours.
    """
    return (*MOTION[dimension], *("neighbours",) * touching, *(ON_GELS[dimension] if gels else ()),
            *(f"{name}_{what}_um" for name in probes for what in PROBED[dimension]),
            *(f"{name}_force_{c}" for name in holders for c in HELD[dimension]), "name")


def cue_columns(cues: Iterable[str], dimension: int = 2) -> tuple[str, ...]:
    """Columns of cues.csv besides CUES: the parts [-] of cues, of distinct names, in what turns a cell."""
    return tuple(f"{name}{axis}" for name in cues for axis in ALONG[dimension])


def digest_up_to(path: Path, end: Mapping[str, Any]) -> Any:
    """The sha256 of a table up to a former `end`.  Raises OutputError if the table was changed."""
    content = path.read_bytes() if path.exists() else b""
    if len(content) < end["bytes"]:
        raise OutputError(f"'{path}' has {len(content)} bytes where a checkpoint has {end['bytes']}: it cannot go on "
                          "there")
    digest = hashlib.sha256(content[:end["bytes"]])
    if digest.hexdigest() != end["sha256"]:
        raise OutputError(f"'{path}' is not the table that the checkpoint was written beside: it was changed, or is of "
                          "another run")
    return digest


class _Table:
    """Appends rows to a file on rank 0, those of a sample in one call, so that a killed run leaves whole lines.

    Rows have the columns and units of the code; the file has times in a unit of its own, as names of columns tell.
    """

    name: str
    kinds: Mapping[int, tuple[str, ...]]  # columns by the number of dimensions
    columns: tuple[str, ...]
    names: Sequence[str] = ()  # of the cells, by number; 0 is the aggregate

    def __init__(self, directory: Path, comm: MPI.Intracomm, more: tuple[str, ...] = (),
                 end: Mapping[str, Any] | None = None, dimension: int = 2, unit: TimeUnit = MICROSECOND) -> None:
        """`more` : further columns;  `end` : end of a table to resume, as `end` returned it;  `unit` : of times."""
        self._comm, self._path, self.columns = comm, Path(directory) / self.name, (*self.kinds[dimension], *more)
        self._unit = unit
        self._digest = hashlib.sha256()
        together(comm, lambda: self._cut(end) if end else self._begin(), root_only=True)

    def _begin(self) -> None:
        if self._path.exists():
            self._digest.update(self._path.read_bytes())
        else:
            self._append(",".join(map(self._unit.column, self.columns)) + "\n")

    def _cut(self, end: Mapping[str, Any]) -> None:
        self._digest = digest_up_to(self._path, end)
        os.truncate(self._path, end["bytes"])

    def end(self) -> dict[str, Any]:
        """Length and sha256 of the table, for a checkpoint; on rank 0."""
        return {"bytes": self._path.stat().st_size, "sha256": self._digest.hexdigest()}

    def flush(self) -> None:
        """Flush all rows to the disk; collective."""
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
            self._digest.update(data)
        except OSError as error:
            raise OutputError(f"cannot write '{self._path}' ({error.strerror})") from error

    def _write(self, rows: Callable[[], Iterable[Mapping[str, Any]]]) -> None:
        together(self._comm, lambda: self._append("".join(map(self._line, rows()))), root_only=True)

    def _line(self, row: Mapping[str, Any]) -> str:
        numbers = {"name": row.get("cell", -1), "neighbour_name": row.get("neighbour", -1)}
        row = {**row, **{text: self.names[int(k)] for text, k in numbers.items()
                         if text in self.columns and 0 <= k < len(self.names)}}
        if foreign := row.keys() - set(self.columns):
            raise ValueError(f"{self.name} has no column {sorted(foreign)}")
        return ",".join(_text(self._unit.entry(c, row.get(c, np.nan))) for c in self.columns) + "\n"


def _text(value: float | str) -> str:
    """Shortest text that reads back as the same bits; a name in quotes where CSV needs them."""
    if isinstance(value, str):
        return '"' + value.replace('"', '""') + '"' if set(value) & set(',"') else value
    return str(int(value)) if isinstance(value, (int, np.integer)) else repr(float(value))


class History(_Table):
    """Writer of `history.csv`; collective; ranks other than 0 may pass None."""

    name, kinds = "history.csv", HISTORY

    def write(self, time: float, rows: Sequence[Mapping[str, float]]) -> None:
        """Add a sample at `time` [us]: `rows[k]` has the columns of cell k without time and cell; 0 is the aggregate.

        Missing columns are written as nan.
        """
        self._write(lambda: ({"time_us": float(time), "cell": cell, **row} for cell, row in enumerate(rows)))


class Ledger(_Table):
    """Writer of `ledger.csv`; collective; ranks other than 0 may pass None."""

    name, kinds = "ledger.csv", LEDGER

    def write(self, time: float, entries: Mapping[str, float]) -> None:
        """Add a sample at `time` [us]: energies per thickness [pN], and their error [-]; absent is nan."""
        self._write(lambda: [{"time_us": float(time), **entries}])


class Tracks(_Table):
    """Writer of `tracks.csv`: centres of cells [µm] by name; collective; ranks other than 0 may pass None."""

    name, kinds = "tracks.csv", TRACKS
    gels: Set[str] = frozenset()  # names of bodies without tracks

    def write(self, time: float, rows: Sequence[Mapping[str, float]]) -> None:
        """Add a sample at `time` [us] from the rows of history, of which the aggregate has no track."""
        self._write(lambda: ({**{name: rows[cell].get(name, np.nan) for name in self.columns[2:]},
                              "id": self.names[cell], "time_us": float(time)} for cell in range(1, len(rows))
                             if self.names[cell] not in self.gels))


class Surroundings(_Table):
    """Writer of `substrate.csv`, `neighbours.csv` or `cues.csv`; collective; ranks other than 0 may pass None."""

    def write(self, time: float, rows: Sequence[Mapping[str, float]]) -> None:
        """Add the rows of a sample at `time` [us], without the time."""
        self._write(lambda: ({"time_us": float(time), **row} for row in rows))


class Substrate(Surroundings):
    """Writer of `substrate.csv`: traction of each cell by place [Pa]."""

    name, kinds = "substrate.csv", SUBSTRATE


class Neighbours(Surroundings):
    """Writer of `neighbours.csv`: forces between pairs of cells in contact [pN/um], in space [pN]."""

    name, kinds = "neighbours.csv", NEIGHBOURS


class Cues(Surroundings):
    """Writer of `cues.csv`: polarity [-], push [pN/um, in space pN] and the part of each cue [-], by cell."""

    name, kinds = "cues.csv", CUES


class Molecules(Surroundings):
    """Writer of `molecules.csv`: accounts of fields that diffuse [-], per µm of thickness in two dimensions [1/um]."""

    name, kinds = "molecules.csv", MOLECULES


class Tables:
    """All tables of a run; collective.

    Parameters
    ----------
    directory : Path -- of the run.
    comm : mpi4py communicator.
    names : list of str -- of the cells.
    more : list of str -- columns of history besides HISTORY.
    dimension : int -- of the scene.
    present : dict -- whether the run has "substrate", "neighbours", "tracks", "cues" and "molecules".
    ends : dict -- ends of tables to resume, by name, as `ends` returned them; empty for a new run.
    unit : TimeUnit -- of times in them.
    cues : tuple of str -- columns of cues.csv besides CUES, as `cue_columns` has them.
    gels : set of str -- names of bodies that are no cells, and have no tracks.
    """

    def __init__(self, directory: Path, comm: MPI.Intracomm, names: Sequence[str], more: tuple[str, ...],
                 present: Mapping[str, bool], ends: Mapping[str, Any], dimension: int = 2,
                 unit: TimeUnit = MICROSECOND, cues: tuple[str, ...] = (), gels: Set[str] = frozenset()) -> None:
        self._comm = comm

        def opened(kind: type[_Table], more: tuple[str, ...] = ()) -> Any:
            table = kind(directory, comm, more, ends.get(kind.name.removesuffix(".csv")), dimension, unit)
            table.names = (ALL, *names)
            return table

        self.history, self.ledger = opened(History, more), opened(Ledger)
        self.tracks = opened(Tracks) if present.get("tracks") else None
        if self.tracks is not None:
            self.tracks.gels = gels
        kinds: dict[str, tuple[type[_Table], tuple[str, ...]]] = {
            "substrate": (Substrate, ()), "neighbours": (Neighbours, ()), "cues": (Cues, cues),
            "molecules": (Molecules, ())}
        self._surroundings = {name: opened(*kind) for name, kind in kinds.items() if present.get(name)}

    def write(self, time: float, rows: Sequence[Mapping[str, float]], entries: Mapping[str, float],
              surroundings: Mapping[str, Sequence[Mapping[str, float]]]) -> None:
        """Add a sample at `time` [us] to all tables."""
        self.history.write(time, rows)
        self.ledger.write(time, entries)
        if self.tracks:
            self.tracks.write(time, rows)
        for name, table in self._surroundings.items():
            table.write(time, surroundings[name])

    def _all(self) -> dict[str, _Table]:
        tracks = {"tracks": self.tracks} if self.tracks else {}
        return {"history": self.history, "ledger": self.ledger, **tracks, **self._surroundings}

    def flush(self) -> None:
        """Flush all rows to the disk."""
        for table in self._all().values():
            table.flush()

    def ends(self) -> dict[str, dict[str, Any]]:
        """Ends of all tables, for a checkpoint, on all ranks."""
        tables = self._all()
        found = together(self._comm, lambda: {name: tables[name].end() for name in tables}, root_only=True)
        return self._comm.bcast(found[0])


# Columns that all runs have, older ones included.
_COLUMNS: dict[str, dict[int, tuple[str, ...]]] = {
    "history.csv": HISTORY, "substrate.csv": SUBSTRATE, "tracks.csv": TRACKS, "cues.csv": CUES,
    **{f"{name}.csv": {d: tuple(c for c in columns if not any(part in c for part in later))
                       for d, columns in kinds.items()}
       for name, kinds, later in (("neighbours", NEIGHBOURS, ("contact",)),
                                  ("ledger", LEDGER, ("friction_loss", "medium_loss", "network_loss",
                                                       "renewal_loss")))}}


def names_of(history: Mapping[str, np.ndarray]) -> dict[int, str]:
    """Names of the cells by number, from history.csv; older runs have none, and get "cell 1" and so on."""
    cells, first = np.unique(history["cell"], return_index=True)
    named = history["name"][first].tolist() if "name" in history else [f"cell {c}" if c else ALL for c in cells]
    return dict(zip(cells.tolist(), named, strict=True))


def time_column(table: Iterable[str]) -> str:
    """Name of the column of times of a table, such as "time_us" or "time_h"; "time_us" if it has none."""
    return next(filter(TimeUnit.of_column, table), "time_us")


def unit_of(table: Iterable[str]) -> TimeUnit:
    """Unit of the times of a table."""
    return TimeUnit.of_column(time_column(table)) or MICROSECOND


def in_unit(table: Mapping[str, np.ndarray], unit: TimeUnit) -> Mapping[str, np.ndarray]:
    """A table with its times and rates of change in a unit."""
    given, time = unit_of(table), time_column(table)
    rate, ratio = f"_per_{given.symbol}", given.size / unit.size
    if given == unit:
        return table

    def changed(name: str, values: np.ndarray) -> tuple[str, np.ndarray]:
        if name == time:
            return f"time_{unit.symbol}", ratio * values
        if name.endswith(rate):
            return f"{name.removesuffix(rate)}_per_{unit.symbol}", values / ratio
        return name, values

    return dict(changed(name, values) for name, values in table.items())


class Columns(dict[str, np.ndarray]):
    """Columns of a table by name; the KeyError of a former name says the present one."""

    def __missing__(self, name: str) -> np.ndarray:
        raise KeyError(f"'{name}' is called '{_FORMERLY[name]}' now" if name in _FORMERLY else name)


def read_table(path: Path) -> dict[str, np.ndarray]:
    """Columns of a table by name, each (rows,): int64 for cells, str for names, else float64; the run may go on."""
    try:
        lines = Path(path).read_text(encoding="utf-8").split("\n")[:-1]  # without an incomplete last line
        if not lines:
            return {}
        names = lines[0].split(",")
        if Path(path).name == "ledger.csv":
            names = [_FORMERLY.get(name, name) for name in names]
        rows = list(csv.reader(lines[1:], strict=True))
        unit = unit_of(names)
        lacking = min(([name for name in map(unit.column, columns) if name not in names]
                       for columns in _COLUMNS.get(Path(path).name, {2: ()}).values()), key=len)
        if lacking:
            raise ValueError(f"it has no column {', '.join(lacking)}")
        columns = zip(*rows, strict=True) if rows else [()] * len(names)
        kinds: dict[str, Any] = {**dict.fromkeys(_WHOLE, np.int64), **dict.fromkeys(_TEXT, str)}
        return Columns({name: np.array(column, dtype=str).astype(kinds.get(name, np.float64))
                        for name, column in zip(names, columns, strict=True)})
    except (ValueError, csv.Error) as error:
        raise OutputError(f"'{path}' is not a table of numbers: {error}") from error
