"""The terms of equation (2) that a scene has."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Terms:
    """What a scene lacks is None, "none" or False; it is not compiled, stored or exchanged.

    substrate, contact, protrusion, cortex, friction : laws or None;  director : "none", "frozen" or "relaxing";
    active : whether ζ acts;  stabilised, bulk_damped, stiffened : the numerical viscosities and stiffness;
    acceleration : of the body force (2,) [µm/µs²] or None;  histories : time laws of supports, loads and plates,
    None if there are no such;  single : whether coefficients of neighbours are in single precision;
    skipped : why a term is absent, by its name, for the log.
    """

    substrate: Any = None
    contact: Any = None
    protrusion: Any = None
    cortex: Any = None
    friction: Any = None
    director: str = "none"
    active: bool = False
    stabilised: bool = True
    bulk_damped: bool = True
    stiffened: bool = False
    acceleration: tuple | None = None
    histories: tuple | None = None
    single: bool = False
    skipped: dict = field(default_factory=dict)
