"""Residual and tangent of the equation of motion, for PETSc's implicit integrators."""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import numpy as np

from petsc4py import PETSc

from ..model.adhesion import GAUSS
from ..model.tensors import cofactors, contracted, determinant
from ..parallel.collect import Arrays
from ..parallel.reduce import largest
from .mechanics import Mechanics
from .stencils import DRAGS
from .stiffness import Stiffness, fill

DIFFERENCE = 4e-7  # largest displacement in a finite difference of forces [spacings]
MATRIX_FREE_FROM = 1_000  # particles of a scene: in larger ones factorisation costs most, and factors are reused
MOST_PARTS = 20  # in which the work of a step is added up
DEEPEST = 3.0  # how far surfaces may reach into each other, over the least equilibrium distance of their bonds [-]
STIFFER, STIFFENINGS = 4.0, 5  # least factor of 1/dt in tangents of shorter steps, and how often it is squared
STIFFEST = STIFFER ** 2.0 ** (STIFFENINGS - 1)  # the largest
SLOW = 0.01  # largest change of the speed in such a difference, over that at which bonds yield [-]
REUSE_ITERATIONS, REUSE_CHANGE = 12, 2.0  # limits of reuse: Krylov iterations of a solve, ratio of two steps


class Equations:
    """The equation of motion (2), M a - f(u, v, t) = 0, of a rank's particles, or without inertia -f(u, v, t) = 0.

    A component that a support holds has the acceleration of the support in place of f/M; without inertia its equation
    is u = ū, times a stiffness.

    Attributes
    ----------
    evaluated, assembled : int -- number of evaluations of f, and of assembled tangents.
    matrix : Mat -- the last tangent that was assembled.
    matrix_free : bool -- whether tangents are applied by differences of forces while `matrix` preconditions, by the
        option -matrix_free, else without inertia, and in scenes of more than MATRIX_FREE_FROM particles.
    exact : int -- for how many steps yet tangents are assembled all the same: differences are wrong across a kink.
    slips : bool -- whether there is friction, which may fall with the speed.
    yields : float -- least speed at which bonds yield, infinite where they do not [µm/µs].
    """

    def __init__(self, mechanics: Mechanics, holding: float = 0.0):
        """Allocate the matrix; `holding` : without inertia, stiffness of supports in place of M [Pa]; collective."""
        self.mechanics = m = mechanics
        self.spacing = min(t.spacing for t in m.scene.templates)
        self.stiffness = Stiffness(m)
        self.mass = m.state.mass[:, None]
        self.matrix = self.stiffness.matrix()
        self.evaluated = self.assembled = 0
        self.free = np.ones(m.state.u.shape)
        self.free[m.loads.held] = 0.0
        self.inertia = holding * (1.0 - self.free) if holding else self.mass * np.ones_like(self.free)
        self.matrix_free = PETSc.Options().getBool("matrix_free", holding > 0.0 or m.scene.size > MATRIX_FREE_FROM)
        self.exact = self._solves = self._iterations = 0
        self.geometric: Any = self.stiffness.matrix() if self.matrix_free else None  # to take off
        self._start, self._last = np.zeros(0), np.zeros(0)  # J at the start of the step, F of the last tangent
        self._begun = 0.0  # time of that start [µs]
        self._stiffer = STIFFER  # factor of 1/dt that `descend` tries first
        self._by_v = 0.0  # 0 before there is a matrix
        self._still: Any = None  # tangent of surface terms in the state `at`, but of those that depend on velocities
        self.slips = m.terms.friction is not None or bool(m.terms.contacts and m.terms.contacts.frictions)
        self.yields = min((getattr(law, "speed", math.inf) for law in m.terms.frictions), default=math.inf)
        self._touches = m.terms.substrate is not None or m.terms.contacts is not None
        self._deepest = DEEPEST * m.terms.contacts.thinnest if m.terms.contacts is not None else 0.0

    def halves(self, x: PETSc.Vec) -> list[np.ndarray]:
        """Both halves (n_owned, d) of a Vec of (n_owned, 2 d), such as u [µm] and v [µm/µs] of (u, v)."""
        return np.split(x.getArray(readonly=True).reshape(len(self.free), -1), 2, axis=1)

    def acceleration(self, t: float, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Acceleration f/M for displacements u and velocities v at the time t; sets the state; collective.

        Parameters
        ----------
        t : float -- time [µs].
        u, v : (n_owned, d) float -- displacements [µm], velocities [µm/µs].

        Returns
        -------
        (n_owned, d) float -- [µm/µs²]; nan where a particle is inverted, or surfaces are far inside each other or
            beyond the search lists.  The wall between cells is finite: edges that meet at speed cross for a while, and
            it still drives them apart.
        """
        m = self.mechanics
        m.set_clock(t)
        m.state.u[:], m.state.v[:] = u, v
        m.state.forget_contacts()
        a = m.rate(t - self._begun)[:, m.scene.dimension :].copy()
        self.evaluated += 1
        late = self._touches and (m.segments.displaced() > 0.5 * m.segments.skin or m.segments.depth > self._deepest)
        if (m.state.J_of_rows <= 0.0).any() or late:
            a[:] = np.nan  # Newton's method shortens its step, else TS cuts the time step
        return a

    def work_along(self, u: np.ndarray, moved: np.ndarray, t: float, dt: float, piece: float) -> np.ndarray:
        """Work of all forces (n_owned,) [pN], [pN µm] while particles move on a straight path; collective.

        Dissipation and work of terms are added to the accounts.

        Parameters
        ----------
        u, moved : (n_owned, d) float -- displacements at the start, and their change [µm].
        t, dt : float -- time of the start, and of the way [µs].
        piece : float -- length of the parts of the way, each of which has Gauss points [µm].
        """
        m, work = self.mechanics, np.zeros(len(u))
        parts = int(min(max(1.0, np.ceil(largest(m.comm, moved) / piece)), MOST_PARTS))
        for part, (at, weight) in product(range(parts), GAUSS):
            at, share = (part + at) / parts, weight / parts
            a = self.acceleration(t + at * dt, u + at * moved, moved / dt)
            work += share * (self.mass * a * moved).sum(axis=1)
            m.accounts.add(share * dt)
        return work

    def residual(self, t: float, u: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Residual M a - f(u, v, t) [pN/µm]; it and u, v, a [µm, µm/µs, µm/µs²] are (n_owned, d); collective."""
        return self.mass * (a - self.acceleration(t, u, v))

    def imbalance(self, t: float, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Residual -f(u, v, t), of held components the stiffness times u - ū [pN/µm]; all as `residual`; collective."""
        force = self.free * self.mass * self.acceleration(t, u, v)
        away = np.zeros_like(u)
        away[self.mechanics.loads.held] = u[self.mechanics.loads.held] - self.mechanics.loads.prescribed()
        return self.inertia * away - force

    def begin(self, time: float) -> None:
        """Note the state at the start of a step, at a `time` [µs]; collective."""
        self.exact = max(0, self.exact - 1)
        self.mechanics.rate(0.0)  # a step before may have been undone
        self.mechanics.begin_step()
        self._begun, self._stiffer = time, STIFFER
        self._start = self.mechanics.state.J_of_rows

    def _error_of_J(self, first: bool) -> np.ndarray:
        """What J of the rows has (n_rows,) [-] beyond its linear change, or beyond the start of the step at `first`."""
        F = self.mechanics.state.tensors()[0]
        last, self._last = self._last, F
        if first:
            return self.mechanics.state.J_of_rows - self._start
        change = F - last
        of_second_order = contracted(last, cofactors(change)) if len(F) == 3 else 0.0
        return of_second_order + determinant(change)

    def saved(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """The tangent that is reused, for a checkpoint: numbers and, on one rank, arrays as `Stiffness.saved` has them.

        On several ranks none, as what they sum has no fixed order in any case.
        """
        if not self.matrix_free or not self._by_v or self.mechanics.comm.size > 1:
            return {}, {}
        return {"by_v": self._by_v, "exact": self.exact, "iterations": self._iterations}, self.stiffness.saved()

    def restore(self, about: dict[str, Any], arrays: Arrays) -> None:
        """Set the tangent from the results of `saved`, arrays (nnz, …) [Pa], int; without them it is made anew."""
        if about and self.matrix_free and self.mechanics.comm.size == 1:
            self._by_v, self.exact, self._iterations = about["by_v"], about["exact"], about["iterations"]
            self.stiffness.restore(self.matrix, arrays)

    def linearise(self, t: float, u: np.ndarray, v: np.ndarray, by_v: float, by_a: float, ksp: PETSc.KSP,
                  pc: PETSc.PC, first: bool) -> None:
        """Set the tangent by_a M - by_v ∂f/∂v - ∂f/∂u of the residual, where M is `inertia`; collective.

        Its geometric part has the pressure that the last Newton step led to if J were linear.  The square of a turn,
        times the bulk modulus, would be a pressure far above all that is real, and the tangent indefinite.

        The matrix is assembled; in the matrix-free form, only if the last solve took many iterations or by_v changed,
        or where a difference of forces would change speeds by more than bonds bear.

        Parameters
        ----------
        t : float -- time [µs].
        u, v : (n_owned, d) float -- displacements [µm], velocities [µm/µs].
        by_v, by_a : float -- ∂v/∂u [1/µs] and ∂a/∂u [1/µs²] of the time integrator.
        ksp : KSP -- that of the last solve.
        pc : PC -- the preconditioner, which may have factors of the matrix.
        first : bool -- whether a solve begins.

        Source: the shifts of TSSetI2Jacobian, PETSc's manual; stresses that are variables of their own in Newton's
        method, Magisano, Leonetti & Garcea (2017), here the pressure.
        """
        self.at, self._still = (t, u.copy(), v.copy(), by_v, by_a, self.acceleration(t, u, v)), None
        n = self.mechanics.n_owned
        self._geometric = geometric = self.stiffness.of_dilation(self._error_of_J(first))
        geometric.data *= self.free[np.repeat(np.arange(n), np.diff(geometric.indptr)), :, None]
        if self.geometric is not None:
            fill(self.geometric, geometric)
        if self._solves:
            self._iterations = ksp.getIterationNumber()
        self._solves += 1
        if self.matrix_free and by_v * DIFFERENCE * self.spacing > SLOW * self.yields:
            self.exact = max(self.exact, 1)
        if self.matrix_free and not self.exact and self._by_v and self._iterations <= REUSE_ITERATIONS:
            self._by_v = 1.0 / REUSE_CHANGE < by_v / self._by_v < REUSE_CHANGE and self._by_v
            if self._by_v:
                return
        self._assemble(by_v, by_a, pc)

    def _assemble(self, by_v: float, by_a: float, pc: PETSc.PC, secant: bool = False) -> None:
        """Set the matrix for the state of now, with the `secant` of friction or its slope; collective."""
        bodies = self.stiffness.internal(1.0, by_v)
        if self._still is None:
            self._still = self.stiffness.surfaces(1.0, by_v, DRAGS, others=True)
        surfaces = self._still + self.stiffness.surfaces(1.0, by_v, DRAGS, secant=secant)
        for K in (bodies, surfaces):
            K.data *= self.free[np.repeat(np.arange(len(self.free)), np.diff(K.indptr)), :, None]
        bodies.data -= self._geometric.data
        bodies.data[self.stiffness.diagonal] += by_a * self.inertia[:, :, None] * np.eye(self.free.shape[1])
        self.stiffness.store(bodies, surfaces, self.matrix, pc)
        self.assembled, self._by_v = self.assembled + 1, by_v

    def descend(self, residual: PETSc.Vec, step: PETSc.Vec, ksp: PETSc.KSP) -> float:
        """Set a Newton step to one down in energy, by the secant of friction and shorter time steps; collective.

        Friction that falls with the speed makes the tangent indefinite, however short a time step is.  Its secant, the
        ratio to the speed, is positive and lies above all slopes, so that full steps with it go down.  Where a contact
        lets go, or closes, a Newton step leads to the state between; the tangent of a shorter time step is definite, as
        viscosity grows with 1/dt.  If none is, the step is as it was, or reversed if it goes up.

        Returns the work of the residual on the step [pN, pN µm], which is not negative.
        """
        t, u, v, by_v, by_a, _ = self.at
        exact, self.exact = self.exact, max(self.exact, 1)
        operators, given = ksp.getOperators(), step.copy()
        stiffer = np.unique(np.minimum(self._stiffer ** np.exp2(np.arange(STIFFENINGS)), STIFFEST))
        for factor in (*([1.0] if self.slips else []), *stiffer):
            self.acceleration(t, u, v)
            self._assemble(factor * by_v, by_a, ksp.getPC(), secant=True)
            ksp.setOperators(*operators)  # new contacts have reset the preconditioner
            ksp.solve(residual, step)
            self._stiffer = max(STIFFER, factor**0.5)
            if residual.dot(step) > 0.0:
                break
        else:
            self._stiffer = STIFFER
            given.copy(step)
            step.scale(math.copysign(1.0, residual.dot(given)))
        self.exact = exact
        return residual.dot(step)

    def apply(self, u: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Change of the residual [pN/µm] with u, v and a [µm, µm/µs, µm/µs²], each (n_owned, d); collective."""
        t, u0, v0, _, _, a0 = self.at
        longest = largest(self.mechanics.comm, u)
        step = DIFFERENCE * self.spacing / max(longest, 1e-300)
        x, y = self.geometric.createVecs()
        x.setArray(u.ravel())
        self.geometric.mult(x, y)
        change = self.inertia * a - self.mass * (self.acceleration(t, u0 + step * u, v0 + step * v) - a0) / step
        change -= y.getArray().reshape(u.shape)
        x.destroy()
        y.destroy()
        return change

    def applied(self) -> PETSc.Mat:
        """The tangent that Krylov methods apply: the assembled one, or differences of forces; collective."""
        if not self.matrix_free:
            return self.matrix
        return PETSc.Mat().createPython(self.matrix.getSizes(), self, comm=self.mechanics.comm)

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y to the tangent times x, by a finite difference of forces, for a Mat of type python; collective."""
        if self.exact:
            self.matrix.mult(x, y)
            return
        u, by_v, by_a = x.getArray(readonly=True).reshape(self.free.shape), *self.at[3:5]
        y.setArray(self.apply(u, by_v * u, by_a * u).ravel())

    def damp(self, r: np.ndarray) -> np.ndarray:
        """(by_v M - ∂f/∂v) r (n_owned, d) [pN/µm] for r (n_owned, d) [µm/µs], exact if f is linear in v; collective."""
        t, u, v, by_v, _, a = self.at
        return self.mass * (by_v * r + self.free * (a - self.acceleration(t, u, v + r)))

    def close(self) -> None:
        """Free the PETSc objects."""
        self.matrix.destroy()
        if self.geometric is not None:
            self.geometric.destroy()
