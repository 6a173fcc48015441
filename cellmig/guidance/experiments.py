"""The runs of each experiment on guidance: case files and what is changed in them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from cellmig.case.shipped import FOLDER
from cellmig.runs.batch import Job

ROWS, GEL = (1, 2, 3, 5, 10), 8  # numbers of cells in rows in a gradient, of the row on a gel
PITCH, GRADIENT, LEVEL, AFFINITY = 20.05, 0.25, 30.0, 50.0  # of rows [µm], of their signal [nM/µm], [nM], [nM]
STEPS, DOSES = (2.0, 5.0, 9.0, 13.0), (0.1, 1.0, 10.0)  # differences across a cell [%], levels over the affinity
DOSE_STEP, GAIN, LENGTH = 9.0, 50.0, 20.0  # difference across a cell of all doses [%], of the cue [-], of a cell [µm]
ALONE, BRIEFLY = 192.0, 24.0  # how long single cells walk [h]: a random walk of 48 h has an index of 0.08 by chance
PERSISTENCE, LOOK = 5.0, 1.0  # of cells that compare receptors, time from sample to sample [min]
PLACES = {"softer": -40.0, "stiffer": 20.0}  # where cells with clutches begin [µm]
TOLERANCE = "0.03"  # of the error of a step [µm]: tracks are of µm, and errors of steps do not add up


@dataclass(frozen=True)
class Configuration:
    """A case file with changes, and the claims that need its runs.

    end, quick : how long it runs, and with --quick [h];  every : time from sample to sample [min].
    """

    case: str
    claims: tuple[str, ...]
    changes: tuple[str, ...] = ()
    end: float = 3.0
    quick: float = 1.5
    every: float = 5.0

    def sets(self, quick: bool) -> tuple[str, ...]:
        """Changes of the case file."""
        end = self.quick if quick else self.end
        times = f'time.end="{end:g} h"', f"time.samples={round(60 * end / self.every)}", "time.frames=1"
        return (*self.changes, *times, *(("particles.per_cell=60",) if quick else ()))


def _row(count: int) -> tuple[str, ...]:
    """A row of cells with its middle at the origin."""
    return f"cells.0.repeat=[{count}]", f'cells.0.centre=["{0.5 * (count - 1) * PITCH:g} um"]'


def _dose(level: float, percent: float) -> tuple[str, ...]:
    """A gradient of the same relative difference across a cell everywhere."""
    slope = math.log1p(percent / 100.0) / LENGTH
    return (f'fields.CXCL12.formula="{20.0 * level:g}*exp({slope:.6g}*x) nM"', f"cues.0.gain={GAIN:g}",
            "polarity.start=[]", "polarity.spread=1", f'polarity.persistence="{PERSISTENCE:g} min"',
            "particles.per_cell=100", "protrusion.protrusion_ratio=0.05")


def _all() -> Iterator[tuple[str, Configuration]]:
    for count in ROWS:
        ends = (ALONE, BRIEFLY) if count == 1 else (3.0, 1.5)
        yield f"row {count}", Configuration("row_chemotaxis", ("G1",), _row(count), *ends)
    yield "gel 1", Configuration("durotaxis", ("G2",), _row(1), ALONE, BRIEFLY)
    for name, changes in (("graded", ()), ("uniform", ('substrate.stiffness="8 kPa"',)),
                          ("cut", ('adhesion.cells.bond_density="0 /um^2"',))):
        yield f"gel {name}", Configuration("durotaxis", ("G2",), (*_row(GEL), *changes))
    for percent in STEPS:
        yield f"steep {percent:g}", Configuration("chemotaxis", ("G3",), _dose(1.0, percent), 4.0, 2.0, LOOK)
    for dose in DOSES:
        if dose != 1.0:
            yield f"dose {dose:g}", Configuration("chemotaxis", ("G3",), _dose(dose, DOSE_STEP), 4.0, 2.0, LOOK)
    clutches = 'cells.0.centre=["{:g} um"]'
    for name, x in PLACES.items():
        yield f"clutches {name}", Configuration("durotaxis_clutches", ("G4",), (clutches.format(x),), 4.0, 2.0)
    yield "clutches uniform", Configuration(
        "durotaxis_clutches", ("G4",), (clutches.format(0.0), 'substrate.stiffness="1.4 kPa"'), 4.0, 2.0)


CONFIGURATIONS = dict(_all())


def plan(out: Path, seeds: int, quick: bool, given: tuple[str, ...] = ()) -> dict[tuple[str, int], Job]:
    """All runs by configuration and seed, ordered by seed, so that the first of them are complete seeds."""
    jobs = {}
    for seed in range(1, seeds + 1):
        for name, c in CONFIGURATIONS.items():
            sets = (*c.sets(quick), *given, f"seed={seed}")
            jobs[name, seed] = Job(f"{name}, seed {seed}", FOLDER / f"{c.case}.toml", sets,
                                   out / "runs" / name.replace(" ", "_") / f"seed{seed}", ("-ts_atol", TOLERANCE))
    return jobs
