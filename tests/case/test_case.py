"""A case file gives the case, or all that is wrong with it: by file and line, with the nearest word that would do."""

from __future__ import annotations

import json
import math
import pickle
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scenes import CASES

from cellmig.case import registry, units
from cellmig.case.json_schema import json_schema
from cellmig.case.lines import key_lines
from cellmig.case.load import change, from_dict, load
from cellmig.case.messages import CaseError, nearest
from cellmig.case.schema import Case, Load, Plate, Support
from cellmig.case.values import declared
from cellmig.laws import register

pytestmark = pytest.mark.serial

register()

MATERIALS = ", ".join(f"'{name}'" for name in sorted(registry.laws("material")))

SOUND = """\
title = "Two cells"
seed = 1
[time]
end = "4 us"
frames = 2
step = "auto"
[particles]
per_cell = 91
[materials.gel]
law = "nematic"
viscosity = "1 mPa s"
bulk_modulus = "2.2 GPa"
reduced_bulk_modulus = "5 MPa"
[materials.core]
law = "mooney-rivlin"
C1 = "2126 Pa"
C2 = "170 Pa"
volumetric_modulus = "170 kPa"
[[cells]]
name = "Left"
shape = "disc"
radius = "5 um"
nucleus_ratio = 0.283
material = "gel"
nucleus = "core"
centre = ["0 um", "5.01 um"]
[[cells]]
name = "Right"
shape = "disc"
radius = "5 um"
material = "gel"
centre = ["10.01 um", "5.01 um"]
[adhesion.substrate]
law = "seifert"
bond_density = "8000 /um^2"
well_depth = "0.03 pN um"
equilibrium_distance = "10 nm"
[protrusion]
law = "edge"
cells = ["Left"]
[numerics]
bulk_viscosity = 0.2
"""


@pytest.fixture
def written(tmp_path: Path) -> Callable[..., Path]:
    """`written(text, "name.toml")`: the path of a case file with that text."""

    def write(text: str | bytes, name: str = "case.toml") -> Path:
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


def messages(path: Path, sets: tuple[str, ...] = ()) -> list[str]:
    """What is wrong with a case, without the folder of its files; nothing may be right."""
    with pytest.raises(CaseError) as caught:
        load(path, sets)
    return str(caught.value).replace(f"{path.parent}/", "").split("\n")


def line_of(text: str, part: str) -> int:
    """Line on which `part` stands first."""
    return text[:text.index(part)].count("\n") + 1


# ------------------------------------------------------------------------------------------------- what is read


@pytest.mark.parametrize("path", CASES.values(), ids=CASES)
def test_every_case_of_the_collection_loads_and_has_a_title(path: Path) -> None:
    case = load(path)
    assert case.title and case.cells and case.name == path.stem


@pytest.mark.parametrize("path", CASES.values(), ids=CASES)
def test_a_resolved_case_written_as_json_loads_to_an_equal_case(path: Path) -> None:
    case = load(path)
    again = from_dict(json.loads(json.dumps(case.resolved(), allow_nan=False)))
    assert again == case
    assert again.resolved() == case.resolved()


def test_the_papers_scene_has_the_numbers_of_the_paper() -> None:
    case = load(CASES["all_protrude"])
    assert [cell.name for cell in case.cells] == ["Cell-1", "Cell-2", "Cell-3"]
    assert [cell.centre for cell in case.cells] == [(10.01, 5.01), (0.0, 5.01), (-10.01, 5.01)]
    assert all(cell.shape.radius == 5.0 and cell.shape.nucleus_ratio == 0.283 for cell in case.cells)
    assert case.particles.per_cell * len(case.cells) == 4455 and case.particles.dilation == 2.2
    assert case.substrate.work == pytest.approx(240.0) and case.contact.work == pytest.approx(24.0)
    gel, core = case.materials["cytoplasm"], case.materials["nucleus"]
    assert (gel.viscosity, gel.bulk_modulus, gel.eta, gel.zeta) == (1000.0, 2.2e9, 5e4, 0.0)
    assert (core.shear_modulus, core.bulk_modulus, core.density) == (4592.0, 680e3, 1000.0)
    assert case.time.end == 400.0 and case.time.step == "auto" and case.seed == 2019


@pytest.mark.parametrize("name, who", [("all_protrude", (1, 2, 3)), ("one_three", (1, 3)), ("two_three", (2, 3)),
                                       ("three_only", (3,)), ("paper", ())])
def test_the_four_cases_of_the_paper_differ_in_title_and_in_who_protrudes(name: str, who: tuple[int, ...]) -> None:
    paper, case = (load(CASES[stem]).resolved() for stem in ("paper", name))
    assert case["protrusion"].pop("cells") == [f"Cell-{i}" for i in who]
    del paper["protrusion"]["cells"], paper["title"], case["title"]
    assert case == paper


def test_what_a_case_does_not_ask_for_is_none(written: Callable[..., Path]) -> None:
    text = SOUND[:SOUND.index("[adhesion")]
    case = load(written(text))
    assert [case.substrate, case.contact, case.protrusion, case.director, case.body_force] == [None] * 5


def test_the_default_laws_of_adhesion_and_protrusion_need_no_name(written: Callable[..., Path]) -> None:
    unnamed = SOUND.replace('law = "seifert"\n', "").replace('law = "edge"\n', "")
    assert load(written(unnamed)) == load(written(SOUND, "named.toml"))


def test_values_arrive_in_micrometres_microseconds_and_pascals(written: Callable[..., Path]) -> None:
    text = SOUND.replace('"auto"', '"1.2 ns"') + '[body_force]\nacceleration = ["0 m/s^2", "-9.81 m/s^2"]\n'
    case = load(written(text))
    assert case.time.step == pytest.approx(1.2e-3, rel=1e-15)
    assert case.substrate.equilibrium_distance == 0.01 and case.materials["gel"].viscosity == 1000.0
    assert case.body_force == (0.0, pytest.approx(-9.81e-6, rel=1e-15))  # µm/µs²


