"""The tangent of contact between cells in space, by differences of forces, pair by pair of a triangle and a feature."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .mechanics import Mechanics

STEP = 3e-4  # of the least equilibrium distance of the bonds, on either side: the error is the square of its share [-]


@dataclass(frozen=True)
class ContactDifferences:
    """Derivatives of the forces between cells, by differences.

    The force of a pair depends on the particles of a triangle and of a face, an edge or a vertex near it alone, which
    are moved one by one, so that the cost is that of about fifty evaluations, whatever the number of contacts.

    name : of the term, "contact" or "sliding";  nodes : (k,) int -- local numbers of the particles near another cell;
    secant : whether the ratio of a drag to the speed is a constant.

    Source: derived here.  Particles that only limit the pieces are moved too: what one feature loses, another gains.
    """

    name: str
    nodes: np.ndarray
    secant: bool = False

    def tangent(self, m: Mechanics, by_u: float, by_v: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Local rows and columns (b,) int, and blocks (b, d, d) [pN/µm], of -(by_u ∂f/∂u + by_v ∂f/∂v)."""
        kernel, d = m.kernel, m.state.dimension
        contacts = m.terms.contacts
        assert contacts is not None
        extremes = [kernel[name].copy() for name in EXTREMES]
        m.surface_force("contact")  # which pairs act
        for name, values in zip(EXTREMES, extremes, strict=True):
            kernel[name][:] = values
        given = STEP * contacts.thinnest, float(by_u), float(by_v), int(self.secant)
        n = kernel(f"{self.name}_blocks", *given, None, None, None)
        rows, columns = np.zeros((2, n), np.int64)
        blocks = np.zeros((n, d, d))
        kernel(f"{self.name}_blocks", *given, rows, columns, blocks)
        return rows, columns, blocks


EXTREMES = ("stiffest_contact", "deepest_contact")
