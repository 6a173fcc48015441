"""Delaunay tetrahedra of points in and on a body, without those outside, and the surface that they leave."""

from __future__ import annotations

import numpy as np
from scipy.spatial import Delaunay

from .surfaces import ClosedSurface
from .triangles import area_vectors, cross, dot, edges_of, unit, volume

FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])  # opposite to each corner, seen from outside
FAR = np.array([(i, j, k) for i in (-1.0, 1.0) for j in (-1.0, 1.0) for k in (-1.0, 1.0)])
FLAT = 0.25  # quality of a tetrahedron below which it is a sliver
COPLANAR = 1e-6  # the same of one whose corners are in one plane, but for rounding
SMOOTH = np.cos(np.radians(40.0))  # of the angle between two outer faces of a sliver on a surface without an edge
DEFECT = 0.2  # largest difference of the volume from that inside the surface, over the latter
PASSES = 8  # in which slivers are taken off the surface


def delaunay(X: np.ndarray) -> np.ndarray:
    """Delaunay tetrahedra (k, 4) int of the points X (n, 3) [µm], with positive volumes.

    Eight points far outside take part: otherwise Qhull needs up to six times as long where many points are in a plane.
    """
    low, high = X.min(axis=0), X.max(axis=0)
    outside = 0.5 * (low + high) + 2.0 * (high - low).max() * FAR
    tet = Delaunay(np.concatenate([X, outside])).simplices.astype(int)
    tet = tet[(tet < len(X)).all(axis=1)]
    negative = volumes(X, tet) < 0.0
    tet[negative] = tet[negative][:, [1, 0, 2, 3]]
    return tet


def volumes(X: np.ndarray, tet: np.ndarray) -> np.ndarray:
    """Volumes (k,) [µm³] of the tetrahedra `tet` (k, 4) int of the points X (n, 3) [µm]."""
    a, b, c, d = X[tet].transpose(1, 0, 2)
    return dot(b - a, cross(c - a, d - a)) / 6.0


def quality(X: np.ndarray, tet: np.ndarray) -> np.ndarray:
    """Shape (k,) [-] of the tetrahedra `tet` (k, 4) int of the points X (n, 3) [µm]: 1 if regular, 0 if flat.

    Source: mean ratio, 12 (3 V)^(2/3) / Σ l² over the edges (Liu & Joe 1994).
    """
    p = X[tet]
    square = sum(((p[:, i] - p[:, j]) ** 2).sum(axis=1) for i in range(4) for j in range(i))
    return 12.0 * np.cbrt(3.0 * np.maximum(volumes(X, tet), 0.0)) ** 2 / square


