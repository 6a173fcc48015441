"""The shape `surface`: closed surfaces of triangles from files of every format, mended or refused with the place."""

from __future__ import annotations

import json
import re
from pathlib import Path

import meshio
import numpy as np
import pytest
from polyhedra import blocks
from scenes import CASES, case

from cellmig.case.load import from_dict, load
from cellmig.case.messages import CaseError
from cellmig.case.schema import Case
from cellmig.geometry import base_surfaces
from cellmig.geometry.bodies import Ball
from cellmig.geometry.file_body import Surface
from cellmig.geometry.surface_file import shells
from cellmig.geometry.tetrahedra import boundary, quality, volumes
from cellmig.geometry.triangles import area_vectors, edges_of, lengths
from cellmig.runs.checkpointing import check_identity, identity

pytestmark = pytest.mark.serial

SPHERE = base_surfaces.ball()
# A box with a roof; its coordinates are exact in single precision.
POINTS = np.array([(0.0, 0, 0), (6, 0, 0), (6, 4, 0), (0, 4, 0), (0, 0, 3), (6, 0, 3), (6, 4, 3), (0, 4, 3), (3, 2, 5)])
QUADS = np.array([(0, 3, 2, 1), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)])
ROOF = np.array([(4, 5, 8), (5, 6, 8), (6, 7, 8), (7, 4, 8)])
TRIANGLES = np.concatenate([QUADS[:, [0, 1, 2]], QUADS[:, [0, 2, 3]], ROOF])
VOLUME = 6 * 4 * 3 + 6 * 4 * 2 / 3
FORMATS = {"stl": {"binary": False}, "STL": {"binary": True}, "obj": {}, "ply": {"binary": False},
           "PLY": {"binary": True}, "off": {}, "vtk": {}, "vtu": {}, "msh": {"file_format": "gmsh"}, "mesh": {},
           "xdmf": {}, "wkt": {}}


def written(path: Path, points: np.ndarray = POINTS, cells: list | None = None, **more) -> Path:
    """A file of triangles, by meshio."""
    form = {key: more.pop(key) for key in ("file_format", "binary") if key in more}
    meshio.Mesh(points, cells or [("triangle", TRIANGLES.astype(np.int32))], **more).write(path, **form)
    return path


def body(path: Path, **keys) -> Surface:
    return Surface(**{"file": shells(str(path)), "unit": 1.0, **keys})


def refused(path: Path, **keys) -> str:
    with pytest.raises(ValueError) as error:
        body(path, **keys)
    return str(error.value)


def cell(folder: Path, *keys: str, name: str = "cell.stl") -> Case:
    """A case whose cell is in a file beside it."""
    (folder / "case.toml").write_text(f'extends = "{CASES["ball"]}"\n[particles]\nper_cell = 300\n[[cells]]\n'
                                      f'name = "A"\nshape = "surface"\nfile = "{name}"\nmaterial = "cytoplasm"\n'
                                      'centre = ["0 um"]\nrest = true\n' + "\n".join(keys) + "\n", encoding="utf-8")
    return load(folder / "case.toml")


@pytest.mark.parametrize("ending", FORMATS)
def test_all_formats_give_the_same_body(tmp_path: Path, ending: str, capfd: pytest.CaptureFixture) -> None:
    path = written(tmp_path / f"cell.{ending}", **FORMATS[ending])
    capfd.readouterr()
    found, known = body(path), body(written(tmp_path / "known.off"))
    assert capfd.readouterr().out == ""
    assert found.volume == pytest.approx(VOLUME, rel=1e-14) and found.lowest() == 0.0
    assert (found._surface.corners == known._surface.corners).all()


def test_quadrilaterals_are_divided(tmp_path: Path) -> None:
    path = written(tmp_path / "cell.vtk", POINTS, [("quad", QUADS), ("triangle", ROOF)])
    assert body(path).volume == pytest.approx(VOLUME, rel=1e-14)
    arrow = np.array([(0, 0, 0), (4, 1, 0), (1, 1, 0), (1, 4, 0), (1, 1, 3.0)])  # a quadrilateral with a reflex corner
    sides = np.array([(1, 0, 4), (2, 1, 4), (3, 2, 4), (0, 3, 4)])
    path = written(tmp_path / "arrow.vtk", arrow, [("quad", np.array([(0, 1, 2, 3)])), ("triangle", sides)])
    assert body(path).volume == pytest.approx(3.0, rel=1e-14)  # a third of the area 3 of the base times the height


