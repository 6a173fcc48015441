"""Bodies in three dimensions for tests of their mechanics, on any number of ranks."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
from bodies import Body, ball, blocks

from mpi4py import MPI

from cellmig.meshfree.body import Template, template
from cellmig.meshfree.boundary import Boundary, Probes
from cellmig.meshfree.scene import Scene
from cellmig.meshfree.terms import Terms
from cellmig.model.director import initial
from cellmig.output.sample import Sampler
from cellmig.parallel.collect import gathered
from cellmig.parallel.partition import partition
from cellmig.parallel.swarm import Swarm
from cellmig.solve.accounts import ACCOUNTS
from cellmig.solve.integrate import Integrator
from cellmig.solve.mechanics import Mechanics
from cellmig.solve.protrusion import Drives, Protruding
from cellmig.solve.step import StepControl

RADIUS = 5.0
layout = cache(ball)


@cache
def balls(laws: tuple, count: int, cells: int = 1, height: float = 0.0) -> Scene:
    """A row of equal balls of 5 µm, of a body's law and that of a nucleus or None, `height` [µm] above z = 0."""
    return scene_of(layout(count, RADIUS), laws, cells, 10.5, height)


def bar(law: Any, shape: tuple = (6, 2, 2)) -> Scene:
    """A bar of cubes of 1 µm."""
    return scene_of(blocks(np.array([*np.ndindex(*shape)]), shake=0.1), (law, None))


def smooth(X: np.ndarray, size: float, seed: int = 5) -> np.ndarray:
    """A field (n, 3) of a few waves of 5 µm and more, with values of about `size`."""
    rng = np.random.default_rng(seed)
    waves = [(rng.uniform(-1, 1, 3) * 2 * np.pi / 5, rng.standard_normal(3), rng.uniform(0, 6)) for _ in range(3)]
    return size * sum(a * np.sin(X @ k + phase)[:, None] for k, a, phase in waves)


def scene_of(body: Body, laws: tuple, cells: int = 1, pitch: float = 0.0, height: float = 0.0) -> Scene:
    """Copies of a body, a `pitch` apart along x, whose lowest points are at a height [µm]."""
    inner = laws[1] or laws[0]
    depth = np.linalg.norm(body.X, axis=1) < 0.4 * RADIUS
    with_nucleus = Body(body.X, depth & (laws[1] is not None), body.triangles, body.tetrahedra)
    t: Template = template(SimpleNamespace(particles=lambda *_: with_nucleus), len(body.X), 0.0, laws, 0.05)
    centre = np.array([[pitch * k, 0.0, height - t.X[:, 2].min()] for k in range(cells)])
    return Scene([t], np.zeros(cells, int), centre, [laws[0], inner], [(0, 1)])


class Space:
    """The mechanics of a scene in three dimensions; a context that frees it.  Collective.

    u, v : (size, 3) -- initial displacements [µm] and velocities [µm/µs] of all particles, zero by default.
    """

    def __init__(self, scene: Scene, terms: Terms, comm: MPI.Comm, u: Any = 0.0, v: Any = 0.0):
        n, cells, none, some = scene.size, len(scene.kind), np.zeros(0), np.zeros(0, int)
        self.scene, self.comm, self.size = scene, comm, n
        owners, own = partition(scene, comm.size), np.arange(n)[comm.rank :: comm.size]
        fields = {"id": np.arange(n), "X": scene.X, "u": u + np.zeros((n, 3)), "v": v + np.zeros((n, 3)),
                  "director": initial(terms.director_law, scene.X - scene.centre[scene.cell]),
                  "loss": np.zeros((n, len(ACCOUNTS)))}
        self.swarm = Swarm(comm, {name: values[own] for name, values in fields.items()})
        self.swarm.migrate(owners.of(own))
        boundary = Boundary((), (), some.reshape(0, 2), none, some, some, some, none.reshape(0, 3), some,
                            some.reshape(0, 3), none, some, none.reshape(0, 9), some)
        names, law = [f"Cell-{k + 1}" for k in range(cells)], terms.protrusion
        pushing = np.array([law is not None and name in law.cells for name in names])
        along_x = np.tile([[[1.0, 0.0]]], (cells, 1, 1))
        drives = Drives(along_x, 0.0 * along_x, 0.0, 1.0)
        protruding = Protruding(pushing, 2019, names, drives)
        self.mechanics = Mechanics(owners, terms, boundary, protruding, self.swarm)
        self.integrator = Integrator(self.mechanics, StepControl(scene, terms), "leapfrog", None, 0.8)
        self.sampler = Sampler(self.mechanics, Probes((), some, some, some, none))
        self.sample()

    def sample(self) -> tuple[dict[str, float], dict[str, float]]:
        """Row of the aggregate, and the ledger."""
        m = self.mechanics
        m.set_aside()
        acceleration, half = self.integrator.rate(), 0.5 * m.times.dt_prev
        rows = self.comm.bcast(self.sampler.history())
        return rows[0], self.sampler.ledger(acceleration, half, m.powers() if half else {})

    def everywhere(self, owned: np.ndarray) -> np.ndarray:
        """Values at the owned particles of all ranks, by global id."""
        return self.comm.bcast(gathered(self.comm, self.mechanics.ids, owned, self.size))

    def forces(self) -> np.ndarray:
        """M a of all particles (size, 3) [pN] in the state as it is."""
        a = self.everywhere(np.ascontiguousarray(self.mechanics.rate()[:, 3:]))
        return self.scene.field("mass")[:, None] * a

    def state(self) -> bytes:
        """Displacements and velocities of all particles."""
        self.mechanics.resume()
        return self.everywhere(self.mechanics.state.owned).tobytes()

    def __enter__(self) -> Space:
        return self

    def __exit__(self, *_: object) -> None:
        self.integrator.destroy()
        self.mechanics.destroy()
        self.swarm.destroy()
