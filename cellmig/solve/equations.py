"""The equation of motion as PETSc's implicit integrators want it: residuals, and their tangent as a Mat."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from petsc4py import PETSc

from .mechanics import Mechanics
from .stiffness import Stiffness


class Equations:
    """M a - f(u, v, t) = 0 on a rank's particles; where a support holds, a is that of the support.

    evaluated : number of evaluations of forces;  assembled : of tangents;  matrix : Mat -- the last tangent.
    """

    def __init__(self, mechanics: Mechanics):
        """Collective."""
        self.mechanics = m = mechanics
        self.stiffness = Stiffness(m)
        self.mass = 1.0 / m.kernel["inverse_mass"][: m.n_owned, None]
        self.matrix = self.stiffness.matrix()
        self.evaluated = self.assembled = 0
        self.free = np.ones((m.n_owned, 2))
        if m.terms.histories is not None:
            self.free[m.kernel["held"] // 4, m.kernel["held"] % 4] = 0.0
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

    def linearise(self, t: float, u: np.ndarray, v: np.ndarray, by_v: float, by_a: float, pc: PETSc.PC) -> None:
        """The derivative by u to `matrix`, while v and a change by_v and by_a times as much; collective."""
        n = self.mechanics.n_owned
        self.accelerate(t, u, v)
        K = self.stiffness(1.0, by_v)
        rows = np.repeat(np.arange(n), np.diff(K.indptr))
        K.data *= self.free[rows, :, None]
        own = np.arange(n)
        inertia = by_a * self.mass[:, :, None] * np.eye(2)
        K = K + sparse.bsr_matrix((inertia, own + self.stiffness.start, np.arange(n + 1)), K.shape)
        K.sort_indices()
        self.stiffness.store(K, self.matrix, pc)
        self.assembled += 1

    def destroy(self) -> None:
        """Free the PETSc object."""
        self.matrix.destroy()
