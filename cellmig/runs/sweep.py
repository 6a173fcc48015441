"""`cellmig sweep`: runs of a case with varied values, in parallel, with one table and one picture."""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import json
import re
import shlex
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cellmig.case.messages import CaseError, Mistake, suggest
from cellmig.case.schema import Case
from cellmig.case.time_unit import TimeUnit
from cellmig.case.units import UnitError, number
from cellmig.exits import DONE, STOPPED
from cellmig.output.directory import OutputError, replace
from cellmig.output.log import clock
from cellmig.output.manifest import read_manifest
from cellmig.output.tables import HISTORY, MEASURES, further_columns, in_unit, read_table, time_column
from cellmig.plot.style import COLOURS, STYLE, save
from cellmig.report.study import write_study

from .batch import Job, JobResult, run_missing, unsound, write_rows

SHOWN = {d: ("ux_um", *measures[:2], "effective_stress_pa") for d, measures in MEASURES.items()}  # by dimensions
SMALL_ENERGY_ERROR = 0.005  # runs with less are counted apart [-]
_LONGEST = 120  # largest number of letters in the name of a directory
_SHORT = re.compile(r"([-+\d.eE]+) (/?)([^\W\d][\w^]*)")  # a quantity that may be part of a name
_WORD, _SIGNS = re.compile(r"[\w.+^-]+"), re.compile(r"[^\w.+^-]+")
_QUANTITY = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*)")
_MANIFEST = ("exit_status", "cause", "worst_energy_error", "steps", "wall_seconds", "state_hash")


def variation(text: str) -> tuple[str, tuple[Any, ...]]:
    """Key and values of "a.b=1,2,4", "a.b=1,2,4 kPa" (one unit for all), "a.b='one','two'" or "seed=1:8".

    Raises ValueError with a message for the user.
    """
    key, _, rest = (part.strip() for part in text.partition("="))
    if not key or not rest:
        raise ValueError(f"expects KEY=VALUE,VALUE,… or KEY=FIRST:LAST, not '{text}'")
    if whole := re.fullmatch(r"(-?\d+):(-?\d+)", rest):
        first, last = map(int, whole.groups())
        values: list[Any] = list(range(first, last + 1))
    else:
        try:
            values = tomllib.loads(f"values = [{rest}]")["values"]
        except tomllib.TOMLDecodeError:
            values = _with_unit([word.strip() for word in rest.split(",")])
    if not values or "" in values:
        raise ValueError(f"'{text}' has no values, or an empty one")
    return key, tuple(values)


def _with_unit(words: list[str]) -> list[Any]:
    """Words, in which plain numbers get the unit of the last word, or become numbers if it has none."""
    last = _QUANTITY.fullmatch(words[-1])
    unit = last[2] if last else ""

    def read(word: str) -> Any:
        if not (number := _QUANTITY.fullmatch(word)) or number[2]:
            return word
        return f"{word} {unit}" if unit else int(word) if re.fullmatch(r"[-+]?\d+", word) else float(word)

    return [read(word) for word in words]


