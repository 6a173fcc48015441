"""Layout of a rank's particles and their neighbours in blocks of four, as the kernel reads them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import Any

import numpy as np
from scipy import sparse

from ..meshfree.scene import Particles, Scene
from ..meshfree.terms import Terms


@dataclass(frozen=True)
class Numbering:
    """Local numbers of a rank: owned particles by id, then ghosts of layer 1, then all further ghosts.

    ids : (n_local,) int -- global ids;  n_owned, n_rows : number of owned particles, and with those of layer 1, whose
    stresses are computed;  shared : (n_owned,) bool -- whether other ranks may have ghosts of them.
    """

    ids: np.ndarray
    n_owned: int
    n_rows: int
    shared: np.ndarray

    def local(self, ids: np.ndarray) -> np.ndarray:
        """Local numbers (k, ...) int of global ids (k, ...) int; -1 where this rank does not have the particle."""
        order = self._order
        at = np.minimum(np.searchsorted(self.ids, ids, sorter=order), len(order) - 1)
        found = order[at] if len(order) else np.zeros_like(ids)
        return np.where(self.ids[found] == ids, found, -1) if len(order) else np.full(np.shape(ids), -1)

    @cached_property
    def _order(self) -> np.ndarray:
        return np.argsort(self.ids, kind="stable")

    def extended(self, ids: np.ndarray) -> Numbering:
        """A copy with the particles `ids` (k,) int as further ghosts at the end."""
        return replace(self, ids=np.concatenate([self.ids, np.setdiff1d(ids, self.ids)]))


class Places:
    """Local numbers of particles in a table of the cells of which a rank has any."""

    def __init__(self, scene: Scene, numbering: Numbering):
        """Fill the table."""
        p = scene.particles(numbering.ids)
        self._cells = np.unique(p.cell)
        size = np.diff(scene.offset)[self._cells]
        self._first = np.append(0, np.cumsum(size))
        self._number = np.full(self._first[-1], -1)
        self._number[self.first(p.cell) + p.at] = np.arange(len(p.ids))

    def first(self, cell: np.ndarray) -> np.ndarray:
        """Places (k,) int in the table of the first particles of each `cell` (k,) int, of which the rank has any."""
        return self._first[np.searchsorted(self._cells, cell)]

    def __getitem__(self, at: np.ndarray) -> np.ndarray:
        """Local numbers (k,) int at places (k,) int in the table; -1 where this rank does not have the particle."""
        return self._number[at]

    def of_cell(self, cell: int) -> np.ndarray:
        """Local numbers of the particles of a cell (n,) int; -1 where this rank does not have the particle."""
        at = int(np.searchsorted(self._cells, cell))
        return self._number[self._first[at] : self._first[at + 1]]


def number(scene: Scene, owned: np.ndarray, needed: np.ndarray) -> Numbering:
    """Numbering of `owned` (n,) int, two layers of neighbours for their internal forces, and `needed` (k,) int ids."""
    owned = np.sort(owned)
    cells, begin = np.unique(scene.cell_of(owned), return_index=True)
    several = len(owned) < scene.size
    parts = [_layers(scene, c, some, several) for c, some in zip(cells.tolist(), np.split(owned, begin[1:]),
                                                                 strict=True)]
    first, second, shared = (np.concatenate([owned[:0].astype(of), *some]) for of, some in
                             zip((int, int, bool), zip(*parts, strict=True) if parts else ((), (), ()), strict=True))
    second = np.union1d(second, np.setdiff1d(needed, np.concatenate([owned, first])))
    return Numbering(np.concatenate([owned, first, second]), len(owned), len(owned) + len(first), shared)


def _layers(scene: Scene, cell: int, owned: np.ndarray, several: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of a cell with `owned` (n,) int ids the ids of both layers of neighbours, and which of `owned` may be ghosts of
    other ranks (n,) bool, if there are `several`: those within two layers of theirs, and on the surface, which may
    come into contact.
    """
    start, template = scene.offset[cell], scene.templates[scene.kind[cell]]
    on_surface = np.zeros(len(template.X), bool)
    on_surface[template.surface] = several
    if len(owned) == len(on_surface):
        return owned[:0], owned[:0], on_surface
    near, own = pattern(template.G[0]), np.zeros(len(on_surface), bool)
    own[owned - start] = True
    first = reach(near, own)
    second = reach(near, first)
    shared = on_surface | reach(near, reach(near, ~own))
    return start + np.flatnonzero(first & ~own), start + np.flatnonzero(second & ~first), shared[own]


