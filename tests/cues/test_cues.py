"""Every cue, and the exact answers of those that have one, on rigid cells."""

from __future__ import annotations

import time

import numpy as np
import pytest
from scenes import EXAMPLES
from scipy.special import erf, ive
from senses import Profile, ball, disc, polygon, sensed, tube

from cellmig.case.expression import Expression
from cellmig.case.level import Level
from cellmig.case.registry import laws
from cellmig.case.units import number
from cellmig.case.values import declared, required
from cellmig.cues.contact import Contact
from cellmig.cues.contacts import closeness
from cellmig.cues.cue import Cue
from cellmig.cues.given import Given
from cellmig.cues.motion import Motion
from cellmig.cues.neighbours import Neighbours
from cellmig.cues.occupancy import Occupancy
from cellmig.cues.surroundings import Surroundings
from cellmig.laws import register

pytestmark = pytest.mark.serial  # cues are found on one rank

register()
CUES = list(laws("cue"))
K = Level.of("10")


def row(count: int, points: int = 120, pitch: float = 10.2, fields: dict | None = None) -> Surroundings:
    """Discs of 10 µm side by side, in reach of their neighbours."""
    return sensed(*[disc(points, (pitch * k, 5.2)) for k in range(count)], fields=fields)


def crowd(d: int, mirrored: bool = False, **more: object) -> Surroundings:
    """Four cells in contact and one alone, that move, with polarities and a field; or their mirror image."""
    rng = np.random.default_rng(3)
    places = np.array([(0.0, 5.2, 5.2), (10.2, 5.2, 5.2), (20.3, 6.0, 5.2), (10.2, 15.4, 5.4), (60.0, 5.2, 5.2)])
    if d == 2:
        places = places[:, 1:] * [0, 1] + places[:, :1] * [1, 0] + [[0, 0], [0, 0], [0, 1], [3, 10.3], [0, 0]]
    sign = np.ones(d)
    sign[0] = -1.0 if mirrored else 1.0
    bodies = [(ball(400, place) if d == 3 else disc(90, place)) for place in places]
    field = Profile(lambda x: 20.0 + 5.0 * np.tanh(sign[0] * x[:, 0] / 20.0) + 0.1 * x[:, -2] * sign[-2])
    p, v = rng.standard_normal((2, 5, d - 1)) * sign[:-1]
    return sensed(*[(points * sign, facets) for points, facets in bodies], fields={"c": field.function}, polarity=p,
                  velocity=1e-6 * v, **more)


def any_cue(name: str, d: int, **changes: object) -> Cue:
    """A cue with its defaults, and examples of what has none: in the field of `crowd`."""
    cls, ready = laws("cue")[name], {"field": "c", "affinity": K, "vector": (0.5,) * (d - 1)}
    needed = {key: f for key, f in declared(cls).items() if required(f)}
    return cls(**{key: ready.get(key) or number(f"{EXAMPLES[f.metadata['unit']]} {f.metadata['unit']}",
                                                f.metadata["unit"]) for key, f in needed.items()} | changes)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("name", CUES)
def test_a_cue_is_a_finite_vector_along_the_substrate_for_the_cells_that_it_names(name: str, d: int) -> None:
    around, of_all, of_two = crowd(d), any_cue(name, d), any_cue(name, d, cells=("Cell-1", "Cell-3"))
    found, some = of_all.value(around), of_two.value(around)
    assert found.shape == some.shape == (5, d - 1)
    assert np.isfinite(found).all()
    assert np.any(found != 0.0)
    assert np.array_equal(some[[0, 2]], found[[0, 2]])
    assert not some[[1, 3, 4]].any()
    assert np.allclose(any_cue(name, d, gain=-2.0 * of_all.gain).value(around), -2.0 * found)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("name", [name for name in CUES if name != "given"])
