"""Output times of a run: its samples and frames."""

from __future__ import annotations

import dataclasses
import math
from fractions import Fraction

from .schema import Case


def until(case: Case, end: float | None) -> Case:
    """The case with another end [µs], if one is given, and outputs at the same intervals; used for estimates."""
    if end is None:
        return case
    counts = {name: max(1, math.ceil(getattr(case.time, name) * end / case.time.end)) for name in ("samples", "frames")}
    return dataclasses.replace(case, time=dataclasses.replace(case.time, end=end, **counts))


def output_times(case: Case, end: float, step: float | None = None) -> list[tuple[float, bool, bool]]:
    """Output times [µs] up to `end` [µs], and whether each is for a sample and for a frame.

    With a fixed `step` [µs] they are rounded to multiples of it.  They are exact fractions of the case's end, rounded
    once, so that coinciding times are equal.
    """
    whole, before = Fraction(str(float(case.time.end))), end * (1.0 - 1e-12)

    def every(count: int) -> set[float]:
        times = (float(whole * i / count) for i in range(int(end / case.time.end * count) + 2))
        return {t for t in times if t < before}

    sample, frame = every(case.time.samples) | {end}, every(case.time.frames) | {end}
    if step:
        sample, frame = ({round(t / step) * step for t in times} for times in (sample, frame))
    return [(t, t in sample, t in frame) for t in sorted(sample | frame)]
