"""The density of ligands below the cells of a scene: the kernel's table, which follows them."""

from __future__ import annotations

import numpy as np

from ..kernel.fields import Field
from ..kernel.kernel import Kernel
from ..model.ligand import SPACING, LigandTable
from ..parallel.reduce import global_maximum
from .segments import Segments
from .subdomain import Subdomain

AROUND = 4.0  # how far the table reaches beyond the surfaces [skins]: they move by less until it is looked at again


class Ligand:
    """The table around all surfaces, the same on all ranks.

    table : LigandTable -- None before the first `renew`.
    """

    FIELDS = (
        Field("ligand", "double *", "(n,), in space (n, m)", "-", "samples of the density of ligands, from 0 to 1"),
        Field("ligand_first", "long *", "(d - 1,)", "", "number of the first sample from the origin, along each axis"),
        Field("ligand_count", "long *", "(d - 1,)", "", "samples along each axis"),
        Field("ligand_spacing", "double", "", "µm", "distance of samples"),
    )

    def __init__(self, part: Subdomain, kernel: Kernel, segments: Segments):
        """Begin without a table."""
        self._comm, self._kernel, self._segments = part.comm, kernel, segments
        self._field, self.table = part.terms.ligand, LigandTable((), np.zeros(0))

    def renew(self) -> None:
        """Make the table anew if surfaces come near its ends; collective."""
        own = self._segments.own_places()[:, :-1]
        ends = np.full(2 * own.shape[1], -np.inf) if not len(own) else np.append(-own.min(axis=0), own.max(axis=0))
        ends = global_maximum(self._comm, ends) + AROUND * self._segments.skin
        low, high = np.split(ends, 2) * np.array([[-1.0], [1.0]])
        if self.table.first and self.table.holds(low, high):
            return
        assert self._field is not None
        own_table = LigandTable.of(self._field, low, high) if self._comm.rank == 0 else None
        self.table = table = self._comm.bcast(own_table)
        k = self._kernel
        k["ligand"], k["ligand_spacing"] = table.samples, SPACING
        k["ligand_first"], k["ligand_count"] = np.array(table.first), np.array(table.samples.shape)
