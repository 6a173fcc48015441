"""A body in space that meets itself: energy, balance, what is across its inside, ranks."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from samples import slope
from scenes import built, everywhere, set_motion, smooth

from mpi4py import MPI

from cellmig.case.load import from_dict
from cellmig.case.schema import Case

EPS, LONG, WIDE, THICK = 0.2, 20.0, 3.0, 2.0  # µm
WALL = {"bond_density": "1000 /um^2", "well_depth": "0.024 pN um", "equilibrium_distance": f"{EPS} um",
        "cutoff": "0.4 um"}


def box(sides: tuple[float, float, float], end: str = "8 us", **more: Any) -> Case:
    """An elastic box with three sides [µm], without a substrate."""
    solid = {"law": "mooney-rivlin", "C1": "1 kPa", "C2": "0 Pa", "volumetric_modulus": "10 kPa"}
    return from_dict({
        "dimension": 3, "time": {"end": end, "samples": 4, "frames": 1}, "particles": {"spacing": "1 um"},
        "materials": {"solid": solid}, "adhesion": {"pairs": [WALL | {"cells": ["Box", "Box"]}]},
        "cells": [{"name": "Box", "shape": "box", "material": "solid", "centre": ["0 um"] * 3,
                   **{key: f"{side} um" for key, side in zip("abc", sides, strict=True)}} | more]})


def ring(gap: float, speed: float = 0.0) -> Case:
    """A box bent to a ring whose ends are a `gap` [µm] apart and meet each other at a `speed` [µm/µs]."""
    radius = (LONG + gap) / (2.0 * math.pi)
    bent = [f"({radius} + z)*sin(x/{radius}) - x um", "0 um", f"({radius} + z)*cos(x/{radius}) - {radius} - z um"]
    moving = {"velocity": [f"-{speed / LONG}*x um/us", "0 um/us", "0 um/us"]} if speed else {}
    return box((LONG, WIDE, THICK), displacement=bent, **moving)


def test_a_body_that_meets_itself_repels_itself_without_resultant_and_moment() -> None:
    """Bonds of flat ends have the energy of their gaps, and what is beside the ends adds a little."""
    gap = 0.1
    with built(ring(gap)) as sim:
        law = sim.terms.contacts.laws[int(sim.terms.contacts.of_pair(*np.zeros((2, 1), int))[0])]
        height = np.linspace(-0.5 * THICK, 0.5 * THICK, 2001)
        angle = 2.0 * math.pi * gap / (LONG + gap)
        gaps = angle * ((LONG + gap) / (2.0 * math.pi) + 0.5 * (height[1:] + height[:-1]))
        ends = WIDE * THICK * law.bond_density * law.potential(gaps).mean()
        force, energy = (everywhere(sim, part) for part in sim.mechanics.surface_force("contact"))
        x = sim.scene.X + everywhere(sim, sim.mechanics.state.u)
        assert 1.0 < energy.sum() / ends < 1.1  # measured 1.065: what is around the rims of the ends is near, too
        assert np.abs(force.sum(axis=0)).max() < 1e-14 * np.abs(force).sum()  # measured 1e-16
        arms = np.linalg.norm(x, axis=1) @ np.linalg.norm(force, axis=1)
        assert np.abs(np.cross(x, force).sum(axis=0)).max() < 1e-14 * arms  # measured 2e-15
        assert force[sim.scene.X[:, 0] > 9.9, 0].sum() > 1e5  # measured 1.3e5 pN


def test_forces_of_a_body_on_itself_are_minus_the_gradient_of_the_energy() -> None:
    """To the error of Gauss points beside edges of 90°, which two bodies have, too."""
    with built(ring(0.1)) as sim:
        m, d = sim.mechanics, smooth(sim.scene.X, 3, 1.0)
        u = everywhere(sim, m.state.u) + 0.01 * np.random.default_rng(2).standard_normal(sim.scene.X.shape)

        def energy(s: float) -> np.ndarray:
            set_motion(sim, u + s * d, 0.0 * u)
            return np.array([everywhere(sim, m.surface_force("contact")[1]).sum()])

        found = slope(energy, 0.0, 1e-5)[0]
        set_motion(sim, u, 0.0 * u)
        expected = -(everywhere(sim, m.surface_force("contact")[0]) * d).sum()
        assert found == pytest.approx(expected, rel=3e-4)  # measured 9e-5


@pytest.mark.parametrize("share", [0.05, -0.05], ids=["thin", "inside out"])
def test_what_a_body_has_across_its_inside_does_not_repel_it(share: float) -> None:
    """Also where it has become so thin that its sides have passed through each other."""
    with built(box((6.0, 6.0, 2.0), displacement=["0 um", "0 um", "0.02*x**2 um"])) as sim:
        set_motion(sim, sim.scene.X * [0.0, 0.0, share - 1.0], 0.0 * sim.scene.X)
        assert sim.terms.contacts.own
        assert not everywhere(sim, sim.mechanics.surface_force("contact")[0]).any()


def test_ends_that_meet_part_again_with_the_same_bits_on_any_ranks() -> None:
    found = []
    for comm in (MPI.COMM_WORLD, MPI.COMM_SELF):
        with built(ring(0.3, speed=0.2), comm) as sim:
            sim.sample()
            stored = []
            for time in np.append(np.linspace(0.8, 1.6, 9), 8.0):
                sim.go(time)
                stored.append(sim.sample()[1])
            found.append((sim.state_hash(), stored))
    assert found[0] == found[1]
    met = [entries["adhesion_cells_pn_um"] for entries in found[0][1]]
    assert max(met) > 50.0 and met[-1] < 1.0
    assert found[0][1][-1]["energy_error"] < 0.01
