"""Cells on an elastic gel against the exact layer, from the runs of `cases/slab.toml` with its pull and without.

`python -m cellmig.verify.slab output/slab output/slab_still PICTURE` prints a table and draws the surface of the gel.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation

from cellmig.plot.style import COLOURS, STYLE, legend_above
from cellmig.runs.record import Record

from .exact import Layer

NM = 1e3  # nm/µm


class Pulled:
    """A run in which the first of two cells on a gel is pulled, and one in which it is not.

    layer : Layer -- the gel;  half : float -- half of the width of a cell [µm];  force : float -- that of the pull
    [pN/µm].
    """

    def __init__(self, pulled: Path, still: Path):
        """Read both."""
        self.runs = Record(pulled), Record(still)
        case = self.runs[0].case
        gel, cell = case.cells[:2]
        self.layer, self.half = Layer(case.materials[gel.material], gel.shape.height), 0.5 * cell.shape.width
        self.force = case.loads[0].body[0] * cell.shape.area

    def surface(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of the gel's surface places x (n,) [µm] and displacements by the pull (n,) [µm], and the middles of both
        cells (2,) [µm], at a `time` in the unit of the run.
        """
        frames = [run.frame(time) for run in self.runs]
        X, of = frames[0]["X"], frames[0]["cell"]
        top = np.flatnonzero((of == 1) & (np.abs(X[:, 1]) < 1e-6))
        top = top[np.argsort(X[top, 0])]
        bases = [frames[0]["x"][(of == n) & (X[:, 1] < 0.06), 0] for n in (2, 3)]
        u = frames[0]["u"][top, 0] - frames[1]["u"][top, 0]
        return X[top, 0], u, np.array([0.5 * (x.min() + x.max()) for x in bases])

    def exact(self, x: np.ndarray) -> np.ndarray:
        """Displacements (n,) [µm] of the layer at x (n,) [µm] from the middle of a cell below which the traction is
        uniform.
        """
        traction = self.force / (2.0 * self.half)
        return self.layer.displacement(x, lambda k: 2.0 * traction * np.sin(self.half * k) / (np.pi * k), 20.0)

    def moved(self, time: float) -> tuple[float, float]:
        """Displacement of the second cell by the pull of the first, and the exact one of the gel below it [µm]."""
        frames = [run.frame(time) for run in self.runs]
        on = frames[0]["cell"] == 3
        middle = self.surface(time)[2]
        places = middle[1] - middle[0] + self.half * np.linspace(-1.0, 1.0, 81)
        return float((frames[0]["u"] - frames[1]["u"])[on, 0].mean()), float(self.exact(places).mean())

    def picture(self, time: float) -> Figure:
        """The gel and the cells, coloured by the displacement along x, above the displacement of the surface."""
        with matplotlib.rc_context(STYLE):
            figure = Figure(figsize=(6.4, 3.6), layout="constrained")
            scene, below = figure.subplots(2, 1, height_ratios=(1.0, 1.4), sharex=True)
            fields = self.runs[0].frame(time)
            x, u, middle = self.surface(time)
            most = NM * np.abs(u).max()
            for cell in (1, 2, 3):
                on = fields["cell"] == cell
                X = fields["X"][on]
                mesh = Triangulation(*X.T)
                corners = X[mesh.triangles]
                longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
                mesh = Triangulation(*fields["x"][on].T, mesh.triangles[longest < 2.5])
                shown = scene.tripcolor(mesh, NM * fields["u"][on, 0], cmap="PuOr", vmin=-most, vmax=most,
                                        shading="gouraud")
            scene.set(aspect="equal", ylabel="y [µm]")
            figure.colorbar(shown, ax=scene, label="u along x [nm]", extend="both")
            at = np.linspace(-45.0, 45.0, 301)
            below.plot(at, NM * self.exact(at - middle[0]), color=COLOURS[6], label="exact, uniform traction")
            below.plot(x, NM * u, ".", color=COLOURS[0], label="particles of the surface")
            for n, place in enumerate(middle):
                below.axvspan(place - self.half, place + self.half, color=COLOURS[4], alpha=0.2, lw=0,
                              label=None if n else "below the cells")
            below.set(xlabel="x [µm]", ylabel="u of the surface\nby the pull [nm]")
            legend_above(below)
            return figure


def table(found: Pulled) -> str:
    """Displacements of the second cell [nm] at some times, in Markdown."""
    times = found.runs[0].times[[5, 10, 20, -1]]
    rows = [(f"{t:.3g}", *(f"{NM * value:.1f}" for value in found.moved(t))) for t in times]
    head = "| " + " | ".join((f"time [{found.runs[0].units['time']}]", "moved by [nm]", "exact [nm]")) + " |"
    return "\n".join([head, "|---|---|---|", *("| " + " | ".join(row) + " |" for row in rows)])


if __name__ == "__main__":
    both = Pulled(*map(Path, sys.argv[1:3]))
    print(table(both))
    both.picture(float(both.runs[0].times[10])).savefig(sys.argv[3], dpi=110)
