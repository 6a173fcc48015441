"""Neighbours, shape functions and Laplacians of bodies that have flowed, found anew on their current positions.

With F0 the deformation gradient at a particle then, and G the gradients of shape functions on the positions x0 of then,
the deformation gradient later is F = (Σ_J x_J ⊗ G_J) F0.  The rows G̃ = F0ᵀ G take the place of reference gradients:
F = B + Σ_J u_J ⊗ G̃_J, Ḟ = Σ_J v_J ⊗ G̃_J, and the forces are -Σ_I V_I P_I G̃_I as before, with the volumes, masses and
laws of before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import QhullError

from ..geometry import delaunay, polygons, tetrahedra
from ..geometry.surfaces import ClosedSurface
from ..geometry.triangles import volume
from ..model.tensors import contracted, determinant
from . import rkpm
from .body import Template
from .recovery import recovery
from .scene import Scene
from .simplices import averaged, edges_of, zero_row_sums
from .stabilisation import laplacian, missed

TIGHT = 1.1  # distance up to which neighbours push each other, over that in the densest lattice [-]
PUSHES, SHARE = 4, 0.2  # how often they do, and by which share of what they lack each moves [-]
FARTHEST = 0.2  # how far a particle moves at most [spacings]
DEEP = 0.4  # how far below a surface in space they are at least, over that distance [-]
HALVINGS = 4  # of this distance where the body is thin
NUDGE = 0.01  # moves that come first [spacings]
BOUNDS = "bounds"  # name by which a template keeps them
GOLDEN, RATIO = 2.399963229728653, 0.6180339887498949  # turn from one of these to the next [rad], and height in space


def renewed(t: Template, x0: np.ndarray, F0: np.ndarray, along: np.ndarray | None = None,
            solve: Callable[..., np.ndarray] = rkpm.factorised, present: np.ndarray | None = None) -> Template:
    r"""A body with the neighbours that its particles have at x0.

    Weights of integrals at x0 are V J; they are scaled to the content that the surface encloses, so that uniform stress
    causes no force inside.  The stabilisations begin anew: their Laplacians vanish at x0.

    Parameters
    ----------
    t : Template -- the body, in its reference configuration or renewed before.
    x0 : (n, D) -- positions from the centre [µm].
    F0 : (n, D, D) -- deformation gradients there [-].
    along : (m,) or (m, 3) -- places of the surface particles along the reference outline or on the reference surface
        [µm], None for those of before.
    solve : function -- as for `rkpm.consistent`.
    present : (t, 3) int -- triangles of the surface in space, None for those of before.

    Raises ValueError where particles have too few neighbours.

    Source: derived here, as updated Lagrangian forms of meshfree methods with total Lagrangian stresses.
    """
    t = t if along is None else replace(t, along=along, present=present)
    facets, J = t.facets, determinant(F0.transpose(1, 2, 0))
    simplices, share = _simplices(x0, facets)
    lonely = np.setdiff1d(np.arange(len(x0)), simplices)
    if len(lonely):
        at = ", ".join(f"{x:.4g}" for x in x0[lonely[0]])
        raise ValueError(f"the particle at ({at}) um from where the cell's centre began has no neighbours inside the "
                         "surface, which is too coarse or too thin there")
    edges = edges_of(simplices)
    support = rkpm.supports(x0, edges, t.dilation * t.spacing)
    now, D = t.V * J, x0.shape[1]
    enclosed = polygons.area(x0[facets]) if D == 2 else volume(x0, facets)
    near = rkpm.gradients(x0, support, None, edges) if t.dilation else averaged(x0, simplices, share)
    G = rkpm.consistent(near, x0, now * (enclosed / now.sum()), support, facets, solve)
    C, square = laplacian(x0, edges)
    weight = missed(D, t.dilation) * now * square
    inner = t.laws[1] if t.laws[1] is not None else t.laws[0]
    viscosity, modulus = (np.where(t.nucleus, of(inner), of(t.laws[0])) for of in (
        lambda law: law.numerical_viscosity(t.spacing), lambda law: law.numerical_modulus))
    entries = np.einsum("ejk,ej->ek", F0[np.repeat(np.arange(len(x0)), np.diff(G[0].indptr))],
                        np.column_stack([g.data for g in G]))
    return replace(t, G=zero_row_sums(entries, G[0].indices, G[0].indptr), C=C, missed=weight,
                   bending_weight=weight * viscosity * _divisor(F0), bending_modulus=weight * modulus * t.grades,
                   R=recovery(x0, G[0], support, t.nucleus), x0=x0, F0=F0)


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
                   bending_weight=t.bending_weight / _divisor(t.F0), F0=None)


class Bounds(NamedTuple):
    """What the step of a body follows from.

    rates : damping rates of stabilisation and viscosities [1/µs], frequencies² of sound and of the elastic
    stabilisation [1/µs²];  viscous, elastic : bounds of single particles [1/µs], [1/µs²];  size_per_mass,
    drawn_per_mass : largest of its particles [µm²/fg], [1/fg];  radius : [µm].
    """

    rates: tuple[float, float, float, float]
    viscous: float
    elastic: float
    size_per_mass: float
    drawn_per_mass: float
    radius: float


def bounds(t: Template) -> Bounds:
    """Bounds of a body as it is `at_rest`, found once: where one of many bodies is renewed, the others have theirs."""
    if (found := vars(t).get(BOUNDS)) is None:
        rest = at_rest(t)
        found = vars(t)[BOUNDS] = Bounds(
            rest.rates, rest.local_bound(rest.viscous_weight), rest.local_bound(rest.elastic_weight),
            float(rest.size_per_mass.max()), float(rest.drawn_per_mass.max()), rest.radius)
    return found


def evened(t: Template, x: np.ndarray, J: np.ndarray, loose: np.ndarray) -> np.ndarray:
    """Positions (n, D) [µm] near x (n, D) [µm], at which particles that are `loose` (n,) bool are more evenly spread.

    Nodal gradients do not see that particles gather: they would do so more and more as a fluid flows.  Neighbours that
    are closer than particles of their masses, with J (n,) [-], are in the densest lattice, hexagonal or face-centred,
    push each other apart, by FARTHEST at most.  Points on long segments of the surface push as well; in space nobody
    stays close to the surface.  Moves in all directions come first: where all is symmetric, particles would stay on an
    axis that flow compresses.

    Source: forces in bars that only push, Persson & Strang (2004), SIAM Review 46, 329; small shifts of particles as in
    Lind, Xu, Stansby & Rogers (2012), J. Comput. Phys. 231, 1499.
    """
    on, facets, count, D = _marked(len(x), t.facets), t.facets, len(x), x.shape[1]
    densest = 2.0 / np.sqrt(3.0) if D == 2 else np.sqrt(2.0)
    shared = t.heaviness if D == 3 else 1.0  # by area of the surface
    content = densest * t.V * shared * J * np.where(on, 2.0, 1.0)  # of the surface's only half is inside
    size = np.sqrt(content) if D == 2 else np.cbrt(content)
    surface = _closed(x, facets) if D == 3 else None
    if surface is None:
        x, size, facets = _divided(x, size, facets)
    start, loose = x, np.append(loose, np.zeros(len(x) - count, bool))
    x = x + np.where(loose[:, None], NUDGE * t.spacing * _directions(len(x), D), 0.0)
    for _ in range(PUSHES):
        ends = edges_of(_simplices(x, facets)[0])
        apart = x[ends[:, 1]] - x[ends[:, 0]]
        length = np.linalg.norm(apart, axis=1)
        push = (np.maximum(TIGHT * size[ends].mean(axis=1) / length - 1.0, 0.0))[:, None] * apart
        moved = x - start
        np.add.at(moved, ends, SHARE * np.stack([-push, push], axis=1))
        far = np.linalg.norm(moved, axis=1)
        shortened = moved * np.minimum(1.0, FARTHEST * t.spacing / np.maximum(far, 1e-300))[:, None]
        x = start + np.where(loose[:, None], shortened, 0.0)
        if surface is not None:
            x[loose] = _below(x[loose], DEEP * size[loose], surface)
    return x[:count]


def _directions(n: int, D: int) -> np.ndarray:
    """Unit vectors (n, D) [-], each in another direction."""
    k = np.arange(n)
    turn = np.column_stack([np.cos(GOLDEN * k), np.sin(GOLDEN * k)])
    if D == 2:
        return turn
    z = 2.0 * (RATIO * k % 1.0)[:, None] - 1.0
    return np.hstack([np.sqrt(1.0 - z**2) * turn, z])


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


def _below(x: np.ndarray, depth: np.ndarray, surface: ClosedSurface) -> np.ndarray:
    """Points x (n, 3) [µm], moved to a `depth` (n,) [µm] below a surface where they are higher; where the body is thin,
    to a half of it, and so on.
    """
    on, triangle = surface.closest(x)
    high = np.flatnonzero((np.linalg.norm(on - x, axis=1) < depth) | ~surface.inside(x))
    down, moved = -depth[:, None] * surface.normals[triangle], x.copy()
    for _ in range(HALVINGS):
        moved[high] = on[high] + down[high]
        high = high[~surface.inside(moved[high])]
        down[high] *= 0.5
    return moved


def with_renewed(scene: Scene, cells: np.ndarray, x0: np.ndarray, F0: np.ndarray, along: np.ndarray,
                 triangles: np.ndarray | None = None, solve: Callable[..., np.ndarray] = rkpm.factorised) -> Scene:
    """A scene in which some `cells` (k,) int are renewed, by x0 (size, D) [µm] and F0 (size, D, D) [-] of all particles
    and by `along` (m,) or (m, 3) [µm] of all surface particles, nan where surfaces are as they were; in space also by
    all `triangles` (t, 3) int, by numbers of particles in their cells.
    """
    templates, kind, material_of = list(scene.templates), scene.kind.copy(), list(scene.material_of)
    first = np.concatenate([[0], np.cumsum([len(scene.templates[k].surface) for k in kind])])
    for c in cells.tolist():
        on, before = slice(*scene.offset[c : c + 2]), kind[c]
        kind[c] = len(templates)
        places = along[first[c] : first[c + 1]]
        with of_cell(c):
            place = None if np.isnan(places[0]).any() else places
            present = None if triangles is None else triangles[slice(*scene.first_facet[c : c + 2])]
            templates.append(renewed(templates[before], x0[on], F0[on], place, solve, present))
        material_of.append(material_of[before])
    used, kind = np.unique(kind, return_inverse=True)
    return replace(scene, templates=[templates[k] for k in used], kind=kind,
                   material_of=[material_of[k] for k in used])


@contextmanager
def of_cell(c: int) -> Iterator[None]:
    """Raises ValueError, with the number of cell c, where it or Qhull refuses the particles."""
    try:
        yield
    except (ValueError, QhullError) as error:
        cause = "its particles are in a line or a plane" if isinstance(error, QhullError) else error
        raise ValueError(f"cell {c + 1}: {cause}") from error


def _divisor(F: np.ndarray) -> np.ndarray:
    """What divides the stabilisation's power (n,) [-], see `Stabilisation`, for F (n, D, D) [-]."""
    parts = F.transpose(1, 2, 0)
    return contracted(parts, parts) - (len(parts) - 1.0) * determinant(parts)


