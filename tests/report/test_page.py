"""The page of a run: what is in it, and that nothing outside of it is needed."""

from __future__ import annotations

import base64
import http.client
import json
import os
import re
import shutil
import signal
import threading
import tomllib
import urllib.error
import urllib.request
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from mpi4py import MPI

from cellmig import commands
from cellmig.output.directory import Claim, OutputError
from cellmig.output.tables import read_table
from cellmig.output.xdmf import Frame, frames
from cellmig.plot.plot import plot
from cellmig.plot.style import save
from cellmig.report import encode, html, movie
from cellmig.report.page import toml
from cellmig.report.study import write_study
from cellmig.report.watch import Server
from cellmig.runs.report import describe, report
from cellmig.usage import UsageError, parse

pytestmark = pytest.mark.serial


@pytest.fixture(scope="module")
def run(coarse: Callable[[str], Path]) -> Path:
    """Three coarse cells over 5 µs."""
    return coarse("all_protrude")


@pytest.fixture
def copy(run: Path, tmp_path: Path) -> Path:
    """The same run, to be spoilt."""
    return shutil.copytree(run, tmp_path / "run")


def data_of(path: Path) -> dict[str, Any]:
    """The data in a page."""
    return json.loads(re.search(r'id="data">(.*?)</script>', path.read_text(encoding="utf-8"), re.DOTALL)[1])


def listening(process: int) -> set[str]:
    """Addresses and ports at which a process waits for connections, in hexadecimal."""
    rows = [row.split() for table in ("tcp", "tcp6") for row in Path(f"/proc/net/{table}").read_text().splitlines()[1:]]
    own = {os.readlink(file) for file in Path(f"/proc/{process}/fd").iterdir()}
    return {row[1] for row in rows if row[3] == "0A" and f"socket:[{row[9]}]" in own}


def unrounded(rounded: dict[str, Any]) -> np.ndarray:
    """What data.js makes of rounded values."""
    low, high = np.frombuffer(zlib.decompress(base64.b64decode(rounded["bytes"])), np.uint8).reshape(2, -1).astype(int)
    zigzag = low | high << 8
    numbers = np.cumsum(((zigzag >> 1) ^ -(zigzag & 1)).reshape(rounded["shape"]), axis=0)
    values = np.where(numbers == rounded["missing"], np.nan, rounded["step"] * (rounded["low"] + numbers))
    return rounded["centre"] + rounded["scale"] * np.sinh(values) if "scale" in rounded else values


@pytest.mark.parametrize("bits", [8, 12, 14, 15])
def test_rounded_values_are_off_by_half_a_step_at_most(bits: int) -> None:
    values = np.random.default_rng(1).normal(size=(5, 40)) * 1e3
    values[2, 3:6], values[3] = np.nan, 0.0
    back = unrounded(encode.rounded(values, bits))
    step = np.nanmax(values) - np.nanmin(values)
    assert np.array_equal(np.isnan(back), np.isnan(values))
    assert np.nanmax(np.abs(back - values)) <= 0.5001 * step / (2**bits - 3)
    assert not back[values == 0.0].any()


def test_values_with_long_tails_are_off_by_a_share_of_what_they_are() -> None:
    values = np.random.default_rng(1).standard_cauchy(size=(20, 200))  # from -6e3 to 1e4
    values[:, :120] = 0.0
    data = encode.evened(values, 11)
    back = unrounded(data)
    assert (np.abs(back - values) / (data["scale"] + np.abs(values))).max() < 0.006  # 0.005
    assert not back[values == 0.0].any()


@pytest.mark.parametrize("values", [np.full((3, 4), 7.25), np.full((2, 3), np.nan), np.zeros((1, 0))])
def test_values_that_are_all_the_same_or_missing_are_kept(values: np.ndarray) -> None:
    assert np.array_equal(unrounded(encode.rounded(values, 12)), values, equal_nan=True)
    assert np.allclose(unrounded(encode.evened(values, 12)), values, rtol=1e-15, equal_nan=True)


