"""Copies of what steps change: to undo a batch of steps, and to go on after a look as if nobody had looked."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

Arrays = dict[str, np.ndarray]


@dataclass
class Times:
    """What a step of leapfrog leaves to the next one.

    dt_prev : the previous step [µs], at whose middle the velocities are;  F_lag : time since F was updated [µs];
    accounted_dt : time for whose work the forces at its end are still missing [µs].
    """

    F_lag: float = 0.0
    accounted_dt: float = 0.0
    dt_prev: float = 0.0


class Undo:
    """One earlier state: arrays by name, of any shape and unit, and times.

    aside : whether the next step is to go on from there.
    """

    def __init__(self) -> None:
        """Copies are made when they are first needed."""
        self.aside = False
        self._copies: Arrays = {}
        self._times = Times()

    def save(self, arrays: Arrays, times: Times) -> None:
        """Remember these."""
        for name, values in arrays.items():
            copy = self._copies.get(name)
            if copy is None or copy.shape != values.shape:
                self._copies[name] = values.copy()
            else:
                np.copyto(copy, values)
        self._times = replace(times)

    def restore(self, arrays: Arrays, times: Times, but: tuple[str, ...] = ()) -> None:
        """Write to these what was remembered, except to the arrays named in `but`."""
        for name, values in arrays.items():
            if name not in but:
                np.copyto(values, self._copies[name])
        times.F_lag, times.accounted_dt, times.dt_prev = (
            self._times.F_lag, self._times.accounted_dt, self._times.dt_prev)
