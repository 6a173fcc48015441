"""Outlines of many cells from one CSV file, a row for each point, as programs for segmentation write them."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

import numpy as np

from . import units
from .messages import show

MOST_POINTS = 10_000_000
MOST_BYTES = 60 * MOST_POINTS  # largest file [B]: a larger one, or an endless device, is no such table
IDS = ("cell", "id", "label")  # names of the column of ids
_COLUMN = re.compile(r"([xyXY])(?:_(\S+))?")
_PIXELS = ("", "px", "pixel", "pixels")


class Traced(NamedTuple):
    """Outline of one cell as its file has it: id, kind ("" without), points (n, 2)
    [units of the file], the first and the last line.
    """

    name: str
    kind: str
    points: np.ndarray
    lines: tuple[int, int]


@dataclass(frozen=True, eq=False)
class OutlineTable:
    """Outlines in a file: its `path`, size of its unit of length [µm] or None for pixels, its `cells`, any `kinds`."""

    path: str
    unit: float | None
    cells: tuple[Traced, ...]
    kinds: bool


def read(path: str) -> OutlineTable:
    """Outlines from a CSV file with the columns cell, x, y and, if wanted, kind, in any order.

    Units are in the header, as in "cell,x_um,y_um", or it counts in pixels.  Rows of a cell follow each other.

    Raises ValueError for any other file, with all ids that come twice; the message is for the user.
    """
    if os.path.exists(path) and not os.path.isfile(path):
        raise ValueError(f"'{path}' is no file")
    try:
        if os.path.getsize(path) > MOST_BYTES:
            raise ValueError("it is too large for a table of outlines")
        with open(path, encoding="utf-8-sig", newline="") as stream:
            start = stream.readline()
            stream.seek(0)
            reader = csv.reader(stream, delimiter="\t" if "\t" in start else ";" if ";" in start else ",")
            every = list(islice(reader, MOST_POINTS + 2))
    except (OSError, UnicodeDecodeError, csv.Error, ValueError) as error:
        raise ValueError(f"'{path}' cannot be read: {getattr(error, 'strerror', None) or error}") from None
    lines = [line for line, row in enumerate(every, 1) if row]
    if len(lines) < 2:
        raise ValueError(f"'{path}' has no points")
    rows = [row for row in every if row]
    head, lines = [word.strip() for word in rows.pop(0)], lines[1:]
    place, unit = _columns(path, head)
    if len(wrong := np.flatnonzero(np.array(list(map(len, rows))) != len(head))):
        raise ValueError(f"'{path}' has {len(rows[wrong[0]])} columns in line {lines[wrong[0]]}, not {len(head)}")
    column = list(zip(*rows, strict=True))
    points = np.column_stack([_numbers(path, lines, column[place[axis]]) for axis in "xy"])
    kinds = [word.strip() for word in column[place["kind"]]] if "kind" in place else [""] * len(lines)
    names = [word.strip() for word in column[place["cell"]]]
    return OutlineTable(path, unit, tuple(_cells(path, lines, names, kinds, points)), "kind" in place)


def _columns(path: str, head: list[str]) -> tuple[dict[str, int], float | None]:
    """Numbers of the columns cell, x, y and kind; size of the unit of length [µm], None for pixels."""
    place: dict[str, int] = {}
    given = {}
    for number, word in enumerate(head):
        match, plain = _COLUMN.fullmatch(units.plain(word)), word.lower()
        name = match[1].lower() if match else "cell" if plain in IDS else plain
        if name not in ("cell", "x", "y", "kind") or name in place:
            raise ValueError(f"'{path}' has a column {show(word)} too many: expects cell,x,y and perhaps kind, such as "
                             "'cell,x_um,y_um'")
        place[name] = number
        if match:
            given[name] = match[2] or ""
    if lacking := [name for name in ("cell", "x", "y") if name not in place]:
        raise ValueError(f"'{path}' begins with {show(','.join(head))}, without the column {lacking[0]}: expects a "
                         "line such as 'cell,x_um,y_um'")
    if (given["x"] in _PIXELS) != (given["y"] in _PIXELS):
        raise ValueError(f"'{path}' has a unit for one of x and y alone: {show(','.join(head))}")
    if given["x"] in _PIXELS:
        return place, None
    try:
        x, y = (units.number(f"1 {given[axis]}", "um") for axis in "xy")
    except units.UnitError as error:
        raise ValueError(f"'{path}' line 1: {error}") from None
    if x != y:
        raise ValueError(f"'{path}' has x and y in different units: {show(','.join(head))}")
    return place, x


def _numbers(path: str, lines: list[int], words: tuple[str, ...]) -> np.ndarray:
    """Finite numbers (n,) that the words are."""
    try:
        values = np.array(list(map(float, words)))
    except ValueError:
        values = np.array([_number(word) for word in words])
    if len(wrong := np.flatnonzero(~np.isfinite(values))):
        raise ValueError(f"'{path}' line {lines[wrong[0]]}: {show(words[wrong[0]])} is not a number")
    return values


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return np.nan


def _cells(path: str, lines: list[int], names: list[str], kinds: list[str],
           points: np.ndarray) -> Iterator[Traced]:
    """Outlines of the cells, in the order of the file."""
    ids = np.array(names)
    ends = [*(np.flatnonzero(ids[1:] != ids[:-1]) + 1).tolist(), len(ids)]
    seen: dict[str, tuple[int, int]] = {}
    twice, start = [], 0
    for end in ends:
        name, span = names[start], (lines[start], lines[end - 1])
        if name in seen:
            twice.append(f"'{name}' begins again in line {span[0]}, after lines {seen[name][0]} to {seen[name][1]}")
        elif not name or not name.isprintable() or name == "all":
            raise ValueError(f"'{path}' line {span[0]}: {show(name)} cannot be the name of a cell")
        elif len(set(kinds[start:end])) > 1:
            raise ValueError(f"'{path}' lines {span[0]} to {span[1]}: the cell '{name}' is of two kinds")
        seen.setdefault(name, span)
        yield Traced(name, kinds[start], points[start:end], span)
        start = end
    if twice:
        more = f", and {len(twice) - 5} more" if len(twice) > 5 else ""
        raise ValueError(f"'{path}' has two cells of one id, or rows out of order: {'; '.join(twice[:5])}{more}")
