"""Protocols of what output may read of a Mechanics."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from mpi4py import MPI

from ..kernel.layout import Numbering
from ..meshfree.boundary import Boundary
from ..meshfree.contact import Surfaces
from ..meshfree.scene import Particles, Scene
from ..meshfree.terms import Terms


class StateView(Protocol):
    """Displacements and velocities of the owned particles."""

    @property
    def u(self) -> np.ndarray:
        """Displacements (n_owned, 2) [µm]."""

    @property
    def v(self) -> np.ndarray:
        """Velocities (n_owned, 2) [µm/µs], of leapfrog half a step before."""

    def tensors(self) -> tuple[np.ndarray, np.ndarray]:
        """F [-] and Ḟ [1/µs] of the rows (2, 2, n_rows)."""

    def since_renewal(self) -> np.ndarray:
        """Deformation gradients (2, 2, n_owned) [-] of the owned particles since their neighbours were found."""


class PartView(Protocol):
    """Particles of this rank."""

    @property
    def numbering(self) -> Numbering:
        """Local numbers of particles."""

    @property
    def row_ids(self) -> np.ndarray:
        """Global ids of the rows (n_rows,), owned first."""

    @property
    def owned(self) -> Particles:
        """The owned particles (n_owned)."""

    @property
    def rows(self) -> Particles:
        """The particles whose stress is computed (n_rows), owned first."""

    def owned_numbers(self, ids: np.ndarray) -> np.ndarray:
        """Local numbers of global ids (k,); -1 where another rank owns the particle."""


class SegmentsView(Protocol):
    """Segments of surfaces."""

    def own_places(self) -> np.ndarray:
        """Positions of this rank's surface particles (k, 2) [µm]."""

    def owned(self) -> tuple[np.ndarray, np.ndarray]:
        """Segments that start on this rank: local ends (e, 2), positions (e, 2, 2) [µm]."""

    def touching(self, most: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Segments near other cells (s,) int: local first ends, these cells, lengths [µm] nearer than `most` ε [-]."""

    def sharpest(self) -> tuple[float, int]:
        """In space, the least cosine [-] of normals of faces at an edge near another cell, and a particle of it."""


class LoadsView(Protocol):
    """Supports, loads and plates."""

    boundary: Boundary

    def reactions(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Forces (k, 2) [pN/µm], owned particles (k,), numbers of the supports and plates (k,)."""


class ImpulsesView(Protocol):
    """Impulses of surfaces since the last row of the tables."""

    cells: int
    mine: np.ndarray
    place: np.ndarray
    key: np.ndarray

    @property
    def bond(self) -> np.ndarray:
        """Impulses by the substrate (n_facets, d, 2 d - 1) [pN µs/µm]."""

    @property
    def contact(self) -> np.ndarray:
        """Impulses by other cells (slots, 2) [pN µs/µm]."""

    def of_surface(self, values: np.ndarray) -> np.ndarray:
        """Values of bonds (n_facets, d, 2 d - 1) by surface particle (k, 3)."""

    def begin(self, x: np.ndarray, bond: np.ndarray, contact: np.ndarray) -> None:
        """Begin again with impulses bond (f, d, 2 d - 1), contact (slots, d) [pN µs/µm], at x (k, d - 1) [µm]."""


class AccountsView(Protocol):
    """Dissipation and work so far."""

    of_particles: dict[str, np.ndarray]

    @property
    def impulses(self) -> ImpulsesView:
        """Impulses of surfaces."""


class View(Protocol):
    """A Mechanics for output; everything is current after its `rate`."""

    comm: MPI.Intracomm
    scene: Scene
    terms: Terms
    surfaces: Surfaces
    ids: np.ndarray
    n_owned: int
    renewals: int
    renewal_loss: float

    @property
    def part(self) -> PartView:
        """Subdomain of this rank."""

    @property
    def state(self) -> StateView:
        """State of the particles."""

    @property
    def segments(self) -> SegmentsView:
        """Surface segments."""

    @property
    def loads(self) -> LoadsView:
        """Supports, loads and plates."""

    @property
    def accounts(self) -> AccountsView:
        """Accounts of energy and impulses."""

    @property
    def protruding(self) -> np.ndarray:
        """Which cells protrude (cells,) bool."""

    def grades(self) -> np.ndarray | None:
        """See `Mechanics.grades`."""

    def internal_fields(self) -> dict[str, np.ndarray]:
        """What laws take of the rows besides F and Ḟ, by their names there: network (d, d, n_rows) [-], gradients
        (m, d, n_rows) [1/µm] and axis (d, n_rows) [-] of the director; what the scene lacks is absent.
        """

    def missed_energy(self) -> np.ndarray:
        """Energy of the director that nodal integrals miss (n_owned,) [pN µm], in space."""

    def surface_force(self, term: str) -> tuple[np.ndarray, np.ndarray]:
        """Force (n_owned, 2) [pN/µm] and energy (n_owned,) [pN] of a term."""

    def stabilisation_energy(self) -> np.ndarray:
        """Energy of the elastic stabilisation (n_owned,) [pN]."""
