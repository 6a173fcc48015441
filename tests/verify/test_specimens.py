"""Exact solutions of the test pieces: they are in equilibrium, and their formulas are what they say in numbers."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import CASES, built

from cellmig.case.expression import Expression
from cellmig.case.load import load
from cellmig.simulation import Simulation
from cellmig.verify.exact import released_disc, without_sound
from cellmig.verify.references.static import STRETCH, patch, squeezed_disc
from cellmig.verify.specimens import Cantilever, Column, Flexure, Kirsch, piece, principal, rectangle

pytestmark = pytest.mark.serial
NUCLEUS = piece(rectangle(1.0, 1.0), 50).materials["nucleus"]
H = 1e-4


def places(low: float, high: float) -> np.ndarray:
    """Random places with coordinates of this size (50, 2)."""
    rng = np.random.default_rng(0)
    return rng.uniform(low, high, (50, 2)) * rng.choice([-1.0, 1.0], (50, 2))


def gradient(field: object, X: np.ndarray) -> np.ndarray:
    """∂u_i/∂X_j (n, 2, 2), by differences."""
    return np.stack([(field(X + H * e) - field(X - H * e)) / (2 * H) for e in np.eye(2)], axis=-1)


def hooke(u: object, X: np.ndarray) -> np.ndarray:
    """Stress in small strain, plane (n, 2, 2)."""
    G, e = NUCLEUS.shear_modulus, gradient(u, X)
    e = 0.5 * (e + e.transpose(0, 2, 1))
    lame = NUCLEUS.bulk_modulus - 2.0 / 3.0 * G
    return 2.0 * G * e + lame * np.trace(e, axis1=1, axis2=2)[:, None, None] * np.eye(2)


def values(formulas: tuple[str, str], X: np.ndarray) -> np.ndarray:
    """Of two formulas (n, 2)."""
    return np.column_stack([Expression(f"{f} um", "um")(X) for f in formulas])


def test_kirsch() -> None:
    plate, X = Kirsch(NUCLEUS, 1.0, 1e-3), places(1.0, 3.0)
    s = hooke(plate.displacement, X)
    assert np.abs(np.stack([s[:, 0, 0], s[:, 1, 1], s[:, 0, 1]], axis=1) - plate.stress(X)).max() < 1e-4 * plate.pull
    assert np.abs(values(plate.formulas(), X) - plate.displacement(X)).max() < 1e-12
    pulls = np.column_stack([Expression(f"{f} Pa", "Pa")(X) for f in plate.tractions()])
    assert np.abs(pulls - plate.stress(X)[:, [2, 1]]).max() < 1e-12 * plate.pull
    assert plate.stress(np.array([[0.0, 1.0], [1.0, 0.0]]))[:, :2] == pytest.approx(
        plate.pull * np.array([[3.0, 0.0], [0.0, -1.0]]), abs=1e-9 * plate.pull)


def test_cantilever() -> None:
    beam, X = Cantilever(NUCLEUS, 8.0, 2.0, 1e-3), places(0.1, 0.9) * [4.0, 1.0]
    s = hooke(beam.displacement, X)
    x, y = X[:, 0] + 4.0, X[:, 1]
    assert s[:, 0, 0] == pytest.approx(beam.force * (8.0 - x) * y / beam.inertia, abs=1e-3)
    assert np.abs(s[:, 1, 1]).max() < 1e-3
    assert s[:, 0, 1] == pytest.approx(Expression(f"{beam.shear()} Pa", "Pa")(X), abs=1e-3)
    end = np.column_stack([np.full(9, -4.0), np.linspace(-1.0, 1.0, 9)])
    assert np.abs(values(beam.formulas(), end) - beam.displacement(end)).max() < 1e-15


def test_flexure_is_in_equilibrium_and_free_at_its_sides() -> None:
    k = np.pi / 16.0
    bent = Flexure(NUCLEUS, 2.0, k)
    x = np.linspace(-1.0, 1.0, 101)
    r = 1.0 / k + 0.0 * x + bent.displacement(np.column_stack([x, 0.0 * x]))[:, 0] + x
    r += bent._series(0.0) - 1.0 / k
    a, b = bent._series.deriv()(x), k * r
    P1, P2 = principal(NUCLEUS, a, b)
    assert np.abs(P1[[0, -1]]).max() < 1e-3 * np.abs(P2).max()
    left = np.gradient(P1, x, edge_order=2)[5:-5]
    assert np.abs(left - k * P2[5:-5]).max() < 2e-3 * np.abs(P2).max()
    assert np.ptp(a * b) > 1e-4  # compressible
    X = places(0.1, 1.0) * [1.0, 4.0]
    assert np.abs(values(bent.formulas(), X) - bent.displacement(X)).max() < 1e-9


def test_column_bears_its_weight() -> None:
    sunk = Column(NUCLEUS, 4.0, 5e3)
    y = np.linspace(-1.9, 1.9, 20)
    X = np.column_stack([0.0 * y, y])
    stretch = 1.0 + gradient(sunk.displacement, X)[:, 1, 1]
    assert principal(NUCLEUS, np.ones(20), stretch)[1] == pytest.approx(-5e3 * (2.0 - y), rel=1e-5, abs=1.0)


def test_patch_and_disc_at_a_coarse_resolution() -> None:
    found = patch(100)
    assert max(found.errors.values()) < 1e-9  # measured 1e-13
    assert np.linalg.det(STRETCH) > 1.0
    assert max(squeezed_disc(320).errors.values()) < 0.006  # measured 0.004


def test_a_disc_released_moves_as_public_finite_elements_say() -> None:
    step, parts = 2.0 * np.pi / 44.413823 / 10, 10
    a2 = released_disc(NUCLEUS, 1.415, 0.05, step, 90, degree=10)
    times = step * np.arange(len(a2))
    right = 3.8e-5 + np.array([0.06368, 0.00637, 3.4e-4]) @ np.cos(np.outer([3.5659, 7.2372, 12.32], times))
    assert np.abs(without_sound(a2 - right, parts)).max() < 0.004 * a2[0]  # measured 0.003


@pytest.mark.parametrize("name", [name for name, path in CASES.items() if load(path).static])
def test_every_static_case_finds_its_equilibria(name: str) -> None:
    case = load(CASES[name], [f"particles.per_cell={1000 if name == 'squeezed_ball' else 320}"])  # for its poles
    with built(case) as sim:
        rows, entries = _ended(sim)
        assert entries["energy_error"] < 0.01
        assert max(abs(v) for k, v in rows[0].items() if k.endswith("_um")) > 0.1


def _ended(sim: Simulation) -> tuple[list[dict], dict]:
    n = sim.case.time.samples
    for k in range(n):
        sim.go(sim.case.time.end * (k + 1) / n)
    return sim.sample()
