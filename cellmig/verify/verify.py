"""`cellmig verify`: errors, observed and expected orders of every reference, at three resolutions or more.

How to add a reference: write one function of the resolution in a module of `cellmig/verify/references`,

    @reference("cook", shows="a tapered panel under shear",
               source="finite elements: NGSolve of high order, felupe's mixed Q2",
               expected={"deflection": converges(2, "linear basis: h² in displacements", {5000: 0.01, 20000: 0.003})},
               at=(600, 1250, 2500, 5000), quick=(300, 600, 1250), seconds=20.0)
    def cook(count: int) -> Measured:
        …
        return Measured(spacing, {"deflection": abs(found / 6.8522 - 1.0)}, count)

`at` are the resolutions, which are arguments of the function, `quick` those of `--quick`.  `exact(1e-12, why)` in place
of `converges` expects an error of rounding at every resolution.  Targets for the error itself are given by number of
particles.  Modules are discovered.  `python -m cellmig verify --only cook` runs the reference, on one process.
"""

from __future__ import annotations

import json
import math
import os
import queue
import subprocess
import threading
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

from cellmig.case.messages import nearest
from cellmig.case.registry import discover
from cellmig.exits import DIFFERENT, DONE, STOPPED
from cellmig.output.directory import replace
from cellmig.output.log import clock
from cellmig.output.manifest import environment, page
from cellmig.parallel.launch import PYTHON, outside_mpi
from cellmig.runs.batch import JobResult, ProgressCounter, write_rows
from cellmig.runs.stops import stop_requests

from . import references
from .reference import FAILS, HOLDS, REFERENCES, Measured, Reference, Verdict, judge


@dataclass(frozen=True)
class Point:
    """A reference at one resolution."""

    reference: Reference
    resolution: Any

    @property
    def name(self) -> str:
        """Name in messages."""
        return f"{self.reference.name} at {self.resolution:g}"

    @property
    def seconds(self) -> float:
        """Estimated wall time on one core [s]: with more particles steps are shorter, too."""
        finest = max(self.reference.at)
        share = self.resolution / finest if isinstance(finest, int) else 1.0
        return self.reference.seconds * share**1.5


def load_references() -> dict[str, Reference]:
    """All references by name, in the order of their modules."""
    discover(references)
    return REFERENCES


def verify(out: Path, only: Sequence[str] = (), quick: bool = False, at_once: int | None = None) -> int:
    """Measure references at their resolutions, print verdicts, write them to `out`; returns the exit code.

    only : names of references or groups, by default all;  quick : coarse resolutions;  at_once : number of processes.
    """
    chosen = select(only)
    points = [Point(r, n) for r in chosen for n in (r.quick if quick else r.at)]
    at_once = at_once or len(os.sched_getaffinity(0))
    wall = max(sum(p.seconds for p in points) / at_once, *(p.seconds for p in points))
    print(f"{len(chosen)} references at {len(points)} points, {at_once} at a time: about {clock(wall)}", flush=True)
    found: dict[Point, Measured | str] = {}
    progress = ProgressCounter(len(points), "point")
    with stop_requests() as stop_signals:
        for point, answer in measure_all(points, at_once, stop_signals):
            found[point] = answer
            progress(JobResult(point, int(isinstance(answer, str)), answer if isinstance(answer, str) else ""))
    progress.close()
    if stop_signals:
        return STOPPED
    verdicts = [v for r in chosen
                for v in judged(r, {p.resolution: a for p, a in found.items() if p.reference is r}, quick)]
    write(out, chosen, verdicts, quick)
    print("", *table(verdicts), "", *(str(out / f"verify.{kind}") for kind in ("json", "csv", "md")), sep="\n")
    return DIFFERENT if any(v.why for v in verdicts) else DONE


