"""The density of ligands on the substrate, over that of the bonds' law, as a smooth function for forces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .protocols import Field, Value

SPACING = 0.5  # of the samples [µm]
TILE = 64  # samples that are asked of a field together: the same ones in the same way, whatever the table begins with


@dataclass(frozen=True)
class LigandTable:
    """Shares λ of the bonds [-]: a field's samples at the nodes of a grid, in its units of length from the origin, as
    coefficients of uniform cubic B-splines.

    λ and its first two derivatives are continuous, it never leaves the range of the samples, a linear field is exact,
    and any other is smoothed: by (SPACING²/6) times its curvature.  Source: de Boor (1978), A Practical Guide to
    Splines.

    first : tuple of int -- number of the first sample, along each axis of the substrate;  samples : (n,) or in space
    (n, m) float [-].
    """

    first: tuple[int, ...]
    samples: np.ndarray

    @classmethod
    def of(cls, field: Field, low: np.ndarray, high: np.ndarray) -> LigandTable:
        """The table of a field from `low` (d - 1,) to `high` (d - 1,) [µm] at least, kept between 0 and 1."""
        first = np.floor(low / SPACING / TILE).astype(int) - 1
        count = np.ceil(high / SPACING / TILE).astype(int) + 1 - first
        samples = np.empty(TILE * count)
        for tile in np.ndindex(*count):
            at = np.stack(np.meshgrid(*(TILE * (first[k] + i) + np.arange(TILE) for k, i in enumerate(tile)),
                                      indexing="ij"), axis=-1)
            x = np.pad(SPACING * at.reshape(-1, len(first)), ((0, 0), (0, 1)))  # on the substrate
            part = tuple(slice(TILE * i, TILE * (i + 1)) for i in tile)
            samples[part] = np.clip(field.value(x, 0.0), 0.0, 1.0).reshape(at.shape[:-1])
        return cls(tuple(int(n) for n in TILE * first), samples)

    def holds(self, low: np.ndarray, high: np.ndarray) -> bool:
        """Whether it has all places from `low` (d - 1,) to `high` (d - 1,) [µm]."""
        first = np.array(self.first)
        return bool((low / SPACING >= first + 2).all() and (high / SPACING <= first + self.samples.shape - 3).all())

    def at(self, *place: Value) -> tuple[Value, list[Value]]:
        """λ [-] and its slopes along the axes of the substrate [1/µm] at places (n,) [µm], one for each axis."""
        last = [n - 3 for n in self.samples.shape]
        number, weights, slopes = [], [], []
        for x, first, most in zip(place, self.first, last, strict=True):
            k = np.clip(np.floor(getattr(x, "value", x) / SPACING).astype(int) - first, 1, most)
            number.append(k)
            u = x * (1.0 / SPACING) - (k + first)
            weights.append(spline(u))
            slopes.append([slope / SPACING for slope in spline_slope(u)])
        return self._sum(number, weights), [self._sum(number, [slopes[k] if k == axis else weights[k]
                                                               for k in range(len(weights))])
                                            for axis in range(len(weights))]

    def _sum(self, number: list[np.ndarray], factors: list[Any]) -> Value:
        """Sum of the samples around times the products of factors along the axes."""
        total: Any = 0.0
        for shift in np.ndindex(*(4,) * len(number)):
            product: Any = self.samples[tuple(k + i - 1 for k, i in zip(number, shift, strict=True))]
            for along, i in zip(factors, shift, strict=True):
                product = along[i] * product
            total = total + product
        return total


def spline(u: Value) -> tuple:
    """Weights [-] of the four samples around a place that is a share u of the spacing beyond the second of them."""
    r = 1.0 - u
    return (r * r * r / 6.0, (4.0 - u * u * (6.0 - 3.0 * u)) / 6.0, (4.0 - r * r * (6.0 - 3.0 * r)) / 6.0,
            u * u * u / 6.0)


def spline_slope(u: Value) -> tuple:
    """Their derivatives by u [-]."""
    r = 1.0 - u
    return -0.5 * r * r, u * (1.5 * u - 2.0), r * (2.0 - 1.5 * r), 0.5 * u * u
