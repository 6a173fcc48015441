"""When a run stops to look: its samples and frames."""

from __future__ import annotations

import dataclasses
import math
from fractions import Fraction

from .schema import Case


def until(case: Case, end: float | None) -> Case:
    """The case with another end [µs], if one is given, and samples and frames as often: for estimates."""
    if end is None:
        return case
    counts = {name: max(1, math.ceil(getattr(case.time, name) * end / case.time.end)) for name in ("samples", "frames")}
    return dataclasses.replace(case, time=dataclasses.replace(case.time, end=end, **counts))


def stops(case: Case, end: float, step: float | None = None) -> list[tuple[float, bool, bool]]:
    """Times [µs] up to `end` at which the run looks up, and whether for a sample and for a frame.

    Where no stop cuts a step [µs], they are whole numbers of it, the nearest ones, each once.

    Parts of the case's end are exact fractions, rounded once: what falls together is one time, whatever its digits.
    """
    whole, before = Fraction(str(float(case.time.end))), end * (1.0 - 1e-12)

    def every(count: int) -> set[float]:
        times = (float(whole * i / count) for i in range(int(end / case.time.end * count) + 2))
        return {t for t in times if t < before}

    sample, frame = every(case.time.samples) | {end}, every(case.time.frames) | {end}
    if step:
        sample, frame = ({round(t / step) * step for t in times} for times in (sample, frame))
    return [(t, t in sample, t in frame) for t in sorted(sample | frame)]
