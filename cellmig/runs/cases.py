"""Simple bodies from the tables of a case."""

from __future__ import annotations

from typing import Any


def lone_body(tree: dict[str, Any], material: str) -> dict[str, Any]:
    """Tables of a case of one cell, changed to a body of one of its materials at the origin, without adhesion."""
    others = {key: value for key, value in tree.items() if key not in ("adhesion", "protrusion")}
    cell = {key: value for key, value in tree["cells"][0].items() if key not in ("nucleus", "nucleus_ratio")}
    origin = {"centre": ["0 um"] * tree.get("dimension", 2), "rest": False}
    return others | {"cells": [cell | origin | {"material": material}],
                     "materials": {material: tree["materials"][material]}}


def fluid_drop(tree: dict[str, Any]) -> dict[str, Any]:
    """Tables of a case of one cell, changed to a drop of its cytoplasm at the origin, without adhesion."""
    return lone_body(tree, tree["cells"][0]["material"])
