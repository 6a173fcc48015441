"""Closed surfaces of triangles divided evenly anew: their points slide in the surface, and edges are flipped."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from .surfaces import ClosedSurface
from .triangles import area_vectors, cross, dot, edges_of, lengths, shares, unit, volume

SHARP = np.cos(np.radians(30.0))  # of the turn at an edge, or of a line of such edges: less stays
FLAT = np.cos(np.radians(1.0))  # of the turn at edges up to which a piece is flat
ROUNDS = 30  # in which points slide
SHORT = 2  # edges that a line of sharp ones is shortened by at a free end: of few edges it is none
RESTS = 1e-3  # farthest move over the mean edge, at which they rest [-]
BENT = np.radians(15.0)  # turn of a triangle to the next at which it counts twice
FARTHEST = 0.3  # how far a point moves in a round at most, over its shortest edge [-]
THIN = 0.05  # least area of a triangle, on the surface of now and at the start, over that before the round [-]
ATTEMPTS = 4  # to take back moves that fold triangles
OBTUSE = 1e-6  # sine of the sum of two opposite angles beyond 180° from which their edge is flipped [-]


@dataclass(frozen=True)
class Divided:
    """Where the points of a surface come to be, and its triangles then.

    Attributes
    ----------
    x : (m, 3) -- positions [µm].
    triangles : (t, 3) int -- points at their corners, as many as before.
    corners : (m, 3) int -- points of before at the corners of the triangle in which each is.
    share : (m, 3) -- of these corners [-].
    moves : (m,) bool -- whether the surface around a point is curved, so that it may move along its normal.
    """

    x: np.ndarray
    triangles: np.ndarray
    corners: np.ndarray
    share: np.ndarray
    moves: np.ndarray

    def between(self, values: np.ndarray) -> np.ndarray:
        """`values` (m, ...) of any unit, of the points of before, at the new places (m, ...), linear in between."""
        return np.einsum("mk,mk...->m...", self.share, values[self.corners])


def spread(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Longest edge (t,) and least height (t,) [µm] of triangles with these `corners` (t, 3, 3) [µm]."""
    longest = lengths(np.roll(corners, -1, axis=1) - corners).max(axis=1)
    return longest, 2.0 * lengths(area_vectors(corners)) / longest


def unevenness(corners: np.ndarray) -> float:
    """Longest edge over the least height of triangles with these `corners` (t, 3, 3) [µm], [-]."""
    longest, height = spread(corners)
    return float(longest.max() / max(height.min(), 1e-300))


def undivided(x: np.ndarray, triangles: np.ndarray, held: np.ndarray, straight: np.ndarray) -> Divided:
    """A surface as it is: points x (m, 3) [µm], triangles (t, 3) int, held and straight (m,) bool, see `divided`."""
    own = np.repeat(np.arange(len(x))[:, None], 3, axis=1)
    share = np.tile([1.0, 0.0, 0.0], (len(x), 1))
    return Divided(x, triangles, own, share, Lines.of(x, triangles).curved & ~held & ~straight)


