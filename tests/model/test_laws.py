"""Laws: stress is the gradient of energy, no frame is preferred, exact values hold, and C computes what Python says.

Every registered law is tested; `scenes.example` gives it parameters.
"""

from __future__ import annotations

import ctypes
import dataclasses
import inspect
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy import arctan, cbrt, cos, cosh, exp, log, maximum, minimum, sin, sinh, sqrt, tan, tanh, where
from scenes import example
from scipy.integrate import quad
from scipy.optimize import brentq

from cellmig.case.pointwise import pointwise
from cellmig.case.registry import laws
from cellmig.kernel.codegen import SHAPES, LawError, Translator
from cellmig.kernel.kernel import VECTORS
from cellmig.kernel.toolchain import compiled
from cellmig.model.director import STARTS, start_angle
from cellmig.solve.tangent import derivative

MATERIALS, ADHESIONS, PROTRUSIONS = (list(laws(kind)) for kind in ("material", "adhesion", "protrusion"))


def with_method(method: str) -> list[str]:
    """Materials that have a method; some do, or it has another name now, and its tests would test nothing."""
    found = [name for name in MATERIALS if hasattr(laws("material")[name], method)]
    assert found, f"no material has '{method}'"
    return found


def deformations(n: int = 200) -> np.ndarray:
    """Random F (2, 2, n) with stretch, shear and rotation: 0.3 < J, turns up to half a circle."""
    rng = np.random.default_rng(1)
    F = np.eye(2)[:, :, None] + 0.35 * rng.standard_normal((2, 2, 3 * n))
    F = F[:, :, F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0] > 0.3][:, :, :n]
    assert F.shape[2] == n
    return np.einsum("ijn,jkn->ikn", rotations(n), F)


def rotations(n: int, seed: int = 2) -> np.ndarray:
    a = np.random.default_rng(seed).uniform(-np.pi, np.pi, n)
    return np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])


def rates(n: int = 200) -> np.ndarray:
    return np.random.default_rng(3).standard_normal((2, 2, n))


def vectors(n: int = 200) -> np.ndarray:
    return np.random.default_rng(4).standard_normal((2, n))


def stress(law: Any, F: np.ndarray, Fdot: np.ndarray | None = None) -> np.ndarray:
    """P of energy and, with Fdot, of viscosity."""
    P = np.array(pointwise(law, "stress", {"F": F}))
    return P + viscous(law, F, Fdot) if Fdot is not None and hasattr(law, "viscous_stress") else P


def viscous(law: Any, F: np.ndarray, Fdot: np.ndarray) -> np.ndarray:
    return np.array(pointwise(law, "viscous_stress", {"F": F, "Fdot": Fdot}))


def determinant(F: np.ndarray) -> np.ndarray:
    return F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]


def cauchy(P: np.ndarray, F: np.ndarray) -> np.ndarray:
    return np.einsum("ikn,jkn->ijn", P, F) / determinant(F)


def slope(function: Any, x: np.ndarray, step: float) -> np.ndarray:
    """Derivative to fourth order in the step."""
    near, far = function(x + step) - function(x - step), function(x + 2 * step) - function(x - 2 * step)
    return (8 * near - far) / (12 * step)


def gradient(function: Any, A: np.ndarray, step: float = 3e-4) -> np.ndarray:
    """Derivative of a scalar function by every component of A."""
    out = np.empty_like(A)
    for i in np.ndindex(A.shape[:-1]):
        direction = np.zeros_like(A)
        direction[i] = 1.0
        out[i] = slope(lambda s, d=direction: function(A + s * d), 0.0, step)
    return out


def assert_close(a: Any, b: Any, tolerance: float) -> None:
    """Equal to `tolerance` of the largest value, which is not zero."""
    scale = np.abs(b).max()
    assert scale > 0.0
    assert np.abs(np.asarray(a) - b).max() <= tolerance * scale, f"{np.abs(np.asarray(a) - b).max() / scale:.2e}"


