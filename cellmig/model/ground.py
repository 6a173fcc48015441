"""What varies along the substrate, as fields, and how the push depends on it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..case import units
from ..case.amounts import OF_SUBSTRATE
from ..case.environment import Ground
from ..case.expression import Expression
from ..case.schema import Case
from ..case.values import declared
from .field import FormulaField
from .protocols import Field


def fields_of(case: Case) -> dict[str, Field]:
    """Fields of a case by name, with those of its substrate as "stiffness" [Pa] and "ligand" [-]."""
    found: dict[str, Any] = dict(case.fields)
    for name in OF_SUBSTRATE:
        if (given := getattr(case.ground, name, None)) is not None:
            unit = declared(Ground)[name].metadata["unit"]
            found[name] = case.fields[given] if isinstance(given, str) else _formula(given, unit)
    return found


def _formula(given: float | Expression, unit: str) -> Any:
    """The field of a number or a formula."""
    text = given.text if isinstance(given, Expression) else units.text(given, unit)
    kind: Any = FormulaField
    return kind(formula=Expression(text, unit, 3, True))


def push_factor(ground: Ground | None, fields: Mapping[str, Field], x: np.ndarray, time: float,
                push: Callable[[Any], Any] = np.positive) -> np.ndarray:
    """Factor of the push (m,) [-] at places x (m, d) [µm]: that of the bonds below, times the response to stiffness.

    It is 1 for clutches, too, whose factor belongs to a side of a cell and has a memory.
    fields : those of `fields_of`;  time : float -- [µs];  push : that of a share of the bonds (m,) [-], in any unit; by
    default as large as the share.
    """
    factor, x = np.ones(len(x)), np.column_stack([x[:, :-1], np.zeros(len(x))])  # on the substrate
    if ground is not None and ground.ligand is not None:
        factor *= push(np.minimum(fields["ligand"].value(x, time), 1.0)) / push(1.0)
    if ground is not None and hasattr(ground.response, "factor"):
        factor *= ground.response.factor(fields["stiffness"].value(x, time))
    return factor
