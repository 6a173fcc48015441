"""What a run leaves in its directory: whole, readable, and never over an older run."""

import contextlib
import json
import resource
import signal
import subprocess
import sys
import time
import types
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from xml.etree import ElementTree

import h5py
import meshio
import numpy as np
import pytest
from scenes import ROOT

from mpi4py import MPI

from cellmig.case.time_unit import TimeUnit
from cellmig.output.directory import Claim, OutputError, together
from cellmig.output.log import Log, Progress, Timers, clock, duration, two_columns
from cellmig.output.manifest import environment, read_manifest, write_manifest
from cellmig.output.tables import HISTORY, LEDGER, History, Ledger, Tables, cue_columns, read_table
from cellmig.output.xdmf import Frames, frames

COMM = MPI.COMM_WORLD
FIELDS = {"id": "", "X": "um", "u": "um", "stress": "Pa", "effective_stress": "Pa"}


def arrays(time: float, ids: np.ndarray) -> dict[str, np.ndarray]:
    """Fields of the particles `ids` that tell the particle and the time from the number."""
    x = np.column_stack([ids * 1.0, ids % 7])
    stress = x[:, :1, None] * np.arange(9.0).reshape(3, 3)
    return {"id": ids.astype(np.int64), "X": x, "u": 0.01 * time * x, "stress": stress, "effective_stress": ids + time}


def owned(frame: int, total: int = 30) -> np.ndarray:
    """Ids of this rank, shuffled and other ones in every frame; the last of several ranks has none at first."""
    ids = np.random.default_rng(frame).permutation(total)
    active = max(1, COMM.size - 1) if frame == 0 else COMM.size
    return ids[COMM.rank::active] if COMM.rank < active else ids[:0]


@pytest.fixture
def written(shared_tmp: Path) -> Path:
    """A run of four frames."""
    writer = Frames(shared_tmp, COMM, FIELDS)
    for frame in range(4):
        writer.write(1.5 * frame, 10 * frame, arrays(1.5 * frame, owned(frame)))
    return shared_tmp


def test_frames_read_back_in_the_order_of_the_ids_whoever_owned_the_particles(written):
    found = frames(written)
    assert [frame.time for frame in found] == [0.0, 1.5, 3.0, 4.5]
    for frame in found:
        fields, expected = frame.read(), arrays(frame.time, np.arange(30))
        assert fields["id"].tolist() == list(range(30))
        assert np.array_equal(fields["u"][:, :2], expected["u"]) and not fields["u"][:, 2].any()
        assert np.array_equal(fields["stress"], expected["stress"].reshape(30, 9))
    assert found[0].units() == FIELDS


def test_the_file_of_a_rank_opens_in_meshio_with_the_moving_particles(written):
    with meshio.xdmf.TimeSeriesReader(written / f"rank{COMM.rank:04d}.xdmf") as reader:
        first = 0 if COMM.size == 1 or COMM.rank < COMM.size - 1 else 1  # the last rank had no particles in frame 0
        assert reader.num_steps == 4 - first
        points, cells = reader.read_points_cells()
        now, data, _ = reader.read_data(0)
        assert now == 1.5 * first and points.shape == (len(data["id"]), 3)
        assert np.array_equal(points, data["X"] + data["u"])
        assert cells[0].type == "vertex" and len(cells[0].data) == len(points)
        assert data["stress"].shape[1] == 9
        later, data, _ = reader.read_data(reader.num_steps - 1)
        assert later == 4.5 and np.array_equal(data["effective_stress"], data["id"] + 4.5)


def test_the_index_is_a_temporal_collection_of_spatial_ones_that_matches_the_files(written):
    outer, = ElementTree.parse(written / "cells.xdmf").getroot().findall("./Domain/Grid")
    assert outer.get("CollectionType") == "Temporal" and len(outer) == 4
    for number, step in enumerate(outer):
        assert step.get("CollectionType") == "Spatial" and float(step.find("Time").get("Value")) == 1.5 * number
        grids = step.findall("Grid")
        assert len(grids) == (max(1, COMM.size - 1) if number == 0 else COMM.size)
        for grid in grids:
            topology = grid.find("Topology")
            assert topology.get("TopologyType") == "Polyvertex"
            for item in grid.iter("DataItem"):
                file, name = item.text.split(":/")
                assert not Path(file).is_absolute()
                with h5py.File(written / file, "r", locking=False) as opened:
                    data = opened[name]
                    assert " ".join(map(str, data.shape)) == item.get("Dimensions")
                    assert len(data) == int(topology.get("NumberOfElements"))
                    assert str(data.dtype.itemsize) == item.get("Precision")
                    assert item.get("DataType") == {"i": "Int", "f": "Float"}[data.dtype.kind]


