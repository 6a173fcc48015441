"""Bodies that references start from: parts of the paper's case files, alone in space."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from mpi4py import MPI

from cellmig.case.load import from_dict, load
from cellmig.case.schema import Case
from cellmig.runs.cases import FOLDER
from cellmig.simulation import Simulation

# The damping that solids have by default, of which nucleus.toml has none.
DAMPED = ("materials.nucleus.stabilisation=0.15", "numerics.bulk_viscosity=0.05")
STILL = [["0 /us", "0 /us"], ["0 /us", "0 /us"]]


def case(name: str, count: int, *sets: str) -> Case:
    """A case of the folder `cases` with so many particles a cell, and with other values if wanted."""
    return load(FOLDER / f"{name}.toml", [f"particles.per_cell={count}", *sets])


def nucleus(count: int, *sets: str) -> Case:
    """The paper's nucleus, R = 1.415 µm, at rest and without any damping."""
    return altered(case("nucleus", count, *sets), {"velocity_gradient": STILL})


def drop(count: int, *sets: str, **tables: Any) -> Case:
    """A disc of the paper's cytoplasm, R = 5 µm, at rest, with further tables of a case."""
    tree = case("one_cell", count, *sets).resolved()
    for key in ("adhesion", "protrusion"):
        tree.pop(key, None)
    del tree["materials"]["nucleus"], tree["cells"][0]["nucleus"], tree["cells"][0]["nucleus_ratio"]
    tree["cells"][0] |= {"centre": ["0 um", "0 um"]}
    return from_dict(tree | tables)


def altered(case: Case, cell: dict[str, Any]) -> Case:
    """A case with other values of its first cell."""
    tree = case.resolved()
    tree["cells"][0] |= cell
    return from_dict(tree)


@contextmanager
def built(case: Case) -> Iterator[Simulation]:
    """A simulation on this process alone, destroyed afterwards."""
    simulation = Simulation(case, MPI.COMM_SELF)
    try:
        yield simulation
    finally:
        simulation.destroy()


def put(sim: Simulation, u: np.ndarray | None = None, v: np.ndarray | None = None) -> None:
    """Give the particles displacements u and velocities v (size, 2), by global id, and make lists, ledger, F anew."""
    m = sim.mechanics
    for columns, values in ((slice(0, 2), u), (slice(2, 4), v)):
        if values is not None:
            m.state.owned[:, columns] = values[m.ids]
    m.state.exchange()
    m.renew_lists()
    sim.sample()


def by_id(sim: Simulation, owned: np.ndarray) -> np.ndarray:
    """Values at the particles (size, ...) by global id."""
    out = np.zeros((sim.scene.size, *np.shape(owned)[1:]))
    out[sim.mechanics.ids] = owned
    return out


def displacement(sim: Simulation) -> np.ndarray:
    """Of all particles (size, 2) [µm]."""
    return by_id(sim, sim.mechanics.state.owned[:, :2])


def velocity(sim: Simulation) -> np.ndarray:
    """Of all particles (size, 2) [µm/µs]: half a step late where the leapfrog has it."""
    return by_id(sim, sim.mechanics.state.owned[:, 2:])


def on_the_rim(sim: Simulation, angles: Sequence[float]) -> np.ndarray:
    """Where the points of the rim of a round body are that were at these angles (k, 2) [µm], particles there or not.

    A Fourier series in the angle is fitted: particles miss the axes by half a spacing, more or less by chance.
    """
    rim = sim.scene.surface(0)
    X, lobes = sim.scene.X[rim], np.arange(1, min(12, len(rim) // 4) + 1)

    def series(at: np.ndarray) -> np.ndarray:
        return np.hstack([np.ones((len(at), 1)), np.cos(np.outer(at, lobes)), np.sin(np.outer(at, lobes))])

    x = X + displacement(sim)[rim]
    return series(np.asarray(angles)) @ np.linalg.lstsq(series(np.arctan2(X[:, 1], X[:, 0])), x, rcond=None)[0]
