"""Local numbers of particles: every neighbour is there, whatever its weight."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scenes import case
from scipy import sparse

from cellmig.kernel.layout import number
from cellmig.meshfree.body import Template
from cellmig.solve.start import discretise


def with_zeros(t: Template) -> Template:
    """A template most of whose gradients are zero, but for those of a particle itself."""

    def some(G: sparse.csr_matrix) -> sparse.csr_matrix:
        off = G.indices != np.repeat(np.arange(len(t.X)), np.diff(G.indptr))
        data = np.where(off & (np.arange(G.nnz) % 3 > 0), 0.0, G.data)
        return sparse.csr_matrix((data, G.indices, G.indptr), G.shape)

    return replace(t, G=tuple(map(some, t.G)))


def test_neighbours_whose_gradients_are_zero_are_read_all_the_same() -> None:
    scene = discretise(case("all_protrude"))
    owned = np.flatnonzero(scene.X[:, 1] < 4.9)
    expected = number(scene, owned, owned[:0])
    found = number(replace(scene, templates=[with_zeros(t) for t in scene.templates]), owned, owned[:0])
    assert np.array_equal(found.ids, expected.ids) and found.n_rows == expected.n_rows
    assert np.array_equal(found.shared, expected.shared)
