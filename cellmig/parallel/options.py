"""PETSc's options: the integrator and the step that they choose, those that have no effect, defaults, errors."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from petsc4py import PETSc

from cellmig.case.messages import suggest

from .arguments import OptionError
from .ghosts import petsc_library

IMPLICIT = ("alpha2", "beuler", "theta", "cn", "bdf")  # TS types that use our tangent
EXPLICIT = ("leapfrog", "euler", "rk", "ssp")  # TS types that need the right-hand side only
OVERDAMPED = tuple(kind for kind in IMPLICIT if kind not in ("alpha2", "cn"))  # for motion without inertia

_OURS = {"no_signal_handler"}
# Options that print something, or say where to stop, do not affect results.
_SHOWS = re.compile(r"(^|_)(monitor|view|log|info|malloc|left|max_steps|memory|help|version|skip_petscrc)(_|$)")


def check_integrator(of_case: str, place: str) -> None:
    """Check the integrator; `place` is where the case names it, for messages.

    The option -ts_type overrides the case.  "leapfrog" is our own TS type, of PETSc's type "python".

    Raises OptionError for an integrator that does not exist or cannot be used.
    """
    options = PETSc.Options()
    kind = requested_integrator(of_case)
    if kind == "auto" and not options.hasName("ts_type"):
        return
    if of_case == "static":
        if options.hasName("ts_type"):
            raise OptionError("-ts_type: a static case takes no steps in time; say time.integrator instead")
        return
    if of_case == "overdamped":
        if kind not in OVERDAMPED:
            raise OptionError(f"-ts_type: an overdamped case takes one of {', '.join(OVERDAMPED)}, not '{kind}'")
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
    """The integrator that the options name, otherwise that of the case; of an overdamped case the type of TS."""
    return PETSc.Options().getString("ts_type", "beuler" if of_case == "overdamped" else of_case)


def requested_step(of_case: float | None) -> float | None:
    """The time step [µs] that the options give, otherwise that of the case.

    Raises OptionError for a step that is not positive.
    """
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
    """PETSc's options from the command line, PETSC_OPTIONS and files: values by name."""
    found = PETSc.Options().getAll()
    return {name: found[name] or "" for name in sorted(found) if name not in _OURS}


def options_in(words: Sequence[str]) -> dict[str, str]:
    """Options in the words of a command line: values by name."""
    found, name = {}, ""
    for word in words:
        if word.startswith("-") and not word[1:2].isdecimal():
            name = word[1:]
            found[name] = ""
        else:
            found[name] = word
    return found


def affecting_results(options: dict[str, str]) -> dict[str, str]:
    """Those of the options that may change a result."""
    return {name: value for name, value in options.items() if not _SHOWS.search(name)}


@contextmanager
def default_options(values: dict[str, str]) -> Iterator[None]:
    """Context in which options that the user has not given have these values, for setFromOptions."""
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
    """Context in which an error of PETSc is an error in its options, for setFromOptions.

    Raises OptionError in place of PETSc's.
    """
    try:
        yield
    except PETSc.Error as error:
        reason = str(error).strip().split("\n")[-1].partition("] ")[2]
        raise OptionError(f"PETSc cannot follow its options: {reason or error}") from error


@contextmanager
def original_errors() -> Iterator[None]:
    """Context in which PETSc calls our functions.

    Raises their exceptions as they are, which petsc4py 3.22 wraps in an error of PETSc's.
    """
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
    """PETSc options that were given but have not been read by any object, as "-name value"."""
    library = ctypes.CDLL(petsc_library())
    n = ctypes.c_int(0)
    names, values = ctypes.POINTER(ctypes.c_char_p)(), ctypes.POINTER(ctypes.c_char_p)()
    if library.PetscOptionsLeftGet(None, ctypes.byref(n), ctypes.byref(names), ctypes.byref(values)):
        return []
    return [f"-{names[i].decode()} {(values[i] or b'').decode()}".strip() for i in range(n.value)]


def petsc_version() -> str:
    """Version of the PETSc library."""
    return ".".join(map(str, PETSc.Sys.getVersion()))
