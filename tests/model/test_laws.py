"""Laws: stress is the gradient of energy, no frame is preferred, and exact values hold.

Every registered law is tested; `scenes.example` gives it parameters.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from samples import (
    assert_close,
    deformations,
    determinant,
    directions,
    distances,
    fractions,
    gradients,
    networks,
    rates,
    rotations,
    slope,
    spin,
)
from scenes import ROOT, example
from scipy.integrate import quad
from scipy.optimize import brentq

from cellmig.case.expression import Expression
from cellmig.case.pointwise import pointwise
from cellmig.case.registry import laws
from cellmig.model.director import STARTS, Anchor, initial

pytestmark = pytest.mark.serial

DIMENSIONS = pytest.mark.parametrize("d", [2, 3])
MATERIALS, ADHESIONS, PROTRUSIONS = (list(laws(kind)) for kind in ("material", "adhesion", "protrusion"))


def with_method(method: str) -> list[str]:
    """Materials that have a method; some do, or it has another name now, and its tests would test nothing."""
    found = [name for name in MATERIALS if hasattr(laws("material")[name], method)]
    assert found, f"no material has '{method}'"
    return found


def stress(law: Any, F: np.ndarray, Fdot: np.ndarray | None = None) -> np.ndarray:
    """P of energy and, with Fdot, of viscosity."""
    P = np.array(pointwise(law, "stress", {"F": F}))
    return P + viscous(law, F, Fdot) if Fdot is not None and hasattr(law, "viscous_stress") else P


def viscous(law: Any, F: np.ndarray, Fdot: np.ndarray) -> np.ndarray:
    return np.array(pointwise(law, "viscous_stress", {"F": F, "Fdot": Fdot}))


def cauchy(P: np.ndarray, F: np.ndarray) -> np.ndarray:
    return np.einsum("ikn,jkn->ijn", P, F) / determinant(F)


def gradient(function: Any, A: np.ndarray, step: float = 3e-4) -> np.ndarray:
    """Derivative of a scalar function by every component of A."""
    out = np.empty_like(A)
    for i in np.ndindex(A.shape[:-1]):
        direction = np.zeros_like(A)
        direction[i] = 1.0
        out[i] = slope(lambda s, d=direction: function(A + s * d), 0.0, step)
    return out


# ---------------------------------------------------------------------------------------------------- any material


@DIMENSIONS
@pytest.mark.parametrize("name", MATERIALS)
def test_stress_is_the_gradient_of_energy(name: str, d: int) -> None:
    law, F = example("material", name), deformations(d=d)
    # measured 7e-12; S Fᵀ in place of F S would be off by order 1
    assert_close(gradient(law.energy, F), stress(law, F), 1e-10)


@DIMENSIONS
@pytest.mark.parametrize("name", MATERIALS)
def test_energy_is_the_same_in_any_frame(name: str, d: int) -> None:
    law, F = example("material", name), deformations(d=d)
    turned = np.einsum("ijn,jkn->ikn", rotations(F.shape[2], 5, d), F)
    assert_close(law.energy(turned), law.energy(F), 1e-13)  # measured 2e-15


@DIMENSIONS
@pytest.mark.parametrize("name", MATERIALS)
def test_stress_turns_with_the_frame(name: str, d: int) -> None:
    law, F, Fdot = example("material", name), deformations(d=d), rates(d=d)
    Q = rotations(F.shape[2], 5, d)
    turn = 0.8 * np.einsum("ijn,jk->ikn", Q, spin(d))  # dQ/dt
    turned = np.einsum("ijn,jkn->ikn", Q, F)
    turning = np.einsum("ijn,jkn->ikn", Q, Fdot) + np.einsum("ijn,jkn->ikn", turn, F)
    expected = np.einsum("ijn,jkn->ikn", Q, stress(law, F, Fdot))
    assert_close(stress(law, turned, turning), expected, 1e-13)  # measured 1e-15


@DIMENSIONS
@pytest.mark.parametrize("name", MATERIALS)
def test_cauchy_stress_is_symmetric(name: str, d: int) -> None:
    law, F = example("material", name), deformations(d=d)
    s = cauchy(stress(law, F, rates(d=d)), F)
    assert_close(s, s.transpose(1, 0, 2), 1e-13)  # measured 8e-16


@DIMENSIONS
@pytest.mark.parametrize("name", MATERIALS)
def test_nothing_is_stressed_at_rest(name: str, d: int) -> None:
    law, I = example("material", name), np.eye(d)[:, :, None]
    scale = law.bulk_modulus + law.shear_modulus
    assert np.abs(stress(law, I)).max() <= 1e-15 * scale  # measured 0
    assert abs(law.out_of_plane(I)) <= 1e-15 * scale
    assert abs(law.energy(I)) <= 1e-15 * scale


@pytest.mark.parametrize("name", MATERIALS)
def test_plane_strain_is_space_with_a_third_stretch_of_one(name: str) -> None:
    law, F, Fdot = example("material", name), deformations(), rates()
    there, changing = np.zeros((2, 3, 3, F.shape[2]))
    there[:2, :2], there[2, 2], changing[:2, :2] = F, 1.0, Fdot
    P = stress(law, there, changing)
    assert_close(law.energy(there), law.energy(F), 1e-13)  # measured 1e-16
    assert_close(P[:2, :2], stress(law, F, Fdot), 1e-13)  # measured 0
    assert_close(P[2, 2] / determinant(F), law.out_of_plane(F), 1e-13)  # measured 6e-16
    assert not P[2, :2].any() and not P[:2, 2].any()


@pytest.mark.parametrize("name", MATERIALS)
def test_energy_is_least_at_rest(name: str) -> None:
    """By as much as its moduli say: an energy of nothing would not do."""
    law, F = example("material", name), deformations()
    assert abs(law.energy(np.eye(2)[:, :, None])[0]) < 1e-9 * law.density  # measured 0
    J = determinant(F)
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
    page = (ROOT / "docs/model.md").read_text(encoding="utf-8")
    assert "p = −k (J − 1/J) / 2" in page and "K ln J" not in page


@pytest.mark.parametrize("name", MATERIALS)
def test_moduli_at_rest_are_those_that_the_law_states(name: str) -> None:
    law, h = example("material", name), 1e-5
    shear = np.array([[1.0, h], [0.0, 1.0]])[:, :, None]
    dilation = ((1.0 + 0.5 * h) * np.eye(2))[:, :, None]
    wave = law.density * law.sound_speed**2  # P-wave modulus K + 4 G/3
    assert stress(law, shear)[0, 1, 0] / h == pytest.approx(law.shear_modulus, rel=1e-4, abs=1e-9)
    # in the plane the response to dilation is K + G/3; measured 1e-5
    assert stress(law, dilation)[0, 0, 0] / h == pytest.approx(wave - law.shear_modulus, rel=1e-4)


@DIMENSIONS
@pytest.mark.parametrize("name", with_method("viscous_stress"))
def test_viscous_stress_loses_what_the_rate_of_deformation_says(name: str, d: int) -> None:
    law, F, Fdot = example("material", name), deformations(d=d), rates(d=d)
    L = np.einsum("ijn,njk->ikn", Fdot, np.linalg.inv(F.transpose(2, 0, 1)))
    rate = 0.5 * (L + L.transpose(1, 0, 2))
    loss = 2.0 * law.viscosity * determinant(F) * (rate**2).sum(axis=(0, 1))
    assert_close((viscous(law, F, Fdot) * Fdot).sum(axis=(0, 1)), loss, 1e-12)  # measured 2e-15


@DIMENSIONS
@pytest.mark.parametrize("name", with_method("viscous_stress"))
def test_rigid_rotation_meets_no_viscosity(name: str, d: int) -> None:
    law, F = example("material", name), deformations(d=d)
    turning = np.einsum("ij,jkn->ikn", spin(d), F)
    assert np.abs(viscous(law, F, turning)).max() <= 1e-13 * np.abs(viscous(law, F, F)).max()  # measured 4e-16


# ------------------------------------------------------------------------------------------------------- networks

NETWORKS = pytest.mark.parametrize("name", with_method("network_renewed"))


@DIMENSIONS
@NETWORKS
def test_stress_of_a_network_is_the_gradient_of_its_energy(name: str, d: int) -> None:
    law, F, A = example("material", name), deformations(d=d), networks(d=d)
    # measured 1e-11
    assert_close(gradient(lambda F: law.energy(F, A), F), np.array(law.stress(F, A)), 1e-9)


@DIMENSIONS
@NETWORKS
def test_bonds_that_form_anew_have_no_stress_and_the_stress_of_a_share_is_that_of_the_rest(name: str, d: int) -> None:
    law, F, A, share = example("material", name), deformations(d=d), networks(d=d), fractions()
    everything, part = (np.array(law.network_renewed(F, A, s)) for s in (1.0, share))
    pressure = np.array(law.pressure_stress(F))
    assert_close(law.stress(F, everything), pressure, 1e-12)  # measured 1e-14
    assert_close(np.array(law.stress(F, A, share)) - pressure, np.array(law.stress(F, part)) - pressure, 1e-12)
    assert_close(law.energy(F, everything), law.compression(F), 1e-12)
    assert_close(np.array(law.unstressed(F)), everything, 1e-15)


@DIMENSIONS
@NETWORKS
def test_what_bonds_lose_is_what_the_energy_falls_by_at_a_constant_strain(name: str, d: int) -> None:
    law, F, A = example("material", name), deformations(d=d), networks(d=d)
    rate = (np.array(law.unstressed(F)) - A) / law.relaxation_time
    loss = np.asarray(law.network_loss(F, A))
    assert (loss > 0.0).all()
    assert_close(loss, -slope(lambda s: law.energy(F, A + s * rate), 0.0, 1e-4), 1e-6)  # measured 1e-9
    assert np.abs(law.network_loss(F, np.array(law.unstressed(F)))).max() < 1e-12 * loss.max()


@DIMENSIONS
@NETWORKS
def test_a_network_is_the_same_in_any_frame_and_in_plane_strain_what_it_is_in_space(name: str, d: int) -> None:
    law, F, A = example("material", name), deformations(d=d), networks(d=d)
    turned = np.einsum("ijn,jkn->ikn", rotations(F.shape[2], 5, d), F)
    for method in ("energy", "network_loss"):
        assert_close(getattr(law, method)(turned, A), getattr(law, method)(F, A), 1e-12)
    assert_close(np.array(law.network_renewed(turned, A, 0.3)), np.array(law.network_renewed(F, A, 0.3)), 1e-12)
    if d == 2:
        wide, held = np.zeros((2, 3, 3, F.shape[2]))
        wide[:2, :2], wide[2, 2], held[:2, :2], held[2, 2] = F, 1.0, A, 1.0
        for method in ("energy", "network_loss"):
            assert_close(getattr(law, method)(wide, held), getattr(law, method)(F, A), 1e-12)
        P = np.array(law.stress(wide, held))
        assert_close(P[:2, :2], np.array(law.stress(F, A)), 1e-13)
        assert_close(P[2, 2] / determinant(F), law.out_of_plane(F), 1e-12)
        assert_close(np.array(law.network_renewed(wide, held, 0.3))[2, 2], np.ones(F.shape[2]), 1e-15)


@NETWORKS
def test_a_strain_that_is_held_leaves_as_many_bonds_as_time_does_in_steps_of_any_length(name: str) -> None:
    law = example("material", name)
    for r in (0.0, 1e-12, 1e-6, 1e-3, 0.1, 1.0, 10.0, 1e3, 1e9):
        first, last = law.network_shares(r * law.relaxation_time)
        assert 0.0 <= first <= 1.0 and 0.0 <= last <= 1.0
        assert (1.0 - first) * (1.0 - last) == pytest.approx(np.exp(-r), rel=1e-14, abs=1e-15)
        assert first + last == pytest.approx(r, rel=1e-3) or r > 1e-3
        if r > 1e-3:  # where C⁻¹ grows from 0 to 1: ∫ exp(s - r) s/r ds
            assert last == pytest.approx(1.0 + np.expm1(-r) / r, rel=1e-11)


@DIMENSIONS
@pytest.mark.parametrize("name", with_method("director_stress"))
def test_director_stress_is_the_gradient_of_its_energy(name: str, d: int) -> None:
    law, F, g = example("material", name), deformations(d=d), gradients(d=d)
    energy, P = (lambda A: law.director_energy(A, g)), np.array(law.director_stress(F, g))
    assert_close(gradient(energy, F), P, 1e-10)  # measured 2e-11


@DIMENSIONS
@pytest.mark.parametrize("name", with_method("director_flux"))
def test_director_flux_is_the_derivative_by_the_gradient(name: str, d: int) -> None:
    law, F, g = example("material", name), deformations(d=d), gradients(d=d)
    energy, flux = (lambda a: law.director_energy(F, a)), np.array(law.director_flux(F, g))
    assert_close(gradient(energy, g), flux, 1e-10)  # measured 1e-12


@DIMENSIONS
@pytest.mark.parametrize("name", with_method("director_stress"))
def test_director_stress_is_equation_7(name: str, d: int) -> None:
    law, F, g = example("material", name), deformations(d=d), gradients(d=d)
    inverse = np.linalg.inv(np.moveaxis(F, 2, 0))
    dh = np.einsum("nji,kjn->kin", inverse, g)  # ∂h_k/∂x_i, in the plane ∂θ/∂x_i
    if d == 2:
        dh = np.array([-np.sin(0.3), np.cos(0.3)])[:, None, None] * dh  # for θ = 0.3
    expected = -law.eta / determinant(F) * np.einsum("kin,kjn->ijn", dh, dh)
    assert_close(cauchy(np.array(law.director_stress(F, g)), F), expected, 1e-13)  # measured 3e-16


@DIMENSIONS
@pytest.mark.parametrize("name", with_method("active_stress"))
def test_active_stress_pulls_along_the_director(name: str, d: int) -> None:
    law, F, h = example("material", name), deformations(d=d), directions(d=d)
    s = cauchy(np.array(law.active_stress(F, h)), F)
    assert_close(s, -law.zeta * h[:, None] * h[None], 1e-13)  # measured 6e-16


@DIMENSIONS
@pytest.mark.parametrize("name", with_method("director_stress"))
def test_a_director_field_that_turns_with_its_body_has_the_same_energy_and_stress(name: str, d: int) -> None:
    """So does one that does not turn, as its energy has one constant."""
    law, F, g, h = example("material", name), deformations(d=d), gradients(d=d), directions(d=d)
    Q = rotations(F.shape[2], 5, d)
    turned, qg = np.einsum("ijn,jkn->ikn", Q, F), g if d == 2 else np.einsum("ijn,jkn->ikn", Q, g)
    for now in (g, qg):
        assert_close(law.director_energy(turned, now), law.director_energy(F, g), 1e-13)  # measured 7e-16
        stress = np.einsum("ijn,jkn->ikn", Q, np.array(law.director_stress(F, g)))
        assert_close(np.array(law.director_stress(turned, now)), stress, 1e-13)  # measured 1e-15
    active = np.einsum("ijn,jkn->ikn", Q, np.array(law.active_stress(F, h)))
    assert_close(np.array(law.active_stress(turned, np.einsum("ijn,jn->in", Q, h))), active, 1e-13)  # measured 5e-16


@pytest.mark.parametrize("name", with_method("director_stress"))
def test_a_director_in_the_plane_is_one_in_space(name: str) -> None:
    law, F, g, h = example("material", name), deformations(), gradients()[0], directions()
    G, slopes, H = np.zeros((3, 3, 200)), np.zeros((3, 3, 200)), np.zeros((3, 200))
    G[:2, :2], G[2, 2], H[:2] = F, 1.0, h
    slopes[:2, :2] = np.array([-h[1], h[0]])[:, None] * g[None]  # ∂h of ∂θ
    assert_close(law.director_energy(G, slopes), law.director_energy(F, g[None]), 1e-13)  # measured 3e-16
    for method, space, plane in (("director_stress", slopes, g[None]), ("active_stress", H, h)):
        expected = np.array(getattr(law, method)(F, plane))
        assert_close(np.array(getattr(law, method)(G, space))[:2, :2], expected, 1e-13)  # measured 6e-16


# --------------------------------------------------------------------------------------------- the paper's nucleus


@pytest.fixture(scope="module")
def nucleus() -> Any:
    return laws("material")["mooney-rivlin"](C1=2126.0, C2=170.0, volumetric_modulus=170e3)


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
    assert mean - shape == pytest.approx(4 * nucleus.volumetric_modulus * np.log(J) / J, rel=1e-12)


@pytest.mark.parametrize(("stretch", "exact"), [(0.5, -33047.494), (1.5, 5517.176), (2.0, 8604.150)])
def test_nucleus_stretched_in_plane_strain_carries_the_exact_force(nucleus: Any, stretch: float, exact: float) -> None:
    def deformed(across: float) -> np.ndarray:
        return np.diag([stretch, across])[:, :, None]

    across = brentq(lambda b: stress(nucleus, deformed(b))[1, 1, 0], 0.3, 3.0, xtol=1e-15, rtol=1e-14)
    F = deformed(across)
    assert stress(nucleus, F)[0, 0, 0] == pytest.approx(exact, abs=6e-4)  # nominal; the values have 3 decimals


# ------------------------------------------------------------------------------------------------------- adhesion


@pytest.mark.parametrize("name", ADHESIONS)
def test_slope_is_the_derivative_of_the_potential(name: str) -> None:
    law = example("adhesion", name)
    r = distances(law)
    assert_close(slope(law.potential, r, 2e-5 * law.equilibrium_distance), law.slope(r), 1e-10)  # measured 1.2e-11


@pytest.mark.parametrize("name", ADHESIONS)
def test_potential_is_the_derivative_of_the_primitive(name: str) -> None:
    law = example("adhesion", name)
    r = distances(law)
    assert_close(slope(law.primitive, r, 2e-5 * law.equilibrium_distance), law.potential(r), 1e-10)  # measured 9e-12


@pytest.mark.parametrize("name", ADHESIONS)
def test_potential_is_twice_differentiable_at_the_cap_and_once_at_the_cutoff(name: str) -> None:
    law = example("adhesion", name)
    eps = law.equilibrium_distance
    h = 1e-7 * eps
    scale = law.well_depth
    for function, at, unit in ((law.potential, law.cap, 1.0), (law.slope, law.cap, 1 / eps),
                               (law.potential, law.cutoff, 1.0), (law.slope, law.cutoff, 1 / eps),
                               (law.primitive, law.cap, eps), (law.primitive, law.cutoff, eps)):
        step = abs(function(at + h) - function(at - h))
        assert step <= 2e-5 * scale * unit  # measured 1.1e-5: curvature 47 σ/ε² times 2 h
    steps = -1e-4 * eps, 1e-4 * eps
    second = [(law.slope(law.cap + s) - law.slope(law.cap)) / s for s in steps]
    assert second[0] == pytest.approx(second[1], rel=1e-3)  # measured 6e-4, a third derivative times the step
    assert second[0] == pytest.approx(law.stiffness(0.0) / law.bond_density, rel=1e-3)
    beyond = np.array([law.cutoff, 1.01 * law.cutoff, 1e3])
    assert not law.potential(beyond).any() and not law.slope(beyond).any() and not law.primitive(beyond).any()


@pytest.mark.parametrize("name", ADHESIONS)
def test_stiffness_is_the_largest_curvature(name: str) -> None:
    law = example("adhesion", name)
    eps = law.equilibrium_distance
    r = distances(law)
    curvature = slope(law.slope, r, 2e-5 * eps)
    assert curvature.max() * law.bond_density == pytest.approx(law.stiffness(0.0), rel=1e-6)
    for least in (0.85 * eps, eps, 1.1 * eps):  # of a contact whose gaps are all at least this
        assert curvature[r >= least].max() * law.bond_density <= law.stiffness(least) * (1 + 1e-9)
        assert slope(law.slope, np.array([least]), 2e-5 * eps)[0] * law.bond_density == pytest.approx(
            law.stiffness(least), rel=1e-6)


@pytest.mark.parametrize("attraction", [0.0, 0.3])
def test_repulsion_without_all_of_the_attraction_has_a_potential(attraction: float) -> None:
    law = dataclasses.replace(example("adhesion", "seifert"), attraction=attraction)
    eps = law.equilibrium_distance
    r = distances(law)
    r = r[np.abs(r - eps) > 1e-4 * eps]
    assert_close(slope(law.potential, r, 2e-5 * eps), law.slope(r), 1e-10)  # measured 1.3e-11
    assert_close(slope(law.primitive, r, 2e-5 * eps), law.potential(r), 1e-10)  # measured 1e-11
    h = 1e-7 * eps
    for function, unit in ((law.potential, 1.0), (law.slope, 1 / eps), (law.primitive, eps)):
        assert abs(function(eps + h) - function(eps - h)) <= 2e-5 * law.well_depth * unit
    assert law.potential(eps) == pytest.approx(-attraction * law.well_depth, rel=2.4e-3, abs=1e-18)
    assert (law.slope(r[r < 0.999 * eps]) < 0.0).all()
    assert attraction or not law.slope(r[r > eps]).any()


@pytest.mark.parametrize("bonds", [0.0, 10.0, 5000.0])
def test_bodies_repel_each_other_however_few_bonds_they_have(bonds: float) -> None:
    law = dataclasses.replace(example("adhesion", "seifert"), bond_density=bonds)
    solid = law.solid
    assert solid.work == pytest.approx(law.work, rel=1e-14)
    assert solid.bond_density * solid.well_depth >= 24.0  # pN/µm
    r = np.linspace(1.0, 5.0) * law.equilibrium_distance
    pull, scale = solid.bond_density * solid.slope(r), 240.0 / law.equilibrium_distance
    assert np.abs(pull - bonds * law.slope(r)).max() < 1e-14 * scale  # measured 1e-17


def test_seifert_well_has_its_depth_at_the_equilibrium_distance() -> None:
    law = example("adhesion", "seifert")
    eps = law.equilibrium_distance
    least = brentq(law.slope, 0.9 * eps, 1.2 * eps, xtol=1e-18, rtol=1e-14)
    # lowering the potential to zero with zero slope at 0.5 µm shifts the minimum by cut slope/(8 σ/ε²) = 4e-6 ε …
    assert least == pytest.approx(eps, rel=5e-6)
    # … and takes 0.237 % of the depth; without the cutoff it is σ
    assert law.potential(eps) == pytest.approx(-law.well_depth, rel=2.4e-3)
    assert law.pair(eps) == pytest.approx(-law.well_depth, rel=1e-15)
    assert law.pair_slope(eps) == 0.0


def test_seifert_pulls_hardest_where_the_paper_says() -> None:
    law = example("adhesion", "seifert")
    r = np.linspace(1.0, 2.0, 20001) * law.equilibrium_distance
    traction = law.bond_density * law.pair_slope(r)
    assert r[np.argmax(traction)] / law.equilibrium_distance == pytest.approx((5 / 3) ** 0.5, abs=1e-4)  # 1.291
    assert traction.max() * 1e-3 == pytest.approx(17.85, abs=0.01)  # kPa


# ----------------------------------------------------------------------------------------------------- protrusion


@pytest.mark.parametrize("name", PROTRUSIONS)
def test_a_push_grows_with_the_bonds_and_up_to_its_stall(name: str) -> None:
    law = dataclasses.replace(example("protrusion", name), stall=None)
    work, stall = np.logspace(-2.0, 6.0, 50), 7.0
    half = stall / law.push(1.0)  # the work of bonds n_½
    full = law.push(work)
    assert_close(full, law.push(1.0) * work, 1e-15)
    assert_close(dataclasses.replace(law, stall=stall).push(work), stall * work / (work + half), 1e-14)


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


BEGINS = [pytest.param(law, start, id=f"{law}-{start}") for law in laws("director") for start in STARTS]


@DIMENSIONS
@pytest.mark.parametrize(("law", "start"), BEGINS)
def test_a_director_starts_as_its_name_says(law: str, start: str, d: int) -> None:
    X = np.random.default_rng(6).standard_normal((50, d))
    given = {"angle": 0.7} if d == 2 else {"direction": (1.0, -2.0, 2.0)}
    h = initial(laws("director")[law](start=start, **(given if start == "uniform" else {})), X)
    if d == 2:
        h = np.column_stack([np.cos(h[:, 0]), np.sin(h[:, 0])])
        uniform, around = np.array([np.cos(0.7), np.sin(0.7)]), X[:, ::-1] * [-1.0, 1.0]
    else:
        uniform, around = np.array([1.0, -2.0, 2.0]) / 3.0, X[:, [1, 0, 2]] * [-1.0, 1.0, 0.0]
    along = {"radial": X, "tangential": around, "uniform": uniform + 0.0 * X}[start]
    assert np.abs(h - along / np.linalg.norm(along, axis=1, keepdims=True)).max() < 1e-14  # measured 2e-16


@DIMENSIONS
def test_a_director_may_start_as_formulas_say(d: int) -> None:
    X = np.random.default_rng(6).standard_normal((50, d))
    formulas = tuple(Expression(text, "", d) for text in ("2*cos(x)", "2*sin(x)", "0*x")[:d])
    law = laws("director")["frozen"](direction=formulas)
    h = initial(law, X)
    h = np.column_stack([np.cos(h[:, 0]), np.sin(h[:, 0])]) if d == 2 else h
    assert np.abs(h[:, :2] - np.column_stack([np.cos(X[:, 0]), np.sin(X[:, 0])])).max() < 1e-14  # measured 3e-16
    assert not law.uniform and laws("director")["frozen"](direction=(1.0, 2.0)).uniform


def test_a_director_without_a_direction_is_along_x() -> None:
    """As in the middle of a radial field."""
    radial, X = laws("director")["relaxing"](), np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 2.0]])
    assert np.array_equal(initial(radial, X), [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert np.array_equal(initial(None, X), [[1.0, 0.0, 0.0]] * 2)
    assert np.array_equal(initial(None, X[:, :2]), [[0.0]] * 2)


def test_an_anchor_keeps_its_angles_and_reacts_by_the_derivative_of_its_director() -> None:
    rng, anchor = np.random.default_rng(3), Anchor()
    normal, tangent, torque = rng.standard_normal((3, 3, 100))
    across, along = np.cos(0.4), np.sin(0.4)
    h = np.array(anchor.direction(normal, tangent, across, along))
    assert np.abs((h * h).sum(axis=0) - 1.0).max() < 1e-14  # measured 4e-16
    assert_close((h * normal).sum(axis=0) / np.linalg.norm(normal, axis=0), across + 0.0 * h[0], 1e-13)
    # measured 7e-16

    def work(normal: np.ndarray, tangent: np.ndarray) -> np.ndarray:
        return (np.array(anchor.direction(normal, tangent, across, along)) * torque).sum(axis=0)

    found = anchor.reaction(normal, tangent, h, torque)
    assert_close(np.array(found[0]), gradient(lambda n: work(n, tangent), normal, 1e-4), 1e-8)  # measured 7e-12
    assert_close(np.array(found[1]), gradient(lambda t: work(normal, t), tangent, 1e-4), 1e-8)  # measured 1e-10
