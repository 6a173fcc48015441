"""Contact of triangles in C: what the pieces in Python say."""

from __future__ import annotations

import ctypes
import dataclasses

import numpy as np
import pytest
from polyhedra import Contact, blocks, relief, sphere
from samples import assert_close
from scenes import example
from scipy.spatial.transform import Rotation

from cellmig.geometry.polyhedra import Polyhedron
from cellmig.kernel.codegen import Translator
from cellmig.kernel.source import text_of
from cellmig.kernel.terms import SURFACE_TERMS
from cellmig.kernel.toolchain import compiled
from cellmig.model.polyhedra import PolyhedronAdhesion
from cellmig.model.seifert import BetweenCells
from cellmig.model.triangles import TriangleBonds

pytestmark = pytest.mark.serial

LAW = BetweenCells(**dataclasses.asdict(dataclasses.replace(example("adhesion", "seifert"), cutoff=0.5)))
TERM = PolyhedronAdhesion(TriangleBonds(LAW))
ALL_PAIRS = """
/* Pieces of n triangles T near a surface x, and what acts on them where both are at `T_now` and `x_now`, to first order
 * about what it is at `T_then` and `x_then`. */
double run(const double *law, double within, double smooth, long n, const double *T, double *force_on_T,
           const double *area, const double *x, double *force, long faces, const int *face, long edges, const int *edge,
           long vertices, const int *first, const int *ring, double *energy, const double *T_then,
           const double *x_then, const double *T_now, const double *x_now)
{
    Pieces found = {0}, acting = {.action = aligned_alloc(sizeof(v4), sizeof(Beside))};
    FacePieces on_faces = {.change = 1, .of = &acting};
    Lines lines = {.change = 1, .of = &acting};
    Points points = {.change = 1, .of = &acting};
    double pierced = 0;
    for (long t = 0; t < n; t++) {
        const double *of[3] = {T + 9 * t, T_then + 9 * t, T_now + 9 * t};
        double *f = force_on_T + 12 * t;
        Triangle at[3];
        for (int k = 0; k < 3; k++) {
            at[k] = (Triangle){law, within, smooth, area[t], {of[k], of[k] + 3, of[k] + 6}, {{0}}, {f, f + 4, f + 8},
                               energy};
            set_sides(at + k);
        }
        const Ball ball = ball_around(at);
        for (long k = 0; k < faces; k++) {
            const int *m = face + 3 * k;
            double *on[3] = {force + 4 * m[0], force + 4 * m[1], force + 4 * m[2]};
            Face here[3];
            const double *places[3] = {x, x_then, x_now};
            for (int j = 0; j < 3; j++) {
                const double *of[3] = {places[j] + 3 * m[0], places[j] + 3 * m[1], places[j] + 3 * m[2]};
                set_face(here + j, of);
            }
            found.used = 0;
            over_face(at, here, &found, &pierced);
            wait_over_face(at + 1, here + 1, found.on, found.used, 0, &on_faces);
            add_over_faces(&on_faces);
            act_over_face(over_face_of(&acting, 0), at + 2, here + 2, on);
        }
        at[2].energy = energy + 1;
        for (long k = 0; k < edges; k++) {
            const int *m = edge + 4 * k;
            const double *of[4] = {x + 3 * m[0], x + 3 * m[1], x + 3 * m[2], x + 3 * m[3]};
            const double *of_then[2] = {x_then + 3 * m[0], x_then + 3 * m[1]};
            const double *of_now[2] = {x_now + 3 * m[0], x_now + 3 * m[1]};
            double *on[2] = {force + 4 * m[0], force + 4 * m[1]};
            Edge3 here;
            set_edge(&here, of);
            found.used = 0;
            beside_edge3(at, &here, &found);
            wait_beside_edge(at + 1, of_then, found.on, found.used, 0, &lines);
            add_beside_edges(&lines);
            act_beside_edge(beside_of(&acting, 0), at + 2, of_now, on);
        }
        at[2].energy = energy + 2;
        for (long k = 0; k < vertices; k++) {
            const double *around[MOST_SPOKES];
            for (int j = first[k]; j < first[k + 1]; j++) around[j - first[k]] = x + 3 * ring[j];
            Vertex here;
            set_vertex(&here, x + 3 * k, around, first[k + 1] - first[k]);
            found.used = 0;
            beside_vertex3(at, &ball, &here, &found);
            wait_beside_vertex(at + 1, x_then + 3 * k, found.on, found.used, 0, &points);
            add_beside_vertices(&points);
            act_beside_vertex(beside_of(&acting, 0), at + 2, x_now + 3 * k, force + 4 * k);
        }
    }
    free(found.on);
    free(acting.action);
    return pierced;
}
"""


