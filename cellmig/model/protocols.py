"""What a law of each kind has, for type checkers; `own` laws that have it are as good as ours.

Formulas take and return a `Value`: they are computed with numbers and arrays, differentiated with dual numbers, and
translated to C.
"""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np

Value = Any  # float, array, dual number, or nested tuples of them for vectors and tensors


class Law(Protocol):
    """A law of any kind."""

    kind: str
    law: str


class Material(Law, Protocol):
    """A material; those with a director or activity have eta and zeta, and the methods of `Nematic`, besides."""

    energy_column: str
    fluid: bool  # whether energy and stress know F by J alone: the rest is forgotten when neighbours are found anew

    @property
    def density(self) -> float:
        """Mass density ρ0 [kg/m³]."""

    @property
    def viscosity(self) -> float:
        """Shear viscosity μ [Pa µs], 0 of a solid."""

    @property
    def shear_modulus(self) -> float:
        """Shear modulus at rest [Pa], 0 of a fluid."""

    @property
    def numerical_modulus(self) -> float:
        """Modulus of the elastic stabilisation [Pa]."""

    @property
    def sound_speed(self) -> float:
        """Speed of compression waves [µm/µs]."""

    def numerical_viscosity(self, spacing: float) -> float:
        """Viscosity of the viscous stabilisation [Pa µs] at a spacing [µm]."""

    def energy(self, F: Value) -> Value:
        """Energy per reference volume [Pa] at a deformation gradient F [-]."""

    def stress(self, F: Value) -> Value:
        """First Piola-Kirchhoff stress P [Pa], its derivative."""

    def out_of_plane(self, F: Value) -> Value:
        """Cauchy stress across the plane [Pa]."""


class Adhesion(Law, Protocol):
    """Bonds between surfaces."""

    @property
    def bond_density(self) -> float:
        """Bonds per reference area N [1/µm²]."""

    @property
    def equilibrium_distance(self) -> float:
        """Equilibrium distance ε [µm]."""

    @property
    def cutoff(self) -> float:
        """Distance beyond which surfaces do not interact [µm]."""

    @property
    def cap(self) -> float:
        """Distance below which the potential is quadratic [µm]."""

    @property
    def work(self) -> float:
        """Work of adhesion [pN/µm]."""

    def stiffness(self, least: float) -> float:
        """Largest stiffness [Pa/µm] at gaps of at least `least` [µm]."""

    def potential(self, r: Value) -> Value:
        """Energy of a bond of length r [pN µm]."""

    def slope(self, r: Value) -> Value:
        """Its derivative by r [pN]."""

    def primitive(self, r: Value) -> Value:
        """Its primitive, zero from the cutoff on [pN µm²]."""


@runtime_checkable
class ClosedAdhesion(Adhesion, Protocol):
    """Bonds whose mean over a segment has a closed form."""

    def closed_form(self, gap1: Value, gap2: Value) -> Value:
        """Positive where `mean` holds, for gaps [µm] of the ends."""

    def mean(self, gap1: Value, gap2: Value) -> Value:
        """Mean energy of a bond [pN µm] and its derivatives by both gaps [pN]."""


class SurfaceBonds(Adhesion, Protocol):
    """Bonds between surfaces in three dimensions, whose potential is integrated over triangles."""

    def second_primitive(self, r: Value) -> Value:
        """The primitive of `primitive`, zero from the cutoff on [pN µm³]."""


class ProtrusionLaw(Law, Protocol):
    """Push of the leading edge."""

    @property
    def cells(self) -> tuple[str, ...]:
        """Names of the cells that protrude."""

    @property
    def protrusion_ratio(self) -> float:
        """Ratio β of the push to the adhesion energy [-]."""

    @property
    def height(self) -> float:
        """Height ℓ of the pushing edge [µm]."""

    @property
    def random(self) -> bool:
        """Whether α is random; else it is 1/2."""

    @property
    def correlation_length(self) -> float:
        """Distance of the points where α is drawn [µm]."""

    @property
    def direction(self) -> tuple[float, ...]:
        """Direction along the substrate, of any length (d - 1,) [-]; empty for +x."""

    @property
    def basal(self) -> float:
        """Push outwards on every side over that of a polarity of size one [-]."""

    @property
    def gate(self) -> float | None:
        """Distance from other cells below which the membrane does not push [µm]."""

    def push(self, work: Value) -> Value:
        """Push without a random factor [pN/µm] for the work of adhesion N σ [pN/µm]."""

    def front(self, x: Value) -> Value:
        """Share of the push [-] at a distance x [µm] ahead of the mean of the surface."""

    def hold(self, bonded: Value) -> Value:
        """Share of the push [-] for a length `bonded` [µm] of closed bonds."""

    def ramp(self, g: Value) -> Value:
        """Share of the adhesion energy [-] below the height g [µm]."""

    def ramp_slope(self, g: Value) -> Value:
        """Its derivative by g [1/µm]."""

    def ramp_primitive(self, g: Value) -> Value:
        """Its primitive, zero below g = 0 [µm]; in three dimensions only."""


