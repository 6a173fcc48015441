"""Tangents: derivatives of all registered laws by one method, against differences; and of whole scenes."""

from __future__ import annotations

import dataclasses
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from samples import assert_close, deformations, directions, fractions, gradients, networks, rates, slope, vectors
from scenes import BALL, DAMPED, DISC, built, case, everywhere, example, forces, in_petsc, set_motion, smooth
from scipy import sparse
from scipy.optimize import brentq
from scipy.sparse.linalg import eigsh
from scipy.special import spherical_jn
from test_forces import NO_ETA, SCENES, SOFT, approach, deform

from mpi4py import MPI

from cellmig.case.pointwise import pointwise
from cellmig.case.registry import laws
from cellmig.case.schema import Pair
from cellmig.kernel.terms import SURFACE_TERMS
from cellmig.model.adhesion import SegmentBonds
from cellmig.model.cortex import CortexForce
from cellmig.model.membranes import CortexTension
from cellmig.model.triangles import FLAT, NEAR, TriangleBonds
from cellmig.solve.stencils import stencils
from cellmig.solve.stiffness import Stiffness
from cellmig.solve.tangent import Dual, derivative, tangent
from cellmig.verify.exact import Globe
from cellmig.verify.specimens import RAMP, piece

METHODS = ("stress", "viscous_stress", "director_stress", "active_stress")
MATERIALS = [(name, method, by) for name, law in laws("material").items() for method in METHODS
             if hasattr(law, method) for by in ("F", "Fdot")[: 1 + (method == "viscous_stress")]]


# ------------------------------------------------------------------------------------------------------ pointwise


@pytest.mark.serial
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize(("name", "method", "by"), MATERIALS)
def test_tangent_of_a_material_is_the_derivative_of_its_stress(name: str, method: str, by: str, d: int) -> None:
    law = example("material", name)
    given = {"F": deformations(d=d), "Fdot": rates(d=d), "gradient": gradients(d=d), "director": directions(d=d),
             "network": networks(d=d), "share": fractions()}
    found = tangent(law, method, given, by)
    expected = np.zeros_like(found)
    for k, l in np.ndindex(d, d):
        direction = np.zeros((d, d, 1))
        direction[k, l] = 1.0
        expected[:, :, k, l] = slope(
            lambda s, d=direction: np.array(pointwise(law, method, {**given, by: given[by] + s * d})), 0.0, 1e-4)
    assert_close(found, expected, 1e-10)  # measured 2e-12, of the differences


@pytest.mark.serial
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("name", [name for name, method, by in MATERIALS if method == "stress"])
def test_tangent_of_an_energy_is_symmetric(name: str, d: int) -> None:
    A = tangent(example("material", name), "stress", {"F": deformations(d=d)})
    assert_close(A, A.transpose(2, 3, 0, 1, 4), 1e-14)  # measured 4e-16


@pytest.mark.serial
@pytest.mark.parametrize("name", laws("adhesion"))
def test_tangent_of_adhesion_is_the_derivative_of_its_forces(name: str) -> None:
    law = example("adhesion", name)
    eps = law.equilibrium_distance
    mean = SegmentBonds(law).mean
    rng = np.random.default_rng(3)
    g1 = eps * rng.uniform(0.5, 4.0, 400)
    g2 = g1 * np.where(np.arange(400) % 2, rng.uniform(0.97, 1.03, 400), rng.uniform(0.3, 3.0, 400))
    kinks = np.abs(np.abs(g2 - g1) - 0.05 * np.maximum(np.minimum(g1, g2), law.cap)) < 1e-3 * eps
    for kink in (law.cap, law.cutoff):
        kinks |= (np.abs(g1 - kink) < 1e-3 * eps) | (np.abs(g2 - kink) < 1e-3 * eps)
    g1, g2 = g1[~kinks], g2[~kinks]
    found = derivative(lambda a, b: mean(a, b)[1:], g1, g2)[1]
    h = 1e-4 * eps
    expected = np.array([slope(lambda s: np.array(mean(g1 + s, g2)[1:]), 0.0, h),
                         slope(lambda s: np.array(mean(g1, g2 + s)[1:]), 0.0, h)]).transpose(1, 0, 2)
    assert_close(found, expected, 1e-7)  # measured 2e-11, of the differences