def test_a_start_velocity_may_have_a_gradient(written: Callable[..., Path]) -> None:
    text = SOUND.replace('material = "gel"\ncentre', 'velocity = ["1 m/s", "0 m/s"]\n'
                         'velocity_gradient = [["0.1 /us", "0 /us"], ["0 /us", "-100 /ms"]]\nmaterial = "gel"\ncentre')
    right = load(written(text)).cells[1]
    assert right.velocity == (1.0, 0.0) and right.velocity_gradient == ((0.1, 0.0), (0.0, -0.1))


def test_a_grid_of_cells_is_written_out_with_its_first_direction_fastest(written: Callable[..., Path]) -> None:
    text = SOUND.replace('name = "Right"', 'name = "R{}"\nrepeat = [3, 2]\n'
                                           'pitch = [["11 um", "0 um"], ["0 um", "12 um"]]')
    cells = load(written(text)).cells
    assert [cell.name for cell in cells] == ["Left", "R1", "R2", "R3", "R4", "R5", "R6"]
    assert [cell.centre for cell in cells[1:]] == [(x, y) for y in (5.01, 17.01) for x in (10.01, 21.01, 32.01)]
    assert all(cell.repeat == (1,) and cell.pitch == () for cell in cells)


def test_repeated_cells_without_braces_in_their_name_get_a_number(written: Callable[..., Path]) -> None:
    text = SOUND.replace('name = "Right"', 'name = "Right"\nrepeat = [2]\npitch = [["11 um", "0 um"]]')
    assert [cell.name for cell in load(written(text)).cells] == ["Left", "Right-1", "Right-2"]


@pytest.mark.parametrize("value", [1.0, 1.0 / 3.0, math.pi * 1e9, 1e-12, 2.2e9, -0.0, 123456789.123456])
@pytest.mark.parametrize("unit", ["um", "Pa s", "pN um", "1/um^2", "kg/m^3", "m/s^2", "rad"])
def test_a_quantity_written_as_text_is_read_back_the_same(value: float, unit: str) -> None:
    value = units.number(units.written(f"{value!r}", unit), unit)
    assert units.number(units.text(value, unit), unit) == value


@pytest.mark.parametrize("unit", ["um^9^9", "um**99", "9**9**9", "um # Pa", "u=m", "(" * 70, "um " * 40, "degC", "EUR"])
def test_what_is_no_unit_is_refused_at_once(unit: str) -> None:
    with pytest.raises(units.UnitError):
        units.number(f"1 {unit}", "um")


@pytest.mark.parametrize(("text", "unit", "value"), [
    ("5 μm", "um", 5.0), ("5 µm", "um", 5.0), ("2 /µm²", "1/um^2", 2.0), ("3 μs⁻¹", "1/us", 3.0), ("−5 um", "um", -5.0),
    ("5\u00a0um", "um", 5.0), ("5\u202fμm", "um", 5.0), ("－５．５　ｕｍ", "um", -5.5), ("5 Pa·s", "Pa s", 5e6),
    ("5 kg·m⁻³", "kg/m^3", 5.0), ("5 ㎛", "um", 5.0), ("10 Å", "nm", 0.001), ("1e−3 m", "um", 1000.0),
    ("5 um\ufeff", "um", 5.0), ("2 um^2", "um^2", 2.0), ("3 mmHg", "Pa", 399.967162245), ("2 min", "us", 1.2e8)])
def test_quantities_are_read_in_the_characters_that_people_and_programs_write(text: str, unit: str,
                                                                             value: float) -> None:
    assert units.number(text, unit) == pytest.approx(value, rel=1e-9)


@pytest.mark.parametrize(("text", "unit", "message"), [
    ("7 kT", "pN um", "'kT' is no unit of energy here: 1 k_B T is 4.1 pN nm at 25 °C"),
    ("5 px", "um", "'px' is no length: say how large a pixel is"), ("5 pixels", "um", "'pixels' is no length"),
    ("5 Mm", "um", "did you mean 'mM' or 'mm'"), ("5 PN", "pN", "did you mean 'pN'"),
    ("5 Ms", "us", "did you mean 'ms'"),
    ("5 MPA", "Pa", "did you mean 'MPa' or 'mPa'"), ("5 c", "um/us", "'c' is not a unit"),
    ("5 kt", "um/us", "'kt' is not a unit"), ("5 ma", "us", "'ma' is not a unit"), ("5 pt", "um", "'pt' is not"),
    ("5 point", "um", "'point' is not a unit"), ("5 a", "us", "'a' is not a unit"), ("5 um2", "um^2", "is not a unit"),
    ("½ um", "um", "is not a number"), ("5² um", "um", "is not a unit"), ("1₂ um", "um", "not a"),
    ("1,5 um", "um", "is not a unit"),
    ("5 percent", "rad", "is not a unit"), ("5 degC", "us", "is not a unit"), ("5 pi um", "um", "is not a unit")])
def test_units_that_mean_something_else_than_they_seem_are_refused(text: str, unit: str, message: str) -> None:
    with pytest.raises(units.UnitError) as error:
        units.number(text, unit)
    assert message in str(error.value)


def test_all_units_that_are_listed_are_known_to_the_library() -> None:
    assert {"um", "pN", "Pa"} <= set(units._known())
    for name in units._known():
        assert units._scale(name)[0] > 0.0


