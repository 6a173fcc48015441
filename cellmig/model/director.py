"""Initial state and evolution of the director h = (cos θ, sin θ) of equation (7) of Bai, Lin & Zeng (2019)."""

from __future__ import annotations

import numpy as np

from ..case.pointwise import Vector
from ..case.registry import law, parameter, quantity

STARTS = ("uniform", "radial", "tangential")


def start_angle(start: str, angle: float, X: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Initial angles θ (n,) [rad] of particles at X (n, 2) [µm] of a cell with this `centre` (2,) [µm].

    `start` is one of STARTS; `angle` [rad] is that of a uniform field.
    """
    if start == "uniform":
        return np.full(len(X), angle)
    theta = np.arctan2(*(X - centre).T[::-1])
    return theta if start == "radial" else theta + 0.5 * np.pi


@law("director", "frozen")
class FrozenDirector:
    """Director that does not change in a material point, Dθ/Dt = 0: the limit γ = 0 of a relaxing one.

    The η term of equation (7) of Bai, Lin & Zeng (2019) is then elastic; a radial field has the modulus η/r² at the
    radius r.
    """

    start: str = parameter("initial director field", "uniform", choices=STARTS)
    angle: float = quantity("rad", "angle θ of a uniform field", "0 rad")

    mobility = 0.0
    anchoring = "none"


@law("director", "relaxing")
class RelaxingDirector:
    """Director that relaxes, Dh/Dt = γ (Δh - f(h)); as f keeps |h| = 1, the angle diffuses, Dθ/Dt = γ Δθ.

    With the anchoring "surface", θ of a surface particle is the angle of the membrane [rad], on which the reaction acts
    as a couple.  Source: the simplified Ericksen-Leslie theory of Lin & Liu (2000).
    """

    start: str = parameter("initial director field", "radial", choices=STARTS)
    angle: float = quantity("rad", "angle θ of a uniform field", "0 rad")
    mobility: float = quantity("um^2/us", "mobility γ", "1 um^2/us", above=0)
    anchoring: str = parameter("anchoring of θ at the membrane", "none", choices=("none", "surface"))


class Couple:
    """Torque of a particle at the membrane as forces on its neighbours along it."""

    def force(self, torque, edge: Vector):
        """Forces on both neighbours [pN/µm], for a torque [pN] and the vector from the one to the other [µm]."""
        dx, dy = edge
        size = torque / (dx * dx + dy * dy)
        return (size * dy, -size * dx), (-size * dy, size * dx)