def test_the_surface_around_elements_with_a_volume_is_that_of_the_body(tmp_path: Path) -> None:
    path = written(tmp_path / "cell.vtu", POINTS, [("hexahedron", np.arange(8)[None]),
                                                   ("pyramid", np.array([(4, 5, 6, 7, 8)]))])
    assert body(path).volume == pytest.approx(VOLUME, rel=1e-14)
    wedge = written(tmp_path / "wedge.vtk", POINTS, [("wedge", np.array([(0, 1, 2, 4, 5, 6)])),
                                                     ("wedge", np.array([(0, 2, 3, 4, 6, 7)]))])
    assert body(wedge).volume == pytest.approx(72.0, rel=1e-14)


OBJ = """o cell
{v}
vn 0 0 1
vt 0.5 0.5
g base
f 1//1 4//1 3//1 2//1
g walls
f 1/1/1 2/1/1 6/1/1 5/1/1
f -8 -7 -3 -4
f 3 4 8 7
f 4 1 5 8
g roof
f 5 6 9
f 6 7 9
f 7 8 9
f 8 5 9
"""


def test_obj_files_may_have_normals_groups_and_points_counted_from_the_end(tmp_path: Path) -> None:
    path = tmp_path / "cell.obj"
    path.write_text(OBJ.format(v="\n".join("v {} {} {}".format(*p) for p in POINTS)))
    found = body(path)
    assert found.volume == pytest.approx(VOLUME, rel=1e-14)
    assert found.parts == ("surface", "cell", "base", "walls", "roof")
    layout = found.particles(400)
    base = layout.X[layout.triangles[layout.parts["base"]]]
    assert (base[..., 2] == 0.0).all() and lengths(area_vectors(base)).sum() == pytest.approx(24.0, rel=1e-12)
    assert (layout.parts["cell"] == layout.parts["surface"]).all()
    path.write_text(path.read_text().replace("f 6 7 9", "f 6 seven 9"))
    assert "cannot be read: line 22: invalid literal" in refused(path)


def test_solids_of_an_stl_file_are_groups(tmp_path: Path) -> None:
    outer, core = (written(tmp_path / f"{name}.stl", factor * POINTS + shift, binary=False).read_text() for
                   name, factor, shift in (("a", 1.0, 0.0), ("b", 0.5, [1.5, 1.0, 0.75])))
    path = tmp_path / "cell.stl"
    path.write_text((outer.replace("solid", "solid membrane") + core.replace("solid", "solid nucleus")).upper())
    found = body(path, nucleus_region="NUCLEUS")
    assert found.volume == pytest.approx(VOLUME, rel=1e-14) == 8.0 * found._nucleus.volume
    assert found.parts == ("surface", "MEMBRANE")
    assert "are 2 pieces, not one" in refused(path)


def test_faces_of_a_ply_file_have_either_name(tmp_path: Path) -> None:
    for ending in ("ply", "PLY"):
        path = written(tmp_path / f"cell.{ending}", **FORMATS[ending])
        path.write_bytes(path.read_bytes().replace(b"vertex_indices", b"vertex_index"))
        assert body(path).volume == pytest.approx(VOLUME, rel=1e-14)


