"""Friction of bonds that let go under force, as Bell's bonds do."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy import exp, log

from ..case.registry import law, quantity

# P(L)/Q(L) for <t> (1 + u)/(1 + L) and <t²>/<t>², with L = ln(1 + u): coefficients of P and of Q from L on; at L = 0 P
# is the exact value 1 and 2, and Q is 1.  `python -m cellmig.model.bell` finds them and their errors.
MEAN = (  # largest relative error 8e-10
    (17.42216444375709, 18.422164178757825),
    (92.85185770437944, 109.27404566398245),
    (167.97609202586526, 245.40511180308343),
    (81.63368747387861, 183.02894030520102),
    (25.35735354091865, 22.22324355424385),
    (4.308984376849032, 6.441330464739494),
    (0.7010310768583463, 0.7127109734959669),
    (0.036730276937812056, 0.04818311956678229),
    (0.006324639199718643, 0.006306834918106966),
)
SPREAD = (  # largest relative error 7e-10
    (35.681795924307345, 18.840897501892723),
    (200.0848452904955, 115.38340699402806),
    (415.69450800084434, 274.44840902329304),
    (296.2725572846214, 239.5948296773271),
    (57.75007753566949, 63.117184638264334),
    (9.698954353092876, 8.707325418430745),
    (1.8937206053755338, 1.9137896269567165),
    (0.061184180994002635, 0.05984861802202441),
    (0.0160876249418717, 0.01610371083884566),
)
FASTEST = 1e6  # u up to which they are fitted


@law("friction", "bell")
class BellFriction:
    r"""Traction of bonds that form, are stretched by the sliding membrane, and open the sooner the more they pull.

    An open bond closes at the rate k_on; a closed one is a spring of stiffness k, which is at rest when it closes, and
    opens at the rate k_off exp(f/F_b) under its force f (Bell).  In steady sliding at a speed v the force of a bond of
    age t is k v t, and the traction is T = s N F_b Φ(v/v0) with v0 = k_off F_b/k, Φ(u) = u <t²>/(2 (ρ + <t>)) and
    ρ = k_off/k_on.  N is the density of bonds, open or closed, s the share of the membrane that is bonded, and t now
    the lifetime of a bond in units of 1/k_off: S(t) = exp(-(exp(u t) - 1)/u) of them live longer.

    At low speed T = s N k k_on v/(k_off (k_on + k_off)).  T is largest at a speed of some v0, and falls beyond: under a
    stronger push the membrane slips.  Bonds have the ages of steady sliding at each instant, so that what changes
    within 1/k_off is not resolved.

    Source: Bell (1978), Science 200:618-627; friction by turnover: Tawada & Sekimoto (1991), Biophys. J. 59:343-356;
    of such bonds: Srinivasan & Walcott (2009), Phys. Rev. E 80:046124.
    """

    bonds: float = quantity("1/um^2", "bonds N, open or closed, per reference area of bonded membrane", minimum=0)
    stiffness: float = quantity("pN/nm", "stiffness k of a bond", above=0)
    on: float = quantity("1/s", "rate k_on at which an open bond closes", above=0)
    off: float = quantity("1/s", "rate k_off at which a closed bond without force opens", above=0)
    force: float = quantity("pN", "force F_b that makes a bond open e times as fast", above=0)

    @property
    def speed(self) -> float:
        """Speed v0 at which the force of a bond grows by F_b in 1/k_off [µm/µs]."""
        return self.off * self.force / self.stiffness

    @property
    def lifetime(self) -> float:
        """Mean lifetime 1/k_off of a bond without force [µs], within which changes are not resolved."""
        return 1.0 / self.off

    @property
    def ratio(self) -> float:
        """ρ = k_off/k_on [-]."""
        return self.off / self.on

    @property
    def slope(self) -> float:
        """N F_b/v0 [Pa µs/µm]."""
        return self.bonds * self.stiffness / self.off

    @property
    def coefficient(self) -> float:
        """Drag of fully bonded membrane at low speed, which is the largest [Pa µs/µm]."""
        return self.slope / (1.0 + self.ratio)

    @cached_property
    def largest(self) -> tuple[float, float]:
        """Largest traction of fully bonded membrane [Pa], and its speed [µm/µs]."""
        low, high = -7.0, 21.0  # ln u
        for _ in range(80):
            a, b = (low + share * (high - low) for share in (0.382, 0.618))
            low, high = (low, b) if exp(a) * self.bent(exp(a)) > exp(b) * self.bent(exp(b)) else (a, high)
        u = float(exp(0.5 * (low + high)))
        return self.slope * self.speed * u * float(self.bent(u)), self.speed * u

    def drag(self, share, speed):
        """Traction t [Pa] against the motion; `share` of closed bonds s [-], `speed` along the substrate v [µm/µs]."""
        return self.slope * share * speed * self.bent(abs(speed) / self.speed)

    def bent(self, u):
        """Φ(u)/u [-] at a speed over v0 u [-], not negative."""
        L = log(1.0 + u)
        mean = _fraction(MEAN, 1.0, L) * (1.0 + L) / (1.0 + u)
        return 0.5 * _fraction(SPREAD, 2.0, L) * mean * mean / (self.ratio + mean)


def _fraction(coefficients, value, L):
    """P(L)/Q(L), which is `value` at L = 0."""
    P, Q = 0.0, 0.0
    for p, q in reversed(coefficients):
        P, Q = (P + p) * L, (Q + q) * L
    return (value + P) / (1.0 + Q)


def moments(u):
    """<t> and <t²> [-] by quadrature, to 1e-14, for speeds over v0 of `u` (n,) [-]; for tests, and for the fit.

    With x = (exp(u t) - 1)/u they are ∫ exp(-x)/(1 + u x) dx and ∫ 2 t exp(-x)/(1 + u x) dx over positive x.

    Source: derived here, from the survival in the docstring of the law.
    """
    at, weight = np.polynomial.legendre.leggauss(60)
    ends = np.append(0.0, np.logspace(-16.0, 1.66, 40))
    x = (ends[:-1, None] + 0.5 * np.diff(ends)[:, None] * (1.0 + at)).ravel()
    ux = np.multiply.outer(u, x)
    share = (0.5 * np.diff(ends)[:, None] * weight).ravel() * np.exp(-x) / (1.0 + ux)
    return share.sum(axis=1), 2.0 * (share * np.log1p(ux)).sum(axis=1) / u


def fitted(L, y, value, terms=9, rounds=200):
    """Coefficients (terms, 2) of P/Q, and its largest relative error [-], for y (n,) at L (n,) and `value` at L = 0.

    Least squares of P - y Q over the last y Q, with weights that grow where the error is large (Lawson).
    """
    powers, q, emphasis, best = L[:, None] ** np.arange(1, terms + 1), np.ones_like(L), np.ones_like(L), (np.inf, None)
    for _ in range(rounds):
        weight = emphasis / (y * q)
        matrix = np.hstack([powers, -y[:, None] * powers]) * weight[:, None]
        size = np.linalg.norm(matrix, axis=0)
        found = (np.linalg.lstsq(matrix / size, (y - value) * weight, rcond=1e-16)[0] / size).reshape(2, terms).T
        error = np.abs(_fraction(found, value, L) / y - 1.0)
        best = min(best, (error.max(), found), key=lambda one: one[0])
        q = np.abs(1.0 + powers @ found[:, 1])
        emphasis *= np.sqrt(error / error.max() + 1e-3)
        emphasis /= emphasis.max()
    return best[1], float(best[0])


if __name__ == "__main__":
    speeds = np.logspace(-7.0, np.log10(FASTEST), 2000)
    mean, square = moments(speeds)
    logs = np.log1p(speeds)
    for name, y, at_rest in (("MEAN", mean * (1.0 + speeds) / (1.0 + logs), 1.0), ("SPREAD", square / mean**2, 2.0)):
        pairs, worst = fitted(logs, y, at_rest)
        print(f"{name} = (  # largest relative error {worst:.1g}")
        print(*(f"    ({p}, {q})," for p, q in pairs.tolist()), ")", sep="\n")
