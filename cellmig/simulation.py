"""A simulation: particles, forces and integrator built from a case."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from mpi4py import MPI

from .case.messages import CaseError, Mistake
from .case.schema import Case
from .kernel.source import c_source
from .laws import register
from .meshfree.boundary import Boundary, Probes
from .meshfree.scene import Scene
from .meshfree.terms import Terms, find_terms
from .output.interval import Interval
from .output.sample import Sampler
from .output.tables import CUES, cue_columns
from .parallel.collect import Arrays, Rows, Whole, computed_on_root, gathered
from .parallel.options import IMPLICIT, requested_integrator
from .parallel.owners import Owners
from .parallel.partition import partition
from .parallel.swarm import Swarm
from .solve.fields import Fields
from .solve.guidance import Guidance, steady
from .solve.implicit import Implicit
from .solve.integrate import Integrator
from .solve.mechanics import Mechanics
from .solve.overdamped import Overdamped, without_inertia
from .solve.protrusion import Protruding
from .solve.restart import flowed, found_anew, restore, same_places, saved
from .solve.start import at_start, discretise, templates
from .solve.static import Static
from .solve.step import NumericsError, StepControl

AT_ONCE = 1 << 20  # particles whose state is gathered at a time
ROUNDING = 1.0 + 1e-12  # ratio of times up to which they are one
NO_RANGE = (math.inf, -math.inf)  # least and largest of nothing

register()


class Simulation:
    """A case on the ranks of a communicator, ready to run; `destroy` it in the end, or use it in a `with` statement.

    scene, terms, mechanics, control (None if static), integrator, sampler : its parts;  time : time reached [µs].
    """

    def __init__(self, case: Case, comm: MPI.Intracomm = MPI.COMM_WORLD, prune: bool = True,
                 parts: tuple[Scene | None, Terms] | None = None,
                 start: Arrays | Mapping[str, np.ndarray] | None = None, moved: np.ndarray | None = None):
        """Build all parts; collective.

        prune : leave out absent terms;  parts : terms in place of the case's, and the scene if it exists;  start :
        arrays of a checkpoint of the same particles, whose u, v, director and network are the initial ones;  moved :
        (m, D) on rank 0, displacements of all surface particles [µm] for which cells are dealt out, None for none.
        """
        case = without_inertia(case) if case.overdamped else case
        self.case, self.comm = case, comm
        scene, self.terms = parts or (None, find_terms(case, prune))
        made = templates(case, comm) if scene is None else None
        owners, self.control, boundary, probes, protruding = computed_on_root(
            comm, lambda: self._decide(scene or discretise(case, made), moved))
        self.scene = owners.scene
        state = at_start(case, self.scene, owners.heads(comm.rank))
        begun = self._begun(start, owners) if start is not None else None
        if begun is not None:
            before = begun.rows("particle state", state["id"])
            state |= dict(zip("uv", np.split(before, 2, axis=1), strict=True))
            owners = self._with_neighbours(owners, begun)
        self.swarm = Swarm(comm, state)
        self.swarm.migrate(owners.of(state["id"]))
        self.mechanics = Mechanics(owners, self.terms, boundary, protruding, self.swarm)
        if begun is not None:
            self.mechanics.begin_from(begun)
        fixed = None if isinstance(case.time.step, str) else case.time.step
        implicit = requested_integrator(case.time.integrator) in IMPLICIT
        kind: Any = Overdamped if case.overdamped else Implicit if implicit else Integrator
        self.integrator: Integrator | Static = Static(self.mechanics) if case.static else kind(
            self.mechanics, self.control, case.time.integrator, fixed, case.time.step_factor)
        self.fields = Fields(case, self.mechanics)
        self.guidance = Guidance(case, self.mechanics, self.fields.by_name) if self.terms.guided else None
        self.sampler = Sampler(self.mechanics, probes)
        self.interval = Interval(self.mechanics)
        self.time, self._J_now = 0.0, NO_RANGE
        self._count()  # the ledger counts from here

    def _decide(self, scene: Scene, moved: np.ndarray | None) -> tuple:
        """Everything that depends on the last bits of libraries and processors, for rank 0."""
        case = self.case
        c_source(scene.materials, self.terms)  # a law that cannot be translated to C is refused here
        control = None if case.static else StepControl(scene, self.terms)
        names, law = [c.name for c in case.cells], self.terms.protrusion
        pushing = set(law.cells if law is not None else ())
        protruding = Protruding(np.array([name in pushing for name in names]), case.seed, names,
                                steady(case, self.terms))
        if moved is not None and len(moved) != scene.first_surface[-1]:  # surfaces are divided anew below
            moved = None
        owners = partition(scene, self.comm.size, self.terms.reach, self.terms.low, moved)
        return owners, control, Boundary.of(case, scene), Probes.of(case, scene), protruding

    def _begun(self, arrays: Arrays | Mapping[str, np.ndarray], owners: Owners) -> Arrays:
        """Arrays of a checkpoint that have the initial state, director and network; collective.  Raises CaseError."""
        arrays = Whole(self.comm, arrays) if isinstance(arrays, Mapping) else arrays
        why = "a static case is solved from rest" if self.case.static else ""
        if not same_places(arrays, owners, self.comm):
            why = ("the run to start from has other particles: shapes, places, nuclei and [particles] have to be the "
                   "same; materials, adhesion, protrusion … may differ")
        elif self.terms.renewal is None and flowed(arrays):
            why = ("fluids of the run to start from have found their neighbours anew, and go on with these: give "
                   "numerics.renewal, too")
        if why:
            raise CaseError([Mistake(self.case.path, None, "--from", why)])
        return arrays

    def go(self, stop: float) -> float:
        """Integrate to the time `stop` [µs]; returns the time reached, less after -ts_max_steps steps; collective.

        Times that differ by rounding alone are one: no step could be as short.
        """
        self._J_now = NO_RANGE
        turning: list[Any] = [one for one in (self.fields, self.guidance) if one is not None]  # cues ask fields
        while (due := min(one.due for one in turning)) <= stop * ROUNDING:
            at = due if due * ROUNDING < stop else stop
            if self.time * ROUNDING < at:
                self.time = self.integrator.advance_to(at)
            if self.integrator.finished:
                return self.time
            for one in turning:
                if one.due == due:
                    one.turn()
        if self.time * ROUNDING < stop or math.isinf(due):
            self.time = self.integrator.advance_to(stop)
        return self.time

    def sample(self, everywhere: bool = True) -> tuple[list[dict[str, float]], dict[str, float]]:
        """Rows of history.csv and the row of ledger.csv now; updates F and the swarm; collective.

        Later steps do not depend on samples.

        everywhere : whether all ranks get the rows of history, or rank 0 alone.
        """
        entries = self._count()
        rows = self.sampler.history()
        return (self.comm.bcast(rows) if everywhere else rows), entries

    def _count(self) -> dict[str, float]:
        """The row of ledger.csv now; updates F and the swarm; collective."""
        m = self.mechanics
        if self.integrator.leapfrog:
            m.set_aside()
        acceleration = self.integrator.rate()
        if self.integrator.leapfrog:
            seen = m.extremes()
            self._J_now = seen.J_min, seen.J_max
        m.store(self.swarm)
        self._powers = m.powers() if self._half_step else {}
        return self.sampler.ledger(acceleration, self._half_step, self._powers)

    @property
    def J_range(self) -> list[float]:
        """Smallest and largest J [-] of all steps, and of the state now if it was sampled: no step has met it yet."""
        seen, (least, most) = self.integrator.extremes, self._J_now
        return [min(seen["J_min"], least), max(seen["J_max"], most)]

    @property
    def _half_step(self) -> float:
        """Time that velocities and impulses of leapfrog are behind positions [µs]."""
        return 0.5 * self.mechanics.times.dt_prev if self.integrator.leapfrog else 0.0

    def next_row(self, rows: list[dict[str, float]], everywhere: bool = True) -> dict[str, list[dict[str, float]]]:
        """Add means since the last sample to its rows, and return the rows of other tables; collective.

        everywhere : whether all ranks get them, or rank 0 alone.
        """
        touches = self.terms.substrate is not None or self.terms.contacts is not None
        powers = self.mechanics.powers() if touches and not self._powers else self._powers
        found = self.interval.next(self.time, rows, self._half_step, powers, self.sampler.contacts)
        guided = self.guidance if self.polar else None
        found |= {"cues": self._cue_rows(guided)} if guided is not None else {}
        found |= {"molecules": self.fields.rows()} if self.fields.diffusing else {}
        if everywhere:
            found, rows[:] = self.comm.bcast((found, rows))
        return found

    @property
    def polar(self) -> bool:
        """Whether cells have polarities, and push."""
        return self.case.polarity is not None and self.guidance is not None

    @property
    def cue_columns(self) -> tuple[str, ...]:
        """Columns of cues.csv besides CUES: the parts of all cues."""
        return cue_columns(self.guidance.parts if self.guidance is not None else (), self.case.dimension)

    def _cue_rows(self, guidance: Guidance) -> list[dict[str, float]]:
        """Rows of cues.csv: polarity and push now, and the part of each cue at the last knot; collective."""
        values = np.hstack([guidance.at(self.time), self.sampler.push(), *guidance.parts.values()])
        names = (*CUES[self.case.dimension][3:], *self.cue_columns)  # after time, number and name
        return [{"cell": cell + 1, **dict(zip(names, row, strict=True))} for cell, row in enumerate(values.tolist())]

    def saved(self) -> tuple[dict[str, Any], dict[str, np.ndarray | Rows]]:
        """State for a checkpoint: numbers, and arrays, on rank 0 or each rank's rows of them; collective.

        It is complete after a batch of steps if the integrator allows it, else after a sample.
        """
        m = self.mechanics
        about, arrays = saved(m)
        own, s = m.part.owned, m.surfaces
        arrays |= {"X": Rows(m.ids, own.X, self.scene.size),
                   "surface": Rows(s.place[m.part.own_surface], s.ids[m.part.own_surface],
                                   int(self.scene.first_surface[-1]))}
        arrays |= self.integrator.arrays() if self.comm.rank == 0 else {}
        found = {"mechanics": about, "integrator": self.integrator.saved(), "ledger": self.sampler.start,
                 "interval": self.interval.saved()}
        if self.fields.diffusing:
            found["fields"], more = self.fields.saved()
            arrays |= more
        if self.guidance is not None:
            found["guidance"], more = self.guidance.saved()
            arrays |= more if self.comm.rank == 0 else {}
        return found, arrays

    def restore(self, about: dict[str, Any], arrays: Arrays | Mapping[str, np.ndarray | Rows]) -> None:
        """Set the state from the results of `saved`, or what was stored of them, on any number of ranks; collective."""
        arrays = Whole(self.comm, arrays) if isinstance(arrays, Mapping) else arrays
        restore(self.mechanics, about["mechanics"], arrays)
        if self.fields.diffusing:
            self.fields.restore(about["fields"], arrays)
        if self.guidance is not None:
            self.guidance.restore(about["guidance"], arrays)
        self.integrator.restore(about["integrator"], arrays)
        self.sampler.start = about["ledger"]
        self.interval.restore(about["interval"])
        self.time = self.integrator.time

    def _with_neighbours(self, owners: Owners, arrays: Arrays) -> Owners:
        """Owners of the scene with the neighbours of the initial state; sets the bounds of the step; collective."""
        if self.terms.renewal is None or not flowed(arrays):
            return owners
        scene = found_anew(owners.scene, arrays, self.comm)
        self.control = computed_on_root(self.comm, lambda: StepControl(scene, self.terms))
        return replace(owners, scene=scene)

    def state_hash(self) -> str:
        """The sha256 of X, u, v in the order of ids, the same on any number of ranks; collective."""
        m = self.mechanics
        found = hashlib.sha256()
        for values in (m.part.owned.X, m.state.u, m.state.v):
            for first in range(0, self.scene.size, AT_ONCE):
                on = slice(*np.searchsorted(m.ids, [first, first + AT_ONCE]))
                count = min(AT_ONCE, self.scene.size - first)
                some = gathered(self.comm, m.ids[on] - first, values[on], count)
                found.update(b"" if some is None else some.tobytes())
        return self.comm.bcast(found.hexdigest())

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.fields.close()
        self.integrator.destroy()
        self.mechanics.destroy()
        self.swarm.destroy()

    def __enter__(self) -> Simulation:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None or issubclass(kind, (CaseError, NumericsError)):  # others may be of this rank alone
            self.destroy()
