"""Contact between cells against its definition, evaluated slowly; its symmetries; its derivatives."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from samples import slope
from scenes import built, case, everywhere, in_petsc, set_motion, surfaces
from scipy.integrate import quad

from mpi4py import MPI

from cellmig.case.schema import Case
from cellmig.model.protocols import Adhesion
from cellmig.parallel.reduce import exact_sum
from cellmig.simulation import Simulation
from cellmig.solve.stiffness import Stiffness
from cellmig.verify import contact

Outlines = list[np.ndarray]
EPS = 0.01  # equilibrium distance of bonds between cells [µm]
GAPS = (0.5, 1.0, 2.0, 5.0, 20.0)  # in equilibrium distances


@cache
def scene(per_cell: int = 60) -> Case:
    """Three cells of the paper, whose outlines repel themselves, and whose surfaces tests put where they want."""
    pairs = ", ".join(f'{{cells = ["Cell-{n}", "Cell-{n}"]}}' for n in (1, 2, 3))
    return case("all_protrude", f"adhesion.pairs=[{pairs}]", per_cell=per_cell)


@pytest.fixture(scope="module")
def sim() -> Iterator[Simulation]:
    """The scene on this rank alone; every test places the surfaces anew."""
    with built(scene(), MPI.COMM_SELF) as simulation:
        yield simulation


def numbers(sim: Simulation) -> list[int]:
    """Number of surface particles of each cell."""
    return [int(n) for n in np.bincount(surfaces(sim).cell)]


def placed(sim: Simulation, outlines: Outlines) -> np.ndarray:
    """Displacements (size, 2) [µm] that put surfaces on outlines; a cell without one goes far away."""
    s, X = surfaces(sim), sim.scene.X
    u = np.zeros_like(X)
    for c in range(len(sim.scene.kind)):
        on = s.ids[s.cell == c]
        u[on] = outlines[c] - X[on] if c < len(outlines) else [0.0, 100.0 * c]
    return u


def lengths(sim: Simulation) -> Outlines:
    """Reference lengths of the segments of each cell [µm]."""
    s = surfaces(sim)
    return [s.size[s.cell == c] for c in range(len(sim.scene.kind))]


def energy(sim: Simulation) -> float:
    return float(exact_sum(sim.comm, sim.mechanics.surface_force("contact")[1]))


def force(sim: Simulation) -> np.ndarray:
    return everywhere(sim, sim.mechanics.surface_force("contact")[0])


def moved(sim: Simulation, u: np.ndarray) -> Simulation:
    """The scene with other displacements and the same search lists."""
    m = sim.mechanics
    m.state.owned[:, :2] = u[m.ids]
    m.state.exchange()
    return sim


# ------------------------------------------------------------------------------------------------------- outlines


def along(corners: Sequence, m: int, shift: float = 0.0) -> np.ndarray:
    """A polygon (m, 2) with these corners, m vertices in all, and sides divided evenly, shifted along x."""
    corners = np.asarray(corners, float) + np.array([shift, 0.0])
    sides = np.roll(corners, -1, axis=0) - corners
    size = np.linalg.norm(sides, axis=1)
    parts = np.ones(len(corners), int)
    for _ in range(m - len(corners)):
        parts[np.argmax(size / parts)] += 1
    return np.concatenate([c + np.arange(n)[:, None] / n * e for c, n, e in zip(corners, parts, sides, strict=True)])


def convex(rng: np.random.Generator, m: int) -> np.ndarray:
    """Points on a turned ellipse."""
    t, turn = np.sort(rng.uniform(0.0, 2.0 * np.pi, m)), rng.uniform(0.0, np.pi)
    c, s = np.cos(turn), np.sin(turn)
    return np.column_stack([5.0 * np.cos(t), 3.5 * np.sin(t)]) @ [[c, s], [-s, c]]


def starred(rng: np.random.Generator, m: int) -> np.ndarray:
    """A star-shaped outline with reflex corners."""
    t = (np.arange(m) + rng.uniform(-0.3, 0.3, m)) * 2.0 * np.pi / m
    return (4.0 * (1.0 + rng.uniform(-0.12, 0.12, m)))[:, None] * np.column_stack([np.cos(t), np.sin(t)])


SQUARE, DIAMOND = [[-3, -3], [3, -3], [3, 3], [-3, 3]], [[0, -3], [3, 0], [0, 3], [-3, 0]]
NOTCHED = [[-3, -3], [3, -3], [3, 3], [1.5, 3], [0, 1], [-1.5, 3], [-3, 3]]  # with a reflex corner above
WEDGE = [[0, 0], [4, 1.6], [4, 4], [-4, 4], [-4, 1.3]]  # acute, its corner below


def pair(kind: str, gap: float, m: list[int]) -> Outlines:
    """Two outlines, or three, at a gap [µm]."""
    rng = np.random.default_rng(list(kind.encode()))
    if kind.startswith("triple"):  # two feet and a third cell in the wedge between them
        left = along([[-5, -2], [-gap / 2, -2], [-gap / 2 - 0.6, 0.0], [-4, 2]], m[0])
        right = along([[gap / 2, -2], [5, -2], [4, 2], [gap / 2 + 0.6, 0.0]], m[1])
        third = along([[0.02 if kind == "triple, aside" else 0.0, -1.6], [1.0, 2.6], [-1.0, 2.6]], m[2])
        return [left, right, contact.brought_near([left, right], third, gap, (0.0, 1.0))]
    shapes: dict[str, tuple[np.ndarray, np.ndarray, tuple]] = {
        "convex": (convex(rng, m[0]), convex(rng, m[1]), (1.0, 0.3)),
        "not convex": (starred(rng, m[0]), starred(rng, m[1]), (0.4, 1.0)),
        "corner at an edge": (along(SQUARE, m[0]), along(DIAMOND, m[1], 0.37), (0.0, 1.0)),
        "corner at a corner": (along(DIAMOND, m[0]), along(DIAMOND, m[1], 0.003), (0.0, 1.0)),
        "corner in a reflex corner": (along(NOTCHED, m[0]), along(WEDGE, m[1], 0.05), (0.0, 1.0)),
        "wedge at a flank": (along(SQUARE, m[0]), along(WEDGE, m[1], -3.6), (0.0, 1.0)),
    }
    A, B, direction = shapes[kind]
    return [A, contact.brought_near([A], B, gap, direction)]


PAIRS = ("convex", "not convex", "corner at an edge", "corner at a corner", "corner in a reflex corner",
         "wedge at a flank")
TRIPLES = ("triple", "triple, aside")
KINDS = PAIRS + TRIPLES


# ---------------------------------------------------------------------------------------------- the slow evaluation


def beside_a_corner(law: Adhesion) -> tuple[float, float]:
    """Integrals [pN µm²] of U where a square is EPS above a line: along the line beyond a corner, and up the side."""
    parts = np.append(np.geomspace(0.2, 40.0, 12) * EPS, np.sqrt(law.cutoff**2 - EPS**2))
    line = sum(quad(lambda s: law.potential(np.hypot(EPS, s)), a, b, epsabs=1e-16, epsrel=1e-11)[0]
               for a, b in pairwise([0.0, *parts]))
    side = sum(quad(law.potential, a, b, epsabs=1e-16, epsrel=1e-11)[0]
               for a, b in pairwise([EPS, *np.geomspace(2.0, 30.0, 9) * EPS, law.cutoff]))
    return line, side


@pytest.mark.serial
def test_the_slow_energy_of_level_outlines_is_minus_the_work_of_adhesion_a_length(sim: Simulation) -> None:
    law = sim.terms.contact
    A, B = along(SQUARE, 24), along([[-8, -7], [8, -7], [8, -3 - EPS], [-8, -3 - EPS]], 40)
    size = [np.linalg.norm(np.roll(o, -1, axis=0) - o, axis=1) for o in (A, B)]
    right = law.bond_density * (6.0 * law.potential(EPS) + sum(beside_a_corner(law)))
    assert contact.energy(law, [A, B], size) == pytest.approx(right, rel=1e-12)  # measured 1e-15


@pytest.mark.serial
@pytest.mark.parametrize("kind", ["not convex", "corner in a reflex corner"])
def test_the_slow_mean_of_the_potential_is_that_of_an_adaptive_rule(sim: Simulation, kind: str) -> None:
    law, (A, B) = sim.terms.contact, pair(kind, 2 * EPS, numbers(sim)[:2])
    means = np.array([contact.mean_potential(law, p, q, B) for p, q in zip(A, np.roll(A, -1, axis=0), strict=True)])
    for k in np.argsort(-np.abs(means))[:3]:
        p, q = A[k], np.roll(A, -1, axis=0)[k]
        parts = contact.breaks(law, p, q, B)
        mean = sum(quad(lambda t, p=p, q=q: contact.potential(law, p + np.array([[t]]) * (q - p), B)[0], a, b,
                        epsabs=1e-13, epsrel=1e-9)[0] for a, b in pairwise(parts))
        assert means[k] == pytest.approx(mean, rel=1e-10)  # measured 1e-13


# ------------------------------------------------------------------------------------------------ energy and force


def absolute(law: Adhesion) -> Any:
    """The law with |U|: pressed and pulled bonds, which make an energy small, have errors of their own."""
    return SimpleNamespace(potential=lambda r: np.abs(law.potential(r)), cutoff=law.cutoff,
                           equilibrium_distance=law.equilibrium_distance, bond_density=law.bond_density)


@pytest.mark.serial
@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("kind", KINDS)
def test_energy_is_that_of_the_definition(sim: Simulation, kind: str, gap: float) -> None:
    outlines = pair(kind, gap * EPS, numbers(sim))
    set_motion(sim, placed(sim, outlines))
    law = sim.terms.contact
    right, size = (contact.energy(u, outlines, lengths(sim)) for u in (law, absolute(law)))
    assert abs(energy(sim) - right) < 1e-9 * size  # measured 8e-10, 1e-10 without corners at corners


@pytest.mark.serial
@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("kind", KINDS)
def test_force_is_minus_the_gradient_of_the_energy(sim: Simulation, kind: str, gap: float) -> None:
    u = placed(sim, pair(kind, gap * EPS, numbers(sim)))
    set_motion(sim, u)
    f = force(sim)
    loaded = np.flatnonzero(np.abs(f).max(axis=1) > 1e-6 * np.abs(f).max())
    assert len(loaded) >= 4
    for k in loaded[np.argsort(-np.abs(f[loaded]).max(axis=1))][:14]:
        for c in range(2):
            d = np.zeros_like(u)
            d[k, c] = 1.0
            errors = [abs(f[k, c] + slope(lambda s, d=d: energy(moved(sim, u + s * d)), 0.0, h)) for h in
                      (3e-5, 1e-5, 3e-6, 1e-6, 3e-7)]
            # measured 1.5e-9
            assert min(errors) < 1e-8 * np.abs(f).max(), f"{k}, {c}: {np.array(errors) / np.abs(f).max()}"


def balanced(sim: Simulation, u: np.ndarray, f: np.ndarray) -> None:
    """Check that forces f at displacements u add up to nothing and turn nothing."""
    x = sim.scene.X + u
    assert np.abs(f.sum(axis=0)).max() <= 1e-12 * np.abs(f).sum()
    assert abs((x[:, 0] * f[:, 1] - x[:, 1] * f[:, 0]).sum()) <= 1e-12 * (np.abs(x) * np.abs(f[:, ::-1])).sum()


@pytest.mark.serial
@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("kind", KINDS)
def test_forces_add_up_to_nothing_and_turn_nothing(sim: Simulation, kind: str, gap: float) -> None:
    u = placed(sim, pair(kind, gap * EPS, numbers(sim)))
    set_motion(sim, u)
    f = force(sim)
    assert f.any()
    balanced(sim, u, f)  # measured 2e-16, turns 4e-16


@pytest.mark.serial
@pytest.mark.parametrize("shift", [0.0, 0.02, 0.05, 0.1, 0.15, 0.4])
def test_level_outlines_may_be_shifted_along_each_other(sim: Simulation, shift: float) -> None:
    """A square on a wider rectangle: the energy is -w a length, and what the corners add, wherever vertices are."""
    m, size, law = numbers(sim), lengths(sim), sim.terms.contact
    A = along(SQUARE, m[0], shift)
    B = along([[-8, -7], [8, -7], [8, -3 - EPS], [-8, -3 - EPS]], m[1])
    set_motion(sim, placed(sim, [A, B]))
    line, side = beside_a_corner(law)

    def dense(on: np.ndarray, k: int, chosen: np.ndarray) -> np.ndarray:
        """Reference length over length of some segments."""
        return (size[k] / np.linalg.norm(np.roll(on, -1, axis=0) - on, axis=1))[chosen]

    low, next_low = A[:, 1] == -3.0, np.roll(A, -1, axis=0)[:, 1] == -3.0
    high = (B[:, 1] == -3.0 - EPS) & (np.roll(B, -1, axis=0)[:, 1] == -3.0 - EPS)
    level = dense(A, 0, low & next_low).mean() + dense(B, 1, high).mean()
    right = 0.5 * law.bond_density * (level * 6.0 * law.potential(EPS) + dense(A, 0, low ^ next_low).sum() * side
                                      + 2.0 * dense(B, 1, high).mean() * line)
    assert energy(sim) == pytest.approx(right, rel=1e-9)


@pytest.mark.serial
@pytest.mark.parametrize("beside", [0.0, 1e-9, -1e-9])
def test_sides_on_the_border_of_a_slab_count_once(sim: Simulation, beside: float) -> None:
    """Two equal squares, one on the other: sides lie on the normals at corners."""
    m, law = numbers(sim), sim.terms.contact
    two = [along(SQUARE, m[0], beside), along([[-3, -9], [3, -9], [3, -3], [-3, -3]], m[1])]
    two[1][:, 1] -= EPS
    set_motion(sim, placed(sim, two))
    assert energy(sim) == pytest.approx(contact.energy(law, two, lengths(sim)), rel=1e-9)


@pytest.mark.serial
@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("kind", KINDS)
def test_the_force_is_continuous_where_a_vertex_crosses_a_border(sim: Simulation, kind: str, gap: float) -> None:
    """Vertices of one outline are moved along it, so that they cross the normals at the vertices of the other."""
    outlines = pair(kind, gap * EPS, numbers(sim))
    A, B = outlines[:2]
    k = int(np.linalg.norm(A[:, None] - B, axis=2).min(axis=1).argmin())
    v = int(np.linalg.norm(A[k] - B, axis=1).argmin())
    crossed = 0
    for e in (B[(v + 1) % len(B)] - B[v], B[v] - B[v - 1]):
        across, jumps = e / np.hypot(*e), []
        if (A[k] - B[v]) @ [across[1], -across[0]] < 0.3 * gap * EPS:  # it would come too close
            continue
        crossed += 1
        for d in (1e-7, 1e-8):
            f = []
            for side in (-d, d):
                at = [o.copy() for o in outlines]
                at[0][k] -= ((A[k] - B[v]) @ across - side) * across  # on the border, d beside it
                set_motion(sim, placed(sim, at))
                f.append(force(sim))
            jumps.append(np.abs(f[1] - f[0]).max() / np.abs(f[0]).max())
        assert jumps[1] < max(0.2 * jumps[0], 1e-9), jumps
    assert crossed


@pytest.mark.serial
def test_cells_far_apart_feel_nothing(sim: Simulation) -> None:
    for gap, there in ((0.51, False), (0.49, True)):  # the cutoff is 0.5 µm
        set_motion(sim, placed(sim, pair("convex", gap, numbers(sim))))
        assert force(sim).any() == there and (energy(sim) != 0.0) == there


# ------------------------------------------------------------------------------------------- an outline with itself


def folded(kind: str, gap: float, m: int) -> np.ndarray:
    """An outline whose parts face each other across a gap [µm]: along a slot above a hollow, or at the lips of one."""
    low = {"slot": 1.5, "mouth": 3.0}[kind]
    g = 0.5 * gap
    slot = [[g, 3], [g, low], [1, 0], [-1, 0], [-g, low], [-g, 3]] if low < 3 else [[g, 3], [1, 0], [-1, 0], [-g, 3]]
    return along([[-3, -3], [3, -3], [3, 3], *slot, [-3, 3]], m)


@pytest.mark.serial
@pytest.mark.parametrize("gap", [0.5, 0.7, 0.9, 1.1])
@pytest.mark.parametrize("kind", ["slot", "mouth"])
def test_an_outline_repels_itself_by_the_same_definition(sim: Simulation, kind: str, gap: float) -> None:
    outline = folded(kind, gap * EPS, numbers(sim)[0])
    law = sim.terms.contacts.laws[int(sim.terms.contacts.of_pair(np.zeros(1, int), np.zeros(1, int))[0])]
    u = placed(sim, [outline, outline + np.array([20.0, 0.0])])
    set_motion(sim, u)
    right = sum(contact.own_energy(law, outline, length) for length in lengths(sim)[:2])
    assert (right > 0.0) == (gap < 1.0)
    # measured 6e-9: of segments in line with the vertex opposite, a hard case of Gauss's rule
    assert energy(sim) == pytest.approx(right, rel=1e-8)
    f = force(sim)
    assert f.any() == (gap < 1.0)
    balanced(sim, u, f)
    for k, c in zip(*np.unravel_index(np.argsort(-np.abs(f), axis=None)[:8], f.shape), strict=True):
        d = np.zeros_like(u)
        d[k, c] = 1.0
        slopes = [slope(lambda s, d=d: energy(moved(sim, u + s * d)), 0.0, h) for h in (1e-5, 3e-6, 1e-6, 3e-7)]
        assert min(abs(f[k, c] + s) for s in slopes) <= 1e-8 * np.abs(f).max()


# -------------------------------------------------------------------------------------------- ranks, lists, tangent


@pytest.mark.parametrize("kind", [*KINDS, "slot", "mouth"])
def test_ranks_and_lists_do_not_matter(kind: str) -> None:
    """The same bits on one rank and on all, with lists of this state and of another."""
    found = []
    for comm in (MPI.COMM_SELF, MPI.COMM_WORLD):
        with built(scene(), comm) as sim:
            m = numbers(sim)
            u = placed(sim, pair(kind, EPS, m) if kind in KINDS else [folded(kind, 0.7 * EPS, m[0])])
            d = np.random.default_rng(3).uniform(-0.2, 0.2, u.shape)
            for lists_at in (u, u + d):
                set_motion(sim, lists_at)
                moved(sim, u)
                found.append((force(sim), energy(sim)))
    assert found[0][0].any()
    for f, e in found:
        assert np.array_equal(f, found[0][0]) and e == found[0][1]


@pytest.mark.parametrize("gap", [0.5, 1.0, 20.0])
@pytest.mark.parametrize("kind", KINDS)
def test_the_tangent_is_the_derivative_of_the_force(kind: str, gap: float) -> None:
    """On any ranks."""
    with built(scene()) as sim:
        m = sim.mechanics
        u = placed(sim, pair(kind, gap * EPS, numbers(sim)))
        set_motion(sim, u)
        force(sim)
        K, d = Stiffness(m).surfaces(1.0, 0.0, ("contact",)), np.random.default_rng(5).standard_normal(u.shape)
        at = np.empty_like(d)
        at[in_petsc(sim)] = d
        found = everywhere(sim, (K @ at.ravel()).reshape(-1, 2))
        errors = [np.abs(found + slope(lambda s: force(moved(sim, u + s * d)), 0.0, h)).max() for h in
                  (1e-5, 1e-6, 1e-7, 1e-8)]
        # measured 3e-9
        assert min(errors) < 1e-6 * np.abs(found).max(), np.array(errors) / np.abs(found).max()