# ---------------------------------------------------------------------------------------------------- any material


@pytest.mark.parametrize("name", MATERIALS)
def test_stress_is_the_gradient_of_energy(name: str) -> None:
    law, F = example("material", name), deformations()
    # measured 5e-12; S Fᵀ in place of F S would be off by order 1
    assert_close(gradient(law.energy, F), stress(law, F), 1e-10)


@pytest.mark.parametrize("name", MATERIALS)
def test_energy_is_the_same_in_any_frame(name: str) -> None:
    law, F = example("material", name), deformations()
    turned = np.einsum("ijn,jkn->ikn", rotations(F.shape[2], 5), F)
    assert_close(law.energy(turned), law.energy(F), 1e-13)  # measured 1e-15


@pytest.mark.parametrize("name", MATERIALS)
def test_stress_turns_with_the_frame(name: str) -> None:
    law, F, Fdot = example("material", name), deformations(), rates()
    Q = rotations(F.shape[2], 5)
    spin = 0.8 * np.einsum("ijn,jkn->ikn", Q, np.array([[0.0, -1.0], [1.0, 0.0]])[:, :, None])  # dQ/dt
    turned = np.einsum("ijn,jkn->ikn", Q, F)
    turning = np.einsum("ijn,jkn->ikn", Q, Fdot) + np.einsum("ijn,jkn->ikn", spin, F)
    expected = np.einsum("ijn,jkn->ikn", Q, stress(law, F, Fdot))
    assert_close(stress(law, turned, turning), expected, 1e-13)  # measured 7e-16


@pytest.mark.parametrize("name", MATERIALS)
def test_cauchy_stress_is_symmetric(name: str) -> None:
    law, F = example("material", name), deformations()
    s = cauchy(stress(law, F, rates()), F)
    assert_close(s[0, 1], s[1, 0], 1e-13)  # measured 8e-16


@pytest.mark.parametrize("name", MATERIALS)
def test_nothing_is_stressed_at_rest(name: str) -> None:
    law, I = example("material", name), np.eye(2)[:, :, None]
    scale = law.bulk_modulus + law.shear_modulus
    assert np.abs(stress(law, I)).max() <= 1e-15 * scale  # measured 0
    assert abs(law.out_of_plane(I)) <= 1e-15 * scale
    assert abs(law.energy(I)) <= 1e-15 * scale


@pytest.mark.parametrize("name", MATERIALS)
def test_energy_is_least_at_rest(name: str) -> None:
    """By as much as its moduli say: an energy of nothing would not do."""
    law, F = example("material", name), deformations()
    assert abs(law.energy(np.eye(2)[:, :, None])[0]) < 1e-9 * law.density  # measured 0
    J = F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]
    modulus = getattr(law, "reduced_bulk_modulus", law.bulk_modulus)
    shape = (F**2).sum(axis=(0, 1)) / J - 2.0
    sheared = law.energy(F / np.sqrt(J))
    assert (law.energy(F) > 0.2 * modulus * np.log(J) ** 2).all()  # measured 0.26 at least
    assert (sheared >= 0.4 * law.shear_modulus * shape).all()  # measured 0.5


def test_the_pressure_of_the_fluid_is_that_of_the_page_of_the_model() -> None:
    law, J = example("material", "nematic"), np.array([0.7, 1.0, 1.3])
    F = np.sqrt(J) * np.eye(2)[:, :, None]
    k, p = law.reduced_bulk_modulus, -stress(law, F)[0, 0] / np.sqrt(J)  # P = -J p F⁻ᵀ
    assert np.abs(p + 0.5 * k * (J - 1.0 / J)).max() < 1e-12 * k  # measured 1e-16
    page = (Path(__file__).resolve().parents[2] / "docs/model.md").read_text(encoding="utf-8")
    assert "p = −k (J − 1/J) / 2" in page and "K ln J" not in page


