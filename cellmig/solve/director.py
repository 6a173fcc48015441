"""The director of a rank's particles: angles or unit vectors with ghosts, their gradients, what they are at anchors."""

from __future__ import annotations

import numpy as np

from ..kernel.fields import Field
from ..kernel.kernel import Kernel, aligned_zeros
from ..model.director import numbers
from ..parallel.ghosts import GhostedField
from ..parallel.reduce import largest
from .anchors import Anchors
from .state import State
from .subdomain import Subdomain


class Director(GhostedField):
    """Directors of m numbers, an angle [rad] or a unit vector [-], then the torques on these, which each step updates.

    Attributes
    ----------
    memory : (capacity, 2 m) float -- of the field, padded for the kernel's last block [rad, pN], [-, pN µm].
    anchors : Anchors -- particles whose director follows the membrane.
    """

    FIELDS = (
        Field("director", "double *", "(n_local, 2 m)", "rad, pN or -, pN µm",
              "directors and torques on them; ghosts are exchanged in each step"),
        Field("director_vec", "void *", doc="what exchanges it: a Vec of PETSc or a `SharedCopies`"),
        Field("director_gradient", "double *", "(n_blocks, m d, 4)", "1/µm",
              "reference gradients of its numbers, one after the other, by lanes"),
        Field("director_axis", "double *", "(n_blocks, d, 4)", "-", "h, by lanes"),
        Field("director_bend", "double *", "(n_blocks, 3, 4)", "1/µm²", "in space Laplacians C h, by lanes"),
        Field("director_modulus", "double *", "(stencils, 4)", "pN µm⁵",
              "in space twice the energy that nodal integrals miss, over |C h|²"),
        Field("director_flux", "double *", "(n_rows, d) or (n_rows, 3, 4)", "pN µm, pN µm²",
              "V η F⁻¹ g, from the first pass to the second"),
        Field("director_mobility", "double *", "(n_owned,)", "1/(µs pN), 1/(µs pN µm)", "γ/(η V), 0 where it is held"),
        Field("director_weight", "double *", "(n_owned,)", "pN", "bound of the second derivative of η |g|²/2"),
        *Anchors.FIELDS,
    )

    def __init__(self, part: Subdomain, kernel: Kernel, state: State):
        """Begin with zeros; collective.  Without a director law the directors stay uniform."""
        d, self.numbers = part.scene.dimension, numbers(part.scene.dimension)
        self.memory = aligned_zeros((part.capacity, 2 * self.numbers))
        super().__init__(part.comm, self.memory, part.n_owned, part.numbering.shared.sum())
        self.set_ghosts(part.in_petsc(part.numbering)[part.n_owned :])
        self._kernel, self._state = kernel, state
        kernel["director"], kernel["director_vec"] = self.memory, self.handle
        kernel["director_gradient"] = np.zeros((len(part.blocks.table), self.numbers * d, 4))
        kernel["director_bend"] = np.zeros((len(part.blocks.table), 3, 4))
        kernel["director_axis"] = np.zeros((len(part.blocks.table), d, 4))
        kernel["director_flux"] = np.zeros((part.capacity, d if d == 2 else 12))
        self._modulus = part.owned.field("director_modulus")
        materials, law = part.scene.materials, part.terms.director_law
        eta, zeta = (np.array([getattr(m, name, 0.0) for m in materials]) for name in ("eta", "zeta"))
        V, stiffness, of_material = part.owned.field("V"), eta.max(), part.owned.material
        mobility = (law.mobility if law else 0.0) / (stiffness * V) if stiffness > 0 else np.zeros(len(V))
        # Bounds of the second derivatives of η |g|²/2 and of ζ, which add to the moduli that limit the step.
        kernel["director_weight"] = 3.0 * eta[of_material]
        state.stiffen(np.abs(zeta)[of_material])
        self.anchors = Anchors(part, kernel, law is not None and law.anchoring == "surface")
        held = self.anchors.owned
        mobility[held] = 0.0
        turning = stiffness / V if d == 2 else stiffness * part.owned.field("relaxation")
        state.stiffen(turning[held], held)  # of a turn of the membrane against the director
        kernel["director_mobility"] = mobility

    def start(self, directors: np.ndarray) -> None:
        """Set `directors` (n_owned, m) [rad], [-], whose angles to the membrane at rest anchors keep; collective."""
        self.set(directors)
        self.anchors.start(self.array[self.anchors.at, : self.numbers])

    def set(self, directors: np.ndarray) -> None:
        """Set `directors` (n_owned, m) [rad], [-] and their gradients, which a frozen one keeps; collective."""
        self.owned[:, : self.numbers] = directors.reshape(-1, self.numbers)
        self.exchange()
        self._kernel("director_field")

    @property
    def values(self) -> np.ndarray:
        """Directors of the owned particles (n_owned, m) [rad], [-]."""
        return self.owned[:, : self.numbers]

    @property
    def torques(self) -> np.ndarray:
        """Torques on the owned particles (n_owned, m) [pN], [pN µm]."""
        return self.owned[:, self.numbers :]

    @property
    def by_block(self) -> dict[str, np.ndarray]:
        """Gradients (n_blocks, m d, 4) [1/µm], axis h (n_blocks, d, 4) [-] and in space Laplacians (n_blocks, d, 4)
        [1/µm²], writable, by the names of the fields.
        """
        names = ("director_gradient", "director_axis", *["director_bend"] * (self.numbers > 1))
        return {name: self._kernel[name] for name in names}

    @property
    def changing(self) -> dict[str, np.ndarray]:
        """Arrays that steps change: directors and torques (n_local, 2 m) [rad, pN], [-, pN µm]."""
        return {"director": self.array}

    def of_rows(self) -> dict[str, np.ndarray]:
        """Reference gradients (m, d, n_rows) [1/µm] and axis h (d, n_rows) [-] of the rows, by their names in laws."""
        gradient, axis = (self._state.by_row(values) for values in list(self.by_block.values())[:2])
        return {"gradient": gradient.reshape(len(gradient), self.numbers, -1).transpose(1, 2, 0), "director": axis.T}

    def missed_energy(self) -> np.ndarray:
        """Energy of the owned particles (n_owned,) [pN µm] that nodal integrals miss, in space: `Template.missed`."""
        bend = self._state.by_row(self._kernel["director_bend"])[: len(self.owned)]
        return 0.5 * self._modulus * (bend * bend).sum(axis=1)

    def widest(self) -> float:
        """Largest angle [rad] between anchored directors of neighbours along the membrane, in the plane; collective.

        At π their energy jumps, as the difference of angles, which are known up to 2π, changes its sign.
        """
        facets = self._kernel["facet"] if len(self.anchors.at) else np.zeros((0, 2), int)
        return largest(self._comm, np.arccos(np.cos(np.diff(self.memory[facets, 0], axis=1))))
