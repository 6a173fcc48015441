"""Compilation of C with the available compiler, and a cache of libraries."""

from __future__ import annotations

import atexit
import ctypes
import fcntl
import hashlib
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path

FLAGS = ["-O3", "-fPIC", "-std=gnu11", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"]
_SEAL = hashlib.sha256().digest_size  # bytes
MENDS = "apt install gcc libc6-dev, or without root: pip install ziglang"


class CompilerError(RuntimeError):
    """No C compiler works; the message has a remedy."""


def cache_directory() -> Path:
    """Directory of compiled kernels: $CELLMIG_CACHE, else the user's cache directory."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(os.environ.get("CELLMIG_CACHE") or Path(base) / "cellmig")


def _architecture(zig: bool) -> list[str]:
    """The newest level of x86-64 that the processor has: vectors of four on all, more registers on some; same bits."""
    try:
        flags = set(Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").split())
    except OSError:
        flags = set()
    if {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl", "fma", "bmi2"} <= flags:
        chosen = ["-march=x86-64-v4", "-mprefer-vector-width=256"]
    else:
        chosen = ["-march=x86-64-v3"] if {"avx2", "fma", "bmi2"} <= flags else []
    return [flag.replace("x86-64-", "x86_64_") for flag in chosen] if zig else chosen  # Zig spells it so


def compiler() -> list[str]:
    """Command of the C compiler: $CC, the system's, or Clang of the package ziglang.  Raises CompilerError if none."""
    if os.environ.get("CC"):
        return shlex.split(os.environ["CC"])
    for name in ("cc", "gcc", "clang"):
        if found := shutil.which(name):
            return [found]
    if find_spec("ziglang"):
        return [sys.executable, "-m", "ziglang", "cc"]
    raise CompilerError(f"no C compiler found: {MENDS}; or set CC")


def loaded(*units: str) -> ctypes.CDLL:
    """Compile and load sources of C as one library.  Raises CompilerError if that fails."""
    path = compiled(*units)
    try:
        return ctypes.CDLL(str(path))
    except OSError as error:
        reason = error
    try:  # from memory, if the disk is mounted noexec
        with open(os.memfd_create("kernel"), "wb") as memory:
            memory.write(path.read_bytes())
            memory.flush()
            return ctypes.CDLL(f"/proc/self/fd/{memory.fileno()}")
    except OSError:
        raise CompilerError(f"the compiled kernel cannot be loaded ({reason}): if the disk of '{path.parent}' is "
                            "mounted noexec, set CELLMIG_CACHE to a directory on another") from None


def compiled(*units: str) -> Path:
    """Shared library of sources of C, cached or compiled; safe with many processes.

    Several are compiled side by side and cached one by one, for other libraries that share some of them.
    Raises CompilerError if that fails.
    """
    return _made(units, "-shared", ".so")


def _made(units: Sequence[str], option: str, suffix: str) -> Path:
    """What the compiler makes of sources: a shared library, or the object of one."""
    command = compiler()
    command += [*FLAGS, *_architecture("ziglang" in command), option]
    key = hashlib.sha256("\0".join([*units, *command]).encode()).hexdigest()[:24]
    found = cache_directory() / f"{key}{suffix}"
    if _is_whole(found):
        return found
    with _turn(found.with_suffix(".lock")), tempfile.TemporaryDirectory() as scratch:
        if _is_whole(found):
            return found
        made = Path(scratch) / f"kernel{suffix}"
        command += [*map(str, _inputs(units, Path(scratch))), "-o", str(made), "-lm"]
        try:
            done = subprocess.run(command, capture_output=True, encoding="utf-8", errors="replace")
        except OSError as error:
            raise CompilerError(f"the C compiler '{command[0]}' cannot be started: {MENDS}; or set CC") from error
        if done.returncode:
            raise CompilerError(f"the C compiler '{command[0]}' could not compile the kernel:\n{done.stderr}")
        return _kept(made, found)


def _inputs(units: Sequence[str], scratch: Path) -> list[Path]:
    """Files that the compiler is given: a source, or the objects of several."""
    if len(units) > 1:
        with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
            return list(pool.map(lambda unit: _made([unit], "-c", ".o"), units))
    code = scratch / "kernel.c"
    code.write_text(units[0], encoding="utf-8")
    return [code]


@contextmanager
def _turn(lock: Path) -> Iterator[None]:
    """One process at a time: the others, such as ranks, wait for what the first compiles.  All at once if no file of
    the cache can be locked.
    """
    with ExitStack() as stack:
        with suppress(OSError):
            lock.parent.mkdir(parents=True, exist_ok=True)
            fcntl.flock(stack.enter_context(lock.open("wb")), fcntl.LOCK_EX)
            stack.callback(lock.unlink, missing_ok=True)
        yield


@cache
def library(source: Path) -> ctypes.CDLL:
    """A file of C, compiled and loaded once in a process."""
    return loaded(source.read_text(encoding="utf-8"))


def _is_whole(library: Path) -> bool:
    """Whether a library in the cache is as it was put there: one that was cut ends the process that loads it."""
    try:
        content = library.read_bytes()
    except OSError:
        return False
    return content[-_SEAL:] == hashlib.sha256(content[:-_SEAL]).digest()


def _kept(made: Path, library: Path) -> Path:
    """Path of the library, moved to the cache as a whole, or in a file of this process if the cache is not writable."""
    content = made.read_bytes()
    try:
        library.parent.mkdir(parents=True, exist_ok=True)
        part = library.with_suffix(f".{os.getpid()}")
        part.write_bytes(content + hashlib.sha256(content).digest())  # behind its end, which no loader minds
        part.replace(library)
        return library
    except OSError:
        with tempfile.NamedTemporaryFile(suffix=library.suffix, delete=False) as own:
            own.write(content)
        atexit.register(Path(own.name).unlink, missing_ok=True)
        return Path(own.name)
