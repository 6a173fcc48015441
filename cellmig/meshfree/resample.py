"""Particles along an outline, whatever points it comes with: few corners, a fine curve, noise, pixels of a picture."""

from __future__ import annotations

import numpy as np

from . import polygons

CORNER = np.radians(30.0)  # an outline that turns by more has a corner there, in which a particle is put
ROUGH = np.radians(90.0)  # and one that turns by more to and fro within a spacing is rough there
LOOKS = 16  # per spacing, at which an outline is looked at


def along(polygon: np.ndarray, h: float, fixed: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Points about `h` apart on an outline (m, 2), and the edges of it on which the middles between them lie (m,) int.

    They are in the `fixed` corners (int), in the others that are sharp as seen from h away, as far as these are apart,
    and evenly between.  Where the outline is rough, as one around pixels, they are as far apart as they seem, and where
    it is in the mean.
    """
    curve = _Curve(polygon, h)
    ends = _ends(curve, h, [] if fixed is None else curve.arc[fixed].tolist())
    s = np.concatenate([_evenly(curve, start, end, h, 1 if len(ends) > 2 else 3)
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
        n = max(4, round(self.length / h))
        seen = polygons.sides(self.at(self.length * np.arange(n) / n)).sum()
        self.reach = min(0.5 * h * self.length / seen, 0.25 * self.length)  # way that gets on by half a spacing
        self._turned = np.concatenate([[0.0], np.cumsum(np.tile(self.turn, 3))])
        self._to_and_fro = np.concatenate([[0.0], np.cumsum(np.tile(np.abs(self.turn), 3))])
        self._thrice = np.concatenate([self.arc - self.length, self.arc, self.arc + self.length])

    def at(self, s: np.ndarray) -> np.ndarray:
        """Points of the outline (n, 2)."""
        return np.column_stack([np.interp(s % self.length, self.ends, self.closed[:, k]) for k in range(2)])

    def mean(self, s: np.ndarray) -> np.ndarray:
        """Points of the outline (n, 2), or the mean over a spacing where it is rough."""
        points = self.at(s)
        a, b = (np.searchsorted(self._thrice, s % self.length + side) for side in (-self.reach, self.reach))
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
    order = np.argsort(-far.round(6), kind="stable")  # corners alike in the order in which they come
    for s in here[order][far[order] > CORNER]:
        apart = np.abs(np.array(kept) - s)
        if (np.minimum(apart, curve.length - apart) > 0.5 * h).all():
            kept.append(float(s))
    # Without any, in the lowest point, where a cell touches first.
    return sorted(kept) or [float(curve.arc[curve.polygon[:, 1].argmin()])]


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
