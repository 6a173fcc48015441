"""What no single value shows: names that must exist, cells that must not overlap, parameters that must fit."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from . import units
from .messages import suggest
from .schema import Cell
from .source import Source
from .values import declared

MOST_CELLS, MOST_PARTICLES = 100_000, 1e9
OUTLINE = 720  # points of an outline: a disc of 5 µm is then round to 0.05 nm
NOT_ABOVE = (("reduced_bulk_modulus", "bulk_modulus", "the reduced modulus is the smaller one"),
             ("range", "cutoff", "beyond the cutoff there would be no bond at its equilibrium"))


def expand(source: Source, cell: Cell, path: tuple) -> Iterator[tuple[Cell, tuple]]:
    """The copies of a cell, each with the path of its table: the first direction runs fastest."""
    counts, pitch = cell.repeat, cell.pitch
    total = math.prod(counts)
    if len(pitch) != len(counts) and total > 1:
        source.wrong((*path, "pitch"), f"expects a vector for each of the {len(counts)} directions of repeat")
        return
    if total > MOST_CELLS:
        source.wrong((*path, "repeat"), f"makes {total} cells; at most {MOST_CELLS} are possible")
        return
    for k in range(total):
        steps, rest = [], k
        for n in counts:
            steps.append(rest % n)
            rest //= n
        moved = (c + sum(i * p[d] for i, p in zip(steps, pitch, strict=False)) for d, c in enumerate(cell.centre))
        centre = tuple(float(f"{c:.15g}") for c in moved)
        numbered = cell.name if "{}" in cell.name or total == 1 else cell.name + "-{}"
        name = numbered.replace("{}", str(k + 1))
        yield dataclasses.replace(cell, name=name, centre=centre, repeat=(1,), pitch=()), path


def check(source: Source, found: dict[str, Any], partial: bool) -> None:
    """Note what does not fit together among the parts of a case; parts that have mistakes are None."""
    if not partial:
        _references(source, found)
        _resolution(source, found)
    _ordered(source, found)
    _names(source, found["cells"])
    if found["substrate"] is not None:
        _above_substrate(source, found["cells"])
    _overlaps(source, found["cells"])


def _laws(found: dict[str, Any]) -> Iterator[tuple[Any, tuple]]:
    """All laws of a case that could be read, with their paths."""
    single = {"substrate": ("adhesion", "substrate"), "contact": ("adhesion", "cells")}
    for name in ("substrate", "contact", "protrusion", "director"):
        if found[name] is not None:
            yield found[name], single.get(name, (name,))
    for name, law in found["materials"].items():
        if law is not None:
            yield law, ("materials", name)


def _references(source: Source, found: dict[str, Any]) -> None:
    """Materials and cells that are named exist; a nucleus has a size and a material, or neither."""
    names = {cell.name for cell, _ in found["cells"]}
    for cell, path in {path: (cell, path) for cell, path in found["cells"]}.values():
        for key in (k for k, f in declared(Cell).items() if f.metadata.get("refers") == "material"):
            name = getattr(cell, key)
            if name is not None and name not in found["materials"]:
                source.wrong((*path, key), f"no material '{name}'{suggest(name, found['materials'])}")
        ratio = getattr(cell.shape, "nucleus_ratio", None)
        if cell.nucleus is not None and ratio is None:
            source.wrong((*path, "nucleus"), "a nucleus has a size: nucleus_ratio is missing")
        elif cell.nucleus is None and ratio is not None:
            source.wrong((*path, "nucleus_ratio"), "a nucleus has a material: nucleus is missing")
    if len({path for _, path in found["cells"]}) < len(source.data.get("cells") or ()):
        return  # some cell could not be read, and its name may be the one
    for law, path in _laws(found):
        for key in (k for k, f in declared(type(law)).items() if f.metadata.get("items") == "cell"):
            for name in dict.fromkeys(getattr(law, key)):
                if name not in names:
                    source.wrong((*path, key), f"no cell '{name}'{suggest(name, names)}")


def _resolution(source: Source, found: dict[str, Any]) -> None:
    """The resolution is given, once, and can be computed."""
    particles = found["particles"]
    if particles is None:
        return
    if (particles.per_cell is None) == (particles.spacing is None):
        given = "not both" if particles.spacing else 'such as per_cell = 1485 or spacing = "0.24 um"'
        source.wrong(("particles",), f"give either per_cell or spacing, {given}")
        return
    total = 0.0
    for cell, _ in found["cells"]:
        count = particles.per_cell or cell.shape.area / particles.spacing**2
        total += count
        if count < 7:
            source.wrong(("particles", "spacing"), f"leaves '{cell.name}' fewer than 7 particles")
            return
    if total > MOST_PARTICLES:
        source.wrong(("particles",), f"makes {total:.2g} particles in all; at most {MOST_PARTICLES:.0e} are possible")


def _ordered(source: Source, found: dict[str, Any]) -> None:
    """Pairs of parameters of one law that have an order."""
    for law, path in _laws(found):
        fields = declared(type(law))
        for small, large, why in NOT_ABOVE:
            if small in fields and large in fields and getattr(law, small) > getattr(law, large):
                low, high = (units.text(getattr(law, k), fields[k].metadata["unit"]) for k in (small, large))
                source.wrong((*path, small), f"{low} is above {large} = {high}: {why}")


def _names(source: Source, cells: list[tuple[Cell, tuple]]) -> None:
    """Every cell has a name of its own."""
    seen: dict[str, tuple] = {}
    for cell, path in cells:
        if not cell.name.strip() or not cell.name.isprintable():
            source.wrong((*path, "name"), "a name has printable characters, and at least one")
        elif cell.name in seen:
            other = ".".join(map(str, seen[cell.name]))
            source.wrong((*path, "name"), f"two cells are called '{cell.name}': this one and {other}")
        seen[cell.name] = path


def _above_substrate(source: Source, cells: list[tuple[Cell, tuple]]) -> None:
    """No cell reaches below the plane y = 0; of the copies of a cell, the first that does is named."""
    told = set()
    for cell, path in cells:
        bottom = cell.centre[1] + cell.shape.lowest()
        if bottom < 0 and path not in told:
            told.add(path)
            source.wrong((*path, "centre"), f"'{cell.name}' reaches {-bottom:.4g} um below the substrate y = 0")


def _overlaps(source: Source, cells: list[tuple[Cell, tuple]]) -> None:
    """No two cells overlap; of the copies of a cell, the first pair is named."""
    shapes: dict[Any, np.ndarray] = {}
    outlines = [shapes.setdefault(c.shape, c.shape.outline(OUTLINE)) + np.array(c.centre) for c, _ in cells]
    told = set()
    for i, j in _near(outlines):
        (a, here), (b, there) = cells[i], cells[j]
        if (here, there) not in told and (depth := _depth(outlines[i], outlines[j])) > 1e-9:
            told.add((here, there))
            source.wrong((*there, "centre"), f"'{b.name}' overlaps '{a.name}' by {depth:.4g} um")


def _near(outlines: list[np.ndarray]) -> Iterator[tuple[int, int]]:
    """Pairs i < j of outlines whose boxes overlap."""
    if len(outlines) < 2:
        return
    low, high = (np.array([f(o, axis=0) for o in outlines]) for f in (np.min, np.max))
    order = np.argsort(low[:, 0], kind="stable")
    ends = np.searchsorted(low[order, 0], high[order, 0])
    for n, i in enumerate(order):
        others = order[n + 1:ends[n]]
        for j in others[(low[others, 1] < high[i, 1]) & (high[others, 1] > low[i, 1])]:
            yield min(i, j), max(i, j)


def _depth(a: np.ndarray, b: np.ndarray) -> float:
    """How deep a corner of one polygon (n, 2) lies inside the other [µm], 0 if none does."""
    return max(_inside(a, b), _inside(b, a))


def _inside(points: np.ndarray, polygon: np.ndarray) -> float:
    """Largest distance from the outline of `polygon` among the points inside it, by crossings of a ray along x."""
    p, q = polygon, np.roll(polygon, -1, axis=0)
    x, y = points[:, :1], points[:, 1:]
    with np.errstate(all="ignore"):
        crosses = ((p[:, 1] <= y) != (q[:, 1] <= y)) & (
            x < p[:, 0] + (y - p[:, 1]) / (q[:, 1] - p[:, 1]) * (q[:, 0] - p[:, 0]))
    inside = points[crosses.sum(axis=1) % 2 == 1]
    if not len(inside):
        return 0.0
    edge = q - p
    along = np.clip(((inside[:, None] - p) * edge).sum(-1) / (edge**2).sum(-1), 0.0, 1.0)
    return float(np.linalg.norm(inside[:, None] - p - along[..., None] * edge, axis=-1).min(axis=1).max())
