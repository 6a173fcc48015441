"""Supports, loads, plates and probes of a case, on the particles of its scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ..case.expression import evaluate
from ..case.schema import Case, OnPart
from ..model.adhesion import GAUSS
from ..model.protocols import LoadCurve
from ..model.triangles import RADON
from . import rkpm
from .scene import Scene
from .simplices import facet_sizes

Points = list[tuple[tuple[float, ...], float]]  # shares of the corners of a facet and weights [-]
SEGMENT: Points = [((1.0 - at, at), weight) for at, weight in GAUSS]
TRIANGLE: Points = [(tuple(shares), weight) for *shares, weight in RADON]


@dataclass(frozen=True)
class Boundary:
    """Supports, loads and plates of a scene, by global ids of particles; each has a load curve, a factor in time.

    Attributes
    ----------
    load_curves : tuple -- the different laws of kind load_curve.
    names : tuple of str -- of the supports, then of the plates; columns of reactions begin with them.
    held : (k, 2) int -- prescribed degrees of freedom: particle and component.
    held_value : (k,) -- their displacements [µm].
    held_curve, held_support : (k,) int -- numbers of their load curves and supports.
    dead : (n,) int -- particles under dead loads: tractions and body forces, which keep their direction.
    dead_force : (n, d) -- forces on these [pN/µm]; in space [pN].
    dead_curve : (n,) int -- numbers of their load curves.
    pressed : (p, d) int -- corners of the segments or triangles under pressure.
    pressure : (p,) -- pressures on these [Pa].
    pressed_curve : (p,) int -- numbers of their load curves.
    plate : (n, 3 d) -- unit normal [-], point [µm] and displacement [µm] of each plate.
    plate_curve : (n,) int -- numbers of their load curves.
    """

    load_curves: tuple
    names: tuple
    held: np.ndarray
    held_value: np.ndarray
    held_curve: np.ndarray
    held_support: np.ndarray
    dead: np.ndarray
    dead_force: np.ndarray
    dead_curve: np.ndarray
    pressed: np.ndarray
    pressure: np.ndarray
    pressed_curve: np.ndarray
    plate: np.ndarray
    plate_curve: np.ndarray

    @classmethod
    def of(cls, case: Case, scene: Scene) -> Boundary:
        """Supports, loads and plates of a case on its scene."""
        load_curves = load_curves_of(case)

        def number(items: Sequence) -> np.ndarray:
            return np.array([load_curves.index(item.load_curve) for item in items], np.int32)

        who = numbers_of(case)
        held, value, support = _held(case, scene, who)
        dead, force, dead_load = _dead(case, scene, who)
        pressed, pressure, pressed_load = _pressed(case, scene, who)
        plate = [[*(np.array(p.normal) / np.linalg.norm(p.normal)), *p.point, *p.displacement] for p in case.plates]
        return cls(load_curves, tuple(s.name for s in (*case.supports, *case.plates)),
                   held, value, number(case.supports)[support], support,
                   dead, force, number(case.loads)[dead_load],
                   pressed, pressure, number(case.loads)[pressed_load],
                   np.array(plate).reshape(-1, 3 * scene.dimension), number(case.plates))

    def support_of(self, ids: np.ndarray, component: np.ndarray) -> np.ndarray:
        """Numbers of the supports (k,) int that prescribe a `component` (k,) int of the particles `ids` (k,) int."""
        d = self.dead_force.shape[1]
        at = np.searchsorted(d * self.held[:, 0] + self.held[:, 1], d * ids + component)
        return self.held_support[at]


def load_curves_of(case: Case) -> tuple[LoadCurve, ...]:
    """The different load curves of the supports, loads and plates of a case."""
    return tuple(dict.fromkeys(item.load_curve for item in (*case.supports, *case.loads, *case.plates)))


def numbers_of(case: Case) -> dict[str, int]:
    """Numbers of the cells by their names."""
    return {cell.name: i for i, cell in enumerate(case.cells)}


def _where(item: OnPart, scene: Scene, cell: int) -> np.ndarray:
    """Facets (e, d) of the surface of a cell on the parts of an item, by numbers of particles in the cell."""
    t = scene.templates[scene.kind[cell]]
    chosen = np.unique(np.concatenate([t.parts[p] for p in item.parts or ("surface",)]))
    return t.facets[chosen]


def _in_box(item: OnPart, X: np.ndarray) -> np.ndarray:
    """Whether points X (..., d) [µm] from the cell's centre are in the box of an item (...) bool."""
    if not item.box:
        return np.ones(X.shape[:-1], bool)
    box = np.sort(np.array(item.box), axis=0)
    margin = 1e-9 * np.ptp(box, axis=0).max() + 1e-12
    return ((X >= box[0] - margin) & (X <= box[1] + margin)).all(axis=-1)


def cells_of(item: OnPart, who: dict[str, int]) -> list[int]:
    """Numbers of the cells of an item, all of those in `who` if it names none."""
    return [who[name] for name in item.cells] if item.cells else list(who.values())


def particles_of(item: OnPart, scene: Scene, cell: int) -> np.ndarray:
    """Particles of a cell on the parts and in the box of an item (k,) int, by their numbers in the cell."""
    on = np.unique(_where(item, scene, cell))
    return on[_in_box(item, scene.templates[scene.kind[cell]].X[on])]


def facets_of(item: OnPart, scene: Scene, cell: int) -> np.ndarray:
    """Facets of a cell's surface on the parts and in the box of an item (e, d) int, by particles of the cell."""
    facets = _where(item, scene, cell)
    return facets[_in_box(item, scene.templates[scene.kind[cell]].X[facets]).all(axis=1)]


