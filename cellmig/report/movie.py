"""The frames of a run as data for the player of a page: positions, fields, triangles, outlines, colours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps

from cellmig.output.fields import FIELDS
from cellmig.output.manifest import read_manifest
from cellmig.output.xdmf import Frame, frames
from cellmig.plot.style import in_print
from cellmig.plot.view import MAP, drawing

from .backdrop import backdrop
from .encode import evened, packed, rounded, size

BUDGET = 4_200_000  # letters that frames may take in a page; with all the rest it stays below 5 MB
STILLS = 24  # runs whose last frames are beside each other
FEWEST = 25  # frames that are kept, though fields are left out
PLACE_BITS, FIELD_BITS = 14, 11  # of positions and fields
_LETTERS = 0.5  # by component, particle and frame, about
_GIVEN = ("id", "cell", "material", "surface", "X", "u")  # not drawn as fields
_NAMES = {"v": "velocity", "J": "volume ratio J"}
_FIRST = ("effective_stress", "J", "pressure")  # fields that are kept where not all fit
# Components of stored arrays that are drawn, by their number of columns and of dimensions.
_PARTS = {(1, 2): {"": 0}, (1, 3): {"": 0}, (3, 2): {"x": 0, "y": 1}, (3, 3): {"x": 0, "y": 1, "z": 2},
          (9, 2): {"xx": 0, "yy": 4, "zz": 8, "xy": 1},
          (9, 3): {"xx": 0, "yy": 4, "zz": 8, "xy": 1, "xz": 2, "yz": 5}}


def movie(directory: Path, names: Mapping[int, str]) -> dict[str, Any] | None:
    """What the player shows of a run, complete or not; None without frames.

    Frames are left out evenly, and then fields, until all of it fits into BUDGET; "left_out" tells what.

    Parameters
    ----------
    directory : Path -- of the run.
    names : dict -- of the cells, by number.
    """
    found = frames(directory)
    if not found:
        return None
    case = read_manifest(directory).get("case")
    first, units = found[0].read(), found[0].units()
    shape, kept, dimension = _shape(directory, found[0], first)
    parts = {name: _PARTS[values[:1].size, dimension] for name, values in first.items() if name not in _GIVEN}
    moving, left_out = _thinned(found, kept, parts, dimension)
    of_time = found[0].unit
    return {"dimension": dimension, "unit": of_time.label, "left_out": left_out,
            "cells": {str(k): names.get(k, f"cell {k}") for k in np.unique(first["cell"]).tolist()},
            "materials": list((case or {}).get("materials") or {}),
            "colours": colours(),
            "fields": {name: {"label": _label(name), "unit": in_print(units[name]), "parts": list(parts[name]),
                              "meaning": FIELDS[name].meaning if name in FIELDS else ""}
                       for name in moving["values"]},
            "start": [packed(axis.astype(np.float32)) for axis in first["X"][kept, :dimension].T],
            "ids": packed(first["id"][kept].astype(np.int32)), "cell": packed(first["cell"][kept].astype(np.uint16)),
            "material": packed(first["material"][kept].astype(np.uint8)),
            "behind": backdrop(directory, moving.pop("chosen"), dimension), **shape, **moving}


def _thinned(found: Sequence[Frame], kept: np.ndarray, parts: Mapping[str, Mapping[str, int]], dimension: int
             ) -> tuple[dict[str, Any], str]:
    """Moving data of as many frames and fields as fit, and what was left out, as text."""
    columns = sum(map(len, parts.values())) + dimension
    most = max(1, len(found) // min(FEWEST, len(found)))  # frames of which one is kept, while fields are
    every = max(1, min(most, int(_LETTERS * len(found) * len(kept) * columns / BUDGET)))
    left_out: list[str] = []
    chosen, data = _moving(found, every, kept, parts, dimension)
    while size(data) > BUDGET:
        values = data["values"]
        if every < most:
            every = min(most, max(every + 1, int(every * size(data) / BUDGET)))
            chosen, data = _moving(found, every, kept, parts, dimension)
        elif further := [name for name in sorted(values, key=lambda name: -len(values[name])) if name not in _FIRST]:
            left_out.append(further[0])
            del values[further[0]]
        elif len(chosen) > 2:
            every *= 2
            chosen, data = _moving(found, every, kept, {name: parts[name] for name in values}, dimension)
        else:
            break
    told = [f"{len(chosen)} of {len(found)} frames are here"] if len(chosen) < len(found) else []
    told += [f"without {', '.join(map(_label, left_out))}, for which there is no room"] if left_out else []
    return {**data, "chosen": chosen}, ", ".join(told)


def _moving(found: Sequence[Frame], every: int, kept: np.ndarray, parts: Mapping[str, Mapping[str, int]],
            dimension: int) -> tuple[list[Frame], dict[str, Any]]:
    """One of `every` frames, and the last; their times, positions and fields, and triangles where these change."""
    chosen = [*found[:-1:every], found[-1]]
    places, fields = [], {name: [] for name in parts}
    surfaces: list[dict[str, Any]] = []
    for frame in chosen:
        read = frame.read()
        surfaces += [_surface(frame, read)["triangles"]] if dimension == 3 else []
        places.append((read["X"] + read["u"])[kept, :dimension])
        for name, columns in parts.items():
            fields[name].append(read[name][kept].reshape(len(kept), -1)[:, list(columns.values())])
    data: dict[str, Any] = {"times": [frame.time for frame in chosen], "values": {}}
    data["x"] = [rounded(axis, PLACE_BITS) for axis in np.moveaxis(np.array(places), 2, 0)]
    for name, values in fields.items():
        data["values"][name] = [evened(one, FIELD_BITS) for one in np.moveaxis(np.array(values, float), 2, 0)]
    different = {one["bytes"]: one for one in surfaces}  # where surfaces were divided anew: see `division_space`
    if len(different) > 1:
        number = {text: k for k, text in enumerate(different)}
        data |= {"surfaces": list(different.values()), "surface": [number[one["bytes"]] for one in surfaces]}
    return chosen, data


def colours() -> list[int]:
    """Red, green and blue of the 256 colours of all fields, from 0 to 255, one after the other."""
    return (np.array(colormaps[MAP].colors) * 255).round().astype(int).ravel().tolist()


def stills(runs: Mapping[str, Path], field: str = "effective_stress") -> dict[str, Any] | None:
    """The last frames of the first STILLS runs, with a field and the range of its colours; None without any."""
    pictures, every, unit = [], [], ""
    for name, directory in list(runs.items())[:STILLS]:
        found = frames(directory)
        if not found or field not in found[-1].units():
            continue
        unit, last = in_print(found[-1].units()[field]), found[-1].read()
        shape, kept, dimension = _shape(directory, found[-1], last)
        places, values = (last["X"] + last["u"])[kept, :dimension], last[field][kept].astype(float)
        every.append(values[np.isfinite(values)])
        pictures.append({"name": name, "time": found[-1].time, "unit": found[-1].unit.label, "dimension": dimension,
                         "x": [rounded(axis[None], PLACE_BITS) for axis in places.T],
                         "values": evened(values[None], FIELD_BITS), **shape})
    if not any(map(len, every)):
        return None
    values = np.concatenate(every)
    low, high = np.percentile(values, [1.0, 99.0])
    return {"low": low, "high": high if high > low else low + 1.0, "beyond": [values.min() < low, values.max() > high],
            "label": _label(field), "unit": unit, "colours": colours(), "runs": pictures}


def _label(name: str) -> str:
    return _NAMES.get(name, name.replace("_", " "))


def _shape(directory: Path, frame: Frame, fields: Mapping[str, np.ndarray]) -> tuple[dict[str, Any], np.ndarray, int]:
    """Triangles of a frame and whether it has a substrate; the particles (k,) that they are of; dimensions."""
    case = read_manifest(directory).get("case")
    dimension = 3 if (directory / "mesh.h5").exists() else 2
    shape = _surface(frame, fields) if dimension == 3 else _plane(fields)
    shape["substrate"] = case is None or "substrate" in case.get("adhesion", {})
    return shape, shape.pop("kept"), dimension


def _plane(first: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Triangles between all particles of a run in two dimensions, outlines, and where materials meet."""
    triangles, loops = [], []
    for cell in np.unique(first["cell"]):
        own = np.flatnonzero(first["cell"] == cell)
        mesh, outline = drawing({name: first[name][own] for name in ("X", "u", "surface")})
        triangles.append(own[mesh.triangles])
        loops += [own[loop].tolist() for loop in outline]
    joined = np.concatenate(triangles)
    return {"kept": np.arange(len(first["id"])), "triangles": packed(joined.astype(np.uint32)), "loops": loops,
            "borders": packed(_borders(first["material"][joined], joined).astype(np.uint32))}


def _borders(material: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Corners (k, 3) of triangles (m, 3) of two materials, the corner that differs from the others first."""
    other = np.array([[1, 2], [2, 0], [0, 1]])
    found = []
    for one, (next_, last) in enumerate(other):
        odd = (material[:, next_] == material[:, last]) & (material[:, one] != material[:, last])
        found.append(triangles[odd][:, [one, next_, last]])
    return np.concatenate(found)


def _surface(frame: Frame, fields: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Triangles of the surfaces in three dimensions; particles inside are left out."""
    kept, places = np.unique(frame.triangles(), return_inverse=True)
    return {"kept": np.searchsorted(fields["id"], kept), "loops": [], "borders": packed(np.zeros((0, 3), np.uint32)),
            "triangles": packed(places.reshape(-1, 3).astype(np.uint32))}
