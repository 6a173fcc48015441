"""Particles in a closed surface: on it, in two layers along that of a nucleus, and evenly elsewhere."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree

from .polygons import snapped
from .surface_points import SAMPLES, Samples, surface_points, thinned
from .surfaces import ClosedSurface
from .tetrahedra import FACES, delaunay, filled, quality, volumes
from .triangles import area_vectors, lengths, unit

NEIGHBOUR = 1.0911  # distance of neighbours in a body-centred lattice with one point per unit volume
SURFACE_SHARE = 0.45  # volume of a particle on the surface over that of one inside
FIRST = 0.9  # least depth of inner particles [distances of neighbours]: higher ones leave the surface too little volume
CLEARANCE = 0.6  # initial depth of inner particles [distances of neighbours]
LAYER = 0.41  # distance of the layers from the surface of the nucleus [distances of neighbours]
CLOSE = 0.6  # least initial distance of points of the layers [distances of neighbours]
ROOM = 0.65  # initial distance of inner particles from those layers [distances of neighbours]
RESOLVED = 1.5  # a nucleus has layers if three times its volume over its area is above this [distances of neighbours]
SHARE = 0.05  # by which the volume of the particles inside a nucleus may differ from its own, over the latter
TRIANGULATIONS, MOVES = 3, 10  # moves of the inner particles between one triangulation and the next
PASSES = 4  # in which flat tetrahedra are removed
SLIVER = 0.3  # quality of a tetrahedron below which it is flat
AWAY = 0.08  # by which one of its corners moves [distances of neighbours]
ROUNDS, EXCESS = 6, 5e-3  # in which the lattice is fitted, until it has so many points too many, over the number
DIGITS = 40  # bits of coordinates that are kept: the last ones depend on the library


def fill(surface: ClosedSurface, count: int, refinement: float = 1.0, nucleus: ClosedSurface | None = None,
         exact: Callable[[np.ndarray], np.ndarray] = np.asarray) -> tuple[np.ndarray, ...]:
    """Fill a closed surface with exactly `count` particles, and with tetrahedra between them.

    Parameters
    ----------
    surface : ClosedSurface
    count : int
    refinement : float -- density of particles along the surface over that inside [-].
    nucleus : ClosedSurface -- around the nucleus; None if there is none.
    exact : function -- moves points (n, 3) [µm] of the triangles to the curved surface that these represent.

    Returns
    -------
    X : (count, 3) -- positions, surface particles first [µm].
    within : (count,) bool -- whether a particle belongs to the nucleus.
    tet : (k, 4) int -- tetrahedra that fill the surface, with positive volumes.
    triangles : (m, 3) int -- their surface, oriented outward.
    origin : (m,) int -- for each of these, a triangle of `surface` where it lies.

    Raises ValueError if the particles are too few for the surface; the message is for the user.
    """
    h = _spacing(surface, count, refinement)
    samples = Samples(surface, round(SAMPLES * refinement**2 * surface.area / h**2))
    outer, fixed = surface_points(samples, refinement**2 * surface.area / h**2)
    outer = snapped(exact(outer), DIGITS)
    layers, sides, shape = np.zeros((0, 3)), np.zeros(0), None
    if nucleus is not None and 3.0 * nucleus.volume > RESOLVED * NEIGHBOUR * h * nucleus.area:
        shape = Samples(nucleus, round(SAMPLES * nucleus.area / h**2))
        layers, sides = _layers(shape, samples, h)
    if len(outer) + len(layers) >= count:
        enough = _enough(surface, count, refinement, (len(outer) + len(layers)) * h**2)
        raise ValueError(f"{count} particles are too few for such a surface: {len(outer)} would be on it"
                         + f" and {len(layers)} around its nucleus" * bool(len(layers))
                         + f"; it takes about {enough} or more")
    inner = _lattice(samples, h, count - len(outer) - len(layers), layers)
    X = _spread(np.concatenate([outer, layers, inner]), len(outer), samples, NEIGHBOUR * h, shape, sides)
    X = _without_slivers(X, len(outer), NEIGHBOUR * h)
    tet, triangles = filled(X, len(outer), fixed, surface)
    origin = samples.alike(X[triangles].mean(axis=1), unit(area_vectors(X[triangles])), 2.0 * h)
    within = np.zeros(count, bool)
    if nucleus is not None:
        within = _within(X, tet, len(outer), nucleus, nucleus.volume / surface.volume)
    return X, within, tet, triangles, origin


def _spacing(surface: ClosedSurface, count: int, refinement: float) -> float:
    """Root h [µm] of V = h³ (N - N_s) + SURFACE_SHARE A h, with N_s = refinement² A/h² particles on the surface."""
    V, A = surface.volume, surface.area
    linear = (refinement**2 - SURFACE_SHARE) * A
    h = _root(V / count) + np.sqrt(max(linear, 0.0) / count)  # above the root: Newton's steps go down to it
    for _ in range(50):
        h -= (count * h**3 - linear * h - V) / (3.0 * count * h**2 - linear)
    return _rounded(h)


def _enough(surface: ClosedSurface, count: int, refinement: float, area: float) -> int:
    """About how many particles it takes if those on surfaces are `area` [µm²] over h²."""
    while area > 0.98 * count * _spacing(surface, count, refinement) ** 2:
        count += 1 + count // 20
    return count


def _rounded(number: float) -> float:
    """The number with twelve digits, so that no library's last bits matter."""
    return float(f"{number:.12g}")


