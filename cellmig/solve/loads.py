"""Supports, loads and plates of a scene on one rank, at the time of a clock that the kernel advances."""

from __future__ import annotations

import numpy as np

from ..kernel.fields import Field
from ..kernel.kernel import Kernel
from ..meshfree.boundary import Boundary
from .subdomain import Subdomain


class Loads:
    """Supports, loads and plates of this rank's particles; empty in a scene without any.

    Attributes
    ----------
    boundary : Boundary -- of the whole scene.
    there : bool -- whether the scene has any.
    held : (k,) int, (k,) int -- owned particles and components that supports hold.
    reaction : (k,) float -- forces of supports on these, writable [pN/µm].
    platable : (p,) int -- owned surface particles, which plates may touch.
    plate_force : (p, plates) float -- forces of plates along their normals, writable [pN/µm].
    """

    FIELDS = (
        Field("clock", "double *", "(3,)", "µs", "time; an origin, and the number of equal steps since then"),
        Field("n_held", "long", doc="held components of particles"),
        Field("held", "int32_t *", "(n_held,)", "", "their places in `state`"),
        Field("held_value", "double *", "(n_held,)", "µm", "displacements at the factor 1"),
        Field("held_curve", "int32_t *", "(n_held,)", "", "load curves"),
        Field("held_before", "double *", "(n_held, 2)", "µm, µm/µs", "u and v before a step"),
        Field("reaction", "double *", "(n_held,)", "pN/µm", "of the supports"),
        Field("n_loaded", "long", doc="particles with loads"),
        Field("loaded", "int32_t *", "(n_loaded,)", "", "these"),
        Field("load", "double *", "(n_local, d)", "pN/µm", "loads now"),
        Field("load_before", "double *", "(n_local, d)", "pN/µm", "loads at the last kick"),
        Field("n_dead", "long", doc="particles with loads that keep their direction"),
        Field("dead", "int32_t *", "(n_dead,)", "", "these"),
        Field("dead_force", "double *", "(n_dead, d)", "pN/µm", "loads at the factor 1"),
        Field("dead_curve", "int32_t *", "(n_dead,)", "", "load curves"),
        Field("n_pressed", "long", doc="facets under pressure"),
        Field("pressed", "int32_t *", "(n_pressed, d)", "", "their corners"),
        Field("pressure", "double *", "(n_pressed,)", "Pa", "at the factor 1"),
        Field("pressed_curve", "int32_t *", "(n_pressed,)", "", "load curves"),
        Field("n_plates", "long", doc="plates"),
        Field("plate", "double *", "(n_plates, 3 d)", "-, µm, µm", "normal, point, displacement"),
        Field("plate_curve", "int32_t *", "(n_plates,)", "", "load curves"),
        Field("n_platable", "long", doc="owned surface particles, if there are plates"),
        Field("platable", "int32_t *", "(n_platable,)", "", "these"),
        Field("plate_before", "double *", "(n_platable, d)", "µm", "their u before a step"),
        Field("plate_force", "double *", "(n_platable, n_plates)", "pN/µm", "along the normals"),
    )

    def __init__(self, part: Subdomain, kernel: Kernel, boundary: Boundary):
        """Set the kernel's arrays, at time zero."""
        self._part, self._kernel, self.boundary = part, kernel, boundary
        self._curves, none = part.terms.load_curves or (), np.zeros(0, np.int64)
        self.held, self.reaction, self.loaded = (none, none), np.zeros(0), none
        self.platable, self.plate_force = none, np.zeros((0, 0))
        self.there = part.terms.load_curves is not None
        if self.there:
            self._set_supports()
            self._set_loads()
            self._set_plates()
            kernel["clock"] = np.zeros(3)

    def _set_supports(self) -> None:
        k, b = self._kernel, self.boundary
        at = self._part.owned_numbers(b.held[:, 0])
        on = np.flatnonzero(at >= 0)
        self.held = at[on], b.held[on, 1]
        k["n_held"], k["held"] = len(on), 2 * self._part.scene.dimension * at[on] + b.held[on, 1]
        k["held_value"], k["held_curve"] = b.held_value[on], b.held_curve[on]
        k["held_before"], k["reaction"] = np.zeros((len(on), 2)), np.zeros(len(on))
        self.reaction = k["reaction"]

    def _set_loads(self) -> None:
        k, b, part = self._kernel, self.boundary, self._part
        at = part.owned_numbers(b.dead)
        on = np.flatnonzero(at >= 0)
        k["n_dead"], k["dead"] = len(on), at[on]
        k["dead_force"], k["dead_curve"] = b.dead_force[on], b.dead_curve[on]
        corners = part.numbering.local(b.pressed.ravel()).reshape(b.pressed.shape)
        near = np.flatnonzero(((corners >= 0) & (corners < part.n_owned)).any(axis=1))
        k["n_pressed"], k["pressed"] = len(near), corners[near]
        k["pressure"], k["pressed_curve"] = b.pressure[near], b.pressed_curve[near]
        self.loaded = np.unique(np.concatenate([at[on], corners[near].ravel()]))
        k["n_loaded"], k["loaded"] = len(self.loaded), self.loaded
        k["load"], k["load_before"] = (np.zeros((part.capacity, part.scene.dimension)) for _ in range(2))

    def _set_plates(self) -> None:
        k, b = self._kernel, self.boundary
        self.platable = self._part.at_surface if len(b.plate) else np.zeros(0, np.int64)
        k["n_platable"], k["platable"] = len(self.platable), self.platable
        k["n_plates"], k["plate"], k["plate_curve"] = len(b.plate), b.plate, b.plate_curve
        k["plate_before"] = np.zeros((len(self.platable), self._part.scene.dimension))
        k["plate_force"] = np.zeros((len(self.platable), len(b.plate)))
        self.plate_force = k["plate_force"]

    def set_clock(self, time: float, origin: float = 0.0, steps: int = 0) -> None:
        """Set the time [µs] of supports, loads and plates, `steps` equal steps after an `origin` [µs]."""
        if self.there:
            self._kernel["clock"][:] = time, origin, steps

    @property
    def clock(self) -> list[float]:
        """Arguments of `set_clock`: time and origin [µs], number of steps."""
        return self._kernel["clock"].tolist()

    def factors(self, curves: np.ndarray) -> np.ndarray:
        """Values (k,) [-] of the load curves with these numbers (k,) int at the time of the clock."""
        time = self._kernel["clock"][0]
        return np.array([curve.value(time) for curve in self._curves])[curves] if len(curves) else np.zeros(0)

    def prescribed(self) -> np.ndarray:
        """Displacements (k,) [µm] of the components that supports hold, at the time of the clock."""
        return self._kernel["held_value"] * self.factors(self._kernel["held_curve"]) if self.there else self.reaction

    def pressures(self) -> tuple[np.ndarray, np.ndarray]:
        """Facets under pressure: corners (s, d) int, local numbers; pressures (s,) [Pa] at the time of the clock."""
        if not self.there:
            return np.zeros((0, self._part.scene.dimension), np.int64), np.zeros(0)
        k = self._kernel
        return k["pressed"], k["pressure"] * self.factors(k["pressed_curve"])

    def add_to(self, force: np.ndarray) -> np.ndarray:
        """`force` (n_owned, d) [pN/µm] with those of loads and supports added, which are current after `rate`."""
        if self.there:
            loaded = self.loaded[self.loaded < len(force)]
            force[loaded] += self._kernel["load"][loaded]
            force[self.held] += self.reaction
        return force

    def reactions(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Forces (k, d) [pN/µm] of supports and plates, owned particles (k,) int, and numbers (k,) of their names."""
        b, (particle, component) = self.boundary, self.held
        force = [np.zeros((len(particle), self._part.scene.dimension))]
        force[0][np.arange(len(particle)), component] = self.reaction
        of = [b.support_of(self._part.ids[particle], component)]
        for p, normal in enumerate(b.plate[:, : self._part.scene.dimension]):
            force.append(self.plate_force[:, p, None] * normal)
            of.append(np.full(len(self.platable), len(b.names) - len(b.plate) + p))
        particles = [particle, *[self.platable] * len(b.plate)]
        return np.concatenate(force), np.concatenate(particles), np.concatenate(of)

    def changing(self, n_local: int) -> dict[str, np.ndarray]:
        """Arrays that steps change: clock (3,) [µs], loads (n_local, d) of the last kick [pN/µm]."""
        k = self._kernel
        return {"clock": k["clock"], "load_before": k["load_before"][:n_local]} if self.there else {}
