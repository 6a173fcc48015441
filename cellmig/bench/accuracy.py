"""`cellmig bench --error`: run time against error for all numerical choices."""

from __future__ import annotations

import dataclasses
import itertools
import random
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from cellmig.case.accuracy import measurements
from cellmig.case.messages import CaseError
from cellmig.exits import DONE, STOPPED
from cellmig.output.directory import replace
from cellmig.output.log import clock, table
from cellmig.runs.batch import LARGEST_ENERGY_ERROR
from cellmig.runs.stops import stop_requests
from cellmig.simulation import Simulation
from cellmig.solve.step import NumericsError

from . import modulus
from .pareto import Broken, Point, draw, gains, measured_problems, pareto, time_at, verdict, with_median_times
from .problems import PROBLEMS, Problem, Series, Setting, columns
from .speed import as_json, write_report

SIZES = {"disc": (91, 331, 631, 1485, 3000, 6000, 12000), "drop": (91, 331, 631, 1485, 3000, 6000),
         "cell": (150, 331, 631, 1485, 3000), **dict.fromkeys(("twist", "turn"), (200, 500, 1000, 2000, 5000)),
         "ball": (200, 500, 1000, 2000, 4000), **dict.fromkeys(("scene", "tension"), (150, 331, 631, 1485))}
QUICK = {**dict.fromkeys(("disc", "drop"), (91, 331, 631, 1485)),
         **dict.fromkeys(("cell", "scene", "tension"), (91, 150, 331)),
         **dict.fromkeys(("twist", "turn", "ball"), (100, 200, 500))}
# Particles of the reference runs of problems without an exact solution, in full and with --quick.
FINEST = {"cell": (12000, 1485), "scene": (6000, 631), "tension": (6000, 631), "ball": (12000, 1000)}
# Single changes, at two sizes; the scene takes 10 times as long as the cell.
SINGLE = {"dilation": (1.4, 1.6, 2.0, 2.6, 3.0), "surface_refinement": (2.0, 3.0), "step_factor": (0.4, 0.6, 0.95),
          "stabilisation": (0.0, 0.5, 2.0), "hourglass_modulus": (0.0, 0.08, 0.32, 0.64),
          "modulus": (1.25, 2.5, 10.0, 20.0), "bulk_viscosity": (0.0, 0.2), "integrator": ("rk", "ssp", "bdf")}
TWO = {**dict.fromkeys(("disc", "drop", "cell"), (331, 1485)), **dict.fromkeys(("scene", "tension"), (331, 631)),
       **dict.fromkeys(("twist", "turn", "ball"), (500, 2000))}
# All combinations at all sizes: choices from which an accuracy is picked, and the stabilisation, which matters most.
CROSSED = {"dilation": (1.8, 2.2), "modulus": (1.25, 5.0)}
ALSO = {"dilation": (1.8, 2.2), "stabilisation": (0.25, 1.0), "hourglass_modulus": (0.16, 0.32)}
ON_SCENE = ({"surface_refinement": (1.0, 2.0), "modulus": (1.25, 5.0)},
            {"surface_refinement": (1.0, 2.0), "stabilisation": (0.25, 0.5, 1.0)})
GRIDS = {**dict.fromkeys(("disc", "drop", "cell", "twist", "turn", "ball"), (CROSSED, ALSO)),
         **dict.fromkeys(("scene", "tension"), ON_SCENE)}
# Largest number of particles a cell with PETSc's types, which take minutes there.
SLOW = {"cell": 400, **dict.fromkeys(("scene", "tension", "twist", "turn", "ball"), 0)}
PROBE = 1e6  # particle-steps of a time measurement


class Stopwatch:
    """CPU time per particle-step, corrected for other programs that slow down memory and caches.

    A standard scene is timed beside each run; times are divided by its slowdown relative to its fastest measurement.
    """

    def __init__(self) -> None:
        self._yardstick = PROBLEMS["drop"].simulation(Setting(per_cell=631))
        self.best = min(_probe(self._yardstick) for _ in range(20))

    def calm(self, sim: Simulation) -> float:
        """Corrected nanoseconds per particle-step of a scene."""
        pairs = [(_probe(sim), _probe(self._yardstick)) for _ in range(3)]
        self.best = min(self.best, *(known for _, known in pairs))
        return min(ns * self.best / known for ns, known in pairs)

    def close(self) -> None:
        """Free the standard scene."""
        self._yardstick.destroy()


def _probe(sim: Simulation) -> float:
    """Nanoseconds of CPU time per particle-step, in steps too short to change the state."""
    n = max(10, round(PROBE / sim.scene.size))
    begin = process_time()
    sim.mechanics.advance(n, 1e-12, sim.integrator.gaps[1])
    return 1e9 * (process_time() - begin) / n / sim.scene.size