@pytest.mark.serial
@pytest.mark.parametrize("name", laws("cortex"))
def test_tangent_of_a_cortex_is_the_derivative_of_its_pull(name: str) -> None:
    force, along, length = CortexForce(example("cortex", name)).force, vectors(), np.linspace(0.5, 2.0, 200)
    found = derivative(lambda edge: force(length, edge)[0], along)[1]
    expected = np.array([slope(lambda s, e=e: np.array(force(length, along + s * e[:, None])[0]), 0.0, 1e-4)
                         for e in np.eye(2)]).transpose(1, 0, 2)
    assert_close(found, expected, 1e-7)  # measured 2e-8, of the differences


@pytest.mark.serial
def test_an_operation_without_a_rule_is_refused() -> None:
    with pytest.raises(TypeError, match="arcsinh"):
        np.arcsinh(Dual(1.0, [1.0]))


# --------------------------------------------------------------------------------------------------- whole scenes


@pytest.mark.serial
@pytest.mark.parametrize("name", laws("adhesion"))
def test_tangent_of_adhesion_of_triangles_is_the_derivative_of_its_forces(name: str) -> None:
    """Gaps that are near each other and not, away from where the mean changes its formula or a knot is."""
    law = example("adhesion", name)
    eps, bonds = law.equilibrium_distance, TriangleBonds(law)
    rng = np.random.default_rng(3)
    gaps = eps * rng.uniform(0.5, 4.0, 400) * np.where(np.arange(400) % 2, rng.uniform(0.999, 1.001, (3, 400)),
                                                       rng.uniform(0.3, 3.0, (3, 400)))
    low, _, high = np.sort(gaps, axis=0)
    near = np.abs(high - low - FLAT * bonds.scale(low)) < 1e-3 * eps
    for a, b in combinations(gaps, 2):
        near |= np.abs(np.abs(a - b) - NEAR * bonds.scale(np.minimum(a, b))) < 1e-3 * eps
    for knot in (law.cap, law.equilibrium_distance, law.cutoff):
        near |= (np.abs(gaps - knot) < 1e-2 * eps).any(axis=0) | ((low < knot) & (knot < high) & (high < 1.1 * low))
    gaps = gaps[:, ~near]
    assert gaps.shape[1] > 200
    found = derivative(lambda *at: bonds.mean(*at)[1:], *gaps)[1]
    expected = np.array([slope(lambda s, e=e: np.array(bonds.mean(*(gaps + s * e[:, None]))[1:]), 0.0, 1e-4 * eps)
                         for e in np.eye(3)]).transpose(1, 0, 2)
    assert_close(found, expected, 1e-7)  # measured 2e-8, of the differences


@pytest.mark.serial
@pytest.mark.parametrize("name", laws("cortex"))
def test_tangent_of_a_cortex_in_space_is_the_derivative_of_its_pull(name: str) -> None:
    force, area = CortexTension(example("cortex", name)).force, np.linspace(0.5, 2.0, 200)
    edges = np.random.default_rng(4).standard_normal((6, 200))
    found = derivative(lambda *x: force(area, x[:3], x[3:]), *edges)[1]
    expected = np.array([slope(lambda s, e=e: np.array(force(area, *np.split(edges + s * e[:, None], 2))), 0.0, 1e-4)
                         for e in np.eye(6)]).transpose(1, 2, 0, 3)
    assert_close(found, expected, 1e-7)  # measured 6e-12


OBLIQUE = {"name": "slope", "point": ["0 um", "1.3 um"], "normal": [0.3, -1.0], "displacement": ["0 um", "0 um"]}
PRESSED = {"loads": [{"name": "p", "pressure": "3 kPa", "load_curve": RAMP}, {
    "name": "t", "traction": ["200*x Pa", "50 Pa"], "load_curve": RAMP}], "plates": [OBLIQUE], "supports": [
        {"name": "low", "box": [["-0.5 um", "-2 um"], ["0.5 um", "-1.3 um"]], "displacement": ["0.1 um", "free"],
         "load_curve": RAMP}]}


