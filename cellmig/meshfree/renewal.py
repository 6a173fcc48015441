"""Neighbours, shape functions and Laplacians of bodies that have flowed, found anew on their current positions.

With F0 the deformation gradient at a particle then, and G the gradients of shape functions on the positions x0 of then,
the deformation gradient later is F = (Σ_J x_J ⊗ G_J) F0.  The rows G̃ = F0ᵀ G take the place of reference gradients:
F = B + Σ_J u_J ⊗ G̃_J, Ḟ = Σ_J v_J ⊗ G̃_J, and the forces are -Σ_I V_I P_I G̃_I as before, with the volumes, masses and
laws of before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..geometry import delaunay, polygons
from ..model.tensors import contracted, determinant
from . import rkpm
from .body import Template
from .recovery import recovery
from .scene import Scene
from .simplices import edges_of, zero_row_sums
from .stabilisation import laplacian, missed

TIGHT = 1.1  # distance up to which neighbours push each other, over that in a hexagonal lattice [-]
PUSHES, SHARE = 4, 0.2  # how often they do, and by which share of what they lack each moves [-]
FARTHEST = 0.2  # how far a particle moves at most [spacings]
NUDGE, GOLDEN = 0.01, 2.399963229728653  # moves that come first [spacings], and the angle from one to the next [rad]


def renewed(t: Template, x0: np.ndarray, F0: np.ndarray, along: np.ndarray | None = None,
            solve: Callable[..., np.ndarray] = rkpm.factorised) -> Template:
    r"""A body in the plane with the neighbours that its particles have at x0.

    Weights of integrals at x0 are V J; they are scaled to the area that the surface encloses, so that uniform stress
    causes no force inside.  The stabilisations begin anew: their Laplacians vanish at x0.

    Parameters
    ----------
    t : Template -- the body, in its reference configuration or renewed before.
    x0 : (n, 2) -- positions from the centre [µm].
    F0 : (n, 2, 2) -- deformation gradients there [-].
    along : (m,) -- places of the surface particles along the reference outline [µm], None for those of before.
    solve : function -- as for `rkpm.consistent`.

    Raises ValueError where particles have too few neighbours.

    Source: derived here, as updated Lagrangian forms of meshfree methods with total Lagrangian stresses.
    """
    facets, J = t.facets, determinant(F0.transpose(1, 2, 0))
    edges = edges_of(_triangles(x0, facets))
    support = rkpm.supports(x0, edges, t.dilation * t.spacing)
    now = t.V * J
    enclosed = polygons.area(x0[facets])
    near = rkpm.gradients(x0, support, None, edges)
    G = rkpm.consistent(near, x0, now * (enclosed / now.sum()), support, facets, solve)
    C, square = laplacian(x0, edges)
    weight = missed(2, t.dilation) * now * square
    inner = t.laws[1] if t.laws[1] is not None else t.laws[0]
    viscosity, modulus = (np.where(t.nucleus, of(inner), of(t.laws[0])) for of in (
        lambda law: law.numerical_viscosity(t.spacing), lambda law: law.numerical_modulus))
    entries = np.einsum("ejk,ej->ek", F0[np.repeat(np.arange(len(x0)), np.diff(G[0].indptr))],
                        np.column_stack([g.data for g in G]))
    return replace(t, G=zero_row_sums(entries, G[0].indices, G[0].indptr), C=C, missed=weight,
                   bending_weight=weight * viscosity * _divisor(F0), bending_modulus=weight * modulus,
                   R=recovery(x0, G[0], support, t.nucleus), x0=x0, F0=F0,
                   along=t.along if along is None else along)


def at_rest(t: Template) -> Template:
    """A body as it was when its neighbours were found, as if it were the reference configuration, with its masses.

    Bounds of the step follow from it.
    """
    if t.F0 is None:
        return t
    J, inverse = determinant(t.F0.transpose(1, 2, 0)), np.linalg.inv(t.F0)
    rows = np.repeat(np.arange(len(J)), np.diff(t.G[0].indptr))
    entries = np.einsum("ejk,ej->ek", inverse[rows], np.column_stack([g.data for g in t.G]))
    return replace(t, G=zero_row_sums(entries, t.G[0].indices, t.G[0].indptr), V=t.V * J, heaviness=t.heaviness / J,
                   bending_weight=t.bending_weight / _divisor(t.F0), x0=None, F0=None)


def evened(t: Template, x: np.ndarray, J: np.ndarray, loose: np.ndarray) -> np.ndarray:
    """Positions (n, 2) [µm] near x (n, 2) [µm], at which particles that are `loose` (n,) bool are more evenly spread.

    Nodal gradients do not see that particles gather: they would do so more and more as a fluid flows.  Neighbours that
    are closer than particles of their volumes V J, with J (n,) [-], are in a hexagonal lattice push each other apart;
    nobody moves by more than FARTHEST.  Points on long segments of the surface push as well.  Moves in all directions
    come first: where all is symmetric, particles would stay on an axis that flow compresses.

    Source: forces in bars that only push, Persson & Strang (2004), SIAM Review 46, 329; small shifts of particles as in
    Lind, Xu, Stansby & Rogers (2012), J. Comput. Phys. 231, 1499.
    """
    on = _marked(len(x), t.facets)
    size = np.sqrt(2.0 / np.sqrt(3.0) * t.V * J * np.where(on, 2.0, 1.0))  # of the surface's only half is inside
    count, x, size, facets = len(x), *_divided(x, size, t.facets)
    start, loose = x, np.append(loose, np.zeros(len(x) - count, bool))
    angle = GOLDEN * np.arange(len(x))
    x = x + np.where(loose[:, None], NUDGE * t.spacing * np.column_stack([np.cos(angle), np.sin(angle)]), 0.0)
    for _ in range(PUSHES):
        ends = edges_of(_triangles(x, facets))
        apart = x[ends[:, 1]] - x[ends[:, 0]]
        length = np.linalg.norm(apart, axis=1)
        push = (np.maximum(TIGHT * size[ends].mean(axis=1) / length - 1.0, 0.0))[:, None] * apart
        moved = x - start
        np.add.at(moved, ends, SHARE * np.stack([-push, push], axis=1))
        far = np.linalg.norm(moved, axis=1)
        shortened = moved * np.minimum(1.0, FARTHEST * t.spacing / np.maximum(far, 1e-300))[:, None]
        x = start + np.where(loose[:, None], shortened, 0.0)
    return x[:count]


def _divided(x: np.ndarray, size: np.ndarray, facets: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (n + k, 2) [µm], their sizes (n + k,) [µm], and facets (m + k, 2) int, with k more points on long ones."""
    length, wide = np.linalg.norm(x[facets[:, 1]] - x[facets[:, 0]], axis=1), size[facets].mean(axis=1)
    more = np.maximum(np.rint(length / wide).astype(int) - 1, 0)
    first, of = np.cumsum(more) - more, np.repeat(np.arange(len(facets)), more)
    share = ((np.arange(len(of)) - first[of] + 1) / (more[of] + 1))[:, None]
    between = (1.0 - share) * x[facets[of, 0]] + share * x[facets[of, 1]]
    number = len(x) + np.arange(len(of))
    divided = np.column_stack([np.insert(number, first, facets[:, 0]), np.insert(number, first + more, facets[:, 1])])
    return np.concatenate([x, between]), np.append(size, wide[of]), divided