class InC:
    """The same as `Contact`, in C."""

    def __init__(self) -> None:
        t = Translator(TERM, "double")
        term, parts = next(s for s in SURFACE_TERMS if "face_kind" in s.methods), []
        for name, results in term.methods.items():
            t.number = "v4" if name in term.in_fours else "double"
            parts.append(t.function(name, f"contact_{name}", results))
        names = "pieces", "polyhedra", "wedges", "cones", "actions", "faces", "lines", "points"
        files = [text_of(f"{name}.h") for name in names]
        source = "\n".join([text_of("simd.h"), *parts, *files, ALL_PAIRS])
        self.library, self.law = ctypes.CDLL(str(compiled(source))), np.array(t.vector())
        self.library.run.restype = ctypes.c_double

    def __call__(self, T: np.ndarray, x: np.ndarray, surface: Polyhedron, since: tuple | None = None,
                 linear: bool = False) -> tuple[int, np.ndarray, ...]:
        """Pieces are of T and x, or of those `since` which they serve; so is what acts, if `linear`, to first order."""
        area = 0.5 * np.linalg.norm(np.cross(T[:, 1] - T[:, 0], T[:, 2] - T[:, 0]), axis=1)
        first = np.concatenate([[0], np.cumsum([len(ring) for ring in surface.rings])]).astype(np.int32)
        lists = surface.faces, surface.edges, np.concatenate(surface.rings)
        faces, edges, ring = (np.array(a, np.int32) for a in lists)
        on_T, on_x, energy = np.zeros((len(T), 3, 4)), np.zeros((len(x), 4)), np.zeros(3)
        T = np.ascontiguousarray(T)
        x = np.ascontiguousarray(x)
        then = [np.ascontiguousarray(a) for a in since or (T, x)]
        acting = then if linear else [T, x]

        def at(a: np.ndarray) -> ctypes.c_void_p:
            return ctypes.c_void_p(a.ctypes.data)

        number, length = ctypes.c_double, ctypes.c_long
        pierced = self.library.run(at(self.law), number(LAW.cutoff), number(LAW.cap), length(len(T)), at(then[0]),
                                   at(on_T), at(area), at(then[1]), at(on_x), length(len(faces)), at(faces),
                                   length(len(edges)), at(edges), length(len(x)), at(first), at(ring), at(energy),
                                   *map(at, acting), at(T), at(x))
        return pierced, on_T[..., :3], on_x[:, :3], energy


@pytest.fixture(scope="module")
def in_c() -> InC:
    return InC()


def triangles(n: int, low: list[float], high: list[float]) -> np.ndarray:
    """Triangles of 0.1 to 0.3 µm in any position between two corners of a box [µm]."""
    rng = np.random.default_rng(8)
    T = rng.uniform(0.05, 0.2, (n, 1, 1)) * np.array([[1.0, 0.0, 0.0], [-0.5, 0.9, 0.0], [-0.5, -0.9, 0.1]])
    turned = np.einsum("nij,nkj->nki", Rotation.random(n, random_state=3).as_matrix(), T)
    return turned + rng.uniform(low, high, (n, 1, 3))


@pytest.mark.parametrize(("surface", "low", "high"), [
    (blocks([(0, 0, 0)]), [0.7, 0.7, 1.2], [1.3, 1.3, 1.4]),
    (blocks([(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1) if (i, j, k) != (1, 1, 1)], 0.5),
     [0.7, 0.7, 0.7], [1.2, 1.2, 1.2]),
    (relief(0.1 * np.random.default_rng(1).standard_normal((4, 4)), 0.5), [-0.5, -0.5, 0.3], [0.5, 0.5, 0.6])],
    ids=["cube", "notched cube", "relief"])
def test_contact_in_c_is_that_of_the_pieces(in_c: InC, surface: tuple, low: list, high: list) -> None:
    T, (x, faces) = triangles(25, low, high), surface
    expected = Contact(TERM, T, x, Polyhedron.of(faces))
    pierced, on_T, on_x, energy = in_c(T, x, Polyhedron.of(faces))
    assert not pierced and all(expected.pieces.values())
    assert energy == pytest.approx(list(expected.energy.values()), rel=1e-12)  # measured 7e-15
    assert_close(on_T, expected.force_on_T, 1e-10)  # measured 1e-12
    assert_close(on_x, expected.force_on_x, 1e-10)  # measured 1e-13


