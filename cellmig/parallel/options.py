"""What is asked of PETSc: the integrator, options that nothing used, its version."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from petsc4py import PETSc

from cellmig.case.messages import suggest

from .arguments import OptionError
from .ghosts import petsc_library

IMPLICIT = ("alpha2", "beuler", "theta", "cn", "bdf")  # TS types that our tangent serves
EXPLICIT = ("leapfrog", "euler", "rk", "ssp")  # TS types that need no more than a rate of change


_OURS = {"no_signal_handler"}
# What shows something, or says where to stop, decides no number.
_SHOWS = re.compile(r"(^|_)(monitor|view|log|info|malloc|left|max_steps|memory|help|version|skip_petscrc)(_|$)")


def check_integrator(of_case: str, place: str) -> None:
    """Refuse an integrator that is unknown or cannot be driven; `place` : where the case says which.

    The option -ts_type goes before the case; "leapfrog" is a TS type of ours, written in Python as PETSc sees it.
    """
    options = PETSc.Options()
    kind = requested_integrator(of_case)
    if kind == "auto" and not options.hasName("ts_type"):
        return
    if of_case == "static":
        if options.hasName("ts_type"):
            raise OptionError("-ts_type: a static case takes no steps in time; say time.integrator instead")
        return
    if options.hasName("ts_type"):
        place = "-ts_type"
        if kind == "leapfrog":
            options["ts_type"] = PETSc.TS.Type.PYTHON
    known = {name for key, name in vars(PETSc.TS.Type).items() if key.isupper()}
    if kind not in known | set(EXPLICIT):
        raise OptionError(f"{place}: there is no integrator '{kind}'{suggest(kind, (*EXPLICIT, *IMPLICIT))}")
    if kind not in (*EXPLICIT, *IMPLICIT, PETSc.TS.Type.PYTHON):
        raise OptionError(f"{place}: '{kind}' splits the equations or needs them in another form; take one of "
                          f"{', '.join((*EXPLICIT, *IMPLICIT))}")


def requested_integrator(of_case: str) -> str:
    """The integrator of the options, else that of the case."""
    return PETSc.Options().getString("ts_type", of_case)


def requested_step(of_case: float | None) -> float | None:
    """The step [µs] of the options, else that of the case."""
    options = PETSc.Options()
    if not options.hasName("ts_dt"):
        return of_case
    try:
        step = options.getReal("ts_dt")
    except KeyError:
        step = 0.0
    if not step > 0.0:
        raise OptionError("-ts_dt: expects a step in µs, such as 1e-3")
    return step


def options_given() -> dict[str, str]:
    """PETSc's options and their values, from the command line, PETSC_OPTIONS and files, by name."""
    found = PETSc.Options().getAll()
    return {name: found[name] or "" for name in sorted(found) if name not in _OURS}


def options_in(words: Sequence[str]) -> dict[str, str]:
    """Options and their values in the words of a command line, by name."""
    found, name = {}, ""
    for word in words:
        if word.startswith("-") and not word[1:2].isdecimal():
            name = word[1:]
            found[name] = ""
        else:
            found[name] = word
    return found


def affecting_results(options: dict[str, str]) -> dict[str, str]:
    """Those options that may change a result."""
    return {name: value for name, value in options.items() if not _SHOWS.search(name)}


@contextmanager
def default_options(values: dict[str, str]) -> Iterator[None]:
    """While objects take their options: those that were not given have these values, and none afterwards."""
    options = PETSc.Options()
    missing = {name: value for name, value in values.items() if not options.hasName(name)}
    for name, value in missing.items():
        options[name] = value
    try:
        yield
    finally:
        for name in missing:
            options.delValue(name)


@contextmanager
def option_errors() -> Iterator[None]:
    """While objects take their options, the same on all ranks: PETSc's complaint is one about an option."""
    try:
        yield
    except PETSc.Error as error:
        reason = str(error).strip().split("\n")[-1].partition("] ")[2]
        raise OptionError(f"PETSc cannot follow its options: {reason or error}") from error


@contextmanager
def original_errors() -> Iterator[None]:
    """While PETSc calls functions of ours: what they raise comes through, though petsc4py 3.22 wraps it in its own."""
    try:
        yield
    except PETSc.Error as error:
        cause: BaseException | None = error
        while isinstance(cause, PETSc.Error):
            cause = cause.__cause__
        if cause is None:
            raise
        raise cause from None


def unused_options() -> list[str]:
    """PETSc options that were given and that nothing has asked for, as "-name value"."""
    library = ctypes.CDLL(petsc_library())
    n = ctypes.c_int(0)
    names, values = ctypes.POINTER(ctypes.c_char_p)(), ctypes.POINTER(ctypes.c_char_p)()
    if library.PetscOptionsLeftGet(None, ctypes.byref(n), ctypes.byref(names), ctypes.byref(values)):
        return []
    return [f"-{names[i].decode()} {(values[i] or b'').decode()}".strip() for i in range(n.value)]


def petsc_version() -> str:
    """Version of the PETSc library."""
    return ".".join(map(str, PETSc.Sys.getVersion()))