def _simplices(x: np.ndarray, facets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Delaunay triangles or tetrahedra (k, D + 1) int of points x (n, D) [µm], but for those outside of a surface
    `facets` (m, D) int, and their weights in sums (k,) [-].

    Facets of a surface that has flowed need not be sides of them.
    """
    if x.shape[1] == 3:
        found = tetrahedra.delaunay(x)
        found = found[tetrahedra.quality(x, found) > tetrahedra.COPLANAR]
        found = found[_closed(x, facets).inside(x[found].mean(axis=1))]
        return found, np.ones(len(found))
    on = _marked(len(x), facets)

    def inside(tri: np.ndarray) -> np.ndarray:
        within = np.ones(len(tri), bool)
        between = np.flatnonzero(on[tri].all(axis=1))
        within[between] = polygons.inside(x[tri[between]].mean(axis=1), x[facets])
        return within

    return delaunay.triangles(x, inside)


def _closed(x: np.ndarray, facets: np.ndarray) -> ClosedSurface:
    """The surface in space with the triangles `facets` (m, 3) int of points x (n, 3) [µm]."""
    return ClosedSurface(x, facets, np.zeros(len(facets), int))


def _marked(n: int, facets: np.ndarray) -> np.ndarray:
    """Which of n particles are at corners of `facets` (m, 2) int, (n,) bool."""
    on = np.zeros(n, bool)
    on[facets] = True
    return on
