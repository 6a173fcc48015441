"""Bodies of tetrahedra and triangles for tests of the operators: a ball, a disc, and a bent bar of cubes."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np
from scipy.spatial import ConvexHull, Delaunay


@dataclass(frozen=True)
class Body:
    """Particles, those of the nucleus, triangles of the surface from outside, tetrahedra; as layouts in space have."""

    X: np.ndarray
    nucleus: np.ndarray
    triangles: np.ndarray
    tetrahedra: np.ndarray


def ball(count: int, radius: float = 5.0, rounds: int = 15) -> Body:
    """A ball with a spiral of points on its surface and a relaxed body-centred lattice inside."""
    h = radius * (4.19 / count) ** (1 / 3)
    for _ in range(20):
        on = round(4 * np.pi * (radius / h) ** 2)
        h = radius * (4.19 / (count - 0.5 * on)) ** (1 / 3)
    outer = _sphere(on)
    a = ((4.19 * 2 * (radius - 0.55 * h) ** 3) / (count - on)) ** (1 / 3)
    grid = np.moveaxis(np.mgrid[-20:20, -20:20, -20:20], 0, -1).reshape(-1, 3)
    lattice = a * np.concatenate([grid, grid + 0.5]) + 0.1 * h * np.array([1.0, 0.3, 0.5])
    inner = lattice[np.argsort(np.linalg.norm(lattice, axis=1), kind="stable")[:count - on]]
    X = np.concatenate([radius * outer, inner])
    for _ in range(rounds):
        tets = oriented(X, Delaunay(X).simplices)
        size = volumes(X, tets)
        moment, total = np.zeros_like(X), np.zeros(count)
        for corner in tets.T:
            np.add.at(moment, corner, size[:, None] * X[tets].mean(axis=1))
            np.add.at(total, corner, size)
        X[on:] = (moment / total[:, None])[on:]
        far = np.linalg.norm(X[on:], axis=1, keepdims=True)
        X[on:] *= np.minimum(1.0, (radius - 0.8 * h) / far)
    return _body(X, oriented(X, Delaunay(X).simplices))


def _sphere(count: int) -> np.ndarray:
    z, turn = 1 - (2 * np.arange(count) + 1) / count, np.arange(count) * np.pi * (3 - 5**0.5)
    x = np.column_stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z])
    for _ in range(20):
        hull = ConvexHull(x).simplices
        mean = np.zeros_like(x)
        for corner in hull.T:
            np.add.at(mean, corner, x[hull].mean(axis=1))
        x = mean / np.linalg.norm(mean, axis=1, keepdims=True)
    return x


def blocks(cubes: np.ndarray, edge: float = 1.0, shake: float = 0.15) -> Body:
    """Cubes at whole places (k, 3), six tetrahedra each, with shaken inner particles; the body may be concave."""
    paths = np.array([np.vstack([np.zeros(3, int), np.eye(3, dtype=int)[list(p)].cumsum(axis=0)])
                      for p in permutations(range(3))])
    places, corner = np.unique((cubes[:, None, None] + paths[None]).reshape(-1, 3), axis=0, return_inverse=True)
    tets = oriented(places.astype(float), corner.reshape(-1, 4))
    inner = np.setdiff1d(np.arange(len(places)), surface_of(tets))
    X = edge * places
    X[inner] += shake * edge * np.random.default_rng(5).uniform(-1, 1, (len(inner), 3))
    return _body(X, tets)


def _body(X: np.ndarray, tets: np.ndarray) -> Body:
    tets = tets[volumes(X, tets) > 1e-9 * np.ptp(X[:, 0]) ** 3 / len(X)]
    return Body(X, np.zeros(len(X), bool), surface_of(tets), tets)


def volumes(X: np.ndarray, tets: np.ndarray) -> np.ndarray:
    return np.linalg.det(X[tets[:, 1:]] - X[tets[:, :1]]) / 6.0


def oriented(X: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """The same tetrahedra, their volumes positive."""
    return np.where((volumes(X, tets) < 0)[:, None], tets[:, [1, 0, 2, 3]], tets)


def surface_of(tets: np.ndarray) -> np.ndarray:
    """Faces of one tetrahedron alone, counterclockwise from outside."""
    faces = tets[:, [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[np.sort(first[count == 1])]