def groups(path: Path, solid: bool) -> tuple[Path, float]:
    """A ball with a core as a file of Gmsh, of tetrahedra or of triangles alone, and the volume of the core [µm³]."""
    ball = Ball(radius=5.0, nucleus_ratio=0.5).particles(600)
    core = ball.nucleus[ball.tetrahedra].any(axis=1)
    low = ball.X[ball.triangles][:, :, 2].mean(axis=1) < 0.0
    cells = [("tetra", ball.tetrahedra[~core], "cytoplasm"), ("tetra", ball.tetrahedra[core], "core"),
             ("triangle", ball.triangles[low], "sole"), ("triangle", ball.triangles[~low], "dome"),
             ("triangle", boundary(ball.tetrahedra[core])[0], "envelope")]
    names = {name: np.array([n, 3 if kind == "tetra" else 2]) for n, (kind, _, name) in enumerate(cells, 1)}
    cells = cells if solid else cells[2:]
    tags = [np.full(len(data), names[name][0]) for _, data, name in cells]
    mesh = meshio.Mesh(ball.X, [(kind, data) for kind, data, _ in cells], field_data=names,
                       cell_data={"gmsh:physical": tags, "gmsh:geometrical": [tag.copy() for tag in tags]})
    meshio.write(path, mesh, "gmsh22", binary=False)
    return path, volumes(ball.X, ball.tetrahedra[core]).sum()


@pytest.mark.parametrize(("solid", "region"), [(True, "core"), (False, "envelope")])
def test_a_nucleus_is_a_region_of_a_mesh_or_the_surface_around_it(tmp_path: Path, solid: bool, region: str) -> None:
    path, core = groups(tmp_path / "cell.msh", solid)
    found = body(path, nucleus_region=region)
    assert found.has_nucleus and found._nucleus.volume == pytest.approx(core, rel=1e-12)
    assert found.parts == ("surface", "sole", "dome")
    layout = found.particles(800)
    V = np.bincount(layout.tetrahedra.ravel(), np.repeat(volumes(layout.X, layout.tetrahedra), 4)) / 4.0
    assert V[layout.nucleus].sum() / V.sum() == pytest.approx(core / found.volume, rel=0.05)  # measured 0.03
    sole, dome = (layout.X[layout.triangles[layout.parts[name]]][:, :, 2].mean(axis=1) for name in ("sole", "dome"))
    assert len(sole) + len(dome) == len(layout.triangles) and sole.max() < 0.5 and dome.min() > -0.5


@pytest.mark.parametrize("kinds", [["tetra", "triangle"], ["triangle"]])
def test_a_nucleus_is_where_an_array_has_a_value(tmp_path: Path, kinds: list[str]) -> None:
    ball = Ball(radius=5.0, nucleus_ratio=0.5).particles(300)
    core = ball.nucleus[ball.tetrahedra].any(axis=1)
    around = boundary(ball.tetrahedra[core])[0]
    cells = {"tetra": ball.tetrahedra, "triangle": np.concatenate([ball.triangles, around])}
    ref = {"tetra": np.where(core, 2, 1), "triangle": np.repeat([1, 2], [len(ball.triangles), len(around)])}
    path = written(tmp_path / "cell.vtu", ball.X, [(kind, cells[kind]) for kind in kinds],
                   cell_data={"ref": [ref[kind] for kind in kinds]})
    found = body(path, nucleus_region="ref=2")
    assert found.parts == ("surface",)
    assert found.volume == pytest.approx(volumes(ball.X, ball.tetrahedra).sum(), rel=1e-12)
    assert found._nucleus.volume == pytest.approx(volumes(ball.X, ball.tetrahedra[core]).sum(), rel=1e-12)


def test_groups_that_give_no_nucleus_are_refused(tmp_path: Path) -> None:
    path, _ = groups(tmp_path / "cell.msh", True)
    assert refused(path, nucleus_region="cor").endswith("cell.msh' has no group 'cor'; did you mean 'core'?")
    assert "nucleus_region: 'cytoplasm' reaches the surface; a nucleus lies within" in refused(
        path, nucleus_region="cytoplasm")
    path, _ = groups(tmp_path / "cell.msh", False)
    assert "'sole': the surface is not closed: triangle " in refused(path, nucleus_region="sole")
    assert "are 2 pieces, not one; a nucleus has a file of its own, nucleus_file, or is a named group" in refused(path)


