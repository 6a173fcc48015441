"""Fields of a case, such as a concentration or the stiffness of the substrate, behind the cells of a picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, Normalize

from cellmig.case import units
from cellmig.case.load import from_dict
from cellmig.case.messages import CaseError, Mistake, suggest
from cellmig.case.own_laws import include_all
from cellmig.laws import register
from cellmig.model.ground import fields_of
from cellmig.output.manifest import read_manifest
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
        return cls(label, law, size, Normalize(values.min(), values.max())) if np.ptp(values) > 0.0 else None

    def values(self, places: np.ndarray, frame: Frame) -> np.ndarray:
        """Values (n,) in the unit of the case at places (n, d) [µm] at the time of a frame."""
        return self.law.value(places, frame.unit.size * frame.time) / self.size


def _fields(directory: Path) -> dict[str, Any]:
    """Fields of the case of a run by name."""
    manifest = read_manifest(directory)
    case = manifest.get("case") or {}
    if not {"fields", "substrate"} & case.keys():
        return {}
    register()
    include_all(manifest.get("laws", ()))
    return dict(fields_of(from_dict(case, manifest.get("case_file", ""), older=True)))
