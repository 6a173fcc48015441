"""What surfaces of cells secrete into a field and take up from it, and the account of its molecules."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..meshfree.contact import Surfaces


@dataclass(frozen=True)
class Exchanging:
    """Facets of surfaces that exchange with a field, once for each exchange that they are in.

    Attributes
    ----------
    facets : (f, d) int -- corners, as indices of the positions of surface particles.
    cell : (f,) int -- their cells.
    secretion, uptake : (f,) -- rates, and largest rates, of an area [1/µm²/µs].
    half : (f,) -- concentration at which uptake is half of the largest [1/µm³].
    """

    facets: np.ndarray
    cell: np.ndarray
    secretion: np.ndarray
    uptake: np.ndarray
    half: np.ndarray

    @classmethod
    def of(cls, surfaces: Surfaces, names: Sequence[str], exchanges: Sequence[Any]) -> Exchanging:
        """The outer facets of the cells that `exchanges` of one field name, among the `names` of all cells."""
        of_facet = surfaces.cell[surfaces.facets[:, 0]]
        parts = [(np.flatnonzero(surfaces.outer & np.isin(of_facet, [names.index(name) for name in e.cells or names])),
                  e) for e in exchanges]
        at = np.concatenate([on for on, _ in parts]) if parts else np.zeros(0, np.int64)
        rates = [np.concatenate([np.full(len(on), getattr(e, name) or 1.0 * (name == "half")) for on, e in parts])
                 if parts else np.zeros(0) for name in ("secretion", "uptake", "half")]
        return cls(surfaces.facets[at], of_facet[at], *rates)

    def at(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Middles (f, d) [µm] and sizes (f,) [µm], in space [µm²], of the facets between positions x (m, d) [µm]."""
        corners = x[self.facets]
        sides = corners[:, 1:] - corners[:, :1]
        size = (np.linalg.norm(sides[:, 0], axis=1) if x.shape[1] == 2
                else 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1))
        return corners.mean(axis=1), size


@dataclass
class Molecules:
    """Account of the molecules of a field since its start, in two dimensions per µm of thickness [1/µm].

    Attributes
    ----------
    secreted, taken : (cells,) -- by each cell, and from the field.
    out, decayed : what left through walls, less what came in; what decayed.
    start, inside : what was there at the start, and what is there now; zero for a field that is always in equilibrium.
    """

    secreted: np.ndarray
    taken: np.ndarray
    out: float = 0.0
    decayed: float = 0.0
    start: float = 0.0
    inside: float = 0.0

    @property
    def lost(self) -> float:
        """What is there, was taken up, went out and decayed, less what was secreted and there at the start."""
        return float(np.sum([self.inside, self.taken.sum(), self.out, self.decayed, -self.secreted.sum(), -self.start]))

    @property
    def turnover(self) -> float:
        """Sum of the sizes of all entries, of which the error of the balance is a part."""
        return float(np.sum(np.abs([self.inside, self.taken.sum(), self.out, self.decayed, self.secreted.sum(),
                                    self.start])))
