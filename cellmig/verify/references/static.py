"""Elastic bodies in equilibrium: patch test, cantilever, hole, flexure, column, Cook's membrane, squeezed disc."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from cellmig.case.schema import Case
from cellmig.simulation import Simulation
from cellmig.verify.reference import Measured, converges, exact, reference
from cellmig.verify.specimens import RAMP, Cantilever, Column, Flexure, Kirsch, piece, rectangle, support, traction

from .scenes import built, by_id, displacement, l2_error, on_a_pressed_rim
from .solid import ELASTIC

LINEAR = 1e-5  # strain of solutions in small strain
SMOOTH = "h² of a linear basis, the solution is smooth"
EDGES = ["bottom", "right", "top", "left"]


def law_of(case: Case) -> Any:
    """The material of a test piece."""
    return case.materials["nucleus"]


def loaded(sim: Simulation, time: float = 1.0) -> dict[str, float]:
    """The row of history of all cells at the equilibrium of a time [µs]."""
    n = round(time * sim.case.time.samples)
    for k in range(n):
        sim.go(time * (k + 1) / n)
    return sim.sample()[0][0]


def displacement_error(sim: Simulation, right: np.ndarray) -> float:
    """L2 error of the displacements over the L2 norm of the exact ones, `right` (size, 2) [µm]."""
    return l2_error(sim, displacement(sim), right)


# ------------------------------------------------------------------------------------------------------- patch tests


class PerturbedShape:
    """A shape whose inner particles are moved at random, by up to a share of the spacing."""

    def __init__(self, shape: Any, share: float):
        self._shape, self._share = shape, share

    def __getattr__(self, name: str) -> Any:
        return getattr(self._shape, name)

    def particles(self, count: int, refinement: float = 1.0) -> NamedTuple:
        """Particles of the shape, moved."""
        layout = self._shape.particles(count, refinement)
        inner = np.ones(len(layout.X), bool)
        inner[layout.surface] = False
        step = self._share * np.sqrt(self.area / count)
        X = layout.X.copy()
        X[inner] += np.random.default_rng(count).uniform(-step, step, (inner.sum(), 2))
        return layout._replace(X=X)


# The bottom of a block stays level; both principal stresses are tensile, so that dead loads are stable.
STRETCH = np.array([[1.2, 0.15], [0.0, 0.8365]])


@reference("patch", shows="a block of random particles, stretched by 1.2 x 0.84 and sheared by 0.15: uniform strain",
           source="F is uniform", at=(150, 600, 2400), quick=(100, 200, 400), seconds=8.0,
           expected={"held all around": exact(1e-8, "gradients of linear fields are exact, to Newton's tolerance"),
                     "pulled by tractions": exact(1e-8, "the same for integrals of gradients"),
                     "stress": exact(1e-7, "uniform in both")})
def patch(count: int) -> Measured:
    """Errors are relative to the length of the block and to the largest stress."""
    found = {}
    u = [f"{STRETCH[i, 0] - (i == 0)}*x + {STRETCH[i, 1] - (i == 1)}*y" for i in range(2)]
    for name, tables in (("held all around", {"supports": [support("all", EDGES, *u)]}), ("pulled by tractions", {})):
        case = piece(rectangle(6.0, 4.0), count, samples=4, **(tables or _pulled()))
        cell = dataclasses.replace(case.cells[0], shape=PerturbedShape(case.cells[0].shape, 0.3))
        with built(dataclasses.replace(case, cells=(cell,))) as sim:
            loaded(sim)
            right = sim.scene.X @ (STRETCH - np.eye(2)).T
            if not tables:
                right -= right[sim.mechanics.loads.boundary.held[0, 0]]
            found[name] = float(np.abs(displacement(sim) - right).max() / 6.0)
            s = sim.sampler.nodal_stress()[0]
            found["stress"] = max(found.get("stress", 0.0), float(np.ptp(s, axis=0).max() / np.abs(s).max()))
            spacing = sim.scene.templates[0].spacing
    return Measured(spacing, found, count)


def _pulled() -> dict:
    """Dead tractions of the uniform stress on all sides; supports of three components, whose reactions are zero."""
    case = piece(rectangle(1.0, 1.0), 50)
    P = np.array(law_of(case).stress(STRETCH[:, :, None]))[:, :, 0]
    normals = dict(zip(EDGES, ([0, -1], [1, 0], [0, 1], [-1, 0]), strict=True))
    loads = [traction(f"{edge}-pull", [edge], *map(repr, (P @ n).tolist())) for edge, n in normals.items()]
    corners = [support("corner", [], "0", "0", box=[["-3 um", "-2 um"], ["-2.999 um", "-1.999 um"]]),
               support("other", [], "free", "0", box=[["2.999 um", "-2 um"], ["3 um", "-1.999 um"]])]
    return {"loads": loads, "supports": corners}


# ------------------------------------------------------------------------------------------------------ small strain


@reference("cantilever", shows="beam of 8 x 2 µm under a shear force at its end, in small strain, L2 over the beam",
           source="Timoshenko & Goodier, Theory of Elasticity, §21; verify/specimens.py", at=(400, 1250, 5000, 20000),
           quick=(200, 500, 1250), seconds=60.0,
           expected={"displacement": converges(2, SMOOTH, ELASTIC), "deflection": converges(2, SMOOTH, ELASTIC)})
def cantilever(count: int) -> Measured:
    """The deflection is that of the middle of the loaded end."""
    beam = Cantilever(law_of(piece(rectangle(1.0, 1.0), 50)), 8.0, 2.0, LINEAR)
    with built(piece(rectangle(8.0, 2.0), count, supports=[support("clamp", ["left"], *beam.formulas())],
                     loads=[traction("shear", ["right"], "0", beam.shear())],
                     probes=[{"name": "end", "point": ["4 um", "0 um"]}])) as sim:
        row = loaded(sim)
        tip = beam.displacement(np.array([[4.0, 0.0]]))[0, 1]
        error = displacement_error(sim, beam.displacement(sim.scene.X))
        return Measured(sim.scene.templates[0].spacing, {"displacement": error,
                                                         "deflection": abs(row["end_uy_um"] / tip - 1.0)}, count)


@reference("hole", shows="strip of 4 x 4 µm with a hole, R = 1 µm, pulled along x as of an infinite plate, L2",
           source="Kirsch 1898; verify/specimens.py", at=(500, 1250, 5000, 20000), quick=(300, 700, 1500), seconds=90.0,
           coarse={"hoop stress": 0.11},
           expected={"displacement": converges(2, SMOOTH, ELASTIC),
                     "recovered stress": converges(1, "fits to gradients that are exact to h"),
                     "concentration": converges(1, "gradients of a linear basis, at the surface", ELASTIC),
                     "hoop stress": converges(1, "the same, with the pressure in it")})
def hole(count: int) -> Measured:
    """The exact solution is prescribed at both ends, its tractions act above and below.

    The concentration is σxx - σyy at the top of the hole, where σxx is 3 σ and σyy is zero.
    """
    plate = Kirsch(law_of(piece(rectangle(1.0, 1.0), 50)), 1.0, LINEAR)
    shape = rectangle(4.0, 4.0, holes=[["0 um", "0 um", "1 um"]])
    xy, yy = plate.tractions()
    with built(piece(shape, count, supports=[support("ends", ["left", "right"], *plate.formulas())],
                     loads=[traction("above", ["top"], xy, yy),
                            traction("below", ["bottom"], f"-({xy})", f"-({yy})")])) as sim:
        loaded(sim)
        X, V = sim.scene.X, sim.scene.field("V")
        found = by_id(sim, sim.sampler.stresses()["stress"])
        found = np.column_stack([found[:, 0, 0], found[:, 1, 1], found[:, 0, 1]])
        right, weight = plate.stress(X), np.array([1.0, 1.0, 2.0])
        stress = np.sqrt((V @ ((found - right) ** 2 @ weight)) / (V @ (right**2 @ weight)))
        crown = on_the_hole(X, found) / plate.pull
        return Measured(sim.scene.templates[0].spacing,
                        {"displacement": displacement_error(sim, plate.displacement(X)),
                         "recovered stress": float(stress),
                         "concentration": abs((crown[0] - crown[1]) / 3.0 - 1.0),
                         "hoop stress": abs(crown[0] / 3.0 - 1.0)}, count)


def on_the_hole(X: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Mean of values at the two particles that are nearest to the highest and the lowest point of the hole."""
    rim = np.flatnonzero(np.abs(np.hypot(*X.T) - 1.0) < 1e-2)
    return np.mean([values[rim[np.argmin(np.abs(X[rim] - [0.0, y]).sum(axis=1))]] for y in (1.0, -1.0)], axis=0)


