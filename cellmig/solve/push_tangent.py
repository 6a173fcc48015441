"""Tangents of pushes, which depend on the whole surface of a cell: by its middle, and by the bonds that hold it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy import sparse

from ..meshfree.contact import ContactLists
from ..meshfree.contact_space import TriangleLists
from .contact_tangent import PushOffDifferences
from .mechanics import Mechanics
from .tangent import derivative


def pushes(m: Mechanics, formula: Any) -> Iterator[Pushes]:
    """Pushes off the substrate of all cells, in each of their directions."""
    assert m.protrusion is not None
    k, vectors, found = m.kernel, m.protrusion.now(), []
    for c, side in np.ndindex(k["hold"].shape):
        on, grip = slice(*k["first_mover"][c : c + 2]), k["grip"][slice(*k["first_grip"][c : c + 2])]
        strength = np.linalg.norm(vectors[c, side])
        if not len(grip) or not strength:
            continue
        nodes = k["mover"][on]
        order = np.argsort(nodes)
        ends = order[np.searchsorted(nodes, k["facet"][grip], sorter=order)]
        found.append(Push(nodes, formula, k["mover_weight"][on], ends.T, k["facet_size"][grip],
                          strength * k["push"][grip].T, vectors[c, side] / strength))
    if found:
        yield Pushes("protrusion", tuple(found))


def pushes_off(m: Mechanics, formulas: tuple) -> Iterator[PushesOff | PushOffDifferences]:
    """Pushes off other bodies of all cells, in each of their directions."""
    k, lists = m.kernel, m.segments.lists
    if m.protrusion is not None and isinstance(lists, TriangleLists) and len(lists.source):
        yield PushOffDifferences("push_off", k["contact_node"], formula=formulas[0], vectors=m.protrusion.now())
    if m.protrusion is None or not isinstance(lists, ContactLists) or not len(lists.edge):
        return
    vectors = m.protrusion.now()[..., 0]
    source = np.repeat(np.arange(len(lists.segment)), np.diff(lists.first))
    nodes = k["contact_node"][np.column_stack([lists.segment[source], lists.edge[:, :2]])]
    mover, law, length, within = (k[name][source] for name in ("contact_mover", "contact_law", "contact_length",
                                                               "contact_cutoff"))
    for c, side in np.ndindex(vectors.shape):
        of = np.flatnonzero(mover == c)
        if not len(of) or not vectors[c, side]:
            continue
        low, high = formulas[0].piece(*m.state.x(nodes[of].T).transpose(0, 2, 1), within[of])
        of = of[low < high]
        if len(of):
            on = slice(*k["first_mover"][c : c + 2])
            every = np.union1d(nodes[of], k["mover"][on])
            weight = np.zeros(len(every))
            weight[np.searchsorted(every, k["mover"][on])] = k["mover_weight"][on]
            yield PushesOff("push_off", every[:, None], formulas, law[of], length[of], within[of],
                            k["contact_push"][source[of]].T, np.searchsorted(every, nodes[of].T), weight,
                            float(vectors[c, side]))


@dataclass(frozen=True)
class Push:
    """The push of a cell in a direction, whose derivatives go by the mean of its surface and by its closed bonds.

    nodes : (k,) int -- local numbers;  formula : ProtrusionForce or ProtrusionPush;
    weight : (k,) float -- of the particles in the mean [-];  ends : (d, n) int -- corners of the facets near the
    substrate, among the nodes;  size : (n,) float -- of these [µm, µm²];  push : (d, n) float -- on their corners
    [pN/µm];  direction : (d - 1,) float -- along the substrate [-].
    """

    nodes: np.ndarray
    formula: Any
    weight: np.ndarray
    ends: np.ndarray
    size: np.ndarray
    push: np.ndarray
    direction: np.ndarray

    def places(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of the ends of facets (d, n), for nodes at x (k, d) [µm], what they are ahead of the mean, and gaps [µm]."""
        place = x[:, :-1] @ self.direction
        return (place - self.weight @ place)[self.ends], x[self.ends, -1]

    def force(self, x: np.ndarray) -> np.ndarray:
        """Forces (k, d) [pN/µm] on nodes at x (k, d) [µm]."""
        ahead, gaps = self.places(x)
        bonded, out = self.formula.grip(self.size, ahead.mean(axis=0), *gaps).sum(), np.zeros_like(x)
        forces = _along(self.formula, self.push, self.size, bonded, *ahead, *gaps)
        for end, along in zip(self.ends, forces, strict=True):
            np.add.at(out[:, :-1], end, along[:, None] * self.direction)
        return out

    def blocks(self, by_u: float, of_bonds: np.ndarray,
               of_forces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Local rows and columns (b,) int, and blocks (b, d, d) [Pa], of -by_u ∂f/∂u.

        of_bonds : (1 + d, n) -- derivatives of closed bonds by places ahead and gaps [-];
        of_forces : (d, 1 + 2 d, n) -- of forces by all bonds and by these [Pa].
        """
        d, k, unit = len(self.ends), len(self.nodes), np.eye(len(self.nodes))
        by_x = unit - self.weight  # of `ahead`, by x of all
        by_all = (of_bonds[0] @ by_x[self.ends].mean(axis=0),
                  sum(by_gap @ unit[end] for by_gap, end in zip(of_bonds[1:], self.ends, strict=True)))
        row, at = np.unique(self.ends, return_inverse=True)
        of_x, of_gap = sums = np.zeros((2, len(row), k))
        for on, (bonded, *by) in zip(at.reshape(self.ends.shape), of_forces[..., None], strict=True):
            onto = sparse.csr_matrix((np.ones(len(on)), (on, np.arange(len(on)))), (len(row), len(on)))
            for out, mean, part, place in zip(sums, by_all, (by[:d], by[d:]), (by_x, unit), strict=True):
                near = sum(slope * place[end] for slope, end in zip(part, self.ends, strict=True))
                out += onto @ (bonded * mean + near)
        blocks = np.zeros((len(row), k, d, d))
        blocks[..., :-1, :-1] = -by_u * of_x[..., None, None] * (self.direction[:, None] * self.direction)
        blocks[..., :-1, -1] = -by_u * of_gap[..., None] * self.direction
        return np.repeat(self.nodes[row], k), np.tile(self.nodes, len(row)), blocks.reshape(-1, d, d)


@dataclass(frozen=True)
class Pushes:
    """All pushes off the substrate: most have few facets, so that their derivatives are found together.

    name : of the term;  each : of a cell in a direction.
    """

    name: str
    each: tuple[Push, ...]

    @property
    def nodes(self) -> np.ndarray:
        """Local numbers (sum of k, 1) int, of one push after the other."""
        return np.concatenate([push.nodes for push in self.each])[:, None]

    def force(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Forces (sum of k, d, 1) [pN/µm] at places x [µm] and velocities v [µm/µs] of that shape."""
        first = np.cumsum([len(push.nodes) for push in self.each])[:-1]
        parts = np.split(x[..., 0], first)
        return np.concatenate([push.force(part) for push, part in zip(self.each, parts, strict=True)])[..., None]

    def tangent(self, m: Mechanics, by_u: float, by_v: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Local rows and columns (b,) int, and blocks (b, d, d) [Pa], of -by_u ∂f/∂u; velocities do not matter."""
        formula, sizes = self.each[0].formula, [len(push.size) for push in self.each]
        number = np.repeat(np.arange(len(sizes)), sizes)
        size = np.concatenate([push.size for push in self.each])
        force = np.concatenate([push.push for push in self.each], axis=1)
        places = [push.places(m.state.x(push.nodes)) for push in self.each]
        ahead, gaps = (np.concatenate(parts, axis=-1) for parts in zip(*places, strict=True))
        closed, of_bonds = derivative(partial(formula.grip, size), ahead.mean(axis=0), *gaps)
        bonded = np.bincount(number, closed)[number]
        of_forces = derivative(partial(_along, formula, force, size), bonded, *ahead, *gaps)[1]
        rows, columns, blocks = zip(*(push.blocks(by_u, of_bonds[:, number == i], of_forces[..., number == i])
                                      for i, push in enumerate(self.each)), strict=True)
        return np.concatenate(rows), np.concatenate(columns), np.concatenate(blocks)


def _along(formula: Any, push: np.ndarray, size: np.ndarray, bonded: Any, *places: Any) -> tuple:
    """Forces along a push on the corners of facets [pN/µm], for the `bonded` size of all of the cell [µm, µm²]."""
    d = len(push)
    ends = formula.force(push, formula.hold(bonded), size, places[:d], places[d:])
    return tuple(along for along, *_ in ends)


@dataclass(frozen=True)
class PushesOff:
    """The push of a cell off other bodies in a direction, of all pieces of its segments beside their edges.

    name : of the term;  nodes : (k, 1) int -- local numbers;  formulas : PushOff of each law of contact;
    law : (n,) int -- numbers of their laws;  length, within : (n,) float -- of the segments at rest, and up to which
    distance they act [µm];  push : (2, n) float -- on the ends of segments [pN/µm];  ends : (4, n) int -- both ends of
    segments and of edges, among the nodes;  weight : (k,) float -- of the nodes in the middle of the cell [-];
    way : float -- the factor of the push along x [-].
    """

    name: str
    nodes: np.ndarray
    formulas: tuple
    law: np.ndarray
    length: np.ndarray
    within: np.ndarray
    push: np.ndarray
    ends: np.ndarray
    weight: np.ndarray
    way: float

    def force(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Forces (k, 2, 1) [pN/µm] at places x [µm] and velocities v [µm/µs] of that shape."""
        at, middle = x[self.ends, :, 0].transpose(0, 2, 1), np.full(len(self.law), self.weight @ x[:, 0, 0])
        bonded = self._each(self._grip, at, middle)[0].sum()
        out = np.zeros_like(x)
        forces = self._each(self._force, at, middle, np.full_like(middle, self.formulas[0].hold(bonded)))[0]
        np.add.at(out[..., 0], self.ends, forces.transpose(0, 2, 1))
        return out

    def tangent(self, m: Mechanics, by_u: float, by_v: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Local rows and columns (b,) int, and blocks (b, 2, 2) [Pa], of -by_u ∂f/∂u; velocities do not matter."""
        places = m.state.x(self.nodes[:, 0])
        x, middle = places[self.ends].transpose(0, 2, 1), np.full(len(self.law), self.weight @ places[:, 0])
        grip, of_grip = self._each(self._grip, x, middle)
        hold, by_bonds = (float(a.squeeze()) for a in derivative(self.formulas[0].hold, np.array([grip.sum()])))
        slope = self._each(self._force, x, middle, np.full_like(middle, hold))[1]  # (4, 2, 10, n)
        row, on = np.unique(self.ends, return_inverse=True)
        on, k = on.reshape(self.ends.shape), len(self.nodes)
        blocks, by_all, bonds = np.zeros((len(row), k, 2, 2)), np.zeros((len(row), 2, 2)), np.zeros((k, 2))
        np.add.at(bonds, self.ends, of_grip[:8].reshape(4, 2, -1).transpose(0, 2, 1))
        bonds[:, 0] += of_grip[8].sum() * self.weight
        np.add.at(by_all, on, slope[:, :, 8:].transpose(0, 3, 1, 2))
        for i, j in np.ndindex(4, 4):
            np.add.at(blocks, (on[i], self.ends[j]), slope[i, :, 2 * j : 2 * j + 2].transpose(2, 0, 1))
        blocks[..., 0] += by_all[:, None, :, 0] * self.weight[:, None]
        blocks += by_bonds * by_all[:, None, :, 1, None] * bonds[:, None]
        node = self.nodes[:, 0]
        return np.repeat(node[row], k), np.tile(node, len(row)), -by_u * blocks.reshape(-1, 2, 2)

    def _each(self, formula: Any, *at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (…, n) of `_grip` or `_force` for all pieces, and their derivatives (…, n) by all entries of `at`."""
        parts = []
        for number in np.unique(self.law):
            on = np.flatnonzero(self.law == number)
            parts.append((on, *derivative(partial(formula, on), *(a[..., on] for a in at))))
        order = np.argsort(np.concatenate([on for on, *_ in parts]))
        value, slope = (np.concatenate(a, axis=-1)[..., order] for a in list(zip(*parts, strict=True))[1:])
        return value, slope

    def _piece(self, on: np.ndarray, x: tuple, middle: Any) -> tuple:
        """The formula of the pieces `on` (k,) int of one law, with their lengths, limits and what they are ahead."""
        formula, forward = self.formulas[self.law[on[0]]], np.sign(self.way)
        ahead = tuple(forward * (end[0] - middle) for end in x[:2])
        return formula, (self.length[on], *formula.piece(*x, self.within[on]), ahead, *x)

    def _grip(self, on: np.ndarray, x: tuple, middle: Any) -> Any:
        formula, given = self._piece(on, x, middle)
        return formula.grip(*given)

    def _force(self, on: np.ndarray, x: tuple, middle: Any, hold: Any) -> tuple:
        formula, given = self._piece(on, x, middle)
        return formula.force(tuple(self.push[:, on]), hold, self.way, *given)
