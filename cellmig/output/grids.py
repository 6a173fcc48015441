"""Fields on grids as XDMF over HDF5, beside the frames of particles: `fields.xdmf`, for ParaView."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import h5py
import numpy as np

from ..case.time_unit import MICROSECOND, TimeUnit
from .directory import replace, together
from .xdmf import FIELDS, HEAD, TAIL, grids

if TYPE_CHECKING:
    from mpi4py import MPI


@dataclass(frozen=True)
class OnGrid:
    """Values of a field in the equal volumes of a box.

    low, size : lower corner of the box, and size of a volume, along each axis [um];  count : volumes along each axis;
    values : (volumes,), along x first;  unit : of the values.
    """

    low: Sequence[float]
    size: Sequence[float]
    count: Sequence[int]
    values: np.ndarray
    unit: str


class GridFrames:
    """Writer of the frames of fields, each in a file `fields/sNNNNNNNN.h5` that rank 0 writes; collective.

    count : existing frames, after `cut_frames`;  run : id of the run;  unit : of times in the files.
    """

    def __init__(self, directory: Path, comm: MPI.Intracomm, count: int = 0, run: str = "",
                 unit: TimeUnit = MICROSECOND) -> None:
        self._directory, self._comm, self._count, self._run, self._unit = Path(directory), comm, count, run, unit
        self._all = "".join(grids(self._directory / FIELDS)) if count else ""

    def write(self, time: float, fields: Mapping[str, OnGrid]) -> None:
        """Write one frame at a `time` [us]; `fields` by name, on rank 0."""
        together(self._comm, lambda: self._write(self._unit.number(float(time)), fields), root_only=True)
        self._count += 1

    def _write(self, time: float, fields: Mapping[str, OnGrid]) -> None:
        name = f"s{self._count:08d}"
        (self._directory / "fields").mkdir(exist_ok=True)
        with h5py.File(name, "w", driver="core", backing_store=False) as file:
            file.attrs.update(time=time, time_unit=self._unit.symbol, frame=self._count, run=self._run)
            for key, field in fields.items():
                data = file.create_dataset(key, data=field.values.reshape(*field.count[::-1]))
                data.attrs.update(unit=field.unit, low=field.low, size=field.size)
            file.flush()
            image = file.id.get_file_image()
        replace(self._directory / "fields" / f"{name}.h5", image)
        pieces = "".join(_grid(f"fields/{name}.h5", time, key, field) for key, field in fields.items())
        self._all += (f'<Grid Name="{name}" GridType="Collection" CollectionType="Spatial">\n'
                      f'<Time Value="{time}"/>\n{pieces}</Grid>\n')
        replace(self._directory / FIELDS, HEAD.format(Path(FIELDS).stem) + self._all + TAIL)


def _grid(file: str, time: float, name: str, field: OnGrid) -> str:
    """A uniform grid; in two dimensions it has one layer of nodes.  XDMF has z first."""
    nodes = [n + 1 for n in field.count] + [1] * (3 - len(field.count))
    low, size = ([*some, *[fill] * (3 - len(field.count))] for some, fill in ((field.low, 0.0), (field.size, 1.0)))

    def backwards(values: Sequence[float]) -> str:
        return " ".join(f"{v:.12g}" for v in values[::-1])

    cells = backwards([max(n - 1, 1) for n in nodes])
    plain = '<DataItem Dimensions="3" DataType="Float" Precision="8" Format="XML">{}</DataItem>'
    return (f'<Grid Name="{name}" GridType="Uniform">\n<Time Value="{time}"/>\n'
            f'<Topology TopologyType="3DCORECTMesh" Dimensions="{backwards(nodes)}"/>\n'
            f'<Geometry GeometryType="ORIGIN_DXDYDZ">{plain.format(backwards(low))}{plain.format(backwards(size))}'
            "</Geometry>\n"
            f'<Attribute Name="{name}" AttributeType="Scalar" Center="Cell" Unit="{field.unit}">'
            f'<DataItem Dimensions="{cells}" DataType="Float" Precision="8" Format="HDF">{file}:/{name}</DataItem>'
            "</Attribute>\n</Grid>\n")
