"""Surfaces in space: balls on a plane and beside each other, and a drop that its tension keeps round."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from cellmig.verify.reference import Measured, converges, reference

from .scenes import built, by_id, case, displacement, set_motion, set_state
from .space import RADIUS, TENSION, ball
from .surface import WIDE, between_round

SAGITTA = "a polyhedron for the ball: its sagitta is of h²"
GAPS = (1.5, 2.5)  # over ε
WIDER = ('adhesion.cells.equilibrium_distance="0.3 um"', 'adhesion.cells.cutoff="1.5 um"')


@reference("ball-on-plane", shows="F(a) of a rigid ball at gaps of 1.5 ε and 2.5 ε", at=(600, 1500, 4000, 10000),
           seconds=13.0,
           source="F = 2πRN [U(a + 2R) - U(a)], the pull: eqs. (4)-(6) over the sphere",
           expected={f"F({k} ε)": converges(2, SAGITTA) for k in GAPS})
def ball_on_plane(count: int) -> Measured:
    """Forces are integrated exactly over triangles: the error is that of the shape, averaged over 16 orientations."""
    found, turns = {}, Rotation.random(16, random_state=1).as_matrix()
    with built(case("ball", count, *WIDE)) as sim:
        law, centre = sim.terms.substrate, sim.scene.centre[0]
        for k in GAPS:
            a = k * law.equilibrium_distance
            right = 2.0 * np.pi * RADIUS * law.bond_density * (law.potential(a + 2.0 * RADIUS) - law.potential(a))
            pulled = []
            for turn in turns:
                set_motion(sim, (sim.scene.X - centre) @ turn.T + [0.0, 0.0, RADIUS + a] - sim.scene.X)
                pulled.append(-float(sim.mechanics.surface_force("substrate")[0][:, 2].sum()))
            found[f"F({k} ε)"] = abs(float(np.mean(pulled)) / right - 1.0)
        return Measured(sim.scene.templates[0].spacing, found, count)


@reference("two-balls", shows="energy and F(a) of two rigid balls at gaps of 1.5 ε and 2.5 ε",
           source="eqs. (3), (4) over a sphere, of distances to another", at=(400, 1000, 3000), seconds=15.0,
           expected={f"{what}({k} ε)": converges(2, SAGITTA) for what in "EF" for k in GAPS})
def two_balls(count: int) -> Measured:
    """Either ball has half of the bonds, and the same energy."""
    found = {}
    with built(case("three_balls", count, *WIDER)) as sim:
        law, centre, R = sim.terms.contact, sim.scene.centre[sim.scene.cell], RADIUS
        for k in GAPS:
            apart = 2.0 * R + k * law.equilibrium_distance
            at = np.outer(sim.scene.cell, [apart, 0.0, 0.0]) + np.outer(sim.scene.cell == 2, [0.0, 100.0, 0.0])
            set_state(sim, at - centre)
            right = between_round(law, apart, lambda t: 2.0 * np.pi * R * R * np.sin(t))
            forces, energies = sim.mechanics.surface_force("contact")
            pulled = float(by_id(sim, forces)[sim.scene.cell == 0, 0].sum())
            found[f"E({k} ε)"] = abs(float(energies.sum()) / right[0] - 1.0)
            found[f"F({k} ε)"] = abs(pulled / right[1] - 1.0)
        return Measured(sim.scene.templates[0].spacing, found, count)


@reference("drop-at-rest", shows="pressure in a ball of fluid under a tension of 5000 pN/µm, and its shape, at 20 µs",
           source="2T/R (Laplace); a sphere", at=(300, 750, 2000), seconds=10.0,
           expected={"pressure": converges(2, "a polyhedron for the ball: its area over its volume is of h²"),
                     "roundness": converges(2, "of the same: rms of the radius over the surface, over R")})
def drop_at_rest(count: int) -> Measured:
    """The viscosity is that of the cytoplasm; motions decay within 5 µs."""
    cortex = {"cortex": {"law": "line-tension", "line_tension": f"{TENSION} pN/um"}}
    with built(ball(count, "cytoplasm", **cortex)) as sim:
        sim.go(20.0)
        V, surface = sim.scene.field("V"), sim.scene.surface(0)
        pressure = -np.trace(sim.sampler.nodal_stress()[0], axis1=1, axis2=2) / 3.0
        x = sim.scene.X + displacement(sim)
        r = np.linalg.norm(x[surface] - V @ x / V.sum(), axis=1)
        return Measured(sim.scene.templates[0].spacing,
                        {"pressure": abs(float(V @ by_id(sim, pressure) / V.sum()) * RADIUS / (2.0 * TENSION) - 1.0),
                         "roundness": float(r.std() / RADIUS)}, count)
