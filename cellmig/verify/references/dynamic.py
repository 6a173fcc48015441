"""Elastic bodies that move under supports and loads: a compression wave, manufactured solutions, vibrating beams.

There is no numerical damping.  Strains are 1e-7 where the solution is one of small strains.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import eigsh

from cellmig.case.schema import Case
from cellmig.simulation import Simulation
from cellmig.verify.reference import Measured, converges, exact, reference
from cellmig.verify.specimens import piece, rectangle

from .scenes import built, displaced, displacement, relative_rms, set_state
from .solid import ELASTIC, stiffness
from .static import EDGES, displacement_error

SMOOTH = "h² of a linear basis, and of a step that goes with h"
SIZE = 1e-7  # amplitude of motions [µm]
LAWS = {"stiff": "170 kPa", "soft": "2 kPa"}  # moduli λ of the paper, with Poisson's ratio 0.497, and one with 0.259


def elastic(width: float, height: float, count: int, modulus: str, *held: dict, **tables: Any) -> Case:
    """A rectangle [µm] of the nucleus's law without damping; `held` : supports;  `start` : fields of its cell."""
    clock = {"end": "100 us", "integrator": "leapfrog"} | tables.pop("time", {})
    return piece(rectangle(width, height, **tables.pop("start", {})), count, time=clock,
                 material={"volumetric_modulus": modulus, "stabilisation": 0}, numerics={"bulk_viscosity": 0},
                 supports=[{"name": f"held-{k}", **s} for k, s in enumerate(held)], **tables)


# --------------------------------------------------------------------------------------------------------- one wave


@reference("standing-wave", shows="compression wave that stands in a block of 4 x 1 µm, two periods, L2",
           source="u = A cos(π x/L) sin ωt, ω = (π/L) sqrt((λ + 2G)/ρ)", at=(300, 1250, 5000, 20000),
           quick=(300, 600, 1250), seconds=60.0, coarse={"soft across": 7.5e-5},
           expected={name + part: converges(2, why, ELASTIC)
                     for part, why in (("", SMOOTH), (" across", "a plane wave has none; at most, over A"),
                                       (" across, L2", "the same; over that of the displacement"))
                     for name in LAWS})
def standing_wave(count: int) -> Measured:
    """The initial velocity is given; 2 1/8 periods later phase and amplitude contribute to the error alike."""
    length, found = 4.0, {}
    walls = [{"parts": ["left", "right"], "displacement": ["0 um", "free"]},
             {"parts": ["bottom", "top"], "displacement": ["free", "0 um"]}]
    for name, modulus in LAWS.items():
        case = elastic(length, 1.0, count, modulus, *walls)
        omega = np.pi / length * case.materials["nucleus"].sound_speed
        with built(case) as sim:
            form = np.column_stack([np.cos(np.pi / length * sim.scene.X[:, 0]), np.zeros(count)])
            set_state(sim, None, SIZE * omega * form)
            time = 2.125 * 2.0 * np.pi / omega
            sim.go(time)
            right = SIZE * np.sin(omega * time) * form
            found[name] = displacement_error(sim, right)
            V, across = sim.scene.field("V"), displacement(sim)[:, 1]
            found[f"{name} across"] = float(np.abs(across).max() / SIZE)
            found[f"{name} across, L2"] = float(np.sqrt(V @ across**2 / (V @ right[:, 0] ** 2)))
            spacing = sim.scene.templates[0].spacing
    return Measured(spacing, found, count)


# --------------------------------------------------------------------------------------------- manufactured solutions


