"""Neighbours of a fluid's particles, found anew where it has been stretched: then it may flow without limit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..geometry import polygons, triangles
from ..geometry.even_surface import spread
from ..meshfree.division import CROWDED, Division, divided, extremes, fluid
from ..meshfree.division_space import SurfaceDivision, divided_in_space, grown_uneven, near_others
from ..meshfree.renewal import evened, of_cell
from ..model.tensors import determinant
from ..output.energies import energies
from ..parallel.collect import Whole, computed_on_root, on_root
from ..parallel.reduce import exact_sum, global_maximum
from .mechanics import Mechanics
from .restart import restore, saved
from .step import NumericsError
from .strain import stretch


def stretched(m: Mechanics) -> np.ndarray:
    """Largest stretch of fluid in each cell since its neighbours were found (cells,) [-], as current as F; collective.

    1 where nothing flows.
    """
    flows = np.array([law.viscosity > 0.0 for law in m.scene.materials])[m.part.owned.material]
    most = np.ones(len(m.scene.kind))
    np.maximum.at(most, m.part.owned.cell, np.where(flows, stretch(m.state.since_renewal()), 1.0))
    return global_maximum(m.comm, most)


def crowded(m: Mechanics) -> np.ndarray:
    """Cells whose surface is to be divided anew, as lengths of segments differ too much (cells,) bool; collective."""
    if not m.divisible.any():
        return np.zeros(len(m.divisible), bool)
    s, own = m.surfaces, m.kernel["facet"][:, 0] < m.n_owned
    if m.scene.dimension == 3:
        return _uneven(m, s.cell[m.segments.ends[own, 0]]) & m.divisible
    loop, x = s.loop[m.segments.number[own]], m.segments.owned()[1]
    ends = extremes(np.linalg.norm(x[:, 1] - x[:, 0], axis=1), loop, int(m.scene.first_loop[-1]))
    longest, inverse = global_maximum(m.comm, ends.ravel()).reshape(2, -1)
    crowds = np.logical_or.reduceat(longest * inverse > CROWDED, m.scene.first_loop[:-1])
    return crowds & m.divisible


def _uneven(m: Mechanics, cell: np.ndarray) -> np.ndarray:
    """Cells in space whose triangles are too uneven (cells,) bool; cells (k,) int of this rank's; collective."""
    longest, height = spread(m.segments.owned()[1])
    ends = np.zeros((2, len(m.divisible)))
    np.maximum.at(ends[0], cell, longest)
    np.maximum.at(ends[1], cell, 1.0 / np.maximum(height, 1e-300))
    longest, inverse = global_maximum(m.comm, ends.ravel()).reshape(2, -1)
    most = np.array([grown_uneven(m.scene, kind) for kind in range(len(m.scene.templates))])
    return longest * inverse > most[m.scene.kind]


def due(m: Mechanics) -> bool:
    """Whether a cell is stretched, or its surface crowded, so far that neighbours are to be found anew; collective."""
    return m.terms.renewal is not None and bool(_due(m).any())


def _due(m: Mechanics) -> np.ndarray:
    """The cells that are due (cells,) bool; collective."""
    return (stretched(m) > m.terms.renewal) | crowded(m)


def renew(m: Mechanics, time: float) -> None:
    """Find the neighbours anew in the cells that are `due`; collective.

    Masses, volumes, J and stresses of laws stay.  Particles of a fluid inside a cell move a little, to be more evenly
    spread, and those on its surface along the outline, where they crowd: see `divided`, and in space in the surface,
    where triangles are uneven: see `divided_in_space`.  They take the velocity that is there, on the surface also J and
    the stress of a network; centre of mass, momentum and its moment stay.  A fluid keeps J alone of F.  The energy of
    the elastic stabilisation begins at zero; that and the change of all other energies is `Mechanics.renewal_loss`.

    Raises NumericsError where particles are inverted or have too few neighbours; `time` [µs] is for its message.
    """
    m.resume()
    cells = np.flatnonzero(_due(m))
    m.rate()  # completes the work of the last step, with the forces of before
    if global_maximum(m.comm, np.array([-m.state.J_of_rows[: m.n_owned].min(initial=1.0)]))[0] >= 0.0:
        raise NumericsError.at(m, time, "a particle is inverted", None,
                               "try a shorter step, smaller loads or finer particles")
    before = _energy(m)
    about, rows = saved(m)
    arrays = on_root(m.comm, rows)

    def move() -> None:
        for c in cells.tolist():
            with of_cell(c):
                _move(m, arrays, c)

    try:
        computed_on_root(m.comm, move)
        restore(m, about, Whole(m.comm, arrays))
    except ValueError as error:
        raise NumericsError.of(m, time, f"neighbours cannot be found anew in {error}",
                               "try finer particles, or numerics.renewal = \"never\"") from error
    m.renewals += 1
    m.renewal_loss += before - _energy(m)


def _energy(m: Mechanics) -> float:
    """All energies [pN]; collective."""
    parts = energies(m, m.state.v * m.terms.inertia)
    return float(exact_sum(m.comm, sum(parts.values()) + m.stabilisation_energy()))


