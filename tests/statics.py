"""Equilibrium under given loads: Newton's method on the forces of the kernel, with the tangent of the laws."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scenes import forces, set_motion
from scipy import sparse
from scipy.sparse.linalg import splu

from cellmig.case.pointwise import pointwise
from cellmig.simulation import Simulation

GAUSS = ((0.5 - np.sqrt(0.15), 5 / 18), (0.5, 8 / 18), (0.5 + np.sqrt(0.15), 5 / 18))


def loads(X: np.ndarray, surface: np.ndarray, stress: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Forces (n, 2) [pN/µm] on the closed polygon `surface` by the tractions of a stress (…, 2, 2), edge by edge."""
    out, after = np.zeros_like(X), np.roll(surface, -1)
    along = X[after] - X[surface]
    normal = np.column_stack([along[:, 1], -along[:, 0]])
    for s, weight in GAUSS:
        t = weight * np.einsum("nij,nj->ni", stress(X[surface] + s * along), normal)
        np.add.at(out, surface, (1.0 - s) * t)
        np.add.at(out, after, s * t)
    return out


def tangent(sim: Simulation, u: np.ndarray, time: float) -> sparse.csc_matrix:
    """Derivative of the internal forces of one cell by u (2n, 2n), x before y; velocities are u/time."""
    t, h = sim.scene.templates[0], 1e-6
    g = t.G
    H = np.array([[g[j] @ u[:, i] for j in range(2)] for i in range(2)])

    def stress(H: np.ndarray) -> np.ndarray:
        P, given = np.zeros_like(H), {"F": H + np.eye(2)[:, :, None], "Fdot": H / time}
        for i, law in enumerate(sim.scene.materials):
            on = sim.scene.material == i
            local = {name: values[..., on] for name, values in given.items()}
            for method in ("stress", "viscous_stress"):
                if hasattr(law, method):
                    P[..., on] += np.array(pointwise(law, method, local))
        return P

    A = np.zeros((2, 2, *H.shape))
    for k in range(2):
        for l in range(2):
            step = h * np.outer(np.eye(2)[k], np.eye(2)[l])[:, :, None]
            A[:, :, k, l] = t.V * (stress(H + step) - stress(H - step)) / (2.0 * h)
    pairs = [(j, l) for j in range(2) for l in range(2)]
    blocks = [[sum(g[j].T @ sparse.diags(A[i, j, k, l]) @ g[l] for j, l in pairs) for k in range(2)] for i in range(2)]
    return (sparse.bmat(blocks) + sparse.block_diag([t.E + t.S / time] * 2)).tocsc()


def equilibrium(sim: Simulation, load: np.ndarray, u: np.ndarray, time: float = np.inf, rounds: int = 10) -> float:
    """Put one cell into equilibrium under a load (n, 2), starting from u; what is out of balance, over the load.

    Of the load, the part that moves the cell as a whole is left out.  Velocities are u/time: with a time, elasticity
    and viscosity share the load as after a creep of that time.
    """
    n, free = len(u), np.ones(2 * len(u), bool)
    left, right = np.argmin(sim.scene.X[:, 0]), np.argmax(sim.scene.X[:, 0])
    free[[left, n + left, n + right]] = False  # held where they are, without a reaction
    for _ in range(rounds):
        set_motion(sim, u, u / time)
        x = sim.scene.X + u
        rigid = [np.repeat([1.0, 0.0], n), np.repeat([0.0, 1.0], n), np.append(-x[:, 1], x[:, 0])]
        rigid = np.linalg.qr(np.column_stack(rigid))[0]
        r = (forces(sim) + load).T.ravel()
        r -= rigid @ (rigid.T @ r)
        missing = float(np.abs(r).max() / np.abs(load).max())
        if missing < 1e-10:
            break
        K = tangent(sim, u, time)[free][:, free]
        step = np.zeros(2 * n)
        step[free] = splu(K, "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}).solve(r[free])
        u = u + step.reshape(2, n).T
    return missing
