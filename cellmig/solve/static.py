"""Equilibria under loads that grow with time: load steps, each a solve by PETSc's SNES."""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np
from scipy import sparse

from petsc4py import PETSc

from ..parallel.options import defaulted, own_errors
from .mechanics import Mechanics
from .plates import Contact
from .step import NumericsError
from .stiffness import Stiffness, fill, typical

SAID = 20  # load steps that are told one by one; all are in the manifest
CUTS = 8  # times that a load step is halved before the run gives up
TIGHT = 1e-10  # what forces may be out of balance, over modulus x spacing, in the mean over particles
WEAK = 1e-10  # of the stiffness: what keeps bodies in place, within Newton's matrix alone, that nothing holds
_COUNTED = ("time", "steps", "redone", "dt", "count", "extremes", "newton")
# Full steps: with a bulk modulus of 150 shear moduli what is out of balance grows at first, and line searches creep.
DEFAULTS = {"snes_type": "newtonls", "snes_linesearch_type": "basic", "snes_max_it": "20",
            "snes_divergence_tolerance": "1e8", "ksp_type": "preonly",
            "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}


class Static:
    """Takes a Mechanics from one equilibrium to the next; time is what loads and supports depend on.

    time : where it is [µs];  steps : load steps taken;  redone : those that were cut;  dt : the last one [µs];
    newton : for each load step its time, and what was out of balance at each of Newton's steps [pN/µm].
    """

    leapfrog, between_samples, fixed_step, whole_step, mechanism = False, False, None, None, "load"

    def __init__(self, mechanics: Mechanics):
        """Everything is at rest and free of stress at first; collective."""
        self.mechanics = m = mechanics
        self.time, self.steps, self.redone, self.dt, self.count = 0.0, 0, 0, 0.0, {}
        self.extremes = {"J_min": math.inf, "J_max": -math.inf, "dt_min": math.inf, "dt_max": 0.0}
        self.after_batch: Callable[[float], None] = lambda time: None
        self.report: Callable[[str], None] = lambda text: None
        self.newton: list[tuple[float, list[float]]] = []
        self.halted = False
        m.state.owned[:, 2:] = 0.0
        m.state.exchange()
        self.stiffness = Stiffness(m)
        self.contact = Contact(m)
        self._held = m.kernel["held"] if m.terms.histories is not None else np.zeros(0, np.int32)
        self._free_bodies = not _rigid_motions_are_held(m)
        self.rate()
        self._scale = typical(self.stiffness(), self.stiffness.start, m.comm)
        self._outside = self._from_outside()
        self._snes()

    def _snes(self) -> None:
        """SNES and its objects, as its options and those of KSP and PC say; by default Newton and a direct solver."""
        m = self.mechanics
        direct = PETSc.Options().getString("pc_type", DEFAULTS["pc_type"]) in ("lu", "cholesky")
        self.snes = snes = PETSc.SNES().create(comm=m.comm)
        self._x = PETSc.Vec().createMPI((2 * m.n_owned, None), bsize=2, comm=m.comm)
        self._r = self._x.duplicate()
        self._matrix = self.stiffness.matrix()
        snes.setFunction(self._residual, self._r)
        snes.setJacobian(self._tangent, self._matrix)
        t, law = m.scene.templates, m.scene.materials
        force = max(l.shear_modulus for l in law) * max(b.spacing for b in t) * math.sqrt(m.scene.size)
        snes.setTolerances(rtol=TIGHT, atol=TIGHT * force, stol=0.0)
        snes.setConvergenceHistory(reset=True)
        with defaulted({k: v for k, v in DEFAULTS.items() if direct or k != "pc_factor_mat_solver_type"}):
            snes.setFromOptions()

    @property
    def description(self) -> str:
        """What it is, for the log."""
        ksp = self.snes.getKSP()
        return f"static: {self.snes.getType()} of PETSc with {ksp.getType()} and {ksp.getPC().getType()}"

    def record(self) -> dict[str, Any]:
        """Newton's residuals, for the manifest."""
        return {"newton": self.newton}

    @property
    def finished(self) -> bool:
        """Whether it was told to stop."""
        return self.halted

    def halt(self) -> None:
        """Take no further step."""
        self.halted = True

    def rate(self) -> np.ndarray:
        """(v, a) of the owned particles, none: nothing moves; F and reactions are brought up to date; collective."""
        return np.zeros((len(self._forces()), 4))

    def saved(self) -> dict[str, Any]:
        """What decides its next load steps and what it counts, for a checkpoint at a sample."""
        return deepcopy({name: getattr(self, name) for name in _COUNTED})

    def restore(self, about: dict[str, Any]) -> None:
        """Go on from what was saved; the mechanics have been restored; collective."""
        for name in _COUNTED:
            setattr(self, name, deepcopy(about[name]))
        self.contact.store(self._forces())
        self._outside = self._from_outside()

    # ------------------------------------------------------------ equations

    def _forces(self) -> np.ndarray:
        """Forces but of supports and plates (n_owned, 2) [pN/µm]; reactions of supports balance them; collective."""
        m = self.mechanics
        a, mass = m.rate()[:, 2:], 1.0 / m.kernel["inverse_mass"][: m.n_owned]
        f = mass[:, None] * a
        if m.terms.histories is not None:
            i, c = m.kernel["held"] // 4, m.kernel["held"] % 4
            f[i, c] -= m.kernel["reaction"]  # made with the acceleration of the support, which is in `a`
            m.kernel["reaction"][:] = -f[i, c]
        return f

    def _take(self, x: PETSc.Vec) -> None:
        self.mechanics.state.owned[:, :2] = x.getArray(readonly=True).reshape(-1, 2)

    def _prescribed(self) -> np.ndarray:
        """Displacements of what supports hold, now [µm]."""
        k, histories = self.mechanics.kernel, self.mechanics.terms.histories or ()
        factor = np.array([h.value(k["clock"][0]) for h in histories]) if len(self._held) else np.zeros(0)
        return k["held_value"] * factor[k["held_history"]] if len(self._held) else np.zeros(0)

    def _residual(self, snes: Any, x: PETSc.Vec, out: PETSc.Vec) -> None:
        """What is out of balance; where something is held, how far it is from where it should be, as a force."""
        m = self.mechanics
        self._take(x)
        r = -self._forces()
        r = self.contact.residual(r, self._scale)
        i, c = self._held // 4, self._held % 4
        r[i, c] = self._scale * (m.state.owned[i, c] - self._prescribed())
        F = m.tensors()[0][..., : m.n_owned]
        if (F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0] <= 0.0).any():
            r[:] = np.nan  # no solution lies beyond: a line search goes back, else the load step is cut
        out.setArray(r.ravel())

    def _tangent(self, snes: Any, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        """Derivative of the residual by x."""
        n = self.mechanics.n_owned
        self._take(x)
        f = self._forces()
        K = self.stiffness()
        turn, diagonal = self.contact.rows(f, self._scale)
        i, c = self._held // 4, self._held % 4
        turn[i, c], diagonal[i, c] = 0.0, 0.0
        diagonal[i, c, c] = self._scale
        if self._free_bodies:
            diagonal += WEAK * self._scale * np.eye(2)
        row = np.repeat(np.arange(n), np.diff(K.indptr))
        K = sparse.bsr_matrix((np.einsum("eij,ejk->eik", turn[row], K.data), K.indices, K.indptr), K.shape)
        own = np.arange(n)
        fill(P, K + sparse.bsr_matrix((diagonal, own + self.stiffness.start, np.arange(n + 1)), K.shape))

    # ------------------------------------------------------------ load steps

    def advance_to(self, stop: float) -> float:
        """Go on to the equilibrium at the time `stop` [µs]; returns the time reached; collective."""
        step = shortest = stop - self.time
        shortest /= 2**CUTS
        while self.time < stop and not self.halted:
            trial = stop if self.time + step > stop - 0.5 * shortest else self.time + step
            if self._found(trial):
                step = 2.0 * (trial - self.time)
                self._take_account(trial)
            else:
                self.redone += 1
                step = 0.5 * (trial - self.time)
                if step < shortest:
                    self._give_up(trial)
                self.report(f"no equilibrium at {trial:.6g} µs ({self._reason()}): "
                            f"the load step is cut to {step:.3g} µs")
        return self.time

    def _found(self, time: float) -> bool:
        """Whether Newton's method leads to an equilibrium; if not, the state is that before; collective."""
        m = self.mechanics
        self._before = m.state.owned[:, :2].copy()
        m.set_clock(time)
        self._x.setArray(self._before.ravel())
        with own_errors():
            self.snes.solve(None, self._x)
        norms = [float(n) for n in self.snes.getConvergenceHistory()[0]]
        good = self.snes.getConvergedReason() > 0
        self.newton.append((time, norms))
        if good:
            self._take(self._x)
            i, c = self._held // 4, self._held % 4
            m.state.owned[i, c] = self._prescribed()
        else:
            m.set_clock(self.time)
            m.state.owned[:, :2] = self._before
        self.contact.store(self._forces())
        return good

    def _from_outside(self) -> np.ndarray:
        """Forces of supports, loads and plates on the owned particles (n_owned, 2) [pN/µm]."""
        k, force = self.mechanics.kernel, self.contact.force()
        if self.mechanics.terms.histories is not None:
            loaded = k["loaded"][k["loaded"] < len(force)]
            force[loaded] += k["load"][loaded]
            force[self._held // 4, self._held % 4] += k["reaction"]
        return force

    def _take_account(self, time: float) -> None:
        """Work of what acts from outside, by the trapezoidal rule over the load step; extremes; who watches."""
        m = self.mechanics
        now = self._from_outside()
        work = 0.5 * ((self._outside + now) * (m.state.owned[:, :2] - self._before)).sum(axis=1)
        m.kernel["external_work"][: m.n_owned] += work
        self._outside, self.dt, self.time = now, time - self.time, time
        self.steps += 1
        self.count["load"] = self.steps
        limits = m.limits()
        for name, value, worse in (("J_min", limits["J_min"], min), ("J_max", limits["J_max"], max),
                                   ("dt_min", self.dt, min), ("dt_max", self.dt, max)):
            self.extremes[name] = worse(self.extremes[name], value)
        norms = self.newton[-1][1]
        if self.steps <= SAID:
            self.report(f"equilibrium at {time:.6g} µs: {len(norms) - 1} steps of Newton, out of balance by "
                        + ", ".join(f"{n:.2g}" for n in norms) + " pN/µm")
        self.after_batch(time)

    def _reason(self) -> str:
        reason = self.snes.getConvergedReason()
        names = {v: k for k, v in vars(PETSc.SNES.ConvergedReason).items() if isinstance(v, int)}
        return f"SNES says {names.get(reason, reason)}"

    def _give_up(self, time: float) -> None:
        self.fail(f"no equilibrium was found at {time:.6g} µs, though the load step was cut {CUTS} times: "
                    f"{self._reason()}")

    def fail(self, cause: str, particle: int | None = None, remedy: str = "") -> None:
        """End the run, with a particle, by default that which is worst off, and a remedy; collective."""
        particle, J = self.mechanics.worst_particle(particle)
        remedy = remedy or ("try smaller loads or displacements, supports that hold all rigid motions, more "
                            "time.samples, or time.integrator = \"leapfrog\" with damping")
        raise NumericsError(f"the numbers broke at {self.time:.6g} µs: {cause}; particle {particle} of cell "
                            f"{int(self.mechanics.scene.cell[particle]) + 1} has J = {J:.4g}; {remedy}")

    def destroy(self) -> None:
        """Free the PETSc objects."""
        for thing in (self.snes, self._matrix, self._x, self._r):
            thing.destroy()


def _rigid_motions_are_held(m: Mechanics) -> bool:
    """Whether supports hold the translations and the rotation of every cell."""
    held = m.boundary.held
    for cell in range(len(m.scene.kind)):
        on = held[m.scene.cell[held[:, 0]] == cell]
        x = m.scene.X[on[:, 0]] - m.scene.centre[cell]
        motion = np.where(on[:, 1] == 0, [np.ones(len(on)), np.zeros(len(on)), -x[:, 1]],
                          [np.zeros(len(on)), np.ones(len(on)), x[:, 0]])
        if len(on) < 3 or np.linalg.matrix_rank(motion, tol=1e-9 * max(1.0, np.abs(x).max())) < 3:
            return False
    return True
