"""Which parts of an outline can meet: those of a fold, not the sides of a part that becomes thin."""

from __future__ import annotations

import numpy as np
import pytest

from cellmig.geometry import polygons
from cellmig.meshfree.contact import Surfaces, contact_pairs

pytestmark = pytest.mark.serial
THIN = 0.01  # distance of what faces each other [µm]


def pairs(corners: list, spacing: float = 0.2, before: list | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of one outline within 2 THIN: middles of both segments (p, 2, 2) [µm], and segments between them (p,).

    `before` : the corners from which the turns are followed.
    """
    x, surfaces = outline(corners, spacing)
    turn = outline(before, spacing)[1].turn if before else surfaces.turn
    turn = surfaces.followed(turn, x)
    found = contact_pairs(surfaces, x, 2 * THIN, lambda a, b: np.full(len(a), 2 * THIN), turn)
    between = np.abs(found[:, 0] - found[:, 1])
    return 0.5 * (x + x[surfaces.after])[found], np.minimum(between, len(x) - between)


def outline(corners: list, spacing: float) -> tuple[np.ndarray, Surfaces]:
    """Surface particles (n, 2) [µm] of a polygon."""
    ring = np.array(corners, float)
    sides = np.roll(ring, -1, axis=0) - ring
    x = np.concatenate([a + np.linspace(0, 1, max(1, round(np.hypot(*d) / spacing)), endpoint=False)[:, None] * d
                        for a, d in zip(ring, sides, strict=True)])
    n, at = len(x), np.arange(len(x))
    after, before = np.roll(at, -1), np.roll(at, 1)
    side = x[after] - x
    turn = polygons.turn(side[before], side)
    zero, facets, size = np.zeros(n, int), np.column_stack([at, after]), np.full(n, spacing)
    return x, Surfaces(at, zero, facets, at, at, size, np.ones(n, bool), after, before, turn, zero, spacing)


def test_both_sides_of_a_fold_are_pairs() -> None:
    middle, between = pairs([[-3, -3], [3, -3], [3, 3], [THIN / 2, 3], [THIN / 2, 0], [-THIN / 2, 0], [-THIN / 2, 3],
                             [-3, 3]])
    assert len(middle) > 20 and (between > 1).all()
    assert (np.abs(middle[..., 0]) < 0.2).all() and (middle[..., 1] > 0.0).all()


def test_both_sides_of_a_thin_part_are_none() -> None:
    assert not len(pairs([[0, 0], [8, 0], [8, THIN], [0, THIN]])[0])


def test_a_part_that_has_turned_over_at_its_tip_is_still_none() -> None:
    """The last segment of the tip has passed through the side before it."""
    before, now = ([[0, -2], [3, 0], [6, 0], [5.8, y], [3, 2 * THIN], [0, 2]] for y in (THIN, -THIN))
    assert not len(pairs(now, 3.0, before)[0])
    assert len(pairs(now, 3.0)[0])  # the turns of now alone do not tell it from a fold


def test_fingers_that_grow_towards_each_other_are_pairs() -> None:
    """Between the tips of a C there is the outside, though all of the outline is between them."""
    jaws = [[0, 0], [4, 0], [4, 2 - THIN / 2], [2, 2 - THIN / 2], [2, 1], [1, 1], [1, 3], [2, 3], [2, 2 + THIN / 2],
            [4, 2 + THIN / 2], [4, 4], [0, 4]]
    middle, _ = pairs(jaws)
    assert len(middle) > 10 and (middle[..., 0] > 1.9).all()


def test_a_short_segment_that_turns_over_at_a_corner_makes_no_pair() -> None:
    places = (3.0, 2 * THIN), (3.0 - 0.5 * THIN, -0.5 * THIN)
    before, now = ([[0, 0], [3, 0], place, [3, 3], [0, 3]] for place in places)
    assert not len(pairs(now, 3.0, before)[0])
