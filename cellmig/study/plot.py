"""Pictures of a run: shapes and stress as in the paper's figures, displacement and contact, the energy ledger."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import TriMesh
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from matplotlib.tri import Triangulation

from cellmig.meshfree import polygons
from cellmig.output.directory import OutputError
from cellmig.output.manifest import read_manifest
from cellmig.output.tables import read_table
from cellmig.output.xdmf import Frame, frames

_PAPER_TIMES = (0.05, 0.51, 0.67)  # of the end: 20, 204 and 268 of 400 us
STYLE = {"font.size": 8, "axes.linewidth": 0.6, "axes.spines.top": False, "axes.spines.right": False,
       "lines.linewidth": 1.2, "legend.frameon": False, "savefig.dpi": 200, "savefig.bbox": "tight"}
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")  # Okabe and Ito
_UNITS = {"um": "µm", "us": "µs"}
_LEAST_SPAN = 1e-3  # µm, of the displacement axis


def plot(directory: Path, times: Sequence[float] | None = None, field: str = "effective_stress",
         out: Path | None = None) -> list[Path]:
    """Draw what a run left, finished or not.

    Parameters
    ----------
    directory : Path -- of the run.
    times : list of float -- [us] of the snapshots, each the nearest frame; by default 5, 51 and 67 % of the end.
    field : str -- fills the shapes; of a vector its length.
    out : Path -- where the pictures go; by default into the run's directory.

    Returns
    -------
    list of Path -- the pictures: shapes (PNG and PDF), displacement and ledger (PNG), of what there is.
    """
    directory = Path(directory)
    out = Path(out or directory)
    out.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context(STYLE):
        figures = {"shapes.png": shapes(directory, times, field), "displacement.png": _displacement(directory),
                   "ledger.png": _ledger(directory)}
        figures = {name: figure for name, figure in figures.items() if figure}
        if not figures:
            raise OutputError(f"'{directory}' holds no frames and no samples to draw")
        if "shapes.png" in figures:
            figures["shapes.pdf"] = figures["shapes.png"]
        for name, figure in figures.items():
            figure.savefig(out / name)
    return [out / name for name in figures]


def save(figure: Figure, out: Path, name: str, formats: Sequence[str]) -> list[Path]:
    """Write a figure in each format; the paths."""
    paths = [out / f"{name}.{kind}" for kind in formats]
    for path in paths:
        figure.savefig(path)
    return paths


def _chosen(found: list[Frame], times: Sequence[float] | None) -> list[Frame]:
    """The frames nearest to `times`, each once, in order."""
    there = np.array([frame.time for frame in found])
    wanted = np.multiply(_PAPER_TIMES, there[-1]) if times is None else np.asarray(times)
    return [found[k] for k in sorted({int(np.argmin(np.abs(there - time))) for time in wanted})]


def shapes(directory: Path, times: Sequence[float] | None, field: str = "effective_stress") -> Figure | None:
    """Snapshots of a run at the frames nearest to `times` [us], filled with a field; None if it has no frames."""
    found = frames(directory)
    if not found:
        return None
    chosen = _chosen(found, times)
    if field not in (units := chosen[0].units()):
        raise OutputError(f"the run has no field '{field}'; it has {', '.join(sorted(units))}")
    data = [frame.read() for frame in chosen]
    values = [_scalar(fields[field], field) for fields in data]
    norm, extend = _colour_range(np.concatenate(values))
    figure, axes = _panels(data)
    substrate = _on_substrate(directory)
    for ax, frame, fields, scalar in zip(axes, chosen, data, values, strict=True):
        image = _snapshot(ax, fields, scalar, norm)
        ax.set_title(f"t = {frame.time:.4g} µs", loc="left", fontsize=8)
        if substrate:
            ax.axhline(0.0, color="0.4", linewidth=1.0, zorder=0)
    unit = _UNITS.get(units[field], units[field])
    figure.colorbar(image, ax=list(axes), extend=extend, aspect=30, pad=0.02,
                    label=field.replace("_", " ") + (f" [{unit}]" if unit else ""))
    return figure


def _panels(data: list[dict[str, np.ndarray]]) -> tuple[Figure, np.ndarray]:
    """One panel a frame, all of the same scale and limits: below one another if the scene is wide."""
    x = np.concatenate([(fields["X"] + fields["u"])[:, :2] for fields in data])
    low, high = x.min(axis=0), x.max(axis=0)
    margin = 0.04 * (high - low).max() + 1e-9  # so that a single particle has a panel too
    low, high = low - margin, high + margin
    (width, height), n = high - low, len(data)
    stacked = n == 1 or width > 1.3 * height
    size = (6.0, 0.6 + n * (0.25 + 4.9 * height / width)) if stacked else (7.2, 0.9 + 6.2 / n * height / width)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(n if stacked else 1, 1 if stacked else n, sharex=True, sharey=True, squeeze=False)
    for ax in axes.flat:
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        ax.yaxis.set_major_locator(MaxNLocator(nbins=4, steps=[1, 2, 5, 10]))
    for ax in axes[-1]:
        ax.set_xlabel("x [µm]")
    for ax in axes[:, 0]:
        ax.set_ylabel("y [µm]")
    return figure, axes.ravel()


def _scalar(values: np.ndarray, field: str) -> np.ndarray:
    if values.ndim == 2 and values.shape[1] == 9:
        raise OutputError(f"'{field}' is a tensor: draw 'effective_stress' or another scalar")
    return np.linalg.norm(values, axis=1) if values.ndim == 2 else values.astype(float)


def _colour_range(values: np.ndarray) -> tuple[Normalize, str]:
    """Limits that a few wild particles do not move, and on which sides there are values beyond them."""
    values = values[np.isfinite(values)]
    if not len(values):
        return Normalize(0.0, 1.0), "neither"
    low, high = np.percentile(values, [1.0, 99.0])
    below, above = values.min() < low, values.max() > high
    extend = {(True, True): "both", (True, False): "min", (False, True): "max"}.get((below, above), "neither")
    return Normalize(low, high if high > low else low + 1.0), extend


def _on_substrate(directory: Path) -> bool:
    """Whether the scene has a substrate; if the manifest does not tell yet, a run on one is the rule."""
    case = read_manifest(directory).get("case")
    return case is None or "substrate" in case.get("adhesion", {})


def _snapshot(ax: Axes, fields: dict[str, np.ndarray], values: np.ndarray, norm: Normalize) -> TriMesh:
    """Draw all cells of a frame; returns the last filling, for the colour bar."""
    for cell in np.unique(fields["cell"]):
        own = fields["cell"] == cell
        triangles, outline = _drawing({name: fields[name][own] for name in ("X", "u", "surface")})
        image = ax.tripcolor(triangles, values[own], norm=norm, cmap="viridis", shading="gouraud", rasterized=True)
        for loop in outline:
            ax.plot(triangles.x[loop], triangles.y[loop], color="0.1", linewidth=0.6)
        material = fields["material"][own].astype(float)
        if borders := list(np.unique(material)[:-1] + 0.5):
            ax.tricontour(triangles, material, levels=borders, colors="white", linewidths=0.7)
    return image


def _drawing(fields: dict[str, np.ndarray]) -> tuple[Triangulation, list[np.ndarray]]:
    """A cell where it is now, in triangles between those who were neighbours at the start; and its closed outlines."""
    reference, x = fields["X"][:, :2], (fields["X"] + fields["u"])[:, :2]
    surface = np.flatnonzero(fields["surface"] >= 0)
    outline = surface[np.argsort(fields["surface"][surface], kind="stable")]
    loops = np.split(outline, np.flatnonzero(np.diff(fields["surface"][outline]) > 1) + 1)  # between, one is left out
    triangles = Triangulation(*reference.T).triangles
    if len(outline) > 2:
        rings = polygons.joined([reference[loop] for loop in loops])
        triangles = triangles[polygons.inside(reference[triangles].mean(axis=1), rings)]
    return Triangulation(*x.T, triangles), [np.append(loop, loop[:1]) for loop in loops]


def _displacement(directory: Path) -> Figure | None:
    """Displacement of every cell and the mean, and what it touches, against time."""
    history = _table(directory / "history.csv")
    if not history:
        return None
    cells = [cell for cell in np.unique(history["cell"]) if cell]
    contacts = [(name, text, style) for name, text, style in (("substrate_contact_um", "with the substrate", "-"),
                                                              ("cell_contact_um", "with cells", ":"))
                if np.nan_to_num(history[name]).any()]
    panels = 2 if contacts else 1
    figure = Figure(figsize=(6.0, 0.4 + 2.1 * panels), layout="constrained")
    upper, *lower = figure.subplots(panels, 1, sharex=True, squeeze=False).flat
    for cell in cells if len(cells) == 1 else [0, *cells]:
        rows = history["cell"] == cell
        time = history["time_us"][rows]
        colour = COLOURS[(cell - 1) % len(COLOURS)]
        style = {"color": colour, "label": f"cell {cell}"} if cell else {"color": "0.2", "label": "mean", "ls": "--"}
        upper.plot(time, history["ux_um"][rows], **style)
        for name, _, line in contacts if cell else ():
            lower[0].plot(time, history[name][rows], color=colour, ls=line)
    upper.set_ylabel("displacement $u_x$ [µm]")
    low, high = upper.get_ylim()
    if high - low < _LEAST_SPAN:  # nothing moves: no picture of rounding errors
        upper.set_ylim(-_LEAST_SPAN, _LEAST_SPAN)
    for ax in lower:
        for _, text, line in contacts:
            ax.plot([], [], color="0.4", ls=line, label=text)
        ax.set_ylabel("contact length [µm]")
    for ax in (upper, *lower):
        ax.legend(loc="upper left")
    ax.set_xlabel("time [µs]")
    return figure


def _ledger(directory: Path) -> Figure | None:
    """Every entry of the energy ledger that the scene has, and what does not add up."""
    ledger = _table(directory / "ledger.csv")
    if not ledger:
        return None
    figure = Figure(figsize=(6.0, 4.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    entries = [name for name in ledger if name not in ("time_us", "closure") and np.nan_to_num(ledger[name]).any()]
    for number, name in enumerate(entries):
        style = "-" if number < len(COLOURS) else "--"
        upper.plot(ledger["time_us"], ledger[name], color=COLOURS[number % len(COLOURS)], ls=style,
                   label=name.replace("_", " "))
    lower.plot(ledger["time_us"], 100 * ledger["closure"], color="0.2")
    upper.set_ylabel("energy per thickness [pN]")
    lower.set(ylabel="closure [%]", xlabel="time [µs]")
    if entries:
        upper.legend(bbox_to_anchor=(1.0, 1.0), loc="upper left")
    return figure


def _table(path: Path) -> dict[str, np.ndarray]:
    """A table with at least one row, or an empty one."""
    table = read_table(path) if path.exists() else {}
    return table if table and len(table["time_us"]) else {}
