"""Pairs of cells whose adhesion differs from that of all others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .schema import Pair

MOST_KINDS = 2000  # kinds of cells that exceptions tell apart


@dataclass(frozen=True)
class Pairing:
    """A number for each two cells, stored for kinds of cells: those of a kind are named together wherever they are.

    Attributes
    ----------
    kind : (cells,) int -- kind of each cell.
    between : (kinds, kinds) int -- number of two cells of these kinds.
    own : (kinds,) int -- number of a cell of this kind and itself.
    """

    kind: np.ndarray
    between: np.ndarray
    own: np.ndarray

    def of(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Number of the cells a (k,) int and b (k,) int, in either order (k,) int."""
        return np.where(a == b, self.own[self.kind[a]], self.between[self.kind[a], self.kind[b]])


class Twice(NamedTuple):
    """Two cells that two exceptions name: numbers of the `first` and the `second`, names of the cells."""

    first: int
    second: int
    cells: tuple[str, str]


def paired(cells: Sequence[str], pairs: Sequence[Pair]) -> tuple[Pairing, list[Twice]]:
    """For each two cells the number of the exception that names them, -1 without; and what is named twice.

    `cells` are the names of all cells.  The first of two exceptions counts.

    Raises ValueError where the exceptions tell too many kinds of cells apart; the message is for the user.
    """
    sides: dict[str, list] = {}
    for number, pair in enumerate(pairs):
        for side, names in enumerate(pair.cells):
            for name in names:
                sides.setdefault(name, []).append((number, side))
    kinds: dict[tuple, int] = {}
    kind = np.array([kinds.setdefault(tuple(sides.get(name, ())), len(kinds)) for name in cells], int)
    if len(kinds) > MOST_KINDS:
        raise ValueError(f"tell {len(kinds)} kinds of cells apart; at most {MOST_KINDS} are possible")
    count = np.bincount(kind, minlength=1)
    members: list[tuple[list[int], list[int]]] = [([], []) for _ in pairs]
    for named, number in kinds.items():
        for pair, side in named:
            members[pair][side].append(number)
    between, own = np.full((len(kinds), len(kinds)), -1), np.full(len(kinds), -1)
    twice = []
    for number, (pair, (left, right)) in enumerate(zip(pairs, members, strict=True)):
        if pair.itself:
            found = _give(own, (np.array(left, int),), number)
        else:
            a, b = (grid.ravel() for grid in np.meshgrid(np.array(left, int), np.array(right, int)))
            apart = (a != b) | (count[a] > 1)  # a kind of one cell has no two
            a, b = a[apart], b[apart]
            found = _give(between, (a, b), number)
            between[b, a] = between[a, b]
        if found is not None:
            first, at = found
            names = [[name for name, k in zip(cells, kind, strict=True) if k == n] for n in at]
            twice.append(Twice(first, number, (names[0][0], names[-1][-1])))
    return Pairing(kind, between, own), twice


def _give(table: np.ndarray, at: tuple, number: int) -> tuple[int, list[int]] | None:
    """Put a number where there is none; the first number that is there already, and where."""
    there = table[at]
    table[at] = np.where(there < 0, number, there)
    taken = np.flatnonzero(there >= 0)
    return (int(there[taken[0]]), sorted(int(index[taken[0]]) for index in at)) if len(taken) else None
