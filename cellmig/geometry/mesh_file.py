"""Boundary of the elements of a mesh file, read by meshio, with the groups of elements and lines that have names."""

from __future__ import annotations

import contextlib
import io
import os
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ..case.messages import show
from . import elements, obj, polygons, stl, wkt
from .elements import TINY

_SKIPPED = re.compile("cannot handle|not parse")  # in meshio's warnings about elements that it leaves out
MOST_VALUES = 50  # an array of whole numbers with more values is no numbering of groups


@dataclass(frozen=True)
class Boundary:
    """Boundary of the elements of a mesh file, in the file's unit of length.

    Attributes
    ----------
    loops : tuple of loops of points (x, y) -- the outer one counterclockwise, then the holes, clockwise.
    regions : tuple of (name, loops) -- around the elements of each named group; the even-odd rule tells the inside.
    lines : tuple of (name, ints) -- first points of the segments of each named part, counted through all `loops`.
    """

    loops: tuple
    regions: tuple = ()
    lines: tuple = ()

    @classmethod
    def of(cls, value: Any) -> Boundary:
        """Boundary from a table such as `written` returns.

        Raises ValueError where the table is none; the message is for the user.
        """
        try:
            loops = _loops(value["loops"])
            regions = tuple((str(name), _loops(region)) for name, region in value.get("regions", {}).items())
            lines = tuple((str(name), tuple(map(int, at))) for name, at in value.get("lines", {}).items())
            numbers = np.concatenate([*map(np.array, loops), *(np.array(o) for _, r in regions for o in r)])
            counts = np.array([k for _, at in lines for k in at], int)
            sound = np.isfinite(numbers).all() and (counts >= 0).all() and (counts < sum(map(len, loops))).all()
        except (TypeError, KeyError, ValueError, AttributeError, OverflowError):
            sound = False
        if not sound:
            raise ValueError(f"expects the name of a file of triangles, such as \"cell.msh\", not {show(value)}")
        return cls(loops, regions, lines)

    def written(self) -> dict:
        """The boundary as a table; a manifest that holds it does not need the mesh file."""
        table: dict[str, Any] = {"loops": [[list(p) for p in loop] for loop in self.loops]}
        table["regions"] = {name: [[list(p) for p in loop] for loop in loops] for name, loops in self.regions}
        table["lines"] = {name: list(at) for name, at in self.lines}
        return table


def _loops(value: Any) -> tuple:
    return tuple(tuple((float(x), float(y)) for x, y in loop) for loop in value)


def boundary(path: str) -> dict:
    """Boundary of the elements of a mesh file, as a table for `Boundary.of`.

    Raises ValueError where the file cannot be read or its elements form no region; the message is for the user.
    """
    mesh = read(path)
    elements.refuse_others(mesh, path)
    areas, lines = elements.rings(mesh, path)
    points = np.asarray(mesh.points, float)
    used = np.unique(np.concatenate([ring.ravel() for _, _, ring in areas]))
    if not np.isfinite(points[used]).all():
        raise ValueError(f"'{path}' has points whose coordinates are no finite numbers")
    if points.shape[1] > 2 and (depth := np.ptp(points[used, 2])) > TINY * np.ptp(points[used], axis=0).max():
        raise ValueError(f"'{path}' is not flat: z differs by {depth:.4g} among its triangles")
    points = points[:, :2]
    same = _coincident(points, used)
    areas, lines = ([(*part[:2], same[part[2]]) for part in parts] for parts in (areas, lines))
    first_of = _representatives(mesh, areas)
    owns = [first_of[number] == number for _, number, _ in areas]
    areas = [(order, number[own], ring[own]) for (order, number, ring), own in zip(areas, owns, strict=True)]
    around, of, along, line, points = elements.edges(areas, lines, points, path)
    loops = sorted(_chain(_edges(around, points, path)), key=lambda loop: -polygons.area(points[loop]))
    starts = np.concatenate([np.array(loop) for loop in loops])
    ends = np.concatenate([np.roll(loop, -1) for loop in loops])
    place = {frozenset(pair): k for k, pair in enumerate(zip(starts.tolist(), ends.tolist(), strict=True))}
    regions: dict[str, list] = {}
    parts: dict[str, list[int]] = {}
    wide = elements.dimensions(mesh) == 2
    for name, members in groups(mesh).items():
        inside = np.isin(of, first_of[members[wide[members]]])
        regions[name] = [_points(points, loop) for loop in _chain(_edges(around[inside], points, path))]
        of_group = along[np.isin(line, members[~wide[members]])].tolist()
        at = sorted({place[pair] for pair in map(frozenset, of_group) if pair in place})
        parts |= {name: at} if at else {}
        if not inside.any() and at:
            del regions[name]
    outlines = tuple(_points(points, loop) for loop in loops)
    return Boundary(outlines, tuple(regions.items()), tuple(parts.items())).written()


