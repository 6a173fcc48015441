"""The stress itself converges: nodal, and recovered as the frames have it, against exact solutions; and in a scene.

Numbers and what they mean for the paper's claims: docs/stress_field.md.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from scenes import DAMPED, built, case, everywhere, set_motion
from scipy.optimize import brentq
from statics import equilibrium, loads

from cellmig.case.load import from_dict
from cellmig.case.schema import Case
from cellmig.simulation import Simulation
from cellmig.verify.exact import Ringing, cauchy, poisson, sheared

pytestmark = pytest.mark.serial

LAYOUTS = ["rings", "irregular"]
NUCLEUS, CELL, RATIO = 1.415, 5.0, 0.283  # radii [µm]
COUNTS = (200, 400, 800)


class Stress(NamedTuple):
    """Cauchy stress (n, 3, 3) [Pa] of all particles."""

    nodal: np.ndarray
    recovered: np.ndarray


def disc(layout: str, count: int, *sets: str, base: str = "nucleus", radius: float = NUCLEUS) -> Case:
    """A disc at rest, in space, with its particles in rings or as any outline is filled."""
    tree = case(base, *sets, per_cell=count).resolved()
    tree.pop("adhesion", None)
    tree.pop("protrusion", None)
    tree["cells"][0] |= {"velocity_gradient": [["0 /us", "0 /us"]] * 2, "centre": ["0 um", "0 um"]}
    if layout == "irregular":
        del tree["cells"][0]["radius"]
        tree["cells"][0] |= {"shape": "ellipse", "a": f"{radius} um", "b": f"{radius} um"}
    return from_dict(tree)


def stress(sim: Simulation) -> Stress:
    """As it is; collective."""
    sim.mechanics.rate()
    nodal = sim.sampler.nodal_stress()[0][: sim.mechanics.n_owned]
    return Stress(everywhere(sim, nodal), everywhere(sim, sim.sampler.stresses()["stress"]))


def deviator(s: np.ndarray) -> np.ndarray:
    return s - np.trace(s, axis1=1, axis2=2)[:, None, None] / 3.0 * np.eye(3)


def effective(s: np.ndarray) -> np.ndarray:
    return np.sqrt(1.5 * (deviator(s) ** 2).sum(axis=(1, 2)))


def divergence(stress: Callable[[np.ndarray], np.ndarray], X: np.ndarray, h: float = 1e-3) -> np.ndarray:
    """Divergence over the second index of a smooth field (n, 2, 2) at X (n, 2), by fourth-order differences."""
    total = np.zeros_like(X)
    for j in range(2):
        e = h * np.eye(2)[j]
        total += (8 * (stress(X + e) - stress(X - e)) - stress(X + 2 * e) + stress(X - 2 * e))[:, :, j] / (12 * h)
    return total


def inclusion(X: np.ndarray, radius: float, moduli: tuple[float, float], ratios: tuple[float, float]) -> np.ndarray:
    """Stress (n, 3, 3) about a round inclusion, under σ11 = -σ22 = 1 at infinity (Muskhelishvili).

    `moduli` and Poisson's `ratios` are of the inclusion, in which the stress is uniform, and of its surroundings.
    """
    (G1, G2), k = moduli, 3.0 - 4.0 * ratios[1]
    a = (G2 - G1) / (k * G1 + G2)
    z = X[:, 0] + 1j * X[:, 1]
    inside = np.abs(z) < radius
    z = np.where(inside, radius, z) / radius
    # Kolosov's potentials outside, φ = a/z and ψ = -z + a/z³, with lengths in radii
    trace = np.where(inside, 0.0, -4.0 * (a / z**2).real)
    q = np.where(inside, -2.0 * (1.0 - a), 2.0 * (2.0 * z.conj() * a / z**3 - 1.0 - 3.0 * a / z**4))
    stress = np.zeros((len(X), 3, 3))
    stress[:, 0, 0], stress[:, 1, 1] = 0.5 * (trace - q.real), 0.5 * (trace + q.real)
    stress[:, 0, 1] = stress[:, 1, 0] = 0.5 * q.imag
    stress[:, 2, 2] = np.where(inside, *ratios) * trace
    return stress


def norm(V: np.ndarray, s: np.ndarray) -> float:
    return float(np.sqrt((V * (s**2).sum(axis=(1, 2))).sum()))


def errors(V: np.ndarray, found: Stress, exact: np.ndarray) -> list[float]:
    """L2 errors over the L2 norm: whole stress nodal and recovered, deviator nodal and recovered [-]."""
    return [norm(V, f(s) - f(exact)) / norm(V, f(exact)) for f in (lambda s: s, deviator) for s in found]


def orders(spacing: list[float], values: Any) -> np.ndarray:
    return np.polyfit(np.log(spacing), np.log(values), 1)[0]


def check(spacing: list[float], found: list[list[float]], least: list[float], largest: list[float]) -> None:
    """Orders and, at the smallest spacing, errors."""
    order = orders(spacing, found)
    told = f"h {np.round(spacing, 4)}, errors {np.round(found, 5).tolist()}, orders {order.round(2)}"
    print(told)
    assert (order > least).all() and (found[-1] < np.array(largest)).all(), told


# ------------------------------------------------------------------------------------------------- a nucleus alone


# Orders and last errors are those of `errors`.  The stress is that after one period of the mode.  The start excites
# sound, which the default damping quiets: without it the whole stress is noise, and its deviator is as good.
# measured orders 1.41, 1.20, 1.73, 1.81 and last errors 0.098, 0.040, 0.012, 0.013 in rings;
# 1.59, 1.66, 1.55, 1.79 and 0.077, 0.026, 0.014, 0.013 irregular
@pytest.mark.parametrize("layout", LAYOUTS)
def test_stress_of_a_disc_that_rings_in_its_slowest_mode_converges(layout: str) -> None:
    spacing, found, size = [], [], 1e-6
    for count in COUNTS:
        with built(disc(layout, count, *DAMPED)) as sim:
            mode = Ringing(sim.scene.materials[0], NUCLEUS)
            u, exact = mode.fields(sim.scene.X)
            set_motion(sim, size * u, np.zeros_like(u))
            sim.sample()  # F is made anew
            sim.go(2.0 * np.pi / mode.frequency)
            spacing.append(sim.scene.templates[0].spacing)
            found.append(errors(sim.scene.field("V"), stress(sim), size * exact))
    check(spacing, found, [1.1, 1.0, 1.3, 1.5], [0.13, 0.06, 0.018, 0.018])


# Bulk and shear modulus are as 148 to 1 and J = 1 in the solution: what locks would show.
# measured orders 1.40, 1.38, 1.65, 1.61 and last errors 0.080, 0.031, 0.0084, 0.0076 in rings;
# 1.79, 1.73, 1.44, 1.53 and 0.068, 0.022, 0.010, 0.0077 irregular
@pytest.mark.parametrize("layout", LAYOUTS)
def test_stress_in_equilibrium_at_finite_strain_converges(layout: str) -> None:
    spacing, found = [], []
    for count in COUNTS:
        with built(disc(layout, count)) as sim:
            X, V, law = sim.scene.X, sim.scene.field("V"), sim.scene.materials[0]
            x, F = sheared(X, 0.08, 1.6)

            def P(X: np.ndarray, law: Any = law) -> np.ndarray:
                return np.array(law.stress(sheared(X, 0.08, 1.6)[1])).transpose(2, 0, 1)

            load = loads(X, sim.scene.surface(0), P) - V[:, None] * divergence(P, X)
            assert equilibrium(sim, load, x - X) < 1e-9
            spacing.append(sim.scene.templates[0].spacing)
            found.append(errors(V, stress(sim), cauchy(law, F, np.zeros_like(F))))
    check(spacing, found, [1.1, 1.1, 1.2, 1.3], [0.1, 0.04, 0.014, 0.01])
    assert all(recovered < 0.6 * nodal for nodal, recovered, *_ in found)  # the pressure's noise; measured 0.31 to 0.41


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_nucleus_under_the_pressure_of_laplace_has_the_same_stress_everywhere(layout: str) -> None:
    with built(disc(layout, 200)) as sim:
        law, pressure, n = sim.scene.materials[0], 200.0 / NUCLEUS, sim.scene.size  # of a line tension of 200 pN/µm

        def P(stretch: float) -> float:
            return float(law.stress(stretch * np.eye(2)[:, :, None])[0][0][0])

        stretch = brentq(lambda a: P(a) + pressure * a, 0.9, 1.1, xtol=1e-15)
        load = loads(sim.scene.X, sim.scene.surface(0), lambda X: np.tile(P(stretch) * np.eye(2), (len(X), 1, 1)))
        assert equilibrium(sim, load, np.zeros((n, 2))) < 1e-9  # measured 4e-12
        for found in stress(sim):
            assert np.abs(found[:, :2, :2] + pressure * np.eye(2)).max() < 1e-9 * pressure  # measured 4e-12


# ------------------------------------------------------------------------------------------- a nucleus in a fluid cell


# Nucleus nodal, recovered, fluid nodal, recovered: measured orders 2.14, 1.87, 1.62, 1.70 and last errors 0.0036,
# 0.0068, 0.011, 0.013 in rings; 2.00, 1.86, 1.67, 1.75 and the same irregular
@pytest.mark.parametrize("layout", LAYOUTS)
def test_deviator_of_a_prescribed_deformation_and_flow_converges_in_nucleus_and_fluid(layout: str) -> None:
    """The pressure is not asked for: where J is prescribed, the bulk modulus takes its error a thousandfold."""
    spacing, found, size, wave, rate, h = [], [], 0.2, 0.6, 0.1, 1e-5
    for count in (331, 631, 1485):
        with built(disc(layout, count, base="one_cell", radius=CELL)) as sim:
            X, V = sim.scene.X, sim.scene.field("V")
            (x1, F1), (x2, F2), (x, F) = (sheared(X, a, wave) for a in (size - h, size + h, size))
            set_motion(sim, x - X, rate * (x2 - x1) / (2.0 * h))
            s, errs = stress(sim), []
            for i, law in enumerate(sim.scene.materials):
                on = sim.scene.material == i
                exact = cauchy(law, F[..., on], rate * (F2 - F1)[..., on] / (2.0 * h))
                errs += errors(V[on], Stress(s.nodal[on], s.recovered[on]), exact)[2:]
            spacing.append(sim.scene.templates[0].spacing)
            found.append(errs)
    check(spacing, found, [1.5] * 4, [0.006, 0.01, 0.016, 0.018])


CREEP = 10.0  # µs


def squeezed(layout: str, count: int) -> tuple[float, list[float]]:
    """Spacing, and the errors in the nucleus of a fluid cell in a straining flow after a creep."""
    with built(disc(layout, count, base="one_cell", radius=CELL)) as sim:
        X, t = sim.scene.X, sim.scene.templates[0]
        fluid, solid = t.laws
        V, on, K = t.V[t.nucleus], t.nucleus, fluid.reduced_bulk_modulus
        G = solid.shear_modulus, fluid.viscosity / CREEP
        nu, size = (poisson(solid), 0.5 * K / (K + G[1])), 1e-5 * G[1]
        exact = size * inclusion(X, RATIO * CELL, G, nu)
        load = loads(X, sim.scene.surface(0), lambda X: size * inclusion(X, RATIO * CELL, G, nu)[:, :2, :2])
        assert equilibrium(sim, load, np.zeros_like(X), CREEP, rounds=3) < 1e-4  # measured 5e-6
        true, out = effective(exact[on])[0], []
        for s in stress(sim):
            out += [norm(V, deviator(s - exact)[on]) / norm(V, exact[on]),
                    np.average(effective(s[on]), weights=V) / true - 1.0, scatter(X[on], s[on]) / true]
        return t.spacing, out


def scatter(X: np.ndarray, s: np.ndarray) -> float:
    """Of the deviator about its linear fit, root mean square [Pa]."""
    p, values = np.column_stack([np.ones(len(X)), X]), deviator(s).reshape(len(X), -1)
    return float(np.sqrt(((values - p @ np.linalg.lstsq(p, values, rcond=None)[0]) ** 2).sum(axis=1).mean()))


# Of each, nodal and recovered: L2 error of the deviator, excess of the mean effective stress, scatter about the linear
# fit (all relative to the exact stress, which is uniform).
# measured orders 0.72, 1.06, 0.67 and 0.67, 1.15, 0.49, last values 0.55, 0.19, 0.42 and 0.54, 0.24, 0.40 in rings;
# 0.76, 1.06, 0.67 and 0.74, 1.20, 0.49, 0.57, 0.19, 0.47 and 0.56, 0.24, 0.44 irregular
@pytest.mark.parametrize("layout", LAYOUTS)
def test_stress_of_a_nucleus_in_a_fluid_that_is_squeezed_converges(layout: str) -> None:
    """The kink of the velocity at the interface, smeared over a spacing, costs an order."""
    spacing, found = zip(*(squeezed(layout, count) for count in (400, 631, 1485)), strict=True)
    check(list(spacing), list(found), [0.5, 0.8, 0.35] * 2, [0.75, 0.3, 0.6] * 2)


# ------------------------------------------------------------------------------------------------- a cell that spreads


def spread(count: int) -> tuple[float, dict[str, np.ndarray]]:
    """Spacing, and effective stresses over 40 to 100 µs as one cell of the paper spreads alone.

    Means over volume of the nucleus (nodal, recovered) and of the cytoplasm's lowest quarter (recovered); that of the
    mean stress of the nucleus; standard deviation within the nucleus.
    """
    with built(case("one_cell", per_cell=count)) as sim:
        t, X, seen = sim.scene.templates[0], sim.scene.X, []
        V, inner = t.V[t.nucleus], t.nucleus
        for time in np.arange(40.0, 100.25, 0.5):
            sim.go(float(time))
            nodal, recovered = stress(sim)
            y = (X + everywhere(sim, sim.mechanics.state.owned[:, :2]))[:, 1]
            low = ~inner & (y < y.min() + 0.25 * np.ptp(y))
            seen.append([np.average(effective(nodal[inner]), weights=V),
                         np.average(effective(recovered[inner]), weights=V),
                         effective(np.average(recovered[inner], axis=0, weights=V)[None])[0],
                         effective(recovered[inner]).std(), np.average(effective(recovered[low]), weights=t.V[low])])
        names = ("nucleus, nodal", "nucleus", "of its mean stress", "scatter in it", "bottom")
        return t.spacing, dict(zip(names, np.transpose(seen), strict=True))


def told_of(series: np.ndarray) -> str:
    """Mean ± standard error, from means over 10 µs."""
    blocks = [part.mean() for part in np.array_split(series, 6)]
    return f"{series.mean():.2f} ± {np.std(blocks, ddof=1) / np.sqrt(6):.2f}"


# measured at these numbers of particles: nucleus 6.9, 6.8, 3.3, 2.8, 2.2, of its mean stress 4.2, 3.7, 2.3, 2.1, 1.7;
# bottom 6.3, 5.5, 5.2, 4.4, 4.9, where single snaps of the contact line weigh; its median 3.31, 3.15, 3.39, 3.30, 3.31
@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_stress_of_a_cell_that_spreads_settles_in_the_cytoplasm_and_falls_in_the_nucleus_with_the_spacing() -> None:
    spacing, found = zip(*(spread(count) for count in (331, 631, 1485, 3000, 6000)), strict=True)  # a minute
    medians = [np.median(f["bottom"]) for f in found]
    for h, f, median in zip(spacing, found, medians, strict=True):
        print(f"h {h:.3f}:", *(f"{name} {told_of(values)}," for name, values in f.items()), f"its median {median:.2f}")
    mean = {name: np.array([f[name].mean() for f in found]) for name in found[0]}
    assert 0.5 < orders(spacing, mean["nucleus"]) < 1.2  # measured 0.88: no limit but zero in sight
    assert 0.4 < orders(spacing, mean["of its mean stress"]) < 0.9  # measured 0.64
    assert (mean["nucleus"] < mean["nucleus, nodal"]).all()
    assert np.ptp(medians) < 0.15 * np.mean(medians)  # measured 0.07
