"""Shapes of cells: where their particles lie, which are nucleus, which are surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..case.registry import law, quantity
from . import polygons


class Layout(NamedTuple):
    """Particles of one cell about its centre.

    X : (n, 2) -- reference positions [µm];  nucleus : (n,) bool -- inside the nucleus;
    surface : (m,) int -- the surface particles, along closed loops: the outer one counterclockwise, holes clockwise;
    after : (m,) int -- position in `surface` of the one that follows, None if all are one loop in this order;
    parts : by name, positions in `surface` where the segments of a part of the boundary begin, None if none has one.
    """

    X: np.ndarray
    nucleus: np.ndarray
    surface: np.ndarray
    after: np.ndarray | None = None
    parts: dict[str, np.ndarray] | None = None

    @property
    def next(self) -> np.ndarray:
        """Position in `surface` of the one that follows (m,) int."""
        return np.roll(np.arange(len(self.surface)), -1) if self.after is None else self.after


@law("shape", "disc")
class Disc:
    """Disc with a concentric nucleus, in rings of particles; the spacing along them is that across, but for the last.

    The interface of the nucleus lies half-way between two rings, so that its area is exact.
    """

    radius: float = quantity("um", "radius R", above=0)
    nucleus_ratio: float | None = quantity("", "radius of the nucleus over R", None, above=0, maximum=0.95)

    parts = ("surface",)

    @property
    def area(self) -> float:
        """Area π R² [µm²]."""
        return float(np.pi * self.radius**2)

    def outline(self, n: int = 64) -> np.ndarray:
        """Polygon of the surface about the centre (n, 2) [µm]."""
        return self.radius * polygons.circle(n)

    def lowest(self) -> float:
        """Height of the lowest point over the centre [µm], negative."""
        return -self.radius

    def particles(self, count: int, refinement: float = 1.0) -> Layout:
        """Exactly `count` particles: one in the centre, then rings, the last on the surface, `refinement` as dense."""
        radii, inner = self._rings(count, refinement)
        numbers = _share(count - 1, np.append(radii[:-1], refinement * radii[-1]))
        X, nucleus = [np.zeros((1, 2))], [np.array([inner > 0])]
        for i, (r, m) in enumerate(zip(radii, numbers, strict=True), 1):
            X.append(r * polygons.circle(m))  # from the lowest point: symmetric left and right
            nucleus.append(np.full(m, i <= inner))
        return Layout(np.concatenate(X), np.concatenate(nucleus), np.arange(count - numbers[-1], count))

    def _rings(self, count: int, refinement: float) -> tuple[np.ndarray, int]:
        """Radii of the rings [µm] and how many of them are nucleus (with the centre, if any)."""
        b = 6.0 * refinement - 3.0
        n = max(1, round((np.sqrt(b * b + 12.0 * (count - 1)) - b) / 6.0))  # 6 i particles on ring i
        if self.nucleus_ratio is None:
            return self.radius * np.arange(1, n + 1) / n, 0
        inner = min(max(1, round(self.nucleus_ratio * n - 0.5)), n - 1)
        r = self.nucleus_ratio * self.radius
        inside = r * np.arange(1, inner + 1) / (inner + 0.5)
        outside = r + (self.radius - r) * (np.arange(n - inner) + 0.5) / (n - inner - 0.5)
        return np.concatenate([inside, outside]), inner


def _share(total: int, weight: np.ndarray) -> np.ndarray:
    """Particles per ring, in proportion to a weight, `total` in all."""
    exact = total * weight / weight.sum()
    numbers = np.maximum(np.floor(exact).astype(int), 3)
    for i in np.argsort(numbers - exact, kind="stable")[: total - numbers.sum()]:
        numbers[i] += 1
    return numbers
