"""Tracks of the cells of runs, read from the tables that they left."""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..case.messages import CaseError, Mistake, suggest
from ..case.time_unit import TimeUnit
from .directory import OutputError, existing_run
from .manifest import read_manifest
from .tables import in_unit, read_table, time_column, unit_of

FITTED = 0.25  # longest lag to which persistence is fitted, over the length of the tracks
EVEN = 0.02  # samples are at equal intervals if no interval is off by more than this share


@dataclass(frozen=True)
class Tracks:
    """Centres of cells, by name, at equal intervals.

    time : (n,) float -- in `unit`;  x : (cells, n, d) float -- [µm], the last axis is the height.
    """

    time: np.ndarray
    x: np.ndarray
    names: tuple[str, ...]
    unit: TimeUnit

    @property
    def interval(self) -> float:
        """Time between two samples, in `unit`."""
        return float(self.time[-1] - self.time[0]) / (len(self.time) - 1)

    @property
    def along(self) -> np.ndarray:
        """Positions along the substrate (cells, n, d - 1) [µm]."""
        return self.x[:, :, :-1]

    def only(self, names: Sequence[str]) -> Tracks:
        """Tracks of the cells whose names are given, or match as those of files do: "Cell-*".

        Raises CaseError where no cell has such a name.
        """
        for name in names:
            if not fnmatch.filter(self.names, name):
                why = f"no cell is called '{name}'{suggest(name, self.names)}"
                raise CaseError([Mistake("--cells", None, "", why)])
        kept = [k for k, own in enumerate(self.names) if any(fnmatch.fnmatchcase(own, name) for name in names)]
        return replace(self, x=self.x[kept], names=tuple(self.names[k] for k in kept))

    def every(self, count: int) -> Tracks:
        """Tracks of every `count`-th sample."""
        return replace(self, time=self.time[::count], x=self.x[:, ::count])


def read_tracks(directory: Path, unit: TimeUnit | None = None) -> Tracks:
    """Tracks of a run, complete or not: of tracks.csv, or of history.csv in runs without it; `unit` : of times.

    Raises OutputError where the directory is no run's, or has fewer than two samples or unequal intervals.
    """
    directory = existing_run(directory)
    path = next((directory / name for name in ("tracks.csv", "history.csv") if (directory / name).exists()), None)
    table: Mapping[str, np.ndarray] = read_table(path) if path else {}
    if not table or not len(table[time_column(table)]):
        raise OutputError(f"'{directory}' has no samples yet")
    table = in_unit(table, unit or unit_of(table))
    own = table["id"] if "id" in table else table["name"] if "name" in table else table["cell"].astype(str)
    there = table["cell"] > 0 if "cell" in table else np.ones(len(own), bool)
    axes = [name for name in ("x_um", "y_um", "z_um") if name in table]
    times = np.unique(table[time_column(table)])
    names = tuple(dict.fromkeys(own[there].tolist()))
    x = np.full((len(names), len(times), len(axes)), np.nan)
    row = np.array([names.index(name) for name in own[there].tolist()])
    x[row, np.searchsorted(times, table[time_column(table)][there])] = np.stack([table[a][there] for a in axes], axis=1)
    steps = np.diff(times)
    if len(steps) > 1 and steps[-1] < (1.0 - EVEN) * steps[0]:  # a run that was stopped between two samples
        times, x, steps = times[:-1], x[:, :-1], steps[:-1]
    if not len(steps):
        raise OutputError(f"'{directory}' has one sample only: tracks need two")
    if np.abs(steps / steps.mean() - 1.0).max() > EVEN:
        raise OutputError(f"'{directory}' has samples at unequal intervals, {steps.min():.4g} to {steps.max():.4g} "
                          f"{unit_of(table).label}: measures of motion need equal ones")
    if not np.isfinite(x).all():
        raise OutputError(f"'{path}' lacks positions of some cells at some samples")
    return Tracks(times, x, names, unit_of(table))


def in_balance(directory: Path) -> bool:
    """Whether forces are in balance at every instant, so that the tractions at samples tell more than their means."""
    time = (read_manifest(directory).get("case") or {}).get("time")
    return isinstance(time, dict) and time.get("integrator") == "overdamped"


def pooled(directories: Sequence[Path]) -> list[Tracks]:
    """Tracks of several runs in the unit of the first, all as long as the shortest.

    Raises OutputError where their intervals or numbers of dimensions differ, or one is given twice.
    """
    if len({path.resolve() for path in directories}) < len(directories):
        raise OutputError("a directory is given twice: its cells would count twice")
    found = [read_tracks(directories[0])]
    found += [read_tracks(path, found[0].unit) for path in directories[1:]]
    first = found[0]
    for path, tracks in zip(directories, found, strict=True):
        if tracks.x.shape[2] != first.x.shape[2]:
            raise OutputError(f"'{path}' has {tracks.x.shape[2]} dimensions and '{directories[0]}' "
                              f"{first.x.shape[2]}: give them one by one")
        if abs(tracks.interval / first.interval - 1.0) > EVEN:
            raise OutputError(f"'{path}' has a sample every {tracks.interval:.4g} {first.unit.label} and "
                              f"'{directories[0]}' every {first.interval:.4g}: give them one by one")
    shortest = min(len(tracks.time) for tracks in found)
    return [replace(tracks, time=tracks.time[:shortest], x=tracks.x[:, :shortest]) for tracks in found]
