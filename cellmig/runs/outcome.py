"""Results of one run that the paper's claims need."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cellmig.output.manifest import read_manifest
from cellmig.output.tables import IMPULSE, MEASURES, read_table
from cellmig.output.xdmf import Frame, frames

CELLS = (1, 2, 3)  # right, middle, left


@dataclass(frozen=True)
class Outcome:
    """Files of a run: history.csv, manifest, frames."""

    history: dict[str, np.ndarray]
    manifest: dict[str, Any] = field(default_factory=dict)
    frames: list[Frame] = field(default_factory=list)
    directory: Path | None = None

    @staticmethod
    def read(directory: Path) -> Outcome:
        """Read the directory of a complete run."""
        return Outcome(read_table(directory / "history.csv"), read_manifest(directory), frames(directory), directory)

    @property
    def dimension(self) -> int:
        """Number of dimensions."""
        return 3 if "z_um" in self.history else 2

    @property
    def end(self) -> float:
        """Time of the last sample [us]."""
        return float(self.history["time_us"][-1])

    @property
    def contacts(self) -> tuple[str, str]:
        """Columns of the contacts with the substrate and between cells."""
        return MEASURES[self.dimension][:2]

    def series(self, column: str, cell: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Times (n,) [us] and a column (n,) of history.csv; cell 0 is the aggregate."""
        rows = self.history["cell"] == cell
        return self.history["time_us"][rows], self.history[column][rows]

    def at(self, column: str, time: float, cell: int = 0) -> float:
        """A column at a time [us], interpolated between samples."""
        return float(np.interp(time, *self.series(column, cell)))

    def frame(self, time: float) -> dict[str, np.ndarray] | None:
        """Fields of the frame nearest to a time [us]; None without frames."""
        return min(self.frames, key=lambda frame: abs(frame.time - time)).read() if self.frames else None

    def apart(self, cell: int) -> float:
        """Time [us] for which an outer cell has no contact with the middle one, its only neighbour."""
        time, contact = self.series(self.contacts[1], cell)
        return float(np.mean(contact == 0.0) * time[-1])

    @property
    def separated(self) -> float:
        """Sum of `apart` of both outer cells [us]."""
        return self.apart(1) + self.apart(3)

    @property
    def impulse(self) -> float:
        """Impulse of the protrusion along x [pN us/um, in space pN us]; nan if the manifest has none."""
        return float(self.manifest.get(f"protrusion_impulse_{IMPULSE[self.dimension]}", np.nan))

    @cached_property
    def nucleus(self) -> int:
        """Value of the field `material` in a nucleus."""
        case = self.manifest["case"]
        used = [name for name in case["materials"]
                if any(name in (cell["material"], cell.get("nucleus")) for cell in case["cells"])]
        return used.index(case["cells"][0]["nucleus"])


# ------------------------------------------------------------------------------------------------------------ shape


def roundness(outcome: Outcome, time: float) -> float:
    """Smallest circularity 4 pi A/P^2 of the cells, in space their smallest sphericity [-]: 1 for a disc or ball."""
    if outcome.dimension == 3:
        return min(outcome.at("sphericity", time, cell) for cell in CELLS)
    return min(4.0 * np.pi * outcome.at("area_um2", time, cell) / outcome.at("perimeter_um", time, cell) ** 2
               for cell in CELLS)


def aspect(outcome: Outcome, time: float) -> float | None:
    """Height over width of the cell for which it is farthest from 1 [-]; in space widths are along x and along y."""
    fields = outcome.frame(time)
    if fields is None:
        return None
    extents = [np.ptp(_positions(fields, cell, outcome.dimension), axis=0) for cell in CELLS]
    return max((height / width for *widths, height in extents for width in widths), key=lambda r: abs(np.log(r)))


def gap(outcome: Outcome, time: float, height: float) -> float | None:
    """Horizontal distance [um] between the outlines of Cell-1 and Cell-2 at a height [um] above the substrate."""
    fields = outcome.frame(time)
    if fields is None:
        return None
    right, left = (_crossings(outline(fields, cell), height) for cell in (1, 2))
    return float(right.min() - left.max()) if len(right) and len(left) else np.nan


