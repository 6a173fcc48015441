"""Quasi-static equilibrium: load steps, each solved by Newton's method in PETSc's SNES."""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import deepcopy
from itertools import combinations
from typing import Any

import numpy as np
from scipy import sparse

from petsc4py import PETSc

from ..model.tensors import determinant
from ..parallel.collect import Arrays
from ..parallel.options import default_options, original_errors
from .mechanics import Mechanics
from .plates import PlateContact
from .step import NO_EXTREMES, NumericsError, widen
from .stiffness import Stiffness, fill, typical

REPORTED = 20  # load steps that the log lists; the manifest lists all
CUTS = 8  # number of times that a load step may be halved
TOLERANCE = 1e-10  # root mean square residual of a particle, over shear modulus × spacing [-]
WEAK = 1e-10  # springs in Newton's matrix that make it regular if rigid motions are free, over its mean diagonal [-]
_COUNTED = ("time", "steps", "redone", "dt", "count", "extremes", "newton")
# Full Newton steps: with a bulk modulus of 150 shear moduli the residual grows at first, and line searches stagnate.
DEFAULTS = {"snes_type": "newtonls", "snes_linesearch_type": "basic", "snes_max_it": "20",
            "snes_divergence_tolerance": "1e8", "ksp_type": "preonly",
            "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}


class Static:
    """Equilibria of a Mechanics, -f(u, t) = 0, along the loads and supports, which depend on the time t.

    A load step that does not converge is halved, one that does is followed by one twice as long.

    Attributes
    ----------
    time, dt : float -- time reached, and last load step [µs].
    steps, redone : int -- load steps taken, and load steps that failed.
    newton : list -- time of each load step [µs], and norm of the residual in each iteration [pN/µm, in space
        pN].
    extremes : dict -- smallest and largest J [-] and load step [µs].
    """

    closing, leapfrog, between_samples, fixed_step, whole_step, mechanism = "", False, False, None, None, "load"

    def __init__(self, mechanics: Mechanics):
        """Begin at rest; collective."""
        self.mechanics = m = mechanics
        self.time, self.steps, self.redone, self.dt = 0.0, 0, 0, 0.0
        self.count: dict[str, int] = {}
        self.extremes = dict(NO_EXTREMES)
        self.after_batch: Callable[[float], None] = lambda time: None
        self.report: Callable[[str], None] = lambda text: None
        self.newton: list[tuple[float, list[float]]] = []
        self.halted = False
        m.state.v[:] = 0.0
        m.state.exchange()
        self.stiffness = Stiffness(m)
        self.plates = PlateContact(m)
        self._free_bodies = not _rigid_motions_are_held(m)
        self.rate()
        self._scale = typical(self.stiffness(), self.stiffness.start, m.comm)
        self._external = self._external_forces()
        self._snes()

    def _snes(self) -> None:
        """Create the SNES from its options, by default full Newton steps and a direct solver."""
        m, d = self.mechanics, self.mechanics.scene.dimension
        direct = PETSc.Options().getString("pc_type", DEFAULTS["pc_type"]) in ("lu", "cholesky")
        self.snes = snes = PETSc.SNES().create(comm=m.comm)
        self._x = PETSc.Vec().createMPI((d * m.n_owned, None), bsize=d, comm=m.comm)
        self._r = self._x.duplicate()
        self._matrix = self.stiffness.matrix()
        snes.setFunction(self._residual, self._r)
        snes.setJacobian(self._tangent, self._matrix)
        t, law = m.scene.templates, m.scene.materials
        force = max(l.shear_modulus for l in law) * max(b.spacing for b in t) ** (d - 1) * math.sqrt(m.scene.size)
        snes.setTolerances(rtol=TOLERANCE, atol=TOLERANCE * force, stol=0.0)
        snes.setConvergenceHistory(reset=True)
        with default_options({k: v for k, v in DEFAULTS.items() if direct or k != "pc_factor_mat_solver_type"}):
            snes.setFromOptions()

    @property
    def description(self) -> str:
        """Name of the solvers, for the log."""
        ksp = self.snes.getKSP()
        return f"static: {self.snes.getType()} of PETSc with {ksp.getType()} and {ksp.getPC().getType()}"

    def record(self) -> dict[str, Any]:
        """Residuals of all iterations, for the manifest."""
        return {"newton": self.newton}

    @property
    def finished(self) -> bool:
        """Whether `halt` was called."""
        return self.halted

    def arrays(self) -> dict[str, np.ndarray]:
        """Further arrays of a checkpoint: none."""
        return {}

    def halt(self) -> None:
        """End `advance_to` after the current load step."""
        self.halted = True

    def rate(self) -> np.ndarray:
        """(v, a) of the owned particles (n_owned, 2 d) [µm/µs, µm/µs²]: zero; updates F and reactions; collective."""
        return np.zeros((len(self._forces()), 2 * self.mechanics.scene.dimension))

    def saved(self) -> dict[str, Any]:
        """State for a checkpoint at a sample: time, last load step and all counts."""
        return deepcopy({name: getattr(self, name) for name in _COUNTED})

    def restore(self, about: dict[str, Any], arrays: Arrays) -> None:
        """Set the state from `about`, which `saved` returned, after that of the mechanics was restored; collective.

        arrays : those of the checkpoint, of any shape and unit.
        """
        for name in _COUNTED:
            setattr(self, name, deepcopy(about[name]))
        self.plates.store(self._forces())
        self._external = self._external_forces()

    # ------------------------------------------------------------ equations

    def _forces(self) -> np.ndarray:
        """Forces (n_owned, d) [pN/µm] without reactions of supports and plates; sets those of supports; collective."""
        m = self.mechanics
        f = m.state.mass[:, None] * m.rate()[:, m.scene.dimension :]
        f[m.loads.held] -= m.loads.reaction  # which the kernel chose such that accelerations are those of supports
        m.loads.reaction[:] = -f[m.loads.held]
        return f

    def _set_displacements(self, x: PETSc.Vec) -> None:
        self.mechanics.state.u[:] = x.getArray(readonly=True).reshape(self.mechanics.state.u.shape)

    def _residual(self, snes: PETSc.SNES, x: PETSc.Vec, out: PETSc.Vec) -> None:
        """Set `out` to -f; for a held component, to stiffness times the distance from its prescribed displacement."""
        m = self.mechanics
        self._set_displacements(x)
        r = -self._forces()
        r = self.plates.residual(r, self._scale)
        held = m.loads.held
        r[held] = self._scale * (m.state.u[held] - m.loads.prescribed())
        F = m.state.tensors()[0][..., : m.n_owned]
        if (determinant(F) <= 0.0).any():
            r[:] = np.nan  # a line search shortens its step, else the load step is halved
        out.setArray(r.ravel())

    def _tangent(self, snes: PETSc.SNES, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        """Set the matrix P to the derivative of the residual."""
        n = self.mechanics.n_owned
        self._set_displacements(x)
        f = self._forces()
        K = self.stiffness()
        factor, diagonal = self.plates.rows(f, self._scale)
        i, c = self.mechanics.loads.held
        factor[i, c], diagonal[i, c] = 0.0, 0.0
        diagonal[i, c, c] = self._scale
        if self._free_bodies:
            diagonal += WEAK * self._scale * np.eye(diagonal.shape[-1])
        row = np.repeat(np.arange(n), np.diff(K.indptr))
        K = sparse.bsr_matrix((np.einsum("eij,ejk->eik", factor[row], K.data), K.indices, K.indptr), K.shape)
        own = np.arange(n)
        fill(P, K + sparse.bsr_matrix((diagonal, own + self.stiffness.start, np.arange(n + 1)), K.shape))

    # ------------------------------------------------------------ load steps

    def advance_to(self, stop: float) -> float:
        """Find the equilibria up to the time `stop` [µs]; collective.

        Returns
        -------
        float -- the time reached [µs], earlier than `stop` where `halt` was called.

        Raises
        ------
        NumericsError -- where a load step was halved CUTS times and does not converge.
        """
        step = shortest = stop - self.time
        shortest /= 2**CUTS
        while self.time < stop and not self.halted:
            trial = stop if self.time + step > stop - 0.5 * shortest else self.time + step
            if self._converges_at(trial):
                step = 2.0 * (trial - self.time)
                self._accept(trial)
            else:
                self.redone += 1
                step = 0.5 * (trial - self.time)
                if step < shortest:
                    self._give_up(trial)
                unit = self.mechanics.scene.time_unit
                self.report(f"no equilibrium at {unit.text(trial)} ({self._reason()}): "
                            f"the load step is cut to {unit.text(step, 3)}")
        return self.time

    def _converges_at(self, time: float) -> bool:
        """Whether Newton's method converges at a time [µs]; if not, the state is restored; collective."""
        m = self.mechanics
        self._before = m.state.u.copy()
        m.loads.set_clock(time)
        self._x.setArray(self._before.ravel())
        with original_errors():
            self.snes.solve(None, self._x)
        norms = [float(n) for n in self.snes.getConvergenceHistory()[0]]
        good = self.snes.getConvergedReason() > 0
        self.newton.append((time, norms))
        if good:
            self._set_displacements(self._x)
            m.state.u[m.loads.held] = m.loads.prescribed()
        else:
            m.loads.set_clock(self.time)
            m.state.u[:] = self._before
        self.plates.store(self._forces())
        return good

    def _external_forces(self) -> np.ndarray:
        """Forces of supports, loads and plates on the owned particles (n_owned, d) [pN/µm]."""
        return self.mechanics.loads.add_to(self.plates.force())

    def _accept(self, time: float) -> None:
        """Add the work of external forces in the load step, by the trapezoidal rule; update counts and extremes."""
        m = self.mechanics
        now = self._external_forces()
        work = 0.5 * ((self._external + now) * (m.state.u - self._before)).sum(axis=1)
        m.accounts.of_particles["external_work"] += work
        self._external, self.dt, self.time = now, time - self.time, time
        self.steps += 1
        self.count["load"] = self.steps
        limits = m.limits()
        widen(self.extremes, "J", limits["J_min"], limits["J_max"])
        widen(self.extremes, "dt", self.dt, self.dt)
        norms = self.newton[-1][1]
        if self.steps <= REPORTED:
            force = "pN" + "/µm" * (m.scene.dimension == 2)
            self.report(f"equilibrium at {m.scene.time_unit.text(time)}: {len(norms) - 1} steps of Newton, out of "
                        f"balance by {', '.join(f'{n:.2g}' for n in norms)} {force}")
        self.after_batch(time)

    def _reason(self) -> str:
        reason = self.snes.getConvergedReason()
        names = {v: k for k, v in vars(PETSc.SNES.ConvergedReason).items() if isinstance(v, int)}
        return f"SNES says {names.get(reason, reason)}"

    def _give_up(self, time: float) -> None:
        at = self.mechanics.scene.time_unit.text(time)
        self.fail(f"no equilibrium was found at {at}, though the load step was cut {CUTS} times: {self._reason()}")

    def fail(self, cause: str, particle: int | None = None, remedy: str = "") -> None:
        """End the run with a message that names a particle, by default that with the largest |ln J|; collective.

        Raises
        ------
        NumericsError -- always.
        """
        remedy = remedy or ("try smaller loads or displacements, supports that hold all rigid motions, more "
                            "time.samples, or time.integrator = \"leapfrog\" with damping")
        raise NumericsError.at(self.mechanics, self.time, cause, particle, remedy)

    def destroy(self) -> None:
        """Free the PETSc objects."""
        for thing in (self.snes, self._matrix, self._x, self._r):
            thing.destroy()


def rigid_motions(x: np.ndarray) -> np.ndarray:
    """Translations [-] and rotations [µm] (d (d + 1)/2, n, d) of particles at x (n, d) [µm]."""
    n, d = x.shape
    turns = np.zeros((d * (d - 1) // 2, n, d))
    for turn, (i, j) in zip(turns, combinations(range(d), 2), strict=True):
        turn[:, i], turn[:, j] = -x[:, j], x[:, i]
    return np.concatenate([np.repeat(np.eye(d)[:, None], n, axis=1), turns])


def _rigid_motions_are_held(m: Mechanics) -> bool:
    """Whether supports hold the translations and rotations of every cell."""
    held, d = m.loads.boundary.held, m.scene.dimension
    for cell in range(len(m.scene.kind)):
        particle, component = held[m.scene.cell_of(held[:, 0]) == cell].T
        x = m.scene.particles(particle).X - m.scene.centre[cell]
        motion = rigid_motions(x)[:, np.arange(len(x)), component]
        if np.linalg.matrix_rank(motion, tol=1e-9 * np.abs(x).max(initial=1.0)) < d * (d + 1) // 2:
            return False
    return True