# ----------------------------------------------------------------------------------------------------- finite strain


@reference("flexure", shows="block of 2 x 8 µm bent into a quarter of a ring, in finite strain, L2 over the block",
           source="Rivlin 1949 for a compressible solid; verify/specimens.py", at=(400, 1250, 5000),
           quick=(200, 500, 1250), seconds=30.0,
           expected={"displacement": converges(2, SMOOTH, ELASTIC)})
def flexure(count: int) -> Measured:
    """The exact solution is prescribed at both ends; the long sides are free."""
    bent = Flexure(law_of(piece(rectangle(1.0, 1.0), 50)), 2.0, np.pi / 16.0)
    ends = [support("ends", ["bottom", "top"], *bent.formulas())]
    with built(piece(rectangle(2.0, 8.0), count, samples=8, supports=ends)) as sim:
        loaded(sim)
        error = displacement_error(sim, bent.displacement(sim.scene.X))
        return Measured(sim.scene.templates[0].spacing, {"displacement": error},
                        count)


@reference("column", shows="a column of 2 x 4 µm between smooth walls sinks by its weight, in finite strain, L2",
           source="dP22/dY = b; verify/specimens.py", at=(200, 800, 3200), quick=(100, 300, 900), seconds=15.0,
           expected={"displacement": converges(2, SMOOTH, ELASTIC)})
