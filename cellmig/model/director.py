"""Initial state, evolution and anchoring of the director h of equation (7) of Bai, Lin & Zeng (2019).

In two dimensions a director is its angle θ, h = (cos θ, sin θ), in three the unit vector h itself.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy import sqrt

from ..case.expression import Expression, evaluate
from ..case.pointwise import Vector, Vector3
from ..case.registry import law, parameter, quantity
from .protocols import DirectorLaw
from .tensors import cross, dot

STARTS = ("uniform", "radial", "tangential")
ANGLE = "angle of a uniform field in two dimensions, from x"
DIRECTION = ("direction of a uniform field, of any length; where components are formulas of x, y (and z), the field "
             "that they give; by default x")


def numbers(dimension: int) -> int:
    """How many numbers a director is: an angle, or the components of a unit vector."""
    return 1 if dimension == 2 else dimension


def initial(law: DirectorLaw | None, from_centre: np.ndarray) -> np.ndarray:
    """Initial directors (n, 1) [rad] or (n, 3) [-] of particles whose places `from_centre` (n, d) [µm] are from the
    centre of their cell.

    Tangential ones go around the centre, in space around the axis through it along z.
    """
    n, d = from_centre.shape
    given = law.direction if law is not None else None
    if law is None or (law.start == "uniform" and given is None):
        angle = law.angle if law is not None else 0.0
        return np.full((n, 1), angle) if d == 2 else np.repeat(np.eye(3)[:1], n, axis=0)
    if given is None:
        along = from_centre
    else:  # zeros lose their sign, which would turn a director of no direction
        along = np.column_stack([evaluate(value, from_centre) for value in given]) + 0.0
    if d == 2:
        return np.arctan2(along[:, 1:], along[:, :1]) + (0.5 * np.pi if law.start == "tangential" else 0.0)
    if law.start == "tangential":
        along = np.cross(np.eye(3)[2], along)
    length = np.linalg.norm(along, axis=1, keepdims=True)
    return np.where(length > 0.0, along / np.where(length > 0.0, length, 1.0), np.eye(3)[0])


class _Begun:
    """What laws of the director have in common: how it begins."""

    start: str
    angle: float
    direction: tuple | None
    anchoring: str

    def __post_init__(self) -> None:
        """Check the direction.

        Raises ValueError if it is zero, or has no meaning; the message is for the user.
        """
        if self.direction is None:
            return
        if self.start != "uniform" or self.angle:
            raise ValueError("direction: is that of a uniform field, in place of angle: give one of them, and "
                             "start = \"uniform\"")
        if not any(self.direction):
            raise ValueError("direction: expects a direction, not zero")

    @property
    def uniform(self) -> bool:
        """Whether the field is uniform and stays so."""
        given: tuple[Any, ...] = self.direction or ()
        formula = any(isinstance(value, Expression) for value in given)
        return self.start == "uniform" and self.anchoring == "none" and not formula


@law("director", "frozen")
class FrozenDirector(_Begun):
    """Director that does not change in a material point, Dh/Dt = 0: the limit γ = 0 of a relaxing one.

    The η term of equation (7) of Bai, Lin & Zeng (2019) is then elastic; a radial field has the modulus η/r² at the
    radius r, in space 2 η/r².
    """

    start: str = parameter("initial director field", "uniform", choices=STARTS)
    angle: float = quantity("rad", ANGLE, "0 rad")
    direction: tuple | None = quantity("", DIRECTION, None, shape=("d",), formula=True)

    mobility = 0.0
    anchoring = "none"


@law("director", "relaxing")
class RelaxingDirector(_Begun):
    """Director that relaxes, Dh/Dt = γ (Δh - f(h)), where f keeps |h| = 1; in the plane its angle diffuses.

    With the anchoring "surface", h of a surface particle keeps its angle to the membrane, on which the reaction acts as
    a couple.  Source: the simplified Ericksen-Leslie theory of Lin & Liu (2000).
    """

    start: str = parameter("initial director field", "radial", choices=STARTS)
    angle: float = quantity("rad", ANGLE, "0 rad")
    direction: tuple | None = quantity("", DIRECTION, None, shape=("d",), formula=True)
    mobility: float = quantity("um^2/us", "mobility γ", "1 um^2/us", above=0)
    anchoring: str = parameter("anchoring of h at the membrane", "none", choices=("none", "surface"))


class Couple:
    """Torque of a particle at the membrane as forces on its neighbours along it, in two dimensions."""

    def force(self, torque, edge: Vector):
        """Forces on both neighbours [pN/µm], for a torque [pN] and the vector from the one to the other [µm]."""
        dx, dy = edge
        size = torque / (dx * dx + dy * dy)
        return (size * dy, -size * dx), (-size * dy, size * dx)


class Anchor:
    """Director of a particle at the membrane in space, `across` n + `along` t, both parts constant.

    n is the unit vector along `normal`, the sum of the cross products of the edges of all triangles around [µm²], t the
    direction within the membrane of a `tangent` that its particles carry along [µm].
    """

    def direction(self, normal: Vector3, tangent: Vector3, across, along):
        """The director [-]."""
        n, t, _, _ = self.frame(normal, tangent)
        return tuple(across * x + along * y for x, y in zip(n, t, strict=True))

    def reaction(self, normal: Vector3, tangent: Vector3, director: Vector3, torque: Vector3):
        """Minus the derivatives of an energy by `normal` [pN/µm] and by `tangent` [pN], whose own by the director is
        -`torque` [pN µm].  The couple is h × torque, and turns n and t together.
        """
        n, t, long, inside = self.frame(normal, tangent)
        b, couple = cross(n, t), cross(director, torque)
        spin = dot(couple, n) / inside
        tilt = spin * dot(tangent, n)
        tilting = tuple((x - tilt * y) / long for x, y in zip(cross(couple, n), b, strict=True))
        return tilting, tuple(spin * x for x in b)

    def frame(self, normal: Vector3, tangent: Vector3):
        """n, t [-], length of `normal` [µm²], of the part of `tangent` within the membrane [µm]."""
        long = sqrt(dot(normal, normal))
        n = tuple(x / long for x in normal)
        off = dot(tangent, n)
        within = tuple(x - off * y for x, y in zip(tangent, n, strict=True))
        inside = sqrt(dot(within, within))
        return n, tuple(x / inside for x in within), long, inside
