"""Cells that push off a gel: balance, work, the rigid substrate as the limit, ranks, what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenes import built, case, everywhere, set_motion, smooth
from test_forces import NO_ETA, SOFT, approach
from test_overdamped import GEL, at
from test_slab import BONDS, FRICTION, SCENES, on_a_slab, on_any_ranks

from mpi4py import MPI

from cellmig.case.load import from_dict
from cellmig.case.messages import CaseError
from cellmig.case.schema import Case

PUSH = {"protrusion_ratio": 3.0, "height": "1 um", "random": False}
CELL = {"name": "Cell", "shape": "segment", "width": "8 um", "height": "2.5 um", "material": "box",
        "centre": ["-2 um", "0.05 um"]}


def crawling(stiff: float = 1.0, way: float = 1.0, **more: Any) -> Case:
    """A cell on a slab of a stiffness C1 [kPa] that pushes off it along x."""
    tree = on_a_slab(CELL, pull=0.0, stiff=stiff, time={"end": "200 s"}).resolved()
    tree["materials"]["box"] = GEL
    del tree["loads"]
    tree["adhesion"]["pairs"][0]["push"] = True
    return from_dict(tree | {"protrusion": PUSH | {"cells": ["Cell"], "direction": [way]}} | more)


def on_the_plane() -> Case:
    """The same on a rigid substrate."""
    tree = crawling().resolved()
    tree["cells"], tree["adhesion"] = [CELL], {"substrate": BONDS}
    del tree["supports"]
    return from_dict(tree | {"friction": FRICTION})


def held_by_few_bonds(scene: str = "all_protrude") -> Case:
    """Three cells, of which the first pushes off both others by so few bonds that these do not hold all of its push."""
    tree = case(scene, *SOFT, NO_ETA).resolved()
    way = [-1.0] if scene == "all_protrude" else [-0.8, 0.6]
    tree["protrusion"] |= {"cells": ["Cell-1", "Cell-2"], "direction": way, "height": "0.3 um"}
    tree["adhesion"]["pairs"] = [tree["adhesion"]["cells"] | {"cells": ["Cell-2", ["Cell-1", "Cell-3"]], "push": True}]
    return from_dict(tree)


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_the_push_off_other_bodies_has_no_sum_and_no_moment_and_the_work_that_the_ledger_says(scene: str) -> None:
    with built(held_by_few_bonds(scene)) as sim:
        m = sim.mechanics
        x, v = approach(sim, 1), smooth(sim.scene.X, 6, 1.0)
        set_motion(sim, x - sim.scene.X, v)
        m.rate()
        total = everywhere(sim, m.accounts.rates()["external_work"]).sum()
        f, on_plane = (everywhere(sim, m.surface_force(term)[0]) for term in ("push_off", "protrusion"))
        each = np.array([np.bincount(sim.scene.cell, f[:, k]) for k in range(x.shape[1])])
        assert np.abs(each).max() > 1e-2 * np.abs(f).sum()
        assert np.abs(f.sum(axis=0)).max() < 1e-14 * np.abs(f).sum()  # measured 8e-18
        assert np.abs(np.cross(x, f).sum(axis=0)).max() < 1e-14 * np.abs(x * f).sum()  # measured 0
        held = sim.comm.allreduce(m.kernel["hold_off"].max(initial=0.0), MPI.MAX)
        assert 0.01 < held < 0.9  # of the whole push: measured 0.56, in space 0.05
        assert total == pytest.approx(((f + on_plane) * v).sum(), rel=1e-12)


@pytest.mark.serial
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_cell_crawls_on_a_gel_and_what_holds_the_gel_bears_nothing(way: float) -> None:
    with built(crawling(way=way)) as sim:
        at(sim, 60.0)
        rows, entries = sim.sample()
        push, v = sim.sampler.push(), 1e6 * everywhere(sim, sim.mechanics.state.v)[sim.scene.cell == 1, 0].mean()
        assert way * push[1, 0] > 30.0 and push[0, 0] == 0.0
        assert way * v > 1e-3  # measured 1.8e-3 µm/s
        assert abs(rows[1]["held_force_x_pn_per_um"]) < 1e-8 * abs(push[1, 0])  # measured 6e-12, of the balance
        assert rows[1]["dipole_pn"] < -50.0  # measured -105 pN
        assert rows[0]["strain_energy_pn"] == rows[1]["strain_energy_pn"] + rows[2]["strain_energy_pn"] > 0.0
        assert entries["energy_error"] < 1e-5  # measured 4e-7, 1.3e-6
        assert entries["friction_loss_pn"] > 0.8 * entries["external_work_pn"] > 0.0


def speed_and_push(scene: Case) -> np.ndarray:
    """Speed [µm/s] and push [pN/µm] of a cell after 100 s."""
    with built(scene) as sim:
        at(sim, 100.0)
        v = everywhere(sim, sim.mechanics.state.v)[sim.scene.cell == sim.scene.cell.max(), 0].mean()
        return np.array([1e6 * v, sim.sampler.push()[-1, 0]])


@pytest.mark.serial
def test_a_stiff_gel_is_the_rigid_substrate() -> None:
    """Forces go to both ends of each piece, and on the substrate to both ends of each segment."""
    rigid = speed_and_push(on_the_plane())
    for stiff, error in ((1.0, 1e-2), (1000.0, 1e-2)):
        found = speed_and_push(crawling(stiff))
        assert np.abs(found / rigid - 1.0).max() < error  # measured 0.5 % of both


def resting_on_a_gel() -> Case:
    """A cell that senses what is around it, on a gel."""
    tree = crawling().resolved()
    del tree["protrusion"]["direction"]
    tree["protrusion"]["gate"] = "1 um"
    return from_dict(tree | {"polarity": {"persistence": "10 s", "spread": 0.0, "start": [1.0]},
                             "cues": [{"law": "neighbours"}, {"law": "contact"}]})


@pytest.mark.serial
def test_a_gel_is_no_neighbour() -> None:
    """It neither turns cells nor gates their push, and a polarity drives them on it."""
    with built(resting_on_a_gel()) as sim:
        at(sim, 5.0)
        assert not any(part.any() for part in sim.guidance.parts.values())
        assert sim.sampler.push()[1, 0] == pytest.approx(np.exp(-0.5) * speed_and_push_at_once(), rel=0.01)


@pytest.mark.serial
def test_a_cell_that_does_not_push_is_no_gel() -> None:
    assert case("slab_crawl").gels == {"Gel"}
    assert crawling().gels == {"Gel"}  # whose cortex has no tension, as there is none


def speed_and_push_at_once() -> float:
    """Push [pN/µm] of the same cell after 5 s with p = 1."""
    with built(crawling()) as sim:
        at(sim, 5.0)
        return float(sim.sampler.push()[1, 0])


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_explicit_steps_of_cells_that_push_off_each_other_have_the_same_bits_on_any_ranks(scene: str) -> None:
    tree = held_by_few_bonds(scene).resolved()
    tree["time"]["end"] = "2 us"
    ours, alone = on_any_ranks(from_dict(tree), 2.0)
    assert np.array_equal(ours[0], alone[0])
    assert ours[1] == alone[1]
    assert ours[1]["energy_error"] < 0.02  # measured 1.6e-2, of the adhesion: without the push it is the same


def test_any_number_of_ranks_finds_the_same_crawl_on_a_gel() -> None:
    found = []
    for comm in (MPI.COMM_WORLD, MPI.COMM_SELF):
        with built(crawling(), comm) as sim:
            found.append(at(sim, 5.0))
    assert np.abs(found[0] - found[1]).max() < 1e-6 * np.abs(found[1]).max()


@pytest.mark.serial
@pytest.mark.parametrize(("change", "message"), [
    ({"bond_density": "0 /um^2"}, "no bonds to push off by"),
    ({"cells": ["Cell", "Cell"]}, "cannot push off itself"),
    ({"cutoff": "0.5 um"}, "beyond the reach of the bonds to a body, adhesion.pairs.0.cutoff"),
], ids=["no bonds", "itself", "reach"])
def test_a_push_that_no_bonds_can_hold_is_refused(change: dict[str, Any], message: str) -> None:
    tree = crawling().resolved()
    tree["adhesion"]["pairs"][0] |= change
    with pytest.raises(CaseError, match=message):
        from_dict(tree)


@pytest.mark.serial
def test_a_pair_of_which_none_protrudes_cannot_push_off_each_other() -> None:
    tree = crawling().resolved()
    tree["cells"].append(CELL | {"name": "Other", "centre": ["8 um", "0.05 um"]})
    tree["adhesion"]["pairs"].append(BONDS | {"cells": ["Other", "Gel"], "friction": FRICTION, "push": True})
    with pytest.raises(CaseError, match="none of these protrudes"):
        from_dict(tree)
