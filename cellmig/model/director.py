"""The director field h = (cos θ, sin θ) of the cytoplasm: where it starts and how it moves."""

from __future__ import annotations

import numpy as np

from ..case.registry import law, parameter, quantity

STARTS = ("uniform", "radial", "tangential")


def start_angle(start: str, angle: float, X: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Angle θ (n,) [rad] at the start, for particles at X (n, 2) [µm] of a cell with this centre (2,) [µm]."""
    if start == "uniform":
        return np.full(len(X), angle)
    theta = np.arctan2(*(X - centre).T[::-1])
    return theta if start == "radial" else theta + 0.5 * np.pi


@law("director", "frozen")
class FrozenDirector:
    """Director carried by the material unchanged, Dθ/Dt = 0: the η term is then elastic (modulus η/r²)."""

    start: str = parameter("state at the start", "uniform", choices=STARTS)
    angle: float = quantity("rad", "angle θ of a uniform start", "0 rad")

    mobility = 0.0
    anchoring = "none"


@law("director", "relaxing")
class RelaxingDirector:
    """Director that relaxes, h_t = γ (Δh - f(h)): with |h| = 1 kept by f, Dθ/Dt = γ Δθ.

    "surface" anchoring holds θ of a surface particle at the angle of the membrane; its couple acts on the membrane.
    """

    start: str = parameter("state at the start", "radial", choices=STARTS)
    angle: float = quantity("rad", "angle θ of a uniform start", "0 rad")
    mobility: float = quantity("um^2/us", "mobility γ", "1 um^2/us", above=0)
    anchoring: str = parameter("what holds θ at the membrane", "none", choices=("none", "surface"))
