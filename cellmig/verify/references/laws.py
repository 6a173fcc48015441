"""Closed forms of the material and adhesion laws, without discretisation: errors are those of rounding."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq, minimize_scalar

from cellmig.case.pointwise import pointwise
from cellmig.case.registry import laws
from cellmig.verify import exact as exact_solutions
from cellmig.verify.reference import Measured, converges, exact, reference

PAPER = "Bai, Lin & Zeng 2019, eqs. (3)-(9), by hand"
FLUID = {"viscosity": 1e3, "bulk_modulus": 2.2e9, "reduced_bulk_modulus": 5e6}
ROUNDING = "a formula in double precision: some 1e-16 per operation"


def nucleus():
    """The paper's nucleus, C1 = 2126 Pa, C2 = 170 Pa, λ = 170 kPa."""
    return laws("material")["mooney-rivlin"](C1=2126.0, C2=170.0, volumetric_modulus=170e3)


def cauchy(law, F: np.ndarray) -> np.ndarray:
    """Cauchy stress (3, 3) [Pa] for F (2, 2) [-]."""
    return exact_solutions.cauchy(law, F[:, :, None], np.zeros((2, 2, 1)))[0]


@reference("simple-shear", shows="nucleus in simple shear γ, which is the size", source=PAPER, unit="",
           at=(2.0, 0.4, 0.01), expected={"σ over 2(C1+C2)γ": exact(1e-12, ROUNDING)})
def simple_shear(shear: float) -> Measured:
    """σ12 is 2(C1+C2)γ, σ11 is 2(C1+C2)γ², σ22 is 0, σ33 is 2 C2 γ²."""
    law = nucleus()
    G = 2.0 * (law.C1 + law.C2)
    right = np.array([[G * shear**2, G * shear, 0], [G * shear, 0, 0], [0, 0, 2.0 * law.C2 * shear**2]])
    error = np.abs(cauchy(law, np.array([[1.0, shear], [0.0, 1.0]])) - right).max()
    return Measured(shear, {"σ over 2(C1+C2)γ": error / (G * shear)})


@reference("dilation", shows="nucleus in dilation by J within the plane, which is the size", source=PAPER, unit="",
           at=(2.0, 1.1, 0.9, 0.5), expected={"mean stress": exact(1e-12, ROUNDING)})
def dilation(J: float) -> Measured:
    """The mean stress is 4 λ ln J/J plus the traces of the two isochoric terms, as only the plane is dilated."""
    law = nucleus()
    I1, I2 = 2.0 * J + 1.0, J**2 + 2.0 * J
    shape = 2.0 / (3.0 * J) * (law.C1 * (I1 - 3.0 * J ** (2 / 3)) + 2.0 * law.C2 * (I2 - 3.0 * J ** (4 / 3)))
    right = 4.0 * law.volumetric_modulus * np.log(J) / J + shape
    return Measured(J, {"mean stress": abs(np.trace(cauchy(law, np.sqrt(J) * np.eye(2))) / 3.0 / right - 1.0)})


@reference("plane-tension", shows="nucleus stretched in plane strain, free across; stretch is the size", source=PAPER,
           unit="", at=(2.0, 1.5, 0.5), expected={"nominal stress": exact(1e-7, "published with 3 decimals of 5,000")})
def plane_tension(stretch: float) -> Measured:
    """The nominal stress is the force per reference area."""
    law, exact_value = nucleus(), {0.5: -33047.494, 1.5: 5517.176, 2.0: 8604.150}[stretch]
    b = brentq(lambda b: cauchy(law, np.diag([stretch, b]))[1, 1], 0.3, 3.0, xtol=1e-15, rtol=1e-14)
    return Measured(stretch, {"nominal stress": abs(b * cauchy(law, np.diag([stretch, b]))[0, 0] / exact_value - 1.0)})


@reference("energy-gradient", shows="each material: P against differences of its energy by a step in F",
           source="P = ∂W/∂F; S Fᵀ for F S would be off by order 1", unit="", at=(0.02, 0.01, 0.005),
           expected={"P": converges(4, "central differences of five points: the step to the fourth")})
