"""Elastic bodies in space in equilibrium: a bar that is pulled, bent by moments, and a beam in plane strain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import brentq

from cellmig.case.pointwise import pointwise
from cellmig.case.schema import Case
from cellmig.verify.exact import poisson
from cellmig.verify.reference import Measured, converges, exact, reference
from cellmig.verify.specimens import RAMP, Cantilever, piece

from .dynamic import LAWS
from .scenes import built, displacement, l2_error
from .space import SQUARED
from .static import LINEAR, law_of, loaded

COUNTS = (300, 1000, 3000)


def bar(count: int, modulus: str, supports: Sequence[tuple], **tables: object) -> Case:
    """A bar of 4 x 1 x 1 µm of the nucleus's law with a volumetric modulus; `supports` : (parts, x, y, z) [µm]."""
    box = {"shape": "box", "a": "4 um", "b": "1 um", "c": "1 um", "centre": ["0 um"] * 3}
    held = [{"name": f"held-{k}", "parts": parts, "load_curve": RAMP,
             "displacement": [v if v == "free" else f"{v} um" for v in way]}
            for k, (parts, *way) in enumerate(supports)]
    return piece(box, count, material={"volumetric_modulus": modulus}, supports=held, dimension=3, **tables)


@reference("bar-pulled", shows="a bar stretched by 1.3, whose sides are free: uniform strain, and the force of its law",
           source="F = diag(1.3, b, b) with no stress across, b solved for", at=COUNTS, seconds=10.0,
           expected={"displacement": exact(1e-8, "gradients of linear fields are exact, to Newton's tolerance"),
                     "force": exact(1e-7, "the same, over that of the law")})
def bar_pulled(count: int) -> Measured:
    """The planes x = -2, y = -0.5, z = -0.5 µm stay level, so that nothing turns."""
    stretch = 1.3
    level = [(["left"], "0", "free", "free"), (["front"], "free", "0", "free"), (["bottom"], "free", "free", "0")]
    case = bar(count, LAWS["soft"], [*level, (["right"], 4.0 * (stretch - 1.0), "free", "free")])

    def across(b: float) -> np.ndarray:
        F = np.diag([stretch, b, b])[:, :, None]
        return np.array(pointwise(law_of(case), "stress", {"F": F}))[:, :, 0]

    b = brentq(lambda b: across(b)[1, 1], 0.7, 1.0, xtol=1e-15)
    with built(case) as sim:
        row = loaded(sim)
        X = sim.scene.X
        right = np.column_stack([(stretch - 1.0) * (X[:, 0] + 2.0), *((b - 1.0) * (X[:, k] + 0.5) for k in (1, 2))])
        return Measured(sim.scene.templates[0].spacing,
                        {"displacement": float(np.abs(displacement(sim) - right).max() / 4.0),
                         "force": abs(row["held-3_force_x_pn"] / across(b)[0, 0] - 1.0)}, count)


@reference("bar-bent", shows="a bar of 4 x 1 x 1 µm bent by moments, with its sides free, in small strain, L2",
           source="u = κ (-x z, ν y z, x²/2 + ν (z² - y²)/2): Saint-Venant", at=COUNTS, seconds=10.0,
           expected={name: converges(2, SQUARED) for name in LAWS})
def bar_bent(count: int) -> Measured:
    """The exact displacement is prescribed at both ends; the section becomes anticlastic."""
    found = {}
    for name, modulus in LAWS.items():
        nu, k = poisson(law_of(bar(50, modulus, []))), 2.0 * LINEAR
        exact_u = (f"{-k}*x*z", f"{k * nu}*y*z", f"{0.5 * k}*(x**2 + {nu}*(z**2 - y**2))")
        with built(bar(count, modulus, [(["left", "right"], *exact_u)])) as sim:
            loaded(sim)
            x, y, z = sim.scene.X.T
            right = k * np.column_stack([-x * z, nu * y * z, 0.5 * (x * x + nu * (z * z - y * y))])
            found[name] = l2_error(sim, displacement(sim), right)
            spacing = sim.scene.templates[0].spacing
    return Measured(spacing, found, count)


@reference("cantilever-in-space", shows="a beam between smooth walls under a shear force at its end, small strain, L2",
           source="plane strain: Timoshenko & Goodier, Theory of Elasticity, §21; verify/specimens.py", at=COUNTS,
           seconds=10.0, expected={name: converges(2, SQUARED) for name in LAWS})
def cantilever_in_space(count: int) -> Measured:
    """The beam of two dimensions with z for y; nothing moves along y."""
    found = {}
    for name, modulus in LAWS.items():
        exact_beam = Cantilever(law_of(bar(50, modulus, [])), 4.0, 1.0, LINEAR)
        ux, uz = (text.replace("y", "z") for text in exact_beam.formulas())
        end = {"name": "end", "parts": ["right"], "load_curve": RAMP,
               "traction": ["0 Pa", "0 Pa", f"{exact_beam.shear().replace('y', 'z')} Pa"]}
        walls = [(["left"], ux, "0", uz), (["front", "back"], "free", "0", "free")]
        with built(bar(count, modulus, walls, loads=[end])) as sim:
            loaded(sim)
            u = exact_beam.displacement(sim.scene.X[:, [0, 2]])
            found[name] = l2_error(sim, displacement(sim), np.column_stack([u[:, 0], 0.0 * u[:, 0], u[:, 1]]))
            spacing = sim.scene.templates[0].spacing
    return Measured(spacing, found, count)
