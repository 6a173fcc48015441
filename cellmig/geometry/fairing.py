"""Closed surfaces without their short relief, such as noise or the steps of an image's voxels."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from .polygons import snapped
from .surfaces import ClosedSurface
from .triangles import cross, dot, lengths

DIGITS = 40  # bits of the coordinates that are kept: the last ones depend on the library
HALVED = 4.05  # wavelength of which a half is left, over the length of the filter


def faired(surface: ClosedSurface, wavelength: float) -> ClosedSurface:
    """The surface with relief of this `wavelength` [µm] halved, shorter relief less, and longer relief left as it is.

    Of relief with the wave number k, 1 - (1 - 1/(1 + l² k²))² is left: a ball of radius R shrinks by 4 l⁴/R⁴.

    Source: implicit fairing by finite elements (Desbrun et al. 1999), twice, with the loss of the first added.
    """
    n, tri = len(surface.vertices), surface.triangles
    mass = sparse.diags(np.bincount(tri.ravel(), np.repeat(surface.areas / 3.0, 3), n))
    rows, columns, weights = [], [], []
    for k in range(3):
        a, b, c = (surface.corners[:, (k + j) % 3] for j in range(3))
        cotangent = 0.5 * dot(b - a, c - a) / np.maximum(lengths(cross(b - a, c - a)), 1e-300)
        i, j = tri[:, (k + 1) % 3], tri[:, (k + 2) % 3]
        rows += [i, j, i, j]
        columns += [i, j, j, i]
        weights += [cotangent, cotangent, -cotangent, -cotangent]
    stiffness = sparse.csc_matrix((np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))), (n, n))
    solve = splu((mass + (wavelength / HALVED) ** 2 * stiffness).tocsc()).solve
    once = solve(mass @ surface.vertices)
    return surface.moved(snapped(2.0 * once - solve(mass @ once), DIGITS))
