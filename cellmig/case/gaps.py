"""Gaps at the start: between cells, and to the substrate; cells that no bonds tie to the substrate."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from .expression import evaluate
from .pairs import paired
from .schema import Case

OUTLINE = 720  # points of an outline: that of a disc of radius 5 µm deviates by 0.05 nm
FEW = 100  # corners of polygons each of whose edges is tried as a line between it and another
MANY = 12  # corners of a polygon that need no points between them: in an overlap, there are corners


class Pressed(NamedTuple):
    """Two cells closer than their law of adhesion holds them apart: their gap [µm], the law."""

    gap: float
    law: Any


class Arrangement(NamedTuple):
    """Arrangement of the cells of a case at the start, from their outlines and displacements.

    Attributes
    ----------
    box : (2, d) -- lower left and upper right corner of the bounding box [µm].
    heights : (cells,) -- heights of the lowest points [µm].
    gap : float -- least gap between two cells [µm]; None if there is one cell.
    pair : tuple -- indices of these two cells.
    pressed : Pressed -- the two cells that are pressed together most; None if none are.
    group : (cells,) int -- number of the group of cells that bonds tie together.
    floating : (k,) int -- cells that bonds tie to the substrate neither directly nor through other cells.
    """

    box: np.ndarray
    heights: np.ndarray
    gap: float | None
    pair: tuple[int, int] | None
    pressed: Pressed | None
    group: np.ndarray
    floating: np.ndarray


def arrangement(case: Case) -> Arrangement:
    """Arrangement of the cells of a case at the start; bonds form up to their cutoff."""
    shared = {key: outline(*key) for key in {(c.shape, c.displacement) for c in case.cells}}
    outlines = [shared[c.shape, c.displacement] for c in case.cells]
    centres = np.array([c.centre for c in case.cells])
    low, high = _boxes(outlines, centres)
    pairing, laws = paired([c.name for c in case.cells], case.pairs)[0], [*(p.law for p in case.pairs), case.contact]
    reach = max((law.cutoff for law in laws if law), default=0.0)
    measure = _Measure([c.shape for c in case.cells], outlines, centres)
    gaps = {pair: one for pair in near(outlines, centres, reach) if (one := measure(*pair, reach)) < reach}
    least = min(gaps.items(), key=lambda item: item[1], default=None) or _nearest(outlines, centres, measure)
    bonds = {pair: law for pair in gaps if (law := laws[pairing.of(*pair)])}
    ties = [pair for pair, law in bonds.items() if law.work and gaps[pair] < law.cutoff]
    pressed = [Pressed(gaps[pair], law) for pair, law in bonds.items() if gaps[pair] < law.cap]
    group, floating = _groups(ties, len(outlines)), np.zeros(0, int)
    if case.substrate is not None:
        floating = np.flatnonzero(~np.isin(group, group[low[:, -1] < case.substrate.cutoff]))
    box = np.array([low.min(axis=0), high.max(axis=0)])
    return Arrangement(box, low[:, -1], least and least[1], least and least[0],
                       min(pressed, key=lambda one: one.gap / one.law.cap, default=None), group, floating)


def outline(shape: Any, displacement: tuple) -> np.ndarray:
    """Outline, in space points of the surface, (n, d) [µm] from the cell's centre, with the initial displacement."""
    points = surface(shape)
    with np.errstate(all="ignore"):
        moved = points + np.column_stack([evaluate(value, points) for value in displacement])
    finite = np.isfinite(moved).all(axis=1)  # a formula may be infinite where no particle is
    return np.where(finite[:, None], moved, points)


def surface(shape: Any) -> np.ndarray:
    """Outline, in space points of the surface, (n, d) [µm] from the cell's centre, fine enough to measure gaps."""
    return shape.outline(1 if len(getattr(shape, "corners", ())) >= MANY else OUTLINE)


def _groups(ties: list[tuple[int, int]], n: int) -> np.ndarray:
    """Number of the connected component of each of n cells, of which `ties` are pairs (n,) int."""
    i, j = np.array(ties, int).reshape(-1, 2).T
    return connected_components(sparse.coo_matrix((np.ones(len(i)), (i, j)), (n, n)), directed=False)[1]