def column(count: int) -> Measured:
    """The body force is 5 kPa/µm and compresses the lower end by 3 %."""
    sunk = Column(law_of(piece(rectangle(1.0, 1.0), 50)), 4.0, 5e3)
    walls = [support("foot", ["bottom"], "free", "0"), support("walls", ["left", "right"], "0", "free")]
    weight = {"name": "weight", "body": ["0 Pa/um", "-5e3 Pa/um"], "load_curve": RAMP}
    with built(piece(rectangle(2.0, 4.0), count, samples=4, supports=walls, loads=[weight])) as sim:
        loaded(sim)
        error = displacement_error(sim, sunk.displacement(sim.scene.X))
        return Measured(sim.scene.templates[0].spacing, {"displacement": error},
                        count)


@reference("cook", shows="Cook's membrane of the nucleus's law under 350 Pa",
           source="finite elements: NGSolve of high order, felupe's mixed Q2",
           at=(500, 1250, 5000, 20000), quick=(300, 700, 1500), seconds=120.0,
           coarse={"deflection": 9.7e-3, "energy": 9.7e-3},
           expected={"deflection": converges(1.09, "twice the exponent 0.545 of the corner between clamped and free "
                                             "side (Williams 1952)", ELASTIC, floor=0.0003 / 6.8522),
                     "energy": converges(1.09, "as the deflection", ELASTIC, floor=3.0 / 18490.0)})
def cook(count: int) -> Measured:
    """The deflection is the mean u_y of the loaded edge."""
    corners = [["0 um", "0 um"], ["48 um", "44 um"], ["48 um", "60 um"], ["0 um", "44 um"]]
    with built(piece({"shape": "polygon", "corners": corners}, count, samples=4,
                     supports=[support("clamp", ["edge-4"], "0", "0")],
                     loads=[traction("pull", ["edge-2"], "0", "350")],
                     probes=[{"name": "edge", "parts": ["edge-2"]}])) as sim:
        row, entries = loaded(sim), sim.sample()[1]
        energy = entries["elastic_pn"] + entries["artificial_dissipation_pn"]
        return Measured(sim.scene.templates[0].spacing,
                        {"deflection": abs(row["edge_uy_um"] / 6.8522 - 1.0),
                         "energy": abs(energy / 18490.0 - 1.0)}, count)


@reference("squeezed-disc", shows="disc R = 1.415 µm between rigid smooth plates, its diameter reduced by 10 and 20 %",
           source="finite elements of two public codes, ± 0.05 %",
           at=(320, 1500, 5000), quick=(320, 505, 1500), seconds=90.0,
           expected={"force, 10 %": converges(2, SMOOTH, ELASTIC, floor=1.0 / 2062.9),
                     "force, 20 %": converges(2, SMOOTH, ELASTIC, floor=1.5 / 5836.2),
                     "bulge, 10 %": converges(2, SMOOTH, ELASTIC, floor=5e-5 / 0.06899),
                     "bulge, 20 %": converges(2, SMOOTH, ELASTIC, floor=5e-5 / 0.18204)})
def squeezed_disc(count: int) -> Measured:
    """Supports keep the highest and the lowest particle on the axis, as smooth plates do not.

    The end of the contact moves from particle to particle, so the surface has twice as many: with as many as inside,
    bulges at 1,500 to 5,000 particles scatter by as much as their errors.
    """
    plates = [{"name": name, "point": ["0 um", f"{y} um"], "normal": [0, -y], "load_curve": RAMP,
               "displacement": ["0 um", f"{-0.2 * y} um"]} for name, y in (("top", 1.415), ("bottom", -1.415))]
    axis = [support(name, [], "0", "free", box=[["-0.001 um", f"{y - 0.01} um"], ["0.001 um", f"{y + 0.01} um"]])
            for name, y in (("high", 1.415), ("low", -1.415))]
    found: dict[str, float] = {}
    steps = 2 * int(np.ceil(np.sqrt(count) / 9.0))
    with built(piece({"shape": "disc", "radius": "1.415 um"}, count, samples=steps, plates=plates, supports=axis,
                     particles={"per_cell": count, "surface_refinement": 2.0})) as sim:
        for share, force, bulge in ((10, 2062.9, 0.06899), (20, 5836.2, 0.18204)):
            for k in range(steps // 2):
                sim.go((share - 10 + 20 * (k + 1) / steps) / 20)
            row, x = sim.sample()[0][0], on_a_pressed_rim(sim, (0.0, np.pi))
            found[f"force, {share} %"] = abs(row["bottom_force_y_pn_per_um"] / force - 1.0)
            found[f"bulge, {share} %"] = abs((0.5 * (x[0, 0] - x[1, 0]) - 1.415) / bulge - 1.0)
        return Measured(sim.scene.templates[0].spacing, found, count)
