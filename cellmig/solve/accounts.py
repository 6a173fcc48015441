"""What is counted step by step: losses, work, and impulses for the mean forces of the tables."""

from __future__ import annotations

from typing import Any

import numpy as np

from mpi4py import MPI

from ..meshfree.contact import ContactLists, Surfaces
from ..parallel.collect import gathered

# Of particles.
ACCOUNTS = ("viscous_loss", "artificial_dissipation", "friction_loss", "protrusion_impulse", "external_work")


def accounts(mechanics: Any) -> dict[str, np.ndarray]:
    """All that is counted, by the name of its array, to write to: (n_owned,) of the particles; impulses at surfaces."""
    k = mechanics.kernel
    return {**{name: k[name][: mechanics.n_owned] for name in ACCOUNTS},
            **{name: k[name] for name in ("bond_impulse", "contact_impulse")}}


def rates(mechanics: Any) -> dict[str, np.ndarray]:
    """Rates of the accounts for the state as it is; collective."""
    counted = accounts(mechanics)
    kept = {name: values.copy() for name, values in counted.items()}
    for values in counted.values():
        values[:] = 0.0
    mechanics.kernel("account", 1.0)
    found = {name: values.copy() for name, values in counted.items()}
    for name, values in kept.items():
        counted[name][:] = values
    return found


class Impulses:
    """What the surfaces of a rank got since the last row of the tables.

    bond : (segments, 2, 3) -- from the substrate by the ends of segments: along y, drag and push along x [pN µs/µm];
    contact : (slots, 2) -- from other cells, by particle and cell [pN µs/µm];  key : (slots,) -- surface particle times
    the number of cells plus the other cell; slot 0 is for particles of other ranks;  mine : (n,) int -- this rank's
    surface particles;  place : (n,) -- their x at the last row [µm].
    """

    def __init__(self, kernel: Any, surfaces: Surfaces, is_mine: np.ndarray, segments: np.ndarray):
        """`is_mine` : (m,) bool -- surface particles of this rank;  `segments` : those of its arrays, by first end."""
        self._kernel, self._surfaces, self._is_mine, self._segments = kernel, surfaces, is_mine, segments
        self.cells, self.mine = int(surfaces.cell[-1]) + 1, np.flatnonzero(is_mine)
        self.key = np.full(1, -1)
        self.place = np.zeros(len(self.mine))
        kernel["bond_impulse"], kernel["contact_impulse"] = np.zeros((len(segments), 2, 3)), np.zeros((1, 2))

    @property
    def bond(self) -> np.ndarray:
        """From the substrate."""
        return self._kernel["bond_impulse"]

    @property
    def contact(self) -> np.ndarray:
        """From other cells."""
        return self._kernel["contact_impulse"]

    def begin(self, x: np.ndarray, bond: np.ndarray, contact: np.ndarray) -> None:
        """Count anew, from these impulses on, with the surface particles at x (n,) [µm]."""
        self.place[:], self.bond[:], self.contact[:] = x, bond, contact

    def follow(self, lists: ContactLists) -> None:
        """A slot for every particle of new search lists and the cell that it touches; what was counted stays."""
        other = self._surfaces.cell[lists.candidate[lists.first[:-1]]]
        self._kernel["contact_slot"] = self._slots(np.where(self._is_mine[lists.node],
                                                            lists.node * self.cells + other, -1))

    def _slots(self, key: np.ndarray) -> np.ndarray:
        """Where the impulses of some keys are, made if they are new."""
        if len(fresh := np.setdiff1d(key, self.key)):
            before, self.key = self.contact, np.concatenate([self.key, fresh])
            self._kernel["contact_impulse"] = np.concatenate([before, np.zeros((len(fresh), 2))])
        order = np.argsort(self.key)
        return order[np.searchsorted(self.key, key, sorter=order)]

    def of_surface(self, values: np.ndarray) -> np.ndarray:
        """Values of bonds by this rank's surface particles (n, 3): those of both their segments."""
        at = [np.searchsorted(self._segments, some) for some in (self.mine, self._surfaces.before[self.mine])]
        return values[at[0], 0] + values[at[1], 1]

    def saved(self, comm: MPI.Comm) -> dict[str, np.ndarray | None]:
        """Arrays for a checkpoint, in an order that no partition changes, on rank 0; collective."""
        key = np.sort(np.concatenate(comm.allgather(self.key[1:])))
        values = gathered(comm, np.searchsorted(key, self.key[1:]), self.contact[1:], len(key))
        return {"contact key": key if comm.rank == 0 else None, "contact impulse": values}

    def restore(self, key: np.ndarray, values: np.ndarray) -> None:
        """Go on from what was saved, of which this rank takes its own."""
        mine = self._is_mine[key // self.cells]
        slots = self._slots(key[mine])
        self.contact[slots] = values[mine]
