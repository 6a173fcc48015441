"""What `bench` compares: two ways to write the internal force, which agree, and a scene that is timed at rest."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import smooth

from mpi4py import MPI

from cellmig.bench.baseline import Baseline
from cellmig.bench.timing import Scene, probe
from cellmig.solve.start import discretise

pytestmark = pytest.mark.serial
SCENE = Scene(2, 150)


def test_the_baselines_have_one_internal_force_without_resultant() -> None:
    scene = discretise(SCENE.case())
    baseline, v = Baseline(scene), 1e-2 * smooth(scene.X, 1, 5.0)
    found = []
    for step in (baseline.numpy_step, baseline.loop_step):
        baseline.v[:], baseline.F[:] = v, np.eye(2) + 0.01
        step(0.0)
        found.append(baseline.force.copy())
    largest = np.abs(found[0]).max()
    assert np.abs(found[0] - found[1]).max() < 1e-12 * largest  # measured: 2e-15
    assert np.abs(found[0].sum(axis=0)).max() < 1e-12 * largest  # measured: 1e-14


def test_a_probe_times_every_term_and_moves_nothing() -> None:
    found = probe(SCENE, MPI.COMM_SELF, repeats=2, output=True)
    assert {"step", "stress", "divergence", "substrate", "contact", "protrusion"} <= set(found["ns"])
    assert all(t > 0.0 for times in found["ns"].values() for t in times["wall"])
    assert {"control", "lists", "sample", "frame"} <= set(found["us"])
    assert found["traffic_bytes"] > 0.0
