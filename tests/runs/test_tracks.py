"""`cellmig tracks`: measures of runs whose motion is known, pooled, as text and as JSON, and what it refuses."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scenes import CASES

from mpi4py import MPI

from cellmig.case.messages import CaseError
from cellmig.case.time_unit import TimeUnit
from cellmig.output.directory import OutputError
from cellmig.output.manifest import read_manifest, write_manifest
from cellmig.output.tables import Tables, read_table
from cellmig.output.tracks import read_tracks
from cellmig.output.tractions import tension
from cellmig.output.xdmf import frames
from cellmig.plot.traction import by_place
from cellmig.runs.diff import diff
from cellmig.runs.tracks import as_json, measure, report

pytestmark = pytest.mark.serial

HOUR = 3.6e9


def leave(directory: Path, x: np.ndarray, times: np.ndarray | None = None, unit: str = "h") -> Path:
    """A run with the tracks x (cells, n, d) [µm] at times [h], hourly unless told."""
    directory.mkdir(parents=True)
    write_manifest(directory, {"case": {"title": "walks", "time": {"end": f"1 {unit}"}}})
    cells, n, d = x.shape
    names = [f"Cell-{k + 1}" for k in range(cells)]
    tables = Tables(directory, MPI.COMM_SELF, names, (), {"tracks": True}, {}, d, TimeUnit(unit))
    for k, time in enumerate(np.arange(n) if times is None else times):
        rows = [{f"{axis}_um": value for axis, value in zip("xyz"[:d], place, strict=True)} for place in x[:, k]]
        tables.write(HOUR * time, [{}, *rows], {}, {})
    return directory


def walks(cells: int, n: int, seed: int, persistence: float = 8.0, drift: float = 0.0) -> np.ndarray:
    """Ornstein-Uhlenbeck velocities of 20 µm/h in the plane, at a constant height of 3 µm."""
    rng, kept, fine = np.random.default_rng(seed), np.exp(-0.1 / persistence), 10
    v, x = 20.0 / np.sqrt(2) * rng.standard_normal((cells, 2)), np.zeros((cells, n, 3))
    for k in range(1, n):
        for _ in range(fine):
            before = v
            v = kept * v + 20.0 / np.sqrt(2) * np.sqrt(1.0 - kept**2) * rng.standard_normal((cells, 2))
            x[:, k, :2] += 0.05 * (before + v)
        x[:, k, :2] += x[:, k - 1, :2] + [drift, 0.0]
    x[:, :, 2] = 3.0
    return x


@pytest.fixture
def seeds(tmp_path: Path) -> list[Path]:
    """Two runs of persistent motion in the plane."""
    return [leave(tmp_path / f"seed-{seed}", walks(40, 161, seed)) for seed in (1, 2)]


def test_the_cells_of_all_seeds_are_pooled_and_their_persistence_is_found(seeds):
    found = measure(seeds)
    fit = found["persistence"]
    assert len(found["cells"]["name"]) == 80 and fit.components == 2
    assert abs(fit.time - 8.0) < 3.0 * fit.time_error < 3.0  # measured 7.7 ± 0.4
    assert abs(fit.speed - 20.0) < 3.0 * fit.speed_error < 1.5
    assert abs(found["mean"]["fmi"]) < 3.0 * found["error"]["fmi"] < 0.15
    assert found["together"]["order"][0] == pytest.approx(np.sqrt(np.pi) / 2 / np.sqrt(40), rel=0.15)  # of chance
    assert found["lags"]["lag"].tolist() == [1, 2, 5, 10, 20, 50]
    alone = measure(seeds[:1])
    assert len(alone["cells"]["name"]) == 40 and alone["error"]["fmi"] > found["error"]["fmi"]


def test_a_drift_is_seen_in_the_index_along_its_axis_only(tmp_path):
    run = leave(tmp_path / "run", walks(60, 81, 3, persistence=2.0, drift=10.0))
    along, across = (measure([run], axis=axis) for axis in (0, 1))
    assert along["mean"]["fmi"] > 0.3 and abs(across["mean"]["fmi"]) < 3.0 * across["error"]["fmi"]


def test_some_cells_can_be_measured_by_their_names(seeds):
    found = measure(seeds, only=["Cell-1*", "Cell-20"])
    assert len(found["cells"]["name"]) == 2 * 12 and set(found["cells"]["name"]) >= {"Cell-1", "Cell-19", "Cell-20"}
    with pytest.raises(CaseError, match="no cell is called 'cell-1'; did you mean 'Cell-1'"):
        measure(seeds, only=["cell-1"])


def test_a_longer_interval_takes_shorter_ways(seeds):
    every, fifth = measure(seeds), measure(seeds, interval=5 * HOUR)
    assert fifth["interval"] == 5.0 and fifth["samples"] == 33
    assert fifth["mean"]["way_um"] < every["mean"]["way_um"] and fifth["mean"]["speed"] < every["mean"]["speed"]
    assert fifth["mean"]["net_um"] == pytest.approx(every["mean"]["net_um"])


def test_the_text_names_its_units_and_says_what_straight_tracks_cannot_tell(tmp_path):
    x = np.zeros((2, 20, 2))
    x[:, :, 0] = 3.0 * np.arange(20) + [[0.0], [30.0]]
    text = report(measure([leave(tmp_path / "run", x, np.arange(20) / 60, "min")]))
    for part in ("every 1 min", "speed µm/min", "FMI x", "mean of 2", "straight at v = 3.0", "MSD µm²", "lag min"):
        assert part in text
    x[:] = 0.0
    assert "the cells rest" in report(measure([leave(tmp_path / "rest", x)]))


def test_json_has_units_in_its_names_and_null_where_nothing_is_known(seeds, tmp_path):
    found = json.loads(as_json(measure(seeds)))
    assert found["persistence"].keys() >= {"time_h", "time_error_h", "speed_um_per_h", "components"}
    assert len(found["cells"]["speed_um_per_h"]) == 80 and found["mean"]["net_um"] > 0.0
    x = np.zeros((1, 5, 2))
    assert json.loads(as_json(measure([leave(tmp_path / "rest", x)])))["mean"]["fmi"] is None


@pytest.mark.parametrize(("times", "dimension", "interval", "axis", "said"), [
    (range(20), 3, None, 0, "3 dimensions"), (range(0, 40, 2), 2, None, 0, "give them one by one"),
    ([0, 1, 4, 5], 2, None, 0, "unequal intervals"), ([0], 2, None, 0, "one sample only"),
    (range(20), 2, 1.5, 0, "give a multiple"), (range(20), 2, 50.0, 0, "long"),
    (range(20), 2, None, 1, "along x only")])
def test_what_cannot_be_measured_is_said(tmp_path, times, dimension, interval, axis, said):
    one = leave(tmp_path / "one", np.zeros((1, 20, 2)))
    two = leave(tmp_path / "two", np.zeros((1, len(times), dimension)), np.array(times))
    with pytest.raises((OutputError, CaseError), match=said):
        measure([one, two], interval and interval * HOUR, axis)


def test_no_run_counts_twice(seeds):
    with pytest.raises(OutputError, match="is given twice"):
        measure([*seeds, seeds[0] / ".." / seeds[0].name])


def test_a_run_that_was_stopped_between_samples_and_one_without_tracks_are_read(tmp_path):
    run = leave(tmp_path / "run", np.zeros((1, 4, 2)), np.array([0.0, 1.0, 2.0, 2.3]))
    assert read_tracks(run).time.tolist() == [0.0, 1.0, 2.0]
    with pytest.raises(OutputError, match="is not the directory of a run"):
        read_tracks(tmp_path / "nowhere")


def test_a_run_without_inertia_leaves_tracks_that_go_on_with_the_same_bits_and_one_with_inertia_none(
        cellmig: Callable[..., subprocess.CompletedProcess], tmp_path):
    coarse = (CASES["crawl"], "--set", "particles.per_cell=60", "--set", "time.samples=360", "--quiet")
    for name, *more in (("whole", "--until", "6 min"), ("part", "--until", "3 min")):
        assert cellmig(1, *coarse, "--out", tmp_path / name, *more).returncode == 0
    assert cellmig(1, "resume", tmp_path / "part", "--until", "6 min", "--quiet").returncode == 0
    same, lines = diff(tmp_path / "whole", tmp_path / "part")
    assert same and any(line.startswith("tracks.csv: 7 rows") for line in lines), lines
    tracks, history = (read_table(tmp_path / "whole" / name) for name in ("tracks.csv", "history.csv"))
    own = history["cell"] == 1
    assert tracks["id"].tolist() == ["Cell-1"] * 7 and tracks["time_h"].tolist() == history["time_h"][own].tolist()
    assert tracks["x_um"].tolist() == history["x_um"][own].tolist()
    done = cellmig(1, "tracks", tmp_path / "whole", "--interval", "2 min")
    assert done.returncode == 0 and "every 0.03333 h" in done.stdout, done
    wrong = cellmig(1, "tracks", tmp_path / "whole", "--interval", "soon")
    assert wrong.returncode == 2 and wrong.stderr.startswith("cellmig: --interval"), wrong
    short = ("--set", "particles.per_cell=60", "--set", "time.samples=4", "--quiet")
    assert cellmig(1, CASES["one_cell"], "--until", "0.1 us", *short, "--out", tmp_path / "fast").returncode == 0
    assert not (tmp_path / "fast/tracks.csv").exists() and read_manifest(tmp_path / "fast")["exit_status"] == 0
    assert read_tracks(tmp_path / "fast").names == ("Cell-1",)


@pytest.fixture(scope="module")
def polar(cellmig: Callable[..., subprocess.CompletedProcess], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cell that crawls with a polarity for a quarter of an hour, a sample a minute, a knot every half a minute."""
    run = tmp_path_factory.mktemp("polar") / "run"
    sets = ("particles.per_cell=60", "time.samples=360", "time.frames=72", 'polarity={persistence="10 min"}', "seed=3")
    done = cellmig(1, CASES["crawl"], *(word for text in sets for word in ("--set", text)), "--until", "15 min",
                   "--out", run, "--quiet")
    assert done.returncode == 0, done
    return run


