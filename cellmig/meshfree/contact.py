"""Surfaces of all cells, and the search for segments that are near the surface of another cell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from ..geometry import polygons
from .scene import Scene, joined, ranges

CLOSE = 3  # steps along an outline up to which two segments meet in a fold only


@dataclass(frozen=True)
class Surfaces:
    """Surface particles of some cells, and the facets between them: segments in two dimensions, triangles in three.

    In two dimensions particles are in order, loop by loop, and a segment goes by its first particle.

    Attributes
    ----------
    ids : (m,) int -- global ids.
    cell : (m,) int -- cells, ascending.
    facets : (f, d) int -- indices of the corners of each facet, counterclockwise from outside, of one cell each.
    place, number : (m,), (f,) int -- numbers of the particles and the facets among those of the whole scene.
    size : (f,) -- reference length [µm] or area [µm²] of the facets.
    outer : (f,) bool -- whether a facet is on the outer surface; in holes there are no bonds and no protrusion.
    after, before : (m,) int -- indices of the next and of the previous particle on the loop; in two dimensions only.
    turn : (m,) -- angle at a particle from the segment before to that after it, in the reference configuration [rad];
        in two dimensions only.
    loop : (m,) int -- numbers of the loops among those of the whole scene; in two dimensions only.
    mean : float -- mean size of the facets of the whole scene [µm] or [µm²].
    """

    ids: np.ndarray
    cell: np.ndarray
    facets: np.ndarray
    place: np.ndarray
    number: np.ndarray
    size: np.ndarray
    outer: np.ndarray
    after: np.ndarray
    before: np.ndarray
    turn: np.ndarray
    loop: np.ndarray
    mean: float

    @classmethod
    def of(cls, scene: Scene, cells: np.ndarray | None = None) -> Surfaces:
        """Surfaces of `cells` (k,) int of a scene, ascending; by default of all."""
        cells = np.arange(len(scene.kind)) if cells is None else cells
        used = [scene.templates[k] for k in scene.kind[cells]]
        count = [len(t.surface) for t in used]
        ids = joined(t.surface for t in used) + np.repeat(scene.offset[cells], count)
        start = np.cumsum([0, *count])[:-1]
        facets = joined((a + t.places for a, t in zip(start, used, strict=True)), (0, scene.dimension))
        place, number = (ranges(of[cells], of[cells + 1]) for of in (scene.first_surface, scene.first_facet))
        size, outer = joined((t.facet_size for t in used), kind=float), joined((t.outer for t in used), kind=bool)
        known = ids, np.repeat(cells, count), facets, place, number, size, outer
        if scene.dimension > 2:
            none = np.zeros(0, np.int64)
            return cls(*known, none, none, np.zeros(0), none, scene.mean_facet)
        after, X = facets[:, 1], scene.particles(ids).X
        before = np.argsort(after)
        side = X[after] - X
        loop = joined(t.loop for t in used) + np.repeat(scene.first_loop[cells], count)
        return cls(*known, after, before, polygons.turn(side[before], side), loop, scene.mean_facet)

    @cached_property
    def cells(self) -> np.ndarray:
        """The cells (k,) int, ascending."""
        return self.cell[np.flatnonzero(np.diff(self.cell, prepend=-1))]

    @property
    def on_outside(self) -> np.ndarray:
        """Whether particles are on the outer surface of their cell (m,) bool."""
        found = np.zeros(len(self.ids), bool)
        found[self.facets[self.outer]] = True
        return found

    @property
    def shares(self) -> np.ndarray:
        """Lengths [µm] or areas [µm²] of the surface that belong to each particle (m,), of each facet an equal part."""
        total = np.zeros(len(self.ids))
        np.add.at(total, self.facets, self.size[:, None] / self.facets.shape[1])
        return total

    def touching(self, some: np.ndarray) -> np.ndarray:
        """Whether facets have a corner among `some` (m,) bool, (f,) bool."""
        return some[self.facets].any(axis=1)

    def followed(self, turn: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Turns (m,) [rad] that were `turn` (m,), for the positions x (m, 2) [µm] of now.

        A tip that becomes too thin turns over: its turn of nearly π then goes on beyond π, not from -π.
        """
        change = polygons.turn(x - x[self.before], x[self.after] - x) - turn
        return turn + (change - 2.0 * np.pi * np.rint(change / (2.0 * np.pi)))


@dataclass(frozen=True)
class NodeLists:
    """Facets near other cells, and nodes: a node is a particle near one other cell, or near its own.

    Attributes
    ----------
    node : (n,) int -- particles, as indices of the `Surfaces`, sorted by cell, other cell, particle.
    other : (n,) int -- the cells that they are near.
    segment : (s, d) int -- nodes at the corners of the facets, once for each cell that they are near.
    source : (s,) int -- these facets, as in the `Surfaces`.
    surfaces : Surfaces -- those among which they were sought.
    """

    node: np.ndarray
    other: np.ndarray
    segment: np.ndarray
    source: np.ndarray
    surfaces: Surfaces

    @property
    def ids(self) -> np.ndarray:
        """Global ids of the particles (n,) int."""
        return self.surfaces.ids[self.node]


