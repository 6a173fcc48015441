"""Shapes from files: triangles that meshio reads, and outlines as pictures give them."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
import pytest
from scenes import CASES, built, case

from cellmig.case.load import from_dict, load
from cellmig.case.messages import CaseError
from cellmig.case.registry import laws
from cellmig.case.schema import Case
from cellmig.meshfree import polygons
from cellmig.meshfree.mesh_file import Boundary, boundary
from cellmig.simulation import discretise

pytestmark = pytest.mark.serial

# A plate of 6 x 4 squares of two triangles each, with a hole to the right of its middle and a core.
X, Y = np.meshgrid(np.arange(7.0), np.arange(5.0))
POINTS = np.column_stack([X.ravel(), Y.ravel()]) - [3.0, 0.0]
SQUARES = [(i, j) for j in range(4) for i in range(6) if (i, j) != (4, 2)]
TRIANGLES = [t for i, j in SQUARES for a in [7 * j + i] for t in ((a, a + 1, a + 8), (a, a + 8, a + 7))]
CORE = np.repeat([(i, j) in ((1, 1), (2, 1)) for i, j in SQUARES], 2).astype(int)
FOOT = [(k, k + 1) for k in range(6)]


def written(path: Path, points: np.ndarray = POINTS, cells: list | None = None, **more) -> Path:
    """A file of triangles, by meshio."""
    meshio.Mesh(points, cells or [("triangle", np.array(TRIANGLES))], **more).write(path)
    return path


def plate(path: Path) -> Path:
    """The plate as a file of Gmsh, with physical groups: core and rest, foot, and one without lines."""
    tags = [np.where(CORE, 2, 1), np.full(6, 3)]
    field_data = {"rest": [1, 2], "core": [2, 2], "foot": [3, 1], "bare": [4, 1], "void": [5, 2]}
    mesh = meshio.Mesh(np.column_stack([POINTS, np.full(35, 0.7)]), [("triangle", np.array(TRIANGLES)), ("line", FOOT)],
                       cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
                       field_data={name: np.array(tag) for name, tag in field_data.items()})
    meshio.write(path, mesh, "gmsh22", binary=False)
    return path


def meshed(folder: Path, keys: str, name: str = "cell.msh") -> Case:
    """A case whose cell is in a file beside it."""
    (folder / "case.toml").write_text(f'extends = "{CASES["one_cell"]}"\n[particles]\nper_cell = 200\n[[cells]]\n'
                                      f'name = "A"\nshape = "mesh"\nfile = "{name}"\nmaterial = "cytoplasm"\n'
                                      f'centre = ["0 um", "0.01 um"]\n{keys}\n', encoding="utf-8")
    return load(folder / "case.toml")


def test_a_mesh_gives_the_area_the_hole_the_nucleus_and_the_parts(tmp_path: Path) -> None:
    plate(tmp_path / "cell.msh")
    found = meshed(tmp_path, 'unit = "500 nm"\nnucleus_region = "core"\nnucleus = "nucleus"')
    shape = found.cells[0].shape
    assert shape.area == pytest.approx(23 * 0.25, rel=1e-12)
    assert shape.lowest() == 0.0
    assert {"surface", "outline", "hole-1", "foot"} <= set(shape.parts) and not {"bare", "core"} & set(shape.parts)
    with built(found) as sim:
        t = sim.scene.templates[0]
    assert t.V.sum() == pytest.approx(shape.area, rel=1e-12)  # its corners are kept, so nothing is cut off
    assert t.V[t.nucleus].sum() == pytest.approx(2 * 0.25, rel=0.15)  # 17 particles of 200; measured
    assert polygons.inside(t.X[t.nucleus], np.array([[-1.1, 0.4], [0.1, 0.4], [0.1, 1.1], [-1.1, 1.1]])).all()
    foot, hole = t.X[t.segments[t.parts["foot"]]], t.X[t.segments[t.parts["hole-1"]]]
    assert (foot[..., 1] == 0.0).all() and np.diff(foot[..., 0]).sum() == pytest.approx(3.0, rel=1e-12)
    assert polygons.area(hole) == pytest.approx(-0.25, rel=1e-12)


def test_a_case_from_a_mesh_needs_the_file_no_more(tmp_path: Path) -> None:
    plate(tmp_path / "cell.msh")
    found = meshed(tmp_path, 'unit = "1 um"')
    (tmp_path / "cell.msh").unlink()
    assert from_dict(found.resolved()).cells == found.cells


@pytest.mark.parametrize("ending", ["vtk", "vtu", "stl", "inp", "mesh", "xdmf", "ply", "off"])
def test_formats_of_meshio_give_the_same_outline(tmp_path: Path, ending: str, capfd: pytest.CaptureFixture) -> None:
    path = written(tmp_path / f"cell.{ending}", np.column_stack([POINTS, np.zeros(35)]))
    capfd.readouterr()
    found = Boundary.of(boundary(str(path)))
    assert [polygons.area(np.array(loop)) for loop in found.loops] == pytest.approx([24.0, -1.0], rel=1e-6)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(("data", "name"), [
    ({"cell_data": {"core": [CORE]}}, "core"), ({"cell_data": {"ref": [CORE + 4.0]}}, "ref=5"),
    ({"cell_sets": {"kern": [np.flatnonzero(CORE)]}}, "kern"),
])
def test_a_nucleus_is_a_set_of_cells_or_where_an_array_has_a_value(tmp_path: Path, data: dict, name: str) -> None:
    written(tmp_path / "cell.xdmf", **data) if "cell_data" in data else written(tmp_path / "cell.inp", **data)
    table = boundary(str(next(p for p in tmp_path.iterdir() if p.suffix in (".xdmf", ".inp"))))
    assert polygons.area(np.array(table["regions"][name][0])) == pytest.approx(2.0)


def test_squares_and_triangles_of_second_order_are_divided(tmp_path: Path) -> None:
    squares = [("quad", np.array([(a, a + 1, a + 8, a + 7) for i, j in SQUARES for a in [7 * j + i]]))]
    six = np.array([[0, 0], [2, 0], [0, 2], [1, -0.2], [1, 1], [0, 1.0]])
    curved = [("triangle6", np.array([[0, 1, 2, 3, 4, 5]]))]
    for points, cells, area in ((POINTS, squares, 23.0), (six, curved, 2.2)):
        found = boundary(str(written(tmp_path / "cell.vtk", np.column_stack([points, 0 * points[:, :1]]), cells)))
        assert sum(polygons.area(np.array(loop)) for loop in found["loops"]) == pytest.approx(area, rel=1e-12)


def broken(path: Path, what: str) -> None:
    """A file with which something is wrong."""
    flat, tilted = np.column_stack([POINTS, 0 * X.ravel()]), np.column_stack([POINTS, 0.1 * X.ravel()])
    tri = np.array(TRIANGLES)
    far = np.concatenate([flat, flat + np.array([20.0, 0.0, 0.0])])
    corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0.0]])
    midway = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [1, 0, 0], [0, -2, 0.0]])
    {"tilted": lambda: written(path, tilted), "lines": lambda: written(path, flat, [("line", np.array(FOOT))]),
     "pieces": lambda: written(path, far, [("triangle", np.concatenate([tri, tri + 35]))]),
     "twice": lambda: written(path, flat, [("triangle", np.concatenate([tri, tri[:1]]))]),
     "touching": lambda: written(path, corner, [("triangle", np.array([[0, 1, 2], [0, 3, 4]]))]),
     "torn": lambda: written(path, midway, [("triangle", np.array([[0, 1, 2], [0, 4, 3], [3, 4, 1]]))]),
     "text": lambda: path.write_text("nothing\n" * 9), "empty": lambda: path.write_text(""),
     "none": lambda: None}[what]()


@pytest.mark.parametrize(("what", "message"), [
    ("none", "no such file"), ("text", "cannot be read"), ("empty", "cannot be read"),
    ("tilted", "is not flat: z differs by 0.6 among its triangles"), ("lines", "has no triangles: only line"),
    ("pieces", "the triangles are 2 pieces, not one"), ("twice", "has triangles that overlap, as at (-2.5, 0"),
    ("touching", "the boundary touches itself at (0, 0) um"), ("torn", "do not meet edge to edge"),
])
def test_a_file_that_holds_no_cell_is_refused(tmp_path: Path, what: str, message: str,
                                              capfd: pytest.CaptureFixture) -> None:
    broken(tmp_path / "cell.vtk", what)
    capfd.readouterr()
    with pytest.raises(CaseError) as error:
        meshed(tmp_path, 'unit = "1 um"\ncolour = "red"', "cell.vtk")
    assert message in str(error.value) and "case.toml:" in str(error.value)
    assert "colour: no such key" in str(error.value)  # all mistakes at once
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(("keys", "message"), [
    ('nucleus_region = "cord"\nnucleus = "nucleus"', "the file has no triangles called 'cord'; did you mean 'core'?"),
    ('nucleus_region = "void"\nnucleus = "nucleus"', "no triangle is in the group 'void'"),
    ('nucleus_region = "foot"\nnucleus = "nucleus"', "no triangles called 'foot'; there is 'rest', 'core'"),
    ('nucleus_region = "rest"\nnucleus = "nucleus"', "'rest' reaches the surface; a nucleus lies within"),
    ('nucleus_region = "core"', "a nucleus has a material, too"), ('nucleus = "nucleus"', "nucleus_region is missing"),
    ('nucleus_ratio = 0.3', "no such key"),
    ('[[supports]]\nname = "held"\nparts = ["fot"]', "'A' has no part 'fot'; did you mean 'foot'?"),
])
def test_names_that_a_mesh_does_not_have_are_mistakes_of_the_case(tmp_path: Path, keys: str, message: str) -> None:
    plate(tmp_path / "cell.msh")
    with pytest.raises(CaseError) as error:
        meshed(tmp_path, f'unit = "1 um"\n{keys}')
    assert message in str(error.value)


def test_a_file_has_a_unit(tmp_path: Path) -> None:
    plate(tmp_path / "cell.msh")
    with pytest.raises(CaseError, match=r'unit: missing: .* such as unit = "1 um"'):
        meshed(tmp_path, "")


# ------------------------------------------------------------------------------------------- outlines from pictures

T = np.linspace(0.0, 2.0 * np.pi, 1500, endpoint=False)
RADIUS = 5 + 0.6 * np.cos(2 * T + 0.3) + 0.35 * np.cos(3 * T) + 0.2 * np.sin(5 * T)
SMOOTH = RADIUS[:, None] * np.column_stack([np.cos(T), np.sin(T)])


def pixels(size: float) -> np.ndarray:
    """The outline of the pixels whose middles are inside SMOOTH, along their edges."""
    k = np.arange(-8.0, 8.0, size)
    x, y = np.meshgrid(k + 0.5 * size, k + 0.5 * size)
    filled = polygons.inside(np.column_stack([x.ravel(), y.ravel()]), SMOOTH).reshape(x.shape)
    after = {}
    for i, j in np.argwhere(filled):
        for start, end, beyond in (((i, j), (i, j + 1), (i - 1, j)), ((i, j + 1), (i + 1, j + 1), (i, j + 1)),
                                   ((i + 1, j + 1), (i + 1, j), (i + 1, j)), ((i + 1, j), (i, j), (i, j - 1))):
            if not filled[beyond]:
                after[start] = end
    loop = [next(iter(after))]
    while (at := after[loop[-1]]) != loop[0]:
        loop.append(at)
    return size * np.array(loop)[:, ::-1] - 8.0


NOISE = np.random.default_rng(1).standard_normal((1500, 2))
# Name: corners, whose length is up to twice that of the surface.
ROUGH = {"fine": SMOOTH, "twice closed": np.concatenate([SMOOTH, SMOOTH[:1], SMOOTH[:1]]),
         "noisy": SMOOTH[::4] + 0.02 * NOISE[::4], "loud": SMOOTH * (1.0 + 0.006 * NOISE[:, :1]),
         "pixels": pixels(0.05), "coarse pixels": pixels(0.1)}


@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("name", ROUGH)
def test_rough_outlines_get_particles_evenly_and_a_nucleus(name: str, clockwise: bool) -> None:
    corners = ROUGH[name]
    shape = laws("shape")["polygon"](corners=tuple(map(tuple, corners[:: -1 if clockwise else 1].tolist())),
                                     nucleus_ratio=0.3)
    layout, h = shape.particles(400), np.sqrt(shape.area / 400)
    ring = layout.X[layout.surface]
    sides = polygons.sides(ring) / h
    assert 0.95 < sides.min() and sides.max() < 1.15  # measured 1.00 to 1.10
    assert len(ring) == pytest.approx(71, abs=3)  # as the smooth outline has, although that of pixels is 27 % longer
    assert polygons.area(ring) == pytest.approx(shape.area, rel=0.01)
    assert shape.area == pytest.approx(polygons.area(SMOOTH), rel=0.01)
    assert layout.nucleus.sum() / 400 == pytest.approx(0.09, rel=0.1)
    assert np.linalg.norm(layout.X[layout.nucleus] - polygons.centroid(SMOOTH), axis=1).max() < 0.4 * 5.0


@pytest.mark.parametrize(("name", "count", "error"), [("outline", 400, 0.03), ("outline", 1000, 0.01),
                                                     ("mesh", 400, 0.02), ("mesh", 1000, 0.008)])
def test_the_outline_of_a_nucleus_runs_between_rows_of_particles(name: str, count: int, error: float) -> None:
    found = case(name, per_cell=count)
    t, shape = discretise(found).templates[0], found.cells[0].shape
    area = shape.nucleus_ratio**2 * shape.area
    assert t.V[t.nucleus].sum() == pytest.approx(area, rel=error)  # measured 0.024, 0.0067; 0.014, 0.0058
    outline = polygons.joined(shape._nucleus)
    assert (polygons.inside(t.X, outline) == t.nucleus).all()
    assert polygons.distance(t.X, outline).min() > 0.3 * t.spacing  # measured 0.33
    others = np.delete(t.V, t.surface) / t.spacing**2
    assert 0.6 < others.min() and others.max() < 1.5  # measured 0.63 to 1.45


@pytest.mark.parametrize(("name", "grown", "moved"), [("outline", 2.5, 0.14), ("mesh", 1.9, 0.08)])
def test_a_cell_from_a_file_attaches_spreads_and_crawls_if_it_protrudes(name: str, grown: float, moved: float) -> None:
    def after(*sets: str) -> tuple[float, float]:
        with built(case(name, *sets, per_cell=150)) as sim:
            start = sim.sample()[0][1]
            sim.go(40.0)
            (_, cell), ledger = sim.sample()
            assert ledger["closure"] < 0.01  # measured 0.0034
            return cell["substrate_contact_um"] - start["substrate_contact_um"], cell["ux_um"]

    contact, way = after()
    _, still = after("protrusion.cells=[]")
    assert contact > grown and way > moved and abs(still) < 1e-12  # measured 2.98, 0.17; 2.24, 0.10; 1e-16
