"""Adhesion as the kernel integrates it: rigid cylinders on a plane and beside each other, flat and rough contacts."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq

from cellmig.parallel.reduce import exact_sum
from cellmig.verify import contact
from cellmig.verify.reference import Measured, converges, exact, reference

from .scenes import built, by_id, case, set_state, surfaces

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
        law, h = sim.terms.substrate, float(surfaces(sim).size.max())
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
        X, law, s = sim.scene.X, sim.terms.substrate, surfaces(sim)
        low = X[:, 1] < 2.0
        u = np.zeros_like(X)
        u[:, 1] = np.where(low, law.equilibrium_distance, X[:, 1] + 3.0) - X[:, 1]
        set_state(sim, u)
        flat = low[s.ids] & low[s.ids[s.after]]
        ends = s.size[low[s.ids] != low[s.ids[s.after]]]
        right = law.bond_density * law.potential(law.equilibrium_distance) * s.size[flat].sum()
        g = law.equilibrium_distance, float(np.min((X + u)[s.ids[~low[s.ids]], 1]))
        steep = law.bond_density * ends.sum() * _along(law, *g)
        energy = abs(_energy(sim) / (right + steep) - 1.0) if len(ends) else np.inf
        set_state(sim, 0.004 * np.random.default_rng(1).standard_normal(X.shape))
        return Measured(sim.scene.templates[0].spacing,
                        {"energy": energy, "force over -∂E/∂u": _slope_error(sim, "substrate")}, count)


def _along(law, low: float, high: float) -> float:
    """Mean of the potential along a segment between two heights [µm]."""
    return float((law.primitive(high) - law.primitive(low)) / (high - low))


def _energy(sim, term: str = "substrate") -> float:
    return float(exact_sum(sim.comm, sim.mechanics.surface_force(term)[1]))


def _slope_error(sim, term: str) -> float:
    """Largest relative error of the six largest forces, against finite differences of the energy [-]."""
    m = sim.mechanics
    f = m.surface_force(term)[0]
    worst = 0.0
    for k in np.argsort(-np.abs(f), axis=None)[:6]:
        i, c = divmod(int(k), 2)
        values = []
        for step in (-2e-6, -1e-6, 1e-6, 2e-6):
            m.state.owned[i, c] += step
            m.state.exchange()
            values.append(_energy(sim, term))
            m.state.owned[i, c] -= step
        slope = (8.0 * (values[2] - values[1]) - values[3] + values[0]) / 12e-6
        worst = max(worst, abs(f[i, c] + slope) / float(np.abs(f).max()))
    m.state.exchange()
    return worst


# --------------------------------------------------------------------------------------------------- between cells


WIDE_BETWEEN = ('adhesion.cells.equilibrium_distance="0.1 um"', 'adhesion.cells.cutoff="5 um"')


def outlines(sim) -> list[np.ndarray]:
    """Outlines of the first two cells as they lie in the reference configuration, each about its centre [µm]."""
    s, X = surfaces(sim), sim.scene.X
    on = [X[s.ids[s.cell == c]] for c in (0, 1)]
    return [x - 0.5 * (x.min(axis=0) + x.max(axis=0)) for x in on]


def placed(sim, two: list[np.ndarray]) -> None:
    """Put the surfaces of the first two cells on outlines [µm], and the other cells far away."""
    s, X = surfaces(sim), sim.scene.X
    u = 100.0 * np.outer(sim.scene.cell, [0.0, 1.0])
    for c, x in enumerate(two):
        on = s.ids[s.cell == c]
        u[on] = x - X[on]
    set_state(sim, u)


def between_round(law, apart: float, measure, R: float = RADIUS) -> list[float]:
    """Energy of two equal cylinders or balls whose centres are `apart` [µm], and its derivative by that distance.

    measure : function -- of the angle t [rad] from the line of the centres: both surfaces there over t, half the bonds.
    """
    parts = [0.0, *np.geomspace(0.02, 1.0, 8), np.pi]

    def along(t: float) -> tuple[float, float]:
        """Gap, and its derivative by the distance of the centres, at an angle."""
        r = np.sqrt(apart * apart + R * R - 2.0 * apart * R * np.cos(t))
        return r - R, (apart - R * np.cos(t)) / r

    return [law.bond_density * sum(quad(lambda t, f=f: f(*along(t)) * measure(t), a, b, epsrel=1e-12)[0]
                                   for a, b in pairwise(parts))
            for f in (lambda gap, _: law.potential(gap), lambda gap, slope: law.slope(gap) * slope)]


@reference("two-cylinders", shows="energy and F(a) of two rigid cylinders at gaps of 1.5 ε and 2.5 ε",
           source="eqs. (3), (4) along a circle, of distances to another", at=(400, 900, 2000, 4500), seconds=5.0,
           expected={f"{what}({k} ε)": converges(2, "polygons for circles: their sagittas are of h²")
                     for what in "EF" for k in (1.5, 2.5)})
def two_cylinders(count: int) -> Measured:
    """Either cylinder has half of the bonds, and the same energy."""
    found = {}
    with built(case("all_protrude", count, *WIDE_BETWEEN)) as sim:
        law, R = sim.terms.contact, RADIUS
        for k in (1.5, 2.5):
            apart, (A, B) = 2.0 * R + k * law.equilibrium_distance, outlines(sim)
            placed(sim, [A, B + np.array([apart, 0.0])])
            right = between_round(law, apart, lambda t: 2.0 * R)
            forces, energies = sim.mechanics.surface_force("contact")
            pulled = float(by_id(sim, forces)[sim.scene.cell == 0, 0].sum())
            found[f"E({k} ε)"] = abs(float(energies.sum()) / right[0] - 1.0)
            found[f"F({k} ε)"] = abs(pulled / right[1] - 1.0)
        return Measured(float(surfaces(sim).size.max()), found, count)


@reference("rough-contact", shows="two outlines, convex and reflex at random, at a least gap of ε",
           source="verify/contact.py: the definition of the energy by Gauss's rule, f = -∂E/∂u", at=(60, 120, 240),
           seconds=2.0, expected={"energy": exact(1e-9, "exact beside edges, Gauss's rule in pieces beside vertices"),
                                  "force over -∂E/∂u": exact(1e-8, "derivatives of the limits of pieces cancel")})
def rough_contact(count: int) -> Measured:
    """The radius of every particle of the surfaces is off by up to 5 %."""
    with built(case("all_protrude", count)) as sim:
        rng, law, s = np.random.default_rng(count), sim.terms.contact, surfaces(sim)
        A, B = (x * (1.0 + rng.uniform(-0.05, 0.05, (len(x), 1))) for x in outlines(sim))
        two = [A, contact.brought_near([A], B, law.equilibrium_distance, [1.0, 0.2])]
        placed(sim, two)
        right = contact.energy(law, two, [s.size[s.cell == c] for c in (0, 1)])
        energy = _energy(sim, "contact")
        return Measured(sim.scene.templates[0].spacing, {"energy": abs(energy / right - 1.0), "force over -∂E/∂u":
                                                         _slope_error(sim, "contact")}, count)
