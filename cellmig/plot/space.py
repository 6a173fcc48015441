"""Shapes of a run in three dimensions: surfaces, coloured by a field, seen from the side and above."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.colors import LightSource
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from cellmig.output.mesh import read_mesh
from cellmig.output.xdmf import Frame

from .snapshots import Picture, View, scalar

ELEVATION, AZIMUTH = 18.0, -65.0  # of the eye [degrees]


def shapes(directory: Path, some: Sequence[Frame], field: str, view: View) -> Picture:
    """Snapshots of frames beside each other; `view` has the range of colours."""
    triangles = read_mesh(directory)["triangles"]
    places = [(fields["X"] + fields["u"])[triangles] for fields in (frame.read() for frame in some)]
    low, high = (choose([choose(p, axis=(0, 1)) for p in places], axis=0) for choose in (np.min, np.max))
    low[2] = min(low[2], 0.0)
    figure = Picture(figsize=(3.4 * len(some), 3.4), layout="constrained")
    light = LightSource(azdeg=225.0, altdeg=50.0)
    for number, (frame, corners) in enumerate(zip(some, places, strict=True), 1):
        ax = figure.add_subplot(1, len(some), number, projection="3d")
        values = scalar(frame.read()[field], field)[triangles].mean(axis=1)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        shade = 0.45 + 0.55 * light.shade_normals(normals, fraction=1.0)
        colours = view.colours(values)
        colours[:, :3] *= np.clip(shade, 0.0, 1.0)[:, None]
        ax.add_collection3d(Poly3DCollection(corners, facecolors=colours, edgecolors="none"))
        if view.substrate:
            (x0, y0, _), (x1, y1, _) = low, high
            ax.add_collection3d(Poly3DCollection([[(x0, y0, 0), (x1, y0, 0), (x1, y1, 0), (x0, y1, 0)]],
                                                 facecolors="0.85", zorder=-1))
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]), xlabel="x [µm]", ylabel="y [µm]",
               zlabel="z [µm]")
        ax.set_box_aspect(high - low)
        ax.view_init(ELEVATION, AZIMUTH)
        ax.set_title(f"t = {frame.time:.4g} µs", loc="left", fontsize=8)
    view.bar(figure, figure.axes)
    return figure
