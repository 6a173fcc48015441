"""`cellmig bench --error`: run time against error over what the method leaves to choose."""

from __future__ import annotations

import dataclasses
import itertools
import json
import random
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from mpi4py import MPI

from cellmig.exits import DONE, STOPPED
from cellmig.output.directory import replace
from cellmig.output.log import clock, table
from cellmig.output.manifest import environment, page
from cellmig.runs.run import stop_requests
from cellmig.simulation import Simulation
from cellmig.solve.step import NumericsError

from . import modulus
from .pareto import Point, draw, gains, levelled, pareto, time_at, verdict
from .problems import PROBLEMS, Problem, Seen, Setting

SIZES = {"disc": (91, 331, 631, 1485, 3000, 6000, 12000), "drop": (91, 331, 631, 1485, 3000, 6000),
         "cell": (150, 331, 631, 1485, 3000)}
QUICK = {"disc": (91, 331, 631, 1485), "drop": (91, 331, 631, 1485), "cell": (91, 150, 331)}
FINEST, QUICK_FINEST = 12000, 1485  # particles of the cell's own references
# One thing changed at a time, at two sizes.
SINGLE = {"dilation": (1.4, 1.6, 2.0, 2.6, 3.0), "step_factor": (0.4, 0.6, 0.95), "stabilisation": (0.0, 0.5, 2.0),
          "stiffening": (0.0, 0.25, 1.0, 2.0), "modulus": (1.25, 2.5, 10.0, 20.0), "bulk_viscosity": (0.0, 0.2),
          "integrator": ("rk", "ssp", "bdf")}
# All combinations, at all sizes: what may be picked for an accuracy, and the stabilisation, which matters most.
CROSSED = {"dilation": (1.8, 2.2), "step_factor": (0.8, 0.95), "modulus": (1.25, 5.0)}
ALSO = {"dilation": (1.8, 2.2), "stabilisation": (0.25, 1.0), "stiffening": (0.5, 1.0)}
SLOW_INTEGRATORS = 400  # particles of the cell above which PETSc's types are not run: minutes each
PROBE = 1e6  # particle-steps that are timed after a run


class Stopwatch:
    """CPU time per particle-step on a core as calm as it ever was: other programs slow memory and caches down.

    A yardstick, always the same scene, is timed beside each run; what it then took more than at its best is taken off.
    """

    def __init__(self) -> None:
        self._yardstick = Simulation(PROBLEMS["drop"].case(Setting(per_cell=631)), MPI.COMM_SELF)
        self.best = min(_probe(self._yardstick) for _ in range(20))

    def calm(self, sim: Simulation) -> float:
        """Nanoseconds per particle-step of a scene, in the unit of the calmest moment."""
        pairs = [(_probe(sim), _probe(self._yardstick)) for _ in range(3)]
        self.best = min(self.best, *(known for _, known in pairs))
        return min(ns * self.best / known for ns, known in pairs)

    def close(self) -> None:
        """Free the yardstick."""
        self._yardstick.destroy()


def _probe(sim: Simulation) -> float:
    """Nanoseconds of CPU per particle-step, in steps that move nothing."""
    n = max(10, round(PROBE / sim.scene.size))
    begin = process_time()
    sim.mechanics.advance(n, 1e-12)
    return 1e9 * (process_time() - begin) / n / sim.scene.size


def watch(problem: Problem, setting: Setting, stopwatch: Stopwatch) -> tuple[Point, Seen]:
    """Run a problem under a setting; the point has no error yet.  Raises NumericsError."""
    sim = Simulation(problem.case(setting), MPI.COMM_SELF)
    try:
        problem.place(sim)
        seen, cpu = [], 0.0
        for time in problem.times:
            begin = process_time()
            sim.go(time)
            cpu += process_time() - begin
            seen.append(problem.watch(sim))
        n, steps = sim.scene.size, sim.integrator.steps + sim.integrator.redone
        # PETSc's types take several evaluations a step and time in Python: theirs is what the run took.
        ns = stopwatch.calm(sim) if sim.integrator.leapfrog else 1e9 * cpu / steps / n
        return Point(problem.name, setting, n, steps, ns, cpu, float("nan")), _columns(seen)
    finally:
        sim.destroy()


def _columns(rows: Sequence[dict[str, float]]) -> Seen:
    return {key: np.array([row[key] for row in rows]) for key in rows[0]}


def plan(quick: bool) -> list[tuple[Problem, Setting]]:
    """All that is run, each once, in an order in which like runs do not follow each other."""
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


def references(quick: bool, stopwatch: Stopwatch) -> tuple[dict[str, Seen], dict[str, float]]:
    """Of problems that nobody knows the answer of: what their finest run saw, and how far it is known.

    The stabilisation is an error that goes with the spacing: the finest run has a quarter of the default's, and what
    the default's changes at the same spacing is how far it is known.
    """
    found, uncertain = {}, {}
    finest = QUICK_FINEST if quick else FINEST
    for name, problem in PROBLEMS.items():
        if problem.own:
            found[name] = watch(problem, Setting(finest, stabilisation=0.25), stopwatch)[1]
            default = watch(problem, Setting(finest), stopwatch)[1]
            uncertain[name] = problem.judge(np.array(problem.times), default, found[name])["error"]
    return found, uncertain


