"""Pictures of how cells moved, and fields behind them."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scenes import CASES

from mpi4py import MPI

from cellmig.case.messages import CaseError
from cellmig.case.time_unit import TimeUnit
from cellmig.case.units import number
from cellmig.output.grids import GridFrames, OnGrid
from cellmig.output.tables import CUES, cue_columns
from cellmig.output.tracks import Tracks
from cellmig.output.xdmf import frames
from cellmig.plot import tracks
from cellmig.plot.background import Stored
from cellmig.plot.kymograph import kymograph
from cellmig.plot.plot import plot
from cellmig.plot.snapshots import shapes, view_of

pytestmark = pytest.mark.serial

FIELD = 'fields.CXCL12={law="formula", formula="5 + 0.1*x + 2*t_h nM"}'


@pytest.fixture(scope="module")
def run(cellmig: Callable[..., subprocess.CompletedProcess], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cell that crawls with a polarity for six minutes through a field that grows."""
    run = tmp_path_factory.mktemp("motion") / "run"
    sets = ("particles.per_cell=60", "time.samples=360", "time.frames=60", 'polarity={persistence="10 min"}', FIELD,
            'substrate.stiffness="3 kPa"')
    done = cellmig(1, CASES["crawl"], *(word for text in sets for word in ("--set", text)), "--until", "6 min",
                   "--out", run, "--quiet")
    assert done.returncode == 0, done
    return run


def walk(d: int, cells: int = 2, n: int = 61) -> Tracks:
    """Random tracks in d dimensions, hourly."""
    x = np.random.default_rng(1).standard_normal((cells, n, d)).cumsum(axis=1)
    return Tracks(np.arange(float(n)), x, tuple(f"Cell-{k + 1}" for k in range(cells)), TimeUnit("h"))


def test_the_pictures_of_a_run_with_tracks_are_drawn(run, tmp_path):
    drawn = {path.stem for path in plot(run, formats=("svg",), out=tmp_path)}
    assert drawn == {"shapes", "displacement", "ledger", "traction", "tracks", "msd", "kymograph", "cues"}


def test_tracks_are_x_against_time_from_the_side_and_start_together_in_the_plane():
    (ax,) = tracks.tracks(walk(2)).axes
    assert [line.get_ydata()[3] for line in ax.lines] == walk(2).x[:, 3, 0].tolist()
    plane, rose = tracks.tracks(walk(3)).axes
    assert plane.lines[0].get_xdata()[0] == plane.lines[0].get_ydata()[0] == 0.0
    assert sum(bar.get_height() for bar in rose.patches) == pytest.approx(100.0)


def test_steps_along_x_fill_one_sector_of_the_rose_around_its_axis():
    x = np.array([[[0.0, 0.0, 1.0], [1.0, 1e-9, 1.0], [3.0, 0.0, 1.0]]])
    found = Tracks(np.arange(3.0), x, ("A",), TimeUnit("h"))
    bars = tracks.tracks(found).axes[1].patches
    assert [bar.get_height() for bar in bars] == [100.0] + [0.0] * (len(bars) - 1)
    assert bars[0].get_x() + 0.5 * bars[0].get_width() == pytest.approx(0.0)


def test_the_mean_square_displacement_is_drawn_with_its_fit_and_not_of_cells_at_rest():
    x = np.random.default_rng(2).standard_normal((30, 400, 1))
    for k in range(1, 400):
        x[:, k] = 0.9 * x[:, k - 1] + 0.44 * x[:, k]
    found = Tracks(np.arange(400.0), np.pad(x.cumsum(axis=1), ((0, 0), (0, 0), (0, 1))), tuple(map(str, range(30))),
                   TimeUnit("min"))
    (ax,) = tracks.squares(found).axes
    assert any("τ = " in text.get_text() for text in ax.get_legend().get_texts())
    rest = Tracks(found.time, np.zeros((1, 400, 2)), ("A",), TimeUnit("min"))
    assert tracks.squares(rest) is None