def test_a_run_with_polarity_tells_it_and_the_push_of_each_cell_at_every_sample(polar):
    found = read_table(polar / "cues.csv")
    assert tuple(found) == ("time_h", "cell", "name", "polarity", "push_pn_per_um")
    assert found["time_h"] == pytest.approx(np.arange(16) / 60) and found["name"].tolist() == ["Cell-1"] * 16
    p, push = found["polarity"], found["push_pn_per_um"]
    assert 0.1 < np.std(p) < 2.0 and (np.sign(push[1:]) == np.sign(p[1:])).all()
    for frame in frames(polar):
        at = np.argmin(np.abs(found["time_h"] - frame.time))
        assert push[at] == pytest.approx(frame.read()["protrusion_force"][:, 0].sum(), rel=1e-12, abs=1e-12)


def test_the_dipole_of_a_cell_is_minus_the_tension_along_it(polar):
    together = measure([polar])["together"]
    table = read_table(polar / "substrate.csv")
    (edges,), pull = by_place(table, np.unique(table["time_h"]), "tangential_now_pa")
    tense = tension(pull, edges[1] - edges[0])
    assert together["tension_pn_per_um"][0] == pytest.approx(tense.max(axis=1).mean())
    whole = (edges[1] - edges[0]) * tense.sum(axis=1).mean()
    assert together["dipole_pn"][0] == pytest.approx(-whole, rel=1e-4)  # the drag of the medium: measured 3e-6
    assert "dipole ∫ x T dx" in report(measure([polar]))
    assert json.loads(as_json(measure([polar])))["together"]["dipole_pn"]["error"] is None  # of one run


