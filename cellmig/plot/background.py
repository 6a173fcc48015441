"""Fields of a case, such as a concentration or the stiffness of the substrate, behind the cells of a picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from matplotlib.colors import LinearSegmentedColormap, Normalize

from cellmig.case import units
from cellmig.case.messages import CaseError, Mistake, suggest
from cellmig.case.time_unit import TimeUnit
from cellmig.model.ground import fields_of
from cellmig.output.manifest import read_case, read_manifest
from cellmig.output.xdmf import Frame

from .style import in_print

MAP = LinearSegmentedColormap.from_list("behind", ["#FFFFFF", "#F3B98A"])  # pale, so that cells stand out
NONE = "none"


@dataclass(frozen=True)
class Background:
    """A field behind the cells; `size` : of its unit in the code's units."""

    label: str
    law: Any
    size: float
    norm: Normalize

    @classmethod
    def of(cls, directory: Path, name: str | None, places: Callable[[Frame], np.ndarray],
           found: Sequence[Frame]) -> Background | None:
        """A field of the case of a run, the first by default; None of a case without, or where it is uniform.

        places : function -- of a frame: where it will be drawn (n, d) [µm];  found : frames with which it will be.
        Raises CaseError for a name that the case does not have.
        """
        laws = _fields(directory)
        if name == NONE or not (laws or name):
            return None
        if name is not None and name not in laws:
            raise CaseError([Mistake("--background", None, "", f"the case has no field '{name}'"
                                     f"{suggest(name, [*laws, NONE])}")])
        name = name or next(iter(laws))
        law = laws[name]
        size = units.number(f"1 {law.unit}", law.unit)
        values = np.stack([law.value(places(frame), frame.unit.size * frame.time) / size for frame in found])
        unit = in_print(law.unit)
        label = name.replace("_", " ") + (f" [{unit}]" if unit else "")
        low, high = np.nanmin(values, initial=np.inf), np.nanmax(values, initial=-np.inf)
        return cls(label, law, size, Normalize(low, high)) if high > low else None

    def values(self, places: np.ndarray, frame: Frame) -> np.ndarray:
        """Values (n,) in the unit of the case at places (n, d) [µm] at the time of a frame."""
        return self.law.value(places, frame.unit.size * frame.time) / self.size


class Stored:
    """A field that diffuses, as the frames of a run have it, volume by volume."""

    def __init__(self, directory: Path, name: str):
        """Raises OSError where a frame cannot be read."""
        self._name, self._paths = name, sorted((directory / "fields").glob("s*.h5"))
        self._times, self.unit = np.zeros(len(self._paths)), ""
        for number, path in enumerate(self._paths):
            with h5py.File(path) as file:
                self._times[number] = file.attrs["time"] * TimeUnit(file.attrs["time_unit"]).size
                self.unit = file[name].attrs["unit"]

    def __bool__(self) -> bool:
        """Whether there are frames."""
        return bool(self._paths)

    def value(self, x: np.ndarray, time: float) -> np.ndarray:
        """Values (n,), in the code's units, at places x (n, d) [µm] in the frame nearest to a time [µs].

        They are nan outside the box.
        """
        with h5py.File(self._paths[int(np.argmin(np.abs(self._times - time)))]) as file:
            data = file[self._name]
            low, size, values = data.attrs["low"], data.attrs["size"], data[:].T  # the file has the last axis first
        at = np.floor((x - low) / size).astype(int)
        inside = ((at >= 0) & (at < values.shape)).all(axis=1)
        found = np.full(len(x), np.nan)
        found[inside] = values[tuple(at[inside].T)]
        return units.number(f"1 {self.unit}", self.unit) * found


def _fields(directory: Path) -> dict[str, Any]:
    """Fields of the case of a run by name; those that diffuse from its frames."""
    if not {"fields", "substrate"} & (read_manifest(directory).get("case") or {}).keys():
        return {}
    laws = fields_of(read_case(directory))
    found: dict[str, Any] = {name: law if hasattr(law, "value") else Stored(directory, name)
                             for name, law in laws.items()}
    return {name: field for name, field in found.items() if not isinstance(field, Stored) or field}
