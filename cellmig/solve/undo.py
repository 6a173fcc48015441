"""What steps change, remembered: to undo a batch of steps, and to go on after a look as if nobody had looked."""

from __future__ import annotations

from typing import Any

import numpy as np

_TIMES = ("F_lag", "accounted_dt", "dt_prev")
_NOT_LOOKED_AT = ("state", "bond_impulse", "contact_impulse")  # no look changes the first, rows of tables the others


class Undo:
    """Copies of the arrays of a Mechanics that steps change, and of its times."""

    def __init__(self, mechanics: Any):
        """Copies are made when they are first needed."""
        self._mechanics, self._put_by = mechanics, False
        self._copies: dict[str, np.ndarray] = {}

    def keep(self) -> None:
        """Remember all that steps change, so that `go_back` can undo them."""
        for name, values in self._mechanics.changing().items():
            copy = self._copies.get(name)
            if copy is None or copy.shape != values.shape:
                self._copies[name] = values.copy()
            else:
                np.copyto(copy, values)
        self._times = {name: getattr(self._mechanics, name) for name in _TIMES}

    def go_back(self) -> None:
        """Undo the steps since `keep`."""
        self._restore(())
        self._mechanics.volumes()  # nor do the values of J count that occurred

    def put_by(self) -> None:
        """What the next step goes on from is put by, so that a look may bring F and the accounts up to date."""
        if not self._put_by and self._mechanics.dt_prev:  # at the start nothing is left half done
            self.keep()
            self._put_by = True

    def forget(self) -> None:
        """What was put by does not count any more: another state takes its place."""
        self._put_by = False

    def take_up(self) -> None:
        """What was put by is there again, as if nobody had looked."""
        if self._put_by:
            self._put_by = False
            self._restore(_NOT_LOOKED_AT)

    def _restore(self, but: tuple) -> None:
        for name, values in self._mechanics.changing().items():
            if name not in but:
                np.copyto(values, self._copies[name])
        for name, value in self._times.items():
            setattr(self._mechanics, name, value)
