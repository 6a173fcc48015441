"""Layouts without chance: ties are shared, first points, senses, orders and processors change no more than rounding."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from scenes import CASES, built, case, everywhere
from scipy.spatial import Delaunay, cKDTree

from cellmig.case.load import from_dict
from cellmig.case.registry import laws
from cellmig.geometry import polygons
from cellmig.geometry.delaunay import areas, triangles
from cellmig.geometry.disc import Disc, Layout
from cellmig.meshfree import rkpm
from cellmig.solve.start import discretise

pytestmark = pytest.mark.serial

MIRROR = np.array([-1.0, 1.0])
# What numpy leaves out on a processor without AVX-512; on one that has none anyway this changes nothing.
OLDER = "AVX512F,AVX512CD,AVX512_SKX,AVX512_CLX,AVX512_CNL,AVX512_ICL"


def everything(tri: np.ndarray) -> np.ndarray:
    return np.ones(len(tri), bool)


def moved(sim: Any, until: float) -> tuple[np.ndarray, np.ndarray]:
    """Places and displacements of all particles (size, 2) at a time [µm]."""
    sim.go(until)
    return sim.scene.X, everywhere(sim, sim.mechanics.state.owned[:, :2])


def images(X: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Of each of the points (n, 2) the number of the other one that is in its place (n,)."""
    away, at = cKDTree(others).query(X)
    assert away.max() < 1e-6 and len(np.unique(at)) == len(X)
    return at


# ------------------------------------------------------------------------------------------------------------ ties


def test_both_diagonals_of_four_points_on_a_circle_have_half() -> None:
    X = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    tri, share = triangles(X, everything)
    assert share @ areas(X, tri) == pytest.approx(1.0, abs=1e-15)
    V, edges = rkpm.dual_cells(X, np.array([[0, 1], [1, 2], [2, 3], [3, 0]]))
    assert V == pytest.approx(np.full(4, 0.25), abs=1e-15) and len(edges) == 6


@pytest.mark.parametrize("turn", [0.0, 1e-9, 0.3])
@pytest.mark.parametrize("corners", [5, 6, 8])
def test_all_corners_of_a_regular_polygon_have_the_same_volume(corners: int, turn: float) -> None:
    a = turn + 2.0 * np.pi * np.arange(corners) / corners
    X, ring = np.column_stack([np.cos(a), np.sin(a)]), np.arange(corners)
    V, edges = rkpm.dual_cells(X, np.column_stack([ring, np.roll(ring, -1)]))
    assert V == pytest.approx(np.full(corners, polygons.area(X) / corners), rel=1e-14)  # measured 4e-16
    assert len(edges) == corners * (corners - 1) // 2


def test_points_of_which_no_four_are_on_a_circle_have_their_delaunay_triangles() -> None:
    X = np.random.default_rng(1).uniform(size=(200, 2))
    tri, share = triangles(X, everything)
    assert (share == 1.0).all()
    assert {frozenset(t) for t in tri.tolist()} == {frozenset(t) for t in Delaunay(X).simplices.tolist()}


@pytest.mark.parametrize(("name", "sets"), [("one_cell", ()), ("all_protrude", ("protrusion.cells=[]",))])
def test_what_is_symmetric_stays_symmetric(name: str, sets: tuple[str, ...]) -> None:
    with built(case(name, 'time.step="2 ns"', *sets, per_cell=331)) as sim:
        X, u = moved(sim, 3.0)
        right, *_, left = sim.sample()[0][1:] if name == "all_protrude" else 2 * sim.sample()[0][1:]
    X = X - [X[:, 0].mean(), 0.0]
    for column in ("sigma11_lower_centre_pa", "effective_stress_pa", "substrate_contact_um"):
        assert right[column] == pytest.approx(left[column], rel=1e-9)  # measured 1e-10, of a small stress
    # measured 4e-15 and 1e-14; with one diagonal of four points on a circle it was 2e-5
    assert np.abs(u * MIRROR - u[images(X * MIRROR, X)]).max() < 1e-12 and np.abs(u).max() > 0.1