def test_a_page_is_one_file_that_asks_for_nothing_else(run: Path) -> None:
    text = report(run).read_text(encoding="utf-8")
    without_data = re.sub(r'id="data">.*?</script>', "", text, flags=re.DOTALL)
    assert not re.search(r"<(?:script|img|iframe)[^>]* src=|<link[^>]* href=\"(?!data:)|@import|url\(", without_data)
    assert set(re.findall(r'href="(https?:[^"]*)"', without_data)) == {f"https://doi.org/{html.PAPER[1]}"}


def test_a_page_has_all_frames_and_fields_of_a_small_run(run: Path) -> None:
    film, found = data_of(report(run))["movie"], frames(run)
    assert film["times"] == [frame.time for frame in found]
    assert film["left_out"] == ""
    last = found[-1].read()
    assert {*film["values"], *movie._GIVEN} == set(last)
    for axis, one in enumerate(film["x"]):
        x = (last["X"] + last["u"])[:, axis]
        assert np.abs(unrounded(one)[-1] - x).max() <= one["step"]
    stress, field = film["values"]["effective_stress"][0], last["effective_stress"]
    away = stress["scale"] + np.abs(field - stress["centre"])
    assert (np.abs(unrounded(stress)[-1] - field) / away).max() < 0.004  # 0.0025


def test_traction_stands_beside_frames_on_a_line_and_on_the_plane(coarse: Callable[[str], Path]) -> None:
    """Its values are those of substrate.csv in the interval that ends at the frame."""
    for name in ("all_protrude", "cap"):
        data, table = data_of(report(coarse(name))), read_table(coarse(name) / "substrate.csv")
        last = table["normal_pa"][table["time_us"] == table["time_us"].max()]
        if name == "cap":
            shown = unrounded(data["movie"]["behind"]["values"])[-1]
            step = data["movie"]["behind"]["values"]["step"]
        else:
            kinds, step = len(data["traction"]["lines"]), 1e-3
            values = np.frombuffer(zlib.decompress(base64.b64decode(data["traction"]["values"]["bytes"])), np.float32)
            shown = values.reshape(-1, kinds, data["traction"]["x"]["shape"][0])[-1, 0]
        assert shown.sum() == pytest.approx(last.sum(), abs=step * len(shown))


def test_a_run_with_tracks_has_a_table_of_how_cells_moved(coarse: Callable[[str], Path]) -> None:
    about = describe(coarse("chemotaxis"))
    head, (row,) = about.motion
    assert (head[0], row[0]) == ("cell", "Cell-1")
    assert row[head.index("way [µm]")] >= row[head.index("net way [µm]")] > 0.0
    assert describe(coarse("all_protrude")).motion[1] == []


