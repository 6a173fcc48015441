"""Equation (2) on one rank, M u'' = F_body + F_cs + F_cc + F_d - F_int, with ghosts of particles of other ranks."""

from __future__ import annotations

import math
from dataclasses import replace
from time import process_time
from typing import NamedTuple

import numpy as np

from petsc4py import PETSc

from ..kernel.kernel import Kernel
from ..kernel.terms import rubs
from ..meshfree.boundary import Boundary
from ..meshfree.division import divisible
from ..meshfree.scene import Scene
from ..meshfree.terms import Terms
from ..parallel.collect import Arrays
from ..parallel.owners import Owners
from ..parallel.reduce import global_maximum, largest
from ..parallel.shared import working_time
from ..parallel.swarm import Swarm
from .accounts import ACCOUNTS, Accounts
from .director import Director
from .ligand import Ligand
from .loads import Loads
from .medium import Immersed
from .modes import Modes
from .network import Network
from .protrusion import Drives, Protruding, Protrusion
from .rubbing import Rubbing
from .segments import Segments
from .state import State
from .subdomain import Subdomain
from .taut import Taut, changes
from .undo import Times, Undo

LOOK = 64  # parts of a step from one look at whether directors rest to the next
RESTS = 1e-13  # change of a director in such a part, at which it rests [-]


class Extremes(NamedTuple):
    """Extremes over some steps and all ranks.

    displaced : largest displacement of surface particles since the lists were made [µm];  gap : least to the substrate
    [µm];  contact : largest stiffness over the mass of contacts between cells [1/µs²], infinite where surfaces cross;
    J_min, J_max : [-].
    """

    displaced: float
    gap: float
    contact: float
    J_min: float
    J_max: float


FIELDS = (*State.FIELDS, *Segments.FIELDS, *Loads.FIELDS, *Modes.FIELDS, *Network.FIELDS, *Director.FIELDS,
          *Protrusion.FIELDS, *Immersed.FIELDS, *Rubbing.FIELDS, *Ligand.FIELDS, *Accounts.FIELDS)


