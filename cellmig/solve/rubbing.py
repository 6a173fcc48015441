"""What the ledger remembers of the friction on the surface of a rank's cells."""

from __future__ import annotations

import numpy as np

from ..kernel.fields import Field
from ..kernel.kernel import Kernel
from .subdomain import Subdomain


class Rubbing:
    """The surface particles of a rank, on which friction may act; there only in a scene that has one."""

    FIELDS = (
        Field("n_rubbing", "long", doc="owned surface particles, if there is friction"),
        Field("rubbing", "int32_t *", "(n_rubbing,)", "", "these"),
        Field("rubs", "double *", "(n_owned, d)", "pN/µm", "forces of friction, in a step"),
        Field("rubbed", "double *", "(n_rubbing, d)", "pN/µm", "those of the last kick"),
    )

    def __init__(self, part: Subdomain, kernel: Kernel):
        """Begin without a last kick."""
        self._kernel, d = kernel, part.scene.dimension
        kernel["n_rubbing"], kernel["rubbing"] = len(part.at_surface), part.at_surface
        kernel["rubs"], kernel["rubbed"] = np.zeros((part.n_owned, d)), np.zeros((len(part.at_surface), d))

    @property
    def changing(self) -> dict[str, np.ndarray]:
        """Arrays that steps change: the friction of the last kick (n_rubbing, d) [pN/µm]."""
        return {"rubbed": self._kernel["rubbed"]}
