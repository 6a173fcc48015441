"""Sections through the cells of a frame in three dimensions: a plane across their tetrahedra, coloured by a field."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.tri import Triangulation

from cellmig.output.mesh import read_mesh
from cellmig.output.xdmf import Frame

from .view import View, scalar, spacing

# Edges of a tetrahedron that a plane cuts, of two triangles at most, by the number of corners beyond the plane: corners
# are in order, those beyond it last.
_CUT = {1: [[(3, 0), (3, 1), (3, 2)]], 2: [[(0, 2), (0, 3), (1, 3)], [(0, 2), (1, 3), (1, 2)]],
        3: [[(0, 1), (0, 2), (0, 3)]]}


@dataclass(frozen=True)
class Section(View):
    """Settings of sections through the centre of the cell number `middle`; tetrahedra (m, 4) int by particles."""

    dimension: ClassVar[int] = 3
    names: ClassVar[tuple[str, ...]] = ("x", "z")
    tetrahedra: np.ndarray
    middle: int = 1

    @classmethod
    def of(cls, directory: Path, found: Sequence[Frame], field: str, **more: Any) -> Self:
        """The view of frames of a run, through the cell that is in the middle at first.  Raises CaseError."""
        view = super().of(directory, found, field, tetrahedra=read_mesh(directory)["tetrahedra"], **more)
        fields = found[0].read()
        y = (fields["X"] + fields["u"])[:, 1]
        centres = {int(cell): y[fields["cell"] == cell].mean() for cell in np.unique(fields["cell"])}
        mean = np.mean(list(centres.values()))
        middle = min(centres, key=lambda cell: abs(centres[cell] - mean))
        return replace(view, low=view.low[[0, 2]], high=view.high[[0, 2]], middle=middle)

    def middles(self, frame: Frame) -> np.ndarray:
        """Places (n, 3) [µm] in the section, likewise."""
        return np.insert(super().middles(frame), 1, self._y(frame.read()), axis=1)

    def _y(self, fields: dict[str, np.ndarray]) -> float:
        """Where the section is [µm]."""
        return float((fields["X"] + fields["u"])[fields["cell"] == self.middle, 1].mean())

    def draw_cells(self, ax: Axes, frame: Frame, fields: dict[str, np.ndarray]) -> None:
        """Draw the sections of all cells of a frame with these fields."""
        self.draw_behind(ax, frame)
        y = self._y(fields)
        pair, share, triangles = cut((fields["X"] + fields["u"])[:, 1] - y, self.tetrahedra)

        def there(values: np.ndarray) -> np.ndarray:
            return values[pair[:, 0]] + (share * (values[pair[:, 1]] - values[pair[:, 0]]).T).T

        if len(triangles):
            x = there(fields["X"] + fields["u"])[:, [0, 2]]
            mesh = Triangulation(*x.T, triangles)
            self.fill(ax, mesh, there(scalar(fields[self.field], self.field)))
            ax.add_collection(LineCollection(x[_outline(triangles)], colors="0.1", linewidths=0.6))
            self.borders(ax, mesh, there(fields["material"].astype(float)))
        if "director" in fields:
            off = np.abs((fields["X"] + fields["u"])[:, 1] - y)
            self.lines(ax, fields, np.flatnonzero(off < 0.5 * spacing(fields["X"])), [0, 2])
        self.draw_plates(ax, frame, y)
        self.finish(ax, f"t = {frame.time:.4g} {frame.unit.label}, section at y = {round(y, 1) + 0.0:g} µm")


def cut(height: np.ndarray, tetrahedra: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The section of tetrahedra (m, 4) int where a function of the particles, `height` (n,) in any unit, is zero.

    Returns
    -------
    (k, 2) int -- particles at the ends of the edges that are cut.
    (k,) float -- where they are cut, from 0 at the first end to 1 at the second [-].
    (t, 3) int -- triangles between the points where they are cut.
    """
    above = height[tetrahedra] > 0.0
    ordered = np.take_along_axis(tetrahedra, np.argsort(above, axis=1, kind="stable"), axis=1)
    parts = [ordered[above.sum(axis=1) == count][:, edges] for count, pieces in _CUT.items() for edges in pieces]
    ends = np.sort(np.concatenate(parts).reshape(-1, 2), axis=1)
    pair, number = np.unique(ends, axis=0, return_inverse=True)
    low, high = height[pair].T
    return pair, low / (low - high), number.reshape(-1, 3)


def _outline(triangles: np.ndarray) -> np.ndarray:
    """Sides (k, 2) int of triangles (t, 3) int that belong to one of them alone."""
    each = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    sides, count = np.unique(np.sort(each, axis=1), axis=0, return_counts=True)
    return sides[count == 1]
