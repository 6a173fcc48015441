"""Protrusion on one rank: the push of a cell depends on its whole surface, also on parts of other ranks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..kernel.fields import Field
from ..kernel.kernel import Kernel
from ..meshfree.division import carried
from .segments import Segments
from .subdomain import Subdomain


class Protruding(NamedTuple):
    """Which cells protrude (cells,) bool, and random factors alpha of all surface particles at the start (m,) [-]."""

    cells: np.ndarray
    alpha: np.ndarray


class Protrusion:
    """The protruding cells of which a rank owns a part of the surface; in each step the kernel finds their front half,
    the bonds that hold it, and the push.
    """

    FIELDS = (
        Field("push", "double *", "(n_facets, d)", "pN/µm", "β α N σ/d at the corners of the facets"),
        Field("pushed", "double *", "(n_facets, d)", "pN/µm", "forces of the last kick"),
        Field("n_movers", "long", doc="protruding cells"),
        Field("first_mover", "long *", "(n_movers + 1,)", "", "their particles in `mover`"),
        Field("mover", "int32_t *", "(…,)", "", "all of their surface particles"),
        Field("mover_weight", "double *", "(…,)", "-", "weights of these in the mean of the surface"),
        Field("mover_of", "int32_t *", "(n_facets,)", "", "protruding cells of the segments"),
        Field("first_grip", "long *", "(n_movers + 1,)", "", "their segments in `grip`"),
        Field("grip", "int32_t *", "(…,)", "", "their segments near the substrate"),
        Field("firm", "double", "", "µm", "length of closed bonds that holds a cell"),
        Field("middle", "double *", "(n_movers,)", "µm", "mean x of the surface"),
        Field("hold", "double *", "(n_movers,)", "-", "share of the push that the bonds hold"),
    )

    def __init__(self, part: Subdomain, kernel: Kernel, segments: Segments, protruding: Protruding):
        """Nothing holds or pushes before the first `renew`."""
        law, bonds = part.terms.protrusion, part.terms.substrate
        assert law is not None and bonds is not None  # without bonds nothing protrudes
        self._kernel, self._segments, k, s = kernel, segments, kernel, part.surfaces
        size = law.protrusion_ratio * bonds.work / part.scene.dimension
        k["push"] = np.where(segments.acts[:, None], size * carried(part.scene, protruding.alpha)[segments.ends], 0.0)
        k["pushed"] = np.zeros(segments.ends.shape)
        cells, first, count = np.unique(s.cell[part.pushed], return_index=True, return_counts=True)
        share = s.shares[part.pushed]
        k["mover_weight"] = share / np.repeat(np.add.reduceat(share, first) if len(first) else share, count)
        k["n_movers"], k["first_mover"] = len(cells), np.append(first, len(part.pushed))
        k["mover"] = part.numbering.local(s.ids[part.pushed])
        k["mover_of"] = np.searchsorted(cells, s.cell[segments.ends[:, 0]])
        k["firm"], k["middle"], k["hold"] = law.height, np.zeros(len(cells)), np.zeros(len(cells))
        self._on = protruding.cells[s.cell[segments.ends[:, 0]]] & s.outer[segments.number]

    def renew(self) -> None:
        """Select the segments near the substrate, from the current search lists."""
        k = self._kernel
        k["grip"] = np.flatnonzero(self._segments.low & self._on)
        k["first_grip"] = np.searchsorted(k["mover_of"][k["grip"]], np.arange(len(k["hold"]) + 1))

    @property
    def changing(self) -> dict[str, np.ndarray]:
        """Arrays that steps change: the push of the last kick (n_facets, d) [pN/µm]."""
        return {"pushed": self._kernel["pushed"]}
