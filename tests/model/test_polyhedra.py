"""Contact between surfaces of triangles: balanced, with a potential, and nothing jumps over edges and vertices."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from polyhedra import Contact, blocks, relief
from samples import assert_close
from scenes import example
from scipy.spatial.transform import Rotation

from cellmig.geometry.polyhedra import Polyhedron
from cellmig.model.polyhedra import PolyhedronAdhesion
from cellmig.model.seifert import BetweenCells
from cellmig.model.triangles import TriangleBonds

pytestmark = pytest.mark.serial

EPS = 0.01
LAW = BetweenCells(**dataclasses.asdict(dataclasses.replace(example("adhesion", "seifert"), cutoff=0.5)))
TERM = PolyhedronAdhesion(TriangleBonds(LAW))
CUBE = blocks([(0, 0, 0)])
NOTCHED = blocks([(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1) if (i, j, k) != (1, 1, 1)], 0.5)
SADDLE = relief(np.array([[0.0, 0.02, 0.1], [0.02, 0.0, 0.12], [0.1, -0.12, 0.0]]), 0.5)
T = np.array([[-0.1, -0.07, 0.02], [0.13, -0.03, 0.0], [0.0, 0.12, 0.0]])
TILTED = (T - T.mean(axis=0)) @ Rotation.from_rotvec([0.2, 0.4, 0.1]).as_matrix().T

# Surface, where T is and how far it goes: nothing of it enters the surface.
PATHS = {"over an edge": (CUBE, [0.8, 0.5, 1.012], [0.4, 0.0, 0.0]),
         "over a corner": (CUBE, [0.8, 0.85, 1.012], [0.4, 0.3, 0.0]),
         "past a corner": (CUBE, [0.8, 0.9, 1.02], [0.4, 0.35, -0.02]),
         "over the rim of a notch": (NOTCHED, [0.3, 0.75, 1.012], [0.4, 0.0, 0.0]),
         "out of the corner of a notch": (NOTCHED, [0.65, 0.65, 0.52], [0.15, 0.12, 0.2]),
         "along a reflex edge past its end": (NOTCHED, [0.64, 0.64, 0.9], [0.02, 0.03, 0.25]),
         "over a saddle of a cube": (NOTCHED, [0.4, 0.4, 1.012], [0.3, 0.3, 0.0]),
         "over a saddle": (SADDLE, [-0.12, -0.1, 0.06], [0.25, 0.2, 0.0])}


def contact(triangle: np.ndarray, surface: tuple) -> Contact:
    return Contact(TERM, triangle[None], surface[0], Polyhedron.of(surface[1]))


@pytest.mark.parametrize("path", PATHS)
def test_energy_and_force_go_on_continuously(path: str) -> None:
    surface, start, way = PATHS[path]
    half, energy, force = 16, [], []
    for share in np.linspace(0.0, 1.0, 2 * half + 1):
        found = contact(T + start + share * np.array(way), surface)
        energy.append(found.total)
        force.append(found.force_on_T[0].sum(axis=0))
    f, e = np.array(force), np.array(energy)
    fine, coarse = (np.abs(np.diff(f[::k], axis=0)).max() for k in (1, 2))
    assert fine < 0.75 * coarse  # measured 0.51 to 0.68; of a jump it would be 1
    # Simpson's rule for the work; measured 1e-3 at most, and 20 times less with half the step
    work = (f[:-2:2] + 4.0 * f[1:-1:2] + f[2::2]) @ np.array(way) / (12.0 * half) * 2.0
    assert np.abs(work + np.diff(e[::2])).max() < 2e-3 * np.ptp(e)


@pytest.mark.parametrize("path", PATHS)
def test_forces_are_in_balance_and_minus_the_gradient(path: str) -> None:
    (x, faces), start, way = PATHS[path]
    corners, surface = T + start + 0.53 * np.array(way), Polyhedron.of(faces)
    found = Contact(TERM, corners[None], x, surface)
    place, force = np.concatenate([corners, x]), np.concatenate([found.force_on_T[0], found.force_on_x])
    largest = np.abs(force).max()
    assert largest > 0.01 and np.abs(force.sum(axis=0)).max() < 1e-13 * largest  # measured 1e-15
    assert np.abs(np.cross(place, force).sum(axis=0)).max() < 1e-13 * largest  # measured 1e-15

    def energy(at: np.ndarray) -> float:
        # The reference area does not change with the place.
        new, old = (np.linalg.norm(np.cross(t[1] - t[0], t[2] - t[0])) for t in (at[:3], corners))
        return Contact(TERM, at[None, :3], at[3:], surface).total * old / new

    for way_of_all in np.random.default_rng(2).standard_normal((2, *place.shape)) * (force != 0.0):
        step = 1e-5
        near, far = (energy(place + k * step * way_of_all) - energy(place - k * step * way_of_all) for k in (1, 2))
        off = (8.0 * near - far) / (12.0 * step) + (force * way_of_all).sum()
        assert abs(off) < 2e-5 * largest  # measured 7e-6, of Gauss points


def test_a_convex_body_has_the_potential_of_the_distance() -> None:
    """As points all over T have it."""
    n = 400
    i, j = np.meshgrid(np.arange(n) + 0.5, np.arange(n) + 0.5)
    s, t = np.sqrt(i.ravel() / n), j.ravel() / n
    shares = np.column_stack([1.0 - s, s * (1.0 - t), s * t])
    for at in ([0.96, 0.95, 1.06], [1.03, 1.04, 1.0], [0.98, 0.97, 1.08]):
        corners = TILTED + at
        points = shares @ corners
        distance = np.linalg.norm(points - np.clip(points, 0.0, 1.0), axis=1)
        assert distance.min() > 0.2 * EPS
        area = 0.5 * np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
        expected = 0.5 * LAW.bond_density * area * LAW.potential(distance).mean()
        found = contact(corners, CUBE)
        assert found.total == pytest.approx(expected, rel=1e-4)  # measured 2.4e-5, of the points of the test
        assert all(found.pieces.values())


def test_parallel_plates_have_the_energy_of_their_gap() -> None:
    """However their triangles lie; edges of level faces have no wedge."""
    x, faces = relief(np.zeros((4, 4)), 0.5)
    upper = np.stack([T, T[[0, 2, 1]]]) * [1.0, 1.0, 0.0] + [[[0.07, -0.11, 0.0]], [[0.3, 0.2, 0.0]]]
    for gap in (0.8 * EPS, 1.7 * EPS, 0.3):
        found = Contact(TERM, upper + np.array([0.0, 0.0, gap]), x, Polyhedron.of(faces))
        area = sum(0.5 * np.linalg.norm(np.cross(t[1] - t[0], t[2] - t[0])) for t in upper)
        assert found.total == pytest.approx(0.5 * LAW.bond_density * area * LAW.potential(gap), rel=1e-12)
        pull = 0.5 * LAW.bond_density * area * LAW.slope(gap)
        assert found.force_on_x.sum(axis=0) == pytest.approx([0.0, 0.0, pull], rel=1e-10, abs=1e-10 * abs(pull))


def test_the_back_of_a_thin_body_does_not_count() -> None:
    height = 0.02 * np.random.default_rng(6).standard_normal((4, 4))
    corners, found = T + np.array([0.05, 0.1, height.max() + 0.05]), []
    for below in (0.1, 2.0):
        x, faces = relief(height, 0.5, below)
        found.append(Contact(TERM, corners[None], x, Polyhedron.of(faces)))
    thin, thick = found
    assert np.array_equal(thin.force_on_x, thick.force_on_x) and not thin.force_on_x[16:].any()
    assert thin.total == thick.total and thin.pieces["edge"]


def test_the_lines_of_a_wedge_are_integrated_exactly() -> None:
    rng = np.random.default_rng(3)
    x = EPS * 10.0 ** rng.uniform(-0.3, 1.5, 300)
    y = x * (1.0 + 10.0 ** rng.uniform(-4, 1, 300))
    t, w = np.polynomial.legendre.leggauss(30)
    limits = np.geomspace(1.0, 2.0, 41) - 1.0  # of t, finer near x
    t, w = ((limits[:-1, None] + 0.5 * np.diff(limits)[:, None] * (t + 1.0)).ravel(),
            (0.5 * np.diff(limits)[:, None] * w).ravel())
    r = x[:, None] + (y - x)[:, None] * t
    U, slope = LAW.potential(r), LAW.slope(r)
    expected = [(w * f).sum(axis=1) for f in ((1 - t) * U, t * U, (1 - t) ** 2 * slope, t * (1 - t) * slope,
                                              t * t * slope)]
    for found, exact in zip(TERM.moments(x, y), expected, strict=True):
        assert_close(found, exact, 1e-9)  # measured 1e-10


def test_the_stiffness_is_that_of_level_bonds_and_bounds_that_of_others() -> None:
    r = np.linspace(0.9, 1.2, 50) * EPS
    level, = TERM.face_stiffness(0.3, r, r, r)
    for found, in ((level,), TERM.edge_stiffness(0.3, 0.3, r, r), TERM.vertex_stiffness(0.3, r)):
        assert np.interp(EPS, r, found) == pytest.approx(0.3 * LAW.stiffness(EPS), rel=0.01)  # measured 1e-3
    inclined, = TERM.face_stiffness(0.3, r, r + EPS, r + 2.0 * EPS)
    assert (inclined < 0.5 * level.max()).all() and (inclined > 0.0).all()


def test_edges_and_rings_of_a_surface_are_those_of_its_faces() -> None:
    for x, faces in (CUBE, NOTCHED, SADDLE):
        found = Polyhedron.of(faces)
        assert len(x) - len(found.edges) + len(faces) == 2
        assert sum(map(len, found.rings)) == 2 * len(found.edges)
        corners = {tuple(np.roll(face, k)) for face in faces.tolist() for k in range(3)}
        assert all((a, b, c) in corners and (b, a, d) in corners for a, b, c, d in found.edges.tolist())
        assert all((v, a, b) in corners for v, ring in enumerate(found.rings)
                   for a, b in zip(ring, ring[1:] + ring[:1], strict=True))


@pytest.mark.parametrize("piece", ["face", "edge", "vertex"])
def test_tangents_are_what_loads_change_by(piece: str) -> None:
    """Of gaps and distances from 5 nm to the cutoff, nearly equal ones and such as differ several times."""
    rng, n = np.random.default_rng(3), 2000
    least = np.geomspace(0.5 * EPS, 0.9 * LAW.cutoff, n)
    change = 10.0 ** rng.uniform(-4.0, 0.5, (3, n)) * rng.uniform(0.0, 1.0, (3, n))
    places = {"face": 3, "edge": 2, "vertex": 1}[piece]
    sizes = [np.ones(n)] if places == 3 else list(rng.uniform(0.1, 1.0, (places, n)))
    gaps, entries = least * (1.0 + change[:places]), {3: [(0, 0), (1, 1), (2, 2), (1, 2), (2, 0), (0, 1)],
                                                      2: [(0, 0), (0, 1), (1, 1)], 1: [(0, 0)]}[places]
    (found,), h = getattr(TERM, f"{piece}_tangent")(*sizes, *gaps), 1e-3 * least
    expected = np.zeros((places, places, n))
    for j in range(places):
        low, high = gaps.copy(), gaps.copy()
        low[j], high[j] = low[j] - h, high[j] + h
        loads = [np.array(getattr(TERM, piece)(*sizes, *at)[0]) for at in (low, high)]
        expected[:, j] = (loads[1] - loads[0]) / (2.0 * h)
    scale = np.abs(expected).max(axis=(0, 1))
    for row, at in zip(found, entries, strict=True):
        assert (np.abs(row - expected[at]) <= 1e-3 * scale).all()  # measured 3e-4, where U'' jumps
