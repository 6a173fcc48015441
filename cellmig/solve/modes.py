"""The mode of stresses and bonds in the deformed body that limits the step."""

from __future__ import annotations

import math

import numpy as np

from ..kernel.fields import Field
from ..kernel.kernel import Kernel, aligned_zeros
from ..parallel.ghosts import GhostedField
from ..parallel.reduce import global_maximum
from .subdomain import Subdomain

CAUTION = 1.1  # factor on an eigenvalue that a few iterations have found, which approach it from below [-]
FIRST = 40  # iterations where the mode is not known
NOISE = 0.02  # added to the mode in each iteration, from which another one can grow [-]
MULTIPLIER = 2654435761  # of Knuth's multiplicative hash (The Art of Computer Programming 3, 6.4)


class Modes(GhostedField):
    """The mode with the largest eigenvalue of ½ dt M⁻¹ C + ¼ dt² M⁻¹ K, by power iteration along the run.

    C and K are damping and stiffness on the current configuration: of isotropic stresses with the moduli at rest (shear
    and P-wave moduli, viscosity and bulk damping), of both stabilisations, and of what acts on surfaces.  A body
    deforms little from one batch of steps to the next, so that one iteration for each keeps the mode.

    Attributes
    ----------
    comm, dimension : the ranks, and D.
    memory : (capacity, 2 D) float -- the mode, whose largest vector is 1 [-], and zeros, as the kernel reads numbers of
        the state.  Noise is added to it, from which another mode can grow that becomes the largest.
    taut : (k,) float -- bounds of the stiffness of the cortex of surface particles, where its tension changes [1/µs²].

    Source: power iteration along explicit steps, as by Benson (1998), Comput. Methods Appl. Mech. Eng. 167, 191.
    """

    FIELDS = (
        Field("viscosity", "double *", "(stencils, 4)", "Pa µs", "μ"),
        Field("shear_modulus", "double *", "(stencils, 4)", "Pa", "at rest"),
        Field("dilation_modulus", "double *", "(stencils, 4)", "Pa", "P-wave modulus less twice the shear modulus"),
    )

    def __init__(self, part: Subdomain, kernel: Kernel):
        """Begin with vectors that look like chance; collective."""
        self.comm, self._part, self._kernel, self.dimension = part.comm, part, kernel, part.scene.dimension
        self.memory = aligned_zeros((part.capacity, 2 * self.dimension))
        super().__init__(part.comm, self.memory, part.n_owned, part.numbering.shared.sum())
        self.set_ghosts(part.in_petsc(part.numbering)[part.n_owned :])
        number = (2 * self.dimension * part.ids[:, None] + np.arange(1, self.dimension + 1)) * MULTIPLIER % 2**32
        self._noise = NOISE * (number / 2.0**31 - 1.0)
        self.mode = self.owned[:, : self.dimension]
        self.mode[:] = self._noise
        self._out = np.zeros((part.n_owned + 4, 2 * self.dimension))
        self._at = part.at_surface
        self.taut = np.zeros(len(self._at))
        self._size, self._drawn = (part.owned.field(name)[self._at, None]
                                   for name in ("size_per_mass", "drawn_per_mass"))

    def follow(self, dt: float, drag: float, stiffness: np.ndarray | None, tension: float, anew: bool) -> float:
        """The largest eigenvalue [-] for a step `dt` [µs]; collective.

        drag, stiffness : of surfaces, per area [Pa µs/µm], and (D,) along the axes [Pa/µm], None for C alone;
        tension : of surfaces, if it is the same at all stretches [pN/µm^(D - 2)];
        anew : whether another mode may be the largest than shortly before.
        """
        damping, squared = 0.5 * dt, 0.0 if stiffness is None else 0.25 * dt**2
        bonds = np.zeros(self.dimension) if stiffness is None else stiffness
        of_surface = self._size * (damping * drag + squared * bonds) + squared * tension * self._drawn
        of_surface += squared * self.taut[:, None]
        for _ in range(FIRST if anew else 1):
            self.exchange()
            self._kernel("respond", damping, squared, self.memory, self._out)
            found = self._out[: self._part.n_owned, : self.dimension]
            found[self._at] += of_surface * self.mode[self._at]
            square = sum(part * part for part in found.T)
            largest = math.sqrt(float(global_maximum(self.comm, np.array([square.max(initial=0.0)]))[0]))
            with np.errstate(over="ignore", invalid="ignore"):  # of a state that is not sound
                for part, of, noise in zip(self.mode.T, found.T, self._noise.T, strict=True):  # faster than all at once
                    np.multiply(of, 1.0 / max(largest, 1e-300), out=part)
                    part += noise
        return CAUTION * largest
