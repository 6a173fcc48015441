"""Rigid plates in equilibrium: either a particle is off a plate, or on it and pushed."""

from __future__ import annotations

import numpy as np

from .mechanics import Mechanics


class Contact:
    """The conditions gap >= 0, push >= 0, one of them zero, of the surface particles and the plate nearest to each.

    They are one equation, min(push, stiffness x gap) = 0, which takes the place of the balance along the normal;
    Newton's method finds with it which particles touch.  The balance along the plate, without friction, stays.
    """

    def __init__(self, mechanics: Mechanics):
        """Particles that both components of a support hold meet no plate."""
        self.mechanics = m = mechanics
        k, n = m.kernel, m.n_owned
        there = m.terms.histories is not None and len(m.boundary.plate) > 0
        self._held = np.zeros((n, 2), bool)
        if m.terms.histories is not None:
            self._held[k["held"] // 4, k["held"] % 4] = True
        self.at = k["platable"] if there else np.zeros(0, np.int64)
        self._meets = ~self._held[self.at].all(axis=1)

    def _gaps(self) -> np.ndarray:
        """From the surface particles to the plates (k, plates) [µm]."""
        m, plate = self.mechanics, self.mechanics.boundary.plate
        t = m.kernel["clock"][0]
        factor = np.array([m.terms.histories[h].value(t) for h in m.boundary.plate_history])
        face = plate[:, 2:4] + factor[:, None] * plate[:, 4:6]
        x = m.scene.X[m.ids[self.at]] + m.state.owned[self.at, :2]
        return np.einsum("kpc,pc->kp", x[:, None] - face, plate[:, :2])

    def _nearest(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Gap (k,) [µm], normal (k, 2) and number (k,) of the plate nearest to each surface particle."""
        gaps = self._gaps()
        p = np.argmin(gaps, axis=1)
        return gaps[np.arange(len(p)), p], self.mechanics.boundary.plate[p, :2], p

    def _directions(self, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Row (k,) that the condition takes, and vectors (k, 2): push is their product with -f; along the plate."""
        held, row = self._held[self.at], np.argmax(np.abs(normal), axis=1)
        row = np.where(held.any(axis=1), np.argmin(held, axis=1), row)  # the component that is free
        k = np.arange(len(row))
        only = np.zeros_like(normal)
        only[k, row] = 1.0 / np.where(normal[k, row] == 0.0, 1.0, normal[k, row])
        one = held.any(axis=1)
        return row, np.where(one[:, None], only, normal), np.column_stack([-normal[:, 1], normal[:, 0]])

    def residual(self, r: np.ndarray, scale: float) -> np.ndarray:
        """The residual (n_owned, 2) with the conditions in it; `scale` [Pa] makes a force of a gap."""
        if not len(self.at):
            return r
        gap, normal, _ = self._nearest()
        row, push, along = self._directions(normal)
        k, old = np.flatnonzero(self._meets), r[self.at]
        new = old.copy()
        new[k, 1 - row[k]] = (along * old).sum(axis=1)[k]
        new[k, row[k]] = np.minimum((push * old).sum(axis=1), scale * gap)[k]
        r = r.copy()
        r[self.at] = new
        return r

    def rows(self, f: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
        """What the rows of ∂r/∂u are made of: a mixture (n, 2, 2) of those of -∂f/∂u, and blocks added to them."""
        n = self.mechanics.n_owned
        turn, diagonal = np.tile(np.eye(2), (n, 1, 1)), np.zeros((n, 2, 2))
        if len(self.at):
            gap, normal, _ = self._nearest()
            row, push, along = self._directions(normal)
            on = scale * gap <= (push * -f[self.at]).sum(axis=1)
            k = np.flatnonzero(self._meets)
            i, r = self.at[k], row[k]
            turn[i, 1 - r] = along[k]
            turn[i, r] = np.where(on[k, None], 0.0, push[k])
            diagonal[i, r] = np.where(on[k, None], scale * normal[k], 0.0)
        return turn, diagonal

    def store(self, f: np.ndarray) -> None:
        """The plates' forces to where the kernel keeps them: what balances the other forces f (n_owned, 2)."""
        if len(self.at):
            kept = self.mechanics.kernel["plate_force"]
            _, normal, p = self._nearest()
            push = (self._directions(normal)[1] * -f[self.at]).sum(axis=1)
            kept[:] = 0.0
            kept[np.arange(len(p)), p] = np.where(self._meets, np.maximum(push, 0.0), 0.0)

    def force(self) -> np.ndarray:
        """Of the plates on the owned particles (n_owned, 2) [pN/µm]."""
        m, out = self.mechanics, np.zeros((self.mechanics.n_owned, 2))
        if len(self.at):
            out[self.at] = m.kernel["plate_force"] @ m.boundary.plate[:, :2]
        return out

    def entered(self) -> float:
        """How deep the deepest particle of this rank is in a plate [µm]."""
        return max(0.0, -float(self._gaps().min())) if len(self.at) else 0.0