def bench_error(out: Path, quick: bool = False) -> int:
    """Measure all, print the Pareto sets and what the defaults should be; write error.json, error.md and error.png.

    Parameters
    ----------
    out : Path -- directory of the results.
    quick : bool -- coarse particles, to try it out.

    Returns
    -------
    int -- exit code: 0, or 75 if it was asked to stop.
    """
    begin, stopwatch, points, failed = perf_counter(), Stopwatch(), [], []
    listed = plan(quick)
    print(f"{len(listed)} runs one after the other, as they are timed; first the finest", flush=True)
    with stop_requests() as asked:
        finest, uncertain = references(quick, stopwatch)
        due = perf_counter() + 30.0
        for count, (problem, setting) in enumerate(listed):
            if asked:
                print("stopped: nothing is written")
                return STOPPED
            try:
                point, seen = watch(problem, setting, stopwatch)
            except NumericsError as error:
                failed.append({"problem": problem.name, **dataclasses.asdict(setting), "message": str(error)})
                continue
            parts = problem.judge(np.array(problem.times), seen, finest.get(problem.name))
            points.append(dataclasses.replace(point, error=parts.pop("error"), parts=parts))
            if perf_counter() > due:
                due = perf_counter() + 30.0
                print(f"{count + 1} of {len(listed)} runs, {clock(perf_counter() - begin)}", flush=True)
    stopwatch.close()
    points = levelled(points)
    reduced = modulus.continuation(quick)
    text = "\n".join([*said(points, failed, uncertain), "", *modulus.said(reduced)])
    print(f"\n{text}\n\n{clock(perf_counter() - begin)} in all")
    write(out, points, failed, uncertain, reduced, text, quick)
    return DONE


def write(out: Path, points: Sequence[Point], failed: list, uncertain: dict[str, float],
          reduced: Sequence[modulus.Row], text: str, quick: bool) -> None:
    """All points as JSON, what was said as Markdown, the picture, and what accuracies are picked from."""
    out.mkdir(parents=True, exist_ok=True)
    origin = {"command": f"cellmig bench --error{' --quick' * quick}", "date": date.today().isoformat(),
              **environment(MPI.COMM_SELF)}
    fronts = {name: pareto([p for p in points if p.problem == name]) for name in PROBLEMS}
    rows = [{"problem": p.problem, **dataclasses.asdict(p.setting), "steps": p.steps, "ns_per_particle_step": p.ns,
             "cost_s": p.cost, "cpu_s": p.cpu, "error": p.error, "parts": p.parts, "pareto": p in fronts[p.problem]}
            for p in sorted(points, key=lambda p: (p.problem, p.cost))]
    replace(out / "error.json", _json({"origin": origin, "reference_known_to": uncertain, "failed": failed,
                                       "reduced_modulus": [dataclasses.asdict(row) for row in reduced],
                                       "points": rows}))
    replace(out / "accuracy.json", _json({"origin": origin, "points": menu(points, uncertain)}))
    replace(out / "error.md", page("Run time against error: every Pareto set", origin["command"], origin, [text]))
    draw(points, out / "error.png", uncertain)
    print(*(out / name for name in ("error.json", "error.md", "error.png", "accuracy.json")), sep="\n")


def menu(points: Sequence[Point], uncertain: dict[str, float]) -> list[dict[str, Any]]:
    """What an accuracy picks from: by kind the front of the points that change nothing but what it may change.

    Below what the reference is known to an error says nothing: such points are held for no better than that.  Cells
    that protrude break with a smaller dilation, which the problem that stands for them does not show.
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


def said(points: Sequence[Point], failed: list, uncertain: dict[str, float]) -> list[str]:
    """The tables in Markdown, and the sentence on the defaults."""
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
              *table(["change", *PROBLEMS], [[Setting(**change).said, *(f"{row[name]:.2f}" for name in PROBLEMS)]
                                              for change, row in best]), ""]
    broken = "; ".join(f"{f['problem']} {f['message'][:60]}" for f in failed)
    lines += [f"{len(failed)} runs broke: {broken}", ""] * bool(failed)
    return [*lines, verdict(best)]


def _line(p: Point, default: Sequence[Point]) -> list[str]:
    parts = [f"{value:.2g}" for value in p.parts.values()]
    return [str(p.particles), p.setting.said, str(p.steps), f"{p.ns:.0f}", f"{p.cost:.3g}", f"{100 * p.error:.2f}",
            *parts, f"{time_at(default, p.error):.3g}"]


def _json(tree: Any) -> str:
    return json.dumps(tree, indent=1, ensure_ascii=False) + "\n"
