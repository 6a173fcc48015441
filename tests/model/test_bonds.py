"""Bonds averaged over a segment: exact where derivatives of their potential jump, too."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from cellmig.case.registry import laws
from cellmig.laws import register
from cellmig.model.adhesion import SLOPED, bonds_of

register()
pytestmark = pytest.mark.serial


def exact(law: Any, gap1: float, gap2: float) -> list[float]:
    """Mean energy, and its derivatives by both gaps, by adaptive quadrature between the places where they jump."""
    ends = sorted((gap1, gap2))
    at = [(knot - gap1) / (gap2 - gap1) for knot in (law.cap, law.equilibrium_distance) if ends[0] < knot < ends[1]]
    change = gap2 - gap1
    parts = (lambda s: law.potential(gap1 + s * change), lambda s: (1.0 - s) * law.slope(gap1 + s * change),
             lambda s: s * law.slope(gap1 + s * change))
    return [quad(part, 0.0, 1.0, points=at or None, epsabs=1e-13, epsrel=1e-12)[0] for part in parts]


@pytest.mark.parametrize("steep", [0.001, 0.99, 1.01, 4.0])  # of the gap at which the way to integrate changes
@pytest.mark.parametrize("attraction", [1.0, 0.7, 0.0])
@pytest.mark.parametrize("name", [name for name, law in laws("adhesion").items() if hasattr(law, "attraction")])
def test_the_mean_over_a_segment_is_the_integral_wherever_it_crosses_the_well(name: str, attraction: float,
                                                                              steep: float) -> None:
    """Once bonds weaker than the wall had forces that jumped by 1e-3 where a segment's slope passes a limit."""
    law = laws("adhesion")[name](bond_density=800.0, well_depth=0.03, equilibrium_distance=0.02, attraction=attraction)
    for near in (law.cap, law.equilibrium_distance, 0.9 * law.equilibrium_distance):
        change = steep * SLOPED * near
        for begin in near - np.array([0.7, 0.5, 0.2, -0.1]) * change:
            for gaps in ((begin, begin + change), (begin + change, begin)):
                mean, *slopes = bonds_of(law).mean(*map(np.float64, gaps))
                expected = exact(law, *gaps)
                assert mean == pytest.approx(expected[0], abs=1e-8 * law.well_depth)  # measured 4e-10
                assert slopes == pytest.approx(expected[1:], abs=3e-7 * law.well_depth / 0.02)  # measured 1.2e-7
