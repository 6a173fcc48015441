"""Conversion of quantities, such as "10 nm", to numbers in the code's units and back.

The code's units are µm, µs and Pa.  Forces are then in pN = Pa µm², masses in fg = Pa µm µs², and a density has the
same value as in kg/m³.  In the plane, forces are per unit thickness: pN/µm = Pa µm.  Amounts of substance are numbers
of molecules, so that a concentration of 1 nM is 0.602 /µm³.
"""

from __future__ import annotations

import re
import sys
import unicodedata
from functools import cache

sys.modules.setdefault("pandas", None)  # Pint 0.19 would import it, which is a quarter of the time a start takes
import pint  # noqa: E402

if sys.modules["pandas"] is None:
    del sys.modules["pandas"]

# Units of SYMBOLS and _NAMES: to read all that Pint knows takes an eighth of a second at each start.
_DEFINITIONS = """
atto- = 1e-18 = a-; femto- = 1e-15 = f-; pico- = 1e-12 = p-; nano- = 1e-9 = n-; micro- = 1e-6 = u-; milli- = 1e-3 = m-
centi- = 1e-2 = c-; deci- = 1e-1 = d-; hecto- = 1e2 = h-; kilo- = 1e3 = k-; mega- = 1e6 = M-; giga- = 1e9 = G-
meter = [length] = m = metre; second = [time] = s; gram = [mass] = g; mole = [substance] = mol
radian = [] = rad; degree = 0.017453292519943295 * radian = deg
minute = 60 * second = min; hour = 60 * minute = h; day = 24 * hour = d; hertz = 1 / second = Hz
newton = kilogram * meter / second ** 2 = N; pascal = newton / meter ** 2 = Pa; joule = newton * meter = J
liter = 1e-3 * meter ** 3 = l = L = litre; molar = mole / liter = M; poise = 0.1 * pascal * second = P
angstrom = 1e-10 * meter = Å; micron = 1e-6 * meter; dyne = 1e-5 * newton = dyn; erg = 1e-7 * joule
electron_volt = 1.602176634e-19 * joule = eV; dalton = 1.66053906660e-27 * kilogram = Da
bar = 1e5 * pascal; atmosphere = 101325 * pascal = atm; psi = 6894.757293168361 * pascal
millimeter_Hg = 133.322387415 * pascal = mmHg; centimeter_H2O = 98.0665 * pascal = cmH2O
"""
_UNITS = pint.UnitRegistry([line.strip() for line in _DEFINITIONS.strip().replace(";", "\n").splitlines()])
_LENGTH, _TIME, _MASS = 1e6, 1e6, 1e15  # µm per m, µs per s, fg per g
_MOLECULES = 6.02214076e23  # in a mole
_QUANTITY = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*?)?\s*$")
# Text that is no unit: numbers with blanks, powers of powers (9^9^9 would take for ever), other characters.
_NO_UNIT = re.compile(r"\d\s*\d|(\^|\*\*)\s*(?!-?\d)|(\^|\*\*)\s*-?\d\s*(\^|\*\*)|[^\w\s*/^()-]|.{60}", re.DOTALL)

# Symbols of units, and the prefixes that each may have.  Pint knows a thousand more units, such as px (1/96 inch), kT
# (kilotesla), kt (knot), ma (1/1000 year), c (speed of light), Mm and PN, which would be misunderstood.
SYMBOLS = {"m": "f p n u m c d k", "s": "f p n u m", "g": "f p n u m k", "N": "f p n u m k", "Pa": "n u m h k M G",
            "J": "a f p n u m k", "eV": "m k", "L": "f p n u m", "l": "f p n u m", "P": "m c", "Hz": "m k M G",
            "bar": "m", "rad": "m", "Da": "k", "M": "f p n u m", "mol": "f p n u m",
            "dyn": "", "erg": "", "atm": "", "mmHg": "", "cmH2O": "", "psi": "",
            "min": "", "h": "", "d": "", "deg": "", "Å": "", "angstrom": "", "micron": "", "microns": ""}
_NAMES = ("meter", "metre", "second", "gram", "newton", "pascal", "joule", "liter", "litre", "hertz", "radian",
          "degree", "dyne", "minute", "hour", "day", "dalton", "poise", "electron_volt", "atmosphere")
_PREFIXES = ("femto", "pico", "nano", "micro", "milli", "centi", "deci", "hecto", "kilo")
_PIXEL = "is no length: say how large a pixel is, such as unit = \"0.1625 um\" beside an outline in pixels"
_THERMAL = "is no unit of energy here: 1 k_B T is 4.1 pN nm at 25 °C, 4.3 pN nm at 37 °C"
_TRAPS = {**dict.fromkeys(("px", "pixel", "pixels", "css_pixel", "dot", "dots"), _PIXEL),
          **dict.fromkeys(("kT", "kBT", "kbT", "k_BT", "kB", "k_B"), _THERMAL)}

