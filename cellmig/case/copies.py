"""Copies of repeated cells: their names and positions, and keys that differ in some of them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping

from .schema import Cell

MOST_CELLS = 100_000


def cell_names(cells: list) -> list[str]:
    """Names of the cells of all tables [[cells]], without those of tables that cannot be read."""
    return [name for item in cells for name in copy_names(item)]


def named(cells: list, names: Callable[[object], list[str]]) -> dict[str, tuple[str, ...]]:
    """Cells by every name that may stand for them: that of one cell, or of a table [[cells]] for all its copies.

    `names` tells those of a table.
    """
    tables = {item["name"]: tuple(copies) for item in cells if (copies := names(item))}
    return tables | {name: (name,) for copies in tables.values() for name in copies}


def copy_names(item: object) -> list[str]:
    """Names of the cells of one table [[cells]]; none if it cannot be read."""
    name, repeat = (item.get("name"), item.get("repeat", [1])) if isinstance(item, dict) else (None, [1])
    whole = isinstance(repeat, list) and all(isinstance(n, int) for n in repeat)
    if isinstance(name, str) and whole and 0 < math.prod(repeat) <= MOST_CELLS:
        return numbered(name, math.prod(repeat))
    return []


def numbered(name: str, total: int) -> list[str]:
    """Names of the `total` copies of a cell."""
    pattern = name if "{}" in name or total == 1 else name + "-{}"
    return [pattern.replace("{}", str(k + 1)) for k in range(total)]


Changed = Mapping[tuple, tuple[Cell, Mapping]]  # by path of a copy: the changed cell, and the table of its changes


def expand(reject: Callable[[tuple, str], None], cells: list[tuple[Cell, tuple]], floor: float | None,
           changed: Changed, placed: Mapping[tuple, list[tuple[Cell, tuple]]]) -> list[tuple[Cell, tuple]]:
    """All copies of all cells, each with the path of its table; the first direction of `repeat` runs fastest.

    Parameters
    ----------
    reject : function -- notes a mistake, given its path and message.
    cells : list of (cell, path) -- cells that are not yet repeated.
    floor : float -- height at which cells rest on the substrate [µm]; None without a substrate.
    changed : dict -- copies that differ.
    placed : dict -- cells of tables that colonies place, by path of the table.
    """
    if sum(len(placed[path]) if path in placed else math.prod(cell.repeat) for cell, path in cells) > MOST_CELLS:
        reject(("cells",), f"are more than {MOST_CELLS}, with all their copies")
        return []
    found = []
    for cell, path in cells:
        if path in placed:
            found += placed[path]
            continue
        total = math.prod(cell.repeat)
        if len(cell.pitch) != len(cell.repeat) and total > 1:
            reject((*path, "pitch"), f"expects a vector for each direction of repeat: {len(cell.repeat)}")
            continue
        first = _set_down(reject, cell, path, floor)
        for k, name in enumerate(numbered(cell.name, total)):
            centre, place = _centre(first, k), (*path, name)
            rest = cell.rest and centre[-1] == _centre(first, 0)[-1]
            own, says = changed.get(place, (cell, {}))
            copy = dataclasses.replace(own, name=name, centre=own.centre if "centre" in says else centre, repeat=(1,),
                                       pitch=(), rest=own.rest if "rest" in says else rest)
            place = place if says else path
            found.append((_set_down(reject, copy, place, floor) if says else copy, place))
    return found


def _set_down(reject: Callable[[tuple, str], None], cell: Cell, path: tuple, floor: float | None) -> Cell:
    """The cell, moved onto the substrate if it is to rest there."""
    if not cell.rest:
        return cell
    if floor is None:
        reject((*path, "rest"), "there is no substrate to rest on without [adhesion.substrate]")
        return cell
    return dataclasses.replace(cell, centre=(*cell.centre[:-1], float(f"{floor - cell.shape.lowest():.15g}")))


def _centre(cell: Cell, k: int) -> tuple[float, ...]:
    """Centre of copy k of a cell [µm]."""
    centre = list(cell.centre)
    for n, pitch in zip(cell.repeat, cell.pitch, strict=False):
        k, step = divmod(k, n)
        centre = [c + step * p for c, p in zip(centre, pitch, strict=True)]
    return tuple(float(f"{c:.15g}") for c in centre)