def _nearest(outlines: list[np.ndarray], centres: np.ndarray, measure: _Measure) -> tuple | None:
    """The pair of cells with the least gap, and the gap; None if there is one cell."""
    within, found = 1e-3 * float(np.ptp(outlines[0])), {}
    while len(outlines) > 1 and not found:  # cells are at least as far apart as their boxes
        within *= 2.0
        found = {p: one for p in near(outlines, centres, within) if (one := measure(*p, within)) < within}
    return min(found.items(), key=lambda item: item[1], default=None)


class _Measure:
    """Gaps between cells [µm]; pairs of equal relative position, as in a grid, are measured once."""

    def __init__(self, shapes: list, outlines: list[np.ndarray], centres: np.ndarray):
        self._shapes, self._outlines, self._centres, self._known = shapes, outlines, centres, {}
        self._places = centres.tolist()

    def __call__(self, i: int, j: int, most: float) -> float:
        """Gap between two cells, exact up to `most`; in space without initial displacements."""
        a, b = self._outlines[i], self._outlines[j]
        key = id(a), id(b), *[round(q - p, 9) for p, q in zip(self._places[i], self._places[j], strict=True)], most
        if key not in self._known:
            apart = self._centres[j] - self._centres[i]
            self._known[key] = gap(a, b + apart, most) if len(apart) == 2 else min(
                _from(self._shapes[i], a, b + apart, most), _from(self._shapes[j], b, a - apart, most))
        return self._known[key]


def _from(shape: Any, surface: np.ndarray, points: np.ndarray, most: float) -> float:
    """Least distance [µm] of points from a body, of which `surface` has points; inf if it exceeds `most`."""
    points = points[_between(points, points, surface.min(axis=0), surface.max(axis=0), most)]
    return float(shape.distances(points).min()) if len(points) else math.inf


def gap(a: np.ndarray, b: np.ndarray, most: float) -> float:
    """Distance [µm] of two polygons a (n, 2) and b (m, 2) [µm] that do not overlap; inf if it exceeds `most`."""
    return min(_apart(a, b, most), _apart(b, a, most))


def _apart(points: np.ndarray, polygon: np.ndarray, most: float) -> float:
    """Least distance [µm] of points from the edges of a polygon; inf if it exceeds `most`."""
    p, q = polygon, np.roll(polygon, -1, axis=0)
    points = points[_between(points, points, p.min(axis=0), p.max(axis=0), most)]
    if len(points):
        edges = _between(np.minimum(p, q), np.maximum(p, q), points.min(axis=0), points.max(axis=0), most)
        p, q = p[edges], q[edges]
    return float(_distances(points, p, q).min()) if len(points) and len(p) else math.inf


def _between(low: np.ndarray, high: np.ndarray, bottom: np.ndarray, top: np.ndarray, margin: float) -> np.ndarray:
    """Whether each of n boxes is within a margin of the box from `bottom` to `top` (n,) bool."""
    return ((low <= top + margin) & (high >= bottom - margin)).all(axis=1)


