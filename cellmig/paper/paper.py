"""`cellmig paper`: the paper's cases and studies over random seeds, its claims R1 to R6, its figures."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cellmig.case.schema import Case
from cellmig.case.shipped import FOLDER
from cellmig.exits import DONE, STOPPED
from cellmig.output.tables import IMPULSE
from cellmig.report.study import write_study
from cellmig.runs.batch import Job, JobResult, run_missing, sound_and_unsound, write_rows
from cellmig.runs.claims import Claim, table, text_of, write_claims
from cellmig.runs.collect import collect, source
from cellmig.runs.outcome import CELLS, Outcome

from .claims import ADHESION, CASES, CLAIMS, IN_SPACE, PROTRUSION, Results, judge, study, times
from .figures import draw

# Frames every 4 us include the times of the paper's snapshots; --quick has the nearest ones of every 20 us.
_FRAMES, _QUICK_FRAMES = 100, 20
# Changes of all cases by the number of dimensions; in space there is one case, and --quick looks at the first half.
_FULL = {2: (), 3: ("time.end=400 us", "time.samples=400")}
_QUICK = {2: ("particles.per_cell=331", "time.samples=200"),
          3: ("particles.per_cell=300", "time.samples=100", "time.end=200 us")}
_BALLS = "three_balls"
_CHANGED = {"adhesion": lambda case, k: f"adhesion.cells.well_depth={k * case.contact.well_depth} pN um",
            "protrusion": lambda case, k: f"protrusion.protrusion_ratio={k * case.protrusion.protrusion_ratio}",
            "alone": lambda case, k: f'protrusion.cells=["{case.cells[0].name}"]'}


@dataclass(frozen=True)
class Configuration:
    """A case of the paper, with a multiple of one strength or as a control, and the claims that need it.

    In space the case is that of three balls, of which the same cells protrude.
    """

    case: str
    claims: tuple[str, ...]
    frames: bool = False
    what: str = ""
    factor: float = 1.0

    def file(self, dimension: int) -> Path:
        """The file of the case."""
        return FOLDER / f"{self.case if dimension == 2 else _BALLS}.toml"

    def sets(self, base: Case, quick: bool, given: Sequence[str] = ()) -> tuple[str, ...]:
        """Changes of the case file, with those `given`; `base` : the case with those given."""
        frames = (_QUICK_FRAMES if quick else _FRAMES) if self.frames else 1
        changed = (_CHANGED[self.what](base, self.factor),) if self.what else ()
        who = [f"Cell-{number}" for number in CASES[self.case].strip("{}").split(",")] if base.dimension == 3 else []
        protruding = (f"protrusion.cells={json.dumps(who)}",) if who else ()
        return (f"time.frames={frames}", *(_QUICK if quick else _FULL)[base.dimension], *protruding, *given, *changed)


CONFIGURATIONS = {
    "all_protrude": Configuration("all_protrude", ("R1", "R2", "R3", "R5", "R6"), frames=True),
    "one_three": Configuration("one_three", ("R3", "R4"), frames=True),
    "two_three": Configuration("two_three", ("R3",)),
    "three_only": Configuration("three_only", ("R3",)),
    "alone": Configuration("one_cell", ("R2",), what="alone"),
    **{study("adhesion", f): Configuration("all_protrude", ("R5",), False, "adhesion", f) for f in ADHESION if f != 1},
    **{study("protrusion", f): Configuration("all_protrude", ("R6",), False, "protrusion", f)
       for f in PROTRUSION if f != 1},
}


def paper(out: Path, seeds: int, at_once: int | None = None, quick: bool = False, only: Sequence[str] = (),
          given: Sequence[str] = (), tension: float | None = None, dimension: int = 2) -> int:
    """Run what is missing, judge the claims, draw the figures, write the numbers to files.

    Parameters
    ----------
    out : Path -- directory of everything; the runs are in `runs/<configuration>/seed<seed>` of it.
    seeds : int -- the case's own seed and the numbers that follow it.
    at_once : int -- runs at a time; by default one for each core.
    quick : bool -- coarse particles, few frames and samples.
    only : list of str -- keys of the claims to run for and to print, by default all.  Figures and files of numbers also
        have runs of other claims that exist.
    given : list of str -- "KEY=VALUE", changes of all cases, made before strengths are multiplied.
    tension : float -- tension of the cells' surfaces [pN/µm], which the paper has not: all is done with it, too, in a
        directory of its own below `out`, and the verdicts are compared.
    dimension : int -- 3 for balls in place of discs, and the claims of IN_SPACE.

    Returns
    -------
    int -- exit code: 0, that of the first run that failed, or 75 after a signal to stop.
    """
    claims = list(dict.fromkeys(only)) or list(CLAIMS if dimension == 2 else IN_SPACE)
    variants = {"as printed": (out, tuple(given))}
    if tension is not None:
        sets = (*given, f'cortex.line_tension="{tension} pN/um"')
        variants[f"with {tension:g} pN/um"] = out / f"tension-{tension:g}", sets
    codes, judged = [], {}
    for label, (place, sets) in variants.items():
        if tension is not None:
            print(f"\nthe model {label}")
        code, judged[label] = _variant(place, seeds, at_once, quick, claims, sets, dimension)
        if code == STOPPED:
            return STOPPED
        codes.append(code)
    if tension is not None:
        print("", *compared(judged), sep="\n")
    return next(filter(None, codes), DONE)


def _variant(out: Path, seeds: int, at_once: int | None, quick: bool, claims: Sequence[str], given: Sequence[str],
             dimension: int) -> tuple[int, list[Claim]]:
    """All of `paper` for one model: the exit code, and the `claims` that were asked for."""
    jobs = plan(out, seeds, quick, given, dimension)
    wanted = [job for (name, _), job in jobs.items() if set(CONFIGURATIONS[name].claims) & set(claims)]
    failed, stopped = run_missing(out, wanted, at_once)
    if stopped:
        print("stopped; the same command goes on from here")
        return STOPPED, []
    sound, bad = sound_and_unsound(jobs)
    results = collect(sound)
    judged = judge(results, CLAIMS if dimension == 2 else IN_SPACE)
    asked = [claim for claim in judged if claim.key in claims]
    said = table(asked, seeds)
    print("", *said, sep="\n", flush=True)
    files = {"Claims": out / "claims.csv", "Runs": out / "runs.csv"}
    write_claims(files["Claims"], judged)
    _write_runs(files["Runs"], jobs, results, failed | bad)
    figures, runs = draw(results, out), {f"{name}, seed {seed}": job.directory for (name, seed), job in sound.items()}
    title = f"Claims of the paper{' in three dimensions' * (dimension == 3)}"
    page = write_study(out, title, said, figures, files, runs)
    print("", *map(str, [*figures, *files.values(), page]), sep="\n")
    return next((ended.code for ended in (failed | bad).values()), DONE), asked


def plan(out: Path, seeds: int, quick: bool, given: Sequence[str] = (), dimension: int = 2
         ) -> dict[tuple[str, int], Job]:
    """All runs by configuration and seed, ordered by seed, so that the first of them are complete seeds."""
    some = {name: c for name, c in CONFIGURATIONS.items() if dimension == 2 or set(c.claims) & set(IN_SPACE)}
    bases = {c.file(dimension): Job("", c.file(dimension), tuple(given), out).load() for c in some.values()}
    jobs = {}
    for k in range(seeds):
        for name, c in some.items():
            path, base = c.file(dimension), bases[c.file(dimension)]
            sets = (*c.sets(base, quick, given), f"seed={base.seed + k}")
            jobs[name, base.seed + k] = Job(f"{name}, seed {base.seed + k}", path, sets,
                                            out / "runs" / name / f"seed{base.seed + k}")
    return jobs


# ------------------------------------------------------------------------------------------------------------- tables


def compared(judged: Mapping[str, list[Claim]]) -> list[str]:
    """Lines of the claims and their parts, with a column of verdicts or numbers for each model."""
    def line(text: str, columns: Iterable[str]) -> str:
        return f"{text:<80}{''.join(f'{column:<27}' for column in columns)}".rstrip()

    lines = [line("claim", judged), "-" * 134]
    for claims in zip(*judged.values(), strict=True):
        lines.append(line(f"{claims[0].key}  {claims[0].text}"[:78], (
            f"{c.verdict}, {len(c.held)} of {len(c.seeds)}" for c in claims)))
        lines += [line(f"      {parts[0].text}"[:78], (
            f"{text_of(p.values.values()) if p.values else '-'}, {len(p.held)} of {len(p.values)}" for p in parts))
            for parts in zip(*(c.parts for c in claims), strict=True)]
    return lines


def _write_runs(path: Path, jobs: Mapping[tuple[str, int], Job], results: Results,
                failed: Mapping[Job, JobResult]) -> None:
    """Write a row for each run that exists or failed."""
    rows = []
    for (name, seed), job in jobs.items():
        c = CONFIGURATIONS[name]
        row: dict[str, Any] = {"configuration": name, "protruding": CASES.get(c.case, "{1}"), "changed": c.what,
                               "factor": c.factor, "seed": seed}
        if job in failed:
            rows.append(row | {"exit_code": failed[job].code, "message": failed[job].message})
        elif outcome := results.get(name, {}).get(seed):
            rows.append(row | {"exit_code": DONE, "message": ""} | _numbers(outcome))
    write_rows(path, rows)


def _numbers(outcome: Outcome) -> dict[str, Any]:
    """Row of a complete run."""
    m = outcome.manifest
    row = {name: m.get(name) for name in ("particles", "steps", "wall_seconds", "worst_energy_error", "state_hash")}
    row["source"] = source(outcome)
    row[f"impulse_{IMPULSE[outcome.dimension].lower()}"] = outcome.impulse
    early, *later = times(outcome.end)
    for time in (early, 24.0, *later, outcome.end):
        for column in ("ux_um", *outcome.contacts):
            row[f"{column}_at_{time:g}us"] = outcome.at(column, time)
    for cell in set(CELLS) & set(outcome.history["cell"].tolist()):
        row[f"ux_um_of_cell{cell}_at_{outcome.end:g}us"] = outcome.at("ux_um", outcome.end, cell)
        row[f"apart_us_of_cell{cell}"] = outcome.apart(cell)
    return row
