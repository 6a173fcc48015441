"""The fluid is a fluid, at any strain: what resists slow flow, checkerboards, volume, dissipation, and the limit."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import built, case, everywhere, outlines, set_motion
from scipy import sparse

from mpi4py import MPI

from cellmig.case.load import from_dict
from cellmig.case.schema import Case
from cellmig.meshfree import rkpm
from cellmig.meshfree.body import Template
from cellmig.meshfree.stabilisation import MISSED, laplacian
from cellmig.output.manifest import read_manifest
from cellmig.runs.info import info
from cellmig.runs.run import Run
from cellmig.simulation import Simulation
from cellmig.solve import strain
from cellmig.solve.strain import STRETCH_LIMIT, StrainWatch, stretch

MU, RADIUS = 1000.0, 5.0  # Pa µs, µm
INNER = 2.0  # µm, radius of the inner of two cylinders, or what the rings of particles make of it
SLOW = 0.05  # 1/µs: a rate of shear at which the viscous stress is 50 Pa


def drop(per_cell: int, **tables: Any) -> Case:
    """A disc of cytoplasm alone in space, with further tables of a case."""
    tree = case("one_cell", per_cell=per_cell).resolved()
    for key in ("adhesion", "protrusion"):
        tree.pop(key, None)
    del tree["materials"]["nucleus"], tree["cells"][0]["nucleus"], tree["cells"][0]["nucleus_ratio"]
    tree["cells"][0] |= {"centre": ["0 um", "0 um"]} | tables.pop("cell", {})
    return from_dict(tree | tables)


def squeezed(per_cell: int, rate: float = 0.25, tension: float = 500.0) -> Case:
    """A drop that its start velocity (a x, -a y) flattens and its line tension draws together again."""
    gradient = [[f"{rate} /us", "0 /us"], ["0 /us", f"{-rate} /us"]]
    return drop(per_cell, cell={"velocity_gradient": gradient},
                cortex={"law": "line-tension", "line_tension": f"{tension} pN/um"})


class Driven:
    """A drop, some particles of which are moved: x(X, t) is where they are at the time t, if they are `held`."""

    def __init__(self, sim: Simulation, held: np.ndarray, where: Callable[[np.ndarray, float], np.ndarray],
                 v: np.ndarray):
        """`held` (size,) bool by global id;  v (size, 2) -- velocities of all particles at the start [µm/µs]."""
        self.sim, self.held, self.where, self.time = sim, held, where, 0.0
        set_motion(sim, v=v)
        self.mine = np.flatnonzero(held[sim.mechanics.ids])
        self.X = sim.scene.X[sim.mechanics.ids[self.mine]]

    def go(self, stop: float) -> None:
        m, run = self.sim.mechanics, self.sim.integrator
        while self.time < stop:
            run.follow_neighbours()
            owned = m.state.owned
            dt = 0.8 * min(run.control.stable(m.limits()).values())
            steps = min(100, int(np.ceil((stop - self.time) / dt)))
            dt = min(dt, (stop - self.time) / steps)
            for _ in range(steps):
                before = self.where(self.X, self.time)
                m.advance(1, dt)
                self.time += dt
                now = self.where(self.X, self.time)
                owned[self.mine] = np.hstack([now - self.X, (now - before) / dt])
                m.state.exchange()
            self.time = stop if stop - self.time < 1e-9 else self.time

    def pull(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions (k, 2) of the held particles, and the forces (k, 2) of the body on them; collective."""
        sim = self.sim
        a = everywhere(sim, sim.mechanics.rate()[:, 2:])
        x = sim.scene.X + everywhere(sim, sim.mechanics.state.owned[:, :2])
        return x[self.held], (sim.scene.field("mass")[:, None] * a)[self.held]

    def look(self) -> dict[str, float]:
        """Largest stretch; noise of the pressure from particle to particle [Pa], raw and as recovered; on one rank."""
        m = self.sim.mechanics
        self.sim.sample()
        F = m.state.tensors()[0]
        J, recovery = F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0], self.sim.sampler._recovery
        law = self.sim.scene.materials[0]
        p = -0.5 * law.reduced_bulk_modulus * (J - 1.0 / J)
        free = ~self.held[m.ids]
        noise = {name: q - recovery @ q for name, q in (("raw", p), ("recovered", recovery @ p))}
        return {"stretch": float(stretch(F).max()),
                **{name: float(np.sqrt(np.mean(q[free] ** 2))) for name, q in noise.items()}}


