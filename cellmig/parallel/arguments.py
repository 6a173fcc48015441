"""Which part of a command line is PETSc's; this is known before PETSc is started."""

from __future__ import annotations

import re

_NUMBER = re.compile(r"-?(\d|\.\d)")


def split_arguments(arguments: list[str]) -> tuple[list[str], list[str]]:
    """(ours, PETSc's): a word with one dash, and the value after it, are PETSc's; all else is ours."""
    ours, theirs, option_open = [], [], False
    for word in arguments:
        option = word.startswith("-") and not word.startswith("--") and not _NUMBER.match(word) and word != "-h"
        if option or (option_open and not word.startswith("--")):
            theirs.append(word)
        else:
            ours.append(word)
        option_open = option
    return ours, theirs
