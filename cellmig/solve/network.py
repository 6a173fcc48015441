"""Networks whose bonds break and form again: what the rows of a rank remember of their deformation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..kernel.fields import Field
from ..kernel.kernel import Kernel
from .state import State
from .subdomain import Subdomain


class Network:
    """A of the rows; those of ghosts follow from F as on the rank of their owner, with the same bits.

    Leapfrog renews A in the kernel, step by step.  Other integrators `begin` a step, `reach` the times at which they
    need stresses, always from the same start, and `renew` A where a step ends.  In between A has the bonds that formed
    anew at the begin; the share that does so at the end is taken with the stress.

    Source: the law maxwell.
    """

    FIELDS = (
        Field("network", "double *", "(n_blocks, d², 4)", "-", "A: entries by columns, by lanes"),
        Field("network_share", "double *", "(n_materials,)", "-", "share that forms anew at F, 0 between steps"),
        Field("network_step", "double *", "(n_materials, 2)", "-", "shares at begin and end of a step of leapfrog"),
    )

    def __init__(self, part: Subdomain, kernel: Kernel, state: State):
        """Begin with A = I."""
        self._kernel, self._state, self._d = kernel, state, part.scene.dimension
        of_block = part.blocks.table[:, 4]
        self._row_ids, self._material = part.row_ids, part.rows.material
        self._laws = [(i, law, of_block == i) for i, law in enumerate(part.scene.materials)
                      if hasattr(law, "network_renewed")]
        kernel["network"] = np.zeros((len(of_block), self._d**2, 4))
        kernel["network"][:, :: self._d + 1] = 1.0
        kernel["network_share"], kernel["network_step"] = (np.zeros((len(part.scene.materials), n)) for n in (1, 2))
        self._start = self._before = self.by_block["network"]

    @property
    def by_block(self) -> dict[str, np.ndarray]:
        """A (n_blocks, d², 4) [-], writable, which steps change, by the name of the field."""
        return {"network": self._kernel["network"]}

    @property
    def rows(self) -> np.ndarray:
        """A of the rows, owned first (d, d, n_rows) [-]."""
        return self._state.by_row(self._kernel["network"]).reshape(-1, self._d, self._d).transpose(2, 1, 0)

    def of_rows(self) -> dict[str, np.ndarray]:
        """A (d, d, n_rows) and the share of its bonds that form anew (n_rows,) [-], by their names in laws."""
        return {"network": self.rows, "share": self._kernel["network_share"][self._material, 0]}

    def begin(self) -> None:
        """Begin a step, at A and F as they are."""
        self._start, self._before = self._kernel["network"].copy(), self._kernel["F"].copy()

    def reach(self, time: float) -> None:
        """Set A and the share for stresses a `time` [µs] after the begin of the step."""
        for i, law, on in self._laws:
            first, self._kernel["network_share"][i] = law.network_shares(time)
            self._set(on, law.network_renewed, self._before, self._start, first)

    def renew(self) -> None:
        """End the step at the time that was reached last, and begin the next; F has to be current."""
        for i, law, on in self._laws:
            last = self._kernel["network_share"][i, 0]
            self._set(on, law.network_renewed, self._kernel["F"], self._kernel["network"], last)
            self._kernel["network_share"][i] = 0.0
        self.begin()

    def begin_from(self, particles: np.ndarray | None) -> None:
        """Begin with A of the rows' `particles` (n_rows, d²) [-], or with bonds without stress; F has to be current."""
        for _, law, on in self._laws:
            self._set(on, law.unstressed, self._kernel["F"])
        if particles is not None:
            self._state.set_by_row(self._kernel["network"], particles)
        self.begin()

    def _set(self, on: np.ndarray, formula: Callable[..., Any], *given: Any) -> None:
        """Set A on some blocks to a formula of tensors by blocks, and of numbers."""
        d = self._d
        A = formula(*(a[on].reshape(-1, d, d, 4).transpose(2, 1, 0, 3) if np.ndim(a) else a for a in given))
        self._kernel["network"][on] = np.array(A).transpose(2, 1, 0, 3).reshape(-1, d * d, 4)