@dataclass(frozen=True)
class Sweep:
    """A case file, varied values, and the directory of all runs.

    vary : values by dotted key;  sets : "KEY=VALUE", changes of all runs;  ranks : of each run;  until : end of all
    runs [us] in place of the case's.
    """

    case: Path
    vary: Mapping[str, Sequence[Any]]
    out: Path
    sets: tuple[str, ...] = ()
    ranks: int = 1
    until: float | None = None

    def jobs(self) -> dict[tuple[str, ...], Job]:
        """All runs by their values as TOML; the first key varies slowest.  Raises CaseError for invalid values."""
        short = [key.rpartition(".")[2] for key in self.vary]
        names = short if len(set(short)) == len(short) else list(self.vary)
        jobs, varied = {}, set()
        for values in itertools.product(*self.vary.values()):
            name = "_".join(f"{key}={_in_a_name(value)}" for key, value in zip(names, values, strict=True))
            name = name if len(name) <= _LONGEST else f"run-{_digest(name)}"
            texts = tuple(map(_toml, values))
            sets = [f"{key}={text}" for key, text in zip(self.vary, texts, strict=True)]
            varied.update(sets)
            jobs[texts] = Job(name, self.case, (*self.sets, *sets), self.out / "runs" / name, ranks=self.ranks,
                              until=self.until)
        _check(jobs.values(), varied)
        return jobs

    def rows(self, jobs: Mapping[tuple[str, ...], Job], failed: Mapping[Job, JobResult] = MappingProxyType({})
             ) -> Iterator[dict[str, Any]]:
        """Rows of each complete run: varied values, the last row of history of each cell, exit status.

        A run that failed or ended early has one row with its exit status and cause; `failed` are those of this command,
        others are found in their manifests.  Times are in the unit of the first case.
        """
        unit = next(iter(jobs.values())).load().time_unit
        columns = [_column(key, values) for key, values in self.vary.items()]
        for texts, job in jobs.items():
            varied = {name: values[text] for (name, values), text in zip(columns, texts, strict=True)}
            manifest, done = read_manifest(job.directory), job.is_done()
            if not done and not (manifest.get("exit_status") and job.matches(manifest)):
                manifest = {}  # it belongs to another run
            least, most = manifest.get("J") or (None, None)
            ended = {key: manifest.get(key) for key in _MANIFEST} | {
                "J_least": least, "J_most": most, "stretch": (manifest.get("strain") or {}).get("largest"),
                "directory": str(job.directory)}
            if job in failed:
                ended |= {"exit_status": failed[job].code, "cause": failed[job].message}
            if done:
                history = in_unit(read_table(job.directory / "history.csv"), unit)
                time = history[time_column(history)]
                for row in np.flatnonzero(time == time[-1]):
                    yield {**varied, **{name: column[row].item() for name, column in history.items()}, **ended}
            elif ended["exit_status"] is not None:
                reached = manifest.get("time_us")
                yield {**varied, f"time_{unit.symbol}": None if reached is None else unit.number(reached), **ended}


def summary(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Lines about all runs: how many came to their end, with which energy errors, how long they took, which broke."""
    runs = list({row["directory"]: row for row in rows}.values())
    done, lines = [run for run in runs if run["exit_status"] == DONE], []
    if found := [run for run in done if run["worst_energy_error"] is not None]:
        worst, longest = (max(found, key=lambda run: run[key]) for key in ("worst_energy_error", "wall_seconds"))
        small = sum(run["worst_energy_error"] <= SMALL_ENERGY_ERROR for run in found)
        lines = [f"{small} of them with an energy error of {100 * SMALL_ENERGY_ERROR:g} % or less; the largest is "
                 f"{100 * worst['worst_energy_error']:.2g} % ({_name(worst)})",
                 f"J from {min(run['J_least'] for run in found):.3f} to {max(run['J_most'] for run in found):.3f}; the "
                 f"longest run took {clock(longest['wall_seconds'])} ({_name(longest)})"]
    return [f"{len(done)} of {len(runs)} runs came to their end", *lines, *(
        f"{_name(run)} ended with exit code {run['exit_status']}: {run['cause']}"
        for run in runs if run["exit_status"] != DONE)]


def _name(row: Mapping[str, Any]) -> str:
    return Path(row["directory"]).name


def _check(jobs: Iterable[Job], varied: Iterable[str]) -> None:
    """Raise CaseError with the mistakes of all cases, each once; those of varied values name the option --vary."""
    options = {f"--set {text}": f"--vary {text}" for text in varied}
    mistakes = []
    for job in jobs:
        try:
            job.load()
        except CaseError as error:
            mistakes += [dataclasses.replace(one, file=options.get(one.file, one.file)) for one in error.mistakes]
    if mistakes:
        raise CaseError(dict.fromkeys(mistakes))


def _check_columns(case: Case, shown: Iterable[str]) -> None:
    """Raise CaseError for columns that history.csv will not have."""
    further = further_columns((probe.name for probe in case.probes),
                              (one.name for one in (*case.supports, *case.plates)), case.dimension,
                              any(pair.friction is not None or pair.push for pair in case.pairs),
                              case.contact is not None and len(case.cells) > 1)
    columns = [case.time_unit.column(name) for name in (*HISTORY[case.dimension][2:], *further[:-1])]  # but names
    if mistakes := [Mistake("--show", None, "", f"history.csv has no column '{name}'{suggest(name, columns)}")
                    for name in shown if name not in columns]:
        raise CaseError(mistakes)


def _toml(value: Any) -> str:
    """A value as text of TOML, as `--set` takes it."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_toml(str(key))} = {_toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, str | bool | np.bool_):
        return json.dumps(value if isinstance(value, str) else bool(value), ensure_ascii=False)
    return repr(float(value)) if isinstance(value, float) else str(value)


def _in_a_name(value: Any) -> str:
    """A value as unique part of the name of a directory; where characters are replaced, a digest is added."""
    text = _toml(value)
    if not isinstance(value, str):
        if _WORD.fullmatch(text):
            return text
    elif quantity := _SHORT.fullmatch(value):
        return f"{quantity[1]}_{'per_' if quantity[2] else ''}{quantity[3]}"
    elif _WORD.fullmatch(value) and value[0].isalpha() and value not in ("true", "false", "inf", "nan"):
        return value
    return f"{_SIGNS.sub('_', text).strip('_')}-{_digest(text)}"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:8]


