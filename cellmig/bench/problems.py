"""Problems with a known answer, on which run time is weighed against error: elastic, fluid, a cell on its substrate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from cellmig.case.load import from_dict, load
from cellmig.case.registry import laws
from cellmig.case.schema import Case
from cellmig.case.values import declared
from cellmig.laws import register
from cellmig.runs.cases import FOLDER
from cellmig.simulation import Simulation

CELL = 5.0  # radius [µm]
Seen = dict[str, np.ndarray]


@dataclass(frozen=True)
class Setting:
    """What the method leaves to choose.

    per_cell : particles;  dilation : of the kernel;  integrator : "leapfrog" or a type of PETSc's TS;  step_factor : of
    the stable step;  stabilisation : its viscosity over the default of the law;  stiffening : of the nucleus, over G;
    modulus : reduced bulk modulus [MPa];  bulk_viscosity : over ρ c h.
    """

    per_cell: int = 1485
    dilation: float = 2.2
    integrator: str = "leapfrog"
    step_factor: float = 0.8
    stabilisation: float = 1.0
    stiffening: float = 0.5
    modulus: float = 5.0
    bulk_viscosity: float = 0.05

    @property
    def changes(self) -> dict[str, Any]:
        """What differs from the defaults, but for the number of particles."""
        return {f.name: getattr(self, f.name) for f in fields(self)[1:] if getattr(self, f.name) != f.default}

    @property
    def said(self) -> str:
        """The same in words."""
        return ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in self.changes.items()) or "defaults"


@dataclass(frozen=True)
class Problem:
    """One problem.

    name, kind, title : str;  tree : () -> tables of its case;  times : when it is looked at [µs];
    watch : what is seen of a simulation, by name;  judge : the error [-] and its parts, of what was seen at all times
    and, where nobody knows the answer, of what the finest run saw;  start : displacement gradient at the start;
    without : choices that mean nothing for it.
    """

    name: str
    kind: str
    title: str
    tree: Callable[[], dict]
    times: tuple[float, ...]
    watch: Callable[[Simulation], dict[str, float]]
    judge: Callable[[np.ndarray, Seen, Seen | None], dict[str, float]]
    start: tuple | None = None
    without: tuple[str, ...] = ()
    own: bool = False

    def case(self, setting: Setting) -> Case:
        """Its case under a setting."""
        tree = self.tree()
        tree["time"] |= {"end": f"{self.times[-1]:.9g} us", "integrator": setting.integrator,
                         "step_factor": setting.step_factor}
        tree["particles"] = {"per_cell": setting.per_cell, "dilation": setting.dilation}
        tree["numerics"] = {"bulk_viscosity": setting.bulk_viscosity}
        for material in tree["materials"].values():
            law = laws("material")[material["law"]]
            material["stabilisation"] = setting.stabilisation * declared(law)["stabilisation"].default
            if "stiffening" in declared(law):
                material["stiffening"] = setting.stiffening
            else:
                material["reduced_bulk_modulus"] = f"{setting.modulus:g} MPa"
        return from_dict(tree, f"{self.name}.toml")

    def place(self, sim: Simulation) -> None:
        """Give the particles their displacement at the start."""
        if self.start is not None:
            m = sim.mechanics
            centre = sim.scene.centre[0]
            m.state.owned[:, :2] = (sim.scene.X[m.ids] - centre) @ np.array(self.start).T
            m.state.exchange()
            m.renew_lists()
            sim.sample()


def _resolved(name: str) -> dict:
    register()
    return load(FOLDER / f"{name}.toml", ("particles.per_cell=91",)).resolved()


def _disc() -> dict:
    """The nucleus, alone and at rest."""
    tree = _resolved("nucleus")
    tree["cells"][0].pop("velocity_gradient")
    return tree


def _drop() -> dict:
    """The cytoplasm, alone."""
    tree = _resolved("one_cell")
    for key in ("adhesion", "protrusion"):
        tree.pop(key, None)
    del tree["materials"]["nucleus"], tree["cells"][0]["nucleus"], tree["cells"][0]["nucleus_ratio"]
    stretching = [["0.02 /us", "0 /us"], ["0 /us", "-0.02 /us"]]
    tree["cells"][0] |= {"centre": ["0 um", "0 um"], "velocity_gradient": stretching}
    return tree


def _cell() -> dict:
    """The paper's cell."""
    return _resolved("one_cell")


