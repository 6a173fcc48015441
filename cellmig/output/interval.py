"""Means between rows of the tables: velocities, and forces on the substrate and between cells."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..parallel.reduce import exact_sum
from .view import View

Rows = list[dict[str, float]]


class Interval:
    """Means over the time since the last row, as single forces oscillate whenever a bond closes.

    time : of the last row [µs];  moved : displacements then, of the aggregate and of each cell [µm];  width : of the
    intervals of the substrate [µm].
    """

    def __init__(self, mechanics: View):
        """Begin without a row."""
        self.mechanics = mechanics
        self.time, self.moved = -np.inf, list[tuple[float, ...]]()
        self.width = max(t.spacing for t in mechanics.scene.templates)

    def next(self, time: float, rows: Rows, half: float, powers: Mapping[str, np.ndarray]) -> dict[str, Rows]:
        """Rows of substrate.csv and neighbours.csv at a time [µs]; adds velocities to those of history; collective.

        Impulses of leapfrog end `half` a step [µs] before `time`; the current forces, in `powers`, complete them.
        """
        m, elapsed = self.mechanics, time - self.time
        for row, before in zip(rows, self.moved, strict=False):
            v = [(row[f"u{axis}_um"] - place) / elapsed for axis, place in zip("xyz", before, strict=False)]
            row |= {f"v{axis}_um_per_us": one for axis, one in zip("xyz", v, strict=False)}
            row |= {"speed_um_per_us": math.hypot(*v)}
        # The first row has no means: its columns are nan in the table.
        self._kinds = ("", "_now") if self.moved else ("_now",)
        self.time, self.moved = time, [tuple(row[f"u{axis}_um"] for axis in "xyz"[: m.scene.dimension]) for row in rows]
        found: dict[str, Rows] = {}
        if (m.terms.substrate is None and m.terms.contact is None) or m.scene.dimension > 2:
            return found  # in space impulses are summed from the start
        counted = m.accounts.impulses
        bond, contact = (half * powers[name] for name in ("bond_impulse", "contact_impulse"))
        if m.terms.substrate is not None:
            mean = counted.of_surface(counted.bond + bond) / elapsed
            found["substrate"] = self._substrate(mean, counted.of_surface(powers["bond_impulse"]))
        if m.terms.contact is not None:
            mean = (counted.contact + contact) / elapsed
            found["neighbours"] = self._neighbours(mean, powers["contact_impulse"], rows)
        counted.begin(m.segments.own_places()[:, 0], -bond, -contact)
        return found

    def _substrate(self, mean: np.ndarray, now: np.ndarray) -> Rows:
        """Rows of traction by cell and place, from forces (n, 3) [pN/µm] of the substrate on particles; collective.

        The mean force on a particle is distributed over its path since the last row.
        """
        m, w, counted = self.mechanics, self.width, self.mechanics.accounts.impulses
        x, cell = m.segments.own_places()[:, 0], m.surfaces.cell[counted.mine]
        parts = []
        for values, start, columns in ((mean, counted.place, slice(0, 3)), (now, x, slice(3, 6))):
            on = np.flatnonzero((values != 0.0).any(axis=1))
            particle, place, share = spread(np.minimum(start, x)[on] - 0.5 * w, np.maximum(start, x)[on] + 0.5 * w, w)
            forces = np.zeros((len(particle), 6))
            forces[:, columns] = -share[:, None] * values[on][particle]
            parts.append((cell[on][particle], place, forces))
        cell, place, forces = (np.concatenate(part) for part in zip(*parts, strict=True))
        keys, sums = self._sums(np.column_stack([cell, place]), forces)
        rows = []
        for (c, k), force in zip(keys.tolist(), (sums / w).tolist(), strict=True):
            row = {"cell": c + 1, "x_um": (k + 0.5) * w}
            for kind in self._kinds:
                normal, drag, push = force[3:] if kind else force[:3]
                row |= {f"normal{kind}_pa": normal, f"tangential{kind}_pa": drag + push}
                if m.terms.friction is not None:
                    row[f"friction{kind}_pa"] = drag
            rows.append(row)
        return rows

    def _neighbours(self, mean: np.ndarray, now: np.ndarray, cells: Rows) -> Rows:
        """Rows of forces between pairs of cells, from forces (slots, 2) [pN/µm] on particles by cells; collective."""
        m, counted = self.mechanics, self.mechanics.accounts.impulses
        values, key = np.hstack([mean, now])[1:], counted.key[1:]
        cell, other = m.surfaces.cell[key // counted.cells], key % counted.cells
        on = (values != 0.0).any(axis=1) & (cell < other)  # the forces on the second cell of a pair are opposite
        keys, sums = self._sums(np.column_stack([cell, other])[on], values[on])
        rows = []
        for (a, b), force in zip(keys.tolist(), sums.tolist(), strict=True):
            apart = [cells[b + 1][name] - cells[a + 1][name] for name in ("x_um", "y_um")]
            row: dict[str, float] = {"cell": a + 1, "neighbour": b + 1}
            for kind in self._kinds:
                x, y = force[2:] if kind else force[:2]
                row |= {f"force_x{kind}_pn_per_um": x, f"force_y{kind}_pn_per_um": y,
                        f"pull{kind}_pn_per_um": (x * apart[0] + y * apart[1]) / math.hypot(*apart)}
            rows.append(row)
        return rows

    def _sums(self, keys: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distinct keys (g, 2) int of all ranks, ascending, and sums (g, c) of values by keys (k, 2); collective."""
        comm = self.mechanics.comm
        every = np.unique(np.concatenate(comm.allgather(np.unique(keys, axis=0))), axis=0)
        number = {tuple(key): i for i, key in enumerate(every.tolist())}
        group = np.array([number[tuple(key)] for key in keys.tolist()], np.intp)
        return every, exact_sum(comm, values, group, len(every))

    def saved(self) -> dict[str, Any]:
        """Time and displacements of the last row, for a checkpoint; impulses are saved with the mechanics."""
        return {"time": self.time, "moved": self.moved}

    def restore(self, about: dict[str, Any]) -> None:
        """Set the state from `about`, which `saved` returned."""
        self.time, self.moved = about["time"], about["moved"]  # Python's JSON has -inf


def spread(low: np.ndarray, high: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distribute ranges from low to high (n,) [µm] over intervals of a width [µm], number k from k to k + 1 widths.

    Returns arrays (parts,): number of the range, number of the interval, share of the range [-], whose sum is 1.
    """
    first, last = (np.floor(ends / width).astype(np.int64) for ends in (low, high))
    count = last - first + 1
    number = np.repeat(np.arange(len(low)), count)
    piece = first[number] + np.arange(len(number)) - np.repeat(np.cumsum(count) - count, count)
    ends = np.minimum(high[number], (piece + 1) * width) - np.maximum(low[number], piece * width)
    return number, piece, ends / (high - low)[number]
