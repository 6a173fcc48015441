"""Neighbours of a fluid's particles, found anew where it has been stretched: then it may flow without limit."""

from __future__ import annotations

import numpy as np

from ..geometry.polygons import cross
from ..meshfree.renewal import evened
from ..model.tensors import determinant
from ..parallel.reduce import exact_sum, global_maximum
from .mechanics import Mechanics
from .restart import restore, saved
from .step import NumericsError
from .strain import stretch


def stretched(m: Mechanics) -> np.ndarray:
    """Largest stretch of fluid in each cell since its neighbours were found (cells,) [-], as current as F; collective.

    1 where nothing flows.
    """
    flows = np.array([law.viscosity > 0.0 for law in m.scene.materials])[m.scene.material[m.ids]]
    most = np.ones(len(m.scene.kind))
    np.maximum.at(most, m.scene.cell[m.ids], np.where(flows, stretch(m.state.since_renewal()), 1.0))
    return global_maximum(m.comm, most)


def due(m: Mechanics) -> bool:
    """Whether a cell is stretched so far that its neighbours are to be found anew; collective."""
    return m.terms.renewal is not None and bool((stretched(m) > m.terms.renewal).any())


def renew(m: Mechanics, time: float) -> None:
    """Find the neighbours anew in the cells that are `due`; collective.

    Surfaces, masses, volumes, J and stresses of laws stay.  Particles of a fluid inside a cell move a little, to be
    more evenly spread, by amounts whose mean over the mass is zero, and take the velocity that is there; momentum and
    its moment stay.  A fluid keeps J alone of F, and a network its stress.  The energy of the elastic stabilisation
    begins at zero; that and the change of kinetic energy is `Mechanics.renewal_loss`.

    Raises NumericsError where particles have too few neighbours; `time` [µs] is for its message.
    """
    m.resume()
    cells = np.flatnonzero(stretched(m) > m.terms.renewal)
    m.rate()  # completes the work of the last step, with the forces of before
    before = _energy(m)
    about, arrays = saved(m)
    if m.comm.rank == 0:
        for c in cells.tolist():
            _move(m, arrays, c)
    try:
        restore(m, about, arrays)
    except ValueError as error:
        raise NumericsError.at(m, time, f"neighbours cannot be found anew: {error}", None,
                               "try finer particles, or numerics.renewal = \"never\"") from error
    m.renewals += 1
    m.renewal_loss += before - _energy(m)


def _energy(m: Mechanics) -> float:
    """Kinetic energy and that of the elastic stabilisation [pN]; collective."""
    kinetic = 0.5 * m.state.mass * (m.state.v**2).sum(axis=1) if m.terms.inertia else 0.0
    return float(exact_sum(m.comm, kinetic + m.stabilisation_energy()))


def _move(m: Mechanics, arrays: dict[str, np.ndarray], c: int) -> None:
    """Change the state of a cell in `arrays`, those of `saved` on rank 0, to that with other neighbours."""
    scene, on, d = m.scene, slice(*m.scene.offset[c : c + 2]), m.scene.dimension
    t, state = scene.templates[scene.kind[c]], arrays["particle state"][on]
    fluid = np.array([getattr(law, "fluid", False) for law in scene.materials])[scene.material[on]]
    F = arrays["particle F"][on].reshape(-1, d, d).transpose(0, 2, 1)
    J, x = determinant(F.transpose(1, 2, 0)), t.X + state[:, :d]
    loose = fluid.copy()
    loose[t.surface] = False
    by = _centred(evened(t, x, J, loose) - x, t.mass, loose)
    L = np.stack([g @ state[:, d:] for g in t.G], axis=2) @ np.linalg.inv(F)
    v = state[:, d:] + _centred(np.where(loose[:, None], np.einsum("nij,nj->ni", L, by), 0.0), t.mass, loose)
    v += _turn(t.mass * (cross(x, state[:, d:]) - cross(x + by, v)), x + by, t.mass, loose)
    state[:] = np.hstack([state[:, :d] + by, v])
    kept = np.where(fluid[:, None, None], J[:, None, None] ** (1.0 / d) * np.eye(d), F)
    if m.network is not None:  # b = F A Fᵀ stays
        A = arrays["particle network"][on].reshape(-1, d, d)
        change = np.linalg.solve(kept, F)
        arrays["particle network"][on] = (change @ A @ change.transpose(0, 2, 1)).reshape(-1, d * d)
    F = kept
    arrays["particle F"][on], arrays["particle bend"][on] = F.transpose(0, 2, 1).reshape(-1, d * d), 0.0
    arrays["neighbours x"][on], arrays["neighbours F"][on] = x + by, F


def _turn(moment: np.ndarray, x: np.ndarray, mass: np.ndarray, on: np.ndarray) -> np.ndarray:
    """Velocities (n, 2) [µm/µs] of the particles `on` (n,) bool, as of a rigid turn around their centre, that have the
    sum of the moments of momentum `moment` (n,) [pN µs].
    """
    away = _centred(np.where(on[:, None], x, 0.0), mass, on)
    inertia = mass @ (away**2).sum(axis=1)
    return moment.sum() / max(inertia, 1e-300) * np.column_stack([-away[:, 1], away[:, 0]])


def _centred(values: np.ndarray, mass: np.ndarray, on: np.ndarray) -> np.ndarray:
    """`values` (n, d) of any unit less their mean over the `mass` (n,) of those `on` (n,) bool, where these are."""
    if not on.any():
        return values
    return values - np.where(on[:, None], mass @ values / mass[on].sum(), 0.0)
