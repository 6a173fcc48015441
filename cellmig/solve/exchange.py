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
        on = [np.flatnonzero(surfaces.outer & np.isin(of_facet, [names.index(name) for name in e.cells or names]))
              for e in exchanges]
        at = np.concatenate([*on, np.zeros(0, np.int64)])
        secretion, uptake, half = (np.repeat([getattr(e, name) or 0.0 for e in exchanges], [len(some) for some in on])
                                   for name in ("secretion", "uptake", "half"))
        return cls(surfaces.facets[at], of_facet[at], secretion, uptake, half)

    def at(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Middles (f, d) [µm] and sizes (f,) [µm], in space [µm²], of the facets between positions x (m, d) [µm]."""
        corners = x[self.facets]
        sides = corners[:, 1:] - corners[:, :1]
        size = (np.linalg.norm(sides[:, 0], axis=1) if x.shape[1] == 2
                else 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1))
        return corners.mean(axis=1), size


@dataclass
class Molecules:
    """Account of the molecules of a field since its start, in two dimensions per µm of thickness.

    Attributes
    ----------
    secreted, taken : (cells,) -- by each cell, and from the field by each cell [-], [1/µm].
    out, decayed : float -- what left through walls, less what came in; what decayed [-], [1/µm].
    crossed : float -- what passed walls in either direction [-], [1/µm].
    rounded : float -- what rounding of concentrations may have moved [-], [1/µm].
    start, inside : float -- what was there at the start, and what is there now [-], [1/µm]; 0 for a field that is
        always in equilibrium.
    """

    secreted: np.ndarray
    taken: np.ndarray
    out: float = 0.0
    decayed: float = 0.0
    crossed: float = 0.0
    rounded: float = 0.0
    start: float = 0.0
    inside: float = 0.0

    @property
    def lost(self) -> float:
        """What is there, was taken up, went out and decayed, less what was secreted and there at the start [-]."""
        return self.inside + float(self.taken.sum()) + self.out + self.decayed - float(self.secreted.sum()) - self.start

    @property
    def turnover(self) -> float:
        """Sum of what is there, was there and passed in any way [-], to which the error of the balance is compared."""
        return (self.inside + float(self.taken.sum()) + self.crossed + self.decayed + float(self.secreted.sum())
                + self.start)

    def enter(self, rates: dict[str, Any], duration: float) -> None:
        """Add flows by name, numbers or (cells,) [1/µs], over a duration [µs]."""
        for name, rate in rates.items():
            setattr(self, name, getattr(self, name) + duration * rate)

    def saved(self) -> dict[str, Any]:
        """All entries as JSON."""
        return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in vars(self).items()}

    @classmethod
    def restored(cls, entries: dict[str, Any]) -> Molecules:
        """The account that `saved` returned."""
        arrays: dict[str, Any] = {name: np.array(entries[name]) for name in ("secreted", "taken")}
        return cls(**entries | arrays)
