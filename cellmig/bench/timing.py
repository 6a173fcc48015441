"""Timing of one scene: step, terms, exchange and output, as a process of `cellmig bench` with its own ranks.

``mpiexec -n 2 python -m cellmig.bench.timing '{"bodies": 3, "per_body": 1485}'`` prints one line of JSON.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from mpi4py import MPI

from cellmig.case.load import from_dict, load
from cellmig.case.schema import Case
from cellmig.case.shipped import FOLDER
from cellmig.laws import register
from cellmig.meshfree.terms import find_terms
from cellmig.output.fields import FIELDS
from cellmig.output.manifest import memory_sizes
from cellmig.output.xdmf import Frames
from cellmig.simulation import Simulation
from cellmig.solve.integrate import Integrator

STILL = 1e-12  # a step too short to change the state [µs]
LEAST = 0.05  # shortest measurement [s]
SURFACE = ("substrate", "contact", "protrusion")
ANEW = "contact anew"  # in space, where its pieces are found in each step


@dataclasses.dataclass(frozen=True)
class Scene:
    """A row of the paper's cells, or rows of balls, in contact, which all protrude.

    bodies : cells, in `rows` of the same length;  per_body : particles of each;  single : of coefficients in single
    precision, None as in runs;  dimension : 2 or 3;  begin : time to which the scene is run before it is timed [µs].
    """

    bodies: int
    per_body: int
    single: bool | None = None
    dimension: int = 2
    begin: float = 0.0
    rows: int = 1

    @property
    def particles(self) -> int:
        """Nominal number of particles."""
        return self.bodies * self.per_body

    def case(self) -> Case:
        """The case."""
        register()
        name = {2: "paper.toml", 3: "three_balls.toml"}[self.dimension]
        tree = load(FOLDER / name, (f"particles.per_cell={self.per_body}",)).resolved()
        repeat = [self.bodies] if self.rows == 1 else [self.bodies // self.rows, self.rows]
        pitch = [["-10.01 um" if c == n else "0 um" for c in range(self.dimension)] for n in range(len(repeat))]
        cell = tree["cells"][0] | {"name": "Cell-{}", "repeat": repeat, "pitch": pitch}
        tree["cells"] = [cell]
        tree["protrusion"]["cells"] = [f"Cell-{i + 1}" for i in range(self.bodies)]
        return from_dict(tree, "bench")


class Timer:
    """Measures wall time of the slowest rank and CPU time of all ranks, of work that is repeated."""

    def __init__(self, comm: MPI.Comm, particles: int, repeats: int):
        self.comm, self.particles, self.repeats = comm, particles, repeats

    def seconds(self, work: Callable[[int], Any]) -> tuple[list[float], list[float]]:
        """Wall and CPU time [s] of one repetition, by measurement; `work(n)` does n; collective."""
        n, wall, cpu = 1, [], []
        while (spent := self._once(work, n)[0]) < LEAST:
            n = max(2 * n, round(1.2 * n * LEAST / max(spent, 1e-9))) if spent > 1e-4 else 10 * n
        for _ in range(self.repeats):
            w, c = self._once(work, n)
            wall.append(w / n)
            cpu.append(c / n)
        return wall, cpu

    def _once(self, work: Callable[[int], Any], n: int) -> tuple[float, float]:
        self.comm.Barrier()
        begin, used = perf_counter(), process_time()
        work(n)
        used = process_time() - used
        self.comm.Barrier()
        return self.comm.allreduce(perf_counter() - begin, MPI.MAX), self.comm.allreduce(used)

    def __call__(self, work: Callable[[int], Any]) -> dict[str, list[float]]:
        """The same per particle [ns]; collective."""
        wall, cpu = self.seconds(work)
        return {"wall": [1e9 * t / self.particles for t in wall], "cpu": [1e9 * t / self.particles for t in cpu]}


def probe(scene: Scene, comm: MPI.Comm, repeats: int = 7, output: bool = False) -> dict[str, Any]:
    """Cost of a scene on the ranks of a communicator; collective.

    Parameters
    ----------
    scene : Scene.  repeats : int -- number of measurements.  output : bool -- whether to time samples and frames.

    Returns
    -------
    dict -- `ns` : wall and CPU times per particle and step [ns] of "step", of the internal force in "stress" and
    "divergence", and of surface terms, of "contact" in space as in steps and, in "contact anew", where its pieces are
    found in each; `us` : times [µs] of "exchange" of ghosts as in steps, by "messages", of step control ("control"),
    "lists", "sample", "frame"; sizes and memory.
    """
    case, begin = scene.case(), perf_counter()
    terms = find_terms(case)
    if scene.single is not None:
        terms = dataclasses.replace(terms, single=scene.single)
    sim = Simulation(case, comm, parts=(None, terms))
    setup = comm.allreduce(perf_counter() - begin, MPI.MAX)
    if scene.begin:
        sim.go(scene.begin)
    m, k, run = sim.mechanics, sim.mechanics.kernel, sim.integrator
    assert isinstance(run, Integrator)
    run.begin_batch()
    share = STILL / run.dt  # pieces of contact serve for as many steps as in runs
    m.advance(3, STILL, run.gaps[1], share)
    timer = Timer(comm, sim.scene.size, repeats)
    force, energy = np.zeros((m.part.capacity, case.dimension)), np.zeros(m.part.capacity)
    ns = {"step": timer(lambda n: m.advance(n, STILL, run.gaps[1], share)),
          "stress": timer(lambda n: k.repeated(n, "stress_of_rate", 0.0, 0.0, STILL)),
          "divergence": timer(lambda n: k.repeated(n, "kick_and_drift", 0.0, 0.0))}
    for name in (*SURFACE, *[ANEW] * (case.dimension == 3)):
        if getattr(terms, term := name.split()[0]) is not None:
            m.segments.serve(0.0 if name == ANEW else share, run.gaps[1])
            ns[name] = timer(lambda n, term=term: k.repeated(n, f"add_{term}", force, energy, 0.0, STILL))
    us = {"control": timer.seconds(lambda n: [m.limits() for _ in range(n)])[0],
          "lists": timer.seconds(lambda n: [m.renew_lists() for _ in range(n)])[0]}
    if comm.size > 1:
        us["messages"] = timer.seconds(lambda n: [m.state.exchange() for _ in range(n)])[0]
        us["exchange"] = timer.seconds(lambda n: k.repeated(n, "exchange_state"))[0]
    if output:
        us |= _output(sim, timer)
    found = {
        **dataclasses.asdict(scene), "particles": sim.scene.size, "ranks": comm.size, "setup_s": setup,
        "single": terms.single, "step_us": run.dt,
        "owned": comm.allgather(m.n_owned), "rows": comm.allgather(m.part.numbering.n_rows),
        "ghosts": comm.allgather(len(m.state.numbering.ids) - m.n_owned), "surface": int(m.scene.first_surface[-1]),
        "neighbours": float(np.mean([t.G[0].nnz / len(t.X) for t in sim.scene.templates])),
        "kernel_bytes": comm.allreduce(k.bytes) / sim.scene.size, "traffic_bytes": comm.allreduce(traffic(k)),
        "peak_bytes": comm.allreduce(peak_memory()) / sim.scene.size, "peak_of": comm.allgather(peak_memory()),
        "ns": ns, "us": {name: [1e6 * t for t in wall] for name, wall in us.items()}}
    sim.destroy()
    return found


def _output(sim: Simulation, timer: Timer) -> dict[str, list[float]]:
    """Wall time [s] of a sample, and of a frame that all ranks write."""
    sample = timer.seconds(lambda n: [sim.sample() for _ in range(n)])[0]
    folder = timer.comm.bcast(tempfile.mkdtemp() if timer.comm.rank == 0 else None)
    fields = sim.sampler.fields()
    frames = Frames(Path(folder), timer.comm, {name: FIELDS[name].unit for name in fields})
    count = iter(range(1, 1 << 30))

    def write(n: int) -> None:
        for _ in range(n):
            at = next(count)
            frames.write(float(at), at, sim.sampler.fields())

    return {"sample": sample, "frame": timer.seconds(write)[0]}


def traffic(kernel: Any) -> float:
    """Smallest memory traffic of the internal force in a step on this rank [B]."""
    read = {"gradient": 1, "adjoint": 1, "column": 2, "laplacian": 1, "bending": 1, "bent": 2,
            "first": 2, "block": 2, "volume": 1, "per_mass": 1, "bulk_damping": 1}
    changed = {"state": 1, "F": 2, "bend": 2, "Q": 2, "step_memory": 2}
    sizes = {name: kernel[name].nbytes for name in {**read, **changed} if name in kernel._arrays}
    return float(sum(sizes[name] * times for name, times in {**read, **changed}.items() if name in sizes))


def peak_memory() -> float:
    """Peak memory of this process [B]; that of getrusage includes the parent process."""
    return memory_sizes("/proc/self/status")["VmHWM"]


def main() -> None:
    """Probe the scene of the first argument; rank 0 prints the result."""
    comm, options = MPI.COMM_WORLD, json.loads(sys.argv[1])
    repeats, output = options.pop("repeats", 7), options.pop("output", False)
    found = probe(Scene(**options), comm, repeats, output)
    if comm.rank == 0:
        print(json.dumps(found))


if __name__ == "__main__":
    main()
