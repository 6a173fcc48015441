"""The study of guidance: what is expected of rows, verdicts of made-up walks, and a run of it in small."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellmig.guidance.claims import CLAIMS, expected, foreseen, judge
from cellmig.guidance.experiments import CONFIGURATIONS, GRADIENT, LEVEL, PITCH, ROWS, plan
from cellmig.guidance.guidance import guidance
from cellmig.guidance.walks import Walk
from cellmig.runs.claims import AVERAGE, FAILS, HOLDS

pytestmark = pytest.mark.serial


class Made(Walk):
    """A walk whose tension is made up."""

    @cached_property
    def tension(self) -> tuple[np.ndarray, np.ndarray]:
        shares = np.linspace(0.02, 0.98, 25)
        return shares, 100.0 * np.minimum(1.0, 5.0 * np.minimum(shares, 1.0 - shares))


def made(drift: float, cells: int = 1, stretch: float = 0.0, wander: float = 1.0, seed: int = 0) -> Walk:
    """A row from right to left that drifts and is stretched at some speeds [µm/h], and wanders by chance."""
    rng, time = np.random.default_rng(seed), np.linspace(0.0, 48.0, 577)
    first = -PITCH * np.arange(cells)[:, None]
    along = np.linspace(1.0, -1.0, cells)[:, None] if cells > 1 else np.zeros((1, 1))
    chance = wander * np.cumsum(rng.choice([-1.0, 1.0], len(time)))
    return Made(time, first + (drift + stretch * along) * time + chance * (cells == 1), Path())


def as_claimed(turned: float = 1.0) -> dict[str, dict[int, Walk]]:
    """Walks of two seeds that are as claimed, or with all drifts `turned` round."""
    found: dict[str, dict[int, Walk]] = {}
    for seed in (1, 2):
        walks = {f"row {n}": made(turned * 4.0 * expected(n), n, seed=seed) for n in ROWS}
        walks |= {"gel 1": made(0.0, seed=seed), "gel graded": made(turned, 8, 0.5), "gel uniform": made(0.0, 8, 1.0),
                  "gel cut": made(0.1, 8)}
        for name in CONFIGURATIONS:
            if name.startswith(("steep", "dose")):
                what, value = name.split()
                percent, dose = (9.0, float(value)) if what == "dose" else (float(value), 1.0)
                rng = np.random.default_rng(seed)
                steps = np.where(rng.random(4000) < 0.5 * (1.0 + turned * foreseen(percent, dose)), 1.0, -1.0)
                walks[name] = Made(np.arange(4001.0), np.append(0.0, np.cumsum(steps))[None], Path())
        walks |= {"clutches softer": made(turned * 2.0, wander=0.0),
                  "clutches stiffer": made(-turned * 5.0, wander=0.0), "clutches uniform": made(0.05, wander=0.0)}
        for name, walk in walks.items():
            found.setdefault(name, {})[seed] = walk
    return found


def test_a_row_in_a_weak_gradient_has_the_share_of_camley(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cellmig.guidance.claims.GRADIENT", 1e-3 * GRADIENT)
    shares = [expected(n) for n in ROWS]
    assert shares == pytest.approx([(n - 1) / n for n in ROWS], rel=1e-6)  # measured 5e-8


@pytest.mark.parametrize("key", CLAIMS)
def test_claims_hold_of_walks_as_claimed_and_not_of_their_opposites(key: str) -> None:
    [claim] = judge(as_claimed(), [key])
    assert claim.verdict in (HOLDS, AVERAGE), [(part.what, part.values) for part in claim.parts]
    [claim] = judge(as_claimed(-1.0), [key])
    assert claim.verdict == FAILS


def test_the_index_of_a_walk_is_its_way_up_over_all_its_way() -> None:
    walk = Walk(np.arange(4.0), np.array([[0.0, 2.0, 1.0, 3.0]]), Path())
    assert (walk.drift, walk.index, walk.cosine) == pytest.approx((1.0, 0.6, 1.0 / 3.0))
    both = Walk(np.array([0.0, 2.0]), np.array([[0.0, 3.0], [-20.0, -21.0]]), Path())
    assert (both.outwards(0), both.outwards(-1)) == (1.5, 0.5)


@pytest.mark.parametrize("quick", [False, True])
def test_every_run_of_the_plan_is_a_case_without_mistakes(quick: bool) -> None:
    jobs = plan(Path("out"), 2, quick)
    assert len({job.directory for job in jobs.values()}) == len(jobs) == 2 * len(CONFIGURATIONS)
    for (name, seed), job in jobs.items():
        if seed == 1:
            case = job.load()
            assert case.guided and case.overdamped and case.seed == 1
            assert case.time.end == pytest.approx(3.6e9 * getattr(CONFIGURATIONS[name], "quick" if quick else "end"))


def test_levels_of_the_rows_are_positive_everywhere() -> None:
    assert LEVEL > 0.5 * GRADIENT * PITCH * max(ROWS)


def test_the_study_runs_what_is_missing_and_tells_what_it_found(tmp_path: Path, capsys: Any) -> None:
    small = ('time.end="3 min"', "time.samples=3", "particles.per_cell=30", 'polarity.persistence="10 min"')
    assert guidance(tmp_path, 1, 2, True, ["G4"], small) == 0
    told = capsys.readouterr().out
    assert "3 to go" in told and "cells with clutches go to an optimal stiffness" in told
    assert (tmp_path / "claims.csv").read_text(encoding="utf-8").startswith("claim,part,")
    rows = (tmp_path / "runs.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) == 4 and (tmp_path / "g4_clutches.png").stat().st_size > 10_000
    assert guidance(tmp_path, 1, 2, True, ["G4"], small) == 0
    assert "3 of them are there already" in capsys.readouterr().out
