"""State of a Mechanics for a checkpoint, gathered and restored on any number of ranks with the same bits."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from mpi4py import MPI

from ..meshfree.contact import Surfaces
from ..meshfree.renewal import with_renewed
from ..meshfree.rkpm import factorised
from ..meshfree.scene import Scene, joined
from ..parallel.collect import Arrays, Rows, computed_on_root
from ..parallel.direct import solve_positive
from ..parallel.owners import Owners
from .mechanics import Mechanics
from .start import LARGE

NEIGHBOURS = tuple(f"neighbours {name}" for name in ("x", "F", "along", "triangles"))  # of `_reference`
SAME = 1e-9  # largest distance of positions that count as equal [spacings]; rounding is 1e-15


def saved(m: Mechanics) -> tuple[dict[str, Any], dict[str, np.ndarray | Rows]]:
    """State between two steps: numbers, the same on all ranks, and arrays, of which each rank has its rows; collective.

    Arrays (size, ...) are by particle, in the order of ids, (m, ...) by surface particle, or (f, ...) by facet; they
    have the units of the fields.
    """
    m.resume()
    about = asdict(m.times) | {"renewals": m.segments.renewals, "neighbours": [m.renewals, m.renewal_loss]}
    if m.loads.there:
        about["clock"] = m.loads.clock
    by_row = {name: m.state.by_row(blocks)[: m.n_owned] for name, blocks in _by_blocks(m).items()}
    arrays: dict[str, Any] = {f"particle {name}": Rows(m.ids, np.array(values), m.scene.size)
                              for name, values in (_of_particles(m) | by_row).items()}
    of_surface = _of_surface(m) | ({"turn": m.segments.turn[m.part.own_surface]} if len(m.segments.turn) else {})
    places, scene = m.surfaces.place[m.part.own_surface], m.scene
    arrays |= {f"surface {name}": Rows(places, np.array(values), int(scene.first_surface[-1]))
               for name, values in of_surface.items()}
    own = m.part.on_surface[m.segments.ends[:, 0]]  # every facet is of the rank of its first corner
    facets = m.surfaces.number[m.segments.number[own]]
    arrays |= {f"facet {name}": Rows(facets, values[own], int(scene.first_facet[-1]))
               for name, values in _of_segments(m).items()}
    if m.terms.contacts is not None:
        arrays |= m.accounts.impulses.saved(m.comm)
    if m.terms.renewal is not None and m.comm.rank == 0:
        arrays |= _reference(m.scene)
    return about, arrays


def restore(m: Mechanics, about: dict[str, Any], arrays: Arrays) -> None:
    """Set the state from the results of `saved`, arrays (size, ...), (m, ...) of any unit; collective."""
    m.undo.aside = False
    if m.terms.renewal is not None and (scene := found_anew(m.scene, arrays, m.comm)) is not m.scene:
        m.remake(scene)
    # Search lists are made for the positions at their last renewal, with the ghosts that they need.
    places = m.surfaces.place[m.part.own_surface]
    m.state.u[m.part.at_surface] = arrays.rows("surface renewed", places)
    if "surface turn" in arrays.names:
        m.segments.turn = arrays.rows("surface turn", m.surfaces.place)
    m.state.exchange()
    m.renew_lists()
    for name, values in _of_surface(m).items():
        values[:] = arrays.rows(f"surface {name}", places)
    for name, values in _of_segments(m).items():
        values[:] = arrays.rows(f"facet {name}", m.surfaces.number[m.segments.number])
    if m.terms.contacts is not None:
        m.accounts.impulses.restore(arrays)
    for name, values in _of_particles(m).items():
        values[:] = arrays.rows(f"particle {name}", m.ids)
    for name, blocks in _by_blocks(m).items():  # with the rows of ghosts, which have the same bits
        m.state.set_by_row(blocks, arrays.rows(f"particle {name}", m.part.row_ids))
    m.segments.renewals, (m.renewals, m.renewal_loss) = about["renewals"], about["neighbours"]
    for name in asdict(m.times):
        setattr(m.times, name, about[name])
    if m.loads.there:
        m.loads.set_clock(*about["clock"])
    if m.network is not None:
        m.network.begin()
    m.state.solution.stateIncrease()
    m.state.exchange()
    if m.director is not None:
        m.director.exchange()


def _reference(scene: Scene) -> dict[str, np.ndarray]:
    """Where neighbours were found: x (size, d) from the centres [µm], F (size, d, d) [-], nan where never anew; places
    `along` the reference outline (m,) [µm], in space on the reference surface (m, 3) [µm], nan where surfaces were not
    divided anew; in space their triangles (t, 3) int.
    """
    d, used = scene.dimension, [scene.templates[k] for k in scene.kind]
    along = np.concatenate([np.full((len(t.surface), 3)[: d - 1], np.nan) if t.along is None else t.along
                            for t in used])
    x, F = np.full((scene.size, d), np.nan), np.full((scene.size, d, d), np.nan)
    for c, t in enumerate(used):
        if t.x0 is not None:
            on = slice(*scene.offset[c : c + 2])
            x[on], F[on] = t.x0, t.F0
    found = {"neighbours x": x, "neighbours F": F, "neighbours along": along}
    return found | ({"neighbours triangles": joined((t.facets for t in used), (0, 3))} if d == 3 else {})


def found_anew(scene: Scene, arrays: Arrays, comm: MPI.Comm) -> Scene:
    """A scene with the neighbours that arrays (size, ...), (m, ...) of any unit, of `saved`, have; the scene itself
    where it has these; collective.
    """
    x, F, along, *triangles = (arrays[name] for name in NEIGHBOURS if name in arrays.names)
    before, first = _reference(scene)["neighbours x"], scene.offset[:-1]
    cells = np.flatnonzero(np.logical_or.reduceat((x != before).any(axis=1), first) & np.isfinite(x[first, 0]))
    if not len(cells):
        return scene
    solve = solve_positive if np.diff(scene.offset)[cells].max() > LARGE else factorised
    present = triangles[0] if triangles else None
    return computed_on_root(comm, lambda: with_renewed(scene, cells, x, F, along, present, solve))


def flowed(arrays: Arrays) -> bool:
    """Whether neighbours of a checkpoint's arrays (size, ...) of any unit were found anew."""
    return NEIGHBOURS[0] in arrays.names and bool(np.isfinite(arrays[NEIGHBOURS[0]]).any())


