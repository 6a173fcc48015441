"""Drag of the liquid around cells: what it exerts, what it takes, and the step that it allows."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from scenes import built, case, everywhere, example, forces, set_motion, smooth

from cellmig.case.load import from_dict
from cellmig.case.registry import laws
from cellmig.case.schema import Case

MEDIA = sorted(laws("medium"))
BOTH = pytest.mark.parametrize("name", ["one_cell", "ball"])
MOVES = 0.3, -0.1, 0.2  # µm/µs


def immersed(name: str, medium: Any) -> Case:
    """A cell above the substrate, at rest in its own frame, which moves through a medium."""
    tree = dataclasses.replace(case(name), medium=medium).resolved()
    cell, d = tree["cells"][0], tree["dimension"]
    centre = [*cell["centre"][: d - 1], "8 um"]
    moving = {"centre": centre, "velocity": [f"{v} um/us" for v in MOVES[:d]]}
    return from_dict(tree | {"cells": [cell | moving | {"rest": False}]})


@BOTH
@pytest.mark.parametrize("law", MEDIA)
def test_a_medium_drags_every_surface_particle_by_its_share_of_the_surface(name: str, law: str) -> None:
    medium = example("medium", law)
    with built(immersed(name, medium)) as sim, built(immersed(name, None)) as dry:
        assert not hasattr(dry.mechanics.kernel.library, "add_medium") and dry.mechanics.immersed is None
        t, v = sim.scene.templates[0], np.array(MOVES[: sim.scene.dimension])
        drag = forces(sim) - forces(dry)
        size = sum(t.facet_size) / t.radius
        # measured 3e-15
        assert drag.sum(axis=0) == pytest.approx(np.array(medium.force(size, tuple(v))), rel=1e-12)
        inside = np.setdiff1d(np.arange(sim.scene.size), sim.scene.surface(0))
        assert not drag[inside].any() and (drag[sim.scene.surface(0)] @ v < 0.0).all()


@pytest.mark.serial
def test_a_ball_in_a_medium_has_the_drag_of_stokes_and_a_disc_that_of_the_page() -> None:
    for name, whole, within in (("one_cell", lambda eta, R: 3.0 * np.pi * eta, 2e-3),  # measured 1.3e-3
                                ("ball", lambda eta, R: 6.0 * np.pi * eta * R, 1e-2)):  # a polyhedron; measured 7.1e-3
        law = laws("medium")["stokes"](viscosity=700.0)
        with built(immersed(name, law)) as sim:
            force = everywhere(sim, sim.mechanics.surface_force("medium")[0]).sum(axis=0)
            radius, v = sim.scene.templates[0].radius, np.array(MOVES[: sim.scene.dimension])
            assert force == pytest.approx(-whole(law.viscosity, radius) * v, rel=within)


@BOTH
@pytest.mark.parametrize("law", MEDIA)
def test_a_medium_alone_changes_the_momentum_of_a_free_cell_and_takes_its_power(name: str, law: str) -> None:
    with built(immersed(name, example("medium", law))) as sim:
        X = sim.scene.X
        v = smooth(X, 6, 1.0)
        set_motion(sim, smooth(X, 5, 0.02), v)
        f, drag = forces(sim), everywhere(sim, sim.mechanics.surface_force("medium")[0])
        assert np.abs((f - drag).sum(axis=0)).max() < 1e-12 * np.abs(f).sum()  # measured 3e-17
        lost = everywhere(sim, sim.mechanics.powers()["medium_loss"])
        assert np.abs(lost + (drag * v).sum(axis=1)).max() < 1e-13 * lost.max()  # measured 2e-16
        assert (lost >= 0.0).all()


@pytest.mark.serial
@BOTH
def test_the_loss_to_a_medium_closes_the_ledger_to_second_order(name: str) -> None:
    def error(factor: float) -> float:
        scene = immersed(name, laws("medium")["stokes"](viscosity=1e4))
        with built(dataclasses.replace(scene, time=dataclasses.replace(scene.time, step_factor=factor))) as sim:
            sim.go(0.5)
            _, ledger = sim.sample()
            unit = "pn" if sim.scene.dimension == 2 else "pn_um"
            assert ledger[f"medium_loss_{unit}"] > 0.5 * ledger[f"kinetic_{unit}"]
            return ledger["energy_error"]

    coarse, fine = error(0.8), error(0.4)
    assert fine < coarse / 3.0 and coarse < 1e-4, (coarse, fine)


def test_a_medium_of_much_drag_shortens_the_step() -> None:
    dry, wet = (built(immersed("one_cell", law)) for law in (None, laws("medium")["stokes"](viscosity=1e6)))
    with dry as a, wet as b:
        assert b.control.stable()["contact"] < 0.5 * a.control.stable()["contact"]