def test_mirrored_surroundings_give_the_mirrored_cue(name: str, d: int) -> None:
    cue, sign = any_cue(name, d), np.array([-1.0, 1.0])[: d - 1]
    found, mirrored = cue.value(crowd(d)), cue.value(crowd(d, mirrored=True))
    assert np.abs(mirrored - sign * found).max() <= 1e-12 * np.abs(found).max()  # measured 2e-15


# ------------------------------------------------------------------------------------------------------ occupancy


@pytest.mark.parametrize("body", [disc(40, (3.0, 5.2)), ball(200, (3.0, 1.0, 5.2)),
                                  polygon([(0, 0), (12, 0), (9, 3), (4, 4)])], ids=["disc", "ball", "polygon"])
def test_occupancy_that_is_linear_across_the_cell_is_found_exactly(body: tuple) -> None:
    """Whatever the shape and the spacing: the fit is exact."""
    slope = np.array([0.01, -0.004])[: body[0].shape[1] - 1]
    share = lambda x: 0.4 + x[:, :-1] @ slope  # noqa: E731
    around = sensed(body, fields={"c": lambda x: 10.0 * share(x) / (1.0 - share(x))})
    found = Occupancy(field="c", affinity=K, gain=1.0).value(around)[0]
    assert np.abs(found - around.length[0] * slope).max() <= 1e-13  # measured 1e-16


def test_the_difference_is_largest_at_the_affinity_and_falls_as_the_law_of_binding() -> None:
    """Gradients of equal ΔC/C = 1 %: ΔΘ = 0.01 c K/(c + K)², index of the plane by receptors falls on both sides."""
    levels = 10.0 * np.array([0.01, 0.1, 0.5, 1.0, 2.0, 10.0, 100.0])
    found = [float(Occupancy(field="c", affinity=K, gain=1.0).value(
        sensed(disc(200, (0.0, 5.2)), fields={"c": lambda x, c=c: c * (1.0 + 0.001 * x[:, 0])}))[0, 0]) for c in levels]
    assert np.argmax(found) == 3
    assert np.allclose(found, 0.01 * levels * 10.0 / (levels + 10.0) ** 2, rtol=1e-4)  # measured 2e-5, of curvature


def test_without_molecules_there_is_no_cue_and_a_full_cell_has_none() -> None:
    for level in (0.0, -1.0, 1e12):
        around = sensed(disc(40, (0.0, 5.2)), fields={"c": lambda x, c=level: c * (1.0 + 0.01 * x[:, 0])})
        assert np.abs(Occupancy(field="c", affinity=K, receptors=1e4).value(around)).max() < 1e-5


def found_steepness(body: tuple, steepness: float, cells: int = 400, knots: int = 10) -> np.ndarray:
    """ΔC/C as equal cells with 5e4 receptors find it at some knots (cells · knots, d - 1), at c = K, along x."""
    points, facets = body
    points = points - 0.5 * (points.max(axis=0) + points.min(axis=0))
    fields = {"c": lambda x: 10.0 * (1.0 + steepness * x[:, 0] / float(np.ptp(points[:, 0])))}
    cue = Occupancy(field="c", affinity=K, gain=1.0, receptors=5e4)
    return np.concatenate([cue.value(sensed(*[(points, facets)] * cells, fields=fields, knot=k))
                           for k in range(knots)]) / 0.25


@pytest.mark.parametrize(("body", "factor"), [(disc(40, (0.0, 5.2)), 8.0), (tube(24), 8.0),
                                              (ball(200, (0.0, 0.0, 5.2)), 12.0),
                                              (polygon([(0, 0), (10, 0), (10, 1e5), (0, 1e5)]), 4.0)],
                         ids=["disc from the side", "ring", "ball", "two ends"])
def test_the_noise_of_receptors_is_that_of_the_fit(body: tuple, factor: float) -> None:
    """Variance of ΔC/C = factor (c + K)²/(N c K): for a ring that of Hu et al. (2011), 0.0253² for 5e4 receptors."""
    found = found_steepness(body, 0.0)
    exact = factor * 4.0 / 5e4
    assert np.abs(found.var(axis=0) / exact - 1.0).max() < 0.07  # 3 standard errors; measured 0.005 to 0.03
    assert np.abs(found.mean(axis=0)).max() < 3.5 * np.sqrt(exact / 4000)


