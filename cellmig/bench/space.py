"""Problems in space: a ball of the nucleus that twists, a ball of fluid that turns, a cell that spreads."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.special import spherical_jn

from cellmig.case.load import load
from cellmig.laws import register
from cellmig.runs.cases import FOLDER
from cellmig.simulation import Simulation

RADIUS = 5.0  # of the balls [µm]
SIZE = 1e-4  # amplitude of their motion, which is one of small strains [µm/µs]
# Wave numbers k of the slowest twist, and of the first turning flow without shear at R [1/µm].
TWIST = brentq(lambda q: spherical_jn(2, q) - q * spherical_jn(3, q), 2.0, 3.0) / RADIUS
TURN = brentq(lambda q: spherical_jn(2, q), 5.0, 6.5) / RADIUS


def ball(material: str, velocity: str) -> dict[str, Any]:
    """Tables of a ball of one material of `cases/ball.toml`, whose velocity is a formula times (-y, x, 0)."""
    tree = cell()
    flow = [f"({velocity})*{along} um/us" for along in ("-y", "x")]
    only = {"material": material, "centre": ["0 um"] * 3, "rest": False, "velocity": [*flow, "0 um/us"]}
    shape = {key: value for key, value in tree["cells"][0].items() if key not in ("nucleus", "nucleus_ratio")}
    others = {key: value for key, value in tree.items() if key != "adhesion"}
    return others | {"cells": [shape | only], "materials": {material: tree["materials"][material]}}


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


def judge_twist(t: np.ndarray, series: dict[str, np.ndarray], _: Any) -> dict[str, float]:
    """Root mean square error over time of the twist, over that of the exact one."""
    omega = TWIST * _root_of("nucleus", lambda law: law.shear_modulus / law.density)
    return {"error": _over(series["twist"], np.sin(omega * t) / omega)}


def judge_turn(t: np.ndarray, series: dict[str, np.ndarray], _: Any) -> dict[str, float]:
    """Root mean square error over time of the flow, over that of the exact one, which decays as exp(-ν k² t)."""
    rate = TURN**2 * _root_of("cytoplasm", lambda law: (law.viscosity / law.density) ** 2)
    return {"error": _over(series["flow"], np.exp(-rate * t))}


def _root_of(material: str, square: Callable[[Any], float]) -> float:
    return float(np.sqrt(square(load(FOLDER / "ball.toml").materials[material])))


def _over(found: np.ndarray, exact: np.ndarray) -> float:
    return float(np.sqrt(np.square(found - exact).mean() / np.square(exact).mean()))
