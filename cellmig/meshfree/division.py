"""Surfaces of fluid bodies in the plane divided anew: their particles move along the outline, apart where they crowd.

Bonds, the push of the protrusion and the drag of a medium are per reference length.  It is carried by the outline, not
by the particles: these get other places on it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry import polygons
from ..geometry.resample import CORNER
from ..geometry.respacing import Places, filled, respaced
from .body import Template
from .boundary import Boundary
from .scene import Particles, Scene
from .simplices import facet_sizes

UNEVEN, CROWDED = 1.5, 3.0  # ratio of longest to shortest segment of a loop beyond which it is divided anew when
# neighbours are found anew, and beyond which they are [-]
WRONG = 1e-3  # error of the area beyond which it is restored [-]
LITTLE = 0.02  # farthest way along the normal by which the area is restored [spacings]


@dataclass(frozen=True)
class Division:
    """Where the surface particles of a body come to be.

    Attributes
    ----------
    x : (m, 2) -- positions [µm].
    first, second : (m,) int -- particles of before, as indices in `Template.surface`, between which they are.
    share : (m,) -- of the way from the first to the second [-].
    along : (m,) -- places along the reference outline [µm].
    overlap : (m, m) -- shares of the segments of before (columns) in those of now; each column sums to 1 [-].
    """

    x: np.ndarray
    first: np.ndarray
    second: np.ndarray
    share: np.ndarray
    along: np.ndarray
    overlap: np.ndarray

    def between(self, values: np.ndarray) -> np.ndarray:
        """`values` (m, ...) of any unit, of the particles of before, at the new places (m, ...), linear in between."""
        share = self.share.reshape(-1, *[1] * (values.ndim - 1))
        return (1.0 - share) * values[self.first] + share * values[self.second]

    def of_facets(self, values: np.ndarray) -> np.ndarray:
        """`values` (m, ...) of any unit, of the segments of before, for those of now (m, ...); sums stay."""
        return np.tensordot(self.overlap, values, 1)


def extremes(lengths: np.ndarray, loop: np.ndarray, count: int) -> np.ndarray:
    """Largest of the `lengths` (e,) [µm] and of their inverses, (2, count), by the `loop` (e,) int of each."""
    ends = np.zeros((2, count))
    np.maximum.at(ends[0], loop, lengths)
    np.maximum.at(ends[1], loop, 1.0 / lengths)
    return ends


def divided(t: Template, x: np.ndarray, area: float) -> Division | None:
    """The surface of a body whose particles are at x (n, 2) [µm] divided anew so that it encloses an `area` [µm²]; None
    where all loops are even and do.

    The shape stays but for what is finer than a segment; what it lacks of the area is given to it where it is curved,
    but not at sharp corners, such as those at the edge of the contact.
    """
    at, m = x[t.surface], len(t.surface)
    longest, inverse = extremes(polygons.sides(x[t.facets]), t.loop, int(t.loop[-1]) + 1)
    loops = longest * inverse > UNEVEN
    if not loops.any() and abs(polygons.area(x[t.facets]) - area) < WRONG * area:
        return None
    points, first, second, share = at.copy(), np.arange(m), t.after.copy(), np.zeros(m)
    along, overlap = _along(t), np.eye(m)
    for number in np.flatnonzero(loops):
        on = np.flatnonzero(t.loop == number)
        found, part = respaced(at[on]), along[on]
        whole = float(t.facet_size[on].sum())
        points[on], first[on], share[on] = found.points, on[found.edge], found.share
        second[on] = t.after[first[on]]
        turns = np.floor(found.arc / np.cumsum(polygons.sides(at[on]))[-1])
        along[on] = part[found.edge] + whole * turns + found.share * t.facet_size[on[found.edge]]
        overlap[np.ix_(on, on)] = _overlap(at[on], found)
    way = points[t.after] - points
    turn = np.abs(polygons.turn(way[t.before], way))
    weight = np.where(turn > CORNER, 0.0, turn)
    return Division(filled(points, t.places, area, weight, LITTLE * t.spacing), first, second, share, along, overlap)


def _along(t: Template) -> np.ndarray:
    """Places of the surface particles along the reference outline (m,) [µm]."""
    if t.along is not None:
        return t.along.copy()
    ends = np.cumsum(t.facet_size) - t.facet_size
    return ends - ends[np.searchsorted(t.loop, t.loop)]


def _overlap(polygon: np.ndarray, places: Places) -> np.ndarray:
    """Shares (k, k) [-] of the edges of a `polygon` (k, 2) [µm], in columns, between each of `places` and the next."""
    side = polygons.sides(polygon)
    high = np.cumsum(side)
    low, length = high - side, high[-1]
    begin, end = places.arc[:, None], np.append(places.arc[1:], places.arc[0] + length)[:, None]
    common = sum(np.maximum(np.minimum(end, high + turn * length) - np.maximum(begin, low + turn * length), 0.0)
                 for turn in (-1, 0, 1))
    return common / common.sum(axis=0)


def fluid(particles: Particles) -> np.ndarray:
    """Which particles are of a fluid, whose energy knows J alone (n,) bool."""
    return _fluids(particles.scene)[particles.material]


def _fluids(scene: Scene) -> np.ndarray:
    """Which of the materials of a scene are fluids (materials,) bool."""
    return np.array([getattr(law, "fluid", False) for law in scene.materials])


def from_outline(t: Template, values: np.ndarray) -> np.ndarray:
    """`values` (m,) of any unit, of the surface particles of a body at the start, where these are now on its reference
    outline (m,), linear in between.
    """
    if t.along is None:
        return values
    out, size = values.copy(), facet_sizes(t.X[t.facets])
    for number in range(int(t.loop[-1]) + 1):
        on = np.flatnonzero(t.loop == number)
        place = np.cumsum(size[on]) - size[on]
        out[on] = np.interp(t.along[on], place, values[on], period=size[on].sum())
    return out


def divisible(scene: Scene, boundary: Boundary) -> np.ndarray:
    """Cells (cells,) bool whose surface may be divided anew: all of it is a fluid, and no support or load is on it."""
    flows = _fluids(scene)
    free = np.array([bool(flows[np.where(t.nucleus[t.surface], inner, outer)].all())
                     for t, (outer, inner) in zip(scene.templates, scene.material_of, strict=True)])[scene.kind]
    bound = np.concatenate([boundary.held[:, 0], boundary.dead, boundary.pressed.ravel()])
    held = scene.particles(np.unique(bound))
    for kind, on, at in held.by_kind():
        free[held.cell[on[np.isin(at, scene.templates[kind].surface)]]] = False
    return free
