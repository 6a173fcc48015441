"""`numerics.accuracy`: the cheapest resolution whose error, measured on a scene of the same kind, is below it."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

from . import registry, units
from .messages import show
from .source import Source
from .values import declared

MEASURED = Path(__file__).with_name("accuracy.json")  # written by `cellmig bench --error`
PLACES = {"per_cell": ("particles", "per_cell"), "dilation": ("particles", "dilation"),
          "surface_refinement": ("particles", "surface_refinement"), "step_factor": ("time", "step_factor")}


@cache
def measurements() -> dict[str, Any]:
    """What was measured, by kind of scene: the quantities "of" which, its "origin", and "points".

    A point is an error [-], the CPU time [s] that it costs and the setting.
    """
    return json.loads(MEASURED.read_text(encoding="utf-8"))


def fraction(text: Any) -> float:
    """An accuracy [-] from "1 %" or 0.01.

    Raises ValueError for what is none; the message is for the user.
    """
    text = units.plain(text) if isinstance(text, str) else text
    percent = isinstance(text, str) and text.strip().endswith("%")
    try:
        value = float(text.strip()[:-1]) / 100.0 if percent else float(text)
    except (TypeError, ValueError):
        value = float("nan")
    if isinstance(text, bool) or not 0.0 < value < 1.0:
        raise ValueError(f'expects an accuracy such as "20 %", not {show(text)}')
    return value


def kind_of(data: dict[str, Any]) -> str | None:
    """Kind of scene that the tables of a case describe; None if that kind has not been measured."""
    cells, materials = data.get("cells"), data.get("materials")
    try:
        used = {cell[key] for cell in cells for key in ("material", "nucleus") if key in cell}
        known = registry.laws("material")
        fluid = {"reduced_bulk_modulus" in declared(known[materials[name]["law"]]) for name in used}
        adhesion = data.get("adhesion", {})
        on_substrate, touching = "substrate" in adhesion, "cells" in adhesion and _several(cells)
    except (TypeError, KeyError, AttributeError):
        return None  # the reader reports what is wrong
    if on_substrate:
        several = "cells with a cortex on a substrate" if "cortex" in data else "cells on a substrate"
        kind = (several if touching else "cell on substrate") if True in fluid else None
    else:
        kind = {(True,): "fluid", (False,): "elastic"}.get(tuple(fluid)) if not touching else None
    if data.get("dimension", 2) == 3:  # where cells that touch were not measured
        return f"{kind} in space" if kind and not touching else None
    return kind


def _several(cells: list) -> bool:
    return len(cells) > 1 or any(n != 1 for cell in cells for n in cell.get("repeat", [1]))


def pick(measured: dict[str, Any], kind: str | None, accuracy: float) -> dict[str, Any]:
    """The cheapest measurement of a kind whose error is at most the accuracy [-].

    Raises ValueError where there is none; the message is for the user.
    """
    if kind not in measured:
        raise ValueError(f"no scene of this kind{f' ({kind})' if kind else ''} was measured; there are: "
                         f"{', '.join(measured)}")
    own = measured[kind]["points"]
    good = [p for p in own if p["error"] <= accuracy]
    if not good:
        best = min(own, key=lambda p: p["error"])
        raise ValueError(f"{100 * accuracy:g} % was not measured on this kind of scene ({kind}): the least is "
                         f"{100 * best['error']:g} %, with {best['per_cell']} particles a cell: ask for that or more")
    return min(good, key=lambda p: p["cost_s"])


def fill(source: Source) -> str:
    """Set the resolution of a case that has an accuracy; returns what was set, "" without an accuracy.

    Keys that the case gives itself are not changed; the error is then known only if they have the values to be chosen.
    """
    data, path = source.data, ("numerics", "accuracy")
    wanted = data.get("numerics", {}).get("accuracy") if isinstance(data.get("numerics", {}), dict) else None
    if wanted is None:
        return ""
    try:
        accuracy, kind = fraction(wanted), kind_of(data)
        chosen = pick(measurements(), kind, accuracy)
    except ValueError as error:
        source.reject(path, str(error))
        return ""
    data["numerics"]["accuracy"] = f"{100 * accuracy:g} %"
    new, unchanged = [], []
    for key, place, value in _choices(data, chosen):
        table = data
        for name in place[:-1]:
            table = table.setdefault(name, {}) if isinstance(table, dict) else None
        if not isinstance(table, dict):
            continue
        given = table.get(place[-1], table.get("spacing") if key == "per_cell" else None)
        if given is None:
            table[place[-1]] = value
            new.append(f"{key} = {value}")
        elif not _same(given, value):
            unchanged.append(f"{key} = {given} (measured: {value})")
    found = measurements()[kind]
    text = [f"{100 * accuracy:g} %, {kind}: measured {100 * chosen['error']:g} % ({found['origin']['date']}), of "
            f"{found['of']}"]
    text += [f"chosen {', '.join(new)}"] * bool(new)
    text += [f"not changed, so that the error may differ: {', '.join(unchanged)}"] * bool(unchanged)
    return "; ".join(text)


def _choices(data: dict[str, Any], chosen: dict[str, Any]) -> list[tuple[str, tuple, Any]]:
    """Name, path in the case and value of each key that an accuracy sets."""
    rows = [(key, place, chosen[key]) for key, place in PLACES.items() if key in chosen]
    for name, material in data["materials"].items() if "modulus" in chosen else ():
        if "reduced_bulk_modulus" in declared(registry.laws("material")[material["law"]]):
            place = ("materials", name, "reduced_bulk_modulus")
            rows.append((place[-1], place, f"{chosen['modulus']:g} MPa"))
    return rows


def _same(given: Any, value: Any) -> bool:
    """Whether two values of a case are equal, possibly in different units."""
    try:
        return units.number(given, "Pa") == units.number(value, "Pa") if isinstance(value, str) else given == value
    except (units.UnitError, TypeError):
        return given == value