@pytest.mark.parametrize("turn", [1e-9, 0.7])
def test_a_turned_layout_moves_as_the_other_does(turn: float, monkeypatch) -> None:
    """A disc that stretches, alone in space: in any direction the same."""
    c, s = np.cos(turn), np.sin(turn)
    R = np.array([[c, -s], [s, c]])

    def found(turned: bool) -> tuple[np.ndarray, np.ndarray]:
        rate = np.array([[0.02, 0.01], [0.0, -0.02]])
        rate = R @ rate @ R.T if turned else rate
        tree = case("one_cell", 'time.step="3 ns"', per_cell=150).resolved()
        tree.pop("adhesion"), tree.pop("protrusion", None)
        tree["cells"][0]["velocity_gradient"] = [[f"{x!r} /us" for x in row] for row in rate.tolist()]
        with built(from_dict(tree)) as sim:
            X, u = moved(sim, 1.0)
            return X - sim.scene.centre[0], u

    X, u = found(False)
    plain = Disc.particles

    def particles(self: Disc, *arguments: Any) -> Layout:
        layout = plain(self, *arguments)
        return layout._replace(X=layout.X @ R.T)

    monkeypatch.setattr(Disc, "particles", particles)
    Y, w = found(True)
    # measured 2e-14; places are rounded to 3e-14
    assert np.abs(u @ R.T - w[images(X @ R.T, Y)]).max() < 1e-12 and np.abs(u).max() > 0.05


def test_a_probe_between_mirror_images_weighs_them_alike() -> None:
    t = discretise(case("one_cell")).templates[0]
    for point in np.array([[0.0, 0.31], [0.0, -2.2], [0.4, 1.0]]):
        weights = [np.zeros(len(t.X)), np.zeros(len(t.X))]
        for weight, place in zip(weights, (point, point * MIRROR), strict=True):
            on, values = rkpm.interpolation(t.X, place)
            weight[on] = values
        assert np.abs(weights[0] - weights[1][images(t.X * MIRROR, t.X)]).max() < 1e-13  # measured 3e-16
        assert weights[0] @ t.X == pytest.approx(point, abs=1e-13)  # measured 1e-16


# -------------------------------------------------------------------------------------------------------- outlines


def smooth(n: int, flat: bool = False) -> np.ndarray:
    """A cell without corners, of n points; with a flat sole if wanted."""
    a = 2.0 * np.pi * np.arange(n) / n
    r = 5.0 * (1.0 + 0.15 * np.cos(2 * a + 0.4) + 0.08 * np.cos(3 * a + 2.0))
    p = r[:, None] * np.column_stack([np.cos(a), np.sin(a)])
    return np.column_stack([p[:, 0], np.maximum(p[:, 1], -3.0 if flat else -9.0)])


def stairs(n: int = 400) -> np.ndarray:
    """The same, by pixels of a quarter of a micrometre."""
    grid = np.round(4.0 * smooth(n)) / 4.0
    grid = grid[(grid != np.roll(grid, 1, axis=0)).any(axis=1)]
    pairs = [(p, [q[0], p[1]]) for p, q in zip(grid.tolist(), np.roll(grid, -1, axis=0).tolist(), strict=True)]
    corners = np.array([point for pair in pairs for point in pair])
    return corners[polygons.distinct(corners)]


HALF = smooth(90)[smooth(90)[:, 0] > 0.3]
HALF = HALF[np.argsort(np.arctan2(HALF[:, 1], HALF[:, 0]))]
OUTLINES = {"smooth": smooth(60), "flat sole": smooth(120, True), "pixels": stairs(),
            "symmetric": np.concatenate([HALF, HALF[::-1] * MIRROR]),
            "dodecagon": 5.0 * np.roll(polygons.circle(12), 3, axis=0),  # it turns by 30° in every corner
            "corners": np.array([[-4.0, -3.0], [5.0, -3.0], [5.5, 0.5], [1.0, 4.0], [0.0, 1.0], [-5.0, 2.0]])}


def laid_out(corners: np.ndarray, count: int = 200, **more: Any) -> Layout:
    return laws("shape")["polygon"](corners=tuple(map(tuple, corners.tolist())), **more).particles(count)