def test_the_speed_of_a_cell_is_that_of_its_polarity(polar):
    """Friction is linear to a percent and inertia is absent: the way in a minute over the mean polarity is the same."""
    found, x = read_table(polar / "cues.csv"), read_tracks(polar).along[0, :, 0]
    p = found["polarity"]
    mean, way = 0.5 * (p[1:] + p[:-1]), np.diff(x)
    late = slice(5, None)  # the cell has settled
    assert np.corrcoef(mean[late], way[late])[0, 1] > 0.95  # measured 0.971


def test_tracks_and_cues_have_the_same_bits_on_three_ranks_and_after_resume(
        cellmig: Callable[..., subprocess.CompletedProcess], tmp_path):
    sets = ("particles.per_cell=60", "time.end=1 us", "time.samples=4", "time.frames=2", "time.step=2 ns",
            'polarity={persistence="1 us"}', 'cues=[{law="contact", reach="0.5 um"}, {law="given", vector=[0.5]}]')
    case = (CASES["two_three"], *(word for text in sets for word in ("--set", text)), "--quiet", "--out")
    assert cellmig(1, *case, tmp_path / "one").returncode == 0
    assert cellmig(3, *case, tmp_path / "three", "--until", "0.5 us").returncode == 0
    assert cellmig(1, "resume", tmp_path / "three", "--until", "1 us", "--quiet").returncode == 0
    same, lines = diff(tmp_path / "one", tmp_path / "three")
    assert same and {"tracks.csv", "cues.csv"} <= {line.partition(":")[0] for line in lines}, lines
    found = read_table(tmp_path / "one/cues.csv")
    assert list(found)[3:] == ["polarity", "push_pn_per_um", "0_contact", "1_given"]
    assert (found["1_given"] == 0.5).all() and len(found["cell"]) == 15
