"""All that decides the next bits of a Mechanics, gathered for a checkpoint and given back on any number of ranks."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from mpi4py import MPI

from ..meshfree.body import Scene
from ..meshfree.contact import Surfaces
from ..parallel.collect import broadcast, gathered
from .mechanics import Mechanics

SAME = 1e-9  # spacings that particles may lie apart which are the same; rounding is 1e-15, the next one is at 1


def saved(m: Mechanics) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Numbers, the same on all ranks, and arrays, on rank 0, of the state between two steps; collective.

    Arrays are by particle in the order of the global ids, or by surface particle (of its segment, the first end):
    (size, …) and (m, …) of any unit.
    """
    m.resume()
    about = asdict(m.times) | {"renewals": m.segments.renewals}
    if m.loads.there:
        about["clock"] = m.loads.clock
    by_row = {name: m.state.by_row(blocks)[: m.n_owned] for name, blocks in _by_blocks(m).items()}
    arrays = {f"particle {name}": gathered(m.comm, m.ids, values, m.scene.size)
              for name, values in (_of_particles(m) | by_row).items()}
    number = np.searchsorted(m.segments.number, m.part.own_surface)
    of_segments = {name: values[number] for name, values in _of_segments(m).items()}
    arrays |= {f"surface {name}": gathered(m.comm, m.part.own_surface, values, len(m.surfaces.ids))
               for name, values in (_of_surface(m) | of_segments).items()}
    if m.terms.contact is not None:
        arrays |= m.accounts.impulses.saved(m.comm)
    return about, {name: values for name, values in arrays.items() if values is not None}


def restore(m: Mechanics, about: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
    """Go back to what was saved; rank 0 has the `arrays` (…) of any unit; collective."""
    m.undo.aside = False
    everything = broadcast(m.comm, arrays)
    particle, surface = ({name.removeprefix(kind): values for name, values in everything.items()
                          if name.startswith(kind)} for kind in ("particle ", "surface "))
    # Lists are made of the positions of that time; ghosts of what touches come with them.
    m.state.u[m.part.at_surface] = surface["renewed"][m.part.own_surface]
    m.state.exchange()
    m.renew_lists()
    for name, values in _of_surface(m).items():
        values[:] = surface[name][m.part.own_surface]
    for name, values in _of_segments(m).items():
        values[:] = surface[name][m.segments.number]
    if m.terms.contact is not None:
        m.accounts.impulses.restore(everything["contact key"], everything["contact impulse"])
    for name, values in _of_particles(m).items():
        values[:] = particle[name][m.ids]
    block, lane = m.part.blocks.lanes_of
    for name, blocks in _by_blocks(m).items():  # of copies too, which have the same bits
        blocks[block, :, lane] = particle[name][m.part.row_ids]
    m.segments.renewals = about["renewals"]
    for name in asdict(m.times):
        setattr(m.times, name, about[name])
    if m.loads.there:
        m.loads.set_clock(*about["clock"])
    m.state.solution.stateIncrease()
    m.state.exchange()
    if m.director is not None:
        m.director.exchange()


_ACCOUNTED = ("viscous_loss", "artificial_dissipation", "external_work")  # by blocks, which no look has settled


def _of_particles(m: Mechanics) -> dict[str, np.ndarray]:
    """Values (n_owned, k) of the owned particles, to write to."""
    found = {"state": m.state.owned, **m.accounts.of_particles}
    if m.director is not None:
        found["theta"] = m.director.owned
    if m.loads.there:
        found["load_before"] = m.loads.changing["load_before"][: m.n_owned]
    return found


def _by_blocks(m: Mechanics) -> dict[str, np.ndarray]:
    """What the kernel keeps by blocks (n_blocks, k, 4), to write to: F, and forces and stresses of the last kick."""
    found = {"F": m.state.changing["F"], **_step_memory(m)}
    return found | m.director.by_block if m.director is not None else found


def _step_memory(m: Mechanics) -> dict[str, np.ndarray]:
    """What blocks remember of the last step, where the kernel has it."""
    terms, memory = m.terms, m.state.changing["step_memory"]
    there = {"viscous": True, "bulk": terms.bulk_damped, "active": terms.active}
    found = {name: memory[name] for name, is_there in there.items() if is_there}
    found |= {f"{name} of blocks": memory[name][:, None] for name in _ACCOUNTED if memory.dtype[name].itemsize}
    return found | ({"stabilising": memory["stabilising"].transpose(0, 2, 1)} if terms.stabilised else {})


def _of_surface(m: Mechanics) -> dict[str, np.ndarray]:
    """Values of the owned surface particles, to write to: u when the lists were made, x at the last row of the tables,
    forces of plates.
    """
    found = {"renewed": m.segments.renewed_at, "place": m.accounts.impulses.place}
    return found | ({"plate_force": m.loads.plate_force} if len(m.loads.boundary.plate) else {})


def _of_segments(m: Mechanics) -> dict[str, np.ndarray]:
    """Values of the segments, to write to: forces of the protrusion, impulses of bonds."""
    found = m.protrusion.changing if m.protrusion is not None else {}
    return found | ({"bond_impulse": m.accounts.impulses.bond} if m.terms.substrate is not None else {})


def same_places(arrays: dict[str, np.ndarray], scene: Scene, comm: MPI.Comm) -> bool:
    """Whether arrays of a checkpoint, on rank 0, are of the particles of a scene: but for rounding; collective."""
    same = True
    if comm.rank == 0:
        X, surface, spacing = arrays["X"], arrays["surface"], min(t.spacing for t in scene.templates)
        same = (X.shape == scene.X.shape and bool(np.abs(X - scene.X).max() <= SAME * spacing)
                and np.array_equal(surface, Surfaces.of(scene).ids))
    return comm.bcast(same)
