"""Exact solutions: eigenmodes of a disc and of a drop; Poisson's ratio and stress of a law; a map that keeps areas."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.special import iv, ivp, jv, jvp

from cellmig.case.pointwise import pointwise

LOBES = 2  # of the mode of the disc, which becomes an ellipse


def poisson(law: Any) -> float:
    """Poisson's ratio in small strain [-]."""
    K, G = law.bulk_modulus, law.shear_modulus
    return (3.0 * K - 2.0 * G) / (2.0 * (3.0 * K + G))


def cauchy(law: Any, F: np.ndarray, Fdot: np.ndarray) -> np.ndarray:
    """Cauchy stress (n, 3, 3) [Pa] of a law for F and its rate (2, 2, n)."""
    P, given = np.zeros_like(F), {"F": F, "Fdot": Fdot}
    for method in ("stress", "viscous_stress"):
        if hasattr(law, method):
            P = P + np.array(pointwise(law, method, given))
    stress = np.zeros((F.shape[-1], 3, 3))
    J = F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]
    stress[:, :2, :2] = np.einsum("ikn,jkn->nij", P, F) / J[:, None, None]
    stress[:, 2, 2] = law.out_of_plane(F)
    return stress


# ------------------------------------------------------------------------------------------------ mode of a disc


class Ringing:
    """Slowest mode with two lobes of a free elastic disc in plane strain: potentials J2(kp r), J2(ks r)."""

    def __init__(self, law: Any, radius: float):
        self.G, self.lame = law.shear_modulus, law.bulk_modulus - 2.0 / 3.0 * law.shear_modulus
        self.speeds = np.sqrt(np.array([self.lame + 2.0 * self.G, self.G]) / law.density)
        at = np.linspace(0.3, 3.5, 300) * self.speeds[1] / radius
        values = [np.linalg.det(self._tractions(w, radius)) for w in at]
        first = np.flatnonzero(np.diff(np.sign(values)))[0]
        self.frequency = brentq(lambda w: np.linalg.det(self._tractions(w, radius)), at[first], at[first + 1])
        t = self._tractions(self.frequency, radius)
        c = np.array([1.0, -t[0, 0] / t[0, 1]])
        self.amplitudes = c / abs(c @ self._radial(self.frequency, radius)[0])  # 1 µm at the rim

    def _radial(self, w: float, r: Any) -> np.ndarray:
        """Factors of u_r, u_θ, e_rr, e_θθ, e_rθ that depend on r, of each potential (5, 2, ...)."""
        (kp, ks), n = w / self.speeds, LOBES
        U = np.array([kp * jvp(n, kp * r), n / r * jv(n, ks * r)])
        W = np.array([-n / r * jv(n, kp * r), -ks * jvp(n, ks * r)])
        dU = np.array([kp**2 * jvp(n, kp * r, 2), n / r * ks * jvp(n, ks * r) - n / r**2 * jv(n, ks * r)])
        dW = np.array([-n / r * kp * jvp(n, kp * r) + n / r**2 * jv(n, kp * r), -(ks**2) * jvp(n, ks * r, 2)])
        return np.array([U, W, dU, (n * W + U) / r, 0.5 * (dW - (n * U + W) / r)])

    def _tractions(self, w: float, radius: float) -> np.ndarray:
        """σ_rr and σ_rθ at the rim, of each potential (2, 2): their determinant is zero at eigenfrequencies."""
        _, _, rr, tt, rt = self._radial(w, radius)
        return np.array([self.lame * (rr + tt) + 2.0 * self.G * rr, 2.0 * self.G * rt])

    def fields(self, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Amplitudes of displacement (n, 2) [µm] and stress (n, 3, 3) [Pa] at X (n, 2) [µm]."""
        r, a = np.maximum(np.hypot(*X.T), 1e-6), np.arctan2(X[:, 1], X[:, 0])
        C, S, cos, sin = np.cos(a), np.sin(a), np.cos(LOBES * a), np.sin(LOBES * a)
        U, W, rr, tt, rt = np.einsum("k,ekn->en", self.amplitudes, self._radial(self.frequency, r)) * np.array(
            [cos, sin, cos, cos, sin])
        p, G = self.lame * (rr + tt), self.G
        stress = np.zeros((len(X), 3, 3))
        stress[:, 0, 0] = p + 2 * G * (rr * C * C + tt * S * S - 2 * rt * S * C)
        stress[:, 1, 1] = p + 2 * G * (rr * S * S + tt * C * C + 2 * rt * S * C)
        stress[:, 0, 1] = stress[:, 1, 0] = 2 * G * ((rr - tt) * S * C + rt * (C * C - S * S))
        stress[:, 2, 2] = p
        return np.column_stack([U * C - W * S, U * S + W * C]), stress


# ------------------------------------------------------------------------------------------------ mode of a drop


class Drop:
    """Linear mode exp(st) with n lobes of a viscous, compressible drop with line tension T; s [1/µs] is complex.

    Displacements have the potentials I_n(a r), I_n(q r) with a² = ρ s²/(K + 2μs), q² = ρ s/μ; at the rim σ_rθ = 0 and
    σ_rr = -T (n² - 1) u_r/R².  For large K and small μ, s² = -n(n² - 1) T/ρR³ - 4n(n - 1) s ν/R².

    Source: derived here; the limit is that of Lamb, Hydrodynamics (1932).
    """

    def __init__(self, law: Any, radius: float, lobes: int, tension: float, guess: complex):
        """`law` : with density, viscosity and reduced_bulk_modulus;  `guess` : start of the iteration for s [1/µs]."""
        self.rho, self.mu, self.K = law.density, law.viscosity, law.reduced_bulk_modulus
        self.n, self.radius, self.tension = lobes, radius, tension
        self.s = _root(self._missing, guess)
        m = self._conditions(self.s)
        self.amplitudes = np.array([1.0, -m[1, 0] / m[1, 1] if lobes else 0.0])
        self.amplitudes = self.amplitudes / (self._radial(self.s, radius)[0] @ self.amplitudes)  # u_r = 1 at the rim

    def _radial(self, s: complex, r: Any) -> np.ndarray:
        """Factors of u_r, u_θ, ∂u_r/∂r, ∂u_θ/∂r that depend on r, of both potentials (4, 2, ...)."""
        a, q, n = np.sqrt(self.rho * s * s / (self.K + 2.0 * self.mu * s)), np.sqrt(self.rho * s / self.mu), self.n
        U = np.array([a * ivp(n, a * r), n * iv(n, q * r) / r])
        W = np.array([-n * iv(n, a * r) / r, -q * ivp(n, q * r)])
        dU = np.array([a * a * ivp(n, a * r, 2), n * (q * ivp(n, q * r) / r - iv(n, q * r) / r**2)])
        dW = np.array([-n * (a * ivp(n, a * r) / r - iv(n, a * r) / r**2), -q * q * ivp(n, q * r, 2)])
        return np.array([U, W, dU, dW])

    def _conditions(self, s: complex) -> np.ndarray:
        """Residuals of the conditions on σ_rr and σ_rθ at the rim, of each potential (2, 2)."""
        R, n = self.radius, self.n
        U, W, dU, dW = self._radial(s, R)
        normal = self.K * (dU + (U + n * W) / R) + 2.0 * self.mu * s * dU + self.tension * (n * n - 1.0) * U / R**2
        return np.array([normal, self.mu * s * (dW - (W + n * U) / R)])

    def _missing(self, s: complex) -> complex:
        m = self._conditions(s)
        return np.linalg.det(m) if self.n else m[0, 0]

    def displacements(self, X: np.ndarray) -> np.ndarray:
        """Complex amplitude of the displacement (n, 2) at X (n, 2) [µm], with radial amplitude 1 at the rim."""
        r, at = np.maximum(np.hypot(*X.T), 1e-6), np.arctan2(X[:, 1], X[:, 0])
        U, W = np.einsum("k,ekn->en", self.amplitudes, self._radial(self.s, r)[:2])
        U, W = U * np.cos(self.n * at), W * np.sin(self.n * at)
        return np.column_stack([U * np.cos(at) - W * np.sin(at), U * np.sin(at) + W * np.cos(at)])


def _root(function: Callable[[complex], complex], guess: complex) -> complex:
    """Zero of an analytic function by the secant method."""
    a, b = guess, guess * (1.0 + 1e-4)
    fa, fb = function(a), function(b)
    for _ in range(60):
        a, b, fa = b, b - fb * (b - a) / (fb - fa), fb
        fb = function(b)
        if abs(b - a) < 1e-13 * abs(b) or fb == fa:
            break
    return complex(b)


# ------------------------------------------------------------------------------------------ a map that keeps areas


def sheared(X: np.ndarray, amplitude: float, wave: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 2) [µm] and F (2, 2, n) [-] of X (n, 2) under two wavy shears in turn: finite strain, det F = 1."""
    x = X[:, 0] + amplitude * np.sin(wave * X[:, 1] + 0.4)
    c = amplitude * wave * np.cos(wave * X[:, 1] + 0.4)
    d = amplitude * wave * np.cos(wave * x)
    return np.column_stack([x, X[:, 1] + amplitude * np.sin(wave * x)]), np.array([[np.ones_like(c), c],
                                                                                  [d, 1.0 + d * c]])
