"""What moves molecules between volumes, cells and walls, and the implicit equations of a step."""

from __future__ import annotations

from typing import Any

import numpy as np

from mpi4py import MPI
from petsc4py import PETSc

from ..model.diffusing import Diffusing
from ..parallel.options import default_options
from .exchange import Exchanging
from .grid import Grid
from .step import NumericsError
from .waves import Waves

REUSE_ITERATIONS = {"cholesky": 4, "lu": 4, "gamg": 12}  # of a Krylov method, above which its PC is made anew
SOLVED, PLACED = 1e-10, 1e-13  # what a solve may leave, over the molecules of a step: sum of sizes, sum [-]
EPSILON = float(np.finfo(float).eps)  # [-]
ITERATIONS = 50  # of Newton's method


class Transport:
    """V dc/dt = f(c) for the concentrations of the volumes of a grid, with the surfaces of cells where they are.

    Uptake is the interpolated u c/(c + K): each volume gives its share at its own concentration, so that none becomes
    negative.

    Attributes
    ----------
    grid : Grid -- of the volumes.
    exchanging : Exchanging -- facets that exchange with the field.
    factored : int -- number of matrices that were factored.
    iterations : int -- of the last Krylov solve.
    """

    def __init__(self, name: str, law: Diffusing, exchanging: Exchanging, cells: int, comm: MPI.Intracomm,
                 direct: bool):
        """Make matrix and solver; collective.

        name : of the field, and prefix of PETSc's options for its solver;  cells : number of cells of the scene;
        direct : solve on one rank, by standing waves or, in a flow, by factors, in place of multigrid.
        """
        self._name, self._law, self.exchanging, self._cells, self._world = name, law, exchanging, cells, comm
        self.grid = Grid(comm, law.box, law.volumes)
        self._matrix, self._leak, self._inflow, rows = self.grid.fluxes(law.diffusion, law.flow, law.sides)
        self._matrix.shift(law.decay * self.grid.volume)
        self._rows = rows + law.decay * self.grid.volume  # sums of the rows of A
        self._closed = not (self._leak.any() or self._inflow.any()) and comm.size == 1
        self._diagonal = self._matrix.getDiagonal().getArray().copy()
        self._tangent = self._matrix.duplicate(copy=True)
        self._x, self._y = self._matrix.createVecs()
        self._ksp = PETSc.KSP().create(comm)
        self._ksp.setOptionsPrefix(f"{name}_")
        self._ksp.setTolerances(rtol=1e-6, max_it=200)
        defaults = {"ksp_type": "gmres" if any(law.flow) else "cg",
                    "pc_type": "gamg" if not direct else "lu" if any(law.flow) else "python",
                    # Chebyshev's bounds of eigenvalues do not hold when steps become longer.
                    "mg_levels_ksp_type": "richardson", "mg_levels_pc_type": "sor"}
        self._defaults = {f"{name}_{key}": value for key, value in defaults.items()}
        with default_options(self._defaults):
            self._ksp.setFromOptions()
        self._reuse = REUSE_ITERATIONS.get(self._ksp.getPC().getType(), 12)
        self._waves, self._mean = None, 0.0  # mean of what is on the diagonal besides A, by which they solve
        if self._ksp.getPC().getType() == "python":
            given = [(not isinstance(low, str), not isinstance(high, str)) for low, high in law.sides]
            self._waves = Waves(law.volumes, law.diffusion * self.grid.volume / self.grid.size**2, given)
            self._ksp.getPC().setPythonContext(self)
        self._size = self._source = np.zeros(0)
        self._factored = np.zeros(0)  # what the factored matrix has on its diagonal besides A
        self.factored = self.iterations = 0

    # ------------------------------------------------------------ equations

    def find_surfaces(self, x: np.ndarray) -> None:
        """Let cells exchange where surface particles are at x (m, d) [µm].

        Raises NumericsError where one of them has left the box; the message is for the user.
        """
        e, n = self.exchanging, len(self.grid.own)
        middle, self._size = e.at(x)
        if (astray := np.flatnonzero(self.grid.outside(middle))).size:
            place = ", ".join(f"{axis} = {value:.4g}" for axis, value in zip("xyz", middle[astray[0]], strict=False))
            raise NumericsError(f"cell {int(e.cell[astray[0]]) + 1}, which exchanges with the field {self._name}, has "
                                f"left its box at {place} µm; make fields.{self._name}.box larger")
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

    def imbalance(self, c: np.ndarray) -> np.ndarray:
        """What sources and fluxes add to each volume of this rank (n,) [1/µs] at c (n,) [1/µm³]; collective.

        Fluxes are those of c less its mean, as rounding of a high and even concentration would hide small sources.
        """
        mean = self.total(c) / self.grid.total
        self._x.setArray(c - mean)
        self._matrix.mult(self._x, self._y)
        at_mean = self._source + (self._inflow - mean * self._rows)
        return at_mean - self._y.getArray(readonly=True) - self._taken(c)[0]

    def _through_walls(self, c: np.ndarray) -> np.ndarray:
        """What leaves each volume through walls, less what comes in [1/µs], as in `imbalance`."""
        if self._closed:
            return np.zeros(len(c))
        mean = self.total(c) / self.grid.total
        return self._leak * (c - mean) - (self._inflow - mean * self._leak)

    def solved(self, base: np.ndarray, tau: float, first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Concentrations c >= 0 with V (c - base)/tau = imbalance(c), by Newton's method; collective.

        The equations are those of an M-matrix and of an uptake that is concave: from the second iteration on, Newton's
        method comes from below and overshoots nothing, also where negative values are replaced by zero.

        Parameters
        ----------
        base, first : (n,) -- concentrations before, and first guess [1/µm³].
        tau : float -- time [µs], infinite for an equilibrium.

        Returns
        -------
        (n,) -- c [1/µm³];  (n,) -- imbalance(c) [1/µs].

        Raises NumericsError where it does not converge.

        Source: the monotone Newton theorem of Ortega & Rheinboldt (1970), Iterative Solution of Nonlinear Equations in
        Several Variables, chapter 13.
        """
        V, c, best = self.grid.volume, first, np.inf
        before = self.total(V / tau * np.abs(base) + self._source)
        for _ in range(ITERATIONS):
            imbalance = self.imbalance(c)
            left = V / tau * (base - c) + imbalance
            size = self.total(np.abs(left))
            scale = before + self.total(np.abs(self._through_walls(c)) + self._taken(c)[0])
            scale += self._law.decay * V * self.total(c)
            placed = abs(self.total(left)) <= PLACED * scale
            finest = EPSILON * self.total(self._diagonal * c)  # what the last bits of c move
            if size == 0.0 or (size <= max(SOLVED * scale, finest) and (placed or size > 0.5 * best)):
                return c, imbalance
            best = size
            c = np.maximum(c + self._correction(left, V / tau + self._taken(c)[1]), 0.0)
        raise NumericsError(f"field {self._name}: Newton's method leaves {size:.3g} of {scale:.3g} molecules/µs; a "
                            "smaller uptake, a larger `half`, or a larger spacing is easier to solve")

    def _correction(self, left: np.ndarray, more: np.ndarray) -> np.ndarray:
        """Solution of (A + more) d = left: by standing waves, at once where `more` is the same everywhere; or by
        factors of an earlier matrix as long as few iterations do.
        """
        if self._waves is not None:
            self._mean = float(more.mean()) + self._law.decay * self.grid.volume
            if more.min() == more.max():
                return self._waves.solved(left, self._mean)
            self._set_tangent(more)
            self._y.setArray(left)
            self._ksp.solve(self._y, self._x)
            return self._x.getArray(readonly=True).copy()
        old = self._factored if len(self._factored) and self.iterations <= self._reuse else more
        reason = self._solve(old, left, more)
        if reason <= 0 and old is not more:
            self._solve(more, left, more)
        return self._x.getArray(readonly=True).copy()

    def _solve(self, factored: np.ndarray, left: np.ndarray, more: np.ndarray) -> int:
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
        self.iterations = self._ksp.getIterationNumber()
        return int(self._ksp.getConvergedReason())

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Precondition by the equations in which what is on the diagonal besides A is the same everywhere."""
        assert self._waves is not None  # else it is not called
        y.setArray(self._waves.solved(x.getArray(readonly=True), self._mean))

    def _set_tangent(self, more: np.ndarray) -> None:
        """Set the matrix of the solver to A + more."""
        self._y.setArray(self._diagonal + more)
        self._tangent.setDiagonal(self._y)
        self._tangent.setOption(PETSc.Mat.Option.SPD, not any(self._law.flow))
        self._ksp.setOperators(self._tangent)

    # ------------------------------------------------------------ molecules

    def rates(self, c: np.ndarray) -> dict[str, Any]:
        """Flows of molecules at c (n,) [1/µm³], by the names of `Molecules`; collective.

        Returns
        -------
        dict -- secreted, taken : (cells,) by each cell;  out, crossed : through walls, and sum of sizes;  decayed;
            rounded : what the last bits of c may move; all in [1/µs].
        """
        e, through = self.exchanging, self._through_walls(c)
        on = e.uptake > 0.0
        near, half = c[self._volume[on]], e.half[on, None]
        share = (self._weight[on] * (near / (near + half))).sum(axis=1)
        taken = np.bincount(e.cell[on], (self._size * e.uptake)[on] * share, self._cells)
        return {"secreted": np.bincount(e.cell, self._size * e.secretion, self._cells),
                "taken": self._world.allreduce(taken), "out": self.total(through),
                "crossed": self.total(np.abs(through)), "decayed": self.total(self._law.decay * self.grid.volume * c),
                "rounded": 4.0 * EPSILON * np.sqrt(self.total((self._diagonal * c) ** 2))}

    def total(self, values: np.ndarray) -> float:
        """Sum of `values` (n,), in any unit, over the volumes of all ranks; collective."""
        own = float(values.sum())
        return own if self._world.size == 1 else float(self._world.allreduce(own))

    def largest(self, values: np.ndarray) -> float:
        """Largest magnitude of `values` (n,), in any unit, on all ranks; collective."""
        own = float(np.abs(values).max(initial=0.0))
        return own if self._world.size == 1 else float(self._world.allreduce(own, MPI.MAX))

    # ------------------------------------------------------------ checkpoints

    @property
    def on_diagonal(self) -> np.ndarray:
        """What the factored matrix has on its diagonal besides that of fluxes (n,) [µm³/µs]; zeros without one."""
        return self._factored if len(self._factored) else np.zeros(len(self.grid.own))

    def factor(self, on_diagonal: np.ndarray, iterations: int) -> None:
        """Factor the matrix with `on_diagonal` (n,) [µm³/µs], as it was after a solve of so many `iterations`."""
        if iterations:
            self._solve(on_diagonal, np.zeros(len(on_diagonal)), on_diagonal)
            self.iterations = iterations

    def close(self) -> None:
        """Free the PETSc objects; collective."""
        for thing in (self._ksp, self._matrix, self._tangent, self._x, self._y):
            thing.destroy()
        self.grid.close()
