"""Fields that diffuse: discs and balls that spread, sources at rest and in motion, a channel, sinks, molecules."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull
from scipy.special import erf, i0, k0

from mpi4py import MPI

from cellmig.model.diffusing import Diffusing, Walls
from cellmig.solve.diffusing import DiffusingField
from cellmig.solve.exchange import Exchanging
from cellmig.verify.reference import Measured, converges, exact, reference

S = 1e-6  # a rate of 1/s in 1/µs
D = 100.0 * S  # µm²/µs
SOLVER = "to the solver's tolerance and rounding"
VOLUMES = "finite volumes, linear between centres"


def field(exchanging: Exchanging | None = None, cells: int = 1, **law: Any) -> DiffusingField:
    """A field by the parameters of its law in the code's units; what is not given is closed, at rest, and empty."""
    walls = Walls(**law.pop("walls", {}))
    law = {"decay": 0.0, "start": 0.0, "flow": (0.0,) * len(law["box"][0])} | law
    nothing = Exchanging(np.zeros((0, len(law["box"][0])), int), np.zeros(0, int), *[np.zeros(0)] * 3)
    return DiffusingField("c", Diffusing(walls=walls, **law), exchanging or nothing, cells, MPI.COMM_SELF)


def surface(facets: np.ndarray, secretion: float = 0.0, uptake: float = 0.0, half: float = 1.0) -> Exchanging:
    """Facets of one cell with equal rates."""
    return Exchanging(facets, np.zeros(len(facets), int), *(np.full(len(facets), r) for r in (secretion, uptake, half)))