def _column(key: str, values: Sequence[Any]) -> tuple[str, dict[str, Any]]:
    """Name of the column of a varied key, and its entry for each value, by the value's text as TOML.

    Quantities become numbers in the unit of the first, which is in the name; if some are not quantities, all stay text.
    """
    quantities = [_QUANTITY.fullmatch(value) if isinstance(value, str) else None for value in values]
    if all(quantity and quantity[2] for quantity in quantities):
        unit = quantities[0][2]
        with suppress(UnitError):
            one = number(f"1 {unit}", unit)
            return f"{key} [{unit}]", {
                _toml(value): float(quantity[1]) if quantity[2] == unit else float(f"{number(value, unit) / one:.12g}")
                for value, quantity in zip(values, quantities, strict=True)}
    return key, {_toml(value): value if isinstance(value, bool | int | float) else
                 value if isinstance(value, str) else _toml(value) for value in values}


def sweep(plan: Sweep, at_once: int | None = None, shown: Sequence[str] = ()) -> int:
    """Run what is missing, then write sweep.csv and report.html and draw sweep.png and sweep.pdf.

    Parameters
    ----------
    plan : Sweep.
    at_once : int -- runs at a time; by default one for each core.
    shown : list of str -- columns of history.csv that are drawn; by default displacement, contacts and stress.

    Returns
    -------
    int -- exit code: 0, that of the first run that failed, or 75 after a signal to stop.
    """
    jobs = plan.jobs()
    case = next(iter(jobs.values())).load()
    shown = shown or SHOWN[case.dimension]
    _check_columns(case, shown)
    failed, stopped = run_missing(plan.out, jobs.values(), at_once)
    failed |= unsound(job for job in jobs.values() if job.is_done())
    if rows := list(plan.rows(jobs, failed)):
        write_rows(plan.out / "sweep.csv", rows)
        figures, said = draw(rows, shown, plan.out), summary(rows)
        runs = {job.name: job.directory for job in jobs.values() if job.is_done()}
        page = write_study(plan.out, f"Sweep of {plan.case.stem}: {', '.join(plan.vary)}", said, figures,
                     {"Runs and cells": plan.out / "sweep.csv"}, runs)
        print(plan.out / "sweep.csv", *figures, page, *said, sep="\n")
    if stopped:
        print("stopped; the same command goes on from here")
        return STOPPED
    return next((ended.code for ended in failed.values()), DONE)


# ---------------------------------------------------------------------------------------------------- the picture


def draw(rows: Sequence[Mapping[str, Any]], shown: Sequence[str], out: Path) -> list[Path]:
    """Draw the last values of the aggregate against the first key: lines of means over seeds for the other keys."""
    rows = [row for row in rows if row.get("cell") == 0]
    if not rows:
        return []
    keys = list(itertools.takewhile(lambda name: not TimeUnit.of_column(name), rows[0]))
    across, *others = [key for key in keys if key != "seed"] or ["seed"]
    shown = [name for name in shown if any(row.get(name) for row in rows)] or list(shown[:1])
    lines: dict[tuple, dict] = {}
    for row in rows:
        lines.setdefault(tuple(row.get(key) for key in others), {}).setdefault(row.get(across), []).append(row)
    labels = [", ".join(f"{_label(key)} {_value_label(value)}" for key, value in zip(others, choice, strict=True))
              for choice in lines]
    with matplotlib.rc_context(STYLE):
        columns, tall = min(2, len(shown)), (len(shown) + 1) // 2
        figure = Figure(figsize=(3.2 * columns, 0.4 + 2.1 * tall), layout="constrained")
        axes = figure.subplots(tall, columns, squeeze=False, sharex=True).ravel()
        for ax, name in zip(axes, shown, strict=False):
            for number, (label, line) in enumerate(zip(labels, lines.values(), strict=True)):
                _line(ax, {at: [row[name] for row in group] for at, group in line.items()}, number, label)
            ax.set_ylabel(axis_of(name))
        for ax in axes[max(0, len(shown) - columns):len(shown)]:
            ax.set_xlabel(_label(across))
            ax.tick_params(labelbottom=True)
        for ax in axes[len(shown):]:
            ax.set_axis_off()
        if others:
            axes[0].legend()
        return save(figure, out, "sweep", ("png", "pdf"))


