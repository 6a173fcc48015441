"""Figures of the study on guidance: what was measured beside what follows from the laws."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cellmig.output.motion import mean_and_error
from cellmig.plot.style import COLOURS, STYLE, save_all

from .claims import Results, expected, foreseen
from .experiments import DOSE_STEP, DOSES, PLACES, ROWS, STEPS

_SIZE = (4.2, 3.0)  # inches


def draw(results: Results, out: Path) -> list[Path]:
    """Draw all figures whose runs exist, as PNG and PDF.

    Parameters
    ----------
    results : dict -- walks by configuration and seed.
    out : Path -- directory of the figures.

    Returns
    -------
    list of Path -- the files.
    """
    with matplotlib.rc_context(STYLE):
        figures = {"g1_rows": _rows(results), "g2_gel": _gel(results), "g3_doses": _doses(results),
                   "g4_clutches": _clutches(results)}
        return save_all(figures, out)


def _axes(columns: int = 1) -> tuple[Figure, Any]:
    figure = Figure(figsize=(_SIZE[0] * columns, _SIZE[1]), layout="constrained")
    return figure, figure.subplots(1, columns)


def _points(ax: Axes, at: Sequence[float], results: Results, names: Sequence[str], number: Any, **how: Any) -> None:
    """Values of all seeds as dots, mean and standard error, of the configurations that exist."""
    there = [(x, np.array([number(walk) for walk in results[name].values()]))
             for x, name in zip(at, names, strict=True) if results.get(name)]
    for x, values in there:
        ax.plot(np.full(len(values), x), values, ".", color="0.75", markersize=4, zorder=1)
    means = np.nan_to_num([mean_and_error(values) for _, values in there]).reshape(-1, 2)
    ax.errorbar([x for x, _ in there], means[:, 0], means[:, 1], fmt="o", markersize=4, capsize=2, zorder=2, **how)


def _rows(results: Results) -> Figure | None:
    """Drift of rows against (N - 1)/N."""
    names = [f"row {count}" for count in ROWS]
    if not results.get(names[-1]):
        return None
    figure, ax = _axes()
    fastest = float(np.mean([walk.drift for walk in results[names[-1]].values()])) / expected(ROWS[-1])
    counts = np.arange(1, ROWS[-1] + 1)
    ax.plot(counts, [fastest * expected(n) for n in counts], color=COLOURS[1], zorder=0,
            label="contact cue of a row, through the longest")
    _points(ax, ROWS, results, names, lambda walk: walk.drift, color=COLOURS[0], label="mean of seeds ± s.e.")
    ax.axhline(0.0, color="0.4", linewidth=0.6, zorder=0)
    ax.set(xlabel="cells in the row", ylabel="drift up the gradient [µm/h]")
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 0.1))  # above the line of zero
    return figure


def _gel(results: Results) -> Figure | None:
    """Drift on gels, and tension of the layer over its width."""
    kinds = {"gel 1": "one cell", "gel graded": "row", "gel uniform": "row, uniform", "gel cut": "row, cut"}
    if not results.get("gel graded"):
        return None
    figure, (left, right) = _axes(2)
    _points(left, range(len(kinds)), results, list(kinds), lambda walk: walk.drift, color=COLOURS[0])
    left.axhline(0.0, color="0.4", linewidth=0.6, zorder=0)
    left.set_xticks(range(len(kinds)), list(kinds.values()))
    left.set_ylabel("drift to the stiffer side [µm/h]")
    for number, (name, label) in enumerate(list(kinds.items())[1:]):
        if runs := results.get(name):
            shares = next(iter(runs.values())).tension[0]
            mean, error = np.nan_to_num([mean_and_error(np.array(one)) for one in
                                         np.transpose([walk.tension[1] for walk in runs.values()])]).T
            right.errorbar(shares, mean, error, color=COLOURS[number], capsize=2, label=label)
    right.set(xlabel="place from the softer to the stiffer end", ylabel="tension of the layer [pN/µm]")
    right.legend()
    return figure


def _doses(results: Results) -> Figure | None:
    """Mean cosine of steps against steepness and against dose."""
    steep = [f"steep {percent:g}" for percent in STEPS]
    if not results.get(steep[0]):
        return None
    figure, (left, right) = _axes(2)
    fine = np.linspace(0.0, max(STEPS), 100)
    left.plot(fine, [foreseen(percent, 1.0) for percent in fine], color=COLOURS[1], label="Gaussian polarity")
    _points(left, STEPS, results, steep, lambda walk: walk.cosine, color=COLOURS[0], label="mean of seeds ± s.e.")
    left.set(xlabel="difference across a cell [%], at c = K", ylabel="mean cosine of steps")
    left.legend()
    wide = np.geomspace(min(DOSES) / 2.0, 2.0 * max(DOSES), 100)
    right.semilogx(wide, [foreseen(DOSE_STEP, dose) for dose in wide], color=COLOURS[1])
    _points(right, DOSES, results, [f"steep {DOSE_STEP:g}" if dose == 1.0 else f"dose {dose:g}" for dose in DOSES],
            lambda walk: walk.cosine, color=COLOURS[0])
    right.set(xlabel=f"level over the affinity, at {DOSE_STEP:g} %", ylabel="mean cosine of steps")
    return figure


def _clutches(results: Results) -> Figure | None:
    """Ways of cells with clutches."""
    kinds = {**{f"clutches {place}": f"begins {place}" for place in PLACES}, "clutches uniform": "uniform substrate"}
    if not any(results.get(name) for name in kinds):
        return None
    figure, ax = _axes()
    for number, (name, label) in enumerate(kinds.items()):
        for k, walk in enumerate(results.get(name, {}).values()):
            ax.plot(walk.time, walk.x[0] - walk.x[0, 0], color=COLOURS[number], linewidth=0.8,
                    label="" if k else label)
    ax.axhline(0.0, color="0.4", linewidth=0.6, zorder=0)
    ax.set(xlabel="time [h]", ylabel="way to the stiffer side [µm]")
    ax.legend()
    return figure
