"""Problems in space: a ball of the nucleus that twists, a ball of fluid that turns, a cell that spreads."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.special import spherical_jn

from cellmig.case.load import load
from cellmig.case.shipped import FOLDER
from cellmig.laws import register
from cellmig.runs.cases import lone_body
from cellmig.simulation import Simulation

RADIUS = 5.0  # of the balls [µm]
SIZE = 1e-4  # amplitude of their motion, which is one of small strains [µm/µs]
# Wave numbers k of the slowest twist, and of the first turning flow without shear at R [1/µm].
TWIST = brentq(lambda q: spherical_jn(2, q) - q * spherical_jn(3, q), 2.0, 3.0) / RADIUS
TURN = brentq(lambda q: spherical_jn(2, q), 5.0, 6.5) / RADIUS


def ball(material: str, velocity: str) -> dict[str, Any]:
    """Tables of a ball of one material of `cases/ball.toml`, whose velocity is a formula times (-y, x, 0)."""
    tree = lone_body(cell(), material)
    tree["cells"][0]["velocity"] = [*(f"({velocity})*{along} um/us" for along in ("-y", "x")), "0 um/us"]
    return tree


def cell() -> dict[str, Any]:
    """Tables of the cell in space."""
    register()
    return load(FOLDER / "ball.toml", ("particles.per_cell=200",)).resolved()


def twisting() -> dict[str, Any]:
    """A ball of the nucleus's law whose halves turn against each other: j2(k r) z/r² (-y, x, 0) (Lamb 1882)."""
    q = f"({TWIST}*sqrt(x**2 + y**2 + z**2 + 1e-12))"
    return ball("nucleus", f"{SIZE * TWIST**2}*z/{q}**2*((3/{q}**2 - 1)*sin({q})/{q} - 3*cos({q})/{q}**2)")


def turning() -> dict[str, Any]:
    """A ball of the cytoplasm that turns, faster inside: j1(k r)/r (-y, x, 0)."""
    q = f"({TURN}*sqrt(x**2 + y**2 + z**2 + 1e-12))"
    return ball("cytoplasm", f"{SIZE * TURN}/{q}*(sin({q})/{q}**2 - cos({q})/{q})")


def twisted(sim: Simulation) -> dict[str, float]:
    """Share of the twist in the displacements, over its initial velocity [µs]."""
    X = sim.scene.X
    r = np.maximum(np.linalg.norm(X, axis=1), 1e-9)
    return {"twist": _share(sim, (spherical_jn(2, TWIST * r) * X[:, 2] / r**2), slice(0, 3))}


def turned(sim: Simulation) -> dict[str, float]:
    """Share of the turning flow in the velocities, over that at the start [-]."""
    r = np.maximum(np.linalg.norm(sim.scene.X, axis=1), 1e-9)
    return {"flow": _share(sim, spherical_jn(1, TURN * r) / r, slice(3, 6))}


def _share(sim: Simulation, speed: np.ndarray, columns: slice) -> float:
    """Share of the motion speed × (-y, x, 0) in columns of the state, by mass, over its initial size."""
    m, X = sim.mechanics, sim.scene.X
    shape, mass = (speed[:, None] * np.column_stack([-X[:, 1], X[:, 0], 0.0 * speed]))[m.ids], sim.scene.field("mass")
    found, whole = (mass[m.ids] @ (field * shape).sum(axis=1) for field in (m.state.owned[:, columns], shape))
    return float(found / whole) / SIZE


def exact_twist(t: np.ndarray) -> np.ndarray:
    """The twist (n,) [µs] of an elastic ball at times t (n,) [µs] (Lamb 1882)."""
    law = _material("nucleus")
    omega = TWIST * np.sqrt(law.shear_modulus / law.density)
    return np.sin(omega * t) / omega


def exact_flow(t: np.ndarray) -> np.ndarray:
    """The turning flow (n,) [-] at times t (n,) [µs], which decays as exp(-ν k² t) (Lamb, Hydrodynamics, 1932)."""
    law = _material("cytoplasm")
    return np.exp(-law.viscosity / law.density * TURN**2 * t)


def _material(name: str) -> Any:
    return load(FOLDER / "ball.toml").materials[name]
