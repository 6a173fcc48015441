"""Physical quantities of a case file: text with a unit in, numbers in the code's units out.

The code's units are µm, µs and Pa.  Hence pN = Pa µm², mass is counted in femtograms, and a density in
kg/m³ keeps its number.  Forces of the plane problem are per unit thickness: pN/µm = Pa µm.
"""

from __future__ import annotations

import re
from functools import cache

import pint

_UNITS = pint.UnitRegistry()
_LENGTH, _TIME, _MASS = 1e6, 1e6, 1e18  # µm per m, µs per s, fg per kg
_QUANTITY = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*?)?\s*$")
# No unit has a number of two digits or a power of a power (9^9^9 would not come back), nor other signs than these.
_NO_UNIT = re.compile(r"\d\s*\d|(\^|\*\*)\s*(?!-?\d)|(\^|\*\*)\s*-?\d\s*(\^|\*\*)|[^\w\s*/^()⁻-]|.{60}", re.DOTALL)


class UnitError(ValueError):
    """A quantity that cannot be read, or has the wrong dimension; the message is for the user."""


@cache
def _scale(unit: str) -> tuple[float, dict]:
    """Factor from `unit` to the code's units, and its dimension as a dict of exponents."""
    text = unit.strip()
    if text.startswith("/"):
        text = "1" + text
    if _NO_UNIT.search(text):
        raise UnitError(f"'{unit}' is not a unit")
    try:
        si = _UNITS.parse_expression(text or "1") * _UNITS.dimensionless
        factor = si.to_base_units()
    except Exception as error:
        raise UnitError(f"'{unit}' is not a unit") from error
    dimension = {k.strip("[]"): v for k, v in factor.dimensionality.items()}
    known = {"length": _LENGTH, "time": _TIME, "mass": _MASS}
    if foreign := set(dimension) - set(known):
        raise UnitError(f"'{unit}' has a dimension that no quantity here has ({', '.join(sorted(foreign))})")
    scale = float(factor.magnitude)
    for name, exponent in dimension.items():
        scale *= known[name] ** exponent
    return _tidy(scale), dimension


def _tidy(scale: float) -> float:
    """`scale` without the last bits that unit arithmetic left: 1000.0000000000001 is 1000."""
    return float(f"{scale:.13g}")


def number(text: str, unit: str) -> float:
    """Value of a quantity such as ``"2.126 kPa"`` in the code's units.

    Parameters
    ----------
    text : str -- a number and its unit.
    unit : str -- a unit of the dimension that is expected, e.g. ``"Pa"``; "" where there is none [-].

    Raises
    ------
    UnitError -- not a number, no unit, an unknown unit, or another dimension.
    """
    match = _QUANTITY.match(text)
    if not match:
        raise UnitError(f"'{text}' is not a number with a unit, such as '{written('1', unit)}'")
    value, given = match.groups()
    if not given and unit:
        raise UnitError(f"'{text}' has no unit; expected one such as '{unit}'")
    try:
        scale, dimension = _scale(given or "")
    except UnitError as error:
        raise UnitError(f"{error}; expected one such as '{unit}'") from None
    if dimension != _scale(unit)[1]:
        raise UnitError(f"'{text}' has the wrong dimension; expected a quantity such as '{written('1', unit)}'")
    result = float(f"{float(value) * scale:.15g}")
    if abs(result) == float("inf"):
        raise UnitError(f"'{text}' is not a finite number")
    return result


def text(value: float, unit: str) -> str:
    """Quantity in the code's units as text with `unit`: the shortest that `number` reads back as the same value."""
    ratio = value / _scale(unit)[0]
    for digits in (12, 15, 17):
        shortest = written(f"{ratio:.{digits}g}", unit)
        if number(shortest, unit) == value:
            break
    return shortest


def written(digits: str, unit: str) -> str:
    """A number and its unit as one writes them: "5 um", "8000 /um^2"."""
    return f"{digits} {unit.removeprefix('1')}".strip()
