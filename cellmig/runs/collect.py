"""Outcomes of the runs of a study."""

from __future__ import annotations

from collections.abc import Mapping

from .batch import Job
from .outcome import Outcome


def collect(jobs: Mapping[tuple[str, int], Job]) -> dict[str, dict[int, Outcome]]:
    """Outcomes of complete runs by name and seed; prints a note where versions or commits differ."""
    results: dict[str, dict[int, Outcome]] = {}
    for (name, seed), job in jobs.items():
        results.setdefault(name, {})[seed] = Outcome.read(job.directory)
    sources = {source(outcome) for runs in results.values() for outcome in runs.values()}
    if len(sources) > 1 or any("changes" in name for name in sources):
        print(f"note: these runs are not of one known source: {', '.join(sorted(sources))}")
    return results


def source(outcome: Outcome) -> str:
    """Commit or version that computed a run."""
    m = outcome.manifest
    return f"{m['commit']} ({m['tree']})" if "commit" in m else f"version {m.get('cellmig')}"
