"""Points spread evenly over a closed surface, with some in its corners and along its sharp edges.

They grow from corners, sharp edges and the lowest point like crystals of a triangular lattice, and then push each other
away until all have nearly the same room.  Only points on the same side of a body, whose normals are similar, see each
other.  The surface is represented by samples of equal area.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from .surfaces import ClosedSurface
from .triangles import cross, dot, edges_of, lengths, on_triangles, unit

SHARP = np.cos(np.radians(40.0))  # of the angle between the normals at an edge: less is a sharp edge
CORNER = np.cos(np.radians(60.0))  # of the turn of a line of sharp edges: less is a corner
OPPOSITE = -0.1  # cosine of the angle between normals: less is the other side of a thin body
SAMPLES = 20  # of the surface for each point
NEAR = 6  # samples among which that of a point is looked for
FACES = 12  # samples nearest to a point on a sharp edge, whose normals are those of its faces
SPACING = 1.0746  # distance of neighbours in a triangular lattice with one point per unit area
# In distances of neighbours:
ROOM = 0.75  # least initial distance of points
STEEP = 0.5  # largest distance of the surface from the tangent at a neighbour
GAP = 0.9  # largest initial distance of the surface from a point
CLOSE = 0.5  # least distance of points on sharp edges
REACH, PUSH = 1.3, 0.3  # points push each other away within this distance, with this step
FAR = 0.3  # largest move in a round, in each direction
ROUNDS = 30  # that even out the points


class Samples:
    """Points of equal area on a surface, with normals: what surface is near a place.

    Attributes
    ----------
    surface : ClosedSurface
    points : (n, 3) -- positions [µm].
    triangle : (n,) int -- triangle of the surface on which each lies.
    normals : (n, 3) -- outward unit normals [-].
    tree : cKDTree -- of the points.
    apart : float -- root of the area of each [µm]: the surface ends no further from them.
    """

    def __init__(self, surface: ClosedSurface, n: int):
        self.surface = surface
        self.points, self.triangle = surface.sampled(n)
        self.normals = surface.normals[self.triangle]
        self.tree = cKDTree(self.points)
        self.apart = np.sqrt(surface.area / n)

    def onto(self, p: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Project points onto the plane of a sample, the nearest one on the same side of the body.

        Parameters
        ----------
        p : (n, 3) -- positions near the surface [µm].
        normal : (n, 3) -- unit normals of the side of the surface that is meant [-].

        Returns
        -------
        q : (n, 3) -- positions on the surface [µm].
        normal : (n, 3) -- its unit normals there [-].
        sample : (n,) int -- number of the sample.
        """
        near = self.tree.query(p, NEAR)[1]
        same = dot(self.normals[near], normal[:, None])
        near = near[np.arange(len(p)), np.where(same > 0.0, 0.0, same).argmax(axis=1)]  # the nearest on this side
        n, from_it = self.normals[near], p - self.points[near]
        beside = from_it - dot(from_it, n)[:, None] * n
        beside *= np.minimum(1.0, self.apart / np.maximum(lengths(beside), 1e-300))[:, None]  # not beyond an edge
        return self.points[near] + beside, n, near

    def height(self, p: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
        """Heights of points above the nearest sample.

        Parameters
        ----------
        p : (n, 3) -- positions [µm].
        reach : float -- distance from the surface up to which points are looked at [µm].

        Returns
        -------
        height : (n,) -- negative inside; that of points out of reach is -inf, wherever they are [µm].
        normal : (n, 3) -- unit normals of the samples, zero out of reach [-].
        """
        away, near = self.tree.query(p, distance_upper_bound=reach)
        seen = np.flatnonzero(np.isfinite(away))
        height, normal = np.full(len(p), -np.inf), np.zeros((len(p), 3))
        normal[seen] = self.normals[near[seen]]
        height[seen] = dot(p[seen] - self.points[near[seen]], normal[seen])
        return height, normal

    def alike(self, p: np.ndarray, normal: np.ndarray, reach: float) -> np.ndarray:
        """Triangles (n,) int of the surface near the points p (n, 3) [µm] whose normals are like `normal` (n, 3).

        An angle of one radian counts as much as the distance `reach` [µm].
        """
        tree = cKDTree(np.concatenate([self.points, reach * self.normals], axis=1))
        return self.triangle[tree.query(np.concatenate([p, reach * normal], axis=1))[1]]


def surface_points(samples: Samples, n: float) -> tuple[np.ndarray, int]:
    """About n points of a surface, so that each has nearly the same area.

    Parameters
    ----------
    samples : Samples -- of the surface, some 20 for each point.
    n : float -- wanted number of points [-]; that found differs by a few per cent.

    Returns
    -------
    points : (m, 3) -- positions [µm].
    fixed : int -- how many of them, the first ones, are in corners, along sharp edges or the lowest one.

    Source: derived here, see the head of this module.
    """
    apart = SPACING * np.sqrt(samples.surface.area / n)
    fixed = _fixed(samples, apart)
    P, N = _grown(samples, fixed, apart)
    free = np.arange(len(P)) >= len(fixed)
    for _ in range(ROUNDS):
        i, j = _near(P, N, REACH * apart)
        along = P[j] - P[i]
        away = lengths(along)
        push = (PUSH * apart * (1.0 / np.maximum(away, 1e-300) - 1.0 / (REACH * apart)))[:, None] * along
        push = np.column_stack([np.bincount(j, x, len(P)) - np.bincount(i, x, len(P)) for x in push.T])
        moved, N[free], _ = samples.onto(P[free] + np.clip(push[free], -FAR * apart, FAR * apart), N[free])
        P[free] = moved
    near = samples.onto(P[free], N[free])[2]
    P[free] = on_triangles(P[free], samples.surface.corners[samples.triangle[near]])
    return P, len(fixed)


def _near(P: np.ndarray, N: np.ndarray, reach: float) -> np.ndarray:
    """Pairs (2, k) int of points P (n, 3) closer than `reach` on one side of a body, by their normals N (n, 3)."""
    pairs = cKDTree(P).query_pairs(reach, output_type="ndarray")
    i, j = pairs.T
    fixed = (N == 0.0).all(axis=1)
    return pairs[(dot(N[i], N[j]) > 0.0) | fixed[i] | fixed[j]].T


def _grown(samples: Samples, fixed: np.ndarray, apart: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) that grow from the `fixed` ones like crystals, and their normals, zero for the fixed ones.

    Each point proposes six neighbours in the directions of its lattice; those that are too close to others are dropped.
    """
    if len(fixed) == 0:
        fixed = samples.points[:1]
    P, N = fixed, np.zeros_like(fixed)
    faces = samples.tree.query(fixed, FACES)[1].ravel()
    at, normal = np.repeat(fixed, FACES, axis=0), samples.normals[faces]
    other = cKDTree(fixed).query(fixed, 2)[1][:, 1] if len(fixed) > 1 else np.zeros(1, int)
    along = np.repeat(fixed[other] - fixed, FACES, axis=0) if len(fixed) > 1 else np.tile([1.0, 0.1, 0.2], (FACES, 1))
    while True:
        while len(at):
            along = unit(along - dot(along, normal)[:, None] * normal)
            turned = np.sqrt(0.75) * cross(normal, along)
            ways = np.stack([along, 0.5 * along + turned, turned - 0.5 * along], axis=1)
            ways = np.concatenate([ways, -ways], axis=1).reshape(-1, 3)
            at, normal = np.repeat(at, 6, axis=0), np.repeat(normal, 6, axis=0)
            step = at + apart * ways
            q, n, _ = samples.onto(step, normal)
            good = (dot(n, normal) > 0.0) & (lengths(q - step) < STEEP * apart)
            q, n, along = q[good], n[good], ways[good]
            fresh = _fresh(q, n, P, N, ROOM * apart)
            at, normal, along = q[fresh], n[fresh], along[fresh]
            P, N = np.concatenate([P, at]), np.concatenate([N, normal])
        empty = np.flatnonzero(cKDTree(P).query(samples.points)[0] > GAP * apart)
        empty = empty[_fresh(samples.points[empty], samples.normals[empty], P, N, ROOM * apart)]
        if len(empty) == 0:
            return P, N
        at, normal = samples.points[empty], samples.normals[empty]
        along = P[cKDTree(P).query(at)[1]] - at
        P, N = np.concatenate([P, at]), np.concatenate([N, normal])


def _fresh(q: np.ndarray, n: np.ndarray, P: np.ndarray, N: np.ndarray, apart: float) -> np.ndarray:
    """Indices of those of the points q (k, 3) that are `apart` from the points P (m, 3) and from each other."""
    pairs = _near(np.concatenate([P, q]), np.concatenate([N, n]), apart) - len(P)
    late, early = pairs.max(axis=0), pairs.min(axis=0)
    left = np.ones(len(q), bool)
    left[late[early < 0][late[early < 0] >= 0]] = False
    late, early = late[early >= 0], early[early >= 0]
    taken = np.zeros(len(q), bool)
    while left.any():
        both = left[late] & left[early]
        late, early = late[both], early[both]
        first = left.copy()
        first[late] = False
        taken |= first
        left &= ~first
        left[late[first[early]]] = False
    return np.flatnonzero(taken)


def _fixed(samples: Samples, spacing: float) -> np.ndarray:
    """Points that do not move (k, 3) [µm]: corners, and others `spacing` apart along sharp edges and between parts.

    The lowest vertex, where a cell touches the substrate first, is one, unless the bottom is flat.
    """
    surface = samples.surface
    edges, edge = edges_of(surface.triangles)
    beside = (np.argsort(edge.ravel(), kind="stable") // 3).reshape(-1, 2)  # both triangles of each edge
    sharp = _sharp(samples, edges, beside, spacing) | (surface.part[beside[:, 0]] != surface.part[beside[:, 1]])
    corners, lines = _lines(surface.vertices, edges[sharp])
    points = [surface.vertices[corners]]
    for line in lines:
        p = surface.vertices[line]
        arc = np.append(0.0, np.cumsum(lengths(np.diff(p, axis=0))))
        loop = line[0] not in corners
        pieces = max(round(arc[-1] / spacing), 3 if loop else 1)
        s = arc[-1] * np.arange(0 if loop else 1, pieces) / pieces
        points.append(np.column_stack([np.interp(s, arc, x) for x in p.T]))
    z = surface.vertices[:, 2]
    lowest = np.flatnonzero(z < z.min() + 1e-6 * spacing)
    points.append(surface.vertices[lowest if len(lowest) == 1 else lowest[:0]])
    found = np.concatenate(points)
    return found[thinned(found, CLOSE * spacing)]


def _sharp(samples: Samples, edges: np.ndarray, beside: np.ndarray, spacing: float) -> np.ndarray:
    """Which of the edges (k, 2), between the triangles `beside` (k, 2), are sharp (k,) bool, on the scale of `spacing`.

    Half a spacing away on both sides, the mean normals differ as much: steps of a rough surface do not count.
    """
    surface = samples.surface
    normals = surface.normals[beside]
    sharp = dot(normals[:, 0], normals[:, 1]) < SHARP
    edges, beside, normals = edges[sharp], beside[sharp], normals[sharp]
    a, b = surface.vertices[edges].transpose(1, 0, 2)
    means = []
    for k in range(2):
        away = cross(normals[:, k], unit(b - a))
        away *= np.sign(dot(surface.corners[beside[:, k]].mean(axis=1) - a, away))[:, None]
        near = samples.normals[samples.tree.query(0.5 * (a + b) + 0.5 * spacing * away, FACES)[1]]
        this_side = dot(near, normals[:, k, None]) > OPPOSITE
        means.append(unit((near * this_side[..., None]).sum(axis=1)))
    sharp[sharp] = dot(*means) < SHARP
    return sharp


def _lines(vertices: np.ndarray, edges: np.ndarray) -> tuple[list[int], list[list[int]]]:
    """Corners of the lines that edges (k, 2) form, and the vertices along each line: between corners, or a loop."""
    beside: dict[int, list[int]] = {}
    for p, q in edges.tolist():
        beside.setdefault(p, []).append(q)
        beside.setdefault(q, []).append(p)

    def turns(at: int) -> bool:
        before, after = (unit(vertices[near] - vertices[at]) for near in beside[at])
        return bool(-dot(before, after) < CORNER)

    corners = [at for at in sorted(beside) if len(beside[at]) != 2 or turns(at)]
    ends, left, lines = set(corners), {frozenset(edge) for edge in edges.tolist()}, []
    for start in [*corners, *sorted(beside)]:  # what the corners leave are loops
        for second in sorted(beside[start]):
            line = [start, second]
            if frozenset(line) not in left:
                continue
            left.discard(frozenset(line))
            while line[-1] not in ends and line[-1] != start:
                line.append(next(near for near in beside[line[-1]] if near != line[-2]))
                left.discard(frozenset(line[-2:]))
            lines.append(line)
    return corners, lines


def thinned(points: np.ndarray, apart: float) -> np.ndarray:
    """Which `points` (n, 3) [µm] are left (n,) bool without those closer than `apart` [µm] to an earlier one."""
    kept = np.ones(len(points), bool)
    for i, j in sorted(cKDTree(points).query_pairs(apart)) if len(points) else []:
        kept[j] &= not kept[i]
    return kept
