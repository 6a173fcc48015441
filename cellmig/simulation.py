"""A simulation: particles, forces and integrator built from a case, and the run that leaves its files."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from fractions import Fraction
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from mpi4py import MPI

from .case.messages import CaseError, Mistake
from .case.registry import laws
from .case.schema import Case, particle_count
from .kernel.kernel import c_source
from .laws import register
from .meshfree import formulas
from .meshfree.body import Scene, template
from .meshfree.boundary import Boundary, Probes, histories_of
from .meshfree.contact import Surfaces
from .meshfree.rkpm import factorised
from .meshfree.terms import Terms
from .model.seifert import solid
from .output.interval import Interval
from .output.log import duration
from .output.sample import Sampler
from .parallel.collect import decided, shared
from .parallel.direct import solve_positive
from .parallel.options import IMPLICIT, integrator_asked
from .parallel.partition import partition
from .parallel.swarm import Swarm
from .solve.implicit import Implicit
from .solve.integrate import Integrator
from .solve.mechanics import Mechanics
from .solve.protrusion_noise import random_factor
from .solve.restart import restore, saved
from .solve.start import at_start
from .solve.static import Static
from .solve.step import NumericsError, StepControl, binding

register()


LARGE = 5_000  # particles of a cell, from which MUMPS beats SuperLU in the setup
TRIAL, TRIAL_EXPLICIT = 8, 500  # steps of each part of a trial, implicit and explicit
GROWING = 1.5  # a trial of implicit steps goes on while it gains that much
SAME = 1e-9  # spacings that particles may lie apart which are the same; rounding is 1e-15, the next one is at 1
SINGLE_FROM = 25_000  # particles of all kinds of cells: beyond, coefficients in double leave caches of 32 MB


def discretise(case: Case) -> Scene:
    """The reference configuration of a case: one template for each kind of cell.

    Raises CaseError where particles do not suit a shape, or formulas have no value at them.
    """
    used = [name for name in case.materials if any(name in (c.material, c.nucleus) for c in case.cells)]
    kinds: dict = {}
    for cell in case.cells:
        kinds.setdefault((cell.shape, cell.material, cell.nucleus), len(kinds))
    templates, material_of = [], []
    for shape, body, nucleus in kinds:
        pair = (case.materials[body], case.materials[nucleus] if nucleus else None)
        try:
            count = particle_count(case, shape)
            solve = solve_positive if count > LARGE else factorised
            templates.append(template(shape, count, case.particles.dilation, pair, case.numerics.bulk_viscosity,
                                      case.particles.surface_refinement, solve))
        except ValueError as error:  # the particles do not suit the shape
            name = next(c.name for c in case.cells if c.shape == shape)
            told = f"'{name}': {error}{getattr(shape, 'doubt', '')}"
            raise CaseError([Mistake(case.path, None, "particles", told)]) from error
        material_of.append((used.index(body), used.index(nucleus or body)))
    scene = Scene(
        templates=templates, material_of=material_of, materials=[case.materials[name] for name in used],
        kind=np.array([kinds[c.shape, c.material, c.nucleus] for c in case.cells]),
        centre=np.array([c.centre for c in case.cells]))
    formulas.check(case, scene)
    return scene


def find_terms(case: Case, prune: bool = True) -> Terms:
    """The terms of equation (2) that the case has, and why it lacks the others; without `prune`, all of them."""
    eta = max(getattr(m, "eta", 0.0) for m in case.materials.values())
    zeta = any(getattr(m, "zeta", 0.0) for m in case.materials.values())
    law, skipped = case.director, {}

    def unless(reason: str | None, term: str, value: Any, absent: Any = None) -> Any:
        if reason is None:
            return value
        skipped[term] = reason
        return absent if prune else value

    def why(*conditions: tuple[bool, str]) -> str | None:
        return next((reason for holds, reason in conditions if holds), None)

    nothing = laws("adhesion")["seifert"](bonds=0.0, energy=0.0, range=0.01)
    substrate = unless(why((case.substrate is None, "the case has none")), "adhesion to the substrate",
                       solid(case.substrate) if case.substrate else nothing)
    between = case.contact or dataclasses.replace(nothing, range=_thin(case))
    contact = unless(why((len(case.cells) == 1, "one cell alone"),
                         (case.static and case.contact is None, "the case has none")),
                     "adhesion between cells", nothing if len(case.cells) == 1 or case.static else solid(between))
    push = case.protrusion
    protrusion = unless(why((push is None, "the case has none"),
                            (push is not None and not push.cells, "no cell protrudes"),
                            (push is not None and push.strength == 0, "its strength is zero"),
                            (case.substrate is None or case.substrate.work == 0, "no adhesion to the substrate")),
                        "protrusion", push or laws("protrusion")["edge"](cells=(), random=False))
    uniform = law is None or (law.start == "uniform" and law.anchoring == "none")
    director = unless(why((eta == 0, "eta is zero"), (uniform, "the director is uniform: its gradient is zero")),
                      "director gradients (eta)", "relaxing" if law is not None and law.mobility else "frozen", "none")
    active = unless(None if zeta else "zeta is zero", "active stress (zeta)", True, False)
    used = case.materials.values()
    still = (case.static, "nothing moves in a static case")
    stabilised = unless(why(still, (not any(m.stabilisation for m in used), "its viscosity is zero")),
                        "viscous stabilisation", True, False)
    stiffened = unless(None if any(m.numerical_modulus for m in used) else "its modulus is zero",
                       "elastic stabilisation", True, False)
    damped = unless(why(still, (not case.numerics.bulk_viscosity, "its viscosity is zero")),
                    "bulk damping", True, False)
    cortex = unless(why((case.cortex is None, "the case has none")), "cortex", case.cortex)
    friction = unless(why((case.friction is None, "the case has none"),
                          (case.substrate is None, "no adhesion to the substrate")), "friction on the substrate",
                      case.friction if case.substrate is not None else None)
    force = case.body_force if case.body_force and any(case.body_force) else None
    force = unless(None if force else "the case has none", "body force", force, None)
    shapes = {(c.shape, c.material, c.nucleus) for c in case.cells}
    single = sum(particle_count(case, shape) for shape, *_ in shapes) > SINGLE_FROM
    outside = unless(None if (case.supports or case.loads or case.plates) else "the case has none",
                     "supports, loads, plates", histories_of(case))
    return Terms(substrate=substrate, contact=contact, protrusion=protrusion, cortex=cortex, friction=friction,
                 director=director, active=active, stabilised=stabilised, bulk_damped=damped, stiffened=stiffened,
                 acceleration=force, histories=outside, single=single, skipped=skipped)


def _thin(case: Case) -> float:
    """Distance [µm] at which cells without adhesion repel: that of the substrate, else a thousandth of a cell."""
    return case.substrate.range if case.substrate else 1e-3 * min(c.shape.area for c in case.cells) ** 0.5


class Simulation:
    """A case built on the ranks of a communicator, ready to run; `destroy` it when done.

    scene, terms, mechanics, control (None if static), integrator, sampler : its parts;  time : where it is [µs].
    """

    def __init__(self, case: Case, comm: MPI.Comm = MPI.COMM_WORLD, prune: bool = True,
                 parts: tuple[Scene, Terms] | None = None, start: dict[str, np.ndarray] | None = None):
        """Build everything; collective.

        `parts` : scene and terms, if they are there already or not the case's;  `start` : on rank 0 arrays of a
        checkpoint of the same particles, whose u, v and director it begins with, instead of the case's.
        """
        self.reason = ""  # of an integrator that was chosen
        if integrator_asked(case.time.integrator) == "auto":
            case, self.reason = cheaper(case, comm)
        self.case, self.comm = case, comm
        self.terms = parts[1] if parts else find_terms(case, prune)
        self.scene, self.control, *others = decided(comm, lambda: self._decide(parts[0] if parts else None))
        owner, state, boundary, probes, alpha = others
        own = np.arange(self.scene.size)[comm.rank :: comm.size]
        begun = {} if start is None else self._begun(start, own)
        self.swarm = Swarm(comm, {name: values[own] for name, values in state.items()} | begun)
        self.swarm.migrate(owner[comm.rank :: comm.size])
        names = case.protrusion.cells if case.protrusion else ()
        protruding = np.array([c.name in names for c in case.cells])
        self.mechanics = Mechanics(self.scene, self.terms, boundary, self.swarm, owner, comm, case.director, alpha,
                                   protruding)
        fixed = None if case.time.step == "auto" else case.time.step
        kind = Implicit if integrator_asked(case.time.integrator) in IMPLICIT else Integrator
        self.integrator = Static(self.mechanics) if case.static else kind(
            self.mechanics, self.control, case.time.integrator, fixed, case.time.step_factor)
        self.sampler = Sampler(self.mechanics, probes)
        self.interval = Interval(self.mechanics)
        self.time = 0.0
        self.sample()  # the ledger counts from here

    def _decide(self, scene: Scene | None) -> tuple:
        """All that depends on the last bits of a library, or of a processor; `scene` : if it is there already."""
        case = self.case
        scene = scene or discretise(case)
        c_source(scene.materials, self.terms)  # a law that has no counterpart in C is refused before its first use
        control = None if case.static else step_control(case, scene, self.terms)
        owner = partition(scene.X, scene.cell, scene.material, self.comm.size)
        alpha = random_factor(Surfaces.of(scene), self.terms.protrusion, case.seed, [c.name for c in case.cells])
        return scene, control, owner, at_start(case, scene), Boundary.of(case, scene), Probes.of(case, scene), alpha

    def _begun(self, arrays: dict[str, np.ndarray], ids: np.ndarray) -> dict[str, np.ndarray]:
        """State of some particles as a checkpoint has it; collective."""
        why = "a static case is solved from rest" if self.case.static else ""
        if not same_places(arrays, self.scene, self.comm):
            why = ("the run to start from has other particles: shapes, places, nuclei and [particles] have to be the "
                   "same; materials, adhesion, protrusion … may differ")
        if why:
            raise CaseError([Mistake(self.case.path, None, "--from", why)])
        found = shared(self.comm, {name.removeprefix("particle "): values for name, values in arrays.items()
                                   if name in ("particle state", "particle theta")})
        begun = {"u": found["state"][ids, :2], "v": found["state"][ids, 2:]}
        if self.case.director is not None and "theta" in found:
            begun["theta"] = found["theta"][ids].ravel()
        return begun

    def go(self, stop: float) -> float:
        """Go on to the time `stop` [µs]; returns the time reached (less if -ts_max_steps ended it); collective."""
        self.time = self.integrator.advance_to(stop)
        return self.time

    def sample(self) -> tuple[list[dict[str, float]], dict[str, float]]:
        """Rows of history.csv and the row of ledger.csv now; brings F and the swarm up to date; collective.

        The steps to come are not those after a look, but the ones that there would have been without it.
        """
        m = self.mechanics
        if self.integrator.leapfrog:
            m.undo.put_by()
        acceleration = self.integrator.rate()
        if self.integrator.leapfrog:
            self.integrator.note_volumes()
        m.store(self.swarm)
        return self.sampler.history(), self.sampler.ledger(acceleration, self._half_step)

    @property
    def _half_step(self) -> float:
        """What velocities and impulses of the leapfrog lag behind positions [µs]."""
        return 0.5 * self.mechanics.dt_prev if self.integrator.leapfrog else 0.0

    def next_row(self, rows: list[dict[str, float]]) -> dict[str, list[dict[str, float]]]:
        """After a sample to be kept: adds means since the last one to its rows; rows of other tables; collective."""
        return self.interval.next(self.time, rows, self._half_step)

    def saved(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """All that decides the next bits: numbers, and on rank 0 arrays in global order; collective.

        After a batch of steps if the integrator allows it, else after a sample.
        """
        about, arrays = saved(self.mechanics)
        if self.comm.rank == 0:
            arrays["X"], arrays["surface"] = self.scene.X, surface_of(self.scene)
        return {"mechanics": about, "integrator": self.integrator.saved(), "ledger": self.sampler.start,
                "interval": self.interval.saved()}, arrays

    def restore(self, about: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
        """Go on from what was saved, on any number of ranks; collective."""
        restore(self.mechanics, about["mechanics"], arrays)
        self.integrator.restore(about["integrator"])
        self.sampler.start = about["ledger"]
        self.interval.restore(about["interval"])
        self.time = self.integrator.time

    def state_hash(self) -> str:
        """sha256 of X, u, v in global-id order, the same on any number of ranks; collective."""
        m = self.mechanics
        own = np.ascontiguousarray(np.hstack([self.scene.X[m.ids], m.state.owned]))
        parts = self.comm.gather((m.ids, own))
        digest = None
        if self.comm.rank == 0:
            ids = np.concatenate([p[0] for p in parts])
            values = np.concatenate([p[1] for p in parts])[np.argsort(ids)]
            digest = hashlib.sha256()
            for part in (values[:, :2], values[:, 2:4], values[:, 4:]):
                digest.update(np.ascontiguousarray(part).tobytes())
            digest = digest.hexdigest()
        return self.comm.bcast(digest)

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.integrator.destroy()
        self.mechanics.destroy()
        self.swarm.destroy()


def surface_of(scene: Scene) -> np.ndarray:
    """Global ids of the surface particles of all cells, in their order (m,)."""
    return np.concatenate([scene.surface(cell) for cell in range(len(scene.kind))])


def same_places(arrays: dict[str, np.ndarray], scene: Scene, comm: MPI.Comm) -> bool:
    """Whether arrays of a checkpoint, on rank 0, are of the particles of a scene: but for rounding; collective."""
    same = True
    if comm.rank == 0:
        X, surface, spacing = arrays["X"], arrays["surface"], min(t.spacing for t in scene.templates)
        same = (X.shape == scene.X.shape and bool(np.abs(X - scene.X).max() <= SAME * spacing)
                and np.array_equal(surface, surface_of(scene)))
    return comm.bcast(same)


def cheaper(case: Case, comm: MPI.Comm) -> tuple[Case, str]:
    """The case with the integrator that goes on faster in a short trial of both, and the reason; collective."""
    def with_(kind: str) -> Case:
        return dataclasses.replace(case, time=dataclasses.replace(case.time, integrator=kind))

    if case.plates:
        return with_("leapfrog"), "implicit steps have no plates"
    speeds = {kind: _speed(with_(kind), comm) for kind in ("leapfrog", "bdf")}
    best = max(speeds, key=speeds.get)
    end, took = case.time.end, [duration(case.time.end / v) if v else "for ever" for v in speeds.values()]
    return with_(best), (f"{best}: as a trial went, {duration(1e-6 * end, 6)} take {took[0]} with explicit steps and "
                         f"{took[1]} with implicit ones")


def _speed(case: Case, comm: MPI.Comm) -> float:
    """Simulated over wall time [µs/s] in a trial; 0 where no step succeeds; collective."""
    simulation = Simulation(case, comm)
    try:
        return try_implicit(simulation).speed if isinstance(simulation.integrator, Implicit) else _explicit(simulation)
    except NumericsError:
        return 0.0
    finally:
        simulation.destroy()


def _explicit(simulation: Simulation) -> float:
    """Simulated over wall time [µs/s] of the second half of a trial of explicit steps; collective."""
    half, comm, at = TRIAL_EXPLICIT * binding(simulation.control.stable())[1], simulation.comm, [(0.0, perf_counter())]
    for stop in (half, 2.0 * half):
        at.append((simulation.go(min(stop, simulation.case.time.end)), comm.allreduce(perf_counter(), MPI.MAX)))
    (before, begin), (time, end) = at[-2:]
    return comm.bcast((time - before) / (end - begin) if time > before else at[1][0] / (at[1][1] - at[0][1]))


class Trial(NamedTuple):
    """Implicit steps at the start of a run: in the last of them, simulated [µs] and wall [s] time, steps, and steps of
    Newton's; taken : how many there were in all;  reached : simulated time [µs];  particles : how many there are.
    """

    simulated: float
    wall: float
    steps: int
    newton: int
    taken: int
    reached: float
    particles: int

    @property
    def speed(self) -> float:
        """Simulated over wall time [µs/s]."""
        return self.simulated / self.wall


def try_implicit(simulation: Simulation, burst: int = TRIAL, least: float = 0.0) -> Trial:
    """Implicit steps until they are as long as the motion lets them be, and for `least` seconds; collective.

    Where PETSc chooses the steps the first are ten of the stable one, and they double: of a stiff case dozens tell
    nothing of those to come.  So bursts of them go on until two in a row gain nothing: one may have met an event.  What
    is told is of the later half.
    """
    run, comm, end = simulation.integrator, simulation.comm, simulation.case.time.end

    def now() -> tuple[float, float, int, int]:
        return simulation.time, comm.allreduce(perf_counter(), MPI.MAX), run.steps, run.newton

    at, best, idle = [now()], 0.0, 0
    while simulation.time < end and (idle < 2 or at[-1][1] - at[0][1] < least):
        run.ts.setMaxSteps(run.steps + burst)
        simulation.go(end)
        at.append(now())
        speed = (at[-1][0] - at[-2][0]) / (at[-1][1] - at[-2][1])
        idle = 0 if speed > GROWING * best else idle + 1
        best = max(best, speed)
    taken = (b - a for a, b in zip(at[len(at) // 2 - 1 if len(at) > 3 else 0], at[-1], strict=True))
    return Trial(*taken, run.steps, simulation.time, simulation.scene.size)


def step_control(case: Case, scene: Scene, terms: Terms) -> StepControl:
    """The stable step of a discretised case."""
    relaxes = terms.director == "relaxing" and case.director is not None
    return StepControl(scene, terms, case.director.mobility if relaxes else 0.0)


def until(case: Case, end: float | None) -> Case:
    """The case with another end [µs], if one is given, and samples and frames as often: for estimates."""
    if end is None:
        return case
    counts = {name: max(1, math.ceil(getattr(case.time, name) * end / case.time.end)) for name in ("samples", "frames")}
    return dataclasses.replace(case, time=dataclasses.replace(case.time, end=end, **counts))


def stops(case: Case, end: float, step: float | None = None) -> list[tuple[float, bool, bool]]:
    """Times [µs] up to `end` at which the run looks up, and whether for a sample and for a frame.

    Where no stop cuts a step [µs], they are whole numbers of it, the nearest ones, each once.

    Parts of the case's end are exact fractions, rounded once: what falls together is one time, whatever its digits.
    """
    whole, before = Fraction(str(float(case.time.end))), end * (1.0 - 1e-12)

    def every(count: int) -> set[float]:
        times = (float(whole * i / count) for i in range(int(end / case.time.end * count) + 2))
        return {t for t in times if t < before}

    sample, frame = every(case.time.samples) | {end}, every(case.time.frames) | {end}
    if step:
        sample, frame = ({round(t / step) * step for t in times} for times in (sample, frame))
    return [(t, t in sample, t in frame) for t in sorted(sample | frame)]