def pattern(m: sparse.csr_matrix) -> sparse.csr_matrix:
    """Pattern of a CSR matrix, with ones also at entries that are zero."""
    return sparse.csr_matrix((np.ones(len(m.indices)), m.indices, m.indptr), m.shape)


def reach(ones: sparse.csr_matrix, mask: np.ndarray) -> np.ndarray:
    """Particles in `mask` (n,) bool or with a neighbour in it (n,) bool, for a symmetric pattern."""
    return mask | (ones @ mask.astype(float) > 0)


@dataclass(frozen=True)
class Blocks:
    """Rows in blocks of up to four particles of one cell and one material, those of owned particles first.

    table : (b, 5) int -- first row, number of rows, stencil, shift, material: blocks of one stencil have the local
    numbers of its lead's neighbours plus the shift;  n_shared, n_owned : number of blocks with shared particles, which
    are first, and of all blocks of owned particles;  lead : (h,) int -- the first block of each stencil.
    """

    table: np.ndarray
    n_shared: int
    n_owned: int
    lead: np.ndarray

    @cached_property
    def lanes_of(self) -> tuple[np.ndarray, np.ndarray]:
        """Block and lane of every row, (n_rows,) int each."""
        count = self.table[:, 1]
        block = np.repeat(np.arange(len(self.table)), count)
        lane = np.arange(len(block)) - np.repeat(np.cumsum(count) - count, count)
        order = np.argsort(self.table[block, 0] + lane)
        return block[order], lane[order]