def circle(radius: float, count: int, whole: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Corners (m, 2) [µm] and edges (count, 2) of a circle about the origin, or of its quarter in x, y > 0."""
    angle = np.linspace(0.0, 2.0 * np.pi if whole else 0.5 * np.pi, count + 1)
    edges = np.column_stack([np.arange(count), np.arange(1, count + 1)])
    return radius * np.column_stack([np.cos(angle), np.sin(angle)]), edges


def ball(radius: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Corners (count, 3) [µm] and triangles of a sphere about the origin."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    x = np.column_stack([np.sqrt(1.0 - z * z) * np.cos(turn), np.sqrt(1.0 - z * z) * np.sin(turn), z])
    return radius * x, ConvexHull(x).simplices


def share_inside(radius: float, spacing: float) -> Callable[[np.ndarray], np.ndarray]:
    """The part of each volume that is within a radius of the origin, by 16 points along each axis."""
    at = (np.arange(16) + 0.5) / 16 - 0.5

    def part(x: np.ndarray) -> np.ndarray:
        inside = np.zeros(len(x))
        for offset in np.stack(np.meshgrid(*[at] * x.shape[1]), axis=-1).reshape(-1, x.shape[1]):
            inside += ((x + spacing * offset) ** 2).sum(axis=1) < radius**2
        return inside / len(at) ** x.shape[1]

    return part


def nowhere(d: int) -> np.ndarray:
    """Positions of no surface particles."""
    return np.zeros((0, d))


# ------------------------------------------------------------------------------------------------------ spreading


@reference("spreading-disc", shows="concentration in the middle of a disc of c0 that spreads in the plane",
           source="c0 (1 - exp(-a²/4Dt)), by Green's function of diffusion", at=(2.0, 1.0, 0.5),
           expected={"centre": converges(2, VOLUMES)})
def spreading_disc(spacing: float) -> Measured:
    """A disc of 10 µm, at 4 D t = a²/2; a quarter of it between closed walls; 20 steps of second order and more."""
    a, end = 10.0, 0.5 * 100.0 / (4.0 * D)
    run = field(diffusion=D, box=((0.0, 0.0), (40.0, 40.0)), spacing=spacing, start=share_inside(a, spacing),
                step=end / 20.0 * spacing / 2.0, time_order=2)
    run.advance(end, nowhere(2))
    return Measured(spacing, {"centre": abs(float(run.value(np.zeros((1, 2)), end)[0]) / (1.0 - np.exp(-2.0)) - 1.0)})


@reference("spreading-ball", shows="the same of a ball in space; the finest grid by multigrid", seconds=15.0,
           source="c0 (erf(a/s) - 2a/(s √π) exp(-a²/s²)), s² = 4Dt", at=(2.0, 1.0, 2.0 / 3.0),
           expected={"centre": converges(2, VOLUMES)})
def spreading_ball(spacing: float) -> Measured:
    """A ball of 8 µm, at 4 D t = a²/2."""
    a, s = 8.0, 8.0 / np.sqrt(2.0)
    end = s * s / (4.0 * D)
    run = field(diffusion=D, box=((0.0,) * 3, (24.0,) * 3), spacing=spacing, start=share_inside(a, spacing),
                step=end / 10.0 * spacing / 2.0, time_order=2)
    run.advance(end, nowhere(3))
    right = erf(a / s) - 2.0 * a / (s * np.sqrt(np.pi)) * np.exp(-((a / s) ** 2))
    return Measured(spacing, {"centre": abs(float(run.value(np.zeros((1, 3)), end)[0]) / right - 1.0)})


# -------------------------------------------------------------------------------------------------------- sources


@reference("secreting-disc", shows="steady field of a disc that secretes Q from its edge, with decay",
           source="Q/(2πD) I0(a/λ) K0(r/λ) outside, a and r exchanged inside, λ² = D/k: Green's function of each point",
           at=(2.0, 1.0, 0.5), seconds=3.0,
           expected={"outside": converges(2, VOLUMES), "middle": converges(2, VOLUMES),
                     "on the edge": converges(1, "the field has a kink there, which is spread over a volume")})
def secreting_disc(spacing: float) -> Measured:
    """A disc of 10 µm, λ = 10 µm; the field is there inside, too.  Errors over the value itself, root mean square."""
    a, k, Q = 10.0, 1.0 * S, 100.0 * S
    scale = np.sqrt(D / k)
    x, edges = circle(a, round(100 / spacing), whole=False)
    length = np.linalg.norm(x[1] - x[0])
    run = field(surface(edges, Q / (4.0 * len(edges) * length)), diffusion=D, decay=k, quasi_steady=True,
                box=((0.0, 0.0), (120.0, 120.0)), spacing=spacing)
    run.advance(0.0, x)
    angle = np.linspace(0.0, 0.5 * np.pi, 16)
    found = {}
    for name, radii in (("outside", (15.0, 20.0, 25.0)), ("middle", (0.0,)), ("on the edge", (a,))):
        r = np.maximum(np.repeat(radii, len(angle)), 1e-9)
        right = Q / (2.0 * np.pi * D) * i0(np.minimum(r, a) / scale) * k0(np.maximum(r, a) / scale)
        way = np.tile(np.column_stack([np.cos(angle), np.sin(angle)]), (len(radii), 1))
        found[name] = float(np.sqrt(np.mean((run.value(r[:, None] * way, 0.0) / right - 1.0) ** 2)))
    return Measured(spacing, found)


@reference("moving-source", shows="field of a disc that secretes and moves, and of one at rest in a flow",
           source="Q/(2πD) exp(-v x/2D) K0(r √(v²/4D² + k/D)) of each point, by Green's function",
           at=(2.0, 1.0, 0.5), seconds=40.0,
           expected={"moving": converges(2, "volumes, and steps of second order in proportion"),
                     "in a flow": converges(2, "exponential fitting, at Péclet numbers of a volume below 1")})
def moving_source(spacing: float) -> Measured:
    """A disc of 2 µm at 10 µm/s, D = 100 µm²/s, k = 4/s, after 3 s; errors over the largest value."""
    v, k, Q, end = 10.0 * S, 4.0 * S, 100.0 * S, 3.0 / S
    x, edges = circle(2.0, 48)
    source = surface(edges, Q / (48 * np.linalg.norm(x[1] - x[0])))
    law = {"diffusion": D, "decay": k, "spacing": spacing}
    points = 4.0 * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.6, -0.8], [-2.0, 0.1], [2.0, 1.0]])
    away = points[:, None] - source.at(x)[0]
    r, fall = np.linalg.norm(away, axis=2), np.sqrt(0.25 * (v / D) ** 2 + k / D)
    kernel = np.exp(-v * away[..., 0] / (2.0 * D)) * k0(r * fall)
    right = Q / (2.0 * np.pi * D) * kernel.mean(axis=1)
    moving = field(source, box=((-50.0, -40.0), (70.0, 40.0)), step=0.02 / S * spacing, time_order=2, **law)
    moving.advance(0.0, x)
    way = np.array([v * end, 0.0])
    moving.advance(end, x + way)
    resting = field(source, box=((-50.0, -40.0), (30.0, 40.0)), flow=(-v, 0.0), walls={"left": "open"},
                    quasi_steady=True, **law)
    resting.advance(0.0, x)
    found = {"moving": moving.value(points + way, end), "in a flow": resting.value(points, 0.0)}
    return Measured(spacing, {name: float(np.abs(c - right).max() / right.max()) for name, c in found.items()})


# -------------------------------------------------------------------------------------------------------- channel


@reference("channel", shows="a channel of 1 mm between 10 nM and none: steady, and its slowest mode after L²/(π²D)",
           source="linear; sin(πx/L) exp(-π² D t/L²) (Crank 1975, chapter 4)", at=(50.0, 25.0, 12.5),
           expected={"steady": exact(1e-11, SOLVER), "mode": converges(2, VOLUMES)})
def channel(spacing: float) -> Measured:
    """D = 100 µm²/s; the mode decays within 1,013 s."""
    L, box = 1000.0, ((0.0, 0.0), (1000.0, 100.0))
    steady = field(diffusion=D, box=box, spacing=spacing, walls={"left": 6.0, "right": 0.0}, quasi_steady=True)
    steady.advance(0.0, nowhere(2))
    x = np.column_stack([np.linspace(25.0, 975.0, 30), np.linspace(1.0, 99.0, 30)])
    error = np.abs(steady.value(x, 0.0) / (6.0 * (1.0 - x[:, 0] / L)) - 1.0).max()
    end = L * L / (np.pi**2 * D)
    return Measured(spacing, {"steady": float(error), "mode": abs(_mode(spacing, end / 400.0, 2) * np.e - 1.0)})


def _mode(spacing: float, step: float, order: int) -> float:
    """What is left of the slowest mode of the channel after its time of decay."""
    L = 1000.0
    run = field(diffusion=D, box=((0.0, 0.0), (L, 100.0)), spacing=spacing, walls={"left": 0.0, "right": 0.0},
                step=step, time_order=order, start=lambda x: np.sin(np.pi * x[:, 0] / L))
    run.advance(L * L / (np.pi**2 * D), nowhere(2))
    middle = float(run.value(np.array([[0.5 * L, 50.0]]), 0.0)[0])
    return middle / np.cos(0.5 * np.pi * spacing / L)  # between two centres beside the middle


@reference("channel-in-time", shows="the slowest mode of the channel by both orders of time; the step is the size",
           source="exp(-t D (2/h)² sin²(πh/2L)) of the same volumes", unit="s", at=(100.0, 50.0, 25.0),
           expected={"order 1": converges(1, "backward Euler"), "order 2": converges(2, "SDIRK of Alexander (1977)")})
def channel_in_time(step: float) -> Measured:
    """Volumes of 50 µm."""
    L, h = 1000.0, 50.0
    right = np.exp(-L * L / np.pi**2 * (2.0 / h) ** 2 * np.sin(0.5 * np.pi * h / L) ** 2)
    return Measured(step, {f"order {n}": abs(_mode(h, step / S, n) / right - 1.0) for n in (1, 2)})


# ---------------------------------------------------------------------------------------------------------- sinks


@reference("sink-in-a-box", shows="concentration in a cell that takes up, in a box of 60 µm with 10 µM at its walls, "
                                  "D = 2000 µm²/min: the sink of the PerMedCoE benchmark (Chaste issue 166)",
           source="c = c0 - a² u c/((c + K) D) (1/a - M/L), by image charges: M = 1.747565 is Madelung's constant",
           at=(12, 20, 36), seconds=10.0,
           expected={"middle": converges(1, "the field has a kink at the surface; (a/L)⁴ = 5e-5 is left out")})
def sink_in_a_box(count: int) -> Measured:
    """A ball of 5 µm that takes up what halves the concentration; mean of `count` volumes along an edge and one more.

    The benchmark leaves open whether the uptake is a constant or in proportion to the concentration, the size of the
    sink, and the start; here uptake is that of Michaelis and Menten on the surface, and the field is steady.
    """
    a, L, c0, half, slow = 5.0, 60.0, 6022.0, 600.0, 2000.0 / 60.0 * S
    reach, right = a * a / slow * (1.0 / a - 1.747565 / L), 0.5 * c0
    most = (c0 - right) / reach * (right + half) / right
    x, triangles = ball(a, 3000)
    area = surface(triangles).at(x)[1].sum()
    errors = []
    for n in (count, count + 1):
        run = field(surface(triangles, uptake=most * 4.0 * np.pi * a * a / area, half=half), diffusion=slow,
                    box=((-0.5 * L,) * 3, (0.5 * L,) * 3), spacing=L / n, start=c0, quasi_steady=True,
                    walls=dict.fromkeys(("left", "right", "front", "back", "bottom", "top"), c0))
        run.advance(0.0, x)
        errors.append(abs(float(run.value(np.zeros((1, 3)), 0.0)[0]) / right - 1.0))
    return Measured(L / (count + 0.5), {"middle": float(np.mean(errors))})


@reference("molecules", shows="the account of molecules with all there is: flow, decay, walls, a cell that moves and "
           "secretes, one that takes up, both in steps by error; concentrations that are negative",
           source="no molecule appears or vanishes", at=(8.0, 4.0, 2.0), seconds=10.0,
           expected={f"{what} in {where}": exact(bound, SOLVER) for where in ("the plane", "space")
                     for what, bound in (("lost", 1e-12), ("negative", 1e-300))})
def molecules(spacing: float) -> Measured:
    """Ten intervals of 10 s; lost over the sum of all entries, least value over the largest."""
    found = {}
    for where, d, (corners, facets) in (("the plane", 2, circle(5.0, 60)), ("space", 3, ball(5.0, 200))):
        n, m = len(facets), len(corners)
        both = Exchanging(np.concatenate([facets, facets + m]), np.repeat([0, 1], n), np.repeat([50.0 * S, 0.0], n),
                          np.repeat([0.0, 80.0 * S], n), np.repeat([1.0, 6.0], n))
        flow = (5.0 * S,) + (0.0,) * (d - 1)
        run = field(both, 2, diffusion=D, decay=0.01 * S, flow=flow, spacing=spacing, start=0.3,
                    box=((-24.0,) * d, (24.0,) * d), walls={"left": 0.6, "right": "open", "top": 0.0})
        least = 0.0
        for k in range(11):
            shift = np.zeros(d)
            shift[0] = 0.6 * k
            run.advance(k * 10.0 / S, np.concatenate([corners - 12.0 + shift, corners + 12.0 - shift]))
            least = min(least, float(run.whole.min() / run.whole.max()))
        account = run.molecules
        found |= {f"lost in {where}": abs(account.lost) / account.turnover, f"negative in {where}": abs(least)}
        run.close()
    return Measured(spacing, found)
