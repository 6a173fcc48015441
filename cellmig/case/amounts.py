"""Checks of fields, of the substrate and of cues: kinds of units, and values where the cells are at the start."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from . import units
from .environment import Ground
from .expression import Expression
from .messages import show
from .source import Source
from .values import declared

ROUNDING = 1.0 + 1e-9  # by which a formula may exceed the largest amount
OUTLINE = 24  # points of each cell at which values are tried, at least
INSIDE = 50  # volumes along an axis at which the start of a field that diffuses is tried, at most
MOST = 10  # of the gain of alignment, with which polarities do not yet overshoot from one knot to the next [-]
OF_SUBSTRATE = ("stiffness", "ligand")  # names under which cues find what is given there


def amounts(source: Source, found: dict[str, Any]) -> None:
    """Note mistakes in the fields and the substrate of a case of which the parts are `found`."""
    fields, ground, cells = found["fields"], found["ground"], [cell for cell, _ in found["cells"]]
    points = None
    if cells and (fields or ground is not None):  # in space a cell has thousands
        points = np.concatenate([np.array(cell.centre) + cell.shape.outline(OUTLINE) for cell in cells])
    for name, law in fields.items():
        if not re.fullmatch(r"[A-Za-z][\w-]*", name):
            source.reject(("fields", name), "names columns and figures: expects letters, digits, - and _ alone")
        if name in OF_SUBSTRATE and getattr(ground, name, None) != name:
            source.reject(("fields", name), f"is the name of what substrate.{name} gives: take another name, or write "
                                            f"{name} = \"{name}\" in [substrate]")
        for axis, _ in getattr(getattr(law, "file", None), "places", ()):
            if found["dimension"] == 2 and axis == "z":
                source.reject(("fields", name, "file"), "has a column z, but the case has two dimensions, x and y")
        if points is not None and isinstance(formula := getattr(law, "formula", None), Expression):
            _values(source, formula, points, ("fields", name, "formula"))
        if isinstance(formula := getattr(law, "start", None), Expression):
            _values(source, formula, _inside(law.box, law.volumes), ("fields", name, "start"), where="in the box")
    if ground is None:
        return
    if found["substrate"] is None and ground.ligand is not None:
        source.reject(("substrate", "ligand"), "is that of the bonds to the substrate, but there is no "
                                               "[adhesion.substrate]")
    for key in OF_SUBSTRATE:
        _ground(source, key, getattr(ground, key), fields, points)


def exchanges(source: Source, found: dict[str, Any]) -> None:
    """Note exchange with fields that do not diffuse, or whose box a cell is not in, and fields without a time."""
    cells = {cell.name: cell for cell, _ in found["cells"]}
    diffusing = {name: law for name, law in found["fields"].items() if getattr(law, "law", "") == "diffusing"}
    if getattr(found["time"], "integrator", "") == "static":
        for name in diffusing:
            source.reject(("fields", name), "diffuses in time, of which a static case has none")
    for e, path in found["exchange"]:
        if e.field not in diffusing:
            if found["fields"].get(e.field) is not None:
                source.reject((*path, "field"), f"'{e.field}' has the law \"{found['fields'][e.field].law}\": cells "
                                                "exchange with fields whose law is \"diffusing\"")
            continue
        low, high = np.array(diffusing[e.field].box)
        for cell in (cells[name] for name in e.cells or cells if name in cells):
            outline = np.array(cell.centre) + cell.shape.outline(OUTLINE)
            if ((outline < low) | (outline > high)).any():
                source.reject(("fields", e.field, "box"), f"does not contain '{cell.name}', which exchanges with the "
                                                          "field")
                break


def cues(source: Source, found: dict[str, Any]) -> None:
    """Note cues of cells without a polarity to turn, levels of another kind than the field of a cue, and alignment
    that overshoots.
    """
    if found["cues"] and "polarity" not in source.data:
        source.reject(("cues",), "turn the polarity of cells, of which there is none: add [polarity], such as "
                                 'persistence = "10 min"')
    known = {key: declared(Ground)[key].metadata["unit"] for key in OF_SUBSTRATE}
    known |= {name: law.unit for name, law in found["fields"].items() if law is not None}
    push, polarity = found["protrusion"], found["polarity"]
    polar = () if push is None or polarity is None else polarity.cells or push.cells
    for cue, path in found["cues"]:
        if polar and (idle := [name for name in cue.cells if name not in polar]):
            source.reject((*path, "cells"), f"'{idle[0]}' has no polarity to turn: name it in "
                          + ("polarity.cells" if idle[0] in push.cells else "protrusion.cells"))
        name, level = getattr(cue, "field", None), getattr(cue, "affinity", None)
        if level is not None and name in known and not units.same_kind(level.unit, known[name]):
            such = f"a level such as {show(units.written('1', known[name]))}" if known[name] else "a pure number"
            source.reject((*path, "affinity"), f"expects {such}, of the kind of '{name}', not {show(level.text)}")
    aligning = [(cue, path) for cue, path in found["cues"] if getattr(cue, "law", "") == "neighbours"]
    for name in [cell.name for cell, _ in found["cells"]]:
        turning = [(cue.gain, path) for cue, path in aligning if not cue.cells or name in cue.cells]
        if (total := sum(gain for gain, _ in turning)) > MOST and len(turning) > 1:
            source.reject((*turning[-1][1], "gain"), f"with the other cues of neighbours, '{name}' has {total:g}, and "
                                                     f"overshoots: at most {MOST:g} in all")
            break


def _ground(source: Source, key: str, given: Any, fields: dict[str, Any], points: np.ndarray | None) -> None:
    """Note mistakes in one of the keys of the substrate."""
    path, unit = ("substrate", key), str(declared(Ground)[key].metadata["unit"])
    most = 1.0 if key == "ligand" else np.inf
    if isinstance(given, Expression) and points is not None:
        _values(source, given, points, path, most)
    law = fields.get(given) if isinstance(given, str) else None
    if law is None:
        return
    if not units.same_kind(law.unit, unit):
        kind = f"a field in a unit such as {unit}" if unit else "a field of pure numbers"
        source.reject(path, f"expects {kind}; '{given}' is in {law.unit or 'no unit'}")
    elif not getattr(law, "steady", False):
        source.reject(path, f"'{given}' depends on the time, but a substrate does not")
    elif points is not None and (law.value(points, 0.0) > most * ROUNDING).any():
        source.reject(path, f"is at most {most:g}, but '{given}' is {law.value(points, 0.0).max():.6g} at a cell")


def _inside(box: tuple, volumes: tuple[int, ...]) -> np.ndarray:
    """Centres (n, d) [µm] of the volumes of a box, at most INSIDE of them along an axis."""
    axes = [a + (b - a) * (np.linspace(0, n - 1, min(n, INSIDE)).round() + 0.5) / n
            for a, b, n in zip(*box, volumes, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def _values(source: Source, formula: Expression, points: np.ndarray, path: tuple, most: float = np.inf,
            where: str = "at a cell") -> None:
    """Note a formula with values that are no amounts at the `points` (n, d) [µm], of which `where` tells the user."""
    try:
        values = formula(points)
    except ValueError as error:
        source.reject(path, str(error))
        return
    wrong = np.flatnonzero(~(np.isfinite(values) & (values >= 0.0) & (values <= most * ROUNDING)))
    if len(wrong):
        value, at = values[wrong[0]] / units.number(f"1 {formula.unit}", formula.unit), points[wrong[0]]
        limits = "at least 0" + (f" and at most {most:g}" if np.isfinite(most) else "")
        place = ", ".join(f"{axis} = {x:.4g}" for axis, x in zip("xyz", at, strict=False))
        source.reject(path, f"{show(formula.text)} is {value:.6g} {formula.unit}".rstrip()
                      + f" at {place} um, {where}: an amount is finite and {limits}")
