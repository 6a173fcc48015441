"""Fields of particles as XDMF over HDF5: a file for each rank and frame, so that a killed run leaves whole frames.

``cells.xdmf`` (rank 0) lists the frames of all ranks, for ParaView; ``rankNNNN.xdmf`` those of one rank, also for
meshio's ``TimeSeriesReader``.  The frames are in ``rankNNNN/sNNNNNNNN.h5``, by number.  In two dimensions they are
points; in three, tetrahedra, and ``surface.xdmf`` has the triangles of the surfaces with the same fields: a rank writes
the elements whose first corner it owns, and copies of the particles of others that they need.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import h5py
import numpy as np

from ..case.time_unit import MICROSECOND, TimeUnit
from .directory import INDEX, OutputError, replace, together
from .mesh import Elements

if TYPE_CHECKING:
    from mpi4py import MPI

HEAD = ('<?xml version="1.0" ?>\n<Xdmf Version="3.0">\n<Domain>\n'
         '<Grid Name="{}" GridType="Collection" CollectionType="Temporal">\n')
TAIL = "</Grid>\n</Domain>\n</Xdmf>\n"
_KIND = {1: "Scalar", 3: "Vector", 9: "Tensor"}
_TOPOLOGY = {"topology": 'TopologyType="Polyvertex" NodesPerElement="1"',
             "tetrahedra": 'TopologyType="Tetrahedron"', "triangles": 'TopologyType="Triangle"'}
_MESH = ("geometry", *_TOPOLOGY)
SURFACE, FIELDS = "surface.xdmf", "fields.xdmf"  # lists beside INDEX


def _padded(values: np.ndarray) -> np.ndarray:
    """Values in the shapes of XDMF: scalars (n,), vectors (n, 3) with z = 0, tensors (n, 9)."""
    if values.ndim == 3:
        return np.ascontiguousarray(values).reshape(len(values), 9)
    if values.ndim == 2 and values.shape[1] < 3:
        return np.pad(values, ((0, 0), (0, 3 - values.shape[1])))
    return values


def _file(rank: int, frame: int) -> str:
    return f"{_name(rank)}/s{frame:08d}.h5"


def _name(rank: int) -> str:
    return f"rank{rank:04d}"


def _item(file: str, name: str, data: np.ndarray, n: int) -> str:
    kind = "Int" if data.dtype.kind == "i" else "Float"
    shape = " ".join(str(d) for d in (n, *data.shape[1:]))
    return (f'<DataItem Dimensions="{shape}" DataType="{kind}" Precision="{data.itemsize}" Format="HDF">'
            f"{file}:/{name}</DataItem>")


def _grid(rank: int, frame: int, time: float, sizes: Mapping[str, int], elements: str,
          data: Mapping[str, np.ndarray], units: Mapping[str, str]) -> str:
    """The `elements` of one rank in one frame; of `data` only types and shapes matter, which ranks have in common.

    Units are XML attributes, which readers of XDMF ignore, and attributes in HDF5.
    """
    file, n, m = _file(rank, frame), sizes["geometry"], sizes[elements]
    lines = [f'<Grid Name="{_name(rank)}" GridType="Uniform">', f'<Time Value="{time}"/>',
             f'<Topology {_TOPOLOGY[elements]} NumberOfElements="{m}">'
             f'{_item(file, elements, data[elements], m)}</Topology>',
             f'<Geometry GeometryType="XYZ">{_item(file, "geometry", data["geometry"], n)}</Geometry>']
    for name, values in data.items():
        if name not in _MESH:
            kind = _KIND[values.shape[1] if values.ndim > 1 else 1]
            lines.append(f'<Attribute Name="{name}" AttributeType="{kind}" Center="Node" Unit="{units[name]}">'
                         f"{_item(file, name, values, n)}</Attribute>")
    return "\n".join([*lines, "</Grid>\n"])


class Frames:
    """Writer of the frames of a run; collective.

    Parameters
    ----------
    directory : Path -- of the run.
    comm : mpi4py communicator.
    fields : dict -- name of each field, in order, and its unit, e.g. ``{"u": "um"}``; at least id, X and u.
    count : int -- existing frames, after `cut_frames`, of any number of ranks.
    run : str -- id of the run, in each file.
    unit : TimeUnit -- of times and velocities in the files.
    elements : Elements -- in three dimensions this rank's "tetrahedra" and "triangles" between its particles, which may
        be replaced from frame to frame.
    """

    def __init__(self, directory: Path, comm: MPI.Intracomm, fields: Mapping[str, str], count: int = 0,
                 run: str = "", elements: Elements | None = None, unit: TimeUnit = MICROSECOND) -> None:
        self.directory, self.comm, self.run, self._unit = Path(directory), comm, run, unit
        self.fields = {name: unit.field(of) for name, of in fields.items()}
        self._rates = [name for name, of in fields.items() if of.endswith("/us")]
        self.count, self.elements = count, elements
        self._shown = {INDEX: "tetrahedra", SURFACE: "triangles"} if elements else {INDEX: "topology"}
        self._mine, self._all = "", dict.fromkeys(self._shown, "")
        together(comm, lambda: (self.directory / _name(comm.rank)).mkdir(parents=True, exist_ok=True))
        if count:
            self._all = {index: "".join(grids(self.directory / index)) for index in self._shown}
            self._mine = "".join(grids(self.directory / f"{_name(comm.rank)}.xdmf"))

    def write(self, time: float, step: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Write one frame, which is in all files when this returns, and in none before.

        Parameters
        ----------
        time : float -- [us].
        step : int -- number of steps taken.
        arrays : dict -- fields of this rank's n >= 0 particles by name, int32, int64 or float64, (n,), (n, d) or
            (n, 3, 3), in the code's units; X (n, d) are reference positions [um], u (n, d) displacements [um].
        """
        if arrays.keys() != self.fields.keys():
            raise ValueError(f"fields {sorted(arrays.keys() ^ self.fields.keys())} are declared or given, not both")
        n, time = len(arrays["X"]), self._unit.number(float(time))
        data = {"geometry": _padded(arrays["X"] + arrays["u"])}
        data |= {name: _padded(np.asarray(arrays[name])) for name in self.fields}
        data |= {name: self._unit.size * data[name] for name in self._rates}
        if self.elements is None:
            data["topology"] = np.arange(n, dtype=np.int32).reshape(n, 1)
        else:
            data = {name: self.elements.complete(values) for name, values in data.items()} | self.elements.local
        sizes = together(self.comm, lambda: self._write_mine(time, step, n, data))
        together(self.comm, lambda: self._write_index(time, sizes, data), root_only=True)
        self.count += 1

    def _write_mine(self, time: float, step: int, n: int, data: Mapping[str, np.ndarray]) -> dict[str, int]:
        sizes = {name: len(values) for name, values in data.items()}
        if n == 0:
            return sizes
        # The file is made in memory, as HDF5 would crash where the disk is full.
        with h5py.File(f"frame{self.count}", "w", driver="core", backing_store=False) as file:
            file.attrs.update(time=time, time_unit=self._unit.symbol, step=step, frame=self.count, run=self.run,
                              owned=n)
            for name, values in data.items():
                unit = "um" if name == "geometry" else self.fields.get(name, "")
                file.create_dataset(name, data=values).attrs["unit"] = unit
            file.flush()
            image = file.id.get_file_image()
        rank, name = self.comm.rank, _name(self.comm.rank)
        replace(self.directory / _file(rank, self.count), image)
        self._mine += _grid(rank, self.count, time, sizes, self._shown[INDEX], data, self.fields)
        replace(self.directory / f"{name}.xdmf", HEAD.format(name) + self._mine + TAIL)
        return sizes

    def _write_index(self, time: float, sizes: list[dict[str, int]], data: Mapping[str, np.ndarray]) -> None:
        for index, elements in self._shown.items():
            grids = (_grid(rank, self.count, time, of_rank, elements, data, self.fields)
                     for rank, of_rank in enumerate(sizes) if of_rank["geometry"])
            self._all[index] += (f'<Grid Name="s{self.count:08d}" GridType="Collection" CollectionType="Spatial">\n'
                                 f'<Time Value="{time}"/>\n{"".join(grids)}</Grid>\n')
            replace(self.directory / index, HEAD.format(Path(index).stem) + self._all[index] + TAIL)