@pytest.mark.parametrize("name", MATERIALS)
def test_moduli_at_rest_are_those_that_the_law_states(name: str) -> None:
    law, h = example("material", name), 1e-5
    shear = np.array([[1.0, h], [0.0, 1.0]])[:, :, None]
    dilation = ((1.0 + 0.5 * h) * np.eye(2))[:, :, None]
    modulus = law.bulk_modulus if not hasattr(law, "reduced_bulk_modulus") else law.reduced_bulk_modulus
    assert stress(law, shear)[0, 1, 0] / h == pytest.approx(law.shear_modulus, rel=1e-4, abs=1e-9)
    # in the plane the response to dilation is K + G/3; measured 1e-5
    assert stress(law, dilation)[0, 0, 0] / h == pytest.approx(modulus + law.shear_modulus / 3.0, rel=1e-4)


@pytest.mark.parametrize("name", with_method("viscous_stress"))
def test_viscous_stress_loses_what_the_rate_of_deformation_says(name: str) -> None:
    law, F, Fdot = example("material", name), deformations(), rates()
    L = np.einsum("ijn,njk->ikn", Fdot, np.linalg.inv(F.transpose(2, 0, 1)))
    d = 0.5 * (L + L.transpose(1, 0, 2))
    loss = 2.0 * law.viscosity * determinant(F) * (d**2).sum(axis=(0, 1))
    assert_close((viscous(law, F, Fdot) * Fdot).sum(axis=(0, 1)), loss, 1e-12)  # measured 2e-15


@pytest.mark.parametrize("name", with_method("viscous_stress"))
def test_rigid_rotation_meets_no_viscosity(name: str) -> None:
    law, F = example("material", name), deformations()
    spin = np.einsum("ij,jkn->ikn", np.array([[0.0, -1.0], [1.0, 0.0]]), F)
    assert np.abs(viscous(law, F, spin)).max() <= 1e-13 * np.abs(viscous(law, F, F)).max()  # measured 4e-16


@pytest.mark.parametrize("name", with_method("director_stress"))
def test_director_stress_is_the_gradient_of_its_energy(name: str) -> None:
    law, F, g = example("material", name), deformations(), vectors()
    energy, P = (lambda A: law.director_energy(A, g)), np.array(law.director_stress(F, g))
    assert_close(gradient(energy, F), P, 1e-10)  # measured 7e-12


@pytest.mark.parametrize("name", with_method("director_flux"))
def test_director_flux_is_the_derivative_by_the_gradient(name: str) -> None:
    law, F, g = example("material", name), deformations(), vectors()
    energy, flux = (lambda a: law.director_energy(F, a)), np.array(law.director_flux(F, g))
    assert_close(gradient(energy, g), flux, 1e-10)  # measured 4e-13


@pytest.mark.parametrize("name", with_method("director_stress"))
def test_director_stress_is_equation_7(name: str) -> None:
    law, F, g = example("material", name), deformations(), vectors()
    inverse = np.linalg.inv(np.moveaxis(F, 2, 0))
    now = np.einsum("nji,jn->in", inverse, g)  # current gradient of θ
    h = np.array([np.cos(0.3), np.sin(0.3)]), np.array([-np.sin(0.3), np.cos(0.3)])
    dh = np.einsum("k,jn->kjn", h[1], now)  # ∂h_k/∂x_j for θ = 0.3
    expected = -law.eta / determinant(F) * np.einsum("kin,kjn->ijn", dh, dh)
    assert_close(cauchy(np.array(law.director_stress(F, g)), F), expected, 1e-13)  # measured 5e-16


@pytest.mark.parametrize("name", with_method("active_stress"))
def test_active_stress_pulls_along_the_director(name: str) -> None:
    law, F, a = example("material", name), deformations(), np.linspace(0, 3, 200)
    h = np.array([np.cos(a), np.sin(a)])
    s = cauchy(np.array(law.active_stress(F, h)), F)
    assert_close(s, -law.zeta * h[:, None] * h[None], 1e-13)  # measured 3e-16


# --------------------------------------------------------------------------------------------- the paper's nucleus