def select(only: Sequence[str]) -> list[Reference]:
    """References by name or by group; raises KeyError with an unknown name and the nearest known one, None without."""
    known = load_references()
    groups = {r.group for r in known.values()}
    if unknown := [name for name in only if name not in known and name not in groups]:
        raise KeyError(unknown[0], nearest(unknown[0], [*known, *groups]))
    return [r for r in known.values() if not only or r.name in only or r.group in only]


def judged(reference: Reference, answers: dict[Any, Measured | str], quick: bool) -> list[Verdict]:
    """A verdict on each error of a reference; where a resolution failed, none holds."""
    measured = [a for a in answers.values() if isinstance(a, Measured)]
    failed = [f"at {n:g}: {a}" for n, a in answers.items() if isinstance(a, str)]
    coarse = reference.coarse if quick else {}
    return [judge(reference.name, name, expected, measured, failed, coarse.get(name, 0.0))
            for name, expected in reference.expected.items()]


# ----------------------------------------------------------------------------------------------------- many at a time


class Worker:
    """A process that measures points one after the other; it is started again if it ended."""

    def __init__(self) -> None:
        self._process: subprocess.Popen | None = None

    def measure(self, point: Point) -> Measured | str:
        """Measure a point; a text says why it failed."""
        if self._process is None or self._process.poll() is not None:
            self._process = subprocess.Popen([*PYTHON, "-m", references.__name__], encoding="utf-8",
                                             stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                                             env=outside_mpi() | {"OPENBLAS_NUM_THREADS": "1"})
        try:
            print(json.dumps([point.reference.name, point.resolution]), file=self._process.stdin, flush=True)
            line = self._process.stdout.readline()
        except BrokenPipeError:
            line = ""
        if not line:
            return f"its process ended with code {self._process.wait()}"
        answer = json.loads(line)
        return answer["failed"] if "failed" in answer else Measured(**answer)

    def end(self) -> None:
        """Stop the process."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process.stdin.close()
            self._process.stdout.close()


def measure_all(points: Sequence[Point], at_once: int, stop_signals: Sequence[int] = ()
                ) -> Iterator[tuple[Point, Measured | str]]:
    """Measure points in processes, the longest first; yield each with its answer, until there are `stop_signals`."""
    waiting = deque(sorted(points, key=lambda point: -point.seconds))
    answers: queue.Queue[tuple[Point, Measured | str]] = queue.Queue()
    workers = [Worker() for _ in range(min(at_once, len(points)))]

    def work(worker: Worker) -> None:
        while waiting and not stop_signals:
            try:
                point = waiting.popleft()
            except IndexError:  # another one took the last
                return
            answers.put((point, worker.measure(point)))

    threads = [threading.Thread(target=work, args=(worker,), daemon=True) for worker in workers]
    for thread in threads:
        thread.start()
    left = len(points)
    try:
        while left and not stop_signals:
            try:
                yield answers.get(timeout=0.1)
                left -= 1
            except queue.Empty:
                continue
    finally:
        waiting.clear()
        for worker in workers:
            worker.end()


# ------------------------------------------------------------------------------------------------------------- tables


def table(verdicts: Sequence[Verdict]) -> list[str]:
    """Lines of a table of errors, orders and verdicts, with the reason of each failure."""
    lines = [_line("reference", "error", "errors from coarse to fine", "order", "fitted", "expected", "verdict"),
             "-" * 160]
    for v in verdicts:
        exact = v.expected.order is None
        lines.append(_line(v.reference, v.error, errors_of(v), _order(v.pairwise), _order(v.fitted),
                           f"<{v.expected.tolerance:.0e}" if exact else f"{v.expected.order:g}", v.verdict))
        lines += [f"      {reason}" for reason in v.why]
        if v.below_floor:
            lines.append(f"      no order is asked: the last error is below {v.expected.floor:.1g}")
    held = sum(v.verdict == HOLDS for v in verdicts)
    return [*lines, f"{held} of {len(verdicts)} hold" + ("" if held == len(verdicts) else f", {len(verdicts) - held} "
                                                         f"{'does' if len(verdicts) - held == 1 else 'do'} not")]


def errors_of(v: Verdict) -> str:
    """Errors from coarse to fine, as text."""
    return " ".join(f"{e:.2g}" for e in v.errors)


def _line(reference: str, error: str, errors: str, order: str, fitted: str, expected: str, verdict: str) -> str:
    return f"{reference:<24} {error:<42} {errors:<42} {order:>6} {fitted:>6} {expected:>8}  {verdict}"


def _order(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.2f}"


def listing(only: Sequence[str] = ()) -> list[str]:
    """Lines that list each reference, its source, and what is expected and why."""
    lines = []
    for r in select(only):
        lines.append(f"{r.name} ({r.group}): {r.shows} [{r.source}]")
        for name, e in r.expected.items():
            what = "exact" if e.order is None else f"order {e.order:g}"
            lines.append(f"    {name}: {what}; {e.why}")
    return lines


def markdown(chosen: Sequence[Reference], verdicts: Sequence[Verdict]) -> list[str]:
    """Lines of docs/data/verify.md: a description of each reference, and a row for each error."""
    lines: list[str] = []
    for r in chosen:
        lines += ["", f"## {r.name} ({r.group})", "", f"{r.shows[0].upper()}{r.shows[1:]}.  Exact: {r.source}.", "",
                  f"| error | sizes [{r.unit or '-'}] | errors | order, fitted | expected | why | verdict |",
                  "|---|---|---|---|---|---|---|"]
        lines += [_row(v) for v in verdicts if v.reference == r.name]
    return lines[1:]


def _row(v: Verdict) -> str:
    e = v.expected
    expected = f"< {e.tolerance:.0e}" if e.order is None else f"{e.order:g}"
    expected += "".join(f"; {100 * t:g} % at {n:,}" for n, t in e.within.items())
    expected += f"; no order below {e.floor:.1g}" if e.floor else ""
    orders = "" if e.order is None else f"{_order(v.pairwise)}, {_order(v.fitted)}"
    verdict = v.verdict if v.verdict == HOLDS else f"**{FAILS}**: {'; '.join(v.why)}"
    sizes, errors = ", ".join(f"{h:.3g}" for h in v.sizes), ", ".join(f"{x:.2g}" for x in v.errors)
    return f"| {v.error} | {sizes} | {errors} | {orders} | {expected} | {e.why} | {verdict} |"


def write(out: Path, chosen: Sequence[Reference], verdicts: Sequence[Verdict], quick: bool) -> None:
    """Write all numbers as JSON and CSV, and as tables for the docs."""
    made = environment(MPI.COMM_SELF)
    rows = [_entries(r, v) for r in chosen for v in verdicts if v.reference == r.name]
    write_rows(out / "verify.csv", [row | {name: " ".join(map(repr, row[name])) for name in row
                                           if isinstance(row[name], tuple)} for row in rows])
    text = json.dumps({"made_with": made, "quick": quick, "verdicts": rows}, indent=1, ensure_ascii=False)
    replace(out / "verify.json", text.replace("NaN", "null") + "\n")
    replace(out / "verify.md", page("Errors and orders of every reference", f"cellmig verify{' --quick' * quick}", made,
                                    markdown(chosen, verdicts)))


def _entries(r: Reference, v: Verdict) -> dict[str, Any]:
    e = v.expected
    return {"group": r.group, "reference": r.name, "shows": r.shows, "source": r.source, "error": v.error,
            "unit": r.unit, "sizes": v.sizes, "particles": v.particles, "errors": v.errors, "order": v.pairwise,
            "order_fitted": v.fitted, "expected_order": e.order, "tolerance": e.tolerance,
            "targets": "; ".join(f"{t:g} at {n}" for n, t in e.within.items()), "floor": e.floor,
            "expected_because": e.why, "verdict": v.verdict, "why": "; ".join(v.why)}