def boundary(tet: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Surface of the tetrahedra `tet` (k, 4) int, which have positive volumes.

    Returns
    -------
    triangles : (m, 3) int -- faces of one tetrahedron only, oriented outward.
    owner : (m,) int -- the tetrahedron of each.
    """
    faces = tet[:, FACES].reshape(-1, 3)
    n, corners = int(tet.max()) + 1, np.sort(faces, axis=1)
    key = (corners[:, 0] * n + corners[:, 1]) * n + corners[:, 2]
    order = np.argsort(key, kind="stable")
    same = np.diff(key[order]) == 0
    alone = np.sort(order[~(np.append(same, False) | np.append(False, same))])
    return faces[alone], alone // 4


def circumcentres(X: np.ndarray, tet: np.ndarray) -> np.ndarray:
    """Centres (k, 3) [µm] of the spheres through the corners of the tetrahedra `tet` (k, 4) int of X (n, 3) [µm]."""
    a, b, c, d = X[tet].transpose(1, 0, 2)
    u, v, w = b - a, c - a, d - a
    total = sum(dot(p, p)[:, None] * cross(q, r) for p, q, r in ((u, v, w), (v, w, u), (w, u, v)))
    six = dot(u, cross(v, w))
    return a + total / np.where(six == 0.0, 1e-300, 2.0 * six)[:, None]


def filled(X: np.ndarray, m: int, fixed: int, surface: ClosedSurface) -> tuple[np.ndarray, np.ndarray]:
    """Tetrahedra that fill a body, and its surface.

    Parameters
    ----------
    X : (n, 3) -- points in the body [µm], the first m on its surface.
    m : int -- number of points on the surface.
    fixed : int -- how many of these, the first ones, are in corners and on sharp edges.
    surface : ClosedSurface -- of the body.

    Returns
    -------
    tet : (k, 4) int -- Delaunay tetrahedra inside, with positive volumes.
    triangles : (t, 3) int -- their surface, oriented outward, a closed surface with all m points and no others.

    Source: away from sharp edges, if the points are close enough, the tetrahedra with the circumcentre inside end at
    triangles of the surface's topology (restricted Delaunay triangulation; Edelsbrunner & Shah 1997, Amenta & Bern
    1999).  At sharp edges those with the centroid inside count, and everywhere if the surface is not closed otherwise.

    Raises ValueError if the points are too few for the surface; the message is for the user.
    """
    tet = _flipped(X, delaunay(X), m)
    outer = np.flatnonzero((tet < m).all(axis=1))
    spherical, central = (surface.inside(p) for p in (circumcentres(X, tet[outer]), X[tet[outer]].mean(axis=1)))
    within = np.ones(len(tet), bool)
    for chosen in (np.where((tet[outer] < fixed).any(axis=1), central, spherical), central, spherical):
        within[outer] = chosen & (volumes(X, tet[outer]) > 0.0)
        inside = _peeled(X, tet[within], m)
        triangles = boundary(inside)[0]
        if _faithful(triangles, m, surface) and abs(volume(X, triangles) / surface.volume - 1.0) < DEFECT:
            return inside, triangles
    raise ValueError(f"{len(X)} particles are too few for such a surface{_misfit(X, triangles, m)}")


def _misfit(X: np.ndarray, triangles: np.ndarray, m: int) -> str:
    """End of a message: where triangles (t, 3) of the points X (n, 3) are no closed surface of the first m points."""
    edges, edge = edges_of(triangles)
    lone = edges[np.bincount(edge.ravel()) != 2].ravel()
    wrong = np.concatenate([np.setdiff1d(np.arange(m), triangles), lone, triangles[triangles >= m]])
    if len(wrong) == 0:
        return ""
    at = "({:.3g}, {:.3g}, {:.3g})".format(*X[wrong[0]])
    return f": near {at} um from the cell's centre it is thinner or rougher than their spacing"


def _flipped(X: np.ndarray, tet: np.ndarray, m: int) -> np.ndarray:
    """Tetrahedra without those of four points of the surface in one plane through the body, as across an edge of a box.

    Such a one has its two diagonals on its two sides; if the two tetrahedra on one side have the same fourth corner,
    they are exchanged for the two that have the other diagonal, so that it leaves no gap.
    """
    for flat in tet[(tet < m).all(axis=1) & (quality(X, tet) < COPLANAR)]:
        beside = np.flatnonzero(np.isin(tet, flat).sum(axis=1) == 3)
        apex = tet[beside][~np.isin(tet[beside], flat)]
        for e in np.unique(apex):
            one = beside[apex == e]
            ends = [c for c in flat if np.isin(tet[one], c).sum() == 1]  # of the other diagonal
            if len(one) != 2 or len(ends) != 2:
                continue
            fresh = np.array([[*ends, c, e] for c in flat if c not in ends])
            negative = volumes(X, fresh) < 0.0
            fresh[negative] = fresh[negative][:, [1, 0, 2, 3]]
            if quality(X, fresh).min() > COPLANAR:
                itself = np.flatnonzero((np.sort(tet, axis=1) == np.sort(flat)).all(axis=1))
                tet = np.concatenate([np.delete(tet, [*one, *itself], axis=0), fresh])
                break
    return tet


def _faithful(triangles: np.ndarray, m: int, surface: ClosedSurface) -> bool:
    """Whether triangles (t, 3) form a closed surface of the first m points, with as many handles as `surface`."""
    edges, edge = edges_of(triangles)
    euler = len(surface.vertices) - len(surface.triangles) // 2
    return bool((np.bincount(edge.ravel()) == 2).all() and np.array_equal(np.unique(triangles), np.arange(m))
                and m - len(edges) + len(triangles) == euler)


def _peeled(X: np.ndarray, tet: np.ndarray, m: int) -> np.ndarray:
    """Tetrahedra without the flat ones on the surface, with two faces there, of which the other two take the place."""
    for _ in range(PASSES):
        triangles, owner = boundary(tet)
        count = np.bincount(owner, minlength=len(tet))
        two = np.flatnonzero((count == 2) & (tet < m).all(axis=1) & (quality(X, tet) < FLAT))
        if len(two) == 0:
            break
        outer = np.argsort(owner, kind="stable")
        start = np.searchsorted(owner[outer], two)
        one, other = outer[start], outer[start + 1]
        normal = unit(area_vectors(X[triangles]))
        flat = dot(normal[one], normal[other]) > SMOOTH
        two, one, other = two[flat], one[flat], other[flat]
        # The edge that the outer faces do not share becomes one of the surface: it must not be there already.
        shared = (triangles[one][:, :, None] == triangles[other][:, None, :])
        ends = np.sort(np.column_stack([triangles[one][~shared.any(axis=2)], triangles[other][~shared.any(axis=1)]]),
                       axis=1)
        n = len(X)
        edges = edges_of(triangles)[0]
        present = np.isin(ends[:, 0] * n + ends[:, 1], edges[:, 0] * n + edges[:, 1])
        if present.all():
            break
        tet = np.delete(tet, two[~present], axis=0)
    return tet
