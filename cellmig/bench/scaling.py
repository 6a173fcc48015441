"""`cellmig bench --scaling`: a model of the cost of a step on many ranks, its constants, its predictions.

The time of a step of a rank with m of N particles is, in nanoseconds,

    row(m) (m + extra) + surface(m)                     compute: own rows, and rows computed on two ranks
    + latency + byte x 32 copies                        exchange of ghosts, once a step
    + [control m + hop log2 P] / CONTROL                step control: reductions of F and gaps
    + [near S_own + far S] / RENEW                      search lists: own and all surface particles

Cells stay whole while a rank has one or more; smaller parts have common rows and ghosts along their cuts.  The model
is for many cells that share coefficients, not for few large bodies, whose coefficients stream from memory.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from cellmig.exits import DONE
from cellmig.meshfree.terms import find_terms
from cellmig.output.log import table
from cellmig.output.manifest import memory_sizes, processor
from cellmig.parallel.partition import partition
from cellmig.solve.start import discretise

from .speed import measured, write_report
from .timing import SURFACE, Scene

PER_CELL = 1500
ROWS = tuple(Scene(cells, PER_CELL) for cells in (1, 3, 12, 67))  # whole cells, each also on 2 and 4 ranks
CUT = (Scene(1, 6000), Scene(1, 24_000))
LARGE = Scene(335, PER_CELL)  # larger than all caches
WEAK = tuple((Scene(3 * ranks, 1485), ranks) for ranks in (1, 2, 4, 8))  # as many particles on each rank
MANY = 20_000  # cells of a scene of which the memory of the case and the partition is measured
CONTROL, RENEW = 200, 555  # steps per step control and per renewal of search lists, in the paper's main scene
BYTES = 32  # of a ghost
NETWORK = (2.0e3, 1.0)  # assumed between nodes: latency [ns], and [ns per byte] of a rank while all ranks send
RANKS = (1, 16, 64, 256, 1024, 10_000)  # of predictions
NODE = 64  # assumed: ranks of a node
MEMORY = 4e9  # assumed: memory of each rank [B]
SIDE = 25.0  # ghosts where two cells of 1,500 particles touch, measured for cells in a row


@dataclasses.dataclass(frozen=True)
class Constants:
    """Measured constants: `row` [ns] by `size` [particles of a rank]; `extra`, `copies` per particle along a cut.

    surface [ns per own surface particle];  latency [ns], byte [ns per byte] of messages on this machine;  control [ns
    per own particle], hop [ns per doubling of ranks];  near, far [ns per own surface particle, per surface particle of
    the scene];  own_bytes, cell_bytes, base_bytes : memory of a rank per own particle, per cell of the scene, and
    fixed.
    """

    size: tuple[float, ...]
    row: tuple[float, ...]
    surface: float
    extra: float
    copies: float
    latency: float
    byte: float
    control: float
    hop: float
    near: float
    far: float
    own_bytes: float
    cell_bytes: float
    base_bytes: float


def fitted(probes: Sequence[dict[str, Any]], cell_bytes: float) -> Constants:
    """Constants by nonnegative least squares over probes on 1, 2 and 4 ranks; `cell_bytes` : of a cell of the scene.

    Compute is CPU time, which does not depend on whether ranks share a core; the others are wall times of probes whose
    ranks have a core each.
    """
    alone = sorted((p for p in probes if p["ranks"] == 1), key=lambda p: p["particles"])
    row = [median(p["ns"]["stress"]["cpu"]) + median(p["ns"]["divergence"]["cpu"]) for p in alone]
    on_surface = [sum(median(p["ns"][t]["cpu"]) for t in SURFACE if t in p["ns"]) * p["particles"]
                  / p["surface"] for p in alone]
    cut = [p for p in probes if p["bodies"] == 1 and p["ranks"] > 1]
    chord = [_cuts(p["particles"], p["ranks"]) * p["ranks"] for p in cut]
    at_once = [p for p in probes if p["ranks"] <= len(os.sched_getaffinity(0))]
    sent = [p for p in at_once if p["ranks"] > 1]
    latency, byte = _least_squares([[1.0, BYTES * max(p["ghosts"])] for p in sent],
                                   [1e3 * median(p["us"]["messages"]) for p in sent])
    control, hop = _least_squares([[max(p["owned"]), math.log2(p["ranks"])] for p in at_once],
                               [1e3 * median(p["us"]["control"]) for p in at_once])
    _, near, far = _least_squares([[1.0, p["surface"] / p["ranks"], p["surface"]] for p in at_once],
                                  [1e3 * median(p["us"]["lists"]) for p in at_once])
    whole = [p for p in probes if p["bodies"] >= p["ranks"]]
    memory = _least_squares([[p["particles"] / p["ranks"], 1.0] for p in whole],
                            [max(p["peak_of"]) - cell_bytes * p["bodies"] for p in whole])
    return Constants(tuple(float(p["particles"]) for p in alone), tuple(row), median(on_surface),
                     sum(sum(p["rows"]) - p["particles"] for p in cut) / sum(chord),
                     sum(sum(p["ghosts"]) for p in cut) / sum(chord), latency, byte, control, hop, near, far,
                     memory[0], cell_bytes, memory[1])


def _least_squares(rows: Sequence[Sequence[float]], values: Sequence[float]) -> list[float]:
    """Nonnegative factors of columns that minimise relative errors."""
    from scipy.optimize import nnls

    a, b = np.array(rows, float), np.array(values, float)
    return [float(x) for x in nnls(a / b[:, None], np.ones(len(b)))[0]]


def bytes_of_a_cell() -> float:
    """Memory that a cell of the scene takes on each rank [B]: of the case, the scene and its partition."""
    before = memory_sizes("/proc/self/status")["VmRSS"]
    case = Scene(MANY, 100).case()
    kept = case, find_terms(case), partition(discretise(case), NODE)
    after = memory_sizes("/proc/self/status")["VmRSS"]
    return (after - before) / len(kept[0].cells)


def _cuts(particles: float, parts: float) -> float:
    """Particles along the cuts of a part of a disc: the smaller number of slices and of squares."""
    across = 2.0 * math.sqrt(particles / math.pi)
    return min(2.0 * (parts - 1.0) / parts * across, 4.0 * math.sqrt(particles / parts))


def predicted(c: Constants, particles: float, ranks: float, per_cell: float = PER_CELL,
              network: tuple[float, float] | None = None) -> dict[str, float]:
    """Time of a step by part [ns], and memory of a rank [B].

    network : latency [ns] and [ns per byte], by default those of this machine within a node, else NETWORK.
    """
    own, whole = particles / ranks, particles / ranks >= per_cell
    cut = 0.0 if whole or ranks == 1 else _cuts(per_cell, per_cell / own)
    copies = c.copies * cut + (SIDE * 4.0 * math.sqrt(own / per_cell) if whole and ranks > 1 else 0.0)
    ring = 4.0 * math.sqrt(per_cell) * 0.89  # surface particles of a disc of so many: 2 sqrt(pi n)
    surface, surface_own = particles / per_cell * ring, own / per_cell * ring
    row = float(np.interp(math.log(own), np.log(c.size), c.row))
    latency, byte = network or ((c.latency, c.byte) if ranks <= NODE else NETWORK)
    parts = {"compute": row * (own + c.extra * cut) + c.surface * surface_own,
             "exchange": (latency + byte * BYTES * copies) if ranks > 1 else 0.0,
             "control": (c.control * own + max(c.hop, latency) * math.log2(ranks)) / CONTROL,
             "lists": (c.near * surface_own + c.far * surface) / RENEW}
    return {**parts, "step": sum(parts.values()),
            "bytes": c.own_bytes * own + c.cell_bytes * particles / per_cell + c.base_bytes}


def bench_scaling(out: Path) -> int:
    """Measure, fit, compare with the measured steps, predict; writes scaling.json and scaling.md.

    Parameters
    ----------
    out : Path -- directory of the results.

    Returns
    -------
    int -- exit code 0.
    """
    probes = []
    for scene, on in [*((s, (1, 2, 4)) for s in ROWS), *((s, (1, 2, 4)) for s in CUT), (LARGE, (1, 2))]:
        for ranks in on:
            print(f"{scene.bodies} x {scene.per_body} particles on {ranks} rank{'s' * (ranks > 1)}", flush=True)
            probes.append(measured(scene, ranks))
    c = fitted([p for p in probes if p["bodies"] > 1 or p["per_body"] == PER_CELL or p["ranks"] > 1], bytes_of_a_cell())
    weak = [measured(scene, ranks, repeats=1) for scene, ranks in WEAK]
    write_report(out / "scaling", "What steps cost on many ranks, by a model", "cellmig bench --scaling",
         {"constants": dataclasses.asdict(c), "probes": probes, "weak": weak}, report(c, probes, weak))
    return DONE


def report(c: Constants, probes: Sequence[dict[str, Any]], weak: Sequence[dict[str, Any]]) -> list[str]:
    """Constants, measured against fitted steps, memory of ranks, and predictions, in Markdown."""
    rows = ", ".join(f"{ns:.1f} with {size:.0f}" for size, ns in zip(c.size, c.row, strict=True))
    lines = [f"{processor()}", "", f"- a row: {rows} particles on a rank [ns]; a surface particle {c.surface:.2g} ns",
             f"- along a cut: {c.extra:.2g} rows computed twice and {c.copies:.2g} copies for each particle of it",
             f"- messages here: {1e-3 * c.latency:.2g} µs and {c.byte:.2g} ns a byte; assumed between nodes: "
             f"{1e-3 * NETWORK[0]:.2g} µs and {NETWORK[1]:.2g} ns a byte and rank, {NODE} ranks a node",
             f"- step control: {c.control:.2g} ns a particle and {1e-3 * c.hop:.2g} µs a doubling of ranks, every "
             f"{CONTROL} steps",
             f"- search lists: {c.near:.0f} ns an own surface particle and {c.far:.2g} ns one of the scene, every "
             f"{RENEW} steps",
             f"- memory of a rank: {c.own_bytes:.0f} B a particle of its own, {c.cell_bytes:.0f} B a cell of the "
             f"scene, {1e-6 * c.base_bytes:.0f} MB", ""]
    cores = len(os.sched_getaffinity(0))
    lines += table(["particles", "bodies", "ranks", "step, measured [µs]", "by the model", "ratio"],
                   [_compared(c, p) for p in probes if p["ranks"] <= cores and p["per_body"] == PER_CELL])
    lines += ["", "Memory of ranks with 4,455 particles each [MB]:", "",
              *table(["particles", "ranks", "rank 0", "least of the others", "most of the others"],
                     [_held(p) for p in weak])]
    head = ["particles", "ranks", "step [µs]", "ns a particle and rank", "efficiency", "exchange", "control", "lists",
            "memory of a rank"]
    strong = [(n, p, predicted(c, n, 1)["step"] / p) for n in (1e5, 1e6, 1e7, 1e9) for p in RANKS if 90 <= n / p <= 2e6]
    weak = [(1e5 * p, p, predicted(c, 1e5, 1)["step"]) for p in RANKS]
    for title, cases in (("Strong scaling, cells of 1,500", strong), ("Weak scaling, 100,000 particles a rank", weak)):
        lines += ["", f"{title}:", "", *table(head, [_prediction(c, *one) for one in cases])]
    return lines


def _held(p: dict[str, Any]) -> list[str]:
    first, *others = (f"{1e-6 * size:.1f}" for size in p["peak_of"])
    return [str(p["particles"]), str(p["ranks"]), first, min(others, default=""), max(others, default="")]


def _compared(c: Constants, p: dict[str, Any]) -> list[str]:
    step = 1e-3 * median(p["ns"]["step"]["wall"]) * p["particles"]
    near = 1e3 * median(p["us"]["exchange"]) if p["ranks"] > 1 else 0.0
    parts = predicted(c, p["particles"], p["ranks"], p["per_body"], (near, 0.0))
    model = 1e-3 * (parts["compute"] + parts["exchange"])  # probes have neither step control nor search lists
    return [str(p["particles"]), str(p["bodies"]), str(p["ranks"]), f"{step:.0f}", f"{model:.0f}",
            f"{model / step:.2f}"]


def _prediction(c: Constants, particles: float, ranks: float, ideal: float) -> list[str]:
    """A line of the tables; `ideal` : time of the step at perfect efficiency [ns]."""
    many = predicted(c, particles, ranks)
    share = [f"{100.0 * many[part] / many['step']:.2g} %" for part in ("exchange", "control", "lists")]
    fits = "" if many["bytes"] < MEMORY else " (more than there is)"
    return [f"{particles:.0e}", str(ranks), f"{1e-3 * many['step']:.4g}",
            f"{many['step'] * ranks / particles:.1f}", f"{ideal / many['step']:.2f}", *share,
            f"{1e-9 * many['bytes']:.2g} GB{fits}"]
