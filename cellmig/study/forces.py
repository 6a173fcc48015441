"""Where the cells pull: on the substrate, by place and time, and on each other, pair by pair."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from cellmig.output.xdmf import Frame

from .style import COLOURS

_PLACES = 500  # along the substrate
_LEAST = 1e-4  # of the largest traction: less is none
_SHARE = 95.0  # % of the places under cells whose colours differ: a membrane that snaps down pulls far harder


def traction(found: Sequence[Frame], chosen: Sequence[Frame]) -> Figure | None:
    """Traction on the substrate: a map over place and time, and above it the profile in some frames.

    None if the scene has no adhesion to the substrate.
    """
    if not found or "adhesion_force" not in found[0].units():
        return None
    frames = [_bonded(frame) for frame in found]
    low, high = (limit(place.min() if limit is min else place.max() for place, *_ in frames) for limit in (min, max))
    width = float(np.median([spacing for *_, spacing in frames]))
    x = np.linspace(low - 3 * width, high + 3 * width, _PLACES)
    map_ = np.array([smoothed(x, place, force, width) for place, force, _ in frames])
    figure = Figure(figsize=(6.0, 4.8), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 3))
    times = np.array([frame.time for frame in found])
    for number, frame in enumerate(chosen):
        upper.plot(x, map_[np.argmin(np.abs(times - frame.time))], color=COLOURS[number % len(COLOURS)],
                   label=f"{frame.time:.4g} µs")
    upper.axhline(0.0, color="0.4", linewidth=0.6, zorder=0)
    upper.set_ylabel("normal traction [Pa]")
    upper.legend()
    pulled = np.abs(map_)
    top = float(np.percentile(pulled[pulled > _LEAST * pulled.max()], _SHARE)) if pulled.any() else 1.0
    edges = np.concatenate([times[:1], 0.5 * (times[1:] + times[:-1]), times[-1:] + (len(times) == 1)])
    image = lower.pcolormesh(np.append(x, 2 * x[-1] - x[-2]), edges, map_, cmap="PuOr_r", norm=Normalize(-top, top),
                             rasterized=True)
    lower.set(xlabel="x [µm]", ylabel="time [µs]")
    figure.colorbar(image, ax=lower, label="pressed ←  [Pa]  → pulled up", extend="both", pad=0.02)
    return figure


def _bonded(frame: Frame) -> tuple[np.ndarray, np.ndarray, float]:
    """Places (m,) [µm] of the surface particles, their pull on the substrate (m,) [pN/µm], and their spacing [µm]."""
    fields = frame.read()
    on = fields["surface"] >= 0
    x = (fields["X"] + fields["u"])[on]
    rim = fields["X"][on][:, :2]
    spacing = float(np.median(cKDTree(rim).query(rim, 2)[0][:, 1])) if len(rim) > 1 else 1.0
    return x[:, 0], -fields["adhesion_force"][on][:, 1], spacing


def smoothed(x: np.ndarray, place: np.ndarray, force: np.ndarray, width: float) -> np.ndarray:
    """Traction (n,) [Pa] at `x` of forces (m,) [pN/µm], each spread over a bell of standard deviation `width` [µm].

    Its integral is the sum of the forces; bells as wide as the spacing of the particles do not show them singly.
    """
    bells = np.exp(-0.5 * ((x[:, None] - place) / width) ** 2) / (np.sqrt(2.0 * np.pi) * width)
    return bells @ force


def between(found: Sequence[Frame]) -> Figure | None:
    """Force between each two neighbours along the line of their centres, against time; None if there are none."""
    if not found or "contact_force" not in found[0].units():
        return None
    pairs: dict[tuple[int, int], list[tuple[float, float]]] = {}
    for frame in found:
        for pair, force in pulls(frame.read()).items():
            pairs.setdefault(pair, []).append((frame.time, force))
    if not pairs:
        return None
    figure = Figure(figsize=(6.0, 2.8), layout="constrained")
    ax = figure.subplots()
    for number, (pair, line) in enumerate(sorted(pairs.items())):
        ax.plot(*zip(*line, strict=True), color=COLOURS[number % len(COLOURS)],
                ls=("-", "--", ":")[number // len(COLOURS) % 3], label=f"cells {pair[0]} and {pair[1]}")
    ax.axhline(0.0, color="0.4", linewidth=0.6, zorder=0)
    ax.set(xlabel="time [µs]", ylabel="pull between neighbours [pN/µm]")
    if len(pairs) <= 2 * len(COLOURS):
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def pulls(fields: dict[str, np.ndarray]) -> dict[tuple[int, int], float]:
    """Force [pN/µm] by pair of cells along the line of their centres, positive where it holds them together.

    What acts on a particle comes from the cell whose surface is nearest.
    """
    on = (fields["surface"] >= 0) & np.any(fields["contact_force"] != 0.0, axis=1)
    if not on.any():
        return {}
    x, cell, force = ((fields["X"] + fields["u"])[on][:, :2], fields["cell"][on], fields["contact_force"][on][:, :2])
    whole = (fields["X"] + fields["u"])[:, :2]
    centre = {c: whole[fields["cell"] == c].mean(axis=0) for c in np.unique(cell)}
    other = np.zeros(len(x), dtype=int)
    for c in centre:
        mine, rest = cell == c, cell != c
        if rest.any():
            other[mine] = cell[rest][cKDTree(x[rest]).query(x[mine])[1]]
    found = {}
    for a, b in {(min(p), max(p)) for p in zip(cell.tolist(), other.tolist(), strict=True) if p[1]}:
        along = (centre[b] - centre[a]) / np.linalg.norm(centre[b] - centre[a])
        on_a, on_b = (force[(cell == i) & (other == j)].sum(axis=0) for i, j in ((a, b), (b, a)))
        found[a, b] = float(0.5 * (on_a - on_b) @ along)  # equal and opposite, but for what reaches a third cell
    return found
