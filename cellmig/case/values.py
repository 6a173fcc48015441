"""Values of a case file: read and checked against their declaration, and written."""

from __future__ import annotations

import copy
import dataclasses
import re
from collections.abc import Callable
from functools import partial
from typing import Any

from . import units
from .expression import Expression, is_formula
from .messages import nearest, show, suggest

LARGEST, LEAST = 1e100, 1e-100  # bounds of a number whose cube, and that of its inverse, are finite


def declared(cls: type) -> dict[str, dataclasses.Field]:
    """Fields of a declared class by name."""
    return {f.name: f for f in dataclasses.fields(cls)}


def required(field: dataclasses.Field) -> bool:
    """Whether a case has to give the field, as it has no default."""
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


def type_name(field: dataclasses.Field) -> str:
    """First word of the type of a field: float, int, bool, str, tuple …"""
    return re.match(r"\w+", getattr(field.type, "__name__", str(field.type))).group()


def in_table(field: dataclasses.Field, unit: Any) -> dataclasses.Field:
    """The field in a table with a key `unit`, if that is not None: lengths that it scales are pure numbers."""
    if unit is None or not field.metadata.get("scaled"):
        return field
    field = copy.copy(field)
    field.metadata = {**field.metadata, "unit": "", "minimum": None, "maximum": None}
    return field


def shape_in(field: dataclasses.Field, dimension: int) -> tuple:
    """Shape of the values of a field in a case of this `dimension`."""
    known = {"d": dimension, "d-1": dimension - 1}
    return tuple(known.get(n, n) for n in field.metadata.get("shape", ()))


def default_in(field: dataclasses.Field, dimension: int) -> Any:
    """Default of a field in a case of this `dimension`: vectors and matrices are zero."""
    if "d" not in field.metadata.get("shape", ()) or not isinstance(field.default, tuple) or not field.default:
        return field.default
    zeros: Any = 0.0
    for n in reversed(shape_in(field, dimension)):
        zeros = (zeros,) * n
    return zeros


def read(field: dataclasses.Field, value: Any, dimension: int = 2) -> Any:
    """Value of a declared field, in the code's units, from the `value` in a case of this `dimension`.

    Raises ValueError where it is not allowed; the message is for the user.
    """
    meta = field.metadata
    if isinstance(value, str) and value in meta.get("words", ()):
        return value
    if "reader" in meta:
        return meta["reader"](value)
    if "unit" in meta:
        return _nested(meta, shape_in(field, dimension), value, partial(_quantity, dimension=dimension))
    if "items" in meta:
        return _nested(meta, (2 if meta["items"] == "pair" else None,), value, _item)
    return {"bool": _flag, "int": _count, "str": _word, "float": _quantity}[type_name(field)](meta, value)


def write(field: dataclasses.Field, value: Any) -> Any:
    """Value as in a case file: the inverse of `read`."""
    if isinstance(value, tuple | list):
        return [write(field, item) for item in value]
    if isinstance(value, Expression):
        return value.text
    if "reader" in field.metadata:
        return value.written()
    if isinstance(value, float) and field.metadata.get("unit"):
        return units.text(value, field.metadata["unit"])
    return value


def example(field: dataclasses.Field) -> str:
    """Example of a value of a field, in TOML."""
    plain = '"…"' if "reader" in field.metadata else {"str": '"…"', "bool": "true"}.get(type_name(field), "1")
    return _example(field.metadata, shape_in(field, 2), plain)


def _example(meta: Any, shape: tuple, plain: str = "1") -> str:
    if "items" in meta:
        return {"cell": '["Cell-1"]', "pair": '["Cell-1", "Cell-2"]'}.get(meta["items"], "[1]")
    unit = meta.get("unit", "")
    leaf = f'"{units.written("1", unit)}"' if unit else plain
    for n in reversed(shape):
        leaf = "[" + ", ".join([leaf] * (n or 1)) + "]"
    return leaf


