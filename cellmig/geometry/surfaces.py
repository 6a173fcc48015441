"""Closed triangulated surfaces in space, oriented outward: volume, what is inside, distances, and points on them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from .triangles import area_vectors, cross, dot, edges_of, lengths, on_triangles, ranks, unit, volume

FLAT = 1e-3  # depth of a hollow over the size of a body up to which it is convex [-]
NEAREST = 12  # samples nearest to a point, on whose triangles its closest point is looked for
BLOCK = 2_000_000  # pairs that are looked at together
# Rays run along the last of these directions, which is that of no edge of common shapes.
RAYS = np.array([[0.9363, 0.2896, -0.1987], [-0.2751, 0.9564, 0.0976], [0.2183, -0.0367, 0.9752]])


def on_hull(points: np.ndarray) -> bool:
    """Whether all `points` (n, 3) of a surface, in one unit, are on their convex hull, to 1e-3 of its size."""
    hull = ConvexHull(points)
    others, faces = np.delete(points, hull.vertices, axis=0), hull.equations
    depth = -(others @ faces[:, :3].T + faces[:, 3]).max(axis=1)
    return bool(depth.max(initial=0.0) < FLAT * np.ptp(points, axis=0).max())


@dataclass(frozen=True, eq=False)
class ClosedSurface:
    """A closed surface of one piece, made of triangles that are oriented outward; made by `closing.closed`.

    Attributes
    ----------
    vertices : (k, 3) -- positions of the vertices [µm].
    triangles : (m, 3) int -- vertices of each triangle, counterclockwise when seen from outside.
    part : (m,) int -- number of the named part of the surface to which each triangle belongs.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    part: np.ndarray

    @cached_property
    def corners(self) -> np.ndarray:
        """Positions of the vertices of each triangle (m, 3, 3) [µm]."""
        return self.vertices[self.triangles]

    @cached_property
    def normals(self) -> np.ndarray:
        """Outward unit normals of the triangles (m, 3) [-]."""
        return unit(area_vectors(self.corners))

    @cached_property
    def areas(self) -> np.ndarray:
        """Areas of the triangles (m,) [µm²]."""
        return lengths(area_vectors(self.corners))

    @property
    def area(self) -> float:
        """Area of the surface [µm²]."""
        return float(self.areas.sum())

    @property
    def volume(self) -> float:
        """Volume inside [µm³]."""
        return volume(self.vertices, self.triangles)

    @cached_property
    def centroid(self) -> np.ndarray:
        """Centre of the volume (3,) [µm].

        Source: sum over the tetrahedra from a point of the surface to its triangles (divergence theorem).
        """
        p = self.corners - self.vertices[0]
        six = dot(p[:, 0], cross(p[:, 1], p[:, 2]))
        return self.vertices[0] + (six[:, None] * p.sum(axis=1)).sum(axis=0) / (4.0 * six.sum())

    def moved(self, vertices: np.ndarray) -> ClosedSurface:
        """The same triangles between `vertices` (k, 3) [µm] elsewhere, by a map that keeps the sense of rotation."""
        return ClosedSurface(vertices, self.triangles, self.part)

    def sampled(self, n: int) -> tuple[np.ndarray, np.ndarray]:
        """Points that represent equal areas.

        Returns
        -------
        points : (n, 3) -- positions on the triangles [µm], the same in whatever order the triangles are listed.
        triangle : (n,) int -- triangle of each.

        Source: the sequence R2 (Roberts 2018), folded into triangles that are sorted along a curve (Morton 1966).
        """
        order = np.argsort(_morton(self.corners.sum(axis=1)), kind="stable")
        until = np.cumsum(self.areas[order])
        k = np.arange(n)
        found = np.searchsorted(until, (k + 0.5) / n * until[-1])
        triangle = order[np.minimum(found, len(order) - 1)]
        u, v = (0.5 + k * 0.7548776662466927) % 1.0, (0.5 + k * 0.5698402909980532) % 1.0
        folded = u + v > 1.0
        u, v = np.where(folded, 1.0 - u, u)[:, None], np.where(folded, 1.0 - v, v)[:, None]
        a, b, c = self.corners[triangle].transpose(1, 0, 2)
        return a + u * (b - a) + v * (c - a), triangle

    @cached_property
    def _samples(self) -> tuple[cKDTree, np.ndarray]:
        """Points of all triangles, for searches, and the triangle of each."""
        points, triangle = self.sampled(max(20_000, 3 * len(self.triangles)))
        points = np.concatenate([points, self.corners.mean(axis=1)])
        return cKDTree(points), np.append(triangle, np.arange(len(self.triangles)))

    def closest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Closest points of the surface to `points` (n, 3) [µm].

        Returns
        -------
        closest : (n, 3) -- positions on the surface [µm].
        triangle : (n,) int -- triangle of each.

        Looked for on the triangles of the nearest samples: far from a curved surface another one may be closer, by far
        less than the distance.
        """
        tree, triangle_of = self._samples
        near = triangle_of[tree.query(points, NEAREST)[1]]
        found = on_triangles(points[:, None], self.corners[near])
        at = np.arange(len(points))
        best = ((found - points[:, None]) ** 2).sum(axis=-1).argmin(axis=1)
        q, triangle, left = found[at, best], near[at, best], at
        while len(left):  # a thin triangle may have no sample near: go on over the edges
            near = self._beside[triangle[left]]
            found = on_triangles(points[left, None], self.corners[near])
            away = ((found - points[left, None]) ** 2).sum(axis=-1)
            best, rows = away.argmin(axis=1), np.arange(len(left))
            closer = away[rows, best] < (1.0 - 1e-12) * ((q[left] - points[left]) ** 2).sum(axis=1)
            left, rows, best = left[closer], rows[closer], best[closer]
            q[left], triangle[left] = found[rows, best], near[rows, best]
        return q, triangle

    @cached_property
    def _beside(self) -> np.ndarray:
        """Triangles beyond the edges of each (m, 3) int."""
        order = np.argsort(edges_of(self.triangles)[1].ravel(), kind="stable").reshape(-1, 2)
        beside = np.empty(3 * len(self.triangles), int)
        beside[order] = order[:, ::-1] // 3
        return beside.reshape(-1, 3)

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Distances of `points` (n, 3) [µm] from the surface (n,) [µm], negative inside."""
        away = lengths(self.closest(points)[0] - points)
        return np.where(self.inside(points), -away, away)

    @cached_property
    def _shadow(self) -> _Cells:
        """The triangles, projected along the rays."""
        return _Cells(_turned(self.vertices)[self.triangles][..., :2])

    @cached_property
    def _sides(self) -> np.ndarray:
        """Of each edge of each triangle (m, 3, 4): a, b, c of the half-plane a x + b y >= c, and 1 if it is the inside.

        Both triangles of an edge have the same a, b, c.
        """
        v, start, end = _turned(self.vertices), self.triangles, np.roll(self.triangles, -1, axis=1)
        low, high = v[np.minimum(start, end)], v[np.maximum(start, end)]
        a, b = low[..., 1] - high[..., 1], high[..., 0] - low[..., 0]
        return np.stack([a, b, a * low[..., 0] + b * low[..., 1], start < end], axis=-1)

    @cached_property
    def _planes(self) -> np.ndarray:
        """Of each triangle (m, 4): normal and height along it, so turned that points below have smaller heights."""
        a, b, c = _turned(self.vertices)[self.triangles].transpose(1, 0, 2)
        normal = cross(b - a, c - a)
        normal *= np.sign(normal[:, 2:])
        return np.column_stack([normal, dot(normal, a)])

    def inside(self, points: np.ndarray) -> np.ndarray:
        """Whether each of the `points` (n, 3) [µm] is inside (n,) bool."""
        return self.winding(points) > 0

    def winding(self, points: np.ndarray) -> np.ndarray:
        """How often the surface goes around each of the `points` (n, 3) [µm]: 1 inside, 0 outside, 2 where it overlaps
        itself, -1 where it is turned inside out (n,) int.

        Source: the signed crossings of a ray with the triangles; the side of an edge is computed once for both of its
        triangles, so that no ray passes between them.
        """
        p = _turned(points)
        winding = np.zeros(len(points), int)
        for one, other in self._shadow.pairs(p[:, :2]):
            x, y = p[one, :2].T[:, :, None]
            a, b, c, turned = np.moveaxis(self._sides[other], -1, 0)
            left = (a * x + b * y >= c) == (turned > 0.0)
            met = left.all(axis=1) | ~left.any(axis=1)
            one, other, sign = one[met], other[met], np.where(left[met, 0], 1, -1)
            normal, height = self._planes[other, :3], self._planes[other, 3]
            above = height > dot(normal, p[one])
            winding += np.bincount(one[above], sign[above], len(points)).astype(int)
        return winding


