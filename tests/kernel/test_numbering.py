"""Local numbers of particles: every neighbour is there, whatever its weight."""

from __future__ import annotations

import numpy as np
from scenes import case

from cellmig.kernel.layout import number
from cellmig.solve.start import discretise


def test_neighbours_whose_gradients_are_zero_are_read_all_the_same() -> None:
    scene = discretise(case("all_protrude"))
    owned = np.flatnonzero(scene.X[:, 1] < 4.9)
    expected = number(scene, owned, owned[:0])
    for t in scene.templates:
        for G in t.G:
            off = G.indices != np.repeat(np.arange(len(t.X)), np.diff(G.indptr))
            G.data[off & (np.arange(G.nnz) % 3 > 0)] = 0.0
    found = number(scene, owned, owned[:0])
    assert np.array_equal(found.ids, expected.ids) and found.n_rows == expected.n_rows
    assert np.array_equal(found.shared, expected.shared)
