"""Error of the reduced bulk modulus k of the fluid, by Richardson extrapolation to the incompressible limit.

As J - 1 = -p/k, the error of flow and shape is of first order in 1/k: twice the result of 2k less that of k is free of
it.  A run with another, larger modulus checks the extrapolation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cellmig.output.log import table
from cellmig.simulation import Simulation

from .problems import PROBLEMS, Problem, Series, Setting, columns, rms

MODULI, CHECK = (2.5, 5.0, 10.0, 20.0), 80.0  # [MPa]: each twice the one before; that of the check
ORDER = 1.0  # expected, in 1/k
SIZE, QUICK_SIZE = 1485, 331  # particles
NAMES = ("drop", "cell")
PEAKS = ("stress", "pressure")  # [Pa], with short peaks where a contact line advances


@dataclass(frozen=True)
class Row:
    """Error of one quantity of a problem with the default modulus.

    end, limit : values at the end, with the default modulus and extrapolated [µm or Pa];  orders : observed in 1/k, of
    three consecutive moduli;  error : of the default, against the limit;  known : error of the extrapolation at the
    modulus of the check.  Errors are root mean squares over time, medians for PEAKS, over those of the change [-].
    """

    problem: str
    quantity: str
    particles: int
    end: float
    limit: float
    orders: tuple[float, ...]
    error: float
    known: float


def continuation(quick: bool = False, names: Sequence[str] = NAMES) -> list[Row]:
    """Run problems with all moduli; a row for each quantity.  Raises NumericsError."""
    size = QUICK_SIZE if quick else SIZE
    return [row for name in names
            for row in judge(PROBLEMS[name], size, {k: measure_problem(PROBLEMS[name], Setting(size, modulus=k))
                                                    for k in (*MODULI, CHECK)})]


def measure_problem(problem: Problem, setting: Setting) -> Series:
    """Measurements of a problem at the start and at all its times, with effective stress and pressure [Pa]."""
    with problem.simulation(setting) as sim:
        rows = [_quantities(problem, sim)]
        for time in problem.times:
            sim.go(time)
            rows.append(_quantities(problem, sim))
        return columns(rows)


def _quantities(problem: Problem, sim: Simulation) -> dict[str, float]:
    """Measurements now; the pressure is a root mean square, as its mean depends on surface forces alone."""
    stress = sim.sample()[0][1]["effective_stress_pa"]
    pressure = np.average(sim.sampler.stresses()["pressure"] ** 2, weights=sim.sampler.V)
    return problem.measure(sim) | {"stress": stress, "pressure": float(np.sqrt(pressure))}


def extrapolated(at: Mapping[float, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Limit of values for infinite k, and their slope in 1/k, from the two largest moduli."""
    less, most = sorted(at)[-2:]
    slope = (at[less] - at[most]) / (1.0 / less - 1.0 / most)
    return at[most] - slope / most, slope


def orders(at: Mapping[float, np.ndarray], size: Callable[[np.ndarray], float]) -> tuple[float, ...]:
    """Observed orders in 1/k, from the sizes of the differences between consecutive moduli."""
    moduli = sorted(at)
    steps = [size(at[a] - at[b]) for a, b in pairwise(moduli)]
    return tuple(float(np.log2(a / b)) if a * b else float("nan") for a, b in pairwise(steps))


def judge(problem: Problem, particles: int, series: Mapping[float, Series]) -> list[Row]:
    """A row for each quantity, from measurements `series` with each modulus."""
    default, rows = Setting().modulus, []
    for quantity in series[default]:
        size = _median if quantity in PEAKS else rms
        at = {k: series[k][quantity] for k in MODULI}
        limit, slope = extrapolated(at)
        change = size(limit - limit[0])
        error, known = size(at[default] - limit), size(series[CHECK][quantity] - limit - slope / CHECK)
        rows.append(Row(problem.name, quantity, particles, float(at[default][-1]), float(limit[-1]), orders(at, size),
                        error / change, known / change))
    return rows


def _median(x: np.ndarray) -> float:
    return float(np.median(np.abs(x)))


def report(rows: Sequence[Row]) -> list[str]:
    """The table in Markdown, and its largest error."""
    lines = [[row.problem, row.quantity, f"{row.end:.6g} {'Pa' if row.quantity in PEAKS else 'µm'}",
              f"{row.limit:.6g}", ", ".join(f"{p:.2f}" for p in row.orders), f"{100 * row.error:.2g}",
              f"{100 * row.known:.2g}"] for row in rows]
    default = f"{Setting().modulus:g} MPa"
    worst = max((row for row in rows if row.quantity not in PEAKS), key=lambda row: row.error)
    return [f"Reduced bulk modulus: {', '.join(f'{k:g}' for k in MODULI)} MPa at {rows[0].particles} particles, "
            f"extrapolated with order {ORDER:g} in 1/k; errors over the change since the start", "",
            *table(["problem", "quantity", f"at the end, {default}", "extrapolated", "orders",
                     f"error of {default} [%]", f"extrapolated against {CHECK:g} MPa [%]"], lines), "",
            f"Of the motion {default} cost the {worst.problem}'s {worst.quantity} most: {100 * worst.error:.2g} %, "
            f"known to {100 * worst.known:.2g} %."]
