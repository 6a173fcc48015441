"""Rigid frictionless plates in equilibrium: unilateral contact of surface particles."""

from __future__ import annotations

import numpy as np

from .mechanics import Mechanics


class PlateContact:
    """Contact of surface particles with the plate nearest to each: gap ≥ 0, pressure ≥ 0, gap × pressure = 0.

    They are written as one equation, min(pressure, stiffness × gap) = 0, which replaces the balance of forces along the
    normal; Newton's method is then an active-set method.  The balance along the plate is unchanged.  A support that
    holds components of a particle bears what a plate pushes along these; where it holds all along the normal, there is
    no contact.

    Source: the min function in semismooth Newton methods, Hintermüller, Ito & Kunisch (2002).
    """

    def __init__(self, mechanics: Mechanics):
        """Find the surface particles of this rank that plates may touch."""
        self.mechanics = m = mechanics
        self.dimension = d = m.scene.dimension
        self._held = np.zeros((m.n_owned, d), bool)
        self._held[m.loads.held] = True
        self.at = m.loads.platable

    def gaps(self) -> np.ndarray:
        """Gaps between the surface particles and the plates (k, plates) [µm]."""
        m = self.mechanics
        normal, point, displacement = np.split(m.loads.boundary.plate, 3, axis=1)
        face = point + m.loads.factors(m.loads.boundary.plate_curve)[:, None] * displacement
        x = m.state.x(self.at)
        return np.einsum("kpc,pc->kp", x[:, None] - face, normal)

    def _nearest(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Gap (k,) [µm], normal (k, d) and number (k,) of the plate nearest to each surface particle."""
        gaps = self.gaps()
        p = np.argmin(gaps, axis=1)
        return gaps[np.arange(len(p)), p], self.mechanics.loads.boundary.plate[p, : self.dimension], p

    def _directions(self, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Row (k,) that the condition replaces, -1 without contact; vectors (k, d) whose product with -f is the
        pressure; matrices (k, d, d) of vectors along the plate, one for each other row.
        """
        free = np.where(self._held[self.at], 0.0, normal)
        square, row, k = (free**2).sum(axis=1), np.argmax(np.abs(free), axis=1), np.arange(len(free))
        largest = free[k, row]
        along = largest[:, None, None] * np.eye(self.dimension)
        along[k, :, row] -= free
        return np.where(square > 0.0, row, -1), free / np.where(square > 0.0, square, 1.0)[:, None], along

    def residual(self, r: np.ndarray, scale: float) -> np.ndarray:
        """The residual r (n_owned, d) [pN/µm] with the contact conditions; `scale` [Pa] is the stiffness in them."""
        if not len(self.at):
            return r
        gap, normal, _ = self._nearest()
        row, pressure, along = self._directions(normal)
        k = np.flatnonzero(row >= 0)
        i, old, r = self.at[k], r[self.at[k]], r.copy()
        r[i] = (along[k] @ old[:, :, None])[:, :, 0]
        r[i, row[k]] = np.minimum((pressure[k] * old).sum(axis=1), scale * gap[k])
        return r

    def rows(self, f: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
        """Factors and summands of the rows of the tangent -∂f/∂u of a particle, for the contact conditions.

        Parameters
        ----------
        f : (n_owned, d) float -- forces but those of plates [pN/µm].
        scale : float -- stiffness in the conditions [Pa].

        Returns
        -------
        (n_owned, d, d), (n_owned, d, d) float -- matrices that multiply the rows [-]; blocks to add [Pa].
        """
        n, d = self.mechanics.n_owned, self.dimension
        factor, diagonal = np.tile(np.eye(d), (n, 1, 1)), np.zeros((n, d, d))
        if len(self.at):
            gap, normal, _ = self._nearest()
            row, pressure, along = self._directions(normal)
            on = scale * gap <= (pressure * -f[self.at]).sum(axis=1)
            k = np.flatnonzero(row >= 0)
            i, r = self.at[k], row[k]
            factor[i] = along[k]
            factor[i, r] = np.where(on[k, None], 0.0, pressure[k])
            diagonal[i, r] = np.where(on[k, None], scale * normal[k], 0.0)
        return factor, diagonal

    def store(self, f: np.ndarray) -> None:
        """Store the forces of the plates in the kernel: they balance the other forces f (n_owned, d) [pN/µm]."""
        if len(self.at):
            kept = self.mechanics.loads.plate_force
            _, normal, p = self._nearest()
            pressure = (self._directions(normal)[1] * -f[self.at]).sum(axis=1)  # zero without contact
            kept[:] = 0.0
            kept[np.arange(len(p)), p] = np.maximum(pressure, 0.0)

    def force(self) -> np.ndarray:
        """Force of the plates on the owned particles (n_owned, d) [pN/µm]."""
        m, out = self.mechanics, np.zeros((self.mechanics.n_owned, self.dimension))
        if len(self.at):
            out[self.at] = m.loads.plate_force @ m.loads.boundary.plate[:, : self.dimension]
        return out