def check_frames(directory: Path, count: int, run: str) -> None:
    """Raise OutputError if a frame of another run is among the first `count` in any list."""
    lists = directory / INDEX, directory / SURFACE, directory / FIELDS, *directory.glob("rank*.xdmf")
    for path in sorted({directory / item for index in lists for grid in grids(index)
                        for item in re.findall(r"(?:rank\d+|fields)/s\d+\.h5", grid)}):
        if int(path.stem[1:]) < count and path.exists():
            with _opened(path) as file:
                if file.attrs.get("run") != run:
                    raise OutputError(f"'{path}' is of another run than the checkpoint: take away what belongs to "
                                      "another, or begin anew")


def cut_frames(directory: Path, comm: MPI.Intracomm, count: int) -> None:
    """Delete all frames of a run but the first `count`; collective, rank 0 does it.

    Lists are cut before files are deleted, so that listed files exist even if the run is killed.  Raises OutputError
    where frames are missing.
    """
    directory = Path(directory)

    def act() -> None:
        for index in (directory / INDEX, directory / SURFACE, directory / FIELDS):
            kept = grids(index)[:count]
            if len(kept) < count and (index.exists() or index.name == INDEX):
                raise OutputError(f"'{index}' has {len(kept)} frames where a checkpoint has {count}: it cannot go on "
                                  "there")
            if index.exists():
                replace(index, HEAD.format(index.stem) + "".join(kept) + TAIL)
        for path in directory.glob("rank*.xdmf"):
            kept = [grid for grid in grids(path) if _count(grid) < count]
            replace(path, HEAD.format(path.stem) + "".join(kept) + TAIL)
        for path in (*directory.glob("rank*/s*.h5"), *directory.glob("fields/s*.h5")):
            if int(path.stem[1:]) >= count:
                path.unlink()
        for path in directory.glob("**/*.part"):
            path.unlink()

    together(comm, act, root_only=True)


