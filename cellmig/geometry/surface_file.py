"""Closed surfaces from files of triangles or of elements with a volume, read by meshio, with their named groups."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from ..case.messages import show, suggest
from . import elements, mesh_file
from .closing import closed, counted
from .surfaces import ClosedSurface
from .triangles import area_vectors, dot, lengths

MOST = 200_000  # largest number of triangles
# Corners around the faces of elements with a volume, as VTK numbers them.
FACES = {"tetra": ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)),
         "pyramid": ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
         "wedge": ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
         "hexahedron": ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))}
READ = "triangles and quadrilaterals, tetrahedra, pyramids, wedges and hexahedra, of first order"
_FACET = {".stl": re.compile(rb"(?i)\s*facet\b"), ".obj": re.compile(rb"\s*f\s")}  # lines of text that hold an element


@dataclass(frozen=True)
class Shells:
    """Closed surfaces of a file, in its unit of length; as text, which is short and quickly compared.

    Attributes
    ----------
    vertices : str -- coordinates of the vertices, "x y z, x y z, …".
    triangles : str -- vertices of the triangles of all surfaces, from 0, "a b c, a b c, …", in any sense.
    parts : tuple of (name, str) -- numbers of the triangles of each named group, from 0, "a b c …".
    regions : tuple of (name, str) -- triangles around the elements with a volume of each named group.
    path : str -- the file; "" if the surfaces are not from one.
    element : tuple of int -- number of the file's element of which each triangle is; () for the same number.
    """

    vertices: str
    triangles: str
    parts: tuple[tuple[str, str], ...] = ()
    regions: tuple[tuple[str, str], ...] = ()
    path: str = field(default="", compare=False)
    element: tuple[int, ...] = field(default=(), compare=False, repr=False)

    @classmethod
    def of(cls, value: Any) -> Shells:
        """Surfaces from a table such as `written` returns, in which rows may be lists of numbers, too.

        Raises ValueError where the table is none; the message is for the user.
        """
        if isinstance(value, Shells):
            return value
        try:
            parts, regions = (tuple((str(name), _text(rows)) for name, rows in value.get(key, {}).items())
                              for key in ("parts", "regions"))
            found = cls(_text(value["vertices"]), _text(value["triangles"]), parts, regions)
            m, known = len(found._all), [_ints(text, 1) for _, text in parts]
            sound = found._points.size and all(((k >= 0) & (k < m)).all() for k in known)
            _ = [_ints(text, 3) for _, text in regions]
        except (TypeError, KeyError, ValueError, AttributeError, OverflowError):
            sound = False
        if not sound:
            raise ValueError("expects the name of a file of triangles in space, such as \"cell.stl\", "
                             f"not {show(value)}")
        return found

    def written(self) -> dict:
        """The surfaces as a table; a manifest that holds it does not need the file."""
        return {"vertices": self.vertices, "triangles": self.triangles, "parts": dict(self.parts),
                "regions": dict(self.regions)}

    @cached_property
    def _points(self) -> np.ndarray:
        return np.array(self.vertices.replace(",", " ").split(), float).reshape(-1, 3)

    @cached_property
    def _all(self) -> np.ndarray:
        return _ints(self.triangles, 3)

    def name(self, triangle: int) -> str:
        """Text for a triangle, given by its index, in a message, with its line where the file is text."""
        n = self.element[triangle] if self.element else triangle
        pattern = _FACET.get(os.path.splitext(self.path)[1].lower())
        if pattern is None or not os.path.isfile(self.path):
            return counted(n)
        with open(self.path, "rb") as stream:
            lines = [number for number, line in enumerate(stream, 1) if pattern.match(line)]
        return f"{counted(n)} (line {lines[n]})" if n < len(lines) else counted(n)

    def inside(self, region: str | None) -> np.ndarray:
        """Whether each triangle is around a `region` of triangles (m,) bool, nowhere without one."""
        chosen = np.zeros(len(self._all), bool)
        if region not in dict(self.regions):
            chosen[_ints(dict(self.parts).get(region or "", ""), 1)] = True
        return chosen

    def named(self, region: str | None = None) -> dict[str, np.ndarray]:
        """Which triangles around all but the `region` are of each named part (m,) bool; "ref=2" names none."""
        found = {}
        for name, text in self.parts:
            which = np.zeros(len(self._all), bool)
            which[_ints(text, 1)] = True
            which = which[~self.inside(region)]
            if which.any() and "=" not in name and name not in (region, "surface"):
                found[name] = which
        return found

    def body(self, region: str | None = None) -> tuple[ClosedSurface, dict[str, np.ndarray]]:
        """The surface around all but a nucleus that is a `region`, and the numbers of its parts by their names.

        Raises ValueError if it is not closed and of one piece; the message is for the user.
        """
        named = self.named(region)
        outside = np.flatnonzero(~self.inside(region))
        kinds, kind = np.unique(np.array([np.zeros(len(outside)), *named.values()]).T, axis=0, return_inverse=True)
        numbers = {name: np.flatnonzero(kinds[:, k]) for k, name in enumerate(named, start=1)}
        try:
            return closed(self._points, self._all[outside], kind.reshape(-1),
                          lambda k: self.name(int(outside[k]))), numbers
        except ValueError as error:
            raise ValueError(f"{self._who}{error}{self._hint(error)}") from None

    def nucleus(self, region: str) -> ClosedSurface:
        """The surface around a named region.

        Raises ValueError if the file has none of this name, or it is not closed; the message is for the user.
        """
        regions, parts = dict(self.regions), dict(self.parts)
        if region not in {**regions, **parts}:
            who = f"'{self.path}'" if self.path else "the file"
            raise ValueError(f"{who} has no group '{region}'{suggest(region, [*regions, *parts])}")
        inside = np.flatnonzero(self.inside(region))
        triangles = _ints(regions[region], 3) if region in regions else self._all[inside]
        if region in regions and np.isin(triangles, self._all).any():
            raise ValueError(f"'{region}' reaches the surface; a nucleus lies within")
        try:
            return closed(self._points, triangles, None,
                          counted if region in regions else lambda k: self.name(int(inside[k])))
        except ValueError as error:
            raise ValueError(f"{self._who}'{region}': {error}") from None

    @property
    def _who(self) -> str:
        return f"'{self.path}': " if self.path else ""

    def _hint(self, error: ValueError) -> str:
        """End of a message about a surface of several pieces."""
        return ("; a nucleus has a file of its own, nucleus_file, or is a named group of this one, nucleus_region"
                if "pieces, not one" in str(error) else "")


def _text(rows: Any) -> str:
    """Rows of numbers as text; what is text already stays."""
    return rows if isinstance(rows, str) else ", ".join(" ".join(map(repr, np.atleast_1d(row).tolist()))
                                                        for row in np.array(rows))


def _ints(text: str, width: int) -> np.ndarray:
    """Whole numbers in a text, in rows of a `width`, (n, width) int; for a width of one (n,)."""
    found = np.array(text.replace(",", " ").split(), int)
    return found.reshape(-1, width) if width > 1 else found


def shells(path: str) -> Shells:
    """The surfaces in a mesh file: around all elements with a volume, or if there are none, all triangles.

    Raises ValueError where the file cannot be read; the message is for the user.
    """
    mesh = mesh_file.read(path)
    points = np.asarray(mesh.points, float)
    _refuse_others(mesh, path)
    if points.ndim != 2 or points.shape[1] < 3:
        raise ValueError(f"'{path}' is flat: its points have no z")
    ring, owner = _faces(mesh, path)
    corners = np.unique(ring[ring >= 0])
    if np.ptp(points[corners, 2]) == 0.0:
        raise ValueError(f"'{path}' is flat: all its triangles have one z; in two dimensions, shape \"mesh\" reads it")
    of = elements.dimensions(mesh)[owner]
    first, same = np.unique(np.sort(ring, axis=1), axis=0, return_index=True, return_inverse=True)[1:]
    same = same.reshape(-1)

    def once(chosen: np.ndarray) -> np.ndarray:
        """Faces of one of the chosen elements with a volume, (k,) int, by their first place."""
        return np.sort(first[np.bincount(same[chosen], minlength=len(first)) == 1])

    around = once(of == 3) if (of == 3).any() else np.sort(first)
    if len(around) > MOST:
        raise ValueError(f"'{path}' has {len(around)} triangles: {MOST} are the most, and a fiftieth of the number of "
                         "particles on the surface shows its shape as well")
    tri, face = _split(ring[around], points[:, :3])
    parts, regions = {}, {}
    for name, members in mesh_file.groups(mesh).items():
        chosen = np.isin(owner, members)
        at = np.flatnonzero(np.isin(same[around[face]], same[chosen & (of == 2)]))
        if len(at):
            parts[name] = at
        if (chosen & (of == 3)).any():
            regions[name] = _split(ring[once(chosen & (of == 3))], points[:, :3])[0]
    used, number = np.unique(np.concatenate([tri, *regions.values()]), return_inverse=True)
    number = number.reshape(-1, 3)
    begin = np.cumsum([0, len(tri), *map(len, regions.values())])
    rows = [number[start:end] for start, end in pairwise(begin)]
    element = () if (of == 3).any() else tuple(owner[around[face]].tolist())
    return Shells(_text(points[used, :3]), _text(rows[0]), tuple((name, _text(at)) for name, at in parts.items()),
                  tuple((name, _text(row)) for name, row in zip(regions, rows[1:], strict=True)), path, element)


def _refuse_others(mesh: Any, path: str) -> None:
    """Raise ValueError if a mesh has elements that are not read, or none that bounds a volume."""
    known, others = {*elements.AROUND, "polygon", *FACES, *elements.ALONG, "vertex"}, dict[str, int]()
    for block in mesh.cells:
        if block.type not in known or (block.type == "polygon" and np.shape(block.data)[1] not in (3, 4)):
            others[block.type] = others.get(block.type, 0) + len(block.data)
    if others:
        listed = ", ".join(f"{n} of type {kind}" for kind, n in sorted(others.items()))
        raise ValueError(f"'{path}' has elements that are not read: {listed}; a cell in space is made of {READ}")
    if not (elements.dimensions(mesh) > 1).any():
        raise ValueError(f"'{path}' has no triangles")


def _faces(mesh: Any, path: str) -> tuple[np.ndarray, np.ndarray]:
    """Corners around all area elements and all faces of others (k, 4) int, -1 after three; the element of each (k,)."""
    rings, owners, begin = [np.zeros((0, 4), int)], [np.zeros(0, int)], 0
    for block in mesh.cells:
        data, number = elements.whole(block.data, len(mesh.points), path), begin + np.arange(len(block.data))
        begin += len(block.data)
        around = FACES.get(block.type, (tuple(range(data.shape[1])),))
        for corners in around if block.type not in (*elements.ALONG, "vertex") else ():
            ring = data[:, list(corners)]
            rings.append(np.column_stack([ring, np.full((len(ring), 4 - ring.shape[1]), -1)]))
            owners.append(number)
    ring, owner = np.concatenate(rings), np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    return ring[order], owner[order]


def _split(ring: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles (m, 3) int of faces of three or four corners `ring` (k, 4), and the face of each (m,) int.

    A quadrilateral is divided along the diagonal that leaves two triangles alike in sense, or else the shorter one.
    """
    a, b, c, d = (points[ring[:, k]] for k in range(4))
    senses = [dot(area_vectors(np.stack(one, axis=1)), area_vectors(np.stack(other, axis=1))) > 0.0
              for one, other in (((a, b, c), (a, c, d)), ((a, b, d), (b, c, d)))]
    other = np.where(senses[0] == senses[1], lengths(b - d) < lengths(a - c), senses[1])[:, None]
    quad = ring[:, 3] >= 0
    one = np.where(other & quad[:, None], ring[:, [0, 1, 3]], ring[:, [0, 1, 2]])
    two = np.where(other, ring[:, [1, 2, 3]], ring[:, [0, 2, 3]])[quad]
    face = np.concatenate([np.arange(len(ring)), np.flatnonzero(quad)])
    order = np.argsort(face, kind="stable")
    return np.concatenate([one, two])[order], face[order]
