"""Pictures of traction on the substrate by place and time, and of forces between pairs of cells, from the tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from .style import COLOURS

Table = Mapping[str, np.ndarray]
_SHARE = 95.0  # percentile that sets colours and axes: peaks of a membrane that jumps to contact are far larger
_BEYOND = 3.0  # axes end at this multiple of it, with a note
_SIDES = {"normal": "pressed ←  [Pa]  → pulled up", "tangential": "to the left ←  [Pa]  → to the right"}


def traction(table: Table, samples: np.ndarray, times: Sequence[float]) -> Figure | None:
    """Map of the mean traction between samples over place and time, and profiles; None without traction.

    `table` : substrate.csv;  `samples` : times of all samples;  `times` : of the profiles [µs].
    """
    kinds = [kind for kind in _SIDES if table and np.nan_to_num(table[f"{kind}_pa"]).any()]
    if not kinds or len(samples) < 2:
        return None
    figure = Figure(figsize=(0.6 + 5.4 * len(kinds), 4.8), layout="constrained")
    for axes, kind in zip(figure.subplots(2, len(kinds), sharex=True, height_ratios=(2, 3), squeeze=False).T, kinds,
                          strict=True):
        edges, map_ = by_place(table, samples, f"{kind}_pa")
        upper, lower = axes
        for number, time in enumerate(times):
            row = int(np.clip(np.searchsorted(samples, time), 1, len(map_))) - 1
            upper.stairs(map_[row], edges, color=COLOURS[number % len(COLOURS)], baseline=None,
                         label=f"{samples[row]:.4g} to {samples[row + 1]:.4g} µs")
        upper.axhline(0.0, color="0.4", linewidth=0.6, zorder=0)
        upper.set_ylabel(f"{kind} traction [Pa]")
        upper.legend()
        top = usual_peak(map_)
        limit_axis(upper, top, "Pa")
        image = lower.pcolormesh(edges, samples, map_, cmap="PuOr_r", norm=Normalize(-top, top), rasterized=True)
        lower.set(xlabel="x [µm]", ylabel="time [µs]")
        beyond = f"\ncolours end at {top:.3g} Pa, the largest is {np.abs(map_).max():.3g} Pa"
        figure.colorbar(image, ax=lower, extend="both", pad=0.02,
                        label=_SIDES[kind] + (beyond if np.abs(map_).max() > _BEYOND * top else ""))
    return figure


def by_place(table: Table, samples: np.ndarray, column: str) -> tuple[np.ndarray, np.ndarray]:
    """Edges of intervals of the substrate (k + 1,) [µm]; a column of all cells by sample and interval (n - 1, k).

    Places that the table does not list are zero; the first sample has no means.
    """
    places = np.unique(table["x_um"])
    width = np.diff(places).min(initial=np.inf)
    width = width if np.isfinite(width) else 1.0
    x = np.rint((table["x_um"] - places[0]) / width).astype(int)
    map_ = np.zeros((len(samples), x.max() + 1))
    np.add.at(map_, (np.searchsorted(samples, table["time_us"]), x), np.nan_to_num(table[column]))
    return places[0] + width * (np.arange(map_.shape[1] + 1) - 0.5), map_[1:]


def between(table: Table, samples: np.ndarray) -> Figure | None:
    """Mean pull of pairs of neighbours along the line of their centres, against time; None without contact.

    `table` : neighbours.csv;  `samples` : times of all samples [µs].
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
    ax.set(xlabel="time [µs]", ylabel="pull between neighbours [pN/µm]")
    limit_axis(ax, usual_peak(np.array(list(lines.values()))), "pN/µm")
    if len(lines) <= 2 * len(COLOURS):
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def pulls(table: Table, samples: np.ndarray) -> dict[tuple[str, str], np.ndarray]:
    """Mean pulls between samples (n - 1,) [pN/µm] by the names of two cells; zero without contact."""
    found: dict[tuple[str, str], np.ndarray] = {}
    row = np.searchsorted(samples, table["time_us"])
    for pair in np.unique(np.column_stack([table["cell"], table["neighbour"]]), axis=0):
        on = np.flatnonzero((table["cell"] == pair[0]) & (table["neighbour"] == pair[1]))
        line = np.zeros(len(samples))
        line[row[on]] = table["pull_pn_per_um"][on]
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
