"""Forces: the kernel computes what the laws say, internal and contact forces balance, rigid motion costs nothing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scenes import DAMPED, NETWORK, built, case, everywhere, forces, set_motion, smooth

from cellmig.case.pointwise import pointwise
from cellmig.case.schema import Case
from cellmig.meshfree import terms
from cellmig.meshfree.body import Template
from cellmig.meshfree.stabilisation import Stabilisation
from cellmig.parallel.reduce import exact_sum
from cellmig.simulation import Simulation

SURFACES = ("substrate", "contact", "protrusion")
# else the pressure drowns the other terms
SOFT = ('materials.cytoplasm.reduced_bulk_modulus="2 kPa"', 'materials.nucleus.volumetric_modulus="1 kPa"')
NO_ETA = 'materials.cytoplasm.eta="0 pN"'

SCENES: dict[str, Callable[[], Case]] = {
    "nucleus": lambda: case("nucleus", *DAMPED),
    "not stiffened": lambda: case("nucleus", *DAMPED, "materials.nucleus.hourglass_modulus=0.0"),
    "stiff": lambda: case("one_three"),
    "three cells": lambda: case("all_protrude", *SOFT, NO_ETA),
    "frozen director": lambda: case("one_cell", *SOFT, 'materials.cytoplasm.eta="200 pN"', 'director.law="frozen"',
                                    'director.start="radial"'),
    "relaxing director": lambda: case("director_radial", *SOFT, 'director.anchoring="none"'),
    "network": lambda: case("one_cell", *SOFT, *NETWORK),
    "active": lambda: case("all_protrude", *SOFT, NO_ETA, 'materials.cytoplasm.zeta="-300 Pa"',
                           'director.law="frozen"', 'director.start="tangential"'),
    "director and activity": lambda: case("director_radial", *SOFT, 'materials.cytoplasm.zeta="300 Pa"',
                                          'director.anchoring="none"'),
}

ELASTIC = ("nucleus", "not stiffened", "stiff")  # scenes where elastic forces outweigh the others by far


def deform(sim: Simulation, size: float = 0.02, speed: float = 0.1, lifted: bool = True) -> tuple[np.ndarray, ...]:
    """Give the scene a smooth random deformation with noise, and velocities: u, v (size, d).

    Lifted cells touch nothing: huge contact forces would leave their rounding behind.
    """
    X = sim.scene.X
    R = 0.5 * np.ptp(X[sim.scene.cell == 0])
    noise = np.random.default_rng(8).standard_normal((2, *X.shape))
    u = smooth(X, 5, size * R, shortest=R) + 0.002 * R * noise[0]
    v = smooth(X, 6, speed, shortest=R) + 0.1 * speed * noise[1]
    if lifted:
        u[:, 0] -= 3.0 * sim.scene.cell
        u[:, -1] += 3.0
    set_motion(sim, u, v)
    return u, v


def internal(sim: Simulation) -> np.ndarray:
    """Forces less those of the surfaces (size, 2) [pN/µm]; collective."""
    f = forces(sim)
    for term in SURFACES:
        if getattr(sim.terms, term) is not None:
            f = f - everywhere(sim, sim.mechanics.surface_force(term)[0])
    return f


def assembled(sim: Simulation, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Internal forces and the part of the stabilisation, from the templates and the laws as Python has them."""
    scene, terms = sim.scene, sim.terms
    total, stabilisation = np.zeros_like(u), np.zeros_like(u)
    theta = None if sim.mechanics.director is None else everywhere(sim, sim.mechanics.director.values[:, 0])
    for c, kind in enumerate(scene.kind):
        t, part = scene.templates[kind], slice(scene.offset[c], scene.offset[c + 1])
        F, rate = (np.array([[g @ a[part, i] for g in t.G] for i in range(2)]) for a in (u, v))
        F = F + np.eye(2)[:, :, None]
        given = {"F": F, "Fdot": rate}
        if theta is not None:
            given["gradient"] = np.zeros((1, 2, len(t.X)))
            for slope, G in zip(given["gradient"][0], (g.tocoo() for g in t.G), strict=True):
                difference = theta[part][G.col] - theta[part][G.row]
                difference -= 2 * np.pi * np.rint(difference / (2 * np.pi))
                np.add.at(slope, G.row, G.data * difference)
            given["director"] = np.array([np.cos(theta[part]), np.sin(theta[part])])
        J = F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]
        cofactor = np.array([[F[1, 1], -F[1, 0]], [-F[0, 1], F[0, 0]]])
        P = t.damping * (rate * cofactor).sum(axis=(0, 1)) / J * cofactor
        for i, law in enumerate(scene.materials):
            on = scene.material[part] == i
            local = {k: q[..., on] for k, q in given.items()}
            methods = ["stress", "viscous_stress"]
            methods += ["director_stress"] * (terms.director != "none") + ["active_stress"] * terms.active
            for method in methods:
                if on.any() and hasattr(law, method):
                    P[..., on] += np.array(pointwise(law, method, local))
        total[part] = divergence(t, t.V * P) - t.E @ u[part]
        bent, Q = Stabilisation().stress(t.bending_weight, F, rate, (t.C @ u[part]).T, (t.C @ v[part]).T)
        stabilisation[part] = divergence(t, np.array(Q)) - t.C.T @ np.array(bent).T
    return total + stabilisation, stabilisation


