"""The director alone: its angle obeys the heat equation."""

from __future__ import annotations

import numpy as np
from scipy.special import jnp_zeros, jv

from cellmig.verify.reference import Measured, converges, exact, reference

from .scenes import built, by_id, drop

RADIUS = 5.0  # µm
RELAXING = {"law": "relaxing", "start": "radial", "mobility": "1 um^2/us", "anchoring": "none"}
ETA = 'materials.cytoplasm.eta="100 pN"'


@reference("director-relaxation", shows="rate of a mode θ = J1(κr) cos φ of a disc, free at the membrane, J1'(κR) = 0",
           source="Fourier: ∂θ/∂t = γ Δθ decays with γκ²", at=(150, 400, 1000, 2500), seconds=5.0,
           coarse={"rate": 1.0e-3},
           expected={"rate": converges(2, "a Rayleigh quotient: the square of an error h in gradients")})
def director_relaxation(count: int) -> Measured:
    """The rate follows from the amplitude of the mode after 1 µs; the inverse rate is 7 µs; nothing flows."""
    k = jnp_zeros(1, 1)[0] / RADIUS
    with built(drop(count, ETA, director=RELAXING)) as sim:
        X, V, m = sim.scene.X, sim.scene.field("V"), sim.mechanics
        r = np.maximum(np.hypot(*X.T), 1e-9)
        mode = jv(1, k * r) * X[:, 0] / r
        m.director.set(0.1 * mode[m.ids])
        dt = 0.5 * sim.control.director
        steps = int(np.ceil(1.0 / dt))
        for _ in range(steps):
            m.relax_director(1.0 / steps)
        left = (V * mode) @ by_id(sim, m.director.values[:, 0]) / (0.1 * (V * mode) @ mode)
        return Measured(sim.scene.templates[0].spacing, {"rate": abs(-np.log(left) / k**2 - 1.0)}, count)


@reference("director-uniform", shows="a uniform director after 100 steps", source="Δθ = 0", at=(150, 400, 1000),
           expected={"uniform, anywhere": exact(1e-12, "differences of equal angles are zero")})
def director_uniform(count: int) -> Measured:
    """Angles change by rounding alone."""
    with built(drop(count, ETA, director=RELAXING)) as sim:
        m = sim.mechanics
        m.director.set(np.full(count, 0.3))
        for _ in range(100):
            m.relax_director(0.5 * sim.control.director)
        return Measured(sim.scene.templates[0].spacing,
                        {"uniform, anywhere": float(np.abs(m.director.values - 0.3).max())}, count)
