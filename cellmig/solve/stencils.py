"""Tangents of surface forces, from the formulas of groups of particles that the kernel also uses."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ..case.pointwise import between
from ..kernel.terms import SURFACE_TERMS
from ..meshfree.contact import ContactLists
from ..model.director import Couple
from .mechanics import Mechanics
from .tangent import derivative, mixed


@dataclass(frozen=True)
class Stencil:
    """A term: many groups of k particles, and the formula of the forces on the particles of a group.

    name : of the term;  nodes : (k, n) int -- local numbers;  force : takes positions x [µm] and velocities v [µm/µs],
    k pairs of numbers each, and returns k pairs of forces [pN/µm].
    """

    name: str
    nodes: np.ndarray
    force: Callable[..., tuple]

    def tangent(self, m: Mechanics, by_u: float, by_v: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Local rows and columns (b,) int, and blocks (b, 2, 2) [Pa], of -(by_u ∂f/∂u + by_v ∂f/∂v)."""
        x, v = (a.transpose(0, 2, 1) for a in (m.state.x(self.nodes), m.state.memory[self.nodes, 2:]))
        blocks = -mixed(self.force, {"x": (x, by_u), "v": (v, by_v)}).transpose(0, 2, 4, 1, 3)
        k, n = self.nodes.shape
        rows = np.broadcast_to(self.nodes[:, None], (k, k, n))
        columns = np.broadcast_to(self.nodes[None], (k, k, n))
        return rows.ravel(), columns.ravel(), blocks.reshape(-1, 2, 2)


def stencils(m: Mechanics) -> Iterator[Stencil | Push]:
    """The surface terms of a scene, for its current search lists, clock and closest points."""
    k = m.kernel
    for term in SURFACE_TERMS:
        if (formula := term.formula(m.terms)) is None:
            continue
        if term.name in OWN_STENCILS:
            yield from OWN_STENCILS[term.name](m, formula)
        else:
            on = k["near"] if "gap1" in _arguments(formula) else np.arange(len(k["facet"]))
            yield _of_segments(term.name, formula, k["facet"][on].T, length=k["facet_size"][on])
    if m.terms.director_law is not None and m.terms.director_law.anchoring == "surface" and m.director is not None:
        anchor, torque = m.director.anchored()
        yield _of_segments("anchors", Couple(), anchor[:, [0, 2]].T, torque=torque)


def _arguments(formula: Any) -> list[str]:
    return list(inspect.signature(formula.force).parameters)


def _of_segments(name: str, formula: Any, ends: np.ndarray, **given: np.ndarray) -> Stencil:
    """A formula of segments or pairs of particles, whose arguments are found by name."""
    arguments = _arguments(formula)

    def force(x: tuple, v: tuple) -> tuple:
        motion = {"edge": (x[1][0] - x[0][0], x[1][1] - x[0][1]), "gap1": x[0][1], "gap2": x[1][1],
                  "speed1": v[0][0], "speed2": v[1][0]}
        return formula.force(**{a: given[a] if a in given else motion[a] for a in arguments})

    return Stencil(name, ends, force)


def _loads(m: Mechanics, formula: Any) -> Iterator[Stencil]:
    """Segments under pressure; other loads are constant."""
    ends, pressure = m.loads.pressures()
    if len(ends):
        yield _of_segments("pressure", formula, ends.T, pressure=pressure)


def _protrusion(m: Mechanics, formula: Any) -> Iterator[Push]:
    """A stencil for each protruding cell, as its push depends on its whole surface."""
    k = m.kernel
    for c in range(len(k["hold"])):
        on, grip = slice(*k["first_mover"][c : c + 2]), k["grip"][slice(*k["first_grip"][c : c + 2])]
        if not len(grip):
            continue
        nodes = k["mover"][on]
        order = np.argsort(nodes)
        ends = order[np.searchsorted(nodes, k["facet"][grip], sorter=order)]
        yield Push("protrusion", nodes[:, None], formula, k["mover_weight"][on], ends.T, k["facet_size"][grip],
                   k["push"][grip].T)


