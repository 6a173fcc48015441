"""Small scenes for the tests: cases of the folder `cases`, coarse, and states that any number of ranks agree on."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from mpi4py import MPI

from cellmig.case.load import load
from cellmig.case.registry import laws
from cellmig.case.schema import Case
from cellmig.case.units import number
from cellmig.case.values import declared
from cellmig.simulation import Simulation
from cellmig.verify import specimens
from cellmig.verify.references.scenes import mean_energy_error as mean_energy_error
from cellmig.verify.references.scenes import outlines as outlines
from cellmig.verify.references.scenes import set_motion as set_motion
from cellmig.verify.references.scenes import surfaces as surfaces

DAMPED = ("materials.nucleus.stabilisation=0.05", "numerics.bulk_viscosity=0.05")  # for nucleus.toml, which is not
ROOT = Path(__file__).resolve().parent.parent
CASES = {path.stem: path for path in sorted((ROOT / "cases").glob("*.toml"))}

# What stands in for a parameter without a default, or whose default of zero would make a test say nothing.
EXAMPLES = {"": 0.5, "kg/m^3": 1000.0, "Pa": 2000.0, "Pa s": 1e-3, "pN": 100.0, "pN um": 0.03, "1/um^2": 8000.0,
            "um": 0.01, "um^2/us": 1.0, "rad": 0.7, "1/us": 1.0, "um/us": 1.0, "us": 1.0, "pN/um": 10.0,
            "Pa us/um": 10.0, "pN/nm": 0.5, "1/s": 2e6}


def example(kind: str, name: str) -> Any:
    """A law with its defaults, and EXAMPLES by unit for what has none; a new law needs nothing else to be tested."""
    cls, values = laws(kind)[name], {}
    for key, f in declared(cls).items():
        default, unit = f.default, f.metadata.get("unit")
        if unit is not None and default != () and (not isinstance(default, int | float) or default == 0.0):
            assert unit in EXAMPLES, f"tests/scenes.py has no example in '{unit}' for '{key}' of the {kind} '{name}'"
            values[key] = number(f"{EXAMPLES[unit]} {unit}", unit)
        elif f.metadata.get("items"):
            values[key] = ()
    return cls(**values)


def case(name: str, *sets: str, per_cell: int = 150) -> Case:
    """A case of the folder `cases`, coarse unless it gives a spacing, with other values if wanted."""
    coarse = [] if _spaced(name) else [f"particles.per_cell={per_cell}"]
    return load(CASES[name], [*coarse, *sets])


@cache
def _spaced(name: str) -> bool:
    """Whether a case of the folder `cases` gives the spacing of its particles."""
    return bool(load(CASES[name]).particles.spacing)


@contextlib.contextmanager
def built(case: Case, comm: MPI.Comm = MPI.COMM_WORLD, prune: bool = True) -> Iterator[Simulation]:
    """A simulation that is destroyed afterwards; collective."""
    simulation = Simulation(case, comm, prune)
    yield simulation
    simulation.destroy()


def everywhere(sim: Simulation, owned: np.ndarray) -> np.ndarray:
    """Values at the owned particles of all ranks, (size, ...) by global id; collective."""
    parts = sim.comm.allgather((sim.mechanics.ids, np.array(owned)))
    out = np.zeros((sim.scene.size, *np.shape(owned)[1:]))
    for ids, values in parts:
        out[ids] = values
    return out


def in_petsc(sim: Simulation) -> np.ndarray:
    """Numbers of all particles in PETSc's order (size,) int, by global id."""
    m = sim.mechanics
    return everywhere(sim, m.part.first + np.arange(m.n_owned)).astype(int)


def forces(sim: Simulation) -> np.ndarray:
    """M a of all particles (size, d) [pN/µm] for the state as it is; collective."""
    return sim.scene.field("mass")[:, None] * everywhere(sim, sim.mechanics.rate()[:, sim.scene.dimension :])


def smooth(X: np.ndarray, seed: int, size: float, waves: int = 3, shortest: float = 4.0) -> np.ndarray:
    """A smooth random field (n, d) with values of about `size`."""
    rng, d = np.random.default_rng(seed), X.shape[1]
    field = np.zeros_like(X)
    for _ in range(waves):
        k = rng.uniform(-1, 1, d) * 2 * np.pi / shortest
        field += rng.standard_normal(d) * np.sin(X @ k + rng.uniform(0, 6))[:, None]
    return size * field / np.sqrt(0.5 * waves)


