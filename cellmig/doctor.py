"""`cellmig doctor`: checks of this machine for what cellmig needs, with remedies.  It needs Python alone."""

from __future__ import annotations

import importlib
import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from cellmig.parallel.launch import PYTHON, mpiexec, on_ranks, outside_mpi

OLDEST = (3, 11)
# Required modules, with the versions that the tests ran with, those of Debian 12 and 13.
MODULES = {"numpy": "1.24, 2.2", "scipy": "1.10, 1.15", "pint": "0.19, 0.24", "tqdm": "4.64, 4.67",
           "h5py": "3.7, 3.13", "meshio": "5.0, 5.3", "matplotlib": "3.6, 3.10", "mpi4py": "3.1, 4.0"}
TESTED = {**MODULES, "system": "Debian 12, 13", "Python": "3.11, 3.13", "PETSc": "3.18, 3.22",
          "MPI": "Open MPI 4.1, 5.0"}
PETSC = "import cellmig; from petsc4py import PETSc; PETSc.DMSwarm; print(*PETSc.Sys.getVersion(), sep='.')"
MPI = "from mpi4py import MPI; print(MPI.Get_library_version().split(', package')[0].split('\\n')[0])"
RANKS = "from mpi4py import MPI; MPI.COMM_WORLD.rank == 0 and print(MPI.COMM_WORLD.size)"
# Optional programs and modules: their use and package.
OPTIONAL = {"pandas": ("tables as frames in Python", "python3-pandas"), "ffmpeg": ("films as mp4, else gif", "ffmpeg"),
            "pvpython": ("pictures by ParaView without a window", "python3-paraview"),
            "mkdocs": ("the documentation as a site", "mkdocs mkdocs-material")}
PATIENCE = 60.0  # time limit of a tried program [s]


class Finding(NamedTuple):
    """Result of a check; `remedy` : the remedy, a command or a text, empty if nothing is wrong."""

    name: str
    found: str
    remedy: str = ""


def examine() -> tuple[bool, str]:
    """Whether nothing is missing, and the report for the user."""
    findings = list(_findings())
    width = max(len(f.name) for f in findings)
    lines = [f"{f.name:<{width}}  {'LACKING: ' if f.remedy else ''}{f.found}{_tested_versions(f)}" for f in findings]
    remedies = dict.fromkeys(f.remedy for f in findings if f.remedy)
    packages = sorted(remedy.removeprefix("apt install ") for remedy in remedies if remedy.startswith("apt install "))
    others = [remedy for remedy in remedies if not remedy.startswith("apt install ")]
    if packages:
        others.insert(0, f"apt install {' '.join(packages)}    (Debian, as root)")
    lines += ["", "to mend it:", *(f"  {remedy}" for remedy in others)] if remedies else ["", "nothing is missing"]
    return not remedies, "\n".join(lines)


def _tested_versions(finding: Finding) -> str:
    return f"   (tested: {TESTED[finding.name]})" if finding.name in TESTED else ""


def _system() -> str:
    """Name of the operating system."""
    try:
        return platform.freedesktop_os_release()["PRETTY_NAME"]
    except (OSError, KeyError):
        return platform.platform()


def _findings() -> Iterator[Finding]:
    yield Finding("system", _system())
    python = "" if sys.version_info >= OLDEST else f"a Python of {'.'.join(map(str, OLDEST))} or later"
    yield Finding("Python", f"{platform.python_version()} ({sys.executable})", python)
    for name in MODULES:
        yield _checked(name, lambda name=name: _version(name), f"apt install python3-{name}")
    yield _checked("PETSc", lambda: _output(*PYTHON, "-c", PETSC), _petsc_remedy())
    yield from _mpi()
    yield _checked("C compiler", _compiler, "apt install gcc libc6-dev")
    yield _checked("kernel cache", _cache, "set CELLMIG_CACHE to a directory that can be written")
    yield _checked("output", lambda: _writable(Path.cwd()), "start from a directory that can be written, or use --out")
    yield Finding("cores", str(len(os.sched_getaffinity(0))))
    yield _checked("memory", _memory, "")
    for name, (use, package) in OPTIONAL.items():
        installed = shutil.which(name) or importlib.util.find_spec(name)
        yield Finding(name, "there" if installed else f"not here, and not needed; for {use}: apt install {package}")


def _petsc_remedy() -> str:
    """What to do where PETSc cannot be used: install it or, where Debian's is there, a Python that it goes with."""
    there = importlib.util.find_spec("petsc4py")
    if there and "petscdir" in str(there.origin):
        return ("install cellmig in an environment of Debian's Python, for which Debian's petsc4py is: "
                "/usr/bin/python3 -m venv --system-site-packages DIR")
    return "apt install python3-petsc4py"


def _checked(name: str, probe: Callable[[], str], remedy: str) -> Finding:
    try:
        return Finding(name, probe())
    except Exception as error:  # whatever the error, it cannot be used
        reason = getattr(error, "stderr", "") or str(error) or type(error).__name__
        return Finding(name, reason.strip().split("\n")[-1], remedy)


def _version(name: str) -> str:
    return str(getattr(importlib.import_module(name), "__version__", "of unknown version"))


def _output(*command: str) -> str:
    """Output of a program; raises an error where the program fails."""
    return subprocess.run(command, env=outside_mpi(), stdin=subprocess.DEVNULL, capture_output=True,
                          encoding="utf-8", errors="replace",
                          timeout=PATIENCE, check=True).stdout.strip()


def _mpi() -> Iterator[Finding]:
    if not (launcher := mpiexec()):
        yield Finding("MPI", "no mpiexec", "apt install openmpi-bin")
        return
    yield _checked("MPI", lambda: _output(*PYTHON, "-c", MPI), "apt install python3-mpi4py")
    command = on_ranks(2, [*PYTHON, "-c", RANKS])
    yield _checked("mpiexec", lambda: f"{launcher} ({_output(launcher, '--version').splitlines()[0]}) starts "
                                    f"{_output(*command)} ranks", f"{launcher} -n 2 true    (tells more)")


def _compiler() -> str:
    from cellmig.kernel.toolchain import compiler

    command = compiler()
    with tempfile.TemporaryDirectory() as directory:
        source = Path(directory) / "try.c"
        source.write_text("#include <math.h>\n#include <stdint.h>\ndouble f(double x) { return sqrt(x); }\n",
                          encoding="utf-8")
        _output(*command, "-shared", "-fPIC", str(source), "-o", str(source.with_suffix(".so")), "-lm")
    return " ".join(command)


def _cache() -> str:
    from cellmig.kernel.toolchain import cache_directory

    directory = cache_directory()
    directory.mkdir(parents=True, exist_ok=True)
    return _writable(directory)


def _writable(directory: Path) -> str:
    with tempfile.TemporaryFile(dir=directory):
        return str(directory)


def _memory() -> str:
    from cellmig.output.manifest import memory_sizes

    sizes = memory_sizes("/proc/meminfo")
    return f"{1e-9 * sizes['MemAvailable']:.3g} of {1e-9 * sizes['MemTotal']:.3g} GB free"