def _move(m: Mechanics, arrays: dict[str, np.ndarray], c: int) -> None:
    """Change the state of a cell in `arrays`, those of `saved` on rank 0, to that with other neighbours."""
    scene, on, d = m.scene, slice(*m.scene.offset[c : c + 2]), m.scene.dimension
    t, state = scene.templates[scene.kind[c]], arrays["particle state"][on]
    flows = fluid(scene.particles(np.arange(on.start, on.stop)))
    F = arrays["particle F"][on].reshape(-1, d, d).transpose(0, 2, 1)
    J, x, v = determinant(F.transpose(1, 2, 0)), t.X + state[:, :d], state[:, d:].copy()
    A = arrays["particle network"][on].reshape(-1, d, d) if m.network is not None else np.zeros_like(F)
    b, surface = F @ A @ F.transpose(0, 2, 1), t.surface
    L = np.stack([g @ v for g in t.G], axis=2) @ np.linalg.inv(F)
    loose = flows.copy()
    loose[surface] = False
    by, area = np.zeros_like(x), float(t.V @ J)
    division = _division(m, arrays, c, x, area) if m.divisible[c] and loose.any() else None
    if division is not None:
        by[surface] = division.x - x[surface]
        for values in (v, b, J):
            values[surface] = division.between(values[surface])
        J[surface] *= 1.0 + (area - t.V @ J) / (t.V[surface] @ J[surface])
        _divide(m, arrays, c, division, by[surface])
        if isinstance(division, SurfaceDivision):
            t = replace(t, present=surface[division.places.triangles], along=division.along)
    by = np.where(loose[:, None], evened(t, x + by, J, loose) - x, by)
    by = _centred(by, t.mass, loose)
    v += np.where(loose[:, None], np.einsum("nij,nj->ni", L, by), 0.0)
    v -= np.where(loose[:, None], t.mass @ (v - state[:, d:]) / max(t.mass[loose].sum(), 1e-300), 0.0)
    cross = polygons.cross if d == 2 else triangles.cross
    lost = t.mass * (cross(x, state[:, d:]) - cross(x + by, v)).T
    v += _turn(lost.sum(axis=-1), x + by, t.mass, loose)
    state[:] = np.hstack([state[:, :d] + by, v])
    F = np.where(flows[:, None, None], J[:, None, None] ** (1.0 / d) * np.eye(d), F)
    if m.network is not None:  # b = F A Fᵀ stays
        inverse = np.linalg.inv(F)
        arrays["particle network"][on] = (inverse @ b @ inverse.transpose(0, 2, 1)).reshape(-1, d * d)
    arrays["particle F"][on], arrays["particle bend"][on] = F.transpose(0, 2, 1).reshape(-1, d * d), 0.0
    arrays["neighbours x"][on], arrays["neighbours F"][on] = x + by, F


def _division(m: Mechanics, arrays: dict[str, np.ndarray], c: int, x: np.ndarray,
              content: float) -> Division | SurfaceDivision | None:
    """The surface of a cell, with particles at x (n, d) [µm] from its centre, divided anew to enclose a `content`
    [µm^d], if it is to be.
    """
    scene, terms = m.scene, m.terms
    t, d = scene.templates[scene.kind[c]], scene.dimension
    if d == 2:
        return divided(t, x, content)
    held = np.zeros(len(t.surface), bool)
    if terms.contacts is not None:
        everywhere = scene.X + arrays["particle state"][:, :d]
        held = near_others(scene, everywhere, c, terms.reach, terms.contacts.own)
    low = scene.centre[c, -1] + x[t.surface, -1] < terms.low if terms.substrate is not None else np.zeros_like(held)
    return divided_in_space(t, x, content, held, low)


def _divide(m: Mechanics, arrays: dict[str, np.ndarray], c: int, division: Division | SurfaceDivision,
            by: np.ndarray) -> None:
    """Change what the surface of a cell has in `arrays` for particles that move `by` (m, d) [µm]."""
    on, facets = (slice(*first[c : c + 2]) for first in (m.scene.first_surface, m.scene.first_facet))
    arrays["neighbours along"][on] = division.along
    arrays["surface place"][on] += by[:, :-1]
    if "facet bond_impulse" in arrays:
        arrays["facet bond_impulse"][facets] = division.of_facets(arrays["facet bond_impulse"][facets])
    t = m.scene.templates[m.scene.kind[c]]
    if isinstance(division, SurfaceDivision):
        arrays["neighbours triangles"][facets] = t.surface[division.places.triangles]
    at = slice(*m.scene.offset[c : c + 2])
    arrays["surface renewed"][on] = arrays["particle state"][at][t.surface, : m.scene.dimension] + by
    if isinstance(division, Division) and "surface turn" in arrays:
        way = division.x[t.after] - division.x
        arrays["surface turn"][on] = polygons.turn(way[t.before], way)


def _turn(moment: np.ndarray, x: np.ndarray, mass: np.ndarray, on: np.ndarray) -> np.ndarray:
    """Velocities (n, d) [µm/µs] of the particles `on` (n,) bool, as of a rigid turn around their centre, that have the
    `moment` of momentum () or (3,) [pN µs µm^(D - 2)].
    """
    away = _centred(np.where(on[:, None], x, 0.0), mass, on)
    square = mass @ (away**2).sum(axis=1)
    if x.shape[1] == 2:
        return moment / max(square, 1e-300) * np.column_stack([-away[:, 1], away[:, 0]])
    inertia = square * np.eye(3) - away.T @ (mass[:, None] * away)
    return triangles.cross(np.linalg.pinv(inertia, hermitian=True) @ moment, away)


def _centred(values: np.ndarray, mass: np.ndarray, on: np.ndarray) -> np.ndarray:
    """`values` (n, d) of any unit less their mean over the `mass` (n,) of those `on` (n,) bool, where these are."""
    if not on.any():
        return values
    return values - np.where(on[:, None], mass @ values / mass[on].sum(), 0.0)