@pytest.mark.parametrize("name", OUTLINES)
@pytest.mark.parametrize("more", [{}, {"nucleus_ratio": 0.35}, {"nucleus_ratio": 0.15}], ids=["", "core", "small core"])
def test_first_point_and_sense_of_an_outline_do_not_matter(name: str, more: dict) -> None:
    p = OUTLINES[name]
    expected = laid_out(p, **more)
    for other in (np.roll(p, 1, axis=0), np.roll(p, len(p) // 2, axis=0), p[::-1], np.roll(p[::-1], 5, axis=0)):
        found = laid_out(other, **more)
        for a, b in ((found.X, expected.X), (found.nucleus, expected.nucleus), (found.surface, expected.surface)):
            assert np.array_equal(a, b)


@pytest.mark.parametrize("name", OUTLINES)
@pytest.mark.parametrize("count", [150, 201])
@pytest.mark.parametrize("more", [{}, {"nucleus_ratio": 0.35}, {"nucleus_ratio": 0.15}], ids=["", "core", "small core"])
def test_a_mirrored_outline_has_the_mirrored_layout(name: str, count: int, more: dict) -> None:
    p = OUTLINES[name]
    a, b = laid_out(p, count, **more), laid_out(p * MIRROR, count, **more)
    at = images(a.X * MIRROR, b.X)
    assert np.abs(a.X * MIRROR - b.X[at]).max() < 1e-12  # measured 6e-14
    assert np.array_equal(a.nucleus, b.nucleus[at])
    if name in ("symmetric", "dodecagon"):
        assert np.abs(a.X * MIRROR - a.X[images(a.X * MIRROR, a.X)]).max() < 1e-12  # measured 6e-14


def test_names_of_edges_stay_those_of_the_corners_as_given() -> None:
    p = OUTLINES["corners"]
    for corners in (p, np.roll(p, 2, axis=0), p[::-1]):
        layout = laid_out(corners)
        for k, (start, end) in enumerate(zip(corners, np.roll(corners, -1, axis=0), strict=True), 1):
            on = layout.parts[f"edge-{k}"]
            ends = layout.X[np.concatenate([layout.surface[on], layout.surface[layout.next[on]]])]
            length = np.linalg.norm(end - start)
            assert np.abs(polygons.cross(end - start, ends - start)).max() < 1e-12 * length**2  # measured 1e-16
            assert polygons.sides(layout.X[layout.surface])[on].sum() == pytest.approx(length, rel=1e-12)


def test_points_of_a_circle_are_exact_mirror_images_from_the_lowest_one() -> None:
    for n in (3, 8, 12, 137, 2000):
        p = polygons.circle(n)
        assert np.array_equal(p[0], [0.0, -1.0]) and polygons.area(p) > 0.0
        assert np.array_equal(p[1:], p[:0:-1] * MIRROR)
        assert np.abs(np.hypot(*p.T) - 1.0).max() < 1e-14  # measured 1e-15


# ------------------------------------------------------------------------------------------------ processors and orders


def test_layouts_have_the_same_bits_on_an_older_processor(outside_mpi: dict[str, str]) -> None:
    program = """if True:
        import hashlib, sys
        import numpy as np
        import cellmig
        from cellmig.solve.start import discretise
        for name in ("one_cell", "outline", "strip_with_hole"):
            scene = discretise(cellmig.load(f"{sys.argv[1]}/{name}.toml", ["particles.per_cell=150"]))
            digest = hashlib.sha256(scene.X.tobytes())
            for c in range(len(scene.kind)):
                digest.update(scene.surface(c).tobytes())
            print(digest.hexdigest())
    """
    command = [sys.executable, "-c", program, str(CASES["one_cell"].parent)]
    found = [subprocess.run(command, env=outside_mpi | env, capture_output=True, text=True, check=True).stdout
             for env in ({}, {"NPY_DISABLE_CPU_FEATURES": OLDER})]
    assert found[0] == found[1] and len(found[0].split()) == 3


@pytest.mark.parametrize("bystander", [False, True])
def test_the_order_of_cells_in_the_file_changes_nothing_but_rounding(bystander: bool) -> None:
    def cell(name: str, x: float) -> dict:
        return disc | {"name": name, "centre": [f"{x} um", "5.01 um"]}

    def run(cells: list[dict]) -> np.ndarray:
        with built(from_dict(tree | {"cells": cells})) as sim:
            _, u = moved(sim, 0.3)
            return u[sim.scene.cell == [c["name"] for c in cells].index("A")]

    tree = case("paper", 'time.step="2 ns"', 'protrusion.cells=["Cell-1"]', per_cell=60).resolved()
    disc = tree["cells"][0] | {"repeat": [1], "pitch": []}
    tree["protrusion"]["cells"] = ["A"]
    a, b = cell("A", -5.005), cell("B", 5.005)
    expected = run([a, b])
    assert np.abs(expected).max() > 0.001
    # measured 2e-16
    assert np.abs(run([cell("C", 25.0), a, b] if bystander else [b, a]) - expected).max() < 1e-12
