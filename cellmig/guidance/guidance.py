"""`cellmig guidance`: published facts on how cells find their way, over random seeds, and what holds of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cellmig.exits import DONE, STOPPED
from cellmig.report.study import write_study
from cellmig.runs.batch import Job, JobResult, run_missing, sound_and_unsound, write_rows
from cellmig.runs.claims import table, write_claims

from .claims import CLAIMS, Results, judge
from .experiments import CONFIGURATIONS, plan
from .figures import draw
from .walks import Walk


def guidance(out: Path, seeds: int, at_once: int | None = None, quick: bool = False, only: Sequence[str] = (),
             given: Sequence[str] = ()) -> int:
    """Run what is missing, judge the claims, draw the figures, write the numbers to files.

    Parameters
    ----------
    out : Path -- directory of everything; the runs are in `runs/<configuration>/seed<seed>` of it.
    seeds : int -- 1 to this number.
    at_once : int -- runs at a time; by default one for each core.
    quick : bool -- coarse particles and half the time.
    only : list of str -- keys of the claims to run for and to print, by default all.
    given : list of str -- "KEY=VALUE", changes of all cases.

    Returns
    -------
    int -- exit code: 0, that of the first run that failed, or 75 after a signal to stop.
    """
    claims, jobs = list(dict.fromkeys(only)) or list(CLAIMS), plan(out, seeds, quick, tuple(given))
    wanted = [job for (name, _), job in jobs.items() if set(CONFIGURATIONS[name].claims) & set(claims)]
    failed, stopped = run_missing(out, wanted, at_once)
    if stopped:
        print("stopped; the same command goes on from here")
        return STOPPED
    sound, bad = sound_and_unsound(jobs)
    results: dict[str, dict[int, Walk]] = {}
    for (name, seed), job in sound.items():
        results.setdefault(name, {})[seed] = Walk.read(job.directory)
    judged = judge(results, CLAIMS)
    said = table([claim for claim in judged if claim.key in claims], seeds)
    print("", *said, sep="\n", flush=True)
    files = {"Claims": out / "claims.csv", "Runs": out / "runs.csv"}
    write_claims(files["Claims"], judged)
    _write_runs(files["Runs"], jobs, results, failed | bad)
    figures, runs = draw(results, out), {f"{name}, seed {seed}": job.directory for (name, seed), job in sound.items()}
    page = write_study(out, "How cells find their way: published facts", said, figures, files, runs)
    print("", *map(str, [*figures, *files.values(), page]), sep="\n")
    return next((ended.code for ended in (failed | bad).values()), DONE)


def _write_runs(path: Path, jobs: Mapping[tuple[str, int], Job], results: Results,
                failed: Mapping[Job, JobResult]) -> None:
    """Write a row for each run that exists or failed."""
    rows: list[dict[str, Any]] = []
    for (name, seed), job in jobs.items():
        row: dict[str, Any] = {"configuration": name, "case": CONFIGURATIONS[name].case, "seed": seed}
        if job in failed:
            rows.append(row | {"exit_code": failed[job].code, "message": failed[job].message})
        elif walk := results.get(name, {}).get(seed):
            m = walk.manifest
            rows.append(row | {"exit_code": DONE, "message": ""} | {
                key: m.get(key) for key in ("particles", "steps", "wall_seconds", "worst_energy_error", "failed_solves")
            } | {"drift_um_per_h": walk.drift, "index": walk.index, "cosine": walk.cosine})
    write_rows(path, rows)
