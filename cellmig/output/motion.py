"""How cells move: speeds, indices, mean square displacement, persistence and correlations, from their tracks.

Positions x (c, n, k) [µm] are of c cells at n times with equal intervals dt, along the k axes of the substrate: one as
seen from the side, two in space.  Times have any unit; speeds have that of dt.  Another interval is another selection
of samples: `x[:, ::m]` with m dt.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import erf, i0e, i1e

SHORTEST, LONGEST = 0.05, 30.0  # persistence that a fit can tell, over the shortest and the longest lag


def speeds(x: np.ndarray, dt: float) -> np.ndarray:
    """Speeds (c, n - 1) [µm per unit of time]: way from sample to sample over the interval."""
    return np.linalg.norm(np.diff(x, axis=1), axis=2) / dt


def path(x: np.ndarray) -> np.ndarray:
    """Accumulated distance (c,) [µm]: the sum of the ways from sample to sample."""
    return np.linalg.norm(np.diff(x, axis=1), axis=2).sum(axis=1)


def net(x: np.ndarray) -> np.ndarray:
    """Euclidean distance (c,) [µm] from the first sample to the last."""
    return np.linalg.norm(x[:, -1] - x[:, 0], axis=1)


def forward_index(x: np.ndarray, axis: int = 0) -> np.ndarray:
    """Forward migration index (c,) [-]: displacement along an axis over accumulated distance; nan of a cell at rest.

    The mean over cells is the FMI of ibidi's Chemotaxis and Migration Tool; along the gradient of a chemical it is the
    chemotactic index (McCutcheon 1946, Physiol. Rev. 26:319-336).
    """
    return _ratio(x[:, -1, axis] - x[:, 0, axis], path(x))


def directionality(x: np.ndarray) -> np.ndarray:
    """Euclidean over accumulated distance (c,) [-], the directness of ibidi; nan of a cell at rest."""
    return _ratio(net(x), path(x))


def directionality_by_lag(x: np.ndarray, lags: Sequence[int]) -> np.ndarray:
    """Mean directionality (c, lags) [-] of all stretches of a track of `lags` intervals.

    It falls with the lag, the faster the less persistent a cell is; at one lag it depends on speed and interval
    (Gorelik & Gautreau 2014, Nat. Protoc. 9:1931-1943).
    """
    way = np.cumsum(np.pad(np.linalg.norm(np.diff(x, axis=1), axis=2), ((0, 0), (1, 0))), axis=1)
    ratios = [_ratio(np.linalg.norm(x[:, m:] - x[:, :-m], axis=2), way[:, m:] - way[:, :-m]) for m in lags]
    return np.stack([_mean(ratio) for ratio in ratios], axis=1)


def mean_cosine(x: np.ndarray, axis: int = 0) -> np.ndarray:
    """Mean of cos φ of the steps (c,) [-], φ being the angle between a step and the axis; nan of a cell at rest."""
    step = np.diff(x, axis=1)
    return _mean(_ratio(step[:, :, axis], np.linalg.norm(step, axis=2)))


def msd(x: np.ndarray, lags: Sequence[int]) -> np.ndarray:
    """Mean square displacement (c, lags) [µm²] of each cell over all pairs of samples `lags` intervals apart."""
    ways = (x[:, m:] - x[:, :-m] for m in lags)
    return np.stack([np.square(way).sum(axis=2).mean(axis=1) for way in ways], axis=1)


def mean_and_error(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean over cells of values (c, ...) and its standard error; what is not finite is left out, nan without values."""
    count = np.isfinite(values).sum(axis=0)
    mean = _mean(values, axis=0)
    square = np.where(np.isfinite(values), (values - mean) ** 2, 0.0).sum(axis=0)
    return mean, np.sqrt(_ratio(square, count * (count - 1.0)))


# ------------------------------------------------------------------------------------------------------- persistence


@dataclass(frozen=True)
class Persistence:
    """Persistent random motion in `components` dimensions: root mean square speed, persistence time, their errors.

    time : inf of tracks as straight as can be told, 0 of tracks without any persistence, whose speed is nan.
    """

    speed: float
    time: float
    speed_error: float
    time_error: float
    components: int

    @property
    def diffusivity(self) -> float:
        """v² τ / k, with which the mean square displacement grows as 2 k D t [µm² per unit of time]; nan if unknown."""
        known = 0.0 < self.time < np.inf
        return self.speed**2 * self.time / self.components if known else np.nan


def persistent(t: np.ndarray, speed: float, time: float) -> np.ndarray:
    """Mean square displacement 2 v² τ (t - τ (1 - exp(-t/τ))) [µm²] after t; v, τ : rms speed and persistence time.

    It holds in any number of dimensions for every velocity whose correlation falls as exp(-t/τ): Ornstein-Uhlenbeck,
    telegraph, or rotational diffusion (Fürth 1920, Z. Phys. 2:244-256).
    """
    y = np.asarray(t) / time
    return 2.0 * (speed * time) ** 2 * (y + np.expm1(-y))


def fit_persistence(t: np.ndarray, squares: np.ndarray, components: int) -> Persistence:
    """Fit `persistent` to the mean over cells of mean square displacements (c, lags) [µm²] at lags t (lags,).

    Least squares of logarithms, weighted by 1/t, as the error of a long lag grows with √t; errors by leaving out one
    cell at a time (jackknife), nan of one cell, since errors of different lags are not independent.
    """
    speed, time = _fit(t, squares.mean(axis=0))
    count = len(squares)
    others = [_fit(t, np.delete(squares, cell, axis=0).mean(axis=0)) for cell in range(count if count > 1 else 0)]
    errors = np.full(2, np.nan)
    if others and np.isfinite(others).all():
        errors = np.sqrt((count - 1) * np.var(others, axis=0))
    return Persistence(speed, time, float(errors[0]), float(errors[1]), components)


