"""Energy of contact between polylines from its definition, slowly: every piece by Gauss's rule, nothing in closed form.

A point x outside an outline B has the potential, with sums over the edges and the vertices of B,

    Φ_B(x) = Σ U(distance to the line of e) [x in the outer half-slab of e] + Σ sign_v U(|x - v|) [x in the cone of v].

The outer half-slab of an edge e = (a, b) has (x - a)·e >= 0 > (x - b)·e and lies to the right of e.  The cone of a
vertex v between the edges e and q has (x - v)·e >= 0 > (x - v)·q and sign_v = 1 where the outline is convex, the
opposites and -1 where it is reflex.  A segment S of another outline A has the energy ½ N L_S ∫ Φ_B(x(ξ)) dξ, with its
reference length L_S.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations
from typing import Any

import numpy as np

NODES, WEIGHTS = np.polynomial.legendre.leggauss(24)


def potential(law: Any, x: np.ndarray, outline: np.ndarray, acts: Any = True) -> np.ndarray:
    """Φ_B at points x (n, 2) [µm] outside a counterclockwise outline (m, 2) [µm]; (n,) [pN µm].

    acts : (m,) bool -- which edges count, by their first vertices, with the vertices at their ends.
    """
    e = np.roll(outline, -1, axis=0) - outline  # of the edges that begin at the vertices
    away = x[:, None] - outline
    along = (away * e).sum(axis=2)
    square = (e * e).sum(axis=1)
    gap = (away * _turned(e)).sum(axis=2) / np.sqrt(square)
    before = np.roll(e, 1, axis=0)
    past = (away * before).sum(axis=2) >= 0.0  # of the edge that ends at the vertex; borders count once
    slab = (along >= 0.0) & ~np.roll(past, -1, axis=1) & (gap > 0.0)
    convex = before[:, 0] * e[:, 1] - before[:, 1] * e[:, 0] >= 0.0
    sign = np.where(convex, 1.0, -1.0)
    cone = np.where(convex, past & (along < 0.0), ~past & (along >= 0.0))
    far = 2.0 * law.cutoff
    edges = np.where(slab, law.potential(np.where(slab, gap, far)), 0.0)
    corners = np.where(cone, sign * law.potential(np.where(cone, np.hypot(*np.moveaxis(away, 2, 0)), far)), 0.0)
    return (edges * acts).sum(axis=1) + (corners * np.roll(acts, 1)).sum(axis=1)


def energy(law: Any, outlines: Sequence[np.ndarray], lengths: Sequence[np.ndarray]) -> float:
    """Energy of contact [pN] of outlines (m, 2) [µm], whose segments have the reference `lengths` (m,) [µm]."""
    total = 0.0
    for a, b in permutations(range(len(outlines)), 2):
        A, B = outlines[a], outlines[b]
        low, high = B.min(axis=0) - law.cutoff, B.max(axis=0) + law.cutoff
        for start, end, length in zip(A, np.roll(A, -1, axis=0), lengths[a], strict=True):
            if (np.maximum(start, end) >= low).all() and (np.minimum(start, end) <= high).all():
                total += 0.5 * law.bond_density * length * mean_potential(law, start, end, B)
    return total


def own_energy(law: Any, outline: np.ndarray, length: np.ndarray) -> float:
    """Energy [pN] of an outline (m, 2) [µm] with itself: the same sum, in which a segment's own edge and those up to
    one edge away do not count, nor parts that it faces across the inside: the outline is to have none that are
    near; `length` (m,) are reference lengths [µm].
    """
    m = len(outline)
    total, beside = 0.0, np.isin(np.arange(m), [0, 1, m - 1])
    for k, (start, end) in enumerate(zip(outline, np.roll(outline, -1, axis=0), strict=True)):
        acts = ~np.roll(beside, k)
        total += 0.5 * law.bond_density * length[k] * mean_potential(law, start, end, outline, acts)
    return total


def mean_potential(law: Any, start: np.ndarray, end: np.ndarray, outline: np.ndarray, acts: Any = True) -> float:
    """Mean of Φ_B along a segment between two points (2,) [µm]; [pN µm]; `acts` (m,) bool as for `potential`."""
    at = breaks(law, start, end, outline)
    half = 0.5 * np.diff(at)
    places = (at[:-1] + half)[:, None] + half[:, None] * NODES
    weights = half[:, None] * WEIGHTS
    x = start + places.reshape(-1, 1) * (end - start)
    return float(weights.ravel() @ potential(law, x, outline, acts))


def breaks(law: Any, start: np.ndarray, end: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """Ascending shares of the way (k,) [-] along a segment where Φ_B or a derivative jumps, and between them more.

    They are the borders of slabs and cones, places at many distances from every edge and vertex, among them
    those where U changes its formula, and the points nearest to vertices.  `start` and `end` (2,) and
    the outline (m, 2) are in µm.
    """
    d, e = end - start, np.roll(outline, -1, axis=0) - outline
    levels = _levels(law)
    away = start - outline
    length = np.linalg.norm(e, axis=1)
    found = [np.zeros(1), np.ones(1)]
    with np.errstate(divide="ignore", invalid="ignore"):
        for border in (0.0, length**2):
            found.append((border - (away * e).sum(axis=1)) / (e @ d))
        n = _turned(e) / length[:, None]
        found.append(((np.append(0.0, levels)[:, None] - (away * n).sum(axis=1)) / (n @ d)).ravel())
        foot = -(away @ d) / (d @ d)
        root = np.sqrt((levels[:, None] ** 2 - ((away + foot[:, None] * d) ** 2).sum(axis=1)) / (d @ d))
        found += [foot, (foot + root).ravel(), (foot - root).ravel()]
    at = np.concatenate(found)
    at = np.unique(at[(at >= 0.0) & (at <= 1.0)])
    return at[np.append(np.diff(at) > 1e-13, True)]


def distance(A: np.ndarray, B: np.ndarray) -> float:
    """Least distance of two outlines (m, 2) [µm] that do not cross [µm]."""
    def from_points(x: np.ndarray, outline: np.ndarray) -> float:
        e = np.roll(outline, -1, axis=0) - outline
        away = x[:, None] - outline
        share = np.clip((away * e).sum(axis=2) / (e * e).sum(axis=1), 0.0, 1.0)
        return float(np.linalg.norm(away - share[:, :, None] * e, axis=2).min())

    return min(from_points(A, B), from_points(B, A))


def brought_near(fixed: Sequence[np.ndarray], outline: np.ndarray, gap: float, direction: Sequence[float]
                 ) -> np.ndarray:
    """An outline (m, 2) [µm], moved from afar against a `direction` (2,) [-] up to a gap [µm] from the `fixed`."""
    d, far = np.asarray(direction) / np.hypot(*direction), 20.0
    while (left := min(distance(A, outline + far * d) for A in fixed) - gap) > 1e-12:
        far -= left  # no nearer than the gap, however the outlines lie
    return outline + far * d


def _levels(law: Any) -> np.ndarray:
    """Distances [µm] at which U changes its formula, and others between them, at most a factor of 1.5 apart (k,)."""
    eps = law.equilibrium_distance
    fixed = [0.1 * eps, 0.3 * eps, *([law.cap] if hasattr(law, "cap") else []), eps, law.cutoff]
    graded = np.geomspace(0.1 * eps, law.cutoff, 2 + int(np.log(10.0 * law.cutoff / eps) / np.log(1.5)))
    return np.unique(np.concatenate([fixed, graded]))


def _turned(e: np.ndarray) -> np.ndarray:
    """Edges (m, 2) turned to the right (m, 2), outwards [µm]."""
    return np.column_stack([e[:, 1], -e[:, 0]])
