"""Rows of one rank: its particles and their neighbours, in the blocks of four that kernel.c reads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from .body import Scene
from .terms import Terms


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


def blocks(scene: Scene, numbering: Numbering, terms: Terms) -> dict[str, np.ndarray]:
    """Arrays of the kernel for a rank's rows, by their names there.

    `first, column, gradient, adjoint` hold G and H = -Gᵀ: the force on J is the sum over I of V P of I times H_JI.  S
    is in `gradient` where its pattern is that of G, else in `…outer`; the elastic stabilisation is in `…stiff`.
    """
    out = gradient_blocks(scene, numbering, terms.stabilised)
    if terms.stabilised:
        rest = [_outside(t.S, t.G) for t in scene.templates]
        out["first_outer"], out["column_outer"], out["outer"] = scalar_blocks(scene, numbering, rest)
    if terms.stiffened:
        stiff = [t.E for t in scene.templates]
        out["first_stiff"], out["column_stiff"], out["stiff"] = scalar_blocks(scene, numbering, stiff)
    return out


def gradient_blocks(scene: Scene, numbering: Numbering, stabilised: bool) -> dict[str, np.ndarray]:
    """Blocks of G and H, and of S on their pattern if `stabilised`, for the rows whose stresses are computed."""
    patterns = [t.G for t in scene.templates]
    row, col, kind, at = _entries(scene, numbering, patterns, numbering.n_rows)
    first, group, lane = _slots(row, -(-numbering.n_rows // 4))
    pair = 4 * (lane // 2) + lane % 2
    gradient, adjoint = np.zeros((first[-1], 12 if stabilised else 8)), np.zeros((first[-1], 8))
    G = _values([t.data for t in patterns], kind, at)
    gradient[group, pair], gradient[group, pair + 2] = G.real, G.imag
    assembled = row < numbering.n_owned  # the others' rows serve for their stress only
    H = np.where(assembled, _values([_adjoint(t) for t in patterns], kind, at), 0)
    adjoint[group, pair], adjoint[group, pair + 2] = H.real, H.imag
    if stabilised:
        S = _values([_inside(t.S, t.G) for t in scene.templates], kind, at)
        gradient[group, 8 + _STAB_LANE[lane]] = np.where(assembled, S, 0)
    return {"first": first, "column": _columns(first, group, lane, col, numbering.n_rows),
            "gradient": gradient, "adjoint": adjoint}


def scalar_blocks(scene: Scene, numbering: Numbering, matrices: list) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Blocks (first, column, values) of scalar matrices, one CSR for each template, for the owned rows."""
    row, col, kind, at = _entries(scene, numbering, matrices, numbering.n_owned)
    first, group, lane = _slots(row, -(-numbering.n_rows // 4))
    values = np.zeros((first[-1], 4))
    values[group, _STAB_LANE[lane]] = _values([m.data for m in matrices], kind, at)
    return first, _columns(first, group, lane, col, numbering.n_rows), values


def csr_rows(scene: Scene, numbering: Numbering, matrices: list, n_rows: int, n_columns: int) -> sparse.csr_matrix:
    """First rows of matrices that couple no more than neighbours, one CSR for each template, in local numbers."""
    row, col, kind, at = _entries(scene, numbering, matrices, n_rows)
    ptr = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=n_rows))])
    return sparse.csr_matrix((_values([m.data for m in matrices], kind, at), col, ptr), (n_rows, n_columns))


_STAB_LANE = np.array([0, 2, 1, 3])  # so that one shuffle doubles two of them


def _adjoint(G: sparse.csr_matrix) -> np.ndarray:
    """-Gᵀ on the pattern of G."""
    H = -G.T.tocsr()
    H.sort_indices()
    if not np.array_equal(H.indices, G.indices):
        raise AssertionError("the neighbours are not symmetric")
    return H.data


def _inside(S: sparse.csr_matrix, G: sparse.csr_matrix) -> np.ndarray:
    """Entries of S on the pattern of G."""
    return np.asarray(S[np.repeat(np.arange(G.shape[0]), np.diff(G.indptr)), G.indices]).ravel()


def _outside(S: sparse.csr_matrix, G: sparse.csr_matrix) -> sparse.csr_matrix:
    """S without its entries on the pattern of G."""
    n, S = np.int64(G.shape[0]), S.tocoo()
    on = np.repeat(np.arange(n), np.diff(G.indptr)) * n + G.indices
    out = ~np.isin(S.row * n + S.col, on)
    rest = sparse.csr_matrix((S.data[out], (S.row[out], S.col[out])), S.shape)
    rest.sort_indices()
    return rest


def _entries(scene: Scene, numbering: Numbering, patterns: list, n_rows: int) -> tuple[np.ndarray, ...]:
    """Entries of the first n_rows rows: row, column (local), template and place in its CSR.

    They ascend by row, and within a row by the global id of the column.
    """
    ids = numbering.ids[:n_rows]
    place = np.full(scene.size, -1)
    place[numbering.ids] = np.arange(len(numbering.ids))
    parts = [np.zeros((4, 0), np.int64)]
    for c in np.unique(scene.cell[ids]):
        rows = np.flatnonzero(scene.cell[ids] == c)
        pattern = patterns[scene.kind[c]]
        which, at = _expand(pattern.indptr, ids[rows] - scene.offset[c])
        column = place[pattern.indices[at] + scene.offset[c]]
        parts.append(np.stack([rows[which], column, np.full_like(at, scene.kind[c]), at]))
    entries = np.concatenate(parts, axis=1)
    return tuple(entries[:, np.argsort(entries[0], kind="stable")])


def _values(data: list[np.ndarray], kind: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Values of entries, from the data of each template."""
    out = np.zeros(len(at), data[0].dtype)
    for k, values in enumerate(data):
        out[kind == k] = values[at[kind == k]]
    return out


def _expand(ptr: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For CSR rows: position in `rows` and index of every entry, in order."""
    count = ptr[rows + 1] - ptr[rows]
    which = np.repeat(np.arange(len(rows)), count)
    begin = np.repeat(ptr[rows] - (np.cumsum(count) - count), count)
    return which, begin + np.arange(count.sum())


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
