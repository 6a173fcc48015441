"""Estimates before a run: time, memory, disk space, resolution, absent terms."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from time import perf_counter
from typing import NamedTuple

from mpi4py import MPI

from cellmig.case.gaps import arrangement
from cellmig.case.schema import Case, particle_count
from cellmig.meshfree.terms import find_terms
from cellmig.output.fields import FIELDS
from cellmig.output.log import duration, simulated, two_columns
from cellmig.parallel.options import IMPLICIT, requested_integrator
from cellmig.simulation import Simulation
from cellmig.solve.overdamped import MOVE
from cellmig.solve.start import discretise
from cellmig.solve.step import NumericsError, StepControl, binding

from .by_rank import RANK_BYTES, Parts, describe_parts, memory, of_cells, of_ranks, size_of
from .estimates import expected, inertia_is_gone
from .summary import (
    describe_bodies,
    describe_contacts,
    describe_guidance,
    describe_load_steps,
    describe_scene,
    describe_skipped,
    describe_step,
)
from .timed import FEWER, PROBE, finer, part_of, timed
from .trial import TRIAL, Trial, choose, try_implicit

SLOW = 2_000  # cells from which gaps take seconds
TRIED, FEW = {2: 1_500, 3: 150}, 3  # the same for implicit steps, by dimensions; timed steps if their length is fixed
COARSE, PATIENCE = 150, 10.0  # particles of a cell in a trial of motion without inertia, least time of it [s]
LONG, LONG_TRIAL = 86400.0, 5.0  # time of explicit steps from which implicit ones are tried, length of the trial [s]
FAILED = "FAILED"  # name of the row of a trial that failed
NEWTON, STATIC_BYTES = 1.4e-4, 35_000  # time of a Newton step [s], memory [B], per particle (measured at 5,000)
# In space, of balls of 1,000 to 8,000 particles: memory but for factors [B] per particle, time [s] and memory [B] of
# factors over powers of the particles of a cell, 2 and 1.45.
SPACE_BYTES, FACTOR, FACTOR_BYTES = 30_000, 9e-8, 1_660


class Cost(NamedTuple):
    """Estimated cost of a run.

    spacing : the largest [um];  stable : stable step by mechanism, step : that taken, both at rest [us];  per_step :
    time per particle-step on this core [s];  row_bytes : memory of the kernel's arrays per particle [B];  coarse :
    whether the timed cells had fewer particles, whose coefficients stay in the caches;  skipped : absent terms and the
    reasons;  left_out : for the first cell of each kind in space, by index, its volume beyond the particles' triangles
    [-].
    """

    particles: int
    spacing: float
    stable: dict[str, float]
    step: float
    steps: int
    per_step: float
    row_bytes: float
    coarse: bool
    skipped: dict[str, str]
    left_out: dict[int, float]

    @property
    def seconds(self) -> float:
        """Time on one core without output, at the step of the state of rest [s]."""
        return self.steps * self.particles * self.per_step


def cost(case: Case) -> Cost:
    """Estimate the cost of a case from timed steps, of fewer cells or particles if it is large."""
    size, terms = size_of(case), find_terms(case)
    part, ratio = part_of(case, PROBE[case.dimension])
    scene = discretise(part)
    first = {int(k): n for n, k in reversed([*enumerate(scene.kind)])} if case.dimension == 3 else {}
    place = {id(cell): n for n, cell in enumerate(case.cells)}
    left_out = {place[id(part.cells[n])]: ratio**2 * (1.0 - float(scene.templates[k].V.sum())
                                                      / part.cells[n].shape.volume) for k, n in sorted(first.items())}
    full = dataclasses.replace(scene, templates=[finer(t, ratio) for t in scene.templates])
    stable = StepControl(full, terms).stable()
    step = case.time.step if case.time.step != "auto" else case.time.step_factor * binding(stable)[1]
    per_step, row_bytes = timed(part, scene, terms.single, max(of_cells(case)))
    return Cost(size, max(t.spacing for t in full.templates), stable, step, math.ceil(case.time.end / step), per_step,
                row_bytes, ratio < 1.0, terms.skipped, left_out)


def report(case: Case, ranks: int = 1, tell: Callable[[str], None] = lambda text: None) -> str:
    """Text of the report of a case, see `examine`."""
    return examine(case, ranks, tell)[1]


def examine(case: Case, ranks: int = 1, tell: Callable[[str], None] = lambda text: None) -> tuple[bool, str]:
    """Whether trials of a case went on, and the text of its report: stable step by mechanism, steps, time, memory, disk
    space, resolution; of each of several `ranks` cells, particles, work and memory.  What takes seconds is told before,
    to `tell`.
    """
    if len(case.cells) > SLOW:
        tell(f"{len(case.cells)} cells: their gaps, and steps of some of them, which take seconds")
    if requested_integrator(case.time.integrator) in ("auto", *IMPLICIT):
        tell("a trial of steps without an end in advance, up to a minute")
    rows = _rows(case, ranks, tell)
    return all(key != FAILED for key, _ in rows), f"{case.path}: {case.title or 'valid'}\n" + two_columns(rows)


def _rows(case: Case, ranks: int, tell: Callable[[str], None]) -> list[tuple[str, str]]:
    """Rows of the report of a case."""
    if case.static:
        return _static_rows(case, ranks)
    chosen: list[tuple[str, str]] = []
    if requested_integrator(case.time.integrator) == "auto":
        part, reason = choose(part_of(case, FEWER)[0], MPI.COMM_SELF)
        case = dataclasses.replace(case, time=part.time)
        chosen = [("chosen", reason + f", of {size_of(part)} particles" * (size_of(part) < size_of(case)))]
    if case.overdamped:
        return _overdamped_rows(case, chosen, ranks)
    if requested_integrator(case.time.integrator) in IMPLICIT:
        return _implicit_rows(case, chosen, ranks)
    c = cost(case)
    fixed = None if case.time.step == "auto" else case.time.step
    parts = _parts(case, ranks)
    return [
        *([("accuracy", case.chosen)] if case.chosen else []),
        _particles(case, c.particles, c.spacing), *describe_bodies(case, c.left_out),
        *describe_scene(case, case.time.end), *chosen,
        ("stable step", ", ".join(f"{name} {1e3 * dt:.3g} ns" for name, dt in c.stable.items())),
        ("time step", describe_step(c.stable, case.time.step_factor, fixed, case.time_unit)),
        ("steps", f"{_count(c.steps)} to {_end(case)}"),
        ("time", f"{duration(c.seconds)} on one core, {duration(c.seconds / 2)} on two if they share well "
                 f"({1e9 * c.per_step:.0f} ns per particle and step, timed now), without output"
                 + "; two to seven times that where cells touch anew and slip" * _slips(case, c)),
        *describe_parts(parts, c.seconds),
        *_faster(case, c, tell),
        ("memory", _memory(case, c, parts)),
        _disk(case, c.particles),
        *_modulus(case), *_resolved(case, c), *describe_skipped(c.skipped),
    ]


def _parts(case: Case, ranks: int) -> Parts:
    """What ranks have."""
    return of_ranks(case, dataclasses.replace(case, particles=part_of(case, FEWER)[0].particles), ranks)


def _memory(case: Case, c: Cost, parts: Parts) -> str:
    """Text of the memory of all ranks, and of the fullest."""
    each = [memory(case, c.row_bytes, n, not rank) for rank, n in enumerate(parts.particles.tolist())]
    return bytes_text(sum(each)) + f" in all, {bytes_text(max(each))} on the fullest rank" * (len(each) > 1)


def _static_rows(case: Case, ranks: int) -> list[tuple[str, str]]:
    """Rows of a static case, which has no steps in time."""
    part, ratio = part_of(case, FEWER)
    size, spacing = size_of(case), ratio * max(t.spacing for t in discretise(part).templates)
    return [
        _particles(case, size, spacing), *describe_scene(case, case.time.end),
        ("load steps", describe_load_steps(case)),
        ("time", f"about {duration(newton_seconds(case))} for each step of Newton on one core, 4 to 8 to a load step, "
                 "as measured elsewhere with a direct solver"),
        *describe_parts(_parts(case, ranks)),
        ("memory", f"about {bytes_text(solver_bytes(case))} in all and {bytes_text(RANK_BYTES)} on each rank"),
        _disk(case, size),
        *describe_skipped(find_terms(case).skipped),
    ]


def newton_seconds(case: Case) -> float:
    """Time of a Newton step with a direct solver on one core [s]."""
    in_space = FACTOR * sum(n**2 for n in of_cells(case)) if case.dimension > 2 else 0.0
    return NEWTON * size_of(case) + in_space


def solver_bytes(case: Case) -> float:
    """Memory of the tangent and its factors [B]: in space those of a cell grow faster than its particles."""
    if case.dimension == 2:
        return STATIC_BYTES * size_of(case)
    return sum(SPACE_BYTES * n + FACTOR_BYTES * n**1.45 for n in of_cells(case))


def _implicit_rows(case: Case, chosen: list[tuple[str, str]], ranks: int) -> list[tuple[str, str]]:
    """Rows of a case with implicit steps, whose number is known only if their length is fixed."""
    c = cost(dataclasses.replace(case, time=dataclasses.replace(case.time, integrator="leapfrog", step="auto")))
    try:
        trial, times, solver = _tried(case, c.particles)
    except NumericsError as error:
        return _rows_of_solves(case, c, [*chosen, _failed(error), *describe_parts(_parts(case, ranks))])
    step, one = trial.simulated / trial.steps, times * trial.wall / trial.steps
    fixed = case.time.step != "auto"
    steps = math.ceil(case.time.end / (case.time.step if fixed else step))
    count = f"{steps} to {_end(case)}"
    if not fixed:
        count = f"as many as the motion asks for: about {steps:.2g} to {_end(case)}, {_trial_text(trial)}"
    return _rows_of_solves(case, c, [
        *chosen, ("time step", solver),
        ("one step", f"{duration(one)}, {trial.newton / trial.steps:.2g} of Newton's, timed now in a trial"),
        ("steps", count), ("time", f"{duration(steps * one)} on one core"), *describe_parts(_parts(case, ranks))])


def _overdamped_rows(case: Case, chosen: list[tuple[str, str]], ranks: int) -> list[tuple[str, str]]:
    """Rows of a case without inertia."""
    try:
        solver, told = _overdamped_time(case)
        steps = [("time step", solver), ("time", told)]
    except NumericsError as error:
        steps = [_failed(error)]
    c = cost(dataclasses.replace(case, time=dataclasses.replace(case.time, integrator="leapfrog", step="auto")))
    return _rows_of_solves(case, c, [*chosen, *steps, *describe_parts(_parts(case, ranks))])


def _failed(error: NumericsError) -> tuple[str, str]:
    """The row of a trial that failed."""
    return FAILED, f"a trial of few particles, and most likely so will the run, with exit code 4: {error}"


def _rows_of_solves(case: Case, c: Cost, steps: list[tuple[str, str]]) -> list[tuple[str, str]]:
    """Rows of a case whose steps are solved for; `c` : cost of leapfrog, `steps` : rows about the steps."""
    return [
        _particles(case, c.particles, c.spacing), *describe_scene(case, case.time.end), *steps,
        ("", f"leapfrog takes {duration(c.seconds)} in {_count(c.steps)} steps"),
        ("memory", f"about {bytes_text(solver_bytes(case))} in all and {bytes_text(RANK_BYTES)} on each rank"),
        _disk(case, c.particles),
        *_modulus(case), *_resolved(case, c), *describe_skipped(c.skipped),
    ]


def _overdamped_time(case: Case) -> tuple[str, str]:
    """Solvers and time of a run without inertia, by a trial of fewer particles of PATIENCE or to the end."""
    coarse = _coarse(case)
    with Simulation(coarse, MPI.COMM_SELF) as s:
        begin = perf_counter()
        trial, solver = try_implicit(s, TRIAL, PATIENCE), s.integrator.step_description
        wall, margin = perf_counter() - begin, MOVE * s.mechanics.segments.skin
    of_steps = (size_of(case) / trial.particles) ** (1.0 / case.dimension)  # as more along a contact line
    times = of_steps * newton_seconds(case) / newton_seconds(coarse)
    told = f"as a trial of {trial.particles} particles took {trial.taken} steps, {duration(wall)}"
    if trial.reached < case.time.end:
        left = case.time.end - trial.reached
        decade = trial.steps / math.log10(trial.reached / (trial.reached - trial.simulated))
        gone = expected(case, arrangement(case), case.time.end).distance
        ways = [(decade * math.log10(case.time.end / trial.reached) + gone / margin,
                 f"each tenfold time takes as many as the last, {decade:.0f}, and cells crawl as above")]
        if case.time.step != "auto":
            ways.append((left / case.time.step, "steps are as long as given"))
        if case.polarity is not None:
            knots = left / case.polarity.interval
            ways.append((knots, f"each of {knots:.2g} knots of the polarity takes one step"))
        steps, why = max(ways)
        wall += trial.wall / trial.steps * steps
        told += f" to {duration(1e-6 * trial.reached)}, if {why}"
    return solver, f"{duration(wall)} to {duration(times * wall)} on one core, {told}"


def _coarse(case: Case) -> Case:
    """A case with fewer particles and cells, for a trial without inertia."""
    cells = case.cells[:FEW]
    count = min(COARSE, max(particle_count(case, shape) for shape in {c.shape for c in cells}))
    particles = dataclasses.replace(case.particles, per_cell=count, spacing=None)
    return dataclasses.replace(case, cells=cells, particles=particles)


def _tried(case: Case, size: int, least: float = 0.0) -> tuple[Trial, float, str]:
    """A trial of implicit steps of a part of a case; cost of the case's steps over the part's; the solver."""
    part, ratio = part_of(case, TRIED[case.dimension])
    with Simulation(part, MPI.COMM_SELF) as s:
        trial = try_implicit(s, FEW if s.integrator.fixed_step else TRIAL, least)
        larger = size / s.scene.size / ratio  # factors of n particles cost n^1.5
        if case.dimension > 2:
            larger = newton_seconds(case) / newton_seconds(part)
        return trial, larger, s.integrator.step_description


def _faster(case: Case, c: Cost, tell: Callable[[str], None]) -> list[tuple[str, str]]:
    """Rows about the time of implicit steps, where explicit ones take days."""
    if c.seconds < LONG or case.plates:
        return []
    tell(f"explicit steps take {duration(c.seconds)} on one core: a trial of implicit ones, of seconds")
    if inertia_is_gone(case):
        slow = dataclasses.replace(case, time=dataclasses.replace(case.time, integrator="overdamped", step="auto"))
        try:
            return [("better", f'time.integrator = "overdamped" takes {_overdamped_time(slow)[1]}')]
        except NumericsError as error:
            return [("", f'time.integrator = "overdamped" finds no way on from the start: {error}')]
    implicit = dataclasses.replace(case, time=dataclasses.replace(case.time, integrator="bdf", step="auto"))
    try:
        trial, times, _ = _tried(implicit, c.particles, LONG_TRIAL)
    except NumericsError as error:
        return [("", f'time.integrator = "bdf", implicit steps, finds no way on from the start: {error}')]
    seconds = times * case.time.end / trial.speed
    text = f'time.integrator = "bdf", implicit steps, takes {duration(seconds)}, {_trial_text(trial)}'
    if seconds < min(c.seconds / 2, LONG):
        return [("better", text)]
    return [("", f"{text}: at that pace no integrator here ends within a day; fewer particles or a shorter time.end "
                 "do")]


def _trial_text(trial: Trial) -> str:
    """Origin of an estimate, as text."""
    mean, reached = (duration(1e-6 * t) for t in (trial.simulated / trial.steps, trial.reached))
    return (f"as the last {trial.steps} of {trial.taken} steps of a trial of {trial.particles} particles went, {mean} "
            f"long in the mean, {reached} after the start; steps lengthen where the motion slows")


def _end(case: Case) -> str:
    """End of the run, as text."""
    return simulated(case.time.end, case.time_unit)


def _count(steps: int) -> str:
    """A number of steps, as text."""
    return f"{steps}" if steps < 1e9 else f"{steps:.2g}"


def _slips(case: Case, c: Cost) -> bool:
    """Whether steps get shorter and cost more than at the start: contact in space, with steps of automatic length."""
    return case.dimension == 3 and case.time.step == "auto" and "contact" in c.stable


def _particles(case: Case, count: int, spacing: float) -> tuple[str, str]:
    cells = len(case.cells)
    support = f"support {case.particles.dilation:g} spacings" if case.dimension == 2 else "averages of finite elements"
    return "particles", f"{count} in {cells} cell{'s' * (cells > 1)}, spacing {spacing:.3g} µm, {support}"


def _disk(case: Case, count: int) -> tuple[str, str]:
    frames = case.time.frames + 1
    return "disk", f"{bytes_text(disk_bytes(case, count))} in {frames} frames"


def disk_bytes(case: Case, count: int) -> int:
    """Size of all frames of a case of `count` particles [B]."""
    return (case.time.frames + 1) * count * _frame_bytes(case)


def _modulus(case: Case) -> list[tuple[str, str]]:
    return [(name, f"bulk modulus reduced from {m.bulk_modulus / 1e6:g} to {m.reduced_bulk_modulus / 1e6:g} MPa")
            for name, m in case.materials.items()
            if hasattr(m, "reduced_bulk_modulus") and m.reduced_bulk_modulus < m.bulk_modulus]


def _resolved(case: Case, c: Cost) -> list[tuple[str, str]]:
    """Rows about lengths of the model relative to the spacing."""
    terms, rows = find_terms(case), []
    named = terms.contact is not None or any(pair.itself for pair in case.pairs)
    between = terms.contacts.laws if named and terms.contacts is not None else ()
    for name, laws in (("substrate", filter(None, [terms.substrate])), ("between cells", between)):
        if distances := sorted({law.equilibrium_distance for law in laws}):
            told = describe_contacts(case, terms) if name == "between cells" else []
            eps = distances[0]
            rows += [*told, ("" if told else name, f"equilibrium distance {1e3 * eps:g} nm is {eps / c.spacing:.2g} of "
                             "the spacing: integrated along the surface, not sampled at particles")]
    if "protrusion" not in c.skipped:
        rows.append(("protrusion", f"height {case.protrusion.height:g} µm is {case.protrusion.height / c.spacing:.2g} "
                                   "spacings"))
    return rows + describe_guidance(case)


def _frame_bytes(case: Case) -> int:
    """Size of a particle in a frame [B]."""
    present = {"": True, "director": case.director is not None, "substrate": case.substrate is not None,
             "contact": len(case.cells) > 1 and not (case.static and case.contact is None),
             "sliding": any(pair.friction is not None for pair in case.pairs),
             "push_off": any(pair.push for pair in case.pairs),
             "friction": case.substrate is not None and any(map(case.friction_of, case.cells)),
             "protrusion": case.protrusion is not None and bool(case.protrusion.cells)}
    elements = 0 if case.dimension == 2 else 90  # four to six tetrahedra, one triangle
    return 28 + elements + sum(field.stored for field in FIELDS.values() if present[field.term])


def bytes_text(n: float) -> str:
    """A size [B] as text, such as 3.2 GB."""
    for unit in ("B", "kB", "MB", "GB"):
        if n < 1000:
            return f"{n:.3g} {unit}"
        n /= 1000
    return f"{n:.3g} TB"
