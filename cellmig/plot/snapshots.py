"""Shapes of a run at given times, coloured by a field, as in the paper's figures; a film of them."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.figure import Figure

from cellmig.output.directory import OutputError
from cellmig.output.mesh import NAME as MESH
from cellmig.output.xdmf import Frame, frames

from .rendered import Rendered, is_there
from .section import Section
from .space import Solid
from .view import DPI, View

_SNAPSHOTS = (0.05, 0.5, 1.0)  # default times over the end
_SECONDS, _MOST_PER_SECOND = 10.0, 25.0  # film: length [s], largest frame rate [1/s]


def nearest_frames(found: list[Frame], times: Sequence[float] | None) -> list[Frame]:
    """The frames nearest to `times`, each once, in order; by default at 5 and 50 % of the end, and the last."""
    available = np.array([frame.time for frame in found])
    wanted = np.multiply(_SNAPSHOTS, available[-1]) if times is None else np.asarray(times)
    return [found[k] for k in sorted({int(np.argmin(np.abs(available - time))) for time in wanted})]


def missing_times(found: Sequence[Frame], times: Sequence[float] | None) -> str:
    """Remark about `times` before the first or after the last frame, else empty."""
    first, last = found[0].time, found[-1].time
    if beyond := [f"{time:g}" for time in times or () if not first - 1e-9 <= time <= last * (1 + 1e-9)]:
        unit = found[0].unit.label
        return (f"the frames are from {first:g} to {last:g} {unit}: {', '.join(beyond)} {unit} is drawn as the nearest "
                "of these")
    return ""


def view_of(directory: Path, found: Sequence[Frame], field: str, behind: str | None = None) -> View:
    """The view of frames of a run, from the side or in space.  Raises CaseError for an unknown field."""
    solid: type[View] = Rendered if is_there() else Solid
    if (directory / MESH).exists():  # in space sections show what is behind
        return solid.of(directory, found, field)
    return View.of(directory, found, field).before(directory, found, behind)


def shapes(directory: Path, times: Sequence[float] | None, field: str = "effective_stress",
           behind: str | None = None) -> Figure | None:
    """Snapshots at the frames nearest to `times`, in the unit of the run, coloured by a field; None without frames.

    behind : field of the case behind the cells, "none" for none; by default the first.
    """
    some = nearest_frames(found, times) if (found := frames(directory)) else []
    return _snapshots(view_of(directory, some, field, behind), some) if some else None


def sections(directory: Path, times: Sequence[float] | None, field: str = "effective_stress",
             behind: str | None = None) -> Figure | None:
    """The same of a section in three dimensions; None in two, and without frames."""
    some = nearest_frames(found, times) if (found := frames(directory)) and (directory / MESH).exists() else []
    return _snapshots(Section.of(directory, some, field).before(directory, some, behind), some) if some else None


def _snapshots(view: View, some: Sequence[Frame]) -> Figure:
    figure, axes = view.panels(len(some))
    for ax, frame in zip(axes, some, strict=True):
        view.draw(ax, frame)
    return figure


def film(directory: Path, out: Path, field: str = "effective_stress", behind: str | None = None) -> Path | None:
    """Write a film of all frames: film.mp4 with ffmpeg, else film.gif; its path, or None without frames."""
    found = frames(directory)
    if not found:
        return None
    kind, writer = ("mp4", FFMpegWriter) if shutil.which("ffmpeg") else ("gif", PillowWriter)
    path, view = out / f"film.{kind}", view_of(directory, found, field, behind)
    figure, (ax,) = view.panels(1)
    pen = writer(fps=min(_MOST_PER_SECOND, max(1.0, len(found) / _SECONDS)))
    try:
        with tempfile.TemporaryDirectory(dir=out) as scratch:
            part = Path(scratch) / path.name
            # All frames of a film need one size, so that margins are not cut.
            with matplotlib.rc_context({"savefig.bbox": None}), pen.saving(figure, str(part), DPI):
                for frame in found:
                    view.draw(ax, frame)
                    pen.grab_frame()
                    for artist in [*ax.collections, *ax.lines, *ax.images]:
                        artist.remove()
            part.replace(path)
    except OSError as error:
        raise OutputError(f"cannot write '{path}' ({error.strerror or error})") from error
    return path
