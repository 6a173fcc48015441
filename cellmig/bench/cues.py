"""Cost of polarity, fields and cues: time of steps without inertia with each of them over that without."""

from __future__ import annotations

from time import process_time
from typing import Any

import numpy as np

from cellmig.case.load import from_dict, load
from cellmig.case.shipped import FOLDER
from cellmig.laws import register
from cellmig.output.log import table
from cellmig.simulation import Simulation

PER_CELL, QUICK = 331, 100  # particles of each of three cells
MINUTES, REPEATS = 10, 3
KNOTS = {"persistence": "10 min", "spread": 0.0, "start": [1.0]}  # a knot every half minute
SIGNAL = {"signal": {"law": "formula", "formula": "5 + 0.02*x nM"}}
OCCUPANCY = {"law": "occupancy", "field": "signal", "affinity": "10 nM", "gain": 1e-6}
BOX = {"law": "diffusing", "diffusion": "100 um^2/s", "decay": "0.01 /s", "spacing": "1 um",
       "box": [["-160 um", "0 um"], ["40 um", "100 um"]]}  # 20,000 volumes
SECRETION = [{"field": "signal", "cells": ["Cell-1", "Cell-2", "Cell-3"], "secretion": "5 /um^2/s"}]
GRADED = {"stiffness": "20 + 0.01*x kPa"}

GIVEN = {"law": "given", "vector": [1.0]}  # so that the polarity stays, and the push is that of the bare scene
# What is added to the scene with a polarity and that cue: tables of the case.
ADDED: dict[str, dict[str, Any]] = {
    "polarity and a given cue": {},
    "cue occupancy of a formula": {"fields": SIGNAL, "cues": [OCCUPANCY]},
    "cue occupancy with receptors": {"fields": SIGNAL, "cues": [OCCUPANCY | {"receptors": 50000}]},
    "cue contact": {"cues": [{"law": "contact", "gain": 1e-6}]},
    "cue neighbours": {"cues": [{"law": "neighbours", "gain": 1e-6}]},
    "cue motion": {"cues": [{"law": "motion", "gain": 1e-6, "speed": "1 um/min"}]},
    "gate at contacts": {"protrusion": {"gate": "1 um"}},
    "ligand": {"substrate": {"ligand": "0.999 + 1e-9*x"}},  # so little that the cells do the same
    "response to stiffness": {"substrate": GRADED | {"response": {"law": "saturating", "half": "1 Pa"}}},
    "field that diffuses, 20,000 volumes": {"fields": {"signal": BOX}, "exchange": SECRETION, "cues": [OCCUPANCY]},
}


def bench_cues(quick: bool = False) -> int:
    """Print the cost of each; returns the exit code."""
    bare = _tree(quick)
    scenes = {"bare": bare, **{name: _with(bare, tables) for name, tables in ADDED.items()}}
    found = {name: [_seconds(tree) for _ in range(1 if quick else REPEATS)] for name, tree in scenes.items()}
    head, rows = [f"three cells that crawl for {MINUTES} min", "CPU time [ms a knot]", "over the bare scene [%]"], []
    base = float(np.median(found["bare"]))
    for name, times in found.items():
        one = float(np.median(times))
        rows.append([name, f"{1e3 * one / (2 * MINUTES):.1f}", f"{100.0 * (one / base - 1.0):+.1f}"])
    print("\n".join(table(head, rows)))
    return 0


def _tree(quick: bool) -> dict[str, Any]:
    """The scene without any of them; it stops where knots are, so that steps are the same."""
    register()
    return load(FOLDER / "crawl_row.toml", (f"particles.per_cell={QUICK if quick else PER_CELL}",)).resolved()


def _with(bare: dict[str, Any], tables: dict[str, Any]) -> dict[str, Any]:
    """The scene with a polarity and what is added."""
    protrusion, cues = bare["protrusion"] | tables.get("protrusion", {}), [GIVEN, *tables.get("cues", [])]
    return {**bare, "polarity": {"law": "relaxing", **KNOTS}, **tables, "protrusion": protrusion, "cues": cues}


def _seconds(tree: dict[str, Any]) -> float:
    """CPU time of ten minutes of a scene, after one [s]."""
    with Simulation(from_dict(tree)) as sim:
        sim.go(60e6)
        begin = process_time()
        for knot in range(1, 2 * MINUTES + 1):
            sim.go(60e6 + knot * 30e6)
        return process_time() - begin
