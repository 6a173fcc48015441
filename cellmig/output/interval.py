"""Means between rows of the tables: velocities, and forces on the substrate and between cells."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..parallel.reduce import exact_sums
from .tables import ALONG, FORCE, MEASURES
from .view import View

Rows = list[dict[str, float]]


class Interval:
    """Means over the time since the last row, as single forces oscillate whenever a bond closes.

    time : of the last row [µs];  moved : displacements then, of the aggregate and of each cell [µm];  width : of the
    intervals of the substrate, in space of its squares [µm].
    """

    def __init__(self, mechanics: View):
        """Begin without a row."""
        self.mechanics = mechanics
        self.time, self.moved = -np.inf, list[tuple[float, ...]]()
        self.width = max(t.spacing for t in mechanics.scene.templates)

    def next(self, time: float, rows: Rows, half: float, powers: Mapping[str, np.ndarray],
             contacts: tuple[np.ndarray, np.ndarray]) -> dict[str, Rows]:
        """Rows of substrate.csv and neighbours.csv at a time [µs], on rank 0; collective.

        Adds velocities and numbers of neighbours to `rows` of history, which other ranks need not have.

        Impulses of leapfrog end `half` a step [µs] before `time`; the current forces, in `powers`, complete them.
        `contacts` : of each facet of this rank near another cell both cells (k, 2) int, and how much of it touches (k,)
        [µm, in space µm²].
        """
        m, elapsed = self.mechanics, time - self.time
        for row, before in zip(rows, self.moved, strict=False):
            v = [(row[f"u{axis}_um"] - place) / elapsed for axis, place in zip("xyz", before, strict=False)]
            row |= {f"v{axis}_um_per_us": one for axis, one in zip("xyz", v, strict=False)}
            row |= {"speed_um_per_us": math.hypot(*v)}
        # The first row has no means: its columns are nan in the table.
        self._kinds = ("", "_now") if math.isfinite(self.time) else ("_now",)
        self.time, self.moved = time, [tuple(row[f"u{axis}_um"] for axis in "xyz"[: m.scene.dimension]) for row in rows]
        found: dict[str, Rows] = {}
        if m.terms.substrate is None and m.terms.contact is None:
            return found
        counted = m.accounts.impulses
        bond, contact = (half * powers[name] for name in ("bond_impulse", "contact_impulse"))
        if m.terms.substrate is not None:
            mean = counted.of_surface(counted.bond + bond) / elapsed
            found["substrate"] = self._substrate(mean, counted.of_surface(powers["bond_impulse"]))
        if m.terms.contact is not None:
            mean = (counted.contact + contact) / elapsed
            found["neighbours"] = self._neighbours(mean, powers["contact_impulse"], contacts, rows)
            if rows:
                _count_neighbours(rows, found["neighbours"], MEASURES[m.scene.dimension][1])
        counted.begin(m.segments.own_places()[:, :-1], -bond, -contact)
        return found

    def _substrate(self, mean: np.ndarray, now: np.ndarray) -> Rows:
        """Rows of traction by cell and place, from forces (n, 2 d - 1) [pN/µm] of the substrate on particles.

        The mean force on a particle is distributed over its path since the last row, in space over the rectangle around
        it.  Collective.
        """
        m, w, counted = self.mechanics, self.width, self.mechanics.accounts.impulses
        x, cell = m.segments.own_places()[:, :-1], m.surfaces.cell[counted.mine]
        d, each, parts = m.scene.dimension, mean.shape[1], []
        for values, start, columns in ((mean, counted.place, slice(0, each)), (now, x, slice(each, 2 * each))):
            on = np.flatnonzero((values != 0.0).any(axis=1))
            low, high = np.minimum(start, x)[on], np.maximum(start, x)[on]
            particle, place, share = spread(low - 0.5 * w, high + 0.5 * w, w)
            forces = np.zeros((len(particle), 2 * each))
            forces[:, columns] = -share[:, None] * values[on][particle]
            parts.append((cell[on][particle], place, forces))
        cell, place, forces = (np.concatenate(part) for part in zip(*parts, strict=True))
        found, rows = exact_sums(m.comm, forces, np.column_stack([cell, place])), list[dict[str, float]]()
        if found is None:
            return rows
        keys, sums = found
        for (c, *at), force in zip(keys.tolist(), (sums / w ** (d - 1)).tolist(), strict=True):
            row = {"cell": c + 1, **{f"{axis}_um": (k + 0.5) * w for axis, k in zip("xy", at, strict=False)}}
            for kind in self._kinds:
                normal, *along = force[each:] if kind else force[:each]
                row[f"normal{kind}_pa"] = normal
                for axis, drag, push in zip(ALONG[d], along[: d - 1], along[d - 1 :], strict=True):
                    row[f"tangential{axis}{kind}_pa"] = drag + push
                    if m.terms.friction is not None:
                        row[f"friction{axis}{kind}_pa"] = drag
            rows.append(row)
        return rows

    def _neighbours(self, mean: np.ndarray, now: np.ndarray, contacts: tuple[np.ndarray, np.ndarray],
                    cells: Rows) -> Rows:
        """Rows of forces between pairs of cells, from forces (slots, d) [pN/µm] on particles by cells; collective."""
        m, counted, d = self.mechanics, self.mechanics.accounts.impulses, self.mechanics.scene.dimension
        values, key = np.hstack([mean, now])[1:], counted.key[1:]
        pairs = np.column_stack([m.scene.cell_at(key // counted.cells), key % counted.cells])
        # The forces on the second cell of a pair are opposite; a contact has two sides.
        on = (values != 0.0).any(axis=1) & (pairs[:, 0] < pairs[:, 1])
        both, size = contacts
        near = (size > 0.0) & (both[:, 0] != both[:, 1])
        parts = np.pad(values[on], ((0, 0), (0, 1))), np.pad(0.5 * size[near, None], ((0, 0), (2 * d, 0)))
        found = exact_sums(m.comm, np.concatenate(parts), np.concatenate([pairs[on], np.sort(both[near], axis=1)]))
        axes, unit, rows = "xyz"[:d], FORCE[d], list[dict[str, float]]()
        if found is None:
            return rows
        keys, sums = found
        for (a, b), (*force, contact) in zip(keys.tolist(), sums.tolist(), strict=True):
            apart = [cells[b + 1][f"{axis}_um"] - cells[a + 1][f"{axis}_um"] for axis in axes]
            row: dict[str, float] = {"cell": a + 1, "neighbour": b + 1, MEASURES[d][1]: contact}
            for kind in self._kinds:
                f = force[d:] if kind else force[:d]
                row |= {f"force_{axis}{kind}_{unit}": value for axis, value in zip(axes, f, strict=True)}
                pull = sum(one * far for one, far in zip(f, apart, strict=True)) / math.hypot(*apart)
                row[f"pull{kind}_{unit}"] = pull
            rows.append(row)
        return rows

    def saved(self) -> dict[str, Any]:
        """Time and displacements of the last row, for a checkpoint; impulses are saved with the mechanics."""
        return {"time": self.time, "moved": self.moved}

    def restore(self, about: dict[str, Any]) -> None:
        """Set the state from `about`, which `saved` returned."""
        self.time, self.moved = about["time"], about["moved"]  # Python's JSON has -inf


def _count_neighbours(rows: Rows, pairs: Rows, contact: str) -> None:
    """Add to each cell of history the number of cells that touch it, to the aggregate their mean [-]."""
    ends = [pair[end] for pair in pairs if pair[contact] > 0.0 for end in ("cell", "neighbour")]
    count = np.bincount(np.array(ends, int), minlength=len(rows))
    for row, number in zip(rows, [len(ends) / max(1, len(rows) - 1), *count[1:].tolist()], strict=True):
        row["neighbours"] = float(number)


def spread(low: np.ndarray, high: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distribute boxes from low to high (n, k) [µm] over cubes of a width [µm], number i from i to i + 1 widths.

    Returns the numbers of the boxes (parts,), numbers of the cubes along each axis (parts, k), and shares of the boxes
    (parts,) [-], whose sum is 1 for each box.
    """
    number, place, share = np.arange(len(low)), np.zeros((len(low), 0), np.int64), np.ones(len(low))
    for axis in range(low.shape[1]):
        of, piece, part = _along(low[number, axis], high[number, axis], width)
        number, place, share = number[of], np.column_stack([place[of], piece]), share[of] * part
    return number, place, share


def _along(low: np.ndarray, high: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same of ranges (n,) [µm] over intervals, as arrays (parts,)."""
    first, last = (np.floor(ends / width).astype(np.int64) for ends in (low, high))
    count = last - first + 1
    number = np.repeat(np.arange(len(low)), count)
    piece = first[number] + np.arange(len(number)) - np.repeat(np.cumsum(count) - count, count)
    ends = np.minimum(high[number], (piece + 1) * width) - np.maximum(low[number], piece * width)
    return number, piece, ends / (high - low)[number]