@pytest.mark.parametrize(("steepness", "index"), [(0.01, 0.243), (0.05, 0.840)])
def test_receptors_limit_the_direction_that_a_cell_finds(steepness: float, index: float) -> None:
    """Mean of cos φ of what a ring of 5e4 receptors finds at c = K, in a gradient of 1 and 5 % across it."""
    found = found_steepness(tube(24), steepness)
    cosine = found[:, 0] / np.linalg.norm(found, axis=1)
    ratio = steepness / np.sqrt(8.0 * 4.0 / 5e4)
    a = ratio**2 / 4.0
    assert np.sqrt(np.pi / 8.0) * ratio * (ive(0, a) + ive(1, a)) == pytest.approx(index, abs=6e-4)
    assert cosine.mean() == pytest.approx(index, abs=3.5 * cosine.std() / np.sqrt(len(cosine)))


def test_seen_from_the_side_a_cell_finds_the_right_way_as_often_as_chance_allows() -> None:
    found = found_steepness(disc(40, (0.0, 5.2)), 0.02)[:, 0]
    exact = erf(0.02 / np.sqrt(2.0 * 8.0 * 4.0 / 5e4))
    assert np.sign(found).mean() == pytest.approx(exact, abs=3.5 / np.sqrt(4000))


def test_noise_belongs_to_the_name_of_a_cell_the_knot_and_the_seed_alone() -> None:
    cells, field = [disc(40, (30.0 * k, 5.2)) for k in range(3)], {"c": lambda x: 10.0 + 0.01 * x[:, 0]}
    cue = Occupancy(field="c", affinity=K, receptors=1e4)
    names = ("A", "B", "C")
    found = cue.value(sensed(*cells, fields=field, names=names))
    other = cue.value(sensed(*cells[::-1], fields=field, names=names[::-1]))
    assert np.array_equal(found, other[::-1])
    for change in ({"knot": 1}, {"seed": 2}):
        assert np.all(cue.value(sensed(*cells, fields=field, names=names, **change)) != found)


# ------------------------------------------------------------------------------------------------------- contacts


def test_cells_turn_away_from_contacts_or_towards_them_and_inner_cells_do_not_turn() -> None:
    around = row(5)
    found = Contact().value(around)[:, 0]
    assert found[0] < -0.1
    assert found[4] == pytest.approx(-found[0], rel=1e-12)
    assert np.abs(found[1:4]).max() < 1e-14
    assert np.array_equal(Contact(gain=-1.0).value(around)[:, 0], -found)
    assert not Contact().value(row(3, pitch=12.0)).any()  # 2 µm apart


@pytest.mark.parametrize("count", [1, 2, 3, 5, 10])
def test_a_row_whose_contact_cue_grows_with_the_level_turns_up_the_gradient(count: int) -> None:
    """The mean cue is β' g d (N - 1)/N times the share of an end contact: a single cell has none."""
    share = lambda x: 0.2 + 0.004 * x[:, 0]  # noqa: E731 -- β, linear: β' g is 0.004 per µm
    around = row(count, fields={"c": lambda x: 10.0 * share(x) / (1.0 - share(x))})
    found = Contact(field="c", affinity=K).value(around)[:, 0].mean()
    touch = around.near(1.0).share[0] if count > 1 else 0.0  # 0.109
    assert found == pytest.approx(touch * 0.004 * 10.2 * (count - 1) / count, rel=1e-9, abs=1e-15)  # measured 1e-14


