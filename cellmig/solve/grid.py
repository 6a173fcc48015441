"""A box of equal volumes, on PETSc's DMDA: fluxes between them, values at points, and the whole of it on one rank."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import sparse

from petsc4py import PETSc


class Grid:
    """Volumes of a box; those that a rank owns are in PETSc's order, numbers of all go along x first.

    Attributes
    ----------
    low, size : (d,) -- lower corner of the box, and size of a volume [µm].
    count : (d,) int -- volumes along each axis.
    volume : float -- of each [µm³], in two dimensions per µm of thickness [µm²].
    own : (n,) int -- numbers of the volumes of this rank.
    """

    def __init__(self, comm: PETSc.Comm, corners: Sequence[Sequence[float]], count: Sequence[int]):
        """Divide the box between two `corners` [µm] into `count` volumes along each axis; collective."""
        self.low, high = np.array(corners, float)
        self.count = np.array(count)
        self.size = (high - self.low) / self.count
        self.volume = float(self.size.prod())
        self._dm = PETSc.DMDA().create(dim=len(count), sizes=tuple(count), dof=1, stencil_width=1, comm=comm,
                                       stencil_type=PETSc.DMDA.StencilType.STAR)
        self._steps = np.append(1, np.cumprod(self.count[:-1]))
        ranges = [np.arange(*r) for r in self._dm.getRanges()]
        self._place = np.stack([a.ravel() for a in np.meshgrid(*ranges[::-1], indexing="ij")][::-1], axis=1)
        self.own = self._place @ self._steps
        self._local = np.full(self.total, -1)
        self._local[self.own] = np.arange(len(self.own))

    @property
    def total(self) -> int:
        """Number of all volumes."""
        return int(self.count.prod())

    @property
    def centres(self) -> np.ndarray:
        """Centres of the volumes of this rank (n, d) [µm]."""
        return self.low + (self._place + 0.5) * self.size

    def vector(self) -> PETSc.Vec:
        """A vector of values of the volumes."""
        return self._dm.createGlobalVec()

    # ------------------------------------------------------------ fluxes

    def fluxes(self, diffusion: float, flow: Sequence[float], walls: Sequence[Sequence[float | str]],
               ) -> tuple[PETSc.Mat, np.ndarray, np.ndarray, np.ndarray]:
        """What leaves each volume by diffusion and flow; collective.

        Parameters
        ----------
        diffusion : float -- D [µm²/µs].
        flow : (d,) -- velocity w [µm/µs].
        walls : both walls of each axis: "closed", "open", or a concentration [1/µm³].

        Returns
        -------
        Mat -- A, so that A c is what leaves the volumes [1/µs]; c [1/µm³].
        (n,) -- of this rank's volumes, the part of the diagonal of A that leaves through walls [µm³/µs].
        (n,) -- what comes in through walls [1/µs].
        (n,) -- sums of the rows of A without rounding [µm³/µs]: zero away from walls.

        Source: exponential fitting of Scharfetter & Gummel (1969), IEEE Trans. Electron Devices 16:64-77, which is
        upwind where the flow is fast: off the diagonal nothing is positive, so that no concentration becomes negative.
        """
        n = len(self.own)
        rows, columns, values = [], [], []
        diagonal, leak, inflow, carried = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
        for axis, (h, w, both) in enumerate(zip(self.size, flow, walls, strict=True)):
            area = self.volume / h
            for sign, wall in zip((-1, 1), both, strict=True):
                at_wall = self._place[:, axis] == (0 if sign < 0 else self.count[axis] - 1)
                inside = np.flatnonzero(~at_wall)
                g, peclet = diffusion * area / h, sign * w * h / diffusion
                diagonal[inside] += g * _bernoulli(-peclet)
                carried[inside] += sign * area * w
                rows.append(inside)
                columns.append(self.own[inside] + sign * self._steps[axis])
                values.append(np.full(len(inside), -g * _bernoulli(peclet)))
                if wall == "open":
                    leak[at_wall] += area * max(sign * w, 0.0)
                elif not isinstance(wall, str):  # half as far away
                    leak[at_wall] += 2.0 * g * _bernoulli(-0.5 * peclet)
                    inflow[at_wall] += 2.0 * g * _bernoulli(0.5 * peclet) * wall
        rows.append(np.arange(n))
        columns.append(self.own)
        values.append(diagonal + leak)
        matrix = self._matrix(np.concatenate(rows), np.concatenate(columns), np.concatenate(values))
        return matrix, leak, inflow, carried + leak

    def _matrix(self, rows: np.ndarray, columns: np.ndarray, values: np.ndarray) -> PETSc.Mat:
        n = len(self.own)
        columns = self._dm.getAO().app2petsc(columns.astype(PETSc.IntType))
        csr = sparse.csr_matrix((values, (rows, columns)), shape=(n, self.total))
        csr.sort_indices()
        return PETSc.Mat().createAIJ(((n, None), (n, None)), comm=self._dm.comm, csr=(
            csr.indptr.astype(PETSc.IntType), csr.indices.astype(PETSc.IntType), csr.data))

    # ------------------------------------------------------------ values at points

    def outside(self, x: np.ndarray) -> np.ndarray:
        """Whether points x (m, d) [µm] are outside the box (m,) bool."""
        return ((x < self.low) | (x > self.low + self.count * self.size)).any(axis=1)

    def weights(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Multilinear interpolation between centres: numbers of volumes and weights (m, 2^d), at x (m, d) [µm].

        Nearer to a wall than the centres the value is that of the centre, as it is where nothing passes a wall.
        """
        at = np.clip((x - self.low) / self.size - 0.5, 0.0, self.count - 1.0)
        first = np.minimum(at.astype(np.int64), self.count - 2)
        share = at - first
        number, weight = first @ self._steps, np.ones(len(x))
        number, weight = number[:, None], weight[:, None]
        for axis, step in enumerate(self._steps):
            s = share[:, axis, None]
            number = np.concatenate([number, number + step], axis=1)
            weight = np.concatenate([weight * (1.0 - s), weight * s], axis=1)
        return number, weight

    def local(self, number: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places (m, k) among this rank's volumes of a `number` (m, k), and its `weight` (m, k) [-], zero elsewhere."""
        place = self._local[number]
        return np.maximum(place, 0), np.where(place >= 0, weight, 0.0)

    # ------------------------------------------------------------ all of it

    def gather(self, values: np.ndarray) -> np.ndarray | None:
        """The `values` (n,) of this rank's volumes, in any unit, by number (total,) on rank 0 or None; collective."""
        if self._dm.comm.size == 1:
            return values.copy()
        parts = self._dm.comm.tompi4py().gather((self.own, values))
        if parts is None:
            return None
        whole = np.empty(self.total)
        for own, some in parts:
            whole[own] = some
        return whole

    def scatter(self, whole: Any) -> np.ndarray:
        """Values (n,) of this rank's volumes, in any unit, from the `whole` (total,) that rank 0 has; collective."""
        comm = self._dm.comm
        return np.array((whole if comm.size == 1 else comm.tompi4py().bcast(whole))[self.own])

    def close(self) -> None:
        """Free the PETSc objects."""
        self._dm.destroy()


def _bernoulli(x: float) -> float:
    """Bernoulli's function x / (e^x - 1) [-]."""
    return 1.0 - 0.5 * x if abs(x) < 1e-8 else float(x / np.expm1(min(x, 700.0)))
