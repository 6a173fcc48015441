"""The initial state of a case: displacements, velocities and director angles, from its formulas."""

from __future__ import annotations

import numpy as np

from ..case.expression import evaluate
from ..case.schema import Case
from ..meshfree.body import Scene
from ..model.director import start_angle


def at_start(case: Case, scene: Scene) -> dict[str, np.ndarray]:
    """Initial fields of all particles, by their names in the swarm.

    These are X, u (size, 2) [µm], v (size, 2) [µm/µs], angles of the director (size,) [rad], accounts (size, 5), zero.
    """
    n, X = scene.size, scene.X
    u, v, theta = np.zeros((n, 2)), np.zeros((n, 2)), np.zeros(n)
    for i, c in enumerate(case.cells):
        on, place = slice(*scene.offset[i : i + 2]), scene.templates[scene.kind[i]].X
        u[on] = np.column_stack([evaluate(value, place) for value in c.displacement])
        v[on] = np.column_stack([evaluate(value, place) for value in c.velocity])
        v[on] += place @ np.array(c.velocity_gradient).T
        if case.director is not None:
            theta[on] = start_angle(case.director.start, case.director.angle, X[on], np.array(c.centre))
    return {"id": np.arange(n), "X": X, "u": u, "v": v, "theta": theta, "loss": np.zeros((n, 5))}