@pytest.mark.parametrize(("d", "bounds"), [(2, (0.05, 0.025, 0.006)), (3, (0.2, 0.05, 0.015))])
def test_contacts_hardly_depend_on_the_spacing(d: int, bounds: tuple) -> None:
    """Discs and balls of 10 µm, 0.2 µm apart, reach 1 µm, against the integral over the circle and the sphere."""
    angle = np.linspace(0.0, np.pi, 20_001)
    weight = closeness(np.sqrt(25.0 + 10.2**2 - 102.0 * np.cos(angle)) - 5.0, 1.0)
    exact = (weight * (1.0 / np.pi if d == 2 else 0.5 * np.sin(angle))).sum() * angle[1]  # 0.1094, 0.0294
    for count, bound in zip({2: (31, 63, 126), 3: (200, 800, 3200)}[d], bounds, strict=True):
        cells = [disc(count, (10.2 * k, 5.2)) if d == 2 else ball(count, (10.2 * k, 0.0, 5.2)) for k in range(2)]
        found = Contact().value(sensed(*cells))[1, 0]  # spacings of 1, 0.5, 0.25 µm; in space of 1.3, 0.6, 0.3 µm
        assert abs(found / exact - 1.0) < bound, found  # measured 0.031, 0.018, 0.0024; in space 0.18, 0.048, 0.012


def test_the_gate_is_one_in_contact_zero_beyond_and_gradual_between() -> None:
    around = row(3, points=1200)
    gate, x = around.gate(1.0), around.x
    middle = around.surfaces.cell == 1
    away = np.abs(np.linalg.norm(x[middle] - [0.0, 5.2], axis=1) - 5.0)
    away = np.minimum(away, np.abs(np.linalg.norm(x[middle] - [20.4, 5.2], axis=1) - 5.0))
    assert np.all(gate[middle][away < 0.499] == 1.0)
    assert not gate[middle][away > 1.001].any()
    assert np.abs(np.diff(gate[middle])).max() < 0.05  # points are 26 nm apart
    assert not row(1).gate(1.0).any()


def test_cells_align_with_neighbours_in_contact_alone() -> None:
    bodies = [disc(60, (10.2 * k, 5.2)) for k in range(3)] + [disc(60, (60.0, 5.2))]
    found = Neighbours().value(sensed(*bodies, polarity=[[1.0], [0.0], [-0.5], [2.0]]))[:, 0]
    assert found == pytest.approx([-1.0, 0.25, 0.5, 0.0], abs=1e-14)


def test_alignment_of_two_cells_conserves_their_polarity_however_far_they_are() -> None:
    for gap in (0.2, 0.6, 0.8, 1.1):
        around = sensed(disc(60, (0.0, 5.2)), disc(77, (10.0 + gap, 5.7)), polarity=[[1.0], [-0.2]])
        assert abs(Neighbours().value(around).sum()) < 1e-15


def test_motion_is_a_direction_for_fast_cells_and_proportional_for_slow_ones() -> None:
    around = sensed(disc(40, (0.0, 5.2)), disc(40, (20.0, 5.2)), velocity=[[1e-6], [-1e-12]])
    assert Motion(speed=1e-8).value(around)[:, 0] == pytest.approx([1.0, -1e-4], rel=1e-4)


def test_what_is_given_is_taken_at_the_place_of_the_cell() -> None:
    around = row(3)
    assert np.array_equal(Given(vector=(1.0,), cells=("Cell-2",)).value(around)[:, 0], [0.0, 1.0, 0.0])
    formula = Expression("0.1*x", "")
    assert Given(vector=(formula,)).value(around)[:, 0] == pytest.approx([0.0, 1.02, 2.04], abs=1e-12)


def test_cues_cost_little_beside_a_step() -> None:
    """Ten cells of 60 surface particles: contacts, once for all cues, and a gradient."""
    field = {"c": lambda x: 10.0 + 0.01 * x[:, 0]}
    best = np.inf
    for _ in range(5):
        around, start = row(10, points=60, fields=field), time.perf_counter()
        Contact().value(around)
        Neighbours().value(around)
        Occupancy(field="c", affinity=K, receptors=1e4).value(around)
        around.gate(1.0)
        best = min(best, time.perf_counter() - start)
    assert best < 0.02  # seconds; measured 0.002
