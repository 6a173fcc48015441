"""Particles along an outline, whatever points it comes with: few corners, a fine curve, noise, pixels of a picture."""

from __future__ import annotations

import numpy as np

from . import polygons

CORNER = np.radians(30.0) + 1e-6  # an outline that turns by more has a corner there, in which a particle is put
ROUGH = np.radians(90.0) + 1e-6  # and one that turns by more to and fro within a spacing is rough there
ALIKE = 1e-6  # angles [rad] and heights [spacings] that differ by less are the same
LOOKS = 16  # per spacing, at which an outline is looked at


def along(polygon: np.ndarray, h: float, fixed: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Points about `h` apart on an outline (m, 2), and the edges of it on which the middles between them lie (m,) int.

    They are in the `fixed` corners (int), in the others that are sharp as seen from h away, as far as these are apart,
    and evenly between.  Where the outline is rough, as one around pixels, they are as far apart as they seem, and where
    it is in the mean.
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
    """An outline by the length of way along it, s [µm]: `arc` at its corners (k,), `ends` with that at its end."""

    def __init__(self, polygon: np.ndarray, h: float):
        self.polygon = polygon
        self.closed = np.concatenate([polygon, polygon[:1]])
        self.ends = np.concatenate([[0.0], np.cumsum(polygons.sides(polygon))])
        self.arc, self.length = self.ends[:-1], self.ends[-1]
        self.turn = _turn(polygon - np.roll(polygon, 1, axis=0), np.roll(polygon, -1, axis=0) - polygon)
        step, side = self.length / max(4, round(self.length / h)), np.diff(self.ends)
        gain = sum(np.linalg.norm(self.at(self.arc + way) - polygon, axis=1) for way in (-step, step))
        seen = 0.25 * gain @ (side + np.roll(side, 1)) / (step * self.length)  # of the way, in such steps
        self.reach = min(0.5 * h / seen, 0.25 * self.length)  # way that gets on by half a spacing
        self._turned = np.concatenate([[0.0], np.cumsum(np.tile(self.turn, 3))])
        self._to_and_fro = np.concatenate([[0.0], np.cumsum(np.tile(np.abs(self.turn), 3))])
        self._thrice = np.concatenate([self.arc - self.length, self.arc, self.arc + self.length])

    def at(self, s: np.ndarray) -> np.ndarray:
        """Points of the outline (n, 2)."""
        return np.column_stack([np.interp(s % self.length, self.ends, self.closed[:, k]) for k in range(2)])

    def mean(self, s: np.ndarray) -> np.ndarray:
        """Points of the outline (n, 2), or the mean over a spacing where it is rough."""
        points = self.at(s)
        s, margin = s % self.length, 1e-9 * self.length  # corners at either end are within
        a = np.searchsorted(self._thrice, s - self.reach - margin)
        b = np.searchsorted(self._thrice, s + self.reach + margin)
        excess = self._to_and_fro[b] - self._to_and_fro[a] - np.abs(self._turned[b] - self._turned[a])
        rough = excess > ROUGH
        around = s[rough, None] + self.reach * (np.arange(LOOKS) + 0.5 - 0.5 * LOOKS) / (0.5 * LOOKS)
        points[rough] = self.at(around.ravel()).reshape(-1, LOOKS, 2).mean(axis=1)
        return points


def _ends(curve: _Curve, h: float, kept: list[float]) -> list[float]:
    """Where along the outline a particle has to be: what is kept anyway, and the sharpest corners first."""
    here, reach = curve.arc[np.abs(curve.turn) > CORNER], min(2.0 * curve.reach, 0.25 * curve.length)
    middle = curve.mean(here)
    far = np.abs(_turn(middle - curve.mean(here - reach), curve.mean(here + reach) - middle))
    here, far = here[far > CORNER], far[far > CORNER]
    order = np.argsort(-far, kind="stable")
    for alike in np.split(order, np.flatnonzero(np.diff(-far[order]) > ALIKE) + 1):
        kept += _apart(here[alike], kept, 0.5 * h, curve.length)
    if not kept:  # in the lowest point, where a cell touches first, or at both ends of a flat sole
        height = curve.polygon[:, 1] - curve.polygon[:, 1].min()
        kept += _apart(curve.arc[height < ALIKE * h], [], 0.5 * h, curve.length)
    return sorted(kept)


def _apart(places: np.ndarray, kept: list[float], least: float, length: float) -> list[float]:
    """Of places alike along an outline those that are further than `least` from others: of a crowd its two ends.

    Those near what is `kept` are left out; a crowd that is no wider than `least` becomes one in its middle.
    """
    apart = np.abs(places[:, None] - np.array(kept)[None])
    s = np.sort(places[(np.minimum(apart, length - apart) > least).all(axis=1)])
    gap = np.diff(s, append=s[:1] + length)  # to the next one
    last = np.flatnonzero(gap > least)
    found: list[float] = []
    for before, end in zip(np.roll(last, 1), last, strict=True):
        begin, width = s[(before + 1) % len(s)], (s[end] - s[(before + 1) % len(s)]) % length
        found += [begin, s[end]] if width > least else [(begin + 0.5 * width) % length]
    return [float(place) for place in found]


def _turn(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Angle from directions (k, 2) before to those after, to the left."""
    return np.arctan2(polygons.cross(before, after), (before * after).sum(axis=1))


def _evenly(curve: _Curve, start: float, end: float, h: float, least: int) -> np.ndarray:
    """Places from one end to before the other, about `h` apart as seen from h away, but no fewer than `least`."""
    s = np.linspace(start, end, LOOKS * int(np.ceil((end - start) / h)) + 1)
    a, b = np.maximum(s - 0.5 * h, start), np.minimum(s + 0.5 * h, end)
    gain = np.linalg.norm(curve.mean(b) - curve.mean(a), axis=1) / (b - a)
    way = np.concatenate([[0.0], np.cumsum(0.5 * (gain[1:] + gain[:-1]) * np.diff(s))])
    n = max(least, round(way[-1] / h))
    return np.interp(way[-1] * np.arange(n) / n, way, s)