def test_a_nucleus_may_have_a_file_of_its_own_in_the_same_coordinates(tmp_path: Path) -> None:
    written(tmp_path / "cell.stl", 5.0 * SPHERE.vertices + 20.0, [("triangle", SPHERE.triangles)])
    path = written(tmp_path / "core.stl", 2.0 * SPHERE.vertices + [21.0, 20.0, 20.0], [("triangle", SPHERE.triangles)])
    found = cell(tmp_path, 'unit = "1 um"', "centred = true", 'nucleus_file = "core.stl"', 'nucleus = "nucleus"')
    shape = found.cells[0].shape
    assert shape._nucleus.centroid == pytest.approx([1.0, 0.0, 0.0], abs=1e-5)  # of single precision
    assert shape._nucleus.volume == pytest.approx(0.4**3 * shape.volume, rel=1e-5)
    for shift, told in ((2.9, "does not lie within the body: it is 0."), (20.0, "does not lie within the body: it is")):
        written(path, 2.0 * SPHERE.vertices + [20.0 + shift + 0.2, 20.0, 20.0], [("triangle", SPHERE.triangles)])
        with pytest.raises(CaseError, match=f"nucleus_file: the nucleus {told}"):
            cell(tmp_path, 'unit = "1 um"', "centred = true", 'nucleus_file = "core.stl"', 'nucleus = "nucleus"')


def test_a_nucleus_whose_corners_alone_are_inside_is_refused(tmp_path: Path) -> None:
    outline = np.array([(0.0, 0), (9, 0), (9, 3), (3, 3), (3, 9), (0, 9)])
    flat = np.array([(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)])
    i, j = np.arange(6), np.roll(np.arange(6), -1)
    sides = np.concatenate([np.column_stack([i, j, j + 6]), np.column_stack([i, j + 6, i + 6])])
    bent = np.concatenate([np.column_stack([outline, np.full(6, z)]) for z in (0.0, 4.0)])
    path = written(tmp_path / "bent.off", bent, [("triangle", np.concatenate([flat, flat + 6, sides]))])
    inner = np.array([(8.0, 1, 2), (1, 8, 2), (1, 1, 1), (1, 1, 3)])
    core = written(tmp_path / "core.off", inner, [("triangle", np.array([(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)]))])
    told = "nucleus_file: the surfaces of the cell and of the nucleus cross each other"
    assert told in refused(path, nucleus_file=shells(str(core)))
    assert "nucleus_file: the nucleus is given by nucleus_ratio already" in refused(
        path, nucleus_ratio=0.3, nucleus_file=shells(str(core)))


def test_triangles_listed_twice_or_without_extent_are_left_out(tmp_path: Path) -> None:
    path = written(tmp_path / "cell.off", POINTS, [("triangle", np.concatenate([TRIANGLES, TRIANGLES[::-1, ::-1],
                                                                                [(0, 0, 1), (2, 2, 2)]]))])
    assert body(path).volume == pytest.approx(VOLUME, rel=1e-14)


def test_triangles_turned_inward_or_at_random_are_turned_outward(tmp_path: Path) -> None:
    for turned in (np.ones(14, bool), np.random.default_rng(0).random(14) < 0.5):
        mixed = np.where(turned[:, None], TRIANGLES[:, ::-1], TRIANGLES)
        found = body(written(tmp_path / "cell.off", POINTS, [("triangle", mixed)]))
        assert found.volume == pytest.approx(VOLUME, rel=1e-14)


def without(*rows: int) -> np.ndarray:
    return np.delete(TRIANGLES, rows, axis=0)


@pytest.mark.parametrize(("points", "triangles", "told"), [
    (POINTS, without(10), r"file: 'PATH': the surface is not closed: triangle 7 \(line 44\) has no neighbour at its "
     r"edge from \(0, 0, 3\) to \(6, 0, 3\), and 2 more"),
    (POINTS, np.concatenate([TRIANGLES, [(0, 4, 8), (4, 1, 8), (1, 0, 4)]]), r"not closed: .*; the surface branches: "),
    (np.concatenate([POINTS, POINTS + 20.0]), np.concatenate([TRIANGLES, TRIANGLES + 9]), "are 2 pieces, not one; a n"),
    (np.where(np.arange(9)[:, None] == 8, [(3, 2, -1)], POINTS), TRIANGLES,
     r"triangle 1 \(line 2\) and triangle 13 \(line 86\) cross each other, about \(2.5, 3, 0.8333\)"),
    (np.concatenate([POINTS, [(3, 0, 3)]]), np.concatenate([without(10), [(4, 9, 8), (9, 5, 8), (4, 5, 9)]]),
     r"triangle 16 \(line 107\) has no area: its corners are in a line, about \(3, 0, 3\)"),
    (POINTS, TRIANGLES[:3], "a closed surface has at least four triangles")])