def with_renewed(scene: Scene, cells: np.ndarray, x0: np.ndarray, F0: np.ndarray, along: np.ndarray,
                 solve: Callable[..., np.ndarray] = rkpm.factorised) -> Scene:
    """A scene in which some `cells` (k,) int are renewed, by x0 (size, 2) [µm] and F0 (size, 2, 2) [-] of all particles
    and by `along` (m,) [µm] of all surface particles, nan where surfaces are as they were.
    """
    templates, kind, material_of = list(scene.templates), scene.kind.copy(), list(scene.material_of)
    first = np.concatenate([[0], np.cumsum([len(scene.templates[k].surface) for k in kind])])
    for c in cells.tolist():
        on, before = slice(*scene.offset[c : c + 2]), kind[c]
        kind[c] = len(templates)
        places = along[first[c] : first[c + 1]]
        templates.append(renewed(templates[before], x0[on], F0[on], None if np.isnan(places[0]) else places, solve))
        material_of.append(material_of[before])
    used, kind = np.unique(kind, return_inverse=True)
    return replace(scene, templates=[templates[k] for k in used], kind=kind,
                   material_of=[material_of[k] for k in used])


def _divisor(F: np.ndarray) -> np.ndarray:
    """What divides the stabilisation's power (n,) [-], see `Stabilisation`, for F (n, D, D) [-]."""
    parts = F.transpose(1, 2, 0)
    return contracted(parts, parts) - (len(parts) - 1.0) * determinant(parts)


def _triangles(x: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Delaunay triangles (k, 3) int of points x (n, 2) [µm], but for those outside of a surface `facets` (m, 2) int.

    Segments of a surface that has grown long need not be edges of them.
    """
    on = _marked(len(x), facets)

    def inside(tri: np.ndarray) -> np.ndarray:
        within = np.ones(len(tri), bool)
        between = np.flatnonzero(on[tri].all(axis=1))
        within[between] = polygons.inside(x[tri[between]].mean(axis=1), x[facets])
        return within

    return delaunay.triangles(x, inside)[0]



def _marked(n: int, facets: np.ndarray) -> np.ndarray:
    """Which of n particles are at corners of `facets` (m, 2) int, (n,) bool."""
    on = np.zeros(n, bool)
    on[facets] = True
    return on