def semi_axes(sim: Simulation) -> dict[str, float]:
    """Half the width and the height of a disc by the material points at 0 and 90 degrees, interpolated [µm]."""
    m, surface = sim.mechanics, sim.scene.surface(0)
    at = np.argsort(m.ids)[surface]
    X = sim.scene.X[surface] - sim.scene.centre[0]
    u, radius = m.state.owned[at, :2], np.hypot(*X.T).mean()
    angle = np.arctan2(X[:, 1], X[:, 0])
    return {"a": radius + _at(angle, u[:, 0], 0.0), "b": radius + _at(angle, u[:, 1], 0.5 * np.pi)}


def _at(angle: np.ndarray, values: np.ndarray, where: float) -> float:
    """Values at even angles, interpolated by the trigonometric polynomial through them."""
    c = np.fft.fft(values) / len(values)
    k = np.fft.fftfreq(len(values), 1.0 / len(values))
    return float(np.real(c @ np.exp(1j * k * (where - angle[0]))))


def spreading(sim: Simulation) -> dict[str, float]:
    """Length of contact with the substrate, height, and height of the centre of a cell [µm]."""
    row = sim.sample()[0][1]
    y = sim.mechanics.surface_positions()[:, 1]
    return {"contact": row["substrate_contact_um"], "height": float(np.ptp(y)), "centre": row["y_um"]}


def ringing(t: np.ndarray) -> np.ndarray:
    """a2(t) of the released nucleus [µm], by high-order finite elements, to 2e-4."""
    return 3.8e-5 + 0.06368 * np.cos(3.5659 * t) + 0.00637 * np.cos(7.2372 * t) + 3.4e-4 * np.cos(12.32 * t)


def judge_disc(t: np.ndarray, seen: Seen, _: Any) -> dict[str, float]:
    """Root mean square over time of what a2 misses, over that of a2; the error of its first mode by a fit.

    `amplitude` and `frequency` are relative; `decay` [1/µs] should be zero.
    """
    a2, exact = 0.5 * (seen["a"] - seen["b"]), ringing(t)

    def missed(p: np.ndarray) -> np.ndarray:
        return np.exp(-p[2] * t) * (p[0] * np.cos(p[1] * t) + 0.00637 * np.cos(2.0296 * p[1] * t)) - a2

    amplitude, frequency, decay = least_squares(missed, (0.06368, 3.5659, 0.0)).x
    return {"error": _rms(a2 - exact) / _rms(exact), "amplitude": float(amplitude / 0.06368 - 1.0),
            "frequency": float(frequency / 3.5659 - 1.0), "decay": float(decay)}


def judge_drop(t: np.ndarray, seen: Seen, _: Any) -> dict[str, float]:
    """Largest error of each semi-axis at 1, 2 and 5 µs over the displacement at the end; the error is the larger."""
    exact = {"a": (5.08760, 5.15571, 5.28614), "b": (4.91357, 4.84742, 4.72173)}  # to 1e-5, high-order finite elements
    parts = {name: float(np.abs(seen[name] - exact[name]).max()) / 0.28614 for name in exact}
    return {"error": max(parts.values()), **parts}


def judge_cell(t: np.ndarray, seen: Seen, finest: Seen | None) -> dict[str, float]:
    """Root mean square over time of what each misses, over that of its change; the error is their mean."""
    if finest is None:
        return {"error": float("nan")}
    first = {"contact": 0.0, "height": 2.0 * CELL, "centre": CELL + 0.01}
    parts = {name: _rms(seen[name] - finest[name]) / _rms(finest[name] - first[name]) for name in first}
    return {"error": float(np.mean(list(parts.values()))), **parts}


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


PROBLEMS = {p.name: p for p in (
    Problem("disc", "elastic", "elastic disc released, two periods", _disc, tuple(0.0881 * np.arange(1, 41)), semi_axes,
            judge_disc, start=((0.05, 0.0), (0.0, -0.05)), without=("modulus",)),
    Problem("drop", "fluid", "viscous drop that stretches, 5 µs", _drop, (1.0, 2.0, 5.0), semi_axes, judge_drop,
            without=("stiffening",)),
    Problem("cell", "cell on substrate", "the paper's cell spreads, 40 µs", _cell, tuple(np.arange(2.0, 41.0, 2.0)),
            spreading, judge_cell, own=True),
)}
