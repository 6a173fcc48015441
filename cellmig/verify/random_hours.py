"""Random case files of motion without inertia: seconds to hours, viscosities, bonds and tensions of cells."""

from __future__ import annotations

from typing import Any

import numpy as np

from .random_bodies import Tables, body, decades, extent, laid_out, text
from .random_cues import guide

SHAPES = {2: ("disc", "ellipse", "segment"), 3: ("ball", "ellipsoid", "cap")}


def scene(seed: int, number: int, dimension: int = 2) -> Tables:
    """Tables of overdamped scene `number` of the set of a seed; they do not depend on the other scenes."""
    rng = np.random.default_rng([seed, number, 3])
    bonds = _bonds(rng, 1.0, 500.0)
    cells = _cells(rng, dimension, float(bonds["equilibrium_distance"].split()[0]))
    names = [cell["name"] for cell in cells]
    tables: Tables = {
        "title": f"overdamped scene {number} of the stress set {seed}", "dimension": dimension,
        "seed": int(rng.integers(1 << 31)),
        "time": {"end": text(decades(rng, 0.0, 4.3), "s"), "integrator": "overdamped", "frames": 2, "samples": 20},
        "particles": {"per_cell": int(rng.integers(60, 201))}, "materials": _materials(rng), "cells": cells,
        "adhesion": {"substrate": bonds}}
    if len(cells) > 1 and rng.random() < 0.8:
        tables["adhesion"]["cells"] = _bonds(rng, 0.3, 100.0)
    if rng.random() < 0.9:
        tables["friction"] = _friction(rng)
    bonds_yield = "law" in tables.get("friction", {"law": ""})
    if bonds_yield or any(cell["off"] for cell in cells) or rng.random() < 0.5:  # else nothing holds a cell
        tables["medium"] = {"viscosity": text(decades(rng, -0.3, 3), "mPa s")}
    if rng.random() < 0.5:
        tables["cortex"] = {"line_tension": text(rng.uniform(0.0, 300.0), "pN/um")}
    if "friction" in tables and rng.random() < 0.8:  # else they go ever faster
        tables["protrusion"] = {"cells": [name for name in names if rng.random() < 0.7],
                                "protrusion_ratio": decades(rng, -2, 0), "height": text(rng.uniform(0.2, 1), "um"),
                                "random": bool(rng.random() < 0.3)}
    if tables["materials"]["cytoplasm"]["law"] != "gel" and rng.random() < 0.5:
        tables["numerics"] = {"renewal": 1.3}
    cues = np.random.default_rng([seed, number, 5])
    if tables.get("protrusion", {}).get("cells") and cues.random() < 0.7:
        guide(cues, tables, *extent(cells))
    for cell in cells:
        del cell["off"]
    return tables


def launch(seed: int, number: int, dimension: int = 2) -> tuple[int, tuple[str, ...]]:
    """Number of ranks and PETSc options of an overdamped scene."""
    rng = np.random.default_rng([seed, number, 4])
    kind = str(rng.choice(["", "-ts_type bdf", "-ts_type theta"], p=[0.9, 0.05, 0.05]))
    return int(rng.choice([1, 2, 3], p=[0.9, 0.08, 0.02])), tuple(kind.split())


def _cells(rng: np.random.Generator, dimension: int, rest: float) -> list[Tables]:
    """1 to 4 cells of 2 to 10 µm in a row or in a heap, most with bonds of `rest` [nm] to the substrate at first."""
    count, size = int(rng.integers(1, 5 if dimension == 2 else 3)), decades(rng, 0.3, 1.0)
    gap, off = float(rng.choice([0.1, rng.uniform(0, 1)])), rng.random() < 0.15
    alike, row = rng.random() < 0.5, count if rng.random() < 0.7 else 2
    sizes = [size] * count if alike else size * rng.uniform(0.6, 1.4, count)
    kinds = [body(rng, SHAPES[dimension], s) for s in sizes]
    for kind in kinds:
        if "height" in kind:  # as cells that have spread
            kind["height"] = text(0.5 * float(kind["height"].split()[0]), "um")
    centres = laid_out(kinds, row, dimension - 1, gap, rng.uniform(0.1, 2) if off else 1e-3 * rest)
    return [{"name": f"Cell-{n + 1}", **kind, "material": "cytoplasm", "centre": centre, "off": off or n >= row}
            | ({"nucleus": "nucleus"} if "nucleus_ratio" in kind else {})
            for n, (kind, centre) in enumerate(zip(kinds, centres, strict=True))]


def _bonds(rng: np.random.Generator, least: float, most: float) -> Tables:
    """Bonds with a work of adhesion from `least` to `most` [pN/µm] and equilibrium distances from 20 to 100 nm."""
    work = decades(rng, np.log10(least), np.log10(most))
    return {"bond_density": text(work / 0.03, "/um^2"), "well_depth": "0.03 pN um",
            "equilibrium_distance": text(decades(rng, np.log10(20), 2), "nm")}


def _friction(rng: np.random.Generator) -> dict[str, Any]:
    """Drag of 10 to 10,000 Pa s/µm, or Bell's bonds, 100 to 1,000 /µm², which under a strong push yield."""
    if rng.random() < 0.5:
        return {"coefficient": text(decades(rng, 1, 4), "Pa s/um")}
    return {"law": "bell", "bonds": text(decades(rng, 2, 3), "/um^2"), "stiffness": text(decades(rng, -1, 0), "pN/nm"),
            "on": "1 /s", "off": text(decades(rng, -1, 1), "/s"), "force": "2 pN"}


def _materials(rng: np.random.Generator) -> Tables:
    """Cytoplasm of 10 to 1,000 Pa s, in two thirds of the scenes with a network; nuclei of 100 Pa to 5 kPa."""
    law = str(rng.choice(["nematic", "gel", "maxwell"]))
    plasm: Tables = {"law": law, "viscosity": text(decades(rng, 1, 3), "Pa s"), "bulk_modulus": "2.2 GPa",
                     "reduced_bulk_modulus": text(decades(rng, 5.5, 6.5), "Pa")}
    if law != "nematic":
        plasm["shear_modulus"] = text(decades(rng, np.log10(50), np.log10(2000)), "Pa")
    if law == "maxwell":
        plasm["relaxation_time"] = text(decades(rng, 0, 3.5), "s")
    if rng.random() < 0.2:
        plasm["zeta"] = text(rng.choice([-1.0, 1.0]) * decades(rng, 0, 2.5), "Pa")
    c1 = decades(rng, 1.5, 3.4)
    return {"cytoplasm": plasm, "nucleus": {"law": "mooney-rivlin", "C1": text(c1, "Pa"), "C2": text(0.1 * c1, "Pa"),
                                            "volumetric_modulus": text(decades(rng, 5.5, 6.5), "Pa")}}
