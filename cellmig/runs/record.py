"""Files of a run from Python: tables as pandas frames or arrays, frames as arrays, pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cellmig.case.schema import Case
from cellmig.output.directory import OutputError, existing_run
from cellmig.output.fields import FIELDS
from cellmig.output.manifest import read_case, read_manifest
from cellmig.output.tables import read_table
from cellmig.output.xdmf import Frame, frames


class Record:
    """A run on the disk, complete or not; each property reads its file.

    directory : Path -- of the run.
    """

    def __init__(self, directory: Path):
        """Raises OutputError where the directory is not that of a run."""
        self.directory = existing_run(directory)

    @property
    def manifest(self) -> dict[str, Any]:
        """Contents of manifest.json."""
        return read_manifest(self.directory)

    @property
    def status(self) -> int | None:
        """Exit code of the run, such as 0 if complete, 75 if stopped on request; None if it has not ended."""
        return self.manifest.get("exit_status")

    @property
    def case(self) -> Case:
        """The case of the run, with all changes and defaults."""
        return read_case(self.directory)

    # ------------------------------------------------------------ tables

    def table(self, name: str) -> dict[str, np.ndarray]:
        """Columns of "history" or "ledger" by name, (rows,) each; needs no pandas."""
        path = self.directory / f"{name}.csv"
        if not path.exists():
            raise OutputError(f"'{self.directory}' has no {name}.csv")
        return read_table(path)

    @property
    def history(self) -> Any:
        """history.csv as a pandas frame: a row for each sample and cell, 0 is the aggregate; units in the names."""
        return _pandas("history").DataFrame(self.table("history"))

    @property
    def ledger(self) -> Any:
        """ledger.csv as a pandas frame: energies per thickness [pN] by sample, and their error [-]."""
        return _pandas("ledger").DataFrame(self.table("ledger"))

    # ------------------------------------------------------------ frames

    @property
    def _frames(self) -> list[Frame]:
        return frames(self.directory)

    @property
    def times(self) -> np.ndarray:
        """Times of the frames (n,), in the unit of the run, such as µs or h."""
        return np.array([frame.time for frame in self._frames])

    @property
    def units(self) -> dict[str, str]:
        """Unit of each field of a frame."""
        first = self._nearest(0.0)
        return {"time": first.unit.symbol, "x": "um", **first.units()}

    def frame(self, time: float | None = None) -> dict[str, np.ndarray]:
        """Fields of all particles in the frame nearest to a time, in the order of their ids.

        Parameters
        ----------
        time : float -- in the unit of the run; None for the last frame.

        Returns
        -------
        dict -- "time", "x" : positions now (n, d) [µm], and every field of the run: vectors (n, d), tensors
            (n, 3, 3), e.g. X, u [µm], v, stress [Pa], cell (1, 2 …), material; `units` has their units.
        """
        frame = self._nearest(time)
        d = self.manifest.get("case", {}).get("dimension", 2)
        fields = {name: _shaped(name, values, d) for name, values in frame.read().items()}
        return {"time": np.array(frame.time), "x": fields["X"] + fields["u"], **fields}

    def _nearest(self, time: float | None) -> Frame:
        if not (found := self._frames):
            raise OutputError(f"'{self.directory}' has no frames yet")
        return found[-1] if time is None else min(found, key=lambda frame: abs(frame.time - time))

    # ------------------------------------------------------------ for people

    def picture(self, times: Sequence[float] | None = None, field: str = "effective_stress") -> Any:
        """Shapes at times in the unit of the run, filled with a field, as matplotlib's figure; a notebook shows it."""
        import matplotlib

        from cellmig.plot.snapshots import shapes
        from cellmig.plot.style import STYLE

        with matplotlib.rc_context(STYLE):
            return shapes(self.directory, times, field)

    def __repr__(self) -> str:
        from .info import info

        return info(self.directory)


def _shaped(name: str, values: np.ndarray, dimension: int) -> np.ndarray:
    """A field in its own shape; files pad vectors and flatten tensors for ParaView."""
    if values.ndim == 2 and values.shape[1] == 9:
        return values.reshape(-1, 3, 3)
    return values[:, :dimension] if name in FIELDS and FIELDS[name].shape == (2,) else values


def _pandas(name: str) -> Any:
    try:
        import pandas
    except ImportError as error:
        raise ImportError(f"{name} is a pandas frame, and pandas is not here: apt install python3-pandas, or take "
                          f"table('{name}'), a dict of arrays", name="pandas") from error
    return pandas
