"""Triangulated surfaces of ball, box, cylinder and cap, whose vertices lie exactly on them.

Finding that they are closed takes longer than all else of a case, so that the last ones are kept.
"""

from __future__ import annotations

from functools import cache, lru_cache

import numpy as np

from .closing import closed
from .polygons import circle, snapped
from .surfaces import ClosedSurface
from .triangles import unit

HALVINGS = 4  # of the edges of an icosahedron: 5,120 triangles, the volume of which is 0.3 % below that of the ball
RINGS = 24  # of vertices of a disc; the outermost has 144
INSCRIBED = np.cos(np.pi / (6 * RINGS)) - 1e-9  # less than the distance of its edges from the centre
DIGITS = 40  # bits of the coordinates of a cap
GOLDEN = 0.5 + np.sqrt(1.25)
KEPT = 8  # surfaces of a kind


@cache
def ball() -> ClosedSurface:
    """Unit ball [-]: an icosahedron, its triangles divided into four again and again; a vertex is the lowest point."""
    X = np.array([p for a in (-1.0, 1.0) for b in (-GOLDEN, GOLDEN) for p in ((0, a, b), (a, b, 0), (b, 0, a))])
    apart = ((X[:, None] - X[None]) ** 2).sum(axis=-1)
    near = (apart > 1.0) & (apart < 5.0)  # the length of the edges is 2
    tri = np.array([(i, j, k) for i in range(12) for j in range(i) for k in range(j)
                    if near[i, j] and near[j, k] and near[k, i]])
    X = unit(X)
    for _ in range(HALVINGS):
        a, b, c = X[tri].transpose(1, 0, 2)
        corners = [(a, a + b, a + c), (b, b + c, a + b), (c, a + c, b + c), (a + b, b + c, a + c)]
        X = unit(np.concatenate([np.stack(t, axis=1) for t in corners]).reshape(-1, 3))
        tri = np.arange(len(X)).reshape(-1, 3)
    return closed(snapped(X), tri)


def box(a: float, b: float, c: float) -> ClosedSurface:
    """Box of lengths a, b, c [µm] about the origin; its parts are left, right, front, back, bottom, top."""
    X = 0.5 * np.array([a, b, c]) * np.array([(i, j, k) for k in (-1, 1) for j in (-1, 1) for i in (-1, 1)])
    sides = [(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)]
    tri = [(p, *two) for p, q, r, s in sides for two in ((q, r), (r, s))]
    return closed(X, np.array(tri), np.repeat(np.arange(6), 2))


@lru_cache(KEPT)
def cylinder(radius: float, length: float) -> ClosedSurface:
    """Cylinder of this radius and length [µm] about the z axis and the origin; its parts are side, bottom, top."""
    disc, tri = _disc()
    X = np.column_stack([radius * disc, np.full(len(disc), 0.5 * length)])
    m, n = 6 * RINGS, len(disc)
    i, j = np.arange(n - m, n), np.roll(np.arange(n - m, n), -1)
    side = np.concatenate([np.column_stack([i, j, i + n]), np.column_stack([j, j + n, i + n])])
    part = np.repeat([0, 1, 2], [len(side), len(tri), len(tri)])
    return closed(np.concatenate([X, X * [1, 1, -1]]), np.concatenate([side, tri + n, tri]), part)


@lru_cache(KEPT)
def cap(contact_radius: float, height: float, centre: float) -> ClosedSurface:
    """Cap of a spheroid that rests on the plane z = 0 [µm]; its parts are base, cap.

    Parameters
    ----------
    contact_radius : float -- radius of its base [µm].
    height : float -- of its top [µm].
    centre : float -- height of the spheroid's centre over its vertical semi-axis, between -1 and 1 [-].
    """
    disc, tri = _disc()
    upright = height / (1.0 + centre)
    across = contact_radius / np.sqrt(1.0 - centre**2)
    ring = np.repeat(np.arange(RINGS + 1), np.maximum(6 * np.arange(RINGS + 1), 1))
    angle = np.arccos(np.longdouble(-centre)) * ring / RINGS  # from the top; as for `circle`, the last bits are rounded
    out = disc / np.maximum(ring / RINGS, 0.5 / RINGS)[:, None]
    dome = np.column_stack([across * np.sin(angle)[:, None] * out, upright * (centre + np.cos(angle))])
    flat = np.column_stack([contact_radius * disc, np.zeros(len(disc))])
    rim = ring == RINGS
    dome[rim] = flat[rim]
    return closed(snapped(np.concatenate([flat, dome]), DIGITS), np.concatenate([tri, tri + len(disc)]),
                  np.repeat([0, 1], len(tri)))


def _disc() -> tuple[np.ndarray, np.ndarray]:
    """Unit disc of rings of vertices (n, 2) [-], ring i of 6 i, the first being the centre, and its triangles."""
    X = np.concatenate([np.zeros((1, 2)), *(i / RINGS * circle(6 * i) for i in range(1, RINGS + 1))])
    tri = []
    for i in range(1, RINGS + 1):
        inner, outer = 1 + 3 * (i - 1) * (i - 2), 1 + 3 * i * (i - 1)
        if i == 1:
            inner = 0
        for k in range(6 * i):
            sixth, j = divmod(k, i)
            here, after = (inner + (sixth * (i - 1) + n) % max(6 * (i - 1), 1) for n in (j, j + 1))
            tri.append((here, outer + k, outer + (k + 1) % (6 * i)))
            if j < i - 1:
                tri.append((here, outer + (k + 1) % (6 * i), after))
    return X, np.array(tri)