NETWORK = ('materials.cytoplasm.law="maxwell"', 'materials.cytoplasm.shear_modulus="20 kPa"',
           'materials.cytoplasm.relaxation_time="0.5 us"')  # makes cytoplasm a fluid with a network that forgets
LEFT, RIGHT = [["-2 um", "-1 um"], ["-2 um", "1 um"]], [["2 um", "-1 um"], ["2 um", "1 um"]]  # boxes around its ends
BAR = {"name": "Bar", "shape": "polygon", "material": "nucleus", "centre": ["0 um", "0 um"],
       "corners": [["-2 um", "-1 um"], ["2 um", "-1 um"], ["2 um", "1 um"], ["-2 um", "1 um"]]}
DISC = {"name": "Disc", "shape": "disc", "radius": "1.415 um"}
ORIGIN = ["0 um", "0 um", "0 um"]
BALL = {"name": "Ball", "shape": "ball", "radius": "1.415 um", "centre": ORIGIN}
POLES = {"lowest": [["-0.3 um", "-0.3 um", "-1.5 um"], ["0.3 um", "0.3 um", "-1.2 um"]],
         "highest": [["-0.3 um", "-0.3 um", "1.2 um"], ["0.3 um", "0.3 um", "1.5 um"]]}
BEAM = {"name": "Beam", "shape": "box", "a": "4 um", "b": "2 um", "c": "2 um", "centre": ORIGIN}


def piece(*, per_cell: int = 200, shape: str = "polygon", end: str = "2 us", integrator: str = "leapfrog",
          step: str = "auto", cell: dict | None = None, **sections: Any) -> Case:
    """A test piece of nucleus: a bar of 4 by 2 µm unless told otherwise, with what holds and loads it."""
    shapes = {"polygon": {"shape": "polygon", "corners": BAR["corners"]}, "disc": {"shape": "disc", "radius": "2 um"},
              "plate with a hole": {"shape": "rectangle", "width": "4 um", "height": "2 um",
                                    "holes": [["0.5 um", "0 um", "0.4 um"]]}}
    body = {"name": "Piece", "centre": ["3 um", "1 um"], **shapes[shape], **(cell or {})}
    return specimens.piece(body, per_cell, time={"end": end, "integrator": integrator, "step": step},
                        material={"volumetric_modulus": "17 kPa"}, **sections)


def plate(name: str, height: float, normal: float, moves: float, dimension: int = 2) -> dict:
    """A level plate at a height, that moves [µm]."""
    level = ["0 um"] * (dimension - 1)
    return {"name": name, "point": [*level, f"{height} um"], "normal": [0] * (dimension - 1) + [normal],
            "displacement": [*level, f"{moves} um"], "load_curve": specimens.RAMP}


def squeezed(count: int, by: float = 0.2, samples: int = 2, dimension: int = 2, **more: Any) -> Case:
    """The disc or the ball, whose axis is held, between two plates, its diameter reduced by a share."""
    move, body = 1.415 * by, DISC if dimension == 2 else BALL
    if dimension == 3:
        more = {"supports": [{"name": name, "box": box, "displacement": ["0 um", "0 um", "free"]}
                             for name, box in POLES.items()]} | more
    plates = [plate("top", 1.415, -1.0, -move, dimension), plate("bottom", -1.415, 1.0, move, dimension)]
    return specimens.piece(body, count, samples, plates=plates, dimension=dimension, **more)


def bent(count: int, pull: float = 200.0, samples: int = 2, dimension: int = 2, **more: Any) -> Case:
    """The bar, held on the left and pulled up on the right by a traction [Pa]."""
    body, left, right = (BAR, {"box": LEFT}, {"box": RIGHT}) if dimension == 2 else (
        BEAM, {"parts": ["left"]}, {"parts": ["right"]})
    load = {"name": "up", **right, "traction": ["0 Pa"] * (dimension - 1) + [f"{pull} Pa"],
            "load_curve": specimens.RAMP}
    return specimens.piece(body, count, samples, supports=[{"name": "left", **left}], loads=[load],
                           dimension=dimension, **more)
