"""Kymographs: velocity of the cells, traction and tension of their layer over place and time."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from cellmig.output.tables import time_column
from cellmig.output.tracks import Tracks
from cellmig.output.tractions import tension

from .traction import Table, by_place, usual_peak


def kymograph(found: Tracks, table: Table, samples: np.ndarray, now: bool = True) -> Figure | None:
    """Velocity along x of the cells where they touch, traction along x, and tension of the layer, by x and time.

    In space traction is integrated across x, and the velocity is the mean of the cells at x.  None without traction.
    `table` : substrate.csv;  `samples` : times of all samples, in the unit of the table;  `now` : tractions at the
    samples, else means between them.
    """
    column = ("tangential_x" if "y_um" in table else "tangential") + "_now" * now + "_pa"
    if not table or len(samples) < 3 or not np.nan_to_num(table[column]).any():
        return None
    edges, pull = by_place(table, samples, column)
    x, width, unit = edges[0], edges[0][1] - edges[0][0], "Pa"
    if pull.ndim == 3:
        pull, unit = width * pull.sum(axis=2), "pN/µm"
    layer = tension(pull, width)
    middle = np.where(pull != 0.0, 0.5 * (layer[:, 1:] + layer[:, :-1]), np.nan)
    label = found.unit.label
    force = "pN" if unit == "pN/µm" else "pN/µm"
    panels = {f"velocity [µm/{label}]": (_velocity(found, table, table[column], samples, x), None),
              f"traction [{unit}]": (np.where(pull != 0.0, pull, np.nan), usual_peak(pull)),
              f"tension h σ [{force}]": (middle, None)}
    figure = Figure(figsize=(9.6, 3.4), layout="constrained")
    axes = figure.subplots(1, len(panels), sharex=True, sharey=True)
    for ax, (name, (values, top)) in zip(axes, panels.items(), strict=True):
        top = top or float(np.nanmax(np.abs(values), initial=0.0)) or 1.0
        beyond = "both" if np.nanmax(np.abs(values), initial=0.0) > top else "neither"
        image = ax.pcolormesh(x, samples, values, cmap="PuOr_r", norm=Normalize(-top, top), rasterized=True)
        figure.colorbar(image, ax=ax, label=name, location="top", extend=beyond, pad=0.02)
        ax.set_xlabel("x [µm]")
        ax.set_facecolor("0.96")
    axes[0].set_ylabel(f"time [{label}]")
    return figure


def _velocity(found: Tracks, table: Table, pull: np.ndarray, samples: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Mean velocity along x (n - 1, places) of the cells that `pull` (rows,) [Pa] at a place; nan without."""
    numbers = {name: number for number, name in enumerate(found.names)}
    cell = np.array([numbers[name] for name in table["name"].tolist()])
    row = np.searchsorted(samples, table[time_column(table)]) - 1
    place = np.searchsorted(edges, table["x_um"]) - 1
    v = np.diff(found.along[:, :, 0], axis=1) / found.interval
    on = (row >= 0) & (row < v.shape[1]) & (np.nan_to_num(pull) != 0.0)
    shape = (len(samples) - 1, len(edges) - 1)
    sums, counts = np.zeros(shape), np.zeros(shape)
    np.add.at(sums, (row[on], place[on]), v[cell[on], row[on]])
    np.add.at(counts, (row[on], place[on]), 1.0)
    return np.where(counts > 0.0, sums / np.maximum(counts, 1.0), np.nan)