def test_a_frame_with_other_fields_than_declared_is_refused(shared_tmp):
    writer = Frames(shared_tmp, COMM, {**FIELDS, "J": ""})
    with pytest.raises(ValueError, match="J"):
        writer.write(0.0, 0, arrays(0.0, owned(1)))


KILLED = """
import types
import numpy as np
from pathlib import Path
from cellmig.output.tables import Ledger
from cellmig.output.xdmf import Frames
alone = types.SimpleNamespace(rank=0, size=1, allgather=lambda value: [value])
frames = Frames(Path({directory!r}), alone, {{"id": "", "X": "um", "u": "um"}})
ledger = Ledger(Path({directory!r}), alone)
print("begun", flush=True)
for step in range(10**9):
    frames.write(step, step, {{"id": np.arange(200), "X": np.ones((200, 2)), "u": np.full((200, 2), float(step))}})
    ledger.write(step / 3, {{"kinetic_pn": step / 7, "energy_error": 1e-9}})
"""


@pytest.mark.parametrize("delay", [0.0, 0.013, 0.051, 0.107, 0.22])
def test_every_frame_opens_in_meshio_after_the_writer_was_killed(shared_tmp, outside_mpi, delay):
    mine = shared_tmp / f"killed{COMM.rank}"
    mine.mkdir()
    program = KILLED.format(directory=str(mine))
    child = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, env=outside_mpi, cwd=ROOT)
    assert child.stdout.readline() == b"begun\n"
    while not (mine / "cells.xdmf").exists():
        time.sleep(0.001)
    time.sleep(delay)
    child.send_signal(signal.SIGKILL)
    child.communicate()
    with meshio.xdmf.TimeSeriesReader(mine / "rank0000.xdmf") as reader:
        reader.read_points_cells()
        for number in range(reader.num_steps):
            now, data, _ = reader.read_data(number)
            assert now == number and (data["u"][:, :2] == number).all() and len(data["u"]) == 200
    assert 1 <= len(frames(mine)) <= reader.num_steps
    assert all((frame.read()["u"][:, :2] == frame.time).all() for frame in frames(mine))
    table = read_table(mine / "ledger.csv")  # without its last line where the kill cut it
    assert np.array_equal(table["kinetic_pn"], np.arange(len(table["kinetic_pn"])) / 7)


def test_tables_have_the_columns_of_the_contract_and_read_back_the_same_bits(shared_tmp):
    history, ledger = History(shared_tmp, COMM), Ledger(shared_tmp, COMM)
    numbers = np.random.default_rng(1).normal(size=20) * 10.0 ** np.arange(-10, 10)
    for number in numbers:
        history.write(abs(number), [{"ux_um": number}, {"ux_um": -number, "x_um": 1 / 3}])
        ledger.write(abs(number), {name: number / 3 for name in LEDGER[2][1:]})
    table = read_table(shared_tmp / "history.csv")
    assert tuple(table) == HISTORY[2] and tuple(read_table(shared_tmp / "ledger.csv")) == LEDGER[2]
    assert table["cell"].dtype == np.int64 and table["cell"].tolist() == [0, 1] * 20
    assert np.array_equal(table["ux_um"][::2], numbers) and np.array_equal(table["ux_um"][1::2], -numbers)
    assert np.isnan(table["area_um2"]).all()
    assert np.array_equal(read_table(shared_tmp / "ledger.csv")["energy_error"], numbers / 3)


