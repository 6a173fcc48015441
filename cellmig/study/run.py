"""One run: what it says, what it leaves, how it ends."""

from __future__ import annotations

import math
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from time import perf_counter

import numpy as np

from mpi4py import MPI

from cellmig import __version__
from cellmig.case.schema import Case
from cellmig.meshfree.tangles import tangle
from cellmig.output.directory import OutputError, fresh_directory, together
from cellmig.output.log import Log, Progress, Timers, clock
from cellmig.output.manifest import environment, write_manifest
from cellmig.output.sample import UNITS
from cellmig.output.tables import History, Ledger
from cellmig.output.xdmf import Frames
from cellmig.parallel.options import check_integrator, options_obeyed, petsc_version, unused_options
from cellmig.simulation import Simulation, stops
from cellmig.solve.step import NumericsError, binding
from cellmig.solve.strain import StrainWatch

DONE, BROKEN, INPUT_OUTPUT, STOPPED = 0, 4, 5, 75
CLOSURE = 0.05  # share of the largest energy that may be missing from the ledger: beyond, the step was unstable


class Run:
    """A simulation with its directory: samples and frames as it goes, a manifest before and after."""

    def __init__(self, case: Case, directory: Path, comm: MPI.Comm, *, until: float | None = None, prune: bool = True,
                 quiet: bool = False):
        """Make the directory and build the simulation; collective."""
        check_integrator(case.time.integrator, f"{case.path}: time.integrator")
        self.case, self.comm, self.timers = case, comm, Timers()
        self.directory = fresh_directory(directory, comm)
        self.log = Log(comm, self.directory, quiet)
        self.begin = perf_counter()
        self.end = case.time.end if until is None else until
        self.manifest = {"case": case.resolved(), "case_file": case.path, "end_us": self.end, "exit_status": None,
                         **environment(comm), "petsc": petsc_version(), "seed": case.seed,
                         **({"accuracy": case.chosen} if case.chosen else {})}
        self._say_header()
        with self.timers("build"), options_obeyed():
            self.simulation = Simulation(case, comm, prune)
        self._say_scene()
        self.manifest |= {"skipped": self.simulation.terms.skipped, "particles": self.simulation.scene.size}
        self._save_manifest()
        self.history = History(self.directory, comm, self.simulation.sampler.columns)
        self.ledger = Ledger(self.directory, comm)
        self.frames: Frames | None = None
        self.strain = StrainWatch(self.simulation.mechanics)
        self.worst_closure = 0.0
        self.step_seconds = 0.0
        self.stopping = False

    def go(self, asked: Sequence[int] = ()) -> int:
        """Run until something ends it, such as an entry in `asked`; returns the exit code; collective."""
        progress = Progress(self.log, self.end)
        self._integrator.report = self.log
        self._integrator.after_batch = lambda time: self._after_batch(time, progress, asked)
        status, cause = DONE, ""
        try:
            for stop, sample, frame in stops(self.case, self.end):
                if stop > 0.0:
                    self._advance(stop)
                status, cause = self._ended_early(stop, asked)
                with self.timers("output"):
                    self._look(sample or bool(cause), frame or bool(cause))
                if cause:
                    break
        except NumericsError as error:
            status, cause = BROKEN, str(error)
            self._try_last_frame()
        except OutputError as error:
            status, cause = INPUT_OUTPUT, str(error)
        finally:
            progress.close()
        self._finish(status, cause)
        return status

    @property
    def _integrator(self):
        return self.simulation.integrator

    def _after_batch(self, time: float, progress: Progress, asked: Sequence[int]) -> None:
        """Between stops: the progress, and an end of this solve if any rank was asked to stop."""
        progress(time, self._integrator.steps, self._integrator.dt)
        if self.comm.allreduce(len(asked)):
            self.stopping = True
            self._integrator.halt()

    def _ended_early(self, stop: float, asked: Sequence[int]) -> tuple[int, str]:
        """Status, and why the run ends here, if it does."""
        if self.stopping or self.comm.allreduce(len(asked)):
            return STOPPED, "asked to stop"
        if self._integrator.finished and self.simulation.time < stop:
            return DONE, f"the {self._integrator.steps} steps of -ts_max_steps are taken"
        return DONE, ""

    def _advance(self, stop: float) -> None:
        with self.timers("steps"):
            start = perf_counter()
            self.simulation.go(stop)
            self.step_seconds += perf_counter() - start

    def _look(self, sample: bool, frame: bool) -> None:
        s = self.simulation
        with np.errstate(all="ignore"):  # what is not finite is told below
            rows, entries = s.sample()
        if not all(map(math.isfinite, entries.values())):
            self._integrator.broken("an energy is not finite")
        self.worst_closure = max(self.worst_closure, entries["closure"])
        if warning := self.strain.look(s.time):
            self.log(warning)
        if sample:
            self.history.write(s.time, rows)
            self.ledger.write(s.time, entries)
        if frame:
            self._write_frame()
        if entries["closure"] > CLOSURE and not self.case.static:  # shapes may look right for long after
            self._integrator.broken(f"{100 * entries['closure']:.3g} % of the energy does not add up, of "
                                    f"{100 * CLOSURE:g} % at most")
        m, terms = s.mechanics, s.terms
        found = tangle(m.surfaces, m.surface_positions(), terms.substrate is not None, terms.contact is not None)
        if found:
            self._integrator.broken(found.cause, found.particle, found.remedy)

    def _write_frame(self) -> None:
        fields = self.simulation.sampler.fields()
        if self.frames is None:
            self.frames = Frames(self.directory, self.comm, {name: UNITS[name] for name in fields})
        self.frames.write(self.simulation.time, self._integrator.steps, fields)

    def _try_last_frame(self) -> None:
        """A picture of what broke, if it can be drawn at all."""
        with np.errstate(all="ignore"), suppress(OutputError):
            self.simulation.time = self._integrator.time
            self.simulation.mechanics.rate()
            self._write_frame()

    # ------------------------------------------------------------ what is said

    def _say_header(self) -> None:
        m = self.manifest
        commit = f" ({m['commit']}, {m['tree']})" if "commit" in m else ""
        self.log(f"cellmig {__version__}{commit}  {self.comm.size} rank{'s' * (self.comm.size > 1)}  "
                 f"PETSc {m['petsc']}  {self.case.path}")
        if self.case.title:
            self.log(self.case.title)

    def _say_scene(self) -> None:
        s, m, run = self.simulation, self.simulation.mechanics, self._integrator
        owned = self.comm.allgather(m.n_owned)
        copies = self.comm.allgather(len(m.numbering.ids) - m.n_owned)
        shared = f"; on each rank {_range(owned)} and copies of {_range(copies)} others" if self.comm.size > 1 else ""
        cells = len(s.scene.kind)
        self.log.table([
            ("particles", f"{s.scene.size} in {cells} cell{'s' * (cells > 1)}, spacing "
                          f"{_range([t.spacing for t in s.scene.templates])} µm{shared}"),
            *([("accuracy", self.case.chosen)] if self.case.chosen else []),
            *laws_said(self.case, s),
            *skipped_said(s.terms.skipped),
            ("integrator", run.said),
            *([("chosen", s.reason)] if s.reason else []),
            ("load steps" if self.case.static else "time step", load_said(self.case) if self.case.static else
             run.steps_said or step_said(s.control.stable(), self.case.time.step_factor, run.fixed_step)),
            ("output", str(self.directory)),
            *(("options", f"nothing has asked for {option} so far: is it misspelt?") for option in unused_options()),
        ])

    def _save_manifest(self) -> None:
        together(self.comm, lambda: write_manifest(self.directory, self.manifest), root_only=True)

    def _finish(self, status: int, cause: str) -> None:
        s, run, wall = self.simulation, self._integrator, perf_counter() - self.begin
        per_step = 1e9 * self.step_seconds / max(1, run.steps) / s.scene.size
        mechanism = max(run.count, key=run.count.get) if run.count else ""
        self.manifest |= {
            "exit_status": status, "cause": cause, "time_us": s.time, "steps": run.steps,
            "dt_us": {"least": run.extremes["dt_min"], "most": run.extremes["dt_max"]}, "dt_set_by": mechanism,
            "steps_by_mechanism": run.count, "steps_redone": run.redone, "wall_seconds": wall,
            "ns_per_particle_step": per_step, "J": [run.extremes["J_min"], run.extremes["J_max"]],
            "strain": self.strain.record(), "worst_closure": self.worst_closure,
            "momentum_pN_us_per_um": s.sampler.momentum(), "protrusion_impulse_pN_us_per_um": s.mechanics.impulse(),
            **run.record(), **({"chosen": s.reason} if s.reason else {}),
            "list_renewals": s.mechanics.rebuilds, "frames": self.frames.count if self.frames else 0,
            "state_hash": s.state_hash() if status != BROKEN else None, "unused_options": unused_options(),
            "sections_seconds": self.timers.seconds()}
        self._save_manifest()
        ended = {DONE: "done", BROKEN: "broken", INPUT_OUTPUT: "ended by an error", STOPPED: "stopped"}[status]
        why = f"; {cause}" if cause and status in (DONE, STOPPED) else ""
        self.log(f"{ended}: {s.time:.6g} µs in {run.steps} steps and {clock(wall)}, {per_step:.1f} ns per particle and "
                 f"step{why}")
        if run.steps:
            stretched = f", fluid stretched up to {self.strain.largest:.3g}-fold" if self.strain.largest else ""
            self.log(f"volume ratio J from {run.extremes['J_min']:.4f} to {run.extremes['J_max']:.4f}{stretched}; "
                     f"at most {100 * self.worst_closure:.2g} % of the energy does not add up")
        if self.manifest["unused_options"]:
            self.log("PETSc options that nothing used: " + ", ".join(self.manifest["unused_options"]))
        self.log(self.timers.summary(self.comm))
        if status in (BROKEN, INPUT_OUTPUT):
            self.log.error(f"cellmig: {cause}")