class Waves:
    """The manufactured solution u = A sin(Ωt) Σ p sin(k·x + φ) with its body force and tractions, in small strain."""

    k = np.array([[0.9, 0.5], [-0.4, 1.1], [1.3, -0.7]])  # [1/µm]
    across, along = np.array([0.6, -0.7, 0.4]), np.array([0.8, 0.5, -0.6])  # parts of p
    phase = np.array([0.3, 1.0, -0.5])

    def __init__(self, law: Any, period: float, size: float, squeezed: float):
        """`size` : A [µm];  `squeezed` : factor of the longitudinal part of p, which changes volumes."""
        self.lame, self.G = law.bulk_modulus - 2.0 / 3.0 * law.shear_modulus, law.shear_modulus
        self.density, self.size, self.omega = law.density, size, 2.0 * np.pi / period
        self.load_curve = {"law": "sine", "period": f"{period} us"}
        self.p = self.across[:, None] * self.turned() + squeezed * self.along[:, None] * self.k

    def turned(self) -> np.ndarray:
        """A vector across each k (waves, d) [1/µm]."""
        return np.column_stack([-self.k[:, 1], self.k[:, 0]])

    def _sum(self, vectors: np.ndarray, unit: str, function: str = "sin") -> list[str]:
        """Formulas of the components of A Σ a sin(k·x + φ), with the rows a of `vectors` (k, c)."""
        waves = [f"{function}({' + '.join(f'{c}*{x}' for c, x in zip(k, 'xyz', strict=False))} + {a})"
                 for k, a in zip(self.k.tolist(), self.phase.tolist(), strict=True)]
        return [" + ".join(f"{c}*{w}" for c, w in zip(column, waves, strict=True)) + f" {unit}"
                for column in (self.size * vectors).T.tolist()]

    def displacement(self, X: np.ndarray, time: float) -> np.ndarray:
        """Exact displacements (n, d) [µm]."""
        return self.size * np.sin(self.omega * time) * np.sin(X @ self.k.T + self.phase) @ self.p

    def support(self, parts: list[str]) -> dict:
        """A support that moves parts by the solution."""
        return {"parts": parts, "displacement": self._sum(self.p, "um"), "load_curve": self.load_curve}

    def start(self) -> dict:
        """The initial velocity."""
        return {"velocity": self._sum(self.omega * self.p, "um/us")}

    def body(self) -> dict:
        """The load b = ρ ü - Div σ."""
        k, p = self.k, self.p
        stiff = (self.lame + self.G) * (k * p).sum(axis=1)[:, None] * k + self.G * (k * k).sum(axis=1)[:, None] * p
        force = stiff - self.density * self.omega**2 * p
        return {"name": "body", "body": self._sum(force, "Pa/um"), "load_curve": self.load_curve}

    def traction(self, part: str, normal: list[float]) -> dict:
        """The load σ n on a part."""
        k, p, n = self.k, self.p, np.array(normal)
        pull = (self.lame * (k * p).sum(axis=1)[:, None] * n
                + self.G * ((k @ n)[:, None] * p + (p @ n)[:, None] * k))
        return {"name": f"pull-{part}", "parts": [part], "traction": self._sum(pull, "Pa", "cos"),
                "load_curve": self.load_curve}


def manufactured(count: int, modulus: str, pulled: bool, size: float = SIZE, squeezed: float = 1.0, **tables: Any
                 ) -> tuple[Case, Waves]:
    """A block of 2 x 2 µm and its solution with a period of 1 µs; `pulled` : with tractions at right and top."""
    free = {"right": [1.0, 0.0], "top": [0.0, 1.0]} if pulled else {}
    waves = Waves(elastic(2.0, 2.0, 50, modulus).materials["nucleus"], 1.0, size, squeezed)
    loads = [waves.body(), *(waves.traction(part, normal) for part, normal in free.items())]
    moved = waves.support([edge for edge in EDGES if edge not in free])
    return elastic(2.0, 2.0, count, modulus, moved, loads=loads, start=waves.start(), **tables), waves


@reference("manufactured-space", shows="manufactured solution of three plane waves in a block of 2 x 2 µm, L2",
           source="manufactured solution (Roache 2002): force on the body, moved surface or tractions",
           at=(300, 1000, 3000), quick=(150, 300, 700), seconds=20.0,
           expected={f"{how}, {name}": converges(2, SMOOTH, {} if name == "stiff, squeezed" else ELASTIC)
                     for how in ("moved", "pulled") for name in ("soft", "stiff", "stiff, squeezed")})
def manufactured_space(count: int) -> Measured:
    """Errors after 1.3 periods, when sin(Ωt) is not near zero.

    In "stiff" the pressures are as large as the shear stresses.  In "stiff, squeezed" they are 150 times as large, and
    their errors deform the block, which is soft in shear.
    """
    found = {}
    for how in ("moved", "pulled"):
        for name, modulus, squeezed in (("soft", LAWS["soft"], 1.0), ("stiff", LAWS["stiff"], 0.01),
                                        ("stiff, squeezed", LAWS["stiff"], 1.0)):
            case, waves = manufactured(count, modulus, how == "pulled", squeezed=squeezed)
            with built(case) as sim:
                sim.go(1.3)
                found[f"{how}, {name}"] = displacement_error(sim, waves.displacement(sim.scene.X, 1.3))
                spacing = sim.scene.templates[0].spacing
    return Measured(spacing, found, count)


COARSE, STEPS = 100, {"leapfrog": 2, "rk 3bs": 3, "rk 4": 4}