def test_greek_letters_are_read_in_files_changes_and_formulas(written: Callable[..., Path]) -> None:
    path = written(SOUND.replace('end = "4 us"', 'end = "4 μs"'))
    for sets, end in (((), 4.0), (("time.end=6 μs",), 6.0), (('time.end="7\u00a0µs"',), 7.0)):
        assert load(path, sets).time.end == end
    found = load(path, ('cells.0.velocity=["0.1·x μm/μs","2−x² μm·μs⁻¹"]',))
    X = np.array([[0.5, 0.0], [2.0, 1.0]])
    assert [v(X).tolist() for v in found.cells[0].velocity] == [[0.05, 0.2], [1.75, -2.0]]


# --------------------------------------------------------------------------------------------- extends and sets


def test_a_case_is_laid_over_the_one_that_it_extends(written: Callable[..., Path], tmp_path: Path) -> None:
    (tmp_path / "base").mkdir()
    written(SOUND, "base/sound.toml")
    written('extends = "sound.toml"\n[time]\nend = "8 us"\n', "base/middle.toml")
    case = load(written('extends = "base/middle.toml"\n[materials.gel]\neta = "3 pN"\n'))
    base = load(tmp_path / "base/sound.toml")
    assert (case.time.end, case.time.frames, case.materials["gel"].eta) == (8.0, 2, 3.0)
    assert case.cells == base.cells and case.title == "Two cells" and case.path.endswith("case.toml")


def test_a_list_of_cells_replaces_the_one_that_is_extended(written: Callable[..., Path]) -> None:
    written(SOUND, "sound.toml")
    case = load(written('extends = "sound.toml"\n[[cells]]\nname = "Left"\nshape = "disc"\nradius = "2 um"\n'
                        'material = "gel"\ncentre = ["0 um", "2.01 um"]\n'))
    assert [cell.shape.radius for cell in case.cells] == [2.0]


def test_a_table_that_names_another_law_replaces_the_one_that_is_extended(written: Callable[..., Path]) -> None:
    written(SOUND + '[director]\nlaw = "relaxing"\nmobility = "2 um^2/us"\n', "sound.toml")
    assert load(written('extends = "sound.toml"\n[director]\nlaw = "frozen"\n')).director.law == "frozen"
    assert load(written('extends = "sound.toml"\n[director]\nlaw = "relaxing"\n')).director.mobility == 2.0


def test_a_long_chain_of_cases_is_followed_to_its_end(written: Callable[..., Path]) -> None:
    written(SOUND, "0.toml")
    for n in range(1, 1200):  # more than Python's depth of calls
        written(f'extends = "{n - 1}.toml"\nseed = {n}\n', f"{n}.toml")
    assert load(written('extends = "1199.toml"')).seed == 1199


def test_a_setting_from_outside_wins_over_the_files(written: Callable[..., Path]) -> None:
    case = load(written(SOUND), ("time.end=40 us", "seed = 7", "particles.dilation=2.5", "cells.0.radius=4.9 um",
                                 "cells.Right.centre=['11 um', '6 um']", 'protrusion.cells=["Right"]',
                                 "protrusion.random=false", "director.law=relaxing", "time.end=41 us"))
    assert (case.time.end, case.seed, case.particles.dilation) == (41.0, 7, 2.5)
    assert case.cells[0].shape.radius == 4.9 and case.cells[1].centre == (11.0, 6.0)
    assert case.protrusion.cells == ("Right",) and case.protrusion.random is False
    assert case.director.law == "relaxing"


@pytest.mark.parametrize("setting, part", [
    ("time.ennd=4 us", "time.ennd: no such key; did you mean 'end'?"),
    ("time.end=4", 'time.end: has no unit: write "4 us" if that is meant'),
    ("time.end", "expects key=value"),
    ("=3", "expects key=value"),
    ("extends=other.toml", "belongs in a file"),
    ("title.x=3", "title.x: is not in a table"),
    ("cells.Lft.radius=3 um", "cells.Lft.radius: no such item; did you mean 'Left'?"),
    ("cells.9.radius=3 um", "no such item"),
    ("cells=3", "cells: is a list of tables"),
    ("tim.end=4 us", "tim: no such section; did you mean 'time'?"),
    ("cortex.law=line-tension", "cortex.line_tension: missing"),
])
def test_a_mistake_in_a_setting_names_the_setting(written: Callable[..., Path], setting: str, part: str) -> None:
    found = messages(written(SOUND), (setting,))
    assert len(found) == 1 and found[0].startswith(f"--set {setting}: ") and part in found[0]


def test_a_mistake_in_an_extended_file_names_that_file_and_line(written: Callable[..., Path]) -> None:
    written(SOUND.replace("bulk_viscosity", "bulk_viscosty"), "sound.toml")
    found = messages(written('extends = "sound.toml"\n[time]\nend = "1 kg"\n'))
    line = line_of(SOUND, "bulk_viscosity")
    assert found == ["case.toml:3: time.end: '1 kg' has the wrong dimension; expected a quantity such as '1 us'",
                     f"sound.toml:{line}: numerics.bulk_viscosty: no such key; did you mean 'bulk_viscosity'?"]


def test_cases_that_extend_each_other_are_a_mistake(written: Callable[..., Path]) -> None:
    written('extends = "case.toml"', "other.toml")
    found = messages(written('extends = "other.toml"'))
    assert len(found) == 1 and found[0].startswith("other.toml:1: extends: ") and "circle" in found[0]


@pytest.mark.parametrize("value, part", [
    ('"soun.toml"', "no such file; did you mean 'sound.toml'?"),
    ('"."', "is a directory"),
    ('"a\\u0000b"', "expects the path of a case file"),
    ("3", "expects the path of a case file, not 3"),
])
def test_an_extended_file_that_is_not_there_is_told_where_it_is_named(written: Callable[..., Path], value: str,
                                                                       part: str) -> None:
    written(SOUND, "sound.toml")
    found = messages(written(f'title = "t"\nextends = {value}\n[tiem]\n'))
    assert found[0].startswith("case.toml:2: extends: ") and part in found[0]
    assert found[1:] == ["case.toml:3: tiem: no such section; did you mean 'time'?"], "nothing is told to be missing"


