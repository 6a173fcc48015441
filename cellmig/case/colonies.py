"""Colonies: whose cells they are, and the cells at their places, with their own sizes or outlines."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from .copies import Changed, copy_names, numbered
from .gaps import surface
from .messages import suggest
from .schema import Cell
from .values import declared

# Keys of a table of cells that outlines have in place of it.
OF_OUTLINES = ("repeat", "pitch", "centre", "corners", "nucleus_corners", "unit", "y_down", "centred")
# What stands for the outline of a cell until the colony gives it: an octagon larger than any nucleus.
ROUND = [[f"{x} um", f"{y} um"] for x, y in ((9, 4), (4, 9), (-4, 9), (-9, 4), (-9, -4), (-4, -9), (4, -9), (9, -4))]

Placed = dict[tuple, list[tuple[Cell, tuple]]]  # by path of a table: its cells, each with the path of its own table


class Colonies:
    """The colonies of a case.

    Attributes
    ----------
    items : list of (law, path) -- the colonies.
    of : dict -- colony, as its index in `items`, of each table of [[cells]] that one places, by the table's index.
    ids : dict -- names of the cells that files of outlines hold, by name of the table.
    """

    def __init__(self, reject: Callable[[tuple, str], None], items: list[tuple[Any, tuple]], tables: Any):
        """Note whose cells the colonies place; `tables` : [[cells]] as it is in the case."""
        self.items, self.reject = items, reject
        self.of: dict[int, int] = {}
        self.ids: dict[str, tuple[str, ...]] = {}
        names = [table.get("name") if isinstance(table, dict) else None for table in tables or ()]
        known = [name for name in names if isinstance(name, str)]
        for number, (law, path) in enumerate(items):
            for name in law.cells or known:
                if name not in known:
                    reject((*path, "cells"), f"no table of cells is called '{name}'{suggest(name, known)}")
                elif names.index(name) in self.of:
                    reject((*path, "cells"), f"'{name}' is placed before, in colony.{self.of[names.index(name)]}")
                else:
                    self.of[names.index(name)] = number
            if self._traced(law):
                mine = [name for name in known if self.of.get(names.index(name)) == number]
                self.ids |= self._identified(law, path, mine, known)

    @staticmethod
    def _traced(law: Any) -> bool:
        """Whether a colony has the outlines of its cells."""
        return hasattr(law, "outlines")

    def _identified(self, law: Any, path: tuple, tables: list[str],
                    known: list[str]) -> dict[str, tuple[str, ...]]:
        """Names of the cells of a file of outlines by table: those of its kind, or all of them."""
        cells = law.file.cells
        found = {name: tuple(c.name for c in cells if c.kind == name or not law.file.kinds) for name in tables}
        if not law.file.kinds and len(tables) > 1:
            self.reject((*path, "file"), f"'{law.file.path}' has no column kind to tell the cells of several tables "
                                         f"apart: {', '.join(map(repr, tables))}")
        for kind in dict.fromkeys(c.kind for c in cells if law.file.kinds and c.kind not in tables):
            line = next(c.lines[0] for c in cells if c.kind == kind)
            self.reject((*path, "cells"), f"'{law.file.path}' line {line} has cells of the kind '{kind}', and no table "
                                          f"of this name is placed here{suggest(kind, tables)}")
        for c in cells:
            if c.name in known:
                self.reject((*path, "file"), f"'{law.file.path}' line {c.lines[0]}: the cell '{c.name}' has the name "
                                             "of a table of cells")
        return found

    def names(self, item: Any) -> list[str]:
        """Names of the cells of a table of [[cells]]."""
        name = item.get("name") if isinstance(item, dict) else None
        return list(self.ids[name]) if isinstance(name, str) and name in self.ids else copy_names(item)

    def completed(self, data: dict, path: tuple, dimension: int) -> dict:
        """A table of [[cells]] with what the colony will give; notes what it must not have."""
        if path[1] not in self.of:
            return data
        law, at = self.items[self.of[path[1]]]
        own = OF_OUTLINES if self._traced(law) else ("pitch",)
        for key in own:
            if key in data:
                self.reject((*path, key), f"is that of {'.'.join(map(str, at))}, which places these cells: leave it "
                            "out")
        data = {key: value for key, value in data.items() if key not in own}
        data = {"centre": ["0 um"] * dimension} | data
        return {"shape": "polygon"} | data | {"corners": ROUND} if self._traced(law) else data

    def place(self, cells: list[tuple[Cell, tuple]], changed: Changed, floor: float | None, bond: float | None,
              found: Mapping[str, Any]) -> Placed:
        """The cells of all tables that colonies place, `cells` being those tables.

        changed : copies that differ;  floor : height at which cells rest [µm], None without a substrate;  bond :
        equilibrium distance of bonds between cells [µm], None without any;  found : the other parts of the case.
        """
        placed: Placed = {at: [] for _, at in cells if at[1] in self.of}
        for number, (law, path) in enumerate(self.items):
            mine = [(cell, at) for cell, at in cells if self.of.get(at[1]) == number]
            gap = law.gap if law.gap is not None else bond
            if gap is None:
                self.reject((*path, "gap"), "missing: without [adhesion.cells] there is no equilibrium distance")
            elif mine and found["particles"] is not None and found["seed"] is not None:
                copies = [self._copy(cell, at, name, changed) for cell, at in mine
                          for name in self.ids.get(cell.name, numbered(cell.name, math.prod(cell.repeat)))]
                try:
                    every = (self._outlined(law, path, copies, gap, found["particles"]) if self._traced(law) else
                             self._packed(law, copies, gap, found["seed"]))
                except ValueError as error:
                    key = getattr(error, "key", None)
                    self.reject((*path, key) if key in declared(type(law)) and getattr(law, key) is not None else path,
                                str(error))
                    every = []
                for cell, at in self._rested(law, every, floor):
                    placed[mine[0][1] if self._traced(law) else at[:2]].append((cell, at))  # outlines in their order
        return placed

    def _copy(self, cell: Cell, path: tuple, name: str, changed: Changed) -> tuple[Cell, tuple]:
        own, says = changed.get((*path, name), (cell, {}))
        return dataclasses.replace(own, name=name, repeat=(1,), pitch=()), (*path, name) if says else path

    def _outlined(self, law: Any, path: tuple, copies: list[tuple[Cell, tuple]], gap: float,
                  particles: Any) -> list[tuple[Cell, tuple]]:
        """The copies with the outlines of the file, at their places."""
        outlines, wrong = law.outlines(gap, particles)
        for text in wrong:
            self.reject((*path, "file"), text)
        found, of = [], {cell.name: (cell, at) for cell, at in copies}
        for name, (centre, corners) in outlines.items():
            if name in of:
                cell, at = of[name]
                try:
                    shape = dataclasses.replace(cell.shape, corners=corners)
                except ValueError as error:
                    self.reject((*path, "file"), f"the cell '{cell.name}', {law.lines(cell.name)}: {error}")
                else:
                    found.append((dataclasses.replace(cell, shape=shape, centre=centre), at))
        return found if not wrong else []

    def _packed(self, law: Any, copies: list[tuple[Cell, tuple]], gap: float, seed: int) -> list[tuple[Cell, tuple]]:
        """The copies of the sizes and at the places of a packing."""
        d = len(copies[0][0].centre)
        known: dict[tuple, tuple] = {}
        if law.axes not in (d - 1, d):
            raise ValueError(f"expects places of {d - 1} or {d} coordinates in {d} dimensions, not {law.axes}")
        cells, prints = [], []
        for (cell, at), size in zip(copies, law.sizes(len(copies), seed).tolist(), strict=True):
            key = cell.shape, size, cell.rest, cell.centre[-1]
            if key not in known:
                shape = scaled(cell.shape, size)
                height = -shape.lowest() if cell.rest else cell.centre[-1]
                known[key] = shape, law.footprint(surface(shape), height)
            cells.append((dataclasses.replace(cell, shape=known[key][0]), at))
            prints.append(known[key][1])
        centres = law.places(prints, gap, seed)
        return [(dataclasses.replace(cell, centre=(*centre, *cell.centre[law.axes:])), at)
                for (cell, at), centre in zip(cells, centres.tolist(), strict=True)]

    def _rested(self, law: Any, cells: list[tuple[Cell, tuple]], floor: float | None) -> list[tuple[Cell, tuple]]:
        """The cells on the substrate, if they are to rest there: each, or all together if they are in layers."""
        resting = next((at for cell, at in cells if cell.rest), None)
        if resting is None:
            return cells
        if floor is None:
            self.reject((*resting, "rest"), "there is no substrate to rest on without [adhesion.substrate]")
            return []
        if not self._traced(law) and law.axes < len(cells[0][0].centre):
            return [(dataclasses.replace(cell, centre=(*cell.centre[:-1], _tidy(floor - cell.shape.lowest())))
                     if cell.rest else cell, at) for cell, at in cells]
        up = floor - min(cell.centre[-1] + cell.shape.lowest() for cell, _ in cells)
        return [(dataclasses.replace(cell, rest=False, centre=(*cell.centre[:-1], _tidy(cell.centre[-1] + up))), at)
                for cell, at in cells]


def _tidy(value: float) -> float:
    return float(f"{value:.15g}")


def scaled(shape: Any, size: float) -> Any:
    """A shape with all its lengths times `size` [-]."""
    if size == 1.0:
        return shape
    counted = getattr(shape, "unit", None) is not None  # corners are numbers of units
    lengths = {name: value for name, f in declared(type(shape)).items() if f.metadata.get("unit") == "um"
               and (value := getattr(shape, name)) is not None and not (counted and f.metadata.get("scaled"))}
    return dataclasses.replace(shape, **{name: _times(value, size) for name, value in lengths.items()})


def _times(value: Any, size: float) -> Any:
    """A length, or nested ones, times `size`."""
    if isinstance(value, Sequence):
        return tuple(_times(item, size) for item in value)
    return float(f"{size * value:.12g}")
