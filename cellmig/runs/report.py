"""`cellmig report` and `cellmig watch`: what a run tells of itself in words, and its page."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np

from cellmig.exits import DONE, FAILED, STOPPED
from cellmig.output.directory import OutputError, at_work, existing_run, replace
from cellmig.output.log import clock, simulated
from cellmig.output.manifest import read_manifest, time_unit
from cellmig.output.tables import time_column, unit_of
from cellmig.report.page import About, page
from cellmig.report.tables import read
from cellmig.report.watch import serve

from .info import about
from .tracks import measure

NAME = "report.html"
LARGE_ERROR = 0.02  # error of the energy that the page warns of
_PROGRESS = re.compile(r"done: |\s*[\d.e+-]+ \S+ +[\d.]+ %  step|stopped|failed|section  ")
_STRETCHED = "fluid was stretched beyond"
# What to do about a warning, by a piece of its text; others say it themselves.
_REMEDIES = {
    "too far apart for any flow": "Compare with finer particles; if they agree, it does no harm.",
    "a segment of a surface": "Take finer particles, or a shorter time.",
    "is more than the": "Take more friction.bonds, or a smaller protrusion.protrusion_ratio.",
    "times their size by the end": "Take a shorter time.end, a smaller protrusion.protrusion_ratio, or [friction].",
    "inertia counts here": "Take time.integrator = \"leapfrog\".",
    "TOO LARGE": "Take time.step = \"auto\".",
}


def report(directory: Path, out: Path | None = None) -> Path:
    """Write the page of a run, complete or not; returns its path, by default report.html in the directory of the run.

    Raises OutputError where the directory is no run's, a file is not as written, or the page cannot be written.
    """
    directory = existing_run(directory)
    path = out or directory / NAME
    try:
        replace(path, page(directory, describe(directory)))
    except OutputError as error:
        if out is None and not os.access(directory, os.W_OK):
            raise OutputError(f"{error}; '--out {NAME}' writes it to here") from error
        raise
    return path


def watch(directory: Path, port: int = 0) -> None:
    """Serve the page of a run that goes on, to this machine alone, until Ctrl-C; nothing is left in the directory.

    port : 0 for a free one.  Raises OutputError where the directory is no run's, or the port is taken.
    """
    serve(existing_run(directory), port, lambda run: page(run, describe(run), live=True))


def describe(directory: Path) -> About:
    """What a run tells of itself."""
    manifest, log = read_manifest(directory), _log(directory)
    summary = about(directory)
    return About(_lead(directory, manifest), summary, list(_scene(log, {key for key, _ in summary})),
                 list(_warnings(directory, manifest, log)), _motion(directory))


def _motion(directory: Path) -> tuple[list[str], list[list[Any]]]:
    """Head and rows of how the cells of a run with tracks moved along x, empty without two samples."""
    if not (directory / "tracks.csv").exists():
        return [], []
    try:
        found = measure([directory])
    except OutputError:  # too few samples, or unequal intervals
        return [], []
    unit, cells = found["unit"].label, found["cells"]
    head = {"name": "cell", "way_um": "way [µm]", "net_um": "net way [µm]", "speed": f"speed [µm/{unit}]",
            "fmi": "forward migration index x", "directionality": "directionality", "cosine": "cos φ"}
    rows = zip(*(np.asarray(cells[key]).tolist() for key in head), strict=True)
    return list(head.values()), [list(row) for row in rows]


def _lead(directory: Path, manifest: dict[str, Any]) -> str:
    """One sentence on how the run stands."""
    status, unit = manifest.get("exit_status"), time_unit(manifest)
    ended = {None: "It runs" if at_work(directory) else "It was killed", DONE: "Done", FAILED: "The simulation failed",
             STOPPED: "Stopped on request"}.get(status, f"Ended with exit code {status}")
    parts = [ended]
    if status is None and (table := read(directory, "history")) and "end_us" in manifest:
        parts.append(f"{table[time_column(table)][-1]:.4g} of {unit.text(manifest['end_us'])}")
    elif (time := manifest.get("time_us")) is not None:
        parts.append(f"{simulated(time, unit)} of {simulated(manifest.get('end_us', time), unit)} in "
                     f"{manifest.get('steps', 0):,} steps")
    if (wall := manifest.get("wall_seconds")) is not None:
        ranks = manifest.get("ranks", 1)
        parts.append(f"{clock(wall)} on {ranks} rank{'s' * (ranks > 1)}")
    if count := manifest.get("particles"):
        cells = len((manifest.get("case") or {}).get("cells") or ())
        parts.append(f"{count:,} particles in {cells} cell{'s' * (cells != 1)}")
    return "; ".join(parts) + "."


def _log(directory: Path) -> list[str]:
    """Lines of the log since the run was begun, or resumed, last."""
    path = directory / "run.log"
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines() if path.exists() else []
    first = max((n for n, line in enumerate(lines) if line.startswith("cellmig ")), default=0)
    return lines[first:]


def _scene(log: list[str], told: set[str]) -> Iterator[tuple[str, str]]:
    """Rows of the head of a log, up to its first progress or end, but those that the summary has."""
    key = ""
    for line in log[1:]:
        if _PROGRESS.match(line):
            return
        if found := re.match(r"(\S.*?)  +(\S.*)|  +(\S.*)", line):
            key = found[1] or key
            if key not in told and key != "WARNING":
                yield found[1] or "", found[2] or found[3]


def _warnings(directory: Path, manifest: dict[str, Any], log: list[str]) -> Iterator[tuple[str, str]]:
    """Warnings of a run, each with what to do unless it says so itself."""
    status = manifest.get("exit_status")
    if status is None and manifest and not at_work(directory):
        yield "The run was killed.", f"cellmig resume {quote(str(directory))}"
    elif status == STOPPED:
        yield "The run was stopped on request.", f"cellmig resume {quote(str(directory))}"
    elif status:
        yield str(manifest.get("cause") or f"exit code {status}"), (
            "docs/stability.md tells what ends a run; a smaller time.step_factor or finer particles are the first to "
            "try." if status == FAILED else "docs/troubleshooting.md lists messages and remedies.")
    text = "\n".join(line for line in log if not _PROGRESS.match(line))
    told = [re.sub(r"\s*\n\s*", " ", found[0] or found[1]) for found in
            re.findall(r"^WARNING:? +(?:at )?(.*(?:\n +.*)*)|(.*TOO LARGE.*)", text, re.MULTILINE)]
    if any(_STRETCHED in warning for warning in told):  # at the end of a run: those of its times say no more
        told = [warning for warning in told if " is stretched " not in warning]
    for warning in told:
        yield warning, next((remedy for piece, remedy in _REMEDIES.items() if piece in warning), "")
    yield from _energy(directory)


def _energy(directory: Path) -> Iterator[tuple[str, str]]:
    table = read(directory, "ledger")
    if not table or not np.isfinite(table["energy_error"]).any():
        return
    worst = np.nanargmax(np.abs(table["energy_error"]))
    if (error := abs(table["energy_error"][worst])) > LARGE_ERROR:
        yield (f"The energy error is {100 * error:.2g} % at {table[time_column(table)][worst]:.4g} "
               f"{unit_of(table).label}.",
               "Take a smaller time.step_factor; the curves of energies show when it began.")
