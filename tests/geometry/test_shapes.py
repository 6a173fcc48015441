"""Every shape: particles as asked for, a closed outline, volumes that fill it, and gradients exact to its edge."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scenes import CASES, built, case, example

from cellmig.case.load import from_dict, load
from cellmig.case.messages import CaseError
from cellmig.case.registry import laws
from cellmig.geometry import polygons
from cellmig.geometry.mesh_file import Boundary
from cellmig.meshfree import rkpm
from cellmig.meshfree.body import Template, template
from cellmig.solve.start import discretise

STAR = [(r * np.cos(a), r * np.sin(a)) for a, r in zip(np.arange(10) * np.pi / 5, [5.0, 2.5] * 5, strict=True)]
T = np.linspace(0, 2 * np.pi, 300, endpoint=False)
WAVY = (5 + 0.5 * np.cos(4 * T[::6]))[:, None] * np.column_stack([np.cos(T[::6]), np.sin(T[::6])])
MESH = Boundary((tuple(map(tuple, WAVY.tolist())),), (("core", (tuple(map(tuple, (0.4 * WAVY + 0.5).tolist())),)),),
                (("left", tuple(range(13, 38))), ("right", (*range(13), *range(38, 50)))))
LOBES = (5 + 1.5 * np.cos(3 * T))[:, None] * np.column_stack([np.cos(T), np.sin(T)])
# name: (registered shape, its parameters, fewest particles that resolve it, least V/h² measured)
SHAPES = {
    "disc": ("disc", {"radius": 5.0, "nucleus_ratio": 0.3}, 30, 0.34),
    "ellipse": ("ellipse", {"a": 6.0, "b": 4.0, "nucleus_ratio": 0.3}, 19, 0.23),
    "thin ellipse": ("ellipse", {"a": 8.0, "b": 2.0, "nucleus_ratio": 0.3}, 19, 0.20),
    "square": ("polygon", {"corners": ((-4.0, -4.0), (4.0, -4.0), (4.0, 4.0), (-4.0, 4.0))}, 19, 0.17),
    "clockwise triangle": ("polygon", {"corners": ((-4.0, -4.0), (0.0, 4.0), (4.0, -4.0)), "nucleus_ratio": 0.4}, 19,
                           0.13),
    "L": ("polygon", {"corners": ((0.0, 0.0), (6.0, 0.0), (6.0, 2.0), (2.0, 2.0), (2.0, 6.0), (0.0, 6.0))}, 19, 0.17),
    "notch": ("polygon", {"corners": ((-5.0, -4.0), (5.0, -4.0), (5.0, 4.0), (0.6, 4.0), (0.0, -1.0), (-0.6, 4.0),
                                      (-5.0, 4.0))}, 40, 0.16),
    "star": ("polygon", {"corners": tuple(STAR), "nucleus_ratio": 0.3}, 60, 0.13),
    "rectangle": ("rectangle", {"width": 8.0, "height": 3.0, "nucleus_ratio": 0.3}, 19, 0.17),
    "spread cell": ("segment", {"width": 16.0, "height": 4.0, "nucleus_ratio": 0.3}, 19, 0.13),
    "high segment": ("segment", {"width": 6.0, "contact_angle": 2.0}, 19, 0.23),
    "plate with holes": ("rectangle", {"width": 8.0, "height": 6.0, "holes": ((-2.0, 0.5, 1.2), (2.0, 0.0, 1.0))}, 150,
                         0.13),
    "ring": ("ellipse", {"a": 4.0, "b": 4.0, "holes": ((0.0, 0.0, 2.0),)}, 60, 0.2),
    "frame": ("polygon", {"corners": ((-5.0, -4.0), (5.0, -4.0), (4.0, 4.0), (-4.0, 4.0)), "holes": ((2.0, 2.0, 1.0),),
                          "cutouts": (((-3.0, -2.5), (3.0, -2.5), (3.0, -1.0), (-1.5, -1.0), (-1.5, 2.5),
                                       (-3.0, 2.5)),)}, 331, 0.13),
    "mesh": ("mesh", {"file": MESH, "unit": 1.0, "nucleus_region": "core"}, 19, 0.2),
    "smooth outline": ("polygon", {"corners": tuple(map(tuple, LOBES.tolist())), "nucleus_ratio": 0.3}, 19, 0.20),
}
COUNTS = [19, 60, 150, 331, 1000]
every = pytest.mark.parametrize(("name", "count"), [(name, count) for name, (_, _, fewest, _) in SHAPES.items()
                                                    for count in COUNTS if count >= fewest])
pytestmark = pytest.mark.serial


@cache
def shape(name: str):
    kind, parameters, *_ = SHAPES[name]
    return laws("shape")[kind](**parameters)


@cache
def cell(name: str, count: int, refinement: float = 1.0) -> Template:
    gel, core = example("material", "nematic"), example("material", "mooney-rivlin")
    return template(shape(name), count, 2.2, (gel, core if shape(name).nucleus_ratio else None), 0.2, refinement)


def loops(t: Template) -> list[np.ndarray]:
    """Particles of each loop of a surface, from the segments alone."""
    follower, left, found = dict(t.facets.tolist()), set(t.surface.tolist()), []
    while left:
        at = next(int(i) for i in t.surface if i in left)
        loop = [at]
        while (at := follower[at]) != loop[0]:
            loop.append(at)
        left -= set(loop)
        found.append(np.array(loop))
    return found


def test_every_registered_shape_is_tested_here() -> None:
    """Those in space are in test_bodies.py."""
    flat = {name for name, cls in laws("shape").items() if cls.dimension == 2}
    assert {kind for kind, *_ in SHAPES.values()} == flat


@pytest.mark.parametrize("refinement", [2.0, 3.0])
@pytest.mark.parametrize("name", [name for name, (_, _, fewest, _) in SHAPES.items() if fewest <= 60])
def test_a_denser_surface_takes_its_particles_from_the_inside(name: str, refinement: float) -> None:
    def along(t: Template) -> float:
        """Spacing along the surface over that inside."""
        return t.facet_size.mean() / np.sqrt(t.V[np.setdiff1d(np.arange(331), t.surface)].mean())

    even, dense = cell(name, 331), cell(name, 331, refinement)
    assert len(dense.X) == 331
    assert along(even) / along(dense) == pytest.approx(refinement, rel=0.1)  # measured -4.2 to +9.1 %
    assert dense.V.sum() == pytest.approx(even.V.sum(), rel=0.002)  # measured 0.17 %: polygons for circles
    for g, slope in zip(dense.G, (1.0, 0.0), strict=True):
        assert np.abs(g @ dense.X[:, 0] - slope).max() < 1e-13  # measured 7e-15


@every
def test_a_shape_has_exactly_the_particles_asked_for(name: str, count: int) -> None:
    assert len(np.unique(cell(name, count).X.round(9), axis=0)) == count


@every
def test_surface_is_a_closed_counterclockwise_polygon_on_the_outline(name: str, count: int) -> None:
    t = cell(name, count)
    (ring, *inner), outline = [t.X[loop] for loop in loops(t)], shape(name).outline(4000)
    assert polygons.area(ring) > 0 and polygons.crossing(ring) is None
    assert polygons.distance(ring, outline).max() < 1e-3 * t.spacing
    assert all(polygons.area(hole) < 0 and polygons.crossing(hole) is None for hole in inner)
    for x, y, r in getattr(shape(name), "holes", ()):
        assert np.abs(np.hypot(*(inner.pop(0) - [x, y]).T) - r).max() < 1e-3 * t.spacing
    for corners in map(np.array, getattr(shape(name), "cutouts", ())):
        hole = inner.pop(0)
        assert polygons.distance(hole, corners).max() < 1e-9 and polygons.distance(corners, hole).max() < 1e-9
    assert not inner
    others, surface = np.setdiff1d(np.arange(count), t.surface), t.X[t.facets]
    assert polygons.inside(t.X[others], surface).all()
    assert polygons.distance(t.X[others], surface).min() > 0.25 * t.spacing


@every
def test_parts_of_a_surface_are_its_named_edges_and_make_all_of_it(name: str, count: int) -> None:
    t = cell(name, count)
    assert set(t.parts) == set(shape(name).parts)
    assert t.parts["surface"].tolist() == list(range(len(t.surface)))
    for kinds, whole in ((("outline", "hole"), "surface"), (("edge", "bottom", "right", "top", "left"), "outline")):
        named = [on for part, on in t.parts.items() if part.startswith(kinds)]
        assert not named or sorted(np.concatenate(named).tolist()) == t.parts[whole].tolist()


@pytest.mark.parametrize("clockwise", [False, True])
def test_an_edge_is_named_by_its_place_among_the_corners(clockwise: bool) -> None:
    corners = SHAPES["L"][1]["corners"][:: -1 if clockwise else 1]
    t = template(laws("shape")["polygon"](corners=corners), 331, 2.2, (example("material", "nematic"), None), 0.2)
    for n in range(6):
        ends = np.array([corners[n], corners[(n + 1) % 6]])
        on = t.X[t.facets[t.parts[f"edge-{n + 1}"]]]
        assert polygons.distance(on.reshape(-1, 2), ends).max() < 1e-12
        assert np.linalg.norm(on[:, 1] - on[:, 0], axis=1).sum() == pytest.approx(np.linalg.norm(ends[1] - ends[0]))


def test_edges_of_a_rectangle_are_where_their_names_say() -> None:
    t = cell("rectangle", 331)
    for part, axis, at in (("bottom", 1, -1.5), ("right", 0, 4.0), ("top", 1, 1.5), ("left", 0, -4.0)):
        ends = t.X[t.facets[t.parts[part]]]
        assert (ends[..., axis] == at).all()
        assert np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum() == pytest.approx(3.0 if axis == 0 else 8.0)


@every
def test_volumes_fill_the_outline_and_none_is_a_needle(name: str, count: int) -> None:
    t = cell(name, count)
    assert t.V.sum() == pytest.approx(polygons.area(t.X[t.facets]), rel=1e-12)  # measured 4e-16
    # polygons in curves, measured 0.8 / count, with holes 1.3
    assert t.V.sum() == pytest.approx(shape(name).area, rel=1.5 / count)
    assert t.V.min() > 0.95 * SHAPES[name][3] * t.spacing**2


@every
def test_lowest_point_and_outline_bound_the_particles(name: str, count: int) -> None:
    t, outline = cell(name, count), shape(name).outline(720)
    holes = sum(np.pi * r**2 for *_, r in getattr(shape(name), "holes", ()))
    holes += sum(abs(polygons.area(np.array(corners))) for corners in getattr(shape(name), "cutouts", ()))
    assert t.X[:, 1].min() >= shape(name).lowest() - 1e-9
    assert len(outline) >= 720 and polygons.area(outline) == pytest.approx(shape(name).area + holes, rel=1e-4)


@pytest.mark.parametrize("name", [n for n, s in SHAPES.items() if "nucleus_ratio" in s[1]])
def test_nucleus_has_its_share_of_the_area(name: str) -> None:
    t = cell(name, 1000)
    share = t.V[t.nucleus].sum() / t.V.sum()
    assert share == pytest.approx(shape(name).nucleus_ratio ** 2, rel=0.03)  # measured within 1.5 %
    assert not t.nucleus[t.surface].any()


@every
def test_gradients_of_linear_fields_are_exact(name: str, count: int) -> None:
    t = cell(name, count)
    for g, slope in zip(t.G, (0.7, -1.3), strict=True):
        assert np.abs(g @ (2.0 + t.X @ np.array([0.7, -1.3])) - slope).max() < 1e-12  # measured 3e-14


@every
def test_gradients_obey_the_divergence_theorem(name: str, count: int) -> None:
    t = cell(name, count)
    total, normal = np.column_stack([t.V @ g for g in t.G]), rkpm.surface_normals(t.X, t.facets)
    error = np.abs(total - normal).max()
    assert error < 1e-11 * np.abs(normal).max()  # measured 4e-13


def test_kernels_do_not_reach_across_a_hollow() -> None:
    t = cell("notch", 1000)
    side = np.where((t.X[:, 1] > 2.0), np.sign(t.X[:, 0]), 0.0)  # the notch parts the arms above y = -1
    rows = np.repeat(np.arange(1000), np.diff(t.G[0].indptr))
    near = np.linalg.norm(t.X[rows] - t.X[t.G[0].indices], axis=1)
    assert (side[rows] * side[t.G[0].indices] >= 0).all()
    assert near.max() < 2.2 * t.spacing * 1.2


def test_the_sense_of_the_corners_does_not_matter() -> None:
    corners = SHAPES["L"][1]["corners"]
    one, other = (laws("shape")["polygon"](corners=c) for c in (corners, corners[:1] + corners[:0:-1]))
    assert one.area == other.area and one.lowest() == other.lowest()
    assert polygons.area(other.outline()) > 0


def polygon_case(corners: list, **more) -> dict:
    return case("one_cell").resolved() | {"cells": [{
        "name": "Cell-1", "shape": "polygon", "material": "cytoplasm", "centre": ["0 um", "10 um"], **more,
        "corners": [[f"{x} um", f"{y} um"] for x, y in corners]}]}


BOW = [(0, 0), (4, 4), (4, 0), (0, 4)]
C = [(0, 0), (6, 0), (6, 2), (1, 2), (1, 4), (6, 4), (6, 6), (0, 6)]


@pytest.mark.parametrize(("corners", "more", "message"), [
    (BOW, {}, "corners: the outline crosses or touches itself: the edge from (0, 0) um meets that from (4, 0) um"),
    ([(0, 0), (4, 0)], {}, "corners: a polygon has at least three"),
    ([(0, 0), (4, 0), (8, 0)], {}, "corners: the"),
    ([(0, 0), (0, 0), (0, 0)], {}, "corners: a polygon has at least three"),
    (C, {"nucleus_ratio": 0.3, "nucleus": "nucleus"}, "about the centre of its area, does not lie within it"),
])
def test_outlines_that_bound_no_cell_are_refused(corners: list, more: dict, message: str) -> None:
    with pytest.raises(CaseError) as error:
        from_dict(polygon_case(corners, **more))
    assert message in str(error.value)


def outlined(folder: Path, table: str) -> Path:
    """A case whose cell takes its corners from a file beside it."""
    (folder / "outlines").mkdir()
    (folder / "outlines/cell.csv").write_text(table, encoding="utf-8")
    (folder / "case.toml").write_text(f'extends = "{CASES["one_cell"]}"\n[[cells]]\nname = "A"\nshape = "polygon"\n'
                                      'corners = "outlines/cell.csv"\nmaterial = "cytoplasm"\n'
                                      'centre = ["0 um", "3 um"]\n', encoding="utf-8")
    return folder / "case.toml"


def test_corners_may_stand_in_a_file_beside_the_case(tmp_path: Path) -> None:
    found = load(outlined(tmp_path, "x_nm,y_nm\n-2000,-2000\n2000, -2000\n0,3.5e3\n\n"))
    assert found.cells[0].shape.corners == ((-2.0, -2.0), (2.0, -2.0), (0.0, 3.5))
    assert from_dict(found.resolved()).cells == found.cells  # which needs the file no more


@pytest.mark.parametrize(("table", "message"), [
    ("-2,-2\n2,-2\n0,3\n", "begins with '-2,-2', not with a line such as 'x_um,y_um'"), ("", "begins with ''"),
    ("x_um,y_um\n-2,-2,1\n2,-2\n0,3\n", "has 3 numbers in line 2, not two"),
    ("x_um,y_um\n-2,a\n2,-2\n0,3\n", "'a um' is not a number with a unit"),
    ("x_um,y_um\n-2,-2\n", "a polygon has at least three"), ("x_kg,y_um\n-2,-2\n2,-2\n0,3\n", "wrong dimension"),
    ("x_um,y_um\n-2,-2\n\n2,a\n", "cell.csv' line 4: 'a um' is not a number"),
    ("x_px,y_px\n-2,-2\n2,-2\n0,3\n", "counts in pixels: say how long 1 is, such as unit = \"0.1625 um\""),
    ("X,Y\n-2,-2\n2,-2\n0,3\n", "names no unit: say how long 1 is, such as unit = \"0.1625 um\""),
    ("x_um,y\n-2,-2\n", "has a unit for one of x and y alone"), ("x_px,y_um\n-2,-2\n", "'px' is no length"),
    (" ,Area,X,Y\n1,5,-2,-2\n", "a table of measurements, not the points of one outline, which ImageJ writes by File"),
    (" ,BX,BY,Width,Height\n1,5,-2,2,2\n", "the columns ',BX,BY,Width,Height': a table of measurements"),
])
def test_a_file_that_holds_no_outline_is_named(tmp_path: Path, table: str, message: str) -> None:
    with pytest.raises(CaseError) as error:
        load(outlined(tmp_path, table))
    assert message in str(error.value) and "case.toml:" in str(error.value)


# Pixels of 0.5 um, y downwards from the edge of a picture: a cell of 4 um x 6 um, whose middle is at 10 um and -20 um.
PIXELS = [(16, 34), (24, 34), (24, 46), (16, 46)]
ROWS = [f"{x},{y}" for x, y in PIXELS]


@pytest.mark.parametrize("table", [
    ["x_px,y_px", *ROWS], ["X,Y", *ROWS], ["x,y", *ROWS], [" ,X,Y", *(f"{n},{row}" for n, row in enumerate(ROWS, 1))],
    ["X\tY", *(row.replace(",", "\t") for row in ROWS)], ROWS, ["Y,X", *(f"{y},{x}" for x, y in PIXELS)],
    ["X,Y", *ROWS[::-1]], ["X,Y", *ROWS[2:], *ROWS[:2]], ["X,Y", *ROWS, ROWS[0]]])
@pytest.mark.parametrize("centred", [True, False])
def test_an_outline_in_pixels_has_a_scale_and_y_down(tmp_path: Path, table: list[str], centred: bool) -> None:
    path = outlined(tmp_path, "\n".join(table) + "\n")
    path.write_text(path.read_text().replace('"3 um"', '"30 um"')
                    + f'unit = "0.5 µm"\ny_down = true\ncentred = {str(centred).lower()}\n', encoding="utf-8")
    found = load(path)
    shape = found.cells[0].shape
    assert shape.area == 24.0 and shape.lowest() == (-3.0 if centred else -23.0)
    assert sorted(shape._border.tolist()) == (
        [[-2, -3], [-2, 3], [2, -3], [2, 3]] if centred else [[8, -23], [8, -17], [12, -23], [12, -17]])
    assert from_dict(found.resolved()).cells == found.cells


def test_a_table_that_names_its_unit_takes_no_other(tmp_path: Path) -> None:
    path = outlined(tmp_path, "x_um,y_um\n-2,-2\n2,-2\n0,3\n")
    path.write_text(path.read_text() + 'unit = "0.5 um"\n', encoding="utf-8")
    with pytest.raises(CaseError, match="gives its own unit, um: leave out the key unit"):
        load(path)


def test_corners_in_the_case_are_numbers_where_there_is_a_unit() -> None:
    tree = polygon_case(PIXELS)
    tree["cells"][0] |= {"corners": [list(p) for p in PIXELS], "unit": "500 nm", "centre": ["0 um", "0 um"]}
    shape = from_dict(tree).cells[0].shape
    assert (shape.area, shape.lowest()) == (24.0, 17.0) and shape.corners[0] == (16.0, 34.0)
    with pytest.raises(CaseError, match="'px' is no length"):
        from_dict(tree | {"cells": [tree["cells"][0] | {"unit": "1 px"}]})


def test_the_middle_of_an_outline_is_the_same_to_the_last_bit_for_any_first_corner_and_sense() -> None:
    corners = [tuple(p) for p in (1e3 + WAVY).tolist()]
    ways = [corners[k:] + corners[:k] for k in (0, 1, 17)]
    shapes = [laws("shape")["polygon"](corners=tuple(way[::turn]), centred=True) for way in ways for turn in (1, -1)]
    assert len({tuple(sorted(map(tuple, shape._border.tolist()))) for shape in shapes}) == 1
    assert np.abs(polygons.centroid(shapes[0]._border)).max() < 1e-12  # measured 3e-14


def closed_by_rounding() -> np.ndarray:
    """The wave again, closed by its first point computed anew, and with points that repeat to rounding."""
    t = np.linspace(0.0, 2.0 * np.pi, 51)
    p = (5 + 0.5 * np.cos(4 * t))[:, None] * np.column_stack([np.cos(t), np.sin(t)])
    return np.insert(p, 20, p[20] * (1 + 1e-14), axis=0)


SPIKE = np.concatenate([WAVY[:10], [WAVY[9] + 2.0, WAVY[9]], WAVY[10:]])


@pytest.mark.parametrize(("corners", "shift"), [(closed_by_rounding(), 0.0), (closed_by_rounding(), 1e4), (SPIKE, 0.0),
                                                (np.repeat(WAVY, 3, axis=0), 0.0)])
def test_points_that_repeat_to_rounding_and_tips_without_width_do_no_harm(corners: np.ndarray, shift: float) -> None:
    for first in range(0, len(corners), 7):
        p = np.roll(corners, first, axis=0) + shift
        shape = laws("shape")["polygon"](corners=tuple(map(tuple, p.tolist())))
        assert shape.area == pytest.approx(polygons.area(WAVY), rel=1e-9) and len(shape._border) == len(WAVY)


@pytest.mark.parametrize("number", [3, 11, 24, 38])
def test_two_neighbours_in_the_wrong_order_are_told_by_their_lines(tmp_path: Path, number: int) -> None:
    points = WAVY.tolist()
    points[number:number + 2] = points[number + 1], points[number]
    table = ["x_um,y_um", *(f"{x!r},{y!r}" for x, y in points)]
    path = outlined(tmp_path, "\n".join(table) + "\n")
    path.write_text(path.read_text().replace('"3 um"', '"9 um"'), encoding="utf-8")
    with pytest.raises(CaseError) as error:
        load(path)
    assert re.search(rf"crosses or touches itself: .*, lines {number + 1} and {number + 3} of '.*cell.csv'; "
                     rf"are lines {number + 2} and {number + 3} of '.*cell.csv' in the right order\?", str(error.value))


def test_neighbours_in_the_wrong_order_that_cross_nothing_are_told_as_well(tmp_path: Path) -> None:
    text = CASES["outline"].read_text(encoding="utf-8").replace("paper.toml", str(CASES["paper"]))
    text = text.replace("per_cell = 1000", "per_cell = 300").replace("5.135 um", "6 um")
    (tmp_path / "case.toml").write_text(text, encoding="utf-8")
    rows = (CASES["outline"].parent / "outline.csv").read_text().splitlines()
    told = 0
    for n in range(1, 16):
        swapped = [*rows[:n], rows[n + 1], rows[n], *rows[n + 2:]]
        (tmp_path / "outline.csv").write_text("\n".join(swapped) + "\n")
        try:
            found = load(tmp_path / "case.toml")
        except CaseError as error:
            assert f"lines {n + 1} and {n + 2} of" in str(error)
            continue
        try:
            discretise(found)
        except CaseError as error:
            told += 1
            assert f"are lines {n + 1} and {n + 2} of" in str(error)
    assert told > 2  # measured 5 of 15; of the others some cross, and some are a rough outline that is laid out


def cell_with(**keys: object) -> object:
    """A polygon of the wave with a nucleus."""
    return laws("shape")["polygon"](corners=tuple(map(tuple, WAVY.tolist())), **keys)


SMALL = tuple(map(tuple, (0.4 * WAVY + [1.5, -0.5]).tolist()))


@pytest.mark.parametrize("shape", [
    lambda: cell_with(nucleus_corners=SMALL), lambda: cell_with(nucleus_corners=SMALL[::-1]),
    lambda: cell_with(nucleus_ratio=0.4, nucleus_offset=(1.5, -0.5)),
    lambda: laws("shape")["ellipse"](a=5.0, b=5.0, nucleus_ratio=0.4, nucleus_offset=(1.5, -0.5)),
    lambda: laws("shape")["rectangle"](width=9.0, height=9.0, nucleus_ratio=0.4, nucleus_offset=(1.5, -0.5))])
def test_a_nucleus_may_lie_off_the_middle(shape: Callable) -> None:
    shape = shape()
    layout = shape.particles(600)
    assert np.abs(layout.X[layout.nucleus].mean(axis=0) - [1.5, -0.5]).max() < 0.1  # measured 0.03
    assert layout.nucleus.sum() / 600 == pytest.approx(0.16, rel=0.12)  # measured 0.145 to 0.16
    assert polygons.area(shape._nucleus[0]) == pytest.approx(0.16 * shape.area, rel=1e-5)


@pytest.mark.parametrize(("keys", "message"), [
    ({"nucleus_ratio": 0.5, "nucleus_offset": (3.0, 0.0)}, "nucleus_offset: the nucleus there does not lie within"),
    ({"nucleus_offset": (3.0, 0.0)}, "nucleus_offset: needs nucleus_ratio, the size of the nucleus"),
    ({"nucleus_corners": SMALL, "nucleus_ratio": 0.4}, "nucleus_ratio: the nucleus has corners already"),
    ({"nucleus_corners": ((4.0, 0.0), (6.0, 0.0), (5.0, 1.0))}, "nucleus_corners: the nucleus does not lie within it"),
    ({"nucleus_corners": ((9.0, 0.0), (10.0, 0.0), (9.0, 1.0))}, "nucleus_corners: the nucleus does not lie within it"),
    ({"nucleus_corners": tuple(map(tuple, (2.0 * WAVY).tolist()))}, "nucleus_corners: the nucleus does not lie within"),
    ({"nucleus_corners": ((0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0))}, "nucleus_corners: the outline crosses"),
    ({"nucleus_corners": ((0.0, 0.0), (1.0, 0.0))}, "nucleus_corners: a polygon has at least three")])
def test_a_nucleus_that_is_not_within_its_cell_is_refused(keys: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        cell_with(**keys)


@pytest.mark.parametrize(("first", "turn", "closed"), [(1, 1, False), (0, -1, True), (40, -1, False)])
def test_first_point_and_sense_of_traced_outlines_are_all_one(first: int, turn: int, closed: bool) -> None:
    found = case("microscope", per_cell=150).cells[0].shape

    def traced(corners: tuple) -> tuple:
        points = (corners[first:] + corners[:first])[::turn]
        return points + points[:1] * closed

    other = dataclasses.replace(found, corners=traced(found.corners), nucleus_corners=traced(found.nucleus_corners))
    one, two = (shape.particles(150) for shape in (found, other))
    assert (one.X == two.X).all() and (one.nucleus == two.nucleus).all()
    assert (one.X[one.surface] == two.X[two.surface]).all()


def test_a_cell_traced_in_a_picture_lies_on_the_substrate_with_its_nucleus() -> None:
    found = case("microscope", per_cell=300)
    shape, template_ = found.cells[0].shape, discretise(found).templates[0]
    trace = np.loadtxt(CASES["microscope"].with_suffix(".csv"), delimiter=",", skiprows=1)[:, 1:]
    assert shape.area == pytest.approx(0.1625**2 * abs(polygons.area(trace)), rel=1e-12)
    assert found.cells[0].centre[1] + shape.lowest() == pytest.approx(0.01, abs=1e-12)
    assert template_.V.sum() == pytest.approx(shape.area, rel=0.005)  # measured 0.0015
    nucleus = polygons.area(shape._nucleus[0])
    assert template_.V[template_.nucleus].sum() == pytest.approx(nucleus, rel=0.05)  # measured 0.021


def test_too_few_particles_for_an_outline_are_a_mistake_of_the_case() -> None:
    few = from_dict(polygon_case(STAR) | {"particles": {"per_cell": 10}})
    with pytest.raises(CaseError, match="'Cell-1': 10 particles are too few for such an outline"), built(few):
        pass


@pytest.mark.parametrize("angle", [0.2, 0.9, np.pi / 2, 2.0, 3.0])
def test_a_segment_rests_on_its_base_and_has_the_height_and_area_of_its_circle(angle: float) -> None:
    segment = laws("shape")["segment"](width=10.0, contact_angle=angle)
    radius, border = 5.0 / np.sin(angle), segment.outline(4000)
    assert segment.lowest() == 0.0 and np.array_equal(border[border[:, 1] == 0.0].min(axis=0), [-5.0, 0.0])
    assert border[:, 1].max() == pytest.approx(radius * (1.0 - np.cos(angle)), rel=1e-12)
    exact = radius**2 * (angle - np.sin(angle) * np.cos(angle))
    assert segment.area == pytest.approx(exact, rel=2e-6)  # of 2,000 chords; measured 2.5e-7 to 1.4e-6
    same = laws("shape")["segment"](width=10.0, height=float(border[:, 1].max()))
    assert np.allclose(same.outline(4000), border, rtol=0.0, atol=1e-11)
    assert set(segment.parts) == {"surface", "outline", "base", "cap"}


@pytest.mark.parametrize(("more", "message"), [
    ({}, "expects one of height and contact_angle"), ({"height": 1.0, "contact_angle": 1.0}, "expects one of"),
    ({"contact_angle": 3.2}, "contact_angle: is less than 180 degrees"),
    ({"height": 4.0, "nucleus_ratio": 0.5, "nucleus_offset": (0.0, -2.0)}, "nucleus_offset: the nucleus there")])
def test_a_segment_that_cannot_be_is_refused(more: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        laws("shape")["segment"](width=10.0, **more)
