"""The paper's nucleus as a free elastic disc: eigenfrequencies, vibration, stress."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import eigsh
from scipy.special import jv

from cellmig.meshfree.body import Template
from cellmig.verify.exact import Ringing, released_disc, without_sound
from cellmig.verify.reference import Measured, converges, exact, reference

from .scenes import DAMPED, built, by_id, displacement, l2_error, nucleus, on_the_rim, set_state

RADIUS = 1.415  # µm
ELASTIC = {5000: 0.01, 20000: 0.003}
SQUARED = "a Rayleigh quotient: the square of an error h in gradients (Strang & Fix, An Analysis of the FEM, ch. 6)"
LEVEL = 3e-5  # below it layouts decide: masses that neighbours exchange leave hardly a term in h² of the breathing mode
MODES = {"n = 2": (2, 3.5646220), "n = 3": (3, 5.5225285), "n = 2, second": (2, 7.2362576), "n = 4": (4, 7.2494496),
         "breathing": (0, 44.413823)}  # [rad/µs]


def stiffness(t: Template) -> sparse.csc_matrix:
    """Stiffness matrix (2n, 2n) [Pa] of a body of one material with its stabilisation, all x before all y."""
    law = t.laws[0]
    G, lame = law.shear_modulus, law.bulk_modulus - 2.0 / 3.0 * law.shear_modulus
    g, V = t.G, sparse.diags(t.V)
    same = G * sum(a.T @ V @ a for a in g) + t.E
    K = [[lame * g[i].T @ V @ g[j] + G * g[j].T @ V @ g[i] + (same if i == j else 0.0 * same) for j in range(2)]
         for i in range(2)]
    return sparse.bmat(K).tocsc()


def lobed(X: np.ndarray, rim: np.ndarray, u: np.ndarray, n: int) -> float:
    """Share of the mode with n lobes in the radial displacement of the rim; for n = 0, of J1 in the disc [-]."""
    r, at = np.hypot(*X.T), np.arctan2(X[:, 1], X[:, 0])
    radial = (u * X).sum(axis=1) / np.maximum(r, 1e-9)
    if n == 0:
        form = jv(1, 44.413823 / 26.189 * r)
        return abs(form @ radial) / np.sqrt((form @ form) * (u**2).sum())
    share = np.exp(1j * n * at[rim]) @ radial[rim]
    return abs(share) / np.sqrt(len(rim) * (radial[rim] @ radial[rim] + 1e-300)) * np.sqrt(2.0)


@reference("disc-modes", shows="frequencies of the free disc, from the linear operator",
           source="roots of the free disc's Bessel determinant",
           at=(500, 1250, 5000, 10000), quick=(300, 700, 1500), seconds=20.0, coarse={"breathing": 1.0e-3},
           expected={**{name: converges(2, SQUARED, ELASTIC, floor=LEVEL if name == "breathing" else 0.0)
                        for name in MODES},
                     "operator": exact(1e-6, "that of the forces, to their rounding at a strain of 1e-8")})
def disc_modes(count: int) -> Measured:
    """The eigenvector of a mode is the one with the mode's lobes among those near its frequency."""
    with built(nucleus(count)) as sim:
        t = sim.scene.templates[0]
        K, M = stiffness(t), sparse.diags(np.tile(t.mass, 2))
        u = 1e-9 * np.random.default_rng(0).standard_normal((count, 2))
        set_state(sim, u)
        f = t.mass[:, None] * by_id(sim, sim.mechanics.rate()[:, 2:])
        right = (K @ u.T.ravel()).reshape(2, -1).T
        found = {"operator": float(np.abs(f + right).max() / np.abs(right).max())}
        for name, (n, omega) in MODES.items():
            values, vectors = eigsh(K, 12, M, sigma=omega**2)
            shares = [lobed(t.X, t.surface, v.reshape(2, -1).T, n) for v in vectors.T]
            pick = int(np.argmax(shares))
            if n:  # several modes have n lobes, each a pair: the nearest in frequency
                good = np.flatnonzero(np.array(shares) > 0.7 * max(shares))
                pick = good[np.argmin(np.abs(np.sqrt(np.abs(values[good])) - omega))]
            found[name] = abs(float(np.sqrt(values[pick])) / omega - 1.0)
        return Measured(t.spacing, found, count)