def between_cylinders(sim: Simulation, rate: float = 0.1) -> tuple[Driven, float, float]:
    """Flow between a cylinder that turns and one that stands, from its steady state on.

    Returns the drop, the angular velocity [1/µs] and the exact torque [pN]; `rate` : of shear at the inner one [1/µs].
    """
    X = sim.scene.X
    r = np.hypot(X[:, 0], X[:, 1])
    a = r[r < INNER + 1e-9].max()
    turn = 0.5 * rate * (1.0 - (a / RADIUS) ** 2)
    k = turn / (1.0 / a**2 - 1.0 / RADIUS**2)
    w = np.where(r <= a, turn, k * (1.0 / np.maximum(r, a) ** 2 - 1.0 / RADIUS**2))

    def where(X: np.ndarray, t: float) -> np.ndarray:
        angle = turn * t * (np.hypot(X[:, 0], X[:, 1]) <= a)
        c, s = np.cos(angle), np.sin(angle)
        return np.column_stack([c * X[:, 0] - s * X[:, 1], s * X[:, 0] + c * X[:, 1]])

    held = (r <= a) | (r > RADIUS - 1e-6)
    return Driven(sim, held, where, np.column_stack([-w * X[:, 1], w * X[:, 0]])), turn, 4.0 * np.pi * MU * k


def torque(flow: Driven) -> float:
    """Of the fluid on the inner cylinder [pN]."""
    x, f = flow.pull()
    on = np.hypot(x[:, 0], x[:, 1]) < INNER + 1e-6
    return -float((x[on, 0] * f[on, 1] - x[on, 1] * f[on, 0]).sum())


# ------------------------------------------------------------------------------------------------ slow simple shear


def sheared(rate: float, comm: MPI.Comm, noise: float = 0.2) -> tuple[Any, ...]:
    """Shear of a drop whose surface is moved, to 100, 200, … 500 %: shear stress, area, energy lost over exact, hash.

    At the start all velocities have noise, in parts of the surface's: what is unstable under shear would grow.
    """
    stress, area, lost = [], [], []
    with built(drop(150), comm) as sim:
        X, A = sim.scene.X, sim.scene.field("V").sum()
        flow = np.column_stack([rate * X[:, 1], 0.0 * X[:, 1]])
        held = np.isin(np.arange(len(X)), sim.scene.surface(0))
        v = flow + noise * rate * RADIUS * np.random.default_rng(2).standard_normal(X.shape) * ~held[:, None]
        driven = Driven(sim, held, lambda X, t: X + t * rate * X[:, 1:] * [1.0, 0.0], v)
        sim.sample()
        for shear in range(1, 6):
            driven.go(shear / rate)
            x, f = driven.pull()
            stress.append(-(x[:, 1] * f[:, 0]).sum() / A)
            area.append(sim.sample()[0][1]["area_um2"] / A)
            lost.append(sim.sample()[1]["viscous_loss_pn"] / (MU * rate**2 * A * driven.time))
        left = np.abs(everywhere(sim, sim.mechanics.state.owned[:, 2:]) - flow).max() / (rate * RADIUS)
        return np.array(stress), np.array(area), np.array(lost), left, sim.state_hash()


@pytest.mark.serial
def test_slow_shear_to_500_percent_meets_the_viscous_stress_and_nothing_else() -> None:
    stress, area, lost, left, _ = sheared(SLOW, MPI.COMM_SELF)
    assert np.abs(stress - MU * SLOW).max() < 0.05  # Pa, of 50; measured 0.0015 at 100 % and 0.0007 at 500 %
    elastic = 2.0 * stress - sheared(2.0 * SLOW, MPI.COMM_SELF)[0]  # what twice the rate does not double
    assert np.abs(elastic).max() < 0.5  # Pa; measured 0.037 at 100 %, of the noise, and 0.004 from 200 % on
    assert np.abs(area - 1.0).max() < 1e-12  # measured 4e-16
    assert np.abs(lost - 1.0).max() < 0.05  # measured 0.037, all of the noise at the start
    assert left < 0.01  # of the noise of 0.2 and more; measured 0.003


def test_shear_to_500_percent_has_the_same_bits_on_any_number_of_ranks(comm: MPI.Comm) -> None:
    stress, area, *_, bits = sheared(1.0, comm, 0.02)
    assert np.abs(stress[1:] / MU - 1.0).max() < 0.02  # measured 0.01 at 200 %, of the noise at the start, then less
    assert np.abs(area - 1.0).max() < 1e-12  # measured 4e-16
    alone = sheared(1.0, MPI.COMM_SELF, 0.02)
    assert bits == alone[-1] and np.array_equal(stress, alone[0])


# ------------------------------------------------------------------------------- shear that differs from place to place


