"""Arrangements of a colony's cells: in a grid, a hexagonal lattice or at random, in a box or along a line.

Cells count as boxes in a grid, and as discs or balls around them elsewhere; along a line in the plane, their gaps are
exact.  Numbers are rounded such that every machine finds the same places.
"""

from __future__ import annotations

import statistics
import zlib
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from ..case import gaps
from ..case.registry import law, parameter, quantity
from . import random_packing
from .random_packing import Unfit, permutation, uniform

CLASSES = 8  # sizes of equal shapes that stand for a distribution: cells of one size are built once
DIGITS = 9  # decimals of a centre [µm]
MOST = 1e6  # largest coordinate [µm]
TRIES, CLOSE = 12, 0.8  # changes of the region of a given mean gap, at least this share of which it has to have


@dataclass(frozen=True, eq=False)
class Footprint:
    """Extent of a cell about its centre: corners of its box `low`, `high` (k,), `outline` (n, d), `height` [µm]."""

    low: np.ndarray
    high: np.ndarray
    outline: np.ndarray
    height: float

    @classmethod
    def of(cls, outline: np.ndarray, height: float, k: int) -> Footprint:
        """That of an outline, or of points of a surface (n, d) [µm], in k coordinates."""
        return cls(outline[:, :k].min(axis=0), outline[:, :k].max(axis=0), outline, height)

    @property
    def middle(self) -> np.ndarray:
        """Middle of the box (k,) [µm]."""
        return 0.5 * (self.low + self.high)

    @cached_property
    def radius(self) -> float:
        """Radius of the disc or ball about the middle that contains the cell [µm]."""
        away = self.outline[:, : len(self.low)] - self.middle
        return float(np.sqrt((away * away).sum(axis=1).max()))


@dataclass(frozen=True, kw_only=True)
class Packing:
    """What all arrangements have: whose cells, where, how far apart, of which sizes."""

    cells: tuple = parameter("names of the tables [[cells]] whose copies it places; by default all", (),
                             items="table")
    box: tuple | None = quantity("um", "two opposite corners of the region; with a coordinate less than the case has "
                                 "dimensions, it is a part of the substrate, and `rest` or `centre` of the cells gives "
                                 "their height", None, minimum=-MOST, maximum=MOST, shape=(2, None))
    corner: tuple | None = quantity("um", "in place of a box, the lower corner of a region that is as large as needed, "
                                    "and as square as possible", None, minimum=-MOST, maximum=MOST,
                                    shape=(None,))
    gap: float | None = quantity("um", "least gap between cells; by default the equilibrium distance of adhesion.cells",
                                 None, minimum=0, maximum=1000)
    order: str = parameter("whether cells of several tables are \"mixed\" at random, or follow each other as \"given\"",
                           "mixed", choices=("mixed", "given"))
    size_spread: float = quantity("", f"standard deviation of the cells' lengths over their mean; {CLASSES} sizes "
                                  "stand for the normal distribution", 0.0, minimum=0, maximum=0.4)

    def __post_init__(self) -> None:
        """Check the region.

        Raises ValueError unless there is one; the message is for the user.
        """
        if (self.box is None) == (self.corner is None):
            raise ValueError("give either box, two corners of the region, or corner, its lower one")
        if self.box is not None and (len({*map(len, self.box)}) > 1 or not (self._widths > 0.0).all()):
            raise ValueError("box: expects the lower corner, then the upper one, with as many coordinates")

    @property
    def _widths(self) -> np.ndarray:
        low, high = self.box or ((), ())
        return np.array([b - a for a, b in zip(low, high, strict=False)])

    @property
    def axes(self) -> int:
        """Number k of coordinates of the region."""
        return len(self.box[0] if self.box is not None else self.corner or ())

    @property
    def lower(self) -> np.ndarray:
        """Lower corner of the region (k,) [µm]."""
        return np.array(self.box[0] if self.box is not None else self.corner)

    @property
    def _name(self) -> int:
        """Number that tells random numbers of several colonies apart."""
        return zlib.crc32("\0".join(self.cells).encode())

    def footprint(self, outline: np.ndarray, height: float) -> Footprint:
        """Extent of a cell, from an `outline`, or points of a surface, (n, d) about its centre, at a height [µm]."""
        return Footprint.of(outline, height, self.axes)

    def sizes(self, n: int, seed: int) -> np.ndarray:
        """Lengths of n cells over those of their tables (n,) [-]: quantiles of the distribution, in random order."""
        if not self.size_spread:
            return np.ones(n)
        usual = statistics.NormalDist()
        z = np.array([usual.inv_cdf((k + 0.5) / CLASSES) for k in range(CLASSES)])
        size = np.round(1.0 + self.size_spread * z / np.sqrt((z * z).mean()), 6)
        return size[permutation(n, seed, self._name, "sizes") % CLASSES]

    def places(self, cells: list[Footprint], gap: float, seed: int) -> np.ndarray:
        """Centres of the cells (n, k) [µm].

        Raises Unfit where there is no room; the message is for the user.
        """
        order = (np.arange(len(cells)) if self.order == "given" else
                 permutation(len(cells), seed, self._name, "order"))
        found = np.zeros((len(cells), self.axes))
        found[order] = self._arranged([cells[k] for k in order], gap, seed)
        return np.round(found, DIGITS)

    def _arranged(self, cells: list[Footprint], gap: float, seed: int) -> np.ndarray:
        raise NotImplementedError

    def _in_row(self, cells: list[Footprint], gap: float) -> np.ndarray:
        """Centres (n, 1) [µm] of cells beside each other, a gap apart, from the lower end on."""
        known: dict[tuple[int, int], float] = {}
        x = [float(self.lower[0] - cells[0].low[0])]
        for a, b in pairwise(cells):
            if (id(a), id(b)) not in known:
                known[id(a), id(b)] = _beside(a, b, gap)
            x.append(x[-1] + known[id(a), id(b)])
        end = x[-1] + cells[-1].high[0]
        if self.box is not None and end > self.box[1][0] + 1e-9:
            raise Unfit(f"is {self._widths[0]:.4g} um long, a row of the {len(cells)} cells {end - self.lower[0]:.4g} "
                        "um")
        return np.array(x)[:, None]


