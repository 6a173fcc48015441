"""Surfaces in space: forces are gradients, means over triangles are exact, and nothing jumps."""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from polyhedra import sphere
from samples import assert_close, distances, slope
from scenes import example

from cellmig.case.registry import laws
from cellmig.model.membranes import CortexTension, ProtrusionPush, SlidingFriction, TriangleAdhesion
from cellmig.model.triangles import FLAT, NEAR, RampSlope, TriangleBonds, TriangleMean

pytestmark = pytest.mark.serial

ADHESIONS, PROTRUSIONS, CORTICES, FRICTIONS = (
    list(laws(kind)) for kind in ("adhesion", "protrusion", "cortex", "friction"))
KINKED = pytest.mark.parametrize("attraction", [1.0, 0.3, 0.0])


def bonds(name: str = "seifert", **changed: Any) -> TriangleBonds:
    return TriangleBonds(dataclasses.replace(example("adhesion", name), **changed))


def hard_gaps(law: Any, n: int = 900) -> np.ndarray:
    """Gaps (3, n) of corners [µm]: near and far, steep and flat, across the places where derivatives jump."""
    rng, eps = np.random.default_rng(7), law.equilibrium_distance
    at = rng.choice([law.cap, eps, law.cutoff], n) + eps * 10.0 ** rng.uniform(-5, -1, n) * rng.choice([-1, 1], n)
    middle = np.where(rng.random(n) < 0.4, at, eps * 10.0 ** rng.uniform(-0.3, 2.2, n))
    spread = 10.0 ** (rng.uniform(-3.5, 1.5, n) + rng.uniform(-2.0, 0.0, (3, n))) * rng.choice([-1, 1], (3, n))
    gaps = np.where(middle * (1.0 + spread) > -0.5 * eps, middle * (1.0 + spread), middle)
    return gaps[:, np.ptp(gaps, axis=0) > 0.0]


def along_levels(law: Any, gaps: np.ndarray) -> np.ndarray:
    """Mean of U and its derivatives by three gaps (4,), by Gauss points along the gap, in many parts."""
    order = np.argsort(gaps)
    a, b, c = gaps[order]
    knots = sorted({a, b, c, *(k for k in (law.cap, law.equilibrium_distance, law.cutoff) if a < k < c)})
    parts = [np.geomspace(p, q, 13) if p > 0.0 else np.linspace(p, q, 25) for p, q in pairwise(knots)]
    limits = np.unique(np.concatenate(parts))
    x, w = np.polynomial.legendre.leggauss(16)
    wide = np.diff(limits)
    g = (limits[:-1, None] + 0.5 * wide[:, None] * (x + 1.0)).ravel()
    w = (0.5 * wide[:, None] * w).ravel()
    up, down, low = (g - a) / max(b - a, 1e-300), (c - g) / max(c - b, 1e-300), g < b
    w = 2.0 * w * np.where(low, up, down) / (c - a)
    on_b = 0.5 * np.where(low, up, down)
    on_c = np.where(low, 0.5 * (g - a) / (c - a), 1.0 - 0.5 * down - 0.5 * (c - g) / (c - a))
    shares = np.array([1.0 - on_b - on_c, on_b, on_c])
    by_gap = np.empty(3)
    by_gap[order] = (w * law.slope(g) * shares).sum(axis=1)
    return np.array([(w * law.potential(g)).sum(), *by_gap])


# ---------------------------------------------------------------------------------------- adhesion to the substrate


@KINKED
@pytest.mark.parametrize("name", ADHESIONS)
def test_the_primitive_is_the_derivative_of_the_second_primitive(name: str, attraction: float) -> None:
    law = bonds(name, **({"attraction": attraction} if name == "seifert" else {})).law
    r, eps = distances(law), law.equilibrium_distance
    r = r[np.abs(r - eps) > 1e-4 * eps]
    assert_close(slope(law.second_primitive, r, 2e-4 * eps), law.primitive(r), 1e-11)  # measured 1e-12
    for at in (law.cap, eps, law.cutoff):
        step = law.second_primitive(at * (1.0 + 1e-9)) - law.second_primitive(at * (1.0 - 1e-9))
        assert abs(step) < 1e-7 * law.well_depth * eps**2
    assert not law.second_primitive(np.array([law.cutoff, 1e3])).any()


@KINKED
@pytest.mark.parametrize("name", ADHESIONS)
def test_the_mean_over_a_triangle_and_its_derivatives_are_exact(name: str, attraction: float) -> None:
    found = bonds(name, **({"attraction": attraction} if name == "seifert" else {}))
    gaps = hard_gaps(found.law)
    spread = np.ptp(gaps, axis=0) / found.scale(gaps.min(axis=0))
    assert (spread < FLAT).sum() > 100 and (spread > NEAR).sum() > 100
    expected = np.array([along_levels(found.law, g) for g in gaps.T]).T
    mean, *by_gaps = found.mean(*gaps)
    assert np.abs(mean - expected[0]).max() < 1e-10 * found.law.well_depth  # measured 2.3e-11, as rounding explains
    assert_close(by_gaps, expected[1:], 1e-9)  # measured 1.4e-10


