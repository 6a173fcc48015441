"""`cellmig tracks`: how the cells of one or several runs moved, by cell and on average."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cellmig.case.messages import CaseError, Mistake
from cellmig.output import motion
from cellmig.output.log import two_columns
from cellmig.output.manifest import plain
from cellmig.output.motion import mean_and_error
from cellmig.output.tables import ALONG, read_table, time_column
from cellmig.output.tracks import FITTED, Tracks, in_balance, pooled
from cellmig.output.tractions import moments, tension
from cellmig.plot.traction import by_place

LAGS = (1, 2, 5)  # times powers of ten, intervals: those in the table
_HEAD = {"way_um": "way µm", "net_um": "net µm", "speed": "speed µm/{unit}", "fmi": "FMI {axis}",
         "directionality": "directionality", "cosine": "cos φ"}  # columns of the table by cell


def measure(directories: Sequence[Path], interval: float | None = None, axis: int = 0,
            only: Sequence[str] = ()) -> dict[str, Any]:
    """Measures of motion along the substrate of the cells of all runs.

    Parameters
    ----------
    directories : list of Path -- of the runs, whose cells are pooled; they have one interval of samples.
    interval : float -- between the positions of which speeds and ways are made [µs]; that of the samples by default.
    axis : int -- of the index, along the substrate.
    only : list of str -- names of cells, such as "Leader-*"; by default all.

    Returns
    -------
    dict -- "runs", "unit" (of times), "interval", "axis"; "cells": "run", "name" and arrays over cells of what they
        did; "mean", "error": the same in the mean over cells and its standard error; "persistence"; "lags": lag, mean
        square displacement with its error, directionality; "together": order, correlations of velocity and tractions,
        in the mean over runs with its error.

    Raises
    ------
    OutputError -- where a directory is no run's, runs differ in interval or dimension, or tracks are too short.
    CaseError -- for an interval, an axis or a name of cells that the runs do not have.
    """
    found = pooled(directories)
    if axis >= found[0].along.shape[2]:
        raise CaseError([Mistake("--axis", None, "", "seen from the side, cells move along x only")])
    count = _count(found[0], interval)
    found = [(tracks.only(only) if only else tracks).every(count) for tracks in found]
    unit, dt, x = found[0].unit, found[0].interval, np.concatenate([tracks.along for tracks in found])
    cells: dict[str, np.ndarray] = {
        "way_um": motion.path(x), "net_um": motion.net(x), "speed": motion.speeds(x, dt).mean(axis=1),
        "fmi": motion.forward_index(x, axis), "directionality": motion.directionality(x),
        "cosine": motion.mean_cosine(x, axis)}
    means = {name: mean_and_error(values) for name, values in cells.items()}
    n = x.shape[1] - 1
    fitted = np.arange(1, max(2, int(FITTED * n)) + 1)[:n]
    lags = [m * 10**power for power in range(len(str(n))) for m in LAGS if m * 10**power <= max(1, n // 2)]
    square, square_error = mean_and_error(motion.msd(x, lags))
    return {"runs": [str(path) for path in directories], "unit": unit, "interval": dt, "samples": n + 1,
            "axis": "xy"[axis],
            "cells": {"run": [str(path) for path, tracks in zip(directories, found, strict=True)
                              for _ in tracks.names],
                      "name": [name for tracks in found for name in tracks.names], **cells},
            "mean": {name: mean for name, (mean, _) in means.items()},
            "error": {name: error for name, (_, error) in means.items()},
            "fitted": float(dt * fitted[-1]),
            "persistence": motion.fit_persistence(dt * fitted, motion.msd(x, fitted), x.shape[2]),
            "lags": {"lag": dt * np.array(lags), "msd_um2": square, "error_um2": square_error,
                     "directionality": mean_and_error(motion.directionality_by_lag(x, lags))[0]},
            "together": _together(found) | _tractions(directories, found[0].along.shape[2])}


def _count(tracks: Tracks, interval: float | None) -> int:
    """Number of intervals of samples in an interval [µs].  Raises CaseError unless it is whole."""
    if interval is None:
        return 1
    ratio, unit = tracks.unit.number(interval) / tracks.interval, tracks.unit.label
    if abs(ratio - round(ratio)) > 0.02 * ratio or round(ratio) < 1:
        why = f"samples are {tracks.interval:.4g} {unit} apart: give a multiple"
    elif round(ratio) >= len(tracks.time):
        why = f"the tracks are {tracks.time[-1] - tracks.time[0]:.4g} {unit} long"
    else:
        return round(ratio)
    raise CaseError([Mistake("--interval", None, "", why)])


def _together(found: Sequence[Tracks]) -> dict[str, tuple[float, float]]:
    """Mean over runs and its error of the order, the correlation time and length of velocities of several cells."""
    values: dict[str, list[float]] = {"order": [], "correlation_time": [], "correlation_um": []}
    for tracks in found:
        x, dt = tracks.along, tracks.interval
        v = np.diff(x, axis=1) / dt
        if len(x) < 2:
            continue
        lags = np.arange(max(1, v.shape[1] // 2))
        values["order"].append(float(mean_and_error(motion.order(v))[0]))
        values["correlation_time"].append(motion.decay_length(dt * lags, motion.correlation_in_time(v, lags)))
        if len(x) > 2:  # of two cells deviations from their mean are opposite
            first = x[:, 0]
            apart = np.linalg.norm(first[:, None] - first, axis=2)
            width = float(np.median(np.where(apart > 0.0, apart, np.inf).min(axis=1)))
            edges = width * (np.arange(1 + int(apart.max() / width) // 2 + 1) + 0.5)
            correlation = motion.correlation_in_space(x[:, :-1], v, edges)
            values["correlation_um"].append(motion.decay_length(0.5 * (edges[1:] + edges[:-1]), correlation))
    return {name: tuple(float(value) for value in mean_and_error(np.array(one))) for name, one in values.items() if one}


def _tractions(directories: Sequence[Path], along: int) -> dict[str, tuple[float, float]]:
    """Mean over runs and its error of means over time: the dipole of tractions, the largest tension of the layer."""
    unit = {1: ("pn", "pn_per_um"), 2: ("pn_um", "pn")}[along]
    values: dict[str, list[float]] = {f"dipole_{unit[0]}": [], f"tension_{unit[1]}": []}
    for directory in directories:
        table = read_table(directory / "substrate.csv") if (directory / "substrate.csv").exists() else {}
        samples = np.unique(table[time_column(table)]) if table else np.array([])
        if len(samples) < 2:
            continue
        now = "_now" * in_balance(directory)
        maps = [by_place(table, samples, f"tangential{axis}{now}_pa") for axis in ALONG[along + 1]]
        width, ends = maps[0][0][0][1] - maps[0][0][0][0], [0.5 * (edges[1:] + edges[:-1]) for edges in maps[0][0]]
        place = np.stack(np.meshgrid(*ends, indexing="ij"), axis=-1).reshape(-1, along)
        pull = np.stack([map_.reshape(len(map_), -1) for _, map_ in maps], axis=-1)
        dipoles = [moments(place, one, width**along, place[one.any(axis=1)].mean(axis=0))[1].trace()
                   for one in pull if one.any()]
        across = maps[0][1] if along == 1 else width * maps[0][1].sum(axis=2)
        for name, value in zip(values, (np.mean(dipoles or [0.0]), tension(across, width).max(axis=1).mean()),
                               strict=True):
            values[name].append(float(value))
    return {name: tuple(float(value) for value in mean_and_error(np.array(one))) for name, one in values.items() if one}


def report(found: dict[str, Any]) -> str:
    """The measures as text."""
    unit, dt = found["unit"].label, found["interval"]
    lines = [two_columns([("runs", ", ".join(found["runs"])), ("positions", (
        f"{found['samples']}, every {dt:.4g} {unit}: ways and speeds are between these, along the substrate"))]), ""]
    head = [text.format(unit=unit, axis=found["axis"]) for text in _HEAD.values()]
    cells, several = found["cells"], len(found["runs"]) > 1
    names = [f"{run}: {name}" if several else name for run, name in zip(cells["run"], cells["name"], strict=True)]
    rows = [[name, *(_number(cells[column][k]) for column in _HEAD)] for k, name in enumerate(names)]
    rows += [[text, *(_number(found[what][column]) for column in _HEAD)]
             for text, what in ((f"mean of {len(names)}", "mean"), ("± s.e.", "error"))]
    lines += [*_table(["cell", *head], rows), "", two_columns(list(_persistence(found))), ""]
    lags = found["lags"]
    lines += _table([f"lag {unit}", "MSD µm²", "± s.e.", "directionality"],
                    [[_number(value) for value in row] for row in zip(*lags.values(), strict=True)])
    return "\n".join(lines)


def _persistence(found: dict[str, Any]) -> list[tuple[str, str]]:
    """Rows of the fit of persistent motion, and of what cells do together."""
    fit, unit = found["persistence"], found["unit"].label
    several = "s" * (fit.components > 1)
    how = f"in {fit.components} component{several}, fitted up to a lag of {found['fitted']:.4g} {unit}"
    if 0.0 < fit.time < np.inf:
        text = (f"τ = {_with_error(fit.time, fit.time_error)} {unit}, v = {_with_error(fit.speed, fit.speed_error)} "
                f"µm/{unit}, D = {_number(fit.diffusivity)} µm²/{unit} {how}")
    else:
        text = {np.inf: f"longer than the tracks tell: straight at v = {_number(fit.speed)} µm/{unit}",
                0.0: "none at this interval: no memory from one position to the next"}.get(
                    fit.time, "unknown: the cells rest, or there are too few positions")
    rows = [("persistence", text)]
    names = {"order": ("order", ""), "correlation_time": ("velocities", f" {unit}: correlation falls to 1/e in time"),
             "correlation_um": ("", " µm: likewise in space"),
             "dipole_pn": ("traction", " pN: dipole ∫ x T dx, below zero where cells contract the substrate"),
             "dipole_pn_um": ("traction", " pN µm: dipole, below zero where cells contract the substrate"),
             "tension_pn_per_um": ("", " pN/µm: largest tension h σ of the layer"),
             "tension_pn": ("", " pN: largest tension of the layer across x")}
    return rows + [(label, _with_error(*found["together"][name]) + more) for name, (label, more) in names.items()
                   if name in found["together"]]


def as_json(found: dict[str, Any]) -> str:
    """The measures as JSON; units are in the names, and what is not known is null."""
    fit, symbol, several = found["persistence"], found["unit"].symbol, ("cells", "mean", "error")
    speed = {what: {f"speed_um_per_{symbol}" if name == "speed" else name: value for name, value in found[what].items()}
             for what in several}
    persistence = {f"time_{symbol}": fit.time, f"time_error_{symbol}": fit.time_error,
                   f"speed_um_per_{symbol}": fit.speed, f"speed_error_um_per_{symbol}": fit.speed_error,
                   f"diffusivity_um2_per_{symbol}": fit.diffusivity, "components": fit.components,
                   f"fitted_up_to_{symbol}": found["fitted"]}
    lags = {f"lag_{symbol}" if name == "lag" else name: value for name, value in found["lags"].items()}
    together = {f"{name}_{symbol}" if name.endswith("time") else name: dict(zip(("mean", "error"), value, strict=True))
                for name, value in found["together"].items()}
    rest = {name: found[name] for name in ("runs", "samples", "axis")}
    return json.dumps(plain({**rest, f"interval_{symbol}": found["interval"], **speed, "persistence": persistence,
                             "lags": lags, "together": together}), indent=2, ensure_ascii=False)


def _number(value: float) -> str:
    return f"{value:.4g}" if np.isfinite(value) else "-"


def _with_error(value: float, error: float) -> str:
    return _number(value) + (f" ± {error:.2g}" if np.isfinite(error) else "")


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table, the first column left, others right."""
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    return ["  ".join(text.ljust(w) if k == 0 else text.rjust(w) for k, (text, w) in enumerate(
        zip(row, widths, strict=True))).rstrip() for row in (head, *rows)]
