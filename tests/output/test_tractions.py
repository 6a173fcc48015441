"""What tractions tell of the cells above, against what is put in, and against the stress of particles."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import built, case, everywhere

from mpi4py import MPI

from cellmig.output.tractions import moments, tension

pytestmark = pytest.mark.serial


def test_two_ends_that_pull_together_are_a_contractile_dipole_under_tension():
    place, pull = np.array([[-3.0], [-1.0], [1.0], [3.0]]), np.array([[5.0], [0.0], [0.0], [-5.0]])
    net, dipole = moments(place, pull, 2.0, np.zeros(1))
    assert net == [0.0] and dipole == [[-60.0]]
    assert tension(pull[:, 0], 2.0).tolist() == [0.0, 10.0, 10.0, 10.0, 0.0]


def test_a_dipole_without_net_force_has_no_origin_and_one_with_it_does():
    rng = np.random.default_rng(0)
    place, pull = rng.uniform(-5, 5, (40, 2)), rng.standard_normal((40, 2))
    away = np.array([3.0, -7.0])
    net, one = moments(place, pull, 0.3, np.zeros(2))
    assert moments(place, pull, 0.3, away)[1] == pytest.approx(one - np.outer(away, net))
    pull -= pull.mean(axis=0)
    assert moments(place, pull, 0.3, away)[1] == pytest.approx(moments(place, pull, 0.3, np.zeros(2))[1])


@pytest.mark.parametrize(("per_cell", "error"), [(100, 0.05), (331, 0.02)])  # measured 0.035, 0.014
def test_the_tension_from_tractions_is_the_stress_of_cells_and_their_membranes(per_cell, error):
    """Three cells that crawl in a row: in sum over the layer, and along it."""
    half, line = 4.0, 30.0  # of a window [µm]; line tension of the case [pN/µm]
    with built(case("crawl_row", 'time.end="0.1 h"', per_cell=per_cell), MPI.COMM_SELF) as s:
        s.next_row(s.sample()[0])
        s.go(3.6e8)
        table, m = s.next_row(s.sample()[0])["substrate"], s.mechanics
        x = (s.scene.X + everywhere(s, m.state.u))[:, 0]
        stress, J = (everywhere(s, values[: m.n_owned]) for values in s.sampler.nodal_stress())
        force = s.scene.field("V") * J * stress[:, 0, 0]  # times a length [pN]
        contact = everywhere(s, m.surface_force("contact")[0])[:, 0]
        corners = m.segments.owned()[1]
        width = s.interval.width
    ends = corners[:, 1] - corners[:, 0]
    membrane = line * ends[:, 0] ** 2 / np.linalg.norm(ends, axis=1)
    first, last = min(row["x_um"] for row in table), max(row["x_um"] for row in table)
    pull = np.zeros(round((last - first) / width) + 1)
    for row in table:
        pull[round((row["x_um"] - first) / width)] += row["tangential_now_pa"]
    found, edges = tension(pull, width), first + width * (np.arange(len(pull) + 1) - 0.5)
    assert abs(found[-1]) < 1e-4 * found.max()  # drag of the medium: measured 6e-6
    whole = force.sum() + membrane.sum() - (x * contact).sum()
    assert width * found.sum() == pytest.approx(whole, rel=2e-5)  # measured 2e-6: forces in balance to 5e-7
    for at in np.arange(edges[0] + half, edges[-1] - half, 1.0):
        near, there, on = (np.maximum(half - np.abs(place - at), 0.0) / half**2 for place in (
            edges, x, corners[:, :, 0].mean(axis=1)))  # weights of a window
        parts = force @ there + membrane @ on
        assert width * found @ near == pytest.approx(parts, abs=error * found.max())