class _Cells:
    """Square cells of a plane, and the triangles (m, 3, 2) whose bounding boxes reach into each."""

    def __init__(self, corners: np.ndarray):
        low, high = corners.min(axis=1), corners.max(axis=1)
        self.low, self.high = low.min(axis=0), high.max(axis=0)
        self.number = int(np.clip(2.0 * np.sqrt(len(corners)), 1, 1000))
        first, last = self._cell(low), self._cell(high)
        wide = last - first + 1
        size = wide[:, 0] * wide[:, 1]
        triangle, k = np.repeat(np.arange(len(corners)), size), ranks(size)
        of = wide[triangle, 1]
        cell = (first[triangle, 0] + k // of) * self.number + first[triangle, 1] + k % of
        self.triangle = triangle[np.argsort(cell, kind="stable")]
        self.count = np.bincount(cell, minlength=self.number**2)
        self.start = np.cumsum(self.count) - self.count

    def _cell(self, p: np.ndarray) -> np.ndarray:
        width = np.maximum(self.high - self.low, 1e-300)
        return np.clip(np.floor((p - self.low) / width * self.number), 0, self.number - 1).astype(int)

    def pairs(self, p: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Blocks of the pairs of a point of p (n, 2) and a triangle of its cell."""
        at = np.flatnonzero(((p >= self.low) & (p <= self.high)).all(axis=1))
        i, j = self._cell(p[at]).T
        cell = i * self.number + j
        count = self.count[cell]
        for block in np.split(np.arange(len(at)), np.flatnonzero(np.diff(np.cumsum(count) // BLOCK)) + 1):
            n = count[block]
            yield np.repeat(at[block], n), self.triangle[np.repeat(self.start[cell[block]], n) + ranks(n)]


def _turned(p: np.ndarray) -> np.ndarray:
    """Points p (n, 3) in coordinates whose last axis is the direction of the rays."""
    return np.stack([dot(p, axis) for axis in RAYS], axis=-1)


def _morton(p: np.ndarray) -> np.ndarray:
    """Numbers (n,) int along a curve through all places, by which points p (n, 3) that are close get close numbers."""
    low, size = p.min(axis=0), max(np.ptp(p, axis=0).max(), 1e-300)
    cell = np.floor((p - low) / size * 1023.999).astype(int)
    bits = np.arange(10)
    return (((cell[..., None] >> bits) & 1) << (3 * bits + np.arange(3)[:, None])).sum(axis=(1, 2))