def test_a_long_triangle_has_the_energy_of_its_parts(in_c: InC) -> None:
    """Triangles with one side along a sharp edge: most of them is within a hundredth of the directions."""
    rng, T = np.random.default_rng(2), []
    x = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 1.0, 0.04], [0.5, 1.0, -0.04]])
    surface = Polyhedron.of(np.array([[0, 1, 2], [1, 0, 3], [0, 2, 3], [1, 3, 2]]))  # a blade
    for _ in range(60):
        near, tip = rng.uniform(-0.03, 0.03), rng.uniform(1.3, 1.9)  # angles from the normal of its upper face
        r = [length * np.array([0.0, -np.sin(angle), np.cos(angle)]) for length, angle in ((0.015, near), (0.45, tip))]
        T.append(np.add([r[0], r[0], r[1]], [[0.3, 0.0, 0.0], [0.5, 0.0, 0.0], [0.4, 0.0, 0.0]]))
    for t in np.array(T):
        middle = 0.5 * (t + np.roll(t, -1, axis=0))
        parts = np.array([[t[0], middle[0], middle[2]], [middle[0], t[1], middle[1]], [middle[2], middle[1], t[2]],
                          [middle[1], middle[2], middle[0]]])
        whole, apart = (in_c(some, x, surface)[-1].sum() for some in (t[None], parts))
        assert whole == pytest.approx(apart, rel=1e-4)  # measured 6e-6; 0.81 where strips were judged by distances


def test_triangles_on_a_border_of_two_features_are_counted_once(in_c: InC) -> None:
    """Blocks face to face, of which all corners, edges and sides are level: their energy is that of any neighbour."""
    (x, faces), gap = blocks([(0, j, k) for j in range(3) for k in range(3)], 0.5), 0.02
    surface, energies = Polyhedron.of(faces), []
    for shift in ([0.0, 0.0, 0.0], [0.0, 1e-8, 0.0], [0.0, -1e-8, 2e-8]):
        other = x + np.array([0.5 + gap, 0.5, 0.0]) + shift
        energies.append(in_c(other[faces], x, surface)[-1].sum())
    assert energies[0] < -1.0  # pN µm; measured -84
    assert energies[1:] == pytest.approx(2 * [energies[0]], rel=1e-6)  # measured 1e-8; 0.04 without SKEW


