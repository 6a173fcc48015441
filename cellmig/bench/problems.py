"""Problems for run time against error: elastic, fluid, a spreading cell, the paper's scene, and some in space."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from mpi4py import MPI

from cellmig.case.load import from_dict, load
from cellmig.case.registry import laws
from cellmig.case.schema import Case
from cellmig.case.shipped import FOLDER
from cellmig.case.values import declared
from cellmig.laws import register
from cellmig.runs.cases import fluid_drop
from cellmig.runs.run import ENERGY_ERROR
from cellmig.simulation import Simulation

from . import space

CELL = 5.0  # radius [µm]
FLATTENED = 20.0  # time from which stresses of the scene count: until then snaps of the membrane rule them [µs]
Series = dict[str, np.ndarray]
FIXED = ("dilation", "surface_refinement", "modulus")  # what does not apply to a solid in space


@dataclass(frozen=True)
class Setting:
    """Numerical choices.

    per_cell : particles;  dilation : of the kernel;  surface_refinement : density of particles along surfaces over that
    inside;  integrator : "leapfrog" or a type of PETSc's TS;  step_factor : step over the stable one;  stabilisation :
    its viscosity over the default of the law;  hourglass_modulus : of the nucleus, over G;  modulus : reduced bulk
    modulus [MPa];  bulk_viscosity : over ρ c h.
    """

    per_cell: int = 1485
    dilation: float = 2.2
    surface_refinement: float = 1.0
    integrator: str = "leapfrog"
    step_factor: float = 0.8
    stabilisation: float = 1.0
    hourglass_modulus: float = 0.16
    modulus: float = 5.0
    bulk_viscosity: float = 0.05

    @property
    def changes(self) -> dict[str, Any]:
        """Choices other than the defaults, without the number of particles."""
        return {f.name: getattr(self, f.name) for f in fields(self)[1:] if getattr(self, f.name) != f.default}

    @property
    def description(self) -> str:
        """The same in words."""
        return ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in self.changes.items()) or "defaults"


@dataclass(frozen=True)
class Problem:
    """A problem.

    kind : of scene, for which an accuracy is picked;  of : quantities whose error counts;  tree : returns the tables of
    its case;  times : of measurements [µs];  measure : returns quantities of a simulation, by name;  judge : error [-]
    and its parts, from the times, the measurements and those of the finest run, which are the reference where `own`;
    start : initial displacement gradient;  without : choices that do not apply.
    """

    name: str
    kind: str
    title: str
    of: str
    tree: Callable[[], dict]
    times: tuple[float, ...]
    measure: Callable[[Simulation], dict[str, float]]
    judge: Callable[[np.ndarray, Series, Series | None], dict[str, float]]
    start: tuple | None = None
    without: tuple[str, ...] = ()
    own: bool = False

    def case(self, setting: Setting) -> Case:
        """The case with a setting."""
        tree = self.tree()
        tree["time"] |= {"end": f"{self.times[-1]:.9g} us", "integrator": setting.integrator,
                         "step_factor": setting.step_factor}
        tree["particles"] = {"per_cell": setting.per_cell, "dilation": setting.dilation,
                             "surface_refinement": setting.surface_refinement}
        tree["numerics"] = {"bulk_viscosity": setting.bulk_viscosity}
        for material in tree["materials"].values():
            law = laws("material")[material["law"]]
            material["stabilisation"] = setting.stabilisation * declared(law)["stabilisation"].default
            if "hourglass_modulus" in declared(law):
                material["hourglass_modulus"] = setting.hourglass_modulus
            else:
                material["reduced_bulk_modulus"] = f"{setting.modulus:g} MPa"
        return from_dict(tree, f"{self.name}.toml")

    def simulation(self, setting: Setting) -> Simulation:
        """The simulation with a setting on this process alone, with its initial displacements."""
        sim = Simulation(self.case(setting), MPI.COMM_SELF)
        if self.start is not None:
            m = sim.mechanics
            centre = sim.scene.centre[0]
            m.state.owned[:, :2] = (sim.scene.X[m.ids] - centre) @ np.array(self.start).T
            m.state.exchange()
            m.renew_lists()
            sim.sample()
        return sim


def _resolved(name: str) -> dict:
    register()
    return load(FOLDER / f"{name}.toml", ("particles.per_cell=91",)).resolved()


def _disc() -> dict:
    """The nucleus alone, at rest."""
    tree = _resolved("nucleus")
    tree["cells"][0].pop("velocity_gradient")
    return tree


def _drop() -> dict:
    """A drop of the cytoplasm that stretches."""
    tree = fluid_drop(_resolved("one_cell"))
    tree["cells"][0]["velocity_gradient"] = [["0.02 /us", "0 /us"], ["0 /us", "-0.02 /us"]]
    return tree


def _cell() -> dict:
    """The paper's cell."""
    return _resolved("one_cell")