def after(kind: str, ns: float) -> np.ndarray:
    """Displacements (size, 2) [µm] of the block in finite strain after 1.3 periods, by a TS type with steps [ns]."""
    ts_type, _, runge_kutta = kind.partition(" ")
    clock = {"end": "2 us", "step": f"{ns} ns", "integrator": ts_type}
    return displaced(manufactured(COARSE, LAWS["soft"], True, 0.05, time=clock)[0], runge_kutta, 1.3)


@reference("manufactured-time", shows="the same with 100 particles in finite strain; the step is the size",
           source="against -ts_rk_type 5dp at 1 ns", unit="ns", at=(20.0, 10.0, 5.0), seconds=10.0,
           expected={kind: converges(order, "PETSc's manual, TS" if kind != "leapfrog" else
                                     "Störmer-Verlet; supports are exact at the end of each step", floor=1e-11)
                     for kind, order in STEPS.items()})
def manufactured_time(ns: float) -> Measured:
    """Loads and supports change within a step, so that stages of Runge-Kutta methods see different ones."""
    right = after("rk 5dp", 1.0)
    return Measured(ns, {kind: relative_rms(after(kind, ns), right) for kind in STEPS})


# --------------------------------------------------------------------------------------------------------------- beams

# First bending frequencies of a beam of 5 x 1 µm in plane strain, clamped at its left end or free [rad/µs].
BENDING = {"clamped, stiff": 0.169468, "clamped, soft": 0.138941, "free, stiff": 0.959731, "free, soft": 0.805275}
CORNER = {"stiff": 1.19, "soft": 1.48}  # twice λ of sin²(πλ/2) = (4 (1 - ν)² - λ²)/(3 - 4ν) (Williams 1952)


def bending(sim: Simulation, clamped: bool, guess: float) -> tuple[float, np.ndarray]:
    """Lowest nonzero eigenfrequency of the linear operator [rad/µs], near a guess, and its displacements (n, 2)."""
    t = sim.scene.templates[0]
    n, held = len(t.X), sim.mechanics.loads.boundary.held
    left = np.setdiff1d(np.arange(2 * n), held[:, 0] + n * held[:, 1])  # x before y
    K, M = stiffness(t)[left][:, left], sparse.diags(np.tile(t.mass, 2)[left])
    count, shift = (1, 0.0) if clamped else (4, -((0.3 * guess) ** 2))
    values, vectors = eigsh(K, count, M, sigma=shift)
    last, u = int(np.argmax(values)), np.zeros(2 * n)
    u[left] = vectors[:, last]
    return float(np.sqrt(values[last])), u.reshape(2, -1).T


@reference("beam-vibration", shows="first bending frequency of a beam of 5 x 1 µm, clamped at its left end or free",
           source="spectral elements (docstring)", at=(500, 1250, 5000), quick=(250, 500, 1000), seconds=15.0,
           expected={**{f"clamped, {name}": converges(order, "twice the exponent of the corners between clamped and "
                                                      "free sides (Williams 1952)", ELASTIC, floor=1e-5)
                        for name, order in CORNER.items()},
                     **{f"free, {name}": converges(2, "a Rayleigh quotient, and h² of the stabilisation", ELASTIC,
                                                   floor=2e-6) for name in CORNER},
                     "in time": exact(1e-5, "the leapfrog's (ω dt)²/8: the clamped soft mode after a quarter of its "
                                      "period, L2")})
def beam_vibration(count: int) -> Measured:
    """The exact frequencies are those of spectral elements of degree 6 on 10 x 2 rectangles.

    Elements at the clamped end were divided five times at a fifth of their length, towards the end and its corners.
    From degree 5 to 6 and from 3 to 5 divisions, frequencies of the clamped beam change by 7e-6 at most, those of the
    free one by 4e-8.  Euler-Bernoulli theory gives 0.1734, 0.1429, 1.1035 and 0.9096.
    """
    found: dict[str, float] = {}
    for name, right in BENDING.items():
        end, law = name.split(", ")
        clamp = [{"parts": ["left"]}] if end == "clamped" else []
        with built(elastic(5.0, 1.0, count, LAWS[law], *clamp)) as sim:
            omega, u = bending(sim, bool(clamp), right)
            found[name] = abs(omega / right - 1.0)
            if name == "clamped, soft":
                u *= SIZE / np.abs(u).max()
                set_state(sim, None, omega * u)
                sim.go(0.5 * np.pi / omega)
                found["in time"] = displacement_error(sim, u)
            spacing = sim.scene.templates[0].spacing
    return Measured(spacing, found, count)