class PolarityLaw(Law, Protocol):
    """How the polarity of a cell changes from knot to knot."""

    @property
    def cells(self) -> tuple[str, ...]:
        """Names of the cells that have one; empty for all that protrude."""

    @property
    def start(self) -> tuple[float, ...]:
        """Polarity at the start (d - 1,) [-]; empty where it is drawn."""

    @property
    def interval(self) -> float:
        """Time from knot to knot [µs]."""

    def drawn(self, towards: Value, noise: Value) -> Value:
        """Polarities (…, d - 1) [-] at the start, for cues and normal numbers of that shape [-]."""

    def next(self, p: Value, towards: Value, noise: Value, chance: Value) -> Value:
        """Polarities (…, d - 1) [-] at the next knot, for normal numbers of that shape and uniform ones (…,) [-]."""


class Cortex(Law, Protocol):
    """Tension of a cell's surface."""

    def energy(self, stretch: Value) -> Value:
        """Energy per reference length [pN/µm] at a `stretch` [-]."""

    def tension(self, stretch: Value) -> Value:
        """Tension [pN/µm], its derivative."""


class Friction(Law, Protocol):
    """Drag of bonds on a membrane that slides along the substrate.

    One whose traction has a largest value tells it to `validate`: `largest`, this [Pa] and its speed [µm/µs], and
    `speed`, far below which it is linear [µm/µs].  One of bonds that live for a while has their `lifetime` [µs], within
    which changes are not resolved.
    """

    @property
    def coefficient(self) -> float:
        """Largest slope of the traction on fully bonded membrane by its speed [Pa µs/µm]."""

    def drag(self, share: Value, speed: Value) -> Value:
        """Traction [Pa] at a share of closed bonds [-] and a speed [µm/µs]."""


class Medium(Law, Protocol):
    """Drag of the liquid around cells."""

    @property
    def coefficient(self) -> float:
        """Largest traction over speed, times the radius of a cell [Pa µs]."""

    def force(self, size: Value, velocity: Value) -> Value:
        """Force [pN/µm, in space pN] on a length or area over the radius [-, µm] at a velocity [µm/µs]."""


class DirectorLaw(Law, Protocol):
    """How the director begins and moves."""

    start: str
    direction: tuple | None
    anchoring: str

    @property
    def uniform(self) -> bool:
        """Whether the field is uniform and stays so."""

    @property
    def angle(self) -> float:
        """Angle of a uniform start in two dimensions [rad]."""

    @property
    def mobility(self) -> float:
        """Mobility γ [µm²/µs], 0 if it is frozen."""


class Field(Law, Protocol):
    """An amount that depends on the place, and may on the time."""

    @property
    def unit(self) -> str:
        """Unit in the case file, of the kind of the amount; "" of pure numbers."""

    @property
    def steady(self) -> bool:
        """Whether it does not depend on the time."""

    def value(self, x: np.ndarray, time: float) -> np.ndarray:
        """Values (n,) in the code's units at places x (n, d) [µm] and a time [µs]."""


class Response(Law, Protocol):
    """How the push depends on the stiffness of the substrate, at once; clutches have a memory and no `factor`."""

    def factor(self, stiffness: Value) -> Value:
        """Factor of the push [-] at a stiffness [Pa]."""


class LoadCurve(Law, Protocol):
    """Factor on displacements and loads."""

    def value(self, t: Value) -> Value:
        """Factor [-] at a time t [µs]."""

    def rate(self, t: Value) -> Value:
        """Its derivative [1/µs]."""

    def acceleration(self, t: Value) -> Value:
        """The derivative of that [1/µs²]."""
