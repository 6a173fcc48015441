"""The tables of a run as data for the charts of a page."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cellmig.case.time_unit import TimeUnit
from cellmig.output.tables import MEASURES, in_unit, names_of, read_table, time_column, unit_of
from cellmig.plot.traction import by_place, usual_peak

from .encode import packed, rounded

Table = Mapping[str, np.ndarray]
SAMPLES = 600  # of each table that a page has at most
LINES = 40  # in one chart
_KEYS = ("cell", "neighbour", "name", "neighbour_name", "id", "field")
_UNITS = (("_um_per_", "µm/{}"), ("_pn_per_um", "pN/µm"), ("_per_um", "1/µm"), ("_pn_um", "pN µm"), ("_pn", "pN"),
          ("_pa", "Pa"), ("_um3", "µm³"), ("_um2", "µm²"), ("_um", "µm"))


@dataclass(frozen=True)
class Kind:
    """How a table is shown: its title, the columns that tell its lines apart, those shown first."""

    title: str
    lines: tuple[str, ...]
    first: tuple[str, ...]


KINDS = {
    "history": Kind("Cells", ("name",), ("ux_um", *MEASURES[2][:2], *MEASURES[3][:2], "effective_stress_pa", "area_um2",
                                         "height_um", "volume_um3")),
    "neighbours": Kind("Forces between cells", ("name", "neighbour_name"),
                       ("pull_pn_per_um", "pull_pn", "cell_contact_um", "cell_contact_um2")),
    "cues": Kind("Polarity and cues", ("name",), ("polarity", "polarity_x", "push_pn_per_um", "push_x_pn")),
    "molecules": Kind("Molecules", ("field", "name"), ("inside", "inside_per_um")),
}


def charts(directory: Path) -> list[dict[str, Any]]:
    """All tables of a run that have rows, as charts of columns against time, with a line for each cell or pair."""
    made = [_chart(name, kind, read(directory, name)) for name, kind in KINDS.items()]
    return [chart for chart in made if chart]


def read(directory: Path, name: str) -> Table:
    """A table of a run, {} where it has no rows."""
    path = directory / f"{name}.csv"
    table = read_table(path) if path.exists() else {}
    return table if table and len(table[time_column(table)]) else {}


def _chart(name: str, kind: Kind, table: Table) -> dict[str, Any] | None:
    if not table:
        return None
    time = time_column(table)
    keys = [key for key in kind.lines if key in table]
    if name == "history" and len(np.unique(table["cell"])) == 2:  # the aggregate is that of one cell
        table = {column: values[table["cell"] > 0] for column, values in table.items()}
    whose = [" – ".join(words) for words in zip(*(table[key].tolist() for key in keys), strict=True)] if keys else (
        [names_of(table)[cell] for cell in table["cell"].tolist()])
    lines = list(dict.fromkeys(whose))[:LINES]
    samples = np.unique(table[time])
    some = samples[thinned(len(samples), SAMPLES)]
    columns = [column for column in table if column != time and column not in _KEYS and _told(table[column])]
    if not columns:
        return None
    place = {line: k for k, line in enumerate(lines)}
    which = np.array([place.get(word, -1) for word in whose])
    rows = np.flatnonzero((which >= 0) & np.isin(table[time], some))
    values = np.full((len(columns), len(lines), len(some)), np.nan)
    values[:, which[rows], np.searchsorted(some, table[time][rows])] = [table[column][rows] for column in columns]
    first = [column for column in kind.first if column in columns] or columns[:1]
    more = len(set(whose)) - len(lines)
    return {"name": name, "title": kind.title, "unit": unit_of(table).label, "lines": lines, "first": first[:4],
            "left_out": f"{more} more are in {name}.csv" if more else "",
            "columns": {column: label(column) for column in columns}, "time": packed(some), "values": packed(values)}


def compared(runs: Mapping[str, Path]) -> dict[str, Any] | None:
    """The mean or sum over cells of history.csv of several runs, with a line for each of the first LINES runs."""
    found = {name: read(directory, "history") for name, directory in list(runs.items())[:LINES]}
    found = {name: table for name, table in found.items() if table}
    if not found:
        return None
    first = next(iter(found.values()))
    unit, time = unit_of(first), time_column(first)
    means = {name: {column: values[table["cell"] == 0] for column, values in in_unit(table, unit).items()}
             for name, table in found.items()}
    samples = np.unique(np.concatenate([table[time] for table in means.values()]))
    some = samples[thinned(len(samples), SAMPLES)]
    columns = [column for column in first if column not in (time, *_KEYS)
               and any(_told(table[column]) for table in means.values() if column in table)]
    if not columns:
        return None
    values = [[np.interp(some, table[time], table[column], left=np.nan, right=np.nan) if column in table
               else np.full(len(some), np.nan) for table in means.values()] for column in columns]
    return {"name": "history", "title": "Runs", "unit": unit.label, "lines": list(means),
            "first": [column for column in KINDS["history"].first if column in columns][:4] or columns[:1],
            "left_out": f"{len(runs) - LINES} more runs are not drawn" if len(runs) > LINES else "",
            "columns": {column: label(column) for column in columns}, "time": packed(some),
            "values": packed(np.array(values))}


def _told(values: np.ndarray) -> bool:
    """Whether a column tells anything."""
    return values.dtype.kind in "fi" and bool(np.nan_to_num(values.astype(float)).any())


def thinned(count: int, most: int) -> np.ndarray:
    """Numbers of at most `most` of `count` things, evenly, with the first and the last."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def label(column: str) -> str:
    """Name of a column of a table for people, with its unit: "pull [pN/µm]"."""
    if unit := TimeUnit.of_column(column):
        return f"time [{unit.label}]"
    for end, unit in _UNITS:
        what, mark, rest = column.rpartition(end)
        if mark and (not rest or (end == "_um_per_" and rest)):
            return f"{_words(what)} [{unit.format(rest.replace('us', 'µs'))}]"
    return _words(column)