def step_said(stable: dict[str, float], factor: float, fixed: float | None) -> str:
    """What the time step [µs] will be and why; `stable` : by mechanism;  `fixed` : as the user says."""
    mechanism, limit = binding(stable)
    if not fixed:
        return (f"about {1e3 * factor * limit:.3g} ns, {factor:g} of the stable one, which {mechanism} sets; follows "
                "the deformation")
    said = f"{1e3 * fixed:.3g} ns as given, {fixed / limit:.3g} times the stable one, which {mechanism} sets"
    return said if fixed <= limit else f"{said}: TOO LARGE"


def load_said(case: Case) -> str:
    """What the load steps of a static case are."""
    return (f"{case.time.samples}, one for each sample; one that finds no equilibrium is cut; time is what loads "
            "depend on, nothing moves")


def skipped_said(skipped: dict[str, str]) -> list[tuple[str, str]]:
    """What the scene does not need, a row each."""
    rows = [f"{name}: {why}" for name, why in skipped.items()] or ["nothing"]
    return [("" if number else "skipped", row) for number, row in enumerate(rows)]


def laws_said(case: Case, simulation: Simulation) -> list[tuple[str, str]]:
    """The laws of a scene as rows for the log, with what is numerical in them."""
    rows = []
    for name, law in case.materials.items():
        if law not in simulation.scene.materials:
            continue
        viscosity = law.numerical_viscosity(max(t.spacing for t in simulation.scene.templates)) / 1e3
        said = f"{law.law}, stabilised with {viscosity:.3g} mPa s"
        said += f" and {law.numerical_modulus:.4g} Pa" if law.numerical_modulus else ""
        if hasattr(law, "reduced_bulk_modulus"):
            said += f", bulk modulus reduced from {law.bulk_modulus / 1e6:g} to {law.reduced_bulk_modulus / 1e6:g} MPa"
        rows.append((name, said))
    t = simulation.terms
    for name, law in (("substrate", t.substrate), ("between cells", t.contact)):
        if law is not None and law.work:
            rows.append((name, f"{law.law}, work of adhesion {law.work:g} pN/µm, range {1e3 * law.range:g} nm"))
    if t.protrusion is not None and case.protrusion:
        rows.append(("protrusion", f"{', '.join(case.protrusion.cells)}; strength {t.protrusion.strength:g}, "
                                   f"height {t.protrusion.height:g} µm"))
    return rows


@contextmanager
def stop_requests() -> Iterator[list[int]]:
    """Signals that ask for a clean end, as they come: SIGTERM, SIGUSR1, ^C; a second ^C ends the program at once."""
    asked: list[int] = []

    def note(number: int, _: object) -> None:
        if number == signal.SIGINT and signal.SIGINT in asked:
            raise KeyboardInterrupt
        asked.append(number)

    old = {number: signal.signal(number, note) for number in (signal.SIGTERM, signal.SIGUSR1, signal.SIGINT)}
    try:
        yield asked
    finally:
        for number, handler in old.items():
            signal.signal(number, handler)


def _range(values: list) -> str:
    low, high = min(values), max(values)
    text = "{:.4g}" if isinstance(low, float) else "{}"
    return text.format(low) if low == high else f"{text.format(low)}-{text.format(high)}"