def _scene() -> dict:
    """The paper's three cells, all of which protrude."""
    return _resolved("all_protrude")


def _tension() -> dict:
    """The same with the tension of a cortex, without which the contact between cells depends on the spacing."""
    return _resolved("all_protrude_tension")


def semi_axes(sim: Simulation) -> dict[str, float]:
    """Semi-axes a and b of a disc [µm], from the displacements of the points of its rim at 0 and 90 degrees."""
    m, surface = sim.mechanics, sim.scene.surface(0)
    at = np.argsort(m.ids)[surface]
    X = sim.scene.X[surface] - sim.scene.centre[0]
    u, radius = m.state.owned[at, :2], np.hypot(*X.T).mean()
    angle = np.arctan2(X[:, 1], X[:, 0])
    return {"a": radius + _at(angle, u[:, 0], 0.0), "b": radius + _at(angle, u[:, 1], 0.5 * np.pi)}


def _at(angle: np.ndarray, values: np.ndarray, where: float) -> float:
    """Trigonometric interpolation of values at equally spaced angles."""
    c = np.fft.fft(values) / len(values)
    k = np.fft.fftfreq(len(values), 1.0 / len(values))
    return float(np.real(c @ np.exp(1j * k * (where - angle[0]))))


def spreading(sim: Simulation) -> dict[str, float]:
    """Contact with the substrate, height and height of the centre of mass of a cell [µm].

    The contact is a length, in space the radius of a disc of the area of contact.
    """
    row, up = sim.sample()[0][1], sim.case.dimension - 1
    contact = row["substrate_contact_um"] if up == 1 else np.sqrt(row["substrate_contact_um2"] / np.pi)
    height = float(np.ptp(sim.comm.bcast(sim.mechanics.segments.everywhere())[:, up]))
    return {"contact": float(contact), "height": height, "centre": row[f"{'xyz'[up]}_um"]}


def crawling(sim: Simulation) -> dict[str, float]:
    """Displacements and contact lengths [µm] of an aggregate, median stresses [Pa], energy error [-].

    Displacements are those of the aggregate (0) and of each cell; effective stresses are medians over the particles by
    volume, of the fluid and of the nuclei.  Raises NumericsError where the energy error would end a run.
    """
    rows, ledger = sim.sample()
    if ledger["energy_error"] > ENERGY_ERROR:
        sim.integrator.fail(f"the energy error is {100 * ledger['energy_error']:.3g} %")
    found = {f"u{axis}{cell}": row[f"u{axis}_um"] for cell, row in enumerate(rows) for axis in "xy"}
    found |= {name: rows[0][f"{name}_contact_um"] for name in ("substrate", "cell")}
    stress, sampler = sim.sampler.stresses()["effective_stress"], sim.sampler
    fluid = np.isin(sampler.material, [k for k, law in enumerate(sim.scene.materials)
                                       if hasattr(law, "reduced_bulk_modulus")])
    return found | {"stress": _median(stress[fluid], sampler.V[fluid]), "energy": ledger["energy_error"],
                    "nucleus_stress": _median(stress[~fluid], sampler.V[~fluid])}


def _median(values: np.ndarray, weights: np.ndarray) -> float:
    """The weighted median: half of the weight belongs to smaller values."""
    order = np.argsort(values)
    below = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(below, 0.5 * below[-1])])


def ringing(t: np.ndarray) -> np.ndarray:
    """Half of a - b [µm] of the released nucleus at times t (n,) [µs]: finite elements of high order, to 2e-4."""
    return 3.8e-5 + 0.06368 * np.cos(3.5659 * t) + 0.00637 * np.cos(7.2372 * t) + 3.4e-4 * np.cos(12.32 * t)


def judge_disc(t: np.ndarray, series: Series, _: Any) -> dict[str, float]:
    """Root mean square error over time of half of a - b, over that of the exact solution.

    Parts are the relative errors of amplitude and frequency of the fitted first mode, and its decay [1/µs].
    """
    a2, exact = 0.5 * (series["a"] - series["b"]), ringing(t)

    def residual(p: np.ndarray) -> np.ndarray:
        return np.exp(-p[2] * t) * (p[0] * np.cos(p[1] * t) + 0.00637 * np.cos(2.0296 * p[1] * t)) - a2

    amplitude, frequency, decay = least_squares(residual, (0.06368, 3.5659, 0.0)).x
    return {"error": rms(a2 - exact) / rms(exact), "amplitude": float(amplitude / 0.06368 - 1.0),
            "frequency": float(frequency / 3.5659 - 1.0), "decay": float(decay)}


