"""Check of a case on its particles: formulas have finite values there, and supports, loads and probes are somewhere."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..case.expression import Expression, evaluate
from ..case.messages import CaseError, Mistake
from ..case.schema import Case
from ..case.values import LARGEST
from ..model.protocols import LoadCurve
from .boundary import cells_of, facets_of, numbers_of, particles_of, points_on
from .scene import Scene

POSITIVE = ("relative_stiffness",)  # keys whose values are not 0 or less
TINY = 1e-9  # a point closer to an axis than this fraction of the cell's size is on it, but for rounding
TIMES = 1001  # number of times, from the start to the end, at which a load curve is checked


def check(case: Case, scene: Scene) -> None:
    """Check the formulas and load curves of a case, and that supports, loads and probes are on its cells.

    Raises CaseError, which holds all that have no finite value or are nowhere.
    """
    wrong: dict[Any, Mistake] = {}
    checked: set[Any] = set()
    for kind, item, key, cell, X in _points(case, scene):
        given = getattr(item, key)
        for value in given if isinstance(given, tuple) else (given,):
            if isinstance(value, Expression) and (place := _undefined(value, X, key in POSITIVE)) is not None:
                at, found = place
                spot = ", ".join(f"{x:.4g}" for x in at)
                named = getattr(item, "name", "")
                where = case.formulas.get((kind, named, key), (case.path, None, f"{kind}.{named}.{key}"))
                file, line, name = where
                wrong.setdefault((where, value.text), Mistake(
                    file, line, name, f"'{value.text}' has no value that can be computed with at ({spot}) um "
                                      f"from the centre of '{case.cells[cell].name}': it is {found:g} there"))
    for kind in ("supports", "loads", "plates"):
        for item in getattr(case, kind):
            if item.load_curve not in checked and (time := _undefined_time(item.load_curve, case.time.end)) is not None:
                wrong[kind, item.name] = Mistake(case.path, None, f"{kind}.{item.name}.load_curve",
                                                 f"has no finite value and rate at {time:.4g} us")
            checked.add(item.load_curve)
    wrong |= _inside_out(case, scene) if not wrong else {}
    wrong |= {(kind, name): Mistake(case.path, None, f"{kind}.{name}.{key}", message)
              for kind, name, key, message in _nowhere(case, scene)}
    if wrong:
        raise CaseError(wrong.values())


def _inside_out(case: Case, scene: Scene) -> dict[Any, Mistake]:
    """Initial displacements that turn particles inside out, by the place of their key."""
    wrong: dict[Any, Mistake] = {}
    seen = set()
    for number, cell in enumerate(case.cells):
        one = int(scene.kind[number]), cell.displacement
        if one in seen or not any(isinstance(value, Expression) for value in cell.displacement):
            continue
        seen.add(one)
        t = scene.templates[one[0]]
        u = np.column_stack([evaluate(value, t.X) for value in cell.displacement])
        J = np.linalg.det(np.eye(len(t.G)) + np.stack([g @ u for g in t.G], axis=2))
        worst = int(np.argmin(J))
        if not J[worst] > 0.0:
            file, line, key = where = case.formulas.get(("cells", cell.name, "displacement"),
                                                        (case.path, None, f"cells.{cell.name}.displacement"))
            spot = ", ".join(f"{x:.4g}" for x in t.X[worst])
            wrong[where] = Mistake(file, line, key, f"turns '{cell.name}' inside out at ({spot}) um from its centre: "
                                   f"J = {J[worst]:.3g} there, which is to be positive; a gentler displacement, or "
                                   "finer particles where it varies within a spacing, keeps it so")
    return wrong


def _nowhere(case: Case, scene: Scene) -> Iterator[tuple[str, str, str, str]]:
    """Kind, name, key and message of supports, loads and probes that are nowhere on their cells."""
    who = numbers_of(case)
    for kind in ("supports", "loads", "probes"):
        for item in getattr(case, kind):
            numbers = cells_of(item, who)
            names = " and ".join(f"'{case.cells[n].name}'" for n in numbers)
            if (point := getattr(item, "point", None)) is not None:
                t = scene.templates[scene.kind[numbers[0]]]
                away = float(np.linalg.norm(t.X - point, axis=1).min())
                if away > t.spacing:
                    yield kind, item.name, "point", (f"is outside of '{case.cells[numbers[0]].name}', whose nearest "
                                                     f"particle is {away:.3g} um from there; a point is given from the "
                                                     "cell's centre")
            elif getattr(item, "body", None) is None:
                on = particles_of if kind == "supports" else facets_of
                if item.box and not any(len(on(item, scene, n)) for n in numbers):
                    yield kind, item.name, "box", (f"holds no {'particle' if kind == 'supports' else 'whole piece'} of "
                                                   f"the surface of {names}; a box is given from the cell's centre")


def _points(case: Case, scene: Scene) -> Iterator[tuple[str, Any, str, int, np.ndarray]]:
    """Kind, item, key, cell, and the points (n, d) [µm] from its centre at which the key is evaluated."""
    seen = set()
    for number, cell in enumerate(case.cells):
        for key in ("displacement", "velocity", "relative_stiffness"):
            if (one := (int(scene.kind[number]), getattr(cell, key))) not in seen:
                seen.add(one)
                yield "cells", cell, key, number, scene.templates[one[0]].X
        if case.director is not None:
            yield "director", case.director, "direction", number, scene.templates[scene.kind[number]].X
    who = numbers_of(case)
    for kind in ("supports", "loads"):
        for item in getattr(case, kind):
            for number in sorted(cells_of(item, who)):
                X = scene.templates[scene.kind[number]].X
                if kind == "supports":
                    yield kind, item, "displacement", number, X[particles_of(item, scene, number)]
                elif item.body is not None:
                    yield kind, item, "body", number, X
                else:
                    corners = X[facets_of(item, scene, number)]
                    yield kind, item, "pressure", number, corners.mean(axis=1)
                    yield kind, item, "traction", number, np.concatenate(
                        [np.einsum("i,eid->ed", shares, corners) for shares, _ in points_on(corners)])


def _undefined(value: Expression, X: np.ndarray, positive: bool) -> tuple[list[float], float] | None:
    """The first of the points X (n, d) at which a formula has no finite value, or no positive one where it should be,
    and its value there.
    """
    size = np.ptp(X, axis=0).max() if len(X) else 0.0
    for points in (X, np.where(np.abs(X) < TINY * size, 0.0, X)):
        found = evaluate(value, points)
        bad = np.flatnonzero(~(np.abs(found) <= LARGEST) | (positive & (found <= 0.0)))
        if len(bad):
            return points[bad[0]].tolist(), float(found[bad[0]])
    return None


@np.errstate(all="ignore")
def _undefined_time(curve: LoadCurve, end: float) -> float | None:
    """The first time [µs] at which a load curve or one of its derivatives is not finite."""
    times = np.linspace(0.0, end, TIMES)
    for t in times.tolist():
        values = [float(of(t)) for of in (curve.value, curve.rate, curve.acceleration)]
        if not np.isfinite(values).all():
            return t
    return None
