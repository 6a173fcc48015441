"""Measures of motion against motions whose answer is known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from cellmig.output.motion import (
    correlation_in_space,
    correlation_in_time,
    decay_length,
    directionality,
    directionality_by_lag,
    fit_persistence,
    forward_index,
    index_of_bias,
    mean_and_error,
    mean_cosine,
    msd,
    net,
    order,
    path,
    persistent,
    speeds,
)

pytestmark = pytest.mark.serial

TAU = 20.0
EXACT = {5.0: 23.04, 20.0: 294.3, 60.0: 1640.0, 200.0: 7200.0, 1000.0: 39200.0}  # MSD at t, of v = 1, τ = 20


def ornstein_uhlenbeck(cells: int, n: int, dt: float, components: int, rng: np.random.Generator) -> np.ndarray:
    """Positions of motion with v² = 1: velocity and way of an interval are jointly Gaussian, and drawn exactly."""
    kept = np.exp(-dt / TAU)
    spread = 1.0 / components
    of_v = spread * (1.0 - kept**2)
    both = spread * TAU * (1.0 - kept) ** 2
    of_x = spread * TAU * (2.0 * dt - TAU * (3.0 - 4.0 * kept + kept**2))
    draw = np.linalg.cholesky([[of_v, both], [both, of_x]])
    v, x = np.sqrt(spread) * rng.standard_normal((cells, components)), np.zeros((cells, n, components))
    for step in range(1, n):
        noise = np.einsum("ij,jck->ick", draw, rng.standard_normal((2, cells, components)))
        x[:, step] = x[:, step - 1] + TAU * (1.0 - kept) * v + noise[1]
        v = kept * v + noise[0]
    return x


def telegraph(cells: int, n: int, dt: float, _: int, rng: np.random.Generator) -> np.ndarray:
    """Positions of motion along a line that turns round at the rate 1/2τ, with exponential times between turns."""
    times, x = dt * np.arange(n), np.zeros((cells, n, 1))
    for cell in range(cells):
        turns = np.cumsum(rng.exponential(2.0 * TAU, int(2 * times[-1] / TAU) + 60))
        turns = np.append(0.0, turns)
        sign = rng.choice([-1.0, 1.0]) * (-1.0) ** np.arange(len(turns))
        places = np.append(0.0, np.cumsum(sign[:-1] * np.diff(turns)))
        assert turns[-1] > times[-1]
        x[cell, :, 0] = np.interp(times, turns, places)
    return x


def rotation(cells: int, n: int, dt: float, _: int, rng: np.random.Generator) -> np.ndarray:
    """Positions in the plane at speed 1 whose direction diffuses at the rate 1/τ; a tenth of the interval a step."""
    fine = 10
    turns = np.sqrt(2.0 * dt / fine / TAU) * rng.standard_normal((cells, fine * (n - 1)))
    angle = np.cumsum(np.column_stack([rng.uniform(-np.pi, np.pi, cells), turns]), axis=1)
    v = np.stack([np.cos(angle), np.sin(angle)], axis=2)
    ways = np.cumsum(0.5 * dt / fine * (v[:, 1:] + v[:, :-1]), axis=1)
    return np.pad(ways, ((0, 0), (1, 0), (0, 0)))[:, ::fine]


MOTIONS: dict[str, tuple[Callable[..., np.ndarray], int]] = {
    "ornstein-uhlenbeck, side": (ornstein_uhlenbeck, 1), "ornstein-uhlenbeck, plane": (ornstein_uhlenbeck, 2),
    "telegraph": (telegraph, 1), "rotation": (rotation, 2)}


def test_the_formula_of_persistent_motion_has_the_published_numbers():
    for t, square in EXACT.items():
        assert float(persistent(t, 1.0, TAU)) == pytest.approx(square, rel=3e-4)  # the digits that are printed


@pytest.mark.parametrize("name", MOTIONS)
def test_all_motions_of_one_persistence_have_one_mean_square_displacement_and_the_fit_finds_it(name):
    motion, components = MOTIONS[name]
    x = motion(1000, 201, 5.0, components, np.random.default_rng(7))
    lags = [1, 4, 12, 40, 200]
    mean, error = mean_and_error(msd(x, lags))
    away = (mean - persistent(5.0 * np.array(lags), 1.0, TAU)) / error
    assert np.abs(away).max() < 4.0  # measured at most 2.5 standard errors
    assert (error / mean).max() < 0.06  # so that the test can tell: measured 0.043
    some = np.arange(1, 51)
    found = fit_persistence(5.0 * some, msd(x, some), components)
    assert abs(found.time - TAU) < 4.0 * found.time_error and abs(found.speed - 1.0) < 4.0 * found.speed_error
    assert found.time_error < 0.05 * TAU and found.speed_error < 0.02
    assert found.diffusivity == pytest.approx(TAU / components, rel=0.1)


def test_the_fit_is_exact_where_the_data_are():
    t = np.arange(1.0, 40.0)
    found = fit_persistence(t, persistent(t, 0.7, 9.0)[None] * np.ones((3, 1)), 1)
    assert (found.speed, found.time) == pytest.approx((0.7, 9.0), rel=1e-6)  # measured 2e-8
    assert found.time_error < 1e-6


@pytest.mark.parametrize(("square", "speed", "time"), [
    (lambda t: 4.0 * t**2, 2.0, np.inf), (lambda t: 6.0 * t, np.nan, 0.0), (lambda t: 0.0 * t, 0.0, np.nan)])
def test_what_is_straight_or_has_no_memory_or_rests_is_told_so(square, speed, time):
    t = np.arange(1.0, 20.0)
    found = fit_persistence(t, square(t)[None], 1)
    assert found.speed == pytest.approx(speed, rel=0.01, nan_ok=True)  # straight: what a persistence of 30 lags changes
    assert found.time == pytest.approx(time, nan_ok=True) and np.isnan(found.time_error)
    assert np.isnan(found.diffusivity)


def test_a_walk_round_three_sides_of_a_square_has_the_indices_of_its_definition():
    x = np.array([[[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]])
    assert path(x) == [6.0] and net(x) == [2.0]
    assert speeds(x, 4.0).tolist() == [[0.5, 0.5, 0.5]]
    assert forward_index(x, 0) == [0.0] and forward_index(x, 1) == pytest.approx([1.0 / 3.0])
    assert directionality(x) == pytest.approx([1.0 / 3.0]) and mean_cosine(x, 1) == pytest.approx([1.0 / 3.0])
    assert directionality_by_lag(x, [1, 2, 3])[0] == pytest.approx([1.0, 0.5**0.5, 1.0 / 3.0])
    assert msd(x, [1, 2, 3]).tolist() == [[4.0, 8.0, 4.0]]


def test_a_cell_at_rest_has_no_index_and_does_not_spoil_the_mean_of_the_others():
    x = np.zeros((3, 4, 1))
    x[1:, :, 0] = np.arange(4.0)
    x[2] *= -3.0
    assert np.isnan(forward_index(x)[0]) and forward_index(x)[1:].tolist() == [1.0, -1.0]
    mean, error = mean_and_error(forward_index(x))
    assert (mean, error) == (0.0, 1.0)
    assert np.isnan(mean_and_error(forward_index(x[:1]))).all() and np.isnan(mean_and_error(forward_index(x[1:2]))[1])


def test_the_index_of_a_bias_has_the_numbers_of_its_formulas():
    b = np.array([0.1, 0.3, 1.0, 2.0])
    assert index_of_bias(b, 1) == pytest.approx([0.0797, 0.2358, 0.6827, 0.9545], abs=6e-5)
    assert index_of_bias(b, 2) == pytest.approx([0.0884, 0.2600, 0.7103, 0.9284], abs=6e-5)


@pytest.mark.parametrize("components", [1, 2])
def test_the_index_of_a_bias_is_the_mean_cosine_of_gaussian_polarities(components):
    rng, n = np.random.default_rng(3), 400_000
    for b in (0.1, 0.3, 1.0, 2.0):
        p = rng.standard_normal((n, components)) / np.sqrt(components)
        p[:, 0] += b
        cosine = p[:, 0] / np.linalg.norm(p, axis=1)
        assert abs(cosine.mean() - index_of_bias(b, components)) < 4.0 * cosine.std() / np.sqrt(n)


def test_order_is_one_of_a_flock_and_zero_of_opposites():
    v = np.ones((4, 3, 2))
    v[2:, 1] *= -2.0
    v[:, 2] = 0.0
    assert order(v)[:2].tolist() == pytest.approx([1.0, 0.0]) and np.isnan(order(v)[2])


def test_correlation_in_time_falls_within_the_persistence():
    x = ornstein_uhlenbeck(400, 400, 2.0, 2, np.random.default_rng(5))
    v = np.diff(x, axis=1) / 2.0
    lags = np.arange(40)
    found = correlation_in_time(v, lags)
    assert found[0] == pytest.approx(1.0)
    length = decay_length(2.0 * lags, found)
    assert length == pytest.approx(20.7, rel=0.06)  # measured 21.4; means over 2 of 20 add 0.7 to the persistence


def test_correlation_in_space_and_its_length_are_those_of_a_wave():
    """Velocities cos(q y + φ) with φ at random in time: correlation cos(q r)."""
    y, phase, q = np.arange(200.0), np.random.default_rng(1).uniform(0, 2 * np.pi, 400), 2 * np.pi / 50
    x = np.stack(np.broadcast_arrays(0.0, y[:, None] + 0 * phase), axis=2)
    v = np.stack(np.broadcast_arrays(np.cos(q * y[:, None] + phase), 0.0), axis=2)
    edges = np.arange(0.5, 31.0)
    found = correlation_in_space(x, v, edges)
    r = 0.5 * (edges[1:] + edges[:-1])
    assert np.abs(found - np.cos(q * r)).max() < 0.02  # measured 0.008: φ at 400 times
    assert decay_length(r, found) == pytest.approx(np.arccos(np.exp(-1)) / q, rel=0.02)
    assert np.isnan(correlation_in_space(x, v, np.array([0.1, 0.9]))[0])
    assert np.isnan(decay_length(r, np.ones_like(r)))
