"""Tangents of surface forces, from the formulas of groups of particles that the kernel also uses."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..kernel.terms import SURFACE_TERMS
from ..model.director import Couple
from .mechanics import Mechanics
from .tangent import mixed


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


def stencils(m: Mechanics) -> Iterator[Stencil]:
    """The surface terms of a scene, for its current search lists, clock and closest points."""
    k = m.kernel
    for term in SURFACE_TERMS:
        if (formula := term.formula(m.terms)) is None:
            continue
        if term.name in OWN_STENCILS:
            yield from OWN_STENCILS[term.name](m, formula)
        else:
            on = k["near"] if "gap1" in _arguments(formula) else np.arange(len(k["segment"]))
            yield _of_segments(term.name, formula, k["segment"][on].T, length=k["length"][on])
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


def _protrusion(m: Mechanics, formula: Any) -> Iterator[Stencil]:
    """A stencil for each protruding cell, as its push depends on its whole surface."""
    k = m.kernel
    for c in range(len(k["hold"])):
        on, grip = slice(*k["first_mover"][c : c + 2]), k["grip"][slice(*k["first_grip"][c : c + 2])]
        nodes = k["mover"][on]
        order = np.argsort(nodes)
        ends = order[np.searchsorted(nodes, k["segment"][grip], sorter=order)]
        segments = [(i, j, k["length"][e], k["push"][e]) for (i, j), e in zip(ends.tolist(), grip, strict=True)]
        yield Stencil("protrusion", nodes[:, None], lambda x, v, w=k["mover_weight"][on], s=segments: push(
            formula, w, s, x))


def push(formula: Any, weight: np.ndarray, segments: list, x: tuple) -> tuple:
    """Forces [pN/µm] on the surface particles of a cell at x [µm], k pairs of numbers, summed as in protrusion.c.

    segments : ends, length [µm] and push (2,) [pN/µm] of those near the substrate;  weight : (k,) float -- of the
    particles in the mean of the surface [-].
    """
    middle, bonded, force = sum(w * place[0] for w, place in zip(weight, x, strict=True)), 0.0, [0.0] * len(x)
    for i, j, length, _ in segments:
        bonded = bonded + formula.grip(length, 0.5 * (x[i][0] + x[j][0]) - middle, x[i][1], x[j][1])
    for i, j, length, size in segments:
        if size.any():
            ends = formula.force(*size, formula.hold(bonded), length, x[i][0] - middle, x[j][0] - middle, x[i][1],
                                 x[j][1])
            for end, (along, _) in zip((i, j), ends, strict=True):
                force[end] = force[end] + along
    return tuple((f, 0.0) for f in force)


def _contact(m: Mechanics, formula: Any) -> Iterator[Stencil]:
    """Segments in contact whose bonds act, with the closest points of the last evaluation of forces."""
    k, closest = m.kernel, m.segments.closest_point
    segment = k["contact_segment"].reshape(-1, 2)
    gaps, cutoff = closest["gap"][segment], formula.bonds.law.cutoff
    acts = np.flatnonzero((gaps < cutoff).any(axis=1) & np.isfinite(gaps).all(axis=1))
    nodes = [n for end in segment[acts].T for n in (k["contact_node"][end], closest["a"][end], closest["b"][end])]
    side = np.where(gaps[acts] < 0.0, -1.0, 1.0).T
    length = k["contact_length"][acts]
    yield Stencil("contact", np.array(nodes, np.int64).reshape(6, -1),
                  lambda x, v: formula.force(length, *side, x))


OWN_STENCILS = {"contact": _contact, "protrusion": _protrusion, "loads": _loads}  # others have stencils of segments
