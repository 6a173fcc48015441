"""A lip of fluid that slides along another body thins at a constant speed, as nothing but a tension holds it."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import built, case, everywhere, outlines

from mpi4py import MPI

from cellmig import change
from cellmig.case.load import from_dict
from cellmig.case.schema import Case, Time
from cellmig.exits import FAILED
from cellmig.geometry.polygons import cross
from cellmig.meshfree.contact import Surfaces
from cellmig.meshfree.overlap import Overlap
from cellmig.output.manifest import read_manifest
from cellmig.runs.run import Run
from cellmig.solve.strain import lips

HEIGHT = 0.3  # of the lip [µm]
BONDS = {"law": "seifert", "bond_density": "1000 /um^2", "well_depth": "0.024 pN um", "equilibrium_distance": "10 nm",
         "cutoff": "0.5 um"}  # those between cells of the paper, 24 pN/µm
MU = 1000.0  # viscosity [Pa µs]


def lip(spacing: float = 0.1, tension: float = 0.0, viscosity: float = MU, **more: Any) -> Case:
    """A strip of fluid, 3 µm wide, a bond above a body that is held; tension of its membrane [pN/µm]."""
    cells = [{"name": "Body", "width": "9 um", "centre": ["0 um", "-0.15 um"], "material": "body", "cortex": False},
             {"name": "Lip", "width": "3 um", "centre": ["0 um", "0.16 um"], "material": "fluid"}]
    tables = {"cortex": {"line_tension": f"{tension} pN/um"}} if tension else {}
    return from_dict({
        "time": {"end": "4 us"}, "particles": {"spacing": f"{spacing} um"}, "adhesion": {"cells": BONDS},
        "materials": {"fluid": {"law": "nematic", "density": "1000 kg/m^3", "viscosity": f"{viscosity} Pa us",
                                "bulk_modulus": "2.2 GPa", "reduced_bulk_modulus": "5 MPa"},
                      "body": {"law": "mooney-rivlin", "density": "1000 kg/m^3", "C1": "2126 Pa", "C2": "170 Pa",
                               "volumetric_modulus": "170 kPa"}},
        "cells": [{"shape": "rectangle", "height": f"{HEIGHT} um", **cell} for cell in cells],
        "supports": [{"name": "held", "cells": ["Body"]}]} | tables | more)


def thinning(strip: Case, begin: float, end: float) -> float:
    """Mean speed at which the middle half of the lip becomes thinner between two times [µm/µs]; collective."""
    with built(strip) as sim:
        lip, of = sim.scene.templates[sim.scene.kind[1]], slice(*sim.scene.offset[1:3])
        X = lip.X[lip.surface]
        top, bottom = (lip.surface[(np.abs(X[:, 0]) < 0.75) & (X[:, 1] * side > 0.499 * HEIGHT)] for side in (1, -1))

        def thickness(time: float) -> float:
            sim.go(time)
            m = sim.mechanics
            y = everywhere(sim, m.part.owned.X + m.state.u)[of, 1]
            return float(y[top].mean() - y[bottom].mean())

        return (thickness(begin) - thickness(end)) / (end - begin)


@pytest.mark.serial
@pytest.mark.parametrize(("spacing", "tension", "viscosity"), [
    (0.1, 0.0, MU), (0.1, 3.0, MU), (0.1, 6.0, MU), (0.1, 9.0, MU), (0.1, 0.0, 2 * MU), (0.075, 0.0, MU)])
def test_a_lip_thins_at_the_speed_that_bonds_and_tension_give(
        spacing: float, tension: float, viscosity: float) -> None:
    """Half of the bonds are counted on the body that is covered: they draw with w/2, both sides of the lip hold with
    2T, and a film of fluid under a force F thins at F/4μ, whatever its thickness.
    """
    strip = lip(spacing, tension, viscosity)
    exact = (0.5 * strip.contact.work - 2.0 * tension) / (4.0 * viscosity)
    assert abs(thinning(strip, 2.0, 4.0) - exact) < 3e-5  # µm/µs, measured 1.1e-5 with the tension of 6 pN/µm


@pytest.mark.serial
@pytest.mark.parametrize(("tables", "pull"), [
    ({}, 12.0), ({"tension": 3.0}, 6.0), ({"tension": 6.0}, 0.0),
    ({"cortex": {"law": "elastic", "line_tension": "1 pN/um", "area_modulus": "5 pN/um"}}, 0.0)])
def test_a_scene_knows_what_draws_its_lips(tables: dict, pull: float) -> None:
    with built(lip(**tables)) as sim:
        assert sim.terms.lip_pull == pytest.approx(pull, abs=0.05)  # measured 0.02, by the cutoff of the bonds
        assert (f"{pull:.3g} pN/um more" in lips(sim.mechanics)) == (pull > 0.0)


@pytest.mark.serial
def test_a_run_that_breaks_at_a_surface_tells_what_holds_lips(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    outside = Overlap(0, "a particle is outside", "try finer particles")
    monkeypatch.setattr("cellmig.runs.run.escaped", lambda *_: outside)
    run = Run(dataclasses.replace(lip(), time=Time(end=0.01, frames=1)), tmp_path, MPI.COMM_SELF, quiet=True)
    assert run.go() == FAILED
    cause = read_manifest(tmp_path)["cause"]
    assert "try finer particles; where a lip slides" in cause and "a line_tension of 24 pN/um" in cause


# ------------------------------------------------------------------------------------------------- lips of whole scenes


def across(x: np.ndarray) -> np.ndarray:
    """Segments of a polygon x (k, 2) [µm] that face each other across its inside, less than 0.4 µm apart, higher than
    0.8 µm: pairs (n, 2) int of their first corners.
    """
    side = np.roll(x, -1, axis=0) - x
    inwards = np.column_stack([-side[:, 1], side[:, 0]]) / np.linalg.norm(side, axis=1)[:, None]
    found = []
    for i in np.flatnonzero(x[:, 1] > 0.8):
        away = x - (x[i] + 0.5 * side[i])
        beside = cross(inwards[i], side)
        with np.errstate(divide="ignore", invalid="ignore"):
            far, share = cross(away, side) / beside, cross(away, inwards[i]) / beside
        hit = (share >= 0.0) & (share <= 1.0) & (far > 0.0)
        hit[[i - 1, i, (i + 1) % len(x)]] = False
        if hit.any() and 0.004 < far[hit].min() < 0.4:
            found.append((i, int(np.flatnonzero(hit)[far[hit].argmin()])))
    return np.array(found).reshape(-1, 2)


def thicknesses(x: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Distances (n,) [µm] of the middles of segments of a polygon x (k, 2) [µm], across the first ones."""
    side = np.roll(x, -1, axis=0) - x
    middle, (first, second) = x + 0.5 * side, pairs.T
    return np.abs(cross(side[first], middle[second] - middle[first])) / np.linalg.norm(side[first], axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("per_cell", [1485, 3000])
def test_lips_of_the_paper_s_cells_are_held_by_a_quarter_of_the_work_of_adhesion(
        per_cell: int, capsys: pytest.CaptureFixture) -> None:
    """The paper's scene with a denser surface, at 80 µs; from then on with other values, for 4 µs."""
    printed = case("all_protrude", "particles.surface_refinement=2", per_cell=per_cell)
    with built(printed) as sim:
        sim.go(80.0)
        saved = sim.saved()
        start = outlines(sim)
        cell = Surfaces.of(sim.scene).cell
    pairs = [across(start[cell == c]) for c in range(3)]
    mean = {}
    for name, sets in {
            "printed": {}, "3 pN/µm": {"cortex.line_tension": "3 pN/um"}, "6 pN/µm": {"cortex.line_tension": "6 pN/um"},
            "a quarter of the stabilisation": {"materials.cytoplasm.stabilisation": 0.25}}.items():
        with built(change(printed, sets)) as sim:
            sim.restore(*saved)
            sim.go(84.0)
            now = outlines(sim)
        mean[name] = 250.0 * float(np.mean(np.concatenate([
            thicknesses(now[cell == c], p) - thicknesses(start[cell == c], p) for c, p in enumerate(pairs)])))
    with capsys.disabled():
        print(f"{per_cell} a cell, {sum(map(len, pairs))} sections:", {k: f"{v:.2f} nm/µs" for k, v in mean.items()})
    assert mean["printed"] < mean["3 pN/µm"] < mean["6 pN/µm"] and abs(mean["6 pN/µm"]) < 0.6
    assert -3.3 < mean["a quarter of the stabilisation"] < mean["printed"] < -0.6
