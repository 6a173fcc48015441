"""Which cells touch: the graph of a colony, lines between the centres of neighbours on the outlines of the cells."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import BoundaryNorm, LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from scipy.spatial import ConvexHull

from cellmig.output.tables import FORCE, MEASURES, time_column
from cellmig.output.xdmf import Frame

from .traction import usual_peak
from .view import Picture, outlines

FEW = 3  # cells of which a graph is drawn, at least
NAMED = 100  # cells that are named, at most
COUNTS = LinearSegmentedColormap.from_list("counts", ["1.0", "0.55"])  # of cells by neighbours
PULLS = "RdBu_r"  # of lines by pull
THICK = 4.0  # line of the longest contact [points]
Table = Mapping[str, np.ndarray]


def graph(found: Sequence[Frame], times: Sequence[float], history: Table, neighbours: Table) -> Figure | None:
    """Contacts at the samples nearest to `times`; None for fewer than three cells, without contacts or frames.

    found : frames of the run;  history, neighbours : its tables.  In three dimensions, cells are seen from above.
    """
    contact = next((name for name in (MEASURES[d][1] for d in (2, 3)) if name in neighbours), None)
    if not times or contact is None or not neighbours[contact].any() or history["cell"].max() < FEW:
        return None
    some = [min(found, key=lambda frame: abs(frame.time - time)) for time in times]
    shapes = [_shapes(frame) for frame in some]
    every = np.concatenate([p for shape in shapes for p in shape])
    low, high = every.min(axis=0), every.max(axis=0)
    margin = 0.04 * (high - low).max()
    width, height = high - low + 2.0 * margin
    figure = Picture(figsize=(6.4, 0.8 + len(some) * (0.25 + 4.6 * height / width)), layout="constrained")
    axes = figure.subplots(len(some), 1, sharex=True, squeeze=False).ravel()
    drawn = _Scales(neighbours, contact)
    for ax, frame, shape in zip(axes, some, shapes, strict=True):
        drawn.draw(ax, frame, shape, history, neighbours)
        ax.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin), aspect="equal",
               ylabel="y [µm]")
        ax.yaxis.set_major_locator(MaxNLocator(nbins=4, steps=[1, 2, 5, 10]))
    axes[-1].set_xlabel("x [µm]")
    drawn.bars(figure, list(axes))
    return figure


def _shapes(frame: Frame) -> list[np.ndarray]:
    """Outlines (k, 2) [µm] of the cells of a frame, in order; in three dimensions the hulls of their projections."""
    fields = frame.read()
    x, cell = fields["X"] + fields["u"], fields["cell"]
    last = np.unique(cell, return_index=True)[1][1:]
    found = []
    for on in np.split(np.arange(len(cell)), last):
        p = x[on, :2]
        flat = np.ptp(x[on, 2]) == 0.0 if x.shape[1] > 2 else True
        found.append(p[outlines(fields["surface"][on])[0]] if flat else p[ConvexHull(p).vertices])
    return found


class _Scales:
    """Colours and widths that all panels share."""

    def __init__(self, neighbours: Table, contact: str):
        self.contact = contact
        self.pull = next(name for name in (f"pull_{unit}" for unit in FORCE.values()) if name in neighbours)
        top = usual_peak(neighbours[self.pull])
        self.norm, self.longest = Normalize(-top, top), float(neighbours[contact].max())
        time, ends = neighbours[time_column(neighbours)], (neighbours["cell"], neighbours["neighbour"])
        rows = np.concatenate([np.column_stack([time, end])[neighbours[contact] > 0.0] for end in ends])
        most = np.unique(rows, axis=0, return_counts=True)[1].max()
        self.counts = BoundaryNorm(np.arange(most + 2) - 0.5, 256)

    def draw(self, ax: Axes, frame: Frame, shapes: list[np.ndarray], history: Table, neighbours: Table) -> None:
        """Draw cells and their contacts at the sample nearest to a frame."""
        times = history[time_column(history)]
        time = times[np.argmin(np.abs(times - frame.time))]
        now, pairs = times == time, (neighbours[time_column(neighbours)] == time) & (neighbours[self.contact] > 0.0)
        centre = np.column_stack([history["x_um"][now], history["y_um"][now]])  # the aggregate first
        ends = np.column_stack([neighbours["cell"][pairs], neighbours["neighbour"][pairs]])
        count = np.bincount(ends.ravel(), minlength=len(centre))[1:]
        ax.add_collection(PolyCollection(shapes, array=count, norm=self.counts, cmap=COUNTS, edgecolors="0.4",
                                         linewidths=0.5))
        lines = LineCollection(centre[ends], array=np.nan_to_num(neighbours[self.pull][pairs]), norm=self.norm,
                               cmap=PULLS, capstyle="round",
                               linewidths=0.3 + THICK * neighbours[self.contact][pairs] / self.longest)
        ax.add_collection(lines)
        if len(shapes) <= NAMED:
            for (x, y), name in zip(centre[1:], history["name"][now][1:], strict=True):
                ax.text(x, y, name, fontsize=5, ha="center", va="center",
                        bbox={"boxstyle": "round,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.8})
        ax.set_title(f"t = {frame.time:.4g} {frame.unit.label}", loc="left", fontsize=8)

    def bars(self, figure: Figure, axes: list[Axes]) -> None:
        """Add the colour bars, and what the widths of lines mean."""
        unit = "pN" if self.pull.endswith("_pn") else "pN/µm"
        figure.colorbar(ScalarMappable(self.norm, PULLS), ax=axes, aspect=30, extend="both",
                        label=f"pull between neighbours [{unit}]")
        bar = figure.colorbar(ScalarMappable(self.counts, COUNTS), ax=axes, location="bottom", aspect=40, shrink=0.8,
                              label="number of neighbours")
        bar.set_ticks(np.arange(len(self.counts.boundaries) - 1))
        measure = "µm" if self.contact.endswith("_um") else "µm²"
        axes[0].plot([], [], color="0.5", linewidth=0.3 + THICK, label=f"contact of {self.longest:.2g} {measure}")
        axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)
