"""Overlaps of surfaces in space: with the substrate, with other cells, and particles that have left their cell."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from ..geometry.triangles import cross, dot, lengths, on_triangles
from .contact import Surfaces
from .overlap import SHARE, Overlap

AT_A_TIME = 1 << 21  # pairs of a point and a triangle whose solid angles are computed at a time


def overlap(surfaces: Surfaces, x: np.ndarray, on_substrate: bool, in_contact: bool) -> Overlap | None:
    """The first overlap of the surfaces at x (m, 3) [µm]; None if there is none.

    `on_substrate` and `in_contact` tell whether bonds or repulsion act to the substrate, and between cells.
    """
    s, deepest = surfaces, _tolerance(surfaces)
    low = int(np.argmin(x[:, 2]))
    if on_substrate and -x[low, 2] > deepest:
        return Overlap(int(s.ids[low]), f"cell {s.cell[low] + 1} is {-x[low, 2]:.3g} µm below the substrate",
                       "its bonds do not bear the load: try more of them, or a smaller load")
    cells = np.unique(s.cell)
    box = {c: (x[s.cell == c].min(axis=0), x[s.cell == c].max(axis=0)) for c in cells.tolist()}
    for a, b in combinations(cells.tolist(), 2) if in_contact else ():
        low_corner, high_corner = (choose(p, q) for choose, p, q in zip((np.maximum, np.minimum), box[a], box[b],
                                                                        strict=True))
        if (low_corner >= high_corner).any():
            continue
        for one, other in ((a, b), (b, a)):
            on = np.flatnonzero((s.cell == one) & (x >= low_corner).all(axis=1) & (x <= high_corner).all(axis=1))
            depth = _depth(s, x, other, x[on])
            if len(on) and depth.max() > deepest:
                return Overlap(int(s.ids[on[np.argmax(depth)]]), f"cells {a + 1} and {b + 1} overlap by "
                               f"{depth.max():.3g} µm", "try a smaller load, or finer particles")
    return None


def escaped(surfaces: Surfaces, x: np.ndarray, ids: np.ndarray, cell: np.ndarray, at: np.ndarray) -> Overlap | None:
    """The first particle outside of the surface of its cell; None if there is none.

    x : (m, 3) -- positions of the surface particles [µm];  ids, cell : (n,) int -- of some particles;
    at : (n, 3) -- their positions [µm].
    """
    deepest = _tolerance(surfaces)
    for c in np.unique(cell):
        on = np.flatnonzero((cell == c) & ~np.isin(ids, surfaces.ids))
        out = on[_winding(at[on], x[_facets(surfaces, c)]) < 0.5]
        away = lengths(_nearest(at[out], x[_facets(surfaces, c)]) - at[out])
        if len(out) and away.max() > deepest:
            return Overlap(int(ids[out[np.argmax(away)]]), f"a particle is {away.max():.3g} µm outside of cell {c + 1}",
                           "try a smaller load, or finer particles")
    return None


def _tolerance(surfaces: Surfaces) -> float:
    """Depth up to which overlaps are tolerated [µm]."""
    return SHARE * float(np.sqrt(surfaces.size.mean()))


def _facets(surfaces: Surfaces, cell: int) -> np.ndarray:
    return surfaces.facets[surfaces.cell[surfaces.facets[:, 0]] == cell]


def _depth(surfaces: Surfaces, x: np.ndarray, cell: int, points: np.ndarray) -> np.ndarray:
    """Depths (n,) [µm] of points (n, 3) [µm] in a cell, 0 outside."""
    corners, out = x[_facets(surfaces, cell)], np.zeros(len(points))
    inside = np.flatnonzero(_winding(points, corners) > 0.5)
    out[inside] = lengths(_nearest(points[inside], corners) - points[inside])
    return out


def _nearest(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Closest points (n, 3) [µm] to points (n, 3) on triangles with these corners (m, 3, 3) [µm]."""
    out = np.empty_like(points)
    for k, p in enumerate(points):
        found = on_triangles(np.broadcast_to(p, (len(corners), 3)), corners)
        out[k] = found[np.argmin(lengths(found - p))]
    return out


def _winding(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Winding numbers (n,) [-] of closed triangles with these corners (m, 3, 3) [µm] about points (n, 3) [µm].

    Source: the solid angle of a triangle, van Oosterom & Strackee (1983).
    """
    out, step = np.zeros(len(points)), max(1, AT_A_TIME // len(corners))
    for k in range(0, len(points), step):
        a, b, c = np.moveaxis(corners[None] - points[k : k + step, None, None], 2, 0)
        la, lb, lc = lengths(a), lengths(b), lengths(c)
        below = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb
        out[k : k + step] = np.arctan2(dot(a, cross(b, c)), below).sum(axis=1) / (2.0 * np.pi)
    return out
