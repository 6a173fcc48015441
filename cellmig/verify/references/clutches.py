"""Clutches on springs: exact means of one, of many in steady sliding, and the stiffness at which they pull most."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from cellmig.case.registry import laws
from cellmig.solve.clutches import mean_traction
from cellmig.verify.reference import Measured, converges, exact, reference

SECOND, PN_NM = 1e6, 1e3  # µs, pN/µm
CHANCE = "five standard errors of the mean over so long a time"


def law(**parameters: Any) -> Any:
    """Clutches of Chan & Odde (2008), changed."""
    return laws("response")["clutches"](**parameters)


@reference("clutch-alone", shows="mean traction of one clutch under five motors; the substrate's spring is the size",
           source="renewal: ∫ S f dt/(1/k_on + ∫ S dt) with f = F_s (1 - exp(-λ t)), by quadrature", unit="pN/nm",
           at=(0.1, 1.0, 10.0), expected={"traction": exact(0.02, CHANCE)})
def clutch_alone(spring: float) -> Measured:
    """S is exp(-∫ k_off exp(f/F_b) dt); motors slow down as the clutch is loaded."""
    one = law(motors=5, clutches=1)
    rate = one.speed / one.stall / (1.0 / (spring * PN_NM) + 1.0 / one.stiffness)
    ages = np.append(0.0, np.logspace(-8.0, 2.0, 100_001)) / one.off
    force, step = -one.stall * np.expm1(-rate * ages), np.diff(ages)
    opening = one.off * np.exp(force / one.force)
    lived = np.exp(-np.append(0.0, np.cumsum(0.5 * (opening[1:] + opening[:-1]) * step)))
    mean, time = (float(np.sum(0.5 * (y[1:] + y[:-1]) * step)) for y in (lived * force, lived))
    found, _ = mean_traction(one, spring * PN_NM, 2e5 * SECOND, 1)
    return Measured(spring, {"traction": abs(found / (mean / (1.0 / one.on + time)) - 1.0)})


@reference("clutches-sliding", shows="traction of clutches on a rigid substrate, under motors that do not slow down "
           "and that do; one over the number of clutches is the size", unit="", at=(25, 75, 225), seconds=4.0,
           source="n_c F_b Φ(v/v0), of bonds in steady sliding; Srinivasan & Walcott 2009",
           expected={"steady flow": exact(0.02, CHANCE), "own flow": converges(
               1, "the flow follows each event: Φ is the limit of many, as one over their number", floor=0.005)})
def clutches_sliding(count: int) -> Measured:
    """With as many motors as clutches, which are softer than those of filopodia."""
    base = law(clutches=count, motors=count, stiffness=0.8 * PN_NM)
    fast = dataclasses.replace(base, motors=100_000, motor_force=1e6)

    bonds = laws("friction")["bell"](bonds=float(count), stiffness=base.stiffness, on=base.on, off=base.off,
                                     force=base.force)

    def pull(flow: float) -> float:
        return float(bonds.drag(1.0, flow))

    low, high = 0.0, base.stall
    for _ in range(60):  # where motors and bonds are in balance
        middle = 0.5 * (low + high)
        low, high = (middle, high) if pull(base.speed * (1.0 - middle / base.stall)) > middle else (low, middle)
    time = 4e5 / count * SECOND
    errors = {name: abs(mean_traction(module, 1e12, time, 2)[0] / expected - 1.0)
              for name, module, expected in (("steady flow", fast, pull(base.speed)), ("own flow", base, low))}
    return Measured(1.0 / count, errors)


@reference("clutches-optimum", shows="stiffness of the largest traction, from 50 motors and clutches to ten times as "
           "many; one over the time of each mean is the size", unit="1/s", at=(500.0, 1000.0, 2000.0), seconds=12.0,
           source="Bangasser, Rosenfeld & Odde 2013: motors and clutches move the optimum together, not alone",
           expected={"both, decades from tenfold": exact(0.15, "to 1.4 times: means differ by 1 % near the maximum"),
                     "motors alone, decades": exact(0.5, "half a decade, and the other way")})
def clutches_optimum(time: float) -> Measured:
    """The maximum of a parabola in log κ_s through the largest means, four in a decade."""

    def optimum(motors: int, clutches: int, low: float) -> float:
        module = law(motors=motors, clutches=clutches, stiffness=0.8 * PN_NM)
        decades = low + 0.25 * np.arange(8)
        means = [mean_traction(module, PN_NM * 10.0**at, time * SECOND, 3)[0] for at in decades]
        best = int(np.clip(np.argmax(means), 2, 5))
        near = slice(best - 2, best + 3)
        square, slope, _ = np.polyfit(decades[near], means[near], 2)
        return float(-0.5 * slope / square)

    few, many, pulled = optimum(50, 50, -1.0), optimum(500, 500, 0.0), optimum(500, 50, -1.25)
    return Measured(1.0 / time, {"both, decades from tenfold": abs(many - few - 1.0),
                           "motors alone, decades": abs(pulled - few)})
