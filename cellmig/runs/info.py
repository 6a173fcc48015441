"""Summary of a run on one screen, from its manifest and tables; the run may be incomplete."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from cellmig.case.time_unit import TimeUnit
from cellmig.output.directory import existing_run
from cellmig.output.log import clock, simulated, two_columns
from cellmig.output.manifest import read_manifest, time_unit
from cellmig.output.tables import IMPULSE, MEASURES, names_of, read_table, time_column, unit_of
from cellmig.output.xdmf import frames

from .summary import describe_dissipation, describe_skipped, describe_volumes

Rows = Iterator[tuple[str, Any]]
_ENDED = {0: "done", 4: "the simulation failed", 5: "input or output failed", 75: "stopped on request"}
_LIBRARIES = ("numpy", "h5py", "mpi4py", "petsc4py", "python", "mpi")
# Keys that other rows already show, or that are for programs.
_NOT_LISTED = ("end_us", "steps_by_mechanism", "frames", "sections_seconds", "worst_energy_error", "hosts",
               "list_renewals", *(f"protrusion_impulse_{unit}" for unit in IMPULSE.values()), "version", "prune",
               "checkpoints")
_ROUNDING = 1e-9  # smaller lengths [µm] and momenta [pN µs/µm] count as zero


def info(directory: Path) -> str:
    """Text of the summary."""
    return two_columns(about(directory))


def about(directory: Path) -> list[tuple[str, Any]]:
    """Rows of key and value of the summary; an empty key continues the row above."""
    directory = existing_run(directory)
    manifest = read_manifest(directory)
    rows: list[tuple[str, Any]] = [("directory", directory)]
    unit = time_unit(manifest)
    if manifest:
        rows += [*_was(manifest, unit), *_numbers(manifest, unit)]
    else:
        rows.append(("manifest", "none yet: the run was stopped before it wrote one, or is at its start"))
    rows += [*_ledger_rows(directory / "ledger.csv"), *_history_rows(directory / "history.csv")]
    found = frames(directory)
    span = f" from {found[0].time:g} to {found[-1].time:g} {found[-1].unit.label}" if found else ""
    rows += [("frames", f"{len(found)}{span}"), *_made_with(manifest), *_rest(manifest, unit)]
    return rows


def _was(m: dict[str, Any], unit: TimeUnit) -> Rows:
    """Case and end of the run; removes its keys from the manifest."""
    case, file = m.pop("case", {}), m.pop("case_file", "")
    yield "case", " ".join(filter(None, [case.get("title", "untitled"), f"({file})" if file else ""]))
    status, cause = m.pop("exit_status", None), m.pop("cause", "")
    how = _ENDED.get(status, f"exit code {status}") if status is not None else "not yet: it runs, or was killed"
    text = cause if cause.startswith(how) else ": ".join(filter(None, [how, cause]))
    yield "ended", text + ("" if status in (None, 0) else f" (exit code {status})")
    if (time := m.pop("time_us", None)) is not None:
        yield "reached", (f"{simulated(time, unit)} of {simulated(m.get('end_us', time), unit)} in "
                          f"{m.pop('steps', 0)} steps")
    ranks, wall = m.pop("ranks", 1), m.pop("wall_seconds", None)
    yield "took", ("" if wall is None else f"{clock(wall)} ") + f"on {ranks} rank{'s' * (ranks > 1)}"
    for name in ("particles", "seed"):
        if name in m:
            yield name, m.pop(name)
    yield from describe_skipped(m.pop("skipped", None) or {})


def _numbers(m: dict[str, Any], unit: TimeUnit) -> Rows:
    """Steps, volumes, strains."""
    dt, by, redone = m.pop("dt_us", None) or {}, m.pop("dt_set_by", ""), m.pop("steps_redone", 0)
    if None not in (dt.get("least"), dt.get("most")):
        least, most = (unit.step(dt[which]) for which in ("least", "most"))
        yield "time step", (f"{least.split()[0]} to {most}" + (f", set by {by}" if by else "")
                            + (f"; {redone} steps were taken again, smaller" if redone else ""))
    if speed := m.pop("ns_per_particle_step", None):
        yield "speed", f"{speed:.1f} ns per particle and step"
    if J := m.pop("J", None):
        yield "volume ratio J", describe_volumes(J)
    for energy in ("pN", "pN_um"):
        if (loss := m.pop(f"scheme_loss_{energy}", None)) is not None:
            yield "scheme loss", f"{loss:.6g} {energy.replace('_um', ' µm')}"
    for dimension, impulse in IMPULSE.items():
        if momentum := m.pop(f"momentum_{impulse}", None):
            yield "momentum", ", ".join(map(_number, momentum)) + (" pN µs/µm" if dimension == 2 else " pN µs")
    if newton := m.pop("newton", None):  # of equilibria: time of each load step, and norms of the residual
        counts = [len(norms) - 1 for _, norms in newton]
        yield "newton steps", f"{sum(counts)} in {len(counts)} load steps, at most {max(counts)} in one"
    strain = m.pop("strain", None) or {}
    if largest := strain.get("largest"):
        crossed = strain.get("crossed_at_us")
        beyond = "" if crossed is None else f", beyond the limit of {strain['limit']:g} from {unit.text(crossed)} on"
        yield "fluid", f"stretched up to {largest:.3g}-fold{beyond}"


def _history_rows(path: Path) -> Rows:
    table = read_table(path) if path.exists() else {}
    if not table or not len(table["cell"]):
        return
    time, names = table[time_column(table)], names_of(table)
    last = time == time[-1]
    yield "last sample", f"{time[-1]:g} {unit_of(table).label}"
    for row in np.flatnonzero(last):
        cell = table["cell"][row]
        dimension = 3 if "z_um" in table else 2
        way = [table[f"u{axis}_um"][row] for axis in "xyz"[: dimension - 1]]  # along the substrate
        numbers = [f"moved {', '.join(map(_number, way))} µm"] * bool(np.isfinite(way).all())
        numbers += [f"{text} {_number(table[name][row])} {'µm²' if name.endswith('um2') else 'µm'}" for text, name in
                    zip(("on the substrate", "on cells"), MEASURES[dimension][:2], strict=True)
                    if np.isfinite(table[name][row]) and np.any(table[name] > 0.0)]
        yield names[int(cell)] if cell else "aggregate", "  ".join(numbers)


def _ledger_rows(path: Path) -> Rows:
    table = read_table(path) if path.exists() else {}
    if not table or not np.isfinite(table["energy_error"]).any():
        return
    worst = np.nanargmax(np.abs(table["energy_error"]))
    if dissipation := describe_dissipation({name: float(column[-1]) for name, column in table.items()}):
        yield "dissipation", dissipation
    yield "energy error", (f"at most {100 * abs(table['energy_error'][worst]):.2g} %, at "
                           f"{table[time_column(table)][worst]:g} {unit_of(table).label}")


def _made_with(m: dict[str, Any]) -> Rows:
    if version := m.pop("cellmig", None):
        commit = ", ".join(filter(None, [m.pop("commit", ""), m.pop("tree", "")]))
        libraries = [f"{name} {m.pop(name)}" for name in _LIBRARIES if name in m]
        petsc = [f"PETSc {m.pop('petsc')}"] if "petsc" in m else []
        yield "made with", ", ".join([f"cellmig {version}" + (f" ({commit})" if commit else ""), *petsc])
        yield "", ", ".join(libraries)
    if digest := m.pop("state_hash", None):
        yield "state hash", f"{digest}: runs with the same are the same"


def _rest(m: dict[str, Any], unit: TimeUnit) -> Rows:
    """The remaining keys."""
    for key, value in m.items():
        if key not in _NOT_LISTED and value not in (None, "", [], {}):
            yield key.replace("_", " "), _plain(value, unit)


def _number(value: float | None) -> str:
    return "unknown" if value is None else f"{value if abs(value) > _ROUNDING else 0.0:.4g}"


def _plain(value: Any, unit: TimeUnit) -> str:
    if isinstance(value, dict):
        return "; ".join(f"{unit.column(name)}: {_plain(unit.entry(name, item), unit)}" for name, item in value.items()
                         if item is not None)
    if isinstance(value, list):
        return ", ".join(_plain(item, unit) for item in value)
    return f"{value:.6g}" if isinstance(value, float) else str(value)