# ------------------------------------------------------------------------------------------------ what is wrong

BROKEN = [  # what is replaced, by what, part of the message
    ("seed = 1", "sead = 1", "sead: no such key; did you mean 'seed'?"),
    ("seed = 1", "SEED = 1", "SEED: no such key; did you mean 'seed'?"),
    ("seed = 1", "seed = -1", "seed: must be >= 0"),
    ("seed = 1", "seed = true", "seed: expects a whole number"),
    ("seed = 1", "seed = 1e3", "seed: expects a whole number"),
    ("title = \"Two cells\"", "title = 3", "title: expects text in quotes, not 3"),
    ("[numerics]", "[numerisc]", "numerisc: no such section; did you mean 'numerics'?"),
    ("[numerics]", "[adhesion.cell]", "adhesion.cell: no such section; did you mean 'cells'?"),
    ("[numerics]", "[[time2]]", "time2: no such key"),
    ("[numerics]\nbulk_viscosity = 0.2", "[body_force]", "body_force.acceleration: missing"),
    ("[numerics]\nbulk_viscosity = 0.2", "[director]", "director.law: missing: one of 'frozen', 'relaxing'"),
    ("end = \"4 us\"", "ennd = \"4 us\"", "time.ennd: no such key; did you mean 'end'?"),
    ("end = \"4 us\"", "", "time.end: missing: time at which the run ends, such as end = \"1 us\""),
    ("end = \"4 us\"", "end = 4", 'time.end: has no unit: write "4 us" if that is meant'),
    ("end = \"4 us\"", "end = \"4\"", "time.end: '4' has no unit; expected one such as 'us'"),
    ("end = \"4 us\"", "end = \"4 uss\"", "time.end: 'uss' is not a unit; expected one such as 'us'"),
    ("end = \"4 us\"", "end = \"4 um\"", "time.end: '4 um' has the wrong dimension"),
    ("end = \"4 us\"", "end = \"soon\"", "time.end: 'soon' is not a number with a unit, such as '1 us'"),
    ("end = \"4 us\"", "end = \"nan us\"", "time.end: 'nan us' is not a number"),
    ("end = \"4 us\"", "end = \"1e999 us\"", "time.end: '1e999 us' is not a finite number"),
    ("end = \"4 us\"", "end = \"-4 us\"", "time.end: must be > 0 us, not -4 us"),
    ("end = \"4 us\"", "end = [\"4 us\"]", "time.end: expects a number with a unit, such as \"1 us\", not ['4 us']"),
    ("end = \"4 us\"", "end = 2020-01-01", "time.end: expects a number with a unit"),
    ("end = \"4 us\"", "end = true", "time.end: expects a number with a unit"),
    ("frames = 2", "frames = 2.5", "time.frames: expects a whole number such as 1, not 2.5"),
    ("frames = 2", "frames = 0", "time.frames: must be >= 1"),
    ("frames = 2", "frames = 2000000", "time.frames: must be >= 1 and <= 1000000, not 2000000"),
    ("frames = 2", "samples = 2000000", "time.samples: must be >= 1 and <= 1000000"),
    ("step = \"auto\"", "step = \"fast\"", "time.step: 'fast' is not a number with a unit, such as '1 us' or 'auto'"),
    ("step = \"auto\"", "step = \"0 us\"", "time.step: must be > 0 us"),
    ("step = \"auto\"", "step_factor = 1.5", "time.step_factor: must be > 0 and <= 1, not 1.5"),
    ("step = \"auto\"", "step_factor = \"0.5\"", "time.step_factor: expects a pure number such as 1.5"),
    ("step = \"auto\"", "integrator = \"leapforg\"", "cannot be 'leapforg'; did you mean 'leapfrog'?"),
    ("per_cell = 91", "", "particles: give either per_cell or spacing, such as per_cell"),
    ("per_cell = 91", "spacing = \"1 um\"\nper_cell = 91", "particles.spacing: give either per_cell or spacing, not"),
    ("per_cell = 91", "per_cell = 6", "particles.per_cell: must be >= 7"),
    ("per_cell = 91", "per_cell = 1000000000", "particles.per_cell: must be >= 7 and <= 100000000"),
    ("per_cell = 91", "spacing = \"9 um\"", "particles.spacing: leaves 'Left' with 1 particles; at least 7"),
    ("per_cell = 91", "spacing = \"0.00001 um\"", "particles.spacing: makes 1.6e+12 particles"),
    ("per_cell = 91", "per_cell = 91\ndilation = 1", "particles.dilation: must be >= 1.2"),
    ("per_cell = 91", "per_cell = 91\ndilation = nan", "particles.dilation: expects a number of a size"),
    ("per_cell = 91", "per_cell = 91\ndilation = inf", "particles.dilation: expects a number of a size"),
    ("law = \"nematic\"", "law = \"nemtic\"", "materials.gel.law: no material law 'nemtic'; did you mean 'nematic'?"),
    ("law = \"nematic\"", "law = 3", f"materials.gel.law: no material law 3; there is {MATERIALS}"),
    ("law = \"nematic\"", "", f"materials.gel.law: missing: one of {MATERIALS}"),
    ("viscosity = \"1 mPa s\"", "viscosty = \"1 mPa s\"", "viscosty: no such key; did you mean 'viscosity'?"),
    ("viscosity = \"1 mPa s\"", "", "materials.gel.viscosity: missing: shear viscosity"),
    ("viscosity = \"1 mPa s\"", "viscosity = \"1 mPa\"", "viscosity: '1 mPa' has the wrong dimension"),
    ("2.2 GPa", "2.2 MPa", "materials.gel.reduced_bulk_modulus: 5000000 Pa is above bulk_modulus = 2200000 Pa"),
    ("equilibrium_distance = \"10 nm\"", "equilibrium_distance = \"2 um\"",
     "adhesion.substrate.equilibrium_distance: 2 um is above cutoff = 1 um"),
    ("law = \"seifert\"", "law = \"siefert\"", "no adhesion law 'siefert'; did you mean 'seifert'?"),
    ("C1 =", "c1 =", "materials.core.c1: no such key; did you mean 'C1'?"),
    ("name = \"Right\"", "name = \"Left\"", "cells.1.name: two cells are called 'Left': this one and cells.0"),
    ("name = \"Right\"", "name = \" \"", "cells.1.name: a name has printable characters"),
    ("name = \"Right\"", "name = \"all\"", "cells.1.name: 'all' is the aggregate of all cells"),
    ("name = \"Right\"", "", "cells.1.name: missing"),
    ("shape = \"disc\"", "shape = \"disk\"", "cells.0.shape: no shape 'disk'; did you mean 'disc'?"),
    ("shape = \"disc\"", "", "cells.0.shape: missing: one of 'disc'"),
    ("radius = \"5 um\"", "radus = \"5 um\"", "cells.0.radus: no such key; did you mean 'radius'?"),
    ("radius = \"5 um\"", "radius = \"5 um\"\nwidth = \"5 um\"",
     "cells.0.width: no such key of shape 'disc', but of 'rectangle', 'segment'; 'disc' has 'radius', 'nucleus_ratio'"),
    ("radius = \"5 um\"", "radius = \"5 um\"\nc = \"5 um\"",
     "cells.0.c: no such key of shape 'disc', but of 'box', 'ellipsoid' in 3 dimensions; 'disc' has"),
    ("C1 =", "viscosity = \"1 Pa s\"\nC1 =", "materials.core.viscosity: no such key of material 'mooney-rivlin', but"),
    ("nucleus_ratio = 0.283", "nucleus_ratio = 1", "cells.0.nucleus_ratio: must be > 0"),
    ("nucleus_ratio = 0.283", "", "cells.0.nucleus: a nucleus has a size, too: nucleus_ratio is missing"),
    ("nucleus = \"core\"", "", "cells.0.nucleus_ratio: a nucleus has a material, too"),
    ("nucleus = \"core\"", "nucleus = \"cor\"", "cells.0.nucleus: no material 'cor'; did you mean 'core'?"),
    ("material = \"gel\"", "material = \"jelly\"", "cells.0.material: no material 'jelly'; there is 'gel', 'core'"),
    ("centre = [\"10.01 um\", \"5.01 um\"]", "centre = [\"10.01 um\"]",
     "cells.1.centre: expects a list such as [\"1 um\", \"1 um\"], not ['10.01 um']"),
    ("centre = [\"10.01 um\", \"5.01 um\"]", "centre = [10.01, 5.01]", "cells.1.centre: has no unit"),
    ("centre = [\"10.01 um\", \"5.01 um\"]", "centre = [\"9.9 um\", \"5.01 um\"]",
     "cells.1.centre: 'Right' overlaps 'Left' by 0.1 um"),
    ("centre = [\"10.01 um\", \"5.01 um\"]", "centre = [\"0 um\", \"5.01 um\"]", "'Right' overlaps 'Left'"),
    ("centre = [\"10.01 um\", \"5.01 um\"]", "centre = [\"10.01 um\", \"4.99 um\"]",
     "cells.1.centre: 'Right' reaches 0.01 um below the substrate y = 0"),
    ("name = \"Right\"", "name = \"Right\"\nrepeat = [2, 2]\npitch = [[\"11 um\", \"0 um\"]]",
     "cells.1.pitch: expects a vector for each direction of repeat: 2"),
    ("name = \"Right\"", "name = \"Right\"\nrepeat = [0]", "cells.1.repeat: must be >= 1"),
    ("name = \"Right\"", "name = \"Right\"\nrepeat = 3", "cells.1.repeat: expects a list such as [1], not 3"),
    ("name = \"Right\"", "name = \"Right\"\nrepeat = [1000000]\npitch = [[\"11 um\", \"0 um\"]]",
     "cells: are more than 100000"),
    ("name = \"Right\"", "name = \"Right\"\nrepeat = [3]\npitch = [[\"9 um\", \"0 um\"]]",
     "'Right-2' overlaps 'Right-1' by 1 um"),
    ("cells = [\"Left\"]", "cells = [\"Left\", \"Rigth\"]", "protrusion.cells: no cell 'Rigth'; did you mean 'Right'?"),
    ("cells = [\"Left\"]", "cells = \"Left\"", "protrusion.cells: expects a list such as [\"Cell-1\"], not 'Left'"),
    ("cells = [\"Left\"]", "cells = [1]", "protrusion.cells: expects text in quotes, not 1"),
    ("cells = [\"Left\"]", "cells = [\"Left\"]\nrandom = 1", "protrusion.random: expects true or false, not 1"),
]


