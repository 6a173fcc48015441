"""Before a run: what it will cost, what it resolves, what it skips."""

from __future__ import annotations

import dataclasses
import math
from time import perf_counter

import numpy as np
from mpi4py import MPI

from cellmig.case.schema import Case
from cellmig.output.log import clock, two_columns
from cellmig.output.sample import UNITS
from cellmig.simulation import Simulation, discretise, find_terms, particle_count, step_control
from cellmig.solve.step import binding

PROBE = 20_000  # particles of the scene, at most, on which a step is timed
SETUP_BYTES = 700  # per particle, beside what is counted: templates, numbering (measured on 1e4 to 1e5 particles)


def report(case: Case) -> str:
    """The pre-flight report of a case: stable step by mechanism, steps, minutes, memory, disk, what is resolved."""
    size = sum(particle_count(case, c.shape) for c in case.cells)
    cells = case.cells[: max(1, PROBE * len(case.cells) // max(size, 1))]
    part = dataclasses.replace(case, cells=cells)
    scene, terms = discretise(part), find_terms(case)
    steps = step_control(case, scene, terms).stable()
    mechanism, stable = binding(steps)
    step = case.time.step if case.time.step != "auto" else case.time.step_factor * stable
    count = math.ceil(case.time.end / step)
    seconds, row_bytes = _timed(part)
    wall = count * size * seconds
    spacing = max(t.spacing for t in scene.templates)
    return two_columns([
        (case.path, case.title or "valid"),
        ("particles", f"{size} in {len(case.cells)} cells, spacing {spacing:.3g} µm, "
                      f"support {case.particles.dilation:g} spacings"),
        ("stable step", "  ".join(f"{name} {1e3 * dt:.3g} ns" for name, dt in steps.items()) + " (at rest)"),
        ("step", f"{1e3 * step:.3g} ns, " + (f"{case.time.step_factor:g} of the one by {mechanism}; it shrinks as "
                                            "particles are squeezed" if case.time.step == "auto" else
                                            f"as the case says: {step / stable:.3g} of the stable one")),
        ("steps", f"{count} to {case.time.end:g} µs"),
        ("time", f"{clock(wall)} on one core, {clock(wall / 2)} on two if they share well "
                 f"({1e9 * seconds:.0f} ns per particle-step, timed now)"),
        ("memory", f"{_bytes(size * (row_bytes + SETUP_BYTES))} in all"),
        ("disk", f"{_bytes((case.time.frames + 1) * size * _frame_bytes(case))} in {case.time.frames + 1} frames"),
        *_modulus(case), *_resolved(case, spacing),
        ("skipped", "; ".join(f"{name}: {why}" for name, why in terms.skipped.items()) or "nothing"),
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
