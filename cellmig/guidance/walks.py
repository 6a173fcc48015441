"""What a run of a study on guidance came to: ways of its cells, tractions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from cellmig.output.manifest import read_manifest
from cellmig.output.motion import forward_index, mean_cosine
from cellmig.output.tables import read_table, time_column
from cellmig.output.tracks import read_tracks
from cellmig.output.tractions import tension
from cellmig.plot.traction import by_place

Table = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Walk:
    """Tracks of a complete run, in the side view, from right to left.

    time : (n,) float -- [h];  x : (cells, n) float -- centres of the cells [µm].
    """

    time: np.ndarray
    x: np.ndarray
    directory: Path

    @staticmethod
    def read(directory: Path) -> Walk:
        """Read the directory of a complete run whose times are in hours."""
        tracks = read_tracks(directory)
        return Walk(tracks.time, tracks.along[:, :, 0], directory)

    @cached_property
    def manifest(self) -> dict:
        """Its manifest."""
        return read_manifest(self.directory)

    @property
    def drift(self) -> float:
        """Mean speed of all cells along x [µm/h]."""
        return float((self.x[:, -1] - self.x[:, 0]).mean() / (self.time[-1] - self.time[0]))

    @property
    def index(self) -> float:
        """Forward migration index along x in the mean over cells [-]: net over whole way, between samples."""
        return float(forward_index(self.x[:, :, None]).mean())

    @property
    def cosine(self) -> float:
        """Mean cosine of steps with the x axis, in the mean over cells [-]."""
        return float(mean_cosine(self.x[:, :, None]).mean())

    def outwards(self, cell: int) -> float:
        """Speed of an end of the row away from its middle [µm/h]: cell 0 to the right, -1 to the left."""
        sign = 1.0 if cell == 0 else -1.0
        return float(sign * (self.x[cell, -1] - self.x[cell, 0]) / (self.time[-1] - self.time[0]))

    @cached_property
    def tension(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean tension of the layer (25,) [pN/µm] at shares of its width from left to right (25,) [-]."""
        table = read_table(self.directory / "substrate.csv")
        samples = np.unique(table[time_column(table)])
        (edges,), pull = by_place(table, samples, "tangential_now_pa")
        width, shares, found = edges[1] - edges[0], np.linspace(0.02, 0.98, 25), []
        for one in pull:
            on = np.flatnonzero(one)
            if len(on):
                ends = edges[on[0]], edges[on[-1] + 1]
                found.append(np.interp(ends[0] + shares * (ends[1] - ends[0]), edges, tension(one, width)))
        return shares, np.mean(found, axis=0)
