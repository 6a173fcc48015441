"""`cellmig plot`: pictures of shapes, displacement, energy, traction and forces between cells of a run."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from cellmig.output.directory import OutputError, existing_run
from cellmig.output.tables import MEASURES, names_of, read_table, time_column, unit_of
from cellmig.output.tracks import in_balance, read_tracks
from cellmig.output.xdmf import Frame, frames

from .graph import graph
from .kymograph import kymograph
from .snapshots import film, missing_times, nearest_frames, sections, shapes
from .style import COLOURS, STYLE, legend_above, save
from .tracks import NAMED, cues, squares, tracks
from .traction import between, traction

_LEAST_SPAN = 1e-3  # smallest range of the displacement axis [µm]


def plot(directory: Path, times: Sequence[float] | None = None, field: str = "effective_stress",
         out: Path | None = None, formats: Sequence[str] = ("png", "pdf"), moving: bool = False,
         behind: str | None = None) -> list[Path]:
    """Draw the files of a run, complete or not.

    Parameters
    ----------
    directory : Path -- of the run.
    times : list of float -- of snapshots, in the unit of the run; they show the nearest frames; by default 5, 50 and
        100 % of the end.
    field : str -- colours the shapes; for a vector its magnitude.
    out : Path -- directory of the pictures; by default that of the run.
    formats : list of str -- "png", "pdf" or "svg".
    moving : bool -- a film as well.
    behind : str -- field of the case behind the cells, "none" for none; by default the first.

    Returns
    -------
    list of Path -- the pictures whose data exist: shapes, section (in three dimensions), displacement, ledger,
        traction, between and graph (neighbours), tracks, msd, kymograph, cues, film.
    """
    directory = existing_run(directory)
    out = Path(out or directory)
    out.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context(STYLE):
        found = frames(directory)
        some = [frame.time for frame in nearest_frames(found, times)] if found else []
        for remark in filter(None, [missing_times(found, times), _no_tables(directory, found)] if found else []):
            print(f"cellmig: {remark}", file=sys.stderr)
        history, ledger, substrate, neighbours, cue_table = (
            _table(directory / f"{name}.csv") for name in ("history", "ledger", "substrate", "neighbours", "cues"))
        samples = np.unique(history.get(time_column(history), []))
        figures = {"shapes": shapes(directory, times, field, behind),
                   "section": sections(directory, times, field, behind),
                   "displacement": _displacement(history),
                   "ledger": _ledger(ledger), "traction": traction(substrate, samples, some),
                   "between": between(neighbours, samples),
                   "graph": graph(found, some if times else some[-1:], history, neighbours),
                   **_motion(directory, substrate, samples),
                   "cues": cues(cue_table)}
        if not any(figures.values()):
            raise OutputError(f"'{directory}' holds no frames and no samples to draw")
        paths = [path for name, figure in figures.items() if figure for path in save(figure, out, name, formats)]
        made = film(directory, out, field, behind) if moving else None
    return [*paths, made] if made else paths


def _motion(directory: Path, substrate: dict[str, np.ndarray], samples: np.ndarray) -> dict[str, Figure | None]:
    """Pictures of how cells moved, of a run with tracks at two samples or more."""
    if len(samples) < 2 or not (directory / "tracks.csv").exists():
        return {}
    found = read_tracks(directory)
    return {"tracks": tracks(found), "msd": squares(found),
            "kymograph": kymograph(found, substrate, samples, in_balance(directory))}


def _no_tables(directory: Path, found: Sequence[Frame]) -> str:
    """Remark about a run whose frames have forces but whose tables are missing, else empty."""
    tables = {"adhesion_force": "substrate.csv", "contact_force": "neighbours.csv"}
    lacking = [name for field, name in tables.items() if field in found[0].units() and not (directory / name).exists()]
    return f"no pictures of forces: the run is of an older version, without {' and '.join(lacking)}" if lacking else ""


def _displacement(history: dict[str, np.ndarray]) -> Figure | None:
    """Displacement, contact lengths and effective stress of each cell against time, with their means."""
    if not history:
        return None
    names = names_of(history)
    cells = [cell for cell in np.unique(history["cell"]) if cell]
    dimension = 3 if "z_um" in history else 2
    contacts = [(name, text, style) for name, text, style in zip(MEASURES[dimension][:2], ("with the substrate",
                                                                 "with cells"), "-:", strict=True)
                if np.nan_to_num(history[name]).any()]
    stressed = np.nan_to_num(history["effective_stress_pa"]).any()
    panels = 1 + bool(contacts) + bool(stressed)
    figure = Figure(figsize=(6.0, 0.4 + 2.0 * panels), layout="constrained")
    axes = figure.subplots(panels, 1, sharex=True, squeeze=False).ravel()
    mean = {"color": "0.2", "label": "mean" + f" of {len(cells)} cells" * (len(cells) > NAMED), "ls": "--", "zorder": 3}
    for cell in cells if len(cells) == 1 else [0, *cells]:
        rows = history["cell"] == cell
        time = history[time_column(history)][rows]
        colour = COLOURS[(cell - 1) % len(COLOURS)]
        style = {"color": colour, "label": names[cell] if len(cells) <= NAMED else "_"} if cell else mean
        axes[0].plot(time, history["ux_um"][rows], **style)
        for name, _, line in contacts if cell else ():
            axes[1].plot(time, history[name][rows], color=colour, ls=line)
        if stressed:
            axes[-1].plot(time, history["effective_stress_pa"][rows], **style)
    axes[0].set_ylabel("displacement $u_x$ [µm]")
    legend_above(axes[0])
    low, high = axes[0].get_ylim()
    if high - low < _LEAST_SPAN:  # nothing moves: do not magnify rounding errors
        axes[0].set(ylim=(-_LEAST_SPAN, _LEAST_SPAN), yticks=(-_LEAST_SPAN, 0.0, _LEAST_SPAN))
    if contacts:
        for _, text, line in contacts:
            axes[1].plot([], [], color="0.4", ls=line, label=text)
        axes[1].set_ylabel("contact length [µm]" if dimension == 2 else "contact area [µm²]")
        legend_above(axes[1])
    if stressed:
        axes[-1].set_ylabel("effective stress [Pa]")
    axes[-1].set_xlabel(f"time [{unit_of(history).label}]")
    return figure


def _ledger(ledger: dict[str, np.ndarray]) -> Figure | None:
    """Entries of the energy ledger that are not zero, and the energy error, against time."""
    if not ledger:
        return None
    figure = Figure(figsize=(6.0, 4.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    time = ledger[time_column(ledger)]
    entries = [name for name in ledger
               if name not in (time_column(ledger), "energy_error") and np.nan_to_num(ledger[name]).any()]
    for number, name in enumerate(entries):
        style = "-" if number < len(COLOURS) else "--"
        upper.plot(time, ledger[name], color=COLOURS[number % len(COLOURS)], ls=style,
                   label=name.removesuffix("_pn_um").removesuffix("_pn").replace("_", " "))
    lower.plot(time, 100 * ledger["energy_error"], color="0.2")
    upper.set_ylabel("energy per thickness [pN]" if "kinetic_pn" in ledger else "energy [pN µm]")
    lower.set(ylabel="energy\nerror [%]", xlabel=f"time [{unit_of(ledger).label}]")
    if entries:
        upper.legend(bbox_to_anchor=(1.0, 1.0), loc="upper left")
    return figure


def _table(path: Path) -> dict[str, np.ndarray]:
    """A table, or an empty one if it has no rows."""
    table = read_table(path) if path.exists() else {}
    return table if table and len(table[time_column(table)]) else {}
