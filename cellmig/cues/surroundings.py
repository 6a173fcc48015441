"""What cells sense at a knot of the polarity: fields on their own surfaces, contacts with others, polarity, motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from ..meshfree.contact import Surfaces
from ..parallel.random import normal
from .contacts import Contacts, closeness, sizes


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What all cells sense at a time.  Means are over the outer surface of each cell as it is now.

    Attributes
    ----------
    time : float -- time of the knot [µs].
    knot : int -- its number, to which random numbers belong.
    seed : int -- of the case.
    names : tuple of str -- of all cells.
    surfaces : Surfaces -- their surfaces.
    x : (m, d) -- positions of all surface particles [µm].
    polarity : (cells, d - 1) -- polarity along the substrate [-].
    velocity : (cells, d - 1) -- mean velocity along the substrate since the last knot [µm/µs].
    fields : by name, what has `value(x, time)`, (n,) in the code's units at points x (n, d) [µm].
    gels : names of the bodies that are no cells, which do not count as neighbours.
    """

    time: float
    knot: int
    seed: int
    names: tuple[str, ...]
    surfaces: Surfaces
    x: np.ndarray
    polarity: np.ndarray
    velocity: np.ndarray
    fields: Mapping[str, Any] = field(default_factory=dict)
    gels: frozenset[str] = frozenset()
    _contacts: dict[float, Contacts] = field(default_factory=dict, init=False, repr=False)

    def concerned(self, cells: tuple[str, ...]) -> np.ndarray:
        """Whether a cell is one of these, by name, or there are none of these (cells,) bool."""
        return np.array([not cells or name in cells for name in self.names])

    @cached_property
    def shares(self) -> np.ndarray:
        """Shares of the particles (m,) [-] in the outer surface of their cell: each facet counts for its corners."""
        s, total = self.surfaces, np.zeros(len(self.x))
        outer = s.facets[s.outer]
        np.add.at(total, outer, sizes(self.x[outer])[:, None] / outer.shape[1])
        return total / np.bincount(s.cell, total, len(self.names))[s.cell]

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Means (cells, ...) of `values` (m, ...) at the surface particles [unit of the values]."""
        out = np.zeros((len(self.names), *values.shape[1:]))
        np.add.at(out, self.surfaces.cell, self.shares.reshape(-1, *[1] * (values.ndim - 1)) * values)
        return out

    @cached_property
    def centre(self) -> np.ndarray:
        """Centres of the outer surfaces (cells, d) [µm]."""
        return self.mean(self.x)

    @cached_property
    def arm(self) -> np.ndarray:
        """Positions of the particles along the substrate from the centre of their cell (m, d - 1) [µm]."""
        return (self.x - self.centre[self.surfaces.cell])[:, :-1]

    @cached_property
    def length(self) -> np.ndarray:
        """Lengths of the cells (cells,) [µm]: the largest distance along the substrate of two surface particles."""
        bounds = np.searchsorted(self.surfaces.cell, np.arange(len(self.names) + 1))
        return np.array([_diameter(self.arm[a:b]) for a, b in pairwise(bounds)])

    def occupancy(self, name: str, affinity: float) -> np.ndarray:
        """Shares Θ = c/(c + K) of occupied receptors at the surface particles (m,) [-]; without occupants zero.

        name : of the field c;  affinity : the level K at which half of them are occupied [unit of the field].

        Source: binding at equilibrium (Tranquillo, Lauffenburger & Zigmond, 1988, J. Cell Biol. 106:303-309).
        """
        level = np.maximum(self.fields[name].value(self.x, self.time), 0.0)
        return level / (level + affinity)

    def near(self, reach: float) -> Contacts:
        """Contacts of cells: parts of their outer surfaces within `reach` [µm] of that of another cell."""
        if reach not in self._contacts:
            gels = [number for number, name in enumerate(self.names) if name in self.gels]
            self._contacts[reach] = Contacts.of(self.surfaces, self.x, reach, gels)
        return self._contacts[reach]

    def gate(self, reach: float) -> np.ndarray:
        """Whether surface particles are in contact with another cell (m,) [-]: 1 up to half the `reach` [µm], 0 beyond.

        It falls gradually from half the reach to the reach.
        """
        return closeness(self.near(reach).distance, reach)

    def normal(self, purpose: str) -> np.ndarray:
        """Independent normal numbers (cells, d - 1) [-] that belong to seed, purpose, knot and the name of the cell."""
        n = self.x.shape[1] - 1
        return np.array([normal(self.seed, f"{purpose} {self.knot}", name, n) for name in self.names]).reshape(-1, n)


def _diameter(points: np.ndarray) -> float:
    """Largest distance of two of the points (n, d - 1) [µm]."""
    if points.shape[1] == 1:
        return float(np.ptp(points))
    corners = points[ConvexHull(points).vertices]
    return float(np.linalg.norm(corners[:, None] - corners, axis=2).max())
