"""Pictures of a run, what it was, and whether two of them are the same: read from the files that it left."""

from itertools import pairwise
from pathlib import Path

import h5py
import matplotlib.image
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.quiver import QuiverKey
from matplotlib.text import Text
from PIL import Image

from mpi4py import MPI

from cellmig.case.messages import CaseError
from cellmig.output.directory import OutputError
from cellmig.output.manifest import write_manifest
from cellmig.output.tables import History, Ledger, read_table
from cellmig.output.xdmf import Frame, Frames, frames
from cellmig.plot.plot import _displacement, plot
from cellmig.plot.snapshots import nearest_frames
from cellmig.plot.traction import _windows, between, by_place, limit_axis, pulls, traction, usual_peak
from cellmig.plot.view import View, drawing
from cellmig.runs.diff import diff
from cellmig.runs.info import info
from cellmig.runs.summary import describe_volumes

COMM = MPI.COMM_WORLD
FIELDS = {"id": "", "cell": "", "material": "", "surface": "", "X": "um", "u": "um", "v": "um/us",
          "effective_stress": "Pa", "stress": "Pa"}


def disc(cell: int, rings: int = 9) -> dict[str, np.ndarray]:
    """A cell of radius 5 um with a nucleus of 2 um, in rings; the outermost is its surface."""
    radius = np.concatenate([np.full(max(1, 6 * k), 5.0 * k / rings) for k in range(rings + 1)])
    angle = np.concatenate([2 * np.pi * np.arange(max(1, 6 * k)) / max(1, 6 * k) for k in range(rings + 1)])
    n, outer = len(radius), 6 * rings
    surface = np.full(n, -1, dtype=np.int32)
    surface[-outer:] = np.arange(outer)
    x = np.column_stack([11.0 * (cell - 1) + radius * np.cos(angle), 5.2 + radius * np.sin(angle)])
    material = (radius > 2.0).astype(np.int32)
    return {"cell": np.full(n, cell, dtype=np.int32), "material": material, "surface": surface, "X": x}


def scene(time: float, kick: float = 0.0) -> dict[str, np.ndarray]:
    """Three cells that flatten and move; `kick` is added to the displacement of particle 100 after 200 us."""
    cells = [disc(cell) for cell in (1, 2, 3)]
    fields = {name: np.concatenate([cell[name] for cell in cells]) for name in cells[0]}
    x, n = fields["X"], len(fields["X"])
    flat = 0.4 * time / 400.0
    u = np.column_stack([0.3 * flat * (x[:, 0] - 11.0) + 8.0 * (time / 400.0) ** 2, -flat * x[:, 1] * x[:, 1] / 10.4])
    u[100] += kick * (time > 200.0)
    stress = np.zeros((n, 3, 3))
    stress[:, 0, 0] = x[:, 0]
    return fields | {"id": np.arange(n, dtype=np.int64), "u": u, "v": u / 400.0, "stress": stress,
                     "effective_stress": 300.0 * flat * (1.0 + np.sin(x[:, 0]) * np.exp(-x[:, 1] / 3.0))}


def leave_a_run(directory: Path, comm=COMM, kick: float = 0.0, samples: int = 21, names=()) -> Path:
    """A run as it would be on the ranks of `comm`, its particles dealt out in a way that changes with time."""
    if comm.rank == 0:
        directory.mkdir()
        manifest = {"case": {"title": "test scene"}, "ranks": comm.size, "wall_seconds": 65.0, "skipped": {}}
        write_manifest(directory, manifest)
    comm.barrier()
    writer, ledger = Frames(directory, comm, FIELDS), Ledger(directory, comm)
    history = History(directory, comm, ("name",) if names else ())
    history.names = names
    for step in range(samples):
        time = 20.0 * step
        fields = scene(time, kick)
        mine = (fields["id"] + step) % comm.size == comm.rank
        writer.write(time, step, {name: values[mine] for name, values in fields.items()})
        contacts = {"substrate_contact_um": 3 + time / 100, "cell_contact_um": time / 200}
        history.write(time, [{"ux_um": cell + time / 50, **contacts} for cell in range(4)])
        ledger.write(time, {"elastic_pn": time, "viscous_loss_pn": -0.99 * time, "energy_error": 1e-4 * step})
    comm.barrier()
    return directory