def _nested(meta: Any, shape: tuple, value: Any, leaf: Callable) -> Any:
    """Nested tuples of a shape, in which None is any length."""
    if not shape:
        return leaf(meta, value)
    if not isinstance(value, list | tuple) or shape[0] not in (None, len(value)):
        raise ValueError(f"expects a list such as {_example(meta, shape)}, not {show(value)}")
    return tuple(_nested(meta, shape[1:], item, leaf) for item in value)


def _quantity(meta: Any, value: Any, dimension: int = 2) -> Any:
    """A quantity or, without a unit, a pure number; a word or a formula where the field allows one."""
    unit = meta.get("unit", "")
    if isinstance(value, str) and value in meta.get("words", ()):
        return value
    if meta.get("formula") and is_formula(value):
        return Expression(value, unit, dimension, bool(meta.get("timed")))
    plain = isinstance(value, int | float) and not isinstance(value, bool)
    or_word = "".join(f" or '{word}'" for word in meta.get("words", ()))
    if unit and isinstance(value, str):
        try:
            number = units.number(value, unit)
        except units.UnitError as error:
            raise ValueError(f"{error}{or_word}") from None
    elif unit and plain:
        raise ValueError(f'has no unit: write "{units.written(show(value), unit)}" if that is meant{or_word}')
    elif unit:
        raise ValueError(f"expects a number with a unit, such as {_example(meta, ())}{or_word}, not {show(value)}")
    elif not plain:
        raise ValueError(f"expects a pure number such as 1.5, without quotes or unit{or_word}, not {show(value)}")
    else:
        number = value
    if not (abs(number) <= LARGEST and (number == 0 or abs(number) >= LEAST)):  # false for NaN
        raise ValueError(f"expects a number of a size that can be computed with, not {show(value)}")
    number = float(number)
    _within(meta, number, value)
    return number


def _count(meta: Any, value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool):
        raise ValueError(f"expects a whole number such as {meta.get('minimum') or 1}, not {show(value)}")
    _within(meta, value, value)
    return value


def _flag(meta: Any, value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"expects true or false, not {show(value)}")
    return value


def _word(meta: Any, value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"expects text in quotes, not {show(value)}")
    if "choices" in meta and value not in meta["choices"]:
        raise ValueError(f"cannot be {show(value)}{suggest(value, meta['choices'])}")
    if value not in meta.get("known", (value,)) and (near := nearest(value, meta["known"], 0.75)):
        raise ValueError(f"cannot be {show(value)}; did you mean '{near}'?")
    return value


def _item(meta: Any, value: Any) -> Any:
    """Item of a list of names or counts, or of a pair of lists of names."""
    if meta["items"] == "count":
        return _count({"minimum": 1}, value)
    if meta["items"] == "pair" and isinstance(value, list | tuple):
        return _nested({"items": "cell"}, (None,), value, _item)
    return _word({}, value)


def _within(meta: Any, number: float, value: Any) -> None:
    """Raise ValueError unless a number, in the code's units, is within its bounds, which are declared in its unit."""
    scale = units.number(f"1 {meta['unit']}", meta["unit"]) if meta.get("unit") else 1
    limits = (meta.get(k) for k in ("above", "minimum", "maximum"))
    above, minimum, maximum = (None if limit is None else limit * scale for limit in limits)
    if ((above is not None and not number > above) or (minimum is not None and not number >= minimum)
            or (maximum is not None and not number <= maximum)):
        raise ValueError(f"must be {bounds(meta)}, not {value if isinstance(value, str) else show(value)}")


def bounds(meta: Any) -> str:
    """Declared bounds as text, with the unit: "> 0 um", ">= 0 and <= 1"."""
    signs = (("above", ">"), ("minimum", ">="), ("maximum", "<="))
    limits = [(sign, units.written(str(meta[k]), meta.get("unit", ""))) for k, sign in signs if meta.get(k) is not None]
    return " and ".join(f"{sign} {limit}" for sign, limit in limits)
