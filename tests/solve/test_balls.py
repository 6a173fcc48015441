"""Mechanics in three dimensions: forces have an energy, motions as a whole cost nothing, bits are the same on ranks."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scenes import built, case, example
from space import Space, balls, bar, layout, scene_of, smooth

from mpi4py import MPI

from cellmig.case.pairs import Pairing
from cellmig.case.pointwise import pointwise
from cellmig.meshfree.contact import Surfaces
from cellmig.meshfree.scene import Scene
from cellmig.meshfree.terms import Contacts, Frictions, Terms
from cellmig.model.cortex import LineTension
from cellmig.model.seifert import BetweenCells
from cellmig.parallel.collect import Whole
from cellmig.solve.protrusion_noise import random_factor
from cellmig.solve.restart import restore, saved
from cellmig.solve.strain import StrainWatch

SEED = 5
SUBSTRATE = example("adhesion", "seifert")
FLUID, SOLID = example("material", "nematic"), example("material", "mooney-rivlin")
PUSH = replace(example("protrusion", "edge"), cells=("Cell-1", "Cell-3"), protrusion_ratio=0.06, height=1.0)
RUBBING = Frictions((example("friction", "bonds"),), np.zeros(9, int))
ALL = Terms(substrate=SUBSTRATE, cortex=LineTension(line_tension=30.0), stabilised=True, stiffened=True,
            bulk_damped=True, friction=RUBBING, acceleration=(1.0, -2.0, 3.0), protrusion=PUSH, dimension=3)
BETWEEN = BetweenCells(**asdict(replace(SUBSTRATE, bond_density=1000.0, cutoff=0.5)))
BOX = ('{name="Box", shape="box", a="5.395 um", b="3.034 um", c="7.522 um", material="nucleus", '
       'centre=["0 um", "0 um", "20 um"], velocity=["0.142 um/us", "0.167 um/us", "-0.089 um/us"]}')
EGG = ('{name="Egg", shape="ellipsoid", a="2.062 um", b="4.991 um", c="2.943 um", material="nucleus", '
       'centre=["4.772 um", "-2.89 um", "18.139 um"], velocity=["-0.147 um/us", "-0.232 um/us", "-0.039 um/us"]}')
BONDS = ('adhesion.cells={bond_density="5000 /um^2", well_depth="0.024 pN um", equilibrium_distance="10 nm", '
         'cutoff="0.5 um"}')
STILL = Terms(stabilised=False, bulk_damped=False, stiffened=True, dimension=3)  # what has an energy
MOVING = Terms(stabilised=True, bulk_damped=True, dimension=3)  # what resists motion


@cache
def cells(count: int = 1, size: int = 200, nucleus: bool = True) -> Scene:
    """Balls 11 nm above the substrate, of fluid with a solid nucleus."""
    return balls((FLUID, SOLID if nucleus else None), size, count, 0.011)


def touching(terms: Terms, cells: int) -> Terms:
    """The same terms and contact between the cells."""
    pairing = Pairing(np.zeros(cells, int), np.zeros((1, 1), int), np.zeros(1, int))
    return replace(terms, contact=BETWEEN, contacts=Contacts((BETWEEN,), pairing, False))


@cache
def row(count: int = 2, size: int = 200) -> Scene:
    """Balls that nearly touch each other."""
    return scene_of(layout(size, 5.0), (FLUID, None), count, 10.0, 0.011)


def energy(scene: Scene, u: np.ndarray) -> float:
    """Energy of solids and of their stabilisation, of all particles at u [pN µm]."""
    total = 0.0
    for c, kind in enumerate(scene.kind):
        t, on = scene.templates[kind], slice(*scene.offset[c : c + 2])
        F = np.array([[g @ u[on, i] for g in t.G] for i in range(3)]) + np.eye(3)[:, :, None]
        total += t.V @ pointwise(t.laws[0], "energy", {"F": F}) + 0.5 * (u[on] * (t.E @ u[on])).sum()
    return float(total)


# ---------------------------------------------------------------------------------------------------------- forces


@pytest.mark.parametrize("law", [SOLID, example("material", "gel")], ids=lambda law: law.law)
def test_forces_are_minus_the_gradient_of_the_energy(comm: MPI.Comm, law: Any) -> None:
    scene = bar(law)
    u, way, h = smooth(scene.X, 0.05), smooth(scene.X, 1.0, SEED + 1), 1e-5
    with Space(scene, STILL, comm, u) as space:
        power = float((space.forces() * way).sum())
    slope = (energy(scene, u - h * way) - energy(scene, u + h * way)) / (2.0 * h)
    assert power == pytest.approx(slope, rel=1e-8)  # measured 6e-10: of the difference


def test_forces_of_tension_are_minus_the_gradient_of_its_energy(comm: MPI.Comm) -> None:
    scene = cells(nucleus=False)
    terms = replace(STILL, cortex=LineTension(line_tension=30.0))
    u, way, h = smooth(scene.X, 0.2), smooth(scene.X, 1.0, SEED + 1), 1e-4
    found = []
    for k in (0.0, -h, h):
        with Space(scene, terms, comm, u + k * way) as space:
            force, stored = (space.everywhere(a) for a in space.mechanics.surface_force("cortex"))
            found.append((force * way).sum() if k == 0.0 else stored.sum())
    assert found[0] == pytest.approx((found[1] - found[2]) / (2.0 * h), rel=1e-8)  # measured 5e-10


def test_forces_of_contact_are_minus_the_gradient_of_its_energy(comm: MPI.Comm) -> None:
    scene, terms = row(), touching(STILL, 2)
    way, h, found = smooth(scene.X, 1.0, SEED + 1), 2e-6, []
    for k in (0.0, -h, h):
        with Space(scene, terms, comm, k * way) as space:
            force, stored = (space.everywhere(a) for a in space.mechanics.surface_force("contact"))
            found.append(force if k == 0.0 else stored.sum())
    force, low, high = found
    size = np.abs(force).sum()
    assert size > 3.0  # pN; measured 6.0
    assert np.abs(force.sum(axis=0)).max() < 1e-14 * size  # measured 3e-16
    assert np.abs(np.cross(scene.X, force).sum(axis=0)).max() < 1e-13 * size  # µm; measured 8e-16
    power, slope = (force * way).sum(), (low - high) / (2.0 * h)
    assert power == pytest.approx(slope, abs=1e-6 * size)  # measured 9e-8: of Gauss points


def test_inner_forces_have_no_resultant_and_no_moment(comm: MPI.Comm) -> None:
    scene = cells()
    u, v = smooth(scene.X, 0.3), smooth(scene.X, 1.0, SEED + 1)
    terms = replace(ALL, substrate=None, friction=None, protrusion=None, acceleration=None)
    with Space(scene, terms, comm, u, v) as space:
        f = space.forces()
    size = np.abs(f).sum()
    assert np.abs(f.sum(axis=0)).max() < 1e-14 * size  # measured 2e-17
    assert np.abs(np.cross(scene.X + u, f).sum(axis=0)).max() < 1e-14 * size  # µm; measured 1e-16


def test_rotation_of_a_deformed_body_costs_no_power(comm: MPI.Comm) -> None:
    scene = cells(nucleus=False)
    u = smooth(scene.X, 0.4)
    turning = np.cross([0.3, -0.5, 0.8], scene.X + u)
    rest, turned = [], []
    for v, found in ((np.zeros_like(u), rest), (turning, turned), (smooth(scene.X, 1.0, SEED + 2), turned)):
        with Space(scene, MOVING, comm, u, v) as space:
            found.append(space.forces())
    viscous = [np.abs(f - rest[0]).max() for f in turned]
    assert viscous[0] < 1e-13 * viscous[1]  # measured 5e-16


def test_what_resists_motion_takes_as_much_power_as_it_dissipates(comm: MPI.Comm) -> None:
    scene = cells(nucleus=False)
    u, v = smooth(scene.X, 0.3), smooth(scene.X, 1.0, SEED + 1)
    with Space(scene, MOVING, comm, u) as space:
        elastic = space.forces()
    with Space(scene, MOVING, comm, u, v) as space:
        power = -((space.forces() - elastic) * v).sum()
        rates = space.mechanics.powers()
        lost = sum(space.everywhere(rates[name]).sum() for name in ("viscous_loss", "artificial_dissipation"))
    assert power > 0.0
    assert lost == pytest.approx(power, rel=1e-12)  # measured 2e-16


# ---------------------------------------------------------------------------------------------------- ranks and time


@cache
def alone(count: int, single: bool) -> bytes:
    """The state after some steps on one rank."""
    return _after(MPI.COMM_SELF, count, single)


def _after(comm: MPI.Comm, count: int, single: bool, terms: Terms = ALL) -> bytes:
    with Space(cells(count), replace(terms, single=single), comm) as space:
        space.integrator.advance_to(0.3)
        return space.state()


@cache
def touching_alone() -> bytes:
    """The state of three cells in contact on one rank."""
    return _in_contact(MPI.COMM_SELF)


def _in_contact(comm: MPI.Comm) -> bytes:
    with Space(row(3), touching(ALL, 3), comm) as space:
        space.integrator.advance_to(0.2)
        return space.state()


def test_cells_in_contact_have_the_same_bits_on_any_number_of_ranks(comm: MPI.Comm) -> None:
    assert _in_contact(comm) == touching_alone()


@pytest.mark.serial
def test_features_that_rest_add_no_bit(comm: MPI.Comm) -> None:
    """Of balls that roll over each other: where all are computed at each step, nothing changes."""
    scene, found = row(), []
    v = np.where(scene.X[:, :1] > scene.X[:, 0].mean(), -1.0, 1.0) * [0.6, 0.8, 0.3]
    for awake in (False, True):
        with Space(scene, replace(touching(MOVING, 2), stiffened=True), comm, 0.0, v) as space:
            for k in range(1, 101):
                for kind in ("face", "side", "vertex"):
                    rests = space.mechanics.kernel[f"{kind}_rest"]
                    rests[:] = -1.0 if awake else rests
                space.integrator.advance_to(0.004 * k)
            found.append(space.state())
    assert found[0] == found[1]


@pytest.mark.parametrize("single", [False, True], ids=["double", "single"])
@pytest.mark.parametrize("count", [1, 4])
def test_balls_have_the_same_bits_on_any_number_of_ranks(comm: MPI.Comm, count: int, single: bool) -> None:
    assert _after(comm, count, single) == alone(count, single)


@pytest.mark.serial
def test_copies_that_share_coefficients_move_alike() -> None:
    """Three cells that are computed together do what one does, but for the last bits of where they are."""
    terms = replace(ALL, protrusion=None)
    state = np.frombuffer(_after(MPI.COMM_SELF, 3, False, terms)).reshape(3, -1, 6)
    one = np.frombuffer(_after(MPI.COMM_SELF, 1, False, terms)).reshape(-1, 6)
    for ball in state:
        assert np.abs(ball - one).max() < 1e-12 * np.abs(one).max()  # measured 2e-16


def test_a_ball_goes_on_with_the_same_bits_after_a_checkpoint(comm: MPI.Comm) -> None:
    with Space(cells(2), ALL, comm) as space:
        space.integrator.advance_to(0.2)
        kept = saved(space.mechanics), space.integrator.saved()
        space.integrator.advance_to(0.4)
        right = space.state()
    with Space(cells(2), ALL, comm) as space:
        (about, arrays), integrator = kept
        restore(space.mechanics, about, Whole(comm, arrays))
        space.integrator.restore(integrator, {})
        space.integrator.advance_to(0.4)
        assert space.state() == right


def test_looking_at_a_ball_changes_no_bit(comm: MPI.Comm) -> None:
    found = []
    for often in (1, 4):
        with Space(cells(), ALL, comm) as space:
            for k in range(1, 5):
                space.integrator.advance_to(0.1 * k)
                if k % (4 // often) == 0:
                    space.sample()
            found.append(space.state())
    assert found[0] == found[1]


def test_a_protruding_ball_gains_the_impulse_of_its_push(comm: MPI.Comm) -> None:
    terms = replace(ALL, acceleration=None, friction=None)
    with Space(cells(), terms, comm) as space:
        space.integrator.advance_to(2.0)
        m = space.mechanics
        momentum, impulse = space.sampler.momentum(), m.accounts.protrusion_impulse()
        assert impulse > 0.0
        assert momentum[0] == pytest.approx(impulse, rel=1e-12)  # measured 5e-15
        assert abs(momentum[1]) < 1e-12 * impulse  # measured 7e-15


def test_the_random_push_is_a_function_of_the_place() -> None:
    """With correlation lengths far above the spacing, two discretisations have the same push."""
    law = replace(PUSH, correlation_length=4.0)
    values = []
    for size in (400, 1500):
        scene = balls((FLUID, None), size)
        X = scene.X[scene.surface(0)] - scene.centre[0]
        alpha = random_factor(scene, Surfaces.of(scene), law, 2019, ["Cell-1"])
        values.append([alpha[np.argsort(np.linalg.norm(X - way, axis=1))[:3]].mean() for way in 5.0 * np.eye(3)])
    assert np.abs(np.diff(values, axis=0)).max() < 0.1  # measured 0.04
    assert np.ptp(values) > 0.3  # measured 0.55


@pytest.mark.serial
def test_energy_closes_while_a_ball_spreads(comm: MPI.Comm) -> None:
    with Space(balls((FLUID, SOLID), 400, 1, 0.01), replace(ALL, acceleration=None, protrusion=None), comm) as space:
        space.integrator.advance_to(10.0)
        row, entries = space.sample()
        assert entries["energy_error"] < 0.005  # measured 0.0009
        assert row["substrate_contact_um2"] > 4.0  # measured 7.0
        J = space.mechanics.state.J_of_rows
        assert np.abs(J - 1.0).max() < 0.06  # measured 0.039, in the soft nucleus


@pytest.mark.serial
def test_energy_closes_while_balls_are_thrown_at_each_other(comm: MPI.Comm) -> None:
    """Triangles come so near that directions from the edges turn by any angle within them."""
    scene = row()
    to_the_left = np.where(scene.X[:, :1] > scene.X[:, 0].mean(), -1.0, 1.0) * [1.0, 0.0, 0.0]
    with Space(scene, replace(touching(MOVING, 2), stiffened=True), comm, 0.0, to_the_left) as space:
        space.integrator.advance_to(0.4)
        assert space.sample()[1]["energy_error"] < 0.001  # measured 1e-5


@pytest.mark.serial
def test_energy_closes_while_edges_slide_past_each_other(comm: MPI.Comm) -> None:
    """What contact has serves for more of shorter steps, and yet they lose less."""
    sliding = case("ball", f"cells=[{BOX}, {EGG}]", BONDS, "time.step_factor=0.1", per_cell=100)
    with built(sliding, comm) as sim:
        sim.go(0.8)
        # measured 5e-5, as where pieces are found in each step; 0.07 if flat gaps say how far surfaces may slip
        assert sim.sample()[1]["energy_error"] < 3e-4


@pytest.mark.serial
def test_energy_closes_while_balls_pass_each_other(comm: MPI.Comm) -> None:
    """All pieces of a triangle are found in the same steps, so that they are parts of it."""
    balls = [f'{{name="{name}", shape="ball", radius="3 um", material="nucleus", centre=[{at}], velocity=[{v}]}}'
             for name, at, v in (("A", '"0 um", "0 um", "20 um"', '"0 um/us", "0 um/us", "0 um/us"'),
                                 ("B", '"6.2 um", "0.3 um", "20 um"', '"-0.1 um/us", "0.6 um/us", "0 um/us"'))]
    passing = case("ball", f"cells=[{', '.join(balls)}]", BONDS.replace("10 nm", "20 nm"), per_cell=120)
    with built(passing, comm) as sim:
        sim.go(3.0)
        # measured 3e-4; 1e-5 where they are found in each step, 0.01 in steps of each piece's own
        assert sim.sample()[1]["energy_error"] < 6e-4


@pytest.mark.serial
def test_breathing_of_an_elastic_ball_has_the_frequency_of_lamb(comm: MPI.Comm) -> None:
    """The lowest radial mode: 4 (c_t/c_l)² (1 - q cot q) = q², with q = ω R/c_l (Lamb 1882)."""
    law = replace(SOLID, stabilisation=0.0, hourglass_modulus=0.16)
    ratio = law.shear_modulus / (law.density * law.sound_speed**2)
    q = np.linspace(1.5, 3.1, 200001)
    q = q[np.argmin(np.abs(4.0 * ratio * (1.0 - q / np.tan(q)) - q * q))]
    period = 2.0 * np.pi * 5.0 / (q * law.sound_speed)
    scene = balls((law, None), 1000)
    r = np.linalg.norm(scene.X - scene.centre, axis=1)[:, None]
    k = q / 5.0
    shape = (scene.X - scene.centre) * (np.sin(k * r) / (k * r) ** 2 - np.cos(k * r) / (k * r)) / r
    mass, times, swing = scene.field("mass"), np.linspace(0.4, 0.6, 9) * period, []
    with Space(scene, replace(STILL, acceleration=None), comm, 1e-4 * shape) as space:
        for time in times:
            space.integrator.advance_to(float(time))
            space.mechanics.resume()
            swing.append(float(mass @ (space.everywhere(space.mechanics.state.u) * shape).sum(axis=1)))
    turn = -np.polyfit(times, swing, 2)[1] / (2.0 * np.polyfit(times, swing, 2)[0])  # farthest on the other side
    assert turn == pytest.approx(0.5 * period, rel=0.02)  # measured 0.007


def test_a_surface_that_is_folded_at_another_cell_is_told_once() -> None:
    with built(case("three_balls", per_cell=100)) as sim:
        m = sim.mechanics
        watch, (cosine, particle) = StrainWatch(m), min(m.comm.allgather(m.segments.sharpest()))
        assert cosine > 0.7 and watch.check(0.0) == ""  # measured 0.90
        x, facets = sim.scene.particles(np.arange(sim.scene.size)).X, m.segments.around()[0]
        corners = next(f for f in facets.ids[facets.facets].tolist() if f[0] == particle)
        p, q, r = x[corners]
        along = (r - q) / np.linalg.norm(r - q)
        m.state.u[m.ids == particle] = 1.9 * (q - p + ((p - q) @ along) * along)  # nearly mirrored at the other side
        m.state.exchange()
        told = [watch.check(1.0), watch.check(2.0)]
        assert f"surface of cell {int(sim.scene.cell_of(particle)) + 1} is folded at particle" in told[0]
        assert told[1] == ""
