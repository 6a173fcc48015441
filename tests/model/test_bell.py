"""Friction of Bell's bonds: moments of their lifetime, the curve that follows, and its limits."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from samples import slope
from scipy.integrate import quad

from cellmig.case.registry import laws
from cellmig.case.units import number
from cellmig.model.bell import moments

pytestmark = pytest.mark.serial

SPEEDS = np.logspace(-6.0, 4.0, 61)
RATIOS = pytest.mark.parametrize("ratio", [0.01, 0.1, 1.0, 10.0])


def bell(ratio: float = 1.0, **parameters: float) -> Any:
    """A law whose units of traction and speed, N F_b and v0, are 1, with ρ = k_off/k_on."""
    unit = {"bonds": 1.0, "stiffness": 1.0, "on": 1.0 / ratio, "off": 1.0, "force": 1.0}
    return laws("friction")["bell"](**unit | parameters)


def lifetime(u: float, power: int) -> float:
    """The moment <t^power> of the lifetime [-] by adaptive quadrature of its survival."""
    ends = np.append(0.0, np.log1p(u * np.array([1e-6, 1e-4, 0.01, 0.1, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 45.0])) / u)
    return sum(quad(lambda t: power * t ** (power - 1) * np.exp(-np.expm1(u * t) / u), a, b, epsabs=0.0,
                    epsrel=1e-12)[0] for a, b in pairwise(ends))


@pytest.fixture(scope="module")
def both() -> np.ndarray:
    """<t> and <t²> (2, n) at SPEEDS."""
    return np.array([[lifetime(u, power) for u in SPEEDS] for power in (1, 2)])


def test_the_quadrature_of_the_fit_has_the_moments_of_the_survival(both: np.ndarray) -> None:
    assert np.abs(np.array(moments(SPEEDS)) / both - 1.0).max() < 1e-13  # measured 1.4e-15


@RATIOS
def test_the_curve_is_that_of_the_moments(both: np.ndarray, ratio: float) -> None:
    mean, square = both
    expected = SPEEDS * square / (2.0 * (ratio + mean))
    assert np.abs(bell(ratio).drag(1.0, SPEEDS) / expected - 1.0).max() < 1e-8  # measured 1.4e-9 to 2.1e-9


@RATIOS
def test_the_traction_is_odd_linear_at_low_speed_and_smooth_at_rest(ratio: float) -> None:
    law = bell(ratio)
    assert np.array_equal(law.drag(1.0, -SPEEDS), -law.drag(1.0, SPEEDS)) and law.drag(1.0, 0.0) == 0.0
    assert law.drag(1.0, 1e-12) / 1e-12 == pytest.approx(law.coefficient, rel=1e-10)
    assert law.coefficient == pytest.approx(1.0 / (1.0 + ratio), rel=1e-15)
    at = np.linspace(-1e-3, 1e-3, 2001)
    assert np.abs(np.diff(slope(lambda s: law.drag(1.0, at + s), 0.0, 1e-7))).max() < 1e-5  # a kink would be of order 1


@RATIOS
def test_the_slope_is_steepest_at_rest_and_the_largest_traction_is_that_of_the_curve(ratio: float) -> None:
    law, v = bell(ratio), np.logspace(-4.0, 5.0, 20001)
    traction = law.drag(1.0, v)
    assert (np.diff(traction) <= law.coefficient * np.diff(v)).all()
    most, speed = law.largest
    assert most >= traction.max() * (1.0 - 1e-12) and most == pytest.approx(traction.max(), rel=1e-6)
    assert speed == pytest.approx(v[traction.argmax()], rel=1e-2)


def test_units_of_a_case_give_the_friction_of_the_page() -> None:
    """N = 500/µm², k = 0.5 pN/nm, 1/s, 5/s, 2 pN: 8.3e3 Pa s/µm, at most 55 Pa, at 3.6 µm/min."""
    texts = {"bonds": ("500 /um^2", "1/um^2"), "stiffness": ("0.5 pN/nm", "pN/nm"), "on": ("1 /s", "1/s"),
             "off": ("5 /s", "1/s"), "force": ("2 pN", "pN")}
    law = bell(**{name: number(*both) for name, both in texts.items()})
    assert law.coefficient == pytest.approx(number("8333.333333333333 Pa s/um", "Pa us/um"), rel=1e-12)
    assert law.speed == pytest.approx(number("1.2 um/min", "um/us"), rel=1e-12)
    most, speed = law.largest
    assert most == pytest.approx(55.14, abs=0.01) and speed == pytest.approx(number("3.58 um/min", "um/us"), rel=1e-3)
