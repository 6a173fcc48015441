"""Test pieces in equilibrium: elastic bodies under supports, loads and plates."""

from __future__ import annotations

from typing import Any

from cellmig.case.load import from_dict
from cellmig.case.schema import Case

NUCLEUS = {"law": "mooney-rivlin", "C1": "2126 Pa", "C2": "170 Pa", "lame": "170 kPa"}
RAMP = {"law": "ramp", "duration": "1 us"}
BAR = {"name": "Bar", "shape": "polygon", "material": "nucleus", "centre": ["0 um", "0 um"],
       "corners": [["-2 um", "-1 um"], ["2 um", "-1 um"], ["2 um", "1 um"], ["-2 um", "1 um"]]}
DISC = {"name": "Disc", "shape": "disc", "radius": "1.415 um", "material": "nucleus", "centre": ["0 um", "0 um"]}
LEFT, RIGHT = [["-2 um", "-1 um"], ["-2 um", "1 um"]], [["2 um", "-1 um"], ["2 um", "1 um"]]


def piece(cell: dict, count: int, samples: int = 2, time: dict | None = None, material: dict | None = None,
          **tables: Any) -> Case:
    """A static case of one cell of the nucleus's law."""
    return from_dict({"time": {"end": "1 us", "samples": samples, "frames": 1, "integrator": "static"} | (time or {}),
                      "particles": {"per_cell": count}, "materials": {"nucleus": NUCLEUS | (material or {})},
                      "cells": [cell]} | tables)


def plate(name: str, height: float, normal: float, moves: float) -> dict:
    """A level plate at a height, that moves [µm]."""
    return {"name": name, "point": ["0 um", f"{height} um"], "normal": [0, normal],
            "displacement": ["0 um", f"{moves} um"], "history": RAMP}


def squeezed(count: int, by: float = 0.2, **more: Any) -> Case:
    """The disc between two plates, its diameter reduced by a share."""
    move = 1.415 * by
    return piece(DISC, count, plates=[plate("top", 1.415, -1.0, -move), plate("bottom", -1.415, 1.0, move)], **more)


def bent(count: int, pull: float = 200.0, **more: Any) -> Case:
    """The bar, held on the left and pulled up on the right by a traction [Pa]."""
    return piece(BAR, count, supports=[{"name": "left", "box": LEFT}],
                 loads=[{"name": "up", "box": RIGHT, "traction": ["0 Pa", f"{pull} Pa"], "history": RAMP}], **more)
