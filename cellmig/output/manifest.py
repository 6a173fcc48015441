"""`manifest.json`: case, environment, numbers and end of a run."""

from __future__ import annotations

import json
import math
import platform
import subprocess
import sys
from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..case.load import from_dict
from ..case.own_laws import include_all
from ..case.schema import Case
from ..case.time_unit import MICROSECOND, SIZES, TimeUnit
from ..laws import register
from .directory import MANIFEST, OutputError, replace

if TYPE_CHECKING:
    from mpi4py import MPI

_LIBRARIES = ("numpy", "numba", "h5py", "mpi4py", "petsc4py")
# Kinds of entries that are read again; null is as if an entry was absent.
_KINDS: dict[type | tuple[type, ...], tuple[str, ...]] = {
    dict: ("case", "skipped", "dt_us", "steps_by_mechanism", "strain", "checkpoints", "sections_seconds"),
    list: ("J", "momentum_pN_us_per_um", "momentum_pN_us"),
    (int, float): ("exit_status", "time_us", "end_us", "steps", "ranks", "wall_seconds", "particles",
                   "ns_per_particle_step"),
    str: ("case_file", "cause", "cellmig", "commit", "tree", "dt_set_by")}


def write_manifest(directory: Path, manifest: Mapping[str, Any]) -> None:
    """Replace the manifest of a run; call it on rank 0.  Numbers that are not finite become null."""
    replace(Path(directory) / MANIFEST, json.dumps(plain(manifest), indent=2, ensure_ascii=False) + "\n")


def read_manifest(directory: Path) -> dict[str, Any]:
    """The manifest of a run, empty if the run was killed before it wrote one.  Raises OutputError if invalid."""
    path = Path(directory) / MANIFEST
    try:
        manifest = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    except (ValueError, RecursionError) as error:
        raise OutputError(f"'{path}' is not a manifest: {error}") from error
    if isinstance(manifest, dict) and "worst_closure" in manifest:  # of an older run
        manifest["worst_energy_error"] = manifest.pop("worst_closure")
    if not isinstance(manifest, dict):
        raise OutputError(f"'{path}' is not a manifest")
    for kind, name in ((kind, name) for kind, names in _KINDS.items() for name in names if name in manifest):
        if manifest[name] is None:
            del manifest[name]
        elif not isinstance(manifest[name], kind):
            raise OutputError(f"'{path}' is not a manifest: '{name}' is {json.dumps(manifest[name])[:40]}")
    return manifest


def read_case(directory: Path) -> Case:
    """The case of a run, with all changes and defaults.  Raises OutputError where the run told none."""
    manifest = read_manifest(directory)
    if "case" not in manifest:
        raise OutputError(f"'{directory}' does not tell its case: the run was stopped before it wrote it")
    register()
    include_all(manifest.get("laws", ()))
    return from_dict(manifest["case"], manifest.get("case_file", ""), older=True)


def time_unit(manifest: Mapping[str, Any]) -> TimeUnit:
    """Unit of times of a run, in which its case has time.end; µs while the manifest has no case yet."""
    time = (manifest.get("case") or {}).get("time")
    symbol = str(time.get("end") if isinstance(time, dict) else "").rpartition(" ")[2]
    return TimeUnit(symbol) if symbol in SIZES else MICROSECOND


def plain(value: Any) -> Any:
    """`value` in the types of JSON: numbers that are not finite are None."""
    if hasattr(value, "tolist"):  # numpy's scalars and arrays
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, (bool, int, str)) else str(value)


def environment(comm: MPI.Intracomm) -> dict[str, Any]:
    """Versions of loaded libraries, commit, processor, hosts and ranks; the same on all ranks; collective."""
    loaded = {name: sys.modules[name] for name in ("cellmig", *_LIBRARIES) if name in sys.modules}
    found: dict[str, Any] = {name: str(getattr(module, "__version__", "unknown")) for name, module in loaded.items()}
    found["python"] = platform.python_version()
    if mpi := sys.modules.get("mpi4py.MPI"):
        found["mpi"] = mpi.Get_library_version().split("\n")[0].split(",")[0].strip("\0 ")
    found["processor"] = comm.bcast(processor())
    found["hosts"] = len(set(comm.allgather(platform.node())))
    found["ranks"] = comm.size
    return found | comm.bcast(_commit() if comm.rank == 0 else None)


def page(title: str, command: str, made_with: Mapping[str, Any], lines: Sequence[str]) -> str:
    """A page of tables for docs/data: title, command, commit, date, lines."""
    commit = f", commit {made_with['commit']} ({made_with['tree']})" if "commit" in made_with else ""
    made = f"Made by `{command}` of version {made_with['cellmig']}{commit} on {date.today().isoformat()}."
    return "\n".join([f"# {title}", "", made, "", *lines]) + "\n"


def _commit() -> dict[str, str]:
    """Commit of the source and state of its tree; empty if the package is not in a checkout of its own."""

    def git(*words: str) -> str:
        command = ["git", "-C", str(Path(__file__).parent), *words]
        return subprocess.run(command, capture_output=True, encoding="utf-8", errors="replace", timeout=10,
                              check=True).stdout.strip()

    try:
        git("ls-files", "--error-unmatch", Path(__file__).name)
        changes = git("status", "--porcelain", "--untracked-files=no")
        return {"commit": git("rev-parse", "--short", "HEAD"), "tree": "local changes" if changes else "clean"}
    except (OSError, subprocess.SubprocessError):
        return {}


def processor() -> str:
    """Name of the processor, if the system reports it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        return next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def memory_sizes(path: str = "/proc/meminfo") -> dict[str, float]:
    """Sizes of memory by name [B], from the system, or from "/proc/self/status" for this process."""
    sizes = dict(line.split(":", 1) for line in Path(path).read_text(encoding="utf-8").splitlines())
    return {name: 1024.0 * float(size.split()[0]) for name, size in sizes.items() if size.endswith(" kB")}