@pytest.fixture(scope="module")
def cylinders() -> dict[float, dict[str, float]]:
    """Flow between cylinders, by the angle of the inner one: torque over exact, stretch, noise of the pressure."""
    found = {}
    with built(drop(1000), MPI.COMM_SELF) as sim:
        flow, turn, exact = between_cylinders(sim)
        for angle in (0.2, 0.6, 1.45, 2.0):
            flow.go(angle / turn)
            found[angle] = {"torque": torque(flow) / exact, **flow.look()}
    return found


# The torque starts 7 % too high: the layer at the cylinder is 3 spacings thick.
@pytest.mark.serial
def test_shear_flow_between_cylinders_is_resisted_as_it_should_up_to_the_limit(cylinders: dict) -> None:
    start, limit = cylinders[0.2], cylinders[1.45]
    assert abs(start["torque"] - 1.07) < 0.02  # measured 1.070, at 47 % of shear
    assert abs(cylinders[0.6]["torque"] - 1.052) < 0.02  # measured 1.052, at 140 % of shear, stretched 1.67-fold
    assert limit["stretch"] == pytest.approx(STRETCH_LIMIT, abs=0.05)  # measured 2.985, at 340 % of shear
    assert abs(limit["torque"] / start["torque"] - 1.0) < 0.05  # measured 0.048


@pytest.mark.serial
def test_beyond_the_limit_the_fluid_thickens(cylinders: dict) -> None:
    """What the warning is about; neither ledger nor shapes tell."""
    assert cylinders[2.0]["torque"] == pytest.approx(1.218, abs=0.03)  # 470 % of shear, stretched 3.9-fold


@pytest.mark.serial
def test_a_shear_flow_that_stops_leaves_no_elastic_stress() -> None:
    with built(drop(1000), MPI.COMM_SELF) as sim:
        flow, turn, _ = between_cylinders(sim)
        surface = 2.0 * np.pi * INNER**2
        flow.go(0.6 / turn)
        assert torque(flow) / surface > 95.0  # Pa; measured 99.4
        x = flow.where(flow.X, flow.time)
        flow.where = lambda X, t: x
        flow.go(flow.time + 6.0)  # the momentum needs 1 µs
        assert abs(torque(flow)) / surface < 2.0  # Pa; measured 0.82, which creeps away


@pytest.mark.serial
def test_pressure_has_little_checkerboard_and_what_is_shown_has_less(cylinders: dict) -> None:
    """Of the pressure less its linear fits around each particle; 100 Pa is the viscous stress at the inner cylinder."""
    bulk = drop(7).materials["cytoplasm"].reduced_bulk_modulus
    raw, recovered = (max(q[name] for q in cylinders.values()) for name in ("raw", "recovered"))
    assert raw < 1e-4 * bulk  # measured 380 Pa, of 5 MPa: density 8e-5
    assert recovered < 200.0  # Pa; measured 168 at 470 % of shear, 100 at the limit, 31 at 140 %
    assert cylinders[0.6]["recovered"] < 60.0


# ----------------------------------------------------------------------------------- dissipation of waves, stretched


def losses(sim: Simulation, shear: float, wavelength: float, renewed: bool = False) -> np.ndarray:
    """Power lost over exact by shear waves in 12 directions, their length in spacings, in a body sheared before.

    `renewed` : with neighbours, gradients and stabilisation made anew for the sheared body.
    """
    t, found = sim.scene.templates[0], []
    x = t.X @ np.array([[1.0, 0.0], [shear, 1.0]])
    made = anew(t, x) if renewed else None
    k = 2.0 * np.pi / (wavelength * t.spacing)
    for angle in np.arange(12) * np.pi / 12:
        along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        lost = exact = 0.0
        for phase in (0.0, 0.5 * np.pi):
            v = np.sin(k * x @ along + phase)[:, None] * across
            if made is None:
                set_motion(sim, x - t.X, v)
                lost += sum(sim.mechanics.powers()[name].sum() for name in ("viscous_loss", "artificial_dissipation"))
            else:
                lost += lost_anew(t, *made, v)
            exact += MU * k**2 * float(t.V @ np.cos(k * x @ along + phase) ** 2)
        found.append(lost / exact)
    return np.array(found)


def anew(t: Template, x: np.ndarray) -> tuple:
    """Volumes, gradients and stabilisation of a body with the particles of t at x."""
    V, edges = rkpm.dual_cells(x, t.facets)
    support = rkpm.supports(x, edges, 2.2 * t.spacing)
    G = rkpm.consistent(rkpm.gradients(x, support, t.facets), x, V, support, t.facets)
    C, square = laplacian(x, edges)
    return V, G, C.T @ sparse.diags(MISSED * t.laws[0].numerical_viscosity(t.spacing) * V * square) @ C


