"""Pictures of traction on the substrate by place and time, and of forces between pairs of cells, from the tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from cellmig.output.tables import ALONG, FORCE, time_column, unit_of

from .style import COLOURS, FAR, legend_above

Table = Mapping[str, np.ndarray]
_SHARE = 95.0  # percentile that sets colours and axes: peaks of a membrane that jumps to contact are far larger
_BEYOND = 3.0  # axes end at this multiple of it, with a note
_LEAST_ARROW, _LONGEST_ARROW = 0.05, 2.0  # of arrows that are drawn, over the largest; length of that [places]
_LEAST_HEIGHT = 2.6  # of a picture, for the label of its colours [inches]
_KEY, _LINE = 0.12, 0.2  # height of the key of arrows above a map, and of a line of text [inches]
_ABOVE_NOTE = 1.12  # height of the legend over that of the axes: a note may stand between
_SIDES = {"normal": "pressed ←  [Pa]  → pulled up", "tangential": "to the left ←  [Pa]  → to the right"}


def traction(table: Table, samples: np.ndarray, times: Sequence[float]) -> Figure | None:
    """Map of the mean traction between samples over place and time, and profiles; None without traction.

    In space, maps of the plane at some times.  `table` : substrate.csv;  `samples` : times of all samples;  `times` :
    of the profiles or maps, both in the unit of the table.
    """
    if "y_um" in table:
        return _on_plane(table, samples, times)
    kinds = [kind for kind in _SIDES if table and np.nan_to_num(table[f"{kind}_pa"]).any()]
    if not kinds or len(samples) < 2:
        return None
    figure = Figure(figsize=(0.6 + 5.4 * len(kinds), 4.8), layout="constrained")
    for axes, kind in zip(figure.subplots(2, len(kinds), sharex=True, height_ratios=(2, 3), squeeze=False).T, kinds,
                          strict=True):
        (edges,), map_ = by_place(table, samples, f"{kind}_pa")
        upper, lower = axes
        for number, time in enumerate(times):
            row = _before(samples, time)
            upper.stairs(np.where(map_[row] != 0.0, map_[row], np.nan), edges, color=COLOURS[number % len(COLOURS)],
                         baseline=None, label=_between(samples, row, table))
        upper.axhline(0.0, color="0.4", linewidth=0.6, zorder=0)
        upper.set_ylabel(f"{kind} traction [Pa]")
        if kind == kinds[0]:
            legend_above(upper, 3, _ABOVE_NOTE)
        top = usual_peak(map_)
        limit_axis(upper, top, "Pa")
        image = lower.pcolormesh(edges, samples, map_, cmap="PuOr_r", norm=Normalize(-top, top), rasterized=True)
        lower.set(xlabel="x [µm]", ylabel=f"time [{unit_of(table).label}]")
        figure.colorbar(image, ax=lower, extend="both", pad=0.02, label=_SIDES[kind] + _colours_end(top, map_))
    return figure


def _colours_end(top: float, values: np.ndarray) -> str:
    """End of the label of a colour bar that ends at `top` [Pa], if values are far beyond."""
    most = np.abs(values).max()
    return f"\ncolours end at {top:.3g} Pa, the largest is {most:.3g} Pa" if most > _BEYOND * top else ""


def _between(samples: np.ndarray, row: int, table: Table) -> str:
    """The interval from a sample to the next, as text."""
    return f"{samples[row]:.4g} to {samples[row + 1]:.4g} {unit_of(table).label}"


def _before(samples: np.ndarray, time: float) -> int:
    """Number of the interval between two samples that ends at a time, or soonest after it."""
    return int(np.clip(np.searchsorted(samples, time), 1, len(samples) - 1)) - 1


def _on_plane(table: Table, samples: np.ndarray, times: Sequence[float]) -> Figure | None:
    """Maps of the plane of the substrate: normal traction as colour, tangential traction as arrows."""
    if len(samples) < 2 or not np.nan_to_num(table["normal_pa"]).any():
        return None
    (x, y), normal = by_place(table, samples, "normal_pa")
    along = np.stack([by_place(table, samples, f"tangential{axis}_pa")[1] for axis in ALONG[3]])
    rows = sorted({_before(samples, time) for time in times or samples[-1:]})
    top, most = usual_peak(normal[rows]), np.linalg.norm(along[:, rows], axis=0).max()
    windows = _windows((x, y), normal[rows])
    width, (wide, high) = x[1] - x[0], np.ptp(windows[0], axis=1)
    follows = bool(np.any(windows != windows[0]))
    stacked = len(rows) == 1 or wide > 1.3 * high
    tall = (5.0 if stacked else 2.6) * high / wide
    size = (6.4, 0.6 + len(rows) * (0.25 + tall)) if stacked else (1.2 + 2.6 * len(rows), 1.0 + tall)
    figure = Figure(figsize=(size[0], max(_LEAST_HEIGHT, size[1])), layout="constrained")
    axes = figure.subplots(len(rows) if stacked else 1, 1 if stacked else len(rows), sharex=not follows,
                           sharey=not follows, squeeze=False)
    for ax, row, window in zip(axes.flat, rows, windows, strict=True):
        image = ax.pcolormesh(x, y, normal[row].T, cmap="PuOr_r", norm=Normalize(-top, top), rasterized=True)
        if most > 0.0:
            at = np.nonzero(np.linalg.norm(along[:, row], axis=0) > _LEAST_ARROW * most)
            arrows = ax.quiver((x[:-1] + 0.5 * width)[at[0]], (y[:-1] + 0.5 * width)[at[1]], *along[:, row][:, *at],
                               units="xy", angles="xy", scale=most / (_LONGEST_ARROW * width), color="0.15",
                               pivot="mid", width=0.1 * width)
        ax.set_title(_between(samples, row, table), loc="left", fontsize=8)
        ax.set(aspect="equal", xlim=window[0], ylim=window[1], facecolor=image.cmap(0.5))  # zero beyond all places
    if most > 0.0:
        above = _KEY if stacked else _KEY + _LINE  # of a narrow map it has no room beside the title
        axes.flat[-1].quiverkey(arrows, 0.9, 1.0 + above / tall, most, f"tangential, {most:.3g} Pa", labelpos="W")
    for ax in axes[-1]:
        ax.set_xlabel("x [µm]")
    for ax in axes[:, 0]:
        ax.set_ylabel("y [µm]")
    label = "normal traction\n" + _SIDES["normal"].replace("Pa", "Pa = N/m²")
    figure.colorbar(image, ax=axes, extend="both", label=label + _colours_end(top, normal[rows]))
    return figure


def _windows(edges: Sequence[np.ndarray], maps: np.ndarray) -> np.ndarray:
    """Limits (n, 2, 2) [µm] along both axes of n maps: all places, or where cells are, if these went far."""
    whole, ends = np.array([[at[0], at[-1]] for at in edges]), []
    for map_ in maps:
        there = [np.flatnonzero(map_.any(axis=axis)) for axis in (1, 0)]
        ends.append([[at[on[0]], at[on[-1] + 1]] if len(on) else every
                     for at, on, every in zip(edges, there, whole, strict=True)])
    size, middle = np.ptp(ends, axis=2).max(axis=0), np.mean(ends, axis=2)
    if np.ptp(whole, axis=1).max() <= FAR * size.max():
        return np.repeat(whole[None], len(maps), axis=0)
    half = 0.5 * size + np.diff(edges[0])[0]
    return np.stack([middle - half, middle + half], axis=-1)


def by_place(table: Table, samples: np.ndarray, column: str) -> tuple[list[np.ndarray], np.ndarray]:
    """Edges of intervals of the substrate along each axis [µm]; a column of all cells by sample and place (n - 1, …).

    Places that the table does not list are zero; the first sample has no means.  Rows of other times, of a run that was
    killed while it wrote its tables or goes on, are left out.
    """
    axes = [table[name] for name in ("x_um", "y_um") if name in table]
    width = min(np.diff(np.unique(at)).min(initial=np.inf) for at in axes)
    width = width if np.isfinite(width) else 1.0
    first = [at.min() for at in axes]
    place = [np.rint((at - low) / width).astype(int) for at, low in zip(axes, first, strict=True)]
    map_ = np.zeros((len(samples), *(k.max() + 1 for k in place)))
    time = table[time_column(table)]
    known = np.isin(time, samples)
    np.add.at(map_, (np.searchsorted(samples, time[known]), *(k[known] for k in place)),
              np.nan_to_num(table[column][known]))
    return [low + width * (np.arange(n + 1) - 0.5) for low, n in zip(first, map_.shape[1:], strict=True)], map_[1:]


def between(table: Table, samples: np.ndarray) -> Figure | None:
    """Mean pull of pairs of neighbours along the line of their centres, against time; None without contact.

    `table` : neighbours.csv;  `samples` : times of all samples, in the unit of the table.
    """
    if not table or len(samples) < 2:
        return None
    figure = Figure(figsize=(6.0, 2.8), layout="constrained")
    ax = figure.subplots()
    lines = pulls(table, samples)
    for number, (names, line) in enumerate(lines.items()):
        ax.stairs(line, samples, color=COLOURS[number % len(COLOURS)], baseline=None, linewidth=0.9,
                  ls=("-", "--", ":")[number // len(COLOURS) % 3], label=" and ".join(names))
    ax.axhline(0.0, color="0.4", linewidth=0.6, zorder=0)
    unit = "pN" if "pull_pn" in table else "pN/µm"
    ax.set(xlabel=f"time [{unit_of(table).label}]", ylabel=f"pull between neighbours [{unit}]")
    limit_axis(ax, usual_peak(np.array(list(lines.values()))), unit)
    if len(lines) <= 2 * len(COLOURS):
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    else:
        ax.set_title(f"{len(lines)} pairs of cells", loc="left", fontsize=8)
    return figure


def pulls(table: Table, samples: np.ndarray) -> dict[tuple[str, str], np.ndarray]:
    """Mean pulls between samples (n - 1,) [pN/µm, in space pN] by the names of two cells; zero without contact."""
    found: dict[tuple[str, str], np.ndarray] = {}
    known = np.isin(table[time_column(table)], samples)  # as in `by_place`
    table = {name: values[known] for name, values in table.items()}
    row = np.searchsorted(samples, table[time_column(table)])
    column = next(name for name in (f"pull_{unit}" for unit in FORCE.values()) if name in table)
    for pair in np.unique(np.column_stack([table["cell"], table["neighbour"]]), axis=0):
        on = np.flatnonzero((table["cell"] == pair[0]) & (table["neighbour"] == pair[1]))
        line = np.zeros(len(samples))
        line[row[on]] = table[column][on]
        found[str(table["name"][on[0]]), str(table["neighbour_name"][on[0]])] = line[1:]
    return found


def usual_peak(values: np.ndarray) -> float:
    """The 95th percentile of the magnitudes of nonzero values, 1 without any."""
    size = np.abs(values[np.isfinite(values) & (values != 0.0)])
    return float(np.percentile(size, _SHARE)) if len(size) else 1.0


def limit_axis(ax: Axes, top: float, unit: str) -> None:
    """Limit the axis to three times `top` either way, with a note if values are beyond."""
    least, most, limit = ax.dataLim.y0, ax.dataLim.y1, _BEYOND * top
    beyond = [f"down to {least:.4g}"] * int(least < -limit) + [f"up to {most:.4g}"] * int(most > limit)
    if beyond:
        low, high = ax.get_ylim()
        ax.set_ylim(max(low, -limit), min(high, limit))
        ax.set_title(f"not all is shown: {', '.join(beyond)} {unit}", loc="right", fontsize=7, color="0.3")
