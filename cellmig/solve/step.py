"""The largest stable time step of the explicit scheme, by mechanism, for the current deformation and gaps."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..meshfree.body import Template
from ..meshfree.renewal import at_rest
from ..meshfree.scene import Scene
from ..meshfree.terms import Terms

BISECTIONS = 20  # for a gap, of which rounding is then far below the accuracy of a step's limits
TYPICAL = 0.94  # smallest gap of a contact over ε of its bonds, measured at 600 to 1,500 particles a cell [-]


class NumericsError(RuntimeError):
    """The numerical solution failed: a value is not finite, a particle is inverted, or the step is too small."""

    @classmethod
    def at(cls, mechanics: Any, time: float, cause: str, particle: int | None, remedy: str) -> NumericsError:
        """The error at a time [µs], with a particle, by default the one with the largest |ln J|; collective."""
        particle, J = mechanics.worst_particle(particle)
        return cls(f"the simulation failed at {mechanics.scene.time_unit.text(time)}: {cause}; particle {particle} of "
                   f"cell {int(mechanics.scene.cell_of(particle)) + 1} has J = {J:.4g}; {remedy}")


NO_EXTREMES = {"J_min": math.inf, "J_max": -math.inf, "dt_min": math.inf, "dt_max": 0.0}


def widen(extremes: dict[str, float], name: str, least: float, most: float) -> None:
    """Extend the range of a quantity, as in NO_EXTREMES: "J" [-] or "dt" [µs], to the values `least` and `most`."""
    low, high = f"{name}_min", f"{name}_max"
    extremes[low], extremes[high] = min(extremes[low], least), max(extremes[high], most)


class StepControl:
    """Largest stable step of leapfrog.

    A mode with u'' + c u' + ω² u = 0 is stable up to the root of c dt/2 + ω² dt²/4 = 1.  c and ω² are those that
    `Modes` follows in the deformed body, between two bounds of its largest eigenvalues: that of the particle whose own
    stress is stiffest, max_I w V_I J λmax(F⁻ᵀ [Σ_J G⊗G/m_J] F⁻¹) with the modulus w, and the largest eigenvalue on the
    reference configuration times the growth of that maximum.  Bonds are stiffer at smaller gaps, which are not known
    before a step: the integrator checks afterwards which gaps occurred.

    Attributes
    ----------
    eps, typical : (2,) float -- equilibrium distance of bonds and typical smallest gap, of the substrate and
        between cells [µm]; 0 where no bonds act.
    touches : bool -- whether bonds act at all.
    director : float -- stable step of a relaxing director [µs].

    Source: derived here.  The root is where leapfrog with damping at the old velocity has the eigenvalue -1; the lower
    bound is the largest Rayleigh quotient of a single particle's stress.
    """

    def __init__(self, scene: Scene, terms: Terms):
        """Find the largest eigenvalues of the scene's kinds of cells, as they were when their neighbours were found."""
        used = [at_rest(scene.templates[k]) for k in np.unique(scene.kind)]
        rates = np.array([t.rates for t in used])
        self.stabilisation, self.viscous, self.elastic, self.stiffening = rates.max(axis=0)  # 1/µs twice, 1/µs² twice
        self._viscous0 = max(t.local_bound(t.viscous_weight) for t in used)
        self._elastic0 = max(t.local_bound(t.elastic_weight) for t in used)
        # a gap between cells is closed from both sides; the strongest of their bonds stand for all, and for the wall of
        # a cell against itself, which ends at its equilibrium distance and has no gap for a softer contact
        laws = terms.contacts.laws if terms.contacts is not None else ()
        between = max(laws, default=None, key=lambda law: (law.work > 0.0, _strength(law)))
        self._contacts = [(terms.substrate, 1.0), (between, 2.0)]
        acting = [law is not None and law.stiffness(0.0) > 0.0 for law, _ in self._contacts]
        self.touches = any(acting)
        self.eps = np.array([law.equilibrium_distance if law and acts else 0.0
                             for (law, _), acts in zip(self._contacts, acting, strict=True)])
        self.typical = TYPICAL * self.eps
        if len(scene.kind) == 1:
            self.typical[1] = math.inf  # of a cell with itself
        self._size_per_mass = max(_size_per_mass(t) for t in used)
        drag = terms.friction.coefficient * self._size_per_mass if terms.friction and terms.substrate else 0.0
        drag += 2.0 * terms.contacts.coefficient * self._size_per_mass if terms.contacts else 0.0  # against each other
        drag += max(terms.medium.coefficient / t.radius * _size_per_mass(t) for t in used) if terms.medium else 0.0
        tension = terms.cortex.tension(1.0) * max(_inverse_inertia(t) for t in used) if terms.cortex else 0.0
        self._surface = float(drag), float(tension)  # damping and frequency² of a surface particle
        # the particle whose own stress is stiffest is then seldom in the fastest mode, and no measure of its growth
        self._anew = scene.dimension == 3 and any(scene.templates[k].F0 is not None for k in scene.kind)
        self._follows = not terms.director_acts  # the modes lack its stresses and torques
        law = terms.director_law if terms.director == "relaxing" else None
        mobility = law.mobility if law is not None else 0.0
        self.director = 2.0 / (mobility * max(t.diffusion for t in used)) if mobility else math.inf

    def gaps(self, gap: float, contact: float) -> np.ndarray:
        """Gaps (2,) [µm]: the least `gap` [µm] to the substrate, and that of flat contacts between cells which are as
        stiff, over the mass, as the stiffest one, `contact` [1/µs²].
        """
        law, sides = self._contacts[1]
        if law is None or not contact > 0.0:
            return np.array([gap, np.inf])
        low, high = 0.0, 2.0 * law.equilibrium_distance
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            softer = sides * law.stiffness(middle) * self._size_per_mass < contact
            low, high = (low, middle) if softer else (middle, high)
        return np.array([gap, low])

    def stable(self, limits: dict[str, Any] | None = None, gaps: np.ndarray | None = None) -> dict[str, float]:
        """Stable step by mechanism: "viscosity", "sound", and where they apply "contact" and "director" [µs].

        Parameters
        ----------
        limits : dict -- of `Mechanics.limits`, and of `Modes.follow` where the modes are followed; None for the
            reference configuration.
        gaps : (2,) float -- smallest gaps that are expected, to the substrate and between cells [µm]; default: typical.
        """
        limits = limits or {"viscous": self._viscous0, "elastic": self._elastic0, "J_min": 1.0}
        growth = limits["viscous"] / self._viscous0 if self._viscous0 else 1.0
        viscous, elastic = self.viscous * growth, self.elastic * limits["elastic"] / self._elastic0
        if "sound" in limits:
            followed = max(limits["viscous"], limits["viscosity"])
            viscous = followed if self._anew else min(viscous, followed)
            followed = max(limits["elastic"], limits["sound"])
            elastic = (followed if self._anew else min(elastic, followed)) if self._follows else elastic
        c = self.stabilisation / limits["J_min"] + viscous  # F : F - J is at least J
        sound = elastic + self.stiffening
        steps = {"viscosity": _root(c, 0.0), "sound": _root(c, sound)}
        contact = max(sides * law.stiffness(gap) if law else 0.0
                      for (law, sides), gap in zip(self._contacts, self.typical if gaps is None else gaps, strict=True))
        if contact or self._surface != (0.0, 0.0):
            drag, tension = self._surface
            steps["contact"] = _root(c + drag, contact * self._size_per_mass + tension + sound)
        if math.isfinite(self.director):
            steps["director"] = self.director / max(1.0, growth)  # diffusion, as of momentum
        return steps


