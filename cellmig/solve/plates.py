"""Rigid frictionless plates in equilibrium: unilateral contact of surface particles."""

from __future__ import annotations

import numpy as np

from .mechanics import Mechanics


class PlateContact:
    """Contact of surface particles with the plate nearest to each: gap ≥ 0, pressure ≥ 0, gap × pressure = 0.

    They are written as one equation, min(pressure, stiffness × gap) = 0, which replaces the balance of forces along the
    normal; Newton's method is then an active-set method.  The balance along the plate is unchanged.  Particles whose
    two components a support holds have no contact.

    Source: the min function in semismooth Newton methods, Hintermüller, Ito & Kunisch (2002).
    """

    def __init__(self, mechanics: Mechanics):
        """Find the surface particles of this rank that plates may touch."""
        self.mechanics = m = mechanics
        self._held = np.zeros((m.n_owned, 2), bool)
        self._held[m.loads.held] = True
        self.at = m.loads.platable
        self._meets = ~self._held[self.at].all(axis=1)

    def gaps(self) -> np.ndarray:
        """Gaps between the surface particles and the plates (k, plates) [µm]."""
        m, plate = self.mechanics, self.mechanics.loads.boundary.plate
        factor = m.loads.factors(m.loads.boundary.plate_curve)
        face = plate[:, 2:4] + factor[:, None] * plate[:, 4:6]
        x = m.state.x(self.at)
        return np.einsum("kpc,pc->kp", x[:, None] - face, plate[:, :2])

    def _nearest(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Gap (k,) [µm], normal (k, 2) and number (k,) of the plate nearest to each surface particle."""
        gaps = self.gaps()
        p = np.argmin(gaps, axis=1)
        return gaps[np.arange(len(p)), p], self.mechanics.loads.boundary.plate[p, :2], p

    def _directions(self, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Row (k,) that the condition replaces; vectors (k, 2) whose product with -f is the pressure; tangents."""
        held, row = self._held[self.at], np.argmax(np.abs(normal), axis=1)
        row = np.where(held.any(axis=1), np.argmin(held, axis=1), row)  # the component that is free
        k = np.arange(len(row))
        only = np.zeros_like(normal)
        only[k, row] = 1.0 / np.where(normal[k, row] == 0.0, 1.0, normal[k, row])
        one = held.any(axis=1)
        return row, np.where(one[:, None], only, normal), np.column_stack([-normal[:, 1], normal[:, 0]])

    def residual(self, r: np.ndarray, scale: float) -> np.ndarray:
        """The residual r (n_owned, 2) [pN/µm] with the contact conditions; `scale` [Pa] is the stiffness in them."""
        if not len(self.at):
            return r
        gap, normal, _ = self._nearest()
        row, pressure, along = self._directions(normal)
        k, old = np.flatnonzero(self._meets), r[self.at]
        new = old.copy()
        new[k, 1 - row[k]] = (along * old).sum(axis=1)[k]
        new[k, row[k]] = np.minimum((pressure * old).sum(axis=1), scale * gap)[k]
        r = r.copy()
        r[self.at] = new
        return r

    def rows(self, f: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
        """Factors and summands of the rows of the tangent -∂f/∂u of a particle, for the contact conditions.

        Parameters
        ----------
        f : (n_owned, 2) float -- forces but those of plates [pN/µm].
        scale : float -- stiffness in the conditions [Pa].

        Returns
        -------
        (n_owned, 2, 2), (n_owned, 2, 2) float -- matrices that multiply the rows [-]; blocks to add [Pa].
        """
        n = self.mechanics.n_owned
        factor, diagonal = np.tile(np.eye(2), (n, 1, 1)), np.zeros((n, 2, 2))
        if len(self.at):
            gap, normal, _ = self._nearest()
            row, pressure, along = self._directions(normal)
            on = scale * gap <= (pressure * -f[self.at]).sum(axis=1)
            k = np.flatnonzero(self._meets)
            i, r = self.at[k], row[k]
            factor[i, 1 - r] = along[k]
            factor[i, r] = np.where(on[k, None], 0.0, pressure[k])
            diagonal[i, r] = np.where(on[k, None], scale * normal[k], 0.0)
        return factor, diagonal

    def store(self, f: np.ndarray) -> None:
        """Store the forces of the plates in the kernel: they balance the other forces f (n_owned, 2) [pN/µm]."""
        if len(self.at):
            kept = self.mechanics.loads.plate_force
            _, normal, p = self._nearest()
            pressure = (self._directions(normal)[1] * -f[self.at]).sum(axis=1)
            kept[:] = 0.0
            kept[np.arange(len(p)), p] = np.where(self._meets, np.maximum(pressure, 0.0), 0.0)

    def force(self) -> np.ndarray:
        """Force of the plates on the owned particles (n_owned, 2) [pN/µm]."""
        m, out = self.mechanics, np.zeros((self.mechanics.n_owned, 2))
        if len(self.at):
            out[self.at] = m.loads.plate_force @ m.loads.boundary.plate[:, :2]
        return out
