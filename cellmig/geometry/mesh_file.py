"""Meshed shapes from files: their boundary, and those of what they name, by meshio."""

from __future__ import annotations

import contextlib
import io
import os
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ..case.messages import show
from . import elements, polygons, wkt
from .elements import TINY

_LOST = re.compile("cannot handle|not parse")  # in what meshio warns of: it goes on without those elements
MOST_VALUES = 50  # of an array of numbers that names groups: one with more names every triangle, or none


@dataclass(frozen=True)
class Boundary:
    """Closed loops around the elements of a file, in its own unit of length, and what it has names for.

    loops : tuple of loops of points (x, y), the outer one counterclockwise, then holes, clockwise.
    regions : tuple of (name, loops) -- around the triangles of each named group, parity tells what is inside.
    lines : tuple of (name, ints) -- where the segments of each named part begin, counted through all `loops`.
    """

    loops: tuple
    regions: tuple = ()
    lines: tuple = ()

    @classmethod
    def of(cls, value: Any) -> Boundary:
        """From a table, as `written` makes it.  Raises ValueError; its text is for the user."""
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
        """As a table: a manifest needs the file no more."""
        table = {"loops": [[list(p) for p in loop] for loop in self.loops]}
        table["regions"] = {name: [[list(p) for p in loop] for loop in loops] for name, loops in self.regions}
        table["lines"] = {name: list(at) for name, at in self.lines}
        return table


def _loops(value: Any) -> tuple:
    return tuple(tuple((float(x), float(y)) for x, y in loop) for loop in value)


def boundary(path: str) -> dict:
    """The boundary in a file of triangles, as a table for `Boundary.of`.

    Raises ValueError; its text is for the user.
    """
    mesh = _read(path)
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
    areas, lines = ([(order, number, same[ring]) for order, number, ring in part] for part in (areas, lines))
    stands = _stands(mesh, areas)
    areas = [(order, number[own], ring[own]) for order, number, ring in areas for own in [stands[number] == number]]
    around, of, along, line, points = elements.edges(areas, lines, points, path)
    loops = sorted(_chain(_edges(around, points, path)), key=lambda loop: -polygons.area(points[loop]))
    starts = np.concatenate([np.array(loop) for loop in loops])
    ends = np.concatenate([np.roll(loop, -1) for loop in loops])
    place = {frozenset(pair): k for k, pair in enumerate(zip(starts.tolist(), ends.tolist(), strict=True))}
    regions, parts = {}, {}
    for name, (wide, thin) in _groups(mesh).items():
        inside = np.isin(of, stands[wide])
        regions[name] = [_points(points, loop) for loop in _chain(_edges(around[inside], points, path))]
        of_group = along[np.isin(line, thin)].tolist()
        at = sorted({place[pair] for pair in map(frozenset, of_group) if pair in place})
        parts |= {name: at} if at else {}
        if not inside.any() and at:
            del regions[name]
    outlines = tuple(_points(points, loop) for loop in loops)
    return Boundary(outlines, tuple(regions.items()), tuple(parts.items())).written()


def _read(path: str) -> Any:
    """A file as meshio reads it, which prints its complaints, or ends the program."""
    if not os.path.isfile(path):
        raise ValueError(f"'{path}': no such file")
    with contextlib.redirect_stdout(io.StringIO()) as said, contextlib.redirect_stderr(said):
        import meshio

        try:
            with np.errstate(over="ignore"):  # of its guess whether an STL file is binary
                mesh = wkt.read(path) if path.lower().endswith(".wkt") else meshio.read(path)
            lost = " ".join(said.getvalue().split())
            if not _LOST.search(lost):
                return mesh
            lines = [lost]
        except (Exception, SystemExit) as error:  # its readers raise whatever a broken file leads to
            lines = [line.strip() for line in (*said.getvalue().splitlines(), str(error)) if line.strip(" .01")]
    raise ValueError(f"'{path}' cannot be read: {lines[0] if lines else 'meshio knows no reason'}") from None


def _stands(mesh: Any, areas: list[tuple]) -> np.ndarray:
    """Number of the element that stands for each of the file's cells: Gmsh 2.2 lists those of two groups twice."""
    tags = mesh.cell_data.get("gmsh:physical")
    sizes = [len(block.data) for block in mesh.cells]
    return elements.twins(areas, np.zeros(sum(sizes), int) if tags is None else np.concatenate(tags))


def _coincident(points: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Number of the point that stands for each (n,): where several coincide, as in an STL file, the first."""
    places, first, which = np.unique(points[used], axis=0, return_index=True, return_inverse=True)
    pairs = cKDTree(places).query_pairs(TINY * np.ptp(places, axis=0).max(), output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(places), len(places)))
    number, label = connected_components(links, directed=False)
    stands = np.full(number, len(used))
    np.minimum.at(stands, label, first)
    same = np.arange(len(points))
    same[used] = used[stands[label[which.reshape(-1)]]]
    return same


def _edges(edges: np.ndarray, points: np.ndarray, path: str) -> np.ndarray:
    """Edges (k, 2) around counterclockwise elements that have one on their left only."""
    key, back = edges @ [len(points), 1], edges @ [1, len(points)]
    once, number = np.unique(key, return_counts=True)
    if len(twice := once[number > 1]):
        x, y = points[list(divmod(int(twice[0]), len(points)))].mean(axis=0)
        raise ValueError(f"'{path}' has triangles that overlap, as at ({x:.4g}, {y:.4g})")
    return edges[~np.isin(key, back)]


def _chain(edges: np.ndarray) -> list[list[int]]:
    """Closed loops of directed edges (k, 2); those that meet in a point are parted there, or not."""
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


def _groups(mesh: Any) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """The file's cells of each group that has a name, those of two dimensions and those of one.

    Names are those of cell sets, such as the physical groups of Gmsh; "ref=2" for where an array of whole numbers is 2;
    and an array's own name for where it is 1, if it is 0 elsewhere.
    """
    sizes = [len(block.data) for block in mesh.cells]
    first = np.concatenate([[0], np.cumsum(sizes)])
    wide = np.repeat([block.type in elements.AREAS for block in mesh.cells], sizes)
    tags = np.concatenate([np.zeros(0, int), *mesh.cell_data.get("gmsh:physical", ())])
    groups = {name: np.flatnonzero((tags == data[0]) & (wide == (data[1] == 2))) if len(tags) else np.zeros(0, int)
              for name, data in mesh.field_data.items() if np.size(data) == 2}
    for name, blocks in mesh.cell_sets.items():
        if not name.startswith("gmsh:"):
            members = [f + np.asarray(b, int) for f, b in zip(first, blocks, strict=False) if b is not None]
            groups[name] = np.concatenate([np.zeros(0, int), *members])
    for name, data in mesh.cell_data.items():
        if any(d.ndim != 1 or d.dtype.kind not in "biuf" for d in data):
            continue
        values = np.concatenate([np.zeros(0), *data])
        if not (np.isfinite(values).all() and (values == np.rint(values)).all()):
            continue
        if len(known := np.unique(values)) <= MOST_VALUES:
            named = {cells.tobytes() for cells in groups.values()}  # which need no number
            of_value = {f"{name}={int(value)}": np.flatnonzero(values == value) for value in known}
            groups |= {key: cells for key, cells in of_value.items() if cells.tobytes() not in named}
            if set(known.tolist()) == {0.0, 1.0}:
                groups.setdefault(name, np.flatnonzero(values == 1))
    return {name: (cells[wide[cells]], cells[~wide[cells]]) for name, cells in groups.items()}
