"""Traction of clutches against the stiffness of the substrate: `python -m cellmig.plot.clutches PICTURE`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from cellmig.case.registry import laws
from cellmig.laws import register
from cellmig.solve.clutches import mean_traction

from .style import COLOURS

SECOND, PN_NM = 1e6, 1e3  # µs, pN/µm
SPRINGS = 10.0 ** np.arange(-1.0, 2.6, 0.25)  # pN/nm
SETS = ((75, 5.0), (50, 0.8), (500, 0.8))  # motors and clutches, pN/nm of a clutch


def curves(sets: Sequence[tuple[int, float]], springs: np.ndarray, time: float) -> list[tuple[Any, np.ndarray]]:
    """For each set the law, and at each spring [pN/nm] the mean traction and its error (n, 2) [pN] over a time [s]."""
    found = []
    for count, stiffness in sets:
        law = laws("response")["clutches"](motors=count, clutches=count, stiffness=stiffness * PN_NM)
        found.append((law, np.array([mean_traction(law, k * PN_NM, time * SECOND, 1) for k in springs])))
    return found


def picture(springs: np.ndarray, found: list[tuple[Any, np.ndarray]]) -> Figure:
    """Mean traction over the stall force against spring and modulus."""
    figure = Figure(figsize=(6.4, 3.8), layout="constrained")
    axes = figure.subplots()
    for (law, means), colour in zip(found, COLOURS, strict=False):
        label = f"{law.motors} motors, {law.clutches} clutches of {law.stiffness / PN_NM:g} pN/nm"
        axes.errorbar(springs, means[:, 0] / law.stall, means[:, 1] / law.stall, fmt=".-", color=colour, label=label)
    axes.set(xscale="log", ylim=(0.0, 1.0), xlabel="spring of the substrate [pN/nm]",
             ylabel="traction over the stall force [-]")
    law = found[0][0]
    above = axes.secondary_xaxis("top", functions=(lambda k: law.modulus(k * PN_NM) / 1e3,
                                                   lambda E: law.spring(E * 1e3) / PN_NM))
    above.set_xlabel(f"Young's modulus below an adhesion of {law.adhesion_radius:g} µm radius [kPa]")
    axes.legend(loc="lower left")
    return figure


def table(springs: np.ndarray, found: list[tuple[Any, np.ndarray]]) -> str:
    """Flow [nm/s] and traction [pN] in Markdown."""
    rows = ["| spring [pN/nm] | " + " | ".join(f"{k:g}" for k in springs) + " |", "|---" * (len(springs) + 1) + "|"]
    for law, means in found:
        flows = 1e9 * law.speed * (1.0 - means[:, 0] / law.stall)
        rows.append(f"| {law.motors} of {law.stiffness / PN_NM:g} pN/nm | " + " | ".join(
            f"{flow:.0f}, {mean:.1f} ± {error:.1f}" for flow, (mean, error) in zip(flows, means, strict=True)) + " |")
    return "\n".join(rows)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    register()
    at = np.array([0.1, 0.316, 1.0, 3.16, 10.0, 100.0, 1000.0])
    print(table(at, curves(SETS, at, 2000.0)))
    picture(SPRINGS, curves(SETS, SPRINGS, 1000.0)).savefig(sys.argv[1], dpi=110)