@pytest.fixture(scope="module")
def nucleus() -> Any:
    return laws("material")["mooney-rivlin"](C1=2126.0, C2=170.0, lame=170e3)


@pytest.mark.parametrize("shear", [-1.0, 0.01, 0.4, 2.0])
def test_nucleus_in_simple_shear_has_the_exact_stress(nucleus: Any, shear: float) -> None:
    F = np.array([[1.0, shear], [0.0, 1.0]])[:, :, None]
    s, C1, C2 = cauchy(stress(nucleus, F), F)[:, :, 0], nucleus.C1, nucleus.C2
    scale = C1 * max(abs(shear), shear**2)
    assert s[0, 1] == pytest.approx(2 * (C1 + C2) * shear, rel=1e-12)
    assert s[0, 0] == pytest.approx(2 * (C1 + C2) * shear**2, abs=1e-12 * scale)
    assert s[1, 1] == pytest.approx(0.0, abs=1e-12 * scale)
    assert nucleus.out_of_plane(F)[0] == pytest.approx(2 * C2 * shear**2, abs=1e-12 * scale)


@pytest.mark.parametrize("J", [0.5, 0.9, 1.1, 2.0])
def test_nucleus_in_dilation_has_the_exact_pressure(nucleus: Any, J: float) -> None:
    F = (np.sqrt(J) * np.eye(2))[:, :, None]
    s = cauchy(stress(nucleus, F), F)[:, :, 0]
    mean = (s[0, 0] + s[1, 1] + nucleus.out_of_plane(F)[0]) / 3.0
    # Dilation within the plane is no dilation in space: to -4 λ ln J/J come the traces of the two shape terms.
    I1, I2 = 2 * J + 1, J**2 + 2 * J
    shape = 2 / (3 * J) * (nucleus.C1 * (I1 - 3 * J ** (2 / 3)) + 2 * nucleus.C2 * (I2 - 3 * J ** (4 / 3)))
    assert mean - shape == pytest.approx(4 * nucleus.lame * np.log(J) / J, rel=1e-12)


@pytest.mark.parametrize(("stretch", "exact"), [(0.5, -33047.494), (1.5, 5517.176), (2.0, 8604.150)])
def test_nucleus_stretched_in_plane_strain_carries_the_exact_force(nucleus: Any, stretch: float, exact: float) -> None:
    def deformed(across: float) -> np.ndarray:
        return np.diag([stretch, across])[:, :, None]

    across = brentq(lambda b: stress(nucleus, deformed(b))[1, 1, 0], 0.3, 3.0, xtol=1e-15, rtol=1e-14)
    F = deformed(across)
    assert stress(nucleus, F)[0, 0, 0] == pytest.approx(exact, abs=6e-4)  # nominal; the values have 3 decimals


# ------------------------------------------------------------------------------------------------------- adhesion


def distances(law: Any) -> np.ndarray:
    """Through cap and well to past the cutoff, without those two points."""
    far = np.geomspace(3.01 * law.range, 1.5 * law.cutoff)
    r = np.concatenate([np.linspace(-0.5, 3.0, 701) * law.range + 1.7e-6, far])
    return r[(abs(r - law.cap) > 1e-4 * law.range) & (abs(r - law.cutoff) > 1e-3 * law.range)]


@pytest.mark.parametrize("name", ADHESIONS)
def test_slope_is_the_derivative_of_the_potential(name: str) -> None:
    law = example("adhesion", name)
    r = distances(law)
    assert_close(slope(law.potential, r, 2e-5 * law.range), law.slope(r), 1e-10)  # measured 1.2e-11


@pytest.mark.parametrize("name", ADHESIONS)
def test_potential_is_the_derivative_of_the_primitive(name: str) -> None:
    law = example("adhesion", name)
    r = distances(law)
    assert_close(slope(law.primitive, r, 2e-5 * law.range), law.potential(r), 1e-10)  # measured 9e-12


