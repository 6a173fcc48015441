"""Motion without inertia: drags, drops that their tension makes round, leapfrog beside it, creep, stress of a layer."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.polynomial import Legendre
from scipy.integrate import solve_ivp

from cellmig.case.load import from_dict
from cellmig.case.schema import Case
from cellmig.model.adhesion import bonds_of
from cellmig.parallel.options import default_options
from cellmig.simulation import Simulation
from cellmig.verify.reference import Measured, converges, exact, reference

from .network import pressed
from .scenes import built, by_id, displacement, set_state, velocity

FLUID = {"law": "nematic", "viscosity": "100 Pa s", "bulk_modulus": "1 MPa", "reduced_bulk_modulus": "1 MPa"}
GEL = FLUID | {"law": "gel", "shear_modulus": "200 Pa"}
RADIUS, WATER = 5.0, 0.7e-3  # µm, Pa s
TIGHT = {"snes_atol": "1e-7", "snes_max_it": "30"}
BONDS = {"bond_density": "8000 /um^2", "well_depth": "0.03 pN um", "equilibrium_distance": "50 nm", "cutoff": "1 um"}


def alone(dimension: int, count: int, material: dict, time: dict, **tables: Any) -> Case:
    """A round body of 5 µm in water."""
    body = {"name": "Body", "shape": "disc" if dimension == 2 else "ball", "radius": f"{RADIUS} um",
            "centre": ["0 um"] * dimension, "material": "plasm"}
    clock = {"samples": 1, "frames": 1, "integrator": "overdamped"} | time
    return from_dict({"dimension": dimension, "time": clock, "particles": {"per_cell": count}, "cells": [body],
                      "materials": {"plasm": material}, "medium": {"viscosity": f"{WATER} Pa s"}, **tables})


# ------------------------------------------------------------------------------------------------------------ drags


SAGITTA = "a polygon or polyhedron for the circle or sphere: its sagitta is of h²"
@reference("disc-in-water", shows="speed of a disc under a body force f, in a medium", at=(100, 300, 900),
           source="f A/(3πη), by definition of the medium",
           expected={"speed": converges(2, SAGITTA), "spread of the speed": exact(
               1e-6, "a body that is pulled evenly comes to rest in itself; to the balance of forces")})
def disc_in_water(count: int) -> Measured:
    """The medium has no other drag in the plane."""
    return pulled(2, count, 3.0 * np.pi * WATER)


@reference("ball-in-water", shows="speed of a ball under a body force f, in a medium", at=(100, 300, 900), seconds=8.0,
           source="f V/(6πηR) (Stokes 1851)", expected={"speed": converges(2, SAGITTA)})
def ball_in_water(count: int) -> Measured:
    """The traction on a sphere is uniform, as the medium has it; a polyhedron is uneven, and turns slowly."""
    return pulled(3, count, 6.0 * np.pi * WATER * RADIUS)


def pulled(dimension: int, count: int, drag: float) -> Measured:
    """Error of the speed of the centre of mass against a `drag` [Pa s, in space Pa s µm], and spread of speeds."""
    force = 1e-4  # pN/µm³
    pull = {"name": "pull", "body": [f"{force} Pa/um", *["0 Pa/um"] * (dimension - 1)]}
    with default_options(TIGHT), built(alone(dimension, count, GEL, {"end": "10 s"}, loads=[pull])) as sim:
        sim.go(1e7)
        V, v = sim.scene.field("V"), 1e6 * velocity(sim)[:, 0]
        right = force * V.sum() / drag
        return Measured(sim.scene.templates[0].spacing, {"speed": abs(V @ v / V.sum() / right - 1.0),
                                                         "spread of the speed": float(np.ptp(v)) / right}, count)


def bonded(sim: Simulation) -> float:
    """Length of closed bonds on the substrate [µm]."""
    ends, x = sim.scene.templates[0].facets, sim.scene.X + displacement(sim)
    closed = bonds_of(sim.terms.substrate).closed(*x[ends, 1].T)
    return float(sim.scene.templates[0].facet_size @ np.clip(closed, 0.0, 1.0))


@reference("slides", shows="speed of a box that is pulled along the substrate, with linear friction c",
           source="v = F/(c L), L of closed bonds: forces are in balance", at=(60, 120, 240), seconds=5.0,
           expected={f"{mu} Pa s": exact(1e-8, "no viscosity and no stiffness is in it; to the balance of forces")
                     for mu in (10, 100, 1000)})
def slides(count: int) -> Measured:
    """The box has 6 x 3 µm; after 30,000 s, when it has settled."""
    found, force, drag = {}, 0.5, 3000.0  # pN/µm³, Pa s/µm
    for mu in (10, 100, 1000):
        case = from_dict({
            "time": {"end": "30000 s", "samples": 1, "frames": 1, "integrator": "overdamped"},
            "particles": {"per_cell": count}, "adhesion": {"substrate": BONDS},
            "materials": {"gel": GEL | {"viscosity": f"{mu} Pa s", "shear_modulus": "2 kPa"}},
            "cells": [{"name": "Box", "shape": "rectangle", "width": "6 um", "height": "3 um", "centre": ["0 um"],
                       "rest": True, "material": "gel"}],
            "friction": {"coefficient": f"{drag} Pa s/um"},
            "loads": [{"name": "pull", "body": [f"{force} Pa/um", "0 Pa/um"]}]})
        with default_options(TIGHT), built(case) as sim:
            sim.go(3e10)
            whole = force * sim.scene.field("V").sum()
            found[f"{mu} Pa s"] = float(np.abs(1e6 * velocity(sim)[:, 0] * drag * bonded(sim) / whole - 1.0).max())
            spacing = sim.scene.templates[0].spacing
    return Measured(spacing, found, count)


# ------------------------------------------------------------------------------------------------------------ drops


TENSION = 100.0  # pN/µm


def rounding(dimension: int, count: int, end: float, **tables: Any) -> tuple[float, float]:
    """Spacing [µm], and what is left of two lobes of a drop after an `end` [s], over what there was [-].

    What a drop without lobes does, whose facets are not quite in equilibrium, is taken off.
    """
    left = []
    for size in (0.05, 0.0):  # µm
        clock = {"end": f"{end} s", "step": f"{end / 40} s"}
        cortex = {"law": "line-tension", "line_tension": f"{TENSION} pN/um"}
        with default_options({"ts_type": "bdf"}), built(alone(dimension, count, FLUID, clock, cortex=cortex)) as sim:
            X, surface = sim.scene.X, sim.scene.surface(0)
            out = X[surface] / np.linalg.norm(X[surface], axis=1)[:, None]
            stretch = np.full(dimension, (1.0 + size / RADIUS) ** (-1.0 / (dimension - 1)))
            stretch[-1] = 1.0 + size / RADIUS
            lobes = 2.0 * out[:, -1] ** 2 - 1.0 if dimension == 2 else Legendre.basis(2)(out[:, -1])
            share = np.linalg.pinv(np.column_stack([lobes, np.ones(len(lobes))]))[0]
            set_state(sim, X * (stretch - 1.0))
            start = share @ (displacement(sim)[surface] * out).sum(axis=1)
            sim.go(1e6 * end)
            left.append((start, share @ (displacement(sim)[surface] * out).sum(axis=1)))
            spacing = sim.scene.templates[0].spacing
    return spacing, float((left[0][1] - left[1][1]) / left[0][0])


FACETS = "h² of the curvature of facets and of what is restored of viscosity, less h³ of the surface"


@reference("drop-rounds", shows="what is left of two lobes of a drop of 100 Pa s after a time of decay, by its tension",
           source="exp(-γt/μR), by nγ/2μR (Hopper 1990, J. Fluid Mech. 213:349-375)", at=(400, 1000, 2500),
           quick=(150, 400, 1000), seconds=30.0,
           expected={"lobes": converges(1.7, FACETS)})
def drop_rounds(count: int) -> Measured:
    """Lobes of 1 % of the radius; steps of 1/40 of the time, by BDF; water takes 1e-5 of it."""
    spacing, left = rounding(2, count, 100.0 * RADIUS / TENSION)
    return Measured(spacing, {"lobes": abs(left * np.e - 1.0)}, count)


@reference("ball-rounds", shows="the same in space", source="exp(-20 γt/19 μR) (Lamb, Hydrodynamics, art. 355)",
           at=(150, 400, 1000), seconds=60.0, expected={"lobes": converges(
               1.3, "0.027 h + 0.012 h² (h in µm): viscosity is restored too much at the surface, whose Laplacians are "
                    "one-sided; with nothing restored the drop is too fast by 13 % at 150 particles")})
def ball_rounds(count: int) -> Measured:
    """Its rate is n (n + 2) (2n + 1) / (2 (2n² + 4n + 3)) of γ/(μR)."""
    spacing, left = rounding(3, count, 95.0 / 100.0 * 100.0 * RADIUS / TENSION)
    return Measured(spacing, {"lobes": abs(left * np.e - 1.0)}, count)


# ----------------------------------------------------------------------------------------------- beside leapfrog


@reference("without-inertia", shows="a body that is released, against leapfrog; the Reynolds number is the size",
           source="the same particles with inertia", unit="", at=(0.2, 0.1, 0.05), seconds=20.0,
           expected={"gel, ρGR²/μ²": converges(1, "inertia is the small parameter of the equation of motion"),
                     "drop, ργR/μ²": converges(1, "inertia is the small parameter of the equation of motion")})
def without_inertia(reynolds: float) -> Measured:
    """Largest difference of displacements at a time of decay, over the largest at first; 5 % of strain."""
    rho, found = 1000.0, {}  # Pa µs²/µm²
    for name, modulus, tension in (("gel, ρGR²/μ²", 1000.0, 0.0), ("drop, ργR/μ²", 0.0, 5000.0)):
        pull = modulus * RADIUS + tension
        mu = np.sqrt(rho * pull * RADIUS / reynolds)  # Pa µs
        end = mu * RADIUS / pull
        plasm = FLUID | {"viscosity": f"{1e-6 * mu} Pa s", "reduced_bulk_modulus": "100 kPa"}
        tables: dict[str, Any] = {"numerics": {"bulk_viscosity": 0}}
        if modulus:
            plasm |= {"law": "gel", "shear_modulus": f"{modulus} Pa"}
        else:
            tables["cortex"] = {"line_tension": f"{tension} pN/um"}
        x = [_released(alone(2, 100, plasm, {"end": f"{end} us", "integrator": kind} | step, **tables), end)
             for kind, step in (("leapfrog", {}), ("overdamped", {"step": f"{end / 100} us"}))]
        found[name] = float(np.abs(x[0] - x[1]).max() / (0.05 * RADIUS))
    return Measured(reynolds, found)


def _released(case: Case, end: float) -> np.ndarray:
    """Displacements (size, 2) [µm] at the time `end` [µs] of a body that is stretched by 5 % and released at rest."""
    with default_options({"ts_type": "bdf"} if case.overdamped else {}), built(case) as sim:
        set_state(sim, sim.scene.X * [0.05, 1.0 / 1.05 - 1.0])
        sim.go(end)
        return displacement(sim)


# ------------------------------------------------------------------------------------------------------------ creep


PULL = 300.0  # Pa


@reference("network-creeps", shows="elongation of a block of network under a pull of 300 Pa over 60 s; step the size",
           source="A' = (λ⁻² - A)/τ of each direction, and the balance of forces, by quadrature", unit="s",
           at=(2.0, 1.0, 0.5), seconds=20.0,
           expected={"elongation": converges(2, "the shares of a step are exact where C⁻¹ is linear in time")})
def network_creeps(step: float) -> Measured:
    """The pull grows within 10 s; τ is 10 s, so that the network flows."""
    case = pressed(2, step)
    tree = case.resolved()
    tree["supports"] = [s for s in tree["supports"] if s["name"] != "right"]
    tree["loads"] = [{"name": "pull", "parts": ["right"], "traction": [f"{PULL} Pa", "0 Pa"],
                      "load_curve": {"law": "ramp", "duration": "10 s"}}]
    tree["time"] |= {"end": "60 s"}
    law = case.materials["plasm"]
    G, tau, mu = law.shear_modulus, 1e-6 * law.relaxation_time, 1e-6 * law.viscosity

    def rates(t: float, z: np.ndarray) -> list[float]:
        """Of λ and A along and across: λ P = G (λ² A - λ⁻² B) + 4 μ λ'/λ, without change of the area."""
        stretch, A, B = z
        pull = PULL * min(t / 10.0, 1.0) * stretch
        rate = (pull - G * (stretch**2 * A - B / stretch**2)) / (4.0 * mu) * stretch
        return [rate, (stretch**-2 - A) / tau, (stretch**2 - B) / tau]

    times = np.array([20.0, 40.0, 60.0])
    exactly = {"method": "Radau", "rtol": 1e-10, "atol": 1e-12}
    drawn = solve_ivp(rates, (0.0, 10.0), [1.0, 1.0, 1.0], **exactly).y[:, -1]
    right = solve_ivp(rates, (10.0, 60.0), drawn, t_eval=times, **exactly).y[0]
    with built(from_dict(tree)) as sim:
        end, error = sim.scene.X[:, 0].max(), 0.0
        for t, stretch in zip(times, right, strict=True):
            sim.go(1e6 * t)
            on = sim.scene.X[:, 0] > end - 1e-9
            found = displacement(sim)[on, 0].mean() / 2.0
            error = max(error, abs(found / (stretch - 1.0) - 1.0))
    return Measured(step, {"elongation": float(error)})