def test_what_bounds_no_volume_is_refused_with_the_triangle_and_its_line(tmp_path: Path, points: np.ndarray,
                                                                          triangles: np.ndarray, told: str) -> None:
    path = tmp_path / "cell.stl"
    facet = "facet normal 0 0 1\nouter loop\n" + 3 * "vertex {:g} {:g} {:g}\n" + "endloop\nendfacet\n"
    path.write_text("solid\n" + "".join(facet.format(*points[t].ravel()) for t in triangles) + "endsolid\n")
    assert re.search(told.replace("PATH", re.escape(str(path))), refused(path)), refused(path)


def test_a_surface_without_an_outside_is_refused(tmp_path: Path) -> None:
    """A Klein bottle that does not cross itself has no place in space; its triangles have."""
    n, m = 6, 5
    i, j = (k.ravel() for k in np.meshgrid(np.arange(n), np.arange(m), indexing="ij"))
    at = lambda p, q: (p % n) * m + np.where(p >= n, -q, q) % m  # noqa: E731
    tri = np.concatenate([np.stack([at(i, j), at(i + 1, j), at(i + 1, j + 1)], axis=1),
                          np.stack([at(i, j), at(i + 1, j + 1), at(i, j + 1)], axis=1)])
    points = np.random.default_rng(1).uniform(0.0, 10.0, (n * m, 3))
    path = written(tmp_path / "cell.off", points, [("triangle", tri)])
    assert "has no outside: the surface is one-sided; triangle" in refused(path)
    assert "cross each other" in refused(path)


@pytest.mark.parametrize(("name", "content", "told"), [
    ("cell.stl", b"", "cannot be read: it is no text, which begins with 'solid', and has not the length"),
    ("cell.stl", bytes(80) + b"\x09\0\0\0" + bytes(99), "84 + 50 x 9 bytes for 9 triangles, but 183 bytes"),
    ("cell.stl", b"solid a\nvertex 0 0\n", "cannot be read: line 2 has no three coordinates: 'vertex 0 0'"),
    ("cell.stl", b"solid\n" + 2 * b"vertex 0 0 0\n" + b"endfacet\n", "line 4 ends a facet of 2 corners, not three"),
    ("cell.stl", b"solid\nvertex 0 0 0\n", "it ends within a facet"), ("cell.stl", b"solid a", "has no triangles"),
    ("cell.off", b"\xff\xfe", "neither text nor a whole binary file"),
    ("cell.toml", b"", "cannot be read: Could not deduce file format"),
    ("cell.obj", b"v 0 0 0\nf 1 2 3\n", "it names points that it does not have"),
    ("cell.obj", b"v 0 0 0\n" * 5 + b"f 1 2 3 4 5\n", "elements that are not read: 1 of type polygon; a cell in space"),
    ("cell.obj", b"v 0 0\nv 1 0\nv 1 1\nf 1 2 3\n", "is flat: its points have no z"),
    ("cell.obj", b"v 0 0 1\nv 1 0 1\nv 1 1 1\nf 1 2 3\n", 'is flat: all its triangles have one z; in two dimensions')])
def test_files_without_a_surface_are_refused(tmp_path: Path, name: str, content: bytes, told: str) -> None:
    (tmp_path / name).write_bytes(content)
    assert told in refused(tmp_path / name)


@pytest.mark.parametrize(("unit", "told"), [
    ("1 um", 'unit: the body would be 6e-06 um long, 6e-06 units of the file; is the unit 1 m?'),
    ("1 nm", 'unit: the body would be 6e-09 um long, 6e-06 units of the file; is the unit 1 m?'), ("1 m", "")])
