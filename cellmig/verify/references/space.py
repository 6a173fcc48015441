"""Bodies in space: balls and rods that ring, blocks that are moved and loaded, balls of fluid that turn and swing."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.polynomial import Legendre
from scipy.optimize import brentq
from scipy.special import spherical_jn

from cellmig.case.load import from_dict
from cellmig.case.schema import Case
from cellmig.runs.cases import lone_body
from cellmig.verify.exact import Globe
from cellmig.verify.reference import Measured, converges, exact, reference
from cellmig.verify.specimens import piece

from .dynamic import Waves
from .scenes import built, by_id, case, displacement, l2_error, set_state, velocity

RADIUS = 5.0  # µm
SQUARED = "h² of linear finite elements, whose averages are exact for linear fields"


def ball(count: int, material: str, *sets: str, **tables: Any) -> Case:
    """A ball of one material of `cases/ball.toml`, alone and at rest, with further tables of a case."""
    return from_dict(lone_body(case("ball", count, *sets).resolved(), material) | tables)


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


@reference("ball-ringing", shows="modes of a free elastic ball, breathing and two lobes: after half a period, L2",
           source="Lamb 1882: potentials j_n(k r), no traction at R; exact.py Globe", at=(300, 750, 2000, 5000),
           seconds=6.0, coarse={"breathing": 0.06},
           expected={"breathing": converges(2, SQUARED), "two lobes": converges(2, SQUARED)})
def ball_ringing(count: int) -> Measured:
    """The law of the nucleus, with Poisson's ratio 0.26 instead of 0.497; nothing damps it."""
    soft = ("materials.nucleus.volumetric_modulus='2 kPa'", "materials.nucleus.stabilisation=0",
            "numerics.bulk_viscosity=0")
    found = {}
    for name, lobes, start in (("breathing", 0, 2.3), ("two lobes", 2, 2.64)):
        with built(ball(count, "nucleus", *soft)) as sim:
            law = sim.scene.materials[0]
            speed = law.sound_speed if lobes == 0 else np.sqrt(law.shear_modulus / law.density)
            mode = Globe(law, RADIUS, lobes, 0.0, 1j * start * speed / RADIUS)
            u = 1e-4 * mode.displacements(sim.scene.X).real
            set_state(sim, u, np.zeros_like(u))
            sim.go(np.pi / mode.s.imag)
            found[name] = l2_error(sim, displacement(sim), -u)
            spacing = sim.scene.templates[0].spacing
    return Measured(spacing, found, count)


def block(shape: dict, count: int, **tables: Any) -> Case:
    """A body of the nucleus's law with Poisson's ratio 0.26, which nothing damps."""
    soft = {"volumetric_modulus": "2 kPa", "stabilisation": 0}
    return piece(shape | {"centre": ["0 um"] * 3}, count, time={"end": "100 us", "integrator": "leapfrog"},
                 material=soft, numerics={"bulk_viscosity": 0}, dimension=3, **tables)


@reference("rod-twisting", shows="slowest twist of a free cylinder of 1 x 4 µm: after half a period, L2 over it",
           source="u = sin(π z/L) (-y, x, 0), ω = (π/L) sqrt(G/ρ): plane sections turn", at=(300, 750, 2000, 5000),
           seconds=6.0, expected={"displacement": converges(2, SQUARED)})
def rod_twisting(count: int) -> Measured:
    """The ends and the side are free of traction in the exact mode."""
    length = 4.0
    with built(block({"shape": "cylinder", "radius": "1 um", "length": f"{length} um"}, count)) as sim:
        X, law = sim.scene.X, sim.scene.materials[0]
        omega = np.pi / length * np.sqrt(law.shear_modulus / law.density)
        u = 1e-4 * np.sin(np.pi * X[:, 2:] / length) * np.column_stack([-X[:, 1], X[:, 0], 0.0 * X[:, 0]])
        set_state(sim, u, np.zeros_like(u))
        sim.go(np.pi / omega)
        return Measured(sim.scene.templates[0].spacing, {"displacement": l2_error(sim, displacement(sim), -u)}, count)


