"""Fields of a case that do not depend on the time, on the substrate around the cells, as `substrate.xdmf`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..case import units
from ..case.schema import Case
from ..model.ground import fields_of
from .directory import OutputError, together

if TYPE_CHECKING:
    from mpi4py import MPI

NAME = "substrate.xdmf"
AROUND = 200.0  # how far it reaches beyond the cells at the start [µm], at least by the size of them all
NODES = {2: 2001, 3: 301}  # along each axis, by the dimensions of the case
THICK = 0.02  # height of the strip that stands for the substrate in two dimensions, over its length


def profile(case: Case) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Points (n, 3) [µm] and quadrilaterals (m, 4) int on the substrate, and values (n,) by field in the case's units.

    In two dimensions they are a strip below y = 0.
    """
    at = np.concatenate([np.array(cell.centre) + cell.shape.outline(24) for cell in case.cells])[:, :-1]
    low, high = at.min(axis=0), at.max(axis=0)
    reach = np.maximum(AROUND, high - low)
    ways = [np.linspace(a, b, NODES[case.dimension]) for a, b in zip(low - reach, high + reach, strict=True)]
    if case.dimension == 2:
        ways.append(np.array([-THICK * np.ptp(ways[0]), 0.0]))
    points = np.stack(np.meshgrid(*ways, indexing="ij"), axis=-1).reshape(-1, 2)
    number = np.arange(len(points)).reshape(len(ways[0]), len(ways[1]))
    corners = (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
    x = points * [1.0, 0.0] if case.dimension == 2 else np.pad(points, ((0, 0), (0, 1)))
    values = {f"{name} [{law.unit}]" if law.unit else name: law.value(x, 0.0) / units.number(f"1 {law.unit}", law.unit)
              for name, law in fields_of(case).items() if getattr(law, "steady", False)}
    return np.pad(points, ((0, 0), (0, 1))), np.stack([c.ravel() for c in corners], axis=1), values


def write_profile(directory: Path, comm: MPI.Intracomm, case: Case) -> None:
    """Write `profile` of a case that has such fields; collective, rank 0 writes.  Raises OutputError."""
    def write() -> None:
        points, corners, values = profile(case)
        if values:
            import meshio  # takes a while, and few cases have fields

            part = directory / f"{NAME}.part"
            try:
                meshio.write(part, meshio.Mesh(points, [("quad", corners)], values), "xdmf", data_format="XML")
                part.replace(directory / NAME)
            except OSError as error:
                raise OutputError(f"cannot write '{directory / NAME}' ({error.strerror})") from error

    together(comm, write, root_only=True)