def _root(number: float) -> float:
    """Cube root of a number, rounded."""
    return _rounded(float(number) ** (1.0 / 3.0))


def _layers(nucleus: Samples, surface: Samples, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (k, 3) of two layers along the surface of a nucleus where there is room, and their heights above it."""
    above, radius = LAYER * NEIGHBOUR * h, 3.0 * nucleus.surface.volume / nucleus.surface.area
    found, heights = [], []
    for side in (-above, above):
        n = 2.0 * above * nucleus.surface.area / h**3 * (1.0 + side / radius) ** 2
        p = surface_points(nucleus, n)[0]
        p = snapped(p + side * nucleus.onto(p, nucleus.normals[nucleus.tree.query(p)[1]])[1], DIGITS)
        p = p[surface.surface.inside(p)]
        found.append(p[surface.height(p, 2.0 * h)[0] < -FIRST * NEIGHBOUR * h])
        heights.append(np.full(len(found[-1]), side))
    layers = np.concatenate(found)
    kept = thinned(layers, CLOSE * NEIGHBOUR * h)
    return layers[kept], np.concatenate(heights)[kept]


def _lattice(samples: Samples, h: float, count: int, layers: np.ndarray) -> np.ndarray:
    """Points (count, 3) of the widest body-centred lattice that has so many inside, away from surface and layers."""
    s, points = h, _points(samples, h, layers)
    for _ in range(ROUNDS):
        if 0 <= len(points) - count <= EXCESS * count:
            break
        s *= _root((len(points) + 0.1) / (count + 0.1))
        points = _points(samples, s, layers)
    while len(points) < count:
        s *= 1.0 - 0.3 * EXCESS
        points = _points(samples, s, layers)
    depth = np.rint(-samples.height(points, 2.0 * h)[0] / (1e-6 * h))
    return points[np.sort(np.argsort(-depth, kind="stable")[:count])]


def _points(samples: Samples, s: float, layers: np.ndarray) -> np.ndarray:
    """Points (k, 3) of a body-centred lattice with one in the volume s³, inside and away from surface and layers."""
    surface, side = samples.surface, _root(2.0) * s
    low = surface.centroid + side * np.array([0.137, 0.241, 0.389])  # none of them in a plane of symmetry
    ranges = [np.arange(np.floor((a - c) / side), np.ceil((b - c) / side) + 1) for a, b, c in
              zip(surface.vertices.min(axis=0), surface.vertices.max(axis=0), low, strict=True)]
    cubes = np.stack(np.meshgrid(*ranges, indexing="ij"), axis=-1).reshape(-1, 3)
    points = low + side * np.concatenate([cubes, cubes + 0.5])
    points = points[surface.inside(points)]
    points = points[samples.height(points, 2.0 * s)[0] < -CLEARANCE * NEIGHBOUR * s]
    if len(layers):
        points = points[np.isinf(cKDTree(layers).query(points, distance_upper_bound=ROOM * NEIGHBOUR * s)[0])]
    return points


def _spread(X: np.ndarray, m: int, samples: Samples, d: float, nucleus: Samples | None,
            heights: np.ndarray) -> np.ndarray:
    """Points X (n, 3), of which the first m are fixed, evened out: the others move to the centroids around them.

    They stay below the surface by FIRST d, and those of layers, which come first, at their `heights` above a nucleus.

    Source: the centroid of the tetrahedra around a point (Chen & Xu 2004).
    """
    n, of_layer = len(X), slice(m, m + len(heights))
    for _ in range(TRIANGULATIONS):
        tet = delaunay(X)
        tet = tet[(tet >= m).any(axis=1)]  # those of surface points alone may be outside
        near = m + np.flatnonzero(samples.height(X[m:], 2.0 * d)[0] > -np.inf)
        for _ in range(MOVES):
            size = np.abs(volumes(X, tet))
            middle = (0.25 * size)[:, None] * X[tet].sum(axis=1)
            total = np.column_stack([np.bincount(tet.ravel(), np.repeat(x, 4), n) for x in (size, *middle.T)])
            moved = total[m:, 1:] / np.maximum(total[m:, :1], 1e-300)
            X = np.concatenate([X[:m], moved])
            if nucleus is not None:
                height, normal = nucleus.height(X[of_layer], d)
                X[of_layer] += np.where(height > -np.inf, heights - height, 0.0)[:, None] * normal
            height, normal = samples.height(X[near], 2.0 * d)
            X[near] -= np.maximum(height + FIRST * d, 0.0)[:, None] * normal
        X = snapped(X, DIGITS)
    return X


def _without_slivers(X: np.ndarray, m: int, d: float) -> np.ndarray:
    """Points X (n, 3), of which the first m are fixed; inner corners of flat tetrahedra move away from the other three.

    The next triangulation has others in their place.
    """
    for _ in range(PASSES):
        tet = delaunay(X)
        tet = tet[(quality(X, tet) < SLIVER) & (tet >= m).any(axis=1)]
        if len(tet) == 0:
            break
        for corner, face in enumerate(FACES):
            inner = tet[tet[:, corner] >= m]
            np.add.at(X, inner[:, corner], -AWAY * d * unit(area_vectors(X[inner[:, face]])))
        X = snapped(X, DIGITS)
    return X


def _within(X: np.ndarray, tet: np.ndarray, m: int, nucleus: ClosedSurface, share: float) -> np.ndarray:
    """Whether each particle is nucleus (n,) bool; the first m, on the surface, are not.

    They are those inside it if these have its `share` of the volume; else as many of the deepest as have.
    """
    within, inside = np.zeros(len(X), bool), nucleus.inside(X[m:])
    volume = (np.bincount(tet.ravel(), np.repeat(volumes(X, tet), 4), len(X)) / 4.0)[m:]
    wanted = share * volumes(X, tet).sum()
    if abs(volume[inside].sum() - wanted) < SHARE * wanted:
        within[m:] = inside
        return within
    depth = np.where(inside, 1.0, -1.0) * lengths(nucleus.closest(X[m:])[0] - X[m:])
    order = np.argsort(-np.rint(depth / (1e-6 * np.cbrt(nucleus.volume))), kind="stable")
    number = 1 + int(np.abs(np.cumsum(volume[order]) - wanted).argmin())
    within[m + order[:number]] = True
    return within
