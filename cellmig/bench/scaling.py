"""`cellmig bench --scaling`: a model of the cost of a step on many ranks, its constants, its predictions.

The time of a step of a rank with m of N particles is, in nanoseconds,

    row(m) (m + extra) + surface(m)                     compute: own rows, and rows computed on two ranks
    + latency + byte x bytes x copies                   exchange of ghosts, once a step
    + [control m + hop log2 P] / CONTROL                step control: reductions of F and gaps
    + [near S_own + far S] / renew                      search lists: own and all surface particles

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

MANY = 20_000  # cells of a scene of which the memory of the case and the partition is measured
CONTROL = 200  # steps per step control
NETWORK = (2.0e3, 1.0)  # assumed between nodes: latency [ns], and [ns per byte] of a rank while all ranks send
RANKS = (1, 16, 64, 256, 1024, 10_000)  # of predictions
NODE = 64  # assumed: ranks of a node
MEMORY = 4e9  # assumed: memory of each rank [B]


@dataclasses.dataclass(frozen=True)
class Scenes:
    """Scenes of a dimension that are measured: a row of cells, in space a layer of balls.

    per_cell : particles;  whole : numbers of cells, each also on 2 and 4 ranks;  cut : particles of single bodies, also
    on 2 and 4;  large : cells that are larger than all caches;  held : cells on every rank, of which memory is
    measured;  renew : steps per renewal of search lists;  side : ghosts where two cells on two ranks touch, measured;
    roughness : surface particles over those of a smooth disc or ball [-].
    """

    dimension: int
    per_cell: int
    whole: tuple[int, ...]
    cut: tuple[int, ...]
    large: int
    held: int
    renew: int
    side: float
    roughness: float

    def scene(self, bodies: int, per_body: int) -> Scene:
        """So many cells, in space in a layer that is as square as can be."""
        rows = max(n for n in range(1, math.isqrt(bodies) + 1) if bodies % n == 0)
        return Scene(bodies, per_body, dimension=self.dimension, rows=1 if self.dimension == 2 else rows)

    @property
    def bytes(self) -> int:
        """Size of a ghost, its displacement and velocity [B]."""
        return 16 * self.dimension

    def surface(self, particles: float) -> float:
        """Particles on the surface of a cell of so many."""
        if self.dimension == 2:
            return self.roughness * 2.0 * math.sqrt(math.pi * particles)
        return self.roughness * (36.0 * math.pi) ** (1.0 / 3.0) * particles ** (2.0 / 3.0)

    def cuts(self, particles: float, parts: float) -> float:
        """Particles along the cuts of a part of a disc or ball, the fewer of slices and of squares or cubes."""
        share = (parts - 1.0) / parts
        if self.dimension == 2:
            return min(2.0 * share * 2.0 * math.sqrt(particles / math.pi), 4.0 * math.sqrt(particles / parts))
        middle = math.pi * (0.75 * particles / math.pi) ** (2.0 / 3.0)
        return min(2.0 * share * middle, 6.0 * (particles / parts) ** (2.0 / 3.0))


# Steps per renewal: of `cases/paper.toml`, and of `cases/three_balls.toml`.
PLANE = Scenes(2, 1500, (1, 3, 12, 67), (6000, 24_000), 335, 3, 555, 25.0, 1.0)
SPACE = Scenes(3, 1000, (1, 4, 16, 49), (4000, 12_000), 196, 4, 700, 80.0, 0.873)


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


def fitted(scenes: Scenes, probes: Sequence[dict[str, Any]], cell_bytes: float) -> Constants:
    """Constants by nonnegative least squares over probes on 1, 2 and 4 ranks; `cell_bytes` : of a cell of the scene.

    Compute is CPU time, which does not depend on whether ranks share a core; the others are wall times of probes whose
    ranks have a core each.
    """
    alone = sorted((p for p in probes if p["ranks"] == 1), key=lambda p: p["particles"])
    row = [median(p["ns"]["stress"]["cpu"]) + median(p["ns"]["divergence"]["cpu"]) for p in alone]
    on_surface = [sum(median(p["ns"][t]["cpu"]) for t in SURFACE if t in p["ns"]) * p["particles"]
                  / p["surface"] for p in alone]
    cut = [p for p in probes if p["bodies"] == 1 and p["ranks"] > 1]
    chord = [scenes.cuts(p["particles"], p["ranks"]) * p["ranks"] for p in cut]
    at_once = [p for p in probes if p["ranks"] <= len(os.sched_getaffinity(0))]
    sent = [p for p in at_once if p["ranks"] > 1]
    latency, byte = _least_squares([[1.0, scenes.bytes * max(p["ghosts"])] for p in sent],
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


def bytes_of_a_cell(scenes: Scenes) -> float:
    """Memory that a cell of the scene takes on each rank [B]: of the case, the scene and its partition."""
    before = memory_sizes("/proc/self/status")["VmRSS"]
    case = scenes.scene(MANY, 100).case()
    kept = case, find_terms(case), partition(discretise(case), NODE)
    after = memory_sizes("/proc/self/status")["VmRSS"]
    return (after - before) / len(kept[0].cells)


def predicted(scenes: Scenes, c: Constants, particles: float, ranks: float,
              network: tuple[float, float] | None = None) -> dict[str, float]:
    """Time of a step by part [ns], and memory of a rank [B].

    network : latency [ns] and [ns per byte], by default those of this machine within a node, else NETWORK.
    """
    per_cell = scenes.per_cell
    own, whole = particles / ranks, particles / ranks >= per_cell
    cut = 0.0 if whole or ranks == 1 else scenes.cuts(per_cell, per_cell / own)
    copies = c.copies * cut + (scenes.side * 4.0 * math.sqrt(own / per_cell) if whole and ranks > 1 else 0.0)
    surface, surface_own = (n / per_cell * scenes.surface(per_cell) for n in (particles, own))
    row = float(np.interp(math.log(own), np.log(c.size), c.row))
    latency, byte = network or ((c.latency, c.byte) if ranks <= NODE else NETWORK)
    parts = {"compute": row * (own + c.extra * cut) + c.surface * surface_own,
             "exchange": (latency + byte * scenes.bytes * copies) if ranks > 1 else 0.0,
             "control": (c.control * own + max(c.hop, latency) * math.log2(ranks)) / CONTROL,
             "lists": (c.near * surface_own + c.far * surface) / scenes.renew}
    return {**parts, "step": sum(parts.values()),
            "bytes": c.own_bytes * own + c.cell_bytes * particles / per_cell + c.base_bytes}


def bench_scaling(out: Path, dimension: int) -> int:
    """Measure, fit, compare with the measured steps, predict; writes scaling.json and scaling.md.

    Parameters
    ----------
    out : Path -- directory of the results.  dimension : int -- 2 or 3.

    Returns
    -------
    int -- exit code 0.
    """
    probes, s = [], PLANE if dimension == 2 else SPACE
    whole, cut = [s.scene(n, s.per_cell) for n in s.whole], [s.scene(1, n) for n in s.cut]
    for scene, on in [*((one, (1, 2, 4)) for one in whole + cut), (s.scene(s.large, s.per_cell), (1, 2))]:
        for ranks in on:
            print(f"{scene.bodies} x {scene.per_body} particles on {ranks} rank{'s' * (ranks > 1)}", flush=True)
            probes.append(measured(scene, ranks))
    c = fitted(s, [p for p in probes if p["bodies"] > 1 or p["per_body"] == s.per_cell or p["ranks"] > 1],
               bytes_of_a_cell(s))
    weak = [measured(s.scene(s.held * ranks, s.per_cell), ranks, repeats=1) for ranks in (1, 2, 4, 8)]
    write_report(out / "scaling", "What steps cost on many ranks, by a model",
                 "cellmig bench --scaling" + " --dimension 3" * (dimension == 3),
                 {"constants": dataclasses.asdict(c), "probes": probes, "weak": weak}, report(s, c, probes, weak))
    return DONE


def report(s: Scenes, c: Constants, probes: Sequence[dict[str, Any]], weak: Sequence[dict[str, Any]]) -> list[str]:
    """Constants, measured against fitted steps, memory of ranks, and predictions, in Markdown."""
    rows = ", ".join(f"{ns:.1f} with {size:.0f}" for size, ns in zip(c.size, c.row, strict=True))
    lines = [f"{processor()}", "", f"- a row: {rows} particles on a rank [ns]; a surface particle {c.surface:.2g} ns",
             f"- along a cut: {c.extra:.2g} rows computed twice and {c.copies:.2g} copies for each particle of it",
             f"- messages here: {1e-3 * c.latency:.2g} µs and {c.byte:.2g} ns a byte; assumed between nodes: "
             f"{1e-3 * NETWORK[0]:.2g} µs and {NETWORK[1]:.2g} ns a byte and rank, {NODE} ranks a node",
             f"- step control: {c.control:.2g} ns a particle and {1e-3 * c.hop:.2g} µs a doubling of ranks, every "
             f"{CONTROL} steps",
             f"- search lists: {c.near:.0f} ns an own surface particle and {c.far:.2g} ns one of the scene, every "
             f"{s.renew} steps",
             f"- memory of a rank: {c.own_bytes:.0f} B a particle of its own, {c.cell_bytes:.0f} B a cell of the "
             f"scene, {1e-6 * c.base_bytes:.0f} MB", ""]
    cores = len(os.sched_getaffinity(0))
    lines += table(["particles", "bodies", "ranks", "step, measured [µs]", "by the model", "ratio"],
                   [_compared(s, c, p) for p in probes if p["ranks"] <= cores and p["per_body"] == s.per_cell])
    lines += ["", f"Memory of ranks with {s.held * s.per_cell:,} particles each [MB]:", "",
              *table(["particles", "ranks", "rank 0", "least of the others", "most of the others"],
                     [_held(p) for p in weak])]
    head = ["particles", "ranks", "step [µs]", "ns a particle and rank", "efficiency", "exchange", "control", "lists",
            "memory of a rank"]
    strong = [(n, p, predicted(s, c, n, 1)["step"] / p)
              for n in (1e5, 1e6, 1e7, 1e9) for p in RANKS if 90 <= n / p <= 2e6]
    weak = [(1e5 * p, p, predicted(s, c, 1e5, 1)["step"]) for p in RANKS]
    for title, cases in ((f"Strong scaling, cells of {s.per_cell:,}", strong),
                         ("Weak scaling, 100,000 particles a rank", weak)):
        lines += ["", f"{title}:", "", *table(head, [_prediction(s, c, *one) for one in cases])]
    return lines


def _held(p: dict[str, Any]) -> list[str]:
    first, *others = (f"{1e-6 * size:.1f}" for size in p["peak_of"])
    return [str(p["particles"]), str(p["ranks"]), first, min(others, default=""), max(others, default="")]


def _compared(s: Scenes, c: Constants, p: dict[str, Any]) -> list[str]:
    step = 1e-3 * median(p["ns"]["step"]["wall"]) * p["particles"]
    near = 1e3 * median(p["us"]["exchange"]) if p["ranks"] > 1 else 0.0
    parts = predicted(s, c, p["particles"], p["ranks"], (near, 0.0))
    model = 1e-3 * (parts["compute"] + parts["exchange"])  # probes have neither step control nor search lists
    return [str(p["particles"]), str(p["bodies"]), str(p["ranks"]), f"{step:.0f}", f"{model:.0f}",
            f"{model / step:.2f}"]


def _prediction(s: Scenes, c: Constants, particles: float, ranks: float, ideal: float) -> list[str]:
    """A line of the tables; `ideal` : time of the step at perfect efficiency [ns]."""
    many = predicted(s, c, particles, ranks)
    share = [f"{100.0 * many[part] / many['step']:.2g} %" for part in ("exchange", "control", "lists")]
    fits = "" if many["bytes"] < MEMORY else " (more than there is)"
    return [f"{particles:.0e}", str(ranks), f"{1e-3 * many['step']:.4g}",
            f"{many['step'] * ranks / particles:.1f}", f"{ideal / many['step']:.2f}", *share,
            f"{1e-9 * many['bytes']:.2g} GB{fits}"]
