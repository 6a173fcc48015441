"""Outlines from files: columns of x and y under a line that names them, with their unit or in a picture's pixels."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Iterable
from itertools import islice
from typing import Any

from . import units
from .messages import show

LARGEST = 100_000  # corners: a longer file is something else
MOST_BYTES = 100 * LARGEST  # so is one of long lines, or a device that never ends
_COLUMN = re.compile(r"([xyXY])(?:_(\S+))?")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_REMEDY = 'say how long 1 is, such as unit = "0.1625 um" for the size of a pixel'


class Corners(tuple):
    """Corners, and where they stand: path : str -- the file;  lines : list -- of it, one for each corner."""

    path: str = ""
    lines: Any = ()

    def __new__(cls, items: Iterable = (), path: str = "", lines: Iterable = ()) -> Corners:
        """Tuple of the items, which knows the file and the lines."""
        corners = super().__new__(cls, items)
        corners.path, corners.lines = path, list(lines)
        return corners


def named(corners: tuple, numbers: Iterable[int]) -> str:
    """How a message names corners, by their numbers from 0: "corners 1 and 3", "lines 2 and 4 of 'a.csv'"."""
    path, lines = getattr(corners, "path", ""), getattr(corners, "lines", ())
    return f"{'lines' if lines else 'corners'} " + " and ".join(str(lines[n] if lines else n + 1) for n in numbers) + (
        f" of '{path}'" if lines else "")


def corners(path: str, scaled: bool) -> Corners:
    """Corners in a CSV file: quantities under the header "x_um,y_um", or another unit; else numbers, if `scaled`.

    `scaled` : whether the case says how long 1 in the file is.  ImageJ's "X,Y", with or without a column of numbers
    before, has no unit, nor have pixels, "x_px,y_px".  Raises ValueError; its text is for the user.
    """
    rows = _rows(path)
    (_, first), *others = rows or [(1, [])]
    if scaled and len(first) == 2 and all(map(_NUMBER.fullmatch, first)):
        at, given, others = [0, 1], ["", ""], rows  # ImageJ's XY coordinates, which have no header
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
    """Lines of a table with their numbers from 1, those that are blank left out."""
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
    """Which columns are x and y, and their units, "" where there is none."""
    match = [_COLUMN.fullmatch(units.plain(word)) for word in head]
    place = {m[1].lower(): n for n, m in enumerate(match) if m}
    others = [word for n, word in enumerate(head) if not match[n] and (n or word)]  # ImageJ numbers rows before
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
