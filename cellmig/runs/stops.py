"""Signals that ask a run, or many, for a clean end."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def stop_requests() -> Iterator[list[int]]:
    """List that receives SIGTERM, SIGUSR1 and SIGINT, which ask for a clean end; a second SIGINT ends the program.

    Python lets the main thread alone listen to signals: in others the list stays empty.
    """
    stop_signals: list[int] = []

    def note(number: int, _: object) -> None:
        if number == signal.SIGINT and signal.SIGINT in stop_signals:
            raise KeyboardInterrupt
        stop_signals.append(number)

    listens = threading.current_thread() is threading.main_thread()
    heard = (signal.SIGTERM, signal.SIGUSR1, signal.SIGINT) if listens else ()
    old = {number: signal.signal(number, note) for number in heard}
    try:
        yield stop_signals
    finally:
        for number, handler in old.items():
            signal.signal(number, handler)