@pytest.mark.parametrize("old, new, part", BROKEN, ids=lambda text: str(text)[:40])
def test_a_mistake_is_told_with_its_file_and_line(written: Callable[..., Path], old: str, new: str, part: str) -> None:
    text = SOUND.replace(old, new, 1)
    assert text != SOUND
    told = [message for message in messages(written(text)) if part in message]
    assert len(told) == 1
    file, line, key, what = told[0].split(":", 3)
    at, key = text.split("\n")[int(line) - 1], key.strip()
    header = at.strip("[]")
    assert file == "case.toml"
    assert at.startswith(f"{key.split('.')[-1]} = ") or header == key or ("missing" in what and key.startswith(header))


def test_a_dimension_as_text_is_told_once_and_shapes_are_those_that_are_meant() -> None:
    with pytest.raises(CaseError) as error:
        load(CASES["ball"], ['dimension="3"'])
    (mistake,) = error.value.mistakes
    assert "dimension: expects a whole number" in str(mistake)


@pytest.mark.parametrize(("sets", "name"), [
    ("cells.1.radius=-1 um", "Right"), ("cells.Right.colour=3", "Right"), ("cells.0.radius=-1 um", "Left"),
    ('loads=[{name="sun", pressure="1 um"}]', "sun"), ('supports=[{name="a"}, {name="b", parts=["c"]}]', "b")])
