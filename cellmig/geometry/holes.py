"""Holes of shapes: circles and polygons inside the outline."""

from __future__ import annotations

from typing import Any

import numpy as np

from . import polygons

FINE = 2000  # corners of the polygon that represents a circle or an ellipse


def loops(shape: Any) -> list[np.ndarray]:
    """Holes of a shape as clockwise polygons, (k, 2) each [µm]: the circles, then the others."""
    round_ones = [np.array([x, y]) + r * polygons.circle(FINE) for x, y, r in shape.holes]
    others = [_simplified(corners) for corners in shape.cutouts]
    return [p[::-1] for p in (*round_ones, *others)]


def check(shape: Any, border: np.ndarray) -> None:
    """Check the holes of a shape with the outer loop `border` (k, 2) [µm].

    Raises ValueError for one that has no area, or reaches the outline or another; the message is for the user.
    """
    for n, (x, y, r) in enumerate(shape.holes):
        middle = np.array([[x, y]])
        if not (r > 0.0 and polygons.inside(middle, border) and polygons.distance(middle, border) > r):
            raise ValueError(f"holes: that at ({x:.4g}, {y:.4g}) um is not inside the outline")
        for a, b, s in shape.holes[:n]:
            if np.hypot(x - a, y - b) <= r + s:
                raise ValueError(f"holes: those at ({a:.4g}, {b:.4g}) um and ({x:.4g}, {y:.4g}) um overlap")
    for n, corners in enumerate(shape.cutouts):
        p = _simplified(corners)
        at = " at ({:.4g}, {:.4g}) um".format(*corners[0]) if corners else ""
        name = f"cutouts: that of {len(corners)} corners{at}"
        if len(p) > 3 and polygons.crossing(p) is not None:
            raise ValueError(f"{name} crosses or touches itself")
        if len(p) < 3 or polygons.is_flat(p):
            raise ValueError(f"{name} has no area")
        if not polygons.inside(p, border).all() or polygons.touch(p, border):
            raise ValueError(f"{name} is not inside the outline")
        before = loops(shape)[: len(shape.holes) + n]
        if any(polygons.touch(p, q) or polygons.inside(p[:1], q)[0] or polygons.inside(q[:1], p)[0] for q in before):
            raise ValueError(f"{name} and another hole overlap")


def _simplified(corners: tuple) -> np.ndarray:
    """The corners of a hole that bound its area, counterclockwise (k, 2) [µm]."""
    return polygons.simplified(np.array(corners).reshape(-1, 2))
