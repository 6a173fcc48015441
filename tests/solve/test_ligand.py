"""Bonds in proportion to ligands: force from energy along the substrate too, tangents, drag, the ledger, any ranks."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from samples import assert_close, slope
from scenes import built, case, everywhere, example, set_motion, smooth
from test_forces import NO_ETA, SOFT, approach
from test_tangent import applied, changed

from mpi4py import MPI

from cellmig.case.expression import Expression
from cellmig.case.schema import Case
from cellmig.model.field import FormulaField
from cellmig.model.ligand import SPACING, LigandTable
from cellmig.parallel.reduce import exact_sum
from cellmig.simulation import Simulation
from cellmig.solve.stencils import stencils

STEEP = {"all_protrude": "0.5 + 0.4*sin(0.9*x)", "three_balls": "0.5 + 0.3*sin(0.9*x)*cos(0.7*y)"}
SCENES = [(scene, part) for scene in STEEP for part in ("substrate", "friction")]


def scene_of(scene: str, ligand: str | None = None, **laws: object) -> Case:
    """Three cells with friction on ligands that change within a cell."""
    found = case(scene, *SOFT, NO_ETA, *((f'substrate.ligand="{ligand}"',) if ligand else ()))
    return dataclasses.replace(found, friction=example("friction", "bonds"), **laws)


def formula(text: str) -> FormulaField:
    return FormulaField(formula=Expression(text, "", 3, True))


def energy(sim: Simulation) -> float:
    return float(exact_sum(sim.comm, sim.mechanics.surface_force("substrate")[1]))


# ------------------------------------------------------------------------------------------------------- the table


@pytest.mark.serial
def test_a_linear_field_is_exact_in_the_table_and_its_ends_are_no_others() -> None:
    x = np.linspace(-39.0, 39.0, 1001)
    share, slopes = LigandTable.of(formula("0.5 + 0.001*x"), np.array([-40.0]), np.array([40.0])).at(x)
    assert np.abs(share - (0.5 + 0.001 * x)).max() < 1e-15 and np.abs(slopes[0] - 0.001).max() < 1e-15


@pytest.mark.serial
@pytest.mark.parametrize("width", [20.0, 10.0, 5.0, 2.0])
def test_the_table_smooths_a_step_by_its_curvature(width: float) -> None:
    """Measured 4.0e-5, 1.6e-4, 6.4e-4 and 3.9e-3: h²/6 times 0.385/width², and by terms of higher order less."""
    x = np.linspace(-39.0, 39.0, 4001)
    share, _ = LigandTable.of(formula(f"0.5 + 0.5*tanh(x/{width})"), np.array([-40.0]), np.array([40.0])).at(x)
    error = np.abs(share - (0.5 + 0.5 * np.tanh(x / width))).max()
    assert 0.95 < error / (SPACING**2 / 6.0 * 4.0 / 27.0**0.5 / 2.0 / width**2) < 1.01


@pytest.mark.serial
def test_the_table_never_leaves_the_range_from_nothing_to_all() -> None:
    x = np.linspace(-39.0, 39.0, 4001)
    share, _ = LigandTable.of(formula("100*x"), np.array([-40.0]), np.array([40.0])).at(x)
    assert share.min() == 0.0 and share.max() <= 1.0 + 1e-15


@pytest.mark.serial
def test_tables_that_begin_elsewhere_have_the_same_bits() -> None:
    field, x = formula(STEEP["all_protrude"]), np.linspace(-5.0, 5.0, 101)
    near, far = (LigandTable.of(field, -np.array([reach]), np.array([reach])) for reach in (8.0, 900.0))
    assert np.array_equal(near.at(x)[0], far.at(x)[0])
    assert near.holds(np.array([-8.0]), np.array([8.0])) and not near.holds(np.array([-8.0]), np.array([800.0]))


# ------------------------------------------------------------------------------------------------- forces of a scene


@pytest.mark.serial
@pytest.mark.parametrize("scene", STEEP)
def test_force_is_minus_the_gradient_of_the_energy_along_the_substrate_too(scene: str) -> None:
    with built(scene_of(scene, STEEP[scene]), MPI.COMM_SELF) as sim:
        m, d = sim.mechanics, sim.scene.dimension
        u = approach(sim, 1) - sim.scene.X
        f = everywhere(sim, m.surface_force("substrate")[0])
        along = np.abs(f[:, :-1]).max()
        assert along > 1e-4 * np.abs(f).max()  # measured 2e-3
        loaded = np.flatnonzero(np.abs(f[:, 0]) > 1e-2 * along)
        for particle in np.random.default_rng(3).permutation(loaded)[:8]:
            for c in range(d):
                step = 2e-6 if c == d - 1 else 1e-3

                def moved(s: float, particle: int = particle, c: int = c) -> float:
                    v = u.copy()
                    v[particle, c] += s
                    changed(sim, v, 0.0 * v)
                    return energy(sim)

                expected = -slope(moved, 0.0, step)
                # measured 2e-9 of the force along the substrate, 4e-9 of that across it
                assert f[particle, c] == pytest.approx(expected, abs=1e-7 * (np.abs(f).max() if c == d - 1 else along))


@pytest.mark.parametrize(("scene", "part"), SCENES)
def test_forces_of_the_kernel_on_ligands_are_those_of_the_formulas(scene: str, part: str) -> None:
    """On any ranks."""
    with built(scene_of(scene, STEEP[scene])) as sim:
        m = sim.mechanics
        set_motion(sim, approach(sim, 1) - sim.scene.X, smooth(sim.scene.X, 6, 1.0))
        expected = m.surface_force(part)[0]
        d = m.scene.dimension
        x, v = m.kernel["X"] + m.kernel["state"][:, :d], m.kernel["state"][:, d:]
        found = np.zeros_like(x)
        for stencil in stencils(m):
            if stencil.name == part and stencil.nodes.size:
                force = stencil.force(*(tuple(map(tuple, a[stencil.nodes].transpose(0, 2, 1))) for a in (x, v)))
                for node, vector in zip(stencil.nodes, force, strict=True):
                    np.add.at(found, node, np.column_stack(np.broadcast_arrays(*vector, node * 0.0)[:d]))
        largest = sim.comm.allreduce(float(np.abs(expected).max()), MPI.MAX)
        assert largest > 0.0
        assert np.abs(found[: m.n_owned] - expected).max() <= 1e-13 * largest


@pytest.mark.parametrize(("scene", "part"), SCENES)
def test_tangent_on_ligands_is_the_derivative_of_the_kernels_force(scene: str, part: str) -> None:
    """On any ranks; the part of the forces along the substrate is compared by itself, as it is the smaller one."""
    with built(scene_of(scene, STEEP[scene])) as sim:
        m = sim.mechanics
        u, v = approach(sim, 1) - sim.scene.X, smooth(sim.scene.X, 6, 1.0)
        d = np.random.default_rng(5).standard_normal(sim.scene.X.shape)

        def moved(s: float) -> np.ndarray:
            changed(sim, u + 3.0 * s * d, v + s * d)
            m.state.exchange()
            return -everywhere(sim, m.surface_force(part)[0])

        expected = slope(moved, 0.0, 1e-7)
        changed(sim, u, v)
        found = applied(sim, d, 3.0, 1.0, part)
        assert_close(found, expected, 1e-7)
        assert_close(found[:, :-1], expected[:, :-1], 1e-6)


@pytest.mark.parametrize("scene", STEEP)
def test_ligands_that_are_everywhere_alike_scale_bonds_and_drag(scene: str) -> None:
    """By their share, with no force along the substrate: measured 3e-15, of the sum of the weights."""
    found = {}
    for ligand in (None, "0.25 + 0*x"):
        with built(scene_of(scene, ligand)) as sim:
            set_motion(sim, approach(sim, 1) - sim.scene.X, smooth(sim.scene.X, 6, 1.0))
            found[ligand] = [everywhere(sim, sim.mechanics.surface_force(part)[0])
                             for part in ("substrate", "friction")]
    for all_bonds, quarter in zip(*found.values(), strict=True):
        assert np.abs(quarter - 0.25 * all_bonds).max() < 1e-13 * np.abs(all_bonds).max()


@pytest.mark.parametrize("scene", STEEP)
def test_the_substrate_takes_the_reaction(scene: str) -> None:
    """Impulses at the facets of a rank's particles add up to the forces on them, along the substrate and across."""
    with built(dataclasses.replace(scene_of(scene, STEEP[scene]), friction=None)) as sim:
        m, d = sim.mechanics, sim.scene.dimension
        set_motion(sim, approach(sim, 1) - sim.scene.X)
        force = everywhere(sim, m.surface_force("substrate")[0]).sum(axis=0)
        of_surface = m.accounts.impulses.of_surface(m.powers()["bond_impulse"])
        total = sum(sim.comm.allgather(of_surface.sum(axis=0)))
        along = total[d : 2 * d - 1] + total[1:d]
        push = sum(sim.comm.allgather(m.powers()["protrusion_impulse"].sum()))
        size = np.abs(force).max()
        assert total[0] == pytest.approx(force[-1], abs=1e-13 * size)
        assert np.abs(along - np.array([push, 0.0][: d - 1]) - force[:-1]).max() < 1e-12 * size


