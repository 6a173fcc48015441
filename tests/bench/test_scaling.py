"""The model of what a step costs on many ranks: it finds the constants that made the times, and adds them up."""

from __future__ import annotations

import dataclasses
import math

import pytest

from cellmig.bench.scaling import PLANE, SPACE, Constants, Scenes, fitted, predicted

pytestmark = pytest.mark.serial
TRUE = Constants((1500.0, 1.005e5), (20.0, 30.0), 15.0, 2.4, 4.6, 2000.0, 0.5, 20.0, 3000.0, 400.0, 0.05, 1200.0,
                 1500.0, 1.5e8)


def probe(scenes: Scenes, bodies: int, per_body: int, ranks: int) -> dict:
    """What `bench` would measure where the constants are true."""
    n, surface, cut = bodies * per_body, 137 * bodies, ranks > 1 and bodies == 1
    own = n / ranks
    chord = scenes.cuts(n, ranks) if cut else 0.0
    row = 20.0 + 10.0 * (math.log(n) - math.log(1500)) / (math.log(1.005e5) - math.log(1500))
    ghosts = TRUE.copies * chord + 25.0 * (ranks > 1)
    us = {"control": [1e-3 * (TRUE.control * own + TRUE.hop * math.log2(ranks))],
          "lists": [1e-3 * (5e5 + TRUE.near * surface / ranks + TRUE.far * surface)]}
    if ranks > 1:
        us["messages"] = us["exchange"] = [1e-3 * (TRUE.latency + TRUE.byte * scenes.bytes * ghosts)]
    return {"bodies": bodies, "per_body": per_body, "particles": n, "ranks": ranks, "surface": surface, "us": us,
            "owned": [own] * ranks, "rows": [own + TRUE.extra * chord] * ranks, "ghosts": [ghosts] * ranks,
            "ns": {"stress": {"cpu": [0.7 * row]}, "divergence": {"cpu": [0.3 * row]},
                   "contact": {"cpu": [TRUE.surface * surface / n]}},
            "peak_of": [TRUE.own_bytes * own + TRUE.cell_bytes * bodies + TRUE.base_bytes] * ranks}


@pytest.mark.parametrize("scenes", [PLANE, SPACE])
def test_the_fit_finds_the_constants_that_made_the_times(scenes: Scenes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda _: range(4))
    probes = [probe(scenes, bodies, 1500, ranks) for bodies in (1, 12, 67) for ranks in (1, 2, 4)]
    probes += [probe(scenes, 1, n, ranks) for n in (6000, 24_000) for ranks in (2, 4)]
    found = fitted(scenes, probes, 1500.0)
    assert found.size == (1500.0, 18_000.0, 100_500.0) and found.row == pytest.approx((20.0, 25.92, 30.0), abs=0.02)
    for name in (f.name for f in dataclasses.fields(Constants) if f.name not in ("size", "row", "copies")):
        assert getattr(found, name) == pytest.approx(getattr(TRUE, name), rel=1e-6), name
    assert found.copies == pytest.approx(TRUE.copies, rel=0.15)  # with those where cells touch, which are 25


@pytest.mark.parametrize("scenes", [PLANE, SPACE])
def test_predictions_add_up_and_say_what_does_not_scale(scenes: Scenes) -> None:
    cells = 1e6 / scenes.per_cell
    surface = cells * scenes.surface(scenes.per_cell)
    one, two, many = (predicted(scenes, TRUE, 1e6, ranks) for ranks in (1, 2, 1024))
    for parts in (one, two, many):
        assert parts["step"] == pytest.approx(sum(parts[name] for name in ("compute", "exchange", "control", "lists")))
    assert one["exchange"] == 0.0 and one["compute"] == pytest.approx(1e6 * 30.0 + 15.0 * surface)
    assert 0.49 < two["compute"] / one["compute"] < 0.51
    assert many["exchange"] > TRUE.latency and many["lists"] > TRUE.far * surface / scenes.renew
    assert predicted(scenes, TRUE, 1e9, 10_000)["bytes"] == pytest.approx(
        1.5e8 + 1200.0 * 1e5 + 1500.0 * 1e3 * cells)  # of what is not its own a rank has a little of each cell


@pytest.mark.parametrize(("scenes", "particles", "surface"), [(PLANE, 1500, 138), (SPACE, 1000, 422)])
def test_surfaces_and_cuts_are_those_of_discs_and_balls(scenes: Scenes, particles: int, surface: int) -> None:
    assert scenes.surface(particles) == pytest.approx(surface, rel=0.01)  # of `cases/paper.toml` and `ball.toml`
    radius = math.sqrt(particles / math.pi) if scenes.dimension == 2 else (0.75 * particles / math.pi) ** (1.0 / 3.0)
    middle = 2.0 * radius if scenes.dimension == 2 else math.pi * radius**2
    assert scenes.cuts(particles, 2) == pytest.approx(middle)  # two halves
    small = (particles / 64) ** (1.0 - 1.0 / scenes.dimension)
    assert scenes.cuts(particles, 64) == pytest.approx(2.0 * scenes.dimension * small)  # squares, cubes