@pytest.mark.parametrize("dimension", [2, 3])
def test_tracks_have_the_columns_that_celltrackr_reads_in_its_order_and_no_aggregate(shared_tmp, dimension):
    """Identifier, time, then the coordinates, in the unit of the case."""
    axes = "xyz"[:dimension]
    tables = Tables(shared_tmp, COMM, ['left, "old"', "Cell-2"], (), {"tracks": True}, {}, dimension, TimeUnit("h"))
    rows = [{f"{axis}_um": 10.0 * cell + k for k, axis in enumerate(axes)} for cell in range(3)]
    for moment in (0.0, 1.8e9):
        tables.write(moment, rows, {}, {})
    tables.flush()
    found = read_table(shared_tmp / "tracks.csv")
    assert tuple(found) == ("id", "time_h", *(f"{axis}_um" for axis in axes))
    assert found["id"].tolist() == ['left, "old"', "Cell-2"] * 2 and found["time_h"].tolist() == [0.0, 0.0, 0.5, 0.5]
    assert found["x_um"].tolist() == [10.0, 20.0] * 2 and found[f"{axes[-1]}_um"][0] == 9.0 + dimension


def test_gels_have_no_tracks(shared_tmp):
    tables = Tables(shared_tmp, COMM, ["Gel", "Cell"], (), {"tracks": True}, {}, gels={"Gel"})
    tables.write(0.0, [{"x_um": float(cell), "y_um": 0.0} for cell in range(3)], {}, {})
    tables.flush()
    assert read_table(shared_tmp / "tracks.csv")["id"].tolist() == ["Cell"]


def test_cues_have_polarity_push_and_the_part_of_each_cue(shared_tmp):
    names = cue_columns(("occupancy", "contact"), 3)
    assert names == ("occupancy_x", "occupancy_y", "contact_x", "contact_y") and cue_columns(("given",)) == ("given",)
    tables = Tables(shared_tmp, COMM, ["A", "B"], (), {"cues": True}, {}, 3, TimeUnit("min"), names)
    row = {"polarity_x": 0.5, "polarity_y": -0.5, "push_x_pn": 3.0, "push_y_pn": 4.0, "contact_x": 1.0}
    tables.write(6e7, [{}], {}, {"cues": [{"cell": 1, **row}, {"cell": 2}]})
    found = read_table(shared_tmp / "cues.csv")
    assert tuple(found) == ("time_min", "cell", "name", "polarity_x", "polarity_y", "push_x_pn", "push_y_pn", *names)
    assert found["name"].tolist() == ["A", "B"] and found["contact_x"][0] == 1.0 and np.isnan(found["contact_y"][0])


def test_tracks_are_cut_where_a_run_goes_on(shared_tmp):
    def opened(ends):
        return Tables(shared_tmp, COMM, ["A"], (), {"tracks": True}, ends)

    tables, rows = opened({}), [{}, {"x_um": 1.0}]
    tables.write(1.0, rows, {}, {})
    ends = tables.ends()
    tables.write(2.0, rows, {}, {})
    opened(ends).write(3.0, rows, {}, {})
    assert read_table(shared_tmp / "tracks.csv")["time_us"].tolist() == [1.0, 3.0]


def test_only_rank_0_needs_to_know_the_numbers_of_a_table(shared_tmp):
    ledger, history = Ledger(shared_tmp, COMM), History(shared_tmp, COMM)
    ledger.write(1.0, {"kinetic_pn": 2.0} if COMM.rank == 0 else None)
    history.write(1.0, [{"ux_um": 2.0}] if COMM.rank == 0 else None)
    assert read_table(shared_tmp / "ledger.csv")["kinetic_pn"].tolist() == [2.0]
    assert read_table(shared_tmp / "history.csv")["ux_um"].tolist() == [2.0]


def test_a_line_that_is_still_being_written_is_not_read(shared_tmp):
    path = shared_tmp / f"half{COMM.rank}.csv"
    path.write_text("time_us,cell\n1.5,0\n2.5")
    assert read_table(path)["time_us"].tolist() == [1.5]


