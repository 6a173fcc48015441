"""Accounts that each step adds to: dissipation, work, and impulses for the mean forces of the tables."""

from __future__ import annotations

import numpy as np

from mpi4py import MPI

from ..kernel.fields import Field
from ..kernel.kernel import Kernel
from ..meshfree.contact import NodeLists
from ..parallel.collect import Arrays, Rows
from ..parallel.reduce import exact_sum
from .segments import Segments
from .subdomain import Subdomain

AT_ONCE = 1 << 20  # impulses of a checkpoint that are looked at at a time
# Of particles.
ACCOUNTS = ("viscous_loss", "artificial_dissipation", "friction_loss", "medium_loss", "protrusion_impulse",
            "external_work", "network_loss")


class Accounts:
    """Dissipation, work and impulses so far.

    Attributes
    ----------
    of_particles : dict of (n_owned,) float -- writable, by name [pN], impulses [pN µs/µm].
    impulses : Impulses -- of surfaces, since the last row of the tables.
    """

    FIELDS = (
        Field("viscous_loss", "double *", "(n_local,)", "pN", "dissipation by viscosity, with what is restored of it"),
        Field("artificial_dissipation", "double *", "(n_local,)", "pN", "dissipation by other numerical viscosities"),
        Field("friction_loss", "double *", "(n_local,)", "pN", "dissipation by friction of bonds"),
        Field("medium_loss", "double *", "(n_local,)", "pN", "dissipation by drag of the liquid around"),
        Field("protrusion_impulse", "double *", "(n_local,)", "pN µs/µm", "of the push along x"),
        Field("external_work", "double *", "(n_local,)", "pN", "of push, loads, plates, supports and activity"),
        Field("network_loss", "double *", "(n_local,)", "pN", "dissipation by bonds of networks that break"),
        Field("bond_impulse", "double *", "(n_facets, d, 2 d - 1)", "pN µs/µm", "see `Impulses.bond`"),
        Field("contact_impulse", "double *", "(slots, 2)", "pN µs/µm", "see `Impulses.contact`"),
        Field("contact_slot", "int32_t *", "(n_contact_nodes,)", "", "slot for the impulse of a node"),
    )

    def __init__(self, part: Subdomain, kernel: Kernel, segments: Segments):
        """Begin at zero."""
        self._comm, self._kernel = part.comm, kernel
        for name in ACCOUNTS:
            kernel[name] = np.zeros(part.capacity)
        self.of_particles = {name: kernel[name][: part.n_owned] for name in ACCOUNTS}
        self.impulses = Impulses(part, kernel, segments)

    @property
    def everything(self) -> dict[str, np.ndarray]:
        """Writable accounts of particles (n_owned,) [pN] and those of `Impulses.arrays` [pN µs/µm], by field."""
        return self.of_particles | self.impulses.arrays

    def changing(self, n_local: int) -> dict[str, np.ndarray]:
        """Arrays that steps change: of particles (n_local,) [pN], and those of `Impulses.arrays` [pN µs/µm]."""
        return {name: self._kernel[name][:n_local] for name in ACCOUNTS} | self.impulses.arrays

    def rates(self) -> dict[str, np.ndarray]:
        """Rates in the current state by name, shaped as (n_owned,) or `Impulses.arrays` [pN/µs, pN/µm]; collective."""
        counted = self.everything
        so_far = {name: values.copy() for name, values in counted.items()}
        for values in counted.values():
            values[:] = 0.0
        self.add(1.0)
        found = {name: values.copy() for name, values in counted.items()}
        for name, values in so_far.items():
            counted[name][:] = values
        return found

    def add(self, dt: float) -> None:
        """Add the rates of the current state times `dt` [µs]; collective."""
        self._kernel("account", dt)

    def protrusion_impulse(self) -> float:
        """Impulse of the protrusion so far [pN µs/µm]; collective."""
        return float(exact_sum(self._comm, self.of_particles["protrusion_impulse"]))