def test_a_size_that_no_cell_has_asks_for_the_unit(tmp_path: Path, unit: str, told: str) -> None:
    written(tmp_path / "cell.off", 1e-6 * POINTS)
    if told:
        with pytest.raises(CaseError) as error:
            cell(tmp_path, f'unit = "{unit}"', name="cell.off")
        assert told in str(error.value)
    else:
        found = cell(tmp_path, f'unit = "{unit}"', name="cell.off").cells[0].shape
        assert found.volume == pytest.approx(VOLUME, rel=1e-9)


def test_a_file_is_turned_centred_and_set_down(tmp_path: Path) -> None:
    written(tmp_path / "cell.off", POINTS[:, [0, 2, 1]])  # with y upwards, as in many files
    found = cell(tmp_path, 'unit = "500 nm"', 'rotation = ["90 deg", "0 deg", "0 deg"]', "centred = true",
                 name="cell.off").cells[0]
    surface = found.shape._surface
    assert surface.centroid == pytest.approx(np.zeros(3), abs=1e-12)
    assert np.ptp(surface.vertices, axis=0) == pytest.approx([3.0, 2.0, 2.5], rel=1e-12)
    assert found.shape.volume == pytest.approx(VOLUME / 8.0, rel=1e-12)
    assert found.centre[2] + found.shape.lowest() == pytest.approx(0.01, rel=1e-12)
    top = surface.vertices[surface.vertices[:, 2].argmax()]  # the ridge of the roof is up
    assert surface.vertices[:, 2].max() - surface.vertices[:, 2].min() == pytest.approx(2.5) and abs(top[0]) < 1e-9


def test_a_case_from_a_file_needs_it_no_more_and_a_changed_one_is_another_case(tmp_path: Path) -> None:
    written(tmp_path / "cell.off")
    found = cell(tmp_path, 'unit = "1 um"', name="cell.off")
    about = json.loads(json.dumps(identity(found, 1.0, True)))
    check_identity(about, cell(tmp_path, 'unit = "1 um"', name="cell.off"), 1.0, True)
    assert from_dict(json.loads(json.dumps(found.resolved()))).cells == found.cells
    moved = POINTS.copy()
    moved[8, 2] += 0.001
    written(tmp_path / "cell.off", moved)
    with pytest.raises(CaseError, match=r"file.vertices: is not what it was in the run"):
        check_identity(about, cell(tmp_path, 'unit = "1 um"', name="cell.off"), 1.0, True)


def test_a_table_that_is_none_is_refused() -> None:
    for value in (3, {"vertices": "0 0 0"}, {"vertices": "0 0 0", "triangles": "a"},
                  {"vertices": "0 0 0", "triangles": "0 0 0", "parts": {"a": "7"}}):
        with pytest.raises(CaseError, match=r"file: expects the name of a file of triangles in space, such as"):
            load(CASES["surface"], [f"cells.0.file={value!r}".replace("'", '"').replace('": ', '" = ')])


def test_the_file_of_the_case_is_the_formula_that_it_names() -> None:
    found = case("surface").cells[0].shape
    assert len(found.file._all) == 320 and len(found._surface.vertices) == 162
    x, y, z = (n := found._surface.vertices / lengths(found._surface.vertices)[:, None]).T
    radius = 5.0 * (0.62 + 0.55 * x**2 + 0.07 * np.sin(5 * x + 1) * np.sin(4 * y + 2) + 0.05 * np.cos(4 * z + 1))
    assert np.abs(radius[:, None] * n - found._surface.vertices).max() < 2e-3  # three digits


