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

from cellmig.exits import DONE, STOPPED
from cellmig.output.directory import replace
from cellmig.output.log import clock, table
from cellmig.runs.run import stop_requests
from cellmig.simulation import Simulation
from cellmig.solve.step import NumericsError

from . import modulus
from .pareto import Point, draw, gains, pareto, time_at, verdict, with_median_times
from .problems import PROBLEMS, Problem, Series, Setting, columns
from .speed import as_json, write_report

SIZES = {"disc": (91, 331, 631, 1485, 3000, 6000, 12000), "drop": (91, 331, 631, 1485, 3000, 6000),
         "cell": (150, 331, 631, 1485, 3000)}
QUICK = {"disc": (91, 331, 631, 1485), "drop": (91, 331, 631, 1485), "cell": (91, 150, 331)}
FINEST, QUICK_FINEST = 12000, 1485  # particles of the reference runs of the cell
# Single changes, at two sizes.
SINGLE = {"dilation": (1.4, 1.6, 2.0, 2.6, 3.0), "step_factor": (0.4, 0.6, 0.95), "stabilisation": (0.0, 0.5, 2.0),
          "hourglass_modulus": (0.0, 0.25, 1.0, 2.0), "modulus": (1.25, 2.5, 10.0, 20.0), "bulk_viscosity": (0.0, 0.2),
          "integrator": ("rk", "ssp", "bdf")}
# All combinations at all sizes: choices from which an accuracy is picked, and the stabilisation, which matters most.
CROSSED = {"dilation": (1.8, 2.2), "step_factor": (0.8, 0.95), "modulus": (1.25, 5.0)}
ALSO = {"dilation": (1.8, 2.2), "stabilisation": (0.25, 1.0), "hourglass_modulus": (0.5, 1.0)}
SLOW_INTEGRATORS = 400  # largest number of particles of the cell with PETSc's types, which take minutes
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
    sim.mechanics.advance(n, 1e-12)
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


def plan(quick: bool) -> list[tuple[Problem, Setting]]:
    """All runs, each once, in random order, so that slow moments of the machine do not bias one setting."""
    found: dict[tuple[str, Setting], None] = {}
    for name, sizes in (QUICK if quick else SIZES).items():
        problem = PROBLEMS[name]
        two = (sizes[1],) if quick else (331, 1485)
        settings = [Setting(per_cell=n) for n in sizes]
        settings += [Setting(per_cell=n, **{key: value}) for key, values in SINGLE.items() if key not in problem.without
                     for value in values for n in two]
        for grid in (CROSSED, ALSO):
            keys = [key for key in grid if key not in problem.without]
            settings += [Setting(n, **dict(zip(keys, values, strict=True)))
                         for values in itertools.product(*(grid[key] for key in keys)) for n in sizes]
        for s in settings:
            if not (name == "cell" and s.integrator != "leapfrog" and s.per_cell > SLOW_INTEGRATORS):
                found[name, s] = None
    listed = [(PROBLEMS[name], setting) for name, setting in found]
    random.Random(0).shuffle(listed)
    return listed


def references(quick: bool, stopwatch: Stopwatch) -> tuple[dict[str, Series], dict[str, float]]:
    """Measurements of the finest run of problems without an exact solution, and their uncertainty [-].

    Its stabilisation is a quarter of the default, whose error falls with the spacing; the uncertainty is the
    difference from a run with the default.
    """
    found, uncertain = {}, {}
    finest = QUICK_FINEST if quick else FINEST
    for name, problem in PROBLEMS.items():
        if problem.own:
            found[name] = measure_problem(problem, Setting(finest, stabilisation=0.25), stopwatch)[1]
            default = measure_problem(problem, Setting(finest), stopwatch)[1]
            uncertain[name] = problem.judge(np.array(problem.times), default, found[name])["error"]
    return found, uncertain


def bench_error(out: Path, quick: bool = False) -> int:
    """Measure all, print the Pareto sets and a verdict on the defaults; write error.json, error.md and error.png.

    Parameters
    ----------
    out : Path -- directory of the results.
    quick : bool -- coarse particles.

    Returns
    -------
    int -- exit code: 0, or 75 after a signal to stop.
    """
    begin, stopwatch, points, failed = perf_counter(), Stopwatch(), [], []
    listed = plan(quick)
    print(f"{len(listed)} runs one after the other, as they are timed; first the finest", flush=True)
    with stop_requests() as stop_signals:
        finest, uncertain = references(quick, stopwatch)
        due = perf_counter() + 30.0
        for count, (problem, setting) in enumerate(listed):
            if stop_signals:
                print("stopped: nothing is written")
                return STOPPED
            try:
                point, series = measure_problem(problem, setting, stopwatch)
            except NumericsError as error:
                failed.append({"problem": problem.name, **dataclasses.asdict(setting), "message": str(error)})
                continue
            parts = problem.judge(np.array(problem.times), series, finest.get(problem.name))
            points.append(dataclasses.replace(point, error=parts.pop("error"), parts=parts))
            if perf_counter() > due:
                due = perf_counter() + 30.0
                print(f"{count + 1} of {len(listed)} runs, {clock(perf_counter() - begin)}", flush=True)
    stopwatch.close()
    points = with_median_times(points)
    reduced = modulus.continuation(quick)
    write(out, points, failed, uncertain, reduced, quick)
    print(f"{clock(perf_counter() - begin)} in all")
    return DONE