def test_frames_and_then_fields_are_left_out_until_a_page_is_small_enough(
        run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = encode.size(movie.movie(run, {}))
    monkeypatch.setattr(movie, "FEWEST", 2)
    monkeypatch.setattr(movie, "BUDGET", whole // 5)
    small = movie.movie(run, {})
    times = [frame.time for frame in frames(run)]
    assert len(small["times"]) < len(times)
    assert (small["times"][0], small["times"][-1]) == (times[0], times[-1])
    assert f"of {len(times)} frames" in small["left_out"]
    monkeypatch.setattr(movie, "FEWEST", len(times))
    small = movie.movie(run, {})
    assert "effective_stress" in small["values"]
    assert "stress" not in small["values"]
    assert "without stress" in small["left_out"]


def test_triangles_that_change_are_those_of_their_frames_and_count_as_room_in_a_page(
        coarse: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch) -> None:
    run, own = coarse("cap"), Frame.triangles
    times = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    found = [replace(frames(run)[0], time=time) for time in times]
    monkeypatch.setattr(movie, "frames", lambda directory: found)
    monkeypatch.setattr(Frame, "triangles", lambda frame: np.roll(own(frame), int(frame.time > 0.0), axis=1))
    whole = movie.movie(run, {})
    assert len(whole["surfaces"]) == 2 and whole["surface"] == [0, *[1] * (len(times) - 1)]
    assert whole["triangles"] == whole["surfaces"][0] != whole["surfaces"][1]
    monkeypatch.setattr(Frame, "triangles", lambda frame: np.roll(own(frame), times.index(frame.time), axis=0))
    whole = encode.size(movie.movie(run, {})["surfaces"])
    monkeypatch.setattr(movie, "FEWEST", 2)
    monkeypatch.setattr(movie, "BUDGET", whole)  # with nothing left for positions and fields
    small = movie.movie(run, {})
    assert len(small["surface"]) == len(small["times"]) < len(times)


def test_a_page_tells_what_was_skipped_what_it_cost_the_case_and_how_to_cite(run: Path) -> None:
    text = report(run).read_text(encoding="utf-8")
    for words in ("skipped", "cortex", "Time spent", "per_cell = 60", "How to cite", html.PAPER[1], "Cell-3",
                  "state hash", "numpy"):
        assert words in text, words


def test_a_page_cites_what_the_citation_file_does() -> None:
    cited = (Path(__file__).parents[2] / "CITATION.cff").read_text(encoding="utf-8")
    assert html.PAPER[1] in cited
    assert re.search(r"title: (Computational .*)", cited)[1] in html.PAPER[0]


def test_a_case_in_a_page_reads_back_as_toml(run: Path) -> None:
    case = json.loads((run / "manifest.json").read_text(encoding="utf-8"))["case"]
    assert tomllib.loads(toml(case)) == case


def test_titles_of_cases_do_no_harm_in_a_page(copy: Path) -> None:
    manifest = json.loads((copy / "manifest.json").read_text(encoding="utf-8"))
    manifest["case"]["title"] = "</script><script>alert(1)</script>"
    manifest["case"]["cells"][0]["name"] = "<b>"
    (copy / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    assert "<script>alert" not in report(copy).read_text(encoding="utf-8")


def test_a_piece_without_a_substrate_does_not_stand_on_one(copy: Path) -> None:
    manifest = json.loads((copy / "manifest.json").read_text(encoding="utf-8"))
    assert movie.movie(copy, {})["substrate"]
    manifest["case"]["adhesion"] = {}
    (copy / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    assert not movie.movie(copy, {})["substrate"]


@pytest.mark.parametrize("value, text", [(12345.6, "12,346"), (0.000123456, "0.0001235"), (3, "3"), (float("nan"), "–"),
                                         (float("-inf"), "−∞")])
def test_numbers_in_tables_have_four_digits(value: float, text: str) -> None:
    assert html.number(value) == text


def test_a_run_of_one_sample_has_a_page(copy: Path) -> None:
    for name in ("history", "ledger", "substrate", "neighbours"):
        head, *rows = (copy / f"{name}.csv").read_text(encoding="utf-8").splitlines(keepends=True)
        first = [row for row in rows if row.startswith("0.0,")]
        (copy / f"{name}.csv").write_text(head + "".join(first), encoding="utf-8")
    data = data_of(report(copy))
    assert data["charts"] and data["traction"] is None


@pytest.mark.parametrize("lost", [["cells.xdmf"], ["history.csv", "ledger.csv"], ["run.log"], ["manifest.json"],
                                  ["substrate.csv", "neighbours.csv"]])
def test_a_run_without_some_files_has_a_page_of_the_others(copy: Path, lost: list[str]) -> None:
    for name in lost:
        (copy / name).unlink()
    assert "How to cite" in report(copy).read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["all_protrude", "cap"])
def test_a_run_killed_between_its_tables_has_a_page_and_pictures(
        coarse: Callable[[str], Path], name: str, tmp_path: Path) -> None:
    """history.csv has a sample less than substrate.csv and neighbours.csv."""
    run = shutil.copytree(coarse(name), tmp_path / "run")
    lines = (run / "history.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    last = lines[-1].partition(",")[0]
    kept = [line for line in lines if not line.startswith(f"{last},")]
    (run / "history.csv").write_text("".join(kept), encoding="utf-8")
    assert "How to cite" in report(run).read_text(encoding="utf-8")
    assert plot(run, None, "effective_stress", tmp_path / "pictures", ["png"])


def test_a_run_that_failed_says_why_and_what_to_do(copy: Path) -> None:
    manifest = json.loads((copy / "manifest.json").read_text(encoding="utf-8")) | {
        "exit_status": 4, "cause": "a particle is inverted"}
    (copy / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    text = report(copy).read_text(encoding="utf-8")
    assert "The simulation failed" in text
    assert "a particle is inverted" in text
    assert "What to do" in text


@pytest.mark.parametrize("key, value", [("steps", "many"), ("end_us", []), ("case", []), ("J", 1.0), ("commit", 7)])
def test_a_manifest_that_cellmig_did_not_write_is_told_with_its_entry(copy: Path, key: str, value: Any) -> None:
    manifest = json.loads((copy / "manifest.json").read_text(encoding="utf-8"))
    (copy / "manifest.json").write_text(json.dumps(manifest | {key: None}), encoding="utf-8")
    report(copy)
    (copy / "manifest.json").write_text(json.dumps(manifest | {key: value}), encoding="utf-8")
    with pytest.raises(OutputError, match=f"is not a manifest: '{key}' is"):
        report(copy)


def test_an_incomplete_run_says_how_to_go_on(copy: Path) -> None:
    manifest = json.loads((copy / "manifest.json").read_text(encoding="utf-8"))
    del manifest["exit_status"]
    (copy / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    assert f"cellmig resume {copy}" in report(copy).read_text(encoding="utf-8")
    assert describe(copy).lead.startswith("It was killed; 20 of 20 µs")
    with Claim(copy, MPI.COMM_SELF):
        assert describe(copy).lead.startswith("It runs; 20 of 20 µs") and not describe(copy).warnings


def test_lines_of_progress_are_no_part_of_the_warning_above_them(copy: Path) -> None:
    with (copy / "run.log").open("a", encoding="utf-8") as log:
        log.write("WARNING at 3 µs: a cell is\n  stretched\n"
                  "     3.5 µs   17.5 %  step        9  dt      0.7 ns  wall      5 s  left      1 s\n")
    assert [text for text, _ in describe(copy).warnings] == ["3 µs: a cell is stretched"]


def test_a_stretch_is_told_once_at_the_end(copy: Path) -> None:
    with (copy / "run.log").open("a", encoding="utf-8") as log:
        log.write("WARNING at 3 µs: particle 1 of cell 2 is stretched 3.03-fold, beyond the limit of 3\n"
                  "WARNING: from 3 µs on fluid was stretched beyond the limit of 3, up to 8-fold\n")
    assert [text[:9] for text, _ in describe(copy).warnings] == ["from 3 µs"]


def test_what_is_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="is not the directory of a run"):
        report(tmp_path)
    with pytest.raises(UsageError, match="from 0 to 65535"):
        parse(["watch", "output", "--port", "70000"])


@pytest.mark.parametrize("name", ["", ".", "/", "manifest.json", "output", "folder.html"])
def test_a_page_does_not_take_the_place_of_another_file_or_of_a_folder(name: str, tmp_path: Path) -> None:
    (tmp_path / "folder.html").mkdir()
    with pytest.raises(UsageError, match=r"--out: expects the name of a file, such as '.*report\.html'"):
        parse(["report", "output", "--out", str(tmp_path / name) if name == "folder.html" else name])


def test_who_asks_for_the_page_of_a_sweep_is_told_where_it_is(tmp_path: Path) -> None:
    write_study(tmp_path, "A sweep", [], [], {})
    (tmp_path / "runs").mkdir()
    with pytest.raises(OutputError, match=f"but that of many, in '{tmp_path}/runs'; '{tmp_path}/report.html' is their"):
        report(tmp_path)


def test_the_page_of_a_run_goes_where_it_is_told_to(run: Path, tmp_path: Path,
                                                    capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "one.html"
    assert commands.report(parse(["report", str(run), "--out", str(path)])) == 0
    assert capsys.readouterr().out == f"{path}\n"
    assert path.stat().st_size < 1e6


def test_the_page_of_a_study_has_its_figures_tables_and_runs(run: Path, tmp_path: Path) -> None:
    figures = save(Figure(figsize=(1, 1)), tmp_path, "some_figure", ("png", "pdf"))
    (tmp_path / "rows.csv").write_text("seed,ux_um,cause,empty\n2,-1.5,\"<a, b>\",\n1,7,,\n", encoding="utf-8")
    path = write_study(tmp_path, "A study", ["holds <1>"], figures, {"Rows": tmp_path / "rows.csv"}, {"one": run})
    text = path.read_text(encoding="utf-8")
    assert text.count('<img src="data:image/png;base64,') == 1
    assert "displacement x [µm]" in text and "&lt;a, b&gt;" in text and "holds &lt;1&gt;" in text
    assert "<th scope=col><button type=button>empty" not in text
    chart, = data_of(path)["charts"]
    assert chart["lines"] == ["one"]


def test_a_port_that_is_taken_is_told(run: Path) -> None:
    with Server(run, 0, str) as server, pytest.raises(OutputError, match="without --port a free one is taken"):
        Server(run, server.server_address[1], str)


@pytest.mark.parametrize("host, status", [("localhost:9000", 200), ("127.0.0.1", 200), ("[::1]:80", 200),
                                          ("evil.example", 403), ("127.0.0.1.evil.example:80", 403)])
def test_watch_answers_only_requests_to_this_machine_by_name(run: Path, host: str, status: int) -> None:
    """A site whose name is given the address of this machine cannot read a run by the browser of its reader."""
    with Server(run, 0, str) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        connection = http.client.HTTPConnection(*server.server_address)
        connection.request("GET", "/", headers={"Host": host})
        answer = connection.getresponse()
        assert answer.status == status
        assert (answer.read().decode() == str(run)) == (status == 200)
        connection.close()
        server.shutdown()
        thread.join()


def test_watch_tells_of_a_file_that_has_gone_while_it_was_read(run: Path) -> None:
    def make(_: Path) -> str:
        raise FileNotFoundError(2, "No such file or directory", "history.csv")

    with Server(run, 0, make) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        with pytest.raises(urllib.error.HTTPError, match="503") as refused:
            urllib.request.urlopen(server.url)
        assert b"history.csv" in refused.value.read()
        refused.value.close()
        server.shutdown()
        thread.join()


@pytest.mark.parametrize("sign", [signal.SIGINT, signal.SIGTERM])
def test_watch_serves_this_machine_alone_and_leaves_nothing_behind(
        copy: Path, sign: signal.Signals, watched: Callable[[Path], Any]) -> None:
    before = sorted(copy.rglob("*"))
    process, address = watched(copy)
    with urllib.request.urlopen(address) as answer:
        assert '"live":true' in answer.read().decode()
    port = int(address.rstrip("/").rpartition(":")[2])
    assert listening(process.pid) == {f"0100007F:{port:04X}"}  # 127.0.0.1, and nothing of MPI
    with urllib.request.urlopen(f"{address}state.json") as answer:
        first = answer.read()
    with open(copy / "run.log", "a", encoding="utf-8") as log:
        log.write("news\n")
    with urllib.request.urlopen(f"{address}state.json") as answer:
        assert answer.read() != first
    with pytest.raises(urllib.error.HTTPError, match="404") as refused:
        urllib.request.urlopen(f"{address}manifest.json")
    refused.value.close()
    process.send_signal(sign)
    assert process.wait(20) == 0
    assert sorted(copy.rglob("*")) == before
