"""Contacts: which part of whose surface is within reach of another cell."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..geometry.triangles import area_vectors, on_triangles
from ..meshfree.contact import Surfaces

MOST = {2: 16, 3: 6}  # pieces along a side of a facet
AT_ONCE = 10_000  # pairs of facets: each has tens of pieces


@dataclass(frozen=True)
class Contacts:
    """Contacts of cells: pairs (i, j), sorted, in which a part of the outer surface of i is near that of j.

    A part counts fully up to half the reach, and gradually less up to the reach.  Facets are divided into pieces as
    small as the reach, so that contacts hardly depend on the spacing of particles.

    Attributes
    ----------
    pair : (k, 2) int -- cells i and j.
    share : (k,) -- share of the outer surface of i that is in contact with j [-].
    middle : (k, d) -- middle of that part [µm].
    close : (k,) -- how close the cells are, from 0 at the reach to 1 at half of it [-]; the same in both orders.
    distance : (m,) -- distance of the surface particles from the nearest other cell [µm], inf beyond the reach.
    """

    pair: np.ndarray
    share: np.ndarray
    middle: np.ndarray
    close: np.ndarray
    distance: np.ndarray

    @classmethod
    def of(cls, surfaces: Surfaces, x: np.ndarray, reach: float, gels: Iterable[int] = ()) -> Contacts:
        """Contacts of `surfaces`, whose particles are at x (m, d) [µm], within a `reach` [µm].

        gels : numbers of the bodies that are no cells, and nobody's neighbours.
        """
        on = surfaces.facets[surfaces.outer & ~np.isin(surfaces.cell[surfaces.facets[:, 0]], list(gels))]
        corners, cell, number = x[on], surfaces.cell[on[:, 0]], int(surfaces.cell[-1]) + 1
        i, j = _near(corners, cell, reach)
        away = np.full(len(x), np.inf)
        np.minimum.at(away, on[i], distances(corners[i], corners[j]))
        facet, other, points, least = _divided(corners, i, j, cell[j], reach)
        size, own = sizes(corners), cell[facet]
        amount = closeness(least, reach) * size[facet, None] / points.shape[1]
        pairs, of = np.unique(own * number + other, return_inverse=True)
        total, moment, gap = np.zeros(len(pairs)), np.zeros((len(pairs), x.shape[1])), np.full(number**2, np.inf)
        np.add.at(total, of.ravel(), amount.sum(axis=1))
        np.add.at(moment, of.ravel(), np.einsum("fp,fpd->fd", amount, points[facet]))
        np.minimum.at(gap, np.minimum(own, other) * number + np.maximum(own, other), least.min(axis=1))
        pairs, total, moment = (values[total > 0.0] for values in (pairs, total, moment))
        pair = np.column_stack(np.divmod(pairs, number))
        return cls(pair, total / np.bincount(cell, size, number)[pair[:, 0]], moment / total[:, None],
                   closeness(gap[pair.min(axis=1) * number + pair.max(axis=1)], reach),
                   np.where(away < reach, away, np.inf))


def closeness(distance: np.ndarray, reach: float) -> np.ndarray:
    """1 at a `distance` [µm] of any shape (...,) up to half the `reach` [µm], gradually less up to it, 0 beyond [-]."""
    u = np.clip(2.0 - 2.0 * distance / reach, 0.0, 1.0)
    return u * u * (3.0 - 2.0 * u)


def sizes(corners: np.ndarray) -> np.ndarray:
    """Lengths [µm] or areas [µm²] (f,) of facets with these `corners` (f, d, d) [µm]."""
    if corners.shape[1] == 2:
        return np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
    return np.linalg.norm(area_vectors(corners), axis=1)


def pieces(d: int, n: int) -> np.ndarray:
    """Middles of the pieces of equal size of a facet whose sides are divided by n, by shares of its corners (p, d) [-].

    A segment, for d of 2, has n pieces, a triangle n².
    """
    if d == 2:
        along = (np.arange(n) + 0.5) / n
        return np.column_stack([1.0 - along, along])
    a, b = np.indices((n, n)).reshape(2, -1)
    upright = np.column_stack([a, b])[a + b < n] + 1.0 / 3.0
    turned = np.column_stack([a, b])[a + b < n - 1] + 2.0 / 3.0
    share = np.concatenate([upright, turned]) / n
    return np.column_stack([1.0 - share.sum(axis=1), share])


def distances(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Distances (k, p) [µm] of `points` (k, p, d) [µm] from facets with these `corners` (k, d, d) [µm], row by row."""
    if corners.shape[1] == 3:
        return np.linalg.norm(points - on_triangles(points, corners[:, None]), axis=2)
    start, along = corners[:, :1], corners[:, 1:] - corners[:, :1]
    square = np.maximum((along * along).sum(axis=2), 1e-300)
    share = np.clip(((points - start) * along).sum(axis=2) / square, 0.0, 1.0)
    return np.linalg.norm(points - start - share[..., None] * along, axis=2)


def _near(corners: np.ndarray, cell: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of facets of different cells that may be within reach, by their bounding spheres, in both orders."""
    middle, radius = _spheres(corners)
    pairs = cKDTree(middle).query_pairs(reach + 2.0 * radius.max(), output_type="ndarray")
    i, j = np.concatenate([pairs, pairs[:, ::-1]]).T
    near = cell[i] != cell[j]
    near[near] &= np.linalg.norm(middle[i[near]] - middle[j[near]], axis=1) <= (reach + radius[i] + radius[j])[near]
    i, j = i[near], j[near]
    order = np.lexsort((j, i))
    return i[order], j[order]


def _divided(corners: np.ndarray, i: np.ndarray, j: np.ndarray, others: np.ndarray, reach: float
             ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Facets near other cells, these cells, pieces of all facets (f, p, d), and the pieces' distances from these cells.

    i, j : pairs of facets that may be within reach;  others : cells of j.  A facet that is near several facets of a
    cell comes once, with the least distance of each piece.
    """
    middle, radius = _spheres(corners)
    d, number = corners.shape[1], int(others.max(initial=0)) + 1
    inside = pieces(d, int(np.clip(np.ceil(2.0 * radius[i].max(initial=0.0) / reach), 1, MOST[d])))
    points = np.einsum("pc,fcd->fpd", inside, corners)
    key, which = np.unique(i * number + others, return_inverse=True)
    least = np.full((len(key), len(inside)), np.inf)
    for some in np.array_split(np.arange(len(i)), len(i) // AT_ONCE + 1):
        apart = np.linalg.norm(points[i[some]] - middle[j[some], None], axis=2)
        pair, piece = np.nonzero(apart <= reach + radius[j[some], None])
        pair = some[pair]
        np.minimum.at(least, (which.ravel()[pair], piece),
                      distances(points[i[pair], piece][:, None], corners[j[pair]])[:, 0])
    return *np.divmod(key, number), points, least


def _spheres(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centres and radii of spheres around facets."""
    middle = corners.mean(axis=1)
    return middle, np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