class Mechanics:
    """The parts of a rank's mechanics, and the calls of a step.

    Attributes
    ----------
    scene, terms, surfaces, comm, ids, n_owned : those of `part`, a Subdomain.
    kernel : Kernel -- the compiled step.
    state : State -- displacements and velocities.
    segments : Segments -- of surfaces, and search lists.
    modes : Modes -- the mode that limits the step.
    taut : Taut -- stiffness of the cortex; None where its tension is the same at all stretches.
    loads : Loads -- supports, loads and plates.
    network : Network -- None if no material has one.
    director : Director -- None if no term depends on it.
    protrusion : Protrusion -- None without.
    immersed : Immersed -- None without a medium.
    rubbing : Rubbing -- None without friction.
    ligand : Ligand -- None where the density of bonds to the substrate is the same everywhere.
    accounts : Accounts -- dissipation, work, impulses.
    times : Times -- of the previous step.
    undo : Undo -- copy of an earlier state.
    renewals : int -- how often neighbours were found anew: see `renewal.renew`.
    renewal_loss : float -- energy that was lost then [pN].
    divisible : (cells,) bool -- cells whose surface may then be divided anew.
    working : float -- CPU time of this rank in steps of leapfrog without waiting for others [s].
    """

    def __init__(self, owners: Owners, terms: Terms, boundary: Boundary, protruding: Protruding, swarm: Swarm):
        """Begin with the particles of a `swarm` in the scene of the `owners`; collective."""
        scene = owners.scene
        self.terms, self.comm = terms, swarm.comm
        self._boundary, self._protruding, self._owners = boundary, protruding, owners
        self.kernel = Kernel(scene.materials, terms, FIELDS)
        self.renewals, self.renewal_loss = 0, 0.0
        self.working, self._clock = 0.0, working_time if swarm.comm.size > 1 else process_time
        self.divisible = divisible(scene, boundary) & (not terms.director_acts)
        self._make(scene)
        self._load(swarm)
        self.prescribe(0.0)
        self.renew_lists()
        self.kernel("deformation")
        self.begin_step()

    def _make(self, scene: Scene) -> None:
        """Make all parts for a scene, at rest; collective."""
        self.scene, terms, kernel = scene, self.terms, self.kernel
        owners = replace(self._owners, scene=scene)
        self.part = part = Subdomain.of(self.comm, owners, terms, self._protruding.cells)
        self.surfaces, self.n_owned, self.ids = part.surfaces, part.n_owned, part.ids
        self.state = State(part, kernel)
        self.segments = Segments(part, kernel, self.state)
        self.modes = Modes(part, kernel)
        self.taut = Taut(terms.cortex, part, kernel, self.state) if changes(terms.cortex) else None
        self.loads = Loads(part, kernel, self._boundary)
        self.state.set_blocks(np.concatenate([part.numbering.local(self.surfaces.ids), self.loads.loaded]))
        self.network = Network(part, kernel, self.state) if terms.network else None
        self.director = Director(part, kernel, self.state) if terms.has_director else None
        self.protrusion = None if terms.protrusion is None else Protrusion(part, kernel, self.segments,
                                                                           self._protruding)
        self.immersed = Immersed(part, kernel) if terms.medium is not None else None
        self.rubbing = Rubbing(part, kernel) if rubs(terms) else None
        self.ligand = Ligand(part, kernel, self.segments) if terms.ligand is not None else None
        self.accounts = Accounts(part, kernel, self.segments)
        self.times, self.undo = Times(), Undo()

    def remake(self, scene: Scene) -> None:
        """Make all parts again, at rest, for the same particles with other neighbours; collective."""
        skin = self.segments.skin
        self.destroy()
        self._make(scene)
        self.segments.skin = skin
        self.kernel("deformation")

    def _load(self, swarm: Swarm) -> None:
        """Copy state and accounts from the swarm, whose particles are ordered by id."""
        at = np.searchsorted(swarm["id"], self.ids)
        self.state.owned[:] = np.hstack([swarm["u"], swarm["v"]])[at]
        for i, name in enumerate(ACCOUNTS):
            self.accounts.of_particles[name][:] = swarm["loss"][at, i]
        if self.director is not None:
            self.director.start(swarm["director"][at])
        self.state.exchange()

    def begin_from(self, arrays: Arrays) -> None:
        """Begin with directors (size, 2 m) [rad], [-] and networks (size, d²) [-] of a checkpoint, as far as they are
        in `arrays`; without them bonds of networks form where particles are.  Collective.
        """
        name = "particle director"
        if self.director is not None and name in arrays.names:  # anchors keep their angles at the case's start
            self.director.set(np.split(arrays.rows(name, self.ids), 2, axis=1)[0])
        if self.network is not None:
            name = "particle network"
            self.network.begin_from(arrays.rows(name, self.part.row_ids) if name in arrays.names else None)

    def store(self, swarm: Swarm) -> None:
        """Copy state and accounts to the swarm."""
        inverse = np.argsort(np.searchsorted(swarm["id"], self.ids))
        swarm["u"], swarm["v"] = self.state.u[inverse], self.state.v[inverse]
        swarm["loss"] = np.column_stack(list(self.accounts.of_particles.values()))[inverse]
        if self.director is not None:
            swarm["director"] = self.director.values[inverse]

    def renew_lists(self) -> None:
        """Make search lists, and ghosts of cells within reach, for the current positions; collective."""
        self.segments.renew()
        if self.ligand is not None:
            self.ligand.renew()
        if self.protrusion is not None:
            self.protrusion.renew()
        if self.segments.lists is not None:
            self.accounts.impulses.follow(self.segments.lists)

    # ------------------------------------------------------------ the step

    def set_clock(self, time: float, origin: float = 0.0, steps: int = 0) -> None:
        """Set the time [µs] of pushes, supports, loads and plates, `steps` equal steps after an `origin` [µs]."""
        self.loads.set_clock(time, origin, steps)
        if self.protrusion is not None:
            self.protrusion.set_clock(time, origin, steps)

    @property
    def protruding(self) -> np.ndarray:
        """Which cells protrude (cells,) bool."""
        return self._protruding.cells

    def drive(self, drives: Drives) -> None:
        """Push as `drives` say from their time on."""
        self._protruding = self._protruding._replace(drives=drives)
        if self.protrusion is not None:
            self.protrusion.drive(drives)

    def prescribe(self, time: float) -> None:
        """Move supports to their positions at a time [µs], with their velocities; collective."""
        self.set_clock(time)
        if self.loads.there:
            self.kernel("prescribe")
            self.state.exchange()

    def advance(self, n: int, dt: float, gap: float = 0.0, share: float = 1.0) -> None:
        """Take `n` steps of `dt` [µs] of leapfrog; collective.

        gap : expected least gap between cells [µm];  share : of the way that surfaces may slip while pieces of contact
        serve [-], to time steps that are too short.

        Raises PETSc.Error where an exchange of ghosts failed.
        """
        self.resume()
        t, begin = self.times, self._clock()
        self.segments.serve(share, gap)
        try:
            failed = self.kernel("advance", n, float(dt), float(t.F_lag), float(t.accounted_dt), float(t.dt_prev))
        finally:  # ^C in a program of one's own comes after the call
            self.segments.serve(0.0)
        if failed:
            raise PETSc.Error(75)
        self.working += self._clock() - begin
        t.accounted_dt = 0.5 * (t.dt_prev + dt) if n == 1 else dt
        t.F_lag = t.dt_prev = dt

    def rate(self, since: float | None = None) -> np.ndarray:
        """(v, a) of the owned particles (n_owned, 2 d) [µm/µs, µm/µs²] in the current state; collective.

        Updates F, reactions and loads.  Raises PETSc.Error where an exchange of ghosts failed.

        since : within a step of an integrator other than leapfrog, time since its begin [µs].
        """
        out = np.zeros((self.n_owned + 4, 2 * self.scene.dimension))
        self.state.exchange()
        if since is not None and self.network is not None:
            self.network.reach(since)
        if self.kernel("rate", out, float(self.times.F_lag), float(self.times.accounted_dt)):
            raise PETSc.Error(75)
        self.times.F_lag = self.times.accounted_dt = 0.0
        return out[: self.n_owned]

    def begin_step(self) -> None:
        """Begin a step of an integrator other than leapfrog, in the state for which F is current."""
        if self.network is not None:
            self.network.begin()

    def end_step(self, dt: float, relaxing: float = math.inf) -> None:
        """End a step of `dt` [µs] of an integrator other than leapfrog, and begin the next; collective.

        Networks are renewed; directors, which were still within the step, relax in parts of at most `relaxing` [µs].
        Raises PETSc.Error where an exchange of ghosts failed.
        """
        if self.network is not None:
            self.network.reach(dt)
            self.kernel("deformation")
            self.network.renew()
        if self.director is None or self.terms.director != "relaxing":
            return
        parts = math.ceil(dt / relaxing) or 1  # millions in a step of seconds
        for part in range(parts + 1):  # in the last one only the loss is completed
            before = self.director.values.copy() if part % LOOK == LOOK - 1 else None
            torque = self.director.torques.copy()
            self.relax_director(dt / parts if part < parts else 0.0)
            if part:  # by the torques at both ends: those at the start alone would take twice of what decays at once
                self.kernel("complete_loss", torque, dt / parts)
            if before is not None and largest(self.comm, self.director.values - before) < RESTS:
                return  # it is at rest for the shape at the end of the step

    def relax_director(self, dt: float) -> None:
        """Relax the director by dt [µs], for integrators that keep it constant within a step; collective.

        Raises PETSc.Error where an exchange of ghosts failed.
        """
        if self.kernel("relax_director", float(dt)):
            raise PETSc.Error(75)

    # ------------------------------------------------------------ back to an earlier state

    def changing(self) -> dict[str, np.ndarray]:
        """Writable arrays that steps change, by name, of any shape and unit."""
        n_local = len(self.state.array)
        found = self.state.changing | self.accounts.changing(n_local) | self.loads.changing(n_local)
        found |= self.network.by_block if self.network is not None else {}
        found |= self.protrusion.changing if self.protrusion is not None else {}
        found |= self.immersed.changing if self.immersed is not None else {}
        found |= self.rubbing.changing if self.rubbing is not None else {}
        return found | (self.director.changing if self.director is not None else {})

    def save(self) -> None:
        """Copy the state, so that `go_back` can undo later steps."""
        self.undo.save(self.changing(), self.times)

    def go_back(self) -> None:
        """Undo the steps since `save`."""
        self.undo.restore(self.changing(), self.times)

    def set_aside(self) -> None:
        """Copy the state before output, which updates F and accounts; `resume` restores it, so that bits do not depend
        on outputs.  Before the first step there is nothing to restore.
        """
        if not self.undo.aside and self.times.dt_prev:
            self.save()
            self.undo.aside = True

    def resume(self) -> None:
        """Restore the state that `set_aside` copied."""
        if self.undo.aside:
            self.undo.aside = False
            self.undo.restore(self.changing(), self.times, but=KEPT)

    # ------------------------------------------------------------ step control

    def meet(self) -> None:
        """Evaluate bonds where the surfaces are now, for `extremes`: the last step left from where they were before."""
        for term, law in (("substrate", self.terms.substrate), ("contact", self.terms.contacts)):
            if law is not None:
                self.surface_force(term)

    def extremes(self) -> Extremes:
        """Extremes since the last call, of contacts since they were forgotten; collective."""
        top = global_maximum(self.comm, np.array([self.segments.displaced(), *self.state.extremes()])).tolist()
        return Extremes(top[0], -top[1], top[2], -top[3], top[4])

    def limits(self) -> dict[str, float]:
        """Limits of the step over all ranks; collective.

        By name: local bounds of viscous [1/µs] and elastic [1/µs²] stiffness, J_min, J_max [-], speed [µm/µs], rate of
        deformation [1/µs], the largest displacement of surface particles since the lists were made [µm], and, of a
        cortex whose tension changes, a bound of its stiffness, the "cortex" [1/µs²], which the modes take over.
        """
        own = np.zeros(6)
        self.kernel("limits", own)
        names = ["viscous", "elastic", "J_min", "J_max", "speed", "strain_rate", "displaced"]
        values = [own[0], own[1], -own[2], *own[3:], self.segments.displaced()]
        if self.taut is not None:
            self.modes.taut = self.taut.frequencies()
            names.append("cortex")
            values.append(self.modes.taut.max(initial=0.0))
        top = global_maximum(self.comm, np.array(values))
        top[2], top[4:6] = -top[2], np.sqrt(top[4:6])
        return dict(zip(names, top.tolist(), strict=True))

    def worst_particle(self, known: int | None = None) -> tuple[int, float]:
        """Global id and J [-] of the particle with the largest |ln J|, or not finite, or of a known id; collective."""
        J = self.state.J_of_rows[: self.n_owned]
        J = np.where(np.isfinite(J) & np.isfinite(self.state.owned).all(axis=1), J, -np.inf)
        share = np.minimum(J, 1.0 / np.maximum(J, 1e-300))  # J or 1/J, whichever is below 1
        if known is not None:
            share = np.where(self.ids == known, share, np.inf)
        i = int(np.argmin(share)) if len(J) else -1
        found = (float(share[i]), int(self.ids[i]), float(J[i])) if i >= 0 else (np.inf, -1, np.inf)
        _, particle, worst = min(self.comm.allgather(found))
        return particle, worst

    # ------------------------------------------------------------ output

    def powers(self) -> dict[str, np.ndarray]:
        """Rates of the accounts by name in the current state: see `Accounts.rates`; collective."""
        if self.loads.there:
            self.rate()  # for the reactions
        return self.accounts.rates()

    def surface_force(self, term: str) -> tuple[np.ndarray, np.ndarray]:
        """Force (n_owned, d) [pN/µm] and energy (n_owned,) [pN] of one of SURFACE_TERMS, by its name."""
        force, energy = np.zeros((self.part.capacity, self.scene.dimension)), np.zeros(self.part.capacity)
        self.kernel(f"add_{term}", force, energy, 0.0, 0.0)
        return force[: self.n_owned], energy[: self.n_owned]

    def stabilisation_energy(self) -> np.ndarray:
        """Energy of the elastic stabilisation (n_owned,) [pN]."""
        out = np.zeros(self.n_owned)
        if self.terms.stiffened:
            self.kernel("stiffness_energy", out)
        return out

    def missed_energy(self) -> np.ndarray:
        """Energy of the director that nodal integrals miss (n_owned,) [pN µm], in space."""
        return self.director.missed_energy() if self.director is not None else np.zeros(self.n_owned)

    def grades(self) -> np.ndarray | None:
        """Elastic moduli of the rows over those of the laws (n_rows,) [-]; None where they are those."""
        return self.part.rows.field("grades") if self.terms.graded else None

    def internal_fields(self) -> dict[str, np.ndarray]:
        """What laws take of the rows besides F and Ḟ, by their names there: those of network and director."""
        return {name: values for part in (self.network, self.director) if part is not None
                for name, values in part.of_rows().items()}

    def destroy(self) -> None:
        """Free the PETSc objects."""
        for field in (self.state, self.modes, self.director):
            if field is not None:
                field.destroy()


# Not restored after output, which leaves the state as it is, and after which impulses begin anew for the next row.
KEPT = ("state", "bond_impulse", "contact_impulse")
