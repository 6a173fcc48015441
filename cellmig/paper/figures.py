"""Counterparts of the paper's figures 2 to 6, and a figure of its study of the protrusion."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cellmig.plot.snapshots import shapes
from cellmig.plot.style import COLOURS, STYLE, save_all

from .claims import ADHESION, CASES, PROTRUSION, Results, about, study, times

_SIZE = (4.2, 3.0)  # inches


def draw(results: Results, out: Path) -> list[Path]:
    """Draw all figures whose runs exist, as PNG and PDF.

    Parameters
    ----------
    results : dict -- outcomes by configuration and seed.
    out : Path -- directory of the figures.

    Returns
    -------
    list of Path -- the files.
    """
    with matplotlib.rc_context(STYLE):
        dimension, end = about(results)
        figures = {"fig2": _snapshots(results, "all_protrude", times(end)), "fig4": _who(results),
                   "fig6": _strengths(results, "adhesion", ADHESION, "cell-cell adhesion"),
                   "protrusion": _strengths(results, "protrusion", PROTRUSION, "protrusion")}
        if dimension == 2:  # figures of claims that are not judged in space
            figures |= {"fig3": _stress(results), "fig5": _snapshots(results, "one_three", (24.0, 292.0, 388.0))}
        return save_all(figures, out)


def _snapshots(results: Results, name: str, times: Sequence[float]) -> Figure | None:
    """Shapes and effective stress of the first seed."""
    runs = results.get(name)
    return shapes(runs[min(runs)].directory, times) if runs else None


def _stress(results: Results) -> Figure | None:
    """Stress at the lower centre of Cell-2 against time: the first seed, and the others in grey."""
    runs = results.get("all_protrude")
    if not runs:
        return None
    figure, ax = _axes()
    first, *others = sorted(runs)
    for number, seed in enumerate(others):
        ax.plot(*runs[seed].series("sigma11_lower_centre_pa", 2), color="0.8", linewidth=0.6,
                label="" if number else "other seeds")
    time, stress = runs[first].series("sigma11_lower_centre_pa", 2)
    ax.plot(time, stress, color=COLOURS[0], label=f"seed {first}")
    ax.axhline(0.0, color="0.4", linewidth=0.6, zorder=0)
    ax.set(xlabel="time [µs]", ylabel=r"$\sigma_{11}$ at the lower centre of Cell-2 [Pa]", xlim=(0.0, time[-1]))
    ax.legend()
    return figure


def _who(results: Results) -> Figure | None:
    """Mean displacement of the aggregate against time, for each set of protruding cells."""
    present = [name for name in CASES if results.get(name)]
    if len(present) < 2:
        return None
    figure, ax = _axes()
    for name in reversed(present):
        _band(ax, *_displacements(results, name), COLOURS[list(CASES).index(name)], CASES[name])
    ax.set(xlabel="time [µs]", ylabel="mean displacement [µm]")
    ax.legend(title="protruding cells", loc="upper left")
    return figure


def _strengths(results: Results, what: str, factors: Sequence[float], label: str) -> Figure | None:
    """Mean displacement for each strength, and its difference from that of the paper's strength in each seed."""
    names = {factor: study(what, factor) for factor in factors if results.get(study(what, factor))}
    if len(names) < 2 or 1.0 not in names:
        return None
    figure = Figure(figsize=(_SIZE[0], 1.6 * _SIZE[1]), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    hues = matplotlib.colormaps["viridis"](np.linspace(0.85, 0.0, len(factors)))
    for factor, hue in zip(factors, hues, strict=True):
        if factor in names:
            time, displacement = _displacements(results, names[factor])
            _band(upper, time, displacement, hue, f"× {factor:g}")
            base = _displacements(results, names[1.0])[1]
            common = sorted(displacement.keys() & base.keys())
            _band(lower, time, {seed: displacement[seed] - base[seed] for seed in common}, hue, "")
    upper.set_ylabel("mean displacement [µm]")
    lower.set(xlabel="time [µs]", ylabel="difference from × 1,\nseed by seed [µm]", xlim=(0.0, time[-1]))
    upper.legend(title=label, loc="upper left")
    return figure


def _axes() -> tuple[Figure, Axes]:
    figure = Figure(figsize=_SIZE, layout="constrained")
    return figure, figure.subplots()


def _displacements(results: Results, name: str) -> tuple[np.ndarray, dict[int, np.ndarray]]:
    """Times [us] and mean displacement of the aggregate [um] by seed."""
    series = {seed: outcome.series("ux_um") for seed, outcome in results[name].items()}
    return next(iter(series.values()))[0], {seed: values for seed, (_, values) in series.items()}


def _band(ax: Axes, time: np.ndarray, by_seed: dict[int, np.ndarray], colour: object, label: str) -> None:
    """Draw the mean over the seeds and a band of one standard deviation about it."""
    if not by_seed:
        return
    values = np.array(list(by_seed.values()))
    mean = values.mean(axis=0)
    ax.plot(time, mean, color=colour, label=label)
    if len(values) > 1:
        spread = values.std(axis=0, ddof=1)
        ax.fill_between(time, mean - spread, mean + spread, color=colour, alpha=0.2, linewidth=0.0)
    ax.set_xlim(0.0, time[-1])
