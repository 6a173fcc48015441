"""Tangents: derivatives of all registered laws by one method, against differences; and of whole scenes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pieces import DISC
from scenes import built, example, smooth
from test_laws import deformations, rates, slope, vectors

from cellmig.case.registry import laws
from cellmig.meshfree.boundary import GAUSS
from cellmig.output.sample import pointwise
from cellmig.solve.tangent import Dual, derivative, tangent
from cellmig.study.pieces import RAMP, piece

METHODS = ("stress", "viscous_stress", "director_stress", "active_stress")
MATERIALS = [(name, method, by) for name, law in laws("material").items() for method in METHODS
             if hasattr(law, method) for by in ("F", "Fdot")[: 1 + (method == "viscous_stress")]]


def assert_close(a: Any, b: Any, tolerance: float) -> None:
    """Equal to `tolerance` of the largest value, which is not zero."""
    scale = np.abs(b).max()
    assert scale > 0.0
    assert np.abs(np.asarray(a) - b).max() <= tolerance * scale, f"{np.abs(np.asarray(a) - b).max() / scale:.2e}"


def segment_slopes(law: Any, g1: Any, g2: Any) -> tuple:
    """Derivatives by the gaps g1, g2 at its ends of the mean of a potential over a segment, as kernel.c has them."""
    dg, low = g2 - g1, np.where(g1 < g2, g1, g2)
    sloped = np.absolute(dg) > 0.05 * np.where(low > law.cap, low, law.cap)
    over = 1.0 / np.where(sloped, dg, 1.0)
    mean = (law.primitive(g2) - law.primitive(g1)) * over
    d1, d2 = 0.0, 0.0
    for at, weight in GAUSS:
        slope = weight * law.slope(g1 + at * dg)
        d1, d2 = d1 + (1.0 - at) * slope, d2 + at * slope
    return (np.where(sloped, (mean - law.potential(g1)) * over, d1),
            np.where(sloped, (law.potential(g2) - mean) * over, d2))


def segment_pull(law: Any, along: tuple, length: Any) -> tuple:
    """Force on the first end of a cortex segment [pN/µm] by the vector to its other end and its reference length."""
    x, y = along
    now = np.sqrt(x * x + y * y)
    t = law.tension(now / length) / now
    return t * x, t * y


# ------------------------------------------------------------------------------------------------------ pointwise


@pytest.mark.parametrize(("name", "method", "by"), MATERIALS)
def test_tangent_of_a_material_is_the_derivative_of_its_stress(name: str, method: str, by: str) -> None:
    law = example("material", name)
    given = {"F": deformations(), "Fdot": rates(), "gradient": vectors(), "director": vectors()}
    found = tangent(law, method, given, by)
    expected = np.zeros_like(found)
    for k, l in np.ndindex(2, 2):
        direction = np.zeros((2, 2, 1))
        direction[k, l] = 1.0
        expected[:, :, k, l] = slope(
            lambda s, d=direction: np.array(pointwise(law, method, {**given, by: given[by] + s * d})), 0.0, 1e-4)
    assert_close(found, expected, 1e-10)  # measured 2e-12, of the differences


@pytest.mark.parametrize("name", [name for name, method, by in MATERIALS if method == "stress"])
def test_tangent_of_an_energy_is_symmetric(name: str) -> None:
    A = tangent(example("material", name), "stress", {"F": deformations()})
    assert_close(A, A.transpose(2, 3, 0, 1, 4), 1e-14)  # measured 4e-16


@pytest.mark.parametrize("name", laws("adhesion"))
def test_tangent_of_adhesion_is_the_derivative_of_its_forces(name: str) -> None:
    law = example("adhesion", name)
    rng = np.random.default_rng(3)
    g1 = law.range * rng.uniform(0.5, 4.0, 400)
    g2 = g1 * np.where(np.arange(400) % 2, rng.uniform(0.97, 1.03, 400), rng.uniform(0.3, 3.0, 400))
    kinks = np.abs(np.abs(g2 - g1) - 0.05 * np.maximum(np.minimum(g1, g2), law.cap)) < 1e-3 * law.range
    for kink in (law.cap, law.cutoff):
        kinks |= (np.abs(g1 - kink) < 1e-3 * law.range) | (np.abs(g2 - kink) < 1e-3 * law.range)
    g1, g2 = g1[~kinks], g2[~kinks]
    found = derivative(lambda a, b: segment_slopes(law, a, b), g1, g2)[1]
    h = 1e-4 * law.range
    expected = np.array([slope(lambda s: np.array(segment_slopes(law, g1 + s, g2)), 0.0, h),
                         slope(lambda s: np.array(segment_slopes(law, g1, g2 + s)), 0.0, h)]).transpose(1, 0, 2)
    assert_close(found, expected, 1e-7)  # measured 2e-11, of the differences


@pytest.mark.parametrize("name", laws("cortex"))
def test_tangent_of_a_cortex_is_the_derivative_of_its_pull(name: str) -> None:
    law, along, length = example("cortex", name), vectors(), np.linspace(0.5, 2.0, 200)
    found = derivative(lambda d: segment_pull(law, d, length), along)[1]
    expected = np.array([slope(lambda s, e=e: np.array(segment_pull(law, along + s * e[:, None], length)), 0.0, 1e-4)
                         for e in np.eye(2)]).transpose(1, 0, 2)
    assert_close(found, expected, 1e-7)  # measured 2e-8, of the differences


def test_an_operation_without_a_rule_is_refused() -> None:
    with pytest.raises(TypeError, match="sinh"):
        np.sinh(Dual(1.0, [1.0]))


# --------------------------------------------------------------------------------------------------- whole scenes


OBLIQUE = {"name": "slope", "point": ["0 um", "1.3 um"], "normal": [0.3, -1.0], "displacement": ["0 um", "0 um"]}
PRESSED = {"loads": [{"name": "p", "pressure": "3 kPa", "history": RAMP}, {
    "name": "t", "traction": ["200*x Pa", "50 Pa"], "history": RAMP}], "plates": [OBLIQUE], "supports": [
        {"name": "low", "box": [["-0.5 um", "-2 um"], ["0.5 um", "-1.3 um"]], "displacement": ["0.1 um", "free"],
         "history": RAMP}]}


def test_tangent_of_a_scene_is_the_derivative_of_its_forces() -> None:
    """Internal force, stabilisation, pressure, a support that moves, an oblique plate: all rows, on any ranks."""
    with built(piece(DISC, 150, 2, **PRESSED)) as sim:
        run, m = sim.integrator, sim.mechanics
        X = sim.scene.X[m.ids]
        u, d = smooth(X, 1, 0.04, shortest=1.0), smooth(X, 2, 1.0, shortest=0.3)
        m.set_clock(0.7)

        def residual(s: float) -> np.ndarray:
            run._x.setArray((u + s * d).ravel())
            run._residual(None, run._x, run._r)
            return run._r.getArray().copy()

        expected = slope(residual, 0.0, 1e-6)
        gap = run.contact._nearest()[0]
        assert sim.comm.allreduce(int((gap < 0.0).sum())) > 2
        run._x.setArray(u.ravel())
        run._tangent(None, run._x, run._matrix, run._matrix)
        run._x.setArray(d.ravel())
        run._matrix.mult(run._x, run._r)
        assert_close(run._r.getArray(), expected, 1e-7)  # measured 4e-11
