"""What references share: bodies from the paper's case files, initial fields, errors in the L2 norm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mpi4py import MPI

from cellmig.case.load import from_dict, load
from cellmig.case.schema import Case
from cellmig.case.shipped import FOLDER
from cellmig.meshfree.contact import Surfaces
from cellmig.runs.cases import fluid_drop
from cellmig.simulation import Simulation

# The default damping of solids, which nucleus.toml sets to zero.
DAMPED = ("materials.nucleus.stabilisation=0.05", "numerics.bulk_viscosity=0.05")
STILL = [["0 /us", "0 /us"], ["0 /us", "0 /us"]]


def case(name: str, count: int, *sets: str) -> Case:
    """A case of the folder `cases` with `count` particles in each cell and the changes `sets`."""
    return load(FOLDER / f"{name}.toml", [f"particles.per_cell={count}", *sets])


def nucleus(count: int, *sets: str) -> Case:
    """The paper's nucleus, R = 1.415 µm, at rest and without damping."""
    return altered(case("nucleus", count, *sets), {"velocity_gradient": STILL})


def drop(count: int, *sets: str, **tables: Any) -> Case:
    """A disc of the paper's cytoplasm, R = 5 µm, at rest, with further tables of a case."""
    return from_dict(fluid_drop(case("one_cell", count, *sets).resolved()) | tables)


def altered(case: Case, cell: dict[str, Any]) -> Case:
    """A case with changed values of its first cell."""
    tree = case.resolved()
    tree["cells"][0] |= cell
    return from_dict(tree)


def built(case: Case) -> Simulation:
    """A simulation on this process alone."""
    return Simulation(case, MPI.COMM_SELF)


def mean_energy_error(sim: Simulation, times: np.ndarray) -> float:
    """Root mean square [-] of the ledger's error at times (n,) [µs]; at one it may just change its sign; collective."""
    errors = []
    for time in times.tolist():
        sim.go(time)
        errors.append(sim.sample()[1]["energy_error"])
    return float(np.sqrt(np.mean(np.square(errors))))


def set_motion(sim: Simulation, u: np.ndarray | None = None, v: np.ndarray | None = None) -> None:
    """Set displacements u and velocities v (size, d) [µm, µm/µs], ordered by id; renew search lists; collective."""
    m, d = sim.mechanics, sim.case.dimension
    for columns, values in ((slice(0, d), u), (slice(d, 2 * d), v)):
        if values is not None:
            m.state.owned[:, columns] = values[m.ids]
    m.state.exchange()
    m.renew_lists()


def surfaces(sim: Simulation) -> Surfaces:
    """Surfaces of all cells, on every rank."""
    return Surfaces.of(sim.scene)


def outlines(sim: Simulation) -> np.ndarray:
    """Positions of all surface particles (m, d) [µm] on every rank; collective."""
    return sim.comm.bcast(sim.mechanics.segments.everywhere())


def set_state(sim: Simulation, u: np.ndarray | None = None, v: np.ndarray | None = None) -> None:
    """Set displacements u and velocities v (size, d) [µm, µm/µs], ordered by id; renew search lists, ledger and F."""
    set_motion(sim, u, v)
    sim.sample()


def by_id(sim: Simulation, owned: np.ndarray) -> np.ndarray:
    """Values at all particles (size, ...), ordered by id."""
    out = np.zeros((sim.scene.size, *np.shape(owned)[1:]))
    out[sim.mechanics.ids] = owned
    return out


def displacement(sim: Simulation) -> np.ndarray:
    """Displacements of all particles (size, d) [µm]."""
    return by_id(sim, sim.mechanics.state.owned[:, : sim.case.dimension])


def velocity(sim: Simulation) -> np.ndarray:
    """Velocities of all particles (size, d) [µm/µs]; those of leapfrog are of half a step before."""
    return by_id(sim, sim.mechanics.state.owned[:, sim.case.dimension :])


def l2_error(sim: Simulation, found: np.ndarray, right: np.ndarray) -> float:
    """L2 error of a field `found` at all particles (size, ...) over the L2 norm of `right` (size, ...) [-]."""
    squares = [np.square(a).reshape(len(a), -1).sum(axis=1) for a in (found - right, right)]
    return float(np.sqrt(np.divide(*(sim.scene.field("V") @ a for a in squares))))


def displaced(case: Case, runge_kutta: str, time: float) -> np.ndarray:
    """Displacements (size, 2) [µm] at a time [µs]; `runge_kutta` : a type of PETSc's "rk", empty for others."""
    with built(case) as sim:
        if runge_kutta:
            sim.integrator.ts.setRKType(runge_kutta)
        sim.go(time)
        return displacement(sim)


def relative_rms(found: np.ndarray, right: np.ndarray) -> float:
    """Root mean square of an error over that of the exact values [-]."""
    return float(np.sqrt(np.square(found - right).mean() / np.square(right).mean()))


def on_the_rim(sim: Simulation, angles: Sequence[float]) -> np.ndarray:
    """Positions (k, 2) [µm] of the points of a round body's rim with these angles [rad] in the reference configuration.

    They are those of a fitted Fourier series, as particles lie up to half a spacing away from an angle.
    """
    rim = sim.scene.surface(0)
    X, lobes = sim.scene.X[rim], np.arange(1, min(12, len(rim) // 4) + 1)

    def series(at: np.ndarray) -> np.ndarray:
        return np.hstack([np.ones((len(at), 1)), np.cos(np.outer(at, lobes)), np.sin(np.outer(at, lobes))])

    x = X + displacement(sim)[rim]
    return series(np.asarray(angles)) @ np.linalg.lstsq(series(np.arctan2(X[:, 1], X[:, 0])), x, rcond=None)[0]


def on_a_pressed_rim(sim: Simulation, angles: Sequence[float]) -> np.ndarray:
    """Positions (k, 2) [µm] of points of a rim whose curvature jumps where a contact ends; `angles` [rad] as above.

    They are those of quartics through the nine particles nearest to each: a Fourier series would converge slowly.
    """
    rim, out = sim.scene.surface(0), []
    X, x = sim.scene.X[rim], sim.scene.X[rim] + displacement(sim)[rim]
    for angle in angles:
        away = np.angle(np.exp(1j * (np.arctan2(X[:, 1], X[:, 0]) - angle)))
        near = np.argsort(np.abs(away), kind="stable")[:9]
        out.append(np.linalg.lstsq(np.vander(away[near], 5, increasing=True), x[near], rcond=None)[0][0])
    return np.array(out)
