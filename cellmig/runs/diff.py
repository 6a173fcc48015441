"""Comparison of two runs: whether they are equal, and their first difference."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from cellmig.output.directory import existing_run
from cellmig.output.tables import read_table, time_column, unit_of
from cellmig.output.xdmf import Frame, frames

_TABLES = ("history.csv", "ledger.csv", "substrate.csv", "neighbours.csv", "tracks.csv", "cues.csv",
           "molecules.csv")


def diff(a: Path, b: Path, tolerance: float = 0.0) -> tuple[bool, list[str]]:
    """Compare the tables and frames of two runs.

    Parameters
    ----------
    a, b : Path -- directories of runs, on any numbers of ranks, complete or not.
    tolerance : float -- allowed difference relative to the largest number of the column or of the field in the frame
        (the energy error is relative already) [-]; 0 for equal bits.

    Returns
    -------
    bool -- whether they are equal.
    list of str -- lines for the user: what was compared, and the first difference of each part.
    """
    a, b = existing_run(a), existing_run(b)
    same, lines = True, []
    for name in [name for name in _TABLES if (a / name).exists() or (b / name).exists()]:
        equal, text = _diff_tables(a / name, b / name, tolerance)
        same, lines = same and equal, [*lines, f"{name}: {text}"]
    equal, text = _diff_frames(frames(a), frames(b), tolerance)
    return same and equal, [*lines, f"frames: {text}"]


def _same(tolerance: float) -> str:
    return f"within {tolerance:g}" if tolerance else "the same, bit for bit"


def _unequal(a: np.ndarray, b: np.ndarray, tolerance: float, scale: float | None = None) -> np.ndarray:
    """Where two arrays of one shape differ, as an array of this shape; nan equals nan."""
    if a.dtype.kind != "f" or b.dtype.kind != "f":
        return a != b
    if tolerance == 0:
        return a.view(np.int64) != b.view(np.int64)
    if scale is None:
        scale = max((np.abs(x[np.isfinite(x)]).max(initial=0.0) for x in (a, b)), default=0.0)
    return ~np.isclose(a, b, rtol=0.0, atol=tolerance * scale, equal_nan=True)


def _numbers(a: Any, b: Any) -> str:
    if isinstance(a, str):
        return f"'{a}' and '{b}'"
    return f"{a} and {b}, apart by {abs(a - b):.3g}"


def _diff_tables(a: Path, b: Path, tolerance: float) -> tuple[bool, str]:
    one, two = (read_table(path) if path.exists() else {} for path in (a, b))
    if (units := (unit_of(one), unit_of(two)))[0] != units[1] and one and two:
        return False, f"times in {units[0].symbol} against times in {units[1].symbol}"
    if one.keys() != two.keys():
        return False, f"columns {sorted(one.keys() ^ two.keys())} are in one of them only"
    lengths = [len(next(iter(table.values()), ())) for table in (one, two)]
    rows, time = min(lengths), time_column(one)
    worst = (rows, "")
    for name in one:
        scale = 1.0 if name == "energy_error" else None
        where = np.flatnonzero(_unequal(one[name][:rows], two[name][:rows], tolerance, scale))
        if len(where) and where[0] < worst[0]:
            worst = (where[0], name)
    row, name = worst
    if name:
        cell = f" of cell {one['cell'][row]}" if "cell" in one else ""
        return False, (f"first differ at {one[time][row]:g} {unit_of(one).symbol}, {name}{cell}: "
                       + _numbers(one[name][row].item(), two[name][row].item()))
    if lengths[0] != lengths[1]:
        return False, f"{_same(tolerance)} in the {rows} rows that both have; {lengths[0]} and {lengths[1]} rows"
    return True, f"{rows} rows, {_same(tolerance)}"


def _diff_frames(one: list[Frame], two: list[Frame], tolerance: float) -> tuple[bool, str]:
    for a, b in zip(one, two, strict=False):
        if a.unit != b.unit:
            return False, f"times in {a.unit.symbol} against times in {b.unit.symbol}"
        if a.time != b.time and abs(a.time - b.time) > tolerance * max(a.time, b.time):
            return False, f"a frame at {a.time} {a.unit.symbol} against one at {b.time} {b.unit.symbol}"
        if text := next(_differences(a.read(), b.read(), tolerance), None):
            return False, f"first differ at {a.time:g} {a.unit.symbol}, {text}"
    both = min(len(one), len(two))
    if len(one) != len(two):
        return False, f"{_same(tolerance)} in the {both} frames that both have; {len(one)} and {len(two)} frames"
    return True, f"{both} frames, {_same(tolerance)}"


def _differences(a: dict[str, np.ndarray], b: dict[str, np.ndarray], tolerance: float) -> Iterator[str]:
    """Differences of two frames, fields of the state first."""
    if not np.array_equal(a["id"], b["id"]):
        yield f"which are not of the same particles ({len(a['id'])} and {len(b['id'])})"
        return
    if lone := sorted(a.keys() ^ b.keys()):
        yield f"fields {lone} are in one of them only"
    state = [name for name in ("cell", "material", "X", "u", "v") if name in a]
    for name in state + sorted(a.keys() & b.keys() - {"id", *state}):
        where = np.argwhere(_unequal(a[name], b[name], tolerance))
        if len(where):
            particle, *component = first = tuple(where[0])
            part = f"[{component[0]}]" if component else ""
            count = len(np.unique(where[:, 0]))
            numbers = _numbers(a[name][first].item(), b[name][first].item())
            yield (f"{name}{part} of particle {a['id'][particle]}: {numbers}; "
                   f"{count} of {len(a['id'])} particles differ in {name}, at most by {_largest(a[name], b[name]):.3g}")


def _largest(a: np.ndarray, b: np.ndarray) -> float:
    with np.errstate(invalid="ignore"):
        gap = np.abs(a - b)
    return float(np.where(np.isnan(gap), np.inf, gap).max())