@dataclass(frozen=True)
class Push:
    """The push of a cell, whose derivatives go by the mean of its surface and by its closed bonds.

    name : of the term;  nodes : (k, 1) int -- local numbers;  formula : ProtrusionForce;  weight : (k,) float -- of the
    particles in the mean [-];  ends : (2, n) int -- of the segments near the substrate, among the nodes;
    length : (n,) float -- of these [µm];  push : (2, n) float -- on their ends [pN/µm].
    """

    name: str
    nodes: np.ndarray
    formula: Any
    weight: np.ndarray
    ends: np.ndarray
    length: np.ndarray
    push: np.ndarray

    def force(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Forces (k, 2, 1) [pN/µm] at places x [µm] and velocities v [µm/µs] of that shape."""
        middle, gaps = self._places(*x[..., 0].T)
        bonded, out = self._closed(middle[self.ends].mean(axis=0), *gaps).sum(), np.zeros_like(x)
        for end, along in zip(self.ends, self._along(bonded, *middle[self.ends], *gaps), strict=True):
            np.add.at(out[:, 0, 0], end, along)
        return out

    def tangent(self, m: Mechanics, by_u: float, by_v: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Local rows and columns (b,) int, and blocks (b, 2, 2) [Pa], of -by_u ∂f/∂u; velocities do not matter."""
        ahead, gaps = self._places(*m.state.x(self.nodes[:, 0]).T)
        k, (i, j), unit = len(ahead), self.ends, np.eye(len(ahead))
        by_x = unit - self.weight  # of `ahead`, by x of all
        closed, slope = derivative(self._closed, ahead[self.ends].mean(axis=0), *gaps)
        by_all = 0.5 * slope[0] @ (by_x[i] + by_x[j]), slope[1] @ unit[i] + slope[2] @ unit[j]
        slopes = derivative(self._along, np.full(len(closed), closed.sum()), *ahead[self.ends], *gaps)[1]
        blocks = np.zeros((k, k, 2, 2))
        for end, (bonded, ahead1, ahead2, gap1, gap2) in zip(self.ends, slopes[..., None], strict=True):
            np.subtract.at(blocks[:, :, 0, 0], end, by_u * (bonded * by_all[0] + ahead1 * by_x[i] + ahead2 * by_x[j]))
            np.subtract.at(blocks[:, :, 0, 1], end, by_u * (bonded * by_all[1] + gap1 * unit[i] + gap2 * unit[j]))
        return np.repeat(self.nodes[:, 0], k), np.tile(self.nodes[:, 0], k), blocks.reshape(-1, 2, 2)

    def _places(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of the nodes what they are ahead of the mean (k,), of the ends the gaps (2, n) [µm]."""
        return x - self.weight @ x, y[self.ends]

    def _closed(self, ahead: Any, gap1: Any, gap2: Any) -> Any:
        return self.formula.grip(self.length, ahead, gap1, gap2)

    def _along(self, bonded: Any, *places: Any) -> tuple:
        ends = self.formula.force(self.push, self.formula.hold(bonded), self.length, places[:2], places[2:])
        return tuple(along for along, _ in ends)


def _contact(m: Mechanics, formulas: tuple) -> Iterator[Stencil]:
    """Pieces of segments beside edges and vertices; their limits are constants, whose derivatives cancel."""
    k, lists = m.kernel, m.segments.lists
    if not isinstance(lists, ContactLists) or not len(lists.edge):
        return
    source = np.repeat(np.arange(len(lists.segment)), np.diff(lists.first))
    everything = k["contact_node"][np.column_stack([lists.segment[source], lists.edge])]
    for number, formula in enumerate(formulas):
        of = k["contact_law"][source] == number
        nodes, length = everything[of].T, k["contact_length"][source[of]]
        x = m.state.x(nodes).transpose(0, 2, 1)
        low, high, first, last, sign = formula.pieces(tuple(x), k["contact_cutoff"][source[of]])
        on = np.flatnonzero(low < high)
        yield Stencil("contact", nodes[:4, on], partial(_beside_edge, formula, (length[on], low[on], high[on])))
        on = np.flatnonzero(first < last)
        piece, start, end = _short(formula, first[on], last[on], *formula.foot(*x[[0, 1, 3]][..., on]))
        on = on[piece]
        limits = sign[on] * length[on], start, end
        yield Stencil("contact", nodes[[0, 1, 3]][:, on], partial(_beside_vertex, formula, limits))


def _beside_edge(formula: Any, piece: tuple, x: tuple, v: tuple) -> tuple:
    """Forces on both ends of segments and of edges at x [µm], four pairs of numbers."""
    along, across = zip(*(formula.beside(end, *x[2:]) for end in x[:2]), strict=True)
    return formula.edge(*piece, along, across, *x[2:])[0]


def _beside_vertex(formula: Any, piece: tuple, x: tuple, v: tuple) -> tuple:
    """Forces on both ends of segments and on vertices at x [µm], three pairs of numbers."""
    return formula.vertex(*piece, between(x[2], x[0]), between(x[2], x[1]))[0]


def _short(formula: Any, first: np.ndarray, last: np.ndarray, foot: np.ndarray, away: np.ndarray) -> list[np.ndarray]:
    """Pieces beside vertices (k,) in short parts, as the kernel divides them: their numbers and limits (m,) [-]."""
    on, start = np.arange(len(first)), first
    parts = [(on[:0], start[:0], start[:0])]
    while len(on):
        end = formula.short(start, foot[on], away[on])
        end = np.where((end < last[on]) & (end > start), end, last[on])
        parts.append((on, start, end))
        left = end < last[on]
        on, start = on[left], end[left]
    return [np.concatenate(part) for part in zip(*parts, strict=True)]


# Others have stencils of segments.
OWN_STENCILS: dict[str, Callable[..., Iterator[Stencil | Push]]] = {"contact": _contact, "protrusion": _protrusion,
                                                                   "loads": _loads}
