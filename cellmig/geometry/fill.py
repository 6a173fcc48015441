"""Particles inside an outline: along it, in two rows along the interface of a nucleus, and evenly elsewhere."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from . import polygons
from .delaunay import areas, triangles
from .resample import resample

COARSE = 0.6  # a hole is resolved if the polygon of its particles has at least this fraction of its area
CLEARANCE = 0.6  # least initial distance of inner particles from the outline [spacings]
RESOLVED = 2.0  # a nucleus of at least this radius [spacings] has rows of particles along its interface
ROUNDS = 30  # iterations that even out the inner particles


def fill(loops: list[np.ndarray], count: int, refinement: float, fixed: list[np.ndarray] | None = None,
         nucleus: list[np.ndarray] | None = None) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
    """Fill closed loops with exactly `count` particles.

    Parameters
    ----------
    loops : list of (k, 2) -- the outer loop, then the holes, which run clockwise [µm].
    refinement : float -- density of particles along the surface over that inside [-].
    fixed : list of (c,) int -- for each loop, the corners at which there has to be a particle.
    nucleus : list of (k, 2) -- loops around the nucleus [µm].

    Returns
    -------
    X : (count, 2) -- positions, surface particles first, loop by loop [µm].
    edge : list of (m,) int -- for each loop, the edge on which the segment from each particle to the next lies.
    inner : (count,) bool -- whether a particle belongs to the nucleus.

    Raises ValueError if the particles are too few for the outline; the message is for the user.
    """
    first = [polygons.first_corner(loop) for loop in loops]  # results do not depend on where a list begins
    loops = [np.roll(loop, -k, axis=0) for loop, k in zip(loops, first, strict=True)]
    fixed = [(at - k) % len(loop) for at, k, loop in zip(fixed, first, loops, strict=True)] if fixed else None
    nucleus = [np.roll(loop, -polygons.first_corner(loop), axis=0) for loop in nucleus or []]
    outline = polygons.joined(loops)
    # As in a disc of rings, a particle has the area 1.047 h², or half of that on the surface.
    a, b = polygons.area(outline) / 1.047, (0.5 * refinement - 0.25) * polygons.sides(outline).sum()
    h = a / (np.sqrt(b**2 + a * (count - 1.0)) - b)
    corners: list[Any] = [None] * len(loops) if fixed is None else list(fixed)
    rings, edge = zip(*map(resample, loops, [h / refinement] * len(loops), corners), strict=True)
    for ring, loop in zip(rings[1:], loops[1:], strict=True):
        if polygons.area(ring) > COARSE * polygons.area(loop):  # both areas are negative
            raise ValueError(f"{count} particles are too few for the hole at "
                             "({:.4g}, {:.4g}) um".format(*polygons.centroid(loop)))
    surface, rough = np.concatenate(rings), polygons.joined(list(rings))
    if len(surface) >= count or any(polygons.crossing(ring) is not None for ring in rings):
        raise ValueError(f"{count} particles are too few for such an outline")
    interface = _interface(nucleus, rough, h)
    if len(surface) + len(interface) >= count:
        interface = interface[:0]
    inner = _lattice(rough, h, count - len(surface) - len(interface), interface)
    X = _spread(np.concatenate([surface, interface, inner]), len(surface) + len(interface))
    edge = [(e + k) % len(loop) for e, k, loop in zip(edge, first, loops, strict=True)]
    return X, edge, _within(X, len(surface), outline, nucleus, len(interface) > 0)


def _interface(nucleus: list[np.ndarray], surface: np.ndarray, h: float) -> np.ndarray:
    """Particles (k, 2) of two rows, one on either side of the interface of a resolved nucleus, where there is room."""
    rows = np.zeros((0, 2))
    for loop in nucleus:
        if abs(polygons.area(loop)) > np.pi * (RESOLVED * h) ** 2:
            p = resample(loop, h)[0]
            chord = np.roll(p, -1, axis=0) - p
            out = np.sqrt(0.75) * 0.5 * h * np.column_stack([chord[:, 1], -chord[:, 0]]) / polygons.sides(p)[:, None]
            middle = 0.5 * (out + np.roll(out, 1, axis=0))
            rows = np.concatenate([rows, p + middle, p + 0.5 * chord - out])  # staggered by half a spacing
    if len(rows):
        loops = polygons.joined(nucleus)
        rows = rows[polygons.inside(rows, surface)]
        rows = rows[(polygons.distance(rows, loops) > 0.35 * h) & (polygons.distance(rows, surface) > CLEARANCE * h)]
        rows = _merged(rows, 0.6 * h)
    return rows


def _merged(points: np.ndarray, apart: float) -> np.ndarray:
    """Points at least `apart` from each other: the closest neighbours are replaced by their mean, until all are."""
    while len(close := cKDTree(points).query_pairs(apart, output_type="ndarray")):
        away = np.linalg.norm(points[close[:, 0]] - points[close[:, 1]], axis=1)
        least = np.full(len(points), apart)
        np.minimum.at(least, close, away[:, None])
        close = close[away <= least[close].min(axis=1) + 1e-6 * apart]  # nearest neighbours of each other
        group = polygons.clusters(close, len(points))
        points = np.column_stack([np.bincount(group, x) for x in points.T]) / np.bincount(group)[:, None]
    return points


def _within(X: np.ndarray, m: int, outline: np.ndarray, nucleus: list[np.ndarray], rows: bool) -> np.ndarray:
    """Whether each particle is nucleus (n,) bool; the first m, on the surface, are not.

    Without `rows` along the interface, the deepest particles are nucleus, in the number that its area asks for.
    """
    within = np.zeros(len(X), bool)
    if nucleus:
        loops = polygons.joined(nucleus)
        inside = polygons.inside(X[m:], loops)
        share = polygons.area(loops) / polygons.area(outline)
        number = inside.sum() if rows else round(share * (len(X) - 0.5 * m))
        depth = np.where(inside, 1.0, -1.0) * polygons.distance(X[m:], loops)
        within[m:] = _deepest(depth, max(number, 1))
    return within


def _deepest(depth: np.ndarray, number: int) -> np.ndarray:
    """Whether each is one of the deepest (n,) bool, about `number` in all; equal depths are treated alike."""
    last, same = np.sort(depth)[::-1][number - 1], 1e-6 * np.abs(depth).max()
    fewer, more = depth > last + same, depth >= last - same
    return more if more.sum() - number <= number - fewer.sum() or not fewer.any() else fewer


def _lattice(outline: np.ndarray, h: float, count: int, interface: np.ndarray) -> np.ndarray:
    """Points (count, 2) of the widest triangular lattice that has so many inside an outline, away from `interface`."""
    low, high = 0.3 * h, 2.0 * h
    for _ in range(25):
        s = 0.5 * (low + high)
        enough = len(_points(outline, s, CLEARANCE * min(s, h), interface)) >= count
        low, high = (s, high) if enough else (low, s)
    points = _points(outline, low, CLEARANCE * min(low, h), interface)
    if len(points) < count:
        raise ValueError(f"{count} particles do not fit inside such an outline")
    return points[_deepest_pairs(points, polygons.distance(points, outline), polygons.centroid(outline), count, h)]


def _deepest_pairs(points: np.ndarray, depth: np.ndarray, centre: np.ndarray, count: int, h: float) -> np.ndarray:
    """Which `count` of the points (n, 2) are the deepest (n,) bool; left and right mirror images go together."""
    place = np.column_stack([depth, -points[:, 1], np.abs(points[:, 0] - centre[0])])
    _, group, size = np.unique(np.rint(place / (1e-6 * h)) + 0.0, axis=0, return_inverse=True, return_counts=True)
    group, excess, out = group.ravel(), len(points) - count, []
    for k, n in enumerate(size):  # the shallowest and highest first
        if n <= excess:
            out.append(k)
            excess -= n
    chosen = ~np.isin(group, out)
    order = np.lexsort((points[:, 0], group))
    chosen[order[chosen[order]][:excess]] = False  # the left one of a pair, if only pairs are left
    return chosen


def _points(outline: np.ndarray, s: float, clearance: float, interface: np.ndarray) -> np.ndarray:
    """Points (k, 2) of a triangular lattice of spacing s inside an outline, which has one at the centre of its area."""
    c, corners = polygons.centroid(outline), outline.reshape(-1, 2)
    low, high = corners.min(axis=0) - c, corners.max(axis=0) - c
    rows = np.arange(np.floor(low[1] / (s * np.sqrt(0.75))), np.ceil(high[1] / (s * np.sqrt(0.75))) + 1)
    columns = np.arange(np.floor(low[0] / s) - 1, np.ceil(high[0] / s) + 1)
    x = s * (columns[None, :] + 0.5 * (rows[:, None] % 2))
    y = np.broadcast_to(s * np.sqrt(0.75) * rows[:, None], x.shape)
    points = c + np.column_stack([x.ravel(), y.ravel()])
    points = points[polygons.inside(points, outline)]
    if len(interface):
        points = points[cKDTree(interface).query(points)[0] > 0.65 * clearance / CLEARANCE]
    return points[polygons.distance(points, outline) > clearance]


def _spread(X: np.ndarray, m: int) -> np.ndarray:
    """Points X (n, 2) evened out: each moves to the centroid of the triangles around it; the first m are fixed."""
    for _ in range(ROUNDS):
        # Triangles of fixed points alone may be outside.
        tri, share = triangles(X, lambda tri: (tri >= m).any(axis=1))
        size = share * areas(X, tri)
        weight = np.bincount(tri.ravel(), np.repeat(size, 3), len(X))
        middle = size[:, None] * X[tri].mean(axis=1)
        total = np.column_stack([np.bincount(tri.ravel(), np.repeat(middle[:, k], 3), len(X)) for k in range(2)])
        X = np.concatenate([X[:m], (total / np.maximum(weight, 1e-300)[:, None])[m:]])
    return X
