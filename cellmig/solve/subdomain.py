"""The subdomain of a rank: owned particles, ghosts, and the rows that it computes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mpi4py import MPI

from ..kernel.layout import Blocks, Numbering, make_blocks, number
from ..meshfree.body import Scene
from ..meshfree.contact import Surfaces
from ..meshfree.terms import Terms


@dataclass(frozen=True)
class Subdomain:
    """A rank's part of a scene, constant in a run but for ghosts of cells that come into contact.

    Attributes
    ----------
    scene, terms, surfaces : the same on all ranks.
    owner : (size,) int -- ranks of all particles.
    pushed : (k,) int -- all surface particles, ascending, of the protruding cells of which the rank has a part, or of
        all of them where they push off other bodies.
    numbering : Numbering -- local numbers of owned particles and ghosts, but for those of contacts.
    blocks : Blocks -- the rows that the kernel computes, in fours.
    """

    comm: MPI.Intracomm
    scene: Scene
    terms: Terms
    surfaces: Surfaces
    owner: np.ndarray
    pushed: np.ndarray
    numbering: Numbering
    blocks: Blocks

    @classmethod
    def of(cls, comm: MPI.Intracomm, scene: Scene, terms: Terms, owner: np.ndarray,
           protruding: np.ndarray) -> Subdomain:
        """The subdomain of this rank; `owner` (size,) int : ranks of the particles, `protruding` (cells,) bool."""
        s = Surfaces.of(scene)
        mine = owner[s.ids] == comm.rank
        near = np.isin(s.cell, s.cell[mine]) | (terms.pushes_off is not None)  # what they push off may be here
        pushed = np.flatnonzero(protruding[s.cell] & s.on_outside & near)
        around = np.concatenate([s.facets[s.touching(mine)].ravel(), pushed])
        numbering = number(scene, np.flatnonzero(owner == comm.rank), s.ids[around])
        return cls(comm, scene, terms, s, owner, pushed, numbering, make_blocks(scene, numbering))

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
        """Length of arrays by particle: every surface particle may become a ghost."""
        return len(self.numbering.ids) + len(self.surfaces.ids) + 8  # the kernel's last block may read past the end

    @cached_property
    def in_petsc(self) -> np.ndarray:
        """Numbers of all particles in PETSc's order, rank by rank (size,) int."""
        order = np.empty(self.scene.size, np.int64)
        order[np.lexsort((np.arange(self.scene.size), self.owner))] = np.arange(self.scene.size)
        return order

    @cached_property
    def on_surface(self) -> np.ndarray:
        """Whether surface particles belong to this rank (m,) bool."""
        return self.owner[self.surfaces.ids] == self.comm.rank

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
