"""Surfaces of all cells, and the search for particles that are near the surface of another cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from .body import Scene


@dataclass(frozen=True)
class Surfaces:
    """Surface particles of all cells, loop by loop; a segment goes by its first particle.

    Attributes
    ----------
    ids : (m,) int -- global ids.
    cell : (m,) int -- cells.
    after, before : (m,) int -- indices of the next and of the previous particle on the loop.
    length : (m,) -- reference length of the segment from a particle to the next [µm].
    outer : (m,) bool -- whether a particle is on the outer loop; in holes there are no bonds and no protrusion.
    """

    ids: np.ndarray
    cell: np.ndarray
    after: np.ndarray
    before: np.ndarray
    length: np.ndarray
    outer: np.ndarray

    @classmethod
    def of(cls, scene: Scene) -> Surfaces:
        """Surfaces of a scene."""
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
    """Particles near the surface of another cell, sorted by pair of cells; indices are those of `Surfaces`.

    Attributes
    ----------
    node : (n,) int -- the particles, once for each cell that they are near.
    first : (n + 1,) int -- where the candidates of each begin.
    candidate : (k,) int -- segments of the other cell that may be the closest one.
    segment : (e, 2) int -- indices in `node` of both ends of the segments whose ends are near the same cell.
    """

    node: np.ndarray
    first: np.ndarray
    candidate: np.ndarray
    segment: np.ndarray

    def needed(self, surfaces: Surfaces, own: np.ndarray) -> ContactLists:
        """The part of the lists that exerts forces on particles in `own` (m,) bool, in the same order.

        Nodes whose gaps the segments of such particles need are included.
        """
        count = np.diff(self.first)
        touched = own[self.candidate] | own[surfaces.after[self.candidate]]
        matters = own[self.node] | (np.bincount(np.repeat(np.arange(len(count)), count), touched, len(count)) > 0)
        segment = self.segment[matters[self.segment].any(axis=1)]
        included = matters.copy()
        included[segment] = True
        number = np.cumsum(included) - 1
        return ContactLists(self.node[included], np.append(0, np.cumsum(count[included])),
                            self.candidate[np.repeat(included, count)], number[segment])

    def involved(self, surfaces: Surfaces) -> np.ndarray:
        """Surface particles that the contact forces depend or act on (k,) int, with repetitions."""
        ends = self.candidate, surfaces.after[self.candidate]
        return np.concatenate([self.node, *ends, surfaces.before[ends[0]], surfaces.after[ends[1]]])


def contact_lists(surfaces: Surfaces, x: np.ndarray, reach: float, change: float, among: np.ndarray) -> ContactLists:
    """Contact lists that remain valid until a distance changes by `change`.

    A segment that is further away than the closest one by more than twice `change` cannot become the closest before.

    Parameters
    ----------
    x : (m, 2) -- positions of the surface particles [µm].
    reach : float -- distance up to which particles are paired [µm]: that of the closest points to find, plus half of
        the longest segment.
    change : float -- of any distance, up to which the lists are valid [µm].
    among : (k,) int -- particles of the cells to consider, ascending.
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
    unique = unique[_distinct(unique)]
    away = _distances(x[unique[:, 1]], x[unique[:, 2]], x[surfaces.after[unique[:, 2]]])
    start = np.flatnonzero(_distinct(unique[:, :2]))
    least = np.minimum.reduceat(away, start) if len(start) else away
    unique = unique[away <= np.repeat(least, np.diff(np.append(start, len(unique)))) + 2.0 * change]
    directed, node, candidate = unique.T
    start = np.flatnonzero(_distinct(unique[:, :2]))
    first = np.append(start, len(unique))
    directed, node = directed[start], node[start]
    key = directed * len(x) + node  # ascending
    following = directed * len(x) + surfaces.after[node]
    at = np.minimum(np.searchsorted(key, following), max(len(key) - 1, 0))
    listed = key[at] == following if len(key) else np.zeros(0, bool)
    segment = np.column_stack([np.flatnonzero(listed), at[listed]])
    return ContactLists(node, first, candidate, segment)


def cells_around(low: np.ndarray, high: np.ndarray, mine: np.ndarray, reach: float) -> np.ndarray:
    """Cells that may be within `reach` [µm] of the cells `mine` (k,) int, ascending (n,) int.

    `low` and `high` (c, 2) [µm] are opposite corners of the bounding boxes of all cells.
    """
    if len(mine) in (0, len(low)):
        return mine
    centre, wide = 0.5 * (low + high), np.linalg.norm(high - low, axis=1).max()
    away, _ = cKDTree(centre[mine]).query(centre, distance_upper_bound=reach + wide)
    return np.flatnonzero(np.isfinite(away))


def _distinct(listed: np.ndarray) -> np.ndarray:
    """Whether each of the sorted rows (k, …) differs from the previous one (k,) bool."""
    return np.append(True, (np.diff(listed, axis=0) != 0).any(axis=1))[: len(listed)]


def _distances(x: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distances (k,) [µm] of points x from the segments from a to b, (k, 2) [µm] each."""
    along = b - a
    t = np.clip(((x - a) * along).sum(axis=1) / (along * along).sum(axis=1), 0.0, 1.0)
    return np.linalg.norm(x - a - t[:, None] * along, axis=1)
