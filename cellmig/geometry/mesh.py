"""The shape `mesh`: the region that the elements of a mesh file cover, its nucleus and named parts of its surface."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ..case.messages import suggest
from ..case.registry import law, parameter, quantity
from . import polygons
from .mesh_file import Boundary, boundary
from .outlines import Outlined


@law("shape", "mesh")
class Mesh(Outlined):
    """Region that the elements of a mesh file cover, in any format that meshio reads; the origin is the cell's centre.

    Elements may be polygons, and triangles and quadrilaterals of first or second order, whose curved sides are
    parabolas; other elements are refused, and all have to be in one plane z = const.
    The file gives the outline, the holes, the nucleus and the names of parts; the particles are laid out anew, in the
    number that the case asks for.
    Parts of its surface: the file's named groups of lines, outline, and hole-1, hole-2 ….
    """

    file: Boundary = parameter("name of a mesh file, or the boundary of its elements, in units of the file",
                               or_file=boundary, reader=Boundary.of)
    unit: float = quantity("um", "length of one unit of the file", above=0)
    nucleus_region: str | None = parameter("elements of the nucleus: the name of a group; \"ref=2\" for where the "
                                           "array ref is 2; or the name of an array that is 1 there and 0 elsewhere",
                                           None)

    def __post_init__(self) -> None:
        """Check that the elements form one cell.

        Raises ValueError where they do not; the message is for the user.
        """
        outer = [loop for loop in self._loops if polygons.area(loop) > 0.0] or self._loops[:1]
        points, number = np.unique(np.concatenate(self._loops), axis=0, return_counts=True)
        wrong = []
        if len(outer) != 1:
            wrong += [f"file: the triangles are {len(outer)} pieces, not one"]
        if (number > 1).any():
            x, y = points[number > 1][0]
            wrong += [f"file: the boundary touches itself at ({x:.4g}, {y:.4g}) um, or triangles do not meet edge to "
                      "edge there"]
        elif any(polygons.crossing(loop) is not None for loop in self._loops):
            wrong += ["file: the boundary crosses itself: triangles overlap"]
        wrong += self._no_nucleus()
        if wrong:
            raise ValueError("; ".join(wrong))

    def _no_nucleus(self) -> list[str]:
        """Messages about a nucleus that cannot be used, for the user."""
        if self.nucleus_region is None:
            return []
        found = dict(self.file.regions)
        if self.nucleus_region not in found:
            return [f"nucleus_region: the file has no triangles called '{self.nucleus_region}'"
                    f"{suggest(self.nucleus_region, [name for name, loops in self.file.regions if loops])}"]
        if not found[self.nucleus_region]:
            return [f"nucleus_region: no triangle is in the group '{self.nucleus_region}'"]
        if {p for loop in self.file.loops for p in loop} & {p for loop in found[self.nucleus_region] for p in loop}:
            return [f"nucleus_region: '{self.nucleus_region}' reaches the surface; a nucleus lies within"]
        return []

    @cached_property
    def _loops(self) -> list[np.ndarray]:
        return [self.unit * np.array(loop) for loop in self.file.loops]

    @property
    def has_nucleus(self) -> bool:
        """Whether the cell has a nucleus."""
        return self.nucleus_region is not None

    @cached_property
    def _border(self) -> np.ndarray:
        return self._loops[0]

    @cached_property
    def _nucleus(self) -> list[np.ndarray]:
        """Loops around the nucleus, (k, 2) [µm] each."""
        return [self.unit * np.array(loop) for loop in dict(self.file.regions)[self.nucleus_region]]

    @property
    def nucleus_ratio(self) -> float | None:
        """Size of the nucleus over that of the cell: the square root of the ratio of their areas [-]."""
        if self.nucleus_region is None:
            return None
        return float(np.sqrt(polygons.area(polygons.joined(self._nucleus)) / self.area))

    @cached_property
    def _edges(self) -> dict[str, np.ndarray]:
        return {name: np.array(at) for name, at in self.file.lines if name != "surface"}  # which names all of it

    @cached_property
    def _fixed(self) -> list[np.ndarray]:
        """For each loop, the corners (c,) int in which a named part begins or ends."""
        first, sizes = 0, [len(loop) for loop in self._loops]
        named, fixed = np.zeros((len(self._edges), sum(sizes)), bool), []
        for part, at in zip(named, self._edges.values(), strict=True):
            part[at] = True
        for size in sizes:
            of_loop = named[:, first:first + size]
            fixed.append(np.flatnonzero((of_loop != np.roll(of_loop, 1, axis=1)).any(axis=0)))
            first += size
        return fixed
