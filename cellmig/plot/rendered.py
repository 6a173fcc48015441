"""How PyVista draws the cells of a frame in three dimensions, where it is installed: smooth, and nearest in front."""

from __future__ import annotations

import os
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from itertools import product
from typing import Any, ClassVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from cellmig.output.xdmf import Frame

from .space import Solid, directions
from .view import MAP, Picture, scalar

_OLDEST = (9, 4)  # VTK that draws without a window; older ones end the program
_PIXELS = 1400  # of the longer side of a picture
_WIDTH, _TALLEST = 5.2, 4.0  # of a panel [inches]
_BELOW = 0.02  # depth of what is drawn as the substrate, so that its squares are above it [µm]
_SHARP = 50.0  # angle between triangles that is no rounding [degrees]


def is_there() -> bool:
    """Whether PyVista is installed, and draws without a window unless there is a display."""
    try:
        new = tuple(int(part) for part in version("vtk").split(".")[:2]) >= _OLDEST
    except PackageNotFoundError:
        return False
    return find_spec("pyvista") is not None and (new or bool(os.environ.get("DISPLAY")))


@dataclass(frozen=True)
class Rendered(Solid):
    """Settings of pictures of surfaces by PyVista, in parallel projection, from where `Solid` looks."""

    pad: ClassVar[float] = 0.03

    @property
    def _box(self) -> np.ndarray:
        """Ranges (3, 2) [µm] of the scene to the right, upwards and towards the eye."""
        ranges = np.transpose([self.ground, self.high])
        corners = np.array(list(product(*ranges))) @ directions().T
        return np.column_stack([corners.min(axis=0), corners.max(axis=0)])

    def panels(self, n: int) -> tuple[Figure, np.ndarray]:
        """A figure of n panels with one scale and a colour bar; the panels are stacked if the scene is wide."""
        wide, high, _ = np.ptp(self._box, axis=1)
        stacked = n == 1 or wide > 1.3 * high
        width = min(_WIDTH if stacked else 3.0, _TALLEST * wide / high)
        tall = 0.3 + width * high / wide
        figure = Picture(figsize=(1.1 + width * (1 if stacked else n), tall * (n if stacked else 1)),
                         layout="constrained")
        axes = figure.subplots(n if stacked else 1, 1 if stacked else n, squeeze=False).ravel()
        for ax in axes:
            ax.set(xlim=(0.0, wide), ylim=(0.0, high), aspect="equal")
            ax.set_axis_off()
            self._directions(ax)
        self.bar(figure, list(axes))
        return figure, axes

    @property
    def _unit(self) -> float:
        """A round length [µm], of the squares on the substrate."""
        return float(np.diff(MaxNLocator(10, steps=[1, 2, 5, 10]).tick_values(0.0, np.ptp(self._box[0])))[0])

    def _directions(self, ax: Axes) -> None:
        """Draw the axes of the scene in the lower left corner, and how long they are."""
        wide = np.ptp(self._box[0])
        at, length = np.full(2, 0.04 * wide), self._unit
        for name, way in zip("xyz", length * directions()[:2].T, strict=True):
            ax.annotate("", at + way, at, arrowprops={"arrowstyle": "-|>", "color": "0.2", "linewidth": 0.7,
                                                      "shrinkA": 0, "shrinkB": 0, "mutation_scale": 6}, zorder=3)
            ax.annotate(name, at + (1.0 + 0.025 * wide / np.linalg.norm(way)) * way, ha="center", va="center",
                        fontsize=7, color="0.2", zorder=3)
        what = f"squares of {self._unit:g} µm" if self.substrate else f"arrows of {length:g} µm"
        ax.set_title(what, loc="right", fontsize=7, color="0.3")

    def limit(self, ax: Axes) -> None:
        """Leave the limits: pictures begin at 0 wherever the cells are."""

    def draw_cells(self, ax: Axes, frame: Frame, fields: dict[str, np.ndarray]) -> None:
        """Draw all cells of a frame with these fields."""
        wide, high, _ = np.ptp(self._box, axis=1)
        image = self._image(fields, frame.triangles())
        ax.imshow(image, extent=(0.0, wide, 0.0, high), zorder=1, interpolation="antialiased")
        x, y, _ = np.rint(0.5 * (self.low + self.high)).astype(int)
        at = f", around x = {x} µm, y = {y} µm" if self.follows else ""
        ax.set_title(f"t = {frame.time:.4g} {frame.unit.label}{at}", loc="left", fontsize=8)

    def _image(self, fields: dict[str, np.ndarray], triangles: np.ndarray) -> np.ndarray:
        """Colours (height, width, 3) of the pixels; triangles (m, 3) int by particles."""
        import pyvista
        from vtkmodules.vtkCommonCore import vtkLogger

        vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)  # of displays that are not there
        surface = pyvista.PolyData.from_regular_faces((fields["X"] + fields["u"])[:, :3], triangles)
        surface["values"] = scalar(fields[self.field], self.field)
        extent = np.ptp(self._box, axis=1)
        size = np.rint(_PIXELS * extent[:2] / extent[:2].max()).astype(int)
        plotter = pyvista.Plotter(off_screen=True, window_size=size.tolist())
        plotter.set_background("white")
        plotter.add_mesh(surface, scalars="values", clim=(self.norm.vmin, self.norm.vmax), cmap=MAP,
                         smooth_shading=True, split_sharp_edges=True, feature_angle=_SHARP, ambient=0.4, diffuse=0.7,
                         specular=0.1, show_scalar_bar=False)
        if self.substrate:
            self._add_substrate(plotter)
        self._aim(plotter.camera, extent)
        plotter.enable_anti_aliasing("ssaa")
        try:
            return plotter.screenshot(return_img=True)
        finally:
            plotter.close()

    def _add_substrate(self, plotter: Any) -> None:
        """Draw the substrate with its squares."""
        import pyvista

        unit = self._unit
        places = [unit * np.arange(np.ceil(low / unit), np.floor(high / unit) + 1)
                  for low, high in zip(self.low[:2], self.high[:2], strict=True)]
        (x0, y0, _), (x1, y1, _) = self.low, self.high
        lines = [((x, y0, 0.0), (x, y1, 0.0)) for x in places[0]] + [((x0, y, 0.0), (x1, y, 0.0)) for y in places[1]]
        plane = pyvista.Plane(center=(0.5 * (x0 + x1), 0.5 * (y0 + y1), -_BELOW), i_size=x1 - x0, j_size=y1 - y0,
                              i_resolution=1, j_resolution=1)
        plotter.add_mesh(plane, color=[0.9] * 3, lighting=False)
        plotter.add_lines(np.array(lines).reshape(-1, 3), color=[0.7] * 3, width=2)

    def _aim(self, camera: Any, extent: np.ndarray) -> None:
        """Let the picture show the box and nothing else."""
        _, up, eye = directions()
        focus = self._box.mean(axis=1) @ directions()
        camera.focal_point, camera.position, camera.up = focus, focus + 4.0 * extent.max() * eye, up
        camera.parallel_projection, camera.parallel_scale = True, 0.5 * extent[1]
        camera.clipping_range = (0.1 * extent.max(), 8.0 * extent.max())
