"""Rows of one rank: its particles and their neighbours, in the blocks of four that kernel.c reads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from .body import Scene, Template


@dataclass(frozen=True)
class Numbering:
    """Local numbers of a rank: owned particles by (material, id), then ghosts of layer 1, then all further ghosts.

    ids : (n_local,) global ids;  n_owned, n_rows : owned, and owned with layer 1, for which stresses are computed.
    """

    ids: np.ndarray
    n_owned: int
    n_rows: int

    def local(self, ids: np.ndarray) -> np.ndarray:
        """Local numbers of global ids; -1 where this rank does not hold them."""
        order = np.argsort(self.ids, kind="stable")
        at = np.minimum(np.searchsorted(self.ids, ids, sorter=order), len(order) - 1)
        found = order[at] if len(order) else np.zeros_like(ids)
        return np.where(self.ids[found] == ids, found, -1) if len(order) else np.full(np.shape(ids), -1)


    def extended(self, ids: np.ndarray) -> Numbering:
        """The same with further ghosts at the end."""
        return Numbering(np.concatenate([self.ids, np.setdiff1d(ids, self.ids)]), self.n_owned, self.n_rows)


def number(scene: Scene, owned: np.ndarray, needed: np.ndarray) -> Numbering:
    """Numbering for the owned ids and what their internal forces need: two layers of neighbours, and `needed` ids."""
    own = np.zeros(scene.size, bool)
    own[owned] = True
    first, second = own.copy(), own.copy()
    for c in np.unique(scene.cell[owned]):
        part = slice(scene.offset[c], scene.offset[c + 1])
        pattern = scene.templates[scene.kind[c]].G
        first[part] = reach(pattern, own[part])
        second[part] = reach(pattern, first[part])
    second[needed] = True

    def by_material(ids: np.ndarray) -> np.ndarray:
        return ids[np.lexsort((ids, scene.material[ids]))]

    layers = [by_material(np.flatnonzero(m)) for m in (own, first & ~own, second & ~first & ~own)]
    return Numbering(np.concatenate(layers), len(layers[0]), len(layers[0]) + len(layers[1]))


def reach(pattern: sparse.csr_matrix, mask: np.ndarray) -> np.ndarray:
    """Particles that are in `mask` or have a neighbour there (n,) bool; the pattern is symmetric."""
    return mask | (abs(pattern) @ mask.astype(float) > 0)


def entries(t: Template) -> tuple[tuple, tuple]:
    """A template's neighbours in CSR: (indptr, indices, G, H, S) on the pattern of G, (indptr, indices, S) outside it.

    H = -Gᵀ: the force on J is the sum over I of V P of I times H_JI.
    """
    G = t.G
    H = -G.T.tocsr()
    H.sort_indices()
    if not np.array_equal(H.indices, G.indices):
        raise AssertionError("the neighbours are not symmetric")
    rows = np.repeat(np.arange(G.shape[0]), np.diff(G.indptr))
    inner = np.asarray(t.S[rows, G.indices]).ravel()
    S = t.S.tocoo()
    n = np.int64(G.shape[0])
    outside = ~np.isin(S.row * n + S.col, rows * n + G.indices)
    outer = sparse.csr_matrix((S.data[outside], (S.row[outside], S.col[outside])), S.shape)
    outer.sort_indices()
    return (G.indptr, G.indices, G.data, H.data, inner), (outer.indptr, outer.indices, outer.data)


def blocks(scene: Scene, numbering: Numbering, stabilised: bool) -> dict[str, np.ndarray]:
    """Arrays `first, column, gradient, adjoint` of the kernel for a rank's rows.

    If `stabilised`, S is in `gradient` where its pattern is that of G, else in `first_outer, column_outer, outer`.
    """
    n_rows, n_owned = numbering.n_rows, numbering.n_owned
    row_ids = numbering.ids[:n_rows]
    kinds = [entries(t) for t in scene.templates]
    place = np.full(scene.size, -1)
    place[numbering.ids] = np.arange(len(numbering.ids))

    inner, outer = [], []
    for c in np.unique(scene.cell[row_ids]) if n_rows else []:
        rows = np.flatnonzero(scene.cell[row_ids] == c)
        local = row_ids[rows] - scene.offset[c]
        (ptr, idx, G, H, S), (optr, oidx, oS) = kinds[scene.kind[c]]
        r, e = _expand(ptr, local)
        keep = rows[r] < n_owned  # only owned rows are stabilised and assembled
        inner.append((rows[r], place[idx[e] + scene.offset[c]], G[e], np.where(keep, H[e], 0), np.where(keep, S[e], 0)))
        r, e = _expand(optr, local[rows < n_owned])
        outer.append((rows[rows < n_owned][r], place[oidx[e] + scene.offset[c]], oS[e]))

    n_blocks = -(-n_rows // 4)
    out: dict[str, np.ndarray] = {}
    row, col, G, H, S = _joined(inner, 5)
    out["first"], group, lane = _slots(row, n_blocks)
    out["column"] = _columns(out["first"], group, lane, col, n_rows)
    pair = 4 * (lane // 2) + lane % 2
    gradient, adjoint = np.zeros((out["first"][-1], 12 if stabilised else 8)), np.zeros((out["first"][-1], 8))
    gradient[group, pair], gradient[group, pair + 2] = G.real, G.imag
    adjoint[group, pair], adjoint[group, pair + 2] = H.real, H.imag
    out["gradient"], out["adjoint"] = gradient, adjoint
    if not stabilised:
        return out
    gradient[group, 8 + _STAB_LANE[lane]] = S.real
    row, col, S = _joined(outer, 3)
    out["first_outer"], group, lane = _slots(row, n_blocks)
    out["column_outer"] = _columns(out["first_outer"], group, lane, col, n_rows)
    out["outer"] = np.zeros((out["first_outer"][-1], 4))
    out["outer"][group, _STAB_LANE[lane]] = S.real
    return out


_STAB_LANE = np.array([0, 2, 1, 3])  # so that one shuffle doubles two of them


def _expand(ptr: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For CSR rows: position in `rows` and index of every entry, in order."""
    count = ptr[rows + 1] - ptr[rows]
    which = np.repeat(np.arange(len(rows)), count)
    begin = np.repeat(ptr[rows] - (np.cumsum(count) - count), count)
    return which, begin + np.arange(count.sum())


