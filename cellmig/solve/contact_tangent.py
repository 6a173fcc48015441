"""The tangent of contact between cells in space, by differences of the kernel's forces, many particles at a time."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count

import numpy as np
from scipy import sparse

from .mechanics import Mechanics

STEP = 3e-4  # of the least equilibrium distance of the bonds, on either side: the error is the square of its share [-]


@dataclass(frozen=True)
class ContactDifferences:
    """Derivatives of the forces between cells by differences.

    Particles that act on no particle in common are moved together, so that the number of evaluations does not grow
    with that of the contacts.

    name : of the term;  nodes : (k,) int -- local numbers of the particles near another cell.

    Source: Curtis, Powell & Reid (1974), colours by the first that is free.
    """

    name: str
    nodes: np.ndarray

    def tangent(self, m: Mechanics, by_u: float, by_v: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Local rows and columns (b,) int, and blocks (b, d, d) [pN/µm], of -by_u ∂f/∂u; velocities do not matter."""
        kernel, d = m.kernel, m.state.dimension
        contacts = m.terms.contacts
        assert contacts is not None
        h = STEP * min(law.equilibrium_distance for law in contacts.laws)
        m.surface_force("contact")  # what may act, here and near here
        pattern = _pattern(m, 1e3 * h)
        colour, place, blocks = _colours(pattern), pattern.tocoo(), np.zeros((pattern.nnz, d, d))
        stiffest = kernel["stiffest_contact"].copy()
        for group in range(colour.max() + 1):
            moved = np.flatnonzero(colour == group)
            on = np.flatnonzero(colour[place.col] == group)
            for c in range(d):
                change = self._force(m, moved, c, h) - self._force(m, moved, c, -h)
                blocks[on, :, c] = -by_u / (2.0 * h) * change[place.row[on]]
        kernel["stiffest_contact"][:] = stiffest
        return place.row, place.col, blocks

    def _force(self, m: Mechanics, moved: np.ndarray, component: int, step: float) -> np.ndarray:
        """Forces on the owned particles (n_owned, d) [pN] with a `component` of some changed by a step [µm]."""
        before = m.state.memory[moved, component]
        m.state.memory[moved, component] = before + step
        force = m.surface_force("contact")[0]
        m.state.memory[moved, component] = before
        return force


def _pattern(m: Mechanics, soon: float) -> sparse.csr_matrix:
    """Which owned particles (rows) feel the move of which ones (columns): all of a triangle and what acts on it.

    soon : float -- how far particles may go until then [µm].
    """
    k, n = m.kernel, len(m.kernel["contact_segment"])
    parts = []
    for name, corners in (("face", k["contact_face"]), ("side", k["contact_side"]),
                          ("vertex", k["contact_vertex"][:, None])):
        acts = k[f"{name}_rest"][: k[f"first_{name}"][-1]] <= k["contact_gone"][0] + soon
        near = corners[k[f"near_{name}"][: len(acts)][acts]]
        source = np.repeat(np.arange(n), np.diff(k[f"first_{name}"]))[acts]
        parts += [(near.ravel(), np.repeat(source, near.shape[1])),
                  (k["contact_segment"][source].ravel(), np.repeat(source, 3))]
    node, source = (np.concatenate(a) for a in zip(*parts, strict=True))
    around = sparse.csr_matrix((np.ones(len(node), np.int32), (k["contact_node"][node], source)), (m.part.capacity, n))
    return (around[: m.n_owned] @ around.T).tocsr()


def _colours(pattern: sparse.csr_matrix) -> np.ndarray:
    """Numbers of columns (n,) int of which no two with the same number have a row in common; -1 for empty ones."""
    conflict = (pattern.T @ pattern).tocsr()
    colour = np.full(pattern.shape[1], -1)
    for j in np.flatnonzero(np.diff(conflict.indptr)).tolist():
        taken = set(colour[conflict.indices[conflict.indptr[j] : conflict.indptr[j + 1]]].tolist())
        colour[j] = next(number for number in count() if number not in taken)
    return colour
