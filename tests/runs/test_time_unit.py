"""Times in the unit in which a case writes its end: µs, ms, s, min, h or d."""

from __future__ import annotations

import dataclasses
import subprocess
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from scenes import CASES, built, case

from mpi4py import MPI

from cellmig.case.load import change, from_dict
from cellmig.case.time_unit import SIZES, TimeUnit
from cellmig.case.times import output_times, until
from cellmig.case.units import number
from cellmig.output.log import Log, Progress
from cellmig.output.manifest import read_manifest, time_unit
from cellmig.output.tables import in_unit, read_table
from cellmig.output.xdmf import frames
from cellmig.runs.preflight import report
from cellmig.runs.record import Record
from cellmig.runs.sweep import Sweep, sweep
from cellmig.solve.step import NumericsError

pytestmark = pytest.mark.serial

COARSE = ("particles.per_cell=60", "time.samples=4", "time.frames=2")
MOVING = (CASES["two_three"], *(word for text in (*COARSE, 'friction.coefficient="1e4 Pa us/um"')
                                for word in ("--set", text)), "--quiet")
RAMP = 'loads.0.load_curve={law="ramp", duration="6 h"}'
STATIC = (CASES["cook"], *(word for text in ("particles.per_cell=60", "time.samples=4", RAMP)
                           for word in ("--set", text)))
TABLES = ("history", "ledger", "substrate", "neighbours")


# --------------------------------------------------------------------------------------------------------- the rule


@pytest.mark.parametrize(("end", "symbol"), [
    ("400 us", "us"), ("400 µs", "us"), ("0.4 ms", "ms"), ("60 s", "s"), ("1 minute", "min"), ("6 h", "h"),
    ("6 hours", "h"), ("2 d", "d"), ("90 ns", "us"), ("1 kilosecond", "us")])
def test_the_unit_of_a_case_is_that_in_which_it_writes_its_end(end, symbol):
    made = case("one_cell", f'time.end="{end}"')
    assert made.time_unit == TimeUnit(symbol) and made.time.end == number(end, "us")
    again = from_dict(made.resolved())
    assert again == made and again.time_unit == made.time_unit
    assert time_unit({"case": made.resolved()}) == made.time_unit


def test_an_earlier_end_and_changes_of_other_values_leave_the_unit_and_another_end_changes_it():
    hours = case("one_cell", 'time.end="6 h"')
    assert until(hours, 7.2e9).time_unit == change(hours, {"seed": 3}).time_unit == TimeUnit("h")
    assert change(hours, {"time.end": "90 min"}).time_unit == TimeUnit("min")


def test_sizes_are_those_of_the_units_that_cases_may_have():
    assert {symbol: number(f"1 {symbol}", "us") for symbol in SIZES} == SIZES


@pytest.mark.parametrize(("end", "count"), [("6 h", 360), ("48 h", 400), ("7 d", 100)])
def test_samples_of_hours_and_days_are_at_the_fractions_that_they_stand_for(end, count):
    made = case("one_cell", f'time.end="{end}"', f"time.samples={count}")
    times = [made.time_unit.number(time) for time, _, _ in output_times(made, made.time.end)]
    exact = float(end.split()[0]) * np.arange(count + 1) / count
    at = np.searchsorted(times, exact - 1e-9)
    assert np.allclose(np.array(times)[at], exact, rtol=4e-16, atol=0.0)  # measured 2.2e-16
    assert times[-1] == float(end.split()[0]) and np.diff(times).min() > 0.0


def test_output_at_steps_of_seconds_comes_once_each_up_to_days():
    made = case("one_cell", 'time.end="2 d"', "time.samples=400", "time.frames=100")
    step = number("7 s", "us")
    times = np.array([time for time, _, _ in output_times(made, made.time.end, step)])
    assert len(times) == 401 and (times % step == 0.0).all() and np.diff(times).min() > 0.9 * made.time.end / 400


# -------------------------------------------------------------------------------------------------- a run and its files


@pytest.fixture(scope="module")
def alone(cellmig: Callable[..., subprocess.CompletedProcess]) -> Callable[..., str]:
    """`alone("info", …)`: the program in one process; what it printed."""

    def start(*words: object, code: int = 0, ranks: int = 1) -> str:
        done = cellmig(ranks, *words)
        assert done.returncode == code and "Traceback" not in done.stderr, done
        return done.stdout + done.stderr

    return start


@pytest.fixture(scope="module")
def made(alone, tmp_path_factory) -> Path:
    """The same run of 1.8 µs, told in µs, and on three ranks in h; a static one of 6 h, with its log."""
    home = tmp_path_factory.mktemp("units")
    alone(*MOVING, "--set", "time.end=1.8 us", "--out", home / "us")
    alone(*MOVING, "--set", "time.end=5e-10 h", "--out", home / "h", ranks=3)
    (home / "said").write_text(alone(*STATIC, "--set", "time.end=6 h", "--out", home / "static"))
    return home


def test_a_run_in_hours_has_the_bits_of_the_same_run_in_microseconds(made):
    assert read_manifest(made / "us")["state_hash"] == read_manifest(made / "h")["state_hash"]


