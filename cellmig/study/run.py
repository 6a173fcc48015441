"""One run: what it says, what it leaves, how it ends."""

from __future__ import annotations

import math
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter

import numpy as np
from mpi4py import MPI

from cellmig import __version__
from cellmig.case.schema import Case
from cellmig.output.directory import fresh_directory
from cellmig.output.log import Log, Progress, Timers, clock
from cellmig.output.manifest import environment, write_manifest
from cellmig.output.sample import UNITS
from cellmig.output.tables import History, Ledger
from cellmig.output.xdmf import Frames
from cellmig.parallel.options import petsc_version, unused_options
from cellmig.simulation import Simulation, stops
from cellmig.solve.step import NumericsError, binding

DONE, BROKEN, INPUT_OUTPUT, STOPPED = 0, 4, 5, 75


class Run:
    """A simulation with its directory: samples and frames as it goes, a manifest before and after."""

    def __init__(self, case: Case, directory: Path, comm: MPI.Comm, *, until: float | None = None, prune: bool = True,
                 quiet: bool = False):
        """Make the directory and build the simulation; collective."""
        self.case, self.comm, self.timers = case, comm, Timers()
        self.directory = fresh_directory(directory, comm)
        self.log = Log(comm, self.directory, quiet)
        self.begin = perf_counter()
        self.end = case.time.end if until is None else until
        self.manifest = {"case": case.resolved(), "case_file": case.path, "end_us": self.end, "exit_status": None,
                         **environment(comm), "petsc": petsc_version(), "seed": case.seed}
        self._say_header()
        with self.timers("build"):
            self.simulation = Simulation(case, comm, prune)
        self._say_scene()
        self._save_manifest()
        self.history, self.ledger = History(self.directory, comm), Ledger(self.directory, comm)
        self.frames: Frames | None = None
        self.worst_closure = 0.0
        self.step_seconds = 0.0

    def go(self) -> int:
        """Run to the end, or until something ends it; returns the exit code; collective."""
        progress = Progress(self.log, self.end)
        self.simulation.integrator.after_batch = lambda time: progress(time, self._integrator.steps, self._integrator.dt)
        status, cause = DONE, ""
        with stop_requests() as asked:
            try:
                for stop, sample, frame in stops(self.case, self.end):
                    if stop > 0.0:
                        self._advance(stop)
                    with self.timers("output"):
                        self._look(sample, frame)
                    if self._integrator.finished and self.simulation.time < stop:
                        cause = f"PETSc's TS has taken its {self._integrator.steps} steps"
                        break
                    if self.comm.allreduce(len(asked)):
                        status, cause = STOPPED, "asked to stop"
                        break
            except NumericsError as error:
                status, cause = BROKEN, str(error)
                self._try_last_frame()
            finally:
                progress.close()
        self._finish(status, cause)
        return status

    @property
    def _integrator(self):
        return self.simulation.integrator

    def _advance(self, stop: float) -> None:
        with self.timers("steps"):
            start = perf_counter()
            self.simulation.go(stop)
            self.step_seconds += perf_counter() - start

    def _look(self, sample: bool, frame: bool) -> None:
        s = self.simulation
        rows, entries = s.sample()
        if not all(map(math.isfinite, entries.values())):
            raise NumericsError(f"the numbers broke at {s.time:.6g} µs: an energy is not finite")
        self.worst_closure = max(self.worst_closure, entries["closure"])
        if sample:
            self.history.write(s.time, rows)
            self.ledger.write(s.time, entries)
        if frame:
            self._write_frame()

    def _write_frame(self) -> None:
        fields = self.simulation.sampler.fields()
        if self.frames is None:
            self.frames = Frames(self.directory, self.comm, {name: UNITS[name] for name in fields})
        self.frames.write(self.simulation.time, self._integrator.steps, fields)

    def _try_last_frame(self) -> None:
        """A picture of what broke, if it can be drawn at all."""
        with np.errstate(all="ignore"):
            self.simulation.time = self._integrator.ts.getTime()
            self.simulation.mechanics.rate()
            self._write_frame()

    # ------------------------------------------------------------ what is said

    def _say_header(self) -> None:
        m = self.manifest
        commit = f" ({m['commit']}, {m['tree']})" if "commit" in m else ""
        self.log(f"cellmig {__version__}{commit}  {self.comm.size} rank{'s' * (self.comm.size > 1)}  "
                 f"petsc {m['petsc']}  {self.case.path}")
        if self.case.title:
            self.log(self.case.title)

    def _say_scene(self) -> None:
        s, m = self.simulation, self.simulation.mechanics
        owned = self.comm.allgather(m.n_owned)
        ghosts = self.comm.allgather(len(m.numbering.ids) - m.n_owned)
        mechanism, stable = binding(s.control.stable())
        step = self._integrator.fixed_step
        self.log.table([
            ("particles", f"{s.scene.size} in {len(s.scene.kind)} cells, spacing "
                          f"{_range([t.spacing for t in s.scene.templates])} µm, owned {_range(owned)}, "
                          f"ghosts {_range(ghosts)} a rank"),
            *laws_said(self.case, s),
            ("skipped", "; ".join(f"{name}: {why}" for name, why in s.terms.skipped.items()) or "nothing"),
            ("stable step", f"{1e3 * stable:.3g} ns at rest, set by {mechanism}; taken "
                            + (f"{1e3 * step:.3g} ns, as the user says" if step
                               else f"{self.case.time.step_factor:g} of it, renewed as the mesh deforms")),
            ("integrator", self.case.time.integrator if self._integrator.leapfrog else self._integrator.ts.getType()),
            ("output", str(self.directory)),
        ])

    def _save_manifest(self) -> None:
        skipped = self.simulation.terms.skipped
        self.manifest |= {"skipped": skipped, "particles": self.simulation.scene.size}
        if self.comm.rank == 0:
            write_manifest(self.directory, self.manifest)

    def _finish(self, status: int, cause: str) -> None:
        s, run = self.simulation, self._integrator
        wall = perf_counter() - self.begin
        per_step = 1e9 * self.step_seconds / max(1, run.steps) / s.scene.size
        momentum, impulse = s.sampler.momentum(), s.mechanics.impulse()
        mechanism = max(run.count, key=run.count.get) if run.count else ""
        self.manifest |= {
            "exit_status": status, "cause": cause, "time_us": s.time, "steps": run.steps,
            "dt_us": {"least": run.extremes["dt_min"], "most": run.extremes["dt_max"]}, "dt_set_by": mechanism,
            "steps_by_mechanism": run.count, "J": [run.extremes["J_min"], run.extremes["J_max"]],
            "wall_seconds": wall, "ns_per_particle_step": per_step, "worst_closure": self.worst_closure,
            "momentum_pN_us_per_um": momentum, "protrusion_impulse_pN_us_per_um": impulse,
            "list_renewals": s.mechanics.rebuilds, "frames": self.frames.count if self.frames else 0,
            "state_hash": s.state_hash() if status != BROKEN else None, "sections_seconds": self.timers.seconds()}
        if self.comm.rank == 0:
            write_manifest(self.directory, self.manifest)
        summary = self.timers.summary(self.comm)
        if unused := unused_options():
            self.log("PETSc options that nothing used: " + ", ".join(unused))
        ended = {DONE: "done", BROKEN: "BROKEN", STOPPED: "stopped"}[status]
        self.log(f"{ended}: {s.time:.6g} µs in {run.steps} steps and {clock(wall)}, {per_step:.1f} ns per particle-step; "
                 f"J in [{run.extremes['J_min']:.4f}, {run.extremes['J_max']:.4f}]; ledger closes to "
                 f"{self.worst_closure:.1e}" + (f"; {cause}" if cause else ""))
        self.log(summary)


def laws_said(case: Case, simulation: Simulation) -> list[tuple[str, str]]:
    """The laws of a scene as rows for the log, with what is numerical in them."""
    rows = []
    for name, law in case.materials.items():
        if law not in simulation.scene.materials:
            continue
        viscosity = law.numerical_viscosity(max(t.spacing for t in simulation.scene.templates)) / 1e3
        said = f"{law.law}, stabilised with {viscosity:.3g} mPa s"
        said += f" and {law.numerical_modulus:.3g} Pa" if law.numerical_modulus else ""
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
    """Signals that ask for a clean end, as they come: SIGTERM, SIGUSR1, ^C."""
    asked: list[int] = []
    old = {s: signal.signal(s, lambda number, _: asked.append(number))
           for s in (signal.SIGTERM, signal.SIGUSR1, signal.SIGINT)}
    try:
        yield asked
    finally:
        for number, handler in old.items():
            signal.signal(number, handler)


def _range(values: list) -> str:
    low, high = min(values), max(values)
    text = "{:.4g}" if isinstance(low, float) else "{}"
    return text.format(low) if low == high else f"{text.format(low)}-{text.format(high)}"



