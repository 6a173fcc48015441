"""Cytoplasm whose network forgets: start-up of flows, relaxation, pressing between walls, a turning drop."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.integrate import quad
from scipy.special import jn_zeros, jv

from cellmig.case.load import from_dict
from cellmig.case.registry import laws
from cellmig.case.schema import Case
from cellmig.verify.reference import Measured, converges, exact, reference

from .scenes import built, drop, set_state, velocity

G, TAU = 2000.0, 1.0  # Pa, µs
SOURCE = "upper-convected Maxwell model (Bird, Armstrong & Hassager 1987), by hand"
SECOND = "the shares of a step are exact where C⁻¹ is linear in time"


def fluid() -> Any:
    """A network of modulus G and relaxation time TAU without viscosity beside it, that hardly changes its volume."""
    return laws("material")["maxwell"](viscosity=1e-9, bulk_modulus=2.2e9, reduced_bulk_modulus=2.2e9, shear_modulus=G,
                                       relaxation_time=TAU)


def network_stress(F: Callable[[float], np.ndarray], end: float, steps: int) -> np.ndarray:
    """Cauchy stress G (b - 1) (2, 2) [Pa] after equal steps to a time `end` [µs]; F(t) (2, 2) [-] keeps the volume."""
    law, A = fluid(), np.eye(2)
    shares = law.network_shares(end / steps)
    at = [F(t) for t in np.linspace(0.0, end, steps + 1)]
    for before, now in pairwise(at):
        for there, share in zip((before, now), shares, strict=True):
            A = np.array(law.network_renewed(there, A, share))
    return G * (at[-1] @ A @ at[-1].T - np.eye(2))


@reference("network-shear", shows="stresses after 2 τ of shear at the rate 1/τ, from rest; the step is the size",
           source=SOURCE, unit="tau", at=(0.5, 0.25, 0.125, 0.0625),
           expected={"σ12": exact(1e-12, "(C⁻¹)12 is linear in time"), "σ11 - σ22": converges(2, SECOND),
                     "σ12 of a strain that is held": exact(1e-12, "the shares of a step are exact at constant strain")})
def network_shear(step: float) -> Measured:
    """σ12 = G (1 - e), σ11 - σ22 = 2 G (1 - (1 + t/τ) e) with e = exp(-t/τ); a strain of 1 that is held keeps G e."""
    count, e = round(2.0 / step), np.exp(-2.0)
    s = network_stress(lambda t: np.array([[1.0, t / TAU], [0.0, 1.0]]), 2.0 * TAU, count)
    held = network_stress(lambda t: np.array([[1.0, 1.0], [0.0, 1.0]]), 2.0 * TAU, count)
    return Measured(step, {"σ12": abs(s[0, 1] / (G * (1.0 - e)) - 1.0),
                           "σ11 - σ22": abs((s[0, 0] - s[1, 1]) / (2.0 * G * (1.0 - 3.0 * e)) - 1.0),
                           "σ12 of a strain that is held": abs(held[0, 1] / (G * e) - 1.0)})


@reference("network-stretched", shows="difference of stresses after 2 τ of planar extension; the step is the size",
           source=SOURCE, unit="tau", at=(0.5, 0.25, 0.125, 0.0625),
           expected={"at 0.3/τ, which comes to rest": converges(2, SECOND),
                     "at 1/τ, which grows without bound": converges(2, SECOND)})
def network_stretched(step: float) -> Measured:
    """b11 = (1 + 1/aτ) exp(at) - 1/aτ with a = 2ε̇ - 1/τ, and b22 with -ε̇."""
    found = {}
    for name, rate in (("at 0.3/τ, which comes to rest", 0.3), ("at 1/τ, which grows without bound", 1.0)):
        s = network_stress(lambda t, k=rate: np.diag(np.exp([k * t / TAU, -k * t / TAU])), 2.0 * TAU, round(2.0 / step))
        b = [(1.0 + 1.0 / a) * np.exp(2.0 * a) - 1.0 / a for a in (2.0 * rate - 1.0, -2.0 * rate - 1.0)]
        found[name] = abs((s[0, 0] - s[1, 1]) / (G * (b[0] - b[1])) - 1.0)
    return Measured(step, found)


def pressed(dimension: int, step: float) -> Case:
    """A block of 2 µm that smooth walls press to 0.8 of its length in 10 s and hold for 20 s more, free across."""
    ramp = {"law": "ramp", "duration": "10 s"}
    sides = ("left", "bottom", "front")[:dimension]
    walls: list[dict] = [{"name": side, "parts": [side],
                          "displacement": ["0 um" if axis == k else "free" for axis in range(dimension)]}
                         for side, k in zip(sides, (0, dimension - 1, 1), strict=False)]
    walls.append({"name": "right", "parts": ["right"], "displacement": ["-0.4 um"] + ["free"] * (dimension - 1),
                  "load_curve": ramp})
    size = {"shape": "rectangle", "width": "2 um", "height": "2 um"} if dimension == 2 else {
        "shape": "box", "a": "2 um", "b": "2 um", "c": "2 um"}
    plasm = {"law": "maxwell", "viscosity": "1 mPa s", "bulk_modulus": "2.2 GPa", "reduced_bulk_modulus": "1 GPa",
             "shear_modulus": "1 kPa", "relaxation_time": "10 s"}
    return from_dict({
        "dimension": dimension, "particles": {"per_cell": 60}, "supports": walls, "materials": {"plasm": plasm},
        "time": {"end": "30 s", "samples": 3, "frames": 1, "integrator": "overdamped", "step": f"{step} s"},
        "cells": [{"name": "Block", "centre": ["0 um"] * dimension, "material": "plasm"} | size]})


@reference("network-pressed", shows="force on the walls that press a block, and hold it; the step is the size",
           source="A' = (λ⁻² - A)/τ of each direction, by quadrature", unit="s", at=(5.0 / 3.0, 5.0 / 6.0, 5.0 / 12.0),
           seconds=25.0, expected={name: converges(2, SECOND) for name in ("in the plane", "in space")})
def network_pressed(step: float) -> Measured:
    """The largest error at 10, 20 and 30 s, over the largest force.

    The size is the largest step up to 10 s, where the error is: the first may be cut, and steps share what is left up
    to a sample.  The material is nearly incompressible: G over its bulk modulus, 1e-6, is left of the error.
    """
    found, size = {}, step
    for name, d in (("in the plane", 2), ("in space", 3)):
        error, most = 0.0, 0.0
        with built(pressed(d, step)) as sim:
            for t in (1.0, 2.0, 3.0):
                sim.go(1e7 * t)
                size = 1e-6 * sim.integrator.extremes["dt_max"] if t == 1.0 else size
                force = -sim.sample()[0][0][f"right_force_x_{'pn_per_um' if d == 2 else 'pn'}"]
                right = _pressing_force(t, d)
                error, most = max(error, abs(force - right)), max(most, abs(right))
        found[name] = error / most
    return Measured(size, found)


def _pressing_force(t: float, dimension: int) -> float:
    """Force [pN/µm, in space pN] on the block of `pressed` at a time t [τ]; its viscosity is 1e-7 of G τ."""
    def stretch(s: float) -> float:
        return 1.0 - 0.2 * min(s, 1.0)

    def A(power: float) -> float:
        parts = [quad(lambda s: np.exp(s - t) * stretch(s) ** power, *span, epsabs=1e-13)[0]
                 for span in ((0.0, min(t, 1.0)), (min(t, 1.0), t))]
        return float(np.exp(-t) + sum(parts))

    along, across = stretch(t), 2.0 / (dimension - 1)  # λ across is along^(-across/2)
    stress = 1e3 * (along**2 * A(-2.0) - along**-across * A(across))
    return -stress * 2.0 ** (dimension - 1) / along


@reference("network-turning", shows="velocities of a turning flow J1(kr) of a drop over 1 µs, J2(kR) = 0, L2",
           source="ρ s (1 + τ s) + k² (μ (1 + τ s) + G τ) = 0: two modes exp(st)", at=(300, 800, 2000, 5000),
           quick=(300, 800, 2000), seconds=30.0,
           expected={"amplitude": converges(2, "a Rayleigh quotient: the square of an error h in gradients")})
def network_turning(count: int) -> Measured:
    """G is 20 kPa, τ 0.5 µs, μ 1 mPa s: the flow turns back and is damped within the microsecond."""
    words = ('law="maxwell"', 'shear_modulus="20 kPa"', 'relaxation_time="0.5 us"', "stabilisation=0")
    k = jn_zeros(2, 1)[0] / 5.0
    with built(drop(count, *(f"materials.cytoplasm.{word}" for word in words))) as sim:
        X, mass, law = sim.scene.X, sim.scene.field("mass"), sim.scene.materials[0]
        r = np.maximum(np.hypot(*X.T), 1e-9)
        mode = (jv(1, k * r) / r)[:, None] * np.column_stack([-X[:, 1], X[:, 0]])
        set_state(sim, v=0.01 * mode)
        rho, tau, mu, modulus = law.density, law.relaxation_time, law.viscosity * k**2, law.shear_modulus * k**2
        s = np.roots([rho * tau, rho + mu * tau, mu + modulus * tau])
        share = np.linalg.solve([[1.0, 1.0], s], [1.0, -mu / rho])
        error, whole = 0.0, mass @ (mode**2).sum(axis=1)
        for time in np.linspace(0.1, 1.0, 10):
            sim.go(float(time))
            late = 0.5 * sim.mechanics.times.dt_prev
            found = mass @ (mode * velocity(sim)).sum(axis=1) / (0.01 * whole)
            error = max(error, abs(found - (share * np.exp(s * (time - late))).sum().real))
        return Measured(sim.scene.templates[0].spacing, {"amplitude": float(error)}, count)