_FILE = re.compile(r"/s(\d{8})\.h5:")


def _count(grid: str) -> int:
    """Number of the frame that a grid is of."""
    return int(_FILE.findall(grid)[0])


def grids(path: Path) -> list[str]:
    """The grids in the collection of a file that `Frames` wrote; none if it does not exist."""
    if not path.exists():
        return []
    _, mark, body = path.read_text(encoding="utf-8").partition('GridType="Collection" CollectionType="Temporal">\n')
    if not mark or not body.endswith(TAIL):
        raise OutputError(f"'{path}' is not a list of frames as it was written")
    body = body.removesuffix(TAIL)
    marks = [m.start() for m in re.finditer(r'^<Grid Name="s\d', body, re.MULTILINE)]
    marks = marks or [m.start() for m in re.finditer(r'^<Grid Name="rank', body, re.MULTILINE)]
    return [body[a:b] for a, b in pairwise([*marks, len(body)])] if marks else []


@dataclass(frozen=True)
class Frame:
    """A written frame of a run, in the files of its ranks; `time` : in the unit of the run."""

    time: float
    files: tuple[Path, ...]

    def read(self) -> dict[str, np.ndarray]:
        """All fields in the order of ids: scalars (n,), vectors (n, 3), tensors (n, 9)."""
        pieces = []
        for path in self.files:
            with _opened(path) as file:
                n = file.attrs.get("owned")  # after them there are copies of other ranks' particles
                pieces.append({name: data[:n] for name, data in file.items() if name not in _MESH})
        fields = {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}
        order = np.argsort(fields["id"], kind="stable")
        return {name: values[order] for name, values in fields.items()}

    def triangles(self) -> np.ndarray:
        """Triangles of the surfaces in three dimensions (m, 3) int, by ids of particles, in order."""
        pieces = [np.zeros((0, 3), np.int64)]
        for path in self.files:
            with _opened(path) as file:
                pieces.append(file["id"][()][file["triangles"][()]])
        found = np.concatenate(pieces)
        return found[np.lexsort(found.T)]

    @property
    def unit(self) -> TimeUnit:
        """Unit of the time."""
        with _opened(self.files[0]) as file:
            return TimeUnit(str(file.attrs.get("time_unit", "us")))

    def units(self) -> dict[str, str]:
        """Units by field."""
        with _opened(self.files[0]) as file:
            return {name: str(data.attrs["unit"]) for name, data in file.items() if name not in _MESH}


def _opened(path: Path) -> h5py.File:
    try:
        return h5py.File(path, "r", locking=False)
    except OSError as error:
        raise OutputError(f"cannot read '{path}': {error}") from error


def frames(directory: Path) -> list[Frame]:
    """The whole frames of a run by time; the run may be at work.  Raises OutputError for an invalid index."""
    index = Path(directory) / INDEX
    if not index.exists():
        return []
    try:
        found = []
        for grid in ElementTree.parse(index).getroot().findall("./Domain/Grid/Grid"):
            items = [(item.text or "").split(":")[0] for item in grid.findall("./Grid/Geometry/DataItem")]
            time = float(grid.findall("Time")[0].attrib["Value"])
            found.append(Frame(time, tuple(index.parent / item for item in items)))
        return found
    except (ElementTree.ParseError, AttributeError, ValueError, TypeError) as error:
        raise OutputError(f"'{index}' is not an index of frames: {error}") from error
