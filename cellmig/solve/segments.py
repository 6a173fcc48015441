"""The surface segments of a rank, and search lists for contact and adhesion."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from mpi4py import MPI

from ..geometry import polygons
from ..kernel.fields import Field
from ..kernel.kernel import Kernel
from ..meshfree.contact import ContactLists, acting, contact_pairs
from ..meshfree.terms import NO_CONTACTS
from ..model.adhesion import Pieces
from ..parallel.reduce import global_maximum
from .state import State
from .subdomain import Subdomain
from .surface_exchange import SurfacePlaces

SKIN = 0.85  # distance by which surfaces may approach each other until the search lists are renewed [spacings]
MARGIN = 0.1  # change of a distance up to which the kernel's lists of pairs that act are complete, over the skin [-]
STRETCH = 1.2  # largest stretch of a segment until then [-]


class Segments:
    """Segments with an end of this rank, or of a cell whose push needs them, in global order; their search lists.

    Attributes
    ----------
    number : (e,) int -- the segments, by their first ends in `Surfaces`.
    acts : (e,) bool -- whether one end is this rank's.
    low : (e,) bool -- whether the substrate may act on it.
    lists : ContactLists -- segments near other cells; None without contact.
    skin : float -- distance by which surfaces may approach each other until the lists are renewed [µm].
    renewals : int -- number of renewals.
    turn : (m,) float -- turns of the outlines of this rank's cells at the surface particles, followed from the start
        [rad].
    """

    FIELDS = (
        Field("n_facets", "long", doc="all facets"),
        Field("facet", "int32_t *", "(n_facets, d)", "", "their corners"),
        Field("facet_size", "double *", "(n_facets,)", "µm or µm²", "reference lengths or areas"),
        Field("n_near", "long", doc="facets near the substrate"),
        Field("near", "int32_t *", "(n_near,)", "", "their numbers"),
        Field("n_contact_nodes", "long", doc="particles near another cell, see `ContactLists`"),
        Field("contact_node", "int32_t *", "(n_contact_nodes,)", "", "these particles"),
        Field("contact_x", "double *", "(n_contact_nodes, 2)", "µm", "their current positions"),
        Field("contact_force", "double *", "(n_contact_nodes, 2)", "pN/µm", "the forces on them"),
        Field("contact_stiffness", "double *", "(n_contact_nodes,)", "Pa", "bounds of their rows of the tangent"),
        Field("n_contact_segments", "long", doc="segments near another cell"),
        Field("contact_segment", "int32_t *", "(n_contact_segments, 2)", "", "their ends in `contact_node`"),
        Field("contact_length", "double *", "(n_contact_segments,)", "µm", "reference lengths"),
        Field("first_edge", "long *", "(n_contact_segments + 1,)", "", "their edges in `contact_edge`"),
        Field("contact_edge", "int32_t *", "(…, 3)", "", "ends of edges of other cells, end of the next edge"),
        Field("stiffness_of_contact", "double *", "(n_local,)", "1/µs²", "the bounds over the mass"),
        Field("stiffest_contact", "double *", "(1,)", "1/µs²", "largest of them; infinite where surfaces cross"),
        Field("listed", "int32_t *", "(…, 2)", "", "pairs that may act soon, and what of them: the edge, the vertex"),
        Field("first_listed", "long *", "(n_contact_segments + 1,)", "", "those of each segment"),
        Field("listed_x", "double *", "(n_contact_nodes, 2)", "µm", "positions when they were listed"),
        Field("contact_margin", "double", "", "µm", "change of a distance up to which they are complete"),
        Field("contact_law", "int32_t *", "(n_contact_segments,)", "", "numbers of their laws in `Terms.contacts`"),
        Field("contact_cutoff", "double *", "(n_contact_segments,)", "µm", "distances beyond which these do not act"),
    )

    def __init__(self, part: Subdomain, kernel: Kernel, state: State):
        """Set segments and laws; search lists are made by the first `renew`."""
        self._part, self._kernel, self._state, s, k = part, kernel, state, part.surfaces, kernel
        acts = s.touching(part.on_surface)
        pushed = np.zeros(len(s.ids), bool)
        pushed[part.pushed] = True
        self.number = np.flatnonzero(acts | (s.touching(pushed) & s.outer))
        self.acts = acts[self.number]
        self.low = np.zeros(len(self.number), bool)
        self.lists: ContactLists | None = None
        self.skin, self.renewals = SKIN * min(t.spacing for t in part.scene.templates), 0
        self.renewed_at = np.zeros((len(part.own_surface), part.scene.dimension))
        self.turn = s.turn
        self._places = SurfacePlaces(part.comm, s, part.owner[s.ids], part.own_surface)
        k["facet"] = part.numbering.local(s.ids[self.ends])
        k["facet_size"], k["n_facets"] = s.size[self.number], len(self.number)
        self._contacts = part.terms.contacts or NO_CONTACTS
        if part.terms.contacts is not None:
            k["stiffness_of_contact"] = np.zeros(part.capacity)

    @cached_property
    def ends(self) -> np.ndarray:
        """Corners of the facets in `Surfaces` (e, d) int."""
        return self._part.surfaces.facets[self.number]

    def own_places(self) -> np.ndarray:
        """Current positions of this rank's surface particles (k, 2) [µm]."""
        return self._state.x(self._part.at_surface)

    def everywhere(self) -> np.ndarray:
        """Current positions of all surface particles of the scene (m, 2) [µm]; collective."""
        return self._places.everywhere(self.own_places())

    def owned(self) -> tuple[np.ndarray, np.ndarray]:
        """Segments that start at a particle of this rank: local ends (e, 2) int, current ends (e, 2, 2) [µm]."""
        ends = self._kernel["facet"]
        ends = ends[ends[:, 0] < self._part.n_owned]
        return ends, self._state.x(ends)

    def touching(self, most: float) -> tuple[np.ndarray, np.ndarray]:
        """Segments near other cells: local first ends (s,) int, and current lengths (s,) [µm] that touch those.

        A gap may be up to `most` [-] equilibrium distances of the bonds.  A length is counted as the energy is, edge by
        edge and vertex by vertex (see `CellAdhesion`).
        """
        if self.lists is None or not len(self.lists.source):
            return np.zeros(0, np.int64), np.zeros(0)
        lists, node = self.lists, self._kernel["contact_node"]
        distance = np.array([law.equilibrium_distance for law in self._contacts.laws])
        x, height = self._state.x(node), most * distance[self._kernel["contact_law"]]
        ends = x[lists.segment]
        pairs = np.concatenate([np.repeat(ends, np.diff(lists.first), axis=0), x[lists.edge]], axis=1)
        height = np.repeat(height, np.diff(lists.first))
        low, high, first, last, sign = Pieces().pieces(tuple(pairs.transpose(1, 2, 0)), height)
        near = np.maximum(high - low, 0.0) + sign * np.maximum(last - first, 0.0)
        share = np.minimum(np.add.reduceat(near, lists.first[:-1]), 1.0)
        other = self._part.surfaces.cell[lists.source] != lists.other[lists.segment[:, 0]]
        return node[lists.segment[:, 0]], np.where(other, share, 0.0) * polygons.sides(ends)

    # ------------------------------------------------------------ search lists

    def renew(self) -> None:
        """Make search lists, and ghosts of cells within reach, for the current positions; collective."""
        part, k, t = self._part, self._kernel, self._part.terms
        self.renewals += 1
        self.renewed_at = self._state.u[part.at_surface].copy()
        if t.substrate is None and t.contacts is None:
            return
        x2 = self.owned()[1]
        longest = np.linalg.norm(x2[:, 1] - x2[:, 0], axis=1).max(initial=0.0)
        longest = float(global_maximum(part.comm, np.array([longest]))[0])
        reach = self._contacts.reach.max() + STRETCH * longest + self.skin if t.contacts is not None else 0.0
        x, around = self._places.near(self.own_places(), reach + 0.5 * longest)
        if t.substrate is not None:
            high = max(t.substrate.cutoff, t.protrusion.height if t.protrusion is not None else 0.0)
            self.low = (x[self.ends, -1].min(axis=1) < high + self.skin) & part.surfaces.outer[self.number]
            k["near"] = np.flatnonzero(self.low & self.acts)
            k["n_near"] = len(k["near"])
        if t.contacts is not None:
            if self._contacts.own:
                self.turn = part.surfaces.followed(self.turn, x, self._places.on)
            farthest = self._contacts.reach.max() + self.skin
            pairs = contact_pairs(part.surfaces, x, farthest, self._within, self.turn, around)
            self._set_contact(ContactLists.of(part.surfaces, acting(part.surfaces, pairs, part.on_surface)))

    def _within(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Distance (k,) [µm] up to which surfaces of the cells a and b (k,) int are paired; -1 if they never meet."""
        within = self._contacts.reach[self._contacts.of_pair(a, b)] + self.skin
        return within if self._contacts.own else np.where(a == b, -1.0, within)

    def _set_contact(self, lists: ContactLists) -> None:
        """Set the kernel's arrays for the lists that act on this rank's particles; collective."""
        s, k, state = self._part.surfaces, self._kernel, self._state
        numbering = self._part.numbering.extended(s.ids[lists.node])
        same = np.array_equal(numbering.ids, state.numbering.ids)
        if not self._part.comm.allreduce(same, MPI.LAND):
            state.renumber(numbering)
        k["n_contact_nodes"], k["contact_node"] = len(lists.node), numbering.local(s.ids[lists.node])
        k["contact_x"], k["contact_force"] = (np.zeros((len(lists.node), 2)) for _ in range(2))
        k["contact_stiffness"] = np.zeros(len(lists.node))
        k["n_contact_segments"], k["contact_segment"] = len(lists.segment), lists.segment
        k["contact_length"], k["first_edge"], k["contact_edge"] = s.size[lists.source], lists.first, lists.edge
        k["listed"], k["first_listed"] = np.zeros((len(lists.edge) + 1, 2)), np.zeros(len(lists.first))
        k["listed_x"], k["contact_margin"] = np.full((len(lists.node), 2), np.nan), MARGIN * self.skin
        cell = s.cell[lists.source], lists.other[lists.segment[:, 0]]
        k["contact_law"] = law = self._contacts.of_pair(*cell)
        k["contact_cutoff"] = self._contacts.reach[law]
        self.lists = lists

    @property
    def cross(self) -> bool:
        """Whether a segment of this rank crossed another outline since contacts were forgotten."""
        return bool(np.isinf(self._kernel["stiffest_contact"][0]))

    def displaced(self) -> float:
        """Largest displacement of this rank's surface particles since the lists were made [µm]."""
        moved = self._state.u[self._part.at_surface] - self.renewed_at
        return float(np.linalg.norm(moved, axis=1).max(initial=0.0))
