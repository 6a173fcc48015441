"""What is asked of PETSc: options that nothing used, its version."""

from __future__ import annotations

import ctypes

from petsc4py import PETSc

from .ghosts import petsc_library


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
