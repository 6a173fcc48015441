"""The surface segments of a rank, and search lists for contact and adhesion."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from mpi4py import MPI

from ..kernel.fields import Field
from ..kernel.kernel import Kernel
from ..meshfree.contact import ContactLists, contact_lists
from ..parallel.reduce import global_maximum
from .state import State
from .subdomain import Subdomain
from .surface_exchange import SurfacePlaces

SKIN = 0.85  # distance by which surfaces may approach each other until the search lists are renewed [spacings]
STRETCH = 1.2  # largest stretch of a segment until then [-]
CLOSEST_POINT = np.dtype([("gap", float), ("n", float, 2), ("t", float), ("a", np.int64), ("b", np.int64)])


class Segments:
    """Segments with an end of this rank, or of a cell whose push needs them, in global order; their search lists.

    Attributes
    ----------
    number : (e,) int -- the segments, by their first ends in `Surfaces`.
    acts : (e,) bool -- whether one end is this rank's.
    low : (e,) bool -- whether the substrate may act on it.
    lists : ContactLists -- particles near other cells; None without contact.
    closest_point : (nodes of `lists`,) CLOSEST_POINT -- on the other cell, as the last evaluation of forces found them.
    skin : float -- distance by which surfaces may approach each other until the lists are renewed [µm].
    renewals : int -- number of renewals.
    """

    FIELDS = (
        Field("n_segments", "long", doc="all segments"),
        Field("segment", "int32_t *", "(n_segments, 2)", "", "their ends"),
        Field("length", "double *", "(n_segments,)", "µm", "reference lengths"),
        Field("n_near", "long", doc="segments near the substrate"),
        Field("near", "int32_t *", "(n_near,)", "", "their numbers"),
        Field("n_contact_nodes", "long", doc="particles near another cell: by particle and cell"),
        Field("contact_node", "int32_t *", "(n_contact_nodes,)", "", "these particles"),
        Field("first_candidate", "long *", "(n_contact_nodes + 1,)", "", "their segments in `candidate`"),
        Field("candidate", "int32_t *", "(…, 4)", "", "segments that may be closest, with the particles beside"),
        Field("n_contact_segments", "long", doc="segments between such particles"),
        Field("contact_segment", "int32_t *", "(n_contact_segments, 2)", "", "their ends in `contact_node`"),
        Field("contact_length", "double *", "(n_contact_segments,)", "µm", "reference lengths"),
        Field("contact_pull", "double *", "(n_contact_nodes,)", "pN/µm", "force of the bonds along the normal"),
        Field("closest_point", "void *", "(n_contact_nodes,)", "", "closest points on the other cell"),
        Field("contact_cutoff", "double", "", "µm", "distance beyond which they do not act"),
    )

    def __init__(self, part: Subdomain, kernel: Kernel, state: State):
        """Set segments and laws; search lists are made by the first `renew`."""
        self._part, self._kernel, self._state, s, k = part, kernel, state, part.surfaces, kernel
        there = part.on_surface | part.on_surface[s.after]
        acts = there.copy()
        there[part.pushed] = True
        self.number = np.flatnonzero(there)
        self.acts = acts[self.number]
        self.low = np.zeros(len(self.number), bool)
        self.lists: ContactLists | None = None
        self.closest_point = np.zeros(0, CLOSEST_POINT)
        self.skin, self.renewals = SKIN * min(t.spacing for t in part.scene.templates), 0
        self.renewed_at = np.zeros((len(part.own_surface), 2))
        self._places = SurfacePlaces(part.comm, s, part.owner[s.ids], part.own_surface)
        k["segment"] = part.numbering.local(s.ids[self.ends])
        k["length"], k["n_segments"] = s.length[self.number], len(self.number)
        if part.terms.contact is not None:
            k["contact_cutoff"] = part.terms.contact.cutoff

    @cached_property
    def ends(self) -> np.ndarray:
        """Ends of the segments in `Surfaces` (e, 2) int."""
        return np.column_stack([self.number, self._part.surfaces.after[self.number]])

    def own_places(self) -> np.ndarray:
        """Current positions of this rank's surface particles (k, 2) [µm]."""
        return self._state.x(self._part.at_surface)

    def everywhere(self) -> np.ndarray:
        """Current positions of all surface particles of the scene (m, 2) [µm]; collective."""
        return self._places.everywhere(self.own_places())

    def owned(self) -> tuple[np.ndarray, np.ndarray]:
        """Segments that start at a particle of this rank: local ends (e, 2) int, current ends (e, 2, 2) [µm]."""
        ends = self._kernel["segment"]
        ends = ends[ends[:, 0] < self._part.n_owned]
        return ends, self._state.x(ends)

    def in_contact(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Segments near other cells: local ends (e, 2) int, current ends (e, 2, 2) and gaps of the ends (e, 2) [µm]."""
        segment = self.lists.segment if self.lists is not None else np.zeros((0, 2), np.int64)
        ends = self._kernel["contact_node"][segment] if len(segment) else segment
        return ends, self._state.x(ends), self.closest_point["gap"][segment]

    # ------------------------------------------------------------ search lists

    def renew(self) -> None:
        """Make search lists, and ghosts of cells within reach, for the current positions; collective."""
        part, k, t = self._part, self._kernel, self._part.terms
        self.renewals += 1
        self.renewed_at = self._state.u[part.at_surface].copy()
        if t.substrate is None and t.contact is None:
            return
        x2 = self.owned()[1]
        longest = np.linalg.norm(x2[:, 1] - x2[:, 0], axis=1).max(initial=0.0)
        longest = float(global_maximum(part.comm, np.array([longest]))[0])
        reach = t.contact.cutoff + STRETCH * longest + self.skin if t.contact is not None else 0.0
        x, around = self._places.near(self.own_places(), reach + 0.5 * longest)
        if t.substrate is not None:
            high = max(t.substrate.cutoff, t.protrusion.height if t.protrusion is not None else 0.0)
            self.low = (x[self.ends, 1].min(axis=1) < high + self.skin) & part.surfaces.outer[self.number]
            k["near"] = np.flatnonzero(self.low & self.acts)
            k["n_near"] = len(k["near"])
        if t.contact is not None:
            lists = contact_lists(part.surfaces, x, reach + 0.5 * longest, self.skin, around)
            self._set_contact(lists.needed(part.surfaces, part.on_surface))

    def _set_contact(self, lists: ContactLists) -> None:
        """Set the kernel's arrays for the lists that act on this rank's particles; collective."""
        s, k, state = self._part.surfaces, self._kernel, self._state
        numbering = self._part.numbering.extended(s.ids[lists.involved(s)])
        same = np.array_equal(numbering.ids, state.numbering.ids)
        if not self._part.comm.allreduce(same, MPI.LAND):
            state.renumber(numbering)

        def local(surface: np.ndarray) -> np.ndarray:
            return numbering.local(s.ids[surface])

        c = lists.candidate
        k["n_contact_nodes"], k["contact_node"] = len(lists.node), local(lists.node)
        k["first_candidate"] = lists.first
        k["candidate"] = local(np.column_stack([s.before[c], c, s.after[c], s.after[s.after[c]]]))
        k["n_contact_segments"], k["contact_segment"] = len(lists.segment), lists.segment
        k["contact_length"] = s.length[lists.node[lists.segment[:, 0]]]
        k["contact_pull"] = np.zeros(len(lists.node))
        self.closest_point = np.zeros(len(lists.node), CLOSEST_POINT)
        k["closest_point"] = self.closest_point.ctypes.data
        self.lists = lists

    def displaced(self) -> float:
        """Largest displacement of this rank's surface particles since the lists were made [µm]."""
        moved = self._state.u[self._part.at_surface] - self.renewed_at
        return float(np.linalg.norm(moved, axis=1).max(initial=0.0))
