"""Newton's equations of the first-order system (u, v), reduced to u by a Schur complement: a Mat and a PC for PETSc."""

from __future__ import annotations

import numpy as np

from petsc4py import PETSc

from .equations import Equations


class Reduction:
    """Tangent J of the residuals r1 = u' - v and r2 = M v' - f(u, v), with σ = ∂u'/∂u = ∂v'/∂v [1/µs].

    With C = -∂f/∂v and the Schur complement S = σ² M + σ C - ∂f/∂u, which `Equations` assembles,

        J (a, b) = (σ a - b, S a - (σ M + C)(σ a - b)),

    so that the solution of J (a, b) = (r1, r2) is S a = r2 + (σ M + C) r1, b = σ a - r1.  The object is the context of
    a Mat and of a PC of type python.  The KSP of S takes the options without prefix.

    Source: derived here, by elimination of b.
    """

    def __init__(self, equations: Equations, ksp: PETSc.KSP):
        """`ksp` : the linear solver of the SNES, whose preconditioner becomes this elimination; collective."""
        self.equations, m = equations, equations.mechanics
        n = 2 * m.scene.dimension * m.n_owned
        self.matrix = PETSc.Mat().createPython(((n, None), (n, None)), self, comm=m.comm)
        self.solver = PETSc.KSP().create(m.comm)
        self.solver.setOperators(equations.matrix)
        self.solver.setFromOptions()
        self._a, self._r = equations.matrix.createVecs()
        self._shift, self._ksp = 0.0, ksp
        ksp.setOptionsPrefix("reduction_")
        ksp.getPC().setType(PETSc.PC.Type.PYTHON)
        ksp.getPC().setPythonContext(_Elimination(self))

    def linearise(self, t: float, u: np.ndarray, v: np.ndarray, shift: float, first: bool) -> None:
        """Set J for u and v (n_owned, d) [µm, µm/µs] at the time t [µs], with the shift σ [1/µs]; collective.

        first : whether a solve begins.
        """
        self.equations.linearise(t, u, v, shift, shift * shift, self._ksp, self.solver.getPC(), first)
        self._shift = shift
        self.matrix.assemble()

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y to J x, for line searches and Krylov methods; collective."""
        a, b = self.equations.halves(x)
        first, e = self._shift * a - b, self.equations
        if e.matrix_free:
            second = e.apply(a, b, self._shift * b)
        else:
            self._a.setArray(a.ravel())
            e.matrix.mult(self._a, self._r)
            second = self._r.getArray().reshape(a.shape) - e.damp(first)
        y.setArray(np.hstack([first, second]).ravel())

    def solve(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y to J⁻¹ x, to the accuracy of the KSP of S; collective."""
        r1, r2 = self.equations.halves(x)
        self._r.setArray((r2 + self.equations.damp(r1)).ravel())
        self.solver.solve(self._r, self._a)
        a = self._a.getArray().reshape(r1.shape)
        y.setArray(np.hstack([a, self._shift * a - r1]).ravel())

    def close(self) -> None:
        """Free the PETSc objects."""
        for thing in (self.matrix, self.solver, self._a, self._r):
            thing.destroy()


class _Elimination:
    """The PC; with -snes_lag_preconditioner, factors of S outlast a new J until `setUp`."""

    def __init__(self, reduction: Reduction):
        self._reduction = reduction

    def setUp(self, pc: PETSc.PC) -> None:
        """Factor S."""
        solver = self._reduction.solver
        solver.getPC().setReusePreconditioner(False)
        solver.setOperators(self._reduction.equations.matrix)
        solver.setUp()
        solver.getPC().setReusePreconditioner(True)

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y to J⁻¹ x."""
        self._reduction.solve(x, y)