def divided(x: np.ndarray, triangles: np.ndarray, start: np.ndarray, held: np.ndarray,
            straight: np.ndarray, upward: np.ndarray | None = None) -> Divided:
    """A surface whose triangles are even.

    Each point moves to the middle of the triangles around it, weighted by their areas, and back onto the surface; an
    edge whose opposite angles are together more than 180° is flipped.  Triangles count more where they turn, and come
    to be smaller there.  Edges that turn by more than 30°, and those around flat pieces, stay; points on a line of them
    slide along it, and its corners stay.  Sharp edges of lines with fewer than five are not flipped either, but their
    points slide.  Between its corners a triangle is a quadratic patch, see `_bulges`.

    Parameters
    ----------
    x : (m, 3) -- positions of the points [µm].
    triangles : (t, 3) int -- their triangles, counterclockwise from outside.
    start : (m, 3) -- places of the points on the surface of the start, on which no triangle may be folded [µm].
    held : (m,) bool -- points that stay, with all edges around them.
    straight : (m,) bool -- points at which edges do not bulge.
    upward : (m, 3) -- unit normals of the surface of the start there [-]; None for those of the triangles, which mean
        little where these are slivers there.

    Source: sliding as in Botsch & Kobbelt (2004), Symp. Geometry Processing, 185; flips as of Delaunay triangles.
    """
    surface = ClosedSurface(x, triangles, np.zeros(len(triangles), int))
    lines = Lines.of(x, triangles)
    outward = normals(x, triangles)[0], normals(start, triangles)[0] if upward is None else upward
    now = _Sliding(x, triangles, undivided(x, triangles, held, straight), start)
    size = lengths(x[triangles] - x[np.roll(triangles, -1, axis=1)]).mean()
    for _ in range(ROUNDS):
        now = _flipped(now, lines, held, outward)
        moved = _moved(now, surface, lines, held, start, outward)
        far = lengths(moved.x - now.x).max()
        now = moved
        if far < RESTS * size:
            break
    now = _flipped(now, lines, held, outward)
    new = now.places
    bulge = _bulges(x, triangles, lines, held | straight)
    return replace(new, x=now.x + bulge.at(new.corners, new.share), triangles=now.triangles,
                   moves=lines.curved & ~held & ~straight)


def filled(x: np.ndarray, triangles: np.ndarray, moves: np.ndarray, content: float, most: float) -> np.ndarray:
    """Positions x (m, 3) [µm] moved along their normals, at most by `most` [µm], so that the `triangles` (t, 3) int
    enclose a `content` [µm³]: all that `moves` (m,) bool, in proportion to the mean turn at the edges around them.
    """
    normal, area = normals(x, triangles)
    edges, _, turn = _turns(x, triangles)
    weight = moves * np.bincount(edges.ravel(), np.repeat(turn, 2), len(x)) / np.bincount(edges.ravel())
    way, size = (weight / max(weight.max(), 1e-300))[:, None] * normal, 0.0
    rate, moved = float(dot(way, area).sum()) / 3.0, x
    for _ in range(4):
        size = float(np.clip(size + (content - volume(moved, triangles)) / max(rate, 1e-300), -most, most))
        moved = x + size * way
    return moved


