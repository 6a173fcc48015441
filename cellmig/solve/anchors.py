"""Anchoring of the director at the membrane: surface particles whose director keeps its angle to it."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..kernel.fields import Field
from ..kernel.kernel import Kernel
from .subdomain import Subdomain

LITTLE = 1e-6  # a director is along the normal if the sine of their angle is below


class Anchors:
    """Anchored surface particles of a rank, and neighbours of such, in the order of the surface.

    Attributes
    ----------
    on : (n_anchors,) int -- as indices in `Surfaces`.
    at : (n_anchors,) int -- local numbers.
    """

    FIELDS = (
        Field("n_anchors", "long", doc="anchored surface particles, and neighbours of such"),
        Field("n_anchors_anywhere", "long", doc="those of all ranks"),
        Field("anchor", "int32_t *", "(n_anchors, 3) or (n_anchors,)", "",
              "itself, in the plane between the particles before and after"),
        Field("anchor_offset", "double *", "(n_anchors,) or (n_anchors, 2)", "rad or -",
              "angle to the membrane, in space the parts along its normal and its tangent"),
        Field("anchor_owned", "int32_t *", "(n_anchors,)", "", "whether it is this rank's"),
        Field("first_anchor_ring", "long *", "(n_anchors + 1,)", "", "in space the triangles around, first of each"),
        Field("anchor_ring", "int32_t *", "(…, 2)", "", "their other corners, in positive order"),
        Field("anchor_weight", "double *", "(…,)", "1/µm", "of the edge to the first of these in the tangent"),
        Field("anchor_frame", "double *", "(n_anchors, 2, 3)", "µm², µm", "in space normal and tangent of now"),
    )

    def __init__(self, part: Subdomain, kernel: Kernel, held: bool):
        """Find them, or none unless they are `held`; collective."""
        self._part, self._kernel, s, own = part, kernel, part.surfaces, part.on_surface
        near = own.copy()
        near[s.facets[s.touching(own)]] = True
        self.on = np.flatnonzero(near) if held else np.zeros(0, int)
        self.at = part.numbering.local(s.ids[self.on])
        kernel["anchor_owned"] = self.at < part.n_owned
        kernel["n_anchors"] = len(self.on)
        kernel["n_anchors_anywhere"] = part.comm.allreduce(len(self.on))
        if part.scene.dimension == 2:
            kernel["anchor"] = part.numbering.local(s.ids[np.column_stack([s.before[self.on], self.on,
                                                                           s.after[self.on]])])
        else:
            self._set_rings()

    @property
    def owned(self) -> np.ndarray:
        """Local numbers of this rank's anchors (k,) int."""
        return self.at[self.at < self._part.n_owned]

    def _set_rings(self) -> None:
        """Set the triangles around each anchor, in the order of the surface."""
        k, s, place = self._kernel, self._part.surfaces, np.full(len(self._part.surfaces.ids), -1)
        place[self.on] = np.arange(len(self.on))
        anchor = place[s.facets].ravel()
        order = np.argsort(anchor, kind="stable")
        order = order[anchor[order] >= 0]
        facet, corner = np.divmod(order, 3)
        self._of = anchor[order]
        self._ring = np.column_stack([s.facets[facet, (corner + i) % 3] for i in (1, 2)])
        k["anchor"], k["anchor_frame"] = self.at, np.zeros((len(self.on), 2, 3))
        k["anchor_ring"] = self._part.numbering.local(s.ids[self._ring])
        k["first_anchor_ring"] = np.append(0, np.cumsum(np.bincount(self._of, minlength=len(self.on))))

    def start(self, directors: np.ndarray) -> None:
        """Note the angles of `directors` (n_anchors, 1) [rad] or (n_anchors, 3) [-] to the membrane at the start."""
        s, k = self._part.surfaces, self._kernel
        X = self._part.scene.particles(s.ids).X
        if self._part.scene.dimension == 2:
            chord = X[s.after[self.on]] - X[s.before[self.on]]
            k["anchor_offset"] = directors[:, 0] - np.arctan2(chord[:, 1], chord[:, 0])
            return
        first, second = (X[self._ring[:, i]] - X[self.on[self._of]] for i in (0, 1))
        normal = self._sums(np.cross(first, second))
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        across = (directors * normal).sum(axis=1)
        tangent = directors - across[:, None] * normal
        along = np.linalg.norm(tangent, axis=1)
        other = np.cross(normal, np.eye(3)[np.abs(normal).argmin(axis=1)])
        tangent = np.where(along[:, None] > LITTLE, tangent, other)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        k["anchor_offset"] = np.column_stack([across, np.where(along > LITTLE, along, 0.0)])
        k["anchor_weight"] = self._weights(first, normal, tangent)

    def _weights(self, edges: np.ndarray, normal: np.ndarray, tangent: np.ndarray) -> np.ndarray:
        """Factors (k,) [1/µm] of the `edges` (k, 3) [µm] whose sum is `tangent` (n_anchors, 3) [-] within the membrane,
        the smallest.
        """
        within = edges - (edges * normal[self._of]).sum(axis=1, keepdims=True) * normal[self._of]
        square = self._sums(within[:, :, None] * within[:, None, :])
        square += np.trace(square, axis1=1, axis2=2)[:, None, None] * normal[:, :, None] * normal[:, None, :]
        factor: Any = np.linalg.solve(square, tangent[:, :, None])[:, :, 0]
        return (within * factor[self._of]).sum(axis=1)

    def _sums(self, values: np.ndarray) -> np.ndarray:
        """Sums (n_anchors, ...) over the triangles around of `values` (k, ...), in any unit."""
        total = np.zeros((len(self.on), *values.shape[1:]))
        np.add.at(total, self._of, values)
        return total
