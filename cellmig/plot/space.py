"""How the cells of a frame are drawn in three dimensions: their surfaces, coloured by a field, in the light."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import ClassVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LightSource
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from mpl_toolkits.mplot3d.proj3d import proj_transform

from cellmig.output.xdmf import Frame

from .view import MAP, Picture, View, scalar

ELEVATION, AZIMUTH = 18.0, -65.0  # of the eye [degrees]
_LIGHT = LightSource(azdeg=225.0, altdeg=50.0)
_TICKS = 6  # along the longest axis
_SHORT = 0.2  # length of an axis, over the longest, that is too short for ticks
_WIDE, _NARROW, _TALL = 5.2, 3.1, 4.0  # of a panel, of one beside others; height of a scene at most [inches]
_BESIDE, _BELOW = 1.3, 1.3  # room in a panel for numbers and names of axes, in width and in height [inches]
_TITLE, _NAME, _LEFT, _BAR = 0.3, 0.2, 0.35, 1.0  # room above a panel, below it, left of it, for the colours [inches]
_OFF_TICKS, _OFF_NAMES = 0.17, 0.46  # of numbers and names of axes from these [inches]
_ZOOMED = 0.99  # diagonal of a scene at zoom 1, over the height of its axes: of matplotlib, as the next
_POINTS, _TICK_PAD, _NAME_PAD = 36.0, 8.0, 21.0  # of its distances of numbers and names, and what it adds to their pads
_SHADOW = 0.45  # brightness of what turns away from the light


def directions() -> np.ndarray:
    """Unit vectors (3, 3) to the right and upwards in the picture, and to the eye [-]."""
    up, around = np.radians([ELEVATION, AZIMUTH])
    right = np.array([-np.sin(around), np.cos(around), 0.0])
    eye = np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
    return np.array([right, np.cross(eye, right), eye])


@dataclass(frozen=True)
class Solid(View):
    """Settings of pictures of a run in three dimensions."""

    dimension: ClassVar[int] = 3
    names: ClassVar[tuple[str, ...]] = ("x", "y", "z")

    @property
    def ground(self) -> np.ndarray:
        """Lowest corner (3,) [µm] of what is drawn, which ends at the substrate."""
        return np.array([*self.low[:2], 0.0 if self.substrate else self.low[2]])

    def panels(self, n: int) -> tuple[Figure, np.ndarray]:
        """A figure of n panels with one scale and a colour bar; the panels are stacked if the scene is wide."""
        extent = self.high - self.ground
        wide, high = np.abs(directions()[:2]) @ extent
        stacked = n == 1 or extent[0] > 1.3 * extent[2]
        width = _WIDE if stacked else _NARROW
        scale = min((width - _BESIDE) / wide, _TALL / high)  # [inches/µm]
        height = scale * high + _BELOW
        (columns, rows), side = (1, n) if stacked else (n, 1), height - _TITLE - _NAME
        size = width * columns + _BAR, height * rows
        figure = Picture(figsize=size)
        axes = []
        for row, column in product(range(rows), range(columns)):
            # Axes in space are squares: the zoom lets a scene go beyond, and layouts of matplotlib would not know.
            left = _LEFT + 0.5 * (scale * wide - side)
            corner = width * column + left, size[1] - height * row - _TITLE - side
            ax = figure.add_axes((*np.divide(corner, size), *np.divide(side, size)), projection="3d",
                                 computed_zorder=False)
            ax.patch.set_visible(False)
            ax.title.set_x((0.1 - left) / side)
            self.limit(ax)
            ax.set_box_aspect(tuple(extent), zoom=scale * np.linalg.norm(extent) / (_ZOOMED * side))
            for axis, others in zip((ax.xaxis, ax.yaxis, ax.zaxis), ([1, 2], [0, 2], [0, 1]), strict=True):
                points = _POINTS * side / (scale * np.linalg.norm(extent[others]))  # of an inch, as it counts them
                axis.set_tick_params(pad=_OFF_TICKS * points - _TICK_PAD)
                axis.labelpad = _OFF_NAMES * points - _NAME_PAD
            ax.view_init(ELEVATION, AZIMUTH)
            axes.append(ax)
        beside = figure.add_axes((1.0 - (_BAR - 0.1) / size[0], 0.05, 0.15 / size[0], 0.9))
        figure.colorbar(ScalarMappable(self.norm, MAP), cax=beside, extend=self.extend, label=self.label)
        return figure, np.array(axes)

    def limit(self, ax: Axes) -> None:
        """Set the limits, names and ticks of the axes; short ones beside a long one have no room for these."""
        extent = self.high - self.ground
        lengths = np.linalg.norm(directions()[:2], axis=0)  # of unit vectors in the picture
        for name, first, last, seen in zip(self.names, self.ground, self.high, lengths, strict=True):
            share = (last - first) / max(extent)
            most = max(1, round(_TICKS * share * seen / max(lengths)))
            ticks = MaxNLocator(most, steps=[1, 2, 5, 10], min_n_ticks=min(2, most)).tick_values(first, last)
            ax.set(**{f"{name}lim": (first, last), f"{name}label": f"{name} [µm]" if share > _SHORT else "",
                      f"{name}ticks": [at for at in ticks if first <= at <= last and share > _SHORT]})

    def draw_cells(self, ax: Axes, frame: Frame, fields: dict[str, np.ndarray]) -> None:
        """Draw all cells of a frame with these fields."""
        triangles = frame.triangles()
        corners = (fields["X"] + fields["u"])[triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        colours = self.colours(scalar(fields[self.field], self.field)[triangles].mean(axis=1))
        shade = _SHADOW + (1.0 - _SHADOW) * _LIGHT.shade_normals(normals, fraction=1.0)
        colours[:, :3] *= np.clip(shade, 0.0, 1.0)[:, None]
        if self.substrate:
            (x0, y0, _), (x1, y1, _) = self.low, self.high
            ax.add_collection3d(Poly3DCollection([[(x0, y0, 0), (x1, y0, 0), (x1, y1, 0), (x0, y1, 0)]],
                                                 facecolors="0.85", zorder=1))  # the eye is above it
        # Those that turn away come first: matplotlib goes by distances of middles, and they would stand out at edges.
        # Edges in the colours of the faces: what is behind would shine through the seams.
        front = _front(ax, corners)
        for zorder, some in ((2, ~front), (3, front)):
            ax.add_collection3d(Poly3DCollection(corners[some], facecolors=colours[some], edgecolors=colours[some],
                                                 linewidths=0.3, zorder=zorder))
        for collection in ax.collections:
            collection.set_clip_on(False)
        ax.set_title(f"t = {frame.time:.4g} {frame.unit.label}", ha="left", fontsize=8)


def _front(ax: Axes, corners: np.ndarray) -> np.ndarray:
    """Which of the triangles (m, 3, 3) [µm], whose corners go round their normals, turn to the eye (m,)."""
    x = np.stack(proj_transform(*corners.reshape(-1, 3).T, ax.get_proj())[:2], axis=-1).reshape(-1, 3, 2)
    first, second = np.swapaxes(x[:, 1:] - x[:, :1], 0, 1)
    return first[:, 0] * second[:, 1] > first[:, 1] * second[:, 0]
