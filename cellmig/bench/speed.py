"""`cellmig bench`: cost of a step by term, against plain implementations and the limits of the machine."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import tempfile
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

from mpi4py import MPI

from cellmig.case.shipped import FOLDER
from cellmig.exits import DONE
from cellmig.output.directory import replace
from cellmig.output.log import table
from cellmig.output.manifest import environment, page, processor
from cellmig.parallel.launch import PYTHON, on_ranks, outside_mpi
from cellmig.solve.start import discretise

from .baseline import Baseline
from .timing import ANEW, SURFACE, Scene

PRESSED = 40.0  # time by which balls in contact have flattened each other [µs]
MOVING = 0.2  # time by which all of a large body moves [µs]: before, many numbers are subnormal, and slow
# By dimension, the paper's scene or three balls first; each on one rank and on two.
SCENES = {2: (Scene(3, 1485), Scene(3, 6700), Scene(1, 100_000, False, 2, MOVING), Scene(1, 100_000, True, 2, MOVING),
              Scene(67, 1500), Scene(670, 1500)),
          3: (Scene(3, 4000, None, 3), Scene(3, 4000, None, 3, PRESSED), Scene(1, 4000, None, 3),
              Scene(1, 100_000, False, 3, MOVING), Scene(1, 100_000, True, 3, MOVING))}
CASES = {2: "all_protrude.toml", 3: "three_balls.toml"}  # whose start is timed
REPEATS = 7
# Floating-point operations of a neighbour in the internal force: 4 D² for F and f, 4 D for Laplacians, which have half
# of the neighbours in the plane and all in space.
OPERATIONS = {2: 20.0, 3: 48.0}
TERMS = ("stress", "divergence", *SURFACE, ANEW)


def bench_speed(out: Path, quick: bool = False, dimension: int = 2) -> int:
    """Measure each scene in processes of its own, print the tables, write speed.json and speed.md.

    Parameters
    ----------
    out : Path -- directory of the results.  quick : bool -- the first scene alone, in half a minute.  dimension : int
        -- 2 or 3.

    Returns
    -------
    int -- exit code 0.
    """
    scenes = SCENES[dimension][: 1 if quick else None]
    baseline = Baseline(discretise(scenes[0].case()))
    limits, plain = baseline.limits(REPEATS), {
        "numpy": baseline.nanoseconds(baseline.numpy_step, REPEATS),
        "plain loop in C": baseline.nanoseconds(baseline.loop_step, REPEATS)}
    probes = []
    for scene in scenes:
        for ranks in (1, 2):
            on = f"{ranks} rank{'s' * (ranks > 1)}"
            print(f"{scene.bodies} x {scene.per_body} particles{_later(scene.begin)} on {on}", flush=True)
            probes.append(measured(scene, ranks, output=scene == scenes[0]))
    found = {"limits": limits, "baseline_ns": plain, "start_s": starts(CASES[dimension]), "probes": probes}
    command = f"cellmig bench{' --quick' * quick}{' --dimension 3' * (dimension == 3)}"
    write_report(out / "speed", "What a step costs", command, found, report(found))
    return DONE


def write_report(place: Path, title: str, command: str, found: dict[str, Any], lines: Sequence[str]) -> dict[str, Any]:
    """Print the lines of tables; write them to `place`.md and all numbers to `place`.json; returns their origin."""
    origin = {"command": command, "date": date.today().isoformat(), **environment(MPI.COMM_SELF)}
    data, text = place.with_suffix(".json"), place.with_suffix(".md")
    print("", *lines, sep="\n")
    place.parent.mkdir(parents=True, exist_ok=True)
    replace(data, as_json({"origin": origin} | found))
    replace(text, page(title, command, origin, lines))
    print(data, text, sep="\n")
    return origin


def as_json(tree: Any) -> str:
    """Text of a JSON file."""
    return json.dumps(tree, indent=1, ensure_ascii=False) + "\n"


def measured(scene: Scene, ranks: int, repeats: int = REPEATS, output: bool = False) -> dict[str, Any]:
    """Result of `probe` for a scene, in processes of its own."""
    options = json.dumps({**dataclasses.asdict(scene), "repeats": repeats, "output": output})
    command = [*PYTHON, "-m", "cellmig.bench.timing", options]
    if ranks > 1:
        command = on_ranks(ranks, command)
    return json.loads(_done(command))


def starts(case: str) -> dict[str, float]:
    """Wall time [s] of a run of 1 ns of a shipped case that compiles the kernel, and of a second one."""
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        command = [*PYTHON, "-m", "cellmig", "run", str(FOLDER / case), "--until", "1 ns",
                   "--quiet", "--out", str(Path(folder) / "run")]
        for name in ("first", "second"):
            begin = perf_counter()
            _done(command, {"CELLMIG_CACHE": str(Path(folder) / "cache")})
            found[name] = perf_counter() - begin
    return found


def _done(command: Sequence[str], more: dict[str, str] | None = None) -> str:
    done = subprocess.run(command, capture_output=True, encoding="utf-8", errors="replace",
                          env=outside_mpi() | (more or {}), check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr}")
    return done.stdout


def report(found: dict[str, Any]) -> list[str]:
    """The tables in Markdown: medians and interquartile ranges."""
    probes, first = found["probes"], found["probes"][0]
    space = first["dimension"] == 3
    terms = [term for term in TERMS if any(term in p["ns"] for p in probes)]
    lines = [f"{processor()}; medians of {REPEATS}; ns per particle-step of wall time unless said", "",
             *table(["particles", "bodies", *["at [µs]"] * space, "coefficients", "ranks", "step", "CPU, all ranks",
                     "internal force", *terms, "exchange [µs]", "kernel [B]", "peak [B]"],
                    [_line(p, terms) for p in probes]), ""]
    if space:
        pressed = f"; at {PRESSED:g} µs they have flattened each other" * any(p["begin"] for p in probes)
        lines += [f"Pieces of contact serve for some steps, for one in \"{ANEW}\". At 0 µs balls begin to touch, 10 nm "
                  f"apart{pressed}.", ""]
    rate = 1e9 / internal(first)
    bytes_moved = first["traffic_bytes"] / first["particles"]
    operations = OPERATIONS[first["dimension"]] * first["neighbours"]
    width, peak = median(found["limits"]["bandwidth"]), median(found["limits"]["arithmetic"])
    times = ", ".join(f"{name} {_short(1e-3 * median(first['us'][name]))} ms" for name in ("lists", "sample", "frame"))
    lines += [("Of three balls" if space else "Of the paper's scene") + " on one rank:", "",
              *table(["", "takes [ns]", "over ours"], [
                  ["internal force", f"{internal(first):.1f}", "1"],
                  *([name, f"{median(ns):.1f}", f"{median(ns) / internal(first):.1f}"]
                    for name, ns in found["baseline_ns"].items())]), "",
              f"{bytes_moved:.0f} B and {operations:.0f} operations a particle-step are "
              f"{1e-9 * rate * bytes_moved:.1f} GB/s, {rate * bytes_moved / width / 1e7:.0f} % of the {width:.1f} GB/s "
              "to memory that one core reaches (beyond 100 %: from caches), "
              f"and {1e-9 * rate * operations:.1f} GFlop/s, {rate * operations / peak / 1e7:.0f} % of its {peak:.1f} "
              "GFlop/s.", "",
              f"Start: {found['start_s']['first']:.2f} s with compilation, {found['start_s']['second']:.2f} s without. "
              + times]
    return [*lines, *(scaling for scaling in (_scaling(probes),) if scaling)]


def internal(probe: dict[str, Any], time: str = "wall") -> float:
    """Median nanoseconds of the internal force per particle-step; `time` : "wall" or "cpu"."""
    return median(probe["ns"]["stress"][time]) + median(probe["ns"]["divergence"][time])


def _line(p: dict[str, Any], terms: Sequence[str]) -> list[str]:
    wall = sorted(p["ns"]["step"]["wall"])
    spread = wall[3 * len(wall) // 4] - wall[len(wall) // 4]
    exchange = f"{median(p['us']['exchange']):.1f}" if "exchange" in p["us"] else ""
    return [str(p["particles"]), str(p["bodies"]), *[f"{p['begin']:g}"] * (p["dimension"] == 3), _coefficients(p),
            str(p["ranks"]), f"{median(wall):.1f} ± {spread:.1f}", f"{median(p['ns']['step']['cpu']):.1f}",
            f"{internal(p):.1f}", *(_short(median(p["ns"][t]["wall"])) if t in p["ns"] else "" for t in terms),
            exchange, f"{p['kernel_bytes']:.0f}", f"{p['peak_bytes']:.0f}"]


def _short(time: float) -> str:
    """A time in two digits, or without fractions."""
    return f"{time:.2g}" if time < 100.0 else f"{time:.0f}"


def _coefficients(p: dict[str, Any]) -> str:
    return "single" if p["single"] else "double"


def _later(begin: float) -> str:
    """When a scene is timed, if not at its start."""
    return f" at {begin:g} µs" if begin else ""


def _scaling(probes: Sequence[dict[str, Any]]) -> str:
    """Parallel efficiency of two ranks."""
    def scene(p: dict[str, Any]) -> tuple:
        return p["bodies"], p["per_body"], p["single"], p["begin"]

    alone = {scene(p): median(p["ns"]["step"]["wall"]) for p in probes if p["ranks"] == 1}
    parts = [f"{p['particles']} in {p['bodies']} ({_coefficients(p)}){_later(p['begin'])}: "
             f"{alone[scene(p)] / median(p['ns']['step']['wall']) / p['ranks']:.2f}" for p in probes if p["ranks"] > 1
             and scene(p) in alone]
    return f"\nEfficiency of two ranks: {', '.join(parts)}." if parts else ""