@pytest.mark.parametrize("mark", ["manifest.json", "cells.xdmf"])
def test_a_second_run_moves_the_first_aside_and_loses_nothing(shared_tmp, mark):
    path = shared_tmp / "run"
    for content, aside in (("first", None), ("second", "run.1"), ("third", "run.2")):
        with Claim(path, COMM, make=True) as claim:
            assert claim.clear() == (aside and shared_tmp / aside)
        assert [file.name for file in path.iterdir()] == ["manifest.json"]
        COMM.barrier()
        if COMM.rank == 0:
            (path / "manifest.json").unlink()
            (path / mark).write_text(content)
        COMM.barrier()
    kept = [(shared_tmp / name / mark).read_text() for name in ("run.1", "run.2", "run")]
    assert kept == ["first", "second", "third"]


def test_a_directory_with_other_files_is_refused_and_left_as_it_is(shared_tmp):
    if COMM.rank == 0:
        (shared_tmp / "thesis.tex").write_text("years of work")
    COMM.barrier()
    with pytest.raises(OutputError, match=r"not a run's.*--out"):
        Claim(shared_tmp, COMM, make=True).clear()
    assert (shared_tmp / "thesis.tex").read_text() == "years of work"


def test_a_place_that_cannot_be_written_is_named_with_a_way_out(shared_tmp):
    if COMM.rank == 0:
        (shared_tmp / "file").write_text("")
    COMM.barrier()
    with pytest.raises(OutputError, match=r"cannot write in .*file/run.*--out"):
        Claim(shared_tmp / "file" / "run", COMM, make=True)


def begin_a_run(path: Path, content: str, comm=COMM) -> Path | None:
    """Claim a directory and write in it as a run does; where what was there is now."""
    with Claim(path, comm, make=True) as claim:
        aside = claim.clear()
        if comm.rank == 0:
            for _ in range(3):
                with open(path / "history.csv", "a") as file:
                    file.write(content)
    return aside


def test_of_runs_that_begin_at_once_each_has_a_directory_of_its_own(tmp_path):
    """Threads stand for processes: a lock is of an open directory, not of a process."""
    alone = types.SimpleNamespace(rank=0, size=1, allgather=lambda value: [value])
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda n: begin_a_run(tmp_path / "run", chr(97 + n % 26), alone), range(200)))
    contents = [(path / "history.csv").read_text() for path in tmp_path.iterdir()]
    assert len(contents) == 200 and all(len(text) == 3 and len(set(text)) == 1 for text in contents)


def test_a_directory_that_a_claim_made_and_left_empty_goes_again(shared_tmp):
    with Claim(shared_tmp / "run", COMM, make=True):
        assert (shared_tmp / "run").is_dir()
        COMM.barrier()
    COMM.barrier()
    assert not (shared_tmp / "run").exists()
    COMM.barrier()
    begin_a_run(shared_tmp / "run", "a")
    COMM.barrier()
    assert (shared_tmp / "run" / "history.csv").exists()


@pytest.mark.parametrize("there", [True, False], ids=["to a run", "to nothing yet"])
def test_a_run_is_written_where_a_link_points_to_and_the_link_stays(shared_tmp, there):
    link, disk = shared_tmp / "link", shared_tmp / "disk" / "run"
    if COMM.rank == 0:
        link.symlink_to(disk)
    COMM.barrier()
    if there:
        assert begin_a_run(link, "a") is None
    begin_a_run(link, "b")
    COMM.barrier()
    assert link.is_symlink() and (disk / "history.csv").read_text() == "bbb"
    assert sorted(path.name for path in shared_tmp.iterdir()) == ["disk", "link"]
    assert not there or (shared_tmp / "disk" / "run.1" / "history.csv").read_text() == "aaa"


def test_the_directory_where_the_user_is_takes_one_run_after_the_other(shared_tmp, monkeypatch):
    (shared_tmp / "here").mkdir(exist_ok=True)
    COMM.barrier()
    monkeypatch.chdir(shared_tmp / "here")
    assert [begin_a_run(Path(), text) for text in "abc"] == [None, Path("../here.1"), Path("../here.2")]
    COMM.barrier()
    found = [Path(place, "history.csv").read_text() for place in ("../here.1", "../here.2", ".")]
    assert found == ["aaa", "bbb", "ccc"]


