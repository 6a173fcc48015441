"""Registry of laws: a law is a frozen dataclass whose declaration serves case files, schema, tests and docs."""

from __future__ import annotations

import dataclasses
import importlib
import pkgutil
from collections.abc import Callable
from typing import Any

_LAWS: dict[str, dict[str, type]] = {}


def law(kind: str, name: str) -> Callable[[type], type]:
    """Class decorator that registers a law of a `kind`, such as "material" or "shape", under a `name`."""

    def register(cls: type) -> type:
        cls = dataclasses.dataclass(frozen=True, kw_only=True)(cls)
        cls.kind, cls.law = kind, name
        _LAWS.setdefault(kind, {})[name] = cls
        return cls

    return register


def kinds() -> list[str]:
    """Kinds of the registered laws."""
    return list(_LAWS)


def laws(kind: str) -> dict[str, type]:
    """All registered laws of a kind, by name."""
    return dict(sorted(_LAWS.get(kind, {}).items()))


def restore(known: dict[str, dict[str, type]]) -> None:
    """Reset the registry to the laws `known`, by kind as `laws` returns them."""
    _LAWS.clear()
    _LAWS.update({kind: dict(named) for kind, named in known.items()})


def discover(package: Any) -> None:
    """Import all modules of `package`, which registers their laws; a new law is a new file."""
    for module in pkgutil.iter_modules(package.__path__, package.__name__ + "."):
        importlib.import_module(module.name)


def quantity(unit: str, doc: str, default: Any = dataclasses.MISSING, *, above: float | None = None,
             minimum: float | None = None, maximum: float | None = None, shape: tuple = (),
             words: tuple = (), formula: bool = False, formerly: str = "") -> Any:
    """Dataclass field for a parameter with a unit; its value is a float in the code's units.

    Parameters
    ----------
    unit : str -- unit in case files, such as "kPa"; "" for a pure number [-].
    doc : str -- meaning and symbol, in one line.
    default : str or float -- as in a case file ("10 nm"); None if the parameter may be absent.
    above, minimum, maximum : float -- bounds in `unit`: exclusive, inclusive, inclusive.
    shape : tuple -- () for a number, (2,) for two, ("d",) for a vector, one for each dimension of the case, ("d-1",)
        for one along the substrate, (None, "d") for any number of vectors, as nested tuples.
    words : tuple of str -- words that are allowed in place of a number, such as ("auto",).
    formula : bool -- whether an `Expression` of x and y is allowed in place of a number.
    formerly : str -- former key, which a message replaces by the new one.
    """
    return parameter(doc, default, unit=unit, above=above, minimum=minimum, maximum=maximum, shape=shape, words=words,
                     formula=formula, formerly=formerly)


def parameter(doc: str, default: Any = dataclasses.MISSING, **metadata: Any) -> Any:
    """Dataclass field for a parameter of any other type (int, bool, str, tuple).

    Metadata
    --------
    choices : tuple -- all allowed words.
    known : tuple -- usual words: a similar word is refused as a misspelling, any other is allowed.
    above, minimum, maximum : bounds of an int.
    items : "cell" for a tuple of names of cells, "pair" for two such tuples, "count" for one of counts.
    refers : "material" or "field" for a string that names one.
    or_file : function that reads the value from a file whose name is given instead.
    scaled : whether lengths are pure numbers if the table has a `unit`.
    reader : function that makes the value from that in the case; its method `written()` is the inverse.
    as_type : JSON type, or types, of what such a function reads, if it is no table.
    timed : whether formulas may depend on the time.
    or_name : "field" for a name of one that may be given instead.
    formerly : former key.
    """
    from .units import number

    unit = metadata.get("unit", "")
    if isinstance(default, str) and unit and default not in metadata.get("words", ()):
        default = number(default, unit)
    return dataclasses.field(default=default, metadata={"doc": doc, **metadata})
