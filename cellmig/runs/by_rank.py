"""What each rank of a run has: cells, particles, copies, work, memory, from the partition of a scene of few kinds."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from cellmig.case.schema import Case, particle_count
from cellmig.kernel.layout import number
from cellmig.meshfree.scene import Scene, ranges
from cellmig.meshfree.terms import find_terms
from cellmig.output.log import duration
from cellmig.parallel.owners import Owners
from cellmig.parallel.partition import partition
from cellmig.solve.start import discretise, kind_of

from .summary import describe_balance, span

ALIKE, BUILT = 8, 20_000  # most kinds of cells, and about as many particles of them all, that stand for all kinds
CUT = 8  # cut cells of a rank of which copies are counted
# Memory [B], measured: of a rank, Python, PETSc and MPI; of a particle besides the kernel's arrays; of one of a kind of
# cells on rank 0, which builds it, and on the others; of a cell of the scene; of a particle of several cells in space,
# while the lists of contacts between them are made.
RANK_BYTES, SCENE_BYTES, KIND_BYTES, HELD_BYTES, CELL_BYTES, LISTS_BYTES = 127e6, 850, 8_200, 2_800, 1_700, 5_400


class Parts(NamedTuple):
    """What ranks have.

    cells, particles : (ranks,) -- parts of cells count as such;  copies : of particles of others within cells that are
    cut, of the rank with the most particles;  load : (ranks,) -- work over the mean [-].
    """

    cells: np.ndarray
    particles: np.ndarray
    copies: int
    load: np.ndarray


def kinds_of(case: Case) -> dict[tuple, int]:
    """Particles of each kind of cells, by what decides it."""
    return {kind: particle_count(case, kind[0]) for kind in dict.fromkeys(map(kind_of, case.cells))}


def of_cells(case: Case) -> list[int]:
    """Particles of each cell."""
    known = {shape: particle_count(case, shape) for shape in {c.shape for c in case.cells}}
    return [known[c.shape] for c in case.cells]


def size_of(case: Case) -> int:
    """Particles of a case."""
    return sum(of_cells(case))


def standing_for(kinds: dict[tuple, int]) -> dict[tuple, tuple]:
    """For each of `kinds`, with their particles, one of the few that stand for all: those next in size."""
    ordered = sorted(kinds, key=lambda kind: kinds[kind])
    few = max(1, min(len(ordered), ALIKE, round(BUILT / (sum(kinds.values()) / len(kinds)))))
    chosen = [ordered[(2 * n + 1) * len(ordered) // (2 * few)] for n in range(few)]
    return {kind: chosen[n * few // len(ordered)] for n, kind in enumerate(ordered)}


def of_ranks(case: Case, coarse: Case, ranks: int) -> Parts:
    """What each of `ranks` has; `coarse` : the case with as many particles in a cell as templates are built of."""
    kinds = kinds_of(coarse)
    alike = standing_for(kinds)
    chosen = list(dict.fromkeys(alike.values()))
    examples = {kind_of(cell): cell for cell in reversed(coarse.cells)}
    few = discretise(dataclasses.replace(coarse, cells=tuple(examples[kind] for kind in chosen), supports=(), loads=(),
                                         probes=()))
    number_of = {kind: chosen.index(alike[kind]) for kind in kinds}
    scene = Scene(few.templates, np.array([number_of[kind_of(cell)] for cell in case.cells]),
                  np.array([cell.centre for cell in case.cells]), few.materials, few.material_of)
    terms = find_terms(case)
    owners = partition(scene, ranks, terms.reach, terms.low)
    true = kinds_of(case)
    size = np.array([true[kind_of(cell)] for cell in case.cells], float)
    particles, cells = (owners.shares(of, ranks) for of in (size, np.ones(len(size))))
    finer = (size.sum() / scene.size) ** (1.0 - 1.0 / case.dimension)  # as many more along a cut
    return Parts(cells, particles, round(finer * _copies(owners, int(particles.argmax()))), owners.load)


def _copies(owners: Owners, rank: int) -> float:
    """Copies on a rank of particles of others within cells that are cut, from CUT of them."""
    scene, cells = owners.scene, owners.cells(rank)
    cut = [cell for cell in cells.tolist() if owners.team > 1 or cell in owners.pieces or cell in owners.free]
    if not cut:
        return 0.0
    some = np.array(cut[:: -(-len(cut) // CUT)])
    ids = ranges(scene.offset[some], scene.offset[some + 1])
    found = number(scene, ids[owners.of(ids) == rank], ids[:0])
    return (len(found.ids) - found.n_owned) * len(cut) / len(some)


def scene_bytes(case: Case) -> int:
    """Memory of a particle of a case besides the kernel's arrays [B]."""
    return SCENE_BYTES + (LISTS_BYTES if case.dimension == 3 and len(case.cells) > 1 else 0)


def memory(case: Case, row_bytes: float, particles: float, first: bool = True) -> float:
    """Memory of a rank with some `particles` [B], the `first` of which builds the kinds of cells; `row_bytes` : of the
    kernel's arrays per particle.
    """
    held = (KIND_BYTES if first else HELD_BYTES) * sum(kinds_of(case).values())
    return RANK_BYTES + particles * (row_bytes + scene_bytes(case)) + held + CELL_BYTES * len(case.cells)


def describe_parts(parts: Parts, seconds: float | None = None) -> list[tuple[str, str]]:
    """Rows about several ranks, none of one; `seconds` : of all steps on one core [s], None if they are solved for."""
    if len(parts.load) == 1:
        return []
    cells, particles = span(np.round(parts.cells, 2).tolist()), span(np.round(parts.particles).astype(int).tolist())
    row = f"{len(parts.load)}, with {cells} cells, {particles} particles each"
    row += f"; the fullest has copies of {parts.copies} others" if parts.copies else ""
    rows = [("ranks", f"{row}, and those of contacts"), *describe_balance(parts.load)]
    if seconds is not None:
        fullest = seconds * parts.load.max() / len(parts.load)
        rows.append(("", f"{duration(fullest)} if each has a core, without output and waits for messages"))
    return rows
