"""Exact solutions: modes of a disc and a drop, a disc released; ratio and stress of a law; a map that keeps areas."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.polynomial import Legendre
from scipy.optimize import brentq
from scipy.special import iv, ivp, jv, jvp, spherical_in

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


# --------------------------------------------------------------------------------------------- a disc released


def released_disc(law: Any, radius: float, strain: float, step: float, count: int, degree: int = 18) -> np.ndarray:
    """Half the difference of the displacements along x at (R, 0) and along y at (0, R) of a free elastic disc.

    It is released at rest from u = strain (x, -y), and moves in finite strain.  A Galerkin method: u_x is x times a
    polynomial in x² and y², u_y the same with y for x, of a `degree` [-]; leapfrog with steps of 0.14 ns.  Sound, which
    it does not resolve, makes a ripple of 0.5 %; `without_sound` takes it out, and then degrees of 14, 18 and 22 differ
    from 26 by 0.12, 0.10 and 0.05 % of the start.  A radius [µm] and a `step` [µs]; returns values at all multiples k
    of the step, k = 0 ... count, (count + 1,) [µm].

    Source: derived here; two public finite-element codes agree to 0.21 % of the start, their own uncertainty.
    """
    (r, wr), (t, wt) = (np.polynomial.legendre.leggauss(degree + 8) for _ in range(2))
    r, t = 0.5 * radius * (r + 1.0), 0.25 * np.pi * (t + 1.0)  # a quarter of the disc
    x, y = np.outer(r, np.cos(t)).ravel(), np.outer(r, np.sin(t)).ravel()
    weight = np.outer(r * wr, wt).ravel()
    orders = [(2 * i + 1, 2 * j) for i in range(degree // 2 + 1) for j in range(degree // 2 + 1 - i)]
    form = [(Legendre.basis(i, [-radius, radius]), Legendre.basis(j, [-radius, radius])) for i, j in orders]

    def forms(along: np.ndarray, across: np.ndarray) -> list[np.ndarray]:
        """Values of the polynomials and of both derivatives, (points, polynomials) each."""
        parts = [(f(along) * g(across), f.deriv()(along) * g(across), f(along) * g.deriv()(across)) for f, g in form]
        return [np.column_stack(columns) for columns in zip(*parts, strict=True)]

    orthonormal = np.linalg.inv(np.linalg.qr(np.sqrt(weight)[:, None] * forms(x, y)[0])[1])
    U, Ux, Uy = (f @ orthonormal for f in forms(x, y))
    V, Vy, Vx = (f @ orthonormal for f in forms(y, x))  # the points are symmetric about the diagonal
    rim = (forms(np.array([radius]), np.zeros(1))[0] @ orthonormal)[0]
    a, b = U.T @ (weight * strain * x), -(V.T @ (weight * strain * y))
    a_rate, b_rate, found = np.zeros_like(a), np.zeros_like(b), [0.5 * rim @ (a - b)]
    n = int(np.ceil(step / 1.4e-4))
    for k in range(n * count):
        one = np.ones_like(x)
        P = law.stress(np.array([[one + Ux @ a, Uy @ a], [Vx @ b, one + Vy @ b]]))
        dt = step / n * (0.5 if k == 0 else 1.0)  # of the velocities
        a_rate -= dt / law.density * (Ux.T @ (weight * P[0][0]) + Uy.T @ (weight * P[0][1]))
        b_rate -= dt / law.density * (Vx.T @ (weight * P[1][0]) + Vy.T @ (weight * P[1][1]))
        a, b = a + step / n * a_rate, b + step / n * b_rate
        if (k + 1) % n == 0:
            found.append(0.5 * rim @ (a - b))
    return np.array(found)


def without_sound(values: np.ndarray, period: int) -> np.ndarray:
    """Values (n,) of an even function of time, averaged with a Hann window over two periods of sound (n - period,).

    `period` [-] counts the steps of a period, and the values begin at the time zero; the unit is theirs [-].
    """
    window = 1.0 + np.cos(np.pi * np.arange(-period, period + 1) / period)
    return np.convolve(np.r_[values[period:0:-1], values], window / window.sum(), "valid")


# ------------------------------------------------------------------------------------------------ mode of a drop


class Drop:
    """Linear mode exp(st) with n lobes of a viscous, compressible drop with line tension T; s [1/µs] is complex.

    Displacements have the potentials I_n(a r), I_n(q r) with a² = ρ s²/(λ + 2G), q² = ρ s²/G, where λ = K and G = μs of
    a fluid; at the rim σ_rθ = 0 and σ_rr = -T (n² - 1) u_r/R².  For large K and small μ,
    s² = -n(n² - 1) T/ρR³ - 4n(n - 1) s ν/R².  The modes of a solid have its λ and G.

    Source: derived here; the limit is that of Lamb, Hydrodynamics (1932).
    """

    def __init__(self, law: Any, radius: float, lobes: int, tension: float, guess: complex):
        """`law` : with density and either viscosity and reduced_bulk_modulus or shear_modulus and bulk_modulus;

        guess : start of the iteration for s [1/µs].
        """
        self.law, self.rho = law, law.density
        self.n, self.radius, self.tension = lobes, radius, tension
        self.s = _root(self._missing, guess)
        m = self._conditions(self.s)
        self.amplitudes = np.array([1.0, -m[1, 0] / m[1, 1] if lobes else 0.0])
        self.amplitudes = self.amplitudes / (self._radial(self.s, radius)[0] @ self.amplitudes)  # u_r = 1 at the rim

    def moduli(self, s: complex) -> tuple[complex, complex]:
        """λ and G [Pa] of motions exp(st), with s [1/µs]."""
        if hasattr(self.law, "reduced_bulk_modulus"):
            return self.law.reduced_bulk_modulus, self.law.viscosity * s
        return self.law.bulk_modulus - 2.0 / 3.0 * self.law.shear_modulus, self.law.shear_modulus

    def _wave_numbers(self, s: complex) -> tuple[complex, complex]:
        """Wave numbers a and q [1/µm]."""
        lame, G = self.moduli(s)
        return np.sqrt(self.rho * s * s / (lame + 2.0 * G)), np.sqrt(self.rho * s * s / G)

    def _radial(self, s: complex, r: Any) -> np.ndarray:
        """Factors of u_r, u_θ, ∂u_r/∂r, ∂u_θ/∂r that depend on r, of both potentials (4, 2, ...)."""
        (a, q), n = self._wave_numbers(s), self.n
        U = np.array([a * ivp(n, a * r), n * iv(n, q * r) / r])
        W = np.array([-n * iv(n, a * r) / r, -q * ivp(n, q * r)])
        dU = np.array([a * a * ivp(n, a * r, 2), n * (q * ivp(n, q * r) / r - iv(n, q * r) / r**2)])
        dW = np.array([-n * (a * ivp(n, a * r) / r - iv(n, a * r) / r**2), -q * q * ivp(n, q * r, 2)])
        return np.array([U, W, dU, dW])

    def _conditions(self, s: complex) -> np.ndarray:
        """Residuals of the conditions on σ_rr and σ_rθ at the rim, of each potential (2, 2)."""
        R, n, (lame, G) = self.radius, self.n, self.moduli(s)
        U, W, dU, dW = self._radial(s, R)
        normal = lame * (dU + (U + n * W) / R) + 2.0 * G * dU + self.tension * (n * n - 1.0) * U / R**2
        return np.array([normal, G * (dW - (W + n * U) / R)])

    def _missing(self, s: complex) -> complex:
        m = self._conditions(s)
        return np.linalg.det(m) if self.n else m[0, 0]

    def displacements(self, X: np.ndarray) -> np.ndarray:
        """Complex amplitude of the displacement (n, 2) at X (n, 2) [µm], with radial amplitude 1 at the rim."""
        r, at = np.maximum(np.hypot(*X.T), 1e-6), np.arctan2(X[:, 1], X[:, 0])
        U, W = np.einsum("k,ekn->en", self.amplitudes, self._radial(self.s, r)[:2])
        U, W = U * np.cos(self.n * at), W * np.sin(self.n * at)
        return np.column_stack([U * np.cos(at) - W * np.sin(at), U * np.sin(at) + W * np.cos(at)])


class Globe(Drop):
    """Linear mode exp(st) of a viscous, compressible ball with surface tension T, with a Legendre polynomial P_n.

    As for `Drop`, with the potentials i_n(a r) and curl curl of r i_n(q r); σ_rr = -T (n - 1)(n + 2) u_r/R² at R.  For
    large K and small μ, s² = -n(n - 1)(n + 2) T/ρR³ - 2(n - 1)(2n + 1) s ν/R².

    Source: derived here; the limit is that of Lamb, Hydrodynamics (1932).
    """

    def _radial(self, s: complex, r: Any) -> np.ndarray:
        """Factors of u_r, u_θ, ∂u_r/∂r, ∂u_θ/∂r that depend on r, of both potentials (4, 2, ...)."""
        (a, q), n = self._wave_numbers(s), self.n
        (f, fp, fpp), (g, gp, gpp) = (_globular(n, k, r) for k in (a, q))
        m = n * (n + 1)
        U, W = np.array([fp, m * g / r]), np.array([f / r, g / r + gp])
        dU = np.array([fpp, m * (gp / r - g / r**2)])
        return np.array([U, W, dU, np.array([fp / r - f / r**2, gp / r - g / r**2 + gpp])])

    def _conditions(self, s: complex) -> np.ndarray:
        """Residuals of the conditions on σ_rr and σ_rθ at the surface, of each potential (2, 2)."""
        R, n, (lame, G) = self.radius, self.n, self.moduli(s)
        U, W, dU, dW = self._radial(s, R)
        tension = self.tension * (n - 1.0) * (n + 2.0) / R**2
        normal = lame * (dU + (2.0 * U - n * (n + 1) * W) / R) + 2.0 * G * dU + tension * U
        return np.array([normal, G * (dW + (U - W) / R)])

    def displacements(self, X: np.ndarray) -> np.ndarray:
        """Complex amplitude of the displacement (n, 3) at X (n, 3) [µm], with radial amplitude 1 at the poles."""
        r = np.maximum(np.linalg.norm(X, axis=1), 1e-6)
        out, cos = X / r[:, None], X[:, 2] / r
        U, W = np.einsum("k,ekn->en", self.amplitudes, self._radial(self.s, r)[:2])
        P = Legendre.basis(self.n)
        south = np.array([0.0, 0.0, 1.0]) - cos[:, None] * out  # the gradient of cos θ on the unit sphere
        return (U * P(cos))[:, None] * out + (W * P.deriv()(cos))[:, None] * south


def _globular(n: int, k: complex, r: Any) -> tuple[Any, Any, Any]:
    """The function i_n(k r) and its first and second derivative with respect to r."""
    z = k * np.asarray(r)
    f, fp = spherical_in(n, z), spherical_in(n, z, derivative=True)
    return f, k * fp, k * k * ((1.0 + n * (n + 1) / z**2) * f - 2.0 / z * fp)


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


# --------------------------------------------------------------------------------------------------- a layer of gel


class Layer:
    """Elastic layer of a thickness h that is bonded to a rigid base, under a traction along its surface, in plane
    strain: displacements of the surface along itself.

    With the traction q cos(k x) they are C(k) q cos(k x).  The displacement is U(y) cos(k x), V(y) sin(k x), with U and
    V made of e^{±k y} and y e^{±k y}; the four factors follow from the traction above and the base below.

    Source: derived here from Navier's equations; for a thick layer it is that of the half-plane, K. L. Johnson, Contact
    Mechanics (1985), ch. 2: displacements by a force P at a distance x go with -2 (1 - ν²) P ln(x)/(π E).
    """

    def __init__(self, law: Any, thickness: float):
        """`thickness` in µm."""
        self.shear, self.nu, self.thickness = law.shear_modulus, poisson(law), thickness

    def compliance(self, k: np.ndarray) -> np.ndarray:
        """C (n,) [µm/Pa] at wave numbers k (n,) [1/µm]."""
        h, mu = self.thickness, self.shear
        lame, kappa = 2.0 * mu * self.nu / (1.0 - 2.0 * self.nu), 3.0 - 4.0 * self.nu
        rows = np.zeros((4, 4, len(k)))  # conditions, unknowns: e^{k y}, y e^{k y}, e^{-k (y + h)}, y e^{-k (y + h)}
        for n, s in ((0, 1.0), (2, -1.0)):
            for y, at in ((0.0, 0), (-h, 2)):
                e = np.exp(s * k * y - (0.0 if s > 0.0 else 1.0) * k * h)
                U = e, y * e
                V = s * e, (s * y - kappa / k) * e
                slope = s * k * e, (1.0 + s * k * y) * e, k * e, (s - s * kappa + k * y) * e  # of U, U, V, V
                for m in range(2):
                    rows[at, n + m] = mu * (slope[m] + k * V[m]) if at == 0 else U[m]
                    rows[at + 1, n + m] = (lame + 2.0 * mu) * slope[2 + m] - lame * k * U[m] if at == 0 else V[m]
        load = np.array([1.0, 0.0, 0.0, 0.0])
        found = np.linalg.solve(rows.transpose(2, 0, 1), np.broadcast_to(load[:, None], (len(k), 4, 1)))[..., 0]
        return found[:, 0] + found[:, 2] * np.exp(-k * h)

    def displacement(self, x: np.ndarray, transform: Callable[[np.ndarray], np.ndarray], most: float) -> np.ndarray:
        """Displacements (n,) [µm] at x (n,) [µm] under the even traction q(x) = ∫ Q(k) cos(k x) dk over positive k.

        transform : Q [Pa µm] of k [1/µm];  most : k up to which it counts [1/µm].
        """
        at, weight = np.polynomial.legendre.leggauss(6)
        ends = np.linspace(0.0, most, 2 + int(4.0 * most * (np.abs(x).max() + self.thickness)))
        k = (ends[:-1, None] + 0.5 * np.diff(ends)[:, None] * (1.0 + at)).ravel()
        share = (0.5 * np.diff(ends)[:, None] * weight).ravel() * transform(k) * self.compliance(k)
        return np.cos(np.multiply.outer(x, k)) @ share
