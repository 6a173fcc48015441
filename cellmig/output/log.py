"""Messages of a run on the screen and in `run.log`, progress, timers; numbers and tables as text."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from ..case.messages import replace_unprintable
from ..case.time_unit import MICROSECOND, TimeUnit
from .directory import together

if TYPE_CHECKING:
    from mpi4py import MPI

_FIRST_LINE, _NEXT_LINE, _NEXT_BAR = 5.0, 30.0, 0.2  # wall time [s]
_UNITS = (("ns", 1e-9, 1e-6), ("µs", 1e-6, 1e-3), ("ms", 1e-3, 1.0), ("s", 1.0, 120.0), ("min", 60.0, 7200.0),
          ("h", 3600.0, 48 * 3600.0), ("days", 86400.0, 730 * 86400.0), ("years", 365.25 * 86400.0, float("inf")))
_BAR = "{percentage:3.0f} % |{bar}| {n:.4g} of {total:.4g} {unit}{postfix}  left {remaining}"


class Log:
    """Writes lines on rank 0; on the others calls do nothing.

    Parameters
    ----------
    comm : mpi4py communicator; creating a log is collective, writing is not.
    directory : Path -- of the run with `run.log`; None for the screen alone.
    quiet : bool -- nothing on the screen.
    """

    def __init__(self, comm: MPI.Intracomm, directory: Path | None = None, quiet: bool = False) -> None:
        replace_unprintable()
        self.quiet, self.root = quiet, comm.rank == 0
        self._writers: list[Callable[[str], None]] = [_to_screen] if self.root and not quiet else []
        if directory is not None:
            self._path = Path(directory) / "run.log"
            together(comm, self._path.touch, root_only=True)
            self._writers += [self._to_file] if self.root else []

    def _to_file(self, text: str) -> None:
        with open(self._path, "a", encoding="utf-8", errors="backslashreplace") as file:
            file.write(text + "\n")

    def error(self, text: str) -> None:
        """Write an error to the file and, even if quiet, to stderr."""
        self._write(text, [write for write in self._writers if write is not _to_screen])
        if self.root:
            print(text, file=sys.stderr, flush=True)

    def __call__(self, text: str) -> None:
        """Write lines."""
        self._write(text, list(self._writers))

    def _write(self, text: str, writers: list[Callable[[str], None]]) -> None:
        for write in writers:
            try:
                write(text)
            except OSError:  # a full disk or a closed pipe must not end the run
                self._writers.remove(write)

    def table(self, rows: Iterable[tuple[str, Any]]) -> None:
        """Write pairs of key and value, aligned."""
        self(two_columns(rows))


def _to_screen(text: str) -> None:
    tqdm.write(text, file=sys.stdout)  # does not overwrite a progress bar
    sys.stdout.flush()


def two_columns(rows: Iterable[tuple[str, Any]]) -> str:
    """Pairs of key and value as lines with aligned values."""
    rows = [(str(key), str(value)) for key, value in rows]
    width = max((len(key) for key, _ in rows), default=0)
    return "\n".join(f"{key:<{width}}  {value}".rstrip() for key, value in rows)


def table(head: list[str], lines: list[list[str]]) -> list[str]:
    """Lines of a table in aligned Markdown."""
    wide = [max(len(line[i]) for line in [head, *lines]) for i in range(len(head))]
    return [f"| {' | '.join(cell.ljust(w) for cell, w in zip(line, wide, strict=True))} |"
            for line in [head, ["-" * w for w in wide], *lines]]


def clock(seconds: float) -> str:
    """Wall time [s] as text, such as 8 s, 2:05, 1:02:05, 3.2 days."""
    if seconds >= 48 * 3600:
        return duration(seconds)
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}" if minutes else f"{rest} s"


def duration(seconds: float, digits: int = 2) -> str:
    """A time [s] as text in a suitable unit, such as 400 µs, 25 s, 3.2 h, 8.6 years."""
    unit, one, _ = next(found for found in _UNITS if seconds < found[2]) if seconds else ("s", 1.0, 0.0)
    value = float(f"{seconds / one:.{digits}g}")
    return f"{value:,.0f} {unit}" if 1e3 <= value < 1e6 else f"{value:.{max(digits, 3)}g} {unit}"


def simulated(time: float, unit: TimeUnit) -> str:
    """A simulated time [µs] as text in the unit of the case; in cases in µs, in one that suits."""
    return duration(1e-6 * time, 6) if unit == MICROSECOND else unit.text(time)


def _on_terminal() -> bool:
    """Whether output goes to a terminal; ranks of Open MPI always see one, so that `./run` sets CELLMIG_TERMINAL."""
    interactive = "CELLMIG_TERMINAL" in os.environ or "ipykernel" in sys.modules  # a notebook shows bars, too
    return interactive or ("OMPI_COMM_WORLD_SIZE" not in os.environ and sys.stdout.isatty())


class Progress:
    """Shows the progress of a run: a bar on a terminal, else lines at intervals, also in the log.

    Parameters
    ----------
    log : Log -- progress is not shown if it is quiet.
    end, start : float -- simulated time [us] at the end and at the start of this run.
    unit : TimeUnit -- of the times that are shown.
    """

    def __init__(self, log: Log, end: float, start: float = 0.0, unit: TimeUnit = MICROSECOND) -> None:
        self._log, self._end, self._start, self._unit = log, end, start, unit
        self._begin = perf_counter()
        self._bar = None
        if not log.root or log.quiet:
            self._due = float("inf")
        elif _on_terminal():
            width = shutil.get_terminal_size().columns - 1  # COLUMNS if set: the terminal of mpiexec has none
            self._bar = tqdm(total=unit.number(end), initial=unit.number(start), file=sys.stdout, ncols=width,
                             bar_format=_BAR.replace("{unit}", unit.label), leave=False)
            self._due = self._begin
        else:
            self._due = self._begin + _FIRST_LINE

    def __call__(self, time: float, step: int, dt: float, within: str = "") -> None:
        """Update, with simulated time [us], number of steps, step [us], and what is done `within` the next step."""
        now = perf_counter()
        if now < self._due:
            return
        if self._bar is not None:
            self._due = now + _NEXT_BAR
            self._bar.set_postfix_str(f"step {step}  dt {self._unit.step(dt)}{within and f'  {within}'}", refresh=False)
            self._bar.update(self._unit.number(time) - self._bar.n)
        else:
            self._due = now + _NEXT_LINE
            self._log(self._line(time, step, dt, now - self._begin) + (within and f"  {within}"))

    def _line(self, time: float, step: int, dt: float, wall: float) -> str:
        done = time - self._start
        left = clock(wall * (self._end - time) / done) if done > 0 else "unknown"
        unit = self._unit
        return (f"{unit.number(time):10.4g} {unit.label}  {100 * time / self._end:5.1f} %  step {step:9d}  "
                f"dt {unit.step(dt, '8.4g')}  wall {clock(wall):>8}  left {left:>8}")

    def close(self) -> None:
        """Remove the bar."""
        if self._bar is not None:
            self._bar.close()


class Timers:
    """Wall time by section, as in ``with timers("contact"):``; a section inside another interrupts that one."""

    def __init__(self) -> None:
        self._seconds: dict[str, float] = {}
        self._open = ["other"]
        self._since = perf_counter()

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Time what is done inside as part of this section."""
        self._settle()
        self._open.append(name)
        try:
            yield
        finally:
            self._settle()
            self._open.pop()

    def _settle(self) -> None:
        """Give the time since the last change of section to the one that is open."""
        now, name = perf_counter(), self._open[-1]
        self._seconds[name] = self._seconds.get(name, 0.0) + now - self._since
        self._since = now

    def seconds(self) -> dict[str, float]:
        """Wall time of this rank by section since the timers were created [s]; `other` is outside of all sections."""
        self._settle()
        spent = dict(self._seconds)
        other = spent.pop("other")
        return {**spent, "other": other}

    def summary(self, comm: MPI.Intracomm) -> str:
        """Table of sections: smallest, mean and largest time of the ranks, share of the total; collective."""
        ranks = comm.allgather(self.seconds())
        names = [*dict.fromkeys(name for rank in ranks for name in rank if name != "other"), "other"]
        total = sum(sum(rank.values()) for rank in ranks)
        width = max(len("section"), *map(len, names))
        lines = [f"{'section':<{width}}  {'min s':>9}  {'avg s':>9}  {'max s':>9}  {'% total':>7}"]
        for name in names:
            spent = [rank.get(name, 0.0) for rank in ranks]
            numbers = (min(spent), sum(spent) / len(spent), max(spent))
            share = 100 * sum(spent) / total
            lines.append(f"{name:<{width}}  " + "  ".join(f"{x:9.3f}" for x in numbers) + f"  {share:7.1f}")
        return "\n".join(lines)