def make_blocks(scene: Scene, numbering: Numbering) -> Blocks:
    """Blocks of a rank's rows, in the order in which the kernel takes them: GROUP cells of a kind at a time."""
    ids = numbering.ids[: numbering.n_rows]
    rows = scene.particles(ids)
    cell, material, ghost = rows.cell, rows.material, np.arange(len(ids)) >= numbering.n_owned
    shared = np.append(numbering.shared, np.zeros(ghost.sum(), bool))
    start = np.flatnonzero(_changes(cell, material, ghost))
    length = np.diff(np.append(start, len(ids)))
    count = -(-length // 4)
    within = 4 * (np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count))
    row, lanes = np.repeat(start, count) + within, np.minimum(np.repeat(length, count) - within, 4)
    at, kind = ids[row] - scene.offset[cell[row]], scene.kind[cell[row]]
    lane = np.arange(len(ids)) - np.repeat(row, lanes)
    shape = _mixed(_patterns(scene, numbering) + lane)
    shape = np.add.reduceat(shape, row) if len(row) else shape
    shared = np.logical_or.reduceat(shared, row) if len(row) else np.zeros(0, bool)
    _, number = np.unique(np.column_stack([kind, cell[row]]), axis=0, return_inverse=True)
    order = np.lexsort((number, shape, lanes, at, kind, number // GROUP, ~shared, ghost[row]))
    row, lanes, at, kind, shape = row[order], lanes[order], at[order], kind[order], shape[order]
    at = np.where(ghost[row], -1 - np.arange(len(row)), at)  # those of copies share nothing
    key = np.column_stack([kind, at, lanes, shape])
    _, lead, stencil = np.unique(key, axis=0, return_index=True, return_inverse=True)
    first = np.argsort(lead)  # stencils by their first use
    lead, stencil = lead[first], np.argsort(first)[stencil]
    table = np.column_stack([row, lanes, stencil, row - row[lead[stencil]], material[row]])
    return Blocks(table, int(shared.sum()), int((~ghost[row]).sum()), lead)


GROUP = 3  # cells of a kind that are worked on side by side: coefficients are read once for all of them


def _patterns(scene: Scene, numbering: Numbering) -> np.ndarray:
    """Hash of each row's place in its template, and of its neighbours' local numbers less its own (n_rows,)."""
    out = np.empty(numbering.n_rows, np.int64)
    ids = numbering.ids[: numbering.n_rows]
    own = np.argsort(ids, kind="stable")
    cell = scene.cell_of(ids[own])
    pattern_of, places = lru_cache(lambda k: pattern(scene.templates[k].G[0])), Places(scene, numbering)
    bounds = np.append(np.flatnonzero(np.diff(cell, prepend=-1)), len(cell))
    for c, rows in zip(cell[bounds[:-1]].tolist(), np.split(own, bounds[1:-1]), strict=True):
        at = ids[rows] - scene.offset[c]
        out[rows] = _mixed(at)
        if len(rows) == scene.offset[c + 1] - scene.offset[c] and (np.diff(rows) == 1).all():
            continue  # as in the template
        local = places.of_cell(c)
        near = pattern_of(scene.kind[c])
        row = np.repeat(np.arange(len(local)), np.diff(near.indptr))
        further = local[near.indices] - local[row] - near.indices + row
        hashed = np.where(further, _mixed(_mixed(near.indices) + further), 0)
        out[rows] += np.add.reduceat(hashed, near.indptr[:-1])[at]
    return out


def _mixed(x: np.ndarray) -> np.ndarray:
    """Numbers that look like chance, by what they are made of (Steele, Lea & Flood 2014, SplitMix64)."""
    z = x.astype(np.uint64) + np.uint64(0x9E3779B97F4A7C15)
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        z = (z ^ (z >> np.uint64(shift))) * np.uint64(factor)
    return (z ^ (z >> np.uint64(31))).view(np.int64)


def stencil_arrays(scene: Scene, numbering: Numbering, blocks: Blocks, terms: Terms) -> dict[str, np.ndarray]:
    """Coefficients by stencil, (stencils, 4) and (groups, k), with the kernel's names and units.

    `first, column, gradient, adjoint` contain G and H, which is -Gᵀ: the force on J is the sum over I of V P of I times
    H_JI.  `laplacian` and `bending` contain C and -Cᵀ, whose entries come first.
    """
    stencils, D = Stencils(scene, numbering, blocks), len(scene.templates[0].G)
    parts = [[t.G[k] for t in scene.templates] for k in range(D)]
    parts.append([_on_pattern(t.C, t.G[0]) for t in scene.templates])
    extended: Any = list
    if terms.single:
        parts = [[rounded(m) for m in part] for part in parts]
        extended = partial(map, with_rest)
    adjoints = [list(extended(map(_adjoint, part))) for part in parts]
    parts = [list(extended(part)) for part in parts]
    bends, turns = terms.stabilised or terms.stiffened, D == 3 and terms.director != "none"
    fields = {"volume": "V", "bulk_damping": "damping"}
    fields |= {name: name for name in ("viscosity", "shear_modulus", "dilation_modulus")}
    fields |= {name: name for name in ("bending_weight", "bending_modulus") if bends}
    fields |= {name: name for name in ("director_modulus",) if turns}
    fields |= {"grade": "grades"} if terms.graded else {}
    out = {name: stencils.by_lane(stencils.particles.field(attribute)) for name, attribute in fields.items()}
    out["per_mass"] = stencils.by_lane(1.0 / stencils.particles.field("mass"))
    return out | (_plane if D == 2 else _space)(stencils, parts, adjoints, bends or turns)


def _plane(stencils: Stencils, parts: list, adjoints: list, bends: bool) -> dict[str, np.ndarray]:
    """Coefficients in groups of a neighbour to each lane, those with Laplacians first."""
    D = len(parts) - 1
    first, near, group, lane, owned, kind, at, column = stencils.entries(parts[-1], adjoints[-1])
    pair = 4 * (lane // 2) + lane % 2
    gradient, adjoint = np.zeros((2, first[-1], 8))
    for k in range(D):
        gradient[group, pair + 2 * k] = _values(parts[k], kind, at)  # of ghosts only stresses count:
        adjoint[group, pair + 2 * k] = np.where(owned, _values(adjoints[k], kind, at), 0)
    out = {"first": first, "column": column, "gradient": gradient, "adjoint": adjoint}
    if bends:
        first_C = np.append(0, np.cumsum(near))
        stencil = np.repeat(np.arange(len(near)), np.diff(first))[group]
        close = group - first[stencil] < near[stencil]
        group, lane, owned, kind, at = (a[close] for a in (group + (first_C - first)[stencil], lane, owned, kind, at))
        laplacian, bending = np.zeros((2, first_C[-1], 4))
        laplacian[group, _TWICE_LANE[lane]] = _values(parts[D], kind, at)
        bending[group, _TWICE_LANE[lane]] = np.where(owned, _values(adjoints[D], kind, at), 0)
        out |= {"first_laplacian": first_C, "laplacian": laplacian, "bending": bending}
    return out


def _space(stencils: Stencils, parts: list, adjoints: list, bends: bool) -> dict[str, np.ndarray]:
    """Coefficients in groups of a neighbour to each lane, its G and C together."""
    first, _, group, lane, owned, kind, at, column = stencils.entries(parts[0], adjoints[0])
    gradient, adjoint = np.zeros((2, first[-1], 4, len(parts)))
    for k in range(len(parts) if bends else len(parts) - 1):
        gradient[group, lane, k] = _values(parts[k], kind, at)  # of ghosts only stresses count:
        adjoint[group, lane, k] = np.where(owned, _values(adjoints[k], kind, at), 0)
    return {"first": first, "column": column, "gradient": gradient, "adjoint": adjoint}


def _on_pattern(m: sparse.csr_matrix, wider: sparse.csr_matrix) -> sparse.csr_matrix:
    """A CSR matrix on the pattern of a wider one, with zeros where it has no entries."""
    found = [np.repeat(np.arange(a.shape[0]), np.diff(a.indptr)) * a.shape[1] + a.indices for a in (wider, m)]
    data = np.zeros(wider.nnz)
    data[np.searchsorted(*found)] = m.data
    return sparse.csr_matrix((data, wider.indices, wider.indptr), wider.shape)


class Stencils:
    """Representative particles of the lanes of stencils, and the entries of their rows."""

    def __init__(self, scene: Scene, numbering: Numbering, blocks: Blocks):
        """Choose a particle for each lane of each stencil."""
        row, lanes = blocks.table[blocks.lead, :2].T
        self._stencil, self._lane = _expand(np.append(0, np.cumsum(lanes)), np.arange(len(lanes)))
        self._lane -= (np.cumsum(lanes) - lanes)[self._stencil]
        number = row[self._stencil] + self._lane
        self.particles, self._count = scene.particles(numbering.ids[number]), len(lanes)
        self._owned = row[self._stencil] < numbering.n_owned
        self._places, self._stride = Places(scene, numbering), 2 * scene.dimension
        self._first = self._places.first(self.particles.cell)
        self._lead = np.flatnonzero(self._lane == 0)
        self._itself = number[self._lead]

    def by_lane(self, values: np.ndarray) -> np.ndarray:
        """Values by lane (stencils, 4) of `values` of the `particles` (n,) in any unit; zero in empty lanes."""
        out = np.zeros((self._count, 4))
        out[self._stencil, self._lane] = values
        return out

    def entries(self, matrices: list, adjoints: list) -> tuple[np.ndarray, ...]:
        """Entries of CSR matrices, one for each template, in groups of a neighbour to each lane of a stencil.

        Returns the first group of each stencil (stencils + 1,) int; the number of those with entries that are not zero,
        there or in the `adjoints` of the same pattern, (stencils,) int; group, lane, whether owned, template and place
        in its CSR of each entry, (k,) int; 2 d times the neighbours (groups, 4) int.  Entries of a lane ascend by id,
        first those that are not zero.
        """
        lanes, at = _rows_of(matrices, self.particles)
        kind = self.particles.kind[lanes]
        close = (_values(matrices, kind, at) != 0.0) | (_values(adjoints, kind, at) != 0.0)
        order = np.lexsort((~close, lanes))  # stable
        at, kind, close = at[order], kind[order], close[order]
        columns = _values(matrices, kind, at, "indices")
        count = np.bincount(lanes, minlength=len(self._lane))
        longest, near = (np.maximum.reduceat(n, self._lead) if len(n) else n
                         for n in (count, np.bincount(lanes[close], minlength=len(self._lane))))
        first, stencil = np.append(0, np.cumsum(longest)), self._stencil[lanes]
        group = first[stencil] + np.arange(len(at)) - np.repeat(np.cumsum(count) - count, count)
        lane = self._lane[lanes]
        neighbours = np.repeat(self._itself, longest)[:, None].repeat(4, axis=1)
        neighbours[group, lane] = self._places[self._first[lanes] + columns]
        return first, near, group, lane, self._owned[lanes], kind, at, (self._stride * neighbours).astype(np.uint32)


def csr_rows(scene: Scene, numbering: Numbering, matrices: list, n_rows: int, n_columns: int) -> sparse.csr_matrix:
    """First rows of matrices that couple no more than neighbours, one CSR for each template, in local numbers."""
    rows, places = scene.particles(numbering.ids[:n_rows]), Places(scene, numbering)
    row, at = _rows_of(matrices, rows)
    kind, ptr = rows.kind[row], np.concatenate([[0], np.cumsum(np.bincount(row, minlength=n_rows))])
    columns = places[places.first(rows.cell)[row] + _values(matrices, kind, at, "indices")]
    return sparse.csr_matrix((_values(matrices, kind, at), columns, ptr), (n_rows, n_columns))


_TWICE_LANE = np.array([0, 2, 1, 3])  # so that one shuffle doubles two of them


def rounded(m: sparse.csr_matrix) -> sparse.csr_matrix:
    """A matrix in single precision, but for the diagonal: that makes rows sum to zero, for motions as a whole."""
    out = sparse.csr_matrix((m.data.astype(np.float32).astype(float), m.indices, m.indptr), m.shape)
    on = _diagonal(out)
    out.data[on] = 0.0
    out.data[on] = -(out @ np.ones(m.shape[0]))[out.indices[on]]
    return out


def with_rest(m: sparse.csr_matrix) -> sparse.csr_matrix:
    """A matrix with a further entry at the end of each row: what single precision lacks of the diagonal."""
    on = _diagonal(m)
    rest, row = m.data[on], m.indices[on]
    rest = rest - rest.astype(np.float32)
    data, columns = (np.insert(a, m.indptr[row + 1], b) for a, b in ((m.data, rest), (m.indices, row)))
    further = np.append(0, np.cumsum(np.bincount(row, minlength=m.shape[0])))
    return sparse.csr_matrix((data, columns, m.indptr + further), m.shape)


def _diagonal(m: sparse.csr_matrix) -> np.ndarray:
    """Places of the diagonal in the data of a CSR matrix."""
    return np.flatnonzero(m.indices == np.repeat(np.arange(m.shape[0]), np.diff(m.indptr)))


def _adjoint(G: sparse.csr_matrix) -> sparse.csr_matrix:
    """-Gᵀ on the pattern of G."""
    H = -G.T.tocsr()
    H.sort_indices()
    if not np.array_equal(H.indices, G.indices):
        raise AssertionError("the neighbours are not symmetric")
    return H


def _rows_of(matrices: list, rows: Particles) -> tuple[np.ndarray, np.ndarray]:
    """For rows of the CSR matrices of some templates: which, and places in the CSR, of all entries."""
    parts = [np.zeros((2, 0), np.int64)]
    for kind, on, at in rows.by_kind():
        which, place = _expand(matrices[kind].indptr, at)
        parts.append(np.stack([on[which], place]))
    entries = np.concatenate(parts, axis=1)
    which, at = entries[:, np.argsort(entries[0], kind="stable")] if len(parts) > 2 else entries
    return which, at


def _values(matrices: list, kind: np.ndarray, at: np.ndarray, of: str = "data") -> np.ndarray:
    """Values of entries, or their columns, from the CSR matrix of each template."""
    values = [getattr(m, of) for m in matrices]
    if len(values) == 1:
        return values[0][at]
    first = np.cumsum([len(v) for v in values]) - [len(v) for v in values]
    return np.concatenate(values)[first[kind] + at]


def _expand(ptr: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For CSR rows: position in `rows` and index of every entry, in order."""
    count = ptr[rows + 1] - ptr[rows]
    which = np.repeat(np.arange(len(rows)), count)
    begin = np.repeat(ptr[rows] - (np.cumsum(count) - count), count)
    return which, begin + np.arange(count.sum())


def _changes(*arrays: np.ndarray) -> np.ndarray:
    """Where any of the arrays differs from its value before; the first does."""
    new = np.ones(len(arrays[0]), bool)
    new[1:] = np.any([a[1:] != a[:-1] for a in arrays], axis=0)
    return new
