"""What varies along the substrate: ligands as the kernel has them, cells on ligands, the way of a cell on a gel."""

from __future__ import annotations

import math

import numpy as np

from cellmig.case.expression import Expression
from cellmig.case.load import change
from cellmig.case.registry import laws
from cellmig.model.ligand import SPACING, LigandTable
from cellmig.verify.reference import Measured, converges, exact, reference

from .scenes import built, by_id, case, displacement, set_motion

HALF, MIDDLE, SLOPE = 1e4, 1e4, 200.0  # of the response [Pa]; of the gel at the cell [Pa], and its gradient [Pa/µm]
QUARTER, SLOW = 9e8, 1e-12  # of an hour [µs]; a speed far below that at which bonds yield [µm/µs]
HALF_HELD = 0.3  # share of the ligands n_½ on which the push is half of its stall
LIGANDS = {"all_protrude": "0.5 + 0.4*sin(0.9*x)", "three_balls": "0.5 + 0.3*sin(0.9*x)*cos(0.7*y)"}


@reference("ligand-step", shows="ligands that rise as tanh(x/w); half a micrometre over w is the size",
           source="the field itself; cubic B-splines smooth it by h² λ''/6, by 0.064 (h/w)² at most", unit="",
           at=(0.1, 0.05, 0.025),
           expected={"share": converges(2, "uniform B-splines of samples: linear fields are exact"),
                     "slope": exact(1e-9, "the derivative of a sum of polynomials")})
def ligand_step(size: float) -> Measured:
    """The largest error of λ; and of its slope against differences of λ, over the largest slope."""
    width, x = SPACING / size, np.linspace(-39.0, 39.0, 4001)
    field = laws("field")["formula"](formula=Expression(f"0.5 + 0.5*tanh(x/{width})", "", 3, True))
    table = LigandTable.of(field, np.array([-41.0]), np.array([41.0]))
    share, slopes = table.at(x)
    h = 1e-3
    around = [table.at(x + k * h)[0] for k in (-2, -1, 1, 2)]
    difference = (8.0 * (around[2] - around[1]) - around[3] + around[0]) / (12.0 * h)
    return Measured(size, {"share": float(np.abs(share - 0.5 - 0.5 * np.tanh(x / width)).max()),
                           "slope": float(np.abs(slopes[0] - difference).max() / np.abs(difference).max())})


@reference("ligand-force", shows="three cells on ligands that change within a cell: forces along the substrate against "
           "differences of the energy", source="f = -∂E/∂x, by differences of five points", unit="particles",
           at=(80, 150, 300), expected={"force": exact(1e-7, "differences of the energy of all bonds"),
                                        "force of balls": exact(1e-7, "the same")})
def ligand_force(count: int) -> Measured:
    """The largest error at eight particles, over the largest force along the substrate."""
    return Measured(count, {"force": _of_energy("all_protrude", count),
                            "force of balls": _of_energy("three_balls", count)})


def _of_energy(scene: str, count: int) -> float:
    """The largest error of the force at eight particles of a scene, over the largest force [-]."""
    with built(case(scene, count, f'substrate.ligand="{LIGANDS[scene]}"')) as sim:
        m, X = sim.mechanics, sim.scene.X
        u = 0.004 * np.random.default_rng(1).standard_normal(X.shape)
        set_motion(sim, u)
        force = m.surface_force("substrate")[0][:, 0].copy()
        largest, h, worst = np.abs(force).max(), 1e-3, 0.0
        for particle in np.random.default_rng(3).permutation(np.flatnonzero(np.abs(force) > 1e-2 * largest))[:8]:
            energy = []
            for k in (-2, -1, 1, 2):
                m.state.owned[:, : X.shape[1]] = u[m.ids]
                m.state.owned[particle, 0] += k * h
                energy.append(m.surface_force("substrate")[1].sum())
            slope = (8.0 * (energy[2] - energy[1]) - energy[3] + energy[0]) / (12.0 * h)
            worst = max(worst, abs(force[particle] + slope) / largest)
    return float(worst)


