"""The unit of all times that a user sees: that in which the case writes `time.end`.

Inside, times are in µs everywhere.  Log, tables, frames and pictures ask this unit for numbers, text and names.
"""

from __future__ import annotations

from dataclasses import dataclass

SIZES = {"us": 1.0, "ms": 1e3, "s": 1e6, "min": 6e7, "h": 3.6e9, "d": 8.64e10}  # units by symbol [µs]
_FINER = {"us": ("ns", 1e3), "ms": ("µs", 1.0), "s": ("ms", 1e-3), "min": ("s", 1e-6), "h": ("s", 1e-6),
          "d": ("min", 1.0 / 6e7)}  # unit of time steps in cases of each, and how many are in 1 µs
_MARK = "_us"  # end of the names of quantities with a time in the code's units


@dataclass(frozen=True)
class TimeUnit:
    """A unit of time; `symbol` : one of SIZES, as in case files and names of columns."""

    symbol: str = "us"

    @classmethod
    def of_size(cls, size: float) -> TimeUnit:
        """The unit of a size [µs], µs if it is none of SIZES."""
        return cls(next((symbol for symbol, known in SIZES.items() if known == size), "us"))

    @classmethod
    def of_column(cls, name: str) -> TimeUnit | None:
        """The unit of a column of times, such as "time_h"; None if it is no such column."""
        what, _, symbol = name.rpartition("_")
        return cls(symbol) if what == "time" and symbol in SIZES else None

    @property
    def size(self) -> float:
        """Its size [µs]."""
        return SIZES[self.symbol]

    @property
    def label(self) -> str:
        """Its symbol in text, such as µs."""
        return self.symbol.replace("u", "µ")

    def number(self, time: float) -> float:
        """A time [µs] in this unit."""
        return time / self.size

    def text(self, time: float, digits: int = 6) -> str:
        """A time [µs] as text, such as "6 h"."""
        return f"{self.number(time):.{digits}g} {self.label}"

    def step(self, dt: float, layout: str = ".3g") -> str:
        """A time step [µs] as text in a finer unit: "5 ns" in cases in µs, "20 s" in those in hours."""
        finer, count = _FINER[self.symbol]
        return f"{count * dt:{layout}} {finer}"

    def column(self, name: str) -> str:
        """Name in this unit of a column of the code's: "time_h" for "time_us", "vx_um_per_h" for "vx_um_per_us"."""
        return f"{name.removesuffix(_MARK)}_{self.symbol}" if name.endswith(_MARK) else name

    def entry(self, name: str, value: float) -> float:
        """A `value` of the code's column `name` in this unit: a time, a rate of change, or what has no time in it."""
        if not name.endswith(_MARK):
            return value
        return value * self.size if name.endswith(f"_per{_MARK}") else value / self.size

    def field(self, unit: str) -> str:
        """Unit of a field in files, "um/h" for "um/us"."""
        return unit.removesuffix("us") + self.symbol if unit.endswith("/us") else unit


MICROSECOND = TimeUnit()