def _beside(a: Footprint, b: Footprint, gap: float) -> float:
    """Distance [µm] along x of the centres of two cells, b on the right of a, whose surfaces are a gap apart."""
    along = float(a.high[0] - b.low[0]) + gap
    left, right = (np.add(cell.outline, (0.0, cell.height)) for cell in (a, b))
    corners = cKDTree(left)
    for _ in range(100):  # the distance of surfaces grows no faster than `along`: it is reached from above
        moved = np.add(right, (along, 0.0))
        excess = gaps.gap(left, moved, 1.001 * corners.query(moved)[0].min()) - gap
        along -= max(excess, 0.0)
        if excess < 1e-9:
            break
    return along


class _Lattice(Packing):
    """Base class of lattices."""

    def _arranged(self, cells: list[Footprint], gap: float, seed: int) -> np.ndarray:
        n = len(cells)
        if self.axes == 1:
            return self._in_row(cells, gap)
        low, size, step = self._unit(cells, gap)
        if self.box is not None:
            columns = np.floor((self._widths - size) / step + 1e-9).astype(int) + 1
            if (columns < 1).any():
                raise Unfit(f"is narrower than a cell, {size.max():.4g} um")
            for axis in range(self.axes):  # a row may lack its last place; more rows than needed are left out
                columns[axis] = min(columns[axis], 1 + -(-n // np.prod(np.maximum(columns[:axis] - 1, 1))))
        else:  # as square as possible
            columns = np.ones(self.axes, int)
            while len(self._points(columns)) < n:
                columns[np.argmin(columns * step)] += 1
        points = self._points(columns)
        if self.box is not None:
            points = points[(points * step <= self._widths - size + 1e-9).all(axis=1)]
        if len(points) < n:
            raise Unfit(f"has room for {len(points)} cells in this lattice, not for {n}")
        return self.lower + low + points[:n] * step - np.array([c.middle for c in cells])

    def _unit(self, cells: list[Footprint], gap: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Middle of the first cell, from the lower corner, size of a cell and step of the lattice, (k,) [µm] each."""
        raise NotImplementedError

    def _points(self, columns: np.ndarray) -> np.ndarray:
        """Points of the lattice (m, k) [steps], the first coordinate fastest."""
        axes = np.meshgrid(*(np.arange(float(c)) for c in columns[::-1]), indexing="ij")
        return np.stack(axes[::-1], axis=-1).reshape(-1, len(columns))


@law("colony", "grid")
class Grid(_Lattice):
    """Rows and columns as wide as the largest cell, with a gap; along a line, a row of cells with exact gaps."""

    def _unit(self, cells: list[Footprint], gap: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        size = np.max([c.high - c.low for c in cells], axis=0)
        return 0.5 * size, size, size + gap


@law("colony", "hexagonal")
class Hexagonal(_Lattice):
    """Hexagonal lattice in the plane, each cell a gap from six others if all are discs of one size."""

    def _unit(self, cells: list[Footprint], gap: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        if self.axes == 3:
            raise Unfit("a hexagonal lattice is in a plane: give two coordinates")
        size = np.full(2, 2.0 * max(c.radius for c in cells))
        return 0.5 * size, size, (size + gap) * [1.0, np.sqrt(0.75)]

    def _points(self, columns: np.ndarray) -> np.ndarray:
        points = super()._points(columns)
        points[:, 0] += 0.5 * (points[:, 1] % 2)
        return points


@law("colony", "random")
class Random(Packing):
    """Random places, by the case's seed, the same on every machine.

    Cells begin anywhere in the region, and those that overlap push each other apart until none do.  With `corner`, the
    region is such that they have a mean gap.

    Source: the collective rearrangement of Jodrey & Tory (1985), Phys. Rev. A 32:2347-2351, without growth.
    """

    mean_gap: float | None = quantity("um", "mean of the gaps between a cell and its nearest one, along a line between "
                                      "neighbours; the region is as large as it takes", None, minimum=0,
                                      maximum=1000)

    def __post_init__(self) -> None:
        """Check the region and the mean gap.

        Raises ValueError where they do not fit together; the message is for the user.
        """
        super().__post_init__()
        if (self.corner is None) != (self.mean_gap is None):
            raise ValueError("mean_gap: goes with corner; in a box, the room decides how far apart cells are")

    def _arranged(self, cells: list[Footprint], gap: float, seed: int) -> np.ndarray:
        if self.mean_gap is not None and self.mean_gap < gap:
            raise Unfit(f"{self.mean_gap:.4g} um is less than the least gap, {gap:.4g} um", "mean_gap")
        if self.axes == 1:
            return self._along_line(cells, gap, seed)
        radius, middle = np.array([c.radius for c in cells]), np.array([c.middle for c in cells])
        start = uniform((len(cells), self.axes), seed, self._name, "places")
        if self.box is not None:
            places = random_packing.packed(start, radius, gap, self._widths)
        else:
            places = self._spaced(start, radius, gap)
        return self.lower + places - middle

    def _along_line(self, cells: list[Footprint], gap: float, seed: int) -> np.ndarray:
        tight = self._in_row(cells, gap)
        share = np.sort(uniform((len(cells),), seed, self._name, "places"))
        if self.box is not None:
            return tight + (self.box[1][0] - tight[-1, 0] - cells[-1].high[0]) * share[:, None]
        share = (share - share[0]) / max(share[-1] - share[0], 1e-300)
        return tight + (float(self.mean_gap or 0.0) - gap) * (len(cells) - 1) * share[:, None]

    def _spaced(self, start: np.ndarray, radius: np.ndarray, gap: float) -> np.ndarray:
        """Places (n, k) [µm] in a square or cube with the mean gap."""
        k, want, size = start.shape[1], float(self.mean_gap or 0.0), 2.0 * float(np.cumsum(radius)[-1]) / len(radius)
        if len(start) == 1:
            return np.full((1, k), radius[0])
        side, least = round(len(radius) ** (1.0 / k) * (size + want), DIGITS), np.inf
        for _ in range(TRIES):
            try:
                places = random_packing.packed(start, radius, gap, np.full(k, side))
            except Unfit:
                break
            least = random_packing.mean_gap(places, radius)
            if CLOSE * want <= least <= want:
                break
            side *= (size + 0.95 * want) / (size + least)
        if least > want:
            raise Unfit(f"{want:.4g} um was not reached at random: take more, or a lattice", "mean_gap")
        return random_packing.stretched(places, radius, want)
