"""A tissue as a program for segmentation would give it: `.venv/bin/python tests/tissue.py > cases/tissue.csv`."""

from __future__ import annotations

import csv
import sys

import numpy as np
from scipy.spatial import Voronoi

PIXEL = 0.325  # µm: 6.5 µm on the camera behind an objective of 20


def seeds(rows: int, jitter: float, pitch: float = 11.0, seed: int = 60) -> np.ndarray:
    """Middles (n, 2) [µm] of a hexagonal patch of cells, each moved by up to `jitter` of the pitch."""
    at = [(pitch * (i + 0.5 * (j % 2)), pitch * np.sqrt(0.75) * j) for j in range(rows) for i in range(rows)]
    return np.array(at) + jitter * pitch * np.random.default_rng(seed).uniform(-1.0, 1.0, (rows * rows, 2))


def outlines(count: int, jitter: float = 0.22, pitch: float = 11.0) -> list[np.ndarray]:
    """Voronoi cells (k, 2) [µm] with rounded corners, the `count` ones nearest to the middle of a patch."""
    middles = seeds(int(np.sqrt(1.47 * count)) + 4, jitter, pitch)
    voronoi = Voronoi(middles)
    inner = np.argsort(np.linalg.norm(middles - middles.mean(axis=0), axis=1), kind="stable")[:count]
    found = []
    for cell in np.sort(inner):
        p = voronoi.vertices[voronoi.regions[voronoi.point_region[cell]]]
        p = p[np.argsort(np.arctan2(*(p - p.mean(axis=0)).T))]
        for _ in range(3):  # corner cutting of Chaikin (1974), by a sixth instead of a quarter
            q = np.roll(p, -1, axis=0)
            p = np.stack([p + (q - p) / 6.0, q - (q - p) / 6.0], axis=1).reshape(-1, 2)
        found.append(p)
    return found


def traced(p: np.ndarray, pixel: float = PIXEL) -> np.ndarray:
    """An outline (k, 2) [µm] as corners of pixels and half-way between them (m, 2) [pixels], y downwards."""
    q = np.concatenate([p, p[:1]]) / pixel
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])
    at = np.arange(0.0, arc[-1], 0.9)
    x = np.round(2.0 * np.column_stack([np.interp(at, arc, q[:, k]) for k in range(2)])) / 2.0
    x = x[(x != np.roll(x, 1, axis=0)).any(axis=1)]
    return x * [1.0, -1.0] + [0.0, 500.0]


def main() -> None:
    """Write 60 cells, of which each fifth is of another kind."""
    out = csv.writer(sys.stdout, lineterminator="\n")
    out.writerow(["cell", "x_px", "y_px", "kind"])
    for number, p in enumerate(outlines(60), 1):
        kind = "leader" if number % 5 == 0 else "follower"
        out.writerows([number, f"{x:g}", f"{y:g}", kind] for x, y in traced(p))


if __name__ == "__main__":
    main()
