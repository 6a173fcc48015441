"""Conservation of momentum, angular momentum, energy and area."""

from __future__ import annotations

import numpy as np

from cellmig.verify.exact import sheared
from cellmig.verify.reference import Measured, converges, exact, reference

from .scenes import altered, built, by_id, case, displacement, drop, mean_energy_error, nucleus, set_state, velocity

PAIRS = "forces come in pairs that are equal and opposite, on one line: sums of rounding alone"


@reference("momentum", shows="momentum of three cells after 1 µs over the impulse of their protrusion",
           source="eq. (2) summed: only F_d is external along x", at=(100, 200, 400), seconds=5.0,
           expected={name: exact(1e-9, "the substrate is without friction, all other forces are internal")
                     for name in ("all_protrude", "three_balls")})
def momentum(count: int) -> Measured:
    """Protrusion is the only external force along the substrate."""
    found = {}
    for name in ("all_protrude", "three_balls"):
        with built(case(name, count)) as sim:
            sim.go(1.0)
            sim.sample()
            error = sim.sampler.momentum()[0] / sim.mechanics.accounts.protrusion_impulse() - 1.0
            found[name], spacing = abs(float(error)), sim.scene.templates[0].spacing
    return Measured(spacing, found, count)


@reference("cell-cell", shows="sum and torque of the forces between three cells that are pressed together",
           source="action and reaction: Σ F_cc = 0, and its torque", at=(100, 200, 400), seconds=2.0,
           expected={"sum": exact(1e-12, PAIRS), "torque": exact(1e-11, PAIRS)})
def cell_cell(count: int) -> Measured:
    """Errors are relative to the sum of the magnitudes."""
    with built(case("paper", count)) as sim:
        u = 0.004 * np.random.default_rng(1).standard_normal((sim.scene.size, 2))
        set_state(sim, u)
        x, f = sim.scene.X + u, by_id(sim, sim.mechanics.surface_force("contact")[0])
        turn = x[:, 0] * f[:, 1] - x[:, 1] * f[:, 0]
        return Measured(sim.scene.templates[0].spacing,
                        {"sum": float(np.abs(f.sum(axis=0)).max() / np.abs(f).sum()),
                         "torque": float(abs(turn.sum()) / np.abs(turn).sum())}, count)


@reference("spin", shows="angular momentum of a disc that rotates and vibrates for 2 µs", source="no external torque",
           at=(100, 200, 400), seconds=3.0,
           expected={"moment": exact(1e-9, "a symmetric Cauchy stress has no torque, leapfrog conserves x × m v")})
def spin(count: int) -> Measured:
    """The elastic stabilisation is off: it keeps the moment of momentum only where x is linear in X."""
    gradient = [["0.1 /us", "-0.3 /us"], ["0.3 /us", "-0.1 /us"]]
    soft = nucleus(count, "materials.nucleus.hourglass_modulus=0")
    with built(altered(soft, {"velocity_gradient": gradient})) as sim:
        found = []
        for time in (0.0, 2.0):
            sim.go(time) if time else None
            x, v, m = sim.scene.X + displacement(sim), velocity(sim), sim.scene.field("mass")
            found.append(float(m @ (x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0])))
        return Measured(sim.scene.templates[0].spacing, {"moment": abs(found[1] / found[0] - 1.0)}, count)


LEDGERS = ("paper", "director_radial", "all_protrude", "ball", "three_balls")


@reference("energy", shows="energy error of the ledger, root mean square over 20 times to 1 µs; the step is the size",
           source="eq. (2) times the velocity: energies and works add up", unit="ns", at=(2.0, 1.0, 0.5), seconds=15.0,
           expected={name: converges(2, "all work is summed by rules of the second order, at the leapfrog's times")
                     for name in LEDGERS})
def energy(ns: float) -> Measured:
    """The scenes have all terms of the model among them."""
    found = {}
    for name in LEDGERS:
        with built(case(name, 150, f'time.step="{ns} ns"')) as sim:
            found[name] = mean_energy_error(sim, np.linspace(0.05, 1.0, 20))
    return Measured(ns, found)


@reference("area", shows="areas of a disc: as it is, in simple shear of 500 %, and under a wavy map with det F = 1",
           source="π R²; verify/exact.py sheared", at=(150, 400, 1000, 2500), seconds=2.0,
           expected={"disc": converges(2, "a polygon for the circle: its sagitta is of h²"),
                     "particles over polygon": exact(1e-12, "dual cells fill the polygon"),
                     "sheared": exact(1e-12, "an affine map takes the polygon with it"),
                     "wavy": converges(2, "sides for curves: their sagittas are of h²")})
def area(count: int) -> Measured:
    """Areas are those of the outline, as in history.csv."""
    with built(drop(count)) as sim:
        X, V = sim.scene.X, sim.scene.field("V")

        def now(u: np.ndarray) -> float:
            set_state(sim, u)
            return sim.sample()[0][1]["area_um2"]

        rest = now(np.zeros_like(X))
        found = {"disc": abs(rest / (np.pi * 25.0) - 1.0), "particles over polygon": abs(V.sum() / rest - 1.0),
                 "sheared": abs(now(5.0 * X[:, 1:] * [1.0, 0.0]) / rest - 1.0),
                 "wavy": abs(now(sheared(X, 0.3, 0.6)[0] - X) / (np.pi * 25.0) - 1.0)}
        return Measured(sim.scene.templates[0].spacing, found, count)
