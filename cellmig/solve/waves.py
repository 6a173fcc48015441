"""Solutions of diffusion in a box by its standing waves, which cosine and sine transforms find."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from scipy import fft

# Transforms of an axis by whether concentrations are given at its lower and at its upper wall, and by how much the
# numbers of its waves are more than 0, 1, 2, …
KINDS = {(False, False): (fft.dct, fft.idct, 2, 0.0), (True, True): (fft.dst, fft.idst, 2, 1.0),
         (False, True): (fft.dct, fft.idct, 4, 0.5), (True, False): (fft.dst, fft.idst, 4, 0.5)}


class Waves:
    """Eigenvectors of diffusion between the equal volumes of a box, A, by which (A + m) d = b is solved at once.

    Source: Buzbee, Golub & Nielson (1970), On direct methods for solving Poisson's equations, SIAM J. Numer. Anal.
    7:627-656; the transforms: Strang (1999), The discrete cosine transform, SIAM Rev. 41:135-147.
    """

    def __init__(self, count: Sequence[int], conductance: Sequence[float], given: Sequence[tuple[bool, bool]]):
        """For `count` volumes along each axis, between which `conductance` (d,) [µm³/µs] leads.

        given : of each axis, whether there are concentrations at its lower and at its upper wall; others are closed.
        """
        self._shape, self.eigenvalues = tuple(count)[::-1], np.zeros(tuple(count)[::-1])
        self._there, self._back = [], []
        for axis, (n, g, walls) in enumerate(zip(count, conductance, given, strict=True)):
            there, back, kind, more = KINDS[walls]
            along = len(self._shape) - 1 - axis
            self._there.append(partial(there, type=kind, axis=along, norm="ortho"))
            self._back.append(partial(back, type=kind, axis=along, norm="ortho"))
            wave = 2.0 * g * (1.0 - np.cos(np.pi * (np.arange(n) + more) / n))
            self.eigenvalues += wave.reshape([-1 if k == along else 1 for k in range(len(self._shape))])

    def solved(self, b: np.ndarray, m: float) -> np.ndarray:
        """Solution d (n,) of (A + m) d = b (n,), for m > 0 [µm³/µs]; volumes go along x first."""
        waves = b.reshape(self._shape)
        for transform in self._there:
            waves = transform(waves)
        waves = waves / (self.eigenvalues + m)
        for transform in self._back:
            waves = transform(waves)
        return waves.ravel()
