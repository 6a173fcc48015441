"""Cases in three dimensions, as users run them: on ranks, resumed, drawn, and refused with reasons."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from xml.etree import ElementTree

import h5py
import meshio
import numpy as np
import pytest
from scenes import CASES

from cellmig.case.load import load
from cellmig.case.messages import CaseError
from cellmig.output.mesh import read_mesh
from cellmig.output.tables import HISTORY, LEDGER, MOTION, read_table
from cellmig.output.xdmf import frames
from cellmig.plot.plot import plot
from cellmig.runs.info import info
from cellmig.runs.preflight import report
from cellmig.runs.record import Record
from cellmig.simulation import Simulation

pytestmark = pytest.mark.serial

COARSE = ("--set", "particles.per_cell=200", "--set", "time.samples=4", "--set", "time.frames=2", "--quiet")


@pytest.fixture(scope="module")
def row(cellmig, tmp_path_factory) -> Path:
    """A run of three balls on three ranks."""
    run = tmp_path_factory.mktemp("space") / "run"
    done = cellmig(3, CASES["three_balls"], *COARSE, "--until", "1 us", "--out", run)
    assert done.returncode == 0, done
    return run


def state_hash(run: Path) -> str:
    return json.loads((run / "manifest.json").read_text())["state_hash"]


def test_a_run_has_the_same_bits_on_other_ranks_and_after_a_stop(cellmig, row, tmp_path) -> None:
    assert cellmig(1, CASES["three_balls"], *COARSE, "--until", "1 us", "--out", tmp_path / "one").returncode == 0
    assert state_hash(tmp_path / "one") == state_hash(row)
    short = ("--until", "1 us", "--wall-time", "1 s", "--out", tmp_path / "two")
    first = cellmig(2, CASES["three_balls"], *COARSE, *short)
    assert first.returncode == 75, first
    assert cellmig(1, "resume", tmp_path / "two", "--quiet").returncode == 0
    assert state_hash(tmp_path / "two") == state_hash(row)
    for name in ("substrate", "neighbours"):
        assert (tmp_path / f"two/{name}.csv").read_bytes() == (row / f"{name}.csv").read_bytes()
    for index in ("cells", "surface"):  # frames of two ranks, and after the stop of one
        steps = ElementTree.parse(tmp_path / f"two/{index}.xdmf").getroot().findall("./Domain/Grid/Grid")
        assert [len(step.findall("Grid")) for step in steps] == [2, 1], index


def test_info_tells_the_way_along_both_axes_of_the_substrate_and_energies_with_the_unit_of_space(row) -> None:
    table, text = read_table(row / "history.csv"), " ".join(info(row).split())
    assert f"Cell-3 moved {table['ux_um'][-1]:.4g}, {table['uy_um'][-1]:.4g} µm" in text
    shutil.copytree(row, other := row.with_name("other"))
    about = json.loads((other / "manifest.json").read_text())
    about |= {"exit_status": 4, "cause": "the simulation failed at 1 µs: a value is not finite any more",
              "scheme_loss_pN_um": 0.5, "newton": [[1.0, [3.0, 0.1, 1e-9]], [2.0, [3.0, 1e-9]]]}
    (other / "manifest.json").write_text(json.dumps(about))
    text = " ".join(info(other).split())
    assert "ended the simulation failed at 1 µs: a value is not finite any more (exit code 4)" in text
    assert "scheme loss 0.5 pN µm" in text and "newton steps 3 in 2 load steps, at most 2 in one" in text


def test_terms_that_do_nothing_change_no_bit(cellmig, tmp_path) -> None:
    hashes = set()
    for name, more in (("pruned", ()), ("whole", ("--no-prune",))):
        done = cellmig(1, CASES["ball"], *COARSE, "--until", "1 us", *more, "--out", tmp_path / name)
        assert done.returncode == 0, done
        hashes.add(state_hash(tmp_path / name))
    assert len(hashes) == 1


def test_two_cells_in_one_place_are_refused() -> None:
    same = '[["0 um", "0 um", "0 um"]]'
    with pytest.raises(CaseError, match=r"'Cell-2' overlaps 'Cell-1' by \d"):
        load(CASES["three_balls"], ["cells.0.repeat=[2]", f"cells.0.pitch={same}", 'protrusion.cells=["Cell-1"]'])


def test_a_start_that_turns_a_body_inside_out_ends_with_a_message(cellmig, tmp_path) -> None:
    inside_out = 'cells.0.displacement=["-2*x um", "0 um", "0 um"]'
    done = cellmig(1, CASES["bar"], *COARSE, "--set", inside_out, "--out", tmp_path / "run")
    assert done.returncode == 2 and "Traceback" not in done.stderr, done
    assert "cells.0.displacement: turns 'Bar' inside out at (" in done.stderr and "J = -" in done.stderr


def test_a_body_from_a_file_has_the_same_bits_on_other_ranks_and_is_resumed_without_the_file(cellmig, tmp_path) -> None:
    for name in ("surface.toml", "cell_surface.stl"):
        shutil.copy(CASES["surface"].parent / name, tmp_path)
    words = (tmp_path / "surface.toml", *COARSE, "--until", "1 us")
    assert cellmig(1, *words, "--out", tmp_path / "one").returncode == 0
    stopped = ("--out", tmp_path / "three", "--wall-time", "1 s")
    assert cellmig(3, *words, *stopped).returncode == 75
    file = tmp_path / "cell_surface.stl"
    file.write_text(file.read_text().replace("vertex 0 0 ", "vertex 0 0.001 "))
    other = cellmig(3, *words, *stopped, "--resume", "auto")
    assert other.returncode == 2 and "file.vertices: is not what it was in the run that is there" in other.stderr, other
    file.unlink()
    assert cellmig(2, "resume", tmp_path / "three", "--quiet").returncode == 0
    assert state_hash(tmp_path / "three") == state_hash(tmp_path / "one")


def test_tables_and_frames_have_three_dimensions(row: Path) -> None:
    history, ledger = (read_table(row / f"{name}.csv") for name in ("history", "ledger"))
    assert tuple(history) == (*HISTORY[3], *MOTION[3], "neighbours", "name") and tuple(ledger) == LEDGER[3]
    assert all(np.isfinite(history[name]).all() for name in HISTORY[3])
    one = history["cell"] == 1
    assert history["volume_um3"][one] == pytest.approx(4 / 3 * np.pi * 125.0, rel=0.06)  # measured 0.04: coarse
    assert history["sphericity"][one] == pytest.approx(1.0, abs=0.01)  # measured 0.006: triangles
    assert history["height_um"][one] == pytest.approx(10.01, abs=0.1)  # measured 0.04
    assert (history["substrate_contact_um2"][one] > 0.0).all() and (history["z_um"][one] > 4.5).all()
    assert np.abs(ledger["energy_error"]).max() < 0.01  # measured 0.004
    assert len(frames(row)) == 2  # at the start and at the end
    mesh, now = read_mesh(row), Record(row).frame(1.0)
    assert now["x"].shape == (600, 3) and now["adhesion_force"].shape == (600, 3)
    assert frames(row)[0].units()["adhesion_force"] == "pN" and "momentum_pN_us" in Record(row).manifest
    sides = now["X"][mesh["tetrahedra"]]
    volume = np.linalg.det(sides[:, 1:] - sides[:, :1]).sum() / 6.0
    assert volume == pytest.approx(3.0 * history["volume_um3"][one][0], rel=1e-6)
    assert mesh["triangles"].max() < 600


def test_pictures_and_films_show_surfaces(row: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")  # no ffmpeg
    made = plot(row, out=tmp_path, formats=("png",), moving=True)
    assert {path.name for path in made} == {"film.gif", *(f"{name}.png" for name in (
        "shapes", "section", "displacement", "ledger", "traction", "between"))}
    assert all(path.stat().st_size > 10_000 for path in made)
    assert len(Record(row).picture([0.0, 1.0]).axes) == 3  # two times and the colours


@pytest.mark.usefixtures("hasty")
def test_validate_tells_what_a_case_in_space_takes() -> None:
    text = report(load(CASES["three_balls"], ["particles.per_cell=200"]))
    for part in ("z from 0.01 to 10.01 µm", "averages of finite elements", "10 nm between cells", "pN a cell",
                 "bodies", "Cell-1: 523.6 µm³ within 313.8 µm², 10 × 10 × 10 µm; its particles hold 95.7 % of that"):
        assert part in text, text


def test_implicit_steps_are_taken_as_the_command_line_asks(cellmig, tmp_path: Path) -> None:
    done = cellmig(1, CASES["ball"], *COARSE, "--until", "0.1 us", "--out", tmp_path / "run", "-ts_type", "bdf")
    manifest = json.loads((tmp_path / "run/manifest.json").read_text())
    assert done.returncode == 0 and manifest["newton_steps"] > 0, done


def test_a_sweep_draws_what_cells_in_space_have(cellmig, tmp_path: Path) -> None:
    done = cellmig(1, "sweep", CASES["ball"], "--vary", "seed=1,2", *COARSE[2:-1], "--set", "particles.per_cell=100",
                   "--set", "time.end=1 us", "--out", tmp_path / "sweep")
    assert done.returncode == 0 and (tmp_path / "sweep/sweep.png").exists(), done
    assert "substrate_contact_um2" in (tmp_path / "sweep/sweep.csv").read_text().splitlines()[0]


@pytest.mark.parametrize(("sets", "told"), [
    (["cells.0.shape=disc"], "no shape 'disc' in 3 dimensions; there is 'ball'"),
    (["dimension=2"], "no shape 'ball' in 2 dimensions; there is 'disc'"),
    (['probes=[{name="p", point=["0 um", "0 um"]}]'], 'point: expects a list such as ["1 um", "1 um", "1 um"]'),
    (["particles.dilation=2.0"], "dilation: has no meaning in three dimensions"),
    (["time.integrator=static"], "finds equilibria of solids: 'nematic' has a viscosity"),
    (['cells.0.centre=["0 um", "0 um"]'], "centre: expects a list such as"),
    (["cells.0.rest=false", 'cells.0.centre=["0 um", "0 um", "4 um"]'], "reaches 1 um below the substrate z = 0"),
    (['cells.0.pitch=[["8 um", "0 um", "0 um"]]'], "overlaps 'Cell-1' by 1.998 um"),
    (["director.law=frozen", "director.angle=1 rad"], "angle: has no meaning in three dimensions: give three numbers"),
    (["director.law=frozen", "director.direction=[1, 0]"], "direction: expects a list such as [1, 1, 1]"),
    (["director.law=frozen", "director.direction=[0, 0, 0]"], "direction: expects a direction, not zero"),
    (["director.law=relaxing", "director.direction=[0, 0, 1]"], "direction: is that of a uniform field"),
    (["director.law=frozen", 'director.direction=["cos(q)", 0, 1]'], "'q' is not known"),
    (["director.law=frozen", 'director.direction=["x um", 0, 1]'], "'x um' is not a formula, such as '0.1*x'")])
def test_what_is_not_there_is_refused(sets: list[str], told: str) -> None:
    with pytest.raises(CaseError) as error:
        load(CASES["three_balls"], ["particles.per_cell=200", *sets])
    assert told in str(error.value), str(error.value)


def test_a_formula_of_the_director_without_a_value_is_refused_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "case.toml").write_text(f"extends = '{CASES['ball']}'\n[director]\nlaw = 'frozen'\n"
                                        "direction = ['log(x)', 1, 0]\n")
    with pytest.raises(CaseError) as error, Simulation(load(tmp_path / "case.toml", ["particles.per_cell=100"])):
        pass
    assert "case.toml:4: director.direction: 'log(x)' has no value" in str(error.value), str(error.value)


@pytest.mark.parametrize(("name", "unit"), [("ball_director", "_um"), ("director_radial", "")])
def test_a_case_with_a_director_has_the_same_bits_on_ranks_and_is_a_start_for_others(
        cellmig, tmp_path: Path, name: str, unit: str) -> None:
    some = (*COARSE, "--until", "1 us", "--out")
    for ranks in (1, 3):
        done = cellmig(ranks, CASES[name], *some, tmp_path / f"{ranks}")
        assert done.returncode == 0, done
    assert state_hash(tmp_path / "1") == state_hash(tmp_path / "3")
    last = Record(tmp_path / "3").frame(1.0)
    assert np.abs(np.linalg.norm(last["director"], axis=1) - 1.0).max() < 1e-15
    done = cellmig(2, CASES[name], "--from", tmp_path / "1", *some, tmp_path / "on")
    assert done.returncode == 0, done
    first = Record(tmp_path / "on").frame(0.0)
    assert np.array_equal(first["director"], last["director"])
    begun, ended = (read_table(tmp_path / name / "ledger.csv")["director_pn" + unit] for name in ("on", "1"))
    assert begun[0] == pytest.approx(ended[-1], rel=1e-12)  # measured 0


def test_a_wrong_dimension_is_the_only_mistake_told() -> None:
    with pytest.raises(CaseError) as error:
        load(CASES["ball"], ["dimension=4"])
    assert str(error.value).endswith("dimension: must be >= 2 and <= 3, not 4"), str(error.value)


def test_the_ranks_have_all_elements_once_and_their_corners(cellmig, tmp_path: Path) -> None:
    """A ball on two ranks, which both need particles of the other."""
    run, V, area, ids = tmp_path / "run", [], [], []
    assert cellmig(2, CASES["ball"], *COARSE, "--until", "0.1 us", "--out", run).returncode == 0
    for file in frames(run)[0].files:
        with h5py.File(file, "r") as opened:
            x, tet, triangles, owned = (opened["geometry"][()], opened["tetrahedra"][()], opened["triangles"][()],
                                        opened.attrs["owned"])
            ids.append(opened["id"][:owned])
            V.append(np.linalg.det(x[tet[:, 1:]] - x[tet[:, :1]]).sum() / 6.0)
            a, b, c = x[triangles].transpose(1, 0, 2)
            area.append(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
            assert len(x) > owned and max(tet.max(), triangles.max()) < len(x)
    first = {name: column[1] for name, column in read_table(run / "history.csv").items()}
    assert len(ids) == 2 and sorted(np.concatenate(ids)) == list(range(200))
    assert sum(V) == pytest.approx(first["volume_um3"], rel=1e-9)
    assert sum(area) == pytest.approx(first["surface_um2"], rel=1e-9)


def test_paraview_finds_tetrahedra_and_the_surface(row: Path) -> None:
    for index, kind in (("cells", "Tetrahedron"), ("surface", "Triangle")):
        steps = ElementTree.parse(row / f"{index}.xdmf").getroot().findall("./Domain/Grid/Grid")
        assert len(steps) == 2
        topologies = [grid.find("Topology") for step in steps for grid in step.findall("Grid")]
        assert len(topologies) == 6 and {t.get("TopologyType") for t in topologies} == {kind}
        many = sum(int(t.get("NumberOfElements")) for t in topologies[:3])
        assert many == len(read_mesh(row)["tetrahedra" if index == "cells" else "triangles"])
    with meshio.xdmf.TimeSeriesReader(row / "rank0001.xdmf") as reader:
        points, cells = reader.read_points_cells()
        assert cells[0].type == "tetra" and cells[0].data.max() < len(points)


def test_a_formula_may_name_z() -> None:
    case = load(CASES["ball"], ['cells.0.velocity=["0.1*z um/us", "0 um/us", "-0.1*x um/us"]'])
    assert [float(v(np.array([[2.0, 0.0, 3.0]]))[0]) if callable(v) else v for v in case.cells[0].velocity] == [
        pytest.approx(0.3), 0.0, pytest.approx(-0.2)]


def test_a_mistake_of_a_shape_is_told_at_the_line_of_its_key(tmp_path) -> None:
    text = Path(CASES["ball"]).read_text().replace("nucleus_ratio = 0.283", 'nucleus_ratio = 0.5\nnucleus_offset = '
                                                   '["4 um", "0 um", "0 um"]')
    (tmp_path / "case.toml").write_text(text)
    line = 1 + text[: text.index("nucleus_offset")].count("\n")
    with pytest.raises(CaseError, match=rf"case\.toml:{line}: cells\.0\.nucleus_offset: the nucleus does not lie"):
        load(tmp_path / "case.toml")
