"""The equation of motion as PETSc's implicit integrators want it: residuals, and their tangent as a Mat."""

from __future__ import annotations

import numpy as np

from petsc4py import PETSc

from ..parallel.reduce import extreme
from .mechanics import Mechanics
from .stiffness import Stiffness

NEAR = 4e-7  # spacings by which particles move, at most, for a difference of forces
KEPT_FROM = 1_000  # particles of the scene: beyond, a tangent is kept as a preconditioner, as its factors cost most
SERVES, CHANGE = 12, 2.0  # iterations of Krylov methods, and change of the step, up to which a tangent is kept


class Equations:
    """M a - f(u, v, t) = 0 on a rank's particles; where a support holds, a is that of the support.

    evaluated : number of evaluations of forces;  assembled : of tangents;  matrix : Mat -- the last tangent;
    matrix_free : whether tangents are applied by differences of forces and `matrix` preconditions (-matrix_free, by
    default in large scenes).
    """

    def __init__(self, mechanics: Mechanics):
        """Collective."""
        self.mechanics = m = mechanics
        self.spacing = min(t.spacing for t in m.scene.templates)
        self.stiffness = Stiffness(m)
        self.mass = 1.0 / m.kernel["inverse_mass"][: m.n_owned, None]
        self.matrix = self.stiffness.matrix()
        self.evaluated = self.assembled = 0
        self.free = np.ones((m.n_owned, 2))
        if m.terms.histories is not None:
            self.free[m.kernel["held"] // 4, m.kernel["held"] % 4] = 0.0
        self.matrix_free = PETSc.Options().getBool("matrix_free", m.scene.size > KEPT_FROM)
        self._serves = 0.0  # by_v of the matrix, none before there is one
        self._touches = m.terms.substrate is not None or m.terms.contact is not None

    def accelerate(self, t: float, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Accelerations (n_owned, 2) [µm/µs²] of a state; not a number where no body can be; collective."""
        m = self.mechanics
        m.set_clock(t)
        m.state.owned[:, :2], m.state.owned[:, 2:] = u, v
        a = m.rate()[:, 2:].copy()
        self.evaluated += 1
        F = m.by_row(m.kernel["F"])
        if (F[:, 0] * F[:, 3] - F[:, 1] * F[:, 2] <= 0.0).any() or (self._touches and m.displaced() > 0.5 * m.skin):
            a[:] = np.nan  # inverted, or beyond the search lists: a line search goes back, else the step is cut
        return a

    def residual(self, t: float, u: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """What is out of balance (n_owned, 2) [pN/µm]; collective."""
        return self.mass * (a - self.accelerate(t, u, v))

    def linearise(self, t: float, u: np.ndarray, v: np.ndarray, by_v: float, by_a: float, ksp: PETSc.KSP,
                  pc: PETSc.PC) -> None:
        """The derivative by u, while v and a change by_v and by_a times as much; collective.

        `matrix` becomes it; if tangents are applied matrix-free, only where it no longer serves `ksp`, that of the last
        solve, as a preconditioner.  `pc` : what factors it.
        """
        self.at = t, u.copy(), v.copy(), by_v, by_a, self.accelerate(t, u, v)
        if self.matrix_free and self._serves and ksp.getIterationNumber() <= SERVES:
            self._serves = 1.0 / CHANGE < by_v / self._serves < CHANGE and self._serves
            if self._serves:
                return
        n = self.mechanics.n_owned
        bodies = self.stiffness.internal(1.0, by_v)
        surfaces = self.stiffness.surfaces(1.0, by_v)
        for K in (bodies, surfaces):
            K.data *= self.free[np.repeat(np.arange(n), np.diff(K.indptr)), :, None]
        bodies.data[self.stiffness.diagonal] += by_a * self.mass[:, :, None] * np.eye(2)
        self.stiffness.store(bodies, surfaces, self.matrix, pc)
        self.assembled, self._serves = self.assembled + 1, by_v

    def apply(self, u: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Change of the residual with changes of u, v and a (n_owned, 2), by a difference of forces; collective."""
        t, u0, v0, _, _, a0 = self.at
        longest = extreme(self.mechanics.comm, np.array([np.abs(u).max(initial=0.0)]))[0]
        step = NEAR * self.spacing / max(longest, 1e-300)
        return self.mass * (a - (self.accelerate(t, u0 + step * u, v0 + step * v) - a0) / step)

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """As a Mat of type python: the derivative times a change of u."""
        u, by_v, by_a = x.getArray(readonly=True).reshape(-1, 2), *self.at[3:5]
        y.setArray(self.apply(u, by_v * u, by_a * u).ravel())

    def damp(self, r: np.ndarray) -> np.ndarray:
        """(by_v M - ∂f/∂v) r (n_owned, 2), exact for forces that are linear in v; collective."""
        t, u, v, by_v, _, a = self.at
        return self.mass * (by_v * r + self.free * (a - self.accelerate(t, u, v + r)))

    def close(self) -> None:
        """Free the PETSc object."""
        self.matrix.destroy()
