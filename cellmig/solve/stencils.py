"""Forces on surfaces as formulas of a few particles each, those of kernel.c, and how they change with their motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..meshfree.boundary import GAUSS
from .mechanics import Mechanics
from .segments import depth
from .tangent import mixed

LEVEL = 1e-6  # of the height of the pushing edge: segments less inclined are level


@dataclass(frozen=True)
class Stencil:
    """One term: many groups of k particles, and the forces of each group on its particles.

    name : of the term;  nodes : (k, n) int -- local numbers;  force : takes positions x and velocities v, k pairs of
    numbers each, and returns k pairs of forces [pN/µm].
    """

    name: str
    nodes: np.ndarray
    force: Callable[..., tuple]

    def tangent(self, m: Mechanics, by_u: float, by_v: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows, columns (b,) in local numbers and blocks (b, 2, 2) of -(by_u ∂f/∂u + by_v ∂f/∂v)."""
        x, v = (a.transpose(0, 2, 1) for a in (m.state.x(self.nodes), m.state.memory[self.nodes, 2:]))
        blocks = -mixed(self.force, {"x": (x, by_u), "v": (v, by_v)}).transpose(0, 2, 4, 1, 3)
        k, n = self.nodes.shape
        rows = np.broadcast_to(self.nodes[:, None], (k, k, n))
        columns = np.broadcast_to(self.nodes[None], (k, k, n))
        return rows.ravel(), columns.ravel(), blocks.reshape(-1, 2, 2)


def stencils(m: Mechanics) -> Iterator[Stencil]:
    """The terms of a scene that act on its surfaces, for the search lists, the clock and the feet as they are."""
    t, k = m.terms, m.kernel
    ends, length, near = k["segment"].T, k["length"], (k["near"] if t.substrate is not None else None)
    if t.substrate is not None:
        yield Stencil("substrate", ends[:, near], lambda x, v: substrate(t.substrate, length[near], x))
    if t.friction is not None:
        yield Stencil("friction", ends[:, near],
                      lambda x, v: friction(t.friction, t.substrate, length[near], x, v))
    if t.protrusion is not None:
        yield from _pushes(m)
    if t.cortex is not None:
        yield Stencil("cortex", ends, lambda x, v: cortex(t.cortex, length, x))
    if t.contact is not None:
        yield _contact(m)
    pressed, pressures = m.loads.pressures()
    if len(pressed):
        yield Stencil("pressure", pressed.T, lambda x, v: pressure(pressures, x))
    if t.director_law is not None and t.director_law.anchoring == "surface" and m.director is not None:
        anchor, torque = m.director.anchored()
        yield Stencil("anchors", anchor[:, [0, 2]].T, lambda x, v: couple(torque, x))


def segment_mean(law: Any, g1: Any, g2: Any) -> tuple:
    """Mean of a potential over a segment whose gap goes from g1 to g2, and its derivatives by both [pN µm, pN]."""
    dg, low = g2 - g1, np.where(g1 < g2, g1, g2)
    sloped = np.absolute(dg) > 0.05 * np.where(low > law.cap, low, law.cap)
    over = 1.0 / np.where(sloped, dg, 1.0)
    exact = (law.primitive(g2) - law.primitive(g1)) * over
    mean, d1, d2 = 0.0, 0.0, 0.0
    for at, weight in GAUSS:
        g = g1 + at * dg
        slope = weight * law.slope(g)
        mean, d1, d2 = mean + weight * law.potential(g), d1 + (1.0 - at) * slope, d2 + at * slope
    return (np.where(sloped, exact, mean),
            np.where(sloped, (exact - law.potential(g1)) * over, d1),
            np.where(sloped, (law.potential(g2) - exact) * over, d2))


def substrate(law: Any, length: np.ndarray, x: tuple) -> tuple:
    """Bonds of a segment to the plane y = 0."""
    _, d1, d2 = segment_mean(law, x[0][1], x[1][1])
    size = -law.bond_density * length
    return (0.0, size * d1), (0.0, size * d2)


def friction(law: Any, bonds: Any, length: np.ndarray, x: tuple, v: tuple) -> tuple:
    """Drag of the closed bonds of a segment."""
    closed = -segment_mean(bonds, x[0][1], x[1][1])[0] / depth(bonds)
    share = np.minimum(np.maximum(closed, 0.0), 1.0)
    return tuple((-0.5 * length * law.drag(share, vx), 0.0) for vx, _ in v)


