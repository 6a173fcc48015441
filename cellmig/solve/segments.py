"""The surface segments of a rank, and search lists for contact and adhesion."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from mpi4py import MPI

from ..geometry import polygons
from ..kernel.fields import Field
from ..kernel.kernel import Kernel
from ..meshfree.contact import ContactLists, NodeLists, Surfaces, acting, contact_pairs
from ..meshfree.contact_space import Features, TriangleLists, acting_triangles, triangle_pairs
from ..meshfree.simplices import facet_sizes, share_below
from ..meshfree.terms import NO_CONTACTS
from ..model.adhesion import Pieces
from ..parallel.reduce import largest
from .state import State
from .subdomain import Subdomain
from .surface_exchange import SurfacePlaces

SKIN = 0.85  # distance by which surfaces may approach each other until the search lists are renewed [spacings]
WORN = {2: 0.2, 3: 0.4}  # share of that after which a batch begins with new lists: in space they take tens of steps [-]
MARGIN = 0.1  # change of a distance up to which the kernel's lists of pairs that act are complete, over the skin [-]
SLIP = 0.05  # how far a triangle and a feature slip while pieces of contact in space serve, over their distance [-]
STRETCH = 1.2  # largest stretch of a segment until then [-]


class Segments:
    """Segments with an end of this rank, or of a cell whose push needs them, in global order; their search lists.

    Attributes
    ----------
    number : (e,) int -- the segments, among the facets of the subdomain's `Surfaces`.
    acts : (e,) bool -- whether one end is this rank's.
    low : (e,) bool -- whether the substrate may act on it.
    lists : ContactLists or TriangleLists -- facets near other cells; None without contact.
    skin : float -- distance by which surfaces may approach each other until the lists are renewed [µm].
    worn : float -- displacement after which they are renewed before a batch of steps [µm].
    renewals : int -- number of renewals.
    turn : (m,) float -- turns of the outlines of this rank's cells at their surface particles, followed from the start
        [rad].
    """

    FIELDS = (
        Field("n_facets", "long", doc="all facets"),
        Field("facet", "int32_t *", "(n_facets, d)", "", "their corners"),
        Field("facet_size", "double *", "(n_facets,)", "µm or µm²", "reference lengths or areas"),
        Field("facet_friction", "int32_t *", "(n_facets,)", "", "numbers of their laws in `Terms.friction`"),
        Field("n_taut", "long", doc="facets with a cortex, if there is any"),
        Field("taut", "int32_t *", "(n_taut,)", "", "their numbers"),
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
        Field("deepest_contact", "double *", "(1,)", "µm", "how far surfaces that cross reach into each other"),
        Field("listed", "int32_t *", "(…, 2)", "", "pairs that may act soon, and what of them: the edge, the vertex"),
        Field("first_listed", "long *", "(n_contact_segments + 1,)", "", "those of each segment"),
        Field("listed_x", "double *", "(n_contact_nodes, 2)", "µm", "positions when they were listed"),
        Field("contact_margin", "double", "", "µm", "change of a distance up to which they are complete"),
        # in space, where edges are those of `contact_side`, and nodes have forces and stiffness in (n_contact_nodes, 4)
        Field("n_contact_faces", "long", doc="faces near another cell, see `TriangleLists`"),
        Field("contact_face", "int32_t *", "(n_contact_faces, 3)", "", "their corners in `contact_node`"),
        Field("n_contact_edges", "long", doc="edges near another cell"),
        Field("contact_side", "int32_t *", "(n_contact_edges, 4)", "", "their ends, and third corners of their faces"),
        Field("n_contact_vertices", "long", doc="vertices near another cell"),
        Field("contact_vertex", "int32_t *", "(n_contact_vertices,)", "", "these"),
        Field("first_ring", "long *", "(n_contact_vertices + 1,)", "", "their neighbours in `contact_ring`"),
        Field("contact_ring", "int32_t *", "(…,)", "", "these, in positive order from outside"),
        Field("first_face", "long *", "(n_contact_segments + 1,)", "", "faces near a triangle in `near_face`"),
        Field("near_face", "int32_t *", "(…,)", "", "these"),
        Field("first_side", "long *", "(n_contact_segments + 1,)", "", "edges near a triangle in `near_side`"),
        Field("near_side", "int32_t *", "(…,)", "", "these"),
        Field("first_vertex", "long *", "(n_contact_segments + 1,)", "", "vertices near a triangle in `near_vertex`"),
        Field("near_vertex", "int32_t *", "(…,)", "", "these"),
        Field("contact_call", "int32_t *", "(1,)", "", "number of the last call of add_contact"),
        Field("contact_serves", "double *", "(3,)", "", "1 where no pieces of before serve; how far triangles and "
              "features slip while pieces do, over their distance; the expected least distance [µm]"),
        Field("contact_gone", "double *", "(n_contact_nodes,)", "µm", "how far nodes have gone, beside their mean, "
              "since lists of what may act were made"),
        Field("triangle_gone", "double *", "(n_contact_segments, 2)", "µm", "how far their corners have gone until "
              "then, and may have gone while lists hold"),
        Field("face_gone", "double *", "(n_contact_faces, 2)", "µm", "the same of faces"),
        Field("side_gone", "double *", "(n_contact_edges, 2)", "µm", "the same of edges, with their faces"),
        Field("vertex_gone", "double *", "(n_contact_vertices, 2)", "µm", "the same of vertices, with their faces"),
        Field("face_rest", "double *", "(…, 2)", "µm", "until when a triangle and a face in `near_face` do not act"),
        Field("side_rest", "double *", "(…, 2)", "µm", "the same of edges"),
        Field("vertex_rest", "double *", "(…, 2)", "µm", "the same of vertices"),
        Field("face_set", "int32_t *", "(n_contact_faces,)", "", "number of the call for which their frames are"),
        Field("side_set", "int32_t *", "(n_contact_edges,)", "", "the same of edges"),
        Field("vertex_set", "int32_t *", "(n_contact_vertices,)", "", "the same of vertices"),
        Field("face_frame", "double *", "(n_contact_faces, …)", "", "this"),
        Field("edge_frame", "double *", "(n_contact_edges, …)", "", "the same of edges"),
        Field("vertex_frame", "double *", "(n_contact_vertices, …)", "", "the same of vertices"),
        Field("contact_smooth", "double *", "(n_contact_segments,)", "µm", "distances below which laws have no scale"),
        Field("contact_apart", "double *", "(n_contact_segments,)", "µm", "equilibrium distances of bonds"),
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
        self.lists: NodeLists | None = None
        self._features: Features | None = None
        self.skin, self.renewals = SKIN * min(t.spacing for t in part.scene.templates), 0
        self.worn = WORN[part.scene.dimension] * self.skin
        self.renewed_at = np.zeros((len(part.own_surface), part.scene.dimension))
        self.turn = s.turn
        self._places = SurfacePlaces(part.comm, part.scene, part.owners, s, part.own_surface)
        k["facet"] = part.numbering.local(s.ids[self.ends])
        k["facet_size"], k["n_facets"] = s.size[self.number], len(self.number)
        if part.terms.friction is not None:
            k["facet_friction"] = part.terms.friction.of_cell[s.cell[self.ends[:, 0]]]
        if part.terms.cortex is not None:
            k["taut"] = np.flatnonzero(~np.isin(s.cell[self.ends[:, 0]], part.terms.slack))
            k["n_taut"] = len(k["taut"])
        self._contacts = part.terms.contacts or NO_CONTACTS
        if part.terms.contacts is not None:
            k["stiffness_of_contact"] = np.zeros(part.capacity)
            k["contact_serves"] = np.array([1.0, 0.0, 0.0])

    @cached_property
    def ends(self) -> np.ndarray:
        """Corners of the facets in `Surfaces` (e, d) int."""
        return self._part.surfaces.facets[self.number]

    def own_places(self) -> np.ndarray:
        """Current positions of this rank's surface particles (k, 2) [µm]."""
        return self._state.x(self._part.at_surface)

    def everywhere(self) -> np.ndarray | None:
        """Current positions of all surface particles of the scene (m, d) [µm] on rank 0, else None; collective."""
        return self._places.everywhere(self.own_places())

    def around(self) -> tuple[Surfaces, np.ndarray]:
        """Surfaces (m particles) of this rank's cells and of all that they meet, and current positions (m, d) [µm];
        collective.
        """
        return self._places.near(self.own_places(), self.skin)

    def owned(self) -> tuple[np.ndarray, np.ndarray]:
        """Segments that start at a particle of this rank: local ends (e, 2) int, current ends (e, 2, 2) [µm]."""
        ends = self._kernel["facet"]
        ends = ends[ends[:, 0] < self._part.n_owned]
        return ends, self._state.x(ends)

    def touching(self, most: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Facets near other cells: local first corners (s,) int, these cells (s,) int, and sizes of what touches.

        Sizes (s,) are the current ones [µm, in space µm²].

        A gap may be up to `most` [-] equilibrium distances of the bonds.  A length is counted as the energy is, edge by
        edge and vertex by vertex (see `CellAdhesion`); an area by the distances of its corners from the other surface,
        between which it is taken to be linear.
        """
        lists = self.lists
        if lists is None or not len(lists.source):
            return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0)
        node = self._kernel["contact_node"]
        corner, near_to = node[lists.segment[:, 0]], lists.other[lists.segment[:, 0]]
        other = lists.surfaces.cell[lists.surfaces.facets[lists.source, 0]] != near_to  # a cell does not touch itself
        if isinstance(lists, TriangleLists):
            x = self._state.x(node)
            distance = np.array([law.equilibrium_distance for law in self._contacts.laws])[self._kernel["contact_law"]]
            share = share_below(lists.distances(x) - (most * distance)[:, None], 0.0)
            return corner, near_to, np.where(other, share, 0.0) * facet_sizes(x[lists.segment])
        assert isinstance(lists, ContactLists)
        distance = np.array([law.equilibrium_distance for law in self._contacts.laws])
        x, height = self._state.x(node), most * distance[self._kernel["contact_law"]]
        ends = x[lists.segment]
        pairs = np.concatenate([np.repeat(ends, np.diff(lists.first), axis=0), x[lists.edge]], axis=1)
        height = np.repeat(height, np.diff(lists.first))
        low, high, first, last, sign = Pieces().pieces(tuple(pairs.transpose(1, 2, 0)), height)
        near = np.maximum(high - low, 0.0) + sign * np.maximum(last - first, 0.0)
        share = np.minimum(np.add.reduceat(near, lists.first[:-1]), 1.0)
        return corner, near_to, np.where(other, share, 0.0) * polygons.sides(ends)

    # ------------------------------------------------------------ search lists

    def renew(self) -> None:
        """Make search lists, and ghosts of cells within reach, for the current positions; collective."""
        part, k, t = self._part, self._kernel, self._part.terms
        self.renewals += 1
        self.renewed_at = self._state.u[part.at_surface].copy()
        if t.substrate is None and t.contacts is None:
            return
        x2 = self.owned()[1]
        longest = largest(part.comm, np.linalg.norm(x2 - np.roll(x2, 1, axis=1), axis=2))
        reach = self._contacts.reach.max() + STRETCH * longest + self.skin if t.contacts is not None else 0.0
        around, x = self._places.near(self.own_places(), reach + 0.5 * longest)
        mine = np.isin(around.cell, part.surfaces.cells)
        if t.substrate is not None:
            self.low = (x[mine][self.ends, -1].min(axis=1) < t.low + self.skin) & part.surfaces.outer[self.number]
            k["near"] = np.flatnonzero(self.low & self.acts)
            k["n_near"] = len(k["near"])
        if t.contacts is not None:
            farthest, own = self._contacts.reach.max() + self.skin, np.zeros(len(around.ids), bool)
            own[mine] = part.on_surface
            if part.scene.dimension == 2:
                turn = around.turn.copy()
                if self._contacts.own:
                    turn[mine] = self.turn = part.surfaces.followed(self.turn, x[mine])
                pairs = contact_pairs(around, x, farthest, self._within, turn)
                self._set_contact(ContactLists.of(around, self._needed(around, pairs, own)))
            else:
                features = self._features_of(around)
                near = triangle_pairs(around, features, x, farthest, self._within)
                near = acting_triangles(around, features, near, own, self._holding(around, near["face"]))
                self._set_triangles(TriangleLists.of(around, features, near))

    def _features_of(self, around: Surfaces) -> Features:
        """Features of surfaces, for the same ones those of before."""
        if self._features is None or self._features.faces is not around.facets:
            self._features = Features.of(self._part.scene, around)
        return self._features

    def _within(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Distance (k,) [µm] up to which surfaces of the cells a and b (k,) int are paired; -1 if they never meet."""
        within = self._contacts.reach[self._contacts.of_pair(a, b)] + self.skin
        return within if self._contacts.own else np.where(a == b, -1.0, within)

    def _needed(self, around: Surfaces, pairs: np.ndarray, own: np.ndarray) -> np.ndarray:
        """Those of `pairs` (p, 2) int that act on this rank's particles `own` (m,) bool, or hold cells that push (q, 2)
        int.
        """
        if self._part.terms.pushes_off is None:
            return acting(around, pairs, own)
        pushes = self._push_off(pairs[:, 0], around.cell[pairs[:, 1]])
        return pairs[(own[pairs] | own[around.after[pairs]]).any(axis=1) | pushes]

    def _holding(self, around: Surfaces, faces: np.ndarray) -> np.ndarray:
        """Whether triangles of surfaces `around` push off `faces` near them (p, 2) int, by which their cells hold (f,)
        bool.
        """
        holding = np.zeros(len(around.facets), bool)
        if self._part.terms.pushes_off is not None:
            other = around.cell[around.facets[faces[:, 1], 0]]
            holding[faces[self._push_off(faces[:, 0], other), 0]] = True
        return holding

    def _push_off(self, facets: np.ndarray, others: np.ndarray) -> np.ndarray:
        """Whether facets push off other cells (k,) int each; (k,) bool."""
        s = self._part.surfaces  # all are there in such a scene
        corner = s.facets[facets, 0]
        pushes = np.array(self._part.terms.pushes_off)[self._contacts.of_pair(s.cell[corner], others)]
        return pushes & np.isin(corner, self._part.pushed)

    def pushing(self) -> np.ndarray:
        """The facets near other cells that push off them, as places in `number`; -1 for the others (s,) int."""
        lists = self.lists
        assert lists is not None
        found = np.searchsorted(self.number, lists.source)
        return np.where(self._push_off(lists.source, lists.other[lists.segment[:, 0]]), found, -1)

    def _set_nodes(self, lists: NodeLists) -> None:
        """Set the kernel's nodes and sources of contact, and the ghosts that they need; collective."""
        s, k, state = lists.surfaces, self._kernel, self._state
        numbering = self._part.numbering.extended(lists.ids)
        same = np.array_equal(numbering.ids, state.numbering.ids)
        if not self._part.comm.allreduce(same, MPI.LAND):
            state.renumber(numbering)
        k["n_contact_nodes"], k["contact_node"] = len(lists.node), numbering.local(lists.ids)
        k["contact_x"] = np.zeros((len(lists.node), self._part.scene.dimension))
        k["n_contact_segments"], k["contact_segment"] = len(lists.segment), lists.segment
        k["contact_length"] = s.size[lists.source]
        cell = s.cell[s.facets[lists.source, 0]], lists.other[lists.segment[:, 0]]
        k["contact_law"] = law = self._contacts.of_pair(*cell)
        k["contact_cutoff"] = self._contacts.reach[law]
        self.lists = lists

    def _set_triangles(self, lists: TriangleLists) -> None:
        """Set the kernel's arrays in space for the lists that act on this rank's particles; collective."""
        self._set_nodes(lists)
        k, sizes = self._kernel, np.zeros(3)
        k["contact_force"] = np.zeros((len(lists.node), 4))
        k["n_contact_faces"], k["contact_face"] = len(lists.face), lists.face
        k["n_contact_edges"], k["contact_side"] = len(lists.edge), lists.edge
        k["n_contact_vertices"], k["contact_vertex"] = len(lists.vertex), lists.vertex
        k["first_ring"], k["contact_ring"] = lists.first_ring, lists.ring
        for kind, name in (("face", "face"), ("edge", "side"), ("vertex", "vertex")):
            k[f"first_{name}"], k[f"near_{name}"] = lists.first[kind], lists.number[kind]
            k[f"{name}_rest"] = np.full((len(lists.number[kind]) + 1, 2), -1.0)
        k("contact_sizes", sizes)
        for (kind, features), size in zip((("face", lists.face), ("edge", lists.edge), ("vertex", lists.vertex)),
                                          sizes.astype(int), strict=True):
            k[f"{kind}_frame"] = np.zeros((len(features) + 1, size))
            name = "side" if kind == "edge" else kind
            k[f"{name}_set"], k[f"{name}_gone"] = np.zeros(len(features) + 1), np.zeros((len(features) + 1, 2))
        k["triangle_gone"], k["contact_call"] = np.zeros((len(lists.segment) + 1, 2)), np.zeros(1)
        k["contact_x"], k["contact_gone"] = self._state.x(k["contact_node"]), np.zeros(len(lists.node))
        for name, of in (("contact_smooth", "cap"), ("contact_apart", "equilibrium_distance")):
            k[name] = np.array([getattr(law, of) for law in self._contacts.laws])[k["contact_law"]]

    def serve(self, share: float, gap: float = 0.0) -> None:
        """Have pieces of contact in space serve from now on, from none on, as far as `share` times SLIP [-].

        gap : expected least gap between cells [µm].
        """
        if self._part.terms.contacts is not None:
            self._kernel["contact_serves"][:] = 1.0, SLIP * share, gap

    def _set_contact(self, lists: ContactLists) -> None:
        """Set the kernel's arrays for the lists that act on this rank's particles; collective."""
        self._set_nodes(lists)
        k = self._kernel
        k["contact_force"], k["contact_stiffness"] = np.zeros((len(lists.node), 2)), np.zeros(len(lists.node))
        k["first_edge"], k["contact_edge"] = lists.first, lists.edge
        k["listed"], k["first_listed"] = np.zeros((len(lists.edge) + 1, 2)), np.zeros(len(lists.first))
        k["listed_x"], k["contact_margin"] = np.full((len(lists.node), 2), np.nan), MARGIN * self.skin

    @property
    def cross(self) -> bool:
        """Whether a segment of this rank crossed another outline since contacts were forgotten."""
        return bool(np.isinf(self._kernel["stiffest_contact"][0]))

    @property
    def depth(self) -> float:
        """How far surfaces of this rank reached into others since contacts were forgotten [µm], 0 if none did."""
        return float(self._kernel["deepest_contact"][0])

    def sharpest(self) -> tuple[float, int]:
        """In space, the least cosine [-] between the normals of both faces at an edge near another cell, and the id of
        a particle of that edge; 1 and -1 if there is none.
        """
        lists = self.lists
        if not isinstance(lists, TriangleLists) or not len(lists.edge):
            return 1.0, -1
        p, q, left, right = self._state.x(self._kernel["contact_node"][lists.edge]).transpose(1, 0, 2)
        one, other = np.cross(q - p, left - p), np.cross(right - p, q - p)
        product = np.linalg.norm(one, axis=1) * np.linalg.norm(other, axis=1)
        cosine = (one * other).sum(axis=1) / np.maximum(product, 1e-300)
        at = int(cosine.argmin())
        return float(cosine[at]), int(self._state.numbering.ids[self._kernel["contact_node"][lists.edge[at, 0]]])

    def displaced(self) -> float:
        """Largest displacement of this rank's surface particles since the lists were made [µm]."""
        moved = self._state.u[self._part.at_surface] - self.renewed_at
        with np.errstate(over="ignore"):  # of a run that fails, which is told
            return float(np.linalg.norm(moved, axis=1).max(initial=0.0))