def measure_problem(problem: Problem, setting: Setting, stopwatch: Stopwatch) -> tuple[Point, Series]:
    """Run a problem with a setting; the error of the point is not yet known.  Raises NumericsError."""
    with problem.simulation(setting) as sim:
        series, cpu = [], 0.0
        for time in problem.times:
            begin = process_time()
            sim.go(time)
            cpu += process_time() - begin
            series.append(problem.measure(sim))
        n, steps = sim.scene.size, sim.integrator.steps + sim.integrator.redone
        # Steps of PETSc's types have several evaluations and parts in Python: the time of the run counts.
        ns = stopwatch.calm(sim) if sim.integrator.leapfrog else 1e9 * cpu / steps / n
        return Point(problem.name, setting, n, steps, ns, cpu, float("nan")), columns(series)


def plan(quick: bool, names: Sequence[str]) -> list[tuple[Problem, Setting]]:
    """All runs of some problems, each once, in random order: slow moments of the machine then do not bias a setting."""
    found: dict[tuple[str, Setting], None] = {}
    for name in names:
        problem, sizes = PROBLEMS[name], (QUICK if quick else SIZES)[name]
        two = (sizes[1],) if quick else TWO[name]
        settings = [Setting(per_cell=n) for n in sizes]
        settings += [Setting(per_cell=n, **{key: value}) for key, values in SINGLE.items() if key not in problem.without
                     for value in values for n in two]
        for grid in GRIDS[name]:
            keys = [key for key in grid if key not in problem.without]
            settings += [Setting(n, **dict(zip(keys, values, strict=True)))
                         for values in itertools.product(*(grid[key] for key in keys)) for n in sizes]
        for s in settings:
            if s.integrator == "leapfrog" or s.per_cell <= SLOW.get(name, s.per_cell):
                found[name, s] = None
    listed = [(PROBLEMS[name], setting) for name, setting in found]
    random.Random(0).shuffle(listed)
    return listed


