"""Drops of the cytoplasm: viscous, inviscid, with line tension, as sound and as shear."""

from __future__ import annotations

import numpy as np

from cellmig.study.reference import Measured, converges, reference

from .scenes import altered, built, drop

RADIUS = 5.0  # µm


def straining(rate: float) -> dict:
    """Of a cell that starts with v = rate (x, -y) [1/µs]."""
    return {"velocity_gradient": [[f"{rate} /us", "0 /us"], ["0 /us", f"{-rate} /us"]]}


def axes(sim) -> np.ndarray:
    """Half the width and height of a drop [µm]."""
    return 0.5 * np.ptp(sim.mechanics.surface_positions(), axis=0)


@reference("viscous-drop", shows="semi-axes at 1, 2, 5 µs of a drop set flowing by 0.02 (x, -y) /µs, over R = 5 µm",
           source="REFERENCES.md 5", at=(150, 400, 1000, 2500), seconds=60.0,
           expected={"semi-axes": converges(2, "h² of a linear basis and of the stabilisation, blind to linear flow",
                                            {5000: 0.01, 20000: 0.003}, floor=2e-6)})
def viscous_drop(count: int) -> Measured:
    """μ = 1000 Pa µs, no surface tension."""
    right = {1.0: (5.08760, 4.91357), 2.0: (5.15571, 4.84742), 5.0: (5.28614, 4.72173)}
    with built(altered(drop(count), straining(0.02))) as sim:
        missed = 0.0
        for time, exact in right.items():
            sim.go(time)
            missed = max(missed, float(np.abs(axes(sim) - exact).max()) / RADIUS)
        return Measured(sim.scene.templates[0].spacing, {"semi-axes": missed}, count)
