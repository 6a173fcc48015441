"""Levels of a field, in a unit that the field decides."""

from __future__ import annotations

from dataclasses import MISSING, dataclass
from typing import Any

from . import units
from .expression import unit_of
from .messages import show
from .registry import parameter


@dataclass(frozen=True)
class Level:
    """A positive level of a field.

    Attributes
    ----------
    text : float or str -- as in the case file: "10 nM", or a pure number [-].
    unit : str -- its unit, "" for a pure number.
    value : float -- the level in the code's units [unit of the field].
    """

    text: float | str
    unit: str
    value: float

    @classmethod
    def of(cls, given: Any) -> Level:
        """Level from its value in a case file.

        Raises ValueError where it is none; the message is for the user.
        """
        if not isinstance(given, str | int | float) or isinstance(given, bool):
            raise ValueError(f"expects a level of the field, such as \"10 nM\", not {show(given)}")
        try:
            unit = unit_of(given) if isinstance(given, str) else ""
        except ValueError:
            raise ValueError(f"expects a level of the field, such as \"10 nM\", not {show(given)}") from None
        value = units.number(given, unit) if isinstance(given, str) else float(given)
        if not 0.0 < value < float("inf"):
            raise ValueError(f"must be > 0, not {show(given)}")
        return cls(given, unit, value)

    def written(self) -> float | str:
        """The level as in a case file, with its unit."""
        return self.text


def level(doc: str, default: Any = MISSING) -> Any:
    """Dataclass field for a `Level`: `doc` is its meaning and symbol, in one line."""
    return parameter(doc, default, reader=Level.of, as_type=["string", "number"])