def test_a_mistake_in_a_list_of_tables_is_told_with_the_name_of_the_table(written: Callable[..., Path], sets: str,
                                                                          name: str) -> None:
    with pytest.raises(CaseError) as error:
        load(written(SOUND), (sets,))
    assert f"'{name}'" in str(error.value).splitlines()[-1]


OUTSIDE = """
[[supports]]
name = "hold"
load_curve = { law = "ramp", duration = "1 us" }
[[loads]]
name = "blow"
pressure = "1 Pa"
load_curve = { law = "constant" }
[[plates]]
name = "floor"
point = ["0 um", "-1 um"]
normal = [0, 1]
load_curve = { law = "constant" }
"""
CLASSES = [*(cls for kind in registry.kinds() for cls in registry.laws(kind).values()), Support, Load, Plate]
RENAMED = [(cls, name, f.metadata["formerly"]) for cls in CLASSES for name, f in declared(cls).items()
           if f.metadata.get("formerly")]


@pytest.mark.parametrize(("cls", "new", "old"), RENAMED, ids=lambda part: part if isinstance(part, str) else "")
def test_a_former_key_is_told_with_the_present_one_and_its_line(written: Callable[..., Path], cls: type, new: str,
                                                                old: str) -> None:
    assert new in declared(cls) and old not in declared(cls)
    text = SOUND + 'protrusion_ratio = 0.06\ncorrelation_length = "0.4 um"\n' + OUTSIDE
    text = text.replace("[numerics]\nbulk_viscosity = 0.2\nprotrusion_ratio", "protrusion_ratio")
    text = text.replace('"170 kPa"\n', '"170 kPa"\nhourglass_modulus = 0.5\n')
    lines = [number for number, line in enumerate(text.split("\n"), 1) if line.startswith(f"{new} = ")]
    told = messages(written(text.replace(f"\n{new} = ", f"\n{old} = ")))
    assert [message.split(": ")[0] for message in told] == [f"case.toml:{line}" for line in lines] != []
    assert all(f".{old}: is called '{new}' now" in message for message in told)


def test_a_former_key_in_an_option_or_a_change_is_told_with_the_present_one(written: Callable[..., Path]) -> None:
    option = 'adhesion.substrate.bonds="1 /um^2"'
    told = "adhesion.substrate.bonds: is called 'bond_density' now"
    assert messages(written(SOUND), (option,)) == [f"--set {option}: {told}"]
    with pytest.raises(CaseError, match=f"change: {told}"):
        change(load(written(SOUND)), {"adhesion.substrate.bonds": "1 /um^2"})


def test_the_case_of_an_older_run_is_read_under_the_present_keys(written: Callable[..., Path]) -> None:
    case = load(written(SOUND))
    text = json.dumps(case.resolved())
    former = {new: old for _, new, old in RENAMED if new != "load_curve"}
    assert all(f'"{new}": ' in text for new in former)
    for new, old in former.items():
        text = text.replace(f'"{new}": ', f'"{old}": ')
    assert from_dict(json.loads(text), older=True).resolved() == case.resolved()
    with pytest.raises(CaseError, match="is called"):
        from_dict(json.loads(text))


@pytest.mark.parametrize("text, part", [
    ("title = \n", "case.toml:1: not TOML: Invalid value"),
    (SOUND + "[time]\n", f"case.toml:{SOUND.count(chr(10)) + 1}: not TOML: Cannot declare ('time',) twice"),
    ("a = 1\nb = [1,\n", "not TOML:"),
    ("a = 1\n\xff".encode("latin-1"), "case.toml:2: is not UTF-8 text"),
    (b"\x00\x01\x02", "case.toml:1: not TOML"),
    ("a = " + "[" * 5000 + "]" * 5000, "case.toml: is nested too deeply"),
    ("a = " + "9" * 5000, "case.toml: cannot be read"),
    ("# " + "x" * (64 << 20), "case.toml: is larger than 64 MiB"),
    ("a" + ".a" * 3000 + " = 1", "a: no such section"),
    ("seed = 0x" + "f" * 9000, "case.toml:1: seed: must be >= 0"),
    ("", "time.end: missing"),
    ("cells = 3", "cells: is a list of tables: write [[cells]]"),
    ("cells = [3]", "case.toml:1: cells.0: expects a table, not 3"),
    ("time = 3", "case.toml:1: time: expects a table, not 3"),
    ("adhesion = 3", "case.toml:1: adhesion: is a section: [adhesion], not 3"),
    ("materials = 3", "case.toml:1: materials: holds tables such as [materials.cytoplasm], not 3"),
    ("materials.a = 3", "case.toml:1: materials.a: expects a table, not 3"),
    ("protrusion = 3", "case.toml:1: protrusion: expects a table, not 3"),
], ids=lambda text: ascii(text)[:30])
def test_no_content_of_a_file_gives_more_than_a_message(written: Callable[..., Path], text: str | bytes,
                                                       part: str) -> None:
    assert any(part in message for message in messages(written(text)))


@pytest.mark.parametrize(("file", "part"), [("/dev/zero", "is no file"), (".", "is no file"),
                                            ("large.csv", "too large"),
                                            ("absent.csv", "cannot be read"), ("nul\\u0000", "cannot be read")])
