"""Outlines from files: two columns of coordinates under a line that names them with their unit."""

from __future__ import annotations

import csv
import os
import re

from .messages import show

LARGEST = 100_000  # corners: a longer file is something else
MOST_BYTES = 100 * LARGEST  # so is one of long lines, or a device that never ends


def corners(path: str) -> list[list[str]]:
    """Corners in a CSV file under the header "x_um,y_um" (or another unit), as quantities of a case file.

    Raises ValueError; its text is for the user.
    """
    if os.path.exists(path) and not os.path.isfile(path):
        raise ValueError(f"'{path}' is no file")
    try:
        if os.path.getsize(path) > MOST_BYTES:
            raise ValueError("it is too large for an outline")
        with open(path, encoding="utf-8-sig", newline="") as stream:
            rows = [row for _, row in zip(range(LARGEST + 2), csv.reader(stream), strict=False)]
    except (OSError, UnicodeDecodeError, csv.Error, ValueError) as error:
        raise ValueError(f"'{path}' cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if len(rows) > LARGEST + 1:
        raise ValueError(f"'{path}' has more than {LARGEST} corners")
    first = rows[0] if rows else []
    head = [re.fullmatch(rf"\s*{axis}_(\w+)\s*", word) for axis, word in zip("xy", first, strict=False)]
    if len(first) != 2 or not all(head):
        raise ValueError(f"'{path}' begins with {show(','.join(first))}, not with a line such as 'x_um,y_um'")
    found = []
    for line, row in enumerate(rows[1:], 2):
        if row and len(row) != 2:
            raise ValueError(f"'{path}' has {len(row)} numbers in line {line}, not two")
        found += [[f"{word.strip()} {unit[1]}" for word, unit in zip(row, head, strict=True)]] if row else []
    return found
