"""Fields of a case, such as a concentration, on a grid behind the cells of a page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cellmig.output.xdmf import Frame
from cellmig.plot.background import Background

from .encode import rounded

SQUARES = 48  # along the longer side
BITS = 8
AROUND = 0.15  # of the scene beyond the cells, over its extent


def backdrop(directory: Path, chosen: Sequence[Frame], dimension: int) -> dict[str, Any] | None:
    """The first field of the case of a run in two dimensions, over the scene; None without one that varies."""
    if dimension == 3:
        return None
    corners = []
    for frame in (chosen[0], chosen[len(chosen) // 2], chosen[-1]):
        read = frame.read()
        x = (read["X"] + read["u"])[:, :2]
        corners += [x.min(axis=0), x.max(axis=0)]
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    around = AROUND * (high - low).max()
    low, high = low - [around, 0.0], high + around
    counts = np.maximum(2, np.round(SQUARES * (high - low) / (high - low).max()).astype(int))
    axes = [a + (b - a) * (np.arange(n) + 0.5) / n for a, b, n in zip(low, high, counts, strict=True)]
    places = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    found = Background.of(directory, None, lambda frame: places, chosen)
    if found is None:
        return None
    values = np.stack([found.values(places, frame) for frame in chosen])
    if np.allclose(values, values[0], equal_nan=True):  # steady
        values = values[:1]
    return {"label": found.label, "low": low.tolist(), "high": high.tolist(), "counts": counts.tolist(),
            "values": rounded(values, BITS)}