def test_an_outline_that_is_no_file_or_never_ends_is_refused(written: Callable[..., Path], file: str,
                                                             part: str) -> None:
    path = written(SOUND + f'[[cells]]\nname = "P"\nshape = "polygon"\ncorners = "{file}"\n')
    with open(path.with_name("large.csv"), "w") as large:
        large.truncate(11_000_000)
    assert any("cells.2.corners" in message and part in message for message in messages(path))


def test_windows_line_ends_and_byte_order_mark_are_read_as_well(written: Callable[..., Path]) -> None:
    windows = b"\xef\xbb\xbf" + SOUND.replace("\n", "\r\n").encode()
    assert load(written(windows)) == load(written(SOUND, "unix.toml"))


def test_ten_thousand_cells_are_checked_for_overlap_in_a_moment(written: Callable[..., Path]) -> None:
    grid = 'name = "R"\nrepeat = [100, 100]\npitch = [["10.01 um", "0 um"], ["5 um", "8.67 um"]]'
    assert len(load(written(SOUND.replace('name = "Right"', grid))).cells) == 10001

    found = messages(written(SOUND.replace('name = "Right"', grid.replace("8.67", "8.6"))))
    assert len(found) == 1 and "'R-101' overlaps 'R-1' by" in found[0]


@pytest.mark.parametrize("count", [7000, pytest.param(100_000, marks=pytest.mark.slow)])
def test_thousands_of_cells_that_are_given_one_by_one_are_read(written: Callable[..., Path], count: int) -> None:
    """In proportion to their number, 20 s for 100,000: nothing looks at every pair of them."""
    side, at = 1 + int(count**0.5), SOUND.index("[[cells]]")
    cells = "".join(f'[[cells]]  # one of very many that a program wrote\nname = "Disc {k}"\nshape = "disc"\n'
                    f'radius = "5 um"\nnucleus_ratio = 0.283\nmaterial = "gel"\nnucleus = "core"\n'
                    f'centre = ["{11 * (k % side)} um", "{5 + 11 * (k // side)} um"]\n' for k in range(count))
    path = written(SOUND[:at] + cells)
    assert path.stat().st_size > 1 << 20
    assert [cell.name for cell in load(path).cells[::count - 1]] == ["Disc 0", f"Disc {count - 1}"]


def test_a_file_that_cannot_be_read_is_a_mistake(tmp_path: Path, written: Callable[..., Path]) -> None:
    written(SOUND, "sound.toml")
    assert messages(tmp_path / "soud.toml") == ["soud.toml: no such file; did you mean 'sound.toml'?"]
    (tmp_path / "folder.toml").mkdir()
    assert messages(tmp_path / "folder.toml") == ["folder.toml: is a directory, not a case file"]


def test_all_mistakes_come_at_once_and_in_the_order_of_their_lines(written: Callable[..., Path]) -> None:
    edits = [("seed = 1", "sed = 1"), ("\"4 us\"", "4"), ("per_cell = 91", "per_cell = 3"), ("nematic", "newtonian"),
             ("\"disc\"", "\"disk\""), ("radius = \"5 um\"\nmaterial", "radius = \"0 um\"\nmaterial"),
             ("seifert", "lennard"), ("[\"Left\"]", "[\"left\"]"), ("_viscosity = 0.2", "_viscosity = -1")]
    text = SOUND
    for old, new in edits:
        text = text.replace(old, new, 1)
    found = messages(written(text), ("time.frames=many",))
    lines = [int(message.split(":")[1]) for message in found[:-1]]
    assert lines == sorted(lines)
    assert lines == [line_of(text, new.split("\n")[0]) for _, new in edits]
    assert found[-1].startswith("--set time.frames=many: ")


def test_the_error_of_a_case_survives_its_way_to_other_ranks(written: Callable[..., Path]) -> None:
    with pytest.raises(ValueError) as caught:
        load(written("seed = -1"))
    again = pickle.loads(pickle.dumps(caught.value))
    assert isinstance(again, CaseError) and again.mistakes == caught.value.mistakes and str(again) == str(caught.value)


def test_the_nearest_name_does_not_mind_capitals() -> None:
    assert nearest("K", ["k", "mu"]) == "k" and nearest("Cell-l", ["Cell-1", "Nucleus"]) == "Cell-1"
    assert nearest("zzz", ["k", "mu"]) is None


# ------------------------------------------------------------------------------------------------- lines, schema


def test_every_key_of_a_file_has_its_line() -> None:
    text = ('# [no]\na."b c".d = 1 # e = 2\ns = """\n[no]\nx = 1 \\""" y\n"""\nl = \'\'\'\n[[no]]\n\'\'\'\n'
            'm = [ # ]\n  1, [2, "]"],\n  {q = 1, r = [3]},\n]\n[[t]]\nx = 1\n[t.u]\ny = 2\n[[t.v]]\nz = 1\n[[t]]\n'
            '[[t.v]]\n[[t.v]]\n\'z z\' = 1979-05-27T07:32:00Z\n["q.r" . s]\ne = """a"""""\nf = {}\ng = []\n')

    def paths(value: object, path: tuple = ()) -> set[tuple]:
        items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        return {path}.union(*(paths(item, (*path, key)) for key, item in items))

    found = key_lines(text)
    assert set(found) == paths(tomllib.loads(text))
    at = {path: text.split("\n")[line - 1] for path, line in found.items()}
    assert at[("a", "b c", "d")].startswith("a.") and at[("m", 2, "r")].startswith("  {q")
    assert at[("t", 1, "v", 1, "z z")].startswith("'z z'") and at[("q.r", "s", "e")].startswith("e =")
    assert found[("t", 0)] == line_of(text, "[[t]]") and found[("t", 1)] == line_of(text, "[[t]]\n[[t.v]]")


