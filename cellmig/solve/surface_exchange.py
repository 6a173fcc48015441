"""Exchange of surface positions: each rank fetches those near its own surfaces from their owners."""

from __future__ import annotations

import numpy as np

from mpi4py import MPI

from ..meshfree.contact import Surfaces, cells_around


class SurfacePlaces:
    """Positions of surface particles, of which each rank has its own.

    mine : (n,) int -- this rank's surface particles, ascending;  cells : their cells;  on : (k,) int -- all surface
    particles of these cells.
    """

    def __init__(self, comm: MPI.Comm, surfaces: Surfaces, owner: np.ndarray, mine: np.ndarray):
        """`owner` : (m,) int -- ranks of all surface particles;  `mine` : (n,) int."""
        d = surfaces.facets.shape[1]
        self.comm, self.mine, self._owner = comm, mine, owner
        self._first = np.searchsorted(surfaces.cell, np.arange(surfaces.cell[-1] + 2))
        self.cells, self._start = np.unique(surfaces.cell[mine], return_index=True)
        self.on = self.of_cells(self.cells)
        self._x = np.empty((len(owner), d))  # pages that are never written take no memory

    def of_cells(self, cells: np.ndarray) -> np.ndarray:
        """Surface particles (k,) int of `cells` (c,) int."""
        return np.concatenate([np.arange(*self._first[c : c + 2]) for c in cells] or [np.zeros(0, int)])

    def everywhere(self, own: np.ndarray) -> np.ndarray:
        """Positions of all surface particles (m, d) [µm], from those of this rank, `own` (n, d) [µm]; collective."""
        counts = np.array(self.comm.allgather(len(own)))
        x, where = np.empty_like(self._x), np.empty(len(self._x), np.int64)
        self.comm.Allgatherv(self.mine, (where, counts))
        everything = np.empty_like(x)
        self.comm.Allgatherv(own, (everything, x.shape[1] * counts))
        x[where] = everything
        return x

    def near(self, own: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
        """Positions near this rank's surface particles; collective.

        own : (n, d) float -- positions of this rank's surface particles [µm];  reach : float [µm].

        Returns
        -------
        (m, d) float -- positions [µm], set for the particles of the second result only.
        (k,) int -- surface particles of all cells within reach.
        """
        d = own.shape[1]
        box = np.full((len(self._first) - 1, 2 * d), np.inf)
        if len(own):
            box[self.cells] = np.minimum.reduceat(np.hstack([own, -own]), self._start)
        self.comm.Allreduce(MPI.IN_PLACE, box, MPI.MIN)
        around = self.of_cells(cells_around(box[:, :d], -box[:, d:], self.cells, reach))
        self._x[self.mine] = own
        others = around[self._owner[around] != self.comm.rank]
        self._x[others] = self._fetched(others)
        return self._x, around

    def _fetched(self, wanted: np.ndarray) -> np.ndarray:
        """Positions (k, d) [µm] of surface particles `wanted` (k,) of other ranks; collective."""
        order = np.argsort(self._owner[wanted], kind="stable")
        count = np.bincount(self._owner[wanted], minlength=self.comm.size).astype(np.int64)
        asked = np.empty_like(count)
        self.comm.Alltoall(count, asked)
        names = np.empty(asked.sum(), np.int64)
        self.comm.Alltoallv((wanted[order].astype(np.int64), count), (names, asked))
        d = self._x.shape[1]
        places = np.empty((len(wanted), d))
        self.comm.Alltoallv((self._x[names], d * asked), (places, d * count))
        out = np.empty_like(places)
        out[order] = places
        return out
