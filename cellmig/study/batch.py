"""Many runs: one process each, as many at once as there are cores; what is there already is kept."""

from __future__ import annotations

import csv
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import IO, Any

from tqdm import tqdm

from cellmig import meshfree, model
from cellmig.case.load import load
from cellmig.case.registry import discover
from cellmig.case.schema import Case
from cellmig.output.directory import OutputError
from cellmig.output.log import clock
from cellmig.output.manifest import read_manifest

from .run import BROKEN

CLOSES = 0.01  # what the ledger of a run may miss, relative to its largest entry
_PAUSE, _NEXT_LINE = 0.05, 30.0  # wall seconds
_LAUNCHER = ("OMPI_COMM", "PMIX_", "ORTE_", "CELLMIG_TERMINAL")  # would make a process believe that it is a rank


@dataclass(frozen=True)
class Job:
    """One run to be: a case file under some `--set`, the directory that it leaves, PETSc's options and the ranks."""

    name: str
    case: Path
    sets: tuple[str, ...]
    directory: Path
    options: tuple[str, ...] = ()
    ranks: int = 1

    def load(self) -> Case:
        """The case that this run is of."""
        discover(model)
        discover(meshfree)
        return load(self.case, self.sets)

    def is_done(self) -> bool:
        """Whether its directory holds this very run, finished: the same case to the last value, and to its end."""
        manifest = read_manifest(self.directory)
        if manifest.get("exit_status") != 0 or manifest["ranks"] != self.ranks:
            return False
        case = self.load()
        return manifest["end_us"] == case.time.end and manifest["case"] == json.loads(json.dumps(case.resolved()))

    def arguments(self) -> list[str]:
        """What the command line says of it."""
        sets = [word for text in self.sets for word in ("--set", text)]
        return ["run", str(self.case), "--out", str(self.directory), "--quiet", *sets, *self.options]

    def start(self, errors: IO[str]) -> subprocess.Popen:
        """Start it; what it says about a failure goes to `errors`."""
        environment = {key: value for key, value in os.environ.items() if not key.startswith(_LAUNCHER)}
        command = [sys.executable, "-m", "cellmig", *self.arguments()]
        if self.ranks > 1:
            mpiexec = shutil.which("mpiexec.openmpi") or "mpiexec"
            command = [mpiexec, "-q", "-n", str(self.ranks), *command]
        return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=errors, text=True,
                                env=environment | {"OPENBLAS_NUM_THREADS": "1"})


@dataclass(frozen=True)
class Ended:
    """How a run ended: its exit code, and a message if that is not 0."""

    job: Job
    code: int
    message: str = ""


def run_all(jobs: Sequence[Job], at_once: int, asked: Sequence[int] = (), limit: float = math.inf) -> Iterator[Ended]:
    """Run jobs in order, `at_once` of them at a time, and tell of each as it ends; a failure stops no other.

    One that takes longer than `limit` wall seconds is killed.  As soon as `asked` is not empty, nothing more is started
    and what runs is asked to stop, too.
    """
    waiting, active = list(jobs)[::-1], {}
    with ExitStack() as files:
        try:
            while (waiting or active) and not asked:
                while waiting and len(active) < at_once:
                    job, errors = waiting.pop(), files.enter_context(tempfile.TemporaryFile("w+"))
                    active[job.start(errors)] = job, errors, perf_counter()
                time.sleep(_PAUSE)
                late = [p for p, (*_, begin) in active.items() if perf_counter() > begin + limit and p.poll() is None]
                for process in late:
                    process.kill()
                    process.wait()
                    yield Ended(active.pop(process)[0], process.returncode, f"no end within {limit:g} s")
                for process in [p for p in active if p.poll() is not None]:
                    yield _ended(process.returncode, *active.pop(process)[:2])
        finally:
            for process in active:
                process.terminate()
            for process in active:
                process.wait()


def run_counted(jobs: Sequence[Job], at_once: int, asked: Sequence[int] = ()) -> dict[Job, Ended]:
    """Run jobs and show how many have ended; those that failed."""
    count, failed = Count(len(jobs)), {}
    for ended in run_all(jobs, at_once, asked):
        count(ended)
        if ended.code:
            failed[ended.job] = ended
    count.close()
    return failed


def unsound(jobs: Iterable[Job]) -> dict[Job, Ended]:
    """Runs to the end whose energy does not add up: they pass for no result, whatever they would say."""
    found = {}
    for job in jobs:
        closure = read_manifest(job.directory)["worst_closure"]
        if closure is None or closure > CLOSES:
            closure = float("nan") if closure is None else closure
            message = f"the energy ledger misses {100 * closure:.3g} %, of {100 * CLOSES:g} % allowed"
            found[job] = Ended(job, BROKEN, message)
            print(f"{job.name} does not count: {message}")
    return found


def counting(jobs: Mapping[Any, Job]) -> tuple[dict[Any, Job], dict[Job, Ended]]:
    """Of all jobs by key, those that are done and count, and those that ended but do not."""
    done = {key: job for key, job in jobs.items() if job.is_done()}
    bad = unsound(done.values())
    return {key: job for key, job in done.items() if job not in bad}, bad


def write_rows(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Rows as CSV; a column for each name that is in any of them."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(path, "w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, columns, lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    except OSError as error:
        raise OutputError(f"cannot write '{path}' ({error.strerror})") from error


def _ended(code: int, job: Job, errors: IO[str]) -> Ended:
    if code == 0:
        return Ended(job, code)
    errors.seek(0)
    said = errors.read().strip().split("\n")[-1].removeprefix("cellmig: ")
    cause = read_manifest(job.directory).get("cause")
    return Ended(job, code, cause or said or f"killed by signal {-code}")


class Count:
    """How many runs have ended: a bar on a terminal, else a line now and then."""

    def __init__(self, total: int) -> None:
        watched = "CELLMIG_TERMINAL" in os.environ or sys.stdout.isatty()
        self._bar = tqdm(total=total, unit="run", file=sys.stdout, leave=False, disable=not watched, dynamic_ncols=True)
        self._total, self._done, self._begin = total, 0, perf_counter()
        self._due = float("inf") if watched else self._begin + _NEXT_LINE

    def __call__(self, ended: Ended) -> None:
        """After a run."""
        self._done += 1
        self._bar.update()
        if ended.code:
            tqdm.write(f"{ended.job.name} failed (exit code {ended.code}): {ended.message}", file=sys.stdout)
        if (now := perf_counter()) >= self._due:
            self._due = now + _NEXT_LINE
            left = (now - self._begin) * (self._total - self._done) / self._done
            print(f"{self._done} of {self._total} runs, {clock(now - self._begin)}, left {clock(left)}", flush=True)

    def close(self) -> None:
        """Take the bar away."""
        self._bar.close()
