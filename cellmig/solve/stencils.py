"""Tangents of surface forces, from the formulas of groups of particles that the kernel also uses."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ..case.pointwise import between
from ..kernel.terms import SURFACE_TERMS
from ..meshfree.contact import ContactLists
from ..meshfree.contact_space import TriangleLists
from ..model.ligand import LigandTable
from ..model.protocols import Friction
from .contact_tangent import ContactDifferences
from .mechanics import Mechanics
from .push_tangent import Pushes, PushesOff, pushes, pushes_off
from .tangent import mixed

FRICTION = ("friction", "sliding")  # terms
DRAGS = (*FRICTION, "medium")  # those that depend on velocities
LEAST_SPEED = 1e-16  # of which the ratio is taken [µm/µs]: a law may cancel below

@dataclass(frozen=True)
class Stencil:
    """A term: many groups of k particles, and the formula of the forces on the particles of a group.

    name : of the term;  nodes : (k, n) int -- local numbers;  force : takes positions x [µm] and velocities v [µm/µs],
    k vectors each, and returns k vectors of forces [pN/µm].
    """

    name: str
    nodes: np.ndarray
    force: Callable[..., tuple]

    def tangent(self, m: Mechanics, by_u: float, by_v: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Local rows and columns (b,) int, and blocks (b, d, d) [Pa], of -(by_u ∂f/∂u + by_v ∂f/∂v)."""
        d = m.state.dimension
        x, v = (a.transpose(0, 2, 1) for a in (m.state.x(self.nodes), m.state.memory[self.nodes, d:]))
        blocks = -mixed(self.force, {"x": (x, by_u), "v": (v, by_v)}).transpose(0, 2, 4, 1, 3)
        k, n = self.nodes.shape
        rows = np.broadcast_to(self.nodes[:, None], (k, k, n))
        columns = np.broadcast_to(self.nodes[None], (k, k, n))
        return rows.ravel(), columns.ravel(), blocks.reshape(-1, d, d)


@dataclass(frozen=True)
class Secant:
    """A law of friction by its ratio to the speed: derivatives do not go by its slope, which may fall, nor by bonds.

    Source: the secant of Kačanov's method, Han, Jensen & Shimansky (1997), Appl. Numer. Math. 24, 57.
    """

    law: Friction

    @property
    def coefficient(self) -> float:
        """Drag at low speed, which is the largest [Pa µs/µm]."""
        return self.law.coefficient

    def drag(self, share: Any, speed: Any) -> Any:
        """Traction [Pa] for the `share` of closed bonds [-] and the `speed` [µm/µs], as of the law."""
        bonded, at = (getattr(a, "value", a) for a in (share, speed))
        moves = np.abs(at) > LEAST_SPEED
        moving = np.where(moves, at, LEAST_SPEED)
        return np.where(moves, self.law.drag(bonded, moving) / moving, self.coefficient * bonded) * speed


def stencils(m: Mechanics, secant: bool = False) -> Iterator[Stencil | Pushes | PushesOff | ContactDifferences]:
    """The surface terms of a scene, for its current search lists, clock and closest points.

    secant : whether tangents have the `Secant` of friction.
    """
    k = m.kernel
    for term in SURFACE_TERMS:
        if (formula := term.formula(m.terms)) is None:
            continue
        if term.name in OWN_STENCILS:
            if secant and term.name in FRICTION:
                formula = tuple(replace(one, law=Secant(one.law)) for one in formula)
            yield from OWN_STENCILS[term.name](m, formula)
        else:
            on = k["near"] if "gap1" in _arguments(formula) else k["taut"]
            yield _of_facets(term.name, formula, k["facet"][on].T, k["facet_size"][on])


def _arguments(formula: Any) -> list[str]:
    return list(inspect.signature(formula.force).parameters)


def _of_facets(name: str, formula: Any, corners: np.ndarray, size: Any = None, **given: np.ndarray) -> Stencil:
    """A formula of facets or pairs of particles, whose arguments are found by name; `size` : at rest [µm, µm²]."""
    arguments, given = _arguments(formula), given | {"length": size, "area": size}

    def force(x: tuple, v: tuple) -> tuple:
        motion = {"edge": between(x[0], x[1])}
        for i, (at, speed) in enumerate(zip(x, v, strict=True)):
            motion |= {f"edge{i}": between(x[0], at), f"gap{i + 1}": at[-1], f"speed{i + 1}": speed[0],
                       f"velocity{i + 1}": speed[:-1]}
        return formula.force(**{a: given[a] if a in given else motion[a] for a in arguments})

    return Stencil(name, corners, force)


