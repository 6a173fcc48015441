"""Random bodies for the scenes of `verify --stress`, and how they lie: in rows, layers, heaps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cellmig.case.registry import laws

Tables = dict[str, Any]
LENGTHS = {"ball": ("radius",), "ellipsoid": ("a", "b", "c"), "cap": ("contact_radius", "height"),
           "box": ("a", "b", "c"), "cylinder": ("radius", "length"),
           "disc": ("radius",), "ellipse": ("a", "b"), "segment": ("width", "height")}
SHAPES = ("ball", "ellipsoid", "cap", "box", "cylinder")


def decades(rng: np.random.Generator, low: float, high: float) -> float:
    """10 to a power [-] that is uniformly distributed from `low` to `high`."""
    return float(10.0 ** rng.uniform(low, high))


def text(value: float, unit: str) -> str:
    """A value [-] with its unit, as in a case."""
    return f"{value:.6g} {unit}"


def cells_in_space(rng: np.random.Generator) -> list[Tables]:
    """1 to 6 cells with gaps from 0 to 1 µm; in a tenth of the scenes they overlap.

    Rows of three follow each other along y or lie on top of each other; in a third of the scenes cells move at first.
    """
    count, size = int(rng.integers(1, 7)), decades(rng, np.log10(2), np.log10(12))
    gap = float(rng.choice([0.01, rng.uniform(0, 1), -rng.uniform(0, 0.02)], p=[0.4, 0.5, 0.1]))
    height = float(rng.choice([0.01, rng.uniform(0, 2), 0.0], p=[0.5, 0.4, 0.1]))
    along, alike, moving = int(rng.integers(1, 3)), rng.random() < 0.5, rng.random() < 0.33
    kinds = [body(rng, SHAPES, size)] * count if alike else [body(rng, SHAPES, size * rng.uniform(0.6, 1.4))
                                                            for _ in range(count)]
    cells: list[Tables] = []
    for n, (kind, centre) in enumerate(zip(kinds, laid_out(kinds, 3, along, gap, height), strict=True), 1):
        nucleus = {"nucleus": "nucleus"} if "nucleus_ratio" in kind else {}
        push = {"velocity": [text(v, "um/us") for v in rng.uniform(-0.2, 0.2, 3)]} if moving else {}
        cells.append({"name": f"Cell-{n}", **kind, **nucleus, "material": "cytoplasm", **push, "centre": centre})
    return cells


def laid_out(kinds: list[Tables], row: int, along: int, gap: float, height: float) -> list[list[str]]:
    """Centres of bodies in rows of `row`, which follow each other `along` an axis, from `height` on [µm]."""
    outlines = [outline(kind) for kind in kinds]
    start = np.zeros(outlines[0].shape[1])
    start[-1] = height
    end, centres = start.copy(), []
    for n, points in enumerate(outlines):
        if n and n % row == 0:
            start[0], start[along] = 0.0, end[along] + gap
        low, high = points.min(axis=0), points.max(axis=0)
        centres.append([text(x, "um") for x in start - low])
        end = np.maximum(end, start + high - low)
        start[0] += high[0] - low[0] + gap
    return centres


def body(rng: np.random.Generator, shapes: Sequence[str], size: float) -> Tables:
    """A body of one of these shapes, of a size [µm], with a nucleus in half of them."""
    name = str(rng.choice(shapes))
    core = {"nucleus_ratio": float(rng.uniform(0.2, 0.6))} if rng.random() < 0.5 else {}
    return {"shape": name, **{key: text(size * rng.uniform(0.5, 1.5), "um") for key in LENGTHS[name]}, **core}


def outline(kind: Tables) -> np.ndarray:
    """Points (n, d) [µm] of the surface of a cell's table, from its centre; that of a polygon may cross itself."""
    if kind["shape"] == "polygon":
        return np.array([[float(x.split()[0]) for x in corner] for corner in kind["corners"]])
    lengths = {key: float(kind[key].split()[0]) for key in LENGTHS[kind["shape"]]}
    return laws("shape")[kind["shape"]](**lengths).outline(720)


def extent(cells: Sequence[Tables]) -> tuple[np.ndarray, np.ndarray]:
    """Opposite corners (d,) [µm] of the box around cells."""
    points = np.concatenate([outline(cell) + [float(x.split()[0]) for x in cell["centre"]] for cell in cells])
    return points.min(axis=0), points.max(axis=0)