@pytest.mark.parametrize("name", ADHESIONS)
def test_potential_is_twice_differentiable_at_the_cap_and_once_at_the_cutoff(name: str) -> None:
    law = example("adhesion", name)
    h = 1e-7 * law.range
    scale = law.energy
    for function, at, unit in ((law.potential, law.cap, 1.0), (law.slope, law.cap, 1 / law.range),
                               (law.potential, law.cutoff, 1.0), (law.slope, law.cutoff, 1 / law.range),
                               (law.primitive, law.cap, law.range), (law.primitive, law.cutoff, law.range)):
        step = abs(function(at + h) - function(at - h))
        assert step <= 2e-5 * scale * unit  # measured 1.1e-5: curvature 47 σ/ε² times 2 h
    steps = -1e-4 * law.range, 1e-4 * law.range
    second = [(law.slope(law.cap + s) - law.slope(law.cap)) / s for s in steps]
    assert second[0] == pytest.approx(second[1], rel=1e-3)  # measured 6e-4, a third derivative times the step
    assert second[0] == pytest.approx(law.stiffness(0.0) / law.bonds, rel=1e-3)
    beyond = np.array([law.cutoff, 1.01 * law.cutoff, 1e3])
    assert not law.potential(beyond).any() and not law.slope(beyond).any() and not law.primitive(beyond).any()


@pytest.mark.parametrize("name", ADHESIONS)
def test_stiffness_is_the_largest_curvature(name: str) -> None:
    law = example("adhesion", name)
    r = distances(law)
    curvature = slope(law.slope, r, 2e-5 * law.range)
    assert curvature.max() * law.bonds == pytest.approx(law.stiffness(0.0), rel=1e-6)
    for least in (0.85 * law.range, law.range, 1.1 * law.range):  # of a contact whose gaps are all at least this
        assert curvature[r >= least].max() * law.bonds <= law.stiffness(least) * (1 + 1e-9)
        assert slope(law.slope, np.array([least]), 2e-5 * law.range)[0] * law.bonds == pytest.approx(
            law.stiffness(least), rel=1e-6)


@pytest.mark.parametrize("attraction", [0.0, 0.3])
def test_repulsion_without_all_of_the_attraction_has_a_potential(attraction: float) -> None:
    law = dataclasses.replace(example("adhesion", "seifert"), attraction=attraction)
    r = distances(law)
    r = r[np.abs(r - law.range) > 1e-4 * law.range]
    assert_close(slope(law.potential, r, 2e-5 * law.range), law.slope(r), 1e-10)  # measured 1.3e-11
    assert_close(slope(law.primitive, r, 2e-5 * law.range), law.potential(r), 1e-10)  # measured 1e-11
    h = 1e-7 * law.range
    for function, unit in ((law.potential, 1.0), (law.slope, 1 / law.range), (law.primitive, law.range)):
        assert abs(function(law.range + h) - function(law.range - h)) <= 2e-5 * law.energy * unit
    assert law.potential(law.range) == pytest.approx(-attraction * law.energy, rel=2.4e-3, abs=1e-18)
    assert (law.slope(r[r < 0.999 * law.range]) < 0.0).all()
    assert attraction or not law.slope(r[r > law.range]).any()


@pytest.mark.parametrize("bonds", [0.0, 10.0, 5000.0])
def test_bodies_repel_each_other_however_few_bonds_they_have(bonds: float) -> None:
    law = dataclasses.replace(example("adhesion", "seifert"), bonds=bonds)
    solid = law.solid
    assert solid.work == pytest.approx(law.work, rel=1e-14)
    assert solid.bonds * solid.energy >= 24.0  # pN/µm
    r = np.linspace(1.0, 5.0) * law.range
    pull, scale = solid.bonds * solid.slope(r), 240.0 / law.range
    assert np.abs(pull - bonds * law.slope(r)).max() < 1e-14 * scale  # measured 1e-17


