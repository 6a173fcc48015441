"""The director of a rank's particles: angles with ghosts, their gradient, anchoring at the membrane."""

from __future__ import annotations

import numpy as np

from ..kernel.fields import Field
from ..kernel.kernel import Kernel, aligned_zeros
from ..parallel.ghosts import GhostedField
from .state import State
from .subdomain import Subdomain


class Director(GhostedField):
    """Angles θ [rad] in column 0 and torques on them [pN] in column 1, which the kernel updates in each step.

    Attributes
    ----------
    memory : (capacity, 2) float -- of the field, padded for the kernel's last block [rad, pN].
    """

    FIELDS = (
        Field("director", "double *", "(n_local, 2)", "rad, pN", "θ and torques; ghosts are exchanged in each step"),
        Field("director_vec", "void *", doc="what exchanges it: a Vec of PETSc or a `SharedCopies`"),
        Field("director_gradient", "double *", "(n_blocks, 2, 4)", "1/µm", "reference gradient of θ, by lanes"),
        Field("director_axis", "double *", "(n_blocks, 2, 4)", "-", "h = (cos θ, sin θ), by lanes"),
        Field("director_flux", "double *", "(n_rows, 2)", "pN µm", "V η F⁻¹ g, from the first pass to the second"),
        Field("director_mobility", "double *", "(n_owned,)", "1/(µs pN)", "γ/(η V), 0 where θ is held"),
        Field("director_weight", "double *", "(n_owned,)", "pN", "bound of the second derivative of η |g|²/2"),
        Field("n_anchors", "long", doc="anchored surface particles, and neighbours of such"),
        Field("n_anchors_anywhere", "long", doc="those of all ranks"),
        Field("anchor", "int32_t *", "(n_anchors, 3)", "", "the particle before, itself, the one after"),
        Field("anchor_offset", "double *", "(n_anchors,)", "rad", "angle to the membrane"),
        Field("anchor_owned", "int32_t *", "(n_anchors,)", "", "whether it is this rank's"),
    )

    def __init__(self, part: Subdomain, kernel: Kernel, state: State):
        """Begin at zero angles; collective.  Without a director law the angles stay uniform."""
        self.memory = aligned_zeros((part.capacity, 2))
        super().__init__(part.comm, self.memory, part.n_owned, part.numbering.shared.sum())
        self.set_ghosts(part.in_petsc[part.numbering.ids[part.n_owned :]])
        self._part, self._kernel, self._state = part, kernel, state
        kernel["director"] = self.memory
        for name in ("director_gradient", "director_axis"):
            kernel[name] = np.zeros((len(part.blocks.table), 2, 4))
        kernel["director_flux"] = np.zeros((part.capacity, 2))
        materials, law = part.scene.materials, part.terms.director_law
        eta, zeta = (np.array([getattr(m, name, 0.0) for m in materials]) for name in ("eta", "zeta"))
        V, stiffness, of_material = part.scene.field("V")[part.ids], eta.max(), part.scene.material[part.ids]
        mobility = (law.mobility if law else 0.0) / (stiffness * V) if stiffness > 0 else np.zeros(len(V))
        # Bounds of the second derivatives of η |g|²/2 and of ζ, which add to the moduli that limit the step.
        kernel["director_weight"] = 3.0 * eta[of_material]
        state.stiffen(np.abs(zeta)[of_material])
        held = law is not None and law.anchoring == "surface"
        self._anchors = self._anchored(mobility, stiffness / V) if held else np.zeros(0, int)
        kernel["director_mobility"] = mobility
        kernel["n_anchors"] = len(self._anchors)
        kernel["n_anchors_anywhere"] = part.comm.allreduce(len(self._anchors))

    def _anchored(self, mobility: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
        """Anchored surface particles of this rank and their neighbours (n_anchors,), whose angles follow the membrane.

        `mobility` (n_owned,) [1/(µs pN)] becomes zero there;  `stiffness` (n_owned,) [Pa] : largest modulus of a
        rotation of the membrane against the director.
        """
        s, k, own = self._part.surfaces, self._kernel, self._part.on_surface
        anchors = np.flatnonzero(own | own[s.after] | own[s.before])
        local = self._part.numbering.local(s.ids[anchors])
        mine = local[local < self._part.n_owned]
        mobility[mine] = 0.0
        self._state.stiffen(stiffness[mine], mine)
        k["anchor_owned"] = local < self._part.n_owned
        k["anchor"] = self._part.numbering.local(s.ids[np.column_stack([s.before[anchors], anchors, s.after[anchors]])])
        return anchors

    def start(self, theta: np.ndarray) -> None:
        """Set angles theta (n_owned,) [rad]; anchors keep their angle to the membrane in the reference configuration.

        Computes the reference gradient, which is constant for a frozen director; collective.
        """
        k, s, a = self._kernel, self._part.surfaces, self._anchors
        self.owned[:, 0] = theta
        self.exchange()
        X = self._part.scene.X
        chord = X[s.ids[s.after[a]]] - X[s.ids[s.before[a]]]
        offset = self.array[self._part.numbering.local(s.ids[a]), 0] - np.arctan2(chord[:, 1], chord[:, 0])
        k["anchor_offset"] = offset
        k["director_vec"] = self.handle
        k("director_field")

    @property
    def by_block(self) -> dict[str, np.ndarray]:
        """Gradient of θ [1/µm] and axis h [-], (n_blocks, 2, 4) each, writable, by the names of the fields."""
        return {name: self._kernel[name] for name in ("director_gradient", "director_axis")}

    @property
    def changing(self) -> dict[str, np.ndarray]:
        """Arrays that steps change: angles and torques (capacity, 2) [rad, pN]."""
        return {"theta": self.memory}

    def of_rows(self) -> dict[str, np.ndarray]:
        """Reference gradient of θ [1/µm] and axis h [-] of the rows, (2, n_rows) each, by their names in laws."""
        gradient, axis = (self._state.by_row(values).T for values in self.by_block.values())
        return {"gradient": gradient, "director": axis}

    def anchored(self) -> tuple[np.ndarray, np.ndarray]:
        """Anchors with both neighbours (n_anchors, 3) int, and their torques (n_anchors,) [pN]."""
        anchor = self._kernel["anchor"]
        return anchor, self.memory[anchor[:, 1], 1]