def heights(x: np.ndarray, faces: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Height (n,) of a surface without overhangs above places (n, 2) [µm]."""
    a, b, c = x[faces].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    a, b, c, normal = (v[normal[:, 2] > 0.0] for v in (a, b, c, normal))
    inside = np.ones((len(at), len(a)), bool)
    for p, q in ((a, b), (b, c), (c, a)):
        side, from_p = (q - p)[None, :, :2], at[:, None] - p[None, :, :2]
        inside &= side[..., 0] * from_p[..., 1] - side[..., 1] * from_p[..., 0] >= -1e-12
    z = a[:, 2] - ((at[:, None] - a[None, :, :2]) * (normal[:, :2] / normal[:, 2:])).sum(axis=2)
    return np.where(inside, z, -np.inf).max(axis=1)


def test_the_potential_of_a_rugged_surface_has_the_gradient_that_it_says_everywhere(in_c: InC) -> None:
    """Along paths close above faces, edges that turn by up to 86 degrees, peaks, pits and saddles."""
    rng = np.random.default_rng(4)
    x, faces = relief(0.13 * rng.standard_normal((5, 5)), 0.5)
    surface, size = Polyhedron.of(faces), 1e-6
    assert max(map(len, surface.rings)) <= 9
    per_area = 0.5 * LAW.bond_density * 0.5 * np.sqrt(3.0) * size**2
    for turn in rng.uniform(0.0, np.pi, 8):
        along = np.linspace(-0.8, 0.8, 400)[:, None] * [np.cos(turn), np.sin(turn)]
        way = np.column_stack([along, heights(x, faces, along) + 0.03])
        found = [in_c((p + size * np.eye(3))[None], x, surface) for p in way]
        potential = np.array([energy.sum() for *_, energy in found]) / per_area
        slope = -np.array([on_T[0].sum(axis=0) for _, on_T, *_ in found]) / per_area
        expected = (0.5 * (slope[1:] + slope[:-1]) * np.diff(way, axis=0)).sum(axis=1)
        assert np.abs(np.diff(potential) - expected).max() < 0.01 * LAW.well_depth  # measured 6e-3, of the steps


def near_and_moved() -> tuple:
    """Triangles 10 nm above a rugged surface, its points and the surface, and ways for both to move."""
    x, faces = relief(0.05 * np.random.default_rng(1).standard_normal((4, 4)), 0.5)
    rng, T = np.random.default_rng(5), triangles(60, [-0.5, -0.5, 0.2], [0.5, 0.5, 0.4])
    over = T[..., 2] - heights(x, faces, T.reshape(-1, 3)[:, :2]).reshape(-1, 3)
    T[..., 2] += (0.01 - over.min(axis=1))[:, None]
    return T, x, Polyhedron.of(faces), (rng.uniform(-1.0, 1.0, T.shape), rng.uniform(-1.0, 1.0, x.shape))


def test_pieces_that_serve_leave_forces_in_balance_and_an_energy_right_to_first_order(in_c: InC) -> None:
    """Of two surfaces whose points move in any direction by up to 0.5, 1 and 2 nm, at gaps of 10 nm and more."""
    (T, x, surface, moves), errors = near_and_moved(), []
    for move in (5e-4, 1e-3, 2e-3):
        now = [a + move * way for a, way in zip((T, x), moves, strict=True)]
        _, on_T, on_x, served = in_c(*now, surface, since=(T, x))
        _, expected, _, found = in_c(*now, surface)
        place, force = np.concatenate([now[0].reshape(-1, 3), now[1]]), np.concatenate([on_T.reshape(-1, 3), on_x])
        largest = np.abs(force).max()
        assert largest > 1.0 and np.abs(force.sum(axis=0)).max() < 1e-13 * largest  # measured 2e-15
        assert np.abs(np.cross(place, force).sum(axis=0)).max() < 1e-11 * largest  # measured 6e-12, of SKEW
        assert served.sum() == pytest.approx(found.sum(), rel=1e-5)  # measured 1.4e-6, and 2e-8 at 0.5 nm
        errors.append(np.abs(on_T - expected).max() / largest)
    assert errors[0] < 0.6 * errors[1] < 0.36 * errors[2] < 4e-4  # measured 6e-5, 1.2e-4, 2.6e-4


def test_what_acts_follows_moves_to_first_order_and_stays_in_balance(in_c: InC) -> None:
    """Of a rugged surface and triangles near it, whose points move in any direction by up to 0.05, 0.1 and 0.2 nm."""
    (T, x, surface, moves), errors = near_and_moved(), []
    for move in (5e-5, 1e-4, 2e-4):
        now = [a + move * way for a, way in zip((T, x), moves, strict=True)]
        _, on_T, on_x, _ = in_c(*now, surface, since=(T, x), linear=True)
        _, expected, expected_on_x, _ = in_c(*now, surface, since=(T, x))
        place, force = np.concatenate([now[0].reshape(-1, 3), now[1]]), np.concatenate([on_T.reshape(-1, 3), on_x])
        largest = np.abs(force).max()
        assert largest > 1.0 and np.abs(force.sum(axis=0)).max() < 1e-13 * largest  # measured 2e-15
        assert np.abs(np.cross(place, force).sum(axis=0)).max() < 1e-11 * largest  # measured 6e-12, of SKEW
        errors.append(max(np.abs(on_T - expected).max(), np.abs(on_x - expected_on_x).max()) / largest)
    assert errors[0] < 0.3 * errors[1] < 0.09 * errors[2] < 5e-6  # measured 2.7e-6, 1.1e-5, 4.1e-5


def test_two_balls_pull_each_other_as_derjaguin_says(in_c: InC) -> None:
    """F = πRN U(a) where the gap a is much less than R; either ball has half of it, and the sum is zero."""
    gap, radius, top = 0.04, 1.0, np.array([0.0, 0.0, 1.0])
    turn = Rotation.from_rotvec([1.0, 0.4, -0.7]).as_matrix()
    exact, errors = np.pi * radius * LAW.bond_density * LAW.potential(gap), []
    for n in (600, 2000):
        x, faces = sphere(n, radius)
        y, surface = x @ turn.T + [0.0, 0.0, 2.0 * radius + gap], Polyhedron.of(faces)
        upper, lower = (v[faces][np.linalg.norm(v[faces].mean(axis=1) - top, axis=1) < 0.9] for v in (y, x))
        (_, on_upper, on_x, energy), (_, on_lower, on_y, other) = in_c(upper, x, surface), in_c(lower, y, surface)
        force, reaction = on_upper.sum(axis=(0, 1)) + on_y.sum(axis=0), on_lower.sum(axis=(0, 1)) + on_x.sum(axis=0)
        assert np.abs(force + reaction).max() < 1e-12 * np.abs(force).max()  # measured 1e-15
        assert energy.sum() == pytest.approx(other.sum(), rel=1e-3)  # measured 2e-4
        errors.append(force[2] / exact - 1.0)
    assert -0.3 < errors[0] < 2.5 * errors[1] < 0.0 and errors[1] > -0.08  # measured -0.23 and -0.057; 4,000: -0.011


def test_a_triangle_through_a_face_is_told(in_c: InC) -> None:
    x, faces = blocks([(0, 0, 0)])
    T = np.array([[[0.4, 0.4, 0.9], [0.6, 0.4, 1.2], [0.5, 0.6, 1.2]]])
    assert in_c(T, x, Polyhedron.of(faces))[0]
    assert not in_c(T + np.array([0.0, 0.0, 0.2]), x, Polyhedron.of(faces))[0]