@pytest.fixture
def run(shared_tmp: Path) -> Path:
    """A finished run on all ranks."""
    return leave_a_run(shared_tmp / "run")


def test_the_pictures_of_a_run_are_drawn_whatever_its_number_of_ranks(run, shared_tmp):
    made = plot(run, out=shared_tmp / f"by{COMM.rank}")
    assert [path.name for path in made] == [f"{name}.{kind}" for name in ("shapes", "displacement", "ledger")
                                            for kind in ("png", "pdf")]
    for path in made[::2]:
        picture = matplotlib.image.imread(path)
        assert picture.shape[1] > 1000 and np.ptp(picture[..., :3]) > 0.9  # 6 inches at 200 dpi, and not blank
    assert made[1].read_bytes().startswith(b"%PDF")


@pytest.mark.serial
def test_a_film_has_all_frames_in_one_size_and_one_colour_scale(run, shared_tmp, monkeypatch):
    monkeypatch.setenv("PATH", "")  # no ffmpeg
    *_, path = plot(run, out=shared_tmp, formats=("svg",), moving=True)
    assert (shared_tmp / "shapes.svg").read_text().startswith("<?xml")
    with Image.open(path) as film:
        pictures = []
        for number in (0, film.n_frames - 1):
            film.seek(number)
            pictures.append(np.array(film.convert("RGB"), dtype=int))
    assert path.name == "film.gif" and film.n_frames == 21
    edge = pictures[0].shape[1] * 9 // 10  # right of it are the colours and their numbers
    apart = np.abs(pictures[0] - pictures[1])
    assert apart[:, edge:].mean() < 2.0 < apart[:, :edge].mean()  # measured 0.55 and 46: palettes differ


SAMPLES = np.array([0.0, 1.0, 2.0, 4.0])
TRACTION = {"time_us": np.array([0.0, 1.0, 1.0, 4.0]), "cell": np.array([1, 1, 2, 2]),
            "x_um": np.array([-0.25, 0.25, 0.25, 1.75]), "normal_pa": np.array([np.nan, 3.0, 4.0, -5.0])}


@pytest.mark.serial
def test_the_map_of_traction_has_what_the_table_lists_and_nothing_elsewhere():
    (edges,), found = by_place(TRACTION, SAMPLES, "normal_pa")
    assert edges == pytest.approx([-0.5, 0.0, 0.5, 1.0, 1.5, 2.0])
    assert found.tolist() == [[0, 7, 0, 0, 0], [0, 0, 0, 0, 0], [0, 0, 0, 0, -5]]


