"""Random numbers by purpose and cell: a function of the place, not of the rank or the order of calls."""

from __future__ import annotations

import zlib

import numpy as np


def uniform(seed: int, purpose: str, cell: int, n: int) -> np.ndarray:
    """The first n of the numbers in [0, 1) that belong to (seed, purpose, cell), by a counter-based generator."""
    key = np.random.SeedSequence([seed, zlib.crc32(purpose.encode()), cell])
    return np.random.Generator(np.random.Philox(key)).random(n)
