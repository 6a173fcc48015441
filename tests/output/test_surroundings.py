"""Tables of forces: what the substrate and the neighbours do to cells, as means between two rows and at an instant."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scenes import built, case, everywhere

from mpi4py import MPI

from cellmig.case.schema import Case
from cellmig.output.fields import FIELDS
from cellmig.output.interval import spread
from cellmig.output.tables import ALONG, FORCE, LEDGER, MEASURES, NEIGHBOURS, SUBSTRATE, History, read_table
from cellmig.parallel.reduce import exact_sum
from cellmig.simulation import Simulation

COMM = MPI.COMM_WORLD
DRAG = 'friction.coefficient="200 Pa us/um"'
FAST = "cells.0.velocity=['3 um/us', '-0.5*y um/us']"  # lists are renewed within the run
PRESSED = "cells.0.velocity=['-4 um/us', '-1 um/us']"  # batches are undone
SIDEWAYS = "cells.0.velocity=['-0.7 um/us', '2 um/us', '-0.2*z um/us']"  # lists are renewed, and batches undone
SCENES = {"protrusion and friction": ("all_protrude", DRAG), "lists renewed": ("all_protrude", DRAG, FAST),
          "batches undone": ("all_protrude", PRESSED), "in space": ("three_balls", DRAG, SIDEWAYS)}
BOTH = pytest.mark.parametrize("name", ["lists renewed", "in space"])


def scene_of(name: str) -> Case:
    """A scene of three cells."""
    return case(*SCENES[name], per_cell=100)


def rows_of(sim: Simulation, stops: list[float]) -> list[tuple[list, dict, np.ndarray]]:
    """History, other rows, and momenta of the cells at the time of the positions, at the start and some times."""
    found = []
    for stop in [0.0, *stops]:
        if stop:
            sim.go(stop)
        history, _ = sim.sample()
        d = sim.scene.dimension
        acceleration = sim.integrator.rate()[:, d:]
        v = everywhere(sim, sim.mechanics.state.owned[:, d:] + sim._half_step * acceleration)
        momentum = np.zeros((sim.sampler.n_cells, d))
        np.add.at(momentum, sim.scene.cell, sim.scene.field("mass")[:, None] * v)
        found.append((history, sim.next_row(history), momentum))
    return found


def on_cells(sim: Simulation, surroundings: dict, kind: str = "") -> np.ndarray:
    """Forces of the substrate and of the other cells on each cell (cells, d) [pN/µm], as the tables have them."""
    d = sim.scene.dimension
    force, size = np.zeros((sim.sampler.n_cells, d)), sim.interval.width ** (d - 1)
    for row in surroundings["substrate"]:
        traction = *(row[f"tangential{axis}{kind}_pa"] for axis in ALONG[d]), row[f"normal{kind}_pa"]
        force[row["cell"] - 1] -= np.multiply(size, traction)
    for row in surroundings["neighbours"]:
        pair = np.array([row[f"force_{axis}{kind}_{FORCE[d]}"] for axis in "xyz"[:d]])
        force[row["cell"] - 1] += pair
        force[row["neighbour"] - 1] -= pair
    return force


@pytest.mark.parametrize("name", SCENES)
def test_mean_forces_of_the_tables_are_what_changes_the_momentum_of_each_cell(name: str) -> None:
    times = [0.1, 0.3, 0.35, 0.6]
    with built(scene_of(name)) as sim:
        found = rows_of(sim, times)
        if name == "lists renewed":
            assert sim.mechanics.segments.renewals > 2 + 2 * len(times)
        if name == "batches undone":
            assert sim.integrator.redone > 0
        for (_, _, before), (_, rows, after), elapsed in zip(found, found[1:], np.diff([0.0, *times]), strict=False):
            force = on_cells(sim, rows)
            size = max(np.abs(force).max() * elapsed, np.abs(after).max())
            assert np.abs(force).max() > 20.0  # pN/µm, in space pN; measured 28 and more
            assert np.abs(force * elapsed - (after - before)).max() < 1e-13 * size  # measured 1.3e-15


@pytest.mark.serial
@pytest.mark.parametrize(("kind", "tolerance"), [
    ("rk", 5e-4), ("cn", 2e-3),  # measured 1.1e-4, 7.0e-4, 3.5e-4: of the second order in the step
    pytest.param("alpha2", 1e-3, marks=pytest.mark.slow)])
def test_mean_forces_of_types_of_petsc_are_means_over_their_steps(kind: str, tolerance: float) -> None:
    with built(case("two_three", DRAG, f'time.integrator="{kind}"', 'time.step="2 ns"', per_cell=60)) as sim:
        (_, _, before), (_, rows, after) = rows_of(sim, [0.1])
        force, change = on_cells(sim, rows), (after - before) / 0.1
        assert np.abs(force - change).max() < tolerance * np.abs(change).max()


@pytest.mark.parametrize("name", ["protrusion and friction", "in space"])
def test_forces_of_now_are_what_accelerates_each_cell(name: str) -> None:
    with built(scene_of(name)) as sim:
        *_, (_, rows, _) = rows_of(sim, [0.3])
        d = sim.scene.dimension
        each = sim.scene.field("mass")[:, None] * everywhere(sim, sim.integrator.rate()[:, d:])
        now = np.zeros((3, d))
        np.add.at(now, sim.scene.cell, each)
        force = on_cells(sim, rows, "_now")
        assert np.abs(force - now).max() < 1e-14 * np.abs(each).sum()  # measured 1e-17


@BOTH
def test_the_table_has_the_whole_force_of_the_substrate_and_cells_pull_each_other_with_opposite_forces(
        name: str) -> None:
    with built(scene_of(name)) as sim:
        sim.go(0.6)
        history, _ = sim.sample()
        rows, d, m = sim.next_row(history), sim.scene.dimension, sim.mechanics
        each = sum(m.surface_force(term)[0] for term in ("substrate", "friction", "protrusion"))
        whole, size = exact_sum(sim.comm, each), exact_sum(sim.comm, np.abs(each)).sum()
        table = sum(np.array([*(row[f"tangential{axis}_now_pa"] for axis in ALONG[d]), row["normal_now_pa"]])
                    for row in rows["substrate"])
        assert np.abs(sim.interval.width ** (d - 1) * table + whole).max() < 1e-14 * size  # measured 2e-16
        key, force = m.accounts.impulses.key[1:], m.powers()["contact_impulse"][1:]
        on_by = exact_sum(sim.comm, force, 3 * m.scene.cell_at(key // 3) + key % 3, 9).reshape(3, 3, d)
        strength = exact_sum(sim.comm, np.abs(force)).sum()
        assert np.abs(on_by + on_by.swapaxes(0, 1)).max() < 1e-14 * strength  # measured 1e-16
        for row in rows["neighbours"]:
            pair = [row[f"force_{axis}_now_{FORCE[d]}"] for axis in "xyz"[:d]]
            assert pair == on_by[row["cell"] - 1, row["neighbour"] - 1].tolist()
        contact = MEASURES[d][1]
        touching = [row[end] for row in rows["neighbours"] if row[contact] > 0.0 for end in ("cell", "neighbour")]
        assert [row["neighbours"] for row in history[1:]] == [touching.count(cell) for cell in (1, 2, 3)]
        assert 3.0 * history[0]["neighbours"] == len(touching)
        assert sum(row[contact] for row in rows["neighbours"]) == pytest.approx(history[0][contact], rel=1e-12)


@BOTH
def test_forces_do_not_depend_on_the_ranks_nor_on_looks_between_two_rows(comm: MPI.Comm, name: str) -> None:
    scene = scene_of(name)
    with built(scene) as sim, built(scene, COMM.Split(COMM.rank, 0)) as alone:
        ours, theirs = rows_of(sim, [0.2, 0.5])[-1], rows_of(alone, [0.2, 0.5])[-1]
        assert ours[:2] == theirs[:2]
        assert ours[1]["substrate"] and ours[1]["neighbours"]


@BOTH
def test_means_go_on_from_a_checkpoint_with_the_same_bits(name: str) -> None:
    scene = scene_of(name)
    with built(scene) as sim, built(scene) as other:
        rows_of(sim, [0.2])
        sim.go(0.3)
        state = sim.saved()
        other.restore(*state)
        for one in (sim, other):
            one.go(0.5)
        rows = [(history := one.sample()[0], one.next_row(history)) for one in (sim, other)]
        assert rows[0] == rows[1]
        assert rows[0][1]["neighbours"]


def test_the_faces_of_two_boxes_touch_as_a_whole() -> None:
    boxes = ('cells=[{name="Box-{}", shape="box", a="2 um", b="3 um", c="3 um", material="cytoplasm", rest=true, '
             'centre=["1.01 um", "0 um", "0 um"], repeat=[2], pitch=[["-2.02 um", "0 um", "0 um"]]}]')
    with built(case("three_balls", boxes, "protrusion.cells=[]", per_cell=100)) as sim:
        (_, rows, _), = rows_of(sim, [])
        row, = rows["neighbours"]
        assert row["cell_contact_um2"] == pytest.approx(9.12, rel=1e-6)  # faces, and their sides up to a gap of 30 nm
        # 20 nm apart by the law for planes: 9 µm² of 4 Nσ/ε (2⁻³ - 2⁻⁵) = 900 Pa.
        assert row["pull_now_pn"] == pytest.approx(8100.0, rel=0.02)  # measured 0.015 more: at the edges
        assert {*row} <= {*NEIGHBOURS[3]}
        assert all({*one} <= {*SUBSTRATE[3]} for one in rows["substrate"])


def test_a_pull_of_neighbours_is_that_along_the_line_of_their_centres() -> None:
    with built(case("two_three", per_cell=100)) as sim:
        *_, (history, rows, _) = rows_of(sim, [0.1])
        row, one, other = rows["neighbours"][0], *history[2:4]
        line = np.array([other["x_um"] - one["x_um"], other["y_um"] - one["y_um"]])
        for kind in ("", "_now"):
            force = np.array([row[f"force_x{kind}_pn_per_um"], row[f"force_y{kind}_pn_per_um"]])
            assert row[f"pull{kind}_pn_per_um"] == pytest.approx(force @ line / np.linalg.norm(line), rel=1e-12)


def test_cells_move_by_their_mean_velocity_from_row_to_row() -> None:
    with built(case("all_protrude", FAST, per_cell=60)) as sim:
        (first, _, _), (second, _, _), (third, _, _) = rows_of(sim, [0.2, 0.5])
        assert "vx_um_per_us" not in first[0]
        for before, after in zip(second, third, strict=True):
            assert after["vx_um_per_us"] * 0.3 == pytest.approx(after["ux_um"] - before["ux_um"], rel=1e-12)
            assert after["speed_um_per_us"] == math.hypot(after["vx_um_per_us"], after["vy_um_per_us"])
        assert third[1]["vx_um_per_us"] == pytest.approx(3.0, rel=0.1)


def test_the_fields_of_a_frame_are_those_declared_whose_terms_the_scene_has() -> None:
    for name, sets, absent in (("all_protrude", (DRAG,), {"director", "sliding", "push_off"}), ("nucleus", (), {
            "director", "substrate", "contact", "friction", "protrusion", "sliding", "push_off"})):
        with built(case(name, *sets, per_cell=60)) as sim:
            fields = sim.sampler.fields()
            assert set(fields) == {name for name, field in FIELDS.items() if field.term not in absent}
            assert all(values.shape[1:] == FIELDS[name].shape for name, values in fields.items())


def test_the_friction_of_the_fields_takes_what_the_ledger_loses_to_it() -> None:
    with built(case("all_protrude", DRAG, FAST, per_cell=100)) as sim:
        before = sim.sample()[1]
        assert before["friction_loss_pn"] == 0.0
        sim.go(0.1)
        m = sim.mechanics
        after = sim.sample()[1]
        drag = sim.sampler.fields()["friction_force"]
        assert not drag[:, 1].any()
        power, rate = (exact_sum(sim.comm, values) for values in (-(drag * m.state.owned[:, 2:]).sum(axis=1),
                                                                  m.powers()["friction_loss"]))
        assert float(power) == pytest.approx(float(rate), rel=1e-12) and rate > 50.0
        assert after["friction_loss_pn"] > 10.0
        assert np.array_equal(m.surface_force("friction")[0], drag)  # looking changes nothing


def test_a_scene_without_a_term_has_no_rows_of_it() -> None:
    with built(case("one_cell", per_cell=60)) as sim:
        assert set(sim.next_row(sim.sample()[0])) == {"substrate"}
    with built(case("nucleus", per_cell=60)) as sim:
        assert sim.next_row(sim.sample()[0]) == {}


def test_a_force_is_spread_evenly_over_the_way_of_its_particle() -> None:
    number, piece, share = spread(np.array([[0.25], [-0.75]]), np.array([[2.5], [-0.25]]), 1.0)
    assert number.tolist() == [0, 0, 0, 1] and piece.tolist() == [[0], [1], [2], [-1]]
    assert share.tolist() == pytest.approx([0.75 / 2.25, 1.0 / 2.25, 0.5 / 2.25, 1.0])


@pytest.mark.serial
def test_names_with_commas_and_quotes_are_read_back(tmp_path) -> None:
    table = History(tmp_path, COMM, ("name",))
    table.names = ("all", 'left, "old"')
    table.write(0.0, [{"ux_um": 1.0}, {"ux_um": 2.0}])
    found = read_table(tmp_path / "history.csv")
    assert found["name"].tolist() == ["all", 'left, "old"'] and found["ux_um"].tolist() == [1.0, 2.0]


@pytest.mark.serial
def test_a_ledger_of_an_older_version_is_read_under_the_new_names(tmp_path) -> None:
    (tmp_path / "ledger.csv").write_text(
        "time_us,kinetic,elastic,compression,director,adhesion_substrate,adhesion_cells,protrusion_work,viscous_loss,"
        "numerical_loss,closure\n0.0,1.0,0.0,0.0,0.0,0.0,0.0,5.0,2.0,3.0,0.0\n")
    found = read_table(tmp_path / "ledger.csv")
    later = ("friction_loss_pn", "medium_loss_pn", "network_loss_pn", "renewal_loss_pn")
    assert tuple(found) == tuple(name for name in LEDGER[2] if name not in later)
    assert [found[f"{name}_pn"].tolist() for name in ("external_work", "artificial_dissipation")] == [[5.0], [3.0]]
    for old, new in (("protrusion_work", "external_work_pn"), ("closure", "energy_error"), ("kinetic", "kinetic_pn")):
        with pytest.raises(KeyError, match=f"'{old}' is called '{new}' now"):
            found[old]
