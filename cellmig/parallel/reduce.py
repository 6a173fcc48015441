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
    groups : int -- number of groups.

    Returns
    -------
    (...), or (groups, ...) with a group -- NaN if a value is not finite.

    Source: fixed-point accumulation (as Demmel & Nguyen 2015): values are split into integer multiples of powers of
    two, and integers are added, which is associative.
    """
    values = np.asarray(values, float)
    flat = values.reshape(len(values), math.prod(values.shape[1:]))
    top = np.abs(flat).max(axis=0, initial=0.0)
    top = np.where(np.isnan(top), np.inf, top)
    comm.Allreduce(MPI.IN_PLACE, top, MPI.MAX)
    shape = values.shape[1:] if group is None else (groups, *values.shape[1:])
    top = np.maximum(top, 1e-200)  # all units of the limbs are normal numbers
    if not np.isfinite(top).all():
        return np.full(shape, np.nan)
    exponent = np.frexp(top)[1]
    group = np.zeros(len(flat), np.intp) if group is None else group
    order = np.argsort(group, kind="stable")
    present, start = np.unique(group[order], return_index=True)
    limbs = np.zeros((3, groups, flat.shape[1]), np.int64)
    for k in range(flat.shape[1] if len(flat) else 0):  # one column at a time saves memory
        rest = flat[order, k]
        for i in range(3):
            unit = int(exponent[k]) - _BITS * (i + 1)
            whole = np.rint(rest * math.ldexp(1.0, -unit))
            limbs[i, present, k] = np.add.reduceat(whole.astype(np.int64), start)
            rest -= whole * math.ldexp(1.0, unit)
    comm.Allreduce(MPI.IN_PLACE, limbs, MPI.SUM)
    exact = [(int(a) << 2 * _BITS) + (int(b) << _BITS) + int(c) for a, b, c in limbs.reshape(3, -1).T]
    powers = np.tile(exponent - 3 * _BITS, groups)
    return np.array([math.ldexp(w, int(e)) for w, e in zip(exact, powers, strict=True)]).reshape(shape)


def global_maximum(comm: MPI.Comm, values: np.ndarray) -> np.ndarray:
    """Elementwise maximum of `values` (n, ...), in any unit, over the ranks; NaN counts as infinite; collective."""
    values = np.where(np.isnan(values), np.inf, values)
    comm.Allreduce(MPI.IN_PLACE, values, MPI.MAX)
    return values


def largest(comm: MPI.Comm, values: np.ndarray) -> float:
    """Largest magnitude of `values` (n, ...) of all ranks, in any unit; 0 without any, infinite for NaN; collective."""
    return float(global_maximum(comm, np.array([np.abs(values).max(initial=0.0)]))[0])
