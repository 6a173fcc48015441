"""The surface of a rank's cells in the liquid around them."""

from __future__ import annotations

import numpy as np

from ..kernel.fields import Field
from ..kernel.kernel import Kernel
from .subdomain import Subdomain


class Immersed:
    """The surface particles of a rank, which a medium drags; there only in a scene that has one."""

    FIELDS = (
        Field("n_immersed", "long", doc="owned surface particles, if there is a medium"),
        Field("immersed", "int32_t *", "(n_immersed,)", "", "these"),
        Field("immersed_size", "double *", "(n_immersed,)", "- or µm", "their lengths or areas over the cell's radius"),
        Field("dragged", "double *", "(n_immersed, d)", "pN/µm", "forces of the last kick"),
    )

    def __init__(self, part: Subdomain, kernel: Kernel):
        """Begin without a last kick."""
        self._kernel, s, scene = kernel, part.surfaces, part.scene
        radius = np.array([t.radius for t in scene.templates])[scene.kind[s.cell]]
        kernel["n_immersed"], kernel["immersed"] = len(part.at_surface), part.at_surface
        kernel["immersed_size"] = (s.shares / radius)[part.own_surface]
        kernel["dragged"] = np.zeros((len(part.at_surface), scene.dimension))

    @property
    def changing(self) -> dict[str, np.ndarray]:
        """Arrays that steps change: the drag of the last kick (n_immersed, d) [pN/µm]."""
        return {"dragged": self._kernel["dragged"]}