@reference("disc-released", shows="elastic disc released from u = 0.05 (x, -y): a2(t) over two periods, over a2(0)",
           source="spectral Galerkin method, ± 0.1 %: verify/exact.py released_disc", at=(300, 750, 2000, 5000),
           seconds=20.0, expected={"a2": converges(2, "h² of a linear basis, in displacements and frequencies; without "
                                                   "the ripple of sound, which no spacing here resolves", ELASTIC,
                                                   floor=1e-3),
                                   "energy at the start": converges(2, "area of the polygon for that of the circle",
                                                                    ELASTIC)})
def disc_released(count: int) -> Measured:
    """The disc rings with 3.57 rad/µs; its sound, with 44 rad/µs and more, changes a2 by 0.5 %."""
    parts, strain = 10, 0.05
    step = 2.0 * np.pi / MODES["breathing"][1] / parts
    times = step * np.arange(int(3.5 / step) + 1)
    with built(nucleus(count)) as sim:
        set_state(sim, strain * sim.scene.X * [1.0, -1.0])
        energy, a2 = sim.sample()[1]["elastic_pn"], [strain * RADIUS]
        for time in times[1:]:
            sim.go(float(time))
            x = on_the_rim(sim, (0.0, 0.5 * np.pi))
            a2.append(0.5 * (x[0, 0] - x[1, 1]))
        right = released_disc(sim.scene.materials[0], RADIUS, strain, step, len(times) - 1)
        error = np.abs(without_sound(np.array(a2) - right, parts)).max() / a2[0]
        return Measured(sim.scene.templates[0].spacing,
                        {"a2": float(error), "energy at the start": abs(energy / 157.853 - 1.0)}, count)


@reference("disc-ringing", shows="exact dynamic solution: slowest mode of the disc after one period, L2 over the disc",
           source="verify/exact.py Ringing: potentials J2(kp r), J2(ks r)", at=(200, 400, 800, 1600), seconds=15.0,
           expected={"displacement": converges(2, "h² of a linear basis"),
                     "nodal stress": converges(1, "gradients of a linear basis"),
                     "recovered stress": converges(1, "fits to gradients that are exact to h"),
                     "recovered deviator": converges(1, "fits to gradients that are exact to h")})
def disc_ringing(count: int) -> Measured:
    """Sound, which the start excites, has the default damping: without it, it would dominate the stress."""
    with built(nucleus(count, *DAMPED)) as sim:
        t, size = sim.scene.templates[0], 1e-6
        mode = Ringing(sim.scene.materials[0], RADIUS)
        u, stress = mode.fields(sim.scene.X)
        set_state(sim, size * u, np.zeros_like(u))
        sim.go(2.0 * np.pi / mode.frequency)
        found = displacement(sim) / size
        sim.mechanics.rate()
        nodal = by_id(sim, sim.sampler.nodal_stress()[0][: sim.mechanics.n_owned]) / size
        recovered = by_id(sim, sim.sampler.stresses()["stress"]) / size
        pairs = {"displacement": (found, u), "nodal stress": (nodal, stress), "recovered stress": (recovered, stress),
                 "recovered deviator": (_deviator(recovered), _deviator(stress))}
        return Measured(t.spacing, {name: l2_error(sim, *pair) for name, pair in pairs.items()}, count)


def _deviator(s: np.ndarray) -> np.ndarray:
    return s - np.trace(s, axis1=1, axis2=2)[:, None, None] / 3.0 * np.eye(3)
