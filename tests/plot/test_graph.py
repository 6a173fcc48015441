"""The graph of a colony: which cells touch, how long and how strongly."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PolyCollection
from test_plot import leave_a_run

from mpi4py import MPI

from cellmig.output.xdmf import frames
from cellmig.plot.graph import graph

pytestmark = pytest.mark.serial

CENTRES = np.array([[11.0, 5.2], [0.0, 5.2], [11.0, 5.2], [22.0, 5.2]])  # of all, then of each cell
HISTORY = {"time_us": np.repeat([0.0, 400.0], 4), "cell": np.tile(np.arange(4), 2), "x_um": np.tile(CENTRES[:, 0], 2),
           "y_um": np.tile(CENTRES[:, 1], 2), "name": np.tile(["all", "a", "b", "c"], 2)}
NEIGHBOURS = {"time_us": np.array([400.0, 400.0, 400.0]), "cell": np.array([1, 2, 1]), "neighbour": np.array([2, 3, 3]),
              "cell_contact_um": np.array([2.0, 1.0, 0.0]), "pull_pn_per_um": np.array([5.0, -3.0, 1.0])}


def test_lines_between_centres_are_as_wide_as_contacts_and_cells_as_dark_as_they_have_neighbours(
        tmp_path: Path) -> None:
    found = frames(leave_a_run(tmp_path / "run", MPI.COMM_SELF))
    ax = graph(found, [400.0], HISTORY, NEIGHBOURS).axes[0]
    cells, = (one for one in ax.collections if isinstance(one, PolyCollection))
    lines, = (one for one in ax.collections if isinstance(one, LineCollection))
    assert cells.get_array().tolist() == [1, 2, 1] and len(cells.get_paths()) == 3
    assert [path.tolist() for path in lines.get_segments()] == [CENTRES[[1, 2]].tolist(), CENTRES[[2, 3]].tolist()]
    wide, narrow = np.array(lines.get_linewidths()) - 0.3
    assert wide == pytest.approx(2.0 * narrow) and lines.get_array().tolist() == [5.0, -3.0]
    assert [text.get_text() for text in ax.texts] == ["a", "b", "c"]


def test_there_is_no_graph_without_contacts_or_of_two_cells(tmp_path: Path) -> None:
    found = frames(leave_a_run(tmp_path / "run", MPI.COMM_SELF))
    apart = NEIGHBOURS | {"cell_contact_um": np.zeros(3)}
    assert graph(found, [400.0], HISTORY, apart) is None and graph(found, [400.0], HISTORY, {}) is None
    few = {name: values[HISTORY["cell"] < 3] for name, values in HISTORY.items()}
    assert graph(found, [400.0], few, NEIGHBOURS) is None
