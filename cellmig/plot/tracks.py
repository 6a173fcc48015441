"""Pictures of how cells moved: their tracks, mean square displacement, polarity and cues."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from cellmig.output.motion import fit_persistence, mean_and_error, msd, persistent
from cellmig.output.tables import CUES, cue_columns, time_column, unit_of
from cellmig.output.tracks import FITTED, Tracks

from .style import COLOURS, legend_above

NAMED = 12  # most cells whose lines are named
_SECTORS = 24  # of the rose


def tracks(found: Tracks) -> Figure:
    """Place against time from the side; in space the tracks from a common origin, and a rose of directions of steps."""
    if found.along.shape[2] == 1:
        figure = Figure(figsize=(6.0, 3.6), layout="constrained")
        ax = figure.subplots()
        for number, x in enumerate(found.along[:, :, 0]):
            ax.plot(found.time, x, **_line(number, found.names))
        ax.set(xlabel=f"time [{found.unit.label}]", ylabel="x of the centre [µm]")
        _name(ax, len(found.names))
        return figure
    figure = Figure(figsize=(7.2, 3.8), layout="constrained")
    ax, rose = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2, projection="polar")
    ways = found.along - found.along[:, :1]
    reach = 1.08 * np.abs(ways).max() or 1.0
    for number, way in enumerate(ways):
        ax.plot(*way.T, **_line(number, found.names) | {"linewidth": 0.9})
        ax.plot(*way[-1], "o", markersize=3, color=COLOURS[number % len(COLOURS)])
    ax.axhline(0.0, color="0.4", linewidth=0.6, zorder=0)
    ax.axvline(0.0, color="0.4", linewidth=0.6, zorder=0)
    ax.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel="x from the start [µm]",
           ylabel="y from the start [µm]")
    _name(ax, len(found.names), 3)
    steps = np.diff(found.along, axis=1).reshape(-1, 2)
    steps = steps[(steps != 0.0).any(axis=1)]
    # Sectors are centred on the axes, so that a cell that goes along x fills one.
    share = np.bincount(np.rint(np.arctan2(steps[:, 1], steps[:, 0]) * _SECTORS / (2.0 * np.pi)).astype(int) % _SECTORS,
                        minlength=_SECTORS) / max(1, len(steps))
    rose.bar(2.0 * np.pi / _SECTORS * np.arange(_SECTORS), 100.0 * share, 2.0 * np.pi / _SECTORS, color=COLOURS[0],
             alpha=0.7, edgecolor="white", linewidth=0.4)
    rose.set_axisbelow(True)
    rose.set_title("directions of steps [%]", fontsize=8)
    rose.set_rlabel_position(112.5)
    rose.yaxis.set_major_locator(MaxNLocator(4))
    return figure


def squares(found: Tracks) -> Figure | None:
    """Mean square displacement against lag, of each cell and on average, with the fit of persistent motion."""
    n = len(found.time) - 1
    if n < 4 or not np.ptp(found.along, axis=1).any():
        return None
    lags = np.unique(np.geomspace(1, n // 2, 40).astype(int))
    fitted, dt, x = np.arange(1, max(2, int(FITTED * n)) + 1), found.interval, found.along
    of_cells = msd(x, lags)
    mean, error = mean_and_error(of_cells)
    fit = fit_persistence(dt * fitted, msd(x, fitted), x.shape[2])
    figure = Figure(figsize=(4.6, 3.6), layout="constrained")
    ax, unit, t = figure.subplots(), found.unit.label, dt * lags
    for one in of_cells if len(x) > 1 else ():
        ax.loglog(t, np.where(one > 0.0, one, np.nan), color="0.75", linewidth=0.5, zorder=1)
    ax.loglog(t, mean, color=COLOURS[0], label=f"mean of {len(x)}" if len(x) > 1 else found.names[0])
    if np.isfinite(error).all():
        ax.fill_between(t, np.maximum(mean - error, 1e-3 * mean), mean + error, color=COLOURS[0], alpha=0.25,
                        linewidth=0.0)
    if 0.0 < fit.time < np.inf:
        ax.loglog(dt * fitted, persistent(dt * fitted, fit.speed, fit.time), color=COLOURS[1], ls="--",
                  label=f"fit: v = {fit.speed:.3g} µm/{unit}, τ = {fit.time:.3g} {unit}")
    ax.loglog(t, mean[0] * (t / t[0]) ** 2, color="0.4", ls=":", linewidth=0.8, label="∝ t²")
    for axis, ends in ((ax.xaxis, ax.get_xlim()), (ax.yaxis, ax.get_ylim())):
        some = "25" if ends[1] < 100.0 * ends[0] else ""  # first digits of what is named between powers of ten
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(lambda x, _, some=some: f"{x:g}" if f"{x:e}"[0] in some else "")
    ax.set(xlabel=f"lag [{unit}]", ylabel="mean square displacement [µm²]")
    legend_above(ax, 3)
    return figure


def cues(table: Mapping[str, np.ndarray]) -> Figure | None:
    """Polarity, and the part of each cue, against time by cell; None without a table or of more than seven.

    `table` : cues.csv.  In space the component along x is a full line, that along y a dashed one.
    """
    cells = np.unique(table["cell"]) if table else np.array([])
    if not 0 < len(cells) <= len(COLOURS):
        return None
    d = 3 if "polarity_y" in table else 2
    known = {time_column(table), *CUES[d]}
    names = dict.fromkeys(name[:-2] if d == 3 else name for name in table if name not in known)
    panels = {"polarity": cue_columns(["polarity"], d), **{name: cue_columns([name], d) for name in names}}
    figure = Figure(figsize=(6.0, 0.6 + 1.5 * len(panels)), layout="constrained")
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False).ravel()
    for ax, (name, columns) in zip(axes, panels.items(), strict=True):
        for number, cell in enumerate(cells):
            rows = table["cell"] == cell
            for column, style in zip(columns, ("-", "--"), strict=False):
                ax.plot(table[time_column(table)][rows], table[column][rows], ls=style,
                        color=COLOURS[number % len(COLOURS)], label=table["name"][rows][0] if style == "-" else None)
        ax.axhline(0.0, color="0.4", linewidth=0.6, zorder=0)
        ax.set_ylabel(name.replace("_", " "))
    for axis, style in zip("xy", ("-", "--"), strict=True) if d == 3 else ():
        axes[0].plot([], [], color="0.4", ls=style, label=f"along {axis}")
    legend_above(axes[0])
    axes[-1].set_xlabel(f"time [{unit_of(table).label}]")
    return figure


def _line(number: int, names: tuple[str, ...]) -> dict[str, object]:
    """Style and name of the line of a cell."""
    return {"color": COLOURS[number % len(COLOURS)], "label": names[number],
            "ls": ("-", "--", ":")[number // len(COLOURS) % 3]}


def _name(ax: Axes, count: int, columns: int = 6) -> None:
    if count <= NAMED:
        legend_above(ax, columns)