IN_SPACE = {"dimension": 3, "loads": [{"name": "p", "pressure": "3 kPa", "load_curve": RAMP}, {
    "name": "t", "traction": ["200*x Pa", "50 Pa", "-30*y Pa"], "load_curve": RAMP}],
    "plates": [{"name": "slope", "point": ["0 um", "0 um", "1.3 um"], "normal": [0.3, 0.2, -1.0]}],
    "supports": [{"name": "low", "box": [["-0.5 um", "-2 um", "-2 um"], ["0.5 um", "2 um", "-1.0 um"]],
                  "displacement": ["0.1 um", "free", "0 um"], "load_curve": RAMP},
                 {"name": "high", "box": [["-0.3 um", "-2 um", "1.0 um"], ["0.6 um", "2 um", "2 um"]],
                  "displacement": ["0 um", "free", "free"], "load_curve": RAMP}]}


@pytest.mark.parametrize(("cell", "tables"), [(DISC, PRESSED), (BALL, IN_SPACE)], ids=["plane", "space"])
def test_tangent_of_a_scene_is_the_derivative_of_its_forces(cell: dict, tables: dict) -> None:
    """Internal force, stabilisation, pressure, a support that moves, an oblique plate: all rows, on any ranks."""
    with built(piece(cell, 150, 2, **tables)) as sim:
        run, m = sim.integrator, sim.mechanics
        X = sim.scene.X[m.ids]
        u, d = smooth(X, 1, 0.04, shortest=1.0), smooth(X, 2, 1.0, shortest=0.3)
        m.loads.set_clock(0.7)

        def residual(s: float) -> np.ndarray:
            run._x.setArray((u + s * d).ravel())
            run._residual(None, run._x, run._r)
            return run._r.getArray().copy()

        expected = slope(residual, 0.0, 1e-6)
        gap = run.plates._nearest()[0]
        assert sim.comm.allreduce(int((gap < 0.0).sum())) > 2
        run._x.setArray(u.ravel())
        run._tangent(None, run._x, run._matrix, run._matrix)
        run._x.setArray(d.ravel())
        run._matrix.mult(run._x, run._r)
        assert_close(run._r.getArray(), expected, 1e-7)  # measured 4e-11


def changed(sim: Any, u: np.ndarray, v: np.ndarray) -> None:
    """Displacements and velocities of the owned particles, lists as they are."""
    m = sim.mechanics
    m.state.owned[:] = np.hstack([u, v])[m.ids]


def applied(sim: Any, d: np.ndarray, by_u: float, by_v: float, *parts: str) -> np.ndarray:
    """The tangent, or that of some terms on surfaces alone, times a field like u, of all ranks."""
    m = sim.mechanics
    m.rate()
    at = np.empty_like(d)
    at[in_petsc(sim)] = d
    stiffness = Stiffness(m)
    K = stiffness.surfaces(by_u, by_v, parts) if parts else stiffness(by_u, by_v)
    return everywhere(sim, (K @ at.ravel()).reshape(-1, d.shape[1]))


BODIES = SCENES | {
    "nucleus in space": lambda: case("ball_nucleus", *DAMPED, *SOFT),
    "director in space": lambda: case("ball_director", *SOFT, 'director.anchoring="none"'),
    "gel in space": lambda: case("bar", "supports=[]", 'materials.gel.reduced_bulk_modulus="3 kPa"'),
}


@pytest.mark.parametrize(("by_u", "by_v"), [(1.0, 0.0), (0.0, 1.0), (3.0, 0.5)])
@pytest.mark.parametrize("name", BODIES)
def test_tangent_of_bodies_is_the_derivative_of_their_forces(name: str, by_u: float, by_v: float) -> None:
    """Stresses of all kinds, both stabilisations, damping; by displacements, by velocities, by both; on any ranks."""
    with built(BODIES[name]()) as sim:
        if by_u == 0.0 and not (sim.terms.stabilised or sim.terms.bulk_damped):
            return
        u, v = deform(sim)
        d = smooth(sim.scene.X, 7, 1.0, shortest=1.0)

        def moved(s: float) -> np.ndarray:
            changed(sim, u + s * by_u * d, v + s * by_v * d)
            return -forces(sim)

        expected = slope(moved, 0.0, 1e-5)
        changed(sim, u, v)
        assert_close(applied(sim, d, by_u, by_v), expected, 1e-7)  # measured 1e-9


