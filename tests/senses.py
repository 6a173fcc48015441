"""Rigid cells with surfaces of any spacing, and what they sense: for tests of cues."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from cellmig.cues.surroundings import Surroundings
from cellmig.meshfree.contact import Surfaces


class Profile:
    """A field given by a function of the points (n, d) [µm]."""

    def __init__(self, function: Callable[[np.ndarray], Any]):
        self.function = function

    def value(self, x: np.ndarray, time: float) -> np.ndarray:
        return np.broadcast_to(self.function(x), len(x)).astype(float)


def disc(count: int, centre: Sequence[float], radius: float = 5.0) -> tuple[np.ndarray, np.ndarray]:
    """Points of a circle, and its segments."""
    angle = 2.0 * np.pi * np.arange(count) / count
    return polygon(centre + radius * np.column_stack([np.cos(angle), np.sin(angle)]))


def polygon(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    n = np.arange(len(corners))
    return np.asarray(corners, float), np.column_stack([n, (n + 1) % len(n)])


def ball(count: int, centre: Sequence[float], radius: float = 5.0) -> tuple[np.ndarray, np.ndarray]:
    """Points of a sphere on a spiral, and the triangles between them."""
    z, turn = 1 - (2 * np.arange(count) + 1) / count, np.arange(count) * np.pi * (3 - 5**0.5)
    points = np.column_stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z])
    return centre + radius * points, ConvexHull(points).simplices


def tube(count: int, rows: int = 2, radius: float = 5.0) -> tuple[np.ndarray, np.ndarray]:
    """The upright wall of a cylinder: a ring of receptors."""
    angle = 2.0 * np.pi * np.arange(count) / count
    ring = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    points = np.concatenate([np.column_stack([ring, np.full(count, float(k))]) for k in range(rows)])
    a, b = np.arange(count), (np.arange(count) + 1) % count
    triangles = [np.column_stack(t) + k * count for k in range(rows - 1)
                 for t in ((a, b, b + count), (a, b + count, a + count))]
    return points, np.concatenate(triangles)


def sensed(*cells: tuple[np.ndarray, np.ndarray], fields: dict[str, Any] | None = None, polarity: Any = None,
           velocity: Any = None, names: Sequence[str] | None = None, knot: int = 0, seed: int = 1) -> Surroundings:
    """What cells of these points and facets sense, at rest and without polarity unless told otherwise."""
    counts = [len(points) for points, _ in cells]
    start = np.concatenate([[0], np.cumsum(counts)])
    x = np.concatenate([points for points, _ in cells])
    facets = np.concatenate([a + f for a, (_, f) in zip(start, cells, strict=False)])
    none = np.zeros(0, np.int64)
    every, number = np.arange(len(x)), np.arange(len(facets))
    s = Surfaces(every, np.repeat(np.arange(len(cells)), counts), facets, every, number, np.ones(len(facets)),
                 np.ones(len(facets), bool), none, none, np.zeros(0), none, 1.0)
    still = np.zeros((len(cells), x.shape[1] - 1))
    return Surroundings(0.0, knot, seed, tuple(names or (f"Cell-{k + 1}" for k in range(len(cells)))), s, x,
                        still if polarity is None else np.asarray(polarity, float),
                        still if velocity is None else np.asarray(velocity, float),
                        {name: Profile(f) for name, f in (fields or {}).items()})
