"""Motion without inertia, 0 = f(u, u', t), for minutes and hours: equation (2) with all forces in balance."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from petsc4py import PETSc

from ..case.schema import Case
from ..kernel.terms import present
from ..meshfree.simplices import facet_sizes
from ..parallel.collect import Arrays
from ..parallel.options import default_options
from ..parallel.reduce import exact_sum, largest
from .equations import Equations
from .implicit import BALANCE, Implicit
from .stencils import FRICTION

SOLID = 1e-6  # first step over the time to the next sample, without a fluid [-]
ERROR = 0.01  # error of a step, mean over particles, over the spacing [-]: one that snaps does not set the step
SAFETY, SHORTER, LONGER = 0.8, 0.2, 2.0  # of the next step: share of the expected one, limits of its change
ITERATIONS = 100  # of Newton's method: 3 or 4, 10 where a particle snaps to the substrate, up to 80 where bonds slip
STALLED, PROGRESS = 15, 0.9  # iterations without a norm that is so much smaller [-], after which a solve is given up
ACCURATE = "1e-6"  # tolerance of Krylov methods: with 1e-2 Newton's method stalls where a push turns round
EXACT = 10  # steps with assembled tangents after a solve that failed
MOVE = 0.25  # largest expected displacement in a step, over the margin of the search lists [-]
COLLAPSED = 0.1  # size of a facet over that at rest, below which tension has closed it [-]
BARE = 10.0  # the same above which few bonds are left on it [-]
CLOSED = 1e-3  # below which a run ends where a solve fails [-]: 1e-8 is left when no step is short enough
OPPOSED = 3.0  # angle between anchored directors of neighbours, at π of which their energy jumps [rad]
LIVED = 0.01  # first step that is tried over the lifetime of bonds that yield [-]: in a far shorter one all slip
FROZEN = 1e-6  # step over that lifetime, below which a solve that failed is not tried again [-]
START = 1e-3  # strain of the least viscous fluid in the first step, under the typical force [-]
BALANCED = 1e-6  # norm of all residuals, which that of no particle exceeds, over the scale of forces [-]


def without_inertia(case: Case) -> Case:
    """The case with relative densities, and no damping of sound, so that no answer depends on the density.

    A body force keeps its size: densities are divided by the largest, by which its acceleration is multiplied.  The
    stabilisation of a network restores what nodal integration misses of its viscosity in slow flow: else short waves
    would meet that of the liquid alone, a hundredth or less.
    """
    largest = max(law.density for law in case.materials.values())
    materials = {name: dataclasses.replace(law, density=law.density / largest) for name, law in case.materials.items()}
    materials |= {name: dataclasses.replace(law, stabilisation=law.stabilisation * law.slow_viscosity / law.viscosity)
                  for name, law in materials.items() if hasattr(law, "slow_viscosity")}
    force = case.body_force and tuple(largest * a for a in case.body_force)
    numerics = dataclasses.replace(case.numerics, bulk_viscosity=0.0)
    return dataclasses.replace(case, materials=materials, body_force=force, numerics=numerics)


class Overdamped(Implicit):
    """Time integration of 0 = f(u, u', t), by default with PETSc's BEULER; BDF and THETA by the option -ts_type.

    A step is as long as its error allows.  That of BEULER is dt² u''/2, with u'' from the velocities of two steps;
    types of second order are more accurate than that.  A step that is too long is undone and repeated.

    Attributes
    ----------
    unbalanced : float -- largest force on a particle that was out of balance after a step, over `scale` [-].
    last, least : float -- the last step, and the first one, up to which any error is accepted: what nothing resists,
        such as a cell above the substrate without a medium, moves at once [µs].
    tolerance : float -- of the error of a step [µm].
    scale : float -- typical force on a particle [pN/µm], in space [pN].
    """

    instead = ""  # with inertia, steps would be ones of nanoseconds

    def __init__(self, *about: Any):
        """Create the TS, see `Integrator`; collective."""
        self.unbalanced = self.last = self.least = 0.0
        self._solved = True  # whether the last solve was one
        # Work of the residual on a Newton step, whether it grows along it, and how often the step was halved.
        self._work, self._grows, self._halvings = 0.0, True, 0
        self._least, self._since = 0.0, 0  # least norm of a solve, and the iteration that came to it
        frictions = about[0].terms.frictions
        self._lifetime = max((getattr(law, "lifetime", 0.0) for law in frictions), default=0.0)  # of bonds that yield
        super().__init__(*about)
        self.tolerance = PETSc.Options().getReal("ts_atol", ERROR * self.equations.spacing)

    def _equations(self) -> Equations:
        h = max(t.spacing for t in self.mechanics.scene.templates)
        return Equations(self.mechanics, self.scale / h)

    def _pose(self) -> None:
        """Give TS the residual -f(u, u', t), its tangent and u."""
        ts = self.ts
        self._x = self._displacements()
        ts.setIFunction(self._out_of_balance, self._x.duplicate())
        ts.setIJacobian(self._linearise, self.equations.applied(), self.equations.matrix)
        ts.setSolution(self._x)
        ts.getSNES().setInitialGuess(self._guess)
        with default_options(self._defaults()):
            ts.setFromOptions()

    def _configure(self, ts: PETSc.TS) -> None:
        """Set tolerances before options are read."""
        super()._configure(ts)
        scene, terms = self.mechanics.scene, self.mechanics.terms
        h = max(t.spacing for t in scene.templates)
        laws = [terms.substrate, *(terms.contacts.laws if terms.contacts else ())]
        along = [law.work for law in laws if law] + [law.tension(1.0) for law in [terms.cortex] if law]
        stress = max(law.shear_modulus for law in scene.materials)
        self.scale = max(stress * h, *along, BALANCE * self._sound() * h) * h ** (scene.dimension - 2)
        ts.getSNES().setTolerances(rtol=1e-14, atol=BALANCED * self.scale, stol=0.0)

    def _sound(self) -> float:
        """Largest modulus of compression waves [Pa]."""
        return max(law.density * law.sound_speed**2 for law in self.mechanics.scene.materials)

    reduced = False  # u is the only unknown
    advice = ""

    def _defaults(self) -> dict[str, str]:
        """Default options; steps are chosen here."""
        krylov = {"ksp_rtol": ACCURATE} if self.equations.matrix_free else {}
        return super()._defaults() | {"ts_adapt_type": "none", "snes_max_it": str(ITERATIONS)} | krylov

    @property
    def description(self) -> str:
        """Name of the integrator, for the log."""
        return f"overdamped: {self.ts.getType()} of PETSc, without inertia"

    @property
    def remedy(self) -> str:
        """What to try where no step is short enough, by what the scene has."""
        t, flows = self.mechanics.terms, any(getattr(law, "fluid", False) for law in self.mechanics.scene.materials)
        director = self.mechanics.director if t.dimension == 2 else None
        opposed = director is not None and director.widest() > OPPOSED
        tries = [text for there, text in (
            (t.protrusion or t.load_curves, "a weaker push (protrusion.protrusion_ratio) or load, or more bonds: one "
                                            f"above what these bear has no speed{self._borne()}"),
            (opposed, "another start of the director: neighbours on the membrane point against each other, where "
                      "their energy jumps"),
            (flows and t.renewal is None, "numerics.renewal for fluids that are stretched far")) if there]
        return "try " + "; ".join([*tries, "more friction, or finer particles"])

    @property
    def _unit(self) -> str:
        return "pN/µm" if self.mechanics.scene.dimension == 2 else "pN"

    def _borne(self) -> str:
        """Of the cell that pushes most on bonds that yield, its push and what these bear, as text; collective."""
        m, scene = self.mechanics, self.mechanics.scene
        fastest = [law.largest[1] for law in m.terms.frictions if hasattr(law, "largest")]
        there = [name for name in ("protrusion", "push_off") if present(name, m.terms)]
        linear = any(law.coefficient and not hasattr(law, "largest") for law in m.terms.frictions)
        if not there or not fastest or linear:
            return ""
        of, count, v = scene.cell_of(m.ids), len(scene.kind), m.state.v.copy()

        def of_cells(names: list[str]) -> np.ndarray:
            force = np.sum([m.surface_force(name)[0] for name in names], axis=0)
            own = np.column_stack([np.bincount(of, column, count) for column in force.T])
            return m.comm.allreduce(own)

        pushes = of_cells(there)
        size = np.linalg.norm(pushes, axis=1) * m.protruding
        way, borne = pushes / np.maximum(size, 1e-300)[:, None] * (size > 0.0)[:, None], np.zeros(count)
        for speed in fastest:
            m.state.v[:] = speed * way[of]
            m.rate(0.0)
            drags = of_cells([name for name in FRICTION if present(name, m.terms)])
            borne = np.maximum(borne, -(drags * way).sum(axis=1))
        m.state.v[:] = v
        m.rate(0.0)
        cell, unit = int(np.argmax(size / np.maximum(borne, 1e-300) * (borne > 0.0))), self._unit
        return (f", and cell {cell + 1} pushes with {size[cell]:.3g} {unit}, of which its bonds bear {borne[cell]:.3g} "
                f"{unit} at most")

    def fail(self, cause: str, particle: int | None = None, remedy: str = "") -> None:
        """End the run as `Integrator.fail`; with its own remedy where tension has gathered the membrane; collective."""
        cortex = self.mechanics.terms.cortex
        if cortex is not None and cortex.tension(2.0) == cortex.tension(1.0):
            least, most = self._facets()
            if least < COLLAPSED or most > BARE:
                remedy = (f"parts of the surface have {least:.2g} to {most:.3g} times their size; "
                          "tension that is the same everywhere gathers it at the contact, and few bonds are left "
                          "elsewhere: try [cortex] law = \"elastic\" with an area_modulus above the work of adhesion, "
                          "or a smaller line_tension")
        super().fail(cause, particle, remedy)

    def _facets(self) -> tuple[float, float]:
        """Smallest and largest size of a segment, or triangle, of the surface over that at rest [-]; collective."""
        m = self.mechanics
        ratio = facet_sizes(m.state.x(m.kernel["facet"])) / np.maximum(m.kernel["facet_size"], 1e-300)
        return 1.0 / largest(m.comm, 1.0 / np.maximum(ratio, 1e-300)), largest(m.comm, ratio)

    @property
    def step_description(self) -> str:
        """Length of the steps, and solvers, for the log."""
        if self.fixed_step is None:
            return f"errors of {1e3 * self.tolerance:.3g} nm a step; {self.solvers}"
        return f"{1e-6 * self.fixed_step:.3g} s as given, or to the next sample; {self.solvers}"

    def _move(self, step: PETSc.Vec) -> np.ndarray:
        return self._vectors(step)

    # ------------------------------------------------------------ equations

    def _converged(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int:
        """As of any implicit step; notes whether the solve has succeeded."""
        found = super()._converged(snes, iteration, norms)
        shortest = min(FROZEN * self._lifetime, self.least)
        if iteration == 0 and not self._solved and self.ts.getTimeStep() < shortest:
            return PETSc.SNES.ConvergedReason.DIVERGED_FUNCTION_DOMAIN
        if iteration == 0 or norms[2] < PROGRESS * self._least:
            self._least, self._since = norms[2], iteration
        if found == PETSc.SNES.ConvergedReason.ITERATING and iteration - self._since >= STALLED:
            found = PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH
        self._solved = found > 0
        return found

    def _shorten(self, x: PETSc.Vec, step: PETSc.Vec) -> bool:
        """Set a Newton step to one that goes down in energy, of LONGEST at most, and not beyond the valley; collective.

        The residual is the slope of an energy, but for friction that depends on the gap.  Its work on a step is
        positive on the way down.  A step at whose end it is less than minus that has gone up again, and is halved; one
        on which it grows is doubled: the cell lets go there, or snaps to the substrate.  The norm of the residual is no
        guide: it has valleys where a contact is about to let go, from which no step leads on.

        Source: step limits of incremental potential contact, Li et al. (2020); a line search by the work, as
        SNESLINESEARCHCP in PETSc's manual.
        """
        residual, ksp = self.ts.getSNES().getFunction()[0], self.ts.getSNES().getKSP()
        if (work := residual.dot(step)) > 0.0:
            self._follow(x, step, work)
        if work <= 0.0 or (self._halvings > 1 and self.equations.slips):
            self._follow(x, step, self.equations.descend(residual, step, ksp))
        return True

    def _follow(self, x: PETSc.Vec, step: PETSc.Vec, work: float) -> None:
        """Scale a step on which the residual does `work` [pN, pN µm]; collective."""
        self._work, self._grows, self._halvings = work, True, 0
        super()._shorten(x, step)

    def _better(self, share: float, most: float, step: PETSc.Vec, out: PETSc.Vec) -> float:
        ahead = out.dot(step)
        self._grows = self._grows and ahead > self._work and share < most
        if self._grows:
            return min(2.0 * share, most)
        if ahead >= -self._work:
            return share
        self._halvings += 1
        return 0.5 * share

    def _out_of_balance(self, ts: PETSc.TS, t: float, u: PETSc.Vec, rate: PETSc.Vec, out: PETSc.Vec) -> None:
        """Set `out` to -f."""
        self._velocity = self._vectors(rate).copy()
        self._remainder = self.equations.imbalance(t, self._vectors(u), self._velocity)
        out.setArray(self._remainder.ravel())

    def _linearise(self, ts: PETSc.TS, t: float, u: PETSc.Vec, rate: PETSc.Vec, shift: float, J: PETSc.Mat,
               P: PETSc.Mat) -> None:
        """Set the tangent -(shift ∂f/∂u' + ∂f/∂u)."""
        ksp = ts.getSNES().getKSP()
        self.equations.linearise(t, self._vectors(u), self._vectors(rate), shift, 1.0, ksp, ksp.getPC(),
                                 self._first_iteration)
        J.assemble()

    def _guess(self, snes: PETSc.SNES, x: PETSc.Vec) -> None:
        """Move the first guess of a solve on by the last velocity, unless cells would be too deep in each other.

        After a solve that failed tangents are assembled for EXACT steps: differences are wrong across a kink.
        """
        if not self._solved and self.equations.matrix_free and not self.equations.exact:
            self.equations.exact = EXACT
        trial, out = x.duplicate(), x.duplicate()
        move = self.ts.getTimeStep() * self._begun
        trial.setArray(x.getArray(readonly=True) + move.ravel())
        snes.computeFunction(trial, out)
        if np.isfinite(out.norm()):
            trial.copy(x)
        trial.destroy()
        out.destroy()

    # ------------------------------------------------------------ steps

    def _cut(self, failed: int, start: float, dt: float) -> None:
        """As of any implicit step; ends a run whose membrane has closed, as steps would become ever shorter."""
        super()._cut(failed, start, dt)
        if self.mechanics.terms.cortex is not None and self._facets()[0] < CLOSED:
            self.fail("the membrane has gathered at one place", remedy=self.remedy)

    def _choose_step(self, stop: float) -> None:
        """Set the next step: one of equal ones to `stop` [µs], at most as long as errors, or the case, allow."""
        m, left = self.mechanics, stop - self.ts.getTime()
        self._begun = m.state.v.copy()
        if not self.least:
            self.least = self._first_step()
            self.dt = LIVED * self._lifetime
        self.dt = self.fixed_step or max(self.dt, self.least)
        fastest = largest(m.comm, self._begun)
        longest = min(self.dt, MOVE * m.segments.skin / max(fastest, 1e-300))
        self.ts.setTimeStep(left / np.ceil(left / longest * (1.0 - 1e-12)))

    def _first_step(self) -> float:
        """First step [µs]: that in which the least viscous fluid strains by START under the typical force."""
        h, scene = self.equations.spacing, self.mechanics.scene
        force = self.scale / h ** (scene.dimension - 2)
        viscosity = min((law.viscosity for law in scene.materials if law.viscosity), default=0.0)
        return START * h * viscosity / force if viscosity else SOLID * self.ts.getMaxTime()

    def _accept(self, before: np.ndarray, dt: float) -> bool:
        """Whether the error of a step of dt [µs] from the state `before` is small enough; sets the next; collective."""
        d = self.mechanics.scene.dimension
        last = self.last or dt
        change = dt**2 / (dt + last) * (self._velocity - before[:, d:])
        error = exact_sum(self.mechanics.comm, np.linalg.norm(change, axis=1)) / self.mechanics.scene.size
        good = bool(error <= self.tolerance) or dt <= self.least or self.fixed_step is not None
        share = SAFETY * np.sqrt(self.tolerance / max(float(error), 1e-300))
        self.dt = dt * min(max(share, SHORTER), LONGER)
        if good:
            self.last = dt
            self.unbalanced = max(self.unbalanced, largest(self.mechanics.comm, self._remainder) / self.scale)
        return good

    def _from_petsc(self) -> None:
        """Copy u and its rate from TS."""
        state = self.mechanics.state
        state.u[:], state.v[:] = self._vectors(self.ts.getSolution()), self._velocity
        state.exchange()

    def _to_petsc(self) -> None:
        """Copy u to TS."""
        self.ts.getSolution().setArray(self.mechanics.state.u.ravel())

    def saved(self) -> dict[str, Any]:
        """State of the integrator for a checkpoint, with the last step, from which the next error follows."""
        return super().saved() | {"last": self.last, "least": self.least, "tangent": self.equations.saved()[0]}

    def arrays(self) -> dict[str, np.ndarray]:
        """The tangent that is reused (nnz, …) [Pa]."""
        return self.equations.saved()[1]

    def restore(self, about: dict[str, Any], arrays: Arrays) -> None:
        """Set the state from `about`, which `saved` returned, and `arrays` of the checkpoint (nnz, …) [Pa]."""
        super().restore(about, arrays)
        self.last, self.least = about["last"], about["least"]
        self.equations.restore(about["tangent"], arrays)

    @property
    def closing(self) -> str:
        """Balance and solves, for the end of the log."""
        return (f"forces in balance to {self.unbalanced:.1g} of {self.scale:.3g} {self._unit}; {self.newton} steps of "
                f"Newton's method, {self.failures} solves failed, {self.redone} steps were repeated for accuracy")

    def record(self) -> dict[str, Any]:
        """Counts, and the largest force out of balance, for the manifest; collective."""
        return super().record() | {"out_of_balance": self.unbalanced}
