"""Many runs, a process each, as many at a time as there are cores; complete runs are not repeated."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import math
import os
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import IO, Any

from tqdm import tqdm

from mpi4py import MPI

from cellmig.case.load import load
from cellmig.case.own_laws import included
from cellmig.case.schema import Case
from cellmig.case.times import until
from cellmig.exits import FAILED
from cellmig.laws import register
from cellmig.output.directory import Claim, replace
from cellmig.output.log import clock
from cellmig.output.manifest import read_manifest
from cellmig.parallel.launch import PYTHON, on_ranks, outside_mpi
from cellmig.parallel.options import affecting_results, options_given, options_in
from cellmig.version import __version__

from .preflight import cost
from .stops import stop_requests

_SETUP = 3.0  # wall time of a run before its first step and after its last (measured) [s]
LARGEST_ENERGY_ERROR = 0.01  # largest energy error of a run that counts [-]
_PAUSE, _NEXT_LINE, _GRACE = 0.05, 30.0, 20.0  # wall time [s]


@dataclass(frozen=True)
class Job:
    """A planned run: a case file, changes of it as of `--set`, its directory, PETSc's options, number of ranks.

    until : end [us] in place of the case's.
    """

    name: str
    case: Path
    sets: tuple[str, ...]
    directory: Path
    options: tuple[str, ...] = ()
    ranks: int = 1
    until: float | None = None

    def load(self) -> Case:
        """The case with its changes."""
        register()
        return load(self.case, self.sets)

    def is_done(self) -> bool:
        """Whether its directory holds this run, complete: the same case in every value, to its end."""
        manifest = read_manifest(self.directory)
        return manifest.get("exit_status") == 0 and manifest["ranks"] == self.ranks and self.matches(manifest)

    def is_outdated(self) -> bool:
        """Whether its directory holds a complete run of another version of cellmig."""
        manifest = read_manifest(self.directory)
        return manifest.get("exit_status") == 0 and manifest.get("version") != __version__

    def is_resumable(self) -> bool:
        """Whether its directory holds this run with a checkpoint, stopped or killed before its end."""
        manifest = read_manifest(self.directory)
        return (any(self.directory.glob("checkpoint/c*.h5")) and manifest.get("exit_status") != 0
                and self.matches(manifest))

    def matches(self, manifest: Mapping[str, Any]) -> bool:
        """Whether a manifest belongs to this case and to this version of cellmig, as others may have other results."""
        if manifest.get("version") != __version__:
            return False
        case = self.load()
        options, end = options_given() | options_in(self.options), until(case, self.until).time.end
        return (manifest["end_us"] == end and manifest.get("laws", []) == included()
                and affecting_results(manifest.get("petsc_options", {})) == affecting_results(options)
                and manifest["case"] == json.loads(json.dumps(case.resolved())))

    def arguments(self) -> list[str]:
        """Words of its command line."""
        sets = [word for text in self.sets for word in ("--set", text)]
        sets += [word for one in included() for word in ("--law", one["file"])]
        end = [] if self.until is None else ["--until", f"{self.until} us"]
        return ["run", str(self.case), "--out", str(self.directory), "--quiet", *sets, *end, *self.options]

    def command(self) -> str:
        """Command line that repeats it."""
        on_ranks = ["mpiexec", "-n", str(self.ranks)] if self.ranks > 1 else []
        return shlex.join([*on_ranks, "cellmig", *self.arguments()])

    def start(self, errors: IO[str]) -> subprocess.Popen:
        """Start or resume it; its messages go to `errors`."""
        resume = ("--resume", "auto") if self.is_resumable() else ()
        command = [*PYTHON, "-m", "cellmig", *self.arguments(), *resume]
        if self.ranks > 1:
            command = on_ranks(self.ranks, command)
        return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=errors,
                                env=outside_mpi() | {"OPENBLAS_NUM_THREADS": "1", "PYTHONIOENCODING": "utf-8"})


@dataclass(frozen=True)
class JobResult:
    """The end of a run: its exit code, and a message if that is not 0."""

    job: Job
    code: int
    message: str = ""


def run_all(jobs: Sequence[Job], at_once: int, stop_signals: Sequence[int] = (), limit: float = math.inf
            ) -> Iterator[JobResult]:
    """Run jobs in order, on `at_once` ranks at a time, or more if one job needs them; yields each that ended.

    A failure does not stop others.  A run that takes longer than `limit` [s] is killed.  After a signal in
    `stop_signals` no further run starts, and those at work receive SIGTERM.
    """
    waiting, active = list(jobs)[::-1], {}

    def room() -> bool:
        return not active or sum(job.ranks for job, *_ in active.values()) + waiting[-1].ranks <= at_once

    with ExitStack() as files:
        try:
            while (waiting or active) and not stop_signals:
                while waiting and room():
                    job = waiting.pop()
                    errors = files.enter_context(tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace"))
                    active[job.start(errors)] = job, errors, perf_counter()
                time.sleep(_PAUSE)
                late = [p for p, (*_, begin) in active.items() if perf_counter() > begin + limit and p.poll() is None]
                for process in late:
                    _kill(process)
                    yield JobResult(active.pop(process)[0], process.returncode, f"no end within {limit:g} s")
                for process in [p for p in active if p.poll() is not None]:
                    yield _result(process.returncode, *active.pop(process)[:2])
        finally:
            for process in active:
                process.terminate()
            for process in active:
                process.wait()


def run_missing(out: Path, jobs: Iterable[Job], at_once: int | None = None, longest_first: bool = False
                ) -> tuple[dict[Job, JobResult], bool]:
    """Run the jobs that are not complete, with progress; returns those that failed, and whether a signal stopped all.

    out : their directory, which other commands must not use;  at_once : runs at a time, by default one for each core.
    With `longest_first`, runs on several ranks come last, as their ranks wait for each other and need all cores.
    """
    with stop_requests() as signals, Claim(out, MPI.COMM_SELF, make=True):
        failed = _run_missing(list(jobs), at_once or len(os.sched_getaffinity(0)), signals, longest_first)
        return failed, bool(signals)


def _run_missing(jobs: Sequence[Job], at_once: int, stop_signals: Sequence[int], longest_first: bool
                 ) -> dict[Job, JobResult]:
    load = os.getloadavg()[0]
    missing = [job for job in jobs if not job.is_done()]
    outdated = sum(job.is_outdated() for job in missing)
    print(f"{len(jobs)} runs; {len(jobs) - len(missing)} of them are there already"
          + (f"; {outdated} are there of another version of cellmig: they are moved aside and done again" if outdated
             else ""), flush=True)
    if not missing:
        return {}
    seconds = _costs(missing)
    wall = expected(seconds, at_once, load, len(os.sched_getaffinity(0)))
    told = f": about {clock(wall)} with the machine as busy as it is now (load {load:.1f})" if wall else ""
    print(f"{len(missing)} to go, {at_once} at a time{told}", flush=True)
    if longest_first:
        missing.sort(key=lambda job: (job.ranks, -seconds[job]))
    count, failed = ProgressCounter(len(missing)), {}
    for ended in run_all(missing, at_once, stop_signals):
        count(ended)
        if ended.code:
            failed[ended.job] = ended
    count.close()
    return failed


def _costs(jobs: Sequence[Job]) -> dict[Job, float]:
    """Estimated time of each job on a free core [s]; jobs that differ in the seed only are measured once.

    All are 0 where a case has no inertia: only trials would tell.
    """
    known: dict[str, float] = {}
    found = {}
    for job in jobs:
        case = dataclasses.replace(until(job.load(), job.until), seed=0, title="", path="")
        if case.overdamped:
            return dict.fromkeys(jobs, 0.0)
        if repr(case) not in known:
            known[repr(case)] = _SETUP + cost(case).seconds
        found[job] = known[repr(case)]
    return found


def expected(seconds: Mapping[Job, float], at_once: int, load: float, cores: int) -> float:
    """Estimated wall time [s] of jobs with these times on one core; `load` : number of other running processes."""
    longest = max(time / job.ranks for job, time in seconds.items())
    return max(sum(seconds.values()) / at_once, longest) * max(1.0, (at_once + load) / cores)


def unsound(jobs: Iterable[Job]) -> dict[Job, JobResult]:
    """Complete runs with an energy error above CLOSES, whose results do not count."""
    found = {}
    for job in jobs:
        error = read_manifest(job.directory)["worst_energy_error"]
        if error is None or error > LARGEST_ENERGY_ERROR:
            error = float("nan") if error is None else error
            message = f"the energy ledger misses {100 * error:.3g} %, of {100 * LARGEST_ENERGY_ERROR:g} % allowed"
            found[job] = JobResult(job, FAILED, message)
            print(f"{job.name} does not count: {message}")
    return found


def sound_and_unsound(jobs: Mapping[Any, Job]) -> tuple[dict[Any, Job], dict[Job, JobResult]]:
    """Complete jobs that count, by key, and complete jobs that do not."""
    done = {key: job for key, job in jobs.items() if job.is_done()}
    bad = unsound(done.values())
    return {key: job for key, job in done.items() if job not in bad}, bad


def write_rows(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Write rows as CSV, with a column for each name in any of them."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    path.parent.mkdir(parents=True, exist_ok=True)
    replace(path, text.getvalue())


def _kill(process: subprocess.Popen) -> None:
    """Kill a process and its ranks; a second SIGINT ends those of mpiexec at once."""
    for _ in range(2):
        process.send_signal(signal.SIGINT)
        with suppress(subprocess.TimeoutExpired):
            process.wait(_GRACE / 2)
    process.kill()
    process.wait()


def _result(code: int, job: Job, errors: IO[str]) -> JobResult:
    if code == 0:
        return JobResult(job, code)
    errors.seek(0)
    message = errors.read().strip().split("\n")[-1].removeprefix("cellmig: ")
    cause = read_manifest(job.directory).get("cause")
    return JobResult(job, code, cause or message or f"killed by signal {-code}")


class ProgressCounter:
    """Shows how many runs have ended: a bar on a terminal, else lines at intervals."""

    def __init__(self, total: int, unit: str = "run") -> None:
        watched = "CELLMIG_TERMINAL" in os.environ or sys.stdout.isatty()
        self._bar = tqdm(total=total, unit=unit, file=sys.stdout, leave=False, disable=not watched, dynamic_ncols=True)
        self._total, self._done, self._begin, self._unit = total, 0, perf_counter(), unit
        self._due = float("inf") if watched else self._begin + _NEXT_LINE

    def __call__(self, ended: JobResult) -> None:
        """Count a run that ended."""
        self._done += 1
        self._bar.update()
        if ended.code:
            tqdm.write(f"{ended.job.name} failed (exit code {ended.code}): {ended.message}", file=sys.stdout)
        if (now := perf_counter()) >= self._due:
            self._due = now + _NEXT_LINE
            left = (now - self._begin) * (self._total - self._done) / self._done
            print(f"{self._done} of {self._total} {self._unit}s, {clock(now - self._begin)}, left {clock(left)}",
                  flush=True)

    def close(self) -> None:
        """Remove the bar."""
        self._bar.close()