def test_seifert_well_has_its_depth_at_the_equilibrium_distance() -> None:
    law = example("adhesion", "seifert")
    least = brentq(law.slope, 0.9 * law.range, 1.2 * law.range, xtol=1e-18, rtol=1e-14)
    # lowering the potential to zero with zero slope at 0.5 µm shifts the minimum by cut slope/(8 σ/ε²) = 4e-6 ε …
    assert least == pytest.approx(law.range, rel=5e-6)
    # … and takes 0.237 % of the depth; without the cutoff it is σ
    assert law.potential(law.range) == pytest.approx(-law.energy, rel=2.4e-3)
    assert law.pair(law.range) == pytest.approx(-law.energy, rel=1e-15)
    assert law.pair_slope(law.range) == 0.0


def test_seifert_pulls_hardest_where_the_paper_says() -> None:
    law = example("adhesion", "seifert")
    r = np.linspace(1.0, 2.0, 20001) * law.range
    traction = law.bonds * law.pair_slope(r)
    assert r[np.argmax(traction)] / law.range == pytest.approx((5 / 3) ** 0.5, abs=1e-4)  # 1.291
    assert traction.max() * 1e-3 == pytest.approx(17.85, abs=0.01)  # kPa


# ----------------------------------------------------------------------------------------------------- protrusion


@pytest.mark.parametrize("name", PROTRUSIONS)
def test_push_is_the_slope_of_its_ramp_and_acts_at_the_edge_only(name: str) -> None:
    law = example("protrusion", name)
    g = np.linspace(-0.5, 1.5, 400) * law.height
    assert_close(slope(law.ramp, g, 1e-5 * law.height), law.ramp_slope(g), 1e-10)  # measured 1.3e-11
    assert law.ramp(g).min() == 0.0 and law.ramp(g).max() == 1.0
    assert law.ramp_slope(g).min() >= 0.0
    assert not law.ramp_slope(np.array([-1.0, 0.0, law.height, 2 * law.height])).any()
    assert quad(law.ramp_slope, 0, law.height)[0] == pytest.approx(1.0, rel=1e-12)


# ------------------------------------------------------------------------------------------------------- director


@pytest.mark.parametrize("start", STARTS)
def test_director_starts_as_its_name_says(start: str) -> None:
    X, centre = np.random.default_rng(6).standard_normal((50, 2)), np.array([0.3, -0.2])
    theta = start_angle(start, 0.7, X, centre)
    h, r = np.array([np.cos(theta), np.sin(theta)]), (X - centre).T / np.linalg.norm(X - centre, axis=1)
    along, across = (h * r).sum(axis=0), h[1] * r[0] - h[0] * r[1]
    expected = {"radial": along - 1.0, "tangential": across - 1.0, "uniform": theta - 0.7}[start]
    assert np.abs(expected).max() < 1e-14


# ------------------------------------------------------------------------------------------------- translated to C