def test_the_schema_lists_every_law_with_its_units_and_bounds() -> None:
    schema = json.loads(json.dumps(json_schema()))
    properties = schema["properties"]
    assert set(properties) == {"extends", "title", "dimension", "seed", "time", "particles", "materials", "cells",
                               "colony", "adhesion", "protrusion", "polarity", "cortex", "friction", "medium", "fields",
                               "substrate", "director", "body_force", "supports", "loads", "plates", "probes",
                               "cues", "exchange", "numerics"}
    options = properties["materials"]["additionalProperties"]["anyOf"]
    assert {option["properties"]["law"]["const"] for option in options} == set(registry.laws("material"))
    radius = properties["cells"]["items"]["anyOf"][0]["properties"]["radius"]
    assert radius["type"] == "string" and "[um]" in radius["description"] and "> 0 um" in radius["description"]
    assert properties["time"]["properties"]["step_factor"] == {
        "type": "number", "exclusiveMinimum": 0, "maximum": 1, "default": 0.8,
        "description": "fraction of the largest stable step for \"auto\" [-], > 0 and <= 1; default: 0.8"}


def test_a_new_law_reaches_case_file_schema_and_messages_by_its_declaration(written: Callable[..., Path],
                                                                            monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_LAWS", {kind: dict(known) for kind, known in registry._LAWS.items()})

    @registry.law("material", "jelly")
    class Jelly:
        """A law that only this test knows."""

        stiffness: float = registry.quantity("kPa", "stiffness", above=1)

    text = SOUND.replace("[numerics]", '[materials.new]\nlaw = "jelly"\nstiffness = "2 kPa"\n[numerics]')
    case: Case = load(written(text))
    assert case.materials["new"] == Jelly(stiffness=2000.0)
    assert case.resolved()["materials"]["new"] == {"law": "jelly", "stiffness": "2 kPa"}
    assert "must be > 1 kPa, not 0.5 kPa" in messages(written(text.replace("2 kPa", "0.5 kPa")))[0]
    assert '"jelly"' in json.dumps(json_schema())


ROW = 'name = "R"\nrepeat = [3]\npitch = [["11 um", "0 um"]]'
OTHER = '\n[cells.R-2]\nradius = "4 um"\ncentre = ["21.01 um", "4.01 um"]\n[cells.R-3]\nmaterial = "core"\n'


def repeated(more: str = OTHER) -> str:
    """SOUND with the second cell thrice, and what differs in some."""
    head, tail = SOUND.split('name = "Right"')
    cell, rest = tail.split("[adhesion", 1)
    return f"{head}{ROW}{cell}{more}[adhesion{rest}"


def test_a_copy_of_a_repeated_cell_differs_in_what_its_own_table_says(written: Callable[..., Path]) -> None:
    cells = {cell.name: cell for cell in load(written(repeated())).cells}
    assert list(cells) == ["Left", "R-1", "R-2", "R-3"]
    assert [c.shape.radius for c in cells.values()] == [5.0, 5.0, 4.0, 5.0]
    assert [c.material for c in cells.values()] == ["gel", "gel", "gel", "core"]
    assert [c.centre for c in cells.values()] == [(0.0, 5.01), (10.01, 5.01), (21.01, 4.01), (32.01, 5.01)]
    case = load(written(repeated()))
    assert from_dict(case.resolved()).cells == case.cells


def test_a_copy_is_changed_on_the_command_line_by_its_name(written: Callable[..., Path]) -> None:
    changed = load(written(repeated("")), ["cells.R-2.radius=4 um", 'cells.R-2.centre=["21.01 um", "4.01 um"]',
                                           "cells.R-3.material=core"])
    assert changed.cells == load(written(repeated())).cells
    low = load(written(repeated("")), ["cells.R-2.radius=4 um", "cells.R-2.rest=true"]).cells
    assert [c.centre for c in low] == [(0.0, 5.01), (10.01, 5.01), (21.01, 4.01), (32.01, 5.01)]
    all_low = load(written(repeated("")), ["cells.1.rest=true", "cells.R-3.radius=3 um"]).cells
    assert [c.centre[1] for c in all_low] == [5.01, 5.01, 5.01, 3.01]


@pytest.mark.parametrize(("more", "sets", "part"), [
    ('[cells.R-4]\nradius = "4 um"\n', [], "cells.1.R-4: no such copy; did you mean 'R-3'?"),
    ('[cells.R-2]\nradus = "4 um"\n', [], "cells.1.R-2.radus: no such key; did you mean 'radius'?"),
    ('[cells.R-2]\nradius = "4 s"\n', [], "cells.1.R-2.radius: "),
    ('[cells.R-2]\nrepeat = [2]\n', [], "cells.1.R-2.repeat: is that of all copies"),
    ('[cells.R-2]\nradius = "6 um"\n', [], "cells.1.R-2.centre: 'R-2' reaches 0.99 um below the substrate"),
    ("", ["cells.R-9.radius=4 um"], "cells.R-9.radius: no such item; did you mean 'R-3'?"),
    ("", ["cells.R-2.radus=4 um"], "cells.1.R-2.radus: no such key; did you mean 'radius'?"),
])
def test_a_mistake_about_a_copy_is_told_with_its_name(written: Callable[..., Path], more: str, sets: list,
                                                       part: str) -> None:
    with pytest.raises(CaseError) as error:
        load(written(repeated(more)), sets)
    told = [str(m) for m in error.value.mistakes if part in str(m)]
    assert len(told) == 1, str(error.value)
    text = repeated(more).split("\n")
    if not sets:
        line = int(told[0].split(":")[1])
        assert text[line - 1].split(" ")[0] in (part.split(":")[0].split(".")[-1], "[cells.R-2]", "[cells.R-4]")
