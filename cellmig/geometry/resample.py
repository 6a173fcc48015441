"""Particles along a closed outline, which may have few corners, be a fine curve, be noisy or follow pixels.

The curve is looked at on the scale of the spacing h: turns within h, to and fro, are roughness and averaged; a turn
that remains on that scale is a corner, and a particle is put there.
"""

from __future__ import annotations

import numpy as np

from . import polygons

CORNER = np.radians(30.0) + 1e-6  # a turn by more is a corner [rad]
ROUGH = np.radians(90.0) + 1e-6  # a curve that turns to and fro by more within a spacing is rough [rad]
EQUAL = 1e-6  # angles [rad] and heights [spacings] that differ by less are equal
SAMPLES = 16  # points per spacing at which the curve is sampled


def resample(polygon: np.ndarray, h: float, fixed: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Points on a closed curve, in its corners and evenly spaced between them.

    Parameters
    ----------
    polygon : (k, 2) -- the curve [µm].
    h : float -- wanted distance between points [µm], measured along the averaged curve where the curve is rough.
    fixed : (c,) int -- corners of the polygon that are points in any case.

    Returns
    -------
    points : (m, 2) -- positions along the curve [µm].
    edge : (m,) int -- edge of the polygon half-way between each point and the next.

    Source: derived here, see the head of this module.
    """
    curve = _Curve(polygon, h)
    ends = _ends(curve, h, [] if fixed is None else curve.arc[fixed].tolist())
    least = 1 if len(ends) > 2 or curve.length > 6.0 * h else 3
    s = np.concatenate([_evenly(curve, start, end, h, least)
                        for start, end in zip(ends, [*ends[1:], ends[0] + curve.length], strict=True)])
    middle = 0.5 * (s + np.append(s[1:], s[0] + curve.length))
    points = curve.mean(s)
    if fixed is not None:
        points[np.isin(s, curve.arc[fixed])] = polygon[fixed][np.argsort(curve.arc[fixed], kind="stable")]
    return points, np.searchsorted(curve.ends, middle % curve.length, side="right") - 1


class _Curve:
    """A closed curve by its arc length s [µm]: `arc` (k,) at its corners, `ends` (k + 1,) with the whole length."""

    def __init__(self, polygon: np.ndarray, h: float):
        self.polygon = polygon
        self.closed = np.concatenate([polygon, polygon[:1]])
        self.ends = np.concatenate([[0.0], np.cumsum(polygons.sides(polygon))])
        self.arc, self.length = self.ends[:-1], self.ends[-1]
        self.turn = polygons.turn(polygon - np.roll(polygon, 1, axis=0), np.roll(polygon, -1, axis=0) - polygon)
        step, side = self.length / max(4, round(self.length / h)), np.diff(self.ends)
        gain = sum(np.linalg.norm(self.at(self.arc + way) - polygon, axis=1) for way in (-step, step))
        seen = 0.25 * gain @ (side + np.roll(side, 1)) / (step * self.length)  # mean chord over arc, at steps of h
        self.reach = min(0.5 * h / seen, 0.25 * self.length)  # arc of which the chord is h/2
        self._turned = np.concatenate([[0.0], np.cumsum(np.tile(self.turn, 3))])
        self._to_and_fro = np.concatenate([[0.0], np.cumsum(np.tile(np.abs(self.turn), 3))])
        self._thrice = np.concatenate([self.arc - self.length, self.arc, self.arc + self.length])

    def at(self, s: np.ndarray) -> np.ndarray:
        """Points of the curve (n, 2) [µm] at arc lengths s (n,) [µm]."""
        return np.column_stack([np.interp(s % self.length, self.ends, self.closed[:, k]) for k in range(2)])

    def mean(self, s: np.ndarray) -> np.ndarray:
        """Points (n, 2) [µm] at arc lengths s (n,) [µm]; where the curve is rough, its mean over a spacing."""
        points = self.at(s)
        s, margin = s % self.length, 1e-9 * self.length  # the interval is closed: corners at its ends count
        a = np.searchsorted(self._thrice, s - self.reach - margin)
        b = np.searchsorted(self._thrice, s + self.reach + margin)
        excess = self._to_and_fro[b] - self._to_and_fro[a] - np.abs(self._turned[b] - self._turned[a])
        rough = excess > ROUGH
        around = s[rough, None] + self.reach * (np.arange(SAMPLES) + 0.5 - 0.5 * SAMPLES) / (0.5 * SAMPLES)
        points[rough] = self.at(around.ravel()).reshape(-1, SAMPLES, 2).mean(axis=1)
        return points


def _ends(curve: _Curve, h: float, fixed: list[float]) -> list[float]:
    """Arc lengths at which there has to be a particle: the `fixed` ones, and the corners, sharpest first."""
    here, reach = curve.arc[np.abs(curve.turn) > CORNER], min(2.0 * curve.reach, 0.25 * curve.length)
    middle = curve.mean(here)
    far = np.abs(polygons.turn(middle - curve.mean(here - reach), curve.mean(here + reach) - middle))
    here, far = here[far > CORNER], far[far > CORNER]
    order = np.argsort(-far, kind="stable")
    for equal in np.split(order, np.flatnonzero(np.diff(-far[order]) > EQUAL) + 1):
        fixed += _apart(here[equal], fixed, 0.5 * h, curve.length)
    if not fixed:  # the lowest point, where a cell touches the substrate first, or both ends of a flat bottom
        height = curve.polygon[:, 1] - curve.polygon[:, 1].min()
        fixed += _apart(curve.arc[height < EQUAL * h], [], 0.5 * h, curve.length)
    return sorted(fixed)


def _apart(arcs: np.ndarray, fixed: list[float], least: float, length: float) -> list[float]:
    """Those of equally sharp corners, at the arc lengths `arcs`, that are further than `least` from the `fixed` ones.

    A cluster of corners that are closer than `least` is replaced by its two ends, or its middle if it is no wider.
    """
    apart = np.abs(arcs[:, None] - np.array(fixed)[None])
    s = np.sort(arcs[(np.minimum(apart, length - apart) > least).all(axis=1)])
    gap = np.diff(s, append=s[:1] + length)  # to the next one
    last = np.flatnonzero(gap > least)
    found: list[float] = []
    for before, end in zip(np.roll(last, 1), last, strict=True):
        begin, width = s[(before + 1) % len(s)], (s[end] - s[(before + 1) % len(s)]) % length
        found += [begin, s[end]] if width > least else [(begin + 0.5 * width) % length]
    return [float(arc) for arc in found]


def _evenly(curve: _Curve, start: float, end: float, h: float, least: int) -> np.ndarray:
    """Arc lengths from `start` to before `end`, `h` apart along the averaged curve, but no fewer than `least`."""
    s = np.linspace(start, end, SAMPLES * int(np.ceil((end - start) / h)) + 1)
    a, b = np.maximum(s - 0.5 * h, start), np.minimum(s + 0.5 * h, end)
    gain = np.linalg.norm(curve.mean(b) - curve.mean(a), axis=1) / (b - a)
    way = np.concatenate([[0.0], np.cumsum(0.5 * (gain[1:] + gain[:-1]) * np.diff(s))])
    n = max(least, round(way[-1] / h))
    return np.interp(way[-1] * np.arange(n) / n, way, s)
