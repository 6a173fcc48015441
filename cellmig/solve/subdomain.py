"""The subdomain of a rank: owned particles, ghosts, and the rows that it computes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mpi4py import MPI

from ..kernel.layout import Blocks, Numbering, make_blocks, number
from ..meshfree.contact import Surfaces
from ..meshfree.scene import Particles, Scene
from ..meshfree.terms import Terms
from ..parallel.collect import fetched
from ..parallel.owners import Owners


@dataclass(frozen=True)
class Subdomain:
    """A rank's part of a scene, constant in a run but for ghosts of cells that come into contact.

    Attributes
    ----------
    scene, terms, owners : the same on all ranks.
    surfaces : Surfaces -- of the cells of which the rank has a part, or of all where cells push off other bodies.
    pushed : (k,) int -- all surface particles, ascending, of those of these cells that protrude.
    numbering : Numbering -- local numbers of owned particles and ghosts, but for those of contacts.
    blocks : Blocks -- the rows that the kernel computes, in fours.
    """

    comm: MPI.Intracomm
    scene: Scene
    terms: Terms
    owners: Owners
    surfaces: Surfaces
    pushed: np.ndarray
    numbering: Numbering
    blocks: Blocks

    @classmethod
    def of(cls, comm: MPI.Intracomm, owners: Owners, terms: Terms, protruding: np.ndarray) -> Subdomain:
        """The subdomain of this rank in the scene of the `owners`; `protruding` (cells,) bool."""
        scene, cells = owners.scene, owners.cells(comm.rank)
        s = Surfaces.of(scene, cells if terms.pushes_off is None else None)  # what they push off may be here
        mine = owners.of(s.ids) == comm.rank
        near = np.isin(s.cell, s.cell[mine]) | (terms.pushes_off is not None)
        pushed = np.flatnonzero(protruding[s.cell] & s.on_outside & near)
        around = np.concatenate([s.facets[s.touching(mine)].ravel(), pushed])
        numbering = number(scene, owners.ids(comm.rank), s.ids[around])
        return cls(comm, scene, terms, owners, s, pushed, numbering, make_blocks(scene, numbering))

    @property
    def n_owned(self) -> int:
        """Number of owned particles."""
        return self.numbering.n_owned

    @property
    def ids(self) -> np.ndarray:
        """Global ids of the owned particles (n_owned,) int, ascending."""
        return self.numbering.ids[: self.n_owned]

    @property
    def row_ids(self) -> np.ndarray:
        """Global ids of the particles whose stress is computed (n_rows,) int, owned first."""
        return self.numbering.ids[: self.numbering.n_rows]

    @property
    def capacity(self) -> int:
        """Length of arrays by particle: every surface particle may become a ghost; pages that are never written take no
        memory.
        """
        return len(self.numbering.ids) + int(self.scene.first_surface[-1]) + 8  # the last block may read past the end

    @cached_property
    def rows(self) -> Particles:
        """The particles whose stress is computed (n_rows), owned first."""
        return self.scene.particles(self.row_ids)

    @cached_property
    def owned(self) -> Particles:
        """The owned particles (n_owned)."""
        return self.scene.particles(self.ids)

    @cached_property
    def first(self) -> int:
        """Number of this rank's first particle in PETSc's order, which is rank by rank."""
        return int(self.comm.scan(self.n_owned)) - self.n_owned

    def in_petsc(self, numbering: Numbering) -> np.ndarray:
        """Numbers of the particles of a `numbering` in PETSc's order (n_local,) int; collective."""
        ghosts, first = numbering.ids[self.n_owned :], self.first
        theirs = fetched(self.comm, self.owners.of(ghosts), ghosts, lambda ids: first + np.searchsorted(self.ids, ids))
        return np.append(first + np.arange(self.n_owned), theirs)

    @cached_property
    def on_surface(self) -> np.ndarray:
        """Whether the particles of `surfaces` belong to this rank (m,) bool."""
        return self.owners.of(self.surfaces.ids) == self.comm.rank

    @cached_property
    def own_surface(self) -> np.ndarray:
        """Indices of this rank's surface particles in `surfaces` (k,) int."""
        return np.flatnonzero(self.on_surface)

    @cached_property
    def at_surface(self) -> np.ndarray:
        """Local numbers of this rank's surface particles (k,) int."""
        return self.numbering.local(self.surfaces.ids[self.own_surface])

    def owned_numbers(self, ids: np.ndarray) -> np.ndarray:
        """Local numbers of global `ids` (k,) int; -1 where another rank owns the particle."""
        at = self.numbering.local(ids)
        return np.where(at < self.n_owned, at, -1)
