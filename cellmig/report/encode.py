"""Arrays as text in a page: rounded to a number of bits, compressed, in base64; `data.js` reads them again."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np

LEVEL = 6  # of zlib: level 9 saves 1 % and takes four times as long


def packed(values: np.ndarray) -> dict[str, Any]:
    """An array as it is, float64 as float32: its type, shape and compressed bytes."""
    kinds = {"f": "f4", "i": "i4", "u": "u4", "b": "u1"}
    kind = values.dtype.str[1:] if values.dtype.itemsize < 4 else kinds[values.dtype.kind]
    return {"type": kind, "shape": list(values.shape), "bytes": _text(values.astype(f"<{kind}").tobytes())}


def evened(values: np.ndarray, bits: int) -> dict[str, Any]:
    """The same of values with long tails, such as stresses of which a few are a thousand times the others.

    asinh((value - centre) / scale) is rounded, with the median as centre, and as scale that of the distances from it:
    values near the centre keep their absolute error, those in the tails their relative one.  Zeros stay zero where half
    of the values are.

    Returns
    -------
    dict -- as `rounded` does, with "centre" and "scale".
    """
    finite = values[np.isfinite(values)]
    centre = float(np.median(finite)) if len(finite) else 0.0
    away = np.abs(finite - centre)
    scale = float(np.median(away[away > 0.0])) if away.any() else 1.0
    return {"centre": centre, "scale": scale, **rounded(np.arcsinh((values - centre) / scale), bits)}


def rounded(values: np.ndarray, bits: int) -> dict[str, Any]:
    """Arrays of frames in whole numbers of `bits` <= 15 bits between their least and largest value.

    What is stored is the change from frame to frame, low bytes first and then high bytes, which compresses best.

    Parameters
    ----------
    values : (frames, ...) float -- nan is kept.
    bits : int -- the error is at most half of the range over 2**bits - 3.

    Returns
    -------
    dict -- "low", "step", "shape", "bytes": value = step * (low + number), with a whole `low`, so that zero stays zero;
        the number "missing" stands for nan.
    """
    finite = np.isfinite(values)
    low, high = (float(end(values, where=finite, initial=start)) for end, start in ((np.min, np.inf),
                                                                                    (np.max, -np.inf)))
    if low > high:
        low = high = 0.0
    most = 2**bits - 1
    step = (high - low) / (most - 2) or abs(low) or 1.0
    first = round(low / step)
    numbers = np.where(finite, np.rint(np.where(finite, values, low) / step) - first, most).astype(np.int32)
    change = np.diff(numbers, axis=0, prepend=0)
    zigzag = ((change << 1) ^ (change >> 31)).astype(np.uint16)  # small numbers of both signs become small ones
    planes = np.concatenate([(zigzag & 255).ravel(), (zigzag >> 8).ravel()]).astype(np.uint8)
    return {"low": first, "step": step, "missing": most, "shape": list(values.shape),
            "bytes": _text(planes.tobytes())}


def size(data: Any) -> int:
    """Letters that packed or rounded arrays take, in whatever holds them."""
    if isinstance(data, dict):
        return sum(map(size, data.values()))
    if isinstance(data, list | tuple):
        return sum(map(size, data))
    return len(data) if isinstance(data, str) else 0


def _text(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data, LEVEL)).decode()
