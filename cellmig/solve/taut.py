"""Stiffness of surfaces whose tension changes with their stretch, for the step: that of an elastic cortex."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, TypeGuard

import numpy as np

from ..geometry import triangles
from ..meshfree.simplices import facet_sizes
from ..model.protocols import Cortex
from .tangent import derivative

if TYPE_CHECKING:  # who only asks for a stable step starts no MPI
    from ..kernel.kernel import Kernel
    from .state import State
    from .subdomain import Subdomain

PROBED = np.array([0.5, 1.0, 1.5, 2.0])  # stretches at which a law tells whether its tension changes [-]


def stiffness(law: Cortex, stretch: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tension and its derivative by a `stretch` (n,) [-], both (n,) [pN/µm]."""
    value, slope = derivative(lambda s: (law.tension(s),), stretch)
    return value[0], slope[0, 0]


def changes(law: Cortex | None) -> TypeGuard[Cortex]:
    """Whether the tension of a cortex, if there is one, changes with the stretch."""
    return law is not None and bool(stiffness(law, PROBED)[1].any())


def at_rest(law: Cortex) -> float:
    """Larger one of tension and its derivative at the reference length [pN/µm]; of a constant tension, that."""
    tension, slope = (float(value[0]) for value in stiffness(law, np.ones(1)))
    return max(tension, slope)


def rows(law: Cortex, x: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Symmetric matrices B (k, D, D, D) of the corners of facets, which bound their stiffness K [pN/µm^(3 - D)].

    For any displacements u of the corners, u·K u is at most the sum of u·B u over these.

    With T' = dT/ds, a segment of length l, L at rest, has T'/L along it and T/l across for the difference of its ends:
    twice that for each end is a bound.  A triangle of area a, A at rest, has T'/A g⊗g with the gradients g of a by its
    corners, for which three times the parts of single corners are a bound, and T times the second derivatives of a.
    Those across are e·e'/4a for two corners opposite to the edges e and e', and row sums are a bound; those along the
    surface cancel between triangles in one plane, and are left out.  Negative T or T' count as zero.

    Parameters
    ----------
    x : (k, D, D) -- corners of facets [µm].
    size : (k,) -- lengths L [µm] or areas A [µm²] of these at rest.

    Source: derived here, by Cauchy's and Gershgorin's inequalities.
    """
    now, D = facet_sizes(x), x.shape[1]
    tension, slope = (np.maximum(value, 0.0) for value in stiffness(law, now / size))
    if D == 2:
        t = (x[:, 1] - x[:, 0]) / now[:, None]
        along = t[:, :, None] * t[:, None, :]
        B = 2.0 * ((slope / size)[:, None, None] * along + (tension / now)[:, None, None] * (np.eye(2) - along))
        return np.repeat(B[:, None], 2, axis=1)
    edges = np.roll(x, -1, axis=1) - np.roll(x, 1, axis=1)  # opposite of each corner
    normal = triangles.unit(triangles.area_vectors(x))
    g = 0.5 * triangles.cross(normal[:, None], edges)
    across = np.abs(edges @ edges.transpose(0, 2, 1)).sum(axis=2) * (0.25 * tension / now)[:, None]
    B = (3.0 * slope / size)[:, None, None, None] * g[..., :, None] * g[..., None, :]
    return B + across[..., None, None] * (normal[:, :, None] * normal[:, None, :])[:, None]


class Taut:
    """Stiffness of the cortex of this rank's surface particles, over their mass."""

    def __init__(self, law: Cortex, part: Subdomain, kernel: Kernel, state: State):
        """Take the facets that `Segments` has set."""
        self._law, self._part, self._kernel, self._state = law, part, kernel, state

    @cached_property
    def _mass(self) -> np.ndarray:
        return self._state.mass[self._part.at_surface]

    def frequencies(self) -> np.ndarray:
        """Bounds ω² (k,) [1/µs²] of this rank's surface particles, as they are now; infinite where one is not sound."""
        part, taut = self._part, self._kernel["taut"]
        corners, size = self._kernel["facet"][taut], self._kernel["facet_size"][taut]
        total = np.zeros((part.capacity, part.scene.dimension, part.scene.dimension))
        with np.errstate(all="ignore"):
            np.add.at(total, corners, rows(self._law, self._state.x(corners), size))
            B = total[part.at_surface]
            sound = np.isfinite(B).all(axis=(1, 2))
            found = np.linalg.eigvalsh(np.where(sound[:, None, None], B, 0.0))[:, -1] / self._mass
        return np.where(sound, np.maximum(found, 0.0), np.inf)
