"""The director of a rank's particles: their angles with copies of others', and what holds them at the membrane."""

from __future__ import annotations

from typing import Any

import numpy as np

from mpi4py import MPI

from ..kernel.kernel import Kernel, aligned_zeros
from ..meshfree.body import Scene
from ..meshfree.contact import Surfaces
from ..parallel.ghosts import GhostedField


class Director(GhostedField):
    """Angles θ [rad] in column 0, the torques on them [pN] in column 1; the kernel moves them, step by step.

    memory : (capacity, 2) -- that of the field, with room for the kernel's last block.
    """

    def __init__(self, comm: MPI.Comm, scene: Scene, surfaces: Surfaces, base: Any, ghosts: np.ndarray, capacity: int,
                 kernel: Kernel, law: Any):
        """`base` : the numbering of particles and rows;  `law` : that of the director, None if uniform; collective."""
        self.memory = aligned_zeros((capacity, 2))
        super().__init__(comm, self.memory, base.n_owned, base.shared.sum())
        self.set_ghosts(ghosts)
        self._X, self._surfaces, self._base, self._kernel = scene.X, surfaces, base, kernel
        kernel["director"] = self.memory
        for name in ("director_gradient", "director_axis"):
            kernel[name] = np.zeros((len(kernel["F"]), 2, 4))
        kernel["director_flux"] = np.zeros((capacity, 2))
        ids = base.ids[: base.n_owned]
        V, eta = scene.field("V")[ids], max(getattr(m, "eta", 0.0) for m in scene.materials)
        mobility = (law.mobility if law else 0.0) / (eta * V) if eta > 0 else np.zeros(len(V))
        self._stiffen(scene.materials, scene.material[ids])
        held = law is not None and law.anchoring == "surface"
        self._anchors = self._anchored(mobility, eta / V) if held else np.zeros(0, int)
        kernel["director_mobility"] = mobility
        kernel["n_anchors"] = len(self._anchors)
        kernel["n_anchors_anywhere"] = comm.allreduce(len(self._anchors))

    def _stiffen(self, materials: list, material: np.ndarray) -> None:
        """What η |g|²/2 and ζ add to the modulus that bounds the step: bounds of their second derivatives."""
        eta, zeta = (np.array([getattr(m, name, 0.0) for m in materials]) for name in ("eta", "zeta"))
        self._kernel["director_weight"] = 3.0 * eta[material]
        self._kernel["elastic_weight"] += np.abs(zeta)[material]

    def _anchored(self, mobility: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
        """Surface particles that this rank has, or neighbours of such; their angle is the membrane's, not moved.

        `stiffness` (n_owned,) [Pa] : what a turn of the membrane against the director adds to its modulus, at most.
        """
        s, base, k = self._surfaces, self._base, self._kernel
        own = base.local(s.ids)
        own = (own >= 0) & (own < base.n_owned)
        anchors = np.flatnonzero(own | own[s.after] | own[s.before])
        local = base.local(s.ids[anchors])
        mine = local[local < base.n_owned]
        mobility[mine] = 0.0
        k["elastic_weight"][mine] += stiffness[mine]
        k["anchor_owned"] = local < base.n_owned
        k["anchor"] = base.local(s.ids[np.column_stack([s.before[anchors], anchors, s.after[anchors]])])
        return anchors

    def start(self, theta: np.ndarray) -> None:
        """Angles (n_owned,) [rad] to go on from; anchors keep that to the membrane which they have at rest; collective.

        A frozen director has a constant reference gradient: it is computed here, once.
        """
        k, s, a = self._kernel, self._surfaces, self._anchors
        self.owned[:, 0] = theta
        self.exchange()
        chord = self._X[s.ids[s.after[a]]] - self._X[s.ids[s.before[a]]]
        k["anchor_offset"] = self.array[self._base.local(s.ids[a]), 0] - np.arctan2(chord[:, 1], chord[:, 0])
        k["director_vec"] = self.handle
        k("director_field")