def _strength(law: Any) -> float:
    """Stiffness of a contact in use, of bonds that are pressed and of those at equilibrium [Pa/µm]."""
    return law.stiffness(TYPICAL * law.equilibrium_distance) + law.stiffness(law.equilibrium_distance)


def binding(steps: dict[str, float]) -> tuple[str, float]:
    """The mechanism with the smallest step, and that step [µs]."""
    name = min(steps, key=lambda name: steps[name])
    return name, steps[name]


def _root(c: float, omega2: float) -> float:
    """Positive root dt of c dt/2 + ω² dt²/4 = 1 [µs], for c [1/µs] and ω² [1/µs²]."""
    bottom = 0.5 * c + math.sqrt(0.25 * c * c + omega2)
    return 2.0 / bottom if bottom > 0 else math.inf


def _size_per_mass(t: Template) -> float:
    """Largest ratio of dual length [µm] or area [µm²] to mass of a surface particle [1/fg times that]."""
    share = np.zeros(len(t.surface))
    np.add.at(share, t.places, t.facet_size[:, None] / t.places.shape[1])
    return float((share / t.mass[t.surface]).max())


def _inverse_inertia(t: Template) -> float:
    """Bound of the largest eigenvalue of a surface under tension, over the tension: a row sum over the mass, with the
    unit of 1/mass, or of 1/(mass × length) in two dimensions.

    A segment of length L has the stiffness 1/L; a triangle of area A with the edges e has |eᵢ·eⱼ|/4A.
    """
    x = t.X[t.facets]
    if t.places.shape[1] == 2:
        rows = 2.0 / t.facet_size[:, None].repeat(2, axis=1)
    else:
        edges = np.roll(x, -1, axis=1) - np.roll(x, 1, axis=1)  # opposite of each corner
        rows = np.abs(edges @ edges.transpose(0, 2, 1)).sum(axis=2) / (4.0 * t.facet_size[:, None])
    total = np.zeros(len(t.surface))
    np.add.at(total, t.places, rows)
    return float((total / t.mass[t.surface]).max())