def write(out: Path, points: Sequence[Point], failed: list, uncertain: dict[str, float],
          reduced: Sequence[modulus.Row], quick: bool) -> None:
    """Print and write the tables, all points as JSON, the picture, and the accuracies that a case can ask for."""
    fronts = {name: pareto([p for p in points if p.problem == name]) for name in PROBLEMS}
    rows = [{"problem": p.problem, **dataclasses.asdict(p.setting), "steps": p.steps, "ns_per_particle_step": p.ns,
             "cost_s": p.cost, "cpu_s": p.cpu, "error": p.error, "parts": p.parts, "pareto": p in fronts[p.problem]}
            for p in sorted(points, key=lambda p: (p.problem, p.cost))]
    found = {"reference_known_to": uncertain, "failed": failed,
             "reduced_modulus": [dataclasses.asdict(row) for row in reduced], "points": rows}
    command = f"cellmig bench --error{' --quick' * quick}"
    origin = write_report(out / "error", "Run time against error: every Pareto set", command, found, [
        *report(points, failed, uncertain), "", *modulus.report(reduced)])
    replace(out / "accuracy.json", as_json({"origin": origin, "points": accuracy_table(points, uncertain)}))
    draw(points, out / "error.png", uncertain)
    print(out / "error.png", out / "accuracy.json", sep="\n")


def accuracy_table(points: Sequence[Point], uncertain: dict[str, float]) -> list[dict[str, Any]]:
    """Accuracies that a case can ask for: by kind of problem, the Pareto set of the points with permitted changes only.

    Errors are at least the uncertainty of the reference.  Cells keep the default dilation, as protruding ones fail with
    a smaller one, which this problem does not show.
    """
    rows = []
    for name, problem in PROBLEMS.items():
        allowed = set(CROSSED) - ({"dilation"} if name == "cell" else set())
        own = [p for p in points if p.problem == name and set(p.setting.changes) <= allowed]
        for p in pareto(own):
            error = max(p.error, uncertain.get(name, 0.0))
            rows.append({"kind": problem.kind, "error": float(f"{error:.3g}"), "cost_s": float(f"{p.cost:.3g}"),
                         "per_cell": p.setting.per_cell, **{key: getattr(p.setting, key) for key in CROSSED
                                                            if key not in problem.without}})
    return rows


def report(points: Sequence[Point], failed: list, uncertain: dict[str, float]) -> list[str]:
    """The tables in Markdown, and the verdict on the defaults."""
    lines = []
    for name, problem in PROBLEMS.items():
        own = [p for p in points if p.problem == name]
        parts = list(own[0].parts)
        known = f"; the reference is known to {100 * uncertain[name]:.2g} %" if name in uncertain else ""
        lines += [f"{problem.title} ({name}): Pareto set of {len(own)} runs{known}", "",
                  *table(["particles", "change of the defaults", "steps", "ns", "time [s]", "error [%]", *parts,
                           "defaults take [s]"],
                          [_line(p, [q for q in own if not q.setting.changes]) for p in pareto(own)]), ""]
    best = gains(points)
    lines += ["Time of the defaults to the same error over that of a change, median over sizes; 1 and less gains "
              "nothing", "",
              *table(["change", *PROBLEMS], [[Setting(**change).description, *(f"{row[name]:.2f}" for name in PROBLEMS)]
                                              for change, row in best]), ""]
    broken = "; ".join(f"{f['problem']} {f['message'][:60]}" for f in failed)
    lines += [f"{len(failed)} runs broke: {broken}", ""] * bool(failed)
    return [*lines, verdict(best)]


def _line(p: Point, default: Sequence[Point]) -> list[str]:
    parts = [f"{value:.2g}" for value in p.parts.values()]
    return [str(p.particles), p.setting.description, str(p.steps), f"{p.ns:.0f}", f"{p.cost:.3g}",
            f"{100 * p.error:.2f}",
            *parts, f"{time_at(default, p.error):.3g}"]
