"""The stable time step, mechanism by mechanism, followed through the deformation."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..meshfree.body import Scene
from ..meshfree.terms import Terms


class NumericsError(RuntimeError):
    """The numbers broke: a value that is not finite, an inverted particle, a step too small."""


class StepControl:
    """Largest stable step of the explicit scheme.

    An oscillation ω² with damping c is stable up to the root of c dt/2 + ω² dt²/4 = 1.  c and ω² are the largest
    eigenvalues on the reference configuration, carried on by the local bounds V J λmax(F⁻ᵀ Σ G⊗G/m F⁻¹), which
    see the few squeezed particles that set the limit of a deformed mesh.
    """

    def __init__(self, scene: Scene, terms: Terms, mobility: float = 0.0):
        """`mobility` : γ of a relaxing director [µm²/µs]."""
        used = [scene.templates[k] for k in np.unique(scene.kind)]
        rates = np.array([t.rates for t in used])
        self.stabilisation, self.viscous, self.elastic = rates.max(axis=0)  # [1/µs], [1/µs], [1/µs²]
        self._viscous0 = max(t.local_bound(t.viscous_weight) for t in used)
        self._elastic0 = max(t.local_bound(t.elastic_weight) for t in used)
        stiffness = terms.substrate.stiffness if terms.substrate else 0.0
        stiffness += 2.0 * terms.contact.stiffness if terms.contact and len(scene.kind) > 1 else 0.0
        self.contact = stiffness * max(_length_per_mass(t) for t in used)
        self.director = max(t.spacing for t in used) ** 2 / (4.0 * mobility) if mobility else math.inf

    def stable(self, limits: dict[str, Any] | None = None) -> dict[str, float]:
        """Stable step by mechanism [µs]; `limits` of the deformed state, none at rest."""
        viscous = limits["viscous"] / self._viscous0 if limits and self._viscous0 else 1.0
        elastic = limits["elastic"] / self._elastic0 if limits else 1.0
        c = self.stabilisation + self.viscous * viscous
        steps = {"viscosity": _root(c, 0.0), "sound": _root(c, self.elastic * elastic)}
        if self.contact:
            steps["contact"] = _root(c, self.contact)
        if math.isfinite(self.director):
            steps["director"] = self.director
        return steps


def binding(steps: dict[str, float]) -> tuple[str, float]:
    """The mechanism that sets the step, and the step [µs]."""
    name = min(steps, key=steps.get)
    return name, steps[name]


def _root(c: float, omega2: float) -> float:
    """Root of c dt/2 + ω² dt²/4 = 1 [µs]."""
    bottom = 0.5 * c + math.sqrt(0.25 * c * c + omega2)
    return 2.0 / bottom if bottom > 0 else math.inf


def _length_per_mass(t: Any) -> float:
    """Largest length of surface that a particle carries over its mass [µm²/fg]."""
    share = 0.5 * (t.segment_length + np.roll(t.segment_length, 1))
    return float((share / t.mass[t.surface]).max())
