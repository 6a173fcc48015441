"""Estimates of the motion of a case, from closed formulas."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any, NamedTuple

import numpy as np

from cellmig.case.expression import evaluate
from cellmig.case.gaps import Arrangement, arrangement
from cellmig.case.held import supported, unheld
from cellmig.case.schema import Case, Cell
from cellmig.cues.cue import Sites
from cellmig.model.ground import fields_of

SMALL, BRIEF, LASTING = 0.1, 10.0, 1e5  # Reynolds number; times over that in which momentum spreads [-]
SLOW = 1e-15  # speed at which any drag is linear [µm/µs]


class Expected(NamedTuple):
    """Estimated motion of a case, within a factor of two or three.

    push : protrusion on the fastest cells, per cell [pN/µm];  borne : most that their bonds bear of it, infinite if
    that grows with the speed without bound [pN/µm];  speed, distance : of these at the end [µm/µs], [µm];
    spreading : initial speed of the contact line [µm/µs];  start : largest initial speed of the case [µm/µs];
    size : diameter 2 √(A/π) of the largest cell [µm];  reynolds, momentum : of the least viscous fluid ρ v L/μ with the
    largest of these speeds and L = `size`, and the time ρ L²/μ in which momentum spreads [µs], None without a fluid.
    """

    push: float
    borne: float
    speed: float
    distance: float
    spreading: float
    start: float
    size: float
    reynolds: float | None
    momentum: float | None

    def fades(self, end: float) -> bool:
        """Whether momentum matters neither in the motion nor for a time `end` [µs]; False without a fluid."""
        return self.momentum is not None and self.reynolds < SMALL and end > BRIEF * self.momentum

    @property
    def fastest(self) -> float:
        """Largest of the speeds [µm/µs]."""
        return max(self.speed, self.spreading, self.start)


def inertia_is_gone(case: Case) -> bool:
    """Whether the motion of a case is one without inertia, and can be computed so: something holds every cell."""
    e = expected(case, arrangement(case), case.time.end)
    moving = e.start or any(unheld(case.cells, case.supports, case.friction, case.substrate, case.medium,
                                  case.pairs))
    return e.fades(case.time.end) and case.time.end > LASTING * e.momentum and not moving


def expected(case: Case, found: Arrangement, end: float) -> Expected:
    r"""Estimate the motion of a case up to a time `end` [µs] from its driving forces.

    *Push.*  The protrusion on a membrane at an angle θ with the substrate is β ᾱ w ∫S'(g) ds = β ᾱ w / sin θ, with
    w = N σ and ᾱ = 1/2.  For a round cell of radius R it is β ᾱ w (8/5) √(R/2ℓ); spread cells are steeper, with a
    somewhat smaller push.  Bonded membrane, at g = ε under the front half of the contact, adds β ᾱ w S'(ε) times its
    length: little for bonds of 10 nm, most of the push for those of 50 nm.  Cells in contact share their pushes F, and
    m v' = ΣF - c v with m = Σρ A.  The drag is c = ΣF/V, with the speed V at which the friction on a contact of one
    diameter, and the medium, bear the pushes; without any v = F t/m, and the distance is F t²/2m.  A cell whose
    supports hold each direction goes nowhere.

    *Spreading.*  Adhesion pulls at the contact line with w, against viscosity or inertia: v = w / (μ + √(ρ R w)).

    Source: derived here.
    """
    touching = set(range(len(case.cells))) - set(found.floating.tolist()) if case.substrate else set()
    best = (0.0, 0.0, 0.0, math.inf)
    for members in _groups(found):
        best = max(best, _carried(case, end, [case.cells[n] for n in members], [n in touching for n in members]))
    speed, distance, push, borne = best
    spreading = max((_spreading(case, case.cells[n]) for n in touching), default=0.0)
    start = max(_start(cell) for cell in {(c.shape, c.velocity, c.velocity_gradient): c for c in case.cells}.values())
    size = 2.0 * max(map(_radius, case.cells))
    fluid = [_law(case, c) for c in case.cells if _law(case, c).viscosity]
    fastest = max(speed, spreading, start)
    momentum = max((law.density * size**2 / law.viscosity for law in fluid), default=None)
    reynolds = momentum and momentum * fastest / size
    return Expected(push, borne, speed, distance, spreading, start, size, reynolds, momentum)


class Polarities(NamedTuple):
    """How large polarities become, about [-].

    start : size at the start, if it is given;  cues : sum of the sizes of cues at the start;  chance : two standard
    deviations;  unknown : numbers of cues of which nothing but a bound is known, and these bounds.
    """

    start: float
    cues: float
    chance: float
    unknown: tuple[tuple[int, float], ...]

    @property
    def largest(self) -> float:
        """Largest polarity by what is known."""
        return max(self.start, self.cues + self.chance)


def polarities(case: Case) -> Polarities:
    """Estimate how large polarities become; those of a constant size are that, and without any cells push with 1."""
    law = case.polarity
    if law is None:
        return Polarities(1.0, 0.0, 0.0, ())
    if law.law == "switching":
        return Polarities(law.spread, 0.0, 0.0, ())
    names, unknown = np.array([cell.name for cell in case.cells]), []
    half = {cell.shape: 0.5 * np.ptp(cell.shape.outline(64), axis=0)[:-1].max() for cell in case.cells}
    sites = Sites(np.array([cell.centre for cell in case.cells], float), np.array([half[c.shape] for c in case.cells]),
                  fields_of(case), (0.0, 0.5 * case.time.end, case.time.end))
    sums = np.zeros(len(names))
    for number, cue in enumerate(case.cues):
        size, is_known = cue.largest(sites)
        size = size * (np.isin(names, cue.cells) if cue.cells else 1.0)
        sums += size * is_known
        unknown += [] if is_known else [(number, float(size.max()))]
    return Polarities(math.hypot(*law.start) if law.start else 0.0, float(sums.max()), 2.0 * law.spread, tuple(unknown))


def _groups(found: Arrangement) -> list[np.ndarray]:
    """Numbers of the cells in each group of cells in contact."""
    order = np.argsort(found.group, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(found.group[order])) + 1)


def _carried(case: Case, end: float, cells: list[Cell], touching: list[bool]) -> tuple[float, float, float, float]:
    """Speed and distance at the end, push per cell and the most that bonds bear of it, of cells that move together."""
    if any(supported(c, case.supports) for c in cells):
        return 0.0, 0.0, 0.0, math.inf
    mass = sum(_law(case, c).density * _content(c) for c in cells)
    rubbing = [c for c, touches in zip(cells, touching, strict=True) if touches]
    force = sum(_push(case, c) for c in rubbing)
    along = abs(case.body_force[0]) if case.body_force and case.substrate else math.hypot(*case.body_force or (0.0,))
    acceleration = force / mass + along
    push, borne = force / len(cells), _borne(case, rubbing) / len(cells)
    steady = _steady(case, cells, rubbing, mass * acceleration)
    rate = acceleration / steady
    if rate * end < 1e-6:
        return acceleration * end, 0.5 * acceleration * end**2, push, borne
    gone = -math.expm1(-rate * end)
    return acceleration * gone / rate, acceleration * (end - gone / rate) / rate, push, borne


def _steady(case: Case, cells: list[Cell], rubbing: list[Cell], force: float) -> float:
    """Speed [µm/µs] at which the friction of some cells, and a medium, bear a force [pN/µm]; infinite if none does."""
    contacts = Counter((case.friction_of(c), _contact(case, c)) for c in rubbing)
    around = sum(2.0 * math.pi if case.dimension == 2 else 4.0 * math.pi * _radius(c) for c in cells)

    def drag(speed: float) -> float:
        found = -case.medium.force(around, (speed,))[0] if case.medium is not None else 0.0
        return found + sum(n * law.drag(1.0, speed) * size for (law, size), n in contacts.items() if law is not None)

    slope = drag(SLOW) / SLOW
    if not slope > 0.0 or not force > 0.0:
        return math.inf
    from scipy.optimize import brentq  # takes a while, and few scenes get here

    low, high = 0.0, force / slope
    for _ in range(200):  # the traction of bonds falls at high speeds
        if drag(high) >= force:
            return brentq(lambda speed: drag(speed) - force, low, high, xtol=1e-9 * high)
        low, high = high, 1.2 * high
    return math.inf


def _borne(case: Case, cells: list[Cell]) -> float:
    """Largest force [pN/µm] of the friction of some cells, infinite if one of them has no largest traction."""
    most = [(getattr(case.friction_of(c), "largest", (math.inf,))[0], c) for c in cells]
    return sum(traction * _contact(case, c) for traction, c in most)


def _contact(case: Case, cell: Cell) -> float:
    """Contact with the substrate of one diameter [µm], in space of a disc [µm²]."""
    return 2.0 * _radius(cell) if case.dimension == 2 else math.pi * _radius(cell) ** 2


def _push(case: Case, cell: Cell) -> float:
    """Push on a cell on the substrate [pN/µm]."""
    law = case.protrusion
    if law is None or cell.name not in law.cells:
        return 0.0
    slope = 1.6 * math.sqrt(_radius(cell) / (2.0 * law.height))
    wide = 1.0 if case.dimension == 2 else 2.0 * _radius(cell)  # of the front [µm]
    bonded = 0.5 * _contact(case, cell) * float(law.ramp_slope(case.substrate.equilibrium_distance))
    own = cell.push.strength if cell.push is not None else 1.0
    return 0.5 * own * law.push(case.substrate.work) * (max(1.0, slope) * wide + bonded)


def _spreading(case: Case, cell: Cell) -> float:
    """Speed of the contact line of a cell on the substrate [µm/µs]; 0 for a solid."""
    law, work = _law(case, cell), case.substrate.work
    return work / (law.viscosity + math.sqrt(law.density * _radius(cell) * work)) if law.viscosity and work else 0.0


def _start(cell: Cell) -> float:
    """Largest initial speed of a cell [µm/µs]."""
    at = cell.shape.outline(64)
    with np.errstate(all="ignore"):
        given = np.column_stack([evaluate(value, at) for value in cell.velocity])
        speeds = np.linalg.norm(given + at @ np.array(cell.velocity_gradient).T, axis=1)
    return float(speeds[np.isfinite(speeds)].max(initial=0.0))


def _radius(cell: Cell) -> float:
    """Radius of the disc of the same area, or the ball of the same volume [µm]."""
    if cell.shape.dimension == 3:
        return (0.75 * cell.shape.volume / math.pi) ** (1.0 / 3.0)
    return math.sqrt(cell.shape.area / math.pi)


def _content(cell: Cell) -> float:
    """Area [µm²] or volume [µm³] of a cell."""
    return cell.shape.area if cell.shape.dimension == 2 else cell.shape.volume


def _law(case: Case, cell: Cell) -> Any:
    return case.materials[cell.material]
