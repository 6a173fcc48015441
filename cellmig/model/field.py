"""Fields: amounts that depend on the place, and may on the time, such as a concentration or a stiffness.

Cues, substrate and figures ask a field by `value` alone.  Places are those of the case, not from the centre of a cell.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from ..case import units
from ..case.expression import Expression, unit_of
from ..case.messages import show
from ..case.registry import law, parameter, quantity
from .samples import AXES, Pixels, Samples, pixels, samples


def field_formula(given: Any) -> Expression:
    """A formula of place and time with a unit of any kind, from text.

    Raises ValueError where it is none; the message is for the user.
    """
    if isinstance(given, Expression):
        return given
    if isinstance(given, int | float) and not isinstance(given, bool):
        given = repr(float(given))
    if not isinstance(given, str):
        raise ValueError(f"expects a formula in quotes, such as \"5 + 0.02*x nM\", not {show(given)}")
    return Expression(given, unit_of(given), 3, True)  # without z at places with two coordinates


@law("field", "formula")
class FormulaField:
    """Field by a formula of x, y, z [µm], the distance r from the origin [µm], and the time.

    The time has its unit in its name: t_s in seconds, t_min in minutes, t_h in hours …, so that no other key changes
    what a formula means.  Where the formula is below zero the field is zero: it is an amount.
    """

    formula: Any = parameter("formula with its unit, such as \"5 + 0.02*x nM\" or \"10*exp(-t_h/2) nM\"",
                             reader=field_formula, as_type="string")

    @property
    def unit(self) -> str:
        """Unit of the formula, "" of a pure number."""
        return self.formula.unit

    @property
    def steady(self) -> bool:
        """Whether it does not depend on the time."""
        return "t_" not in self.formula.text

    def value(self, x: np.ndarray, time: float) -> np.ndarray:
        """Values (n,), in the code's units of the kind of `unit`, at places x (n, d) [µm] and a time [µs]."""
        return np.maximum(self.formula(x, time), 0.0)


class Grid:
    """Values at the nodes of a grid, linear from node to node, constant beyond the ends."""

    def __init__(self, places: dict[str, np.ndarray], values: np.ndarray):
        """`places` : of the nodes along some axes "x", "y", "z" (n,) [µm];  `values` (nx, ...) : an axis for each, in
        any unit.
        """
        from scipy.interpolate import RegularGridInterpolator  # takes a while, and few cases have such a field

        self._axes = [AXES.index(axis) for axis in places]
        self._nodes = [np.append(at, at[-1] + 1.0) if len(at) == 1 else at for at in places.values()]
        for axis, at in enumerate(places.values()):
            values = np.repeat(values, 2, axis=axis) if len(at) == 1 else values
        self._values = values
        self._between = RegularGridInterpolator(self._nodes, values)

    def along_first(self) -> Grid:
        """The mean over all axes but the first."""
        first = AXES[self._axes[0]]
        return Grid({first: self._nodes[0]}, self._values.reshape(len(self._values), -1).mean(axis=1))

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Values (n,) at places x (n, d) [µm]."""
        return self._between(np.column_stack([np.clip(x[:, axis], at[0], at[-1])
                                              for axis, at in zip(self._axes, self._nodes, strict=True)]))


@law("field", "table")
class TableField:
    """Field by a table: values at places, linear between them and constant beyond.

    The file is CSV.  It has a column value, and a column x for a field that varies along x alone; x and y, or all of x,
    y and z, for the nodes of a grid, in any order.
    """

    file: Samples = parameter("name of a CSV file with the columns x and value", or_file=samples, reader=Samples.of)
    unit: str = parameter("unit of the values, such as \"nM\" or \"kPa\"; \"\" for pure numbers", "")
    length: float = quantity("um", "unit of the places", "1 um", above=0)

    def __post_init__(self) -> None:
        """Check unit and values.  Raises ValueError for a unit that is none, and for negative amounts."""
        units.same_kind(self.unit, self.unit)
        if (self.file.grid < 0.0).any():
            raise ValueError(f"file: an amount is at least 0, not {self.file.grid.min():g}")

    steady = True

    @cached_property
    def _grid(self) -> Grid:
        return Grid({axis: self.length * at for axis, at in self.file.nodes.items()},
                    units.number(f"1 {self.unit}", self.unit) * self.file.grid)

    def value(self, x: np.ndarray, time: float) -> np.ndarray:
        """Values (n,), in the code's units of the kind of `unit`, at places x (n, d) [µm]."""
        return self._grid(x)


@law("field", "image")
class ImageField:
    """Field by an image, such as a micrograph of what was printed: from black to white through `range`.

    The value of a pixel holds at its centre; it is linear from centre to centre and constant beyond.  In two dimensions
    the field varies along x, and is the mean over the rows of the image; in three it is that of the plane of the
    substrate, where the rows go from the largest y, above, to the smallest.
    """

    file: Pixels = parameter("name of an image, PNG or TIFF, of 8 or 16 bits", or_file=pixels, reader=Pixels.of)
    pixel: float = quantity("um", "size of a pixel", above=0)
    range: tuple = quantity("", "values of black and of white, in `unit`", shape=(2,), minimum=0)
    unit: str = parameter("unit of the values, such as \"nM\" or \"kPa\"; \"\" for pure numbers", "")
    corner: tuple = quantity("um", "x and y of the lower left corner of the image", (0.0, 0.0), shape=(2,))

    def __post_init__(self) -> None:
        """Check the unit.  Raises ValueError for one that is none."""
        units.same_kind(self.unit, self.unit)

    steady = True

    @cached_property
    def _plane(self) -> Grid:
        black, white = (units.number(f"1 {self.unit}", self.unit) * value for value in self.range)
        grey = self.file.grey[::-1].T
        return Grid({axis: start + self.pixel * (np.arange(n) + 0.5)
                     for axis, start, n in zip("xy", self.corner, grey.shape, strict=True)},
                    black + (white - black) * grey)

    @cached_property
    def _line(self) -> Grid:
        return self._plane.along_first()

    def value(self, x: np.ndarray, time: float) -> np.ndarray:
        """Values (n,), in the code's units of the kind of `unit`, at places x (n, d) [µm]."""
        return self._line(x) if x.shape[1] == 2 else self._plane(x)
