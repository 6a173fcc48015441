"""Fields have the values that a case gives: by formula, table or image, in the code's units."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scenes import CASES

from cellmig.case import registry, units
from cellmig.case.load import from_dict, load
from cellmig.case.messages import CaseError
from cellmig.case.schema import Case
from cellmig.laws import register
from cellmig.model.ground import fields_of, push_factor

pytestmark = pytest.mark.serial

register()

NANOMOLAR, HOUR = 0.602214076, 3.6e9  # 1 nM in 1/µm³, 1 h in µs


def with_tables(folder: Path, text: str, **files: str) -> Case:
    """The case of one cell with further tables, and text files beside it."""
    for name, content in files.items():
        (folder / f"{name}.csv").write_text(content)
    (folder / "case.toml").write_text(f'extends = "{CASES["one_cell"]}"\n{text}')
    return load(folder / "case.toml")


def wrong(folder: Path, text: str, **files: str) -> str:
    """What is wrong with such a case, without the folder of its files."""
    with pytest.raises(CaseError) as caught:
        with_tables(folder, text, **files)
    return str(caught.value).replace(f"{folder}/", "")


def picture(path: Path, greys: np.ndarray) -> None:
    """Write an image of these greys."""
    from PIL import Image

    Image.fromarray(greys).save(path)


def test_a_formula_counts_places_from_the_origin_of_the_case_and_knows_the_time_by_its_unit(tmp_path: Path) -> None:
    field = with_tables(tmp_path, '[fields.c]\nformula = "5 + 0.02*x + 3*t_h nM"').fields["c"]
    x = np.array([[50.0, 0.0], [-10.0, 4.0]])
    assert field.unit == "nM" and not field.steady
    np.testing.assert_allclose(field.value(x, 2.0 * HOUR), NANOMOLAR * np.array([12.0, 10.8]), rtol=1e-14)


def test_a_formula_is_zero_where_it_is_below_zero(tmp_path: Path) -> None:
    field = with_tables(tmp_path, '[fields.c]\nformula = "5 + 0.02*x nM"').fields["c"]
    assert (field.value(np.array([[-251.0, 0.0], [-1e6, 0.0]]), 0.0) == 0.0).all()


@pytest.mark.parametrize(("unit", "size"), [("nM", NANOMOLAR), ("/um^3", 1.0), ("kPa", 1e3), ("", 1.0)])
def test_a_field_may_have_any_unit(tmp_path: Path, unit: str, size: float) -> None:
    field = with_tables(tmp_path, f'[fields.c]\nformula = "5 + 0*x {unit}"').fields["c"]
    assert field.unit == unit and field.value(np.zeros((1, 2)), 0.0) == pytest.approx(5.0 * size, rel=1e-14)


def test_a_table_is_linear_between_its_places_and_constant_beyond(tmp_path: Path) -> None:
    case = with_tables(tmp_path, '[fields.E]\nlaw = "table"\nfile = "E.csv"\nunit = "kPa"\nlength = "1 mm"',
                       E="value,x\n3,0.2\n1,0\n2,0.1\n")
    x = np.column_stack([[-5.0, 0.0, 50.0, 150.0, 200.0, 1e4], np.zeros(6)])
    np.testing.assert_allclose(case.fields["E"].value(x, 0.0), [1e3, 1e3, 1.5e3, 2.5e3, 3e3, 3e3], rtol=1e-14)


def test_a_table_of_a_grid_is_bilinear(tmp_path: Path) -> None:
    grid = "".join(f"{x},{y},{1 + 2 * x + 3 * y + x * y}\n" for y in (4, 0) for x in (0, 1, 5))
    field = with_tables(tmp_path, '[fields.c]\nlaw = "table"\nfile = "c.csv"', c=f"x,y,value\n{grid}").fields["c"]
    x, y = np.random.default_rng(1).uniform([0.0, 0.0], [5.0, 4.0], (20, 2)).T
    np.testing.assert_allclose(field.value(np.column_stack([x, y]), 0.0), 1 + 2 * x + 3 * y + x * y, rtol=1e-14)


@pytest.mark.parametrize(("kind", "deep"), [("png", 8), ("png", 16), ("tiff", 8), ("tiff", 16)])
def test_an_image_holds_at_the_centres_of_pixels_and_is_in_the_plane_the_mean_of_its_rows(tmp_path: Path, kind: str,
                                                                                          deep: int) -> None:
    white = 2**deep - 1
    picture(tmp_path / f"c.{kind}", np.array([[0, white], [white, white]], np.uint8 if deep == 8 else np.uint16))
    field = with_tables(tmp_path, f'[fields.c]\nlaw = "image"\nfile = "c.{kind}"\npixel = "2 um"\nrange = [1, 3]\n'
                        'unit = "nM"\ncorner = ["10 um", "-1 um"]').fields["c"]
    line, plane = np.array([[0.0, 0.0], [11.0, 0.0], [12.0, 0.0]]), np.array([[11.0, 2.0, 0.0], [11.0, 0.0, 0.0]])
    np.testing.assert_allclose(field.value(line, 0.0), NANOMOLAR * np.array([2.0, 2.0, 2.5]), rtol=1e-14)
    np.testing.assert_allclose(field.value(plane, 0.0), NANOMOLAR * np.array([1.0, 3.0]), rtol=1e-14)


def test_a_resolved_case_has_the_content_of_its_files(tmp_path: Path) -> None:
    greys = np.random.default_rng(2).integers(0, 255, (5, 7), np.uint8)
    picture(tmp_path / "n.png", greys)
    case = with_tables(tmp_path, '[fields.E]\nlaw = "table"\nfile = "E.csv"\nunit = "kPa"\n[fields.n]\nlaw = "image"\n'
                       'file = "n.png"\npixel = "1 um"\nrange = [0, 1]\n[substrate]\nstiffness = "E"\nligand = "n"\n'
                       'response = { law = "optimum", optimum = "2 kPa" }', E="x,value\n0,0.1\n1e-3,3\n")
    for path in tmp_path.glob("*.*"):
        path.unlink()
    again = from_dict(json.loads(json.dumps(case.resolved(), allow_nan=False)))
    assert again == case and again.resolved() == case.resolved()
    x = np.random.default_rng(3).uniform(-1.0, 8.0, (9, 2))
    for name, field in fields_of(case).items():
        assert np.array_equal(field.value(x, 0.0), fields_of(again)[name].value(x, 0.0)), name


@pytest.mark.parametrize(("text", "said"), [
    ('[fields.c]\nformula = "5*t nM"', "the time has a unit: write t_s for seconds"),
    ('[fields.c]\nformula = "5*q nM"', "'q' is not known"),
    ('[fields.c]\nformula = "5 + * nM"', "is not a formula with a unit"),
    ('[fields.c]\nformula = "5*z nM"', "'z' is not known"),
    ('[fields.c]\nformula = "x - 100 nM"', "an amount is finite and at least 0"),
    ('[fields."a b"]\nformula = "1 nM"', "expects letters, digits"),
    ('[fields.c]\nlaw = "table"\nfile = "d.csv"', "no file 'd.csv'"),
    ('[fields.c]\nlaw = "table"\nfile = "c.csv"\nunit = "nMM"', "is not a unit"),
    ('[fields.c]\nlaw = "image"\nfile = "c.csv"\npixel = "1 um"\nrange = [0, 1]', "is no image that can be read"),
    ('[substrate]\nstiffness = "F"', "'F' is not a number with a unit, such as '1 Pa', or the name of a field"),
    ('[fields.c]\nformula = "1 nM"\n[substrate]\nstiffness = "c"', "expects a field in a unit such as Pa"),
    ('[fields.c]\nformula = "1 + t_s"\n[substrate]\nligand = "c"', "depends on the time, but a substrate does not"),
    ('[substrate]\nligand = "1 + abs(x)"', "at least 0 and at most 1"),
    ('[substrate]\nresponse = { half = "1 kPa" }', "response: is to a stiffness, which is missing"),
    ('[fields.ligand]\nformula = "1"', "is the name of what substrate.ligand gives"),
])
def test_what_is_wrong_with_a_field_is_told(tmp_path: Path, text: str, said: str) -> None:
    assert said in wrong(tmp_path, text, c="x,value\n0,1\n1,2\n")


@pytest.mark.parametrize(("content", "said"), [
    ("a,value\n0,1\n", "has the columns 'a,value', not x and value"),
    ("x,value\n0,1\n1,two\n", "line 3: '1,two' are not numbers"),
    ("x,value\n0,1\n1\n", "has 1 words in line 3, not 2"),
    ("x,value\n0,1\n1,-2\n", "an amount is at least 0, not -2"),
    ("x,value\n0,1\n1,nan\n", "line 3: a value is not finite"),
    ("x,value\n0,1\n0,2\n", "has two values at one place"),
    ("x,y,value\n0,0,1\n1,0,2\n1,1,3\n", "has 3 rows, not one value at each of the 4 nodes of a grid"),
    ("x,value\n", "has no rows"),
])
def test_what_is_wrong_with_a_table_is_told(tmp_path: Path, content: str, said: str) -> None:
    assert said in wrong(tmp_path, '[fields.c]\nlaw = "table"\nfile = "c.csv"', c=content)


def test_a_table_with_a_third_coordinate_is_for_three_dimensions(tmp_path: Path) -> None:
    said = wrong(tmp_path, '[fields.c]\nlaw = "table"\nfile = "c.csv"', c="x,z,value\n0,0,1\n1,0,2\n")
    assert "has a column z" in said


def test_a_static_case_has_no_substrate_that_varies(tmp_path: Path) -> None:
    text = f'extends = "{CASES["squeezed_disc"]}"\n[substrate]\nstiffness = "1 kPa"'
    (tmp_path / "case.toml").write_text(text)
    with pytest.raises(CaseError, match="it has no substrate yet"):
        load(tmp_path / "case.toml")


@pytest.mark.parametrize("law", [one for one in registry.laws("response").values() if hasattr(one, "factor")])
def test_a_response_is_between_nothing_and_the_full_push(law: type) -> None:
    made = law(**dict.fromkeys(law.__dataclass_fields__, 1e4))
    g = made.factor(np.logspace(0.0, 8.0, 200))
    assert (g > 0.0).all() and (g <= 1.0).all() and g.max() > 0.99
    assert made.factor(1e4) == {"saturating": 0.5, "optimum": 1.0}[law.law]


def test_the_push_follows_stiffness_and_ligands_where_the_membrane_is(tmp_path: Path) -> None:
    case = with_tables(tmp_path, '[substrate]\nstiffness = "3000 + 13.7*x Pa"\nresponse = { half = "10 kPa" }\n'
                       'ligand = "0.5 + 0.001*x"')
    x = np.array([[0.0, 0.0], [100.0, 2.0], [900.0, 0.0]])
    E, ligand = np.array([3000.0, 4370.0, 15330.0]), np.array([0.5, 0.6, 1.0])
    np.testing.assert_allclose(push_factor(case.ground, fields_of(case), x, 0.0), ligand * E / (E + 1e4), rtol=1e-14)
    assert (push_factor(None, {}, x, 0.0) == 1.0).all()


def test_concentrations_are_molecules_by_volume() -> None:
    assert units.number("1 nM", "/um^3") == units.number("1 nmol/L", "nM") == NANOMOLAR
    assert units.text(10.0 * NANOMOLAR, "nM") == "10 nM"
