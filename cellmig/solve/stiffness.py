"""The tangent of a scene: how the forces on its particles change with their displacements, in PETSc's blocks."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from petsc4py import PETSc

from ..meshfree.rows import csr_rows
from .mechanics import Mechanics
from .tangent import tangent

TURN = np.array([[0.0, -1.0], [1.0, 0.0]])


class Stiffness:
    """Derivative -∂f/∂u of the forces of a Mechanics, in blocks of two rows and columns a particle.

    Columns are numbered as PETSc numbers the particles of all ranks.  Terms: internal force with its geometric part
    (the gradient of the displacement carries both), elastic stabilisation, pressure on segments.
    """

    def __init__(self, mechanics: Mechanics):
        """Rows of gradients, and the stabilisation; collective in nothing."""
        self.mechanics = m = mechanics
        base, scene, n = m.base, m.scene, m.n_owned
        self._column = m.place_in_petsc[base.ids]
        self.start = int(self._column[0]) if n else 0
        self.shape = 2 * n, 2 * scene.size
        self._G = self._wide([t.G for t in scene.templates], base.n_rows)
        owned = (self._G.indices >= self.start) & (self._G.indices < self.start + n)
        row = np.repeat(np.arange(base.n_rows), np.diff(self._G.indptr))
        self._row = row
        left = sparse.coo_matrix((np.flatnonzero(owned), (self._G.indices[owned] - self.start, row[owned])),
                                 (n, base.n_rows)).tocsr()
        g = self._G.data[left.data]
        blocks = np.zeros((len(g), 2, 2, 2))
        blocks[:, 0, 0], blocks[:, 1, 1] = np.column_stack([g.real, g.imag]), np.column_stack([g.real, g.imag])
        self._left = sparse.bsr_matrix((blocks.reshape(-1, 2, 4), left.indices, left.indptr), (2 * n, 4 * base.n_rows))
        self._stiff = self._stabilisation()
        self._volume = scene.field("V")[base.ids[: base.n_rows]]
        self._material = scene.material[base.ids[: base.n_rows]]

    def _wide(self, matrices: list, n_rows: int) -> sparse.csr_matrix:
        """First rows of matrices with the columns of all ranks."""
        local = csr_rows(self.mechanics.scene, self.mechanics.base, matrices, n_rows, self.mechanics.scene.size)
        wide = sparse.csr_matrix((local.data, self._column[local.indices], local.indptr),
                                 (n_rows, self.mechanics.scene.size))
        wide.sort_indices()
        return wide

    def _stabilisation(self) -> sparse.bsr_matrix:
        m = self.mechanics
        if not m.terms.stiffened:
            return sparse.bsr_matrix(self.shape, blocksize=(2, 2))
        E = self._wide([t.E for t in m.scene.templates], m.n_owned)
        return sparse.bsr_matrix((E.data[:, None, None] * np.eye(2), E.indices, E.indptr), self.shape)

    def internal(self) -> sparse.bsr_matrix:
        """Of the stresses at the deformation gradients as they are, and of the stabilisation."""
        m, G = self.mechanics, self._G
        F, n = m.tensors()[0], m.base.n_rows
        A = np.zeros((2, 2, 2, 2, n))
        for i, law in enumerate(m.scene.materials):
            on = self._material == i
            A[..., on] = self._volume[on] * tangent(law, "stress", {"F": F[..., on]})
        g = np.stack([G.data.real, G.data.imag])
        by_column = np.einsum("ijkle,le->eijk", A[..., self._row], g).reshape(-1, 4, 2)
        right = sparse.bsr_matrix((by_column, G.indices, G.indptr), (4 * n, self.shape[1]))
        return self._left @ right + self._stiff

    def pressure(self) -> sparse.bsr_matrix:
        """Of the pressures, which follow the surface."""
        k = self.mechanics.kernel
        if self.mechanics.terms.histories is None or not len(k["pressed"]):
            return sparse.bsr_matrix(self.shape, blocksize=(2, 2))
        histories = self.mechanics.terms.histories
        factor = np.array([h.value(k["clock"][0]) for h in histories])[k["pressed_history"]]
        half = 0.5 * k["pressure"] * factor
        i, j = k["pressed"].T
        rows, columns = np.concatenate([i, i, j, j]), np.concatenate([j, i, j, i])
        values = np.concatenate([-half, half, -half, half])  # both ends bear half of what their distance makes
        own = rows < self.mechanics.n_owned
        return self._of_blocks(rows[own], columns[own], values[own, None, None] * TURN)

    def _of_blocks(self, rows: np.ndarray, columns: np.ndarray, blocks: np.ndarray) -> sparse.bsr_matrix:
        """Matrix of blocks at local rows and columns; those at one place add up."""
        order = np.argsort(rows, kind="stable")
        ptr = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=self.shape[0] // 2))])
        out = sparse.bsr_matrix((blocks[order], self._column[columns[order]], ptr), self.shape)
        out.sum_duplicates()
        return out

    def __call__(self) -> sparse.bsr_matrix:
        """All of it, for the state and the time as they are; F is to be current."""
        return self.internal() + self.pressure()

    def matrix(self) -> PETSc.Mat:
        """A Mat with room for all entries that ever occur, which are those of neighbours of neighbours; collective."""
        n, size = self.mechanics.n_owned, self.mechanics.scene.size
        ones = sparse.csr_matrix((np.ones(self._G.nnz), self._G.indices, self._G.indptr), self._G.shape)
        left = sparse.csr_matrix((np.ones(len(self._left.indices)), self._left.indices, self._left.indptr),
                                 (n, ones.shape[0]))
        stiff = sparse.csr_matrix((np.ones(len(self._stiff.indices)), self._stiff.indices, self._stiff.indptr),
                                  (n, size))
        pattern = (left @ ones + stiff).tocsr()
        pattern.sort_indices()
        mat = PETSc.Mat().createBAIJ(((2 * n, None), (2 * n, None)), 2, comm=self.mechanics.comm)
        mat.setPreallocationCSR((pattern.indptr.astype(PETSc.IntType), pattern.indices.astype(PETSc.IntType),
                                 np.zeros((pattern.nnz, 2, 2))))
        return mat


def fill(mat: PETSc.Mat, values: sparse.bsr_matrix) -> None:
    """Set the entries of a Mat to this rank's rows, the others to zero; collective."""
    mat.zeroEntries()
    mat.setValuesBlockedCSR(values.indptr.astype(PETSc.IntType), values.indices.astype(PETSc.IntType),
                            values.data)
    mat.assemble()


def typical(K: sparse.bsr_matrix, start: int, comm: Any) -> float:
    """Mean of the diagonal over all ranks [Pa]; collective."""
    rows = np.repeat(np.arange(K.shape[0] // 2), np.diff(K.indptr))
    on = K.indices == rows + start
    found = np.array([np.trace(K.data[on].sum(axis=0)) if on.any() else 0.0, K.shape[0]])
    total = sum(comm.allgather(found))
    return float(total[0] / total[1])
