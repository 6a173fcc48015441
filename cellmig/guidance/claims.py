"""Claims G1 to G4 on guidance: numbers measured for each random seed, their bounds, verdicts.

Bounds are of numbers without a unit, or signs, and do not depend on the parameters of the cases.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from itertools import pairwise

import numpy as np

from cellmig.output.motion import index_of_bias
from cellmig.runs.claims import Claim, Part, text_of

from .experiments import (
    AFFINITY,
    DOSE_STEP,
    DOSES,
    GAIN,
    GEL,
    GRADIENT,
    LENGTH,
    LEVEL,
    LOOK,
    PERSISTENCE,
    PITCH,
    PLACES,
    ROWS,
    STEPS,
)
from .walks import Walk

Results = Mapping[str, Mapping[int, Walk]]  # walks by configuration and seed
SMALL = 0.05  # largest index of a single cell that counts as none [-]


def judge(results: Results, keys: Iterable[str]) -> list[Claim]:
    """Claims with the values of `results`."""
    return [CLAIMS[key](results) for key in keys]


def by_seed(results: Results, names: Iterable[str], number: Callable[..., float]) -> dict[int, float]:
    """`number(*walks)` for each seed that all these configurations have."""
    runs = [results.get(name, {}) for name in names]
    return {seed: float(number(*(run[seed] for run in runs)))
            for seed in sorted(set.intersection(*map(set, runs)))}


def told(results: Results, names: Iterable[str], number: Callable[[Walk], float]) -> str:
    """Mean ± standard deviation of a number in each of some configurations, as text."""
    found = {name: by_seed(results, [name], number) for name in names}
    return ", ".join(f"{name}: {text_of(values.values())}" for name, values in found.items() if values)


def expected(count: int) -> float:
    """Mean contact cue of a row in the gradient, over that of a row without end in one that grows linearly [-].

    β(c) at both ends of the row, less each other, over the number of cells, for β = c/(c + K): β' g d (N - 1)/N in a
    weak gradient.  Source: derived here; Camley et al. (2016), Phys. Rev. Lett. 116:098101.
    """
    ends = LEVEL + 0.5 * GRADIENT * (count - 1) * PITCH * np.array([-1.0, 1.0])
    low, high = ends / (ends + AFFINITY)
    return float((high - low) / count) * (LEVEL + AFFINITY) ** 2 / (AFFINITY * GRADIENT * PITCH)


def g1(results: Results) -> Claim:
    """Theveneau et al. (2010), Malet-Engra et al. (2015): groups climb a gradient that single cells do not."""
    names, largest = {count: f"row {count}" for count in ROWS}, max(ROWS)
    some = [count for count in ROWS if count > 1]
    parts = [Part("forward index of a single cell [-]", by_seed(results, ["row 1"], lambda w: w.index), -SMALL, SMALL)]
    parts += [Part(f"drift of {high} cells less that of {low} [µm/h]",
                   by_seed(results, [names[low], names[high]], lambda a, b: b.drift - a.drift), above=0.0)
              for low, high in pairwise(some)]
    parts += [Part(f"drift of {count} over that of {largest} cells, less {expected(count) / expected(largest):.2f} [-]",
                   by_seed(results, [names[count], names[largest]], lambda a, b, n=count: a.drift / b.drift
                           - expected(n) / expected(largest)), -0.15, 0.15) for count in some[:-1]]
    return Claim("G1", "a row follows a chemical gradient that a single cell does not; longer rows are faster", parts,
                 [f"drift [µm/h]: {told(results, names.values(), lambda w: w.drift)}",
                  f"forward index [-]: {told(results, names.values(), lambda w: w.index)}",
                  "(N - 1)/N, with the saturation of receptors: "
                  + ", ".join(f"{count}: {expected(count):.3f}" for count in ROWS)])


def middle(walk: Walk) -> float:
    """Tension of the layer in its middle [pN/µm]."""
    return float(walk.tension[1][len(walk.tension[0]) // 2])


def g2(results: Results) -> Claim:
    """Sunyer et al. (2016): clusters go to the stiffer side, single cells do not; it takes junctions."""
    graded = by_seed(results, ["gel graded"], lambda w: w.drift)
    mean = float(np.mean(list(graded.values()))) if graded else np.nan
    parts = [
        Part("forward index of a single cell [-]", by_seed(results, ["gel 1"], lambda w: w.index), -SMALL, SMALL),
        Part(f"drift of {GEL} cells on the graded gel [µm/h]", graded, above=0.0),
        Part("stiff end less soft end, speeds outwards [µm/h]",
             by_seed(results, ["gel graded"], lambda w: w.outwards(0) - w.outwards(-1)), above=0.0),
        Part("tension of the layer in the middle less that at its ends [pN/µm]",
             by_seed(results, ["gel graded"], lambda w: middle(w) - w.tension[1][[0, -1]].mean()), above=0.0),
        Part("tension of the layer in the middle over the largest [-]",
             by_seed(results, ["gel graded"], lambda w: middle(w) / w.tension[1].max()), above=0.8),
        Part("drift on a uniform gel over that on the graded one [-]",
             {seed: v / mean for seed, v in by_seed(results, ["gel uniform"], lambda w: w.drift).items()}, -0.25, 0.25),
        Part("drift with junctions cut over that with them [-]",
             {seed: v / mean for seed, v in by_seed(results, ["gel cut"], lambda w: w.drift).items()}, -0.25, 0.25)]
    kinds = ["gel 1", "gel graded", "gel uniform", "gel cut"]
    return Claim("G2", "a row goes to the stiffer side of a gel, a single cell does not; it takes junctions", parts,
                 [f"drift [µm/h]: {told(results, kinds, lambda w: w.drift)}",
                  "tension in the middle [pN/µm]: " + told(results, kinds[1:], middle)])


def foreseen(percent: float, dose: float) -> float:
    """Mean cosine of steps [-] in a gradient of a difference across a cell [%], at a level over the affinity.

    That of a Gaussian polarity whose mean is the cue of occupancy, in the mean over the time between samples.
    """
    apart = LOOK / PERSISTENCE
    spread = np.sqrt(2.0 * (apart - 1.0 + np.exp(-apart))) / apart
    return float(index_of_bias(GAIN * percent / 100.0 * dose / (1.0 + dose) ** 2 / spread, 1))


def g3(results: Results) -> Claim:
    """Zigmond (1977), Herzmark et al. (2007): cells go the straighter the steeper, and best at the affinity."""
    steep = {percent: f"steep {percent:g}" for percent in STEPS}
    doses = {dose: f"dose {dose:g}" if dose != 1.0 else steep[DOSE_STEP] for dose in DOSES}
    parts = [Part(f"cosine of steps at {high:g} % across a cell less that at {low:g} % [-]",
                  by_seed(results, [steep[low], steep[high]], lambda a, b: b.cosine - a.cosine), above=0.0)
             for low, high in pairwise(STEPS)]
    parts += [Part(f"cosine at the affinity less that at {dose:g} of it [-]",
                   by_seed(results, [doses[1.0], name], lambda a, b: a.cosine - b.cosine), above=0.0)
              for dose, name in doses.items() if dose != 1.0]
    cases = {**{name: foreseen(p, 1.0) for p, name in steep.items()},
             **{name: foreseen(DOSE_STEP, d) for d, name in doses.items()}}
    parts += [Part(f"cosine, {name}, less {exact:.2f} [-]",
                   by_seed(results, [name], lambda w, e=exact: w.cosine - e), -0.25, 0.25)
              for name, exact in cases.items()]
    return Claim("G3", "chemotaxis is better in steeper gradients, and best where half of all receptors are occupied",
                 parts, [f"mean cosine of steps [-]: {told(results, cases, lambda w: w.cosine)}",
                         "of a Gaussian polarity: " + ", ".join(f"{name}: {e:.2f}" for name, e in cases.items())])


def g4(results: Results) -> Claim:
    """Isomursu et al. (2022): cells go to their optimal stiffness from both sides, which clutches find."""
    names = {place: f"clutches {place}" for place in PLACES}
    up = by_seed(results, [names["softer"]], lambda w: w.drift)
    mean = float(np.mean(list(up.values()))) if up else np.nan
    parts = [Part("drift of a cell that begins where it is too soft [µm/h]", up, above=0.0),
             Part("drift of one that begins where it is too stiff [µm/h]",
                  by_seed(results, [names["stiffer"]], lambda w: w.drift), below=0.0),
             Part("drift on a uniform substrate over that up the gradient [-]",
                  {seed: v / mean for seed, v in by_seed(results, ["clutches uniform"], lambda w: w.drift).items()},
                  -0.5, 0.5)]
    return Claim("G4", "cells with clutches go to an optimal stiffness, which no parameter names", parts, [
        f"drift [µm/h]: {told(results, [*names.values(), 'clutches uniform'], lambda w: w.drift)}",
        f"a cell is {LENGTH:g} µm long; the stiffness grows e-fold on that length"])


CLAIMS = {"G1": g1, "G2": g2, "G3": g3, "G4": g4}
