"""Surfaces of fluid bodies in space divided anew: their particles slide in the surface, and edges are flipped.

Bonds, the push of the protrusion and the drag of a medium are per reference area.  It is carried by the surface, not by
the particles: these get other places on it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from ..geometry import even_surface
from ..geometry.surfaces import ClosedSurface
from ..geometry.triangles import dot, shares, unit, volume
from .body import Template
from .division import WRONG, from_outline
from .scene import Scene, joined

UNEVEN, CROWDED = 12.0, 15.0  # longest edge of a surface over the least height of its triangles beyond which it is
# divided anew when neighbours are found anew, and beyond which they are [-]
GROWN = 1.5  # least growth of that since they were, for which they are: what is sharp stays uneven [-]
LITTLE = 0.3  # farthest way along the normal by which the volume is restored [spacings]
EDGE = 1.5  # longest distance of a surface from its particles [spacings]
FACING = 0.5  # cosine of the angle of normals up to which parts of a surface face each other [-]
PARTS = 4  # into which an edge is divided, to find where triangles overlap


@dataclass(frozen=True)
class SurfaceDivision:
    """Where the surface particles of a body come to be, and the triangles between them.

    Attributes
    ----------
    places : Divided -- of the particles of the surface.
    along : (m, 3) -- places on the reference surface [µm].
    before : (m, 3) -- positions before [µm].
    triangles : (t, 3) int -- those before, by indices in `Template.surface`.
    """

    places: even_surface.Divided
    along: np.ndarray
    before: np.ndarray
    triangles: np.ndarray

    @property
    def x(self) -> np.ndarray:
        """Positions (m, 3) [µm]."""
        return self.places.x

    def between(self, values: np.ndarray) -> np.ndarray:
        """`values` (m, ...) of any unit, of the particles of before, at the new places (m, ...), linear in between."""
        return self.places.between(values)

    def of_facets(self, values: np.ndarray) -> np.ndarray:
        """`values` (t, 3, ...) of any unit, at the corners of the triangles of before, for those of now; sums stay."""
        a, b = np.array([(a, b) for a in range(PARTS) for b in range(PARTS)]).T
        folded = a + b >= PARTS  # every small triangle is a third from its corners
        u, v = (np.where(folded, PARTS - k - 1.0 / 3.0, k + 1.0 / 3.0) / PARTS for k in (a, b))
        points = np.column_stack([1.0 - u - v, u, v]) @ self.before[self.triangles]
        now = ClosedSurface(self.x, self.places.triangles, np.zeros(len(self.triangles), int))
        row, column = now.closest(points.reshape(-1, 3))[1], np.repeat(np.arange(len(self.triangles)), len(u))
        overlap = sparse.csr_array((np.full(len(row), 1.0 / len(u)), (row, column)), (len(values), len(values)))
        whole = overlap @ values.sum(axis=1).reshape(len(values), -1) / 3.0
        return np.repeat(whole.reshape(-1, 1, *values.shape[2:]), 3, axis=1)


def divided_in_space(t: Template, x: np.ndarray, content: float, held: np.ndarray,
                     straight: np.ndarray) -> SurfaceDivision | None:
    """The surface of a body whose particles are at x (n, 3) [µm] divided anew so that it encloses a `content` [µm³];
    None where it is even and does.

    held, straight : (m,) bool -- surface particles that stay, and that slide between straight edges alone.
    """
    at, faces = x[t.surface], t.places
    ratio = even_surface.unevenness(at[faces])
    if ratio <= UNEVEN and abs(volume(at, faces) - content) < WRONG * content:
        return None
    found, start = even_surface.undivided(at, faces, held, straight), t.on_reference
    if ratio > UNEVEN:
        even = even_surface.divided(at, faces, start, held, straight, _upward(t))
        found = even if even_surface.unevenness(even.x[even.triangles]) < ratio else found
    full = even_surface.filled(found.x, found.triangles, found.moves, content, LITTLE * t.spacing)
    along = reference(t).closest(found.between(start))[0]
    return SurfaceDivision(replace(found, x=full), along, at, faces)


def reference(t: Template) -> ClosedSurface:
    """The surface of a body in space in its reference configuration."""
    return ClosedSurface(t.X[t.surface], np.searchsorted(t.surface, t.triangles), np.zeros(len(t.triangles), int))


def _upward(t: Template) -> np.ndarray:
    """Unit normals of the reference surface of a body where its surface particles are on it (m, 3) [-]."""
    surface = reference(t)
    return unit(_from_surface(t, even_surface.normals(surface.vertices, surface.triangles)[0]))


def carried(scene: Scene, cells: np.ndarray, values: np.ndarray) -> np.ndarray:
    """`values` (m,) of any unit, of surface particles of `cells` (k,) int at the start, at the places of the reference
    outlines or surfaces where these are now (m,), linear in between.
    """
    used = [scene.templates[k] for k in scene.kind[cells]]
    parts = np.split(values, np.cumsum([len(t.surface) for t in used])[:-1]) if used else []
    at = from_outline if scene.dimension == 2 else _from_surface
    return joined((at(t, part) for t, part in zip(used, parts, strict=True)), kind=float)


def _from_surface(t: Template, values: np.ndarray) -> np.ndarray:
    """`values` (m, ...) of any unit, of the surface particles of a body at the start, where these are now on its
    reference surface (m, ...), linear in between.
    """
    if t.along is None:
        return values
    surface = reference(t)
    on, triangle = surface.closest(t.along)
    share = shares(on, surface.corners[triangle]).reshape(-1, 3, *[1] * (values.ndim - 1))
    return (share * values[surface.triangles[triangle]]).sum(axis=1)


def grown_uneven(scene: Scene, kind: int) -> float:
    """Longest edge over least height of triangles beyond which neighbours of bodies of a `kind` are found anew [-]."""
    return max(CROWDED, GROWN * scene.templates[kind].unevenness)


def near_others(scene: Scene, x: np.ndarray, c: int, reach: float, itself: bool) -> np.ndarray:
    """Which surface particles of cell c are near other cells (m,) bool, or, if it meets `itself`, near parts of it
    across its outside.

    x : (size, 3) -- positions of all particles [µm];  reach : distance of surfaces up to which they are near [µm].
    """
    t = scene.templates[scene.kind[c]]
    at, reach = x[scene.surface(c)], reach + EDGE * max(t.spacing for t in scene.templates)
    low, high = at.min(axis=0) - reach, at.max(axis=0) + reach
    others = [x[scene.surface(k)] for k in range(len(scene.kind)) if k != c]
    there = np.concatenate([np.zeros((0, 3)), *others])
    there = there[((there >= low) & (there <= high)).all(axis=1)]
    near = np.zeros(len(at), bool)
    if len(there):
        near = np.isfinite(cKDTree(there).query(at, distance_upper_bound=reach)[0])
    if itself:
        normal = unit(even_surface.normals(at, t.places)[1])
        i, j = cKDTree(at).query_pairs(reach, output_type="ndarray").T
        way = at[j] - at[i]
        facing = ((dot(normal[i], normal[j]) < FACING) & (dot(normal[i], way) > 0.0) & (dot(normal[j], way) < 0.0))
        near[i[facing]] = near[j[facing]] = True
    return near
