"""Robustness: each random scene must run stably, stop with a clear message, or be refused."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mpi4py import MPI

from cellmig.case.schema import Case, particle_count
from cellmig.exits import DIFFERENT, DONE, FAILED, INVALID_INPUT, STOPPED
from cellmig.geometry import polygons
from cellmig.geometry.surfaces import ClosedSurface
from cellmig.laws import register
from cellmig.meshfree.overlap import SHARE
from cellmig.meshfree.terms import size_of
from cellmig.output.directory import Claim, replace
from cellmig.output.manifest import read_manifest
from cellmig.output.tables import read_table
from cellmig.output.xdmf import frames
from cellmig.runs.batch import Job, JobResult, ProgressCounter, run_all
from cellmig.runs.outcome import outline
from cellmig.runs.run import ENERGY_ERROR
from cellmig.runs.stops import stop_requests
from cellmig.solve.start import discretise

from . import random_cases, random_hours
from .random_cases import toml

VOLUME = 0.1  # largest |J - 1| of a particle besides the softness of the case
SOFT = 0.4  # largest allowance for softness: J from 0.5 to 1.5
SWING = 2.0  # loads act at once: a body swings to twice the strain at which it comes to rest
DEPTH = 0.02  # largest depth of a cell within another, over its size
# Largest relative change of a cell's area, in space volume, beyond that by J, over the largest |J - 1|: 1 to 5 %, in
# space 4 to 20 %.  It is of the first order in the spacing where sharp edges become round: 138, 500, 1,500 particles of
# a cap under tension have 2.2, 1.0, 0.7 %.
AREA = {2: 0.1, 3: 0.4}
STEPS, LIMIT = {False: 3000, True: 500}, {False: 240.0, True: 900.0}  # of a run, of an overdamped one: steps, time [s]
# A clear message names time, cause, particle and remedy, or the cell that has left the box of a field.
CLEAN = re.compile(r"failed at [\d.e+-]+ (µs|ms|s|min|h): "
                   r"(.+; particle \d+ of cell \d+ has .+; .*(try|take) |cell \d+, .+ has left its box .+; make )")


@dataclass(frozen=True)
class Verdict:
    """How a scene ended: "stable", "stopped" or "refused" with a clear message, or else "bad".

    why : the message, or what is wrong;  command : reproduces the run;  numbers : what was measured.
    """

    name: str
    ended: str
    code: int
    why: str
    command: str
    numbers: dict[str, float]


def stress(out: Path, count: int, seed: int, at_once: int | None = None, sets: Sequence[str] = (),
           dimension: int = 2, overdamped: bool = False) -> int:
    """Draw `count` scenes, run each for a limited time and judge; returns the exit code, DIFFERENT if any is bad.

    sets : "KEY=VALUE", changes to all scenes;  at_once : runs at a time, by default one for each core;
    overdamped : whether they are scenes of motion without inertia.
    """
    register()
    jobs = [prepare(out, seed, number, tuple(sets), dimension, overdamped) for number in range(count)]
    verdicts, progress = [], ProgressCounter(count)
    with Claim(out, MPI.COMM_SELF, make=True), stop_requests() as stop_signals:
        for ended in run_all(jobs, at_once or len(os.sched_getaffinity(0)), stop_signals, LIMIT[overdamped]):
            verdicts.append(judge(ended, *measure(ended)))
            progress(JobResult(ended.job, 0))
    progress.close()
    if stop_signals:
        return STOPPED
    verdicts.sort(key=lambda v: v.name)
    results = {"seed": seed, "dimension": dimension, "overdamped": overdamped, "sets": [*sets],
               "scenes": [asdict(v) for v in verdicts]}
    replace(out / "stress.json", json.dumps(results, indent=1, ensure_ascii=False))
    print("\n".join([*table(verdicts), str(out / "stress.json")]))
    return DIFFERENT if any(v.ended == "bad" for v in verdicts) else DONE


def prepare(out: Path, seed: int, number: int, sets: tuple[str, ...] = (), dimension: int = 2,
            overdamped: bool = False) -> Job:
    """Write the case file of a scene."""
    draw = random_hours if overdamped else random_cases
    folder = out / f"seed{seed}-scene{number:03}"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "case.toml").write_text(toml(draw.scene(seed, number, dimension)) + "\n", encoding="utf-8")
    ranks, options = draw.launch(seed, number, dimension)
    return Job(folder.name, folder / "case.toml", sets, folder / "run",
               ("-ts_max_steps", str(STEPS[overdamped]), *options), ranks)


# -------------------------------------------------------------------------------------------------------- judgement


def measure(ended: JobResult) -> tuple[dict[str, float], list[np.ndarray]]:
    """Numbers of a complete run, and in the plane the outlines of its cells (n, 2) [um] in the last frame."""
    if ended.code:
        return {}, []
    directory = ended.job.directory
    manifest, history = read_manifest(directory), read_table(directory / "history.csv")
    case, last = ended.job.load(), frames(directory)[-1]
    fields = last.read()
    outlines = [outline(fields, cell)[:-1] for cell in np.unique(fields["cell"])] if case.dimension == 2 else []
    deep = _deepest(last.triangles(), fields) if case.dimension == 3 else 0.0
    return {"dimension": case.dimension, "energy_error": manifest["worst_energy_error"], "J_min": manifest["J"][0],
            "J_max": manifest["J"][1], "area": area_error(case, history, fields), "softness": softness(case),
            "depth": deep, "steps": manifest["steps"], "seconds": manifest["wall_seconds"],
            "share": manifest["time_us"] / case.time.end}, outlines


def area_error(case: Case, history: dict[str, np.ndarray], fields: dict[str, np.ndarray]) -> float:
    """Largest relative change of a cell's area, in space volume, beyond that of its particles' volumes [-]."""
    column = "area_um2" if case.dimension == 2 else "volume_um3"
    area = np.array([history[column][history["cell"] == c][[0, -1]] for c in np.unique(fields["cell"])])
    V, cell = discretise(case).field("V")[fields["id"]], fields["cell"] - 1
    ratio = np.bincount(cell, V * fields["J"]) / np.bincount(cell, V)
    change, compressed = area[:, 1] / area[:, 0] - 1.0, ratio - 1.0
    return float(np.maximum(change - np.maximum(compressed, 0.0), np.minimum(compressed, 0.0) - change).max())


def _deepest(triangles: np.ndarray, fields: dict[str, np.ndarray]) -> float:
    """Largest depth of a surface particle of a cell within another, over the cube root of the volume of that [-];
    triangles (m, 3) int of the surfaces.
    """
    x, cell, found = fields["X"] + fields["u"], fields["cell"], 0.0
    for c in np.unique(cell):
        surface = ClosedSurface(x, own := triangles[cell[triangles[:, 0]] == c], np.zeros(len(own), int))
        others = np.unique(triangles[cell[triangles[:, 0]] != c])
        if len(others):
            found = max(found, -float(surface.distance(x[others]).min()) / np.cbrt(surface.volume))
    return found


def softness(case: Case) -> float:
    """Largest load of a case over the smallest bulk modulus, an estimate of the largest |J - 1| [-]."""
    used = [case.materials[name] for cell in case.cells for name in (cell.material, cell.nucleus) if name]
    d = case.dimension
    spacing = min(size_of(cell.shape) / particle_count(case, cell.shape) ** (1 / d) for cell in case.cells)
    adhesion = (case.substrate, case.contact, *(pair.law for pair in case.pairs))
    loads = [law.work / law.equilibrium_distance for law in adhesion if law is not None]
    floor, push, turned = case.substrate, case.protrusion, case.director
    if floor is not None and any(c.centre[-1] + c.shape.lowest() < floor.cap for c in case.cells):  # pressed at first
        loads.append(floor.bond_density * (floor.cap_curvature * floor.cap - floor.cap_slope))
    if floor is not None and push is not None:
        loads.append(push.protrusion_ratio * floor.work / push.height)
    if case.cortex is not None:
        loads.append((d - 1) * case.cortex.line_tension / spacing)  # at a corner
    if turned is not None and not turned.uniform:
        loads += [law.eta / spacing**2 for law in used if hasattr(law, "eta")]  # in the core of a defect
    if case.body_force is not None:
        tall = max(float(np.ptp(cell.shape.outline(64), axis=0).max()) for cell in case.cells)
        loads.append(max(law.density for law in used) * float(np.linalg.norm(case.body_force)) * tall)
    loads += [abs(law.zeta) for law in used if hasattr(law, "zeta")]
    return max([*loads, 0.0]) / min(law.density * law.sound_speed**2 for law in used)


def judge(ended: JobResult, numbers: dict[str, Any], outlines: Sequence[np.ndarray]) -> Verdict:
    """The verdict on a run by its exit code, its message, and for a complete run `measure`."""
    def say(how: str, why: str) -> Verdict:
        return Verdict(ended.job.name, how, ended.code, why, ended.job.command(), numbers)

    if ended.code == FAILED:
        return say("stopped", ended.message) if CLEAN.search(ended.message) else say("bad", f"says '{ended.message}'")
    if ended.code == INVALID_INPUT:
        return say("refused", ended.message) if ended.message else say("bad", "refused without a word")
    if ended.code:
        return say("bad", ended.message or f"exit code {ended.code}")
    wrong = [*_numbers_wrong(numbers), *_outlines_wrong(outlines)]
    return say("bad", "; ".join(wrong)) if wrong else say("stable", "")


def _numbers_wrong(numbers: dict[str, float]) -> list[str]:
    wrong = []
    if not all(map(np.isfinite, numbers.values())):
        wrong.append("a number is not finite")
    if not numbers["energy_error"] <= ENERGY_ERROR:
        wrong.append(f"energy error {numbers['energy_error']:.3g}")
    room, swing = (VOLUME + min(k * numbers["softness"], SOFT) for k in (1.0, SWING))
    if not (1.0 - swing < numbers["J_min"] and numbers["J_max"] < 1.0 + swing):
        wrong.append(f"J from {numbers['J_min']:.3g} to {numbers['J_max']:.3g}")
    if not numbers["depth"] < DEPTH:
        wrong.append(f"a cell is {numbers['depth']:.3g} of its size within another")
    if not numbers["area"] < AREA[int(numbers["dimension"])] * room:
        wrong.append(f"an area or volume changed by {100 * numbers['area']:.3g} % more than its particles")
    return wrong


def _outlines_wrong(outlines: Sequence[np.ndarray]) -> list[str]:
    wrong = []
    for n, x in enumerate(outlines, 1):
        sides = np.stack([x, np.roll(x, -1, axis=0)], axis=1)
        for i, j in polygons.crossings(x):
            # As in a run: smaller folds are of particles that coincide.
            if polygons.overlap_of_edges(sides[i], sides[j]) > SHARE * polygons.sides(x).mean():
                wrong.append("cell {} crosses itself near ({:.4g}, {:.4g}) um".format(n, *x[i]))
                break
    for i, a in enumerate(outlines):
        for j, b in enumerate(outlines):
            if i != j and (deep := polygons.depth(a, b)) > DEPTH * np.sqrt(abs(polygons.area(a))):
                wrong.append(f"cell {i + 1} is {deep:.3g} um within cell {j + 1}")
    return wrong


# ------------------------------------------------------------------------------------------------------------ tables


def table(verdicts: Sequence[Verdict]) -> list[str]:
    """Number of scenes by verdict, and each bad one with the command that reproduces it."""
    lines = [f"{how:8} {sum(v.ended == how for v in verdicts):4}" for how in ("stable", "stopped", "refused", "bad")]
    stable = [v.numbers for v in verdicts if v.ended == "stable"]
    if stable:
        lines.append(f"stable ones: energy error at most {100 * max(n['energy_error'] for n in stable):.2g} %, J from "
                     f"{min(n['J_min'] for n in stable):.3f} to {max(n['J_max'] for n in stable):.3f}, areas "
                     f"or volumes kept to {100 * max(n['area'] for n in stable):.2g} %; "
                     f"{sum(n['share'] < 0.999 for n in stable)} ended by the number of their steps")
    for v in verdicts:
        if v.ended == "bad":
            lines += [f"{v.name}: exit code {v.code}, {v.why}", f"    {v.command}"]
    return lines