ACTIVE, NOT_ACTIVE = (f'materials.cytoplasm.zeta="{zeta} Pa"' for zeta in (300, 0))
ALONG = 'director.start="tangential"'
ANCHORED = {"in the plane": ("director_radial", NOT_ACTIVE), "in space": ("ball_director", NOT_ACTIVE),
            "along the membrane": ("director_radial", ALONG, ACTIVE), "and in space": ("ball_director", ALONG, ACTIVE)}


@pytest.mark.parametrize("name", ANCHORED)
def test_tangent_of_anchored_directors_is_the_derivative_of_all_forces(name: str) -> None:
    """Directors at the membrane turn with it, others are still, and torques act on all; on any ranks."""
    with built(case(*ANCHORED[name], *SOFT)) as sim:
        u, v = deform(sim)
        d = smooth(sim.scene.X, 7, 1.0, shortest=1.0)

        def moved(s: float) -> np.ndarray:
            changed(sim, u + s * d, v)
            return -forces(sim)

        expected = slope(moved, 0.0, 1e-5)
        changed(sim, u, v)
        assert_close(applied(sim, d, 1.0, 0.0), expected, 1e-9)  # measured 3e-11
        part = applied(sim, d, 1.0, 0.0, "anchors")
        assert np.abs(part).max() > 0.005 * np.abs(expected).max()  # measured 0.009 to 0.014


@pytest.mark.serial
@pytest.mark.parametrize("name", ["director_radial", "ball_director"])
def test_a_rank_without_anchors_has_no_part_of_their_tangent(name: str) -> None:
    """As one that is inside a cell."""
    with built(case(name, *SOFT, per_cell=60), MPI.COMM_SELF) as sim:
        m = sim.mechanics
        m.rate()
        assert Stiffness(m).surfaces(names=("anchors",)).nnz > 0
        m.director.anchors.at, m.kernel["anchor_owned"][:] = m.director.anchors.at[:0], 0
        assert Stiffness(m).surfaces(names=("anchors",)).nnz == 0


KINDS = {"substrate": "adhesion", "contact": "adhesion", "sliding": "friction", "push_off": "protrusion"}
KIND_OF = {term.name: KINDS.get(term.name, term.name) for term in SURFACE_TERMS if term.name != "loads"}
SURFACE_LAWS = [(scene, part, name) for scene in ("all_protrude", "three_balls") for part, kind in KIND_OF.items()
                for name in laws(kind)]
BY_DIFFERENCES = {("three_balls", part) for part in ("contact", "sliding", "push_off")}  # tangents


def three_cells(scene: str, part: str, name: str) -> Any:
    """A case of three cells with a law of surfaces."""
    scene, law = case(scene, *SOFT, NO_ETA), example(KIND_OF[part], name)
    names = tuple(cell.name for cell in scene.cells)
    law = dataclasses.replace(law, cells=names) if KIND_OF[part] == "protrusion" else law
    if part == "push_off":
        pairs = Pair(cells=(names[:1], names[1:]), law=scene.contact, push=True),
        return dataclasses.replace(scene, pairs=pairs, protrusion=law)
    if part == "sliding":
        return dataclasses.replace(scene, pairs=(Pair(cells=(names, names), law=scene.contact, friction=law),))
    return dataclasses.replace(scene, **{part: law})


