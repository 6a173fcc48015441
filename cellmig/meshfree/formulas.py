"""Formulas of a case at the places where it needs their values: each has to be a number there."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..case.expression import Expression, evaluate
from ..case.messages import CaseError, Mistake
from ..case.values import LARGEST
from .body import Scene
from .boundary import GAUSS, particles_of, segments_of

TINY = 1e-9  # of a cell's size: a place as near an axis is on it, but for rounding
TIMES = 1001  # at which a history is looked at, from the start to the end


def check(case: Any, scene: Scene) -> None:
    """Raise CaseError, with all of them, where formulas or histories of a case have no finite value."""
    wrong, sound = {}, set()
    for kind, item, key, cell, X in _asked(case, scene):
        given = getattr(item, key)
        for value in given if isinstance(given, tuple) else (given,):
            if isinstance(value, Expression) and (place := _undefined(value, X)) is not None:
                x, y, found = place
                where = case.formulas.get((kind, item.name, key), (case.path, None, f"{kind}.{item.name}.{key}"))
                wrong.setdefault((where, value.text), Mistake(
                    *where, f"'{value.text}' has no value that can be computed with at ({x:.4g}, {y:.4g}) um from the "
                            f"centre of '{case.cells[cell].name}': it is {found:g} there"))
    for kind in ("supports", "loads", "plates"):
        for item in getattr(case, kind):
            if item.history not in sound and (time := _undefined_time(item.history, case.time.end)) is not None:
                wrong[kind, item.name] = Mistake(case.path, None, f"{kind}.{item.name}.history",
                                                 f"has no finite value and rate at {time:.4g} us")
            sound.add(item.history)
    if wrong:
        raise CaseError(wrong.values())


def _asked(case: Any, scene: Scene) -> Iterator[tuple[str, Any, str, int, np.ndarray]]:
    """Kind, item, key, cell, and the places about its centre (n, 2) [µm] at which the key's values are asked for."""
    seen = set()
    for number, cell in enumerate(case.cells):
        for key in ("displacement", "velocity"):
            if (one := (int(scene.kind[number]), getattr(cell, key))) not in seen:
                seen.add(one)
                yield "cells", cell, key, number, scene.templates[one[0]].X
    for kind in ("supports", "loads"):
        for item in getattr(case, kind):
            for number in (n for n, cell in enumerate(case.cells) if cell.name in item.cells or not item.cells):
                X = scene.templates[scene.kind[number]].X
                if kind == "supports":
                    yield kind, item, "displacement", number, X[particles_of(item, scene, number)]
                elif item.body is not None:
                    yield kind, item, "body", number, X
                else:
                    ends = X[segments_of(item, scene, number)]
                    yield kind, item, "pressure", number, ends.mean(axis=1)
                    yield kind, item, "traction", number, np.concatenate(
                        [(1.0 - s) * ends[:, 0] + s * ends[:, 1] for s, _ in GAUSS])


def _undefined(value: Expression, X: np.ndarray) -> tuple[float, float, float] | None:
    """The first of the places (n, 2) at which a formula is no finite number, and what it is there."""
    size = np.ptp(X, axis=0).max() if len(X) else 0.0
    for places in (X, np.where(np.abs(X) < TINY * size, 0.0, X)):
        found = evaluate(value, places)
        bad = np.flatnonzero(~(np.abs(found) <= LARGEST))
        if len(bad):
            return (*places[bad[0]].tolist(), float(found[bad[0]]))
    return None


@np.errstate(all="ignore")
def _undefined_time(history: Any, end: float) -> float | None:
    """The first time at which a history or its derivatives are no finite numbers [µs]."""
    times = np.linspace(0.0, end, TIMES)
    for t in times.tolist():
        values = [float(of(t)) for of in (history.value, history.rate, history.acceleration)]
        if not np.isfinite(values).all():
            return t
    return None
