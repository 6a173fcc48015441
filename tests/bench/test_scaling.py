"""The model of what a step costs on many ranks: it finds the constants that made the times, and adds them up."""

from __future__ import annotations

import dataclasses
import math

import pytest

from cellmig.bench.scaling import BYTES, Constants, fitted, predicted

pytestmark = pytest.mark.serial
TRUE = Constants((1500.0, 1.005e5), (20.0, 30.0), 15.0, 2.4, 4.6, 2000.0, 0.5, 20.0, 3000.0, 400.0, 0.05, 1200.0,
                 1500.0, 1.5e8)


def probe(bodies: int, per_body: int, ranks: int) -> dict:
    """What `bench` would measure where the constants are true."""
    n, surface, cut = bodies * per_body, 137 * bodies, ranks > 1 and bodies == 1
    own = n / ranks
    chord = min(2.0 * (ranks - 1) / ranks * 2.0 * math.sqrt(n / math.pi), 4.0 * math.sqrt(own)) if cut else 0.0
    row = 20.0 + 10.0 * (math.log(n) - math.log(1500)) / (math.log(1.005e5) - math.log(1500))
    ghosts = TRUE.copies * chord + 25.0 * (ranks > 1)
    us = {"control": [1e-3 * (TRUE.control * own + TRUE.hop * math.log2(ranks))],
          "lists": [1e-3 * (5e5 + TRUE.near * surface / ranks + TRUE.far * surface)]}
    if ranks > 1:
        us["messages"] = us["exchange"] = [1e-3 * (TRUE.latency + TRUE.byte * BYTES * ghosts)]
    return {"bodies": bodies, "per_body": per_body, "particles": n, "ranks": ranks, "surface": surface, "us": us,
            "owned": [own] * ranks, "rows": [own + TRUE.extra * chord] * ranks, "ghosts": [ghosts] * ranks,
            "ns": {"stress": {"cpu": [0.7 * row]}, "divergence": {"cpu": [0.3 * row]},
                   "contact": {"cpu": [TRUE.surface * surface / n]}},
            "peak_of": [TRUE.own_bytes * own + TRUE.cell_bytes * bodies + TRUE.base_bytes] * ranks}


def test_the_fit_finds_the_constants_that_made_the_times(monkeypatch) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda _: range(4))
    probes = [probe(bodies, 1500, ranks) for bodies in (1, 12, 67) for ranks in (1, 2, 4)]
    probes += [probe(1, n, ranks) for n in (6000, 24_000) for ranks in (2, 4)]
    found = fitted(probes, 1500.0)
    assert found.size == (1500.0, 18_000.0, 100_500.0) and found.row == pytest.approx((20.0, 25.92, 30.0), abs=0.02)
    for name in (f.name for f in dataclasses.fields(Constants) if f.name not in ("size", "row", "copies")):
        assert getattr(found, name) == pytest.approx(getattr(TRUE, name), rel=1e-6), name
    assert found.copies == pytest.approx(TRUE.copies, rel=0.15)  # with those where cells touch, which are 25


def test_predictions_add_up_and_say_what_does_not_scale() -> None:
    one, two, many = (predicted(TRUE, 1e6, ranks) for ranks in (1, 2, 1024))
    for parts in (one, two, many):
        assert parts["step"] == pytest.approx(sum(parts[name] for name in ("compute", "exchange", "control", "lists")))
    assert one["exchange"] == 0.0 and one["compute"] == pytest.approx(1e6 * 30.0 + 15.0 * one_ring() * 1e6 / 1500)
    assert 0.49 < two["compute"] / one["compute"] < 0.51
    assert many["exchange"] > TRUE.latency and many["lists"] > TRUE.far * 1e6 / 1500 * one_ring() / 555
    assert predicted(TRUE, 1e9, 10_000)["bytes"] == pytest.approx(
        1.5e8 + 1200.0 * 1e5 + 1500.0 * 1e9 / 1500)  # of what is not its own a rank has a little of each cell


def one_ring() -> float:
    """Surface particles of a cell of 1,500."""
    return 4.0 * math.sqrt(1500) * 0.89
