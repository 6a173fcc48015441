"""Where cells push: polarities, which chance and cues turn, and what becomes of them in the mechanics."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ..case.schema import Case
from ..cues.surroundings import Surroundings
from ..meshfree.contact import Surfaces
from ..meshfree.scene import Scene
from ..meshfree.terms import Terms
from ..model.ground import push_factor
from ..parallel.collect import Arrays, computed_on_root
from ..parallel.random import normal, uniform
from .clutches import Modules, edges
from .mechanics import Mechanics
from .protrusion import Drives
from .step import NumericsError

# Shares of a basal push, which is the same on all sides, and of a polarity in each of the directions of a cell: the sum
# of n unit vectors e over half a circle is n/π long, that of (p·e) e over the half around p is n p/4.
SHARES = {1: (0.0, 1.0), 2: (1.0, 1.0), 8: (math.pi / 8.0, 0.5)}


def directions(sides: int, dimension: int) -> np.ndarray:
    """Unit vectors (sides, d - 1) [-] along the substrate in which a cell pushes on every side."""
    if dimension == 2:
        return np.array([[1.0], [-1.0]])[:sides]
    turn = 2.0 * np.pi * np.arange(sides) / sides
    return np.column_stack([np.cos(turn), np.sin(turn)])


def towards(case: Case) -> np.ndarray:
    """Unit vectors (cells, d - 1) [-] along which cells without a polarity push."""
    n, given = case.dimension - 1, case.protrusion.direction if case.protrusion is not None else ()
    found = np.array([(cell.push and cell.push.direction) or given or (1.0,) + (0.0,) * (n - 1)
                      for cell in case.cells], float)
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def vectors(case: Case, terms: Terms, p: np.ndarray) -> np.ndarray:
    """Vectors (cells, sides, d - 1) [-] of the pushes of cells with polarities p (cells, d - 1) [-]."""
    if terms.sides == 1:
        return p[:, None].copy()
    basal, along = SHARES[terms.sides]
    ways = directions(terms.sides, terms.dimension)
    law: Any = terms.protrusion
    return (basal * law.basal + along * np.maximum(p @ ways.T, 0.0))[..., None] * ways


def strengths(case: Case, time: float) -> np.ndarray:
    """Factors (cells,) [-] of the pushes of cells at a time [µs]."""
    found = np.ones(len(case.cells))
    for c, push in enumerate(cell.push for cell in case.cells):
        if push is not None:
            found[c] = push.strength * (push.begin <= time < (math.inf if push.end is None else push.end))
    return found


def steady(case: Case, terms: Terms) -> Drives:
    """Drives at the start of cells without polarities, which do not change."""
    value = strengths(case, 0.0)[:, None, None] * vectors(case, terms, towards(case))
    return Drives(value, np.zeros_like(value), 0.0, 1.0)


class Guidance:
    """Polarities of cells, found at knots that are fixed in time, and drives that are linear in time between them.

    Attributes
    ----------
    knot : int -- number of the last knot.
    p, then : (cells, d - 1) float -- polarities at the last and at the next knot [-].
    parts : dict of (cells, d - 1) float -- what each cue gave at the last knot, by number, as in the case, and law [-].
    due : float -- time up to which the drives hold [µs].
    """

    def __init__(self, case: Case, mechanics: Mechanics, fields: Mapping[str, Any]):
        """Find polarities at the start, and at the first knot, by the `fields` that cues name; collective."""
        self._case, self._mechanics, self._law = case, mechanics, case.polarity
        names, law = [cell.name for cell in case.cells], self._law
        self._names, self._fields = tuple(names), fields
        self._found: tuple[Scene | None, Surfaces | None] = None, None
        push = case.protrusion.cells if case.protrusion is not None else ()
        self._polar = np.array([law is not None and name in push and name in (law.cells or push) for name in names])
        self._interval = law.interval if law is not None else case.time.end / case.time.samples
        self._events = sorted({t for cell in case.cells if cell.push for t in (cell.push.begin, cell.push.end) if t})
        self.knot, self._at, self.parts = 0, 0.0, dict[str, np.ndarray]()
        self._factor = np.ones(mechanics.scene.first_surface[-1])
        self._pull = np.ones((len(names), mechanics.terms.sides))
        pushing = [name for name in names if name in push]
        self._modules = case.clutches and Modules(case.clutches, case.seed, self._names, pushing, mechanics.terms.sides)
        self.p = self.then = np.where([[name in push] for name in names], towards(case), 0.0)
        self._centre = np.zeros((len(names), mechanics.scene.dimension))
        self._gate = case.protrusion.gate if case.protrusion is not None else None
        self._senses = bool(case.cues) or self._gate is not None or case.ground is not None
        self._look()
        self._drive()

    @property
    def due(self) -> float:
        """Time of the next knot, or at which a cell begins or ceases to push [µs]."""
        if not self._case.guided:
            return math.inf
        return min([self._interval * (self.knot + 1), *(t for t in self._events if t > self._at)])

    def turn(self) -> None:
        """Find what follows at the time that was due; collective."""
        self._at = self.due
        if self._at == self._interval * (self.knot + 1):
            self.knot += 1
            self.p = self.then
            self._look()
        self._drive()

    def now(self) -> np.ndarray:
        """Polarities (cells, d - 1) [-] at the time that was due last."""
        return self.at(self._at)

    def at(self, time: float) -> np.ndarray:
        """Polarities (cells, d - 1) [-] at a time [µs] from the last knot to the next."""
        return self.p + (time / self._interval - self.knot) * (self.then - self.p)

    def _look(self) -> None:
        """Find the next polarities, and factors of the push, by what is around the cells at this knot; collective."""
        m = self._mechanics
        x = m.segments.everywhere() if self._senses else None
        found = computed_on_root(m.comm, lambda: self._decided(x))
        self.p, self.then, self._factor, self._pull, self._centre, self.parts = found

    def _decided(self, x: np.ndarray | None) -> tuple:
        """What `_look` sets, for surface particles at x (m, d) [µm]; for rank 0."""
        case, law, parts, centre = self._case, self._law, dict[str, np.ndarray](), self._centre
        factor, pull = self._factor, self._pull
        if x is not None:
            around = self._surroundings(x)
            with np.errstate(all="ignore"):  # what is not finite has a message of its own
                parts = {f"{n}_{cue.law}": cue.value(around) for n, cue in enumerate(case.cues)}
                factor = push_factor(case.ground, self._fields, x, self._at, self._push)
            self._finite(parts, factor)
            if self._gate is not None:
                factor = factor * (1.0 - around.gate(self._gate))
            pull, centre = self._pulls(x) if self._modules is not None else pull, around.centre
        cues = sum(parts.values(), np.zeros_like(self.p))
        if law is not None and not self.knot:
            first = law.begun(law.start) if law.start else law.drawn(cues, self._normal("start"))
            self.p = np.where(self._polar[:, None], first, self.p)
        return self.p, self.p if law is None else self._next(cues), factor, pull, centre, parts

    @property
    def _surfaces(self) -> Surfaces:
        """Surfaces of all cells, for rank 0."""
        scene, found = self._found
        if found is None or scene is not self._mechanics.scene:  # they may be divided anew
            scene, found = self._found = self._mechanics.scene, Surfaces.of(self._mechanics.scene)
        return found

    def _finite(self, parts: dict[str, np.ndarray], factor: np.ndarray) -> None:
        """Raise NumericsError where a cue (cells, d - 1) [-] or a factor of the push (m,) [-] is not finite."""
        cell = self._surfaces.cell
        every = [(f"the cue {name}", values, np.arange(len(values))) for name, values in parts.items()]
        for what, values, of in [*every, ("the factor of the push", factor, cell)]:
            wrong = np.flatnonzero(~np.isfinite(values.reshape(len(values), -1)).all(axis=1))
            if len(wrong):
                raise NumericsError(f"the simulation failed at {self._case.time_unit.text(self._at)}: {what} of "
                                    f"'{self._names[of[wrong[0]]]}' is not finite: formulas of fields, of the "
                                    "substrate and of cues have to be, wherever cells go and at all times")

    def _push(self, bonds: np.ndarray) -> np.ndarray:
        """Push of α = 1 (m,) [pN/µm] by shares of the bonds (m,) [-]."""
        law, on = self._mechanics.terms.protrusion, self._mechanics.terms.substrate
        assert law is not None and on is not None  # else nothing is guided
        return law.push(bonds * on.work)

    def _pulls(self, x: np.ndarray) -> np.ndarray:
        """Factors of the push (cells, sides) [-] by the clutches since the last knot, for surface particles at x (m, d)
        [µm] now; for rank 0.  What they did before the start is what they do there.
        """
        at = edges(self._surfaces, x, directions(self._mechanics.terms.sides, x.shape[1]))
        modulus = self._fields["stiffness"].value(at.reshape(-1, x.shape[1]), self._at)
        return self._modules.advance(self.knot, self._interval, modulus.reshape(at.shape[:2]))

    def _surroundings(self, x: np.ndarray) -> Surroundings:
        """What is around the cells at this knot, for surface particles at x (m, d) [µm]."""
        around = Surroundings(self._at, self.knot, self._case.seed, self._names, self._surfaces, x, self.p,
                              np.zeros_like(self.p), self._fields, self._case.gels)
        if not self.knot:
            return around
        return replace(around, velocity=(around.centre - self._centre)[:, :-1] / self._interval)

    def _next(self, cues: np.ndarray) -> np.ndarray:
        """Polarities (cells, d - 1) [-] at the next knot, for the sum of `cues` of that shape [-]."""
        chance = np.array([uniform(self._case.seed, "turn", self._key(name), 1)[0] for name in self._names])
        turned = self._law.next(self.p, cues, self._normal("noise"), chance)
        return np.where(self._polar[:, None], turned, self.p)

    def _normal(self, purpose: str) -> np.ndarray:
        """Independent normal numbers (cells, d - 1) [-] that belong to each cell and the last knot."""
        n = self.p.shape[1]
        return np.array([normal(self._case.seed, f"polarity {purpose}", self._key(name), n) for name in self._names])

    def _key(self, name: str) -> str:
        return f"{name}\0{self.knot}"

    def _drive(self) -> None:
        """Push as the polarities say from now on."""
        case, terms, start = self._case, self._mechanics.terms, self._interval * self.knot
        low, high = (vectors(case, terms, p) for p in (self.p, self.then))
        on = (strengths(case, self._at)[:, None] * self._pull)[..., None]
        rate = (high - low) / self._interval
        self._mechanics.drive(Drives(on * (low + (self._at - start) * rate), on * rate, self._at, self._factor))

    def saved(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """State for a checkpoint: numbers; the factor of the push at all surface particles (m,) [-], centres (cells, d)
        [µm], and on rank 0 the forces on clutches (cells, sides, n_c) [pN].
        """
        parts = {name: values.tolist() for name, values in self.parts.items()}
        pushing = self._mechanics.protrusion
        clutches = {} if self._modules is None else {"guidance clutches": self._modules.forces.copy()}
        return ({"knot": self.knot, "at": self._at, "p": self.p.tolist(), "then": self.then.tolist(), "parts": parts,
                 "pull": self._pull.tolist(), "clock": None if pushing is None else pushing.clock},
                {"guidance factor": self._factor, "guidance centre": self._centre} | clutches)

    def restore(self, about: dict[str, Any], arrays: Arrays) -> None:
        """Set the state from the results of `saved`; collective."""
        found = {name: arrays[name] for name in arrays.names if name.startswith("guidance")}
        self.knot, self._at, self._factor = about["knot"], about["at"], found["guidance factor"]
        self._centre = found["guidance centre"]
        self.p, self.then, self._pull = (np.array(about[name]) for name in ("p", "then", "pull"))
        if self._modules is not None:
            self._modules.forces = found["guidance clutches"].copy()
        self.parts = {name: np.array(values) for name, values in about["parts"].items()}
        self._drive()
        if self._mechanics.protrusion is not None:
            self._mechanics.protrusion.set_clock(*about["clock"])