def _fit(t: np.ndarray, square: np.ndarray) -> tuple[float, float]:
    """Speed and persistence of mean square displacements (lags,); (0, nan) of what is at rest, nan of one lag."""
    if not square.max(initial=0.0) > 0.0:
        return 0.0, np.nan
    if len(t) < 2 or not square.min() > 0.0:
        return np.nan, np.nan
    from scipy.optimize import minimize_scalar  # takes a while, and few runs are long enough for a fit

    weight = 1.0 / t / (1.0 / t).sum()

    def misfit(log_time: float) -> tuple[float, float]:
        """Weighted variance of the logarithm of data over model, and log v² at the best speed."""
        left = np.log(square / persistent(t, 1.0, np.exp(log_time)))
        mean = float(weight @ left)
        return float(weight @ (left - mean) ** 2), mean

    low, high = np.log(SHORTEST * t.min()), np.log(LONGEST * t.max())
    grid = np.linspace(low, high, 80)
    best = int(np.argmin([misfit(value)[0] for value in grid]))
    if best == 0:
        return np.nan, 0.0
    if best == len(grid) - 1:
        return float(np.exp(0.5 * misfit(high)[1])), np.inf
    found = minimize_scalar(lambda value: misfit(value)[0], bounds=(grid[best - 1], grid[best + 1]), method="bounded",
                            options={"xatol": 1e-8}).x
    return float(np.exp(0.5 * misfit(found)[1])), float(np.exp(found))


def index_of_bias(bias: np.ndarray, components: int) -> np.ndarray:
    """Mean of cos φ [-] of a polarity with Gaussian components of spread 1 and mean `bias` along the axis [-].

    From the side (one component) erf(b/√2), in the plane √(π/8) κ exp(-κ²/4) (I₀ + I₁)(κ²/4) with κ = √2 b, the spread
    of each component being 1/√2: <p²> = 1 in both.  Derived from the integral over the Gaussian.
    """
    b = np.asarray(bias, float)
    if components == 1:
        return erf(b / np.sqrt(2.0))
    half = 0.5 * b**2  # κ²/4; the scaled Bessel functions contain exp(-κ²/4)
    return np.sqrt(np.pi / 8.0) * np.sqrt(2.0) * b * (i0e(half) + i1e(half))


# ------------------------------------------------------------------------------------------------------- correlations


def order(v: np.ndarray) -> np.ndarray:
    """Polar order (n,) [-] of velocities (c, n, k): |Σ v/|v|| over the number of cells that move; nan if none does."""
    size = np.linalg.norm(v, axis=2, keepdims=True)
    moving = size > 0.0
    total = np.linalg.norm(np.where(moving, v / np.where(moving, size, 1.0), 0.0).sum(axis=0), axis=1)
    return _ratio(total, moving.sum(axis=(0, 2)))


def correlation_in_time(v: np.ndarray, lags: Sequence[int]) -> np.ndarray:
    """Correlation <δv(t) δv(t + lag)> / <δv²> (lags,) [-] of velocities (c, n, k), δv = v without the mean of all."""
    apart = v - v.mean(axis=(0, 1))
    n = v.shape[1]
    found = [np.mean((apart[:, m:] * apart[:, : n - m]).sum(axis=2)) for m in lags]
    return _ratio(np.array(found), np.full(len(found), np.square(apart).sum(axis=2).mean()))


def correlation_in_space(x: np.ndarray, v: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Correlation <δv(x) δv(x + r)> / <δv²> (bins,) [-] by distance, δv = v without the mean of all cells at the time.

    x, v : positions and velocities (c, n, k);  edges : of the bins of the distance (bins + 1,) [µm].  A bin without
    pairs is nan (as in Petitjean et al. 2010, Biophys. J. 98:1790-1800).
    """
    apart = v - v.mean(axis=0)
    one, two = np.triu_indices(len(x), 1)
    distance = np.linalg.norm(x[one] - x[two], axis=2).ravel()
    product = (apart[one] * apart[two]).sum(axis=2).ravel()
    bins = np.searchsorted(edges, distance, side="right") - 1
    inside = (bins >= 0) & (bins < len(edges) - 1)
    sums, counts = (np.bincount(bins[inside], weights, len(edges) - 1)
                    for weights in (product[inside], np.ones(inside.sum())))
    return _ratio(_ratio(sums, counts), np.full(len(sums), np.square(apart).sum(axis=2).mean()))


def decay_length(r: np.ndarray, correlation: np.ndarray) -> float:
    """The first r at which a correlation, 1 at r = 0 and linear between its values, is 1/e; nan if it stays above."""
    known = np.isfinite(correlation) & (np.asarray(r) > 0.0)
    at, value = np.append(0.0, np.asarray(r)[known]), np.append(1.0, correlation[known])
    below = np.flatnonzero(value <= np.exp(-1.0))
    if not len(below):
        return np.nan
    k = below[0]
    return float(at[k - 1] + (at[k] - at[k - 1]) * (value[k - 1] - np.exp(-1.0)) / (value[k - 1] - value[k]))


def _ratio(above: np.ndarray, below: np.ndarray) -> np.ndarray:
    """Quotient, nan where the divisor is not above zero."""
    below = np.asarray(below, float)
    return np.where(below > 0.0, above / np.where(below > 0.0, below, 1.0), np.nan)


def _mean(values: np.ndarray, axis: int = 1) -> np.ndarray:
    """Mean of the finite values along an axis, nan without any."""
    there = np.isfinite(values)
    return _ratio(np.where(there, values, 0.0).sum(axis=axis), there.sum(axis=axis))
