"""Run time against error: Pareto sets, gains over the defaults, and the picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from cellmig.parallel.options import IMPLICIT
from cellmig.plot.style import COLOURS, STYLE, save

from .problems import PROBLEMS, Setting

# CPU time [ns] per particle and evaluation of forces of other codes, with 4,500 particles in 2D on one core.
PEERS = {"SPHinXsys": 504.0, "mfree_iwf": 4800.0}
STEEPEST = -3.0  # of the logarithms of time and error: in 2D, errors of first order and steps as long as the spacing
PAYS = 1.1  # smaller gains are within the scatter of times, and do not justify other results of every run
# Changes that gain on these problems, but lose on whole scenes or in other quantities (docs/error.md).
UNFIT = {"stabilisation": "with less, short waves of the fluid lose too little",
         "hourglass_modulus": "with more, bending is too stiff", "step_factor": "with more, less of the energy adds up"}


@dataclass(frozen=True)
class Point:
    """A timed run.

    setting : numerical choices;  ns : corrected CPU time per particle-step [ns];  cpu : measured time of all steps [s];
    error : [-];  parts : of the error, by name.
    """

    problem: str
    setting: Setting
    particles: int
    steps: int
    ns: float
    cpu: float
    error: float
    parts: dict[str, float] = field(default_factory=dict)

    @property
    def cost(self) -> float:
        """CPU time on one core [s]: steps × particles × time of each."""
        return 1e-9 * self.steps * self.particles * self.ns


@dataclass(frozen=True)
class Broken:
    """A run that failed.

    setting : numerical choices;  message : of its error.
    """

    problem: str
    setting: Setting
    message: str


def measured_problems(points: Sequence[Point]) -> list[str]:
    """Names of the problems that have points, in the order of PROBLEMS."""
    return [name for name in PROBLEMS if any(p.problem == name for p in points)]


def pareto(points: Sequence[Any]) -> list[Any]:
    """The points for which no other has both smaller cost and smaller error, ordered by cost."""
    best: list[Any] = []
    for point in sorted(points, key=lambda p: (p.cost, p.error)):
        if not best or point.error < best[-1].error:
            best.append(point)
    return best


def time_at(curve: Sequence[Any], error: float) -> float:
    """Time [s] to an error, by linear inter- and extrapolation of the logarithms along the Pareto set of a curve.

    Beyond the points the time grows at most as that of a method of first order; it is nan with fewer than two points.
    """
    front = pareto(curve)
    if len(front) < 2:
        return float("nan")
    x, y = (np.log([getattr(p, name) for p in front[::-1]]) for name in ("error", "cost"))
    k = int(np.clip(np.searchsorted(x, np.log(error)), 1, len(x) - 1))
    slope, at = (y[k] - y[k - 1]) / (x[k] - x[k - 1]), 0 if np.log(error) < x[0] else k
    slope = max(slope, STEEPEST) if at == 0 else slope
    return float(np.exp(y[at] + slope * (np.log(error) - x[at])))


def gain(points: Sequence[Point], changes: dict[str, Any]) -> float:
    """Time of the defaults to the same error over that with changes, median over sizes; nan without points."""
    default = [p for p in points if not p.setting.changes]
    found = [time_at(default, p.error) / p.cost for p in points if p.setting.changes == changes]
    return float(np.median(found)) if found else float("nan")


def gains(points: Sequence[Point], broken: Sequence[Broken] = ()) -> list[tuple[dict[str, Any], dict[str, float]]]:
    """Gain by problem of each change of the defaults, ordered by the smallest gain of all problems, best first.

    Choices that do not apply to a problem are left out of the change there.  A gain is 0 where a run with the change
    broke at a size at which the defaults did not, and nan where it was not measured.
    """
    changes = {repr(p.setting.changes): p.setting.changes for p in (*points, *broken) if p.setting.changes}
    rows = []
    for change in changes.values():
        row = {}
        for name in measured_problems(points):
            own = [p for p in points if p.problem == name]
            left = {key: value for key, value in change.items() if key not in PROBLEMS[name].without}
            whole = {p.setting.per_cell for p in own if not p.setting.changes}
            failed = any(b.problem == name and b.setting.changes == left and b.setting.per_cell in whole
                         for b in broken)
            row[name] = 0.0 if failed else gain(own, left) if left else 1.0
        if not all(np.isnan(value) for value in row.values()):
            rows.append((change, row))
    return sorted(rows, key=lambda pair: -float(np.nanmin(list(pair[1].values()))))


def with_median_times(points: Sequence[Point]) -> list[Point]:
    """The points, with the median time per particle-step of all points whose steps do the same work, as times scatter.

    Problem, size, dilation, refinement and integrator determine the work, and terms that are absent because their
    factor is zero.
    """
    def work(p: Point) -> tuple:
        s = p.setting
        return (p.problem, p.particles, s.dilation, s.surface_refinement, s.integrator, not s.stabilisation,
                not s.hourglass_modulus, not s.bulk_viscosity)

    times: dict[tuple, list[float]] = {}
    for p in points:
        times.setdefault(work(p), []).append(p.ns)
    return [replace(p, ns=float(np.median(times[work(p)]))) for p in points]


def verdict(rows: Sequence[tuple[dict[str, Any], dict[str, float]]]) -> str:
    """Sentences that name the best setting by these numbers, and the one which should be the default."""
    paying = [row for row in rows if all(value >= PAYS for value in row[1].values())]
    fit = [row for row in paying if not set(row[0]) & set(UNFIT)]
    text = "The defaults should stay: no change of them that was measured gains time on every problem."
    if fit:
        text = f"The defaults should be: {_gain_text(fit[0])}."
    elif paying:
        used = [key for key in UNFIT if any(key in change for change, _ in paying)]
        why = "; ".join(f"{key.replace('_', ' ')}: {UNFIT[key]}" for key in used)
        text = f"All the same the defaults should stay, as what gains is unfit ({why})."
    best = f"By these numbers alone the best is {_gain_text(paying[0])}.  " if paying and paying[:1] != fit[:1] else ""
    return best + text


def _gain_text(row: tuple[dict[str, Any], dict[str, float]]) -> str:
    text = ", ".join(f"{value:.2g} times as fast in {name}" for name, value in row[1].items())
    return f"{Setting(**row[0]).description} ({text}, to the same error)"


def draw(points: Sequence[Point], path: Path, uncertain: dict[str, float]) -> None:
    """Draw error against time of each problem: all points, Pareto set, defaults, other codes."""
    with matplotlib.rc_context(STYLE):
        measured = measured_problems(points)
        columns = min(3, len(measured))
        rows = -(-len(measured) // columns)
        figure = Figure(figsize=(3.6 * columns, 0.8 + 3.6 * rows), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        for ax in axes[len(measured):]:
            ax.set_axis_off()
        for ax, name in zip(axes, measured, strict=False):
            own = [p for p in points if p.problem == name]
            _panel(ax, own, PROBLEMS[name].title)
            if floor := uncertain.get(name):
                ax.axhspan(ax.get_ylim()[0], 100.0 * floor, color="0.9", zorder=0)
                ax.text(0.03, 0.02, "grey: the reference is not known better", transform=ax.transAxes, fontsize=7)
            if name == "disc":
                _peers(ax, [p for p in own if not p.setting.changes])
        for ax in axes[::columns]:
            ax.set_ylabel("error [%]")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="lower center", ncol=3)
        figure.get_layout_engine().set(rect=(0.0, 0.12 / rows, 1.0, 1.0 - 0.12 / rows))  # room for the legend
        save(figure, path.parent, path.stem, (path.suffix[1:],))


def _panel(ax: Axes, points: Sequence[Point], title: str) -> None:
    """Draw a problem; the Pareto set is a staircase, since lines between its points would claim too much."""
    front, default = pareto(points), sorted((p for p in points if not p.setting.changes), key=lambda p: p.cost)
    implicit = [p for p in points if p.setting.integrator in IMPLICIT]
    for some, style in ((points, {"marker": ".", "ls": "", "color": "0.65", "mew": 0, "label": "all settings"}),
                        (front, {"marker": "o", "ms": 3.5, "drawstyle": "steps-post", "color": COLOURS[0],
                                 "label": "Pareto set"}),
                        (default, {"marker": "s", "ms": 5, "ls": ":", "color": COLOURS[1],
                                   "label": "defaults, with their particles"}),
                        (implicit, {"marker": "^", "ms": 5, "ls": "", "color": "black", "label": "implicit steps"})):
        if some:
            ax.loglog([p.cost for p in some], [100.0 * p.error for p in some], **style)
    for p in default:
        ax.annotate(str(p.particles), (p.cost, 100.0 * p.error), (5, 4), textcoords="offset points", fontsize=7,
                    color=COLOURS[1])
    ax.set(title=title, xlabel="CPU time on one core [s]")
    ax.set_ylim(bottom=0.8 * min(100.0 * p.error for p in points))
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_formatter("")
    ax.grid(color="0.9", lw=0.5)
    ax.set_axisbelow(True)


def _peers(ax: Axes, default: Sequence[Point]) -> None:
    """Draw the defaults with the times per particle of other codes: an offset in time, not runs of these codes."""
    curve = sorted(default, key=lambda p: p.cost)
    for (name, ns), colour, dashes in zip(PEERS.items(), COLOURS[2:], ("--", "-."), strict=False):
        ax.plot([1e-9 * ns * p.steps * p.particles for p in curve], [100.0 * p.error for p in curve], ls=dashes, lw=1.0,
                color=colour, label=f"our particles and steps at {name}'s {ns:g} ns")
