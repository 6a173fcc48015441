"""Messages about a case: one line for each mistake, with file, line, key and the nearest valid word."""

from __future__ import annotations

import difflib
import io
import sys
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Mistake:
    """A mistake in a case: its file or command-line option, line or None, key or "", and message."""

    file: str
    line: int | None
    key: str
    message: str

    def __str__(self) -> str:
        place = f"{self.file}:{self.line}" if self.line else self.file
        text = ": ".join(part for part in (place, self.key, self.message) if part)
        return text.encode("utf-8", "backslashreplace").decode()


class CaseError(ValueError):
    """A case that cannot be used; `mistakes` holds all mistakes, str() is the message for the user."""

    def __init__(self, mistakes: Iterable[Mistake]):
        self.mistakes = list(mistakes)
        super().__init__(self.mistakes)

    def __str__(self) -> str:
        return "\n".join(map(str, self.mistakes))


def nearest(word: object, words: Iterable[str], cutoff: float = 0.6) -> str | None:
    """The one of `words` that is most similar to `word`, ignoring case; None below a similarity of `cutoff` [-]."""
    if not isinstance(word, str):
        return None
    lower = {w.lower(): w for w in words}
    found = difflib.get_close_matches(word.lower()[:80], lower, n=1, cutoff=cutoff)
    return lower[found[0]] if found else None


def suggest(word: object, words: Iterable[str]) -> str:
    """End of a message about an unknown word: the nearest known one, or a list of all."""
    words = list(dict.fromkeys(words))
    if near := nearest(word, words):
        return f"; did you mean '{near}'?"
    return f"; there is {', '.join(map(repr, words[:20]))}" if words else "; there is none"


def show(value: object) -> str:
    """A value as short text on one line."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # an integer of thousands of digits, or tables nested thousands deep
        return "that"
    return text if len(text) <= 60 else text[:57] + "..."


def replace_unprintable() -> None:
    """Make the standard streams replace characters that they cannot encode."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and (stream.errors == "strict" or "utf" not in stream.encoding.lower()):
            stream.reconfigure(errors="replace")
