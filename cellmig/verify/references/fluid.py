"""Drops of the cytoplasm: spreading flows, decay of shear, vibration by line tension and by compression."""

from __future__ import annotations

import numpy as np
from scipy.special import jn_zeros, jv

from cellmig.case.schema import Case
from cellmig.verify.exact import Drop
from cellmig.verify.reference import Measured, converges, reference

from .scenes import altered, built, displacement, drop, on_the_rim, set_state, velocity

RADIUS = 5.0  # µm


def straining(rate: float) -> dict:
    """The initial velocity v = rate (x, -y), rate [1/µs], of a cell."""
    return {"velocity_gradient": [[f"{rate} /us", "0 /us"], ["0 /us", f"{-rate} /us"]]}


def axes(sim) -> np.ndarray:
    """Semi-axes along x and y of a symmetric drop (2,) [µm]."""
    x = on_the_rim(sim, np.arange(4) * np.pi / 2)
    return 0.5 * np.array([x[0, 0] - x[2, 0], x[1, 1] - x[3, 1]])


@reference("viscous-drop", shows="semi-axes at 1, 2, 5 µs of a drop set flowing by 0.02 (x, -y) /µs, over R = 5 µm",
           source="finite elements of two public codes, incompressible, ± 1e-5 µm",
           at=(2500, 5000, 10000, 20000), quick=(150, 400, 1000), seconds=30.0, coarse={"semi-axes": 3.6e-4},
           expected={"semi-axes": converges(2, "h² of a linear basis and of the stabilisation, zero for linear flow, "
                                            "once the layer at the rim is resolved", {5000: 0.01, 20000: 0.003},
                                            floor=2e-6)})
def viscous_drop(count: int) -> Measured:
    """The viscosity is 1000 Pa µs; there is no line tension.

    The initial flow pulls at the free rim with 2 μ A.  A layer of vorticity grows from there as √(νt), which is 1 µm at
    1 µs; spacings of 0.72 to 0.28 µm (150 to 1,000 particles) have orders of 0.9 and 1.7 between them.
    """
    right = {1.0: (5.08760, 4.91357), 2.0: (5.15571, 4.84742), 5.0: (5.28614, 4.72173)}
    with built(altered(drop(count), straining(0.02))) as sim:
        error = 0.0
        for time, exact in right.items():
            sim.go(time)
            error = max(error, float(np.abs(axes(sim) - exact).max()) / RADIUS)
        return Measured(sim.scene.templates[0].spacing, {"semi-axes": error}, count)


@reference("inviscid-drop", shows="stretching ellipse: semi-axes when a/b = 4, over R, from v = A (x, -y), A = 0.1 /µs",
           source="Dirichlet's ellipse: dA/dt = A² (b² - a²)/(a² + b²), da/dt = A a, b = R²/a",
           at=(400, 1000, 2500, 5000), quick=(150, 400, 1000), seconds=10.0, coarse={"semi-axes": 8.7e-4},
           expected={name: converges(order, why, {5000: 0.01, 20000: 0.003}, floor=1e-4) for name, order, why in (
               ("semi-axes", 1, "h times the slope of the pressure at the rim, with the beats of its rings"),
               ("semi-axes by moments", 2, "h² of a linear basis; F is uniform, the pressure quadratic in X"))})
def inviscid_drop(count: int) -> Measured:
    """The viscosity is 1e-5 of the cytoplasm's; the solution has a = 2R, b = R/2 at the product 0.8005088 of A and t.

    The stabilisation is that of the cytoplasm: without it single particles of the rim move by 1 % of R.

    Gradients at a particle obey the divergence theorem for a constant pressure.  A pressure p with the slope p' at the
    rim has an error of p' h there, whose sign and size depend on how particles of the rim lie to those of the ring
    beneath.  That ring has six fewer, at any resolution, so that the error has 6, 12, ... lobes, which do not become
    finer with h: it is a pressure on the rim of first order.  Particles of the rim miss the ellipse by 5.6e-4, 3.5e-4,
    2.0e-4, 1.3e-4 and 9.1e-5 R along x in the root mean square at 1,000, 2,500, 5,000, 10,000 and 20,000 particles:
    orders 1.1, 1.7, 1.2 and 1.0, and 6 and 12 lobes are the largest in it.
    """
    thin = ('materials.cytoplasm.viscosity="1e-8 Pa s"', "materials.cytoplasm.stabilisation=1e5")
    with built(altered(drop(count, *thin), straining(0.1))) as sim:
        sim.go(8.005088)
        mass, X = sim.scene.field("mass"), sim.scene.X
        moments = np.sqrt(mass @ (X + displacement(sim)) ** 2 / (mass @ X**2))
        found = {"semi-axes": axes(sim) / RADIUS, "semi-axes by moments": moments}
        return Measured(sim.scene.templates[0].spacing,
                        {name: float(np.abs(a - (2.0, 0.5)).max()) for name, a in found.items()}, count)


@reference("shear-decay", shows="rate at which a turning flow J1(kr) of a drop decays, J2(kR) = 0",
           source="ν k² = 1.055 /µs: shear diffuses (Lamb, Hydrodynamics, ch. XI)", at=(300, 800, 2000, 5000),
           quick=(300, 800, 2000), seconds=30.0, coarse={"rate": 1.6e-3},
           expected={"rate": converges(1.7, "0.060 h² of what is restored, less 0.094 h³ (h in µm) of the rim, whose "
                                       "Laplacians are one-sided: 1.67 from 2,000 to 5,000 particles"),
                     "rate, nothing restored": converges(2, "a Rayleigh quotient: the square of an error h in "
                                                         "gradients")})
