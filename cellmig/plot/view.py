"""How the cells of a frame are drawn: triangles between their particles, coloured by a field, with outlines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from matplotlib.tri import Triangulation
from scipy.spatial import cKDTree

from cellmig.case.messages import CaseError, Mistake, suggest
from cellmig.case.schema import Plate
from cellmig.geometry import polygons
from cellmig.output.manifest import read_case, read_manifest
from cellmig.output.xdmf import Frame

from . import background
from .background import Background
from .style import FAR, in_print

DPI = 140  # resolution of films and of pictures in notebooks
MAP = "viridis"
_SQUARES = 200  # of a field behind the cells along each axis
_AROUND = 0.1  # what is shown of it beyond the cells, over their extent


class Picture(Figure):
    """A figure that notebooks show without pyplot."""

    def _repr_png_(self) -> bytes:
        memory = BytesIO()
        self.savefig(memory, format="png", dpi=DPI, bbox_inches="tight")
        return memory.getvalue()


@dataclass(frozen=True)
class View:
    """Settings that all pictures of a run share: field, colours, limits of the axes, presence of a substrate.

    low, high : (2,) float -- limits [um];  extend : sides of the colour bar with values beyond its range;  behind : the
    field behind the cells, if any;  follows : whether the limits go with the cells, which else would be specks on a
    long way.
    """

    field: str
    label: str
    norm: Normalize
    extend: str
    low: np.ndarray
    high: np.ndarray
    substrate: bool
    dimension: ClassVar[int] = 2
    names: ClassVar[tuple[str, ...]] = ("x", "y")  # of the axes
    pad: ClassVar[float] = 0.02  # between the panels and the colour bar, over their width
    behind: Background | None = field(default=None, kw_only=True)
    plates: tuple[Plate, ...] = field(default=(), kw_only=True)
    follows: bool = field(default=False, kw_only=True)

    @classmethod
    def of(cls, directory: Path, found: Sequence[Frame], field: str, **more: Any) -> Self:
        """The view that contains frames of a run, with `more` of it.  Raises CaseError for an unknown field."""
        if field not in (units := found[0].units()):
            raise CaseError([Mistake("--field", None, "", f"the run has no field '{field}'{suggest(field, units)}")])
        values, corners = [], []
        for frame in found:
            fields = frame.read()
            x = (fields["X"] + fields["u"])[:, : cls.dimension]
            values.append(scalar(fields[field], field))
            corners.append((x.min(axis=0), x.max(axis=0)))
        lows, highs = np.swapaxes(corners, 0, 1)
        low, high, sizes = lows.min(axis=0), highs.max(axis=0), (highs - lows).max(axis=0)
        follows = bool((high - low).max() > FAR * sizes.max())
        if follows:
            middle, sizes[-1] = 0.5 * (low + high), (high - low)[-1]
            low, high = middle - 0.5 * sizes, middle + 0.5 * sizes
        margin = 0.04 * (high - low).max() + 1e-9  # a single particle needs a panel, too
        unit = in_print(units[field])
        label = field.replace("_", " ") + (f" [{unit}]" if unit else "")
        return cls(field, label, *_colour_range(np.concatenate(values)), low - margin, high + margin,
                   _on_substrate(directory), follows=follows, plates=_plates(directory), **more)

    def around(self, fields: dict[str, np.ndarray]) -> Self:
        """The same view with the cells of a frame in the middle along the substrate, if it follows them."""
        if not self.follows:
            return self
        x = (fields["X"] + fields["u"])[:, ["xyz".index(name) for name in self.names]]
        shift = 0.5 * (x.min(axis=0) + x.max(axis=0) - self.low - self.high)
        shift[-1] = 0.0
        return replace(self, low=self.low + shift, high=self.high + shift)

    def before(self, directory: Path, found: Sequence[Frame], name: str | None) -> Self:
        """The same view, wider, before a field of the case, if it has one.  Raises CaseError for an unknown name."""
        around = _AROUND * (self.high - self.low).max()
        wide = replace(self, low=self.low - [around, 0.0], high=self.high + around)
        behind = Background.of(directory, name, lambda frame: wide.around(frame.read()).middles(frame), found)
        return self if behind is None else replace(wide, behind=behind)

    @property
    def squares(self) -> tuple[np.ndarray, np.ndarray]:
        """Edges (n + 1,) [µm] along both axes of the squares of the field behind the cells."""
        low = max(0.0, self.low[1]) if self.substrate else self.low[1]
        return tuple(np.linspace(*ends, _SQUARES + 1) for ends in ((self.low[0], self.high[0]), (low, self.high[1])))

    def middles(self, frame: Frame) -> np.ndarray:
        """Places (n, d) [µm] of the scene at the middles of the squares, row by row."""
        x, y = (0.5 * (edges[1:] + edges[:-1]) for edges in self.squares)
        return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)

    def draw_behind(self, ax: Axes, frame: Frame) -> None:
        """Draw the field behind the cells at the time of a frame."""
        if self.behind is not None:
            x, y = self.squares
            values = self.behind.values(self.middles(frame), frame)
            ax.pcolormesh(x, y, values.reshape(len(y) - 1, -1), norm=self.behind.norm, cmap=background.MAP,
                          rasterized=True, zorder=-1)

    def panels(self, n: int) -> tuple[Figure, np.ndarray]:
        """A figure of n panels with one scale and a colour bar; the panels are stacked if the scene is wide."""
        width, height = self.high - self.low
        stacked = n == 1 or width > 1.3 * height
        size = (6.0, 0.6 + n * (0.25 + 4.9 * height / width)) if stacked else (7.2, 0.9 + 6.2 / n * height / width)
        below = 0.0 if self.behind is None else 0.7  # another colour bar
        figure = Picture(figsize=(size[0], size[1] + below), layout="constrained")
        axes = figure.subplots(n if stacked else 1, 1 if stacked else n, sharex=not self.follows, sharey=True,
                               squeeze=False)
        for ax in axes.flat:
            ax.set_aspect("equal")
            ax.yaxis.set_major_locator(MaxNLocator(nbins=4, steps=[1, 2, 5, 10]))
        for ax in axes[-1]:
            ax.set_xlabel(f"{self.names[0]} [µm]")
        for ax in axes[:, 0]:
            ax.set_ylabel(f"{self.names[1]} [µm]")
        self.bar(figure, list(axes.flat))
        return figure, axes.ravel()

    def colours(self, values: np.ndarray) -> np.ndarray:
        """Colours (n, 4) of values (n,)."""
        return ScalarMappable(self.norm, MAP).to_rgba(values)

    def bar(self, figure: Figure, axes: list[Axes]) -> None:
        """Add the colour bar beside some axes."""
        figure.colorbar(ScalarMappable(self.norm, MAP), ax=axes, extend=self.extend, aspect=30, pad=self.pad,
                        label=self.label)
        if self.behind is not None:
            figure.colorbar(ScalarMappable(self.behind.norm, background.MAP), ax=axes, location="bottom", aspect=40,
                            shrink=0.8, label=self.behind.label)

    def draw(self, ax: Axes, frame: Frame) -> None:
        """Draw all cells of a frame, in the limits of the view."""
        fields = frame.read()
        view = self.around(fields)
        view.limit(ax)
        view.draw_cells(ax, frame, fields)

    def limit(self, ax: Axes) -> None:
        """Set the limits of the axes."""
        ax.set(xlim=(self.low[0], self.high[0]), ylim=(self.low[1], self.high[1]))

    def draw_cells(self, ax: Axes, frame: Frame, fields: dict[str, np.ndarray]) -> None:
        """Draw all cells of a frame with these fields, and what is around them."""
        self.draw_behind(ax, frame)
        values = scalar(fields[self.field], self.field)
        for cell in np.unique(fields["cell"]):
            own = fields["cell"] == cell
            triangles, outline = drawing({name: fields[name][own] for name in ("X", "u", "surface")})
            self.fill(ax, triangles, values[own])
            for loop in outline:
                ax.plot(triangles.x[loop], triangles.y[loop], color="0.1", linewidth=0.6)
            self.borders(ax, triangles, fields["material"][own].astype(float))
        if "director" in fields:
            self.lines(ax, fields, np.arange(len(values)), [0, 1])
        self.draw_plates(ax, frame)
        self.finish(ax, f"t = {frame.time:.4g} {frame.unit.label}")

    def fill(self, ax: Axes, triangles: Triangulation, values: np.ndarray) -> None:
        """Colour triangles by values (n,) at their corners."""
        ax.tripcolor(triangles, values, norm=self.norm, cmap=MAP, shading="gouraud", rasterized=True)

    def borders(self, ax: Axes, triangles: Triangulation, material: np.ndarray) -> None:
        """Draw where materials meet, from the number of the material (n,) at the corners."""
        first, last = int(material.min()), int(np.ceil(material.max()))
        if last > first:
            ax.tricontour(triangles, material, levels=np.arange(first, last) + 0.5, colors="white", linewidths=0.7)

    def lines(self, ax: Axes, fields: dict[str, np.ndarray], some: np.ndarray, axes: list[int]) -> None:
        """Draw the directors of `some` particles (k,) int as lines, seen along the axis that is not among `axes`."""
        x, h = (fields["X"] + fields["u"])[np.ix_(some, axes)], fields["director"][np.ix_(some, axes)]
        half = 0.4 * spacing(fields["X"]) * h
        ax.add_collection(LineCollection(np.stack([x - half, x + half], axis=1), colors="tab:red", linewidths=0.6))

    def draw_plates(self, ax: Axes, frame: Frame, y: float = 0.0) -> None:
        """Draw the faces of plates at the time of a frame; `y` : of a section in space [µm]."""
        some = ["xyz".index(name) for name in self.names]
        for plate in self.plates:
            normal, curve = np.array(plate.normal), plate.load_curve
            at = np.array(plate.point) + curve.value(frame.unit.size * frame.time) * np.array(plate.displacement)
            across, middle = normal[some], 0.5 * (self.low + self.high)
            if size := float(np.linalg.norm(across)):
                level = normal @ at - y * np.delete(normal, some).sum()
                along = np.linalg.norm(self.high - self.low) / size * np.array([-across[1], across[0]])
                x = middle + (level - across @ middle) / size**2 * across
                ax.plot(*np.transpose([x - along, x + along]), color="0.4", linewidth=1.0, zorder=0)

    def finish(self, ax: Axes, title: str) -> None:
        """Draw the substrate and the title."""
        if self.substrate:
            ax.axhline(0.0, color="0.4", linewidth=1.0, zorder=0)
        ax.set_title(title, loc="left", fontsize=8)


def spacing(X: np.ndarray) -> float:
    """Median distance [µm] of particles at X (n, d) [µm] to their nearest neighbours."""
    return float(np.median(cKDTree(X).query(X, k=2)[0][:, 1])) if len(X) > 1 else 1.0


def scalar(values: np.ndarray, field: str) -> np.ndarray:
    """A scalar, or the magnitude of a vector (n,).  Raises CaseError for a tensor."""
    if values.ndim == 2 and values.shape[1] == 9:
        raise CaseError([Mistake("--field", None, "", f"'{field}' is a tensor: draw 'effective_stress' or another "
                                                      "scalar")])
    return np.linalg.norm(values, axis=1) if values.ndim == 2 else values.astype(float)


def _colour_range(values: np.ndarray) -> tuple[Normalize, str]:
    """Colour range from the 1st to the 99th percentile, and the sides with values beyond it."""
    values = values[np.isfinite(values)]
    if not len(values):
        return Normalize(0.0, 1.0), "neither"
    low, high = np.percentile(values, [1.0, 99.0])
    below, above = values.min() < low, values.max() > high
    extend = {(True, True): "both", (True, False): "min", (False, True): "max"}.get((below, above), "neither")
    return Normalize(low, high if high > low else low + 1.0), extend


def _on_substrate(directory: Path) -> bool:
    """Whether the scene has a substrate; assumed while the manifest has no case yet."""
    case = read_manifest(directory).get("case")
    return case is None or "substrate" in case.get("adhesion", {})


def _plates(directory: Path) -> tuple[Plate, ...]:
    """Plates of the case of a run."""
    return read_case(directory).plates if (read_manifest(directory).get("case") or {}).get("plates") else ()


def drawing(fields: dict[str, np.ndarray]) -> tuple[Triangulation, list[np.ndarray]]:
    """Triangles of a cell at its current positions, made in the reference configuration; its closed outlines."""
    reference, x = fields["X"][:, :2], (fields["X"] + fields["u"])[:, :2]
    loops = outlines(fields["surface"])
    triangles = Triangulation(*reference.T).triangles
    if sum(map(len, loops)) > 2:
        rings = polygons.joined([reference[loop] for loop in loops])
        triangles = triangles[polygons.inside(reference[triangles].mean(axis=1), rings)]
    return Triangulation(*x.T, triangles), [np.append(loop, loop[:1]) for loop in loops]


def outlines(surface: np.ndarray) -> list[np.ndarray]:
    """Particles along the outlines of a cell, by loop, from its field `surface` (n,) int."""
    on = np.flatnonzero(surface >= 0)
    on = on[np.argsort(surface[on], kind="stable")]
    return np.split(on, np.flatnonzero(np.diff(surface[on]) > 1) + 1)  # numbers of loops have gaps
