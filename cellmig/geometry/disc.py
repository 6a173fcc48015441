"""Layout of the particles of a cell, and the shape `disc`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..case.registry import law, quantity
from . import polygons


class Layout(NamedTuple):
    """Particles of one cell, with the centre of the cell as origin.

    Attributes
    ----------
    X : (n, 2) -- reference positions [µm].
    nucleus : (n,) bool -- whether a particle belongs to the nucleus.
    surface : (m,) int -- surface particles along closed loops, the outer one counterclockwise, holes clockwise.
    after : (m,) int -- index in `surface` of the next particle on the loop; None if `surface` is one loop in order.
    parts : dict of (k,) int -- by name of a part of the boundary, indices in `surface` where its segments begin.
    """

    X: np.ndarray
    nucleus: np.ndarray
    surface: np.ndarray
    after: np.ndarray | None = None
    parts: dict[str, np.ndarray] | None = None

    @property
    def next(self) -> np.ndarray:
        """Index in `surface` of the next particle on the loop (m,) int."""
        return np.roll(np.arange(len(self.surface)), -1) if self.after is None else self.after


@law("shape", "disc")
class Disc:
    """Disc of radius R with a concentric nucleus, filled with rings of particles.

    The spacing along a ring equals that between rings; on the surface it may be finer.  The nucleus ends half-way
    between two rings, so that its area is exact.
    """

    radius: float = quantity("um", "radius R", above=0)
    nucleus_ratio: float | None = quantity("", "radius of the nucleus over R", None, above=0, maximum=0.95)

    parts = ("surface",)
    dimension = 2

    @property
    def area(self) -> float:
        """Area π R² [µm²]; particles represent it per unit thickness."""
        return float(np.pi * self.radius**2)

    def outline(self, n: int = 64) -> np.ndarray:
        """Polygon (n, 2) [µm] of the surface, with the centre as origin."""
        return self.radius * polygons.circle(n)

    def lowest(self) -> float:
        """Height of the lowest point above the centre [µm], -R."""
        return -self.radius

    def particles(self, count: int, refinement: float = 1.0) -> Layout:
        """Exactly `count` particles: one at the centre, then rings, of which the last is the surface.

        Along the surface, particles are `refinement` times as dense [-] as inside.
        """
        radii, inner = self._rings(count, refinement)
        numbers = _share(count - 1, np.append(radii[:-1], refinement * radii[-1]))
        X, nucleus = [np.zeros((1, 2))], [np.array([inner > 0])]
        for i, (r, m) in enumerate(zip(radii, numbers, strict=True), 1):
            X.append(r * polygons.circle(m))  # begins at the lowest point: left and right are symmetric
            nucleus.append(np.full(m, i <= inner))
        return Layout(np.concatenate(X), np.concatenate(nucleus), np.arange(count - numbers[-1], count))

    def _rings(self, count: int, refinement: float) -> tuple[np.ndarray, int]:
        """Radii of the rings [µm], and the number of them in the nucleus."""
        b = 6.0 * refinement - 3.0
        n = max(1, round((np.sqrt(b * b + 12.0 * (count - 1)) - b) / 6.0))  # as ring i has 6 i particles
        if self.nucleus_ratio is None:
            return self.radius * np.arange(1, n + 1) / n, 0
        inner = min(max(1, round(self.nucleus_ratio * n - 0.5)), n - 1)
        r = self.nucleus_ratio * self.radius
        inside = r * np.arange(1, inner + 1) / (inner + 0.5)
        outside = r + (self.radius - r) * (np.arange(n - inner) + 0.5) / (n - inner - 0.5)
        return np.concatenate([inside, outside]), inner


def _share(total: int, weight: np.ndarray) -> np.ndarray:
    """Numbers of particles of the rings, `total` in all, in proportion to `weight` but at least 3 each."""
    exact = total * weight / weight.sum()
    numbers = np.maximum(np.floor(exact).astype(int), 3)
    for i in np.argsort(numbers - exact, kind="stable")[: total - numbers.sum()]:
        numbers[i] += 1
    return numbers