@pytest.mark.parametrize("name", ADHESIONS)
def test_the_force_of_the_substrate_is_minus_the_gradient_of_the_energy(name: str) -> None:
    term = TriangleAdhesion(bonds(name))
    gaps, eps = hard_gaps(term.bonds.law), term.bonds.law.equilibrium_distance
    clear = np.ones(gaps.shape[1], bool)
    for at, of in ((FLAT, np.ptp(gaps, axis=0)), *((NEAR, np.diff(np.sort(gaps, axis=0), axis=0)[k]) for k in (0, 1))):
        clear &= np.abs(of / term.bonds.scale(gaps.min(axis=0)) - at) > 2e-3  # where quadrature begins
    gaps = gaps[:, clear]
    force = term.force(0.3, *gaps)
    up = np.array([f[2] for f in force])
    numeric = []
    for k in range(3):
        direction = np.eye(3)[k][:, None]
        numeric.append(-slope(lambda s, d=direction: term.facet(0.3, *(gaps + s * d))[1], 0.0, 3e-4 * eps))
    assert_close(up, np.array(numeric), 3e-8)  # measured 6e-9
    assert not np.array([f[:2] for f in force]).any()


def test_the_order_of_the_corners_does_not_matter() -> None:
    found = bonds()
    gaps = hard_gaps(found.law)
    mean, *by_gaps = found.mean(*gaps)
    turned, *by_turned = found.mean(*gaps[[2, 0, 1]])
    assert np.array_equal(turned, mean) and np.array_equal(np.array(by_turned), np.array(by_gaps)[[2, 0, 1]])


def test_a_level_triangle_has_the_potential_of_its_gap() -> None:
    found = bonds()
    r = distances(found.law)
    mean, *by_gaps = found.mean(r, r, r)
    assert_close(mean, found.law.potential(r), 1e-14)
    assert_close(sum(by_gaps), found.law.slope(r), 1e-14)
    assert found.closed(*3 * [found.law.equilibrium_distance]) == pytest.approx(1.0, abs=3e-3)  # the cutoff: 2.4e-3
    assert found.closed(*3 * [found.law.cutoff]) == 0.0


def test_the_curvature_is_that_of_the_potential_where_it_is_positive() -> None:
    found = bonds()
    r = np.linspace(0.5, 2.0, 400) * found.law.equilibrium_distance
    exact = np.maximum(slope(found.law.slope, r, 1e-5 * found.law.equilibrium_distance), 0.0)
    assert np.abs(found.curvature(r, r, r) - exact).max() < 0.02 * exact.max()  # measured 0.01
    steep = found.curvature(r, r + 0.3, r + 0.5)
    assert (steep >= 0.0).all() and steep.max() < 1e-2 * exact.max()


