"""Sources of the values of a case: its file, the files that it extends, and options `--set`."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field

from .copies import cell_names, copy_names
from .lines import key_lines
from .messages import Mistake, nearest, show, suggest
from .shipped import FOLDER

LARGEST = 64 << 20  # largest case file [B]: one that lists 100,000 cells has a quarter of this


@dataclass
class Source:
    """Tables of a case, the file and line of each key, and the mistakes found so far.

    Attributes
    ----------
    data : dict -- merged tables.
    places : dict -- path of a key (names and indices of items) to (file, line).
    files : list -- files in the order in which their mistakes are reported.
    mistakes : list of Mistake.
    """

    data: dict = field(default_factory=dict)
    places: dict = field(default_factory=dict)
    files: list = field(default_factory=list)
    mistakes: list = field(default_factory=list)

    def place(self, path: tuple) -> tuple[str, int | None]:
        """File and line of a key, or of the nearest table that contains it."""
        for n in range(len(path), 0, -1):
            if path[:n] in self.places:
                return self.places[path[:n]]
        return self.files[0], None

    def reject(self, path: tuple, message: str) -> None:
        """Note a mistake at a key; in a list of tables, the name of the table is added to the message."""
        name = self._name(path)
        if name and repr(name) not in message:
            message += f" (of {name!r})"
        self.mistakes.append(Mistake(*self.place(path), ".".join(map(str, path)), message))

    def rejected(self, path: tuple) -> bool:
        """Whether a mistake was noted at a key, or in it."""
        of = ".".join(map(str, path))
        return any(f"{mistake.key}.".startswith(f"{of}.") for mistake in self.mistakes)

    def _name(self, path: tuple) -> str:
        """Name of the table in a list, such as [[cells]], that contains a key; "" without one."""
        items = self.data.get(path[0]) if len(path) > 1 and isinstance(path[1], int) else None
        item = items[path[1]] if isinstance(items, list) and path[1] < len(items) else None
        name = item.get("name") if isinstance(item, dict) and path[2:] != ("name",) else None
        return name.strip()[:60] if isinstance(name, str) and name.isprintable() else ""

    def sorted_mistakes(self) -> list[Mistake]:
        """Mistakes by file and line, each once."""
        order = {file: i for i, file in enumerate(self.files)}
        return sorted(dict.fromkeys(self.mistakes), key=lambda m: (order.get(m.file, len(order)), m.line or 0))

    def forget(self, path: tuple) -> None:
        """Remove the places of a value that is replaced."""
        for known in [p for p in self.places if p[:len(path)] == path]:
            del self.places[known]


def read(path: str | os.PathLike, sets: Sequence[str] = ()) -> Source:
    """Source of the case in a file, with all files that it extends and the changes `sets` ("a.b=value")."""
    source, chain, visited = Source(), [], set()
    file: str | None = os.fspath(path)
    extended_at: tuple = (file, None)
    while file is not None:
        if os.path.realpath(file) in visited:
            source.mistakes.append(Mistake(*extended_at, "extends", f"'{file}' extends this file: they go in a circle"))
            break
        source.files.append(file)
        visited.add(os.path.realpath(file))
        try:
            data, lines = _read_file(file)
        except _Unreadable as error:
            mine, key = (extended_at, "extends") if error.line is None and chain else ((file, error.line), "")
            source.mistakes.append(Mistake(*mine, key, f"'{file}' {error}" if key else str(error)))
            break
        chain.append((file, data, lines))
        extended_at, file = (file, lines.get(("extends",))), _parent(source, file, data, lines)
    for file, data, lines in reversed(chain):
        _merge(source, source.data, data, ())
        source.places.update({p: (file, line) for p, line in lines.items() if p})
    for text in sets:
        _set(source, text)
    return source


def _parent(source: Source, file: str, data: dict, lines: dict) -> str | None:
    """Path of the file that this one extends, None without one."""
    if "extends" not in data:
        return None
    parent = data.pop("extends")
    if isinstance(parent, str) and parent and "\0" not in parent:
        return os.path.normpath(os.path.join(os.path.dirname(file), parent))
    source.mistakes.append(Mistake(file, lines.get(("extends",)), "extends",
                                   f"expects the path of a case file, not {show(parent)}"))
    return None


class _Unreadable(Exception):
    """A file that cannot be read; `line` is that of the error, None without one."""

    def __init__(self, message: str, line: int | None = None):
        super().__init__(message)
        self.line = line


def _read_file(file: str) -> tuple[dict, dict]:
    """Tables of a TOML file and the lines of its keys."""
    text = _text(file)
    try:
        return tomllib.loads(text), key_lines(text)
    except tomllib.TOMLDecodeError as error:
        where = re.search(r" \(at line (\d+), column (\d+)\)$", str(error))
        if where:
            raise _Unreadable(f"not TOML: {str(error)[:where.start()]} (column {where[2]})", int(where[1])) from None
        raise _Unreadable(f"not TOML: {error}", text.count("\n") + 1) from None
    except RecursionError:
        raise _Unreadable("is nested too deeply") from None
    except ValueError as error:  # e.g. an integer of more digits than Python reads
        raise _Unreadable(f"cannot be read: {error}") from None


def _text(file: str) -> str:
    """Text of a file."""
    try:
        if os.path.isdir(file):
            raise _Unreadable("is a directory, not a case file")
        if not os.path.exists(file):
            raise _Unreadable("no such file" + _near_file(file))
        if not os.path.isfile(file):
            raise _Unreadable("is not a regular file")
        with open(file, "rb") as stream:
            raw = stream.read(LARGEST + 1)
    except (OSError, ValueError) as error:
        raise _Unreadable(f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if len(raw) > LARGEST:
        raise _Unreadable(f"is larger than {LARGEST >> 20} MiB: that is no case file")
    try:
        return raw.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise _Unreadable("is not UTF-8 text", raw[:error.start].count(b"\n") + 1) from None


def _near_file(file: str) -> str:
    folder, name = os.path.split(file)
    try:
        near = nearest(name, [f for f in os.listdir(folder or ".") if f.endswith(".toml")])
    except OSError:
        return ""
    if not near and os.path.isfile(os.path.join(folder, "cases", name)):
        near = os.path.join("cases", name)
    if not near and (FOLDER / f"{(stem := name.removesuffix('.toml'))}.toml").is_file():
        return f"; 'cellmig cases {stem}' copies it to here"
    return f"; did you mean '{os.path.join(folder, near)}'?" if near else ""


def _merge(source: Source, base: dict, child: dict, path: tuple) -> None:
    """Merge `child` into `base`: tables are merged; other values, and tables of another law, are replaced."""
    for key, value in child.items():
        old = base.get(key)
        if isinstance(value, dict) and isinstance(old, dict) and value.get("law") in (None, old.get("law")):
            _merge(source, old, value, (*path, key))
        else:
            if key in base:
                source.forget((*path, key))
            base[key] = value


def _set(source: Source, text: str) -> None:
    """Apply a change `a.b=value`."""
    name, equals, value = text.partition("=")
    place = f"--set {text}"
    source.files.append(place)
    if not equals:
        source.mistakes.append(Mistake(place, None, "", _NO_CHANGE))
    else:
        assign(source, name, _value(value), place)


_NO_CHANGE = "expects key=value, such as time.end='40 us'"


def assign(source: Source, name: str, value: object, place: str) -> None:
    """Set a value, as in a case file, at a dotted name; `place` is the option or call that does so, for messages."""
    keys = [key.strip() for key in name.split(".")]
    if not all(keys) or keys[0] == "extends":
        what = "belongs in a file" if keys[0] == "extends" else _NO_CHANGE
        source.mistakes.append(Mistake(place, None, "", what))
        return
    where, path = source.data, ()
    cells = where.get("cells")
    if keys[0] == "cells" and isinstance(cells, list) and len(keys) > 1 and _step(cells, keys[1]) is None:
        keys[1:1] = [str(n) for n, item in enumerate(cells) if keys[1] in copy_names(item)][:1]
    for key in keys:
        if path:
            if isinstance(where, dict) and path[-1] not in where:
                where[path[-1]] = {}
                source.places[path] = place, None
            where = where[path[-1]]
        path = (*path, _step(where, key))
        if path[-1] is None:
            items = where if isinstance(where, list) else []
            names = cell_names(items)
            message = f"no such item{suggest(key, names)}" if names else "is not in a table"
            source.mistakes.append(Mistake(place, None, name, message))
            return
    where[path[-1]] = value
    source.forget(path)
    source.places[path] = place, None


def _step(where: object, key: str) -> str | int | None:
    """Index for `key` in a table (the key) or a list of tables (an index or a name); None if there is none."""
    if isinstance(where, dict):
        return key
    if isinstance(where, list):
        named = [n for n, item in enumerate(where) if isinstance(item, dict) and item.get("name") == key]
        if named or (key.isdecimal() and len(key) < 9 and int(key) < len(where)):
            return named[0] if named else int(key)
    return None


def _value(text: str) -> object:
    """A value on the command line: TOML if it can be read as such, otherwise text."""
    try:
        return tomllib.loads(f"v = {text}")["v"] if "\n" not in text else text
    except (ValueError, RecursionError):
        return text