@pytest.mark.parametrize(("scene", "part", "name"), [case for case in SURFACE_LAWS if case[:2] not in BY_DIFFERENCES])
def test_forces_of_the_kernel_on_surfaces_are_those_of_the_formulas(scene: str, part: str, name: str) -> None:
    """Three cells pressed against each other and the substrate, whose membranes slide, on any ranks."""
    with built(three_cells(scene, part, name)) as sim:
        m = sim.mechanics
        set_motion(sim, approach(sim, 1) - sim.scene.X, smooth(sim.scene.X, 6, 1.0))
        expected = m.surface_force(part)[0]
        d = m.scene.dimension
        x, v = m.kernel["X"] + m.kernel["state"][:, :d], m.kernel["state"][:, d:]
        found = np.zeros_like(x)
        for stencil in stencils(m):
            if stencil.name == part and stencil.nodes.size:
                force = stencil.force(*(a[stencil.nodes].transpose(0, 2, 1) for a in (x, v)))
                for node, pair in zip(stencil.nodes, force, strict=True):
                    np.add.at(found, node, np.column_stack(np.broadcast_arrays(*pair, node * 0.0)[:d]))
        largest = sim.comm.allreduce(float(np.abs(expected).max()), MPI.MAX)
        assert largest > 0.0
        assert np.abs(found[: m.n_owned] - expected).max() <= 1e-14 * largest  # measured 2e-15: sums in another order


@pytest.mark.parametrize(("scene", "part", "name"), SURFACE_LAWS)
def test_tangent_of_a_law_of_surfaces_is_the_derivative_of_the_kernels_force(scene: str, part: str, name: str) -> None:
    """Three cells pressed against each other and the substrate, whose membranes slide, on any ranks."""
    with built(three_cells(scene, part, name)) as sim:
        m = sim.mechanics
        u, v = approach(sim, 1) - sim.scene.X, smooth(sim.scene.X, 6, 1.0)
        d = np.random.default_rng(5).standard_normal(sim.scene.X.shape)

        def moved(s: float) -> np.ndarray:
            changed(sim, u + 3.0 * s * d, v + s * d)
            m.state.exchange()
            return -everywhere(sim, m.surface_force(part)[0])

        expected = slope(moved, 0.0, 1e-7)
        changed(sim, u, v)
        # measured 2e-8; in space 1.2e-7 of contact, whose tangent is made of differences, too: 6e-8 to 6e-7 by d; of
        # drag between cells 7e-8
        assert_close(applied(sim, d, 3.0, 1.0, part), expected, 3e-7 if (scene, part) in BY_DIFFERENCES else 1e-7)


@pytest.mark.serial
def test_the_tangent_of_a_ball_at_rest_has_the_modes_of_lamb() -> None:
    """Six motions as a whole, five twists and five ovals of two lobes, and the breathing (Lamb 1882)."""
    errors = []
    for count in (200, 500):
        with built(piece(BALL, count, dimension=3, material={"volumetric_modulus": "2 kPa"}), MPI.COMM_SELF) as sim:
            m, law = sim.mechanics, sim.scene.materials[0]
            m.rate()
            shear = np.sqrt(law.shear_modulus / law.density) / 1.415  # [1/µs]
            exact = [shear * brentq(lambda q: spherical_jn(2, q) - q * spherical_jn(3, q), 2.0, 3.0)]
            for lobes, guess in ((2, 2.64 * shear), (0, 2.3 * law.sound_speed / 1.415)):
                exact.append(Globe(law, 1.415, lobes, 0.0, 1j * guess).s.imag)
            K = Stiffness(m)().tocsr()
            assert abs(K - K.T).max() < 1e-14 * abs(K).max()  # measured 8e-17
            root = sparse.diags(np.repeat(m.state.mass, 3) ** -0.5)
            A = (root @ K @ root).tocsc()
            square, _ = eigsh(A, 16, sigma=-0.1 * shear**2)
            found = np.sqrt(np.maximum(square[6:], 0.0))
            assert np.abs(square[:6]).max() < 1e-12 * square[6]  # measured 5e-16
            square, mode = eigsh(A, 8, sigma=exact[2] ** 2)
            radial = (mode.T @ (root.power(-1) @ (sim.scene.X[m.ids] / 1.415).ravel())) ** 2
            found = [found[:5].mean(), found[5:].mean(), np.sqrt(square[np.argmax(radial)])]
            errors.append(np.abs(np.array(found) / exact - 1.0))
    assert (errors[1] < [0.06, 0.04, 0.004]).all()  # measured 0.050, 0.035, 0.0023
    assert (errors[1] < 0.55 * errors[0]).all()  # measured 0.49, 0.43, 0.34; of the second order 0.54