def test_a_kymograph_has_the_velocity_of_the_cell_that_touches_and_the_tension_between_its_ends():
    found = Tracks(np.array([0.0, 1.0, 2.0]), np.zeros((1, 3, 2)), ("A",), TimeUnit("h"))
    found.x[0, :, 0] = [0.0, 3.0, 4.0]
    table = {"time_h": np.repeat([1.0, 2.0], 3), "x_um": np.tile([0.5, 1.5, 2.5], 2), "name": np.array(["A"] * 6),
             "cell": np.ones(6, int), "tangential_now_pa": np.array([4.0, 1e-9, -4.0, 2.0, 1e-9, -2.0])}
    axes = kymograph(found, table, np.array([0.0, 1.0, 2.0])).axes
    speed, pull, tense = (ax.collections[0].get_array().reshape(2, 3) for ax in axes[:3])
    assert speed.tolist() == [[3.0] * 3, [1.0] * 3]
    assert pull[:, 0].tolist() == [4.0, 2.0] and tense[:, 1].tolist() == pytest.approx([4.0, 2.0])
    assert kymograph(found, table | {"tangential_now_pa": np.zeros(6)}, np.array([0.0, 1.0, 2.0])) is None
    assert kymograph(found, {}, np.array([0.0, 1.0, 2.0])) is None


@pytest.mark.parametrize("d", [2, 3])
def test_polarity_and_each_cue_have_a_panel_and_many_cells_none(d):
    def table(cells: int) -> dict[str, np.ndarray]:
        columns = {"time_h": np.repeat(np.arange(3.0), cells), "cell": np.tile(np.arange(cells) + 1, 3),
                   "name": np.tile([f"Cell-{k + 1}" for k in range(cells)], 3)}
        rest = [*CUES[d][3:], *cue_columns(["contact", "CXCL12"], d)]
        return columns | {name: np.arange(3.0 * cells) for name in rest}

    axes = tracks.cues(table(2)).axes
    assert [ax.get_ylabel() for ax in axes] == ["polarity", "contact", "CXCL12"]
    assert len(axes[1].lines) == 2 * (d - 1) + 1
    along = ["along x", "along y"] if d == 3 else []
    assert [text.get_text() for text in axes[0].get_legend().get_texts()] == ["Cell-1", "Cell-2", *along]
    assert tracks.cues(table(8)) is None and tracks.cues({}) is None


def test_the_field_behind_cells_has_its_values_at_its_place_and_time(run):
    found = frames(run)
    behind = view_of(run, found, "effective_stress").behind
    assert behind.label == "CXCL12 [nM]"
    place = np.array([[10.0, 3.0], [-20.0, 1.0]])
    assert behind.values(place, found[0]) == pytest.approx([6.0, 3.0])
    assert behind.values(place, found[-1]) == pytest.approx([6.2, 3.2])
    picture = shapes(run, [0.0]).axes[0].collections[0]
    x = picture.get_coordinates()[..., 0]
    assert picture.get_array().ravel()[0] == pytest.approx(5.0 + 0.1 * x[0, :2].mean())


def test_a_field_that_diffuses_is_that_of_the_nearest_frame_and_ends_with_its_box(tmp_path):
    writer = GridFrames(tmp_path, MPI.COMM_SELF, unit=TimeUnit("h"))
    for time in (0.0, 3.6e9):
        values = np.arange(6.0) + 10.0 * (time > 0.0)  # along x first
        writer.write(time, {"cAMP": OnGrid((-3.0, 0.0), (2.0, 5.0), (3, 2), values, "nM")})
    place, size = np.array([[-2.0, 1.0], [2.9, 9.0], [3.1, 1.0]]), number("1 nM", "nM")
    found = Stored(tmp_path, "cAMP")
    assert found and found.unit == "nM"
    assert found.value(place, 1e9) / size == pytest.approx([0.0, 5.0, np.nan], nan_ok=True)
    assert found.value(place, 2e9) / size == pytest.approx([10.0, 15.0, np.nan], nan_ok=True)
    assert not Stored(tmp_path / "without", "cAMP")


def test_another_field_or_none_is_behind_and_one_that_is_not_there_is_told(run):
    found = frames(run)
    assert view_of(run, found, "effective_stress", "none").behind is None
    assert view_of(run, found, "effective_stress", "stiffness").behind is None  # it is uniform
    with pytest.raises(CaseError, match="no field 'CXCL'; did you mean 'CXCL12'"):
        view_of(run, found, "effective_stress", "CXCL")
