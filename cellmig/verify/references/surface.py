"""Adhesion as the kernel integrates it: a rigid cylinder on a plane, a flat contact."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq

from cellmig.parallel.reduce import exact_sum
from cellmig.verify.reference import Measured, converges, exact, reference

from .scenes import built, case, set_state

RADIUS = 5.0  # µm
# So ε is half a spacing, not 1/25 of it.
WIDE = ('adhesion.substrate.equilibrium_distance="0.1 um"', 'adhesion.substrate.cutoff="10 um"')


def lowered(sim, gap: float) -> None:
    """Place an undeformed cell at a gap [µm] from the substrate."""
    set_state(sim, np.tile([0.0, gap - sim.scene.X[:, 1].min()], (sim.scene.size, 1)))


def pull(sim, gap: float) -> float:
    """Attraction by the substrate [pN/µm] at a gap [µm]."""
    lowered(sim, gap)
    return -float(sim.mechanics.surface_force("substrate")[0][:, 1].sum())


def on_the_circle(law, a: float, R: float = RADIUS) -> float:
    """Attraction [pN/µm] of a circle of radius R at a gap a [µm], integrated numerically along it."""
    N, split = law.bond_density, np.sqrt(2.0 * law.equilibrium_distance / R)
    parts = [0.0, 0.2 * split, split, 3.0 * split, 10.0 * split, np.pi / 2]
    return 2.0 * sum(quad(lambda t: N * law.slope(a + R * (1.0 - np.cos(t))) * R, x, y, epsrel=1e-12)[0]
                     for x, y in pairwise(parts) if y > x)


@reference("cylinder-on-plane", shows="F(a) of a rigid cylinder at gaps of 1.5 ε and 2.5 ε; gap without force",
           source="eqs. (4)-(6) along a circle; along its parabola with Γ, zero at √(35/48) ε",
           at=(400, 900, 2000, 4500), seconds=5.0,
           expected={"F(1.5 ε)": converges(2, "a polygon for the circle: its sagitta is of h²"),
                     "F(2.5 ε)": converges(2, "a polygon for the circle: its sagitta is of h²"),
                     "gap of no pull, over ε": converges(2, "a polygon for the circle: its sagitta is of h²",
                                                         floor=1e-9)})
def cylinder_on_plane(count: int) -> Measured:
    """Forces are integrated exactly along segments: the error is that of the shape."""
    with built(case("one_cell", count, *WIDE)) as sim:
        law, h = sim.terms.substrate, float(sim.mechanics.surfaces.length.max())
        eps = law.equilibrium_distance
        found = {f"F({k} ε)": abs(pull(sim, k * eps) / on_the_circle(law, k * eps) - 1.0) for k in (1.5, 2.5)}
        low, high = 0.7 * eps, 1.1 * eps
        right = brentq(lambda a: on_the_circle(law, a), low, high, xtol=1e-13)
        rest = brentq(lambda a: pull(sim, a), low, high, xtol=1e-13)
        return Measured(h, found | {"gap of no pull, over ε": abs(rest - right) / eps}, count)


@reference("closed-form", shows="F(a) at 1.2 ε of cylinders with a/R as size: closed form against the circle",
           source="eqs. (4)-(6) along a parabola: F(a) = (4Nσ/ε) √(2πR) […]", unit="", at=(0.024, 0.012, 0.006),
           expected={"F": converges(1, "parabola for the circle: relative error a/R")})
def closed_form(size: float) -> Measured:
    """The closed form, which replaces the circle by its parabola, has an error of its own; there are no particles."""
    from scipy.special import gamma

    from cellmig.case.registry import laws

    law = laws("adhesion")["seifert"](bond_density=8000.0, well_depth=0.03, equilibrium_distance=0.1, cutoff=1e3)
    eps = law.equilibrium_distance
    a = 1.2 * eps
    R = a / size
    ratio = eps**3 * a**-2.5 * gamma(2.5) / gamma(3) - eps**5 * a**-4.5 * gamma(4.5) / gamma(5)
    parabola = 4.0 * law.work / eps * np.sqrt(2.0 * np.pi * R) * ratio
    return Measured(size, {"F": abs(parabola / on_the_circle(law, a, R) - 1.0)})


@reference("flat-contact", shows="a cell with its lower side level at the gap ε, and pressed unevenly",
           source="energy N φ(ε) a length; f = -∂E/∂u", at=(200, 400, 800), seconds=2.0,
           expected={"energy": exact(1e-12, "integrated exactly along segments, the sum of their lengths"),
                     "force over -∂E/∂u": exact(1e-7, "energy and force by one formula; differences of 1e-6 µm")})
def flat_contact(count: int) -> Measured:
    """Bonds belong to reference lengths, so that the energy is proportional to those."""
    with built(case("one_cell", count)) as sim:
        X, law, s = sim.scene.X, sim.terms.substrate, sim.mechanics.surfaces
        low = X[:, 1] < 2.0
        u = np.zeros_like(X)
        u[:, 1] = np.where(low, law.equilibrium_distance, X[:, 1] + 3.0) - X[:, 1]
        set_state(sim, u)
        flat = low[s.ids] & low[s.ids[s.after]]
        ends = s.length[low[s.ids] != low[s.ids[s.after]]]
        right = law.bond_density * law.potential(law.equilibrium_distance) * s.length[flat].sum()
        g = law.equilibrium_distance, float(np.min((X + u)[s.ids[~low[s.ids]], 1]))
        steep = law.bond_density * ends.sum() * _along(law, *g)
        energy = abs(_energy(sim) / (right + steep) - 1.0) if len(ends) else np.inf
        return Measured(sim.scene.templates[0].spacing, {"energy": energy, "force over -∂E/∂u": _slope_error(sim)},
                        count)


def _along(law, low: float, high: float) -> float:
    """Mean of the potential along a segment between two heights [µm]."""
    return float((law.primitive(high) - law.primitive(low)) / (high - low))


def _energy(sim) -> float:
    return float(exact_sum(sim.comm, sim.mechanics.surface_force("substrate")[1]))


def _slope_error(sim) -> float:
    """Largest relative error of the six largest forces along y, against finite differences of the energy [-]."""
    m, rng = sim.mechanics, np.random.default_rng(1)
    u = 0.004 * rng.standard_normal((sim.scene.size, 2))
    set_state(sim, u)
    f = m.surface_force("substrate")[0]
    worst = 0.0
    for i in np.argsort(-np.abs(f[:, 1]))[:6]:
        values = []
        for step in (-2e-6, -1e-6, 1e-6, 2e-6):
            m.state.owned[i, 1] += step
            m.state.exchange()
            values.append(_energy(sim))
            m.state.owned[i, 1] -= step
        slope = (8.0 * (values[2] - values[1]) - values[3] + values[0]) / 12e-6
        worst = max(worst, abs(f[i, 1] + slope) / float(np.abs(f).max()))
    return worst
