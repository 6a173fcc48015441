"""What resists rigid motion of a cell: without inertia it has to be there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from .schema import Cell, Support


def unheld(cells: Sequence[Cell], supports: Sequence[Support], friction: Any, substrate: Any,
           medium: Any) -> Iterator[Cell]:
    """The cells that neither a medium, nor friction on the substrate that they rest on, nor supports hold.

    friction, substrate, medium : laws, or None.  A support counts for the directions in which it is not free.
    """
    if medium is not None and medium.coefficient:
        return
    for cell in cells:
        law = friction if cell.friction is None else cell.friction
        rubs = law is not None and law.coefficient > 0.0 and substrate is not None and substrate.work > 0.0
        if rubs and cell.centre[-1] + cell.shape.lowest() < substrate.cutoff:
            continue
        if not supported(cell, supports):
            yield cell


def supported(cell: Cell, supports: Sequence[Support]) -> bool:
    """Whether supports hold each direction of a cell."""
    directions = {axis for s in supports if not s.cells or cell.name in s.cells
                  for axis, value in enumerate(s.displacement) if value != "free"}
    return len(directions) == len(cell.centre)
