"""Fields that diffuse: finite volumes, implicit steps in time, molecules that cells secrete and take up."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from mpi4py import MPI
from petsc4py import PETSc

from ..model.diffusing import Diffusing
from ..parallel.collect import computed_on_root
from ..parallel.options import default_options
from .exchange import Exchanging, Molecules
from .grid import Grid
from .step import NumericsError

DIRECT = {2: 100_000, 3: 20_000}  # volumes up to which a field is solved on one rank, by factors: the bits are the same
REUSE_ITERATIONS = {"cholesky": 4, "lu": 4, "gamg": 12}  # of a Krylov method, above which its PC is made anew
ACCURACY = 1e-3  # largest error of a step, over the largest concentration [-]
SAFETY, SHORTER, LONGER = 0.8, 0.2, 2.0  # of the next step: share of the expected one, limits of its change
SOLVED, PLACED = 1e-10, 1e-13  # what a solve may leave, over the molecules of a step: sum of sizes, sum [-]
BALANCED = 1e-12  # error of the account of molecules, over its entries [-]
ITERATIONS = 50  # of Newton's method
GAMMA = 1.0 - math.sqrt(0.5)  # of SDIRK of second order (Alexander 1977, SIAM J. Numer. Anal. 14:1006-1021)


@dataclass(frozen=True)
class _Stage:
    """Concentrations (n,) [1/µm³] that a stage of a step leads to, and what flows there, over the time `weight` [µs]."""

    c: np.ndarray
    weight: float
    imbalance: np.ndarray
    rates: dict[str, Any]


class DiffusingField:
    """A field on a grid, and the molecules that it exchanges with cells.

    Uptake is the interpolated u c/(c + K) of the new time: each volume gives its share at its own concentration, so
    that none becomes negative.  What a solve leaves over goes into the next step; no molecule is lost.

    Attributes
    ----------
    time : float -- up to which the field is known [µs].
    whole : (volumes,) -- concentrations on rank 0, along x first [1/µm³]; None on others.
    molecules : Molecules -- on rank 0.
    steps, redone, lowered, factored : int -- steps taken, those repeated for accuracy, those of second order that
        would have been negative, matrices factored.
    """

    def __init__(self, name: str, law: Diffusing, exchanging: Exchanging, cells: int, comm: MPI.Intracomm):
        """Begin with the start of the law; collective.

        name : of the field, and prefix of PETSc's options for its solver;  cells : number of cells of the scene.
        """
        self.name, self.law, self.exchanging, self.comm = name, law, exchanging, comm
        count = law.volumes
        self.alone = math.prod(count) <= DIRECT[law.dimension]
        self.here = comm.rank == 0 or not self.alone
        self.time = self.last = self.dt = 0.0
        self.steps = self.redone = self.lowered = self.factored = self._iterations = 0
        self.molecules = Molecules(np.zeros(cells), np.zeros(cells))
        self.whole: np.ndarray | None = None
        if self.here:
            self._world = MPI.COMM_SELF if self.alone else comm
            self.grid = Grid(self._world, law.box, count)
            self._build()

    def _build(self) -> None:
        """Matrix, solver and first values."""
        grid, law = self.grid, self.law
        self._matrix, self._leak, self._inflow = grid.fluxes(law.diffusion, law.flow, law.walls.of(law.dimension))
        self._matrix.shift(law.decay * grid.volume)
        flows = any(law.flow)
        self._matrix.setOption(PETSc.Mat.Option.SPD, not flows)
        self._diagonal = self._matrix.getDiagonal().getArray().copy()
        self._tangent = self._matrix.duplicate(copy=True)
        self._x, self._y = self._matrix.createVecs()
        self._ksp = PETSc.KSP().create(self._world)
        self._ksp.setOptionsPrefix(f"{self.name}_")
        self._ksp.setTolerances(rtol=1e-6, max_it=200)
        defaults = {"ksp_type": "gmres" if flows else "cg",
                    "pc_type": "gamg" if not self.alone else "lu" if flows else "cholesky",
                    # Chebyshev's bounds of eigenvalues do not hold when steps become longer.
                    "mg_levels_ksp_type": "richardson", "mg_levels_pc_type": "sor"}
        self._defaults = {f"{self.name}_{key}": value for key, value in defaults.items()}
        with default_options(self._defaults):
            self._ksp.setFromOptions()
        self._reuse = REUSE_ITERATIONS.get(self._ksp.getPC().getType(), 12)
        self._factored = np.zeros(0)  # what the factored matrix has on its diagonal besides A
        self.c = law.started(grid.centres)
        self._carried, self._rate = np.zeros(len(self.c)), np.zeros(len(self.c))
        self._x_of_surfaces: np.ndarray | None = None
        self._account_start()

    def _account_start(self) -> None:
        if not self.law.steady:
            self.molecules.start = self.molecules.inside = self._sum(self.grid.volume * self.c)
        self.whole = self.grid.gather(self.c)

    # ------------------------------------------------------------ reading

    def value(self, x: np.ndarray, time: float) -> np.ndarray:
        """Concentrations (n,) [1/µm³] at x (n, d) [µm], now; on rank 0.

        Outside the box it is as at the nearest point of it.
        """
        number, weight = self.grid.weights(x)
        return (weight * self.whole[number]).sum(axis=1)

    # ------------------------------------------------------------ time

    def advance(self, until: float, x: np.ndarray) -> None:
        """Go on to a time [µs] at which surface particles are at x (m, d) [µm], on rank 0; collective.

        Between the times of two calls they move evenly.  The first call, at the time 0, says where they start.

        Raises NumericsError where a cell that exchanges has left the box, or molecules are lost.
        """
        if self.alone:
            if self.comm.size > 1:  # the numbers that others need
                self.time = computed_on_root(self.comm, lambda: self._advance(until, x))
            else:
                self._advance(until, x)
        else:
            self._advance(until, self.comm.bcast(x))

    def _advance(self, until: float, x: np.ndarray) -> float:
        interval, before = until - self.time, self._x_of_surfaces if self._x_of_surfaces is not None else x
        if self.law.steady:
            self._find_surfaces(x)
            found = self._stage(self.c, math.inf, interval)
            self.c = found.c
            self._enter(found.rates, interval)
        elif self.law.step != "auto":
            count = math.ceil(interval / self.law.step * (1.0 - 1e-12))
            for k in range(count):
                self._step(interval / count, *(before + j / count * (x - before) for j in (k, k + 1)))
        elif interval > 0.0:
            self._steps_by_error(interval, before, x)
        self._x_of_surfaces, self.time = np.array(x), until
        self.whole = self.grid.gather(self.c)
        lost, turnover = self.molecules.lost, self.molecules.turnover
        if not abs(lost) <= BALANCED * turnover:
            raise NumericsError(f"field {self.name}: {lost:.3g} of {turnover:.6g} molecules are lost")
        return until

    def _steps_by_error(self, interval: float, before: np.ndarray, x: np.ndarray) -> None:
        """Steps of interval/2^k, so that factors serve several of them."""
        # In the first step molecules go as far as the next volume.
        self.dt = self.dt or 0.5 * float(self.grid.size.min()) ** 2 / self.law.diffusion
        least = 1e-6 * self.dt
        level, at = max(0, math.ceil(math.log2(interval / self.dt))), 0
        while at < 1 << level:
            parts = 1 << level
            if not self._step(interval / parts, *(before + j / parts * (x - before) for j in (at, at + 1)), least):
                level, at = level + 1, 2 * at
                continue
            at += 1
            while level and at % 2 == 0 and 2.0 * interval / (1 << level) <= self.dt:
                level, at = level - 1, at // 2

    def _step(self, dt: float, before: np.ndarray, x: np.ndarray, least: float = math.inf) -> bool:
        """Take a step [µs] in which surfaces move from `before` to x, unless it is longer than `least` and too wrong.

        Surfaces are where they are at the time of each stage.
        """
        start = self.c + self._carried / self.grid.volume
        stages = self._of_second_order(start, dt, before, x) if self.law.time_order == 2 else []
        if not stages:
            self._find_surfaces(x)
            stages = [self._stage(start, dt, dt)]
        c = stages[-1].c
        rate = (c - self.c) / dt
        last = self.last or dt
        error = self._largest(dt**2 / (dt + last) * (rate - self._rate)) / max(self._largest(c), 1e-300)
        self.dt = dt * min(max(SAFETY * math.sqrt(ACCURACY / max(error, 1e-300)), SHORTER), LONGER)
        if self.last and error > ACCURACY and dt > least:
            self.redone += 1
            return False
        self._carried = self.grid.volume * (start - c)
        for stage in stages:
            self._carried += stage.weight * stage.imbalance
            self._enter(stage.rates, stage.weight)
        self.c, self._rate, self.last = c, rate, dt
        self.steps += 1
        self._carry_rounding()
        return True

    def _stage(self, base: np.ndarray, tau: float, weight: float) -> _Stage:
        """Solve a stage from `base` over `tau` [µs], of which what flows counts for the time `weight` [µs]."""
        c = self._solved(base, tau)
        return _Stage(c, weight, self._imbalance(c), self._rates(c))

    def _of_second_order(self, start: np.ndarray, dt: float, before: np.ndarray, x: np.ndarray) -> list[_Stage]:
        """Both stages of a step; none if a concentration would be negative."""
        self._find_surfaces(before + GAMMA * (x - before))
        first = self._stage(start, GAMMA * dt, (1.0 - GAMMA) * dt)
        self._find_surfaces(x)
        second = self._stage(start + (1.0 - GAMMA) / GAMMA * (first.c - start), GAMMA * dt, GAMMA * dt)
        if self._largest(np.minimum(self._unclipped, 0.0)) > SOLVED * self._largest(second.c):
            self.lowered += 1
            return []
        return [first, second]

    def _carry_rounding(self) -> None:
        """Let the next step also have what rounding of fluxes has lost: in a steady state it has one sign."""
        self.molecules.inside = self._sum(self.grid.volume * self.c)
        rest = -self.molecules.lost - self._sum(self._carried)
        self._carried += rest / max(self._sum(self.c), 1e-300) * self.c

    # ------------------------------------------------------------ equations

    def _find_surfaces(self, x: np.ndarray) -> None:
        """Secretion, and largest uptake by the concentration K of its half, of all volumes [1/µs]."""
        e, n = self.exchanging, len(self.c)
        middle, self._size = e.at(x) if len(e.cell) else (np.zeros((0, self.law.dimension)), np.zeros(0))
        if (astray := np.flatnonzero(self.grid.outside(middle))).size:
            raise NumericsError(f"field {self.name}: cell {int(e.cell[astray[0]]) + 1} has left its box at "
                                f"{np.array2string(middle[astray[0]], precision=3)} µm: make the box larger")
        self._volume, self._weight = self.grid.local(*self.grid.weights(middle))

        def spread(rate: np.ndarray) -> np.ndarray:
            return np.bincount(self._volume.ravel(), (rate[:, None] * self._weight).ravel(), n)

        self._source = spread(self._size * e.secretion)
        self._uptake = [(half, spread(self._size * e.uptake * (e.half == half)))
                        for half in np.unique(e.half[e.uptake > 0.0])]

    def _taken(self, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Uptake of each volume [1/µs], and its slope [µm³/µs]."""
        rate, slope = np.zeros(len(c)), np.zeros(len(c))
        for half, most in self._uptake:
            rate += most * c / (c + half)
            slope += most * half / (c + half) ** 2
        return rate, slope

    def _imbalance(self, c: np.ndarray) -> np.ndarray:
        """What all sources and fluxes add to each volume [1/µs]."""
        self._x.setArray(c)
        self._matrix.mult(self._x, self._y)
        return self._source + self._inflow - self._y.getArray(readonly=True) - self._taken(c)[0]

    def _solved(self, base: np.ndarray, tau: float) -> np.ndarray:
        """Concentrations c >= 0 with V (c - base)/tau = imbalance(c), by Newton's method.

        The equations are those of an M-matrix and of uptake that grows ever more slowly: from the second iteration on,
        Newton's method comes from below and overshoots nothing (Ortega & Rheinboldt 1970, theorem 13.3.4), also where
        negative values are replaced by zero.
        """
        V, c, best = self.grid.volume, self.c, math.inf
        scale = self._sum(V / tau * np.abs(base) + self._source + self._inflow)
        self._unclipped = c
        for _ in range(ITERATIONS):
            left = V / tau * (base - c) + self._imbalance(c)
            size = self._sum(np.abs(left))
            solved = size <= SOLVED * scale
            if size == 0.0 or (solved and (abs(self._sum(left)) <= PLACED * scale or size > 0.5 * best)):
                return c
            best = size
            self._unclipped = c + self._newton(left, V / tau + self._taken(c)[1])
            c = np.maximum(self._unclipped, 0.0)
        raise NumericsError(f"field {self.name}: Newton's method leaves {size:.3g} of {scale:.3g} molecules/µs")

    def _newton(self, left: np.ndarray, more: np.ndarray) -> np.ndarray:
        """Solution of (A + more) d = left; factors are those of an earlier matrix as long as few iterations do."""
        old = self._factored if len(self._factored) and self._iterations <= self._reuse else more
        reason = self._solve_with(old, left, more)
        if reason <= 0 and old is not more:
            self._solve_with(more, left, more)
        return self._x.getArray(readonly=True).copy()

    def _solve_with(self, factored: np.ndarray, left: np.ndarray, more: np.ndarray) -> int:
        """Solve (A + more) d = left with the factors of A + `factored`, by which d is in self._x; PETSc's reason."""
        if factored is not self._factored:
            self._set_tangent(factored)
            self._ksp.getPC().setReusePreconditioner(False)
            with default_options(self._defaults):  # those of the levels of GAMG are read now
                self._ksp.setUp()
            self._factored, self.factored = factored, self.factored + 1
        self._set_tangent(more)
        self._ksp.getPC().setReusePreconditioner(True)
        self._y.setArray(left)
        self._ksp.solve(self._y, self._x)
        self._iterations = self._ksp.getIterationNumber()
        return self._ksp.getConvergedReason()

    def _set_tangent(self, more: np.ndarray) -> None:
        """Set the matrix of the solver to A + more."""
        self._matrix.copy(self._tangent, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self._y.setArray(self._diagonal + more)
        self._tangent.setDiagonal(self._y)
        self._tangent.setOption(PETSc.Mat.Option.SPD, not any(self.law.flow))
        self._ksp.setOperators(self._tangent)

    # ------------------------------------------------------------ molecules

    def _rates(self, c: np.ndarray) -> dict[str, Any]:
        """What cells secrete and take up (cells,), what leaves through walls, and decays [1/µs]."""
        e, cells = self.exchanging, len(self.molecules.taken)
        share = (self._weight * (c[self._volume] / (c[self._volume] + e.half[:, None]))).sum(axis=1)
        by_cell = np.bincount(e.cell, self._size * e.uptake * share, cells)
        return {"secreted": np.bincount(e.cell, self._size * e.secretion, cells), "taken": self._sums(by_cell),
                "out": self._sum(self._leak * c - self._inflow),
                "decayed": self._sum(self.law.decay * self.grid.volume * c)}

    def _enter(self, rates: dict[str, Any], duration: float) -> None:
        """Add rates over a duration [µs] to the account."""
        for name, rate in rates.items():
            setattr(self.molecules, name, getattr(self.molecules, name) + duration * rate)

    def _sums(self, values: np.ndarray) -> np.ndarray:
        """Elementwise sum over the ranks."""
        return values if self.alone else self._world.allreduce(values)

    def _sum(self, values: np.ndarray) -> float:
        """Sum over the volumes of all ranks."""
        return float(self._sums(values.sum()))

    def _largest(self, values: np.ndarray) -> float:
        """Largest magnitude on all ranks."""
        found = float(np.abs(values).max())
        return found if self.alone else self._world.allreduce(found, MPI.MAX)

    # ------------------------------------------------------------ checkpoints

    def saved(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """State as JSON, and arrays on rank 0, by number of volume; collective."""
        m = self.molecules
        about = {"time": self.time, "last": self.last, "dt": self.dt, "steps": self.steps, "redone": self.redone,
                 "lowered": self.lowered, "iterations": self._iterations,
                 "out": m.out, "decayed": m.decayed, "start": m.start, "inside": m.inside}
        arrays = {}
        if self.here:
            arrays = {name: self.grid.gather(values) for name, values in self._of_volumes().items()}
        if self.comm.rank == 0:
            arrays |= {"secreted": m.secreted, "taken": m.taken}
            if self._x_of_surfaces is not None:
                arrays["surfaces"] = self._x_of_surfaces
        return self.comm.bcast(about), arrays if self.comm.rank == 0 else {}

    def _of_volumes(self) -> dict[str, np.ndarray]:
        return {"c": self.c, "carried": self._carried, "rate": self._rate,
                "factored": self._factored if len(self._factored) else np.zeros(len(self.c))}

    def restore(self, about: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
        """Set the state that `saved` returned, on any number of ranks; collective."""
        for name in ("time", "last", "dt", "steps", "redone", "lowered"):
            setattr(self, name, about[name])
        for name in ("out", "decayed", "start", "inside"):
            setattr(self.molecules, name, about[name])
        if self.here:
            values = [self.grid.scatter(arrays.get(name)) for name in self._of_volumes()]
            self.c, self._carried, self._rate, factored = values
            if about["iterations"]:
                self._solve_with(factored, np.zeros(len(self.c)), factored)
                self._iterations = about["iterations"]
            rest = {name: arrays.get(name) for name in ("secreted", "taken", "surfaces")}
            rest = rest if self.alone else self.comm.bcast(rest)
            self.molecules.secreted, self.molecules.taken = rest["secreted"].copy(), rest["taken"].copy()
            self._x_of_surfaces = rest["surfaces"]
            self.whole = self.grid.gather(self.c)

    def close(self) -> None:
        """Free the PETSc objects; collective."""
        if self.here:
            for thing in (self._ksp, self._matrix, self._tangent, self._x, self._y):
                thing.destroy()
            self.grid.close()