def lost_anew(t: Template, V: np.ndarray, G: Any, S: Any, v: np.ndarray) -> float:
    """Power that viscosity and stabilisation take from the velocities v."""
    L = np.stack([g @ v for g in G], axis=-1)
    d = 0.5 * (L + L.transpose(0, 2, 1))
    return float(2.0 * MU * (V @ (d**2).sum(axis=(1, 2))) + (v * (S @ v)).sum())


# In a body of 1,485 particles, which is 43 spacings wide, mean over the directions, least and most:
#   stretch    waves of 6 spacings     12 spacings             24 spacings             24, renewed
#   1          1.005 (1.00 to 1.01)    1.001 (1.00 to 1.00)    1.000 (1.00 to 1.00)    1.000
#   1.60       0.975 (0.84 to 1.22)    0.997 (0.95 to 1.08)    1.000 (0.99 to 1.02)    1.003
#   2.41       0.899 (0.69 to 1.18)    0.990 (0.90 to 1.14)    0.998 (0.97 to 1.04)    1.008
#   3.30       1.049 (0.55 to 1.91)    1.057 (0.84 to 1.45)    1.025 (0.96 to 1.16)    1.006
#   5.19       10.21 (0.47 to 28.8)    2.304 (0.81 to 5.20)    1.554 (0.94 to 2.77)    1.011
@pytest.mark.serial
@pytest.mark.parametrize(("shear", "mean"), [(0.0, 1.000), (0.975, 1.000), (2.0, 0.998), (3.0, 1.025), (5.0, 1.554)])
def test_a_stretched_fluid_loses_in_long_waves_what_it_should_up_to_the_limit(shear: float, mean: float) -> None:
    with built(drop(1485), MPI.COMM_SELF) as sim:
        fixed, renewed = losses(sim, shear, 24.0), losses(sim, shear, 24.0, True)
    assert fixed.mean() == pytest.approx(mean, rel=0.01)
    assert fixed.min() > 0.93  # measured 0.94 at the end, 0.97 up to 2.4: no direction flows too easily
    assert abs(renewed.mean() - 1.0) < 0.03  # measured 0.011 at most: it is the reference, not the strain


@pytest.mark.serial
@pytest.mark.parametrize(("wavelength", "most"), [(6.0, 0.01), (12.0, 0.003), (24.0, 0.001)])
def test_a_fluid_at_rest_loses_in_waves_what_it_should(wavelength: float, most: float) -> None:
    with built(drop(1485), MPI.COMM_SELF) as sim:
        lost = losses(sim, 0.0, wavelength)
    assert np.abs(lost - 1.0).max() < most  # measured 0.0075, 0.0014, 0.0004


# ------------------------------------------------------------------------------------------- squeezed flat and released


def history(case: Case, times: np.ndarray, comm: MPI.Comm) -> tuple[np.ndarray, ...]:
    """At these times: width and height (n, 2) [µm], area [µm²], energy error, stretch; at the end: momentum, hash."""
    size, area, error, far = [], [], [], []
    with built(case, comm) as sim:
        for time in times:
            sim.go(float(time))
            rows, ledger = sim.sample()
            x = outlines(sim)
            size.append(np.ptp(x, axis=0))
            area.append(rows[1]["area_um2"])
            error.append(ledger["energy_error"])
            far.append(float(comm.allreduce(stretch(sim.mechanics.state.tensors()[0]).max(), MPI.MAX)))
        ends = sim.sampler.momentum(), sim.state_hash()
        return np.array(size), np.array(area), np.array(error), np.array(far), *ends


TIMES = np.linspace(2.0, 40.0, 20)  # µs: flattest at 10, nearly round at the end


def test_a_drop_squeezed_flat_and_released_conserves_and_has_the_same_bits_on_any_ranks(comm: MPI.Comm) -> None:
    size, area, error, far, momentum, bits = history(squeezed(150), TIMES, comm)
    assert size[:, 0].max() > 18.5 and far.max() > 2.5  # flattened: 10 µm wide at the start; measured 18.56, 2.64
    assert np.abs(size[-1] - 2.0 * RADIUS).max() < 0.2  # and round again; measured 10.12 by 9.82
    assert np.ptp(area) < 2e-3 * area[0]  # measured 9e-4
    assert error.max() < 1e-5  # measured 2e-7
    assert np.abs(momentum).max() < 1e-9  # pN µs/µm; measured 4e-12, of 1e5 each way
    alone = history(squeezed(150), TIMES, MPI.COMM_SELF)
    assert bits == alone[-1] and np.array_equal(size, alone[0]) and np.array_equal(error, alone[2])