def judge_drop(t: np.ndarray, series: Series, _: Any) -> dict[str, float]:
    """Largest error of both semi-axes at 1, 2 and 5 µs, over the displacement at the end."""
    exact = {"a": (5.08760, 5.15571, 5.28614), "b": (4.91357, 4.84742, 4.72173)}  # finite elements, to 1e-5
    parts = {name: float(np.abs(series[name] - exact[name]).max()) / 0.28614 for name in exact}
    return {"error": max(parts.values()), **parts}


def judge_cell(t: np.ndarray, series: Series, finest: Series | None) -> dict[str, float]:
    """Mean of the relative errors of all quantities: root mean squares over time, over those of their change."""
    if finest is None:
        return {"error": float("nan")}
    first = {"contact": 0.0, "height": 2.0 * CELL, "centre": CELL + 0.01}
    parts = {name: rms(series[name] - finest[name]) / rms(finest[name] - first[name]) for name in first}
    return {"error": float(np.mean(list(parts.values()))), **parts}


def judge_scene(t: np.ndarray, series: Series, finest: Series | None,
                counted: tuple[str, ...] = ("displacement", "substrate", "cells")) -> dict[str, float]:
    """The largest relative error of the mean displacement along x and of the lengths of contact, those `counted`.

    They, and the displacements of each cell, are root mean squares over time, over those of the reference.  Further
    parts are errors of the median stresses, whose medians over time count, and the largest energy error of the run.
    """
    if finest is None:
        return {"error": float("nan")}

    def apart(*names: str) -> float:
        found, exact = (np.concatenate([s[name] for name in names]) for s in (series, finest))
        return rms(found - exact) / rms(exact)

    def stress(name: str) -> float:
        found, exact = (float(np.median(s[name][t >= FLATTENED])) for s in (series, finest))
        return abs(found / exact - 1.0)

    parts = {"displacement": apart("ux0"), "substrate": apart("substrate"), "cells": apart("cell")}
    each = [name for name in finest if name[0] == "u" and name[-1] != "0"]
    return {"error": max(parts[name] for name in counted), **parts, "each": apart(*each), "stress": stress("stress"),
            "nucleus": stress("nucleus_stress"), "energy": float(series["energy"].max())}


def judge_exact(t: np.ndarray, series: Series, _: Any, name: str,
                exact: Callable[[np.ndarray], np.ndarray]) -> dict[str, float]:
    """Root mean square error over time of one quantity, over that of the `exact` one."""
    return {"error": rms(series[name] - exact(t)) / rms(exact(t))}


def columns(rows: Sequence[dict[str, float]]) -> Series:
    """Measurements at several times, as an array for each quantity."""
    return {key: np.array([row[key] for row in rows]) for key in rows[0]}


def rms(x: np.ndarray) -> float:
    """Root mean square of x (n,), in its unit."""
    return float(np.sqrt(np.mean(np.square(x))))


PROBLEMS = {p.name: p for p in (
    Problem("disc", "elastic", "elastic disc released, two periods", "the displacement in time", _disc,
            tuple(0.0881 * np.arange(1, 41)), semi_axes, judge_disc, start=((0.05, 0.0), (0.0, -0.05)),
            without=("modulus", "surface_refinement")),
    Problem("drop", "fluid", "viscous drop that stretches, 5 µs", "the shape", _drop, (1.0, 2.0, 5.0), semi_axes,
            judge_drop, without=("hourglass_modulus", "surface_refinement")),
    Problem("cell", "cell on substrate", "the paper's cell spreads, 40 µs", "contact length and height", _cell,
            tuple(np.arange(2.0, 41.0, 2.0)), spreading, judge_cell, own=True),
    Problem("scene", "cells on a substrate", "the paper's three cells, 100 µs",
            "displacement and contact with the substrate; without a cortex the contact between cells depends on the "
            "spacing", _scene, tuple(np.arange(2.0, 101.0, 2.0)), crawling,
            partial(judge_scene, counted=("displacement", "substrate")), own=True),
    Problem("tension", "cells with a cortex on a substrate", "the same with the tension of a cortex",
            "displacement and contacts with the substrate and between cells", _tension,
            tuple(np.arange(2.0, 101.0, 2.0)), crawling, judge_scene, own=True),
    Problem("twist", "elastic in space", "elastic ball that twists, two periods", "the displacement in time",
            space.twisting, tuple(0.3 * np.arange(1, 41)), space.twisted,
            partial(judge_exact, name="twist", exact=space.exact_twist), without=FIXED),
    Problem("turn", "fluid in space", "ball of fluid that turns, 1 µs", "the flow in time", space.turning,
            tuple(0.1 * np.arange(1, 11)), space.turned, partial(judge_exact, name="flow", exact=space.exact_flow),
            without=(*FIXED[:2], "hourglass_modulus")),
    Problem("ball", "cell on substrate in space", "a cell in space spreads, 40 µs", "radius of contact and height",
            space.cell, tuple(np.arange(2.0, 41.0, 2.0)), spreading, judge_cell, without=("dilation",), own=True),
)}