def test_pictures_follow_cells_that_go_far_and_show_whole_ways_that_are_short(shared_tmp):
    """Cells of 31 um: a way of 8 um, as in `scene`, is shown whole; one of 400 um would make them specks."""
    for way, follows in ((0.0, False), (400.0, True)):
        writer, places = Frames(shared_tmp / f"{way:g}", COMM, FIELDS), []
        for step in range(3):
            fields = scene(200.0 * step)
            fields["u"][:, 0] += way * step / 2
            places.append(fields["X"] + fields["u"])
            mine = fields["id"] % COMM.size == COMM.rank
            writer.write(200.0 * step, step, {name: values[mine] for name, values in fields.items()})
        COMM.barrier()
        found = frames(shared_tmp / f"{way:g}")
        view = View.of(shared_tmp / f"{way:g}", found, "effective_stress")
        _, axes = view.panels(3)
        for ax, frame, x in zip(axes, found, places, strict=True):
            view.draw(ax, frame)
            (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
            assert left < x[:, 0].min() and x[:, 0].max() < right and low < x[:, 1].min() and x[:, 1].max() < high
            assert right - left == pytest.approx(view.high[0] - view.low[0])
        assert view.follows is follows and (len({ax.get_xlim() for ax in axes}) == 3) is follows
        assert view.high[0] - view.low[0] < 50.0  # measured 42, and 43 of those that are followed


@pytest.mark.serial
@pytest.mark.parametrize(("far", "wide"), [(4, 8.0), (100, 6.0)])
def test_maps_of_traction_in_space_follow_cells_that_go_far(far, wide):
    edges, maps = (np.arange(far + 5.0), np.arange(5.0)), np.zeros((2, far + 4, 4))
    maps[0, :4], maps[1, far:] = 1.0, 1.0
    windows = _windows(edges, maps)
    assert np.ptp(windows, axis=2)[:, 0] == pytest.approx([wide, wide])
    assert windows[1, 0, 0] <= far < far + 4 <= windows[1, 0, 1]


@pytest.mark.serial
def test_in_space_the_map_of_traction_is_one_of_squares():
    table = {**TRACTION, "x_um": np.array([0.25, 0.25, 0.25, 1.25]), "y_um": np.array([-0.75, 0.75, 0.75, 0.25])}
    (x, y), found = by_place(table, SAMPLES, "normal_pa")
    assert x == pytest.approx([0.0, 0.5, 1.0, 1.5]) and y == pytest.approx([-1.0, -0.5, 0.0, 0.5, 1.0])
    assert {tuple(at): found[tuple(at)] for at in np.argwhere(found).tolist()} == {(0, 0, 3): 7, (2, 2, 2): -5}
    along = {f"tangential_{axis}_pa": np.zeros(4) for axis in "xy"}
    for times, titles in (([1.0, 4.0], ["0 to 1 µs", "2 to 4 µs"]), ([], ["2 to 4 µs"])):
        axes = traction(table | along, SAMPLES, times).axes
        assert [ax.get_title(loc="left") for ax in axes[:-1]] == titles


@pytest.mark.serial
def test_the_key_of_arrows_stands_beside_or_above_the_title_of_the_last_map():
    samples = np.array([0.0, 0.3167, 0.3333, 0.65, 0.6667])
    x, y = (at.ravel() for at in np.meshgrid(np.arange(20.0), np.arange(20.0)))
    table = {"x_um": x, "y_um": y, "normal_pa": x, "tangential_x_pa": 18.9 + 0.0 * x, "tangential_y_pa": 0.0 * x}
    table = {name: np.tile(values, 4) for name, values in table.items()} | {"time_h": np.repeat(samples[1:], 400)}
    for times in ([0.3167, 0.3333, 0.6667], [0.6667]):
        figure = traction(table, samples, times)
        FigureCanvasAgg(figure).draw()
        (key,) = (key.text.get_window_extent().extents for key in figure.findobj(QuiverKey))
        (title,) = (text.get_window_extent().extents for text in figure.findobj(Text)
                    if text.get_text() == "0.65 to 0.6667 h")
        assert key[1] >= title[3] or key[0] >= title[2]


@pytest.mark.serial
def test_pulls_go_by_the_names_of_cells_and_are_nothing_where_they_do_not_touch():
    table = {"time_us": np.array([0.0, 1.0, 4.0, 4.0]), "cell": np.array([1, 1, 1, 2]),
             "neighbour": np.array([2, 2, 2, 3]), "pull_pn_per_um": np.array([np.nan, 7.0, 2.0, -4.0]),
             "name": np.array(["a", "a", "a", "b"]), "neighbour_name": np.array(["b", "b", "b", "c"])}
    found = pulls(table, SAMPLES)
    assert {pair: line.tolist() for pair, line in found.items()} == {("a", "b"): [7, 0, 2], ("b", "c"): [0, 0, -4]}


@pytest.mark.serial
def test_cells_go_by_their_names_and_by_numbers_in_runs_that_have_none(run, shared_tmp):
    named = leave_a_run(shared_tmp / "named", names=("all", "left", "middle, old", "right"))
    assert "middle, old moved 10 µm" in " ".join(info(named).split())
    for directory, names in ((named, ["left", "middle, old", "right"]), (run, ["cell 1", "cell 2", "cell 3"])):
        figure = _displacement(read_table(directory / "history.csv"))
        assert [text.get_text() for text in figure.axes[0].get_legend().get_texts()] == ["mean", *names]


@pytest.mark.serial
def test_of_many_cells_and_pairs_the_mean_and_the_number_are_named():
    cell, time = (at.ravel() for at in np.meshgrid(np.arange(21), SAMPLES))
    history = {"time_us": time, "cell": cell, "ux_um": cell * time, "substrate_contact_um": time,
               "cell_contact_um": time, "effective_stress_pa": time}
    legend = _displacement(history).axes[0].get_legend()
    assert [text.get_text() for text in legend.get_texts()] == ["mean of 20 cells"]
    first = np.tile(np.arange(1, 20), 2)
    table = {"time_us": np.repeat([1.0, 4.0], 19), "cell": first, "neighbour": first + 1, "pull_pn": 1.0 * first,
             "name": first.astype(str), "neighbour_name": (first + 1).astype(str)}
    assert between(table, SAMPLES).axes[0].get_title(loc="left") == "19 pairs of cells"


@pytest.mark.serial
def test_a_run_of_an_older_version_says_why_there_are_no_pictures_of_forces(run, shared_tmp, capsys, monkeypatch):
    monkeypatch.setattr(Frame, "units", lambda frame: FIELDS | {"adhesion_force": "pN/um", "contact_force": "pN/um"})
    plot(run, out=shared_tmp)
    assert "of an older version, without substrate.csv and neighbours.csv" in capsys.readouterr().err


@pytest.mark.serial
def test_one_peak_does_not_flatten_the_rest_and_is_told():
    ax = Figure().subplots()
    line = np.sin(np.arange(400.0))
    line[0] = 7600.0
    ax.plot(line)
    limit_axis(ax, usual_peak(line), "Pa")
    assert ax.get_ylim()[1] == pytest.approx(3.0, rel=0.01)
    assert "up to 7600 Pa" in ax.get_title(loc="right")
    calm = Figure().subplots()
    calm.plot(line[1:])
    limit_axis(calm, usual_peak(line[1:]), "Pa")
    assert not calm.get_title(loc="right")


@pytest.mark.serial
def test_times_beyond_the_frames_are_told_and_drawn_as_the_nearest(run, shared_tmp, capsys):
    plot(run, times=[20.0, 500.0], out=shared_tmp)
    assert "the frames are from 0 to 400 µs: 500 µs is drawn" in capsys.readouterr().err
    plot(run, times=[0.0, 400.0], out=shared_tmp)
    assert not capsys.readouterr().err


@pytest.mark.serial
@pytest.mark.parametrize(("times", "expected"), [
    (None, [20.0, 200.0, 400.0]), ([90.0, 95.0, 1e9], [80.0, 100.0, 400.0]), ([1.0, 2.0], [0.0])])
def test_the_snapshots_are_the_frames_nearest_to_the_times_each_once(times, expected):
    found = [Frame(20.0 * step, ()) for step in range(21)]
    assert [frame.time for frame in nearest_frames(found, times)] == expected


@pytest.mark.serial
def test_a_run_with_one_frame_is_drawn_with_that_one(shared_tmp, monkeypatch):
    titles = []
    monkeypatch.setattr("matplotlib.axes.Axes.set_title", lambda ax, text, **_: titles.append(text))
    plot(leave_a_run(shared_tmp / "short", samples=1), out=shared_tmp / f"by{COMM.rank}")
    assert titles == ["t = 0 µs"]


@pytest.mark.serial
def test_a_cell_that_is_not_convex_is_filled_up_to_its_outline_and_not_beyond():
    corners = np.array([[0, 0], [10, 0], [10, 5], [5, 5], [5, 10], [0, 10], [0, 0]])
    walk = [a + (b - a) * step / 5 for a, b in pairwise(corners) for step in range(5)]
    inner = [(x, y) for x in range(1, 10) for y in range(1, 10) if x < 5 or y < 5]
    order = np.random.default_rng(0).permutation(len(walk) + len(inner))
    fields = {"X": np.array([*walk, *inner], dtype=float)[order],
              "surface": np.array([*range(len(walk)), *[-1] * len(inner)])[order]}
    triangles, outline = drawing(fields | {"u": 0.5 * fields["X"]})
    x, y = triangles.x[triangles.triangles], triangles.y[triangles.triangles]
    area = 0.5 * np.abs((x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])).sum()
    assert area == pytest.approx(75.0 * 1.5**2)  # the convex hull has 87.5 * 1.5²
    closed = np.column_stack([triangles.x, triangles.y])[outline]
    assert np.allclose(closed, 1.5 * np.array([*walk, walk[0]]))


