"""Elastic test pieces as cases, and their exact equilibria in small and in finite strain."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.integrate import solve_bvp
from scipy.optimize import brentq

from cellmig.case.load import from_dict
from cellmig.case.pointwise import pointwise
from cellmig.case.schema import Case
from cellmig.solve.tangent import tangent

from .exact import poisson

NUCLEUS = {"law": "mooney-rivlin", "C1": "2126 Pa", "C2": "170 Pa", "volumetric_modulus": "170 kPa"}
RAMP = {"law": "ramp", "duration": "1 us"}


def piece(cell: dict, count: int, samples: int = 1, time: dict | None = None, material: dict | None = None,
          **tables: Any) -> Case:
    """A case of one body of the nucleus's law at the origin, static unless `time` has another integrator.

    cell, time, material, tables : further keys, or other values;  loads with the history RAMP are complete at 1 µs.
    """
    body = {"name": "Body", "centre": ["0 um", "0 um"], "material": "nucleus", **cell}
    clock = {"end": "1 us", "samples": samples, "frames": 1, "integrator": "static"} | (time or {})
    return from_dict({"time": clock, "particles": {"per_cell": count},
                      "materials": {"nucleus": NUCLEUS | (material or {})}, "cells": [body], **tables})


def rectangle(width: float, height: float, **more: Any) -> dict:
    """Keys of a rectangle [µm]."""
    return {"shape": "rectangle", "width": f"{width} um", "height": f"{height} um", **more}


def support(name: str, parts: list[str], x: str, y: str, **more: Any) -> dict:
    """A support of parts with displacements x, y: formulas [µm] or "free"."""
    return {"name": name, "parts": parts, "displacement": [v if v == "free" else f"{v} um" for v in (x, y)],
            "load_curve": RAMP, **more}


def traction(name: str, parts: list[str], x: str, y: str) -> dict:
    """A load on parts with tractions x, y: formulas [Pa]."""
    return {"name": name, "parts": parts, "traction": [f"{v} Pa" for v in (x, y)], "load_curve": RAMP}


# ------------------------------------------------------------------------------------------------------ small strain


class Cantilever:
    """Beam of length L and depth D under a shear force F at its end, in plane strain.

    The exact displacement is prescribed at x = -L/2, the parabolic traction of the solution acts at x = L/2.

    Source: Timoshenko & Goodier, Theory of Elasticity (1951), §21.
    """

    def __init__(self, law: Any, length: float, depth: float, strain: float):
        """`strain` : at the surface of the clamped end [-]."""
        nu = poisson(law)
        self.length, self.depth, self.nu = length, depth, nu / (1.0 - nu)
        self.modulus = 2.0 * law.shear_modulus * (1.0 + nu) / (1.0 - nu**2)
        self.inertia = depth**3 / 12.0
        self.force = strain * self.modulus * self.inertia / (length * 0.5 * depth)

    def formulas(self) -> tuple[str, str]:
        """Formulas of the displacements of the end x = -L/2 [µm]."""
        c = self.force / (6.0 * self.modulus * self.inertia)
        x = f"{c * (2.0 + self.nu)}*y*(y**2 - {0.25 * self.depth**2})"
        return x, f"{-3.0 * c * self.nu * self.length}*y**2"

    def shear(self) -> str:
        """Formula of the traction along y of the end x = L/2 [Pa]."""
        return f"{-0.5 * self.force / self.inertia}*({0.25 * self.depth**2} - y**2)"

    def displacement(self, X: np.ndarray) -> np.ndarray:
        """Exact displacements (n, 2) [µm]."""
        x, y, L, D, nu = X[:, 0] + 0.5 * self.length, X[:, 1], self.length, self.depth, self.nu
        c = self.force / (6.0 * self.modulus * self.inertia)
        ux = c * y * ((6.0 * L - 3.0 * x) * x + (2.0 + nu) * (y**2 - 0.25 * D**2))
        uy = -c * (3.0 * nu * y**2 * (L - x) + 0.25 * (4.0 + 5.0 * nu) * D**2 * x + (3.0 * L - x) * x**2)
        return np.column_stack([ux, uy])


class Kirsch:
    """Round hole of radius R in a plate under the tension σ along x at infinity, in plane strain (Kirsch 1898)."""

    def __init__(self, law: Any, radius: float, strain: float):
        """`strain` : σ over the shear modulus [-]."""
        nu = poisson(law)
        self.radius, self.kappa, self.pull = radius, 3.0 - 4.0 * nu, strain * law.shear_modulus
        self._c, self._even = 0.25 * strain, 1.0 - 2.0 * nu

    def formulas(self) -> tuple[str, str]:
        """Formulas of the displacements [µm]."""
        R, c = self.radius, self._c
        even = f"({self._even}*r + {R**2}/r)"
        first, third = f"({self.kappa * R**2}/r + r)", f"({R**2}/r - {R**4}/r**3)"
        return (f"{c}*({even}*x/r + {first}*x/r + {third}*cos(3*atan2(y, x)))",
                f"{c}*({even}*y/r - {first}*y/r + {third}*sin(3*atan2(y, x)))")

    def tractions(self) -> tuple[str, str]:
        """Formulas of σxy and σyy [Pa], the tractions of a side with its normal along y."""
        t, q = "atan2(y, x)", f"({self.radius**2}/r**2)"
        return (f"{self.pull}*(-{q}*(0.5*sin(2*{t}) + sin(4*{t})) + 1.5*{q}**2*sin(4*{t}))",
                f"{self.pull}*(-{q}*(0.5*cos(2*{t}) - cos(4*{t})) - 1.5*{q}**2*cos(4*{t}))")

    def displacement(self, X: np.ndarray) -> np.ndarray:
        """Exact displacements (n, 2) [µm]."""
        r, t, R = np.hypot(*X.T), np.arctan2(X[:, 1], X[:, 0]), self.radius
        even, first = self._even * r + R**2 / r, self.kappa * R**2 / r + r
        third = R**2 / r - R**4 / r**3
        return self._c * np.column_stack([(even + first) * np.cos(t) + third * np.cos(3 * t),
                                          (even - first) * np.sin(t) + third * np.sin(3 * t)])

    def stress(self, X: np.ndarray) -> np.ndarray:
        """Exact σxx, σyy, σxy (n, 3) [Pa]."""
        q, t = (self.radius / np.hypot(*X.T)) ** 2, np.arctan2(X[:, 1], X[:, 0])
        two, four = np.cos(2 * t), np.cos(4 * t)
        xx = 1.0 - q * (1.5 * two + four) + 1.5 * q**2 * four
        yy = -q * (0.5 * two - four) - 1.5 * q**2 * four
        xy = -q * (0.5 * np.sin(2 * t) + np.sin(4 * t)) + 1.5 * q**2 * np.sin(4 * t)
        return self.pull * np.column_stack([xx, yy, xy])


# ----------------------------------------------------------------------------------------------------- finite strain


def principal(law: Any, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First Piola-Kirchhoff stresses along the axes (n,) [Pa], of stretches a and b (n,) [-] along them."""
    F = np.zeros((2, 2, np.size(a)))
    F[0, 0], F[1, 1] = a, b
    P = np.array(pointwise(law, "stress", {"F": F}))
    return P[0, 0], P[1, 1]


