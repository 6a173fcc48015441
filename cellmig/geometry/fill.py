"""Particles within an outline: along it, in two rows beside the outline of a nucleus, and evenly between."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from . import polygons
from .delaunay import areas, triangles
from .resample import along

COARSE = 0.6  # least area of a hole's particles over its own, below which it is not resolved
CLEARANCE = 0.6  # least distance of inner particles from the outline at first, in spacings
SEAM = 2.0  # least radius of a nucleus, in spacings, along whose outline particles are laid
ROUNDS = 30  # in which the inner particles spread evenly


def fill(loops: list[np.ndarray], count: int, refinement: float, fixed: list[np.ndarray] | None = None,
         nucleus: list[np.ndarray] | None = None) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
    """`count` particles in closed loops: positions (count, 2), those of the surface first.

    Of each loop, the edges (m,) as well on which the segments from its particles to the next lie; and which particles
    are within the loops of a `nucleus` (count,) bool.  Along the surface particles are `refinement` times as dense as
    within.

    Raises ValueError if they are too few for the outline.
    """
    first = [polygons.first(loop) for loop in loops]  # wherever they are said to begin
    loops = [np.roll(loop, -k, axis=0) for loop, k in zip(loops, first, strict=True)]
    fixed = [(at - k) % len(loop) for at, k, loop in zip(fixed, first, loops, strict=True)] if fixed else None
    nucleus = [np.roll(loop, -polygons.first(loop), axis=0) for loop in nucleus or []]
    outline = polygons.joined(loops)
    # As for a disc in rings: each particle takes 1.047 h², those on the surface half as much.
    a, b = polygons.area(outline) / 1.047, (0.5 * refinement - 0.25) * polygons.sides(outline).sum()
    h = a / (np.sqrt(b**2 + a * (count - 1.0)) - b)
    corners = fixed or [None] * len(loops)
    rings, edge = zip(*(along(loop, h / refinement, at) for loop, at in zip(loops, corners, strict=True)), strict=True)
    for ring, loop in zip(rings[1:], loops[1:], strict=True):
        if polygons.area(ring) > COARSE * polygons.area(loop):  # both are negative
            raise ValueError(f"{count} particles are too few for the hole at "
                             "({:.4g}, {:.4g}) um".format(*polygons.centroid(loop)))
    surface, rough = np.concatenate(rings), polygons.joined(list(rings))
    if len(surface) >= count or any(polygons.crossing(ring) is not None for ring in rings):
        raise ValueError(f"{count} particles are too few for such an outline")
    seams = _beside(nucleus, rough, h)
    if len(surface) + len(seams) >= count:
        seams = seams[:0]
    inner = _lattice(rough, h, count - len(surface) - len(seams), seams)
    X = _spread(np.concatenate([surface, seams, inner]), len(surface) + len(seams))
    edge = [(e + k) % len(loop) for e, k, loop in zip(edge, first, loops, strict=True)]
    return X, edge, _within(X, len(surface), outline, nucleus, len(seams) > 0)


def _beside(nucleus: list[np.ndarray], surface: np.ndarray, h: float) -> np.ndarray:
    """Particles in two rows (k, 2) along the outline of a nucleus, which runs half-way between them, as far as it fits.

    A nucleus smaller than SEAM has none.
    """
    rows = np.zeros((0, 2))
    for loop in nucleus:
        if abs(polygons.area(loop)) > np.pi * (SEAM * h) ** 2:
            p = along(loop, h)[0]
            chord = np.roll(p, -1, axis=0) - p
            out = np.sqrt(0.75) * 0.5 * h * np.column_stack([chord[:, 1], -chord[:, 0]]) / polygons.sides(p)[:, None]
            middle = 0.5 * (out + np.roll(out, 1, axis=0))
            rows = np.concatenate([rows, p + middle, p + 0.5 * chord - out])  # in each other's gaps
    if len(rows):
        loops = polygons.joined(nucleus)
        rows = rows[polygons.inside(rows, surface)]
        rows = rows[(polygons.distance(rows, loops) > 0.35 * h) & (polygons.distance(rows, surface) > CLEARANCE * h)]
        rows = _merged(rows, 0.6 * h)
    return rows


def _merged(points: np.ndarray, apart: float) -> np.ndarray:
    """Points no closer than `apart`: those next to each other become one in their middle, until all are."""
    while len(close := cKDTree(points).query_pairs(apart, output_type="ndarray")):
        away = np.linalg.norm(points[close[:, 0]] - points[close[:, 1]], axis=1)
        least = np.full(len(points), apart)
        np.minimum.at(least, close, away[:, None])
        close = close[away <= least[close].min(axis=1) + 1e-6 * apart]  # each is the next of the other
        links = coo_array((np.ones(len(close)), close.T), shape=(len(points), len(points)))
        group = connected_components(links, directed=False)[1]
        points = np.column_stack([np.bincount(group, x) for x in points.T]) / np.bincount(group)[:, None]
    return points


def _within(X: np.ndarray, m: int, outline: np.ndarray, nucleus: list[np.ndarray], seamed: bool) -> np.ndarray:
    """Which particles are nucleus (n,) bool, none of the m of the surface; without a seam as many as its area takes."""
    within = np.zeros(len(X), bool)
    if nucleus:
        loops = polygons.joined(nucleus)
        inside = polygons.inside(X[m:], loops)
        share = polygons.area(loops) / polygons.area(outline)
        number = inside.sum() if seamed else round(share * (len(X) - 0.5 * m))
        depth = np.where(inside, 1.0, -1.0) * polygons.distance(X[m:], loops)
        within[m:] = _deepest(depth, max(number, 1))
    return within


def _deepest(depth: np.ndarray, number: int) -> np.ndarray:
    """Which are the deepest (n,) bool, about so many: those that are as deep are in or out together."""
    last, same = np.sort(depth)[::-1][number - 1], 1e-6 * np.abs(depth).max()
    fewer, more = depth > last + same, depth >= last - same
    return more if more.sum() - number <= number - fewer.sum() or not fewer.any() else fewer


def _lattice(outline: np.ndarray, h: float, count: int, seams: np.ndarray) -> np.ndarray:
    """`count` points of the widest triangular lattice with as many inside an outline, clear of it and of `seams`."""
    low, high = 0.3 * h, 2.0 * h
    for _ in range(25):
        s = 0.5 * (low + high)
        enough = len(_points(outline, s, CLEARANCE * min(s, h), seams)) >= count
        low, high = (s, high) if enough else (low, s)
    points = _points(outline, low, CLEARANCE * min(low, h), seams)
    if len(points) < count:
        raise ValueError(f"{count} particles do not fit inside such an outline")
    return points[_kept(points, polygons.distance(points, outline), polygons.centroid(outline), count, h)]


def _kept(points: np.ndarray, depth: np.ndarray, centre: np.ndarray, count: int, h: float) -> np.ndarray:
    """Which `count` of the points (n, 2) are kept (n,) bool: the deepest, and of left and right images both or none."""
    place = np.column_stack([depth, -points[:, 1], np.abs(points[:, 0] - centre[0])])
    _, group, size = np.unique(np.rint(place / (1e-6 * h)) + 0.0, axis=0, return_inverse=True, return_counts=True)
    group, excess, out = group.ravel(), len(points) - count, []
    for k, n in enumerate(size):  # the shallowest and highest first
        if n <= excess:
            out.append(k)
            excess -= n
    kept = ~np.isin(group, out)
    order = np.lexsort((points[:, 0], group))
    kept[order[kept[order]][:excess]] = False  # of a pair the left one, where there are only pairs
    return kept


def _points(outline: np.ndarray, s: float, clearance: float, seams: np.ndarray) -> np.ndarray:
    """Points of a triangular lattice with spacing s inside an outline, one of them in the centre of its area."""
    c, corners = polygons.centroid(outline), outline.reshape(-1, 2)
    low, high = corners.min(axis=0) - c, corners.max(axis=0) - c
    rows = np.arange(np.floor(low[1] / (s * np.sqrt(0.75))), np.ceil(high[1] / (s * np.sqrt(0.75))) + 1)
    columns = np.arange(np.floor(low[0] / s) - 1, np.ceil(high[0] / s) + 1)
    x = s * (columns[None, :] + 0.5 * (rows[:, None] % 2))
    y = np.broadcast_to(s * np.sqrt(0.75) * rows[:, None], x.shape)
    points = c + np.column_stack([x.ravel(), y.ravel()])
    points = points[polygons.inside(points, outline)]
    if len(seams):
        points = points[cKDTree(seams).query(points)[0] > 0.65 * clearance / CLEARANCE]
    return points[polygons.distance(points, outline) > clearance]


def _spread(X: np.ndarray, m: int) -> np.ndarray:
    """Points of which the first m are the outline and stay; the others move into the middle of what surrounds them."""
    for _ in range(ROUNDS):
        # Those between points of the outline alone may be outside.
        tri, share = triangles(X, lambda tri: (tri >= m).any(axis=1))
        size = share * areas(X, tri)
        weight = np.bincount(tri.ravel(), np.repeat(size, 3), len(X))
        middle = size[:, None] * X[tri].mean(axis=1)
        total = np.column_stack([np.bincount(tri.ravel(), np.repeat(middle[:, k], 3), len(X)) for k in range(2)])
        X = np.concatenate([X[:m], (total / np.maximum(weight, 1e-300)[:, None])[m:]])
    return X