def star(draw: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A ball with random bumps and axes."""
    n, r = SPHERE.vertices, np.ones(len(SPHERE.vertices))
    for _ in range(3):
        r += draw.uniform(0.02, 0.15) * np.sin(n @ (draw.normal(size=3) * draw.uniform(1.0, 4.0)) + draw.uniform(0, 6))
    return 5.0 * r[:, None] * n * draw.uniform(0.6, 1.4, 3), SPHERE.triangles


def torus(draw: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A ring of random thickness and number of triangles."""
    m, k, r = draw.integers(12, 60), draw.integers(8, 24), draw.uniform(1.5, 3.5)
    along, around = np.meshgrid(2 * np.pi * np.arange(m) / m, 2 * np.pi * np.arange(k) / k, indexing="ij")
    out = 5.0 + r * np.cos(around)
    points = np.stack([out * np.cos(along), out * np.sin(along), r * np.sin(around)], axis=-1).reshape(-1, 3)
    i, j = (n.ravel() for n in np.meshgrid(np.arange(m), np.arange(k), indexing="ij"))
    a, b, c, d = (((i + p) % m) * k + (j + q) % k for p, q in ((0, 0), (1, 0), (1, 1), (0, 1)))
    return points, np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


@pytest.mark.parametrize("relief", ["voxels", "noise"])
def test_smoothing_takes_off_relief_shorter_than_the_spacing(tmp_path: Path, relief: str) -> None:
    points, triangles = 5.0 * SPHERE.vertices, SPHERE.triangles
    if relief == "voxels":
        at = np.stack(np.meshgrid(*3 * [np.arange(-13, 14)], indexing="ij"), axis=-1).reshape(-1, 3)
        points, triangles = blocks([tuple(row) for row in at[0.4 * lengths(at) < 4.7].tolist()], 0.4)
    else:
        points = points * (1.0 + 0.03 * np.random.default_rng(0).normal(size=len(points)))[:, None]
    path = written(tmp_path / "cell.off", points, [("triangle", triangles)])
    rough, smooth = body(path), body(path, smoothing=1.6)
    with pytest.raises(ValueError, match="it is thinner or rougher than their spacing"):
        rough.particles(1000)
    assert "smoothing, a length of about twice the spacing" in rough.hint and not smooth.hint
    layout = smooth.particles(1000)
    assert volumes(layout.X, layout.tetrahedra).sum() == pytest.approx(rough.volume, rel=0.01)  # measured 0.007
    area = lengths(area_vectors(layout.X[layout.triangles])).sum()
    assert area == pytest.approx(36.0**(1 / 3) * np.pi**(1 / 3) * rough.volume**(2 / 3), rel=0.03)  # of a ball


def test_smoothing_leaves_balls_and_parts_and_asks_for_less_where_it_changes_the_shape(tmp_path: Path) -> None:
    path = written(tmp_path / "cell.off", 5.0 * SPHERE.vertices, [("triangle", SPHERE.triangles)])
    left = [1.0 - body(path, smoothing=w).volume / body(path).volume for w in (1.0, 2.0)]
    assert left == pytest.approx([3 * 4 * (w / 4.05) ** 4 / 5.0**4 for w in (1.0, 2.0)], rel=0.1)  # 7.1e-5, 1.1e-3
    with pytest.raises(ValueError, match=r"^smoothing: 9 um would change the volume by "):
        body(path, smoothing=9.0)
    groups(tmp_path / "cell.msh", True)
    found = body(tmp_path / "cell.msh", nucleus_region="core", smoothing=1.0)
    assert found.parts == ("surface", "sole", "dome") and found._nucleus.area < body(
        tmp_path / "cell.msh", nucleus_region="core")._nucleus.area


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("make", [star, torus])
def test_random_surfaces_are_filled_well(tmp_path: Path, make, seed: int) -> None:
    points, triangles = make(np.random.default_rng(seed))
    found = body(written(tmp_path / "cell.off", points, [("triangle", triangles)]))
    layout = found.particles(1000)
    V, m = volumes(layout.X, layout.tetrahedra), len(np.unique(layout.triangles))
    assert (V > 0.0).all() and len(layout.X) == 1000
    assert abs(V.sum() / found.volume - 1.0) < 0.04
    area = lengths(area_vectors(layout.X[layout.triangles])).sum()
    assert abs(area / found._surface.area - 1.0) < 0.04
    inner = (layout.tetrahedra >= m).any(axis=1)
    assert quality(layout.X, layout.tetrahedra)[inner].min() > 0.25
    assert m - len(edges_of(layout.triangles)[0]) + len(layout.triangles) == (2 if make is star else 0)