def divergence(t: Template, Q: np.ndarray) -> np.ndarray:
    """Forces (n, 2) [pN/µm] of stresses V P (2, 2, n) [pN]."""
    return -np.column_stack([sum(g.T @ q for g, q in zip(t.G, row, strict=True)) for row in Q])


@pytest.mark.parametrize("name", SCENES)
def test_kernel_computes_what_the_laws_say(name: str) -> None:
    with built(SCENES[name]()) as sim:
        u, v = deform(sim)
        expected, stabilisation = assembled(sim, u, v)
        size = np.abs(expected).max()
        assert np.abs(stabilisation).max() > (1e-5 if name in ELASTIC else 1e-2) * size  # all parts count
        # measured 1.2e-14: sums in another order
        assert np.abs(internal(sim) - expected).max() < 1e-12 * size


@pytest.mark.parametrize("name", SCENES)
def test_internal_forces_add_up_to_nothing(name: str) -> None:
    with built(SCENES[name]()) as sim:
        deform(sim)
        f = internal(sim)
        assert np.abs(f.sum(axis=0)).max() < 1e-13 * np.abs(f).sum()  # measured 6e-17


@pytest.mark.parametrize("name", SCENES)
def test_single_precision_of_coefficients_keeps_momentum_and_changes_forces_by_its_rounding(
        name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with built(SCENES[name]()) as sim:
        u, v = deform(sim)
        expected = internal(sim)
        assert not sim.terms.single
    monkeypatch.setattr(terms, "SINGLE_FROM", 0)
    with built(SCENES[name]()) as sim:
        set_motion(sim, u, v)
        f = internal(sim)
        assert sim.terms.single
        assert np.abs(f.sum(axis=0)).max() < 1e-13 * np.abs(f).sum()  # measured 6e-17
        assert 0.0 < np.abs(f - expected).max() < 1e-6 * np.abs(expected).max()  # measured 7.1e-8


def moment(x: np.ndarray, f: np.ndarray) -> np.ndarray:
    return x[:, 0] * f[:, 1] - x[:, 1] * f[:, 0]


@pytest.mark.parametrize("name", SCENES)
def test_internal_forces_turn_nothing(name: str) -> None:
    with built(SCENES[name]()) as sim:
        u, _ = deform(sim)
        turn = moment(sim.scene.X + u, internal(sim))
        # measured 5e-17: the Cauchy stress is symmetric, and the stabilisations are blind to a rotation
        assert abs(turn.sum()) < 1e-12 * np.abs(turn).sum()


def approach(sim: Simulation, seed: int) -> np.ndarray:
    """Press the cells together a little, unevenly, and return the positions (size, d)."""
    u = 0.004 * np.random.default_rng(seed).standard_normal(sim.scene.X.shape)
    set_motion(sim, u)
    return sim.scene.X + u


# Three cells on three ranks have one each; two cells on three ranks are cut.
@pytest.mark.parametrize("cells", [3, 2])
@pytest.mark.parametrize("seed", [1, 2])
def test_forces_between_cells_add_up_to_nothing_and_turn_nothing(seed: int, cells: int) -> None:
    """On several ranks this is Newton's third law across their borders: every rank brings the forces on its own."""
    with built(case("paper", f"cells.0.repeat=[{cells}]")) as sim:
        x, m = approach(sim, seed), sim.mechanics
        own = m.surface_force("contact")[0]
        f = everywhere(sim, own)
        touching = np.abs(f).max(axis=1) > 0
        assert touching.sum() >= 8
        assert set(sim.scene.cell[touching].tolist()) == set(range(cells))
        total = exact_sum(sim.comm, own)
        assert np.abs(total).max() < 1e-13 * np.abs(f).sum()  # measured 1e-16
        # the force acts along the line from particle to foot; measured 1e-15
        assert abs(moment(x, f).sum()) < 1e-12 * np.abs(moment(x, f)).sum()


def test_forces_do_not_depend_on_who_computes_them(comm) -> None:
    with built(case("all_protrude")) as sim, built(case("all_protrude"), comm.Split(comm.rank, 0)) as alone:
        u, v = deform(sim, lifted=False)
        set_motion(alone, u, v)
        assert np.array_equal(forces(sim), forces(alone))
        for term in SURFACES:
            ours, theirs = (everywhere(s, s.mechanics.surface_force(term)[0]) for s in (sim, alone))
            assert np.array_equal(ours, theirs)


@pytest.mark.parametrize("angle", [0.1, 1.0, 3.0])
def test_rigid_motion_costs_no_elastic_force(angle: float) -> None:
    with built(case("nucleus")) as sim:
        X = sim.scene.X
        Q = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        set_motion(sim, X @ (Q - np.eye(2)).T + [3.0, -2.0], np.zeros_like(X))
        rigid = np.abs(internal(sim)).max()
        set_motion(sim, X * [0.01, -0.01], np.zeros_like(X))
        assert rigid < 1e-10 * np.abs(internal(sim)).max()  # against a strain of 1 %; measured 1.2e-11


def test_rigid_spin_and_translation_cost_no_viscous_force() -> None:
    with built(case("one_cell")) as sim:
        X = sim.scene.X
        set_motion(sim, np.zeros_like(X), X @ np.array([[0.0, -1.0], [1.0, 0.0]]).T + [1.0, 2.0])
        rigid = np.abs(internal(sim)).max()
        set_motion(sim, np.zeros_like(X), X * [1.0, -1.0])
        assert rigid < 1e-11 * np.abs(internal(sim)).max()  # measured 9e-15


def test_undeformed_cells_at_rest_feel_their_surfaces_only() -> None:
    with built(case("all_protrude")) as sim:
        set_motion(sim, np.zeros_like(sim.scene.X))
        inside = np.abs(internal(sim)).max()
        assert inside < 1e-9 * np.abs(forces(sim)).max()


# --------------------------------------------------------------------------------- force and energy, all terms at once

WHOLE = {name: SCENES[name] for name in ("nucleus", "not stiffened", "stiff", "three cells", "frozen director",
                                              "relaxing director")}
WHOLE["anchored director"] = lambda: case("director_radial", *SOFT)
STORES = ("elastic", "compression", "director", "adhesion_substrate", "adhesion_cells", "artificial_dissipation")


@pytest.mark.parametrize("name", WHOLE)
def test_force_is_minus_the_gradient_of_all_energies(name: str) -> None:
    """The couple of an anchored director on the membrane is part of it."""
    with built(WHOLE[name]()) as sim:
        m = sim.mechanics
        u = deform(sim, 0.005, lifted=False)[0]
        set_motion(sim, u, np.zeros_like(u))
        f = forces(sim)
        if sim.terms.protrusion is not None:  # no potential
            f = f - everywhere(sim, m.surface_force("protrusion")[0])

        def energy(moved: np.ndarray) -> float:
            m.state.owned[:, :2] = moved[m.ids]
            ledger = sim.sampler.ledger(m.rate(), 0.0)
            return sum(ledger[f"{name}_pn"] for name in STORES)

        surface = np.concatenate([sim.scene.surface(c) for c in range(len(sim.scene.kind))])
        rng, worst = np.random.default_rng(9), 0.0
        for particle in [*rng.choice(surface, 4, replace=False), *rng.choice(sim.scene.size, 6, replace=False)]:
            for c in range(2):
                values = []
                for step in (-2e-5, -1e-5, 1e-5, 2e-5):
                    moved = u.copy()
                    moved[particle, c] += step
                    values.append(energy(moved))
                slope = (8 * (values[2] - values[1]) - values[3] + values[0]) / 12e-5
                worst = max(worst, abs(f[particle, c] + slope))
        assert worst < 1e-9 * np.abs(f).max()  # measured 2e-11 stiff, 2e-13 soft