def read(path: str) -> Any:
    """The mesh of a file, as meshio has it.

    Raises ValueError where the file cannot be read, also where meshio would end the program; the message is for the
    user.
    """
    if not os.path.isfile(path):
        raise ValueError(f"'{path}': no such file")
    with contextlib.redirect_stdout(io.StringIO()) as output, contextlib.redirect_stderr(output):
        import meshio

        try:
            own = _OWN.get(os.path.splitext(path)[1].lower())
            mesh = own(path) if own else meshio.read(path)
            for block in mesh.cells:  # meshio calls faces of two corners in PLY files triangles
                corners, around = np.shape(block.data)[-1], (elements.AROUND | elements.ALONG).get(block.type)
                if len(block.data) and around and len(around) != corners:
                    raise ValueError(f"it has faces of {corners} corners")
            warning = " ".join(output.getvalue().split())
            if not _SKIPPED.search(warning):
                return mesh
            lines = [warning]
        except UnicodeDecodeError:
            lines = ["it is neither text nor a whole binary file"]
        except (Exception, SystemExit) as error:  # meshio's readers raise any exception on a broken file
            lines = [line.strip() for line in (*output.getvalue().splitlines(), str(error)) if line.strip(" .01")]
    raise ValueError(f"'{path}' cannot be read: {lines[0] if lines else 'meshio knows no reason'}") from None


def _read_ply(path: str) -> Any:
    """The mesh of a PLY file, whose faces may have the one of their two usual names that meshio does not know."""
    import meshio

    with open(path, "rb") as stream:
        head, end, rest = stream.read().partition(b"end_header")
    if not end:
        raise ValueError("its head does not end: there is no end_header")
    return meshio.read(io.BytesIO(re.sub(rb"\bvertex_index\b", b"vertex_indices", head) + end + rest), "ply")


_OWN = {".obj": obj.read, ".ply": _read_ply, ".stl": stl.read, ".wkt": wkt.read}  # where meshio reads less


def _representatives(mesh: Any, areas: list[tuple]) -> np.ndarray:
    """As `elements.representatives`: Gmsh's format 2.2 lists an element once for each of its physical groups."""
    tags = mesh.cell_data.get("gmsh:physical")
    sizes = [len(block.data) for block in mesh.cells]
    return elements.representatives(areas, np.zeros(sum(sizes), int) if tags is None else np.concatenate(tags))


def _coincident(points: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Number of the first of the points that coincide with each, as in an STL file (n,) int."""
    places, first, which = np.unique(points[used], axis=0, return_index=True, return_inverse=True)
    pairs = cKDTree(places).query_pairs(TINY * np.ptp(places, axis=0).max(), output_type="ndarray")
    label = polygons.clusters(pairs, len(places))
    first_of = np.full(len(places), len(used))
    np.minimum.at(first_of, label, first)
    same = np.arange(len(points))
    same[used] = used[first_of[label[which.reshape(-1)]]]
    return same


def _edges(edges: np.ndarray, points: np.ndarray, path: str) -> np.ndarray:
    """Those of the `edges` (k, 2) around counterclockwise elements that belong to one element alone."""
    key, back = edges @ [len(points), 1], edges @ [1, len(points)]
    once, number = np.unique(key, return_counts=True)
    if len(twice := once[number > 1]):
        x, y = points[list(divmod(int(twice[0]), len(points)))].mean(axis=0)
        raise ValueError(f"'{path}' has triangles that overlap, as at ({x:.4g}, {y:.4g})")
    return edges[~np.isin(key, back)]


def _chain(edges: np.ndarray) -> list[list[int]]:
    """Closed loops of directed edges (k, 2); loops that meet in a point may come as one or as several."""
    after: dict[int, list[int]] = {}
    for start, end in edges[::-1].tolist():
        after.setdefault(start, []).append(end)
    loops = []
    for first, _ in edges.tolist():
        while after[first]:
            loop = [first]
            while (point := after[loop[-1]].pop()) != first:
                loop.append(point)
            loops.append(loop)
    return loops


def _points(points: np.ndarray, loop: list[int]) -> tuple:
    return tuple(map(tuple, points[loop].tolist()))


def groups(mesh: Any) -> dict[str, np.ndarray]:
    """Numbers (k,) int of the elements of each named group of a mesh.

    A name is that of a cell set, such as a physical group of Gmsh; "ref=2" for the elements where the array `ref` of
    whole numbers is 2; or that of an array which is 1 in the group and 0 elsewhere.
    """
    first = np.concatenate([[0], np.cumsum([len(block.data) for block in mesh.cells])])
    tags = np.concatenate([np.zeros(0, int), *mesh.cell_data.get("gmsh:physical", ())])
    of = elements.dimensions(mesh)
    found = {name: np.flatnonzero((tags == data[0]) & (of == data[1])) if len(tags) else np.zeros(0, int)
             for name, data in mesh.field_data.items() if np.size(data) == 2}
    for name, blocks in mesh.cell_sets.items():
        if not name.startswith("gmsh:"):
            members = [f + np.asarray(b, int) for f, b in zip(first, blocks, strict=False) if b is not None]
            found[name] = np.concatenate([np.zeros(0, int), *members])
    for name, data in mesh.cell_data.items():
        if any(np.ndim(d) != 1 or d.dtype.kind not in "biuf" for d in data):
            continue
        values = np.concatenate([np.zeros(0), *data])
        if not (np.isfinite(values).all() and (values == np.rint(values)).all()):
            continue
        if len(known := np.unique(values)) <= MOST_VALUES:
            named = {cells.tobytes() for cells in found.values()}  # groups that have a name already
            of_value = {f"{name}={int(value)}": np.flatnonzero(values == value) for value in known}
            found |= {key: cells for key, cells in of_value.items() if cells.tobytes() not in named}
            if set(known.tolist()) == {0.0, 1.0}:
                found.setdefault(name, np.flatnonzero(values == 1))
    return found