def _positions(fields: dict[str, np.ndarray], cell: int, dimension: int = 2) -> np.ndarray:
    on = fields["cell"] == cell
    return (fields["X"] + fields["u"])[on, :dimension]


def outline(fields: dict[str, np.ndarray], cell: int) -> np.ndarray:
    """Positions (n, 2) [um] of a cell's surface particles in order, the first again at the end."""
    place = fields["surface"][fields["cell"] == cell]
    order = np.argsort(place, kind="stable")[np.count_nonzero(place < 0):]
    return _positions(fields, cell)[np.append(order, order[:1])]


def _crossings(line: np.ndarray, height: float) -> np.ndarray:
    """Coordinates x (k,) [um] at which a polyline (n, 2) crosses a height."""
    (x0, y0), (x1, y1) = line[:-1].T, line[1:].T
    on = (y0 - height) * (y1 - height) < 0.0
    return x0[on] + (height - y0[on]) / (y1[on] - y0[on]) * (x1 - x0)[on]


# ----------------------------------------------------------------------------------------------------------- stress


class Oscillation(NamedTuple):
    """changes : of sign;  deviation, slow : standard deviations [Pa], raw and smoothed;  push, pull, scale : [Pa]."""

    changes: int
    deviation: float
    slow: float
    push: float
    pull: float
    scale: float


def oscillation(outcome: Outcome, cell: int = 2, start: float = 20.0, window: float = 10.0) -> Oscillation:
    """Oscillation of sigma11 at the lower centre of a cell about its linear trend after `start` [us].

    Sign changes are those of means over a `window` [us], so that sound and jumps of the contact line do not count.  The
    scale is the mean effective stress of the cell in the same time.
    """
    time, stress = outcome.series("sigma11_lower_centre_pa", cell)
    late = time >= start
    time, stress = time[late], stress[late]
    swing = stress - np.polyval(np.polyfit(time, stress, 1), time)
    width = min(len(swing), 1 + round(window / (time[1] - time[0])))
    slow = np.convolve(swing, np.ones(width) / width, "valid")
    signs = np.sign(slow[slow != 0.0])
    scale = outcome.series("effective_stress_pa", cell)[1][late].mean()
    return Oscillation(int(np.count_nonzero(np.diff(signs))), float(swing.std()), float(slow.std()),
                       float(max(0.0, -stress.min())), float(max(0.0, stress.max())), float(scale))


def stresses(outcome: Outcome, start: float, end: float) -> dict[str, dict[int, float]]:
    """Median effective stress [Pa] from `start` to `end` [us], by part of the cell and cell; empty without frames.

    The mean over time would depend on peaks of less than a microsecond where a contact line jumps.  The stress of the
    whole cell is that of history.csv, weighted by volume; the others are means over particles in frames.  The bottom
    is the lowest quarter of the cell's height at the time, the scatter the standard deviation over the nucleus.
    """
    chosen = [frame.read() for frame in outcome.frames if start <= frame.time <= end]
    if not chosen:
        return {}
    time = outcome.series("effective_stress_pa")[0]
    late = (time >= start) & (time <= end)
    whole = {cell: outcome.series("effective_stress_pa", cell)[1][late] for cell in CELLS}
    found = {"whole cell": {cell: float(np.median(stress)) for cell, stress in whole.items()}}
    parts = [{cell: _by_part(fields, cell, outcome.nucleus) for cell in CELLS} for fields in chosen]
    for name in parts[0][CELLS[0]]:
        found[name] = {cell: float(np.median([part[cell][name] for part in parts])) for cell in CELLS}
    return found


def _by_part(fields: dict[str, np.ndarray], cell: int, nucleus: int) -> dict[str, float]:
    on = fields["cell"] == cell
    stress, inner, y = fields["effective_stress"][on], fields["material"][on] == nucleus, _positions(fields, cell)[:, 1]
    low = y < y.min() + 0.25 * np.ptp(y)
    return {"nucleus": stress[inner].mean(), "scatter in the nucleus": stress[inner].std(),
            "cytoplasm": stress[~inner].mean(),
            "cytoplasm at the bottom": stress[~inner & low].mean(),
            "share of the nucleus": stress[inner].sum() / stress.sum()}
