"""Protrusion on one rank: the push of a cell depends on its whole surface, also on parts of other ranks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..kernel.fields import Field
from ..kernel.kernel import Kernel
from ..meshfree.division_space import carried
from .protrusion_noise import random_factor
from .segments import Segments
from .subdomain import Subdomain


@dataclass
class Drives:
    """In which directions cells push, and how strongly, the same on all ranks.

    value : (cells, sides, d - 1) float -- vectors whose lengths are factors of the push, at a `time` [-];  rate : their
    change (cells, sides, d - 1) [1/µs];  time : [µs];  factor : (m,) float -- of the push at all surface particles of
    the scene, or one for all [-].
    """

    value: np.ndarray
    rate: np.ndarray
    time: float
    factor: np.ndarray | float


class Protruding(NamedTuple):
    """Which cells protrude.

    cells : (cells,) bool;  seed, names : of the case and of its cells, to which their random numbers belong;  drives :
    Drives -- of the start.
    """

    cells: np.ndarray
    seed: int
    names: Sequence[str]
    drives: Drives


class Protrusion:
    """The protruding cells of which a rank owns a part of the surface; in each step the kernel finds their front half,
    the bonds that hold it, and the push.
    """

    FIELDS = (
        Field("push", "double *", "(n_facets, d)", "pN/µm", "β α N σ/d at the corners of the facets"),
        Field("pushed", "double *", "(n_facets, d, d - 1)", "pN/µm", "forces of the last kick along the substrate"),
        Field("n_movers", "long", doc="protruding cells"),
        Field("first_mover", "long *", "(n_movers + 1,)", "", "their particles in `mover`"),
        Field("mover", "int32_t *", "(…,)", "", "all of their surface particles"),
        Field("mover_weight", "double *", "(…,)", "-", "weights of these in the mean of the surface"),
        Field("mover_of", "int32_t *", "(n_facets,)", "", "protruding cells of the segments"),
        Field("first_grip", "long *", "(n_movers + 1,)", "", "their segments in `grip`"),
        Field("grip", "int32_t *", "(…,)", "", "their segments near the substrate"),
        Field("firm", "double", "", "µm", "length of closed bonds that holds a cell"),
        Field("drive", "double *", "(n_movers, sides, d - 1)", "-", "directions of the push times its factors"),
        Field("drive_rate", "double *", "(n_movers, sides, d - 1)", "1/µs", "their change"),
        Field("drive_time", "double", "", "µs", "time of the value of `drive`"),
        Field("drive_clock", "double *", "(3,)", "µs", "time; an origin, and the number of equal steps since then"),
        Field("drive_now", "double *", "(n_movers, sides, d)", "-", "factors and directions at the time of the clock"),
        Field("middle", "double *", "(n_movers, sides)", "µm", "mean of the surface in each direction"),
        Field("hold", "double *", "(n_movers, sides)", "-", "share of the push that the bonds hold"),
        # off other bodies
        Field("hold_off", "double *", "(n_movers, sides)", "-", "the same for bonds to these"),
        Field("contact_mover", "int32_t *", "(n_contact_segments,)", "", "protruding cells of the segments, or -1"),
        Field("contact_push", "double *", "(n_contact_segments, d)", "pN/µm", "β α N σ/2 at ends, in space β α N σ"),
        Field("n_own_surface", "long", doc="surface particles of this rank"),
        Field("own_surface", "int32_t *", "(n_own_surface,)", "", "these"),
        Field("contact_own", "int32_t *", "(n_contact_nodes,)", "", "nodes among these, or -1"),
        Field("pushed_off", "double *", "(n_own_surface, d)", "pN/µm", "forces of the last kick on these"),
    )

    def __init__(self, part: Subdomain, kernel: Kernel, segments: Segments, protruding: Protruding):
        """Nothing holds or pushes before the first `renew`."""
        law, bonds = part.terms.protrusion, part.terms.substrate
        assert law is not None  # else nothing protrudes
        self._kernel, self._segments, k = kernel, segments, kernel
        self._surfaces = s = part.surfaces
        d, sides = part.scene.dimension, part.terms.sides
        size = law.push(bonds.work) / d if bonds is not None else 0.0
        alpha = random_factor(part.scene, s, law, protruding.seed, protruding.names)
        self._alpha = carried(part.scene, s.cells, alpha)[segments.ends]
        self._push = np.where(segments.acts[:, None], size * self._alpha, 0.0)
        k["pushed"] = np.zeros((*segments.ends.shape, d - 1))
        cells, first, count = np.unique(s.cell[part.pushed], return_index=True, return_counts=True)
        share = s.shares[part.pushed]
        k["mover_weight"] = share / np.repeat(np.add.reduceat(share, first) if len(first) else share, count)
        k["n_movers"], k["first_mover"] = len(cells), np.append(first, len(part.pushed))
        k["mover"] = part.numbering.local(s.ids[part.pushed])
        k["mover_of"] = np.searchsorted(cells, s.cell[segments.ends[:, 0]])
        k["firm"], k["drive_now"] = law.height, np.zeros((len(cells), sides, d))
        k["middle"], k["hold"] = np.zeros((len(cells), sides)), np.zeros((len(cells), sides))
        self._cells, self._part, self._factor = cells, part, protruding.drives.factor
        k["hold_off"], k["pushed_off"] = np.zeros((len(cells), sides)), np.zeros((len(part.own_surface), d))
        k["n_own_surface"], k["own_surface"] = len(part.own_surface), part.at_surface
        self.drive(protruding.drives)
        self._on = protruding.cells[s.cell[segments.ends[:, 0]]] & s.outer[segments.number]

    def drive(self, drives: Drives) -> None:
        """Push as these Drives say, from their time on."""
        k, self._time = self._kernel, drives.time
        k["drive"], k["drive_rate"] = drives.value[self._cells], drives.rate[self._cells]
        self._factor = drives.factor
        k["push"] = self._push * self._factor_at(self._segments.ends)
        k["drive_time"], k["drive_clock"] = drives.time, np.array([drives.time, 0.0, 0.0])
        if self._segments.lists is not None:
            self._renew_off()

    def _factor_at(self, on: np.ndarray) -> np.ndarray | float:
        """Factors of the push at surface particles `on` (...) int of this rank's cells (...), or one for all [-]."""
        factor = self._factor
        return factor[self._surfaces.place[on]] if isinstance(factor, np.ndarray) else factor

    def set_clock(self, time: float, origin: float = 0.0, steps: int = 0) -> None:
        """Push as in the Drives at a time [µs], `steps` equal steps after an `origin` [µs]."""
        self._kernel["drive_clock"][:] = time, origin, steps

    @property
    def clock(self) -> list[float]:
        """Arguments of `set_clock`: time and origin [µs], number of steps."""
        return self._kernel["drive_clock"].tolist()

    def now(self) -> np.ndarray:
        """Vectors (cells, sides, d - 1) [-] of the protruding cells of this rank at the time of the clock."""
        k = self._kernel
        return k["drive"] + (k["drive_clock"][0] - self._time) * k["drive_rate"]

    def renew(self) -> None:
        """Select the segments near the substrate, from the current search lists."""
        k = self._kernel
        k["grip"] = np.flatnonzero(self._segments.low & self._on)
        k["first_grip"] = np.searchsorted(k["mover_of"][k["grip"]], np.arange(len(k["hold"]) + 1))
        self._renew_off()

    def _renew_off(self) -> None:
        """Select the facets that push off other bodies, from the current search lists, and their pushes."""
        k, part, lists, law = self._kernel, self._part, self._segments.lists, self._part.terms.protrusion
        if part.terms.pushes_off is None or lists is None:
            return
        assert law is not None and part.terms.contacts is not None
        at = self._segments.pushing()
        share = 0.5 if part.scene.dimension == 2 else 1.0
        size = np.array([share * law.push(bonds.work) for bonds in part.terms.contacts.laws])[k["contact_law"]]
        ends = self._segments.ends[at]
        k["contact_push"] = size[:, None] * self._alpha[at] * self._factor_at(ends)
        k["contact_mover"] = np.where(at < 0, -1, k["mover_of"][at])
        own = np.full(len(part.surfaces.ids), -1)
        own[part.own_surface] = np.arange(len(part.own_surface))
        k["contact_own"] = own[lists.node]

    @property
    def changing(self) -> dict[str, np.ndarray]:
        """Arrays that steps change: the pushes of the last kick [pN/µm], off the substrate (n_facets, d, d - 1) and off
        other bodies (k, d), and the clock (3,) [µs].
        """
        return {name: self._kernel[name] for name in ("pushed", "pushed_off", "drive_clock")}