def _words(name: str) -> str:
    return re.sub(r"^([uv])([xyz])\b", r"\1_\2", name.replace("_", " ")).replace("u_", "displacement ").replace(
        "v_", "velocity ").replace("sigma11", "σ₁₁")


def ledger(directory: Path) -> dict[str, Any] | None:
    """The energies of a run against time, and their error; None without rows."""
    table = read(directory, "ledger")
    if not table:
        return None
    time = time_column(table)
    some = thinned(len(table[time]), SAMPLES)
    entries = [name for name in table if name not in (time, "energy_error") and _told(table[name])]
    return {"unit": unit_of(table).label, "energy": "pN" if "kinetic_pn" in table else "pN µm",
            "lines": [_words(re.sub("_pn(_um)?$", "", name)) for name in entries],
            "time": packed(table[time][some]), "values": packed(np.array([table[name][some] for name in entries])),
            "error": packed(100.0 * table["energy_error"][some])}


def traction(directory: Path, times: Sequence[float]) -> dict[str, Any] | None:
    """Mean traction on the substrate over places in two dimensions, in the intervals that end at `times`."""
    table = read(directory, "substrate")
    if not table or "y_um" in table or len(times) == 0:
        return None
    samples = np.unique(read(directory, "history").get(time_column(table), table[time_column(table)]))
    kinds = [name for name in ("normal_pa", "tangential_pa", "friction_pa") if _told(table[name])]
    if len(samples) < 2 or not kinds:
        return None
    (edges,), _ = by_place(table, samples, kinds[0])
    maps = np.array([by_place(table, samples, kind)[1] for kind in kinds])
    rows = np.clip(np.searchsorted(samples, times), 1, len(samples) - 1) - 1
    return {"x": packed(0.5 * (edges[1:] + edges[:-1])), "lines": [name.removesuffix("_pa") for name in kinds],
            "values": packed(np.moveaxis(maps[:, rows], 0, 1)), "usual": 2.0 * max(map(usual_peak, maps)),
            "since": packed(samples[rows]), "until": packed(samples[rows + 1])}


def ground(directory: Path, times: Sequence[float]) -> dict[str, Any] | None:
    """The same of the normal traction over squares of the substrate in three dimensions."""
    table = read(directory, "substrate")
    samples = np.unique(read(directory, "history").get(time_column(table), [])) if "y_um" in table else np.array([])
    if len(samples) < 2 or not _told(table["normal_pa"]):
        return None
    edges, map_ = by_place(table, samples, "normal_pa")
    rows, top = np.clip(np.searchsorted(samples, times), 1, len(samples) - 1) - 1, usual_peak(map_)
    return {"label": f"normal traction to ±{top:.2g} Pa, seen from below: orange pulls up, violet presses",
            "low": [float(one[0]) for one in edges], "width": float(edges[0][1] - edges[0][0]),
            "counts": list(map_.shape[1:]), "usual": top, "values": rounded(map_[rows].reshape(len(rows), -1), 8)}


def budget(directory: Path) -> list[tuple[str, float, float]]:
    """Entries of the energy budget at the last sample: name, energy, share of the largest [-]."""
    table = read(directory, "ledger")
    if not table:
        return []
    last = {name: float(column[-1]) for name, column in table.items() if name != time_column(table)}
    entries = {name: value for name, value in last.items() if name != "energy_error" and np.isfinite(value) and value}
    most = max(map(abs, entries.values()), default=1.0)
    return [(_words(re.sub("_pn(_um)?$", "", name)), value, abs(value) / most) for name, value in entries.items()]


def tracks(directory: Path) -> dict[str, Any] | None:
    """Centres of the cells at all samples, by history.csv."""
    table = read(directory, "history")
    if not table:
        return None
    time, axes = time_column(table), [f"{axis}_um" for axis in "xyz" if f"{axis}_um" in table]
    cells = [cell for cell in np.unique(table["cell"]).tolist() if cell]
    samples = np.unique(table[time])
    some = samples[thinned(len(samples), SAMPLES)]
    values = np.full((len(cells), len(some), len(axes)), np.nan)
    for k, cell in enumerate(cells):
        rows = (table["cell"] == cell) & np.isin(table[time], some)
        values[k, np.searchsorted(some, table[time][rows])] = np.stack([table[axis][rows] for axis in axes], axis=-1)
    return {"time": packed(some), "x": packed(values)}
