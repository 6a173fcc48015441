"""Equation (2) on one rank, M u'' = F_body + F_cs + F_cc + F_d - F_int, with ghosts of what others own."""

from __future__ import annotations

from typing import Any

import numpy as np

from mpi4py import MPI
from petsc4py import PETSc

from ..kernel.fields import FIELDS
from ..kernel.kernel import Kernel, aligned_zeros
from ..kernel.layout import make_blocks, number, stencil_arrays
from ..meshfree.body import Scene
from ..meshfree.boundary import Boundary
from ..meshfree.contact import ContactLists, Surfaces, contact_lists
from ..meshfree.terms import Terms
from ..parallel.ghosts import GhostedField
from ..parallel.reduce import exact_sum, global_maximum
from ..parallel.swarm import Swarm
from .accounts import ACCOUNTS, Impulses, rates
from .director import Director
from .push import Push, depth
from .surface_exchange import SurfacePlaces
from .undo import Undo

SKIN = 0.85  # spacings by which surfaces may approach each other before the search lists are made anew


class Mechanics:
    """State, forces and accounts of a rank's particles.

    state : GhostedField (n_local, 4) -- (ux, uy, vx, vy) [µm, µm/µs];  solution : Vec -- its owned part, for TS;
    theta : Director or None -- their angles;  kernel : the compiled step;  ids : (n_owned,) -- global ids in local
    order;  impulses : of bonds and contacts since the last row of the tables;
    dt_prev : the previous step [µs], at whose middle the velocities are;  F_lag : time since F was updated [µs];
    accounted_dt : time for whose work the forces at its end are still missing [µs].
    """

    def __init__(self, scene: Scene, terms: Terms, boundary: Boundary, swarm: Swarm, owner: np.ndarray, comm: MPI.Comm,
                 director: Any, alpha: np.ndarray, protruding: np.ndarray):
        """`swarm` holds this rank's particles; `owner` (size,) ranks; `protruding` (cells,) bool, `alpha` of these."""
        self.scene, self.terms, self.boundary, self.comm, self.law = scene, terms, boundary, comm, director
        self.surfaces = Surfaces.of(scene)
        self._owner = owner
        self.place_in_petsc = np.empty(scene.size, np.int64)
        self.place_in_petsc[np.lexsort((np.arange(scene.size), owner))] = np.arange(scene.size)
        self._number(swarm["id"], protruding if terms.protrusion is not None else np.zeros_like(protruding))
        self.kernel = Kernel(scene.materials, terms, FIELDS)
        self._fill_rows()
        self._fill_surfaces(alpha)
        if terms.load_curves is not None:
            boundary.fill(self.kernel, self.base, self.surfaces.ids[self._mine], self._capacity)
        self._mark_loaded()
        self.theta = self._director()
        self._load(swarm)
        self._point_to_memory()
        self.prescribe(0.0)
        self.F_lag = self.accounted_dt = self.dt_prev = 0.0
        self.rebuilds, self.skin = 0, SKIN * min(t.spacing for t in scene.templates)
        self.undo = Undo(self)
        self.renew_lists()
        self.kernel("deformation")

    # ------------------------------------------------------------ layout

    def _number(self, owned: np.ndarray, protruding: np.ndarray) -> None:
        """Local numbers, and the memory of the state, with room for every surface particle as a ghost."""
        s = self.surfaces
        own = np.zeros(self.scene.size, bool)
        own[owned] = True
        touched = np.flatnonzero(own[s.ids] | own[s.ids[s.after]] | own[s.ids[s.before]])
        self.push = Push(s, protruding, own)
        around = np.concatenate([touched, s.after[touched], s.before[touched], self.push.surface])
        self.base = self.numbering = number(self.scene, owned, s.ids[around])
        self.n_owned = self.base.n_owned
        self.ids = self.base.ids[: self.n_owned]
        self._capacity = len(self.base.ids) + len(s.ids) + 8  # the kernel's last block may read past the end
        self._memory = aligned_zeros((self._capacity, 4))
        self._X = aligned_zeros((self._capacity, 2))
        self.solution = PETSc.Vec().createWithArray(self._memory[: self.n_owned].ravel(),
                                                    size=(4 * self.n_owned, None), bsize=4, comm=self.comm)
        self.state = GhostedField(self.comm, self._memory, self.n_owned, self.base.shared.sum())
        self._set_ghosts(self.base)

    def _set_ghosts(self, numbering: Any) -> None:
        """Copies of these particles from now on; collective."""
        self.numbering = numbering
        self._X[: len(numbering.ids)] = self.scene.X[numbering.ids]
        self.state.set_ghosts(self._in_petsc(numbering))
        self.state.exchange()

    def _in_petsc(self, numbering: Any) -> np.ndarray:
        """Ghosts by their numbers in PETSc's order (n_ghosts,)."""
        return self.place_in_petsc[numbering.ids[self.n_owned :]]

    def _fill_rows(self) -> None:
        k, scene, n_rows = self.kernel, self.scene, self.base.n_rows
        self.blocks = make_blocks(scene, self.base, self.terms)
        n_blocks = len(self.blocks.table)
        k["n_owned"], k["n_rows"] = self.n_owned, n_rows
        k["n_shared_blocks"], k["n_owned_blocks"], k["n_blocks"] = self.blocks.n_shared, self.blocks.n_owned, n_blocks
        for name, values in stencil_arrays(scene, self.base, self.blocks, self.terms).items():
            k[name] = values
        k["inverse_mass"] = 1.0 / scene.field("mass")[self.base.ids[:n_rows]]
        for name in ACCOUNTS:
            k[name] = np.zeros(self._capacity)
        k["step_memory"] = np.zeros((n_blocks, k.library.step_memory_size() // 8))
        k["F"], k["Q"] = np.zeros((n_blocks, 4, 4)), np.zeros((self._capacity, 4))
        k["force"] = np.zeros((self._capacity, 2))
        k["least_gap"], k["J_range"] = np.full(2, np.inf), NO_VOLUMES.copy()
        k["bound"] = scene.field("bound")[self.ids]
        k["viscous_weight"] = scene.field("viscous_weight")[self.ids]
        k["elastic_weight"] = scene.field("elastic_weight")[self.ids]
        k["acceleration"] = self.terms.acceleration or (0.0, 0.0)
        k["X"] = self._X
        if self.comm.size > 1:
            k["ghost_begin"], k["ghost_end"] = self.state.exchange_functions

    def _fill_surfaces(self, alpha: np.ndarray) -> None:
        """Segments with an end of this rank, or of a cell whose push needs them, in global order."""
        k, s = self.kernel, self.surfaces
        own = self.base.local(s.ids)
        own = (own >= 0) & (own < self.n_owned)
        self._is_mine, self._mine = own, np.flatnonzero(own)
        self._at = self.base.local(s.ids[self._mine])
        self.places = SurfacePlaces(self.comm, s, self._owner[s.ids], self._mine)
        acts = own | own[s.after]
        there = acts.copy()
        there[self.push.surface] = True
        self._segments = np.flatnonzero(there)
        self._acts = acts[self._segments]
        k["segment"] = self.base.local(s.ids[np.column_stack([self._segments, s.after[self._segments]])])
        k["length"], k["n_segments"] = s.length[self._segments], len(self._segments)
        self.impulses = Impulses(k, s, own, self._segments)
        if self.terms.substrate is not None:
            k["substrate_bonds"], k["substrate_floor"] = self.terms.substrate.bond_density, self.terms.substrate.cap
            k["substrate_depth"] = depth(self.terms.substrate)
        if self.terms.contact is not None:
            c = self.terms.contact
            k["contact_bonds"], k["contact_floor"], k["contact_cutoff"] = c.bond_density, c.cap, c.cutoff
        if self.terms.protrusion is not None:
            self.push.fill(k, self.base, self.terms.protrusion, self.terms.substrate.work, alpha, self._segments,
                           self._acts)

    def _mark_loaded(self) -> None:
        """The blocks of rows on which more than stresses may act: of surfaces, and of what is loaded."""
        at = self.base.local(self.surfaces.ids)
        if self.terms.load_curves is not None:
            at = np.append(at, self.kernel["loaded"])
        loaded = np.zeros(self.base.n_rows, bool)
        loaded[at[(at >= 0) & (at < self.base.n_rows)]] = True
        block, _ = self.blocks.lanes_of
        any_of = np.bincount(block, loaded, len(self.blocks.table)) > 0
        self.kernel["block"] = np.column_stack([self.blocks.table, any_of])

    def _director(self) -> Director | None:
        """The director field, if its gradient or its axis matters."""
        if self.terms.director == "none" and not self.terms.active:
            return None
        return Director(self.comm, self.scene, self.surfaces, self.base, self._in_petsc(self.base), self._capacity,
                        self.kernel, self.law)

    def _load(self, swarm: Swarm) -> None:
        """State and accounts from the swarm, whose particles stand by id."""
        at = np.searchsorted(swarm["id"], self.ids)
        self.state.owned[:] = np.hstack([swarm["u"], swarm["v"]])[at]
        for i, name in enumerate(ACCOUNTS):
            self.kernel[name][: self.n_owned] = swarm["loss"][at, i]
        if self.theta is not None:
            self.theta.start(swarm["theta"][at])
        self.state.exchange()

    def store(self, swarm: Swarm) -> None:
        """State and accounts back to the swarm."""
        at = np.searchsorted(swarm["id"], self.ids)
        inverse = np.argsort(at)
        swarm["u"], swarm["v"] = self.state.owned[inverse, :2], self.state.owned[inverse, 2:]
        swarm["loss"] = np.column_stack([self.kernel[name][: self.n_owned] for name in ACCOUNTS])[inverse]
        if self.theta is not None:
            swarm["theta"] = self.theta.owned[inverse, 0]

    # ------------------------------------------------------------ search lists

    def own_surfaces(self) -> np.ndarray:
        """Current positions of this rank's surface particles [µm]."""
        return self._X[self._at] + self._memory[self._at, :2]

    def surface_positions(self) -> np.ndarray:
        """Current positions of all surface particles of the scene (m, 2) [µm]; collective."""
        return self.places.everywhere(self.own_surfaces())

    def renew_lists(self) -> None:
        """Search lists, ghosts of cells in reach and the front halves, for the positions as they are; collective."""
        s, k, t = self.surfaces, self.kernel, self.terms
        self.rebuilds += 1
        self._renewed_at = self._memory[self._at, :2].copy()
        if t.substrate is None and t.contact is None:
            self._point_to_memory()
            return
        x2 = self.segments()[1]
        longest = np.linalg.norm(x2[:, 1] - x2[:, 0], axis=1).max(initial=0.0)
        longest = float(global_maximum(self.comm, np.array([longest]))[0])
        # A segment may stretch by a fifth until the next renewal.
        reach = t.contact.cutoff + 1.2 * longest + self.skin if t.contact is not None else 0.0
        x, around = self.places.near(self.own_surfaces(), reach + 0.5 * longest)
        ends = np.column_stack([self._segments, s.after[self._segments]])
        if t.substrate is not None:
            depth = max(t.substrate.cutoff, t.protrusion.height if t.protrusion is not None else 0.0)
            low = (x[ends, 1].min(axis=1) < depth + self.skin) & s.outer[self._segments]
            near = np.flatnonzero(low & self._acts)
            k["near"], k["n_near"] = near, len(near)
        if t.protrusion is not None:
            self.push.renew(k, low)
        if t.contact is not None:
            self._renew_contact(contact_lists(s, x, reach + 0.5 * longest, self.skin, around))
        self._point_to_memory()

    def _renew_contact(self, lists: ContactLists) -> None:
        """Those that act on this rank's particles, of all that are near."""
        s, k = self.surfaces, self.kernel
        lists = lists.needed(s, self._is_mine)
        numbering = self.base.extended(s.ids[lists.involved(s)])
        same = np.array_equal(numbering.ids, self.numbering.ids)
        if not self.comm.allreduce(same, MPI.LAND):
            self._set_ghosts(numbering)

        def local(surface: np.ndarray) -> np.ndarray:
            return numbering.local(s.ids[surface])

        c = lists.candidate
        k["n_contact_nodes"], k["contact_node"] = len(lists.node), local(lists.node)
        k["first_candidate"] = lists.first
        k["candidate"] = local(np.column_stack([s.before[c], c, s.after[c], s.after[s.after[c]]]))
        k["n_contact_segments"], k["contact_segment"] = len(lists.segment), lists.segment
        k["contact_length"] = s.length[lists.node[lists.segment[:, 0]]]
        k["contact_pull"] = np.zeros(len(lists.node))
        self.impulses.follow(lists)
        self.closest_point = np.zeros(len(lists.node), CLOSEST_POINT)
        k["closest_point"] = self.closest_point.ctypes.data
        self.lists = lists

    def _point_to_memory(self) -> None:
        k = self.kernel
        k["n_local"] = len(self.numbering.ids)
        k["state"] = self._memory
        k["state_vec"] = self.state.handle

    def displaced(self) -> float:
        """Largest displacement of this rank's surface particles since the lists were made [µm]."""
        return float(np.linalg.norm(self._memory[self._at, :2] - self._renewed_at, axis=1).max(initial=0.0))

    def lists_are_late(self) -> bool:
        """Whether surfaces moved further than the search lists allow; collective."""
        return bool(global_maximum(self.comm, np.array([self.displaced()]))[0] > 0.5 * self.skin)

    # ------------------------------------------------------------ the step

    def set_clock(self, time: float, origin: float = 0.0, steps: int = 0) -> None:
        """Supports, loads and plates are those at a time [µs] from now on, `steps` equal steps after an `origin`."""
        if self.terms.load_curves is not None:
            self.kernel["clock"][:] = time, origin, steps

    def prescribe(self, time: float) -> None:
        """Supports move to where they are at a time [µs], with the velocity they have there; collective."""
        if self.terms.load_curves is not None:
            self.set_clock(time)
            self.kernel("prescribe")
            self.state.exchange()

    def advance(self, n: int, dt: float) -> None:
        """`n` steps of `dt` [µs] of the symplectic scheme, in place; collective."""
        self.undo.take_up()
        if self.kernel("advance", n, float(dt), float(self.F_lag), float(self.accounted_dt), float(self.dt_prev)):
            raise PETSc.Error(75)
        self.accounted_dt = 0.5 * (self.dt_prev + dt) if n == 1 else dt
        self.F_lag = self.dt_prev = dt

    def changing(self) -> dict[str, np.ndarray]:
        """What steps change, by name: state, F, step memory, accounts, clock."""
        there = {"F": True, "step_memory": True, "pushed": self.terms.protrusion is not None,
                 **dict.fromkeys(("clock", "load_before"), self.terms.load_curves is not None)}
        found = {"state": self._memory, **{name: self.kernel[name] for name, is_there in there.items() if is_there},
                 **{name: self.kernel[name] for name in (*ACCOUNTS, "bond_impulse", "contact_impulse")}}
        return found | ({"theta": self.theta.memory} if self.theta is not None else {})

    def least_gaps(self) -> np.ndarray:
        """Least gaps to the substrate and between cells since this was last asked (2,) [µm]; collective."""
        least = -global_maximum(self.comm, -self.kernel["least_gap"])
        self.kernel["least_gap"][:] = np.inf
        return least

    def volumes(self) -> tuple[float, float]:
        """Least and largest J [-] in all steps since this was last asked, but those undone; collective."""
        low, high = self.kernel["J_range"].reshape(2, 4)
        least, most = global_maximum(self.comm, np.array([-low.min(), high.max()]))
        self.kernel["J_range"][:] = NO_VOLUMES
        return -float(least), float(most)

    def rate(self) -> np.ndarray:
        """(v, a) of the owned particles (n_owned, 4) for the state as it is; brings F up to date; collective."""
        out = np.zeros((self.n_owned + 4, 4))
        self.state.exchange()
        if self.kernel("rate", out, float(self.accounted_dt)):
            raise PETSc.Error(75)
        self.F_lag = self.accounted_dt = 0.0
        return out[: self.n_owned]

    def relax_director(self, dt: float) -> None:
        """The director alone goes on by dt [µs], for integrators that hold it still within a step; collective."""
        if self.terms.director == "relaxing" and self.kernel("relax_director", float(dt)):
            raise PETSc.Error(75)

    def powers(self) -> dict[str, np.ndarray]:
        """Rates of the accounts, by name, for the state as it is; collective."""
        if self.terms.load_curves is not None:
            self.rate()  # for the reactions
        return rates(self)

    def tensors(self) -> tuple[np.ndarray, np.ndarray]:
        """F and Ḟ of the rows, owned first, (2, 2, n_rows) each [-], [1/µs]; current after `rate`."""
        rates = np.zeros_like(self.kernel["F"])
        self.kernel("velocity_gradient", rates)
        return tuple(self.by_row(a).reshape(-1, 2, 2).transpose(2, 1, 0) for a in (self.kernel["F"], rates))

    def by_row(self, blocks: np.ndarray) -> np.ndarray:
        """Values that the kernel keeps by blocks, (n_blocks, k, 4), as (n_rows, k)."""
        block, lane = self.blocks.lanes_of
        return blocks[block, :, lane]

    def surface_force(self, term: str) -> tuple[np.ndarray, np.ndarray]:
        """Force (n_owned, 2) [pN/µm] and energy (n_owned,) [pN] of a term: a key of SURFACE_FORCES."""
        force, energy = np.zeros((self._capacity, 2)), np.zeros(self._capacity)
        function, *arguments = SURFACE_FORCES[term]
        self.kernel(function, force, *(energy if a is ENERGY else a for a in arguments))
        return force[: self.n_owned], energy[: self.n_owned]

    def stabilisation_energy(self) -> np.ndarray:
        """Energy of the elastic stabilisation (n_owned,) [pN]."""
        out = np.zeros(self.n_owned)
        if self.terms.stiffened:
            self.kernel("stiffness_energy", out)
        return out

    def segments(self) -> tuple[np.ndarray, np.ndarray]:
        """Surface segments that start at a particle of this rank: local ends (e, 2), current ends (e, 2, 2) [µm]."""
        ends = self.kernel["segment"]
        ends = ends[ends[:, 0] < self.n_owned]
        return ends, self._X[ends] + self._memory[ends, :2]

    def limits(self) -> dict[str, Any]:
        """Over all ranks: local bounds of viscous and elastic stiffness, extremes of J, speed, displacement."""
        own = np.zeros(6)
        self.kernel("limits", own)
        names = ("viscous", "elastic", "J_min", "J_max", "speed", "displaced")
        values = np.array([own[0], own[1], -own[2], own[3], own[4], self.displaced()])
        top = global_maximum(self.comm, values)
        top[2], top[4] = -top[2], np.sqrt(top[4])
        return dict(zip(names, top.tolist(), strict=True))

    def worst_particle(self, known: int | None = None) -> tuple[int, float]:
        """Global id and J of the one whose J is furthest from 1, or not finite, or one that is known; collective."""
        F = self.by_row(self.kernel["F"])[: self.n_owned]
        J = F[:, 0] * F[:, 3] - F[:, 1] * F[:, 2]
        J = np.where(np.isfinite(J) & np.isfinite(self.state.owned).all(axis=1), J, -np.inf)
        share = np.minimum(J, 1.0 / np.maximum(J, 1e-300))  # J or 1/J, whichever is below 1
        if known is not None:
            share = np.where(self.ids == known, share, np.inf)
        i = int(np.argmin(share)) if len(J) else -1
        found = (float(share[i]), int(self.ids[i]), float(J[i])) if i >= 0 else (np.inf, -1, np.inf)
        return min(self.comm.allgather(found))[1:]

    def impulse(self) -> float:
        """Impulse of the protrusion so far [pN µs/µm]; collective."""
        return float(exact_sum(self.comm, self.kernel["protrusion_impulse"][: self.n_owned]))

    def destroy(self) -> None:
        """Free the PETSc objects."""
        for field in (self.state, self.theta):
            if field is not None:
                field.destroy()
        self.solution.destroy()


NO_VOLUMES = np.repeat([np.inf, -np.inf], 4)
ENERGY = object()  # stands for the array of energies
SURFACE_FORCES = {"substrate": ("substrate_adhesion", ENERGY, 0.0), "contact": ("cell_adhesion", ENERGY, 0.0),
                  "cortex": ("cortex_pull", ENERGY), "friction": ("bond_friction", 0.0),
                  "protrusion": ("protrude", None, None, 0.0, 0.0)}
CLOSEST_POINT = np.dtype([("gap", float), ("n", float, 2), ("t", float), ("a", np.int64), ("b", np.int64)])
