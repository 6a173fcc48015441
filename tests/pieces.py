"""Test pieces in equilibrium: elastic bodies under supports, loads and plates."""

from __future__ import annotations

from typing import Any

from scenes import LEFT, RIGHT

from cellmig.case.schema import Case
from cellmig.verify.specimens import RAMP, piece

BAR = {"name": "Bar", "shape": "polygon", "material": "nucleus", "centre": ["0 um", "0 um"],
       "corners": [["-2 um", "-1 um"], ["2 um", "-1 um"], ["2 um", "1 um"], ["-2 um", "1 um"]]}
DISC = {"name": "Disc", "shape": "disc", "radius": "1.415 um"}


def plate(name: str, height: float, normal: float, moves: float) -> dict:
    """A level plate at a height, that moves [µm]."""
    return {"name": name, "point": ["0 um", f"{height} um"], "normal": [0, normal],
            "displacement": ["0 um", f"{moves} um"], "history": RAMP}


def squeezed(count: int, by: float = 0.2, samples: int = 2, **more: Any) -> Case:
    """The disc between two plates, its diameter reduced by a share."""
    move = 1.415 * by
    return piece(DISC, count, samples, plates=[plate("top", 1.415, -1.0, -move), plate("bottom", -1.415, 1.0, move)],
                 **more)


def bent(count: int, pull: float = 200.0, samples: int = 2, **more: Any) -> Case:
    """The bar, held on the left and pulled up on the right by a traction [Pa]."""
    return piece(BAR, count, samples, supports=[{"name": "left", "box": LEFT}],
                 loads=[{"name": "up", "box": RIGHT, "traction": ["0 Pa", f"{pull} Pa"], "history": RAMP}], **more)