def test_an_error_of_one_rank_is_raised_on_all_of_them():
    def fail_on_the_last():
        if COMM.rank == COMM.size - 1:
            raise OSError("no space left")

    with pytest.raises(OutputError, match=f"rank {COMM.size - 1}: no space left"):
        together(COMM, fail_on_the_last)


@contextlib.contextmanager
def full_disk_on_the_last_rank():
    """As if no file could grow beyond 2 kB there; ends before the tests' own report goes on, which may be a file."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    if COMM.rank == COMM.size - 1:
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_a_full_disk_stops_all_ranks_and_leaves_the_frames_before_it_whole(written):
    writer = Frames(written / "more", COMM, FIELDS)
    with full_disk_on_the_last_rank(), pytest.raises(OutputError, match=r"cannot write .*s00000000\.h5"):
        writer.write(0.0, 0, arrays(0.0, owned(1)))
    assert frames(written / "more") == [] and not list((written / "more").glob("**/*.part"))
    assert [frame.read()["id"].tolist() for frame in frames(written)] == [list(range(30))] * 4


@pytest.mark.serial
def test_a_full_disk_cuts_no_line_of_a_table(shared_tmp):
    ledger = Ledger(shared_tmp, COMM)
    with full_disk_on_the_last_rank(), pytest.raises(OutputError, match=r"cannot write .*ledger\.csv"):
        for step in range(1000):
            ledger.write(step / 7, {"kinetic_pn": step / 3})
    text = (shared_tmp / "ledger.csv").read_text()
    assert 1900 < len(text) <= 2000 and text.endswith("\n")
    assert np.array_equal(read_table(shared_tmp / "ledger.csv")["kinetic_pn"], np.arange(text.count("\n") - 1) / 3)


@pytest.mark.serial
def test_a_manifest_of_an_older_version_is_read_under_the_new_names(tmp_path):
    (tmp_path / "manifest.json").write_text('{"worst_closure": 0.002}')
    assert read_manifest(tmp_path) == {"worst_energy_error": 0.002}


def test_a_manifest_is_json_whatever_numpy_and_nan_are_in_it(shared_tmp):
    mine = shared_tmp / str(COMM.rank)
    mine.mkdir()
    manifest = {"steps": np.int64(7), "dt": np.float64(1.1e-3), "energy_error": np.nan, "out": mine, "x": np.ones(2)}
    write_manifest(mine, manifest)
    text = (mine / "manifest.json").read_text()
    assert json.loads(text, parse_constant=pytest.fail) == read_manifest(mine)
    assert read_manifest(mine) == {"steps": 7, "dt": 1.1e-3, "energy_error": None, "out": str(mine), "x": [1.0, 1.0]}
    assert [file.name for file in mine.iterdir()] == ["manifest.json"]


def test_the_environment_is_told_the_same_on_all_ranks():
    found = environment(COMM)
    assert found["ranks"] == COMM.size and found["hosts"] >= 1 and found["numpy"] == np.__version__
    assert "MPI" in found["mpi"] and found.get("tree") in (None, "clean", "local changes")
    assert ("petsc4py" in found) == ("petsc4py" in sys.modules)
    assert COMM.allgather(found) == [found] * COMM.size


def test_the_screen_and_the_log_file_get_the_same_lines_from_rank_0_alone(shared_tmp, capsys):
    log = Log(COMM, shared_tmp)
    log("first line")
    log.table([("stable step", "1.1 ns"), ("set by", "viscosity")])
    expected = "first line\nstable step  1.1 ns\nset by       viscosity\n"
    assert capsys.readouterr().out == (expected if COMM.rank == 0 else "")
    COMM.barrier()
    assert (shared_tmp / "run.log").read_text() == expected


def test_a_quiet_log_writes_to_its_file_only(shared_tmp, capsys):
    Log(COMM, shared_tmp, quiet=True)("text")
    COMM.barrier()
    assert capsys.readouterr().out == "" and (shared_tmp / "run.log").read_text() == "text\n"


def test_progress_is_a_line_after_5_s_and_then_every_30_s_of_wall_time(monkeypatch, capsys):
    now = [100.0]
    monkeypatch.setattr("cellmig.output.log.perf_counter", lambda: now[0])
    monkeypatch.setattr("cellmig.output.log._on_terminal", lambda: False)
    progress = Progress(Log(COMM), end=400.0)
    for step in range(1, 81):
        now[0] += 1.0
        progress(2.0 * step, step, 1.1e-3)
    progress.close()
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == (3 if COMM.rank == 0 else 0)  # after 5, 35 and 65 s
    if COMM.rank == 0:
        assert lines[1].split() == "70 µs 17.5 % step 35 dt 1.1 ns wall 35 s left 2:45".split()
    now[0] += 30.0
    progress(160.0, 80, 1.1e-3, "in its step 7 of Newton's")  # a step that takes long
    assert capsys.readouterr().out.endswith("left     2:45  in its step 7 of Newton's\n") == (COMM.rank == 0)


def test_progress_is_a_bar_on_a_terminal_and_the_lines_of_the_log_step_around_it(monkeypatch, capsys):
    monkeypatch.setattr("cellmig.output.log._on_terminal", lambda: True)
    log = Log(COMM)
    progress = Progress(log, end=400.0)
    progress(200.0, 10, 1.1e-3)
    log("a remark")
    progress.close()
    screen = capsys.readouterr().out
    for part in ("50 % |", "200 of 400 µs", "\ra remark\n"):
        assert (part in screen) == (COMM.rank == 0)


def test_the_closing_summary_has_every_section_over_the_ranks_and_adds_up_to_the_whole():
    timers = Timers()
    with timers("forces"):
        time.sleep(0.02)
    with timers("forces"):
        time.sleep(0.01)
    if COMM.rank == 0:
        with timers("log"):
            time.sleep(0.005)
    rows = {words[0]: words[1:] for words in map(str.split, timers.summary(COMM).splitlines()[1:])}
    assert list(rows) == ["forces", "log", "other"]
    low, mean, high = map(float, rows["forces"][:3])
    assert 0.03 <= low <= mean <= high
    assert (float(rows["log"][0]) == 0.0) == (COMM.size > 1)
    assert sum(float(row[3]) for row in rows.values()) == pytest.approx(100, abs=0.2)  # rounded to 0.1 each


def test_a_section_inside_another_interrupts_it_so_that_no_time_counts_twice(monkeypatch):
    now = [0.0]
    monkeypatch.setattr("cellmig.output.log.perf_counter", lambda: now[0])
    timers = Timers()
    with timers("steps"):
        now[0] += 2.0
        with timers("checkpoints"):
            now[0] += 4.0
        now[0] += 3.0
    with timers("checkpoints"):
        now[0] += 1.0
    now[0] += 6.0
    assert timers.seconds() == {"steps": 5.0, "checkpoints": 5.0, "other": 6.0}


@pytest.mark.parametrize(("seconds", "text"), [(8.2, "8 s"), (59.7, "1:00"), (125, "2:05"), (3725, "1:02:05"),
                                                  (276480, "3.2 days"), (2.714e8, "8.6 years")])
def test_wall_time_is_told_as_people_tell_it(seconds, text):
    assert clock(seconds) == text


def test_columns_are_aligned():
    assert two_columns([("a", 1), ("long", "x y")]) == "a     1\nlong  x y"


@pytest.mark.serial
@pytest.mark.parametrize("text", ["[]", "rubbish", '{"case": 3}', '{"exit_status": 0, "strain": "much"}'])
def test_what_is_no_manifest_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(OutputError, match="is not a manifest"):
        read_manifest(tmp_path)


@pytest.mark.parametrize(("seconds", "digits", "text"), [
    (1.24e-9, 2, "1.2 ns"), (400e-6, 2, "400 µs"), (388.5e-6, 6, "388.5 µs"), (2e-3, 6, "2 ms"), (25, 2, "25 s"),
    (90, 2, "90 s"), (600, 2, "10 min"), (11500, 2, "3.2 h"), (2.714e8, 2, "8.6 years"), (1e12, 2, "32,000 years"),
    (1e20, 2, "3.2e+12 years"), (0, 2, "0 s")])
def test_a_time_is_told_in_the_unit_that_people_take(seconds, digits, text):
    assert duration(seconds, digits) == text