def areas(x: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b, c = x[triangles].transpose(1, 0, 2)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def test_a_sphere_on_the_plane_has_the_force_of_derjaguin() -> None:
    """F = 2πRN [U(a) - U(a + 2R)]; of a polyhedron, but for the height of the sphere over its faces."""
    term = TriangleAdhesion(bonds(cutoff=0.5))
    law, R, a = term.bonds.law, 2.0, 0.06
    errors = []
    for n in (4000, 16000):
        x, triangles = sphere(n, R)
        gaps = x[triangles, 2].T + R + a
        force = sum(term.facet(areas(x, triangles), *gaps)[0]).sum()
        exact = 2.0 * np.pi * R * law.bond_density * (law.potential(a) - law.potential(a + 2.0 * R))
        errors.append(force / exact - 1.0)
    assert abs(errors[0]) < 0.05 and abs(errors[1]) < 0.0125  # measured 0.033 and 0.0084
    assert abs(errors[1]) < 0.35 * abs(errors[0])  # of second order in the spacing


# ------------------------------------------------------------------------------------- cortex, friction, protrusion


def triangles(n: int = 50) -> np.ndarray:
    """Corners (3 corners, 3 components, n) of random triangles [µm]."""
    return np.random.default_rng(3).standard_normal((3, 3, n))


@pytest.mark.parametrize("name", CORTICES)
def test_the_cortex_pulls_with_minus_the_gradient_of_its_energy(name: str) -> None:
    term, x = CortexTension(example("cortex", name)), triangles()

    def energy(x: np.ndarray) -> np.ndarray:
        return term.energy(0.4, tuple(x[1] - x[0]), tuple(x[2] - x[0]))

    force = np.array(term.force(0.4, tuple(x[1] - x[0]), tuple(x[2] - x[0])))
    numeric = np.empty_like(force)
    for i in np.ndindex(3, 3):
        direction = np.zeros((3, 3, 1))
        direction[i] = 1.0
        numeric[i] = -slope(lambda s, d=direction: energy(x + s * d), 0.0, 1e-3)
    assert_close(force, numeric, 1e-10)  # measured 1.2e-11
    assert np.abs(force.sum(axis=0)).max() < 1e-14 * np.abs(force).max()
    assert np.abs(np.cross(x, force, axis=1).sum(axis=0)).max() < 1e-13 * np.abs(force).max()


def test_a_spherical_cortex_is_under_the_pressure_of_laplace() -> None:
    """2T/R times the area; forces are those of the volume's derivative to the error of the facets."""
    term, (x, faces) = CortexTension(example("cortex", "line-tension")), sphere(1000, 2.0)
    a, b, c = x[faces].transpose(1, 2, 0)
    force = np.array(term.force(areas(x, faces), tuple(b - a), tuple(c - a)))
    virial = (force * np.array([a, b, c])).sum()
    assert virial == pytest.approx(-2.0 * term.law.line_tension * areas(x, faces).sum(), rel=1e-12)


@pytest.mark.parametrize("name", FRICTIONS)
def test_friction_is_against_the_motion_and_that_of_the_bonded_area(name: str) -> None:
    term = SlidingFriction(example("friction", name), bonds())
    eps, v = term.bonds.law.equilibrium_distance, (0.3, -0.4)
    force = np.array(term.force(0.6, eps, eps, eps, v, v, (0.0, 0.0)))
    expected = -0.2 * term.law.drag(term.bonds.closed(eps, eps, eps), 0.5) * np.array([0.6, -0.8, 0.0])
    assert force[0] == pytest.approx(expected, rel=1e-12) and force[1] == pytest.approx(expected, rel=1e-12)
    assert not force[2].any()
    assert not np.array(term.force(0.6, 2.0, 2.0, 2.0, v, v, v)).any()


@pytest.mark.parametrize("name", PROTRUSIONS)
def test_the_push_is_the_mean_slope_of_the_ramp(name: str) -> None:
    law = example("protrusion", name)
    rng, mean = np.random.default_rng(5), RampSlope(law)
    g = np.linspace(-0.5, 1.5, 400) * law.height
    assert_close(slope(law.ramp_primitive, g, 1e-4 * law.height), law.ramp(g), 1e-11)  # measured 8e-13
    gaps = law.height * (rng.uniform(-0.3, 1.3, 200) + 10.0 ** rng.uniform(-5, 0, 200) * rng.uniform(-1, 1, (3, 200)))
    n = 150
    i, j = np.meshgrid(np.arange(n) + 0.5, np.arange(n) + 0.5)
    s, t = np.sqrt(i.ravel() / n), j.ravel() / n  # even over the triangle
    shares = np.array([1.0 - s, s * (1.0 - t), s * t])
    expected = law.ramp_slope(gaps.T @ shares).mean(axis=1)
    assert_close(mean.average(*gaps), expected, 3e-4)  # measured 1.2e-4, of the points of the test
    term = ProtrusionPush(law, bonds())
    force = np.array(term.force((1.0, 2.0, 3.0), 0.5, 0.6, (1e3, 1e3, -1e3), (0.2, 0.4, 0.7)))
    push = 0.3 * mean.average(0.2, 0.4, 0.7)
    assert force == pytest.approx(push * np.array([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 0.0]]), rel=1e-12)
    assert term.hold(term.grip(0.6, 1e3, 0.01, 0.01, 0.01)) > 0.5 > term.hold(term.grip(0.6, -1e3, 0.01, 0.01, 0.01))


def test_the_mean_of_a_quadratic_function_is_exact_between_its_knots() -> None:
    class Square(TriangleMean):
        """r² up to r = 1, 1 from there on."""

        def value(self, gap: Any) -> Any:
            return np.minimum(gap, 1.0) ** 2

        def primitive(self, gap: Any) -> Any:
            return np.minimum(gap, 1.0) ** 3 / 3.0 + np.maximum(gap - 1.0, 0.0)

        def second_primitive(self, gap: Any) -> Any:
            beyond = np.maximum(gap - 1.0, 0.0)
            return np.minimum(gap, 1.0) ** 4 / 12.0 + beyond / 3.0 + beyond**2 / 2.0

        def scale(self, least: Any) -> Any:
            return 1.0 + 0.0 * least

        def knot(self, middle: Any) -> Any:
            return 1.0 + 0.0 * middle

    a, b, c = np.random.default_rng(2).uniform(-1.0, 1.0, (3, 200))
    exact = (a * a + b * b + c * c + a * b + b * c + c * a) / 6.0
    assert_close(Square().average(a, b, c), exact, 1e-12)  # measured 1e-14
    near = 1.0 + 1e-3 * np.array([a, b, c])
    assert Square().average(*near) == pytest.approx(TriangleMean.by_differences(Square(), *np.sort(near, axis=0))[0],
                                                    abs=1e-9)
