"""Sections of a case on what is around the cells: what varies along the substrate, exchange with fields."""

# ruff: noqa: RUF009 -- parameter() and its kin return dataclass fields
from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .registry import parameter, quantity


@dataclass(frozen=True, kw_only=True)
class Exchange:
    """What the surfaces of some cells secrete into a diffusing field, and take up from it."""

    field: str = parameter("name of a field whose law is \"diffusing\"", refers="field")
    cells: tuple = parameter("names of cells; by default all", (), items="cell")
    secretion: float = quantity("1/um^2/s", "molecules that they secrete", "0 /um^2/s", minimum=0)
    uptake: float = quantity("1/um^2/s", "molecules u that they take up at most: u c/(c + K)", "0 /um^2/s", minimum=0)
    half: float | None = quantity("nM", "concentration K at which uptake is half of the largest", None, above=0)

    def __post_init__(self) -> None:
        """Check the rates.

        Raises ValueError where there are none, or a concentration is missing; the message is for the user.
        """
        if not self.secretion and not self.uptake:
            raise ValueError("expects secretion or uptake, such as secretion = \"5 /um^2/s\"")
        if bool(self.uptake) != (self.half is not None):
            raise ValueError("uptake and half belong together: u c/(c + K) with uptake u and half K")


@dataclass(frozen=True, kw_only=True)
class Ground:
    """What varies along the substrate."""

    stiffness: Any = parameter("Young's modulus E of the substrate; a formula of the place, or a name of [fields.NAME]",
                               None, unit="Pa", above=0, formula=True, or_name="field")
    ligand: Any = parameter("density of bonds over that of adhesion.substrate, from 0 to 1; a formula of the place, or "
                            "a name of [fields.NAME]", None, unit="", minimum=0, maximum=1, formula=True,
                            or_name="field")
    response: Any = parameter("factor of the push by the stiffness, such as { law = \"saturating\", "
                              "half = \"10 kPa\" }", None, kind="response", default_law="saturating", optional=True)

    def __post_init__(self) -> None:
        """Check the response.

        Raises ValueError where it has no stiffness; the message is for the user.
        """
        if self.response is not None and self.stiffness is None:
            raise ValueError("response: is to a stiffness, which is missing")
