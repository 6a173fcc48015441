"""Overlaps that large loads may cause: of a surface with itself, with another or the substrate; escaped particles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ..geometry import polygons
from .contact import Surfaces

SHARE = 0.1  # depth of an overlap over the mean length of segments up to which it is tolerated


class Overlap(NamedTuple):
    """An overlap: the global id of a particle there, what is wrong, and what the user may do about it."""

    particle: int
    cause: str
    remedy: str


def overlap(surfaces: Surfaces, x: np.ndarray, on_substrate: bool, in_contact: bool,
            with_itself: bool = False) -> Overlap | None:
    """The first overlap of the surfaces at x (m, 2) [µm]; None if there is none.

    `on_substrate`, `in_contact` and `with_itself` tell whether bonds or repulsion act to the substrate, between cells,
    and between the parts of an outline.
    """
    s, deepest = surfaces, SHARE * surfaces.mean
    if not len(x):
        return None
    low = int(np.argmin(x[:, 1]))
    if on_substrate and -x[low, 1] > deepest:
        return Overlap(int(s.ids[low]), f"cell {s.cell[low] + 1} is {-x[low, 1]:.3g} µm below the substrate",
                       "its bonds do not bear the load: try more of them, or a smaller load")
    seen = set()
    for i, j in _crossings(s, x):
        a, b = int(s.cell[i]), int(s.cell[j])
        if a == b:
            if polygons.overlap_of_edges(x[[i, s.after[i]]], x[[j, s.after[j]]]) <= deepest:
                continue  # particles that coincide are no fold
            return Overlap(int(s.ids[i]), "the outline of cell {} crosses itself at ({:.4g}, {:.4g}) µm".format(
                a + 1, *x[i]), ("its repulsion does not bear the load" if with_itself else
                                "nothing keeps the surfaces of this cell apart") +
                           ": try a smaller load or finer particles")
        if (a, b) not in seen and (depth := _depth(s, x, a, b)) > deepest:
            return Overlap(int(s.ids[i]), f"cell {a + 1} and cell {b + 1} overlap by {depth:.3g} µm",
                           "their bonds do not bear the load: try more of them, or a smaller load" if in_contact else
                           "cells do not meet in a static case: try a smaller load, or steps in time")
        seen.add((a, b))
    return None


def escaped(surfaces: Surfaces, x: np.ndarray, ids: np.ndarray, cell: np.ndarray, at: np.ndarray) -> Overlap | None:
    """The first particle outside of its cell, by more than a tenth of the segment there; None if there is none.

    A segment that is stretched cuts the corners of the flow beneath it, whose particles are not outside for that.

    Parameters
    ----------
    x : (m, 2) -- positions of all surface particles [µm].
    ids : (n,) int -- global ids of the particles to check, ascending.
    cell : (n,) int -- their cells.
    at : (n, 2) -- their positions [µm].
    """
    s = surfaces
    within = ~np.isin(ids, s.ids)
    for c in np.unique(cell):
        on, of = (np.arange(*np.searchsorted(numbers, [c, c + 1])) for numbers in (s.cell, cell))
        of = of[within[of]]
        edges, p = np.stack([x[on], x[s.after[on]]], axis=1), at[of]
        nearest = on[cKDTree(x[on]).query(p)[1]]
        beside = [polygons.cross(x[s.after[k]] - x[k], p - x[k]) < 0.0 for k in (nearest, s.before[nearest])]
        of, p = of[beside[0] | beside[1]], p[beside[0] | beside[1]]  # right of a segment next to the nearest corner
        out = ~polygons.inside(p, edges)
        of, (depth, edge) = of[out], polygons.nearest_edge(p[out], edges)
        length = np.linalg.norm(edges[edge, 1] - edges[edge, 0], axis=1)
        left = depth > SHARE * np.maximum(length, s.mean)
        if left.any():
            i, depth = of[left][0], depth[left]
            return Overlap(int(ids[i]), f"a particle is {depth.max():.3g} µm outside of the surface of cell {c + 1}",
                           "particles move past each other: try a smaller load or finer particles")
    return None


def _crossings(s: Surfaces, x: np.ndarray) -> list[list[int]]:
    """First particles of pairs of segments that meet and are not adjacent."""
    p, q = x, x[s.after]
    longest = float(np.linalg.norm(q - p, axis=1).max())
    pairs = cKDTree(0.5 * (p + q)).query_pairs(longest * (1.0 + 1e-9), output_type="ndarray")
    i, j = pairs[(s.after[pairs[:, 0]] != pairs[:, 1]) & (s.after[pairs[:, 1]] != pairs[:, 0])].T
    met = polygons.intersect(p[i], q[i], p[j], q[j])
    return sorted(np.column_stack([i, j])[met].tolist())


def _depth(s: Surfaces, x: np.ndarray, a: int, b: int) -> float:
    """Largest depth of a surface particle of either of two cells inside the other [µm]."""
    one, other = x[(s.cell == a) & s.outer], x[(s.cell == b) & s.outer]
    return max(polygons.depth(one, other), polygons.depth(other, one))
