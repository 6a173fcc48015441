"""The fields of a case: those that are given, and those that diffuse, which go on from knot to knot."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..case import units
from ..case.schema import Case
from ..meshfree.contact import Surfaces
from ..model.ground import fields_of
from ..output.grids import OnGrid
from ..parallel.collect import Arrays
from .diffusing import DiffusingField
from .exchange import Exchanging
from .mechanics import Mechanics
from .step import NumericsError

BOTH = "field {} {}"  # name of an array of a checkpoint, by field and array


class Fields:
    """What cues ask for values, by name; diffusing fields are known at knots that are fixed in time.

    Attributes
    ----------
    by_name : dict -- of all fields, each with `value(x, time)`; values of diffusing ones on rank 0 alone.
    diffusing : dict of DiffusingField -- those that diffuse.
    knot : int -- number of the last knot.
    """

    def __init__(self, case: Case, mechanics: Mechanics):
        """Begin with the fields at the start, with cells where they are; collective."""
        self._mechanics, self._names = mechanics, [cell.name for cell in case.cells]
        self._exchanges, self._scene = case.exchange, mechanics.scene
        self._interval = case.polarity.interval if case.polarity is not None else case.time.end / case.time.samples
        self.knot = 0
        self.diffusing = {
            name: DiffusingField(name, law, self._exchanging(name), len(case.cells), mechanics.comm)
            for name, law in case.fields.items() if law.law == "diffusing"}
        self.by_name: dict[str, Any] = {**fields_of(case), **self.diffusing}
        self._advance()

    def _exchanging(self, name: str) -> Exchanging:
        """What exchanges with a field, by the surfaces of now."""
        return Exchanging.of(Surfaces.of(self._scene), self._names, [e for e in self._exchanges if e.field == name])

    @property
    def due(self) -> float:
        """Time of the next knot [µs]; infinite without fields that diffuse."""
        return self._interval * (self.knot + 1) if self.diffusing else math.inf

    def turn(self) -> None:
        """Go on to the time that was due; collective."""
        self.knot += 1
        self._advance()

    def _advance(self) -> None:
        if self.diffusing:
            x = self._mechanics.segments.everywhere()
            time = self._interval * self.knot
            if self._scene is not self._mechanics.scene:  # surfaces may have been divided anew
                self._scene = self._mechanics.scene
                for name, field in self.diffusing.items():
                    field.exchange_by(self._exchanging(name))
            for field in self.diffusing.values():
                try:
                    field.advance(time, x)
                except NumericsError as error:
                    when = self._mechanics.scene.time_unit.text(time)
                    raise NumericsError(f"the simulation failed at {when}: {error}") from None

    def rows(self) -> list[dict[str, Any]]:
        """Molecules of each field up to the last knot, for all cells, and for each: rows of a table; on rank 0."""
        rows: list[dict[str, Any]] = []
        unit = "_per_um" if self._mechanics.scene.dimension == 2 else ""
        for name, field in self.diffusing.items():
            m, known = field.molecules, {"time_us": field.time, "field": name}
            of_all = {"secreted": m.secreted.sum(), "taken_up": m.taken.sum(), "inside": m.inside, "out": m.out,
                      "decayed": m.decayed, "start": m.start, "lost": m.lost}
            by_cell = [{"secreted": m.secreted[k], "taken_up": m.taken[k]} for k in range(len(self._names))]
            rows += [{**known, "cell": k, **{f"{key}{unit}": float(value) for key, value in entries.items()}}
                     for k, entries in enumerate([of_all, *by_cell])]
        return rows

    def grids(self) -> dict[str, OnGrid]:
        """The diffusing fields at the last knot, for frames, by name [nM]; on rank 0."""
        found, unit = {}, units.number("1 nM", "nM")
        for name, field in self.diffusing.items():
            if field.whole is not None:
                grid = field.transport.grid
                found[name] = OnGrid(grid.low.tolist(), grid.size.tolist(), grid.count.tolist(), field.whole / unit,
                                     "nM")
        return found

    @property
    def closing(self) -> list[str]:
        """Steps and account of each diffusing field, for the end of the log; of use on rank 0."""
        told = []
        for name, f in self.diffusing.items():
            lowered = f", {f.lowered} taken with order 1 to stay positive" * (f.lowered > 0)
            error = abs(f.molecules.lost) / max(f.molecules.turnover, 1e-300)
            told.append(f"field {name}: {f.steps} steps in {f.seconds:.3g} s, {f.redone} repeated for accuracy{lowered}"
                        f"; its molecules are accounted for to {error:.1g}")
        return told

    def saved(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """State for a checkpoint as JSON, and arrays on rank 0; collective."""
        about: dict[str, Any] = {"knot": self.knot, "fields": {}}
        arrays: dict[str, np.ndarray] = {}
        for name, field in self.diffusing.items():
            about["fields"][name], found = field.saved()
            arrays |= {BOTH.format(name, key): values for key, values in found.items()}
        return about, arrays

    def restore(self, about: dict[str, Any], arrays: Arrays) -> None:
        """Set the state from the results of `saved`; collective."""
        self.knot = about["knot"]
        for name, field in self.diffusing.items():
            start = BOTH.format(name, "")
            here = arrays.names if self._mechanics.comm.rank == 0 else []
            field.restore(about["fields"][name], {key.removeprefix(start): arrays[key] for key in here
                                                  if key.startswith(start)})

    def close(self) -> None:
        """Free the PETSc objects; collective."""
        for field in self.diffusing.values():
            field.close()
