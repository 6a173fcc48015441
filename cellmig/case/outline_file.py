"""Outlines from CSV files: columns x and y, in a unit that the header names or in pixels of an image."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Iterable
from itertools import islice
from typing import Any

from . import units
from .messages import show

LARGEST = 100_000  # most corners
MOST_BYTES = 100 * LARGEST  # largest file [B]: a larger one, or an endless device, is no outline
_COLUMN = re.compile(r"([xyXY])(?:_(\S+))?")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_REMEDY = 'say how long 1 is, such as unit = "0.1625 um" for the size of a pixel'


class Corners(tuple):
    """Tuple of corners, with the `path` of their file and the list of their `lines` in it."""

    path: str = ""
    lines: Any = ()

    def __new__(cls, items: Iterable = (), path: str = "", lines: Iterable = ()) -> Corners:
        """Tuple of the items, with the file and the lines of its corners."""
        corners = super().__new__(cls, items)
        corners.path, corners.lines = path, list(lines)
        return corners


def named(corners: tuple, numbers: Iterable[int]) -> str:
    """Text for corners with `numbers` from 0 in a message: "corners 1 and 3" or "lines 2 and 4 of 'a.csv'"."""
    path, lines = getattr(corners, "path", ""), getattr(corners, "lines", ())
    return f"{'lines' if lines else 'corners'} " + " and ".join(str(lines[n] if lines else n + 1) for n in numbers) + (
        f" of '{path}'" if lines else "")


def corners(path: str, scaled: bool) -> Corners:
    """Corners from a CSV file.

    They are quantities if the header has a unit, such as "x_um,y_um".  Otherwise they are pure numbers, and `scaled`
    tells whether the case gives their unit of length: such headers are "x_px,y_px" and ImageJ's "X,Y", which a column
    of row numbers may precede.

    Raises ValueError for any other file; the message is for the user.
    """
    rows = _rows(path)
    (_, first), *others = rows or [(1, [])]
    if scaled and len(first) == 2 and all(map(_NUMBER.fullmatch, first)):
        at, given, others = [0, 1], ["", ""], rows  # ImageJ writes XY coordinates without a header
    else:
        at, given = _columns(path, first)
    if any(given) != all(given):
        raise ValueError(f"'{path}' has a unit for one of x and y alone: {show(','.join(first))}")
    plain = all(unit in ("", "px", "pixel", "pixels") for unit in given)
    if plain and not scaled:
        raise ValueError(f"'{path}' {'counts in pixels' if any(given) else 'names no unit'}: {_REMEDY}")
    if scaled and not plain:
        raise ValueError(f"'{path}' gives its own unit, {given[0]}: leave out the key unit")
    found, lines = [], []
    for line, row in others:
        if len(row) != len(first):
            raise ValueError(f"'{path}' has {len(row)} numbers in line {line}, not {_words(len(first))}")
        words = [row[n] for n in at]
        found.append([_plain(word, path, line) if plain else _quantity(f"{word} {unit}", path, line)
                      for word, unit in zip(words, given, strict=True)])
        lines.append(line)
    return Corners(found, path, lines)


def _rows(path: str) -> list[tuple[int, list[str]]]:
    """Rows of a table that are not blank, with the numbers of their lines, from 1."""
    if os.path.exists(path) and not os.path.isfile(path):
        raise ValueError(f"'{path}' is no file")
    try:
        if os.path.getsize(path) > MOST_BYTES:
            raise ValueError("it is too large for an outline")
        with open(path, encoding="utf-8-sig", newline="") as stream:
            start = stream.readline()
            stream.seek(0)
            reader = csv.reader(stream, delimiter="\t" if "\t" in start else ",")
            rows = [(reader.line_num, [word.strip() for word in row]) for row in islice(reader, LARGEST + 2)]
    except (OSError, UnicodeDecodeError, csv.Error, ValueError) as error:
        raise ValueError(f"'{path}' cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if len(rows) > LARGEST + 1:
        raise ValueError(f"'{path}' has more than {LARGEST} corners")
    return [(line, row) for line, row in rows if any(row)]


def _columns(path: str, head: list[str]) -> tuple[list[int], list[str]]:
    """Indices of the columns x and y, and their units, "" without one."""
    match = [_COLUMN.fullmatch(units.plain(word)) for word in head]
    place = {m[1].lower(): n for n, m in enumerate(match) if m}
    others = [word for n, word in enumerate(head) if not match[n] and (n or word)]  # ImageJ's row numbers
    if set(place) == {"x", "y"} and not others and len(head) - (head[0] == "") == 2:
        return [place["x"], place["y"]], [match[place[axis]][2] or "" for axis in "xy"]
    if len(head) > 2 and re.search(r"(?i)\b[bx]?[xy]\b|area", " ".join(head)):
        raise ValueError(f"'{path}' has the columns {show(','.join(head))}: a table of measurements, not the points of "
                         "one outline, which ImageJ writes by File > Save As > XY Coordinates")
    raise ValueError(f"'{path}' begins with {show(','.join(head))}, not with a line such as 'x_um,y_um'")


def _plain(word: str, path: str, line: int) -> float:
    if not _NUMBER.fullmatch(word):
        raise ValueError(f"'{path}' line {line}: {show(word)} is not a number")
    return float(word)


def _quantity(text: str, path: str, line: int) -> str:
    try:
        units.number(text, "um")
    except units.UnitError as error:
        raise ValueError(f"'{path}' line {line}: {error}") from None
    return text


def _words(n: int) -> str:
    return {2: "two", 3: "three"}.get(n, str(n))