def _line(ax: Axes, values: Mapping[Any, Sequence[float]], number: int, label: str) -> None:
    """Draw a line of means, with single runs as faint points where there are several; `values` by varied value."""
    style = {"color": COLOURS[number % len(COLOURS)], "marker": "osD^vP*"[number % 7]}
    ax.plot(list(values), [np.mean(group) for group in values.values()], label=label, markersize=4, **style)
    single = [(at, value) for at, group in values.items() for value in group if len(group) > 1]
    if single:
        ax.plot(*zip(*single, strict=True), ls="", alpha=0.35, markersize=2.5, **style)


_AXES = {"ux_um": "displacement $u_x$ [µm]", "uy_um": "displacement $u_y$ [µm]", "area_um2": "area [µm²]",
         "substrate_contact_um": "contact with the substrate [µm]", "cell_contact_um": "contact with cells [µm]",
         "substrate_contact_um2": "contact with the substrate [µm²]", "cell_contact_um2": "contact with cells [µm²]",
         "volume_um3": "volume [µm³]", "surface_um2": "surface [µm²]",
         "height_um": "height [µm]", "sphericity": "sphericity [-]",
         "perimeter_um": "perimeter [µm]", "effective_stress_pa": "effective stress [Pa]"}


def axis_of(column: str) -> str:
    """Axis label of a column of history.csv."""
    return _AXES.get(column, column)


def _value_label(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _label(key: str) -> str:
    """Name of a varied column, with typographic units."""
    name, bracket, unit = key.partition(" [")
    return name.replace("_", " ") + bracket + unit.replace("um", "µm").replace("^2", "²").replace("^3", "³")


# ------------------------------------------------------------------------------------------------------- a cluster

_SLURM = """\
#!/usr/bin/env bash
# {count} runs of {case}.  See what your cluster asks for (account, partition, modules), then
#     sbatch {script}
# A run that meets the wall limit leaves a checkpoint and is queued again; what is done is not computed twice.  When
# all are done, the command that wrote this script, without --slurm, writes the table and the picture.
#SBATCH --job-name={name}
#SBATCH --array=1-{count}
#SBATCH --ntasks={ranks}
#SBATCH --cpus-per-task=1
#SBATCH --time=04:00:00
#SBATCH --signal=USR1@60
#SBATCH --requeue --open-mode=append
#SBATCH --output={logs}
set -uo pipefail
export OPENBLAS_NUM_THREADS=1
cellmig=${{CELLMIG:-${{SLURM_SUBMIT_DIR:-.}}/.venv/bin/cellmig}}
left=$((${{SLURM_JOB_END_TIME:-0}} - $(date +%s)))  # seconds; a tenth, or five minutes, is for the end
limit=()
((left < 10)) || limit=(--wall-time "$((left - (left < 3000 ? left / 10 : 300))) s")

start() {{ srun "$cellmig" "$@" --resume auto "${{limit[@]}}"; }}

case $SLURM_ARRAY_TASK_ID in
{runs}
esac
code=$?
[[ $code -ne 75 ]] || scontrol requeue "${{SLURM_ARRAY_JOB_ID}}_$SLURM_ARRAY_TASK_ID"
exit "$code"
"""


def array_script(plan: Sweep) -> Path:
    """Write a script that does the runs as a Slurm array; returns its path."""
    jobs = plan.jobs()
    lines = [f"{number}) start {shlex.join(job.arguments())} ;;" for number, job in enumerate(jobs.values(), 1)]
    script = plan.out / "sweep.sbatch"
    logs = str(plan.out).replace("%", "%%") + "/task%a.log"  # Slurm puts the number of the task for %a
    text = _SLURM.format(case=plan.case, count=len(jobs), name=shlex.quote(f"cellmig-{plan.case.stem}"),
                         ranks=plan.ranks, script=shlex.quote(str(script)), logs=shlex.quote(logs),
                         runs="\n".join(lines))
    try:
        plan.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write in '{plan.out}' ({error.strerror})") from error
    replace(script, text)
    return script
