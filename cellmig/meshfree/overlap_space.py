"""Overlaps of surfaces in space: with the substrate, with other cells, and particles that have left their cell."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from ..geometry.surfaces import ClosedSurface
from .contact import Surfaces
from .overlap import SHARE, Overlap


def overlap(surfaces: Surfaces, x: np.ndarray, on_substrate: bool, in_contact: bool) -> Overlap | None:
    """The first overlap of the surfaces at x (m, 3) [µm]; None if there is none.

    `on_substrate` and `in_contact` tell whether bonds or repulsion act to the substrate, and between cells.
    """
    s, deepest = surfaces, _tolerance(surfaces)
    if not len(x):
        return None
    low = int(np.argmin(x[:, 2]))
    if on_substrate and -x[low, 2] > deepest:
        return Overlap(int(s.ids[low]), f"cell {s.cell[low] + 1} is {-x[low, 2]:.3g} µm below the substrate",
                       "its bonds do not bear the load: try more of them, or a smaller load")
    cells = np.unique(s.cell)
    box = {c: (x[s.cell == c].min(axis=0), x[s.cell == c].max(axis=0)) for c in cells.tolist()}
    for a, b in combinations(cells.tolist(), 2) if in_contact else ():
        low_corner, high_corner = np.maximum(box[a][0], box[b][0]), np.minimum(box[a][1], box[b][1])
        if (low_corner >= high_corner).any():
            continue
        for one, other in ((a, b), (b, a)):
            on = np.flatnonzero((s.cell == one) & (x >= low_corner).all(axis=1) & (x <= high_corner).all(axis=1))
            depth = _depth(_surface(s, x, other), x[on])
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
        surface = _surface(surfaces, x, c)
        out = on[~surface.inside(at[on])]
        away = surface.distance(at[out]) if len(out) else np.zeros(0)
        if len(out) and away.max() > deepest:
            return Overlap(int(ids[out[np.argmax(away)]]), f"a particle is {away.max():.3g} µm outside of cell {c + 1}",
                           "try a smaller load, or finer particles")
    return None


def _tolerance(surfaces: Surfaces) -> float:
    """Depth up to which overlaps are tolerated [µm]."""
    return SHARE * float(np.sqrt(surfaces.mean))


def _depth(surface: ClosedSurface, points: np.ndarray) -> np.ndarray:
    """Depths (n,) [µm] of points (n, 3) [µm] in a cell, 0 outside."""
    out, inside = np.zeros(len(points)), np.flatnonzero(surface.inside(points))
    if len(inside):
        out[inside] = -surface.distance(points[inside])
    return out


def _surface(surfaces: Surfaces, x: np.ndarray, cell: int) -> ClosedSurface:
    """The surface of a cell, for surface particles at x (m, 3) [µm]."""
    on = np.flatnonzero(surfaces.cell == cell)
    facets = surfaces.facets[surfaces.cell[surfaces.facets[:, 0]] == cell] - on[0]
    return ClosedSurface(x[on], facets, np.zeros(len(facets), int))
