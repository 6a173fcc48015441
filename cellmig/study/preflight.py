"""Before a run: what it will cost, what it resolves, what it skips."""

from __future__ import annotations

import dataclasses
import math
from time import perf_counter
from typing import NamedTuple

import numpy as np

from mpi4py import MPI

from cellmig.case.schema import Case
from cellmig.output.log import clock, two_columns
from cellmig.output.sample import UNITS
from cellmig.simulation import Simulation, discretise, find_terms, particle_count, step_control
from cellmig.solve.step import binding

PROBE = 20_000  # particles of the scene, at most, on which a step is timed
SETUP_BYTES = 700  # per particle, beside what is counted: templates, numbering (measured on 1e4 to 1e5 particles)


class Cost(NamedTuple):
    """What a run takes.

    particles, steps : int;  spacing : float -- the largest [um];  stable : dict -- stable step at rest by mechanism,
    step : float -- the one taken at rest [us];  per_step : float -- seconds per particle-step on this core;
    row_bytes : float -- of the kernel's arrays per particle;  skipped : dict -- terms that are, and why.
    """

    particles: int
    spacing: float
    stable: dict[str, float]
    step: float
    steps: int
    per_step: float
    row_bytes: float
    skipped: dict[str, str]

    @property
    def seconds(self) -> float:
        """On one core, without output, if the step stays as it is at rest."""
        return self.steps * self.particles * self.per_step


def cost(case: Case) -> Cost:
    """What a case takes; timed now, on some cells of it if it is large."""
    size = sum(particle_count(case, c.shape) for c in case.cells)
    part = dataclasses.replace(case, cells=case.cells[: max(1, PROBE * len(case.cells) // max(size, 1))])
    scene, terms = discretise(part), find_terms(case)
    stable = step_control(case, scene, terms).stable()
    step = case.time.step if case.time.step != "auto" else case.time.step_factor * binding(stable)[1]
    per_step, row_bytes = _timed(part)
    return Cost(size, max(t.spacing for t in scene.templates), stable, step, math.ceil(case.time.end / step), per_step,
                row_bytes, terms.skipped)


def report(case: Case) -> str:
    """The pre-flight report of a case: stable step by mechanism, steps, minutes, memory, disk, what is resolved."""
    c = cost(case)
    mechanism, stable = binding(c.stable)
    return two_columns([
        (case.path, case.title or "valid"),
        ("particles", f"{c.particles} in {len(case.cells)} cells, spacing {c.spacing:.3g} µm, "
                      f"support {case.particles.dilation:g} spacings"),
        ("stable step", "  ".join(f"{name} {1e3 * dt:.3g} ns" for name, dt in c.stable.items()) + " (at rest)"),
        ("step", f"{1e3 * c.step:.3g} ns, " + (f"{case.time.step_factor:g} of the one by {mechanism}; it shrinks as "
                                              "particles are squeezed" if case.time.step == "auto" else
                                              f"as the case says: {c.step / stable:.3g} of the stable one")),
        ("steps", f"{c.steps} to {case.time.end:g} µs"),
        ("time", f"{clock(c.seconds)} on one core, {clock(c.seconds / 2)} on two if they share well "
                 f"({1e9 * c.per_step:.0f} ns per particle-step, timed now)"),
        ("memory", f"{_bytes(c.particles * (c.row_bytes + SETUP_BYTES))} in all"),
        ("disk", f"{_bytes((case.time.frames + 1) * c.particles * _frame_bytes(case))} "
                 f"in {case.time.frames + 1} frames"),
        *_modulus(case), *_resolved(case, c.spacing),
        ("skipped", "; ".join(f"{name}: {why}" for name, why in c.skipped.items()) or "nothing"),
    ])


def _timed(case: Case) -> tuple[float, float]:
    """Seconds per particle-step on this core, and bytes per particle of the kernel's arrays."""
    s = Simulation(case, MPI.COMM_SELF)
    m, dt = s.mechanics, 1e-3 * binding(s.control.stable())[1]
    n = max(5, round(2e6 / s.scene.size))
    m.advance(3, dt)
    spent = min(_seconds(m, n, dt) for _ in range(3))
    held = sum(a.nbytes for a in m.kernel._arrays.values())
    result = spent / (n * s.scene.size), held / s.scene.size
    s.destroy()
    return result


def _seconds(mechanics, n: int, dt: float) -> float:
    start = perf_counter()
    mechanics.advance(n, dt)
    return perf_counter() - start


def _modulus(case: Case) -> list[tuple[str, str]]:
    return [(name, f"bulk modulus reduced from {m.bulk_modulus / 1e6:g} to {m.reduced_bulk_modulus / 1e6:g} MPa")
            for name, m in case.materials.items()
            if hasattr(m, "reduced_bulk_modulus") and m.reduced_bulk_modulus < m.bulk_modulus]


def _resolved(case: Case, spacing: float) -> list[tuple[str, str]]:
    """How the lengths of the model compare with the spacing."""
    rows = []
    for name, law in (("substrate", case.substrate), ("between cells", case.contact)):
        if law is not None:
            rows.append((name, f"range {1e3 * law.range:g} nm is {law.range / spacing:.2g} of the spacing: integrated "
                               "along the surface segments, not sampled at particles"))
    if case.protrusion is not None and case.protrusion.cells:
        rows.append(("protrusion", f"height {case.protrusion.height:g} µm is {case.protrusion.height / spacing:.2g} "
                                   "spacings"))
    return rows


def _frame_bytes(case: Case) -> int:
    """Bytes of a particle in a frame."""
    wide = {"stress": 72, "X": 24, "u": 24, "v": 24, "director": 24}
    absent = {"director"} if case.director is None else set()
    absent |= {"adhesion_force"} if case.substrate is None else set()
    absent |= {"contact_force"} if case.contact is None or len(case.cells) == 1 else set()
    absent |= {"protrusion_force"} if case.protrusion is None or not case.protrusion.cells else set()
    fields = set(UNITS) - absent
    return 28 + int(np.sum([wide.get(f, 24 if f.endswith("force") else 8) for f in fields]))


def _bytes(n: float) -> str:
    for unit in ("B", "kB", "MB", "GB"):
        if n < 1000:
            return f"{n:.3g} {unit}"
        n /= 1000
    return f"{n:.3g} TB"