_SIGNS = {ord(one): plain for many, plain in (
    ("µμ", "u"), ("−–‐‑‒﹣", "-"), ("·⋅∙×⋆", "*"), ("∕", "/"), ("\u200b\u200e\u2060\ufeff", "")) for one in many}
_RAISED = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁺⁻", "0123456789+-")
_WIDE = re.compile("[\uff01-\uff5e\u3371-\u33df\u212b]")  # wide letters, ㎛ and its like, the sign of the angstrom
_POWER = re.compile("[⁺⁻]?[⁰¹²³⁴⁵⁶⁷⁸⁹]+")


@cache
def _known() -> frozenset[str]:
    """All symbols and names of units that are allowed in a case."""
    short = {prefix + base for base, prefixes in SYMBOLS.items() for prefix in ["", *prefixes.split()]}
    long = {prefix + base for base in _NAMES for prefix in ["", *_PREFIXES]} | {"megapascal", "gigapascal"}
    return frozenset(short | long | {f"{name}s" for name in long})


def plain(text: str) -> str:
    """A quantity or unit in ASCII, such as "5 um**2", for any form of mu, minus, dot, blank, power, wide letter."""
    if text.isascii():
        return text
    text = _POWER.sub(lambda raised: "**" + raised.group().translate(_RAISED).lstrip("+"), text)
    text = "".join(" " if c.isspace() else unicodedata.normalize("NFKC", c) if _WIDE.match(c) else c for c in text)
    return text.translate(_SIGNS)


class UnitError(ValueError):
    """A quantity that cannot be read or has the wrong dimension; the message is for the user."""


@cache
def _scale(unit: str) -> tuple[float, dict]:
    """Factor from `unit` to the code's units, and the dimension as a dict of exponents."""
    text = plain(unit).strip()
    if text.startswith("/"):
        text = "1" + text
    if _NO_UNIT.search(text):
        raise UnitError(f"'{unit}' is not a unit")
    for word in re.findall(r"[^\W\d]\w*", text):
        if word not in _known():
            raise UnitError(_refusal(unit, word))
    try:
        si = _UNITS.parse_expression(text or "1") * _UNITS.dimensionless
        factor = si.to_base_units()
    except Exception as error:
        raise UnitError(f"'{unit}' is not a unit") from error
    dimension = {k.strip("[]"): v for k, v in factor.dimensionality.items()}
    known = {"length": _LENGTH, "time": _TIME, "mass": _MASS, "substance": _MOLECULES}
    scale = float(factor.magnitude)
    for name, exponent in dimension.items():
        scale *= known[name] ** exponent
    dimension.pop("substance", None)  # a number
    return _tidy(scale), dimension


def _refusal(unit: str, word: str) -> str:
    """Message about a `word` in a unit that is no unit here."""
    if word in _TRAPS:
        return f"'{word}' {_TRAPS[word]}"
    others = sorted(known for known in _known() if known.lower() == word.lower())  # such as mm for Mm
    return f"'{unit}' is not a unit" + (f" here; did you mean {' or '.join(map(repr, others))}?" if others else "")


def _tidy(scale: float) -> float:
    """`scale` without rounding errors of unit arithmetic: 1000.0000000000001 becomes 1000."""
    return float(f"{scale:.13g}")


def number(text: str, unit: str) -> float:
    """Value, in the code's units, of a quantity such as "2.126 kPa"; `unit` has the expected dimension, "" for [-].

    Raises UnitError where `text` is no number, or its unit is missing, unknown or of another dimension.
    """
    match = _QUANTITY.match(plain(text))
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


def same_kind(unit: str, other: str) -> bool:
    """Whether two units are of one kind, so that one can stand for the other.  Raises UnitError for what is none."""
    return _scale(unit)[1] == _scale(other)[1]


def unit_size(quantity: str) -> float:
    """Size, in the code's units, of the unit that a quantity such as "6 h" has; call it after `number`."""
    match = _QUANTITY.match(plain(quantity))
    return _scale(match.group(2) or "" if match else "")[0]


def text(value: float, unit: str) -> str:
    """Shortest text, in `unit`, that `number` converts to `value`, which is in the code's units."""
    ratio = value / _scale(unit)[0]
    for digits in (12, 15, 17):
        shortest = written(f"{ratio:.{digits}g}", unit)
        if number(shortest, unit) == value:
            break
    return shortest


def written(digits: str, unit: str) -> str:
    """Text of a number and its unit: "5 um", "8000 /um^2"."""
    return f"{digits} {unit.removeprefix('1')}".strip()