def _boxes(outlines: list[np.ndarray], centres: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower left and upper right corners of the bounding boxes of cells, (n, d) [µm] each."""
    boxes = {key: (o.min(axis=0), o.max(axis=0)) for key, o in {id(o): o for o in outlines}.items()}
    low, high = (np.array([boxes[id(o)][side] for o in outlines]) + centres for side in (0, 1))
    return low, high


def near(outlines: list[np.ndarray], centres: np.ndarray, within: float = 0.0) -> Iterator[tuple[int, int]]:
    """Pairs i < j of cells whose bounding boxes overlap or are less than `within` [µm] apart.

    `outlines` are (k, d) [µm] each, from the cells' `centres` (n, d) [µm].
    """
    if len(outlines) < 2:
        return
    low, high = _boxes(outlines, centres)
    high = high + within
    order = np.argsort(low[:, 0], kind="stable")
    ends = np.searchsorted(low[order, 0], high[order, 0])
    for n, i in enumerate(order):
        others = order[n + 1:ends[n]]
        for j in others[(low[others, 1:] < high[i, 1:]).all(axis=1) & (high[others, 1:] > low[i, 1:]).all(axis=1)]:
            yield int(min(i, j)), int(max(i, j))


def depth(shapes: tuple, outlines: tuple, apart: np.ndarray) -> float:
    """Largest depth [µm] of a corner of one of two outlines, or of a point of one of two surfaces, in the other; their
    middles count, too, as two equal surfaces may coincide.

    shapes, outlines : of both;  apart : (d,) -- from the centre of the first to that of the second [µm].
    """
    (one, other), (a, b) = shapes, outlines
    if len(apart) == 2:
        return overlap(a, b + apart)
    a, b = _with_middle(one, a), _with_middle(other, b)
    return max(0.0, -float(one.distances(b + apart).min()), -float(other.distances(a - apart).min()))


def _with_middle(shape: Any, points: np.ndarray) -> np.ndarray:
    """Points (n, 3) [µm] of the surface of a shape, and their mean if it is inside."""
    middle = points.mean(axis=0, keepdims=True)
    return np.concatenate([points, middle]) if shape.distances(middle)[0] < 0.0 else points


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Largest depth [µm] of a corner, or the mean of the corners, of one of the polygons a, b (k, 2) in the other."""
    axis = b.mean(axis=0) - a.mean(axis=0)
    if (a @ axis).max() < (b @ axis).min() or (len(a) <= FEW and _side_by_side(a, b)):
        return 0.0  # a straight line separates them, as is usual for neighbours
    return max(_inside(_probes(a), b), _inside(_probes(b), a))


def _side_by_side(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether the line through an edge of the counterclockwise polygon a (k, 2) separates it from b (m, 2)."""
    edge = np.roll(a, -1, axis=0) - a
    out = np.stack([edge[:, 1], -edge[:, 0]])
    return bool(((a @ out).max(axis=0) < (b @ out).min(axis=0)).any())


def _probes(polygon: np.ndarray) -> np.ndarray:
    """Corners of a polygon, and their mean if that is inside: the corners of two equal polygons may coincide."""
    middle = polygon.mean(axis=0, keepdims=True)
    return np.concatenate([polygon, middle]) if _inside(middle, polygon) > 0 else polygon


@np.errstate(all="ignore")  # division by zero for edges along x, which cross no ray; underflow in tiny shapes
def _inside(points: np.ndarray, polygon: np.ndarray) -> float:
    """Largest depth [µm] of the points inside a polygon, by the crossings of a ray along +x; 0 if none is inside."""
    points = points[((points >= polygon.min(axis=0)) & (points <= polygon.max(axis=0))).all(axis=1)]
    if not len(points):
        return 0.0
    p, q = every = polygon, np.roll(polygon, -1, axis=0)
    may = (np.maximum(p[:, 1], q[:, 1]) >= points[:, 1].min()) & (np.minimum(p[:, 1], q[:, 1]) <= points[:, 1].max())
    p, q = p[may], q[may]
    x, y = points[:, :1], points[:, 1:]
    crosses = ((p[:, 1] <= y) != (q[:, 1] <= y)) & (
        x < p[:, 0] + (y - p[:, 1]) / (q[:, 1] - p[:, 1]) * (q[:, 0] - p[:, 0]))
    inside = points[crosses.sum(axis=1) % 2 == 1]
    return float(_distances(inside, *every).min(axis=1).max()) if len(inside) else 0.0


def _distances(points: np.ndarray, p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Distances (n, m) [µm] of points (n, 2) from the edges from p to q, (m, 2) each."""
    edge = q - p
    along = np.clip(((points[:, None] - p) * edge).sum(-1) / (edge**2).sum(-1), 0.0, 1.0)
    return np.linalg.norm(points[:, None] - p - along[..., None] * edge, axis=-1)
