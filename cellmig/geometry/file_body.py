"""The shape `surface`: the body within a closed surface of triangles, which a file holds, and its nucleus."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from ..case.registry import law, parameter, quantity
from .bodies import NUCLEI, Body
from .closing import crossing
from .fairing import faired
from .polygons import snapped
from .surface_file import Shells, shells
from .surfaces import ClosedSurface
from .triangles import cross

DIGITS = 40  # bits of the coordinates that are kept: the last ones of a turned surface depend on the library
LEAST, MOST = 0.1, 5000.0  # size of a body [µm] beyond which its unit is wrong
UNITS = {"1 nm": 1e-3, "1 um": 1.0, "1 mm": 1e3, "1 cm": 1e4, "1 m": 1e6}
SMOOTHED = 0.1  # change of the volume by smoothing that is not meant
USUAL = (1.0, 1000.0)  # sizes for which another unit is proposed [µm]


@law("shape", "surface")
class Surface(Body):
    """Body within a closed surface of triangles from a file: STL, OBJ, PLY, Gmsh, or any format that meshio reads.

    A file of elements with a volume gives the surface around them.  Vertices that coincide are joined, triangles of any
    sense are oriented, quadrilaterals are divided.  The file gives the shape, the nucleus and names of parts; particles
    are laid out anew, in the number that the case asks for.
    Parts of its surface: the file's named groups of triangles, such as physical groups of Gmsh.
    """

    file: Shells = parameter("name of a file of triangles, or the surfaces in it, in units of the file",
                             or_file=shells, reader=Shells.of)
    unit: float = quantity("um", "length of one unit of the file", above=0)
    rotation: tuple | None = quantity("rad", "vector along the axis about which the file's coordinates are turned, "
                                      "through the origin, as long as the angle", None, shape=(3,))
    centred: bool = parameter("whether the cell's centre is the centre of volume, instead of the file's origin", False)
    smoothing: float | None = quantity("um", "wavelength of relief, such as noise or the steps of an image's voxels, "
                                       "of which a half is left; shorter relief goes, longer one stays", None, above=0)
    nucleus_file: Shells | None = parameter("file of the surface around the nucleus, in the same unit and "
                                            "coordinates", None, or_file=shells, reader=Shells.of)
    nucleus_region: str | None = parameter("elements of the nucleus, with a volume or around it: the name of a group; "
                                           "\"ref=2\" for where the array ref is 2; or the name of an array that is 1 "
                                           "there and 0 elsewhere", None)

    def __post_init__(self) -> None:
        """Check the surfaces and their size.

        Raises ValueError where they bound no body of one piece; the message is for the user.
        """
        if len(given := [k for k in NUCLEI if getattr(self, k) is not None]) > 1:
            raise ValueError(f"{given[1]}: the nucleus is given by {given[0]} already")
        wrong = []
        for part in ("_given", "_given_nucleus"):
            try:
                getattr(self, part)
            except ValueError as error:
                wrong.append(str(error))
        if wrong:
            raise ValueError("; ".join(dict.fromkeys(wrong)))
        super().__post_init__()
        nucleus = self._nucleus
        if nucleus is not None:
            both = np.concatenate([self._surface.corners, nucleus.corners])
            apart = np.concatenate([self._surface.triangles, nucleus.triangles + len(self._surface.vertices)])
            if crossing(both, apart) is not None:
                raise ValueError(f"{given[0]}: the surfaces of the cell and of the nucleus cross each other")

    def _check_size(self, surface: ClosedSurface) -> None:
        """Raise ValueError for a body of a size that no cell has."""
        size = np.ptp(surface.vertices, axis=0).max()
        if not LEAST <= self.unit * size <= MOST:
            fits = [name for name, unit in UNITS.items() if USUAL[0] <= unit * size <= USUAL[1]]
            raise ValueError(f"unit: the body would be {self.unit * size:.3g} um long, {size:.3g} units of the file"
                             + (f"; is the unit {' or '.join(fits)}?" if fits else ""))

    @cached_property
    def _given(self) -> tuple[ClosedSurface, dict[str, np.ndarray]]:
        """The surface in the file's unit and axes, and the numbers of its parts."""
        surface, numbers = _of("file", self.file.body, self.nucleus_region)
        self._check_size(surface)
        return self._smooth(surface), numbers

    @cached_property
    def _given_nucleus(self) -> ClosedSurface | None:
        if self.nucleus_file is not None:
            return self._smooth(_of("nucleus_file", self.nucleus_file.body)[0])
        if self.nucleus_region is None:
            return None
        return self._smooth(_of("nucleus_region", self.file.nucleus, self.nucleus_region))

    def _smooth(self, surface: ClosedSurface) -> ClosedSurface:
        """A surface of the file without short relief; raises ValueError where that changes more."""
        if self.smoothing is None:
            return surface
        smooth = faired(surface, self.smoothing / self.unit)
        if (change := abs(smooth.volume / surface.volume - 1.0)) > SMOOTHED:
            raise ValueError(f"smoothing: {self.smoothing:.3g} um would change the volume by {100.0 * change:.2g} %")
        if crossing(smooth.corners, smooth.triangles) is not None:
            raise ValueError(f"smoothing: with {self.smoothing:.3g} um the surface would cross itself")
        return smooth

    @property
    def hint(self) -> str:
        """End of a message about particles that do not suit the surface."""
        return "" if self.smoothing else "; smoothing, a length of about twice the spacing, takes short relief off"

    def _placed(self, vertices: np.ndarray) -> np.ndarray:
        """Vertices (k, 3) of the file [µm], in the axes of the case."""
        p = self.unit * vertices
        if self.rotation is None or not any(self.rotation):
            return p
        turn = np.array(self.rotation)
        angle = np.sqrt(turn @ turn)
        axis = np.broadcast_to(turn / angle, p.shape)
        across = cross(axis, p)  # Rodrigues' formula
        return snapped(p + np.sin(angle) * across + (1.0 - np.cos(angle)) * cross(axis, across), DIGITS)

    @cached_property
    def _centre(self) -> np.ndarray:
        """The cell's centre in the turned coordinates of the file (3,) [µm]."""
        surface, _ = self._given
        return surface.moved(self._placed(surface.vertices)).centroid if self.centred else np.zeros(3)

    @cached_property
    def _surface(self) -> ClosedSurface:
        surface, _ = self._given
        return surface.moved(self._placed(surface.vertices) - self._centre)

    @property
    def _numbers(self) -> dict[str, np.ndarray]:
        return self._given[1]

    @cached_property
    def _nucleus(self) -> ClosedSurface | None:
        nucleus = self._given_nucleus
        if nucleus is None:
            return super()._nucleus
        return nucleus.moved(self._placed(nucleus.vertices) - self._centre)


def _of(key: str, read: Callable, *given: Any) -> Any:
    """What a function reads; raises its ValueError with the key in front of the message."""
    try:
        return read(*given)
    except ValueError as error:
        raise ValueError(f"{key}: {error}") from None