def _held(case: Case, scene: Scene, who: dict[str, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Prescribed particles and components (k, 2), values (k,) and supports (k,): of several the last one counts."""
    found: dict[tuple[int, int], tuple[float, int]] = {}
    for number, support in enumerate(case.supports):
        for cell in cells_of(support, who):
            on = particles_of(support, scene, cell)
            X = scene.templates[scene.kind[cell]].X[on]
            for k, value in enumerate(support.displacement):
                if value != "free":
                    ids = (scene.offset[cell] + on).tolist()
                    found |= {(i, k): (v, number) for i, v in zip(ids, evaluate(value, X).tolist(), strict=True)}
    keys = sorted(found)
    values = [found[key] for key in keys]
    return (np.array(keys, np.int64).reshape(-1, 2), np.array([v for v, _ in values], float),
            np.array([n for _, n in values], np.int64))


def _dead(case: Case, scene: Scene, who: dict[str, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Particles (n,), forces (n, d) and numbers (n,) of dead loads: integrals of tractions, or body forces times V."""
    ids, forces, loads = [], [], []
    for number, load in enumerate(case.loads):
        for cell in cells_of(load, who) if load.pressure is None else ():
            t = scene.templates[scene.kind[cell]]
            if load.body is not None:
                on, force = np.arange(len(t.X)), t.V[:, None] * _vectors(load.body, t.X)
            else:
                facets = facets_of(load, scene, cell)
                on, force = np.unique(facets), tractions(t.X, facets, partial(_vectors, load.traction))
            ids.append(scene.offset[cell] + on)
            forces.append(force[on])
            loads.append(np.full(len(on), number))
    if not ids:
        return np.zeros(0, np.int64), np.zeros((0, scene.dimension)), np.zeros(0, np.int64)
    return np.concatenate(ids), np.concatenate(forces), np.concatenate(loads)


def _vectors(components: tuple, X: np.ndarray) -> np.ndarray:
    """Values (n, d) of numbers or formulas at points X (n, d)."""
    return np.column_stack([evaluate(c, X) for c in components])


def points_on(facets: np.ndarray) -> Points:
    """Points of a quadrature on facets (e, d, d) [µm], segments or triangles."""
    return SEGMENT if facets.shape[1] == 2 else TRIANGLE


def tractions(X: np.ndarray, facets: np.ndarray, traction: Callable[[np.ndarray], Any]) -> np.ndarray:
    """Forces on particles (n, d) [pN/µm, in space pN] of a traction on facets of the surface.

    Parameters
    ----------
    X : (n, d) -- positions [µm].
    facets : (e, d) int -- ends of segments, corners of triangles.
    traction : function -- of points (e, d) [µm], gives tractions (e, d) [Pa].

    Source: ∫ N t dA by Gauss points, three of a segment and seven of a triangle (Radon 1948), with shape functions N
    that are linear on a facet.
    """
    force, corners = np.zeros_like(X), X[facets]
    size = facet_sizes(corners)[:, None]
    for shares, weight in points_on(corners):
        t = weight * size * traction(np.einsum("i,eid->ed", shares, corners))
        for at, share in zip(facets.T, shares, strict=True):
            np.add.at(force, at, share * t)
    return force


def _pressed(case: Case, scene: Scene, who: dict[str, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Facets (p, d), pressures (p,) and numbers (p,) of pressure loads."""
    facets, values, loads = [np.zeros((0, scene.dimension), np.int64)], [np.zeros(0)], [np.zeros(0, np.int64)]
    for number, load in enumerate(case.loads):
        for cell in cells_of(load, who) if load.pressure is not None else ():
            found = facets_of(load, scene, cell)
            facets.append(scene.offset[cell] + found)
            values.append(evaluate(load.pressure, scene.templates[scene.kind[cell]].X[found].mean(axis=1)))
            loads.append(np.full(len(found), number))
    return np.concatenate(facets), np.concatenate(values), np.concatenate(loads)


# ------------------------------------------------------------------------------------------------------------ probes


@dataclass(frozen=True)
class Probes:
    """Points and parts whose motion is recorded, as weighted means over particles.

    Attributes
    ----------
    names : tuple of str -- names of the p probes.
    cell : (p,) int -- their cells.
    probe, id : (k,) int -- probe and global id of each term of the means.
    weight : (k,) -- of each term [-]; the weights of a probe sum to 1.
    """

    names: tuple
    cell: np.ndarray
    probe: np.ndarray
    id: np.ndarray
    weight: np.ndarray

    @classmethod
    def of(cls, case: Case, scene: Scene) -> Probes:
        """Probes of a case: a point is interpolated between particles, a part has the mean along its length or area."""
        who, parts = numbers_of(case), [(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))]
        cells = np.array([cells_of(p, who)[0] for p in case.probes], np.int64)
        for number, (item, cell) in enumerate(zip(case.probes, cells, strict=True)):
            X = scene.templates[scene.kind[cell]].X
            if item.point is not None:
                on, weight = rkpm.interpolation(X, np.array(item.point))
            else:
                force = tractions(X, facets_of(item, scene, cell), lambda x: np.ones_like(x))[:, 0]
                on = np.flatnonzero(force)
                weight = force[on] / force.sum()
            parts.append((np.full(len(on), number), scene.offset[cell] + on, weight))
        return cls(tuple(p.name for p in case.probes), cells, *map(np.concatenate, zip(*parts, strict=True)))
