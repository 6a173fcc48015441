"""Particles along an outline, whatever points it comes with: few corners, a fine curve, or the pixels of a picture."""

from __future__ import annotations

import numpy as np

from . import polygons

CORNER = np.radians(30.0)  # an outline that turns by more has a corner there, in which a particle is put
LOOKS = 16  # per spacing, at which it is measured how fast the outline gets on


def along(polygon: np.ndarray, h: float, fixed: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Points about `h` apart on an outline (m, 2), and the edges of it on which the middles between them lie (m,) int.

    They are in the `fixed` corners (int), in the others that are sharp as seen from h away, as far as these are apart,
    and evenly between: where an outline is rough, as one around pixels, they are as far apart as they seem.
    """
    closed = np.concatenate([polygon, polygon[:1]])
    arc = np.concatenate([[0.0], np.cumsum(polygons.sides(polygon))])

    def at(s: np.ndarray) -> np.ndarray:
        return np.column_stack([np.interp(s % arc[-1], arc, closed[:, k]) for k in range(2)])

    ends = _ends(polygon, arc[:-1], arc[-1], h, at, [] if fixed is None else arc[fixed].tolist())
    s = np.concatenate([_evenly(start, end, h, at, 1 if len(ends) > 2 else 3)
                        for start, end in zip(ends, [*ends[1:], ends[0] + arc[-1]], strict=True)])
    middle = 0.5 * (s + np.append(s[1:], s[0] + arc[-1]))
    return at(s), np.searchsorted(arc, middle % arc[-1], side="right") - 1


def _ends(polygon, arc: np.ndarray, total: float, h: float, at, kept: list[float]) -> list[float]:
    """Where along the outline a particle has to be: what is kept anyway, and the sharpest corners first."""
    near = _turn(polygon - np.roll(polygon, 1, axis=0), np.roll(polygon, -1, axis=0) - polygon)
    sharp = np.flatnonzero(near > CORNER)
    here, reach = arc[sharp], min(h, 0.25 * total)
    far = _turn(polygon[sharp] - at(here - reach), at(here + reach) - polygon[sharp])
    order = np.argsort(-far.round(6), kind="stable")  # corners alike in the order in which they come
    for s in here[order][far[order] > CORNER]:
        apart = np.abs(np.array(kept) - s)
        if (np.minimum(apart, total - apart) > 0.5 * h).all():
            kept.append(float(s))
    return sorted(kept) or [float(arc[polygon[:, 1].argmin()])]  # in the lowest point, where a cell touches first


def _turn(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Angle between directions (k, 2) before and after."""
    return np.abs(np.arctan2(polygons.cross(before, after), (before * after).sum(axis=1)))


def _evenly(start: float, end: float, h: float, at, least: int) -> np.ndarray:
    """Places from one end to before the other, about `h` apart as seen from h away, but no fewer than `least`."""
    s = np.linspace(start, end, LOOKS * int(np.ceil((end - start) / h)) + 1)
    a, b = np.maximum(s - 0.5 * h, start), np.minimum(s + 0.5 * h, end)
    gain = np.linalg.norm(at(b) - at(a), axis=1) / (b - a)
    way = np.concatenate([[0.0], np.cumsum(0.5 * (gain[1:] + gain[:-1]) * np.diff(s))])
    n = max(least, round(way[-1] / h))
    return np.interp(way[-1] * np.arange(n) / n, way, s)