@dataclass(frozen=True)
class ContactLists(NodeLists):
    """Pairs of a segment and an edge of another outline, or of its own, that are near each other.

    Pairs are sorted by the first ends of segment and edge, so that sums over them are the same on any number of ranks.
    Nodes are ends of segments, of edges and of the next edges.

    Attributes
    ----------
    first : (s + 1,) int -- where the edges near each segment begin.
    edge : (p, 3) int -- nodes at both ends of the edges, and at the end of the next ones.
    """

    first: np.ndarray
    edge: np.ndarray

    @classmethod
    def of(cls, surfaces: Surfaces, pairs: np.ndarray) -> ContactLists:
        """The lists of `pairs` (p, 2) int: segments and edges by their first ends, sorted."""
        after, cell = surfaces.after, surfaces.cell
        source, edge = pairs.T
        ends = np.column_stack([source, after[source], edge, after[edge], after[after[edge]]])
        near = np.column_stack([cell[edge], cell[edge], cell[source], cell[source], cell[source]])
        n_cells, m = int(cell.max(initial=0)) + 1, max(1, len(cell))
        key, number = np.unique(((cell[ends] * n_cells + near) * m + ends).ravel(), return_inverse=True)
        number = number.reshape(-1, 5)
        begin = np.append(True, (source[1:] != source[:-1]) | (near[1:, 0] != near[:-1, 0]))[: len(pairs)]
        first = np.append(np.flatnonzero(begin), len(pairs))
        return cls(key % m, key // m % n_cells, number[first[:-1], :2], source[first[:-1]], surfaces, first,
                   number[:, 2:])


def contact_pairs(surfaces: Surfaces, x: np.ndarray, farthest: float,
                  within: Callable[[np.ndarray, np.ndarray], np.ndarray], turn: np.ndarray) -> np.ndarray:
    """Pairs of a segment and an edge that are near each other (p, 2) int, sorted, in both orders.

    Neighbours along an outline are no pair, nor are two parts of it between which the cell itself lies: there it is
    thin, and no force on its outside keeps it from becoming thinner.

    Parameters
    ----------
    x : (m, 2) -- positions of the surface particles [µm].
    farthest : float -- largest distance of a pair [µm].
    within : function -- of two cells (k,) int each, distance up to which they are near (k,) [µm], < 0 if they never
        are.
    turn : (m,) -- turns of the outlines at the surface particles, followed from the start: see `followed` [rad].
    """
    among = np.flatnonzero(surfaces.outer)
    a, b, cell = x[among], x[surfaces.after[among]], surfaces.cell[among]
    middle, half = 0.5 * (a + b), 0.5 * np.linalg.norm(b - a, axis=1)
    i, j = cKDTree(middle).query_pairs((farthest + 2.0 * half.max(initial=0.0)) * (1.0 + 1e-9),
                                       output_type="ndarray").T
    most = within(cell[i], cell[j])
    near = np.linalg.norm(middle[i] - middle[j], axis=1) <= most + half[i] + half[j]
    near &= (most >= 0.0) & (surfaces.after[among[i]] != among[j]) & (surfaces.after[among[j]] != among[i])
    i, j, most = i[near], j[near], most[near]
    near = _apart(a[i], b[i], a[j], b[j]) <= most
    own = np.flatnonzero(near & (cell[i] == cell[j]))
    near[own] = _face_outside(surfaces, turn, among[i[own]], among[j[own]])
    pairs = np.column_stack([among[i[near]], among[j[near]]])
    pairs = np.concatenate([pairs, pairs[:, ::-1]])
    return pairs[np.lexsort(pairs.T[::-1])]


def _face_outside(surfaces: Surfaces, turn: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Whether the outside of a cell may be between two segments of its outline, a < b (k,) int; (k,) bool.

    From a part of an outline to one that it faces across the inside, the outline turns by +π either way; to one that it
    faces across a fold, by -π one way and by 3π the other way.  Segments next to each other but for a few meet in folds
    alone: elsewhere short ones between them may turn over.
    """
    outside = np.zeros(len(a), bool)
    for cell in np.unique(surfaces.cell[a]):
        mine = surfaces.cell[a] == cell
        loop = np.flatnonzero((surfaces.cell == cell) & surfaces.outer)
        along, first, last = np.cumsum(turn[loop]), a[mine] - loop[0], b[mine] - loop[0]
        angle, steps = along[last] - along[first], last - first
        back = len(loop) - steps
        least = np.where(steps <= back, angle, 2.0 * np.pi - angle)
        far = np.minimum(steps, back) > CLOSE
        outside[mine] = np.where(far, np.abs(angle - np.pi) > 0.75 * np.pi, least < -0.5 * np.pi)
    return outside


def acting(surfaces: Surfaces, pairs: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Those of `pairs` (p, 2) int that exert forces on particles in `own` (m,) bool, in the same order (q, 2) int."""
    return pairs[(own[pairs] | own[surfaces.after[pairs]]).any(axis=1)]


def cells_around(low: np.ndarray, high: np.ndarray, mine: np.ndarray, reach: float) -> np.ndarray:
    """Cells that may be within `reach` [µm] of the cells `mine` (k,) int, ascending (n,) int.

    `low` and `high` (c, 2) [µm] are opposite corners of the bounding boxes of all cells.
    """
    if len(mine) in (0, len(low)):
        return mine
    centre, wide = 0.5 * (low + high), np.linalg.norm(high - low, axis=1).max()
    away, _ = cKDTree(centre[mine]).query(centre, distance_upper_bound=reach + wide)
    return np.flatnonzero(np.isfinite(away))


def _apart(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Distances (k,) [µm] of segments from a to b and from c to d, (k, 2) [µm] each, that do not cross."""
    return np.minimum(np.minimum(_distances(a, c, d), _distances(b, c, d)),
                      np.minimum(_distances(c, a, b), _distances(d, a, b)))


def _distances(x: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distances (k,) [µm] of points x from the segments from a to b, (k, 2) [µm] each."""
    along = b - a
    t = np.clip(((x - a) * along).sum(axis=1) / (along * along).sum(axis=1), 0.0, 1.0)
    return np.linalg.norm(x - a - t[:, None] * along, axis=1)
