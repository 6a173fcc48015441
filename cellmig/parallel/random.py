"""Random numbers as a function of seed, purpose and name, independent of ranks and of the order of calls."""

from __future__ import annotations

import hashlib

import numpy as np


def uniform(seed: int, purpose: str, name: str, n: int) -> np.ndarray:
    """The first n of the numbers in [0, 1) that belong to (seed, purpose, name), (n,) [-]."""
    return np.random.Generator(stream(seed, purpose, name)).random(n)


def normal(seed: int, purpose: str, name: str, n: int) -> np.ndarray:
    """The first n of the normal numbers, of mean 0 and variance 1, that belong to (seed, purpose, name), (n,) [-]."""
    return np.random.Generator(stream(seed, purpose, name)).standard_normal(n)


def stream(seed: int, purpose: str, name: str) -> np.random.Philox:
    """All random bits that belong to (seed, purpose, name), one after another.

    Source: the counter-based generator Philox (Salmon et al. 2011).
    """
    words = np.frombuffer(hashlib.sha256(f"{purpose}\0{name}".encode()).digest(), "<u4")
    return np.random.Philox(np.random.SeedSequence([seed, *words.tolist()]))
