"""The largest stable time step of the explicit scheme, by mechanism, for the current deformation and gaps."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..meshfree.renewal import at_rest, bounds
from ..meshfree.scene import Scene
from ..meshfree.terms import Terms
from .taut import at_rest as tense
from .taut import changes

if TYPE_CHECKING:  # who only asks for a stable step starts no MPI
    from .modes import Modes

BISECTIONS = 20  # for a gap, of which rounding is then far below the accuracy of a step's limits
# Gaps over the equilibrium distance between which bonds become compressed, of the substrate and of cells [-].
COMPRESSED = np.array([[0.5, 0.8], [0.25, 0.65]])
RISEN = 1.1  # ratio of the stiffness of bonds from which a mode is not the same any more [-]
TYPICAL = 0.94  # smallest gap of a contact over ε of its bonds, measured at 600 to 1,500 particles a cell [-]


class NumericsError(RuntimeError):
    """The numerical solution failed: a value is not finite, a particle is inverted, or the step is too small."""

    @classmethod
    def at(cls, mechanics: Any, time: float, cause: str, particle: int | None, remedy: str) -> NumericsError:
        """The error at a time [µs], with a particle, by default the one with the largest |ln J|; collective."""
        particle, J = mechanics.worst_particle(particle)
        cell = int(mechanics.scene.cell_of(particle)) + 1
        return cls.of(mechanics, time, f"{cause}; particle {particle} of cell {cell} has J = {J:.4g}", remedy)

    @classmethod
    def of(cls, mechanics: Any, time: float, cause: str, remedy: str) -> NumericsError:
        """The error at a time [µs]."""
        return cls(f"the simulation failed at {mechanics.scene.time_unit.text(time)}: {cause}; {remedy}")


NO_EXTREMES = {"J_min": math.inf, "J_max": -math.inf, "dt_min": math.inf, "dt_max": 0.0}


def widen(extremes: dict[str, float], name: str, least: float, most: float) -> None:
    """Extend the range of a quantity, as in NO_EXTREMES: "J" [-] or "dt" [µs], to the values `least` and `most`."""
    low, high = f"{name}_min", f"{name}_max"
    extremes[low], extremes[high] = min(extremes[low], least), max(extremes[high], most)


class StepControl:
    """Largest stable step of leapfrog.

    A step dt is stable if no mode has ½ dt c + ¼ dt² ω² > 1, with its damping c and frequency² ω².  `Modes` follows the
    largest of these forms in the deformed body with all its stresses and bonds, between two bounds: those of the
    particle whose own stress is stiffest, max_I w V_I J λmax(F⁻ᵀ [Σ_J G⊗G/m_J] F⁻¹) with the modulus w, and the sum of
    the largest eigenvalues of all parts on the reference configuration, those of stresses times the growth of that
    maximum.  Bonds are stiffer at smaller gaps, which are not known before a step: the integrator checks afterwards
    which gaps occurred.

    Attributes
    ----------
    eps, typical : (2,) float -- equilibrium distance of bonds and typical smallest gap, of the substrate and
        between cells [µm]; 0 where no bonds act.
    touches : bool -- whether bonds act at all.
    director : float -- stable step of a relaxing director [µs].

    Source: derived here.  At 1 leapfrog with damping at the old velocity has the eigenvalue -1; the lower bound is the
    largest Rayleigh quotient of a single particle's stress, the upper one Weyl's inequality.
    """

    def __init__(self, scene: Scene, terms: Terms):
        """Find the largest eigenvalues of the scene's kinds of cells, as they were when their neighbours were found."""
        kinds = [scene.templates[k] for k in np.unique(scene.kind)]
        used = [bounds(t) for t in kinds]
        rates = np.array([t.rates for t in used])
        self.stabilisation, self.viscous, self.elastic, self.stiffening = rates.max(axis=0)  # 1/µs twice, 1/µs² twice
        self._viscous0 = max(t.viscous for t in used)
        self._elastic0 = max(t.elastic for t in used)
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
        self._size_per_mass = max(t.size_per_mass for t in used)
        drag = terms.friction.coefficient if terms.friction and terms.substrate else 0.0
        drag += 2.0 * terms.contacts.coefficient if terms.contacts else 0.0  # against each other
        drag += terms.medium.coefficient / min(t.radius for t in used) if terms.medium else 0.0
        self._drag, tension = float(drag), tense(terms.cortex) if terms.cortex else 0.0
        self._tension = 0.0 if changes(terms.cortex) else tension  # where it changes, `Taut` says what it does
        self._surface = (self._drag * self._size_per_mass,  # damping and frequency² of a surface particle
                         tension * max(t.drawn_per_mass for t in used))
        # the particle whose own stress is stiffest is then seldom in the fastest mode, and no measure of its growth
        self._anew = scene.dimension == 3 and any(scene.templates[k].F0 is not None for k in scene.kind)
        self._follows = not terms.director_acts  # the modes lack its stresses and torques
        law = terms.director_law if terms.director == "relaxing" else None
        mobility = law.mobility if law is not None else 0.0
        self.director = 2.0 / (mobility * max(at_rest(t).diffusion for t in kinds)) if mobility else math.inf

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

    def compression(self, gaps: np.ndarray) -> float:
        """Compression of bonds at gaps (2,) [µm], from 0 to 1 over the ranges COMPRESSED [-]."""
        there, (none, full) = self.eps > 0.0, COMPRESSED
        share = np.clip((none - gaps / np.where(there, self.eps, 1.0)) / (none - full), 0.0, 1.0)[there]
        return float(share.max(initial=0.0))

    def stable(self, limits: dict[str, Any] | None = None, gaps: np.ndarray | None = None) -> dict[str, float]:
        """Stable step by mechanism: "viscosity", "sound", and where they apply "contact" and "director" [µs].

        Parameters
        ----------
        limits : dict -- of `Mechanics.limits`, and of `follow` where the modes are followed; None for the reference
            configuration.
        gaps : (2,) float -- smallest gaps that are expected, to the substrate and between cells [µm]; default: typical.
        """
        limits = limits or {"viscous": self._viscous0, "elastic": self._elastic0, "J_min": 1.0}
        growth = limits["viscous"] / self._viscous0 if self._viscous0 else 1.0
        viscous, elastic = self.viscous * growth, self.elastic * limits["elastic"] / self._elastic0
        c = self.stabilisation / limits["J_min"] + viscous  # F : F - J is at least J
        if "damping" in limits:
            c = min(c, max(limits["viscous"], limits["damping"]))
        sound = elastic + self.stiffening
        steps = {"viscosity": _root(c, 0.0), "sound": _root(c, sound)}
        contact = max(self._stiffness(self.typical if gaps is None else gaps))
        drag, tension = self._surface[0], limits.get("cortex", self._surface[1])
        if contact or drag or tension:
            steps["contact"] = _root(c + drag, contact * self._size_per_mass + tension + sound)
        if "share" in limits:
            followed = self._followed(limits, contact)
            steps = {name: followed if self._anew else max(step, followed) for name, step in steps.items()}
        if math.isfinite(self.director):
            steps["director"] = self.director / max(1.0, growth)  # diffusion, as of momentum
        return steps

    def _stiffness(self, gaps: np.ndarray) -> tuple[float, float]:
        """Largest stiffness of the bonds of a surface at gaps (2,) [µm] to the substrate, and to other cells, on both
        of which they act [Pa/µm].
        """
        of = [sides * law.stiffness(gap) if law else 0.0
              for (law, sides), gap in zip(self._contacts, gaps, strict=True)]
        return of[0], of[1]

    def follow(self, modes: Modes, limits: dict[str, Any], gaps: np.ndarray, dt: float, before: float | None
               ) -> dict[str, float]:
        """What `modes` say for the expected `gaps` (2,) [µm]; collective.

        Parameters
        ----------
        limits : dict -- of `Mechanics.limits`.
        dt : float -- stable step of shortly before [µs].
        before : float -- stiffness of bonds for which they were followed then [Pa/µm]; None for the first time.

        Returns
        -------
        dict -- "share" of the stable step [-] at the step "at" [µs] for bonds of the stiffness "held" [Pa/µm]; with a
        director, whose stresses and torques the modes lack, the largest rate of "damping" [1/µs].
        """
        if before is None:
            dt = min(dt, binding(self.stable(limits, gaps))[1])
        dt = modes.comm.bcast(dt)  # processors may differ in the last bit
        substrate, between = self._stiffness(gaps)
        held = max(substrate, between)
        if not self._follows:
            return {"damping": 2.0 / dt * modes.follow(dt, 0.0, None, 0.0, before is None), "held": held}
        stiffness = np.full(modes.dimension, between)
        stiffness[-1] = held
        risen = before is None or held > RISEN * before
        return {"share": modes.follow(dt, self._drag, stiffness, self._tension, risen), "at": dt, "held": held}

    def _followed(self, limits: dict[str, Any], contact: float) -> float:
        """The stable step [µs] by the mode that was followed, and at least by single particles, for bonds of the
        stiffness `contact` [Pa/µm].

        The share is largest of the forms ½ dt c + ¼ dt² ω² of all modes, each of which grows with dt at least in
        proportion and at most with its square; stiffer bonds add at most their own.
        """
        dt = limits["at"]
        stiffer = 0.25 * dt**2 * self._size_per_mass
        own = max(limits["elastic"], limits.get("cortex", 0.0))
        alone = 0.5 * dt * limits["viscous"], 0.25 * dt**2 * own, stiffer * contact
        share = max(limits["share"] + stiffer * max(contact - limits["held"], 0.0), *alone)
        return dt / max(share, math.sqrt(share))


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
