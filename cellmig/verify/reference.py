"""References: functions of the resolution with expected errors, and verdicts on what they measured."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

SHORTFALL = 0.2  # largest difference of an observed order below the expected one
MARGIN = 0.2  # largest growth of an error since it was recorded, where resolutions are too coarse for an order
TRIED = 0.5  # a target applies to runs with at least this share of its particles

HOLDS, FAILS = "holds", "does not hold"


@dataclass(frozen=True)
class Expected:
    """What theory predicts for one error.

    order : power of the size h, None for an error of rounding;  why : one line of reasoning, or a citation;
    tolerance : largest error of rounding;  within : {particles: error} -- bound on the error of the finest resolution
    with at most so many particles;  floor : uncertainty of the exact value, or what layouts differ by: an error
    below it has no order.
    """

    order: float | None
    why: str
    tolerance: float = 0.0
    within: Mapping[int, float] = field(default_factory=dict)
    floor: float = 0.0


def converges(order: float, why: str, within: Mapping[int, float] | None = None, floor: float = 0.0) -> Expected:
    """An error that is proportional to a power of the size."""
    return Expected(order, why, within=within or {}, floor=floor)


def exact(tolerance: float, why: str) -> Expected:
    """An error of rounding at any size."""
    return Expected(None, why, tolerance)


@dataclass(frozen=True)
class Measured:
    """What a reference measured at one resolution.

    size : h in the unit of the reference;  errors : by name, not negative;  particles : 0 if there are none.
    """

    size: float
    errors: dict[str, float]
    particles: int = 0


@dataclass(frozen=True, eq=False)
class Reference:
    """A reference: `measure(resolution)` returns a Measured with the errors named in `expected`.

    group : kind of physics;  shows, source : a line each;  unit : of the size;  at, quick : resolutions from coarse to
    fine;  seconds : estimated time of the finest of `at` on one core;  coarse : recorded errors at the finest of
    `quick`, for those errors whose order `quick` is too coarse to show.
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
    """Register a function of the resolution as the reference `name`; `quick` are by default the three coarsest of `at`.

    Raises ValueError where two modules use one name.
    """

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
    """The verdict on one error of a reference.

    sizes, errors, particles : from coarse to fine;  pairwise : order of the two finest;  fitted : order of all, by
    least squares;  why : reasons of a failure, empty if the error is as expected.
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
        """HOLDS or FAILS."""
        return FAILS if self.why else HOLDS

    @property
    def below_floor(self) -> bool:
        """Whether the finest error is below the uncertainty of the exact value."""
        floor = self.expected.floor
        return self.expected.order is not None and floor > 0.0 and bool(self.errors) and self.errors[-1] <= floor


def orders(sizes: Sequence[float], errors: Sequence[float]) -> tuple[float, float]:
    """Observed orders, of the two finest sizes and of all by least squares; nan where an error is zero."""
    h, e = np.asarray(sizes, float), np.asarray(errors, float)
    if len(h) < 2 or not (np.isfinite(e).all() and (e > 0.0).all()):
        return math.nan, math.nan
    slope = np.log(e[-1] / e[-2]) / np.log(h[-1] / h[-2])
    return float(slope), float(np.polyfit(np.log(h), np.log(e), 1)[0])


def judge(name: str, error: str, expected: Expected, found: Sequence[Measured], failed: Sequence[str] = (),
          coarse: float = 0.0) -> Verdict:
    """The verdict on one error, measured at resolutions in any order.

    failed : why other resolutions could not be measured;  coarse : recorded error at the finest resolution, where they
    are too coarse for an order: then the error may exceed it by a fifth.
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
    elif errors[-1] > expected.floor:  # else it is zero or within the uncertainty of the exact value
        why += [f"order {order:.2f} {how} is below {expected.order - SHORTFALL:.3g}"
                for how, order in (("of the two finest", pairwise), ("over all", fitted))
                if not order >= expected.order - SHORTFALL]
    why += _unmet_targets(expected, particles, errors)
    return Verdict(name, error, expected, sizes, errors, particles, pairwise, fitted, tuple(why))


def _unmet_targets(expected: Expected, particles: Sequence[int], errors: Sequence[float]) -> list[str]:
    """Messages about targets for the error itself that apply and are missed."""
    messages = []
    for most, target in expected.within.items():
        tried = [(n, e) for n, e in zip(particles, errors, strict=True) if n <= most]
        if tried and max(tried)[0] >= TRIED * most and not max(tried)[1] <= target:
            n, e = max(tried)
            messages.append(f"error {e:.2g} at {n} particles is above {target:g}")
    return messages