@dataclass(frozen=True)
class Lines:
    """Edges of a surface that stay.

    Attributes
    ----------
    x : (m, 3) -- positions of the points [µm].
    edges : (k, 2) int -- all edges, the lower number first.
    on : (k,) bool -- those that stay: they turn by more than 30°, or a flat piece ends there.
    straight : (k,) bool -- those of flat pieces.
    """

    x: np.ndarray
    edges: np.ndarray
    on: np.ndarray
    straight: np.ndarray

    @classmethod
    def of(cls, x: np.ndarray, triangles: np.ndarray) -> Lines:
        """Lines of a surface with points x (m, 3) [µm] and triangles (t, 3) int."""
        edges, half = _halves(triangles)
        normal, (one, other) = unit(area_vectors(x[triangles])), (half // 3).T
        cosine = dot(normal[one], normal[other])
        level = np.ones(len(x), bool)  # whether all edges around a point are
        for edge, flat in ((edges[:, k], cosine > FLAT) for k in (0, 1)):
            level[edge[~flat]] = False
        flat = level[triangles].any(axis=1)
        while True:  # what is in one plane with a flat triangle is flat, too
            more = (cosine > FLAT) & (flat[one] != flat[other])
            if not more.any():
                break
            flat[one[more]] = flat[other[more]] = True
        on = cosine < SHARP
        for _ in range(SHORT):
            on &= (np.bincount(edges[on].ravel(), minlength=len(x)) > 1)[edges].all(axis=1)
        return cls(x, edges, on | (flat[one] != flat[other]), flat[one] | flat[other])

    @cached_property
    def curved(self) -> np.ndarray:
        """Points at which no edge stays and none is of a flat piece (m,) bool."""
        found = np.ones(len(self.x), bool)
        found[self.edges[self.on | self.straight]] = False
        return found

    @cached_property
    def keys(self) -> np.ndarray:
        """Numbers of the lines (k,) int, see `_key`."""
        return _key(self.edges[self.on], len(self.x))

    @cached_property
    def ends(self) -> np.ndarray:
        """Neighbours along the lines of the points that may slide along one (m, 2) int, -1 for others."""
        line = self.edges[self.on]
        each = np.concatenate([line, line[:, ::-1]])
        each = each[np.argsort(each[:, 0], kind="stable")]
        count = np.bincount(each[:, 0], minlength=len(self.x))
        two = np.flatnonzero(count == 2)
        first = (np.cumsum(count) - count)[two]
        found = np.full((len(self.x), 2), -1)
        a, b = each[first, 1], each[first + 1, 1]
        ahead = dot(unit(self.x[two] - self.x[a]), unit(self.x[b] - self.x[two])) > SHARP
        found[two[ahead]] = np.column_stack([a, b])[ahead]
        return found

    @cached_property
    def inner(self) -> np.ndarray:
        """Points on no line (m,) bool."""
        found = np.ones(len(self.x), bool)
        found[self.edges[self.on]] = False
        return found

    def closest(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lines (n, 2) int closest to the points p (n, 3) [µm], and shares (n, 2) [-] of their ends there."""
        line = self.edges[self.on]
        a, b = self.x[line[:, 0]], self.x[line[:, 1]]
        along = b - a
        share = np.clip(dot(p[:, None] - a, along) / np.maximum(dot(along, along), 1e-300), 0.0, 1.0)
        away = a + share[..., None] * along - p[:, None]
        best = dot(away, away).argmin(axis=1)
        share = share[np.arange(len(p)), best]
        return line[best], np.column_stack([1.0 - share, share])


@dataclass(frozen=True)
class _Sliding:
    """Points x (m, 3) [µm] on the triangles of before, the `triangles` (t, 3) int of now, the `places` of the points
    among those of before, and these on the surface of the `start` (m, 3) [µm].
    """

    x: np.ndarray
    triangles: np.ndarray
    places: Divided
    start: np.ndarray


def _halves(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges (k, 2) int, and the half-edges (k, 2) int of each: three times a triangle plus the corner that begins."""
    edges, edge = edges_of(triangles)
    return edges, np.argsort(edge.ravel(), kind="stable").reshape(-1, 2)


def _turns(x: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges and half-edges as of `_halves`, and the turns (k,) [rad] of the surface at these."""
    edges, half = _halves(triangles)
    one, other = unit(area_vectors(x[triangles]))[half // 3].transpose(1, 0, 2)
    return edges, half, np.arccos(np.clip(dot(one, other), -1.0, 1.0))


def _weights(x: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Areas of the triangles (t,) [µm²], which count more where they turn: there they come to be smaller."""
    _, half, turn = _turns(x, triangles)
    most = np.zeros(len(triangles))
    np.maximum.at(most, half // 3, turn[:, None])
    return lengths(area_vectors(x[triangles])) * (1.0 + (most / BENT) ** 2)


def _key(edges: np.ndarray, m: int) -> np.ndarray:
    """One number (k,) int for each of the `edges` (k, 2) int between m points, in whatever sense."""
    return edges.min(axis=1) * m + edges.max(axis=1)


def normals(x: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals (m, 3) [-] at points x (m, 3) [µm] of triangles (t, 3) int, and the sums of the area vectors around
    them (m, 3) [µm²].
    """
    total, normal, p = np.zeros_like(x), np.zeros_like(x), x[triangles]
    area = area_vectors(p)
    square = dot(p - np.roll(p, -1, axis=1), p - np.roll(p, -1, axis=1))
    for k, corner in enumerate(triangles.T):
        np.add.at(total, corner, area)
        np.add.at(normal, corner, area / (square[:, k] * square[:, (k + 2) % 3])[:, None])
    return unit(normal), total


def _flipped(now: _Sliding, lines: Lines, held: np.ndarray, outward: tuple[np.ndarray, ...]) -> _Sliding:
    """With edges flipped until none is opposite to angles of more than 180° together; `outward` see `_moved`."""
    triangles, m = now.triangles.copy(), len(now.x)
    now_outward, start_outward = (now.places.between(up) for up in outward)
    for _ in range(ROUNDS):
        edges, half = _halves(triangles)
        (one, other), corner = (half // 3).T, half % 3
        a, b, c = (triangles[one, (corner[:, 0] + k) % 3] for k in range(3))
        d = triangles[other, (corner[:, 1] + 2) % 3]
        wide = _sum_of_angles(now.x, a, b, c, d)
        at = np.flatnonzero((wide < -OBTUSE) & ~held[np.stack([a, b, c, d])].any(axis=0)
                            & ~np.isin(_key(edges, m), lines.keys))
        valence, normal = np.bincount(triangles.ravel(), minlength=m), unit(area_vectors(now.x[triangles]))
        quads = np.stack([a, b, c, d], axis=1)[at]
        at = at[(valence[quads[:, :2]] > 3).all(axis=1) & ~np.isin(_key(quads[:, 2:], m), _key(edges, m))
                & (dot(normal[one[at]], normal[other[at]]) > SHARP) & _sound(now.x, quads, now_outward, SHARP)
                & _sound(now.start, quads, start_outward, -1.0)]
        used: set[int] = set()
        for k in at[np.argsort(wide[at], kind="stable")].tolist():
            corners = int(a[k]), int(b[k]), int(c[k]), int(d[k])
            if used.isdisjoint(corners):
                used.update(corners)
                triangles[one[k]], triangles[other[k]] = corners[0::3] + corners[2:3], corners[:0:-2] + corners[2:3]
        if not used:
            break
    return replace(now, triangles=triangles)


def _sum_of_angles(x: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Sines (k,) [-] of the sums of the angles at c and d (k,) int, opposite to edges from a to b (k,) int."""
    sine, cosine = [], []
    for tip in (c, d):
        p, q = unit(x[a] - x[tip]), unit(x[b] - x[tip])
        cosine.append(dot(p, q))
        sine.append(lengths(cross(p, q)))
    return sine[0] * cosine[1] + cosine[0] * sine[1]


def _sound(x: np.ndarray, quads: np.ndarray, outward: np.ndarray, sharp: float) -> np.ndarray:
    """Whether the triangles after the flip of edges, with ends and opposite corners `quads` (k, 4) int, face `outward`
    (m, 3) [-], are not thin, and turn at most as the cosine `sharp` says (k,) bool.
    """
    a, b, c, d = (x[corner] for corner in quads.T)
    one, other = (area_vectors(np.stack(corners, axis=1)) for corners in ((a, d, c), (d, b, c)))
    normal, least = unit(outward[quads].sum(axis=1)), THIN * lengths(one + other)
    return (dot(one, normal) > least) & (dot(other, normal) > least) & (dot(unit(one), unit(other)) > sharp)


def _moved(now: _Sliding, surface: ClosedSurface, lines: Lines, held: np.ndarray, start: np.ndarray,
           outward: tuple[np.ndarray, ...]) -> _Sliding:
    """With points moved once; unit normals `outward` (m, 3) [-] of the points of before, now and at the start."""
    x, triangles, places = now.x, now.triangles, now.places
    corners = x[triangles]
    area, middle = _weights(x, triangles), corners.mean(axis=1)
    total, target = np.zeros(len(x)), np.zeros_like(x)
    shortest = np.full(len(x), np.inf)
    for k, corner in enumerate(triangles.T):
        np.add.at(total, corner, area)
        np.add.at(target, corner, area[:, None] * middle)
        side = lengths(corners[:, k] - corners[:, (k + 1) % 3])
        np.minimum.at(shortest, corner, side)
        np.minimum.at(shortest, triangles[:, (k + 1) % 3], side)
    way = target / total[:, None] - x
    normal = normals(x, triangles)[0]
    way -= dot(way, normal)[:, None] * normal
    slides = lines.ends[:, 0] >= 0
    first, last = (x[lines.ends[:, k]] for k in (0, 1))
    way = np.where(slides[:, None], 0.25 * (first + last - 2.0 * x), way)
    way *= np.minimum(1.0, FARTHEST * shortest / np.maximum(lengths(way), 1e-300))[:, None]
    inner = np.flatnonzero(lines.inner & ~held)
    along = np.flatnonzero(slides & ~held)
    to, share = places.corners.copy(), places.share.copy()
    on, triangle = surface.closest(x[inner] + way[inner])
    to[inner], share[inner] = surface.triangles[triangle], shares(on, surface.corners[triangle])
    if len(along):
        line, part = lines.closest(x[along] + way[along])
        to[along], share[along] = np.column_stack([line, line[:, :1]]), np.column_stack([part, np.zeros(len(part))])
    for attempt in range(ATTEMPTS + 1):
        new = replace(places, corners=to, share=share)
        found = _Sliding(new.between(lines.x), triangles, new, new.between(start))
        bad = np.zeros(len(triangles), bool)
        for before, after, up in ((x, found.x, outward[0]), (now.start, found.start, outward[1])):
            area = area_vectors(before[triangles])
            faced, facing = (dot(areas, unit(at.between(up)[triangles].sum(axis=1)))
                             for at, areas in ((places, area), (new, area_vectors(after[triangles]))))
            bad |= (facing < THIN * lengths(area)) & (facing < faced)  # what is folded may stay, and hinders no other
        if not bad.any():
            return found
        back = np.unique(triangles[bad]) if attempt < ATTEMPTS - 1 else np.arange(len(x))
        to[back], share[back] = places.corners[back], places.share[back]
    return now


@dataclass(frozen=True)
class _Bulges:
    """Vectors (k,) [µm] from the middle of edges, with numbers `key` (k,) int in ascending order, to a curve."""

    key: np.ndarray
    vector: np.ndarray
    count: int

    def at(self, corners: np.ndarray, share: np.ndarray) -> np.ndarray:
        """What is added (m, 3) [µm] at points with shares (m, 3) [-] of the `corners` (m, 3) int of a triangle."""
        total = np.zeros((len(corners), 3))
        for i, j in ((0, 1), (1, 2), (2, 0)):
            both = share[:, i] * share[:, j]
            on = np.flatnonzero((both > 0.0) & (corners[:, i] != corners[:, j]))
            edge = np.searchsorted(self.key, _key(corners[on][:, [i, j]], self.count))
            total[on] += 4.0 * both[on, None] * self.vector[edge]
        return total


def _bulges(x: np.ndarray, triangles: np.ndarray, lines: Lines, straight: np.ndarray) -> _Bulges:
    """Bulges of the edges of triangles (t, 3) int: that of a circle that turns as the surface does at both ends in the
    harmonic mean; none where it turns to and fro, at edges that stay, and at points that are `straight` (m,) bool.

    Patches that are quadratic, with these as the middles of their edges, are exact for quadratic surfaces.

    Source: derived here; the harmonic mean of two slopes as of van Leer (1979).
    """
    normal = normals(x, triangles)[0]
    a, b = lines.edges.T
    one, other = dot(normal[a], x[b] - x[a]), dot(normal[b], x[a] - x[b])
    same = one * other > 0.0
    depth = np.where(same, 2.0 * one * other / np.where(same, one + other, 1.0), 0.0)
    fixed = straight | ~(lines.inner)
    depth = np.where(lines.straight | fixed[a] | fixed[b], 0.0, depth)
    vector = -0.25 * depth[:, None] * unit(normal[a] + normal[b])
    key = _key(lines.edges, len(x))
    order = np.argsort(key)
    return _Bulges(key[order], vector[order], len(x))
