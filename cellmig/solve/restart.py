"""All that decides the next bits of a Mechanics, gathered for a checkpoint and given back on any number of ranks."""

from __future__ import annotations

from typing import Any

import numpy as np

from mpi4py import MPI

from ..meshfree.body import Scene
from ..meshfree.contact import Surfaces
from ..parallel.collect import broadcast, gathered
from .accounts import ACCOUNTS
from .mechanics import Mechanics

SAME = 1e-9  # spacings that particles may lie apart which are the same; rounding is 1e-15, the next one is at 1
_TIMES = ("F_lag", "accounted_dt", "dt_prev", "rebuilds")


def saved(m: Mechanics) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Numbers, the same on all ranks, and arrays, on rank 0, of the state between two steps; collective.

    Arrays are by particle in the order of the global ids, or by surface particle (of its segment, the first end).
    """
    m.undo.take_up()
    about = {name: getattr(m, name) for name in _TIMES}
    if m.terms.load_curves is not None:
        about["clock"] = m.kernel["clock"].tolist()
    arrays = {f"particle {name}": gathered(m.comm, m.ids, values, m.scene.size)
              for name, values in _of_particles(m).items()}
    n = len(m.surfaces.ids)
    arrays |= {f"surface {name}": gathered(m.comm, m._mine, values, n)
               for name, values in _of_surface(m).items()}
    if m.terms.contact is not None:
        arrays |= m.impulses.saved(m.comm)
    return about, {name: values for name, values in arrays.items() if values is not None}


def restore(m: Mechanics, about: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
    """Go back to what was saved; rank 0 has the arrays; collective."""
    m.undo.forget()
    everything = broadcast(m.comm, arrays)
    particle, surface = ({name.removeprefix(kind): values for name, values in everything.items()
                          if name.startswith(kind)} for kind in ("particle ", "surface "))
    own = m._mine
    # Lists are made of the positions of that time; ghosts of what touches come with them.
    m._memory[m._at, :2] = surface["renewed"][own]
    m.state.exchange()
    m.renew_lists()
    for name, values in _of_surface(m).items():
        if name not in ("renewed", *_BY_SEGMENT):
            values[:] = surface[name][own]
    for name in _BY_SEGMENT:
        if name in surface:
            m.kernel[name][:] = surface[name][m._segments]
    if m.terms.contact is not None:
        m.impulses.restore(everything["contact key"], everything["contact impulse"])
    for name, values in _of_particles(m).items():
        if name not in _BY_BLOCK:
            values[:] = particle[name][m.ids]
    ids, (block, lane) = m.base.ids[: m.base.n_rows], m.blocks.lanes_of
    for name, blocks in _by_blocks(m).items():  # of copies too, which have the same bits
        blocks[block, :, lane] = particle[name][ids]
    for name in _TIMES:
        setattr(m, name, about[name])
    if m.terms.load_curves is not None:
        m.set_clock(*about["clock"])
    m.solution.stateIncrease()
    m.state.exchange()
    if m.theta is not None:
        m.theta.exchange()


_BY_SEGMENT = ("pushed", "bond_impulse")
_ACCOUNTED = ("viscous_loss", "artificial_dissipation", "external_work")  # by blocks, which no look has settled
_BY_BLOCK = ("F", "stabilising", "viscous", "bulk", "active", "director_gradient", "director_axis",
             *(f"{name} of blocks" for name in _ACCOUNTED))


def _of_particles(m: Mechanics) -> dict[str, np.ndarray]:
    """Values (n_owned, k) of the owned particles; those by block are copies, the others are where the kernel looks."""
    found = {"state": m.state.owned, **{name: m.kernel[name][: m.n_owned] for name in ACCOUNTS}}
    if m.theta is not None:
        found["theta"] = m.theta.owned
    if m.terms.load_curves is not None:
        found["load_before"] = m.kernel["load_before"][: m.n_owned]
    return found | {name: m.by_row(blocks)[: m.n_owned] for name, blocks in _by_blocks(m).items()}


def _by_blocks(m: Mechanics) -> dict[str, np.ndarray]:
    """What the kernel keeps by blocks (n_blocks, k, 4), to write to: F, and forces and stresses of the last kick."""
    found = {"F": m.kernel["F"], **_step_memory(m)}
    if m.theta is not None:
        found |= {name: m.kernel[name] for name in ("director_gradient", "director_axis")}
    return found


def _step_memory(m: Mechanics) -> dict[str, np.ndarray]:
    """Forces and stresses of the last kick and accounts, where `StepMemory` of the kernel has them."""
    terms = m.terms
    layout = [("stabilising", "f8", (4, 2)), ("viscous_loss", "f8", 4), ("artificial_dissipation", "f8", 4),
              ("viscous", "f4", (4, 4)), ("bulk", "f4", (1, 4))]
    layout += [("elastic", "f8", (4, 2))] * terms.stiffened
    layout += [("external_work", "f8", 4), ("active", "f4", (4, 4))] * terms.active
    memory = m.kernel["step_memory"].reshape(-1).view(np.dtype(layout))
    there = {"viscous": True, "bulk": terms.bulk_damped, "active": terms.active}
    found = {name: memory[name] for name, is_there in there.items() if is_there}
    found |= {f"{name} of blocks": memory[name][:, None] for name in _ACCOUNTED if name in memory.dtype.names}
    return found | ({"stabilising": memory["stabilising"].transpose(0, 2, 1)} if terms.stabilised else {})


def _of_surface(m: Mechanics) -> dict[str, np.ndarray]:
    """Values of the owned surface particles, or of the segments that begin there: u when the lists were made, x at the
    last row of the tables, forces of plates and of the protrusion, impulses of bonds.
    """
    found = {"renewed": m._renewed_at, "place": m.impulses.place}
    if m.terms.load_curves is not None and len(m.boundary.plate):
        found["plate_force"] = m.kernel["plate_force"]
    number = np.searchsorted(m._segments, m._mine)
    there = {"pushed": m.terms.protrusion is not None, "bond_impulse": m.terms.substrate is not None}
    found |= {name: m.kernel[name][number] for name, is_there in there.items() if is_there}
    return found


def same_places(arrays: dict[str, np.ndarray], scene: Scene, comm: MPI.Comm) -> bool:
    """Whether arrays of a checkpoint, on rank 0, are of the particles of a scene: but for rounding; collective."""
    same = True
    if comm.rank == 0:
        X, surface, spacing = arrays["X"], arrays["surface"], min(t.spacing for t in scene.templates)
        same = (X.shape == scene.X.shape and bool(np.abs(X - scene.X).max() <= SAME * spacing)
                and np.array_equal(surface, Surfaces.of(scene).ids))
    return comm.bcast(same)
