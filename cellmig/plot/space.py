"""How the cells of a frame are drawn in three dimensions: their surfaces, coloured by a field, in the light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LightSource
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from cellmig.output.mesh import read_mesh
from cellmig.output.xdmf import Frame

from .view import Picture, View, scalar

ELEVATION, AZIMUTH = 18.0, -65.0  # of the eye [degrees]
_LIGHT = LightSource(azdeg=225.0, altdeg=50.0)
_TICKS = 6  # along the longest axis
_SHORT = 0.2  # length of an axis, over the longest, that is too short for ticks
_SHADOW = 0.45  # brightness of what turns away from the light


@dataclass(frozen=True)
class Solid(View):
    """Settings of pictures of a run in three dimensions; triangles (m, 3) int by particles."""

    dimension: ClassVar[int] = 3
    names: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    pad: ClassVar[float] = 0.16
    triangles: np.ndarray

    @classmethod
    def of(cls, directory: Path, found: Sequence[Frame], field: str, **more: Any) -> Self:
        """The view that contains frames of a run.  Raises CaseError for an unknown field."""
        return super().of(directory, found, field, triangles=read_mesh(directory)["triangles"], **more)

    @property
    def ground(self) -> np.ndarray:
        """Lowest corner (3,) [µm] of what is drawn, which ends at the substrate."""
        return np.array([*self.low[:2], 0.0 if self.substrate else self.low[2]])

    def panels(self, n: int) -> tuple[Figure, np.ndarray]:
        """A figure of n panels with one scale and a colour bar; the panels are stacked if the scene is wide."""
        extent = self.high - self.ground
        stacked = n == 1 or extent[0] > 1.3 * extent[2]
        tall = np.clip(0.2 + (extent[1] * np.sin(np.radians(ELEVATION)) + extent[2]) / max(extent[:2]), 0.4, 1.0)
        size = (6.0, 0.4 + 4.2 * tall * n) if stacked else (1.8 + 3.4 * n, 3.4)
        figure = Picture(figsize=size, layout="constrained")
        axes = np.array([figure.add_subplot(n if stacked else 1, 1 if stacked else n, number, projection="3d",
                                            computed_zorder=False) for number in range(1, n + 1)])
        for ax in axes:
            self.limit(ax)
            # Axes in space are squares as high as their panel: there is room beside that of a long scene.
            long = sorted(extent)[1] <= _SHORT * max(extent)
            ax.set_box_aspect(tuple(extent), zoom=1.6 if long else 0.95 if stacked else 0.85)
            ax.xaxis.labelpad = 8.0 if long else ax.xaxis.labelpad
            ax.view_init(ELEVATION, AZIMUTH)
        self.bar(figure, list(axes))
        return figure, axes

    def limit(self, ax: Axes) -> None:
        """Set the limits, names and ticks of the axes; short ones beside a long one have no room for these."""
        extent = self.high - self.ground
        for name, first, last in zip(self.names, self.ground, self.high, strict=True):
            share = (last - first) / max(extent)
            ticks = MaxNLocator(max(1, round(_TICKS * share)), steps=[1, 2, 5, 10]).tick_values(first, last)
            ax.set(**{f"{name}lim": (first, last), f"{name}label": f"{name} [µm]" if share > _SHORT else "",
                      f"{name}ticks": [at for at in ticks if first <= at <= last and share > _SHORT]})

    def draw_cells(self, ax: Axes, frame: Frame, fields: dict[str, np.ndarray]) -> None:
        """Draw all cells of a frame with these fields."""
        corners = (fields["X"] + fields["u"])[self.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        colours = self.colours(scalar(fields[self.field], self.field)[self.triangles].mean(axis=1))
        shade = _SHADOW + (1.0 - _SHADOW) * _LIGHT.shade_normals(normals, fraction=1.0)
        colours[:, :3] *= np.clip(shade, 0.0, 1.0)[:, None]
        if self.substrate:
            (x0, y0, _), (x1, y1, _) = self.low, self.high
            ax.add_collection3d(Poly3DCollection([[(x0, y0, 0), (x1, y0, 0), (x1, y1, 0), (x0, y1, 0)]],
                                                 facecolors="0.85", zorder=1))  # the eye is above it
        # Edges in the colours of the faces: what is behind would shine through the seams.
        ax.add_collection3d(Poly3DCollection(corners, facecolors=colours, edgecolors=colours, linewidths=0.3, zorder=2))
        for collection in ax.collections:
            collection.set_clip_on(False)
        ax.set_title(f"t = {frame.time:.4g} {frame.unit.label}", loc="left", fontsize=8)
