"""What a reference is: a function of the resolution with errors to expect, and the verdict on what it measured."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

SHORTFALL = 0.2  # by which an observed order may miss the expected one
MARGIN = 0.2  # by which an error may be above what was measured before, where no order can be asked
TRIED = 0.5  # share of a target's particles from which on it has been tried: coarser ones cannot miss it

HOLDS, FAILS = "holds", "does not hold"


@dataclass(frozen=True)
class Expected:
    """What theory says of one error, before it is measured.

    order : in the size h, None where the error is one of rounding;  why : one line of reasoning, or where to read it;
    tolerance : most that an error of rounding may be;  within : {particles: error} -- the finest resolution with at
    most so many particles has at most this error;  floor : how exactly the exact value is known, or what else is in
    the error: below it no order is asked.
    """

    order: float | None
    why: str
    tolerance: float = 0.0
    within: Mapping[int, float] = field(default_factory=dict)
    floor: float = 0.0


def converges(order: float, why: str, within: Mapping[int, float] | None = None, floor: float = 0.0) -> Expected:
    """An error that falls with an order of the size."""
    return Expected(order, why, within=within or {}, floor=floor)


def exact(tolerance: float, why: str) -> Expected:
    """An error near rounding at any size."""
    return Expected(None, why, tolerance)


@dataclass(frozen=True)
class Measured:
    """What a reference measured at one resolution.

    size : h of the order, in the reference's unit;  errors : by name, not negative;  particles : 0 if there are none.
    """

    size: float
    errors: dict[str, float]
    particles: int = 0


@dataclass(frozen=True, eq=False)
class Reference:
    """A reference: `measure(resolution)` returns a Measured, which has the errors that are `expected`.

    group : physics it belongs to;  shows, source : one line each;  unit : of the size;  at, quick : resolutions, from
    coarse to fine;  seconds : that the finest one of `at` takes on one core, about;  coarse : of the errors for whose
    order `quick` is too coarse, what was measured at the finest of it.
    """

    name: str
    group: str
    shows: str
    source: str
    expected: dict[str, Expected]
    at: tuple[Any, ...]
    quick: tuple[Any, ...]
    measure: Callable[[Any], Measured]
    unit: str = "um"
    seconds: float = 1.0
    coarse: Mapping[str, float] = field(default_factory=dict)


REFERENCES: dict[str, Reference] = {}


def reference(name: str, *, shows: str, source: str, expected: dict[str, Expected], at: Sequence[Any],
              quick: Sequence[Any] = (), unit: str = "um", seconds: float = 1.0,
              coarse: Mapping[str, float] | None = None) -> Callable[..., Any]:
    """Register a function of the resolution as the reference `name`; by default `quick` are its three coarsest."""

    def register(measure: Callable[[Any], Measured]) -> Callable[[Any], Measured]:
        group = measure.__module__.rpartition(".")[2]
        if name in REFERENCES and REFERENCES[name].measure.__module__ != measure.__module__:
            raise ValueError(f"two references are called '{name}'")
        REFERENCES[name] = Reference(name, group, shows, source, expected, tuple(at), tuple(quick or at[:3]), measure,
                                     unit, seconds, coarse or {})
        return measure

    return register


@dataclass(frozen=True)
class Verdict:
    """What became of one error of a reference.

    sizes, errors, particles : from coarse to fine;  pairwise : order between the two finest;  fitted : over all, by
    least squares;  verdict : HOLDS or FAILS;  why : what is wrong, empty if nothing is.
    """

    reference: str
    error: str
    expected: Expected
    sizes: tuple[float, ...]
    errors: tuple[float, ...]
    particles: tuple[int, ...]
    pairwise: float
    fitted: float
    why: tuple[str, ...]

    @property
    def verdict(self) -> str:
        """Whether it is as expected."""
        return FAILS if self.why else HOLDS

    @property
    def below_floor(self) -> bool:
        """Whether no order was asked because the finest error is as small as it can be known."""
        floor = self.expected.floor
        return self.expected.order is not None and floor > 0.0 and bool(self.errors) and self.errors[-1] <= floor


def orders(sizes: Sequence[float], errors: Sequence[float]) -> tuple[float, float]:
    """Observed order between the two finest sizes, and over all by least squares; nan where an error is zero."""
    h, e = np.asarray(sizes, float), np.asarray(errors, float)
    if len(h) < 2 or not (np.isfinite(e).all() and (e > 0.0).all()):
        return math.nan, math.nan
    slope = np.log(e[-1] / e[-2]) / np.log(h[-1] / h[-2])
    return float(slope), float(np.polyfit(np.log(h), np.log(e), 1)[0])


def judge(name: str, error: str, expected: Expected, found: Sequence[Measured], failed: Sequence[str] = (),
          coarse: float = 0.0) -> Verdict:
    """The verdict on one error, measured at resolutions in any order.

    `failed` : why others could not be measured;  `coarse` : where resolutions are too coarse for the order, the error
    that was measured at the finest of them: it may be larger by a fifth, and no order is asked.
    """
    found = sorted(found, key=lambda m: -m.size)
    sizes, errors = tuple(m.size for m in found), tuple(m.errors[error] for m in found)
    particles = tuple(m.particles for m in found)
    pairwise, fitted = orders(sizes, errors) if expected.order is not None else (math.nan, math.nan)
    why = list(failed)
    if not errors or not all(map(math.isfinite, errors)):
        why.append("an error is missing or not finite")
    elif expected.order is None:
        if max(errors) > expected.tolerance:
            why.append(f"{max(errors):.2g} is above {expected.tolerance:g}")
    elif coarse:
        if errors[-1] > (1.0 + MARGIN) * coarse:
            why.append(f"{errors[-1]:.2g} is above {coarse:.2g}, measured before, by more than a fifth")
    elif errors[-1] > expected.floor:  # else it is zero or as good as the exact value is known
        why += [f"order {order:.2f} {how} is below {expected.order - SHORTFALL:.3g}"
                for how, order in (("of the two finest", pairwise), ("over all", fitted))
                if not order >= expected.order - SHORTFALL]
    why += _missed(expected, particles, errors)
    return Verdict(name, error, expected, sizes, errors, particles, pairwise, fitted, tuple(why))


def _missed(expected: Expected, particles: Sequence[int], errors: Sequence[float]) -> list[str]:
    """Targets for the error itself that have been tried and missed."""
    missed = []
    for most, target in expected.within.items():
        tried = [(n, e) for n, e in zip(particles, errors, strict=True) if n <= most]
        if tried and max(tried)[0] >= TRIED * most and not max(tried)[1] <= target:
            n, e = max(tried)
            missed.append(f"error {e:.2g} at {n} particles is above {target:g}")
    return missed
