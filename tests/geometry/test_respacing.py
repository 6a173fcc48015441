"""Points moved along an outline: evenly spaced, of the same shape and area, in the same corners."""

from __future__ import annotations

import numpy as np
import pytest

from cellmig.geometry import polygons
from cellmig.geometry.respacing import filled, respaced

pytestmark = pytest.mark.serial


def uneven_circle(k: int, seed: int) -> np.ndarray:
    """Points on the unit circle, whose distances differ up to threefold."""
    angle = np.cumsum(1.0 + 2.0 * np.random.default_rng(seed).random(k))
    angle *= 2.0 * np.pi / angle[-1]
    return np.column_stack([np.cos(angle), np.sin(angle)])


def half_disc(k: int) -> np.ndarray:
    """The upper half of the unit disc, whose points crowd at the right end of its flat side."""
    arc, flat = np.pi * np.linspace(0.0, 1.0, k) ** 1.5, 1.0 - 2.0 * np.linspace(0.0, 1.0, k)[::-1] ** 1.5
    return np.concatenate([np.column_stack([np.cos(arc), np.sin(arc)]), np.column_stack([flat, 0.0 * flat])[1:-1]])


def segments_of(points: np.ndarray) -> np.ndarray:
    """The edges of a polygon by numbers of corners."""
    return np.column_stack([np.arange(len(points)), np.roll(np.arange(len(points)), -1)])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_points_on_a_circle_become_even_and_stay_on_it(seed: int) -> None:
    errors = []
    for k in (40, 80):
        start = uneven_circle(k, seed)
        found = respaced(start)
        side = polygons.sides(found.points)
        assert side.max() < 1.01 * side.min()  # measured 1.003
        assert np.abs(found.arc - np.append(0.0, np.cumsum(polygons.sides(start))[:-1])).max() < 12.0 * side.mean()
        errors.append(np.abs(np.hypot(*found.points.T) - 1.0).max())
    assert errors[0] < 5e-3 and errors[1] < 0.35 * errors[0]  # of second order, and a third of what chords have


def test_corners_and_straight_sides_stay() -> None:
    start = half_disc(40)
    points = respaced(start).points
    side = polygons.sides(points)
    assert polygons.sides(start).max() > 8.0 * polygons.sides(start).min() and side.max() < 1.2 * side.min()
    for corner in ((1.0, 0.0), (-1.0, 0.0)):
        assert np.abs(points - corner).sum(axis=1).min() < 1e-12
    assert points[:, 1].min() > -1e-12  # no point below the flat side
    assert polygons.area(points) == pytest.approx(0.5 * np.pi, rel=3e-3)  # measured 2e-3


def test_points_that_are_even_stay_where_they_are() -> None:
    start = polygons.circle(50)
    assert np.abs(respaced(start).points - start).max() < 1e-12


def test_an_area_is_restored_where_an_outline_is_curved() -> None:
    points = half_disc(40)
    weight = np.where(points[:, 1] > 1e-9, 1.0, 0.0)
    area = 1.003 * polygons.area(points)
    found = filled(points, segments_of(points), area, weight, 0.1)
    assert polygons.area(found) == pytest.approx(area, rel=1e-9)
    assert np.array_equal(found[weight == 0.0], points[weight == 0.0])
    kept = filled(points, segments_of(points), 2.0 * area, weight, 0.01)
    assert np.linalg.norm(kept - points, axis=1).max() <= 0.01 + 1e-12