@pytest.mark.serial
def test_a_misspelt_run_is_no_run_and_makes_no_directory(run, shared_tmp):
    with pytest.raises(OutputError, match=r"'.*rum' is not the directory of a run; did you mean '.*run'\?"):
        plot(shared_tmp / "rum")
    assert not (shared_tmp / "rum").exists()


@pytest.mark.serial
@pytest.mark.parametrize(("field", "message"), [("stres", "'stres'; did you mean 'stress'"), ("stress", "a tensor")])
def test_a_field_that_cannot_be_drawn_is_refused_with_a_reason(run, shared_tmp, field, message):
    with pytest.raises(CaseError, match=f"--field: .*{message}"):  # exit code 2
        plot(run, field=field, out=shared_tmp / f"by{COMM.rank}")


@pytest.mark.serial
def test_a_directory_without_anything_to_draw_is_refused(shared_tmp):
    (shared_tmp / "manifest.json").write_text("{}\n")
    with pytest.raises(OutputError, match="no frames and no samples"):
        plot(shared_tmp, out=shared_tmp / f"by{COMM.rank}")


def test_runs_on_different_numbers_of_ranks_are_the_same_bit_for_bit(run, shared_tmp):
    alone = leave_a_run(shared_tmp / f"alone{COMM.rank}", MPI.COMM_SELF)
    assert diff(run, alone) == (True, ["history.csv: 84 rows, the same, bit for bit",
                                       "ledger.csv: 21 rows, the same, bit for bit",
                                       "frames: 21 frames, the same, bit for bit"])


