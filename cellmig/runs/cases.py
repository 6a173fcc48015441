"""The case files of the project."""

from __future__ import annotations

from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parents[2] / "cases"


def fluid_drop(tree: dict[str, Any]) -> dict[str, Any]:
    """Tables of a case of one cell, changed to a drop of its cytoplasm at the origin, without adhesion."""
    cell, nucleus = tree["cells"][0], tree["cells"][0]["nucleus"]
    others = {key: value for key, value in tree.items() if key not in ("adhesion", "protrusion")}
    cell = {key: value for key, value in cell.items() if key not in ("nucleus", "nucleus_ratio")}
    return others | {"cells": [cell | {"centre": ["0 um", "0 um"]}],
                     "materials": {name: law for name, law in tree["materials"].items() if name != nucleus}}