@pytest.mark.parametrize("name", TABLES)
def test_tables_in_hours_name_them_and_hold_the_same_times_and_speeds(made, name):
    us, h = (read_table(made / unit / f"{name}.csv") for unit in ("us", "h"))
    assert "time_h" in h and not any(column.endswith("_us") for column in h)
    back = in_unit(h, TimeUnit("us"))
    assert list(back) == list(us)
    for column, values in us.items():
        if values.dtype.kind == "f":
            assert np.allclose(back[column], values, rtol=1e-14, atol=0.0, equal_nan=True), column  # measured 3e-16
    assert h["time_h"][-1] == 5e-10
    if name == "history":
        of_all = h["cell"] == 0
        moved, elapsed = (np.diff(h[column][of_all]) for column in ("ux_um", "time_h"))
        assert np.allclose(h["vx_um_per_h"][of_all][1:], moved / elapsed, rtol=1e-12)  # measured 3e-15


def test_frames_in_hours_have_their_times_and_velocities_in_hours(made):
    us, h = (frames(made / unit) for unit in ("us", "h"))
    assert [frame.time for frame in h] == pytest.approx([frame.time / 3.6e9 for frame in us], rel=1e-14)
    assert {frame.unit.symbol for frame in h} == {"h"} and h[0].units()["v"] == "um/h"
    assert np.allclose(h[-1].read()["v"], 3.6e9 * us[-1].read()["v"], rtol=1e-14, atol=0.0)
    with h5py.File(h[-1].files[0]) as file:
        assert file.attrs["time_unit"] == "h" and file.attrs["time"] == 5e-10
    record = Record(made / "h")
    assert record.units["time"] == "h" and record.times[-1] == record.frame(5e-10)["time"] == 5e-10


def test_runs_in_different_units_are_told_apart(alone, made):
    told = alone("diff", made / "us", made / "h", code=1)
    assert "history.csv: times in us against times in h" in told and "frames: times in us against times in h" in told


def test_the_log_and_the_summary_of_a_run_in_hours_are_in_hours(alone, made):
    log, info = (made / "said").read_text(), alone("info", made / "static")
    assert "equilibrium at 1.5 h: " in log and "done: 6 h in 4 steps" in log
    for line in ("reached         6 h of 6 h in 4 steps", "last sample     6 h", "frames          2 from 0 to 6 h"):
        assert line in info
    assert "µs" not in (log + info).replace("pN µs/µm", "")


def test_a_run_of_hours_goes_on_to_a_later_end_in_any_unit(alone, made, tmp_path):
    run = tmp_path / "run"
    alone(*STATIC, "--set", "time.end=6 h", "--out", run, "--until", "90 min")
    said = alone("resume", run, "--until", "6 h")
    assert "goes on from the checkpoint at 1.5 h" in said and "its end is now 6 h, no longer 1.5 h" in said
    for name in ("history.csv", "ledger.csv"):
        assert (run / name).read_bytes() == (made / "static" / name).read_bytes()
    told = alone("resume", run, "--until", "1 s", code=2)
    assert "is at 6 h already, beyond 0.000277777777778 h" in told


def test_pictures_of_hours_are_drawn_at_times_in_any_unit(alone, made, tmp_path):
    said = alone("plot", made / "static", "--times", "0 us,360 min,20 h", "--out", tmp_path, "--format", "svg")
    assert "the frames are from 0 to 6 h: 20 h is drawn as the nearest of these" in said
    alone("plot", made / "h", "--out", tmp_path, "--format", "svg")
    assert {path.stem for path in tmp_path.iterdir()} >= {"shapes", "displacement", "ledger", "traction", "between"}


def test_a_sweep_of_ends_in_several_units_has_one_table_in_the_unit_of_the_first(tmp_path):
    plan = Sweep(CASES["one_cell"], {"time.end": ["1e-10 h", "0.18 us"]}, tmp_path, COARSE)
    assert sweep(plan, at_once=2, shown=["speed_um_per_h"]) == 0
    rows = [row for row in plan.rows(plan.jobs()) if row["cell"] == 0]
    assert [row["time.end [h]"] for row in rows] == [1e-10, 5e-11]
    assert [row["time_h"] for row in rows] == pytest.approx([1e-10, 5e-11], rel=1e-14)
    assert all(row["speed_um_per_h"] > 0.0 for row in rows) and "time_us" not in rows[1]


# ----------------------------------------------------------------------------------------------------------- messages


def test_a_failure_tells_its_time_in_the_unit_of_the_case():
    with built(case("one_cell", 'time.end="6 h"', per_cell=60), MPI.COMM_SELF) as s, \
            pytest.raises(NumericsError, match=r"failed at 0\.5 h: nothing"):
        raise NumericsError.at(s.mechanics, 1.8e9, "nothing", None, "")


def test_progress_of_hours_is_in_hours_and_its_steps_in_seconds(monkeypatch, capsys):
    now = [100.0]
    monkeypatch.setattr("cellmig.output.log.perf_counter", lambda: now[0])
    monkeypatch.setattr("cellmig.output.log._on_terminal", lambda: False)
    progress = Progress(Log(MPI.COMM_SELF), end=2.16e10, unit=TimeUnit("h"))
    now[0] += 40.0
    progress(5.4e9, 270, 2e7)
    assert capsys.readouterr().out.split() == "1.5 h 25.0 % step 270 dt 20 s wall 40 s left 2:00".split()


@pytest.mark.usefixtures("hasty")
def test_validation_tells_the_end_and_speeds_of_a_case_in_its_unit():
    slow = case("one_cell", "time.end=2 h", "materials.cytoplasm.viscosity=1e5 Pa s",
                'friction.coefficient="2 Pa h/um"')
    told = report(dataclasses.replace(slow, path="slow"))
    for part in (" to 2 h", "µm/h while cells spread", "2 Pa h/µm on bonded membrane"):
        assert part in told
    assert "µs" not in told
