"""What a law is: a frozen dataclass, declared once, from which case files, schema, tests and docs take it."""

from __future__ import annotations

import dataclasses
import importlib
import pkgutil
from collections.abc import Callable
from typing import Any

_LAWS: dict[str, dict[str, type]] = {}


def law(kind: str, name: str) -> Callable[[type], type]:
    """Class decorator: register a law of `kind` ("material", "adhesion", "protrusion", "shape", …) as `name`."""

    def register(cls: type) -> type:
        cls = dataclasses.dataclass(frozen=True, kw_only=True)(cls)
        cls.kind, cls.law = kind, name
        _LAWS.setdefault(kind, {})[name] = cls
        return cls

    return register


def kinds() -> list[str]:
    """Kinds of which there are laws."""
    return list(_LAWS)


def laws(kind: str) -> dict[str, type]:
    """All registered laws of a kind, by name."""
    return dict(sorted(_LAWS.get(kind, {}).items()))


def restore(known: dict[str, dict[str, type]]) -> None:
    """Forget all laws but those `known`, as `laws` gave them by kind."""
    _LAWS.clear()
    _LAWS.update({kind: dict(named) for kind, named in known.items()})


def discover(package: Any) -> None:
    """Import every module of `package`, so that its laws are registered: a new law is a new file."""
    for module in pkgutil.iter_modules(package.__path__, package.__name__ + "."):
        importlib.import_module(module.name)


def quantity(unit: str, doc: str, default: Any = dataclasses.MISSING, *, above: float | None = None,
             minimum: float | None = None, maximum: float | None = None, shape: tuple = (),
             words: tuple = (), formula: bool = False, formerly: str = "") -> Any:
    """A parameter with a unit: dataclass field whose value is a float in the code's units.

    Parameters
    ----------
    unit : str -- the unit that users read and write, e.g. "kPa"; "" for a pure number [-].
    doc : str -- one line: meaning, symbol.
    default : str or float -- as in a case file ("10 nm"), or None if it may be absent.
    above, minimum, maximum : float -- bounds in `unit` (exclusive, inclusive, inclusive).
    shape : tuple of int -- () for one number, (2,) a vector, (None, 2) any number of vectors: nested tuples.
    words : tuple of str -- what may stand in place of a number, e.g. ("auto",).
    formula : bool -- whether an `Expression` of x and y may stand in place of a number.
    formerly : str -- the key that a case had in its place before: who writes it is told the new one.
    """
    return parameter(doc, default, unit=unit, above=above, minimum=minimum, maximum=maximum, shape=shape, words=words,
                     formula=formula, formerly=formerly)


def parameter(doc: str, default: Any = dataclasses.MISSING, **metadata: Any) -> Any:
    """A parameter of any other type (int, bool, str, tuple), with metadata that the case reader obeys.

    `choices=(…)` lists what is allowed, `known=(…)` what is usual (near misses are refused, other names are not);
    `above`, `minimum`, `maximum` bound an int; `items="cell"` makes a tuple one of cell names, "count" of counts;
    `or_file` reads the file whose name stands for a value; `scaled` is for lengths that are pure numbers if the table
    has a `unit`; `formerly` is its former key; `reader` makes that from what stands in the case, and
    `written()` is its inverse; `refers="material"` makes a string the name of a material.
    """
    from .units import number

    unit = metadata.get("unit", "")
    if isinstance(default, str) and unit and default not in metadata.get("words", ()):
        default = number(default, unit)
    return dataclasses.field(default=default, metadata={"doc": doc, **metadata})
