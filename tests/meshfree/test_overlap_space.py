"""Overlaps in space: cells in each other, below the substrate, and particles outside of their cell are told."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import example
from space import balls

from cellmig.meshfree.contact import Surfaces
from cellmig.meshfree.overlap_space import escaped, overlap

pytestmark = pytest.mark.serial

SCENE = balls((example("material", "nematic"), None), 200, 2, 0.0)


def places(shift: float = 0.0, lift: float = 0.0) -> tuple[Surfaces, np.ndarray]:
    """Surfaces, and positions with the second ball moved by `shift` along x, and all of them by `lift` along z."""
    surfaces = Surfaces.of(SCENE)
    moved = np.where(surfaces.cell == 1, shift, 0.0)[:, None] * [1.0, 0.0, 0.0] + np.array([0.0, 0.0, lift])
    return surfaces, SCENE.X[surfaces.ids] + moved


def test_balls_apart_on_a_substrate_do_not_overlap() -> None:
    assert overlap(*places(), True, True) is None


def test_a_ball_in_another_is_told_with_its_depth() -> None:
    found = overlap(*places(-1.5), True, True)  # centres are 10.5 µm apart
    assert found is not None and found.cause.startswith("cells 1 and 2 overlap by 0.")
    assert SCENE.cell[found.particle] in (0, 1)
    assert overlap(*places(-1.5), True, False) is None  # cells that do not meet may


def test_a_ball_below_the_substrate_is_told() -> None:
    found = overlap(*places(lift=-0.3), True, True)
    assert found is not None and found.cause == "cell 1 is 0.3 µm below the substrate"
    assert overlap(*places(lift=-0.3), False, True) is None


def test_a_particle_outside_of_its_cell_is_told() -> None:
    surfaces, x = places()
    at = SCENE.X.copy()
    assert escaped(surfaces, x, np.arange(SCENE.size), SCENE.cell, at) is None
    lost = np.setdiff1d(np.arange(SCENE.size), surfaces.ids)[-1]
    at[lost] += [0.0, 0.0, 12.0]
    found = escaped(surfaces, x, np.arange(SCENE.size), SCENE.cell, at)
    assert found is not None and found.particle == lost and found.cause.endswith("outside of cell 2")
