"""Search lists of surfaces: which segments are near the substrate, which particles near another cell's surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from .body import Scene


@dataclass(frozen=True)
class Surfaces:
    """All closed polylines of the scene, one after the other; indices run through them.

    ids : (m,) -- global ids of the surface particles;  cell : (m,);  after, before : (m,) -- neighbours in the
    polyline;  length : (m,) -- reference length of the segment from a particle to the next [µm];  outer : (m,) bool --
    not in a hole, where there are no bonds and nothing protrudes.
    """

    ids: np.ndarray
    cell: np.ndarray
    after: np.ndarray
    before: np.ndarray
    length: np.ndarray
    outer: np.ndarray

    @classmethod
    def of(cls, scene: Scene) -> Surfaces:
        """The surfaces of a scene."""
        rings = [scene.surface(c) for c in range(len(scene.kind))]
        start = np.concatenate([[0], np.cumsum([len(r) for r in rings])])
        after = np.concatenate([a + scene.templates[k].after for a, k in zip(start, scene.kind, strict=False)])
        before = np.argsort(after)
        cell = np.repeat(np.arange(len(rings)), np.diff(start))
        length = np.concatenate([scene.templates[k].segment_length for k in scene.kind])
        outer = np.concatenate([scene.templates[k].loop == 0 for k in scene.kind])
        return cls(np.concatenate(rings), cell, after, before, length, outer)


@dataclass(frozen=True)
class ContactLists:
    """Particles near another cell's surface, by pair of cells; indices into `Surfaces`.

    node : (n,);  first : (n + 1,), candidate : (k,) -- the segments that may be closest, by their first particle;
    segment : (e, 2) -- neighbours in `node`, both listed.
    """

    node: np.ndarray
    first: np.ndarray
    candidate: np.ndarray
    segment: np.ndarray

    def needed(self, surfaces: Surfaces, own: np.ndarray) -> ContactLists:
        """What acts on particles in `own` (m,) bool, in the same order; with nodes whose gaps their segments need."""
        count = np.diff(self.first)
        touched = own[self.candidate] | own[surfaces.after[self.candidate]]
        matters = own[self.node] | (np.bincount(np.repeat(np.arange(len(count)), count), touched, len(count)) > 0)
        segment = self.segment[matters[self.segment].any(axis=1)]
        keep = matters.copy()
        keep[segment] = True
        number = np.cumsum(keep) - 1
        return ContactLists(self.node[keep], np.append(0, np.cumsum(count[keep])),
                            self.candidate[np.repeat(keep, count)], number[segment])

    def involved(self, surfaces: Surfaces) -> np.ndarray:
        """Surface particles that the forces need or act on."""
        ends = self.candidate, surfaces.after[self.candidate]
        return np.concatenate([self.node, *ends, surfaces.before[ends[0]], surfaces.after[ends[1]]])


def contact_lists(surfaces: Surfaces, x: np.ndarray, reach: float, change: float, among: np.ndarray) -> ContactLists:
    """Lists for surface positions x (m, 2) [µm]: all feet of perpendiculars up to `reach` [µm] are among them.

    They hold until a distance changes by `change` [µm]: a segment further away by twice that cannot become the closest.
    Looked at are the particles `among` (k,), of whole cells, ascending; half of the longest segment is within `reach`.
    """
    among = among[surfaces.outer[among]]
    pairs = among[cKDTree(x[among]).query_pairs(reach, output_type="ndarray")]
    pairs = pairs[surfaces.cell[pairs[:, 0]] != surfaces.cell[pairs[:, 1]]]
    near = np.concatenate([pairs, pairs[:, ::-1]])  # (particle, particle of another cell)
    segments = np.concatenate([near, np.column_stack([near[:, 0], surfaces.before[near[:, 1]]])])
    n_cells = surfaces.cell.max() + 1
    own, other = surfaces.cell[segments[:, 0]], surfaces.cell[segments[:, 1]]
    unique = np.column_stack([own * n_cells + other, segments])
    unique = unique[np.lexsort(unique.T[::-1])]
    unique = unique[_fresh(unique)]
    away = _distances(x[unique[:, 1]], x[unique[:, 2]], x[surfaces.after[unique[:, 2]]])
    start = np.flatnonzero(_fresh(unique[:, :2]))
    least = np.minimum.reduceat(away, start) if len(start) else away
    unique = unique[away <= np.repeat(least, np.diff(np.append(start, len(unique)))) + 2.0 * change]
    directed, node, candidate = unique.T
    fresh = _fresh(unique[:, :2])
    first = np.append(np.flatnonzero(fresh), len(unique))
    directed, node = directed[fresh], node[fresh]
    key = directed * len(x) + node  # ascending
    following = directed * len(x) + surfaces.after[node]
    at = np.minimum(np.searchsorted(key, following), max(len(key) - 1, 0))
    listed = key[at] == following if len(key) else np.zeros(0, bool)
    segment = np.column_stack([np.flatnonzero(listed), at[listed]])
    return ContactLists(node, first, candidate, segment)


def cells_around(low: np.ndarray, high: np.ndarray, mine: np.ndarray, reach: float) -> np.ndarray:
    """Cells, ascending, that may be within `reach` [µm] of some, `mine`; boxes are from low to high (c, 2) [µm]."""
    if len(mine) in (0, len(low)):
        return mine
    centre, wide = 0.5 * (low + high), np.linalg.norm(high - low, axis=1).max()
    away, _ = cKDTree(centre[mine]).query(centre, distance_upper_bound=reach + wide)
    return np.flatnonzero(np.isfinite(away))


def _fresh(listed: np.ndarray) -> np.ndarray:
    """Which of sorted rows (k, …) are not as the one before (k,) bool."""
    return np.append(True, (np.diff(listed, axis=0) != 0).any(axis=1))[: len(listed)]


def _distances(x: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distances (k,) of points x (k, 2) from segments a-b (k, 2) each [µm]."""
    along = b - a
    t = np.clip(((x - a) * along).sum(axis=1) / (along * along).sum(axis=1), 0.0, 1.0)
    return np.linalg.norm(x - a - t[:, None] * along, axis=1)
