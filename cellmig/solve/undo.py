"""Copies of what steps change, to undo a batch of steps, and to continue after output with the same bits."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

Arrays = dict[str, np.ndarray]


@dataclass
class Times:
    """Times that a step of leapfrog needs from the previous one.

    dt_prev : the previous step [µs], in whose middle the velocities are;  F_lag : time since F was updated [µs];
    accounted_dt : time whose work still lacks the forces at its end [µs].
    """

    F_lag: float = 0.0
    accounted_dt: float = 0.0
    dt_prev: float = 0.0


class Undo:
    """A copy of an earlier state: arrays by name, of any shape and unit, and times.

    aside : whether the next step continues from the copy.
    """

    def __init__(self) -> None:
        """Begin without copies; memory is allocated by the first `save`."""
        self.aside = False
        self._copies: Arrays = {}
        self._times = Times()

    def save(self, arrays: Arrays, times: Times) -> None:
        """Copy arrays and times."""
        for name, values in arrays.items():
            copy = self._copies.get(name)
            if copy is None or copy.shape != values.shape:
                self._copies[name] = values.copy()
            else:
                np.copyto(copy, values)
        self._times = replace(times)

    def restore(self, arrays: Arrays, times: Times, but: tuple[str, ...] = ()) -> None:
        """Restore arrays, except those named in `but`, and times."""
        for name, values in arrays.items():
            if name not in but:  # ghosts may have come or gone since; they are exchanged
                n = min(len(values), len(self._copies[name]))
                values[:n] = self._copies[name][:n]
        times.F_lag, times.accounted_dt, times.dt_prev = (
            self._times.F_lag, self._times.accounted_dt, self._times.dt_prev)