def energy_gradient(step: float) -> Measured:
    """The largest error of all materials at random F, over the largest P."""
    rng, worst = np.random.default_rng(1), 0.0
    F = np.eye(2)[:, :, None] + 0.25 * rng.standard_normal((2, 2, 200))
    F = F[..., F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0] > 0.4]
    for law in (nucleus(), laws("material")["nematic"](**FLUID),
                laws("material")["gel"](**FLUID, shear_modulus=500.0)):
        P, slopes = np.array(pointwise(law, "stress", {"F": F})), np.empty_like(F)
        for i in np.ndindex(2, 2):
            e = np.zeros((2, 2, 1))
            e[i] = step
            W = [law.energy(F + k * e) for k in (-2, -1, 1, 2)]
            slopes[i] = (8.0 * (W[2] - W[1]) - W[3] + W[0]) / (12.0 * step)
        worst = max(worst, np.abs(slopes - P).max() / np.abs(P).max())
    return Measured(step, {"P": float(worst)})


@reference("seifert", shows="one bond: strongest pull on a grid of gaps, which is the size", source=PAPER, unit="range",
           at=(0.02, 0.01, 0.005),
           expected={"strongest pull": converges(2, "half the curvature times the distance squared"),
                     "stiffness at ε": exact(1e-12, ROUNDING)})
def seifert(step: float) -> Measured:
    """The strongest pull is 17.85 kPa at √(5/3) ε, the stiffness at equilibrium 8 N σ/ε², both without a cutoff."""
    law = laws("adhesion")["seifert"](bond_density=8000.0, well_depth=0.03, equilibrium_distance=0.01)
    eps, x = law.equilibrium_distance, np.sqrt(5.0 / 3.0)
    r = (x + step * (np.arange(-20, 20) + 0.5)) * eps  # the maximum lies halfway between two points
    strongest = float(law.bond_density * law.pair_slope(r).max()) / (4.0 * law.work / eps * (x**-3 - x**-5))
    stiffness = law.stiffness(eps) / (8.0 * law.work / eps**2)
    return Measured(step, {"strongest pull": abs(strongest - 1.0), "stiffness at ε": abs(stiffness - 1.0)})


@reference("bell", shows="friction of Bell's bonds over five decades of speed each side of v0; k_off/k_on is the size",
           source="survival exp(-(exp(u t) - 1)/u) of bonds in steady sliding, by adaptive quadrature; Srinivasan & "
           "Walcott 2009", unit="", at=(10.0, 1.0, 0.1, 0.01),
           expected={"traction": exact(1e-8, "a rational function of ln(1 + u), fitted to 8e-10 in either moment"),
                     "largest traction": exact(1e-8, "the same; its error at a maximum is of second order")})
def bell(ratio: float) -> Measured:
    """T/N F_b is Φ(u) = u <t²>/2(ρ + <t>); for ρ = 1 it is largest at u = 4.503, 0.21848, for 0.1 at 19.29, 0.84613."""

    def curve(u: float) -> float:
        ends = np.log1p(u * np.array([0.0, 1e-4, 0.01, 0.1, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 45.0])) / u
        mean, half_square = (sum(quad(lambda t, k=k: t**k * np.exp(-np.expm1(u * t) / u), *piece, epsabs=0.0,
                                      epsrel=1e-11)[0] for piece in pairwise(ends)) for k in (0, 1))
        return u * half_square / (ratio + mean)

    law = laws("friction")["bell"](bonds=1.0, stiffness=1.0, on=1.0 / ratio, off=1.0, force=1.0)
    error = max(abs(law.drag(1.0, u) / curve(u) - 1.0) for u in np.logspace(-5.0, 5.0, 41))
    most = -minimize_scalar(lambda u: -curve(u), bracket=(0.5 * law.largest[1], law.largest[1])).fun
    return Measured(ratio, {"traction": float(error), "largest traction": abs(law.largest[0] / most - 1.0)})
