"""Direct solution of large symmetric systems on one rank, by MUMPS (Amestoy et al. 2001) through PETSc."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from petsc4py import PETSc


def solve_positive(A: sparse.csc_matrix, b: np.ndarray) -> np.ndarray:
    """Solution x (n, k) of A x = b, for a symmetric positive definite A (n, n) and b (n, k) of any units.

    Each rank solves a system of its own.
    """
    A = sparse.csr_matrix(A)
    A.sort_indices()
    indices = A.indptr.astype(PETSc.IntType), A.indices.astype(PETSc.IntType)
    matrix = PETSc.Mat().createAIJ(A.shape, csr=(*indices, A.data), comm=PETSc.COMM_SELF)
    matrix.setOption(PETSc.Mat.Option.SPD, True)
    ksp = PETSc.KSP().create(PETSc.COMM_SELF)
    ksp.setOperators(matrix)
    ksp.setType(PETSc.KSP.Type.PREONLY)
    ksp.getPC().setType(PETSc.PC.Type.CHOLESKY)
    ksp.getPC().setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
    x, y = matrix.createVecs()
    out = np.empty_like(b)
    for k in range(b.shape[1]):
        y.setArray(b[:, k])
        ksp.solve(y, x)
        out[:, k] = x.getArray(readonly=True)
    for each in (ksp, matrix, x, y):
        each.destroy()
    return out
