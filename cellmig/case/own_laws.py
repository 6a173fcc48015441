"""The user's own laws, from files outside of the package; a manifest lists these files with their hashes."""

from __future__ import annotations

import hashlib
import os
import sys
import traceback
from collections.abc import Iterable, Mapping
from types import ModuleType

from . import registry
from .messages import suggest

# Parameters and methods that a law of each kind needs.
NEEDED = {
    "material": ("density", "energy", "stress", "out_of_plane", "bulk_modulus", "shear_modulus", "sound_speed",
                 "stabilisation", "viscosity", "numerical_modulus", "numerical_viscosity"),
    "adhesion": ("bond_density", "well_depth", "equilibrium_distance", "cutoff", "cap", "work", "stiffness",
                 "potential", "slope", "primitive"),
    "protrusion": ("cells", "protrusion_ratio", "height", "push", "ramp", "ramp_slope", "front", "hold", "random",
                   "direction", "basal", "gate"),
    "polarity": ("interval", "drawn", "next", "start", "cells"),
    "cortex": ("energy", "tension"), "friction": ("coefficient", "drag"),
    "medium": ("coefficient", "force"),
    "load_curve": ("value", "rate", "acceleration"),
    "shape": ("area", "lowest", "outline", "particles", "parts"),
}
FORMER_KINDS = {"history": "load_curve"}  # by their former names
_included: dict[str, str] = {}  # path to SHA-256


class LawFileError(ValueError):
    """A file of laws that cannot be used; the message, with file and line, is for the user."""


def included() -> list[dict[str, str]]:
    """Files that have been included, in order, with the SHA-256 of their contents."""
    return [{"file": path, "sha256": digest} for path, digest in _included.items()]


def include(path: str | os.PathLike, sha256: str | None = None) -> None:
    """Execute a file that registers laws, once; the laws of the package must have been registered.

    `sha256` is the expected hash of the file, None for any.

    Raises LawFileError where the file cannot be read, differs from that hash, fails or has no complete law.
    """
    path = os.path.realpath(path)
    try:
        with open(path, "rb") as stream:
            raw = stream.read()
        digest = hashlib.sha256(raw).hexdigest()
    except (OSError, ValueError) as error:
        raise LawFileError(f"'{path}' cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if sha256 not in (None, digest):
        raise LawFileError(f"'{path}' is not what it was in the run that is there: give it back, or begin anew")
    if _included.get(path) == digest:
        return
    if path in _included:
        raise LawFileError(f"'{path}' has changed since it was loaded")
    before = {kind: registry.laws(kind) for kind in registry.kinds()}
    try:
        _execute(path, raw, digest)
        _check(path, before)
    except BaseException:
        registry.restore(before)
        raise
    _included[path] = digest


def include_all(files: Iterable[Mapping[str, str]]) -> None:
    """Include the files of laws that a manifest lists, unless a file with the same contents is included already.

    Raises LawFileError where one has changed.
    """
    for file in files:
        if file["sha256"] not in _included.values():
            include(file["file"], file["sha256"])


def _execute(path: str, raw: bytes, digest: str) -> None:
    """Execute a file as a module with a name of its own, so that its classes can be pickled."""
    module = ModuleType(f"cellmig_law_{digest[:16]}")
    module.__file__ = path
    sys.modules[module.__name__] = module
    try:
        exec(compile(raw, path, "exec"), module.__dict__)
    except (Exception, SystemExit) as error:
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == path]
        line = error.lineno if isinstance(error, SyntaxError) and error.filename == path else lines[-1] if lines else 1
        what = f"not Python: {error.msg}" if isinstance(error, SyntaxError) else f"{type(error).__name__}: {error}"
        raise LawFileError(f"{path}:{line}: {what}") from None


def _check(path: str, before: Mapping[str, Mapping[str, type]]) -> None:
    """Raise LawFileError if no law is new, or a new one is of an unknown kind, has a known name or is incomplete."""
    new = [(kind, name, cls) for kind in registry.kinds() for name, cls in registry.laws(kind).items()
           if before.get(kind, {}).get(name) is not cls]
    if not new:
        raise LawFileError(f"'{path}' has no law: a class with @law(\"kind\", \"name\") before it is one")
    for kind, name, cls in new:
        if kind not in before:
            present = FORMER_KINDS.get(kind)
            raise LawFileError(f"'{path}': the kind of law '{kind}' is called '{present}' now" if present else
                               f"'{path}': no kind of law '{kind}'{suggest(kind, before)}")
        if name in before[kind]:
            raise LawFileError(f"'{path}': there is a law '{name}' of the kind '{kind}' already: give it another name")
        fields = getattr(cls, "__dataclass_fields__", {})
        if missing := [one for one in NEEDED.get(kind, ()) if one not in fields and not hasattr(cls, one)]:
            raise LawFileError(f"'{path}': '{name}' lacks what a law of the kind '{kind}' has: {', '.join(missing)}")