def protrusion(law: Any, bonds: Any, weight: np.ndarray, segments: list, x: tuple) -> tuple:
    """Push of a cell along x, whose whole surface is at x; `segments` : ends, length and push of those near the
    substrate; `weight` (k,) makes the mean of the surface.
    """
    middle, bonded, force = sum(w * place[0] for w, place in zip(weight, x, strict=True)), 0.0, [0.0] * len(x)
    for i, j, length, _ in segments:
        closed = np.maximum(-segment_mean(bonds, x[i][1], x[j][1])[0] / depth(bonds), 0.0)
        bonded = bonded + length * closed * law.front(0.5 * (x[i][0] + x[j][0]) - middle)
    for i, j, length, push in segments:
        if not push.any():
            continue
        g1, g2 = x[i][1], x[j][1]
        dg = g2 - g1
        steep = np.absolute(dg) > LEVEL * law.height
        edge = np.where(steep, (law.ramp(g2) - law.ramp(g1)) / np.where(steep, dg, 1.0),
                        law.ramp_slope(0.5 * (g1 + g2)))
        for end, size in zip((i, j), push, strict=True):
            force[end] = force[end] + size * length * law.hold(bonded) * law.front(x[end][0] - middle) * edge
    return tuple((f, 0.0) for f in force)


def _pushes(m: Mechanics) -> Iterator[Stencil]:
    """Each cell that protrudes: how it is pushed depends on all of its surface."""
    k, t = m.kernel, m.terms
    for c in range(len(k["hold"])):
        on, grip = slice(*k["first_mover"][c : c + 2]), k["grip"][slice(*k["first_grip"][c : c + 2])]
        nodes = k["mover"][on]
        order = np.argsort(nodes)
        ends = order[np.searchsorted(nodes, k["segment"][grip], sorter=order)]
        segments = [(i, j, k["length"][e], k["push"][e]) for (i, j), e in zip(ends.tolist(), grip, strict=True)]
        weight = k["mover_weight"][on]
        yield Stencil("protrusion", nodes[:, None],
                      lambda x, v, w=weight, s=segments: protrusion(t.protrusion, t.substrate, w, s, x))


def cortex(law: Any, length: np.ndarray, x: tuple) -> tuple:
    """Tension of a segment."""
    dx, dy = x[1][0] - x[0][0], x[1][1] - x[0][1]
    now = np.sqrt(dx * dx + dy * dy)
    t = law.tension(now / length) / now
    return (t * dx, t * dy), (-t * dx, -t * dy)


def pressure(size: np.ndarray, x: tuple) -> tuple:
    """Pressure on a segment, whose outside is to the right of it; half on each end."""
    half = 0.5 * size
    f = -half * (x[1][1] - x[0][1]), half * (x[1][0] - x[0][0])
    return f, f


def couple(torque: np.ndarray, x: tuple) -> tuple:
    """A torque on an anchored particle as forces on its neighbours along the membrane."""
    dx, dy = x[1][0] - x[0][0], x[1][1] - x[0][1]
    w = torque / (dx * dx + dy * dy)
    return (w * dy, -w * dx), (-w * dy, w * dx)


def foot(x: tuple, a: tuple, b: tuple, side: np.ndarray) -> tuple:
    """Gap from x to the segment a-b, and its derivatives by the three, as pairs; `side` (n,) is -1 within a cell."""
    ex, ey, px, py = b[0] - a[0], b[1] - a[1], x[0] - a[0], x[1] - a[1]
    t = np.minimum(np.maximum((px * ex + py * ey) / (ex * ex + ey * ey), 0.0), 1.0)
    dx, dy = px - t * ex, py - t * ey
    r = np.sqrt(dx * dx + dy * dy)
    n = side * dx / r, side * dy / r
    return side * r, (n, ((t - 1.0) * n[0], (t - 1.0) * n[1]), (-t * n[0], -t * n[1]))


def contact(law: Any, length: np.ndarray, side: np.ndarray, x: tuple) -> tuple:
    """Half of the bonds between a segment and another cell; x : its first end with the ends of the segment where its
    foot is, then the second end with those of its own; side : (2, n).
    """
    (g1, first), (g2, second) = foot(*x[:3], side[0]), foot(*x[3:], side[1])
    _, d1, d2 = segment_mean(law, g1, g2)
    size = -0.5 * law.bond_density * length
    return (*((size * d1 * gx, size * d1 * gy) for gx, gy in first),
            *((size * d2 * gx, size * d2 * gy) for gx, gy in second))


def _contact(m: Mechanics) -> Stencil:
    """The segments of contact whose bonds act, with the feet that the last evaluation found."""
    k, law, feet = m.kernel, m.terms.contact, m.segments.closest_point
    segment = k["contact_segment"].reshape(-1, 2)
    gaps = feet["gap"][segment]
    acts = np.flatnonzero((gaps < law.cutoff).any(axis=1) & np.isfinite(gaps).all(axis=1))
    nodes = [n for end in segment[acts].T for n in (k["contact_node"][end], feet["a"][end], feet["b"][end])]
    side = np.where(gaps[acts] < 0.0, -1.0, 1.0).T
    length = k["contact_length"][acts]
    return Stencil("contact", np.array(nodes, np.int64).reshape(6, -1), lambda x, v: contact(law, length, side, x))
