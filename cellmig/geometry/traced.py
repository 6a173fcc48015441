"""Colonies whose outlines were traced in a picture, made fit for bonds: neighbours a gap apart."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ..case import outline_table
from ..case.outline_table import OutlineTable
from ..case.registry import law, parameter, quantity
from . import polygons

MOST, MOST_POINTS = 1e6, 1e6  # largest coordinate [µm]; most points of all outlines
DIGITS = 6  # decimals of a corner and of a centre [µm]
PASSES = 30  # most moves of all outlines
ENOUGH = 0.02  # of the gap that may lack
CANDIDATES = 12  # nearest corners among which those of another cell are sought
LEAST = 7  # particles of a cell, and points of an outline
FINE = 16  # places in a spacing over which an outline is averaged
MOST_TOLD = 20  # cells with mistakes that are told


@law("colony", "outlines")
class Outlines:
    """Cells whose outlines a CSV file has, a row for each point under "cell,x_um,y_um", with a column kind if wanted.

    The column cell gives the names of the cells.  With a column kind, the cells of a kind have the keys of the table
    [[cells]] of that name.  Each outline is averaged along a spacing, which takes the steps of pixels off and rounds
    corners, and gets points at that distance.  Where two outlines are then nearer to each other than the gap, share a
    border or overlap, by up to the spacing, both are set back by half of what lacks; with `close`, outlines that are as
    near are drawn out to meet, too.  All others stay as they are.
    """

    cells: tuple = parameter("names of the tables [[cells]] whose cells they are, the kinds of the file if it has any; "
                             "by default all", (), items="table")
    file: OutlineTable = parameter("name of the CSV file", or_file=outline_table.read, reader=lambda value: value,
                                   as_type="string")
    unit: float | None = quantity("um", "length of one unit of the file, such as the size of a pixel, unless its "
                                  "header tells", None, above=0)
    y_down: bool = parameter("whether the file's y axis points down, as in images", False)
    gap: float | None = quantity("um", "gap between neighbours; by default the equilibrium distance of adhesion.cells",
                                 None, minimum=0, maximum=1000)
    close: float = quantity("um", "outlines that are nearer to each other than this are drawn out to the gap, such as "
                            "over the line of pixels between cells", 0.0, minimum=0, maximum=1000)
    spacing: float | None = quantity("um", "distance of the points of the outlines; by default that of the particles",
                                     None, above=0)
    centre: tuple | None = quantity("um", "where the middle of the colony goes; by default it stays where the file has "
                                    "it", None, minimum=-MOST, maximum=MOST, shape=(2,))

    def __post_init__(self) -> None:
        """Check the unit and the size.

        Raises ValueError where they are wrong; the message is for the user.
        """
        if not isinstance(self.file, OutlineTable):
            raise ValueError("file: expects the name of a CSV file")
        if self.unit is None and self.file.unit is None:
            raise ValueError(f"unit: '{self.file.path}' names no unit: say how long 1 is, such as unit = \"0.1625 um\" "
                             "for the size of a pixel")
        if self.unit is not None and self.file.unit is not None:
            raise ValueError(f"unit: '{self.file.path}' gives its own unit: leave it out")
        if not all((abs(p) <= MOST).all() for p in self._given.values()):
            raise ValueError(f"unit: outlines reach further than {MOST:.0e} um")

    @cached_property
    def _given(self) -> dict[str, np.ndarray]:
        """Points of all cells (n, 2) [µm], with y upwards, by name."""
        scale = (self.unit or self.file.unit or 1.0) * np.array([1.0, -1.0 if self.y_down else 1.0])
        return {c.name: scale * c.points for c in self.file.cells}

    def lines(self, name: str) -> str:
        """Where the file has a cell, for messages."""
        first, last = next(c.lines for c in self.file.cells if c.name == name)
        return f"lines {first} to {last} of '{self.file.path}'"

    def outlines(self, gap: float, particles: Any) -> tuple[dict[str, tuple[tuple, tuple]], list[str]]:
        """Centre (2,) and corners about it [µm] of each cell, and what is wrong with any, for the user.

        gap : between neighbours [µm];  particles : section of the case, with per_cell or spacing.
        """
        found, wrong = {}, []
        for cell in self.file.cells:
            p = self._given[cell.name]
            where = f"the cell '{cell.name}', lines {cell.lines[0]} to {cell.lines[1]} of '{self.file.path}',"
            left = polygons.distinct(p)
            if len(p) < 3:
                wrong.append(f"{where} has {len(p)} point{'s' * (len(p) != 1)}: an outline has at least three")
            elif len(left) > 3 and (pair := polygons.crossing(p[left])) is not None:
                i, j = (cell.lines[0] + int(left[k]) for k in pair)
                wrong.append(f"{where} crosses itself: the edge from line {i} meets that from line {j}")
            elif len(left) < 3 or polygons.is_flat(p[left]):
                wrong.append(f"{where} has no area")
            else:
                found[cell.name] = polygons.simplified(p)
        if wrong or not found:
            return {}, self._few(wrong)
        size = {name: polygons.area(p) for name, p in found.items()}
        spacing = self.spacing or particles.spacing or float(np.sqrt(np.mean(list(size.values())) / particles.per_cell))
        if (number := sum(float(polygons.sides(p).sum()) for p in found.values()) / spacing) > MOST_POINTS:
            return {}, [f"a spacing of {spacing:.3g} um makes {number:.2g} points of all outlines, at most "
                        f"{MOST_POINTS:.0e} are possible"]
        for name, area in size.items():
            if area < LEAST * spacing**2:
                wrong.append(f"the cell '{name}', {self.lines(name)}, has {area:.3g} um^2, less than {LEAST} times the "
                             f"square of the spacing, {spacing:.3g} um: it is too small")
        if wrong:
            return {}, self._few(wrong)
        loops = spaced_apart([averaged(p, spacing) for p in found.values()], gap, max(self.close, gap), spacing)
        return self._about_centres(dict(zip(found, loops, strict=True))), []

    def _few(self, wrong: list[str]) -> list[str]:
        more = [f"{len(wrong) - MOST_TOLD} more outlines of '{self.file.path}' are wrong"] * (len(wrong) > MOST_TOLD)
        return wrong[:MOST_TOLD] + more

    def _about_centres(self, loops: dict[str, np.ndarray]) -> dict[str, tuple[tuple, tuple]]:
        """Centre (2,) and corners about it [µm] of each cell."""
        move = np.zeros(2)
        if self.centre is not None:
            every = np.concatenate(list(loops.values()))
            move = np.array(self.centre) - 0.5 * (every.min(axis=0) + every.max(axis=0))
        found = {}
        for name, p in loops.items():
            middle = np.round(polygons.centroid(p), DIGITS)
            centre = tuple(np.round(middle + move, DIGITS).tolist())
            found[name] = centre, tuple(map(tuple, np.round(p - middle, DIGITS).tolist()))
        return found


def averaged(polygon: np.ndarray, spacing: float) -> np.ndarray:
    """Points (n, 2) [µm] at equal distances, about the spacing [µm], of the mean of a polygon (k, 2) over it."""
    start = np.roll(polygon, -polygons.first_corner(polygon), axis=0)  # the same wherever the list begins
    closed = np.concatenate([start, start[:1]])
    arc = np.concatenate([[0.0], np.cumsum(polygons.sides(start))])
    n = max(LEAST, round(arc[-1] / spacing))
    at = arc[-1] * np.arange(n * FINE) / (n * FINE)
    p = np.column_stack([np.interp(at, arc, closed[:, k]) for k in range(2)])
    around = np.concatenate([p, p[:FINE]])
    total = np.concatenate([np.zeros((1, 2)), np.cumsum(around, axis=0)])
    return (total[FINE:] - total[:-FINE])[: len(p) : FINE] / FINE


def spaced_apart(loops: list[np.ndarray], gap: float, close: float, spacing: float) -> list[np.ndarray]:
    """Outlines that are a gap apart wherever they were nearer to each other than `close`, or overlapped.

    Each point moves by half of what lacks along the normal of the nearest other outline, until almost nothing lacks.

    Parameters
    ----------
    loops : list of (k, 2) -- the outlines, counterclockwise [µm].
    gap, close : float -- see above, gap <= close [µm].
    spacing : float -- distance of their points, and the largest overlap that is undone [µm].
    """
    x, size = np.concatenate(loops), np.array([len(p) for p in loops])
    cell, first = np.repeat(np.arange(len(loops)), size), np.concatenate([[0], np.cumsum(size)])[:-1]
    after = np.arange(len(x)) + 1
    after[first + size - 1] = first
    for number in range(PASSES):
        normal, away = _nearest(x, cell, after, max(close, gap) + 1.5 * spacing)
        reach = close if number == 0 else gap
        on = (away < reach) & (away > -spacing)
        if not (away[on] < (1.0 - ENOUGH) * gap).any() and number:
            break
        x = x + np.where(on, 0.5 * (gap - away), 0.0)[:, None] * normal
    return np.split(x, first[1:])


def _nearest(x: np.ndarray, cell: np.ndarray, after: np.ndarray, within: float) -> tuple[np.ndarray, np.ndarray]:
    """Outward normal (n, 2) [-] of the nearest outline of another cell, and the distance from it (n,) [µm].

    The distance is negative inside, and infinite beyond `within`.

    x : (n, 2) -- corners of all outlines [µm];  cell : (n,) int -- their cells;  after : (n,) int -- next corners.
    """
    number = min(CANDIDATES, len(x))
    _, near = cKDTree(x).query(x, k=number, distance_upper_bound=within)
    near = near.reshape(len(x), number)
    other = np.where(near < len(x), np.append(cell, -1)[near], -1)
    foreign = (other >= 0) & (other != cell[:, None])
    point, column = np.flatnonzero(foreign.any(axis=1)), foreign.argmax(axis=1)
    corner = near[point, column[point]]
    before = np.empty_like(after)
    before[after] = np.arange(len(x))
    edge = after[corner]
    starts = np.stack([before[before[corner]], before[corner], corner, edge], axis=1)
    p, q = x[starts], x[after[starts]]
    along = q - p
    t = np.clip(((x[point, None] - p) * along).sum(-1) / np.maximum((along * along).sum(-1), 1e-300), 0.0, 1.0)
    off = x[point, None] - p - t[..., None] * along
    length = np.sqrt((off * off).sum(-1))
    best = length.argmin(axis=1)
    take = np.arange(len(point)), best
    out = np.stack([along[..., 1], -along[..., 0]], axis=-1)
    out /= np.sqrt((out * out).sum(-1))[..., None]
    mean = out.copy()  # at a corner, the normals of both edges
    mean[:, 1:] += np.where((t[:, 1:] <= 0.0)[..., None], out[:, :-1], 0.0)
    mean[:, :-1] += np.where((t[:, :-1] >= 1.0)[..., None], out[:, 1:], 0.0)
    mean /= np.sqrt((mean * mean).sum(-1))[..., None]
    normal, away = np.zeros_like(x), np.full(len(x), np.inf)
    normal[point] = mean[take]
    away[point] = np.where((off[take] * mean[take]).sum(-1) < 0.0, -1.0, 1.0) * length[take]
    return normal, away
