"""Discs in the plane and balls in space at random places that do not overlap, with the same bits on every machine.

Random bits are those of a generator that never changes; sums are in the order of sorted pairs; all else are sums,
products, quotients and square roots, whose rounding is fixed.
"""

from __future__ import annotations

import zlib

import numpy as np
from scipy.spatial import cKDTree

SWEEPS = 3000  # most moves of all cells
BEYOND = 3e-3  # what cells are pushed apart beyond touching, over their distance: touching is then reached in the end
PUSH = 0.9  # share of an overlap by which each of two cells moves: more than half, since others push back
DENSEST = {2: 0.85, 3: 0.62}  # covered fractions that random places do not exceed, by dimensions
SMALLER = 0.99  # steps in which cells that do not fit shrink, until they do
SKIN = 0.3  # distance beyond touching up to which pairs are watched, over the mean radius


class Unfit(ValueError):
    """Cells for which there is no room; `key` of the colony that tells where."""

    def __init__(self, message: str, key: str = "box"):
        super().__init__(message)
        self.key = key


def _bits(n: int, seed: int, name: int, purpose: str) -> np.ndarray:
    """Random bits (n,) uint64 that belong to seed, name and purpose.

    Source: the counter-based generator Philox (Salmon et al. 2011).
    """
    return np.random.Philox(np.random.SeedSequence([seed, name, zlib.crc32(purpose.encode())])).random_raw(n)


def uniform(shape: tuple[int, ...], seed: int, name: int, purpose: str) -> np.ndarray:
    """Random numbers in [0, 1) of a `shape` such as (n, 2) [-]."""
    bits = _bits(int(np.prod(shape)), seed, name, purpose)
    return ((bits >> np.uint64(11)) * 2.0**-53).reshape(shape)


def permutation(n: int, seed: int, name: int, purpose: str) -> np.ndarray:
    """Random order of n items (n,) int."""
    return np.argsort(_bits(n, seed, name, purpose), kind="stable")


def packed(start: np.ndarray, radius: np.ndarray, gap: float, widths: np.ndarray) -> np.ndarray:
    """Centres (n, k) [µm] of discs or balls in the box from zero to `widths` (k,) [µm], at least a gap apart.

    Parameters
    ----------
    start : (n, k) -- random places, over the free widths of the box [-].
    radius : (n,) -- radii [µm].
    gap : float -- least gap [µm].
    widths : (k,) -- of the box [µm].

    Raises Unfit where they do not fit; the message tells how much of the box they would cover, and which share of it
    was reached, with smaller ones.
    """
    low, high = np.broadcast_to(radius[:, None], start.shape), widths - radius[:, None]
    if (high < low).any():
        raise Unfit(f"is {widths.min():.4g} um wide, less than a cell, {2.0 * radius.max():.4g} um")
    x, wanted = low + start * (high - low), _cover(radius + 0.5 * gap, widths)
    size = min(1.0, (DENSEST[len(widths)] / wanted) ** (1.0 / len(widths)))
    if size == 1.0:
        x, done = _rearranged(x, radius, gap, (low, high), SWEEPS, PUSH)
        if done:
            return x
    done = False
    while not done:
        size *= SMALLER
        x, done = _rearranged(x, size * radius, size * gap, (low, high), SWEEPS // 10, 0.5)
    raise Unfit(f"is too small: the cells, with half of the gap around them, would cover {wanted:.3g} of it, and "
                f"{wanted * size ** len(widths):.3g} was reached at random")


def _rearranged(x: np.ndarray, radius: np.ndarray, gap: float, bounds: tuple[np.ndarray, np.ndarray], sweeps: int,
                push: float) -> tuple[np.ndarray, bool]:
    """Places (n, k) [µm] within bounds after at most so many sweeps from the places x; whether all are a gap apart.

    push : share of an overlap by which each of two cells moves [-].
    """
    reach, skin = 2.0 * float(radius.max()) + gap, SKIN * float(radius.mean())
    seen, found = np.full(x.shape, np.inf), False
    for _ in range(sweeps):
        if not found or 4.0 * ((x - seen) ** 2).sum(axis=1).max() > skin * skin:
            pairs, seen, found = _near(x, reach + skin), x, True
            touching = radius[pairs[:, 0]] + radius[pairs[:, 1]] + gap
        apart, away = _apart(x, pairs)
        if (away >= touching).all():
            return x, True
        x = np.clip(x + push * _overlaps(apart, away, (1.0 + BEYOND) * touching, pairs, len(x)), *bounds)
    return x, False


def _cover(radius: np.ndarray, widths: np.ndarray) -> float:
    """Covered fraction of a box [-]."""
    unit = {2: np.pi, 3: 4.0 / 3.0 * np.pi}[len(widths)]
    return float(unit * (radius ** len(widths)).sum() / np.prod(widths))


def _near(x: np.ndarray, reach: float) -> np.ndarray:
    """Sorted pairs (m, 2) int of centres within reach [µm]."""
    pairs = cKDTree(x).query_pairs(reach, output_type="ndarray")
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def _apart(x: np.ndarray, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vectors (m, k) from the second to the first of each pair, and their lengths (m,) [µm]."""
    apart = x[pairs[:, 0]] - x[pairs[:, 1]]
    square = apart[:, 0] * apart[:, 0]
    for column in apart.T[1:]:  # in this order on every machine
        square = square + column * column
    return apart, np.sqrt(square)


def _overlaps(apart: np.ndarray, away: np.ndarray, touching: np.ndarray, pairs: np.ndarray, n: int) -> np.ndarray:
    """Sums (n, k) [µm] of the overlaps of each with others, as vectors away from these."""
    on = np.flatnonzero(away < touching)
    apart, away, pairs = apart[on], away[on], pairs[on]
    same = away == 0.0
    unit = np.where(same[:, None], np.eye(apart.shape[1])[0], apart / np.where(same, 1.0, away)[:, None])
    overlap = (touching[on] - away)[:, None] * unit
    return np.column_stack([np.bincount(pairs[:, 0], column, n) - np.bincount(pairs[:, 1], column, n)
                            for column in overlap.T])


def nearest(places: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Gaps (n,) [µm] between each disc or ball and its nearest one, from their places (n, k) and radius (n,) [µm]."""
    reach = 2.0 * float(radius.max())
    least = np.full(len(places), np.inf)
    tree = cKDTree(places)
    far = tree.query(places, k=2)[0][:, 1].max() + reach  # the nearest centre bounds the nearest surface
    pairs = tree.query_pairs(far, output_type="ndarray")
    _, away = _apart(places, pairs)
    for side in (0, 1):
        np.minimum.at(least, pairs[:, side], away - radius[pairs[:, 0]] - radius[pairs[:, 1]])
    return least


def mean_gap(places: np.ndarray, radius: np.ndarray) -> float:
    """Mean gap [µm] between a disc or ball and its nearest one, from their places (n, k) and radius (n,) [µm]."""
    return float(np.cumsum(nearest(places, radius))[-1] / len(places))


def stretched(places: np.ndarray, radius: np.ndarray, want: float) -> np.ndarray:
    """The places (n, k) [µm] of discs or balls of a radius (n,) [µm], stretched to the mean gap `want` [µm]."""
    low, high = 1.0, 1.0
    while mean_gap(high * places, radius) < want:
        high *= 1.1
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if mean_gap(middle * places, radius) >= want else (middle, high)
    return high * places
