"""When a run writes checkpoints, what they contain, and which of them a run resumes from."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

from mpi4py import MPI

from cellmig.case.load import from_dict
from cellmig.case.messages import CaseError, Mistake
from cellmig.case.own_laws import include_all, included
from cellmig.case.schema import Case
from cellmig.output import checkpoint
from cellmig.output.checkpoint import Checkpoint
from cellmig.output.directory import Claim, OutputError, run_near, together
from cellmig.output.log import Log
from cellmig.output.manifest import processor, read_manifest, time_unit
from cellmig.output.tables import digest_up_to
from cellmig.output.xdmf import check_frames
from cellmig.parallel.options import affecting_results
from cellmig.simulation import Simulation
from cellmig.solve.restart import same_places
from cellmig.version import __version__

FORMAT = 11  # version of names and contents of checkpoints
GO_ON, SAVE, STOP = 0, 1, 2
INTERVAL = 300.0  # default interval of checkpoints in wall time [s]
SHARE = 0.02  # largest share of the wall time for checkpoints at the default interval
SPARE = 3.0  # reserve of wall time for the end, besides the slowest batch of steps [s]


@dataclass(frozen=True)
class Intervals:
    """Intervals of checkpoints in wall [s] and simulated time [µs]; limit of the wall time [s]; None is the default."""

    wall: float | None = None
    simulated: float | None = None
    limit: float | None = None


DEFAULT_INTERVALS = Intervals()


class CheckpointSchedule:
    """Writer of the checkpoints of a run; every method is collective.

    count, seconds : number of checkpoints, and their wall time;  resumable : the last state that can be resumed, where
    the current one cannot.
    """

    def __init__(self, directory: Path, comm: MPI.Comm, intervals: Intervals, begin: float, start: float):
        """`begin` : of the run, by perf_counter [s];  `start` : simulated time at which it begins or resumes [µs]."""
        self.directory, self.comm, self.intervals = directory, comm, intervals
        self.count, self.seconds = 0, 0.0
        self.resumable: Checkpoint | None = None
        self._begin, self._checked = begin, perf_counter()
        self._written = self._checked
        self._saved_until, self._slowest, self._last = start, 0.0, 0.0

    def action(self, time: float, stop_signals: Sequence[int]) -> int:
        """GO_ON, SAVE or STOP at a time [µs]; `stop_signals` : signals that this rank received; collective."""
        now, i = perf_counter(), self.intervals
        self._slowest, self._checked = max(self._slowest, now - self._checked), now
        own = STOP if stop_signals else GO_ON
        if self.comm.rank == 0 and not own:
            if i.limit and now - self._begin + 2.0 * self._slowest + SPARE > i.limit:
                own = STOP
            elif now - self._written > (i.wall or max(INTERVAL, self._last / SHARE)) or (
                    i.simulated and time // i.simulated > self._saved_until // i.simulated):
                own = SAVE
        return self.comm.allreduce(own, MPI.MAX)

    def save(self, state: Callable[[], Checkpoint]) -> None:
        """Write the checkpoint `resumable`, else that of `state()`; collective."""
        begin = perf_counter()
        made = self.resumable or state()
        checkpoint.write(self.directory, self.comm, made)
        self._written = perf_counter()
        self._last, self._saved_until = self._written - begin, made.about["time_us"]
        self.count, self.seconds = self.count + 1, self.seconds + self._last


def identity(case: Case, end: float, prune: bool) -> dict[str, Any]:
    """What has to be equal in a resumed run, in the types of JSON: version, case, end [µs], pruning, own laws."""
    laws = {"laws": included()} if included() else {}
    return {"version": __version__, "case": case.resolved(), "end_us": end, "prune": prune, **laws}


def method(simulation: Simulation, options: dict[str, str]) -> dict[str, Any]:
    """What else has to be equal, known once a simulation is built: code of the kernel, integrator, options."""
    run = simulation.integrator
    return {"kernel": hashlib.sha256(_code(simulation.mechanics.kernel.source).encode()).hexdigest(),
            "integrator": run.description, "step": run.fixed_step, "options": affecting_results(options)}


def _code(source: str) -> str:
    """C source without comments and layout."""
    return " ".join(re.sub(r"/\*.*?\*/|//[^\n]*", " ", source, flags=re.DOTALL).split())


def check_files(state: Checkpoint, directory: Path, comm: MPI.Comm) -> None:
    """Raise OutputError unless tables and frames of a directory belong to a checkpoint; collective."""

    def act() -> None:
        tables = dict(state.about["files"])
        check_frames(directory, tables.pop("frames"), state.about["id"])
        for name, end in tables.items():
            digest_up_to(directory / f"{name}.csv", end)

    together(comm, act, root_only=True)


def check_method(state: Checkpoint, simulation: Simulation, options: dict[str, str]) -> None:
    """Raise OutputError unless method and particles are those of a checkpoint; collective."""
    then, now = state.about["method"], method(simulation, options)
    if then["kernel"] != now["kernel"]:
        raise OutputError("the checkpoint is of another version of cellmig, whose steps are not these: go on with "
                          "that, or begin anew")
    if not same_places(state.stored, simulation.mechanics.part.owners, simulation.comm):
        raise OutputError("the checkpoint is of other particles than are laid out by this version of cellmig on this "
                          f"processor ({processor()}; it is of {state.about['processor']}): go on there, or begin anew")
    for name in ("integrator", "step"):
        if then[name] != now[name]:
            raise OutputError(f"the checkpoint is of a run with {name} {then[name] or 'auto'}, not "
                              f"{now[name] or 'auto'}: give the PETSc options that were given then")
    if other := sorted(dict(then["options"].items() ^ now["options"].items())):
        was, here = (", ".join(f"-{name} {of['options'][name]}".strip() for name in other if name in of["options"])
                     or "without" for of in (then, now))
        raise OutputError(f"the checkpoint is of a run with other PETSc options (on the command line, in PETSC_OPTIONS "
                          f"or in a file .petscrc): {was} then, {here} now")


def check_identity(about: dict[str, Any], case: Case, end: float, prune: bool) -> None:
    """Raise CaseError unless the case is that of a run, OutputError unless the version is."""
    _check_version(about)
    now = json.loads(json.dumps(identity(case, end, prune)))
    about, now = ({**one, "laws": [file["sha256"] for file in one.get("laws", ())]} for one in (about, now))
    for name, what in (("case", ""), ("end_us", "--until"), ("prune", "--no-prune"), ("laws", "--law")):
        if about.get(name) != now[name]:
            found = what or next(_differences(about["case"], now["case"]))
            raise CaseError([Mistake(case.path, None, found, "is not what it was in the run that is there: give what "
                                     "was given then, another place with --out DIR, or no --resume")])


def _check_version(about: dict[str, Any]) -> None:
    if about.get("version") != __version__:
        raise OutputError(f"the run that is there is of cellmig {about.get('version')}, this is {__version__}: go on "
                          "with that version, or begin anew")


def _differences(a: Any, b: Any, path: str = "") -> Any:
    """Dotted keys at which two trees of tables differ."""
    if isinstance(a, dict) and isinstance(b, dict):
        for key in {**a, **b}:
            yield from _differences(a.get(key), b.get(key), f"{path}.{key}" if path else key)
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        for i, pair in enumerate(zip(a, b, strict=True)):
            yield from _differences(*pair, f"{path}.{i}")
    elif a != b:
        yield path


def read_run(claim: Claim, comm: MPI.Comm, quiet: bool = False, done_too: bool = False
         ) -> tuple[dict[str, Any], Checkpoint | None]:
    """Manifest and newest intact checkpoint of the run in a claimed directory, if it has them; collective.

    The checkpoint of a complete run is read only with `done_too`.  Raises OutputError where the two do not match.
    """
    directory = claim.path
    manifest = comm.bcast(together(comm, lambda: read_manifest(directory), root_only=True)[0])
    state = None
    if done_too or not is_done(manifest):
        state = checkpoint.newest(directory, comm, lambda text: Log(comm, directory, quiet)(text))
    if state:
        _check_version(state.about.get("run", {}))
        if state.about.get("format") != FORMAT:
            raise OutputError(f"the checkpoint in '{directory}' is of another state of cellmig's source: begin anew")
        if manifest.get("run_id", state.about["id"]) != state.about["id"]:
            raise OutputError(f"the checkpoint in '{directory}' is of another run than the manifest: take away what "
                              "belongs to another, or begin anew")
    return manifest, state


def is_done(manifest: dict[str, Any]) -> bool:
    """Whether a run is complete."""
    return manifest.get("exit_status") == 0 and not manifest.get("cause")


def last_state(directory: Path, comm: MPI.Comm, quiet: bool = False) -> Checkpoint:
    """Last state of a run, as initial state of another; collective.  Raises OutputError where there is none."""
    with Claim(directory, comm) as claim:
        _, state = read_run(claim, comm, quiet, done_too=True)
    if state is None:
        raise OutputError(f"'{directory}' has no checkpoint to start from")
    return state


def parent(directory: Path, state: Checkpoint) -> dict[str, Any]:
    """Entries for the manifest about the run whose last state was the initial one."""
    about = state.about
    return {"directory": str(directory), "run_id": about["id"], "time_us": about["time_us"],
            "case_file": about["case_file"], "title": about["run"]["case"].get("title", "")}


def new_end(until: float, state: Checkpoint | None, manifest: dict[str, Any], directory: Path) -> float:
    """The changed end of a run [µs].  Raises OutputError or CaseError if the run cannot be resumed to it."""
    if state is None and is_done(manifest):
        raise OutputError(f"the run in '{directory}' is done and has no checkpoint to go on from")
    if state and until < (reached := state.about["time_us"]):
        unit = time_unit(manifest)
        raise CaseError([Mistake("--until", None, "", f"the run in '{directory}' is at {unit.text(reached, 12)} "
                                 f"already, beyond {unit.text(until, 12)}; 'run CASE --from DIR' starts another case "
                                 "from its state")])
    return until


def origin(directory: Path, manifest: dict[str, Any], state: Checkpoint | None) -> tuple[Case, float, bool]:
    """Case, end [µs] and pruning of a run that resumes, or begins again if it has no checkpoint yet."""
    about = state.about | state.about["run"] if state else manifest
    if not ({"case_file", "end_us", "prune", "version"} <= about.keys() and isinstance(about.get("case"), dict)):
        raise OutputError(f"there is nothing to resume in '{directory}'{run_near(directory)}")
    if state:
        _check_version(about)
    include_all(about.get("laws", ()))
    return from_dict(about["case"], about["case_file"]), about["end_us"], about["prune"]
