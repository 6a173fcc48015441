"""The fastest modes of viscosity and of sound in the deformed body, which limit the step."""

from __future__ import annotations

import numpy as np

from ..kernel.fields import Field
from ..kernel.kernel import Kernel, aligned_zeros
from ..parallel.ghosts import GhostedField
from ..parallel.reduce import global_maximum
from .subdomain import Subdomain

CAUTION = 1.1  # factor on rates that a few iterations have found, which approach the largest one from below [-]
FIRST = 40  # iterations at the start of a run
NOISE = 0.02  # added to modes in each iteration, from which another one can grow [-]
MULTIPLIER = 2654435761  # of Knuth's multiplicative hash (The Art of Computer Programming 3, 6.4)


class Modes(GhostedField):
    """The modes of largest squared frequency and of largest damping rate, by power iteration along the run.

    The operators are those of isotropic stresses on the current configuration, with the moduli at rest: shear and
    P-wave moduli, and viscosity with the bulk damping.  A body deforms little from one batch of steps to the next, so
    that one iteration for each keeps the modes.

    Attributes
    ----------
    memory : (capacity, 2 d) float -- the mode of sound, and that of viscosity; the largest vector of each is 1
        [-].  Noise is added to them, from which a mode can grow that becomes the fastest one.

    Source: power iteration along explicit steps, as by Benson (1998), Comput. Methods Appl. Mech. Eng. 167, 191.
    """

    FIELDS = (
        Field("viscosity", "double *", "(stencils, 4)", "Pa µs", "μ"),
        Field("shear_modulus", "double *", "(stencils, 4)", "Pa", "at rest"),
        Field("dilation_modulus", "double *", "(stencils, 4)", "Pa", "P-wave modulus less twice the shear modulus"),
    )

    def __init__(self, part: Subdomain, kernel: Kernel):
        """Begin with vectors that look like chance; collective."""
        self._part, self._kernel, self._width = part, kernel, 2 * part.scene.dimension
        self.memory = aligned_zeros((part.capacity, self._width))
        super().__init__(part.comm, self.memory, part.n_owned, part.numbering.shared.sum())
        self.set_ghosts(part.in_petsc(part.numbering)[part.n_owned :])
        number = (self._width * part.ids[:, None] + np.arange(1, self._width + 1)) * MULTIPLIER % 2**32
        self._noise = NOISE * (number / 2.0**31 - 1.0)
        self.owned[:] = self._noise

    def follow(self, known: bool = False) -> dict[str, float]:
        """Rates of the modes, "sound" [1/µs²] and "viscosity" [1/µs], which may be `known` from shortly before;
        collective.
        """
        k, out = self._kernel, np.zeros((self._part.n_owned + 4, self._width))
        for _ in range(1 if known else FIRST):
            self.owned[:] += self._noise
            self.exchange()
            k("respond", k["shear_modulus"], k["dilation_modulus"], self.memory, out, 0)
            k("respond", k["viscosity"], k["bulk_damping"], self.memory, out, self._width // 2)
            largest = global_maximum(self._comm, _longest(out))
            self.owned[:] = out[: self._part.n_owned] * np.repeat(1.0 / np.maximum(largest, 1e-300), self._width // 2)
        sound, viscosity = (CAUTION * largest).tolist()
        return {"sound": sound, "viscosity": viscosity}


def _longest(modes: np.ndarray) -> np.ndarray:
    """Largest lengths (2,) of both vectors of all particles, (n, 2 d)."""
    squares = (sum(part**2 for part in vector) for vector in np.split(modes.T, 2))
    return np.sqrt([square.max(initial=0.0) for square in squares])
