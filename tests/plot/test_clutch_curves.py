"""The curve of clutches: what the picture and the table show."""

from __future__ import annotations

import numpy as np
import pytest

from cellmig.plot.clutches import curves, picture, table

pytestmark = pytest.mark.serial


def test_the_picture_and_the_table_have_the_traction_of_each_set_at_each_spring() -> None:
    springs = np.array([0.5, 50.0])
    found = curves(((20, 5.0), (10, 0.8)), springs, 100.0)
    lines = [bars[0].get_ydata() for bars in picture(springs, found).axes[0].containers]
    for (law, means), line in zip(found, lines, strict=True):
        np.testing.assert_allclose(line, means[:, 0] / law.stall)
        assert 0.0 < line[1] < line[0] < 1.0  # softer than where they are torn off at once
    rows = table(springs, found).splitlines()
    assert len(rows) == 4 and rows[2].startswith("| 20 of 5 pN/nm | ")
    assert f"{found[0][1][0, 0]:.1f}" in rows[2]
