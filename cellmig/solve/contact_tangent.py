"""The tangent of contact between cells in space, by differences of forces, pair by pair of a triangle and a feature."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .mechanics import Mechanics
from .tangent import derivative

STEP = 3e-4  # of the least equilibrium distance of the bonds, on either side: the error is the square of its share [-]


@dataclass(frozen=True)
class ContactDifferences:
    """Derivatives of the forces between cells, by differences.

    The force of a pair depends on the particles of a triangle and of a face, an edge or a vertex near it alone, which
    are moved one by one, so that the cost is that of about fifty evaluations, whatever the number of contacts.

    name : of the term;  nodes : (k,) int -- local numbers of the particles near another cell;
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
        m.surface_force(self.name)  # which pairs act
        for name, values in zip(EXTREMES, extremes, strict=True):
            kernel[name][:] = values
        given = STEP * contacts.thinnest, float(by_u), float(by_v), int(self.secant)
        n = kernel(f"{self.name}_blocks", *given, None, None, None)
        rows, columns = np.zeros((2, n), np.int64)
        blocks = np.zeros((n, d, d))
        kernel(f"{self.name}_blocks", *given, rows, columns, blocks)
        return rows, columns, blocks


@dataclass(frozen=True)
class PushOffDifferences(ContactDifferences):
    """The same of pushes off other bodies, which depend on the whole surface of a cell, too: by its middle, and by the
    bonds that hold it.

    formula : SurfacePush;  vectors : (c, sides, d - 1) float -- pushes of the cells [-].
    """

    formula: Any = None
    vectors: np.ndarray | None = None

    def tangent(self, m: Mechanics, by_u: float, by_v: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Local rows and columns (b,) int, and blocks (b, d, d) [pN/µm], of -by_u ∂f/∂u; velocities do not matter."""
        assert self.vectors is not None
        parts = [super().tangent(m, by_u, by_v)]
        for c, side in np.ndindex(self.vectors.shape[:2]):
            if self.vectors[c, side].any():
                parts.append(self._of_cell(m, c, side, by_u))
        rows, columns, blocks = (np.concatenate(part) for part in zip(*parts, strict=True))
        return rows, columns, blocks

    def _of_cell(self, m: Mechanics, c: int, side: int, by_u: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The part by the middle and by the bonds of cell c, of its push in one direction."""
        assert self.vectors is not None and m.terms.contacts is not None
        kernel, n = m.kernel, len(self.nodes)
        by_middle, by_hold, of_bonds = np.zeros((3, n, 3))
        total = np.zeros(2)
        drive = c * self.vectors.shape[1] + side
        kernel("push_off_of_cell", STEP * m.terms.contacts.thinnest, drive, by_middle, by_hold, of_bonds, total)
        on = slice(*kernel["first_mover"][c : c + 2])
        way = np.append(self.vectors[c, side] / np.linalg.norm(self.vectors[c, side]), 0.0)
        of_middle = np.outer(kernel["mover_weight"][on], way)
        columns = np.concatenate([self.nodes, kernel["mover"][on]])
        _, slope = derivative(self.formula.hold, total[1:])
        of_hold = float(slope.squeeze()) * np.concatenate([of_bonds, total[0] * of_middle])
        of_middle = np.concatenate([np.zeros((n, 3)), of_middle])
        at = np.flatnonzero((by_middle != 0.0).any(axis=1) | (by_hold != 0.0).any(axis=1))
        blocks = (by_middle[at, None, :, None] * of_middle[None, :, None]
                  + by_hold[at, None, :, None] * of_hold[None, :, None])
        return (np.repeat(self.nodes[at], len(columns)), np.tile(columns, len(at)), -by_u * blocks.reshape(-1, 3, 3))


EXTREMES = ("stiffest_contact", "deepest_contact")