def _substrate(m: Mechanics, formula: Any) -> Iterator[Stencil]:
    """Facets near the substrate; where ligands vary, an energy pulls them along it, too."""
    k = m.kernel
    on = k["near"]
    corners, size = k["facet"][on].T, k["facet_size"][on]
    bonds = _of_facets("substrate", formula, corners, size)
    if m.ligand is None:
        yield bonds
        return
    table = m.ligand.table

    def force(x: tuple, v: tuple) -> tuple:
        share, slopes = table.at(*_middle(x))
        energy = formula.energy(size, *(at[-1] for at in x))
        along = [-slope * energy / len(x) for slope in slopes]
        return tuple((*along, share * normal) for *_, normal in bonds.force(x, v))

    yield Stencil("substrate", corners, force)


def _middle(x: tuple) -> list:
    """Places along the substrate of the middles of facets, whose corners are at x, k vectors [µm]."""
    return [sum(at[axis] for at in x) / len(x) for axis in range(len(x[0]) - 1)]


def _loads(m: Mechanics, formula: Any) -> Iterator[Stencil]:
    """Facets under pressure; other loads are constant."""
    corners, pressure = m.loads.pressures()
    if len(corners):
        yield _of_facets("pressure", formula, corners.T, pressure=pressure)


def _friction(m: Mechanics, formulas: tuple) -> Iterator[Stencil]:
    """Facets near the substrate, by the laws of their cells."""
    k = m.kernel
    for number, formula in enumerate(formulas):
        on = k["near"][k["facet_friction"][k["near"]] == number]
        if len(on):
            drag = _of_facets("friction", formula, k["facet"][on].T, k["facet_size"][on])
            yield drag if m.ligand is None else Stencil("friction", drag.nodes, partial(_on_ligands, m.ligand.table,
                                                                                        drag))


def _on_ligands(table: LigandTable, of_all: Stencil, x: tuple, v: tuple) -> tuple:
    """Forces in proportion to the ligands below facets, of which all would exert those `of_all`."""
    share, _ = table.at(*_middle(x))
    return tuple(tuple(share * f for f in force) for force in of_all.force(x, v))


def _medium(m: Mechanics, formula: Any) -> Iterator[Stencil]:
    """Surface particles one by one."""
    nodes, size = m.kernel["immersed"], m.kernel["immersed_size"]
    if len(nodes):
        yield Stencil("medium", nodes[None], lambda x, v: (formula.force(size, v[0]),))


def _contact(m: Mechanics, formulas: tuple) -> Iterator[Stencil | ContactDifferences]:
    """Pieces of segments beside edges and vertices; their limits are constants, whose derivatives cancel."""
    k, lists = m.kernel, m.segments.lists
    if isinstance(lists, TriangleLists) and len(lists.source):
        yield ContactDifferences("contact", k["contact_node"])
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


def _sliding(m: Mechanics, formulas: tuple) -> Iterator[Stencil | ContactDifferences]:
    """Pieces of segments beside edges, by the laws of both bodies; the limits of pieces move with their ends."""
    k, lists = m.kernel, m.segments.lists
    if isinstance(lists, TriangleLists) and len(lists.source):
        yield ContactDifferences("sliding", k["contact_node"], any(isinstance(one.law, Secant) for one in formulas))
    if not isinstance(lists, ContactLists) or not len(lists.edge):
        return
    source = np.repeat(np.arange(len(lists.segment)), np.diff(lists.first))
    everything = k["contact_node"][np.column_stack([lists.segment[source], lists.edge[:, :2]])]
    for number, formula in enumerate(formulas):
        of = np.flatnonzero(k["contact_law"][source] == number)
        within = k["contact_cutoff"][source[of]]
        if not len(of) or not formula.law.coefficient:
            continue
        low, high = formula.piece(*m.state.x(everything[of].T).transpose(0, 2, 1), within)
        on = np.flatnonzero(low < high)
        about = k["contact_length"][source[of[on]]], within[on]
        yield Stencil("sliding", everything[of[on]].T, partial(_drag_beside_edge, formula, about))


def _drag_beside_edge(formula: Any, about: tuple, x: tuple, v: tuple) -> tuple:
    """Forces on both ends of segments and of edges at x [µm] and v [µm/µs], four pairs of numbers."""
    length, within = about
    return formula.force(length, *formula.piece(*x, within), *x, *v)[0]


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


# Others have stencils of facets.
OWN_STENCILS: dict[str, Callable[..., Iterator]] = {
    "substrate": _substrate, "contact": _contact, "sliding": _sliding, "friction": _friction, "medium": _medium,
    "protrusion": pushes, "push_off": pushes_off, "loads": _loads}
