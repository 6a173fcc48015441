"""Boxes on a gel in space, which are pulled along, thrown or push: drag against load, balance, work, ranks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenes import built, everywhere, set_motion
from test_overdamped import BELL, GEL, at
from test_push_off import PUSH
from test_slab import BONDS, DRAG, FRICTION, LAWS, SOLID, error_of_drag, on_any_ranks

from cellmig.case.load import from_dict
from cellmig.case.messages import CaseError
from cellmig.case.schema import Case
from cellmig.simulation import Simulation
from cellmig.solve.step import NumericsError
from cellmig.solve.stiffness import Stiffness


def box(name: str, material: str, sides: tuple[float, float, float], bottom: float, **more: Any) -> dict[str, Any]:
    """A box with three sides [µm] that stands at a height [µm]."""
    centre = ["0 um", "0 um", f"{bottom + sides[2] / 2} um"]
    return {"name": name, "shape": "box", "material": material, "centre": centre,
            **{key: f"{side} um" for key, side in zip("abc", sides, strict=True)}} | more


def on_a_slab(pull: float = 0.5, friction: dict | None = None, time: dict | None = None, spacing: float = 1.0,
              **more: Any) -> Case:
    """A box of 4 x 4 x 2 µm on a slab that is held below and on two sides; a force `pull` [Pa/µm] along x on it."""
    clock = {"end": "100 s", "samples": 10, "frames": 1, "integrator": "overdamped"} | (time or {})
    gel = SOLID | {"C1": "1 kPa", "volumetric_modulus": "1 kPa"}
    pulled = {"name": "pull", "cells": ["Box"], "body": [f"{pull} Pa/um", "0 Pa/um", "0 Pa/um"],
              "load_curve": {"law": "ramp", "duration": "1 s"}}
    return from_dict({
        "dimension": 3, "time": clock, "particles": {"spacing": f"{spacing} um"},
        "materials": {"slab": gel, "box": SOLID},
        "cells": [box("Gel", "slab", (8.0, 8.0, 3.0), -3.0), box("Box", "box", (4.0, 4.0, 2.0), 0.05) | more],
        "adhesion": {"cells": BONDS | {"bond_density": "0 /um^2"}, "pairs": [
            BONDS | {"cells": ["Box", "Gel"], "friction": friction or FRICTION}]},
        "supports": [{"name": "held", "cells": ["Gel"], "parts": ["bottom", "left", "right"]}],
        **({"loads": [pulled]} if pull else {})})


def dragged(sim: Simulation, speed: float) -> np.ndarray:
    """Force on the gel [pN] if the box moves along x at a speed [µm/µs]."""
    u, on_gel = everywhere(sim, sim.mechanics.state.u), sim.scene.cell == 0
    set_motion(sim, u, speed * np.outer(~on_gel, [1.0, 0.0, 0.0]))
    return everywhere(sim, sim.mechanics.surface_force("sliding")[0])[on_gel].sum(axis=0)


def test_a_box_slides_on_a_gel_with_force_over_drag_and_the_gel_bears_the_force() -> None:
    force = 0.5 * 32.0
    with built(on_a_slab()) as sim:
        at(sim, 20.0)
        v = 1e6 * everywhere(sim, sim.mechanics.state.v)[:, 0]
        rows, entries = sim.sample()
        held = [rows[1][f"held_force_{axis}_pn"] for axis in "xyz"]
        assert held == pytest.approx([-force, 0.0, 0.0], abs=1e-8 * force)  # measured 1e-11, of the balance
        assert entries["energy_error"] < 1e-6  # measured 6e-9
        assert rows[1]["strain_energy_pn_um"] > 0.0
        area = dragged(sim, 1e-9)[0] / (1e-3 * DRAG)
        assert area == pytest.approx(16.0, rel=0.05)  # measured 16.4 µm²: its rim is bonded, too
        assert v[sim.scene.cell == 1].mean() == pytest.approx(force / (DRAG * area), rel=1e-2)  # measured 3e-3


def test_bells_bonds_drag_a_box_along_a_gel_as_they_drag_it_along_a_substrate() -> None:
    """Traction times area, at speeds from far below to beyond that of the largest traction."""
    with built(on_a_slab(friction=BELL)) as sim:
        law, areas = sim.case.pairs[0].friction, []
        for speed in law.largest[1] * np.array([1e-6, 0.3, 1.0, 10.0]):
            force = dragged(sim, speed)
            areas.append(force[0] / law.drag(1.0, speed))
            assert np.abs(force[1:]).max() < 1e-10 * force[0]
        # measured 1e-9 at the least speed, which has 1e-15 µm/µs added to its square
        assert areas == pytest.approx(areas[:1] * 4, rel=1e-8)
        assert 15.5 < areas[0] < 17.0


def test_a_cell_crawls_on_a_gel_and_what_holds_the_gel_bears_nothing() -> None:
    tree = on_a_slab(0.0).resolved()
    tree["materials"]["box"] = GEL
    tree["adhesion"]["pairs"][0]["push"] = True
    with built(from_dict(tree | {"protrusion": PUSH | {"cells": ["Box"], "direction": [1.0, 0.0]}})) as sim:
        at(sim, 40.0)
        rows, entries = sim.sample()
        push, v = sim.sampler.push(), 1e6 * everywhere(sim, sim.mechanics.state.v)[sim.scene.cell == 1].mean(axis=0)
        assert push[1, 0] > 150.0 and push[0, 0] == 0.0  # measured 185 pN
        held = [rows[1][f"held_force_{axis}_pn"] for axis in "xyz"]
        assert held == pytest.approx([0.0] * 3, abs=1e-8 * push[1, 0])  # measured 3e-11, of the balance
        assert rows[1]["dipole_pn_um"] < -100.0  # measured -210 pN µm
        assert entries["energy_error"] < 1e-5  # measured 6e-7
        assert entries["friction_loss_pn_um"] > 0.7 * entries["external_work_pn_um"] > 0.0
        drag = 1e3 * dragged(sim, 1e-9)[0]  # pN s/µm
        assert v[0] == pytest.approx(push[1, 0] / drag, rel=0.03)  # measured 1.5 %: it still settles


def thrown(law: dict) -> Case:
    """A box that is thrown along a gel, with inertia."""
    velocity = ["0.1 um/us", "0.03 um/us", "0 um/us"]
    return on_a_slab(0.0, law, {"integrator": "leapfrog", "end": "4 us"}, velocity=velocity)


@pytest.mark.parametrize("law", LAWS, ids=["bonds", "bell"])
def test_explicit_steps_of_bodies_that_drag_each_other_have_the_same_bits_on_any_ranks(law: dict) -> None:
    ours, alone = on_any_ranks(thrown(law), 4.0)
    assert np.array_equal(ours[0], alone[0])
    assert ours[1] == alone[1]


@pytest.mark.serial
@pytest.mark.parametrize("strong", [30.0, 1000.0])
def test_a_box_that_is_thrown_loses_what_the_ledger_says_to_second_order(strong: float) -> None:
    """Also where a drag stops surfaces within a few steps."""
    coarse, fine = (error_of_drag(thrown({"coefficient": f"{strong} Pa us/um"}), factor) for factor in (0.4, 0.2))
    assert np.log2(coarse / fine) > 1.8, (coarse, fine)  # measured 1.95 and 1.89; from 0.8 to 0.4 it is 1.4 and 1.65
    assert fine < 1e-5  # measured 6e-7 and 6.0e-6


YIELDING = {"law": "bell", "bonds": "100 /um^2", "on": "1 /s", "off": "0.1 /s", "force": "2 pN",
            "stiffness": "0.1 pN/nm"}


def pushing(ratio: float) -> Case:
    """A box of a fluid gel on a slab without viscosity, which pushes on bonds that yield and live for 10 s."""
    tree = on_a_slab(0.0, YIELDING).resolved()
    tree["materials"]["box"] = GEL
    tree["adhesion"]["pairs"][0]["push"] = True
    push = PUSH | {"cells": ["Box"], "direction": [1.0, 0.0], "protrusion_ratio": ratio}
    return from_dict(tree | {"protrusion": push})


def test_a_push_on_a_gel_begins_on_bonds_that_yield() -> None:
    """The slab gives way at once, so that all bonds slip in a step far shorter than they live."""
    with built(pushing(12.0)) as sim:
        at(sim, 10.0)
        assert sim.integrator.failures == 0 and sim.integrator.steps < 20
        assert sim.integrator.record()["out_of_balance"] <= 1e-6
        assert sim.sample()[1]["energy_error"] < 1e-4


def test_a_push_above_what_bonds_bear_ends_soon_and_tells_both() -> None:
    with built(pushing(200.0)) as sim:
        with pytest.raises(NumericsError, match=r"protrusion_ratio.* cell 2 pushes with .* pN, .* bear .* pN at most"):
            at(sim, 10.0)
        assert sim.integrator.trying < 300


@pytest.mark.serial
@pytest.mark.parametrize("speed", [0.0, 0.1, 0.5])
def test_the_tangent_of_bonds_that_yield_is_their_slope_in_steps_of_any_length(speed: float) -> None:
    """Of a box that slides at a share of the speed of the largest traction, in steps of 1 ns to 100 s."""
    with built(on_a_slab(0.0, YIELDING)) as sim:
        m, law = sim.mechanics, sim.case.pairs[0].friction
        v = speed * law.largest[1]
        dragged(sim, v)
        along = np.outer(sim.scene.cell_of(m.ids) == 1, [1.0, 0.0, 0.0])
        slopes = []
        for dt in (1e-3, 1e2, 1e8):
            tangent = Stiffness(m).surfaces(0.0, 1.0 / dt, ("sliding",))
            change = (tangent @ along.ravel()).reshape(along.shape)
            slopes.append(dt * float((change * along).sum()))
        step = 1e-4 * law.speed
        force = [dragged(sim, v + by)[0] for by in (-step, step)]
        assert slopes == pytest.approx([(force[1] - force[0]) / (2.0 * step)] * 3, rel=1e-3)  # measured 2e-4


@pytest.mark.serial
@pytest.mark.parametrize("mistake", [{"cells": ["Gell"]}, {"displacement": ["free", "free"]}])
def test_a_mistake_in_what_holds_a_gel_is_not_followed_by_others_that_it_causes(mistake: dict[str, Any]) -> None:
    tree = on_a_slab().resolved()
    tree["supports"][0] |= mistake
    with pytest.raises(CaseError) as refused:
        from_dict(tree)
    assert [told.key for told in refused.value.mistakes] == [f"supports.0.{key}" for key in mistake]