# By blocks, until particles get them.
_ACCOUNTED = ("viscous_loss", "artificial_dissipation", "external_work", "network_loss")


def _of_particles(m: Mechanics) -> dict[str, np.ndarray]:
    """Writable values (n_owned, k) of the owned particles."""
    found = {"state": m.state.owned, "modes": m.modes.mode, **m.accounts.of_particles}
    if m.director is not None:
        found["director"] = m.director.owned
    if m.loads.there:
        found["load_before"] = m.loads.changing(m.n_owned)["load_before"]
    return found


def _by_blocks(m: Mechanics) -> dict[str, np.ndarray]:
    """Writable arrays by blocks (n_blocks, k, 4): F, Laplacians, A, and forces and stresses of the last kick."""
    found = {**{name: m.state.changing[name] for name in ("F", "bend")}, **_step_memory(m)}
    found |= m.network.by_block if m.network is not None else {}
    return found | m.director.by_block if m.director is not None else found


def _step_memory(m: Mechanics) -> dict[str, np.ndarray]:
    """What blocks remember of the last step, where the kernel has it."""
    terms, memory = m.terms, m.state.changing["step_memory"]
    there = {"viscous": True, "bent": terms.stabilised, "bulk": terms.bulk_damped, "active": terms.active}
    found = {name: memory[name] for name, is_there in there.items() if is_there}
    return found | {f"{name} of blocks": memory[name][:, None] for name in _ACCOUNTED if memory.dtype[name].itemsize}


def _of_surface(m: Mechanics) -> dict[str, np.ndarray]:
    """Values of the owned surface particles, to write to: u when the lists were made, x at the last row of the tables,
    drag of a medium, friction, forces of plates.
    """
    found = {"renewed": m.segments.renewed_at, "place": m.accounts.impulses.place}
    found |= m.immersed.changing if m.immersed is not None else {}
    found |= m.rubbing.changing if m.rubbing is not None else {}
    found |= {"pushed_off": m.protrusion.changing["pushed_off"]} if m.terms.pushes_off and m.protrusion else {}
    return found | ({"plate_force": m.loads.plate_force} if len(m.loads.boundary.plate) else {})


def _of_segments(m: Mechanics) -> dict[str, np.ndarray]:
    """Values of the segments, to write to: forces of the protrusion, impulses of bonds."""
    found = {"pushed": m.protrusion.changing["pushed"]} if m.protrusion is not None else {}
    return found | ({"bond_impulse": m.accounts.impulses.bond} if m.terms.substrate is not None else {})


def same_places(arrays: Arrays, owners: Owners, comm: MPI.Comm) -> bool:
    """Whether arrays of a checkpoint belong to the particles of the owners' scene, up to rounding; collective."""
    scene = owners.scene
    same = ("X" in arrays.names and arrays.shape("X") == (scene.size, scene.dimension)
            and arrays.shape("surface") == (scene.first_surface[-1],))
    if same:
        cells, spacing = owners.heads(comm.rank), min(t.spacing for t in scene.templates)
        of_cells, s = scene.particles(scene.ids_of(cells)), Surfaces.of(scene, cells)
        away = np.abs(arrays.rows("X", of_cells.ids) - of_cells.X).max(initial=0.0)
        same = bool(away <= SAME * spacing) and np.array_equal(arrays.rows("surface", s.place), s.ids)
    return comm.allreduce(same, MPI.LAND)