def references(quick: bool, names: Sequence[str], stopwatch: Stopwatch
               ) -> tuple[dict[str, Series], dict[str, float]]:
    """Measurements of the finest run of problems without an exact solution, and their uncertainty [-].

    Its stabilisation is a quarter of the default, whose error falls with the spacing; the uncertainty is the larger
    difference from a run with the default, and from one with half of the particles.
    """
    found, uncertain = {}, {}
    for name in names:
        problem = PROBLEMS[name]
        if problem.own:
            finest = Setting(FINEST[name][quick], stabilisation=0.25)
            found[name] = measure_problem(problem, finest, stopwatch)[1]
            others = (dataclasses.replace(finest, stabilisation=1.0),
                      dataclasses.replace(finest, per_cell=finest.per_cell // 2))
            uncertain[name] = max(problem.judge(np.array(problem.times), measure_problem(problem, other, stopwatch)[1],
                                                found[name])["error"] for other in others)
    return found, uncertain


def bench_error(out: Path, quick: bool = False, names: Sequence[str] = ()) -> int:
    """Measure all, print the Pareto sets and a verdict on the defaults; write error.json, error.md and error.png.

    Parameters
    ----------
    out : Path -- directory of the results.
    quick : bool -- coarse particles.
    names : list of str -- problems, by default all.

    Returns
    -------
    int -- exit code: 0, or 75 after a signal to stop.
    """
    begin, stopwatch, points, broken = perf_counter(), Stopwatch(), [], []
    names = names or list(PROBLEMS)
    listed = plan(quick, names)
    print(f"{len(listed)} runs one after the other, as they are timed; first the finest", flush=True)
    with stop_requests() as stop_signals:
        finest, uncertain = references(quick, names, stopwatch)
        due = perf_counter() + 30.0
        for count, (problem, setting) in enumerate(listed):
            if stop_signals:
                print("stopped: nothing is written")
                return STOPPED
            try:
                point, series = measure_problem(problem, setting, stopwatch)
            except (CaseError, NumericsError) as error:  # or so few particles that they do not fill the body
                broken.append(Broken(problem.name, setting, str(error)))
                continue
            parts = problem.judge(np.array(problem.times), series, finest.get(problem.name))
            points.append(dataclasses.replace(point, error=parts.pop("error"), parts=parts))
            if perf_counter() > due:
                due = perf_counter() + 30.0
                print(f"{count + 1} of {len(listed)} runs, {clock(perf_counter() - begin)}", flush=True)
    stopwatch.close()
    points = with_median_times(points)
    reduced = modulus.continuation(quick, [name for name in modulus.NAMES if name in names])
    write(out, points, broken, uncertain, reduced, quick)
    print(f"{clock(perf_counter() - begin)} in all")
    return DONE


def write(out: Path, points: Sequence[Point], broken: Sequence[Broken], uncertain: dict[str, float],
          reduced: Sequence[modulus.Row], quick: bool) -> None:
    """Print and write the tables, all points as JSON, the picture, and the accuracies that a case can ask for."""
    measured = measured_problems(points)
    fronts = {name: pareto([p for p in points if p.problem == name]) for name in measured}
    rows = [{"problem": p.problem, **dataclasses.asdict(p.setting), "steps": p.steps, "ns_per_particle_step": p.ns,
             "cost_s": p.cost, "cpu_s": p.cpu, "error": p.error, "parts": p.parts, "pareto": p in fronts[p.problem]}
            for p in sorted(points, key=lambda p: (p.problem, p.cost))]
    found = {"reference_known_to": uncertain,
             "broken": [{"problem": b.problem, **dataclasses.asdict(b.setting), "message": b.message} for b in broken],
             "reduced_modulus": [dataclasses.asdict(row) for row in reduced], "points": rows}
    chosen = "".join(f" --problem {name}" for name in measured) * (len(measured) < len(PROBLEMS))
    command = f"cellmig bench --error{chosen}{' --quick' * quick}"
    origin = write_report(out / "error", "Run time against error: every Pareto set", command, found, [
        *report(points, broken, uncertain), *(["", *modulus.report(reduced)] if reduced else [])])
    replace(out / "accuracy.json", as_json(measurements() | {
        PROBLEMS[name].kind: {"of": PROBLEMS[name].of, "origin": origin, "points": rows}
        for name, rows in accuracy_table(points, uncertain).items()}))
    draw(points, out / "error.png", uncertain)
    print(out / "error.png", out / "accuracy.json", sep="\n")


def accuracy_table(points: Sequence[Point], uncertain: dict[str, float]) -> dict[str, list[dict[str, Any]]]:
    """Accuracies that a case can ask for: by problem, the Pareto set of the points with permitted changes only.

    Errors are at least the uncertainty of the reference, and runs count whose energy adds up.  Cells keep the default
    dilation, with which scenes were tried.
    """
    found = {}
    for name in measured_problems(points):
        problem = PROBLEMS[name]
        allowed = set(GRIDS[name][0]) - ({"dilation"} if name == "cell" else set())
        own = [dataclasses.replace(p, error=float(f"{max(p.error, uncertain.get(name, 0.0)):.3g}")) for p in points
               if p.problem == name and set(p.setting.changes) <= allowed
               and p.parts.get("energy", 0.0) <= LARGEST_ENERGY_ERROR]
        found[name] = [{"error": p.error, "cost_s": float(f"{p.cost:.3g}"), "per_cell": p.setting.per_cell} | {
            key: getattr(p.setting, key) for key in GRIDS[name][0] if key not in problem.without} for p in pareto(own)]
    return found


def report(points: Sequence[Point], broken: Sequence[Broken], uncertain: dict[str, float]) -> list[str]:
    """The tables in Markdown, and the verdict on the defaults."""
    lines, measured = [], measured_problems(points)
    for name in measured:
        problem, own = PROBLEMS[name], [p for p in points if p.problem == name]
        parts = list(own[0].parts)
        known = f"; the reference is known to {100 * uncertain[name]:.2g} %" if name in uncertain else ""
        lines += [f"{problem.title} ({name}): Pareto set of {len(own)} runs{known}", "",
                  *table(["particles", "change of the defaults", "steps", "ns", "time [s]", "error [%]", *parts,
                           "defaults take [s]"],
                          [_line(p, [q for q in own if not q.setting.changes]) for p in pareto(own)]), ""]
    best = gains(points, broken)
    lines += ["Time of the defaults to the same error over that of a change, median over sizes; 1 and less gains "
              "nothing; 0 broke, nan was not measured", "",
              *table(["change", *measured], [[Setting(**change).description, *(f"{row[name]:.2f}" for name in measured)]
                                              for change, row in best]), ""]
    if broken:
        lines += [f"{len(broken)} runs broke:", "", *table(
            ["problem", "particles", "change of the defaults", "message"],
            [[b.problem, str(b.setting.per_cell), b.setting.description, b.message] for b in broken]), ""]
    all_there = len(measured) == len(PROBLEMS)
    some = "" if all_there else f"Defaults are chosen by all problems; by {' and '.join(measured)} alone:  "
    return [*lines, some + verdict(best)]


def _line(p: Point, default: Sequence[Point]) -> list[str]:
    parts = [f"{value:.2g}" for value in p.parts.values()]
    return [str(p.particles), p.setting.description, str(p.steps), f"{p.ns:.0f}", f"{p.cost:.3g}",
            f"{100 * p.error:.2f}",
            *parts, f"{time_at(default, p.error):.3g}"]