@pytest.mark.serial
def test_a_drop_squeezed_flat_is_as_wide_and_high_as_with_finer_particles() -> None:
    coarse, fine = (history(squeezed(n), TIMES, MPI.COMM_SELF)[0] for n in (150, 600))
    assert np.abs(coarse / fine - 1.0).max() < 0.02  # measured 0.013


# ------------------------------------------------------------------------------------------------------- the message


@pytest.mark.serial
def test_stretch_is_the_largest_singular_value_and_indifferent_to_rotation() -> None:
    F = np.eye(2)[:, :, None] + 0.8 * np.random.default_rng(4).standard_normal((2, 2, 100))
    expected = np.linalg.svd(np.moveaxis(F, 2, 0), compute_uv=False)[:, 0]
    c, s = np.cos(0.7), np.sin(0.7)
    assert np.abs(stretch(F) - expected).max() < 1e-13  # measured 9e-16
    assert np.abs(stretch(np.einsum("ij,jkn->ikn", np.array([[c, -s], [s, c]]), F)) - expected).max() < 1e-13


def told(case: Case, until: float, directory: Path, comm: MPI.Comm) -> tuple[list[str], dict]:
    """Lines of warning and the manifest's entry of a run; on all ranks."""
    assert Run(case, directory, comm, until=until, quiet=True).go() == 0
    lines = (directory / "run.log").read_text().splitlines()
    return [line for line in lines if line.startswith("WARNING")], read_manifest(directory).get("strain")


def test_a_run_that_crosses_the_limit_says_so_then_and_at_its_end(comm: MPI.Comm, shared_tmp: Path) -> None:
    case = squeezed(100, 0.4)
    warnings, found = told(case, 8.0, shared_tmp / "run", comm)
    assert len(warnings) == 2 and f"the limit of {STRETCH_LIMIT:g}" in warnings[0], warnings
    assert f"at {found['crossed_at_us']:.6g} µs: particle " in warnings[0] and "of cell 1" in warnings[0]
    assert warnings[1].startswith(f"WARNING: from {found['crossed_at_us']:.6g} µs on fluid was stretched beyond ")
    assert f"up to {found['largest']:.3g}-fold" in warnings[1]
    assert found["largest"] > 3.5 and found["limit"] == STRETCH_LIMIT and 1.0 < found["crossed_at_us"] < 6.0
    assert f"beyond the limit of {STRETCH_LIMIT:g} from {found['crossed_at_us']:.6g} µs on" in info(shared_tmp / "run")
    if comm.rank == 0:
        assert told(case, 8.0, shared_tmp / "alone", MPI.COMM_SELF) == (warnings, found)


@pytest.mark.serial
def test_each_doubling_of_the_limit_is_told_once_with_its_cell() -> None:
    with built(squeezed(100), MPI.COMM_SELF) as sim:
        watch, told = StrainWatch(sim.mechanics), []
        for step, most in enumerate((2.9, 3.1, 5.9, 6.2, 4.0, 6.5, 13.0), 1):
            set_motion(sim, u=sim.scene.X * [most - 1.0, 1.0 / most - 1.0])
            sim.sample()
            told.append(watch.check(float(step)))
    assert [bool(line) for line in told] == [False, True, False, True, False, False, True]
    assert "WARNING at 4 µs: particle " in told[3] and "stretched 6.2-fold, 2.1 times the limit of 3" in told[3]
    assert watch.largest == pytest.approx(13.0, abs=1e-9) and "up to 13-fold" in watch.summary()  # measured 1e-14


def test_a_run_within_the_limit_and_a_solid_beyond_it_are_not_warned_of(
        comm: MPI.Comm, shared_tmp: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    warnings, found = told(squeezed(100), 1.0, shared_tmp / "fluid", comm)
    assert not warnings and 1.1 < found["largest"] < STRETCH_LIMIT and found["crossed_at_us"] is None
    fast = 'cells.0.velocity_gradient=[["2 /us", "0 /us"], ["0 /us", "-2 /us"]]'
    solid = case("nucleus", fast, per_cell=100)
    monkeypatch.setattr(strain, "STRETCH_LIMIT", 1.5)
    assert told(solid, 0.4, shared_tmp / "solid", comm) == ([], None)
    assert strain.STRETCH_LIMIT < stretched(solid, 0.4)  # measured 1.9


def stretched(case: Case, time: float) -> float:
    """Largest stretch of a case at a time."""
    with built(case, MPI.COMM_SELF) as sim:
        sim.go(time)
        sim.sample()
        return float(stretch(sim.mechanics.state.tensors()[0]).max())