@reference("ligand-optimum", shows="speed of a crawling cell on a density n of ligands, in a viscous medium; size: "
           "one over the root of the particles", unit="", at=(60, 120, 240), seconds=20.0,
           source="F_s n/(n + n_½)/(ζ + c L n), largest at √(n_½ ζ/(c L)); DiMilla, Barbee & Lauffenburger 1991",
           expected={"speed": exact(0.01, "forces are in balance; the shape of the cell depends a little on the bonds"),
                     "optimum": exact(0.02, "the same: the speed is even in log n about it")})
def ligand_optimum(count: int) -> Measured:
    """ζ, c L and the push are those of one density; speeds are at the optimum that follows, at half and twice it."""
    _, push, zeta, sliding = crawled(count, HALF_HELD)
    best = math.sqrt(HALF_HELD * zeta / sliding)
    at = [0.5 * best, best, 2.0 * best]
    low, top, high = speeds = [crawled(count, n)[0] for n in at]
    error = max(abs(v * (n + HALF_HELD) * (zeta + sliding * n) / (2.0 * push * n) - 1.0)  # F_s is twice the push of n_½
                for n, v in zip(at, speeds, strict=True))
    shift = 0.5 * math.log(2.0) * (low - high) / (low - 2.0 * top + high)  # of the parabola's vertex, in ln n
    return Measured(1.0 / math.sqrt(count), {"speed": error, "optimum": abs(shift)}, count)


def crawled(count: int, ligand: float) -> tuple[float, float, float, float]:
    """Speed in half a minute [µm/µs] on a density of ligands; push [pN/µm], drags of the medium ζ and of friction over
    the density c L [Pa µs] at its end.
    """
    given = case("crawl", count, f"substrate.ligand={ligand}", 'medium.viscosity="300 Pa s"',
                 'friction={law="bonds", coefficient="500 Pa s/um"}')
    stall = HALF_HELD * given.protrusion.push(given.substrate.work)
    with built(change(given, {"protrusion.stall": f"{stall} pN/um"})) as sim:
        sim.go(3e7)
        begun = displacement(sim)[:, 0].mean()
        sim.go(6e7)
        sim.sample()
        speed = float(displacement(sim)[:, 0].mean() - begun) / 3e7
        push, medium, friction = (float(by_id(sim, sim.mechanics.surface_force(name)[0])[:, 0].sum())
                                  for name in ("protrusion", "medium", "friction"))
    return speed, push, -medium / speed, -friction / speed / ligand


@reference("durotaxis", shows="a spread cell that pushes on both sides, on 10 kPa + 200 Pa/µm x, for a quarter of an "
           "hour",
           source="[g(E(x + a)) - g(E(x - a))] F/(c L): push F of one side, at its mean place a, friction c and bonded "
           "length L of the cell on 10 kPa", unit="particles", at=(100, 200, 300),
           expected={"way": exact(0.03, "the response is not linear in E over the base: measured 1.3 %")})
def durotaxis(count: int) -> Measured:
    """E/(E + H) with H = 10 kPa; the way is 0.71 µm."""
    sets = ("substrate.response={half=\"10 kPa\"}", "protrusion.basal=1",
            "polarity={spread=0, persistence=\"10 min\"}")
    with built(case("crawl", count, 'substrate.stiffness="10 kPa"', *sets)) as sim:
        sim.go(QUARTER)
        m = sim.mechanics
        force, x = m.surface_force("protrusion")[0][:, 0], m.state.x(np.arange(m.n_owned))[:, 0]
        on = force > 0.0
        push, ahead = force[on].sum(), np.average(x[on], weights=force[on]) - x.mean()
        m.state.owned[:, 2:] = [SLOW, 0.0]
        drag = -m.surface_force("friction")[0][:, 0].sum() / SLOW
    low, high, here = (E / (E + HALF) for E in (MIDDLE - SLOPE * ahead, MIDDLE + SLOPE * ahead, MIDDLE))
    with built(case("crawl", count, f'substrate.stiffness="{MIDDLE} + {SLOPE}*x Pa"', *sets)) as sim:
        sim.go(QUARTER)
        before = sim.sample()[0][0]["x_um"]
        sim.go(2.0 * QUARTER)
        way = sim.sample()[0][0]["x_um"] - before
    return Measured(count, {"way": abs(way / (QUARTER * push / here * (high - low) / drag) - 1.0)})
