"""What resists rigid motion of a cell: without inertia it has to be there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from .gaps import near
from .schema import Cell, Pair, Support

OUTLINE = 64  # points of an outline, whose bounding box tells whether bodies may touch


def unheld(cells: Sequence[Cell], supports: Sequence[Support], friction: Any, substrate: Any, medium: Any,
           pairs: Sequence[Pair] = ()) -> list[Cell]:
    """The cells that neither a medium, nor friction on the substrate that they rest on, nor supports hold, nor friction
    on bodies that are held.

    friction, substrate, medium : laws, or None.  A support counts for the directions in which it is not free.
    """
    if medium is not None and medium.coefficient:
        return []
    held = {cell.name for cell in cells if _rests(cell, friction, substrate) or supported(cell, supports)}
    ties, before = [*_ties(cells, pairs)], -1
    while ties and before < len(held):
        before = len(held)
        held |= {name for tie in ties if tie & held for name in tie}
    return [cell for cell in cells if cell.name not in held]


def _rests(cell: Cell, friction: Any, substrate: Any) -> bool:
    """Whether bonds to the substrate drag on a cell."""
    law = friction if cell.friction is None else cell.friction
    rubs = law is not None and law.coefficient > 0.0 and substrate is not None and substrate.work > 0.0
    return rubs and cell.centre[-1] + cell.shape.lowest() < substrate.cutoff


def _ties(cells: Sequence[Cell], pairs: Sequence[Pair]) -> Iterator[set[str]]:
    """Names of two cells each that may be within reach of bonds that drag."""
    pairs = [pair for pair in pairs if pair.friction is not None and pair.friction.coefficient and pair.law.work]
    if not pairs:
        return
    outlines = {cell.shape: cell.shape.outline(OUTLINE) for cell in cells}
    centres, reach = np.array([cell.centre for cell in cells]), max(pair.law.cutoff for pair in pairs)
    for i, j in near([outlines[cell.shape] for cell in cells], centres, reach):
        tie = {cells[i].name, cells[j].name}
        if any(tie <= {*pair.cells[0], *pair.cells[1]} for pair in pairs):
            yield tie


def supported(cell: Cell, supports: Sequence[Support]) -> bool:
    """Whether supports hold each direction of a cell."""
    directions = {axis for s in supports if not s.cells or cell.name in s.cells
                  for axis, value in enumerate(s.displacement) if value != "free"}
    return len(directions) == len(cell.centre)
