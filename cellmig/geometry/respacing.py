"""Points of a closed outline moved along it, until they are evenly spaced."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from . import polygons
from .resample import CORNER

APART = 1.5  # least distance of corners that stay, over the mean one of points [-]


class Places(NamedTuple):
    """Places on the edges of a polygon of k corners, for as many points.

    points : (k, 2) -- their positions [µm];  arc : (k,) -- arc lengths on the polygon, ascending, which may begin below
    0 or end beyond its whole length [µm];  edge : (k,) int -- edges on which they are;  share : (k,) -- of it that
    is before them [-].
    """

    points: np.ndarray
    arc: np.ndarray
    edge: np.ndarray
    share: np.ndarray


def respaced(polygon: np.ndarray) -> Places:
    """Evenly spaced points on the smooth curve through the corners of a `polygon` (k, 2) [µm] of any sense.

    A sharp corner stays a point, and the spacing differs a little from one part between such corners to the next.  Each
    point is moved along the curve as little as that allows.  Between its ends an edge bulges as a circle does whose
    chords turn as the outline does at that end where it turns less, and not at all where it turns to and fro: what is
    straight stays so, and a curve never passes beyond the tangent at a corner.

    Source: derived here; equal arc lengths as of front tracking, the smaller of two slopes as of van Leer (1979).
    """
    side = polygons.sides(polygon)
    ends = np.concatenate([[0.0], np.cumsum(side)])
    arc, length, k = ends[:-1], ends[-1], len(polygon)
    way = np.roll(polygon, -1, axis=0) - polygon
    turn = polygons.turn(np.roll(way, 1, axis=0), way)
    slots, sharp = _slots(arc, np.abs(turn), length)
    if sharp:  # the points are assigned to them, in order, so that the sum of squared ways is least
        thrice = np.concatenate([slots - length, slots, slots + length])
        begin = int(np.argmin([((thrice[i : i + k] - arc) ** 2).sum() for i in range(2 * k)]))
        slots = thrice[begin : begin + k]
    else:
        slots = slots + (arc - slots).mean()
    inside = slots - length * np.floor(slots / length)
    edge = np.clip(np.searchsorted(ends, inside, side="right") - 1, 0, k - 1)
    share = np.clip((inside - arc[edge]) / side[edge], 0.0, 1.0)
    along, first, last = way[edge], turn[edge], np.roll(turn, -1)[edge]
    bend = np.where(first * last > 0.0, np.sign(first) * np.minimum(np.abs(first), np.abs(last)), 0.0)
    bulge = 0.5 * bend * share * (1.0 - share)
    points = polygon[edge] + share[:, None] * along + bulge[:, None] * np.column_stack([along[:, 1], -along[:, 0]])
    return Places(points, slots, edge, share)


def _slots(arc: np.ndarray, turn: np.ndarray, length: float) -> tuple[np.ndarray, bool]:
    """Arc lengths (k,) [µm], ascending, for as many points as are at `arc` (k,) [µm]; whether corners are among them.

    turn : (k,) -- sizes of the turns [rad];  length : of the whole outline [µm].
    """
    k, least = len(arc), APART * length / len(arc)
    corners: list[float] = []
    for i in np.argsort(-turn, kind="stable"):
        away = np.abs(arc[i] - np.array(corners))
        if turn[i] > CORNER and (np.minimum(away, length - away) > least).all():
            corners.append(float(arc[i]))
    if not corners:
        return length * np.arange(k) / k, False
    start = np.sort(corners)
    part = np.diff(start, append=start[0] + length)
    count = np.maximum(np.floor(k * part / length).astype(int), 1)
    while (short := k - count.sum()) != 0:
        ratio = part / (count + 0.5 * np.sign(short))
        count[np.argmax(ratio) if short > 0 else np.argmin(np.where(count > 1, ratio, np.inf))] += np.sign(short)
    return np.concatenate([s + w * np.arange(n) / n for s, w, n in zip(start, part, count, strict=True)]), True


def filled(points: np.ndarray, edges: np.ndarray, area: float, weight: np.ndarray, most: float) -> np.ndarray:
    """`points` (k, 2) [µm] of outlines moved along their normals by lengths in proportion to `weight` (k,) [any unit],
    at most by `most` [µm], so that the `edges` (e, 2) int, counterclockwise, enclose an `area` [µm²].
    """
    chord = np.zeros_like(points)
    side = points[edges[:, 1]] - points[edges[:, 0]]
    for end in edges.T:
        np.add.at(chord, end, side)
    normal = np.column_stack([chord[:, 1], -chord[:, 0]]) / np.maximum(np.linalg.norm(chord, axis=1), 1e-300)[:, None]
    way, moved = weight[:, None] * normal, points
    rate = 0.5 * float(polygons.cross(way, chord).sum())
    size, limit = 0.0, most / max(float(weight.max(initial=0.0)), 1e-300)
    for _ in range(4):
        size += (area - polygons.area(moved[edges])) / max(rate, 1e-300)
        size = float(np.clip(size, -limit, limit))
        moved = points + size * way
    return moved
