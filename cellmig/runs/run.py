"""One run: its log, its files, its end."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from time import perf_counter
from typing import Any
from uuid import uuid4

import numpy as np

from mpi4py import MPI

from cellmig.case.messages import CaseError
from cellmig.case.schema import Case
from cellmig.case.times import output_times
from cellmig.exits import DONE, FAILED, INPUT_OUTPUT, INVALID_INPUT, STOPPED
from cellmig.meshfree import overlap_space
from cellmig.meshfree.overlap import escaped, overlap
from cellmig.output import checkpoint
from cellmig.output.checkpoint import Checkpoint
from cellmig.output.directory import Claim, OutputError, together
from cellmig.output.fields import field_unit
from cellmig.output.grids import GridFrames
from cellmig.output.log import Log, Progress, Timers, clock, simulated
from cellmig.output.manifest import environment, write_manifest
from cellmig.output.mesh import Elements, write_mesh
from cellmig.output.profile import write_profile
from cellmig.output.tables import IMPULSE, Tables
from cellmig.output.xdmf import Frames, cut_frames
from cellmig.parallel.ending import require_all
from cellmig.parallel.options import check_integrator, option_errors, options_given, petsc_version, unused_options
from cellmig.simulation import Simulation
from cellmig.solve.step import NumericsError
from cellmig.solve.strain import StrainWatch, lips
from cellmig.version import __version__

from . import checkpointing, summary
from .checkpointing import DEFAULT_INTERVALS, STOP, CheckpointSchedule, Intervals
from .resources import require_resources
from .trial import choose

ENERGY_ERROR = 0.05  # a larger energy error ends a run: the step was unstable [-]


class Run:
    """A simulation with its directory: log, samples, frames, checkpoints, and a manifest before and after."""

    def __init__(self, case: Case, directory: Path, comm: MPI.Comm, *, until: float | None = None, prune: bool = True,
                 quiet: bool = False, intervals: Intervals = DEFAULT_INTERVALS, state: Checkpoint | None = None,
                 claim: Claim | None = None, origin: Path | None = None):
        """Make the directory and build the simulation, resumed from `state` if given; collective.

        until : end [µs] in place of the case's;  claim : of the directory, if it exists already;  origin : directory of
        a run whose last state is the initial state of this one.
        """
        options = options_given()
        check_integrator(case.time.integrator, f"{case.path}: time.integrator")
        if not state:
            require_resources(case, directory, comm)
        origin_state = checkpointing.last_state(origin, comm, quiet) if origin and not state else None
        parent = checkpointing.parent(origin, origin_state) if origin_state else state and state.about["from"]
        self.case, self.comm, self.timers = case, comm, Timers()
        self.directory = Path(directory)
        self.claim = claim or Claim(self.directory, comm, make=True)
        self.aside = None if state else self.claim.clear()
        if state:
            checkpointing.check_files(state, self.directory, comm)
        self.log = Log(comm, self.directory, quiet)
        self.begin = perf_counter()
        self.end = case.time.end if until is None else until
        self.identity = checkpointing.identity(case, self.end, prune)
        self.manifest = {**self.identity, "run_id": state.about["id"] if state else comm.bcast(uuid4().hex),
                         "case_file": case.path, "exit_status": None, **environment(comm), "petsc": petsc_version(),
                         "petsc_options": options,
                         "seed": case.seed, **({"from": parent} if parent else {}),
                         **({"accuracy": case.chosen} if case.chosen else {})}
        if not state:
            self._save_manifest()
        self._log_header()
        with self.timers("build"), option_errors():
            self.simulation = self._build(prune, origin_state, state)
        if state:
            checkpointing.check_method(state, self.simulation, options)
        self._log_scene()
        self.strain = StrainWatch(self.simulation.mechanics)
        self.worst_energy_error = self.steps_before = self.wall_before = 0.0
        self.entries: dict[str, float] = {}
        self.output_time, self.stopping, self.resumed = -1.0, "", []  # last output time [µs]
        self.frames: Frames | None = None
        self.grid_frames: GridFrames | None = None
        self._open(state.about["files"] if state else {"frames": 0})
        if state:
            self._restore(state)
        self._save_manifest(skipped=self.simulation.terms.skipped, particles=self.simulation.scene.size)
        self.schedule = CheckpointSchedule(self.directory, comm, intervals, self.begin, self.simulation.time)
        if not self._integrator.between_samples:
            self.schedule.resumable = self._state()

    def _build(self, prune: bool, origin_state: Checkpoint | None, state: Checkpoint | None) -> Simulation:
        try:
            case, self.reason = choose(self.case, self.comm)
            moved = state.stored["surface renewed"] if state and self.log.root else None
            return Simulation(case, self.comm, prune, start=origin_state.stored if origin_state else None, moved=moved)
        except (CaseError, NumericsError) as error:  # found only once there are particles
            require_all(self.comm, error)
            status = FAILED if isinstance(error, NumericsError) else INVALID_INPUT
            self._save_manifest(exit_status=status, cause=str(error))
            raise

    def _open(self, ends: dict[str, Any]) -> None:
        """Open tables and frames; those of a resumed run are cut to the lengths `ends`."""
        terms, names = self.simulation.terms, [cell.name for cell in self.case.cells]
        if self.case.dimension == 3:
            write_mesh(self.directory, self.comm, self.simulation.scene)
        write_profile(self.directory, self.comm, self.case)
        present = {"substrate": terms.substrate is not None, "neighbours": terms.contact is not None,
                   "tracks": self.case.overdamped or self.case.polarity is not None,
                   "cues": self.simulation.polar, "molecules": bool(self.simulation.fields.diffusing)}
        self.tables = Tables(self.directory, self.comm, names, self.simulation.sampler.columns, present, ends,
                             self.case.dimension, self.case.time_unit, self.simulation.cue_columns, self.case.gels)
        self.frames_before = ends["frames"]
        if "history" in ends:
            cut_frames(self.directory, self.comm, self.frames_before)

    def go(self, stop_signals: Sequence[int] = ()) -> int:
        """Run to the end, or until a signal is in `stop_signals`; returns the exit code; collective."""
        progress = Progress(self.log, self.end, self.simulation.time, self.case.time_unit)
        self._integrator.report = self.log
        self._integrator.after_batch = lambda time: self._after_batch(time, progress, stop_signals)
        self._integrator.within_step = lambda: self._within_step(progress, stop_signals)
        status, cause = DONE, ""
        try:
            for stop, sample, frame in output_times(self.case, self.end, self._integrator.whole_step):
                if stop <= self.output_time:
                    continue
                if stop > 0.0:
                    self._advance(stop)
                status, cause = self._ended_early(stop_signals)
                if self.simulation.time > self.output_time:  # not where a first step was undone
                    with self.timers("output"):
                        self._write_outputs(sample or bool(cause), frame or bool(cause))
                if cause:
                    break
                self.output_time = stop
                if not self._integrator.between_samples:
                    self.schedule.resumable = self._state()
        except (NumericsError, OutputError) as error:
            require_all(self.comm, error)
            status, cause = FAILED if isinstance(error, NumericsError) else INPUT_OUTPUT, str(error)
            if status == FAILED:
                self._try_last_frame()
        finally:
            progress.close()
        if status == DONE:
            self._write_final_checkpoint()
        self._finish(status, cause)
        self.claim.release()
        return status

    @property
    def _integrator(self):
        return self.simulation.integrator

    def _after_batch(self, time: float, progress: Progress, stop_signals: Sequence[int]) -> None:
        """Show progress, write a checkpoint if it is due, stop if a signal or the limit of wall time asks for it."""
        progress(time, self._integrator.steps, self._integrator.dt)
        action = self.schedule.action(time, stop_signals)
        if action:
            self._save()
        if action == STOP:
            self._stop(stop_signals)
            self._integrator.halt()

    def _within_step(self, progress: Progress, stop_signals: Sequence[int]) -> None:
        """Show progress in an implicit step, which may take minutes, and undo it if the run is to stop; collective."""
        run = self._integrator
        progress(run.time, run.steps, run.dt, f"in its step {run.trying} of Newton's")
        if not self.stopping and self.schedule.action(run.time, stop_signals) == STOP:
            self._save()
            self._stop(stop_signals)
            run.halt()

    def _stop(self, stop_signals: Sequence[int]) -> None:
        stop_signals = self.comm.allreduce(len(stop_signals))
        self.stopping = "asked to stop" if stop_signals else "the wall time is used up"

    def _ended_early(self, stop_signals: Sequence[int]) -> tuple[int, str]:
        """Exit code and cause if the run ends before its end; an empty cause if not."""
        if not self.stopping and self.comm.allreduce(len(stop_signals)):
            self._save()
            self._stop(stop_signals)
        if self.stopping:
            return STOPPED, self.stopping
        if self._integrator.finished and self.simulation.time < self.end:
            return DONE, f"the {self._integrator.steps} steps of -ts_max_steps are taken"
        return DONE, ""

    # ------------------------------------------------------------ checkpoints

    def _save(self) -> None:
        """Write a checkpoint of now, or of the last sample where the current state cannot be resumed."""
        with self.timers("checkpoints"):
            self.tables.flush()
            self.schedule.save(self._state)

    def _write_final_checkpoint(self) -> None:
        """Write a checkpoint of the end and delete the others, so that another run can continue from it."""
        with self.timers("checkpoints"):
            last = self.schedule.resumable or self._state()
            try:
                checkpoint.write(self.directory, self.comm, last, keep=1)
            except OutputError as error:  # the run is complete all the same
                self.log(f"its last state is not kept: {error}")

    def _state(self) -> Checkpoint:
        """The current state as a checkpoint; collective."""
        about, arrays = self.simulation.saved()
        files = {**self.tables.ends(), "frames": self.frames.count if self.frames else self.frames_before}
        run = {"output_time": self.output_time, "worst_energy_error": self.worst_energy_error, "resumed": self.resumed,
               "step_seconds": self._step_seconds(), "wall_seconds": self._wall(), "strain": self.strain.saved()}
        now = checkpointing.method(self.simulation, self.manifest["petsc_options"])
        return Checkpoint({"format": checkpointing.FORMAT, "id": self.manifest["run_id"],
                           "from": self.manifest.get("from"),
                           "run": self.identity, "case_file": self.case.path, "time_us": self._integrator.time,
                           "processor": self.manifest["processor"], "method": now, "files": files,
                           "past": run, "state": about}, arrays)

    def _restore(self, state: Checkpoint) -> None:
        self.simulation.restore(state.about["state"], state.stored)
        run = state.about["past"]
        self.output_time, self.worst_energy_error = run["output_time"], run["worst_energy_error"]
        self.steps_before, self.wall_before = run["step_seconds"], run["wall_seconds"]
        self.strain.restore(run["strain"])
        self.resumed = [*run["resumed"], {"time_us": state.about["time_us"], "ranks": self.comm.size}]
        self.manifest["resumed"] = self.resumed
        unit = self.case.time_unit
        self.log(f"goes on from the checkpoint at {unit.text(state.about['time_us'])}")
        if (end := state.about["run"]["end_us"]) != self.end:
            self.resumed[-1]["until_us"] = self.end
            self.log(f"its end is now {unit.text(self.end, 12)}, no longer {unit.text(end, 12)}")
        before, now = state.about["processor"], self.manifest["processor"]
        if before != now:
            self.resumed[-1]["processor"] = now
            self.log(f"it was written on another processor ({before}; this is {now}): last bits may differ")

    def _wall(self) -> float:
        """Wall time of the run, with that before it was resumed [s]."""
        return self.wall_before + perf_counter() - self.begin

    def _step_seconds(self) -> float:
        """Wall time of all steps, with those before it was resumed [s]."""
        return self.steps_before + self.timers.seconds().get("steps", 0.0)

    # ------------------------------------------------------------ steps and samples

    def _advance(self, stop: float) -> None:
        with self.timers("steps"):
            self.simulation.go(stop)

    def _write_outputs(self, sample: bool, frame: bool) -> None:
        s = self.simulation
        with np.errstate(all="ignore"):  # values that are not finite are reported below
            rows, entries = s.sample(everywhere=False)
        if not all(map(math.isfinite, entries.values())):
            self._integrator.fail("an energy is not finite")
        self.worst_energy_error, self.entries = max(self.worst_energy_error, entries["energy_error"]), entries
        if warning := self.strain.check(s.time):
            self.log(warning)
        if sample:
            self.tables.write(s.time, rows, entries, s.next_row(rows, everywhere=False))
        if frame:
            self._write_frame()
        m, terms = s.mechanics, s.terms
        around, x = m.segments.around()
        between, of_itself = terms.contact is not None, terms.contacts is not None and terms.contacts.own
        if self.case.dimension == 2:
            found = overlap(around, x, self.case.substrate is not None, between, of_itself)
        else:
            found = overlap_space.overlap(around, x, self.case.substrate is not None, between)
        if frame and found is None:  # it takes longer than a sample
            left = escaped if self.case.dimension == 2 else overlap_space.escaped
            found = left(around, x, m.ids, m.part.owned.cell, m.part.owned.X + m.state.u)
        if found := min(filter(None, self.comm.allgather(found)), default=None):
            self._integrator.fail(found.cause, found.particle, found.remedy + lips(m))
        if entries["energy_error"] > ENERGY_ERROR and not self.case.static:  # shapes alone would not show it for long
            self._integrator.fail(f"the energy error is {100 * entries['energy_error']:.3g} %, more than "
                                  f"{100 * ENERGY_ERROR:g} %")

    def _write_frame(self) -> None:
        fields = self.simulation.sampler.fields()
        if self.frames is None:
            units = {name: field_unit(name, self.case.dimension) for name in fields}
            self.frames = Frames(self.directory, self.comm, units, self.frames_before, self.manifest["run_id"],
                                 self._elements(fields["id"]), self.case.time_unit)
            if self.simulation.fields.diffusing:
                self.grid_frames = GridFrames(self.directory, self.comm, self.frames_before, self.manifest["run_id"],
                                              self.case.time_unit)
        elif self.case.numerics.renewal is not None:
            self.frames.elements = self._elements(fields["id"])
        self.frames.write(self.simulation.time, self._integrator.steps, fields)
        if self.grid_frames is not None:
            self.grid_frames.write(self.simulation.time, self.simulation.fields.grids())

    def _elements(self, ids: np.ndarray) -> Elements | None:
        """What is drawn of this rank's particles `ids` (n,) int in three dimensions, None in two; collective."""
        owners = self.simulation.mechanics.part.owners
        return Elements(self.comm, owners, ids) if self.case.dimension == 3 else None

    def _try_last_frame(self) -> None:
        """Write a frame of the state that failed, if possible."""
        with np.errstate(all="ignore"), suppress(OutputError):
            self.simulation.time = self._integrator.time
            self.simulation.mechanics.rate()
            self._write_frame()

    # ------------------------------------------------------------ log and manifest

    def _log_header(self) -> None:
        m = self.manifest
        commit = f" ({m['commit']}, {m['tree']})" if "commit" in m else ""
        self.log(f"cellmig {__version__}{commit}  {self.comm.size} rank{'s' * (self.comm.size > 1)}  "
                 f"PETSc {m['petsc']}  {self.case.path}")
        if self.case.title:
            self.log(self.case.title)

    def _log_scene(self) -> None:
        s, m, run, unit = self.simulation, self.simulation.mechanics, self._integrator, self.case.time_unit
        parts = self.comm.allgather((m.n_owned, len(m.state.numbering.ids) - m.n_owned))
        shared = "; on each rank {} and copies of {} others".format(*map(summary.span, zip(*parts, strict=True)))
        cells = len(s.scene.kind)
        self.log.table([
            ("particles", f"{s.scene.size} in {cells} cell{'s' * (cells > 1)}, spacing "
                          f"{summary.span([t.spacing for t in s.scene.templates])} µm"
                          f"{shared * (self.comm.size > 1)}"),
            *summary.describe_balance(m.part.owners.load),
            *([("accuracy", self.case.chosen)] if self.case.chosen else []),
            *(summary.describe_scene(s.case, self.end) if self.log.root else []),
            *summary.describe_laws(self.case, s),
            *summary.describe_skipped(s.terms.skipped),
            *([("neighbours", f"found anew where a fluid is stretched {s.terms.renewal:g}-fold")]
              if s.terms.renewal is not None else []),
            ("integrator", run.description),
            *([("chosen", self.reason)] if self.reason else []),
            ("load steps", summary.describe_load_steps(self.case)) if self.case.static else
            ("time step", run.step_description or summary.describe_step(
                s.control.stable(), self.case.time.step_factor, run.fixed_step, self.case.time_unit)),
            *([("from", f"the state of '{origin['directory']}' at {unit.text(origin['time_us'])}, at {unit.text(0.0)}")]
              if (origin := self.manifest.get("from")) else []),
            ("output", f"{self.directory}{f'; what was there is now in {self.aside}' if self.aside else ''}"),
            *(("options", f"nothing has asked for {option} so far: is it misspelt?") for option in unused_options()),
        ])

    def _save_manifest(self, **more: Any) -> None:
        self.manifest |= more
        together(self.comm, lambda: write_manifest(self.directory, self.manifest), root_only=True)

    def _finish(self, status: int, cause: str) -> None:
        s, run, wall = self.simulation, self._integrator, self._wall()
        per_step = 1e9 * self._step_seconds() / max(1, run.steps) / s.scene.size
        mechanism = max(run.count, key=run.count.get) if run.count else ""
        impulse = IMPULSE[self.case.dimension]
        self.manifest |= {
            "exit_status": status, "cause": cause, "time_us": s.time, "steps": run.steps,
            "dt_us": {"least": run.extremes["dt_min"], "most": run.extremes["dt_max"]}, "dt_set_by": mechanism,
            "steps_by_mechanism": run.count, "steps_redone": run.redone, "wall_seconds": wall,
            "ns_per_particle_step": per_step, "J": s.J_range,
            "strain": self.strain.record(), "worst_energy_error": self.worst_energy_error,
            f"momentum_{impulse}": s.sampler.momentum(),
            f"protrusion_impulse_{impulse}": s.mechanics.accounts.protrusion_impulse(),
            **run.record(), **({"chosen": self.reason} if self.reason else {}),
            "list_renewals": s.mechanics.segments.renewals,
            "frames": self.frames.count if self.frames else self.frames_before,
            "checkpoints": {"written": self.schedule.count, "seconds": self.schedule.seconds},
            "state_hash": s.state_hash() if status != FAILED else None, "unused_options": unused_options(),
            "sections_seconds": self.timers.seconds()}
        self._save_manifest()
        ended = {DONE: "done", FAILED: "failed", INPUT_OUTPUT: "ended by an error", STOPPED: "stopped"}[status]
        why = f"; {cause}" if cause and status in (DONE, STOPPED) else ""
        self.log(f"{ended}: {simulated(s.time, self.case.time_unit)} in {run.steps} steps and {clock(wall)}, "
                 f"{per_step:.1f} ns per particle and step{why}")
        if run.steps:
            stretched = f", fluid stretched up to {self.strain.largest:.3g}-fold" if self.strain.largest else ""
            stretched += f", neighbours found anew {s.mechanics.renewals} times" * (s.mechanics.renewals > 0)
            error = f"; energy error at most {100 * self.worst_energy_error:.2g} %" if self.output_time > 0.0 else ""
            self.log(f"volume ratio J from {summary.describe_volumes(s.J_range)}{stretched}{error}")
        if dissipation := summary.describe_dissipation(self.entries):
            self.log(f"dissipation: {dissipation}")
        for told in filter(None, (summary.measured_balance(s), run.closing, self.strain.summary(), *s.fields.closing)):
            self.log(told)
        if self.manifest["unused_options"]:
            self.log("PETSc options that nothing used: " + ", ".join(self.manifest["unused_options"]))
        self.log(self.timers.summary(self.comm))
        if status in summary.NEXT:
            self.log(summary.NEXT[status].format(self.directory))
        if status in (FAILED, INPUT_OUTPUT):
            self.log.error(f"cellmig: {cause}")