def in_c(law: Any, method: str, number: str, arguments: dict[str, np.ndarray]) -> np.ndarray:
    """Results of the C function of a method, for arguments (..., n) with n a multiple of four."""
    translator = Translator(law, number)
    function = translator.function(method, "translated")
    shapes = {a: SHAPES.get(a, ()) for a in arguments}
    result = np.asarray(getattr(law, method)(*arguments.values()))
    out, n = np.zeros_like(result), result.shape[-1]
    lanes = 4 if number == "v4" else 1
    passed, lines = [], []
    for name, shape in shapes.items():
        lines.append(f"{number} {name}{''.join(f'[{k}]' for k in shape)};")
        lines.append(f"memcpy(&{name}, in_{name} + i * {int(np.prod(shape))}, sizeof {name});")
        # groups of four (or one) values, component by component
        passed.append(np.ascontiguousarray(np.moveaxis(arguments[name].reshape(*shape, -1, lanes), -2, 0)))
    call = ", ".join(["p", *[f"(const {number} (*)[2]){a}" if len(s) == 2 else a for a, s in shapes.items()]])
    many = result.ndim - 1
    size = int(np.prod(result.shape[:-1]))
    lines.append(f"{number} result{''.join(f'[{k}]' for k in result.shape[:-1])};")
    lines.append(f"translated({call}, result);" if many else f"result = translated({call});")
    lines.append(f"memcpy(out + i * {size}, &result, sizeof result);")
    signature = ", ".join(f"const double *in_{a}" for a in shapes)
    source = "\n".join([
        VECTORS.read_text(encoding="utf-8"), function,
        f"void run(long n, const double *p, {signature}, double *out) {{",
        f"    for (long i = 0; i < n; i += {lanes}) {{", *["        " + line for line in lines], "    }\n}\n"])
    raw = np.zeros((n // lanes, *result.shape[:-1], lanes))
    p = np.array(translator.vector() or [0.0])
    addresses = [ctypes.c_void_p(a.ctypes.data) for a in (p, *passed, raw)]
    ctypes.CDLL(str(compiled(source))).run(ctypes.c_long(n), *addresses)
    out[:] = np.moveaxis(raw, 0, -2).reshape(result.shape)
    return out


LIMIT = 0.25


class Formulas:
    """What a law's formula may have, one method for each; F and the rest are arguments as the translator knows them."""

    rate, least, whole = 0.7, 0.2, 3

    def exponential(self, r):
        return exp(-self.rate * r) + np.exp(-900.0 * r * r)

    def circular(self, r):
        return sin(r) + cos(2.0 * r) * tan(0.1 * r) - arctan(r)

    def hyperbolic(self, r):
        return tanh(r) + sinh(0.1 * r) / cosh(r)

    def powers(self, r):
        a = abs(r) + self.least
        return a**0.5 + a**-1.5 + a**3 + a**self.rate + 2.0**r + a**self.whole + r**2.0

    def chosen(self, r):
        return where(r > 0.0, exp(r), 1.0) + maximum(r, 0.0) * minimum(r, self.least) + where(self.rate < 1.0, r, 7.0)

    def constant(self, r):
        a = self.rate * 2.0
        return a + exp(self.rate) + pi + LIMIT

    def other(self, r):
        a, b = r, self.powers(r)
        return a * log(b) - sqrt(cbrt(b))


@pytest.mark.serial
@pytest.mark.parametrize("number", ["double", "v4"])
@pytest.mark.parametrize("method", [name for name in vars(Formulas) if inspect.isfunction(getattr(Formulas, name))])
def test_every_function_that_a_formula_may_have_is_the_same_in_c(method: str, number: str) -> None:
    r = np.linspace(-2.0, 2.0, 400)
    expected = getattr(Formulas(), method)(r) + np.zeros_like(r)
    translator = Translator(Formulas(), number)
    lanes = 4 if number == "v4" else 1
    source = "\n".join([VECTORS.read_text(encoding="utf-8"), translator.function(method, "translated"), f"""
        void run(long n, const double *p, const double *r, double *out) {{
            for (long i = 0; i < n; i += {lanes}) {{
                {number} x; memcpy(&x, r + i, sizeof x); x = translated(p, x); memcpy(out + i, &x, sizeof x); }} }}"""])
    out, p = np.zeros_like(r), np.array(translator.vector() or [0.0])
    addresses = [ctypes.c_void_p(a.ctypes.data) for a in (p, r, out)]
    ctypes.CDLL(str(compiled(source))).run(ctypes.c_long(len(r)), *addresses)
    assert np.abs(out - expected).max() <= 3e-15 * np.abs(expected).max()  # measured 1.3e-15, of v4_log


@pytest.mark.parametrize("method", [name for name in vars(Formulas) if inspect.isfunction(getattr(Formulas, name))])
def test_every_function_that_a_formula_may_have_has_its_derivative(method: str) -> None:
    r, function = np.linspace(-1.9, 1.93, 50), getattr(Formulas(), method)
    value, found = derivative(function, r)
    expected = slope(lambda x: function(x) + 0.0 * x, r, 1e-4)
    assert np.abs(found[0] - expected).max() < 1e-9 * max(1.0, np.abs(expected).max())  # measured 6e-11, of differences
    assert np.abs(value - function(r)).max() <= 1e-15 * np.abs(value).max()


class Wrong:
    """Formulas that are none."""

    rate, words = 1.0, "many"

    def unknown(self, r):
        return exp2(r)  # noqa: F821

    def loop(self, r):
        for _ in range(3):
            r = r * 2.0
        return r

    def wordy(self, r):
        return r * self.words

    def missing(self, r):
        return r * self.nothing

    def twice(self, r):
        return where(r > 0.0, r)

    def between(self, r):
        return where(0.0 < r < 1.0, r, 0.0)

    def endless(self, r):
        return self.endless(r)

    def silent(self, r):
        r = r * 2.0

    def name(self, r):
        return r * undefined  # noqa: F821

    def whole(self, r):
        return r // 2.0


@pytest.mark.parametrize(("method", "line", "what"), [
    ("unknown", 1, "'exp2(r)' is not translated to C; a formula has numbers"), ("loop", 1, "is no assignment"),
    ("wordy", 1, "'self.words' is no number"), ("missing", 1, "'self.nothing' is no number"),
    ("twice", 1, "where takes 3"), ("between", 1, "'0.0 < r < 1.0' is not translated"), ("endless", 0, "calls itself"),
    ("silent", 0, "returns nothing"), ("name", 1, "'undefined' is not translated"), ("whole", 1, "is not translated")])
def test_a_formula_that_cannot_be_translated_is_told_with_its_file_and_line(method: str, line: int, what: str) -> None:
    with pytest.raises(LawError) as error:
        Translator(Wrong(), "v4").function(method, "translated")
    number = inspect.getsourcelines(getattr(Wrong, method))[1] + line
    assert f"test_laws.py:{number}: Wrong.{method}: " in str(error.value) and what in str(error.value)


def pointwise_methods(kind: str) -> list[tuple[str, str]]:
    """(law, method) for all methods of formulas: those with arguments that the translator knows."""
    known = {"material": set(SHAPES), "adhesion": {"r"}, "protrusion": {"g"}}[kind]
    functions = [(name, method, set(inspect.signature(f).parameters) - {"self"}) for name, cls in laws(kind).items()
                 for method, f in inspect.getmembers(cls, inspect.isfunction) if not method.startswith(("_", "pair"))]
    return [(name, method) for name, method, arguments in functions if arguments and arguments <= known]


@pytest.mark.serial
@pytest.mark.parametrize(("name", "method"), pointwise_methods("material"))
def test_material_is_the_same_in_c(name: str, method: str) -> None:
    law, F, a = example("material", name), deformations(), np.linspace(0, 3, 200)
    given = {"F": F, "Fdot": rates(), "gradient": vectors(), "director": np.array([np.cos(a), np.sin(a)])}
    arguments = {k: given[k] for k in list(inspect.signature(getattr(type(law), method)).parameters)[1:]}
    expected = np.asarray(getattr(law, method)(*arguments.values()))
    assert_close(in_c(law, method, "v4", arguments), expected, 1e-13)  # measured 0; log and cbrt may round otherwise


@pytest.mark.serial
@pytest.mark.parametrize(("name", "method"), pointwise_methods("adhesion"))
def test_adhesion_is_the_same_in_c(name: str, method: str) -> None:
    law = example("adhesion", name)
    r = distances(law)
    assert_close(in_c(law, method, "double", {"r": r}), getattr(law, method)(r), 1e-14)  # measured 0


@pytest.mark.serial
@pytest.mark.parametrize(("name", "method"), pointwise_methods("protrusion"))
def test_protrusion_is_the_same_in_c(name: str, method: str) -> None:
    law = example("protrusion", name)
    g = np.linspace(-0.5, 1.5, 400) * law.height
    assert_close(in_c(law, method, "double", {"g": g}), getattr(law, method)(g), 1e-14)  # measured 0