class WavesInSpace(Waves):
    """Three plane waves in space."""

    k = np.array([[0.9, 0.5, -0.6], [-0.4, 1.1, 0.7], [1.3, -0.7, 0.5]])  # [1/µm]

    def turned(self) -> np.ndarray:
        """A vector across each k (waves, 3) [1/µm]."""
        return np.cross(self.k, np.roll(self.k, 1, axis=1))


FREE = {"right": [1.0, 0.0, 0.0], "top": [0.0, 0.0, 1.0]}  # parts of a box with tractions, and their normals


@reference("manufactured-block", shows="manufactured solution of three plane waves in a block of 2 x 2 x 2 µm, L2",
           source="manufactured solution (Roache 2002): force on the body, moved surface or tractions",
           at=(300, 750, 2000, 5000), seconds=15.0,
           expected={"moved": converges(2, SQUARED), "pulled": converges(2, SQUARED)})
def manufactured_block(count: int) -> Measured:
    """Errors after 1.3 periods, when sin(Ωt) is not near zero; "pulled" has tractions at right and top."""
    found = {}
    for how, free in (("moved", {}), ("pulled", FREE)):
        box = {"shape": "box", "a": "2 um", "b": "2 um", "c": "2 um"}
        waves = WavesInSpace(block(box, 50).materials["nucleus"], 1.0, 1e-7, 1.0)
        sides = ("left", "right", "front", "back", "bottom", "top")
        moved = waves.support([side for side in sides if side not in free])
        loads = [waves.body(), *(waves.traction(part, normal) for part, normal in free.items())]
        with built(block(box | waves.start(), count, loads=loads, supports=[{"name": "moved", **moved}])) as sim:
            sim.go(1.3)
            found[how] = l2_error(sim, displacement(sim), waves.displacement(sim.scene.X, 1.3))
            spacing = sim.scene.templates[0].spacing
    return Measured(spacing, found, count)


@reference("block-patch", shows="stress and forces inside a body of random particles that is stretched and sheared",
           source="F is uniform: P is, and no inner particle is accelerated", at=(300, 1000, 3000), seconds=2.0,
           expected={"F": exact(1e-12, "averages of gradients of linear elements are exact"),
                     "acceleration": exact(1e-11, "the divergence theorem holds at every inner particle")})
def block_patch(count: int) -> Measured:
    """Errors are relative to F - I, and to the largest acceleration at the surface."""
    F = np.array([[1.2, 0.15, -0.1], [0.05, 0.85, 0.2], [-0.1, 0.1, 1.05]])
    with built(block({"shape": "cylinder", "radius": "1 um", "length": "2 um"}, count)) as sim:
        set_state(sim, sim.scene.X @ (F - np.eye(3)).T)
        a = by_id(sim, sim.mechanics.rate()[:, 3:])
        found = sim.mechanics.state.tensors()[0]
        inner = np.setdiff1d(np.arange(count), sim.scene.surface(0))
        return Measured(sim.scene.templates[0].spacing,
                        {"F": float(np.abs(found - F[:, :, None]).max() / np.abs(F - np.eye(3)).max()),
                         "acceleration": float(np.abs(a[inner]).max() / np.abs(a).max())}, count)


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
        shape, pressure, K = mode.displacements(X), 2.0 * mode.tension / RADIUS, mode.law.reduced_bulk_modulus
        J = np.sqrt(1.0 + (pressure / K) ** 2) - pressure / K  # of pressure and tension in balance
        set_state(sim, amplitude * shape.real + (J ** (1.0 / 3.0) - 1.0) * X, amplitude * (mode.s * shape).real)
        outward = X[surface] / RADIUS
        lobes = Legendre.basis(mode.n)(outward[:, 2])
        share, found = np.linalg.pinv(np.column_stack([lobes, np.ones(len(lobes))]))[0], []
        for t in times:
            sim.go(float(t))
            found.append(float(share @ (displacement(sim)[surface] * outward).sum(axis=1)))
        return sim.scene.templates[0].spacing, np.array(found)
