"""Sums over all ranks whose bits depend neither on the partition nor on the order of the terms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mpi4py import MPI

_BITS = 30  # bits of a limb: three limbs hold 90 bits below the largest value, and 2³³ values can be added


def exact_sum(comm: MPI.Comm, values: Any, group: np.ndarray | None = None, groups: int = 1) -> np.ndarray:
    """Sum over the ranks and the first axis; collective.

    Parameters
    ----------
    values : (n, ...) -- in any unit.
    group : (n,) int -- group of each value, from 0; None for a single sum.
    groups : int -- number of groups, which is small: of many see `exact_sums`.

    Returns
    -------
    (...), or (groups, ...) with a group -- NaN if a value is not finite.

    Source: fixed-point accumulation (as Demmel & Nguyen 2015): values are split into integer multiples of powers of
    two, and integers are added, which is associative.
    """
    values = np.asarray(values, float)
    flat = values.reshape(len(values), math.prod(values.shape[1:]))
    shape = values.shape[1:] if group is None else (groups, *values.shape[1:])
    exponent = _exponents(comm, flat)
    if exponent is None:
        return np.full(shape, np.nan)
    present, order, start = _groups(np.broadcast_to(0, len(flat)) if group is None else group)
    limbs = np.zeros((3, groups, flat.shape[1]), np.int64)
    limbs[:, present] = _limbs(flat, exponent, order, start)
    comm.Allreduce(MPI.IN_PLACE, limbs, MPI.SUM)
    return _rounded(limbs, exponent).reshape(shape)


def exact_sums(comm: MPI.Comm, values: np.ndarray, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Sums over the ranks by keys, of which each rank has some; collective.

    Parameters
    ----------
    values : (n, c) -- in any unit.
    keys : (n,) or (n, m) int -- of each value.

    Returns
    -------
    (g,) or (g, m) int and (g, c), or None -- on rank 0 the distinct keys, ascending, and the sums, NaN if a value is
    not finite, of the same bits as `exact_sum`; None on other ranks.
    """
    of_rank, order, start = _groups(keys)
    exponent = _exponents(comm, values)
    own = np.zeros((3, 0, 0), int) if exponent is None else _limbs(values, exponent, order, start)
    parts = comm.gather((of_rank, own))
    if parts is None:
        return None
    every, number = np.unique(np.concatenate([found for found, _ in parts]), axis=0, return_inverse=True)
    if exponent is None:
        return every, np.full((len(every), values.shape[1]), np.nan)
    limbs = np.zeros((3, len(every), values.shape[1]), np.int64)
    ends = np.cumsum([len(found) for found, _ in parts])[:-1]
    for at, (_, some) in zip(np.split(number.ravel(), ends), parts, strict=True):
        limbs[:, at] += some
    return every, _rounded(limbs, exponent)


def _exponents(comm: MPI.Comm, values: np.ndarray) -> np.ndarray | None:
    """Exponents (c,) int of the largest of values (n, c) of all ranks; None where one is not finite; collective."""
    top = np.abs(values).max(axis=0, initial=0.0)
    top = np.where(np.isnan(top), np.inf, top)
    comm.Allreduce(MPI.IN_PLACE, top, MPI.MAX)
    top = np.maximum(top, 1e-200)  # all units of the limbs are normal numbers
    return np.frexp(top)[1] if np.isfinite(top).all() else None


def _groups(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray | slice, np.ndarray]:
    """Distinct keys (g,) or (g, m) int of `keys` (n,) or (n, m) int, ascending; an order (n,) int in which equal ones
    follow each other, and where each begins in it (g,) int.
    """
    if keys.ndim == 1 and (keys[1:] >= keys[:-1]).all():  # as those of cells
        start = np.flatnonzero(np.diff(keys, prepend=keys[:1] - 1))
        return keys[start], slice(None), start
    distinct, group = np.unique(keys, axis=0, return_inverse=True)
    order = np.argsort(group.ravel(), kind="stable")
    return distinct, order, np.searchsorted(group.ravel()[order], np.arange(len(distinct)))


def _limbs(values: np.ndarray, exponent: np.ndarray, order: np.ndarray | slice, start: np.ndarray) -> np.ndarray:
    """Sums (3, g, c) int of the limbs of values (n, c), of any unit, by groups that begin at `start` (g,) int in an
    `order` (n,) int.
    """
    limbs = np.zeros((3, len(start), values.shape[1]), np.int64)
    for k in range(values.shape[1] if len(values) else 0):  # one column at a time saves memory
        rest = values[order, k].copy()
        for i in range(3):
            unit = int(exponent[k]) - _BITS * (i + 1)
            whole = np.rint(rest * math.ldexp(1.0, -unit))
            limbs[i, :, k] = np.add.reduceat(whole.astype(np.int64), start)
            rest -= whole * math.ldexp(1.0, unit)
    return limbs


def _rounded(limbs: np.ndarray, exponent: np.ndarray) -> np.ndarray:
    """Values (g, c) of limbs (3, g, c) int."""
    exact = [(int(a) << 2 * _BITS) + (int(b) << _BITS) + int(c) for a, b, c in limbs.reshape(3, -1).T]
    powers = np.tile(exponent - 3 * _BITS, limbs.shape[1])
    return np.array([math.ldexp(w, int(e)) for w, e in zip(exact, powers, strict=True)]).reshape(limbs.shape[1:])


def global_maximum(comm: MPI.Comm, values: np.ndarray) -> np.ndarray:
    """Elementwise maximum of `values` (n, ...), in any unit, over the ranks; NaN counts as infinite; collective."""
    values = np.where(np.isnan(values), np.inf, values)
    comm.Allreduce(MPI.IN_PLACE, values, MPI.MAX)
    return values


def largest(comm: MPI.Comm, values: np.ndarray) -> float:
    """Largest magnitude of `values` (n, ...) of all ranks, in any unit; 0 without any, infinite for NaN; collective."""
    return float(global_maximum(comm, np.array([np.abs(values).max(initial=0.0)]))[0])
