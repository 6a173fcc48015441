"""The package from Python: cases changed, run and read back; the examples, each in a process of its own."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scenes import CASES, ROOT

import cellmig
from cellmig.case.messages import CaseError
from cellmig.output.directory import OutputError
from cellmig.plot.plot import plot

COARSE = {"particles.per_cell": 100, "time.end": "4 us", "time.frames": 2, "time.samples": 8}


@pytest.fixture
def case():
    return cellmig.change(cellmig.load(CASES["one_cell"]), COARSE)


@pytest.mark.serial
def test_a_changed_case_is_another_and_the_old_one_stays(case):
    finer = cellmig.change(case, {"particles.spacing": "0.8 um", "cells.Cell-1.radius": "4 um"})
    assert (finer.particles.per_cell, finer.particles.spacing) == (None, 0.8)
    assert (finer.cells[0].shape.radius, case.cells[0].shape.radius, case.particles.per_cell) == (4.0, 5.0, 100)
    assert cellmig.change(case, {}) == case


@pytest.mark.serial
def test_a_table_may_be_changed_as_a_whole(case):
    elastic = {"law": "mooney-rivlin", "density": "1000 kg/m^3", "C1": "1 kPa", "C2": "0 Pa",
               "volumetric_modulus": "100 kPa"}
    assert cellmig.change(case, {"materials.cytoplasm": elastic}).materials["cytoplasm"].law == "mooney-rivlin"


@pytest.mark.serial
def test_all_mistakes_in_changes_are_told_at_once(case):
    with pytest.raises(CaseError) as error:
        cellmig.change(case, {"time.ends": "40 us", "cells.Cell-9.radius": "4 um", "seed": "many"})
    assert len(error.value.mistakes) == 3
    assert "change: time.ends: no such key; did you mean 'end'?" in str(error.value)


def test_a_simulation_that_is_built_has_the_faster_integrator_if_the_case_leaves_it_open(case):
    with cellmig.build(cellmig.change(case, {"time.integrator": "auto"})) as simulation:
        assert simulation.integrator.description in ("leapfrog", "bdf")
        assert simulation.go(0.01) == 0.01


def test_a_run_is_read_back_as_arrays(case, shared_tmp):
    record = cellmig.run(case, out=shared_tmp / "run", until="2 us", quiet=True)
    assert record.status == 0 and record.case == case
    np.testing.assert_allclose(record.times, [0.0, 2.0])
    first, last = record.frame(0.0), record.frame()
    assert first["stress"].shape == (100, 3, 3) and first["x"].shape == (100, 2)
    assert last["time"] == 2.0 and (last["id"] == np.arange(100)).all() and record.units["x"] == "um"
    np.testing.assert_array_equal(last["x"], last["X"] + last["u"])
    assert record.table("history")["time_us"][-1] == 2.0
    again = cellmig.open(shared_tmp / "run")
    assert again.manifest["state_hash"] == record.manifest["state_hash"]
    assert "aggregate" in repr(again)


@pytest.mark.serial
def test_a_record_of_an_older_run_has_its_case(case, tmp_path):
    text = json.dumps({"case": case.resolved(), "case_file": case.path})
    for new, old in (("bond_density", "bonds"), ("well_depth", "energy")):
        text = text.replace(f'"{new}"', f'"{old}"')
    (tmp_path / "manifest.json").write_text(text)
    assert cellmig.open(tmp_path).case == case


@pytest.mark.serial
def test_tables_are_pandas_frames(case, shared_tmp):
    pytest.importorskip("pandas", reason="no pandas here: apt install python3-pandas")
    record = cellmig.run(case, out=shared_tmp / "run", quiet=True)
    assert list(record.history.query("cell == 1")["time_us"]) == list(record.ledger["time_us"])


@pytest.mark.serial
def test_without_pandas_the_message_says_what_to_do(case, shared_tmp, monkeypatch):
    record = cellmig.run(case, out=shared_tmp / "run", quiet=True)
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r"apt install python3-pandas, or take table\('history'\)"):
        record.history  # noqa: B018


@pytest.mark.serial
def test_forces_on_the_substrate_and_between_cells_are_drawn_of_scenes_that_have_them(tmp_path):
    case = cellmig.change(cellmig.load(CASES["all_protrude"]), COARSE)
    made = plot(cellmig.run(case, out=tmp_path, quiet=True).directory, formats=("png",))
    assert [path.stem for path in made] == ["shapes", "displacement", "ledger", "traction", "between", "graph"]


@pytest.mark.serial
def test_what_is_no_run_is_not_opened(shared_tmp):
    with pytest.raises(OutputError, match="not the directory of a run"):
        cellmig.open(shared_tmp / "nothing")


@pytest.mark.serial
def test_a_picture_shows_itself_in_a_notebook(case, shared_tmp):
    record = cellmig.run(case, out=shared_tmp / "run", until="0.1 us", quiet=True)
    assert record.picture([0.0])._repr_png_().startswith(b"\x89PNG")


@pytest.fixture
def example(tmp_path, outside_mpi):
    """Runs Python in an empty folder; returns what it prints."""
    def run(*words: str | Path) -> str:
        environment = outside_mpi | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "agg"}
        done = subprocess.run([sys.executable, *words], cwd=tmp_path, text=True, env=environment,
                              capture_output=True, timeout=120)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


@pytest.mark.serial
@pytest.mark.parametrize(("name", "said"), [
    ("first_look", "effective stress in the nucleus"),
    ("adhesion_law", "spring: contact with the substrate"),
    ("own_shape", "400 particles"),
    ("sweep", "tension 80 pN/um: contact"),
])
def test_an_example_runs_and_says_what_it_found(example, name, said):
    if name == "first_look":
        pytest.importorskip("pandas", reason="no pandas here: apt install python3-pandas")
    assert said in example(ROOT / f"examples/{name}.py")


@pytest.mark.serial
def test_the_cells_of_the_notebook_run_one_after_the_other(example):
    pytest.importorskip("pandas", reason="no pandas here: apt install python3-pandas")
    cells = [cell for cell in json.loads((ROOT / "examples/tour.ipynb").read_text())["cells"]
             if cell["cell_type"] == "code"]
    assert not any(cell["outputs"] or cell["execution_count"] for cell in cells)
    text = "\n".join("".join(cell["source"]) for cell in cells).replace("%matplotlib inline\n", "")
    said = example("-c", text)
    assert "no such key; did you mean 'per_cell'?" in said and "300 particles; effective stress in the nucleus" in said
