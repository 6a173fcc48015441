"""The scene of all cells in the reference configuration, and the particles that one wants of it.

Nothing is kept of single particles: what a rank holds grows with its own, and by a few bytes with each cell.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..case.time_unit import MICROSECOND, TimeUnit


@dataclass(frozen=True)
class Scene:
    """All cells in the reference configuration; global ids count the particles cell by cell, each as its template does.

    Attributes
    ----------
    templates : list of Template -- one for each kind of cell.
    kind : (cells,) int -- index of the template of each cell.
    centre : (cells, D) -- centres of the cells [µm].
    materials : list -- the material laws that occur.
    material_of : list -- for each template, the indices of the laws of body and nucleus in `materials`.
    time_unit : TimeUnit -- of times in messages.
    """

    templates: list
    kind: np.ndarray
    centre: np.ndarray
    materials: list
    material_of: list
    time_unit: TimeUnit = MICROSECOND

    @cached_property
    def offset(self) -> np.ndarray:
        """First global id of each cell, and at the end the number of all particles (cells + 1,) int."""
        return self._first([len(t.X) for t in self.templates])

    @cached_property
    def first_surface(self) -> np.ndarray:
        """First number of a surface particle of each cell, and at the end that of all (cells + 1,) int."""
        return self._first([len(t.surface) for t in self.templates])

    @cached_property
    def first_facet(self) -> np.ndarray:
        """First number of a facet of each cell, and at the end that of all (cells + 1,) int."""
        return self._first([len(t.places) for t in self.templates])

    @cached_property
    def first_loop(self) -> np.ndarray:
        """First number of a loop of each cell's outline in the plane, and at the end that of all (cells + 1,) int."""
        return self._first([int(t.loop[-1]) + 1 for t in self.templates])

    @cached_property
    def mean_facet(self) -> float:
        """Mean reference length [µm] or area [µm²] of all facets."""
        total = np.array([math.fsum(t.facet_size) for t in self.templates])[self.kind]
        return math.fsum(total) / int(self.first_facet[-1])

    def _first(self, sizes: list[int]) -> np.ndarray:
        return np.concatenate([[0], np.cumsum(np.array(sizes, np.int64)[self.kind])])

    @property
    def dimension(self) -> int:
        """Number of dimensions, 2 or 3."""
        return self.centre.shape[1]

    @property
    def size(self) -> int:
        """Number of particles."""
        return int(self.offset[-1])

    def surface(self, cell: int) -> np.ndarray:
        """Global ids of the surface particles of a cell, loop by loop (m,) int."""
        return self.offset[cell] + self.templates[self.kind[cell]].surface

    def cell_of(self, ids: np.ndarray) -> np.ndarray:
        """Cells (k,) int of particles `ids` (k,) int, from 0."""
        return (np.searchsorted(self.offset, ids, side="right") - 1).astype(np.int32)

    def cell_at(self, places: np.ndarray) -> np.ndarray:
        """Cells (k,) int of surface particles by their numbers in the scene `places` (k,) int, from 0."""
        return np.searchsorted(self.first_surface, places, side="right") - 1

    def ids_of(self, cells: np.ndarray) -> np.ndarray:
        """Global ids (n,) int of the particles of `cells` (k,) int, cell by cell."""
        return ranges(self.offset[cells], self.offset[cells + 1])

    def particles(self, ids: np.ndarray) -> Particles:
        """The particles with global `ids` (n,) int."""
        return Particles(self, ids)

    @property
    def all(self) -> Particles:
        """All particles, for those who have room for them: rank 0 of a small scene, tests, references."""
        return Particles(self, np.arange(self.size))

    def field(self, attribute: str) -> np.ndarray:
        """An `attribute` of the templates, such as "V", for all particles by global id (size, ...), in its unit."""
        return np.concatenate([getattr(self.templates[k], attribute) for k in self.kind])

    @property
    def cell(self) -> np.ndarray:
        """Cell of each particle, from 0 (size,) int."""
        return self.all.cell

    @property
    def X(self) -> np.ndarray:
        """Reference positions (size, D) [µm]."""
        return self.all.X

    @property
    def material(self) -> np.ndarray:
        """Index in `materials` of the law of each particle (size,) int."""
        return self.all.material


@dataclass(frozen=True)
class Particles:
    """Some particles of a scene, with what their templates say of them.

    scene : Scene;  ids : (n,) int -- their global ids.
    """

    scene: Scene
    ids: np.ndarray

    @cached_property
    def cell(self) -> np.ndarray:
        """Cells, from 0 (n,) int."""
        return self.scene.cell_of(self.ids)

    @cached_property
    def kind(self) -> np.ndarray:
        """Kinds of these cells (n,) int."""
        return self.scene.kind[self.cell]

    @cached_property
    def at(self) -> np.ndarray:
        """Places in their templates (n,) int."""
        return self.ids - self.scene.offset[self.cell]

    @cached_property
    def _by_kind(self) -> tuple[np.ndarray, list[tuple[int, slice]]]:
        """An order (n,) in which particles of a kind follow each other, and where those of each kind are in it."""
        order = np.argsort(self.kind, kind="stable")
        kinds, first = np.unique(self.kind[order], return_index=True)
        last = np.append(first[1:], len(order))[: len(first)]
        return order, [(int(k), slice(a, b)) for k, a, b in zip(kinds, first, last, strict=True)]

    def by_kind(self) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Each kind that occurs, with the numbers of its particles here (k,) int and in its template (k,) int."""
        order, parts = self._by_kind
        for kind, part in parts:
            yield kind, order[part], self.at[order[part]]

    def field(self, attribute: str) -> np.ndarray:
        """An `attribute` of the templates, such as "V" (n, ...), in its unit."""
        return self._taken([getattr(self.scene.templates[kind], attribute) for kind, _ in self._by_kind[1]],
                           getattr(self.scene.templates[0], attribute))

    def _taken(self, values: list[np.ndarray], like: np.ndarray) -> np.ndarray:
        if len(values) == 1:
            return values[0][self.at]
        out = np.empty((len(self.ids), *like.shape[1:]), like.dtype)
        for (_, on, at), of_kind in zip(self.by_kind(), values, strict=True):
            out[on] = of_kind[at]
        return out

    @cached_property
    def X(self) -> np.ndarray:
        """Reference positions (n, D) [µm]."""
        return self.field("X") + self.scene.centre[self.cell]

    @cached_property
    def material(self) -> np.ndarray:
        """Index in the scene's `materials` of the law of each (n,) int."""
        of = np.array(self.scene.material_of, np.int32)[self.kind]
        return np.where(self.field("nucleus"), of[:, 1], of[:, 0])


def ranges(first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """The integers from each of `first` (k,) int to below each of `last` (k,) int, one after another (n,) int."""
    count = last - first
    return np.repeat(first - (np.cumsum(count) - count), count) + np.arange(count.sum())


def joined(parts: Iterable[np.ndarray], shape: tuple[int, ...] = (0,), kind: type = np.int64) -> np.ndarray:
    """The `parts` (k, ...) of any unit one after another (n, ...); of a `shape` and `kind` if there are none."""
    return np.concatenate([np.zeros(shape, kind), *parts])
