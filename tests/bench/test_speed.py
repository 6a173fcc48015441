"""What `bench` compares: two ways to write the kernel's internal force, and scenes timed at rest."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import built, everywhere, smooth

from mpi4py import MPI

from cellmig.bench.baseline import Baseline
from cellmig.bench.speed import report
from cellmig.bench.timing import ANEW, Scene, probe
from cellmig.commands import bench
from cellmig.simulation import Simulation
from cellmig.usage import UsageError, parse

pytestmark = pytest.mark.serial
SCENES = {"plane": Scene(2, 150), "space": Scene(2, 200, None, 3, begin=0.01)}


@pytest.mark.parametrize("name", SCENES)
def test_the_baselines_have_the_internal_force_of_the_kernel_and_no_resultant(name: str) -> None:
    case = SCENES[name].case()
    with built(case, MPI.COMM_SELF) as sim:
        baseline, X = Baseline(sim.scene), sim.scene.X
        u, v = (size * smooth(X, seed, 5.0) for seed, size in ((1, 1e-2), (2, 1e-2)))
        *columns, bend = (part @ u for part in baseline.G)
        F = np.eye(case.dimension) + np.stack(columns, axis=2)
        found = [_of_kernel(sim, u, v)]
        for step in (baseline.numpy_step, baseline.loop_step):
            baseline.v[:], baseline.F[:], baseline.bend[:] = v, F, bend
            step(0.0)
            found.append(baseline.force.copy())
    largest = np.abs(found[0]).max()
    for force in found:
        assert np.abs(force - found[0]).max() < 1e-12 * largest
        assert np.abs(force.sum(axis=0)).max() < 1e-12 * largest


def _of_kernel(sim: Simulation, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The kernel's internal force (n, d) for displacements and velocities, as what a kick of 1 µs adds to v."""
    m, d = sim.mechanics, sim.scene.dimension
    m.state.owned[:] = np.hstack([u, v])[m.ids]
    for call, *given in (("deformation",), ("stress_of_rate", 0.0, 0.0, 0.0)):
        m.kernel(call, *given)
    m.kernel["force"][:], m.state.owned[:] = 0.0, 0.0
    m.kernel("kick_and_drift", 1.0, 0.0)
    return sim.scene.field("mass")[:, None] * everywhere(sim, m.state.owned[:, d:])


@pytest.mark.parametrize("name", SCENES)
def test_a_probe_times_every_term_and_moves_nothing(name: str) -> None:
    found = probe(SCENES[name], MPI.COMM_SELF, repeats=2, output=True)
    assert {"step", "stress", "divergence", "substrate", "contact", "protrusion"} <= set(found["ns"])
    assert all(t > 0.0 for times in found["ns"].values() for t in times["wall"])
    assert {"control", "lists", "sample", "frame"} <= set(found["us"])
    assert found["traffic_bytes"] > 0.0
    seconds, ns = {"first": 2.0, "second": 1.0}, {"numpy": [300.0], "plain loop in C": [60.0]}
    said = report({"limits": {"bandwidth": [20.0], "arithmetic": [60.0]}, "baseline_ns": ns, "start_s": seconds,
                   "probes": [found]})
    told = "Pieces of contact serve for some steps, for one in \"contact anew\"" in "\n".join(said)
    assert told == (ANEW in found["ns"]) == (name == "space")


@pytest.mark.parametrize("kind", ["--error", "--modulus", "--cues"])
def test_what_is_of_the_plane_alone_is_not_measured_in_space(kind: str) -> None:
    with pytest.raises(UsageError, match="--dimension is for the cost of a step, also with --scaling"):
        bench(parse(["bench", kind, "--dimension", "3"]))
