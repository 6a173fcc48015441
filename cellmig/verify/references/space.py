"""Balls: a solid one twists and rings, one of fluid turns and comes to rest, or oscillates by its surface tension."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.polynomial import Legendre
from scipy.optimize import brentq
from scipy.special import spherical_jn

from cellmig.case.load import from_dict
from cellmig.case.schema import Case
from cellmig.verify.exact import Globe
from cellmig.verify.reference import Measured, converges, reference

from .scenes import built, case, displacement, l2_error, set_state, velocity

RADIUS = 5.0  # µm
SQUARED = "h² of linear finite elements, whose averages are exact for linear fields"


def ball(count: int, material: str, *sets: str, **tables: Any) -> Case:
    """A ball of one material of `cases/ball.toml`, alone and at rest, with further tables of a case."""
    tree = case("ball", count, *sets).resolved()
    del tree["adhesion"]
    only = {"material": material, "nucleus": material, "centre": ["0 um"] * 3, "rest": False}
    tree["cells"][0] |= only
    tree["cells"][0].pop("nucleus_ratio")
    tree["cells"][0].pop("nucleus")
    tree["materials"] = {material: tree["materials"][material]}
    return from_dict(tree | tables)


@reference("ball-twisting", shows="slowest mode of a free elastic ball, whose halves twist: after a period, L2 over it",
           source="u = j2(k r) sin θ cos θ along the parallels, k R j3(kR) = j2(kR) (Lamb 1882)",
           at=(300, 750, 2000, 5000), seconds=4.0, expected={"displacement": converges(2, SQUARED)})
def ball_twisting(count: int) -> Measured:
    """The ball has the law of the nucleus, and nothing damps it."""
    root = brentq(lambda q: spherical_jn(2, q) - q * spherical_jn(3, q), 2.0, 3.0)
    quiet = ("materials.nucleus.stabilisation=0", "numerics.bulk_viscosity=0")
    with built(ball(count, "nucleus", *quiet)) as sim:
        X, law, k = sim.scene.X, sim.scene.materials[0], root / RADIUS
        r = np.maximum(np.linalg.norm(X, axis=1), 1e-9)
        u = 1e-4 * (spherical_jn(2, k * r) * X[:, 2] / r**2)[:, None] * np.column_stack([-X[:, 1], X[:, 0], 0.0 * r])
        set_state(sim, u, np.zeros_like(u))
        sim.go(2.0 * np.pi / (k * np.sqrt(law.shear_modulus / law.density)))
        return Measured(sim.scene.templates[0].spacing, {"displacement": l2_error(sim, displacement(sim), u)}, count)


@reference("ball-turning", shows="rate at which a turning flow j1(k r) of a ball of fluid decays, j2(kR) = 0",
           source="ν k² = 1.33 /µs: shear diffuses (Lamb, Hydrodynamics, ch. XI)", at=(2000, 5000, 10000),
           quick=(300, 750, 2000), seconds=25.0, coarse={"rate": 0.0163, "rate, nothing restored": 0.151},
           expected={"rate": converges(1.6, "0.064 h² of what is restored, less 0.042 h³ (h in µm) of the surface: "
                                       "1.6 from 5,000 to 10,000 particles"),
                     "rate, nothing restored": converges(2, "a Rayleigh quotient: the square of an error h in "
                                                         "gradients")})
def ball_turning(count: int) -> Measured:
    """The rate follows from the amplitudes of the mode in the velocities after 0.5 and 1 µs."""
    spacing, rate = _turning_rate(ball(count, "cytoplasm"))
    _, bare = _turning_rate(ball(count, "cytoplasm", "materials.cytoplasm.stabilisation=0"))
    return Measured(spacing, {"rate": rate, "rate, nothing restored": bare}, count)


def _turning_rate(case: Case) -> tuple[float, float]:
    """Spacing [µm], and error of the rate relative to ν k²."""
    k = brentq(lambda q: spherical_jn(2, q), 5.0, 6.5) / RADIUS
    with built(case) as sim:
        X, mass, law = sim.scene.X, sim.scene.field("mass"), sim.scene.materials[0]
        r = np.maximum(np.linalg.norm(X, axis=1), 1e-9)
        mode = (spherical_jn(1, k * r) / r)[:, None] * np.column_stack([-X[:, 1], X[:, 0], 0.0 * r])
        set_state(sim, v=0.01 * mode)
        share = []
        for time in (0.5, 1.0):
            sim.go(time)
            share.append(float(mass @ (mode * velocity(sim)).sum(axis=1)))
        rate = -np.log(share[1] / share[0]) / 0.5
        return sim.scene.templates[0].spacing, abs(rate / (law.viscosity / law.density * k**2) - 1.0)


TENSION = 5000.0  # pN/µm


@reference("ball-oscillation", shows="surface of a ball of fluid that oscillates by its tension, two lobes, a period",
           source="Lamb: ω² = n(n-1)(n+2)T/ρR³, damped by (n-1)(2n+1)ν/R²; with its boundary layer: exact.py Globe",
           at=(300, 750, 2000, 5000), seconds=10.0,
           expected={"surface": converges(1.7, "0.031 h² of what is restored and of the curvature of triangles, less "
                                          "0.012 h³ (h in µm) of the surface: 1.7 from 300 to 5,000 particles")})
def ball_oscillation(count: int) -> Measured:
    """The viscosity is that of the cytoplasm, T = 5000 pN/µm; the period is 11 µs, five times the decay time.

    What a ball without the mode does, whose triangles are not quite in equilibrium, is taken off.
    """
    cortex = {"cortex": {"law": "line-tension", "line_tension": f"{TENSION} pN/um"}}
    scene = ball(count, "cytoplasm", "numerics.bulk_viscosity=0", **cortex)
    law, n, amplitude = scene.materials["cytoplasm"], 2, 0.01
    nu = law.viscosity / law.density
    guess = complex(-(n - 1) * (2 * n + 1) * nu / RADIUS**2,
                    np.sqrt(n * (n - 1) * (n + 2) * TENSION / law.density / RADIUS**3))
    mode = Globe(law, RADIUS, n, TENSION, guess)
    times = np.linspace(0.0, 2.0 * np.pi / mode.s.imag, 13)
    (h, swinging), (_, still) = (_swing(scene, mode, size, times) for size in (amplitude, 0.0))
    return Measured(h, {"surface": float(np.abs((swinging - still) / amplitude - np.exp(mode.s * times).real).max())},
                    count)


def _swing(scene: Case, mode: Globe, amplitude: float, times: np.ndarray) -> tuple[float, np.ndarray]:
    """Spacing [µm], and share of the mode in the radial displacement of the surface at times [µs] [µm]."""
    with built(scene) as sim:
        X, surface = sim.scene.X, sim.scene.surface(0)
        shape, pressure = mode.displacements(X), 2.0 * mode.tension / RADIUS
        J = np.sqrt(1.0 + (pressure / mode.K) ** 2) - pressure / mode.K  # of pressure and tension in balance
        set_state(sim, amplitude * shape.real + (J ** (1.0 / 3.0) - 1.0) * X, amplitude * (mode.s * shape).real)
        outward = X[surface] / RADIUS
        lobes = Legendre.basis(mode.n)(outward[:, 2])
        share, found = np.linalg.pinv(np.column_stack([lobes, np.ones(len(lobes))]))[0], []
        for t in times:
            sim.go(float(t))
            found.append(float(share @ (displacement(sim)[surface] * outward).sum(axis=1)))
        return sim.scene.templates[0].spacing, np.array(found)
