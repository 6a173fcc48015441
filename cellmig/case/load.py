"""Reads a case file into a `Case`, or reports all its mistakes at once."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

from . import accuracy, registry, units, values
from .amounts import OF_SUBSTRATE
from .checks import check, ordered, resolution
from .colonies import Colonies
from .copies import expand, named
from .expression import Expression
from .messages import CaseError, show, suggest
from .outline_file import Corners
from .schema import Case, Cell, Pair, case_fields, case_path
from .source import Source, assign, read
from .time_unit import TimeUnit
from .values import declared


def load(path: str | os.PathLike, sets: Sequence[str] = ()) -> Case:
    """Case of a file, with the files that it extends and the changes `sets` ("time.end=40 us", "cells.0.radius=4 um").

    The laws that it names must have been registered.

    Raises CaseError, which holds all mistakes.
    """
    return _case(read(path, sets), os.fspath(path))


def from_dict(data: Mapping[str, Any], path: str = "case", older: bool = False) -> Case:
    """Case from tables such as `Case.resolved` returns; `older` : those of an older version may have former keys.

    Raises CaseError, which holds all mistakes.
    """
    return _case(Source(data=dict(data), files=[path]), path, older)


def change(case: Case, changes: Mapping[str, Any]) -> Case:
    """A copy of the case with some values changed.

    `changes` are values as in a case file by dotted keys: ``{"time.end": "40 us", "cells.Cell-1.radius": "4 um"}``; a
    dict is a whole table.

    Raises CaseError, which holds all mistakes.
    """
    tree = case.resolved()
    for one, other in (("per_cell", "spacing"), ("spacing", "per_cell")):
        if f"particles.{one}" in changes:
            tree["particles"].pop(other, None)
    source = Source(data=tree, files=[case.path or "case", "change"])
    for name, value in changes.items():
        assign(source, name, value, "change")
    return _case(source, case.path)


def _case(source: Source, path: str, older: bool = False) -> Case:
    chosen = accuracy.fill(source)
    reader = _Reader(source, older)
    try:
        found = reader.case()
    except RecursionError:
        source.reject((), "is nested too deeply")
    except ArithmeticError:
        source.reject((), "holds a number too large or too small to compute with")
    if source.mistakes:
        raise CaseError(source.sorted_mistakes())
    unit = TimeUnit.of_size(units.unit_size(reader.find(("time", "end"))))
    return Case(**found, path=path, formulas=reader.formulas, chosen=chosen, time_unit=unit)


class _Reader:
    """Compares the tables of a case with its declarations and notes every mistake."""

    def __init__(self, source: Source, older: bool = False):
        self.source, self.reject, self.older = source, source.reject, older
        self.formulas: dict[tuple, tuple] = {}
        self.partial = bool(source.mistakes)  # a file could not be read: missing keys are not reported
        self.changed: dict[tuple, tuple] = {}  # copies of repeated cells that have changes, by path
        many = {f.metadata["kind"]: self.find(case_path(f)) for f in case_fields().values() if f.metadata.get("many")}
        self.names = {kind: list(given) if isinstance(given, dict) else [] for kind, given in many.items()}
        given = source.data.get("dimension")
        # What else it may be is refused, and "3", too, but cells are those that are meant.
        self.dimension = 3 if given == "3" or (isinstance(given, int | float) and given > 2) else 2
        self.cells_of: dict[str, tuple[str, ...]] = {}  # by name: a cell, or all copies of a repeated one
        tables = source.data.get("cells")
        self.colonies = self.read_colonies(tables if isinstance(tables, list) else [])
        if isinstance(tables, list):
            self.cells_of = named(tables, self.colonies.names)
            self.names["cell"] = list(self.cells_of)

    def case(self) -> dict[str, Any]:
        """Values of all fields by name; None where they have mistakes."""
        data, fields = self.source.data, case_fields()
        self.known_keys(data, (), {case_path(f) for f in fields.values()})
        found = {name: self.part(f, self.find(case_path(f)), case_path(f)) for name, f in fields.items()}
        on_substrate = self.find(("adhesion", "substrate")) is not None
        floor = getattr(found["substrate"], "equilibrium_distance", 0.0) if on_substrate else None
        wrong = 0.0 if self.find(("adhesion", "cells")) is not None else None  # its mistakes are told
        bond = getattr(found["contact"], "equilibrium_distance", wrong)
        placed = self.colonies.place(found["cells"], self.changed, floor, bond, found)
        found["cells"], found["colony"] = expand(self.reject, found["cells"], floor, self.changed, placed), []
        if not self.partial:
            resolution(self.source)
        check(self.source, found, on_substrate)
        for name in [name for name, f in fields.items() if "items_of" in f.metadata]:
            self.note_formulas(name, found[name])
            found[name] = tuple(item for item, _ in found[name])
        self.note_formulas("director", [(law, ("director",)) for law in [found["director"]] if law is not None])
        return found

    def read_colonies(self, tables: list) -> Colonies:
        """The colonies, before the cells: outlines have names."""
        before = len(self.source.mistakes)
        given = self.find(("colony",))
        items = self.items(partial(self.law, "colony"), [] if given is None else given, ("colony",))
        colonies = Colonies(self.reject, items, tables)
        self.partial |= len(self.source.mistakes) > before  # cells of such a colony are not reported as missing
        return colonies

    def note_formulas(self, kind: str, items: list[tuple[Any, tuple]]) -> None:
        """Note file and line of formulas, whose values are checked once there are particles."""
        for item, path in items:
            for key in (key for key, f in declared(type(item)).items() if f.metadata.get("formula")):
                given = getattr(item, key)
                if any(isinstance(v, Expression) for v in (given if isinstance(given, tuple) else (given,))):
                    where = (*path, key)
                    named = kind, getattr(item, "name", ""), key
                    self.formulas[named] = (*self.source.place(where), ".".join(map(str, where)))

    def find(self, path: tuple) -> Any:
        """Value at a path of tables; None if there is none."""
        value: Any = self.source.data
        for key in path:
            value = value.get(key) if isinstance(value, dict) else None
        return value

    def known_keys(self, data: dict, path: tuple, known: set) -> None:
        """Note a mistake for each key of `data` with which none of the `known` paths begins."""
        words = sorted({p[0] for p in known}) + ["extends"] * (not path)
        for key, value in data.items():
            below = {p[1:] for p in known if p[0] == key}
            if not below:
                what = "section" if isinstance(value, dict) else "key"
                self.reject((*path, key), f"no such {what}{suggest(key, words)}")
            elif () not in below and isinstance(value, dict):
                self.known_keys(value, (*path, key), below)
            elif () not in below:
                self.reject((*path, key), f"is a section: [{key}], not {show(value)}")

    def part(self, f: Any, value: Any, path: tuple) -> Any:
        """Value of one field of the case."""
        meta = f.metadata
        if "section" in meta and value is None and f.default is None:
            return None
        if "section" in meta:
            return self.record(meta["section"], {} if value is None else value, path)
        if meta.get("items_of") is Cell:
            return self.cells(value, path)
        if meta.get("items_of") == "colony":
            return self.colonies.items
        if "items_of" in meta:
            what = meta["items_of"]
            read = (self.pair if what is Pair else partial(self.law if isinstance(what, str) else self.record, what))
            return self.items(read, [] if value is None else value, path)
        if meta.get("many"):
            if not isinstance(value, dict | None):
                self.reject(path, f"holds tables such as [{f.name}.{meta['such_as']}], not {show(value)}")
                return {}
            return {name: self.law(meta["kind"], item, (*path, name), meta["default_law"])
                    for name, item in (value or {}).items()}
        if value is None:
            if "unit" in meta and self.find(path[:-1]) == {}:
                self.missing(path, f"{meta['doc']}, such as {path[-1]} = {values.example(f)}")
            return values.default_in(f, self.dimension)
        if "kind" in meta:
            return self.law(meta["kind"], value, path, meta["default_law"])
        return self.value(f, value, path)

    def cells(self, value: Any, path: tuple) -> list[tuple[Any, tuple]]:
        """Cells without mistakes, not yet repeated, with their paths."""
        if value is None or value == []:
            self.missing(path, "a case has at least one cell, in a table [[cells]]")
            return []
        if not isinstance(value, list):
            self.reject(path, "is a list of tables: write [[cells]]")
            return []
        found = [(self.repeated(item, (*path, n)), (*path, n)) for n, item in enumerate(value)]
        return [cell for cell in found if cell[0] is not None]

    def repeated(self, data: Any, path: tuple) -> Cell | None:
        """A cell, not yet repeated; copies that have tables of their own are put into `changed`."""
        if not isinstance(data, dict):
            return self.cell(data, path)
        names = self.colonies.names(data)
        known = {*declared(Cell), *declared(registry.laws("shape").get(str(data.get("shape")), Cell))}
        own = {k: v for k, v in data.items() if k not in known and isinstance(v, dict) and len(names) > 1}
        data = {k: v for k, v in data.items() if k not in own}
        cell = self.cell(data, path)
        for name, says in own.items():
            if name not in names:
                self.reject((*path, name), f"no such copy{suggest(name, names)}")
            elif fixed := {"name", "repeat", "pitch"} & set(says):
                self.reject((*path, name, min(fixed)), "is that of all copies")
            elif cell is not None:
                alone = {k: v for k, v in data.items() if k not in ("repeat", "pitch")}
                if (copy := self.cell({**alone, **says}, (*path, name))) is not None:
                    self.changed[(*path, name)] = copy, says
        return cell

    def items(self, read: Callable[[Any, tuple], Any], value: Any, path: tuple) -> list[tuple[Any, tuple]]:
        """Items without mistakes of a list of tables, with their paths; `read` makes one from its table and path."""
        if not isinstance(value, list):
            self.reject(path, f"is a list of tables: write [[{'.'.join(path)}]]")
            return []
        found = [(read(item, (*path, n)), (*path, n)) for n, item in enumerate(value)]
        return [item for item in found if item[0] is not None]

    def pair(self, data: Any, path: tuple) -> Pair | None:
        """Cells with a law of their own; keys that the table lacks are as in adhesion.cells, if that has this law."""
        of_all = self.find(("adhesion", "cells"))
        default = of_all.get("law", "seifert") if isinstance(of_all, dict) else "seifert"
        cls = self.choose("adhesion", data, path, "law", default)
        if cls is None or not isinstance(data, dict):
            return self.record(Pair, data, path, None, law=None)
        given = {}
        if isinstance(of_all, dict) and cls is registry.laws("adhesion").get(default):
            base = self.law("adhesion", of_all, ("adhesion", "cells"), "seifert")  # its mistakes are told once
            given = {key: getattr(base, key, None) for key in declared(cls) if key not in data}
        own = {key: value for key, value in data.items() if key not in declared(Pair)}
        law = self.record(cls, own, path, declared(Pair), **given)
        return self.record(Pair, data, path, None, law=law)

    def cell(self, data: Any, path: tuple) -> Cell | None:
        """Cell from a table, which holds the keys of the cell and those of its shape."""
        if isinstance(data, dict):
            data = self.colonies.completed(data, path, self.dimension)
        shape_class = self.choose("shape", data, path, "shape")
        own = declared(Cell)
        extra = set(declared(shape_class)) - set(own) if shape_class else None
        if not isinstance(data, dict):
            return self.record(Cell, data, path)
        if data.get("rest") is True and isinstance(data.get("centre"), list) and len(data["centre"]) == 1:
            data = {**data, "centre": [*data["centre"], *["0 um"] * (self.dimension - 1)]}  # its height follows
        shape = shape_class and self.record(shape_class, {k: v for k, v in data.items() if k in extra}, path, own)
        return self.record(Cell, data, path, extra, ("shape", shape_class), shape=shape)

    def law(self, kind: str, data: Any, path: tuple, default: str | None = None) -> Any:
        """Law of a kind from its table."""
        cls = self.choose(kind, data, path, "law", default)
        return cls and self.record(cls, data, path, ("law",), (kind, cls))

    def choose(self, kind: str, data: Any, path: tuple, key: str, default: str | None = None) -> type | None:
        """Registered class that a table names, None if it has a mistake."""
        known = registry.laws(kind)
        if kind == "shape":
            known = {name: cls for name, cls in known.items() if cls.dimension == self.dimension}
        if not isinstance(data, dict):
            if key == "law":
                self.reject(path, f"expects a table, not {show(data)}")
            return None
        name = data.get(key, default)
        if name is None:
            self.missing((*path, key), f"one of {', '.join(map(repr, known))}")
        elif not isinstance(name, str) or name not in known:
            what = f"{kind}{' law' * (key == 'law')} {show(name)}"
            elsewhere = f" in {self.dimension} dimensions" * (isinstance(name, str) and name in registry.laws(kind))
            self.reject((*path, key), f"no {what}{elsewhere}{suggest(name, known)}")
        else:
            return known[name]
        return None

    def unknown(self, key: str, words: Iterable[str], kind: str, cls: type | None) -> str:
        """Message about a key that is not among `words`, which tells whether others of this kind of law have it."""
        laws = registry.laws(kind) if cls else {}
        having = [name for name, law in laws.items() if key in declared(law)]
        here = [name for name in having if getattr(laws[name], "dimension", self.dimension) == self.dimension]
        if not cls or not having:
            return f"no such key{suggest(key, words)}"
        own = next(name for name, law in laws.items() if law is cls)
        where = "" if here else f" in {5 - self.dimension} dimensions"
        return (f"no such key of {kind} '{own}', but of {', '.join(map(repr, here or having))}{where}; '{own}' has "
                f"{', '.join(map(repr, declared(cls))) or 'none'}")

    def record(self, cls: type, data: Any, path: tuple, others: Any = (), which: tuple[str, type | None] = ("", None),
               **given: Any) -> Any:
        """Instance of a declared class from a table; None if it has mistakes.

        `others` are further keys that the table may have, None for any; `which` is the kind and the class of the law
        whose keys these are; `given` are values that do not come from the table.
        """
        if not isinstance(data, dict):
            self.reject(path, f"expects a table, not {show(data)}")
            return None
        fields, found = declared(cls), dict(given)
        for key, value in data.items():
            if key in fields and key not in given:
                found[key] = self.value(values.in_table(fields[key], data.get("unit")), value, (*path, key))
            elif key not in fields and others is not None and key not in others:
                renamed = next((name for name, f in fields.items() if f.metadata.get("formerly") == key), None)
                if not renamed:
                    self.reject((*path, key), self.unknown(key, [*fields, *others], *which))
                elif not self.older:
                    self.reject((*path, key), f"is called '{renamed}' now")
                if renamed:
                    found[renamed] = self.value(values.in_table(fields[renamed], data.get("unit")), value, (*path, key))
        for key, f in fields.items():
            if key not in found and "default_law" in f.metadata and not f.metadata.get("optional"):
                found[key] = self.law(f.metadata["kind"], {}, (*path, key), f.metadata["default_law"])
            if key not in found and "d" in f.metadata.get("shape", ()) and f.default and not values.required(f):
                found[key] = values.default_in(f, self.dimension)
            if key not in found and values.required(f):
                self.missing((*path, key), f"{f.metadata['doc']}, such as {key} = {values.example(f)}")
                found[key] = None
        ordered(self.source, cls, found, path)
        if any(found[k] is None for k in found):
            return None
        try:
            return cls(**found)
        except ValueError as error:  # raised by the class, on several parameters
            key, _, what = str(error).partition(": ")
            if key in data:
                self.reject((*path, key), what)
            else:
                self.reject(path, str(error))
            return None

    def value(self, f: Any, value: Any, path: tuple) -> Any:
        """Value of one key; None if it has a mistake."""
        if "record" in f.metadata:
            return self.record(f.metadata["record"], value, path)
        if "kind" in f.metadata:
            return self.law(f.metadata["kind"], value, path, f.metadata["default_law"])
        if isinstance(value, str) and value in self.names.get(f.metadata.get("or_name"), ()):
            return value
        try:
            if f.metadata.get("or_file") and isinstance(value, str):
                place = self.source.place(path)[0]
                folder = "" if place.startswith("--set ") else os.path.dirname(place)
                scaled = (f.metadata["unit"] == "",) if f.metadata.get("scaled") else ()
                value = f.metadata["or_file"](os.path.join(folder, value), *scaled)
            found = values.read(f, value, self.dimension)
            if isinstance(value, Corners):
                found = Corners(found, value.path, value.lines)
        except ValueError as error:
            other = "or_name" in f.metadata and isinstance(value, str) and "is not a" in str(error)
            named = suggest(value, self.names["field"]) if other else ""
            self.reject(path, f"{error}{named and f', or the name of a field{named}'}")
            return None
        what = f.metadata.get("refers") or f.metadata.get("items")
        if what == "pair":
            if () in found:
                self.reject(path, "names no cell on one side")
            return tuple(self.copies((side,) if isinstance(side, str) else side, path) for side in found)
        if what == "cell":
            return self.copies(found, path)
        if what in self.names and found is not None:
            self.known(what, found, path)
        return found

    def copies(self, names: tuple[str, ...], path: tuple) -> tuple[str, ...]:
        """Names of single cells: the name of a repeated cell stands for all its copies."""
        if "cell" in self.names:
            for name in dict.fromkeys(names):
                self.known("cell", name, path)
        return tuple(dict.fromkeys(one for name in names for one in self.cells_of.get(name, ())))

    def known(self, what: str, name: str, path: tuple) -> None:
        """Note a mistake unless there is such a material or cell."""
        of_substrate = [key for key in OF_SUBSTRATE if what == "field" and self.find(("substrate", key)) is not None]
        names = list(dict.fromkeys([*self.names[what], *of_substrate]))
        if name not in names and not self.partial:
            self.reject(path, f"no {what} {show(name)}{suggest(name, names)}")

    def missing(self, path: tuple, what: str) -> None:
        """Note a required key that is missing."""
        if not self.partial:
            self.reject(path, f"missing: {what}")