class Impulses:
    """Impulses on the surfaces of a rank since the last row of the tables.

    bond : (facets, d, 2 d - 1) -- by the substrate on the corners of facets: normal, drag and push along it [pN µs/µm];
    contact : (slots, d) -- by other cells, by particle and cell [pN µs/µm];  key : (slots,) int -- number of a surface
    particle in the scene times the number of cells plus the other cell; slot 0 is for particles of other ranks;
    mine : (n,) int -- this rank's particles of the subdomain's `Surfaces`;  place : (n, d - 1) -- their places along
    the substrate at the last row [µm].
    """

    def __init__(self, part: Subdomain, kernel: Kernel, segments: Segments):
        """Begin at zero, without contacts before the first `follow`."""
        self._kernel, self._part, self._segments = kernel, part, segments.number
        self.cells, self.mine = len(part.scene.kind), part.own_surface
        self.key = np.full(1, -1)
        d = part.scene.dimension
        self.place = np.zeros((len(self.mine), d - 1))
        kernel["bond_impulse"] = np.zeros((len(self._segments), d, 2 * d - 1))
        kernel["contact_impulse"] = np.zeros((1, d))

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Impulses of bonds (n_facets, d, 2 d - 1) and contacts (slots, 2) [pN µs/µm], by the names of the fields."""
        return {name: self._kernel[name] for name in ("bond_impulse", "contact_impulse")}

    @property
    def bond(self) -> np.ndarray:
        """Impulses by the substrate (n_facets, d, 2 d - 1) [pN µs/µm]."""
        return self._kernel["bond_impulse"]

    @property
    def contact(self) -> np.ndarray:
        """Impulses by other cells (slots, 2) [pN µs/µm]."""
        return self._kernel["contact_impulse"]

    def begin(self, x: np.ndarray, bond: np.ndarray, contact: np.ndarray) -> None:
        """Begin again with impulses bond (f, d, 2 d - 1), contact (slots, d) [pN µs/µm], at x (n, d - 1) [µm]."""
        self.place[:], self.bond[:], self.contact[:] = x, bond, contact

    def follow(self, lists: NodeLists) -> None:
        """Assign slots to the particles of new search lists and the cells that they touch; impulses stay."""
        at = self._part.numbering.local(lists.ids)
        mine = (at >= 0) & (at < self._part.n_owned)
        self._kernel["contact_slot"] = self._slots(np.where(mine, lists.surfaces.place[lists.node] * self.cells
                                                            + lists.other, -1))

    def _slots(self, key: np.ndarray) -> np.ndarray:
        """Slots of keys (k,), which are created if they are new."""
        if len(fresh := np.setdiff1d(key, self.key)):
            before, self.key = self.contact, np.concatenate([self.key, fresh])
            self._kernel["contact_impulse"] = np.concatenate([before, np.zeros((len(fresh), before.shape[1]))])
        order = np.argsort(self.key)
        return order[np.searchsorted(self.key, key, sorter=order)]

    def of_surface(self, values: np.ndarray) -> np.ndarray:
        """Sums (n, k) of values (n_segments, d, k) of any unit over the facets of own surface particles."""
        surfaces = self._part.surfaces
        end, n = surfaces.facets[self._segments].ravel(), len(surfaces.ids)
        return np.stack([np.bincount(end, values[:, :, k].ravel(), n)[self.mine] for k in range(values.shape[2])], 1)

    def saved(self, comm: MPI.Intracomm) -> dict[str, Rows]:
        """Keys (k,) int and impulses (k, d) [pN µs/µm] for a checkpoint, rank by rank; collective."""
        count = len(self.key) - 1
        last, size = comm.scan(count), comm.allreduce(count)
        number = np.arange(last - count, last)
        return {"contact key": Rows(number, self.key[1:].copy(), size),
                "contact impulse": Rows(number, self.contact[1:].copy(), size)}

    def restore(self, arrays: Arrays) -> None:
        """Set this rank's impulses from arrays (k,) int and (k, d) [pN µs/µm] that `saved` returned."""
        own, size = self._part.surfaces.place[self.mine], arrays.shape("contact key")[0]
        for first in range(0, size, AT_ONCE):
            number = np.arange(first, min(size, first + AT_ONCE))
            key = arrays.rows("contact key", number)
            mine = np.isin(key // self.cells, own)
            slots = self._slots(key[mine])
            self.contact[slots] = arrays.rows("contact impulse", number[mine])