# -------------------------------------------------------------------------------------------------------- in motion


@pytest.mark.serial
@pytest.mark.parametrize("ligand", ["0.5 + 0*x", STEEP["all_protrude"]])
def test_energy_closes_with_the_order_of_the_steps(ligand: str) -> None:
    """Measured 5.5e-5 and 1.5e-5 on ligands that are alike, 4.1e-5 and 1.3e-5 on those that change; with bonds as at
    rest in a step it was 9.3e-4 and 1.75e-3.
    """
    errors = []
    for factor in (0.8, 0.4):
        with built(case("one_cell", f'substrate.ligand="{ligand}"', f"time.step_factor={factor}")) as sim:
            sim.go(4.0)
            errors.append(sim.sample()[1]["energy_error"])
    assert errors[0] / errors[1] > 2.8 and errors[0] < 1e-4


@pytest.mark.serial
def test_a_drop_goes_to_where_ligands_are() -> None:
    with built(case("one_cell", 'substrate.ligand="0.5 + 0.04*x"', "protrusion.cells=[]")) as sim:
        before = sim.sample()[0][0]["x_um"]
        sim.go(8.0)
        assert sim.sample()[0][0]["x_um"] > before + 5e-3  # measured 6.1e-3, and less than 1e-15 on equal ligands


def test_ligands_have_the_same_bits_on_any_ranks() -> None:
    hashes = set()
    for comm in (MPI.COMM_WORLD, MPI.COMM_SELF):
        with built(scene_of("all_protrude", STEEP["all_protrude"]), comm) as sim:
            sim.go(0.5)
            hashes.add(sim.state_hash())
    assert len(hashes) == 1
