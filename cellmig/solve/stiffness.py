"""The tangent of a scene: derivatives of the forces on its particles, as a matrix of d × d blocks."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from mpi4py import MPI
from petsc4py import PETSc

from ..case.pointwise import pointwise
from ..kernel.kernel import assemble
from ..kernel.layout import csr_rows
from ..meshfree.stabilisation import BulkDamping, Stabilisation
from ..model.tensors import cofactors
from ..parallel.collect import Arrays
from .anchor_tangent import AnchorTangent
from .mechanics import Mechanics
from .stencils import stencils
from .tangent import mixed


class Stiffness:
    """Derivatives -∂f/∂u [Pa] and -∂f/∂v [Pa µs] of the forces of a Mechanics, a d × d block for each two particles.

    Arguments by_u [-] and by_v [1/µs] are the factors of both in a sum.  Units are those of d = 2 dimensions, where
    forces are per µm of thickness; in space all are those times µm.

    Columns are in the order of PETSc's particles of all ranks.  Terms are all stresses, in first Piola-Kirchhoff form
    with the geometric part included, bulk damping, both stabilisations, and all surface terms, at constant directors
    but for those at the membrane that are anchored.
    """

    def __init__(self, mechanics: Mechanics):
        """Compute the pattern of the matrix."""
        self.mechanics = m = mechanics
        base, scene, n = m.part.numbering, m.scene, m.n_owned
        self.dimension = d = scene.dimension
        self._column = m.state.in_petsc[: len(base.ids)]
        self.start = m.part.first if n else 0
        self.shape = d * n, d * scene.size
        wide = [self._wide([t.G[k] for t in scene.templates], base.n_rows) for k in range(d)]
        self._G = wide[0]
        owned = (self._G.indices >= self.start) & (self._G.indices < self.start + n)
        self._row = np.repeat(np.arange(base.n_rows), np.diff(self._G.indptr))
        left = sparse.coo_matrix((np.flatnonzero(owned), (self._G.indices[owned] - self.start, self._row[owned])),
                                 (n, base.n_rows)).tocsr()
        self.pattern = (_pattern(left, left.shape) @ _pattern(self._G, self._G.shape)).tocsr()
        self.pattern.sort_indices()
        self.diagonal = np.searchsorted(_places(self.pattern), np.arange(n) * (scene.size + 1) + self.start)
        columns = [part.data for part in wide]
        self._laplacian = None
        if m.terms.stabilised or m.terms.stiffened:
            C = [t.C for t in scene.templates]
            near, bending = self._wide(C, base.n_rows), np.zeros(self._G.nnz)
            bending[np.searchsorted(_places(self._G), _places(near))] = near.data
            columns.append(bending)
            self._laplacian = csr_rows(scene, base, C, base.n_rows, len(base.ids))
            self._base = m.part.rows.field("base")[:, d]
        lists = left.indptr, left.data, self._row, self._G.indptr, self._G.indices
        self._lists = d, len(columns), *(a.astype(np.int64) for a in lists), np.column_stack(columns)
        self._blocks = *(a.astype(np.int64) for a in (self.pattern.indptr, self.pattern.indices)),
        self._volume = m.part.rows.field("V")
        self._anchored = self._of_anchors(wide)
        self._damping = m.part.rows.field("damping") if m.terms.bulk_damped else None
        self._bending = [there * m.part.rows.field(f"bending_{kind}")
                         for kind, there in (("weight", m.terms.stabilised), ("modulus", m.terms.stiffened))]
        self._stored: tuple[sparse.bsr_matrix, ...] = ()
        self._material = m.part.rows.material
        self._modulus = np.array([law.density * law.sound_speed**2 for law in scene.materials])[self._material]
        self._modulus = self._modulus if m.grades() is None else m.grades() * self._modulus

    def _wide(self, matrices: list, n_rows: int) -> sparse.csr_matrix:
        """The first `n_rows` rows of matrices, with the columns of all ranks."""
        scene, numbering = self.mechanics.scene, self.mechanics.part.numbering
        local = csr_rows(scene, numbering, matrices, n_rows, scene.size)
        wide = sparse.csr_matrix((local.data, self._column[local.indices], local.indptr), (n_rows, scene.size))
        wide.sort_indices()
        return wide

    def _of_anchors(self, gradients: list[sparse.csr_matrix]) -> AnchorTangent | None:
        """The part of anchored directors, where a scene has them; collective."""
        m = self.mechanics
        law, n = m.terms.director_law, m.n_owned
        if m.director is None or law is None or law.anchoring != "surface":
            return None
        return AnchorTangent(m, [g[:n] for g in gradients], self._wide([t.C for t in m.scene.templates], n))

    def moduli(self, by_u: float, by_v: float) -> np.ndarray:
        """Moduli V (by_u ∂P/∂F + by_v ∂P/∂Ḟ) (d, k, d, k, n_rows) [pN] of the rows.

        k is d, with stabilisation d + 1: the last columns of F and P are C u and its conjugate.
        """
        m, terms, d = self.mechanics, self.mechanics.terms, self.dimension
        F, rate = m.state.tensors()
        given = {"F": F, "Fdot": rate, **m.internal_fields()}
        A, grades = np.zeros((d, d, d, d, F.shape[-1])), m.grades()
        present = {"stress": True, "viscous_stress": True, "director_stress": terms.director != "none",
                   "active_stress": terms.active}
        for i, law in enumerate(m.scene.materials):
            on = self._material == i
            local = {name: values[..., on] for name, values in given.items()}
            for method in present:
                if present[method] and hasattr(law, method) and on.any():
                    grade = 1.0 if grades is None or method != "stress" else grades[on]
                    A[..., on] += grade * _of_both(lambda l=law, k=method, q=local, **moved: pointwise(l, k, q | moved),
                                                   local, by_u, by_v)
        if self._damping is not None:
            A += _of_both(lambda F, Fdot: BulkDamping().stress(self._damping, F, Fdot)[0], given, by_u, by_v)
        A *= self._volume
        if self._laplacian is None:
            return A
        bend = (self._laplacian @ m.state.memory[: self._laplacian.shape[1]]).T
        bend[:d] += self._base.T
        wider = _of_both(self._bent, {name: np.concatenate([a, b[:, None]], axis=1) for name, a, b in (
            ("F", F, bend[:d]), ("Fdot", rate, bend[d:]))}, by_u, by_v)
        wider[:, :d, :, :d] += A
        return wider

    def _bent(self, F: Any, Fdot: Any) -> tuple:
        """Stress of the stabilisations with its conjugate to C u as a last column, for such F and Ḟ."""
        weight, modulus = self._bending
        q, P = Stabilisation().stress(weight, *([row[:-1] for row in a] for a in (F, Fdot)),
                                      *([row[-1] for row in a] for a in (F, Fdot)))
        return tuple((*p, b + modulus * row[-1]) for p, b, row in zip(P, q, F, strict=True))

    def internal(self, by_u: float = 1.0, by_v: float = 0.0) -> sparse.bsr_matrix:
        """The part [Pa] of stresses and stabilisations."""
        return self._of_rows(self.moduli(by_u, by_v))

    def of_dilation(self, dilation: np.ndarray) -> sparse.bsr_matrix:
        """The geometric part [Pa] of the pressure that a `dilation` J - 1 (n_rows,) [-] makes."""
        d, k = self.dimension, self._lists[1]
        A = np.zeros((d, k, d, k, len(dilation)))
        F = self.mechanics.state.tensors()[0]
        A[:, :d, :, :d] = self._volume * self._modulus * dilation * mixed(cofactors, {"A": (F, 1.0)})
        return self._of_rows(A)

    def _of_rows(self, moduli: np.ndarray) -> sparse.bsr_matrix:
        """The matrix [Pa] for moduli (d, k, d, k, n_rows) [pN] of the rows."""
        A = np.ascontiguousarray(moduli.reshape(-1, moduli.shape[-1]).T)
        d, k, *lists = self._lists
        blocks = np.zeros((self.pattern.nnz, d, d))
        assemble(d, k, self.mechanics.n_owned, *lists, A, np.zeros(self.pattern.shape[1], np.int64), *self._blocks,
                 blocks)
        return sparse.bsr_matrix((blocks, self.pattern.indices, self.pattern.indptr), self.shape)

    def surfaces(self, by_u: float = 1.0, by_v: float = 0.0, names: tuple = (), others: bool = False,
                 secant: bool = False) -> sparse.bsr_matrix:
        """The part [Pa] of surface terms and "anchors", of those in `names` or all `others`, with the closest points of
        last; collective.

        secant : whether friction that falls with the speed counts as one in proportion to it, which never pushes.
        """
        def wanted(name: str) -> bool:
            return not names or (name in names) != others

        parts = [s.tangent(self.mechanics, by_u, by_v) for s in stencils(self.mechanics, secant)
                 if s.nodes.size and wanted(s.name)]
        found = sparse.bsr_matrix(self.shape, blocksize=(self.dimension,) * 2)
        if parts:
            rows, columns, blocks = (np.concatenate(a) for a in zip(*parts, strict=True))
            own = (rows < self.mechanics.n_owned) & blocks.any(axis=(1, 2))
            found = self._of_blocks(rows[own], columns[own], blocks[own])
        if self._anchored is not None and wanted("anchors"):
            found += by_u * self._anchored().tobsr(found.blocksize)
        return found

    def _of_blocks(self, rows: np.ndarray, columns: np.ndarray, blocks: np.ndarray) -> sparse.bsr_matrix:
        """Matrix of blocks at local rows and columns; blocks at one place are added."""
        n, wide = self.mechanics.scene.size, self.mechanics.state.in_petsc[columns]  # contacts change the ghosts
        order = np.argsort(places := rows * n + wide, kind="stable")
        first = np.flatnonzero(np.diff(places[order], prepend=-1))
        rows, columns = np.divmod(places[order[first]], n)
        ptr = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=self.mechanics.n_owned))])
        return sparse.bsr_matrix((np.add.reduceat(blocks[order], first) if len(first) else blocks, columns, ptr),
                                 self.shape, blocksize=(self.dimension,) * 2)

    def __call__(self, by_u: float = 1.0, by_v: float = 0.0) -> sparse.bsr_matrix:
        """The tangent -(by_u ∂f/∂u + by_v ∂f/∂v) [Pa] in the current state, after F was updated."""
        return self.internal(by_u, by_v) + self.surfaces(by_u, by_v)

    def matrix(self) -> PETSc.Mat:
        """A Mat with memory for all entries of bodies, those of neighbours of neighbours; collective."""
        n, d = self.mechanics.n_owned, self.dimension
        mat = PETSc.Mat().createBAIJ(((d * n, None), (d * n, None)), d, comm=self.mechanics.comm)
        self._allocate(mat, self.pattern)
        return mat

    def _allocate(self, mat: PETSc.Mat, pattern: sparse.csr_matrix) -> None:
        """Allocate the entries of a pattern in a Mat; collective."""
        pattern.sort_indices()
        self._room = _places(pattern)
        mat.setPreallocationCSR((pattern.indptr.astype(PETSc.IntType), pattern.indices.astype(PETSc.IntType),
                                 np.zeros((pattern.nnz, self.dimension, self.dimension))))

    def store(self, bodies: sparse.bsr_matrix, surfaces: sparse.bsr_matrix, mat: PETSc.Mat, pc: PETSc.PC) -> None:
        """Set a Mat to the sum of both parts, after allocation of entries for new contacts; collective.

        PETSc does not notice the allocation, so that `pc`, which may have factors of the Mat, is reset.
        """
        shape = self.mechanics.n_owned, self.mechanics.scene.size
        new = _pattern(surfaces, shape)
        wanted = _places(new)
        at = np.searchsorted(self._room, wanted)
        missing = (at == len(self._room)).any() or (self._room[at] != wanted).any()
        if self.mechanics.comm.allreduce(bool(missing), MPI.LOR):
            self._allocate(mat, (new + _of_places(self._room, shape)).tocsr())
            pc.reset()
        fill(mat, bodies, surfaces)
        self._stored = bodies, surfaces

    def saved(self) -> dict[str, np.ndarray]:
        """What is in the Mat, on one rank, with the room in it, by which the order of elimination goes.

        Arrays of CSR, values (nnz, d, d) [Pa], and numbers (nnz,) int of the entries that there is room for.
        """
        parts = {f"tangent {k} {name}": getattr(part, name) for k, part in enumerate(self._stored)
                 for name in ("data", "indices", "indptr")}
        return parts | {"tangent room": self._room}

    def restore(self, mat: PETSc.Mat, arrays: Arrays) -> None:
        """Set a Mat as `saved` found it, from arrays (nnz, …) [Pa], int."""
        shape = self.mechanics.n_owned, self.mechanics.scene.size
        self._allocate(mat, _of_places(arrays["tangent room"], shape))
        self._stored = tuple(sparse.bsr_matrix(tuple(arrays[f"tangent {k} {name}"] for name in (
            "data", "indices", "indptr")), self.shape) for k in range(2))
        fill(mat, *self._stored)


def _pattern(K: Any, shape: tuple[int, int]) -> sparse.csr_matrix:
    """Pattern of a matrix: ones at its entries or blocks."""
    return sparse.csr_matrix((np.ones(len(K.indices)), K.indices, K.indptr), shape)


def _places(pattern: sparse.csr_matrix) -> np.ndarray:
    """A number for the row and column of each entry (nnz,) int."""
    row = np.repeat(np.arange(pattern.shape[0]), np.diff(pattern.indptr))
    return row * pattern.shape[1] + pattern.indices


def _of_places(places: np.ndarray, shape: tuple[int, int]) -> sparse.csr_matrix:
    """The pattern with entries at these `_places` (nnz,) int."""
    return sparse.csr_matrix((np.ones(len(places)), np.divmod(places, shape[1])), shape)


def _of_both(stress: Any, given: dict[str, np.ndarray], by_u: float, by_v: float) -> np.ndarray:
    """Derivative by_u ∂/∂F + by_v ∂/∂Ḟ (d, d, d, d, n) [Pa] of a stress."""
    return mixed(stress, {"F": (given["F"], by_u), "Fdot": (given["Fdot"], by_v)})


def fill(mat: PETSc.Mat, *parts: sparse.bsr_matrix) -> None:
    """Set a Mat to the sum of `parts`, which are the rows of this rank; collective."""
    mat.zeroEntries()
    for part in parts:
        mat.setValuesBlockedCSR(part.indptr.astype(PETSc.IntType), part.indices.astype(PETSc.IntType), part.data,
                                addv=True)
    mat.assemble()


def typical(K: sparse.bsr_matrix, start: int, comm: Any) -> float:
    """Mean of the diagonal of K over all ranks [Pa]; `start` : first column of this rank; collective."""
    rows = np.repeat(np.arange(len(K.indptr) - 1), np.diff(K.indptr))
    on = K.indices == rows + start
    found = np.array([np.trace(K.data[on].sum(axis=0)) if on.any() else 0.0, K.shape[0]])
    total = sum(comm.allgather(found))
    return float(total[0] / total[1])