def test_the_first_difference_is_told_by_field_particle_time_and_size(run, shared_tmp):
    other = leave_a_run(shared_tmp / "other", kick=1e-9)
    same, lines = diff(run, other)
    assert not same
    assert "first differ at 220 us, u[0] of particle 100" in lines[2] and "apart by 1e-09" in lines[2]
    assert diff(run, other, tolerance=1e-8)[0]


@pytest.mark.serial
def test_the_last_bit_of_one_number_is_a_difference(run, shared_tmp):
    other = leave_a_run(shared_tmp / "other")
    with h5py.File(frames(other)[3].files[0], "r+", locking=False) as file:
        file["v"][0, 1] = np.nextafter(file["v"][0, 1], np.inf)
    same, lines = diff(run, other)
    assert not same and "60 us, v[1] of particle" in lines[2] and "; 1 of" in lines[2]
    assert diff(run, other, tolerance=1e-12)[0]


@pytest.mark.serial
def test_a_shorter_run_is_not_the_same_but_is_compared_as_far_as_it_goes(run, shared_tmp):
    short = leave_a_run(shared_tmp / "short", samples=5)
    same, lines = diff(run, short)
    assert not same
    assert "in the 20 rows that both have; 84 and 20 rows" in lines[0] and "21 and 5 frames" in lines[2]


@pytest.mark.serial
def test_a_difference_in_a_table_is_told_by_column_cell_and_time(run, shared_tmp):
    other = leave_a_run(shared_tmp / "other")
    table = (other / "history.csv").read_text().split("\n")
    table[6] = table[6].replace("1.4", "1.5")
    (other / "history.csv").write_text("\n".join(table))
    same, lines = diff(run, other)
    assert not same and "at 20 us, ux_um of cell 1: 1.4 and 1.5, apart by 0.1" in lines[0]


def test_info_tells_what_a_run_was_and_did(run):
    text = " ".join(info(run).split())
    for part in ("case test scene", "ended not yet", "took 1:05 on", "skipped nothing", "frames 21 from 0 to 400 µs",
                 "last sample 400 µs", "aggregate moved 8 µm",
                 "cell 3 moved 11 µm on the substrate 7 µm on cells 2 µm",
                 "energy error at most 0.2 %, at 400 µs"):
        assert part in text


@pytest.mark.serial
def test_volumes_of_a_run_that_blew_up_are_told_in_a_few_digits():
    assert describe_volumes([-8.7e273, 1.00371]) == "-8.7e+273 to 1.0037"
    assert describe_volumes([None, np.inf]) == "unknown to inf"


@pytest.mark.serial
def test_info_works_on_a_run_that_was_killed_at_once(shared_tmp):
    (shared_tmp / "manifest.json").write_text("{}\n")
    assert "stopped before it wrote one" in info(shared_tmp)
    with pytest.raises(OutputError, match="not the directory of a run"):
        info(shared_tmp / "elsewhere")