# ------------------------------------------------------------------------------------------------- stress of a layer


WINDOW = 2.0  # width at half of its height [µm]


@reference("layer-stress", shows="stress of a crawling cell over its height, h σ, against ∫ T dx of its traction",
           source="balance of forces of the part on the left (monolayer stress microscopy, Tambe et al. 2011, "
                  "Nature Materials 10:469-475)", at=(100, 300, 900), seconds=20.0,
           expected={"h σ": converges(1, "stress is singular at the ends of the contact"),
                     "forces of all": exact(1e-6, "to the balance of forces")})
def layer_stress(count: int) -> Measured:
    """A segment of 20 x 5 µm of gel that pushes itself, 100 s after its start.

    Largest error over the largest h σ, of means over WINDOW; sum of forces over the sizes of those of friction.
    """
    case = from_dict({
        "time": {"end": "100 s", "samples": 1, "frames": 1, "integrator": "overdamped"},
        "particles": {"per_cell": count}, "materials": {"gel": GEL}, "adhesion": {"substrate": BONDS},
        "medium": {"viscosity": f"{WATER} Pa s"}, "friction": {"coefficient": "500 Pa s/um"},
        "cells": [{"name": "Cell", "shape": "segment", "width": "20 um", "height": "5 um", "centre": ["0 um"],
                   "rest": True, "material": "gel"}],
        "protrusion": {"cells": ["Cell"], "protrusion_ratio": 0.25, "height": "1 um", "random": False}})
    with default_options(TIGHT), built(case) as sim:
        sim.go(1e8)
        sim.sample()
        x, V = sim.scene.X[:, 0] + displacement(sim)[:, 0], sim.scene.field("V")
        terms = [by_id(sim, sim.mechanics.surface_force(name)[0])[:, 0]
                 for name in ("substrate", "friction", "protrusion", "medium")]
        forces = np.sum(terms, axis=0)
        stress, J = sim.sampler.nodal_stress()
        at = np.linspace(x.min(), x.max(), 41)[1:-1]
        away = np.clip((x - at[:, None]) / WINDOW, -1.0, 1.0)  # [-], of means over cosine windows
        mean = (0.5 + 0.5 * np.cos(np.pi * away)) / WINDOW @ (V * by_id(sim, stress[:, 0, 0] * J))
        carried = (0.5 + 0.5 * away + 0.5 / np.pi * np.sin(np.pi * away)) @ forces
        return Measured(sim.scene.templates[0].spacing, {
            "h σ": float(np.abs(mean - carried).max() / np.abs(carried).max()),
            "forces of all": float(abs(forces.sum()) / np.abs(terms[1]).sum())}, count)
