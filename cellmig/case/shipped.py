"""The cases and examples that come with the package: what each is, and copies of them with the files that they need."""

from __future__ import annotations

import os
import shutil
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path

from .messages import nearest

_PACKAGE = Path(__file__).parents[1]


def _folder(name: str) -> Path:
    """In the package once it is installed, beside it in a checkout."""
    inside = _PACKAGE / name
    return inside if inside.is_dir() else _PACKAGE.parent / name


FOLDER, EXAMPLES = _folder("cases"), _folder("examples")


class NotShipped(LookupError):
    """No case or example of this name; the message is for the user."""


class Different(FileExistsError):
    """A copy would replace a file that is not the same; the message is for the user."""


def listing() -> str:
    """Each case with its title, and each example with what it does, a line each."""
    width = max(map(len, names()))
    cases = [(path.stem, tomllib.loads(_text(path))["title"]) for path in _files(FOLDER)]
    examples = [(path.name, _first_sentence(path)) for path in _files(EXAMPLES)]
    return "\n".join([*(f"{name:<{width}}  {title}" for name, title in cases), "", "examples in Python:",
                      *(f"{name:<{width}}  {title}" for name, title in examples), "",
                      "'cellmig cases NAME' copies one to here, with the files that it needs"])


def names() -> list[str]:
    """Names of all cases, and the file names of all examples."""
    return [*(path.stem for path in _files(FOLDER)), *(path.name for path in _files(EXAMPLES))]


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.suffix in (".toml", ".py", ".ipynb"))


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def _first_sentence(path: Path) -> str:
    """What an example says of itself."""
    if path.suffix == ".ipynb":
        return "A notebook to look round"
    return _text(path).partition('"""')[2].partition("\n")[0].partition(".  ")[0].rstrip(".")


def needed(name: str) -> list[Path]:
    """The file of a case or example and, for a case, those beside it that it names, and that they name.

    Raises NotShipped.
    """
    files = _files(EXAMPLES) + _files(FOLDER)
    known = {path.stem: path for path in files} | {path.name: path for path in files}
    if name not in known:
        near = nearest(name, list(known))
        raise NotShipped(f"no case '{name}'; " + (f"did you mean '{near}'?" if near else "'cellmig cases' lists them"))
    found: list[Path] = []
    left = [known[name]]
    while left:
        file = left.pop(0)
        if file in found:
            continue
        found.append(file)
        if file.suffix == ".toml":
            beside = {path.name: path for path in file.parent.iterdir()}
            left += [beside[text] for text in _texts(tomllib.loads(_text(file))) if text in beside]
    return found


def _texts(value: object) -> Iterator[str]:
    """All texts in a tree of tables and lists."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list):
        for item in value.values() if isinstance(value, dict) else value:
            yield from _texts(item)


def copy(names: Sequence[str], to: Path) -> list[Path]:
    """Copy cases and examples, with what they need, to a folder; returns the copies, also those that were there.

    Raises NotShipped, and Different before anything is copied.
    """
    if os.path.lexists(to) and not to.is_dir():
        raise Different(f"'{to}' is not a folder; name another by --to")
    copies = {to / file.name: file for name in names for file in needed(name)}
    if others := [copy for copy, file in copies.items() if os.path.lexists(copy) and not _same(copy, file)]:
        raise Different(f"{', '.join(map(str, others))}: there already, and not the same; move it away, or name "
                        "another folder by --to")
    to.mkdir(parents=True, exist_ok=True)
    for copy, file in copies.items():
        if not copy.exists():
            shutil.copyfile(file, copy)
    return list(copies)


def _same(one: Path, other: Path) -> bool:
    return one.is_file() and one.read_bytes() == other.read_bytes()
