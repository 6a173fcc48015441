"""Arguments for formulas of laws, derivatives by differences, and equality to rounding."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation


def deformations(n: int = 200, d: int = 2) -> np.ndarray:
    """Random F (d, d, n) with stretch, shear and rotation: 0.3 < J, turns up to half a circle."""
    rng = np.random.default_rng(1)
    F = np.eye(d)[:, :, None] + 0.35 * rng.standard_normal((d, d, 3 * n))
    F = F[:, :, determinant(F) > 0.3][:, :, :n]
    assert F.shape[2] == n
    return np.einsum("ijn,jkn->ikn", rotations(n, d=d), F)


def rotations(n: int, seed: int = 2, d: int = 2) -> np.ndarray:
    if d == 3:
        return Rotation.random(n, random_state=seed).as_matrix().transpose(1, 2, 0)
    a = np.random.default_rng(seed).uniform(-np.pi, np.pi, n)
    return np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])


def spin(d: int) -> np.ndarray:
    """A rate of rotation (d, d)."""
    W = np.array([[0.0, -1.0, 0.4], [1.0, 0.0, -0.7], [-0.4, 0.7, 0.0]])
    return W[:d, :d]


def rates(n: int = 200, d: int = 2) -> np.ndarray:
    return np.random.default_rng(3).standard_normal((d, d, n))


def vectors(n: int = 200, d: int = 2) -> np.ndarray:
    return np.random.default_rng(4).standard_normal((d, n))


def gradients(n: int = 200, d: int = 2) -> np.ndarray:
    """Of the numbers of a director (m, d, n)."""
    return np.random.default_rng(4).standard_normal((1 if d == 2 else 3, d, n))


def directions(n: int = 200, d: int = 2) -> np.ndarray:
    """Unit vectors (d, n)."""
    return rotations(n, 6, d)[0]


def networks(n: int = 200, d: int = 2) -> np.ndarray:
    """What networks remember, symmetric and positive definite (d, d, n)."""
    F = deformations(n, d)[..., ::-1]
    return np.einsum("kin,kjn->ijn", F, F)


def fractions(n: int = 200) -> np.ndarray:
    """Numbers between 0 and 1 (n,)."""
    return np.random.default_rng(7).uniform(size=n)


def distances(law: Any) -> np.ndarray:
    """Through cap and well to past the cutoff, without those two points."""
    eps = law.equilibrium_distance
    far = np.geomspace(3.01 * eps, 1.5 * law.cutoff)
    r = np.concatenate([np.linspace(-0.5, 3.0, 701) * eps + 1.7e-6, far])
    return r[(abs(r - law.cap) > 1e-4 * eps) & (abs(r - law.cutoff) > 1e-3 * eps)]


def determinant(F: np.ndarray) -> np.ndarray:
    return F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0] if len(F) == 2 else np.linalg.det(np.moveaxis(F, -1, 0))


def slope(function: Any, x: np.ndarray, step: float) -> np.ndarray:
    """Derivative to fourth order in the step."""
    near, far = function(x + step) - function(x - step), function(x + 2 * step) - function(x - 2 * step)
    return (8 * near - far) / (12 * step)


def assert_close(a: Any, b: Any, tolerance: float) -> None:
    """Equal to `tolerance` of the largest value, which is not zero."""
    scale = np.abs(b).max()
    assert scale > 0.0
    assert np.abs(np.asarray(a) - b).max() <= tolerance * scale, f"{np.abs(np.asarray(a) - b).max() / scale:.2e}"
