"""What no force prevents at any load: surfaces cross themselves, each other, the substrate; particles leave a cell."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ..geometry import polygons
from .contact import Surfaces

SHARE = 0.1  # of the mean segment: surfaces may be as deep within each other


class Tangle(NamedTuple):
    """Where surfaces are entangled: a global id, what is wrong there, and what may help."""

    particle: int
    cause: str
    remedy: str


def tangle(surfaces: Surfaces, x: np.ndarray, on_substrate: bool, in_contact: bool) -> Tangle | None:
    """The first entanglement of the surfaces at x (m, 2) [µm], with or without forces from substrate and neighbours."""
    s, deepest = surfaces, SHARE * float(surfaces.length.mean())
    low = int(np.argmin(x[:, 1]))
    if on_substrate and -x[low, 1] > deepest:
        return Tangle(int(s.ids[low]), f"cell {s.cell[low] + 1} is {-x[low, 1]:.3g} µm below the substrate",
                      "its bonds do not bear the load: try more of them, or a smaller load")
    seen = set()
    for i, j in _crossings(s, x):
        a, b = int(s.cell[i]), int(s.cell[j])
        if a == b:
            if _reach(x, s.after, i, j) <= deepest:
                continue  # particles that came to lie on one another, no fold
            return Tangle(int(s.ids[i]), "the outline of cell {} crosses itself at ({:.4g}, {:.4g}) µm".format(
                a + 1, *x[i]), "nothing keeps the surfaces of one cell apart: try a smaller load or finer particles")
        if (a, b) not in seen and (depth := _depth(s, x, a, b)) > deepest:
            return Tangle(int(s.ids[i]), f"cell {a + 1} and cell {b + 1} overlap by {depth:.3g} µm",
                          "their bonds do not bear the load: try more of them, or a smaller load" if in_contact else
                          "the case has no [adhesion.cells], without which nothing keeps cells apart: try one")
        seen.add((a, b))
    return None


def stray(surfaces: Surfaces, x: np.ndarray, ids: np.ndarray, cell: np.ndarray, places: np.ndarray) -> Tangle | None:
    """The first of some particles, `ids` ascending, of cells (n,) at `places` (n, 2) [µm], that has left its cell."""
    s, deepest = surfaces, SHARE * float(surfaces.length.mean())
    within = ~np.isin(ids, s.ids)
    for c in np.unique(cell):
        on, of = (np.arange(*np.searchsorted(numbers, [c, c + 1])) for numbers in (s.cell, cell))
        of = of[within[of]]
        edges, p = np.stack([x[on], x[s.after[on]]], axis=1), places[of]
        nearest = on[cKDTree(x[on]).query(p)[1]]
        beside = [polygons.cross(x[s.after[k]] - x[k], p - x[k]) < 0.0 for k in (nearest, s.before[nearest])]
        of, p = of[beside[0] | beside[1]], p[beside[0] | beside[1]]  # others are inside, as far as this is sound
        out = ~polygons.inside(p, edges)
        of, depth = of[out], polygons.distance(p[out], edges)
        if (depth > deepest).any():
            i = of[np.argmax(depth > deepest)]
            return Tangle(int(ids[i]), f"a particle is {depth.max():.3g} µm outside of the surface of cell {c + 1}",
                          "particles move past each other: try a smaller load or finer particles")
    return None


def _reach(x: np.ndarray, after: np.ndarray, i: int, j: int) -> float:
    """How far two segments that meet reach past one another: least distance of an end from the other one [µm]."""
    ends = np.stack([x[[i, after[i]]], x[[j, after[j]]]])
    distances = []
    for (a, b), others in zip(ends, ends[::-1], strict=True):
        along = b - a
        t = np.clip((others - a) @ along / max(along @ along, 1e-300), 0.0, 1.0)
        distances += np.linalg.norm(others - a - t[:, None] * along, axis=1).tolist()
    return min(distances)


def _crossings(s: Surfaces, x: np.ndarray) -> list[list[int]]:
    """Pairs of segments that meet and are no neighbours, by their first particles."""
    p, q = x, x[s.after]
    longest = float(np.linalg.norm(q - p, axis=1).max())
    pairs = cKDTree(0.5 * (p + q)).query_pairs(longest * (1.0 + 1e-9), output_type="ndarray")
    i, j = pairs[(s.after[pairs[:, 0]] != pairs[:, 1]) & (s.after[pairs[:, 1]] != pairs[:, 0])].T
    met = polygons.intersect(p[i], q[i], p[j], q[j])
    return sorted(np.column_stack([i, j])[met].tolist())


def _depth(s: Surfaces, x: np.ndarray, a: int, b: int) -> float:
    """How deep the corners of one of two cells lie within the other [µm]."""
    one, other = x[(s.cell == a) & s.outer], x[(s.cell == b) & s.outer]
    return max(polygons.depth(one, other), polygons.depth(other, one))