def _joined(parts: list, n: int) -> list[np.ndarray]:
    """Entries of all cells, sorted by row; within a row they keep their order, which is that of global ids."""
    if not parts:
        return [np.zeros(0, int)] * 2 + [np.zeros(0)] * (n - 2)
    joined = [np.concatenate([p[i] for p in parts]) for i in range(n)]
    order = np.argsort(joined[0], kind="stable")
    return [a[order] for a in joined]


def _slots(row: np.ndarray, n_blocks: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First group of each block (n_blocks + 1,), and the group and lane of every entry."""
    count = np.bincount(row, minlength=4 * n_blocks)
    start = np.concatenate([[0], np.cumsum(count)])
    first = np.concatenate([[0], np.cumsum(count.reshape(-1, 4).max(axis=1))]).astype(np.int64)
    return first, first[row // 4] + np.arange(len(row)) - start[row], row % 4


def _columns(first: np.ndarray, group: np.ndarray, lane: np.ndarray, col: np.ndarray, n_rows: int) -> np.ndarray:
    """Four times the neighbours (groups, 4); where a row has too few for its block, the row itself, with zeros."""
    block = np.repeat(np.arange(len(first) - 1), np.diff(first))
    columns = np.minimum(4 * block[:, None] + np.arange(4), max(n_rows - 1, 0))
    columns[group, lane] = col
    return (4 * columns).astype(np.uint32)  # where they stand in fields of four numbers
