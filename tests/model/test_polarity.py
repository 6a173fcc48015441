"""Polarity: the statistics of its paths are those of persistent random walks, whatever the law."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.special import erf, i0e, i1e

from cellmig.case.registry import laws

pytestmark = pytest.mark.serial

LAWS, PATHS, TAU = list(laws("polarity")), 40_000, 20.0


def law(name: str, **given: Any) -> Any:
    return laws("polarity")[name](persistence=TAU, **given)


def paths(law: Any, n: int, knots: int, towards: float = 0.0, seed: int = 1) -> np.ndarray:
    """Polarities (knots + 1, PATHS, n) of independent cells, whose cue points along the first axis."""
    rng = np.random.default_rng(seed)
    cue = np.zeros((PATHS, n))
    cue[:, 0] = towards
    found = [law.drawn(cue, rng.standard_normal((PATHS, n)))]
    for _ in range(knots):
        found.append(law.next(found[-1], cue, rng.standard_normal((PATHS, n)), rng.random(PATHS)))
    return np.array(found)


@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.parametrize("name", LAWS)
def test_polarity_keeps_its_size_and_loses_its_direction_in_the_persistence_time(name: str, n: int) -> None:
    p = paths(law(name), n, 40)
    size, kept = (p**2).sum(axis=2).mean(axis=1), (p[0] * p).sum(axis=2).mean(axis=1)
    error = 4.0 / np.sqrt(PATHS)  # four standard errors of numbers of size 1; measured 0.8 to 2.0 of them
    assert np.abs(size - 1.0).max() < np.sqrt(2.0) * error
    assert np.abs(kept - np.exp(-np.arange(41) / 20.0)).max() < np.sqrt(2.0) * error


@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.parametrize("name", LAWS)
def test_mean_square_displacement_is_that_of_a_persistent_random_walk(name: str, n: int) -> None:
    """Between knots polarity is linear, as in a run: that takes 1/12 of (h/τ)² and less from the displacement."""
    p, h = paths(law(name), n, 60), TAU / 20.0
    x = np.concatenate([np.zeros((1, PATHS, n)), np.cumsum(0.5 * h * (p[1:] + p[:-1]), axis=0)])
    t = h * np.arange(61)
    found, exact = (x**2).sum(axis=2).mean(axis=1), 2.0 * TAU * (t - TAU * (1.0 - np.exp(-t / TAU)))
    # Of the side view 2 %: three standard errors of squares whose spread is their mean times √2.  Measured 1.1 %.
    assert np.abs(found[5:] / exact[5:] - 1.0).max() < 0.025


@pytest.mark.parametrize("bias", [0.1, 0.3, 1.0, 2.0])
@pytest.mark.parametrize("name", LAWS)
def test_bias_against_chance_rules_how_often_a_cell_goes_towards_a_cue(name: str, bias: float) -> None:
    p = paths(law(name), 1, 0, bias)[0, :, 0]
    assert np.sign(p).mean() == pytest.approx(erf(bias / np.sqrt(2.0)), abs=4.0 / np.sqrt(PATHS))  # measured 0.010


@pytest.mark.parametrize("bias", [0.1, 0.3, 1.0, 2.0])
@pytest.mark.parametrize("name", LAWS)
def test_the_same_in_the_plane(name: str, bias: float) -> None:
    p, k = paths(law(name), 2, 0, bias)[0], bias**2 / 2.0
    along = (p[:, 0] / np.linalg.norm(p, axis=1)).mean()
    exact = np.sqrt(np.pi / 8.0) * np.sqrt(2.0) * bias * (i0e(k) + i1e(k))
    assert along == pytest.approx(exact, abs=4.0 * np.sqrt(0.5 / PATHS))  # measured 0.003


@pytest.mark.parametrize("n", [1, 2])
def test_a_relaxing_polarity_has_the_mean_of_its_cues(n: int) -> None:
    p = paths(law("relaxing", spread=0.5), n, 20, 0.7)
    assert p[..., 0].mean() == pytest.approx(0.7, abs=0.01)  # measured 0.003
    assert np.abs(paths(law("relaxing", spread=0.0), n, 5, 0.7)[..., 0] - 0.7).max() < 1e-15
