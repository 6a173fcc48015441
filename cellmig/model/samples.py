"""Samples of fields from files: tables of places and values, and images; as text, which a manifest can hold."""

from __future__ import annotations

import base64
import csv
import math
import os
import zlib
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from ..case.messages import show

LARGEST = 4_000_000  # most samples of a field
MOST_BYTES = 100 * LARGEST  # largest file [B]: a larger one, or an endless device, is none
AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Samples:
    """Values at all nodes of a grid, in units that stand beside; as text, which is quickly compared.

    Attributes
    ----------
    places : tuple of (axis, str) -- along "x", "y" or "z" the ascending places of the nodes, "0 10 20 …".
    values : str -- at the nodes, the last axis the fastest.
    path : str -- the file; "" if they are not from one.
    """

    places: tuple[tuple[str, str], ...]
    values: str
    path: str = field(default="", compare=False)

    @classmethod
    def of(cls, given: Any) -> Samples:
        """Samples from a table such as `written` returns.

        Raises ValueError where it is none; the message is for the user.
        """
        if isinstance(given, Samples):
            return given
        try:
            found = cls(tuple((axis, str(given[axis])) for axis in AXES if axis in given), str(given["values"]))
            sound = bool(found.places) and all((np.diff(at) > 0.0).all() for at in found.nodes.values())
            sound = sound and bool(np.isfinite(found.grid).all())
        except (TypeError, KeyError, ValueError):
            sound = False
        if not sound:
            raise ValueError(f"expects the name of a table of places and values, such as \"c.csv\", not {show(given)}")
        return found

    def written(self) -> dict[str, str]:
        """The table from which `of` makes the samples."""
        return {**dict(self.places), "values": self.values}

    @cached_property
    def nodes(self) -> dict[str, np.ndarray]:
        """Places of the nodes by axis (n,), in the unit beside."""
        return {axis: np.array(text.split(), float) for axis, text in self.places}

    @cached_property
    def grid(self) -> np.ndarray:
        """Values at the nodes (nx, ...), an axis for each of `places`, in the unit beside."""
        return np.array(self.values.split(), float).reshape([len(at) for at in self.nodes.values()])


def samples(path: str) -> Samples:
    """Samples from a CSV file with a column "value", and one or more of the columns "x", "y" and "z".

    Its rows are all nodes of a grid, in any order.  Raises ValueError for any other; the message is for the user.
    """
    head, rows = _rows(path)
    axes = [name for name in AXES if name in head]
    if sorted([*axes, "value"]) != sorted(head) or not axes:
        raise ValueError(f"'{path}' has the columns {show(','.join(head))}, not x and value, such as 'x,value', or "
                         "those of a grid, 'x,y,value'; their units are keys of the case")
    try:
        table = np.array([[float(word) for word in row] for _, row in rows])
    except ValueError:
        line, row = next((line, row) for line, row in rows if not all(map(_is_number, row)))
        raise ValueError(f"'{path}' line {line}: {show(','.join(row))} are not numbers") from None
    if not np.isfinite(table).all():
        raise ValueError(f"'{path}' line {rows[int(np.argwhere(~np.isfinite(table))[0, 0])][0]}: a value is not finite")
    table = table[:, [head.index(name) for name in (*axes, "value")]]
    order = np.lexsort(table.T[-2::-1])
    places = [np.unique(at) for at in table.T[:-1]]
    size = math.prod(map(len, places))
    if size != len(table) or (np.stack(np.meshgrid(*places, indexing="ij"), axis=-1).reshape(-1, len(axes))
                              != table[order, :-1]).any():
        raise ValueError(f"'{path}' has {len(table)} rows, not one value at each of the {size} nodes of a grid"
                         if len(axes) > 1 else f"'{path}' has two values at one place")
    return Samples(tuple((axis, _text(at)) for axis, at in zip(axes, places, strict=True)), _text(table[order, -1]),
                   path)


def _rows(path: str) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Names of the columns of a CSV file, and its rows with the numbers of their lines, from 1."""
    _check_file(path)
    try:
        with open(path, encoding="utf-8-sig", newline="") as stream:
            reader = csv.reader(stream)
            rows = [(reader.line_num, [word.strip() for word in row]) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"'{path}' cannot be read: {getattr(error, 'strerror', None) or error}") from None
    rows = [(line, row) for line, row in rows if any(row)]
    if len(rows) < 2:
        raise ValueError(f"'{path}' has no rows of places and values")
    head = rows[0][1]
    for line, row in rows[1:]:
        if len(row) != len(head):
            raise ValueError(f"'{path}' has {len(row)} words in line {line}, not {len(head)}")
    return head, rows[1:]


def _check_file(path: str) -> None:
    if not os.path.exists(path):
        raise ValueError(f"no file '{path}'")
    if not os.path.isfile(path):
        raise ValueError(f"'{path}' is no file")
    if os.path.getsize(path) > MOST_BYTES:
        raise ValueError(f"'{path}' is too large for a field")


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _text(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)


@dataclass(frozen=True)
class Pixels:
    """Greys of an image from 0, black, to 1, white.

    Attributes
    ----------
    size : (int, int) -- columns and rows.
    data : str -- 16 bits a pixel, row by row from the top, compressed by zlib, in base 64.
    path : str -- the file; "" if it is not from one.
    """

    size: tuple[int, int]
    data: str
    path: str = field(default="", compare=False)

    @classmethod
    def of(cls, given: Any) -> Pixels:
        """An image from a table such as `written` returns.

        Raises ValueError where it is none; the message is for the user.
        """
        if isinstance(given, Pixels):
            return given
        try:
            columns, rows = given["size"]
            found = cls((int(columns), int(rows)), str(given["data"]))
            found.grey  # noqa: B018 -- whether it can be read
        except (TypeError, KeyError, ValueError, zlib.error):
            raise ValueError(f"expects the name of an image, such as \"c.png\", not {show(given)}") from None
        return found

    def written(self) -> dict[str, Any]:
        """The table from which `of` makes the image."""
        return {"size": list(self.size), "data": self.data}

    @cached_property
    def grey(self) -> np.ndarray:
        """Greys (rows, columns) [-], the upper row first."""
        raw = np.frombuffer(zlib.decompress(base64.b64decode(self.data, validate=True)), "<u2")
        return raw.reshape(self.size[::-1]) / 65535.0


def pixels(path: str) -> Pixels:
    """The greys of an image of 8 or 16 bits: PNG, TIFF and what Pillow reads besides; colours by their luminance.

    Raises ValueError for any other file; the message is for the user.
    """
    from PIL.Image import DecompressionBombError  # comes with matplotlib
    from PIL.Image import open as opened

    _check_file(path)
    try:
        with opened(path) as image:
            if image.width * image.height > LARGEST:
                raise ValueError(f"'{path}' has more than {LARGEST} pixels")
            if image.mode == "F":
                raise ValueError(f"'{path}' has real numbers for pixels, so that none is white: save it with 16 bits")
            deep = image.mode.startswith("I")
            raw = np.asarray(image if deep else image.convert("L"), np.int64)
            size = image.size
    except (OSError, SyntaxError, DecompressionBombError) as error:
        raise ValueError(f"'{path}' is no image that can be read: {error}") from None
    raw = np.clip(raw, 0, 65535) if deep else 257 * raw
    return Pixels(size, base64.b64encode(zlib.compress(raw.astype("<u2").tobytes(), 9)).decode(), path)