def shear_decay(count: int) -> Measured:
    """The rate follows from the amplitudes of the mode in the velocities after 0.5 and 1 µs."""
    spacing, rate = _shear_rate(drop(count))
    _, bare = _shear_rate(drop(count, "materials.cytoplasm.stabilisation=0"))
    return Measured(spacing, {"rate": rate, "rate, nothing restored": bare}, count)


def _shear_rate(case: Case) -> tuple[float, float]:
    """Spacing [µm], and error of the rate relative to ν k²."""
    k = jn_zeros(2, 1)[0] / RADIUS
    with built(case) as sim:
        X, mass, law = sim.scene.X, sim.scene.field("mass"), sim.scene.materials[0]
        r = np.maximum(np.hypot(*X.T), 1e-9)
        mode = (jv(1, k * r) / r)[:, None] * np.column_stack([-X[:, 1], X[:, 0]])
        set_state(sim, v=0.01 * mode)
        share = []
        for time in (0.5, 1.0):
            sim.go(time)
            share.append(float(mass @ (mode * velocity(sim)).sum(axis=1)))
        rate = -np.log(share[1] / share[0]) / 0.5
        return sim.scene.templates[0].spacing, abs(rate / (law.viscosity / law.density * k**2) - 1.0)


def ringing(case, mode, amplitude: float, time: float) -> tuple[float, float]:
    """Spacing [µm], and largest error of the rim over `time` [µs], relative to the initial amplitude of the mode."""
    with built(case) as sim:
        X, rim = sim.scene.X, sim.scene.surface(0)
        shape, pressure, K = mode.displacements(X), mode.tension / RADIUS, mode.law.reduced_bulk_modulus
        J = np.sqrt(1.0 + (pressure / K) ** 2) - pressure / K  # of pressure and tension in balance
        set_state(sim, amplitude * shape.real + (np.sqrt(J) - 1.0) * X, amplitude * (mode.s * shape).real)
        at, error = np.arctan2(*X[rim].T[::-1]), 0.0
        lobes = np.cos(mode.n * at) / np.square(np.cos(mode.n * at)).sum()
        still = lobes @ np.full(len(rim), (np.sqrt(J) - 1.0) * RADIUS)
        for t in np.linspace(0.0, time, 13)[1:]:
            sim.go(float(t))
            radial = (displacement(sim)[rim] * X[rim]).sum(axis=1) / np.hypot(*X[rim].T)
            error = max(error, abs((lobes @ radial - still) / amplitude - np.exp(mode.s * t).real))
        return sim.scene.templates[0].spacing, float(error)


TENSION = 5000.0  # pN/µm


@reference("drop-oscillation", shows="rim of a drop that oscillates by its line tension, two lobes, over a period",
           source="Lamb: ω² = n(n²-1)T/ρR³, damped by 2n(n-1)ν/R²; with its boundary layer: verify/exact.py Drop",
           at=(150, 400, 1000, 2500), seconds=40.0,
           expected={"rim": converges(2, "h² of the polygon's curvature and of a linear basis", {5000: 0.01})})
def drop_oscillation(count: int) -> Measured:
    """The viscosity is that of the cytoplasm, T = 5000 pN/µm; the period is 14 µs, five times the decay time."""
    cortex = {"cortex": {"law": "line-tension", "line_tension": f"{TENSION} pN/um"}}
    case = drop(count, "numerics.bulk_viscosity=0", **cortex)
    law = case.materials["cytoplasm"]
    n, nu = 2, law.viscosity / law.density
    guess = complex(-2 * n * (n - 1) * nu / RADIUS**2, np.sqrt(n * (n * n - 1) * TENSION / law.density / RADIUS**3))
    mode = Drop(law, RADIUS, n, TENSION, guess)
    h, error = ringing(case, mode, 0.01, 2.0 * np.pi / mode.s.imag)
    return Measured(h, {"rim": error}, count)


@reference("drop-sound", shows="rim of a drop in its first breathing mode, over 3 periods",
           source="J0(ωR/c) = 0: ω = 2.4048 c/R, damped by νκ²; with viscosity at the rim: verify/exact.py Drop",
           at=(1000, 2500, 6000, 15000), quick=(150, 400, 1000), seconds=5.0, coarse={"rim": 1.5e-2},
           expected={"rim": converges(2, "h² in frequency and damping without the numerical damping of sound",
                                      {5000: 0.01}),
                     "rim, damped by default": converges(1, "the numerical damping of sound is 0.05 ρ c h")})
def drop_sound(count: int) -> Measured:
    """The bulk modulus is 5 MPa, the speed of sound 71 µm/µs, the period 0.18 µs."""
    found = {}
    for name, sets in (("rim", ("numerics.bulk_viscosity=0",)), ("rim, damped by default", ())):
        case = drop(count, *sets)
        law = case.materials["cytoplasm"]
        k = jn_zeros(0, 1)[0] / RADIUS
        guess = complex(-law.viscosity / law.density * k**2, k * np.sqrt(law.reduced_bulk_modulus / law.density))
        mode = Drop(law, RADIUS, 0, 0.0, guess)
        h, found[name] = ringing(case, mode, 1e-4, 6.0 * np.pi / mode.s.imag)
    return Measured(h, found, count)
