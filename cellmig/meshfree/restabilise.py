"""Viscous stabilisation made for the positions as they are: the same neighbours, their distances of now."""

from __future__ import annotations

from typing import Any

import numpy as np

from .body import Scene
from .rows import Numbering, stabilisation_places

STRAIN = 0.2  # change of a squared distance since the stabilisation was made at which it is made anew [-]


class Restabilised:
    """The matrix S of `stabilisation`, for the owned rows of a rank, in the blocks that kernel.c reads.

    Along a stretch λ former neighbours are λ times as far apart.  With their distances at the start it resists waves of
    a given length λ⁴ times as much, with those of now λ² times, as neighbours of now with a spacing of λ h would.
    Sums run by global id over the same numbers on any number of ranks.
    """

    def __init__(self, scene: Scene, numbering: Numbering, kernel: Any):
        """Lay out the entries and fill them for the reference configuration."""
        ids = numbering.ids[: numbering.n_rows]
        self._rows = np.argsort(ids, kind="stable")  # by global id
        self._around, self._there = _neighbours(scene, numbering, ids[self._rows])
        count = np.maximum(self._there.sum(axis=1), 1)
        self._weight = (scene.field("stabilising")[ids] * scene.field("V")[ids])[self._rows] / count
        self._inverse_mass = 1.0 / scene.field("mass")[numbering.ids[: numbering.n_owned]]
        self._kernel, self._n_owned = kernel, numbering.n_owned
        places = stabilisation_places(scene, numbering)
        for name in ("first_outer", "column_outer", "outer"):
            kernel[name] = places[name]
        self._row, self._place, self._diagonal = places["row"], places["place"], places["diagonal"]
        self._lay_out(places["row"], places["col"])
        self._made_for: np.ndarray | None = None

    def _lay_out(self, row: np.ndarray, col: np.ndarray) -> None:
        """For every contribution of a particle I, (J, K), (J, I) and (I, K), the entry that it adds to, if any."""
        n, wide = self._around.shape
        size = int(max(self._around.max(initial=0), self._rows.max(initial=0))) + 1
        key = row.astype(np.int64) * size + col
        order = np.argsort(key)
        members = np.column_stack([self._around, self._rows])
        there = np.column_stack([self._there, np.ones(n, bool)])
        wanted = members[:, :, None].astype(np.int64) * size + members[:, None, :]
        use = there[:, :, None] & there[:, None, :] & ~np.eye(wide + 1, dtype=bool)
        use &= members[:, :, None] < self._n_owned
        self._use = np.flatnonzero(use.ravel())
        self._entry = order[np.searchsorted(key, wanted.ravel()[self._use], sorter=order)]

    def _distances(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        d = x[self._around] - x[self._rows][:, None]
        return d, np.where(self._there, d[..., 0] ** 2 + d[..., 1] ** 2, 1.0)

    def strain(self, x: np.ndarray) -> float:
        """Largest relative change of a squared distance on this rank since S was made; x (n_local, 2) [µm]."""
        with np.errstate(all="ignore"):  # positions may be infinite where a run breaks
            return float(np.abs(self._distances(x)[1] / self._made_for - 1.0).max(initial=0.0))

    def make(self, x: np.ndarray) -> float:
        """S for the positions x (n_local, 2) [µm]; returns this rank's largest Σ_K |S_JK| / m_J [1/µs]."""
        d, square = self._distances(x)
        self._made_for = square
        w = np.where(self._there, self._weight[:, None] / square, 0.0)
        a, b, c = ((w * d[..., i] * d[..., j]).sum(axis=1) for i, j in ((0, 0), (1, 1), (0, 1)))
        det = a * b - c * c
        det = np.where(det > 0.0, det, 1.0)
        p, q = w * d[..., 0], w * d[..., 1]

        def product(u: np.ndarray, v: np.ndarray) -> np.ndarray:
            return u[:, :, None] * v[:, None, :]

        inverse = [m[:, None, None] for m in (b / det, a / det, -c / det)]
        linear = inverse[0] * product(p, p) + inverse[1] * product(q, q) + inverse[2] * (product(p, q) + product(q, p))
        n, wide = w.shape
        whole = np.zeros((n, wide + 1, wide + 1))
        whole[:, :wide, :wide] = -linear
        whole[:, np.arange(wide), np.arange(wide)] += w
        whole[:, :wide, wide] = whole[:, wide, :wide] = -whole[:, :wide, :wide].sum(axis=2)
        values = np.bincount(self._entry, whole.ravel()[self._use], len(self._row))
        rest = np.bincount(self._row, values, self._n_owned)
        values[self._diagonal] = -rest
        inner, outer = self._kernel["gradient"].reshape(-1), self._kernel["outer"].reshape(-1)
        within = self._place < len(inner)
        inner[self._place[within]] = values[within]
        outer[self._place[~within] - len(inner)] = values[~within]
        size = np.bincount(self._row, np.abs(values), self._n_owned)
        return float((size * self._inverse_mass).max(initial=0.0))


def _neighbours(scene: Scene, numbering: Numbering, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Local numbers of the neighbours of particles (n, most), by global id, and which of them there are.

    Where there are fewer than the most of the scene, the particle itself stands in: no sum depends on the rank.
    """
    lists = [_padded(t.edges, len(t.X)) for t in scene.templates]
    most = max(a.shape[1] for a in lists)
    around, there = np.tile(ids[:, None], (1, most)), np.zeros((len(ids), most), bool)
    for c in np.unique(scene.cell[ids]):
        on = np.flatnonzero(scene.cell[ids] == c)
        found = lists[scene.kind[c]][ids[on] - scene.offset[c]]
        there[on[:, None], np.arange(found.shape[1])] = found >= 0
        around[on[:, None], np.arange(found.shape[1])] = np.where(found >= 0, found + scene.offset[c], ids[on][:, None])
    return numbering.local(around), there


def _padded(edges: np.ndarray, n: int) -> np.ndarray:
    """Neighbours of each particle in ascending order (n, most), -1 where there are fewer."""
    both = np.concatenate([edges, edges[:, ::-1]])
    both = both[np.lexsort((both[:, 1], both[:, 0]))]
    count = np.bincount(both[:, 0], minlength=n)
    start = np.concatenate([[0], np.cumsum(count)])[:-1]
    out = np.full((n, count.max(initial=1)), -1)
    out[both[:, 0], np.arange(len(both)) - start[both[:, 0]]] = both[:, 1]
    return out