class Flexure:
    """A block bent into a sector, with free long sides (Rivlin 1949, here for a compressible solid).

    The point (X, Y) moves to the radius r(X) and the angle κY.  The equilibrium dP1/dX = κ P2 with stretches r' and κr,
    and P1 = 0 at both sides X = ±W/2, is solved numerically, to 1e-9.
    """

    def __init__(self, law: Any, width: float, curvature: float):
        self.curvature = k = curvature

        def stretch(P1: np.ndarray, r: np.ndarray) -> np.ndarray:
            a = 1.0 / (k * r)
            for _ in range(8):
                F = np.zeros((2, 2, len(a)))
                F[0, 0], F[1, 1] = a, k * r
                a = a - (principal(law, a, k * r)[0] - P1) / tangent(law, "stress", {"F": F})[0, 0, 0, 0]
            return a

        def rates(X: np.ndarray, z: np.ndarray) -> np.ndarray:
            a = stretch(z[1], z[0])
            return np.array([a, k * principal(law, a, k * z[0])[1]])

        X = np.linspace(-0.5 * width, 0.5 * width, 41)
        found = solve_bvp(rates, lambda a, b: np.array([a[1], b[1]]), X, np.array([1.0 / k + X, 0.0 * X]), tol=1e-9)
        if not found.success:
            raise ArithmeticError(found.message)
        x = np.linspace(-0.5 * width, 0.5 * width, 201)
        self._series = np.polynomial.Polynomial.fit(x, found.sol(x)[0], 12).convert()

    def displacement(self, X: np.ndarray) -> np.ndarray:
        """Exact displacements (n, 2) [µm], zero in the middle of the block."""
        r, at = self._series(X[:, 0]), self.curvature * X[:, 1]
        return np.column_stack([r * np.cos(at) - self._series(0.0) - X[:, 0], r * np.sin(at) - X[:, 1]])

    def formulas(self) -> tuple[str, str]:
        """Formulas of the displacements [µm]."""
        k, r = self.curvature, " + ".join(f"({c})*x**{n}" for n, c in enumerate(self._series.coef))
        return f"({r})*cos({k}*y) - {self._series(0.0)} - x", f"({r})*sin({k}*y) - y"


class Column:
    """A column between smooth walls, supported at its lower end, under its own weight b [Pa/µm], in finite strain."""

    def __init__(self, law: Any, height: float, weight: float):
        depth = np.polynomial.chebyshev.chebpts2(33)[::-1] * 0.5 * height
        pressed = -weight * (0.5 * height - depth)
        stretch = [brentq(lambda b, s=s: float(principal(law, 1.0, b)[1][0]) - s, 0.2, 2.0, xtol=1e-14)
                   for s in pressed]
        lag = np.polynomial.Chebyshev.fit(depth, np.array(stretch) - 1.0, 32).integ()
        self._sunk = lag - lag(-0.5 * height)

    def displacement(self, X: np.ndarray) -> np.ndarray:
        """Exact displacements (n, 2) [µm]."""
        return np.column_stack([0.0 * X[:, 0], self._sunk(X[:, 1])])
