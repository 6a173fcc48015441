"""Exchange of surface positions: each rank fetches those near its own surfaces from their owners."""

from __future__ import annotations

import numpy as np

from mpi4py import MPI

from ..meshfree.contact import Surfaces, cells_around
from ..meshfree.scene import Scene
from ..parallel.collect import fetched, gathered
from ..parallel.owners import Owners


class SurfacePlaces:
    """Positions of surface particles, of which each rank has its own.

    surfaces : Surfaces -- of the cells of which this rank has a part;  mine : (n,) int -- its particles among these.
    """

    def __init__(self, comm: MPI.Comm, scene: Scene, owners: Owners, surfaces: Surfaces, mine: np.ndarray):
        """Nothing is known of others before the first call of `near`."""
        self.comm, self.surfaces, self.mine = comm, surfaces, mine
        self._scene, self._owners = scene, owners
        self._ids = surfaces.ids[mine]
        self._order = np.argsort(self._ids)
        self._around, self._owner = surfaces, owners.of(surfaces.ids)
        self._cells, self._start = np.unique(surfaces.cell[mine], return_index=True)

    def everywhere(self, own: np.ndarray) -> np.ndarray | None:
        """Positions of all surface particles (m, d) [µm] on rank 0, from those of this rank, `own` (n, d) [µm]; None on
        other ranks; collective.
        """
        return gathered(self.comm, self.surfaces.place[self.mine], own, int(self._scene.first_surface[-1]))

    def near(self, own: np.ndarray, reach: float) -> tuple[Surfaces, np.ndarray]:
        """Surfaces (m particles) of all cells near this rank's particles, and their positions (m, d) [µm]; collective.

        own : (n, d) float -- positions of this rank's surface particles [µm];  reach : float [µm].
        """
        d = own.shape[1]
        box = np.full((len(self._scene.kind), 2 * d), np.inf)
        if len(own):
            box[self._cells] = np.minimum.reduceat(np.hstack([own, -own]), self._start)
        self.comm.Allreduce(MPI.IN_PLACE, box, MPI.MIN)
        cells = np.union1d(cells_around(box[:, :d], -box[:, d:], self._cells, reach), self.surfaces.cells)
        if not np.array_equal(cells, self._around.cells):
            self._around = Surfaces.of(self._scene, cells)
            self._owner = self._owners.of(self._around.ids)
        around, owner = self._around, self._owner
        x = np.empty((len(around.ids), d))
        x[owner == self.comm.rank] = own
        others = np.flatnonzero(owner != self.comm.rank)
        x[others] = fetched(self.comm, owner[others], around.ids[others], lambda ids: own[self._number(ids)])
        return around, x

    def _number(self, ids: np.ndarray) -> np.ndarray:
        """Numbers (k,) int of this rank's surface particles with global `ids` (k,) int."""
        return self._order[np.searchsorted(self._ids, ids, sorter=self._order)]
