"""`cellmig verify --sensitivity`: dependence of results on numerical choices, which are no part of the model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mpi4py import MPI

from cellmig.case.schema import Case
from cellmig.case.shipped import FOLDER
from cellmig.exits import DIFFERENT, DONE, STOPPED
from cellmig.output.directory import replace
from cellmig.output.log import table
from cellmig.output.manifest import environment, page
from cellmig.output.sample import TOUCHING
from cellmig.runs.batch import Job, run_missing, sound_and_unsound, write_rows
from cellmig.runs.collect import collect
from cellmig.runs.outcome import Outcome

LATE, PERCENTILE = 0.25, 99  # the peak stress is the 99th percentile in the last quarter of a run
START, STEP = 20.0, 0.05  # plateaus: earliest begin [us], growth that ends them [um]
_SPACINGS, _QUICK_SPACINGS = (331, 631, 1485), (150, 331, 631)
_SETS, _QUICK = ("time.frames=40",), ("time.samples=100", "time.end=100 us")
MEASURED = {"displacement_um": "displacement [µm]", "substrate_contact_um": "on the substrate [µm]",
            "cell_contact_um": "between cells [µm]", "peak_stress_pa": "peak stress [Pa]"}


@dataclass(frozen=True)
class Choice:
    """A numerical choice that is varied.

    name : in directories and in the CSV;  what : in tables, with its unit;  values : which may include the default;
    default : value of a case;  sets : changes, as of `--set`, that give a case a value.
    """

    name: str
    what: str
    values: tuple[float, ...]
    default: Callable[[Case], float]
    sets: Callable[[Case, float], tuple[str, ...]]

    def others(self, case: Case) -> tuple[float, ...]:
        """The values but the default of a case."""
        return tuple(v for v in self.values if not np.isclose(v, self.default(case), rtol=1e-9))


def choices(quick: bool, seed: int) -> list[Choice]:
    """All choices; `seed` : the default one."""

    def key(text: str) -> Callable[[Case, float], tuple[str, ...]]:
        return lambda case, value: (text.format(value),)

    return [
        Choice("per_cell", "particles per cell", _QUICK_SPACINGS if quick else _SPACINGS,
               lambda case: case.particles.per_cell, key("particles.per_cell={:g}")),
        Choice("surface_refinement", "density along surfaces over that inside", (1, 2),
               lambda case: case.particles.surface_refinement, key("particles.surface_refinement={:g}")),
        Choice("reduced_bulk_modulus", "reduced bulk modulus [MPa]", (2, 5, 20),
               lambda case: 1e-6 * case.materials["cytoplasm"].reduced_bulk_modulus,
               key("materials.cytoplasm.reduced_bulk_modulus={:g} MPa")),
        Choice("step_factor", "time step over the stable one", (0.4, 0.8),
               lambda case: case.time.step_factor, key("time.step_factor={:g}")),
        Choice("equilibrium_distance", "equilibrium distance of both adhesions [nm]", (10, 20),
               lambda case: 1e3 * case.substrate.equilibrium_distance, _equilibrium_distances),
        Choice("stabilisation", "stabilisation of the cytoplasm", (0.5, 1),
               lambda case: case.materials["cytoplasm"].stabilisation, key("materials.cytoplasm.stabilisation={:g}")),
        Choice("hourglass_modulus", "hourglass modulus of the nucleus", (0.06, 0.16),
               lambda case: case.materials["nucleus"].hourglass_modulus,
               key("materials.nucleus.hourglass_modulus={:g}")),
        Choice("bulk_viscosity", "bulk viscosity", (0.05, 0.2),
               lambda case: case.numerics.bulk_viscosity, key("numerics.bulk_viscosity={:g}")),
        # The seed shows how much chance alone changes.
        Choice("seed", "seed of the random numbers", (seed, seed + 1, seed + 2), lambda case: case.seed,
               key("seed={:g}")),
        Choice("ranks", "ranks", (1, 2), lambda case: 1, lambda case, value: ()),
    ]


def _equilibrium_distances(case: Case, nanometres: float) -> tuple[str, ...]:
    """Changes of the equilibrium distance of both adhesions, at the same work; cells start in equilibrium."""
    wider = 1e-3 * nanometres - np.array([case.contact.equilibrium_distance, case.substrate.equilibrium_distance])
    (x, y), pitch = case.cells[0].centre + wider, case.cells[1].centre[0] - case.cells[0].centre[0] - wider[0]
    return (f"adhesion.substrate.equilibrium_distance={nanometres:g} nm",
            f"adhesion.cells.equilibrium_distance={nanometres:g} nm",
            f'cells.0.centre=["{x:.9g} um", "{y:.9g} um"]', f'cells.0.pitch=[["{pitch:.9g} um", "0 um"]]')


def sensitivity(out: Path, at_once: int | None = None, quick: bool = False) -> int:
    """Run what is missing, print how results depend on each choice, write them as CSV and Markdown.

    Parameters
    ----------
    out : Path -- directory of everything; the runs are in `runs/` of it.
    at_once : int -- runs at a time; by default one for each core.
    quick : bool -- coarse particles, to 100 us.

    Returns
    -------
    int -- exit code: 0, that of the first run that failed, 1 if ranks change the bits, or 75 after a signal to stop.
    """
    jobs = plan(out, quick)
    failed, stopped = run_missing(out, jobs.values(), at_once, longest_first=True)
    if stopped:
        print("stopped; the same command goes on from here")
        return STOPPED
    sound, bad = sound_and_unsound(jobs)
    results = collect(sound)
    case = jobs["default", ""].load()
    rows, curves = compare(results, choices(quick, case.seed), case), spreading(results)
    text = "\n".join(_report(rows, curves, case))
    print(f"\n{text}\n", flush=True)
    write_rows(out / "sensitivity.csv", [*rows, *curves])
    replace(out / "sensitivity.md", page("How the main scene depends on each choice", "cellmig verify --sensitivity"
                                         + " --quick" * quick, environment(MPI.COMM_SELF), [text]))
    print(out / "sensitivity.csv", out / "sensitivity.md", sep="\n")
    code = next((ended.code for ended in (failed | bad).values()), DONE)
    return code or (DIFFERENT if any(row["same_bits"] == "no" for row in rows) else DONE)


def plan(out: Path, quick: bool) -> dict[tuple[str, str], Job]:
    """All runs by choice and value: the default, one change each, and single cells that spread."""
    main, alone = FOLDER / "all_protrude.toml", FOLDER / "one_cell.toml"
    spacings, runs = _QUICK_SPACINGS if quick else _SPACINGS, out / "runs"
    sets = (*_SETS, *(_QUICK if quick else ()), f"particles.per_cell={spacings[-1]}")
    case = Job("", main, sets, out).load()
    jobs = {("default", ""): Job("default", main, sets, runs / "default")}
    for choice in choices(quick, case.seed):
        for value in choice.others(case):
            name = f"{choice.name}={value:g}"
            jobs[choice.name, f"{value:g}"] = Job(name, main, (*sets, *choice.sets(case, value)), runs / name,
                                                  ranks=int(value) if choice.name == "ranks" else 1)
    for n in spacings:
        for label, refinement in (("", ()), (" dense", ("particles.surface_refinement=2",))):
            name = f"spreading={n}{label.replace(' ', '-')}"
            jobs["spreading", f"{n}{label}"] = Job(name, alone, (*sets, f"particles.per_cell={n}", *refinement),
                                                  runs / name)
    return jobs


# ------------------------------------------------------------------------------------------------------ measurements


def measure(outcome: Outcome) -> dict[str, float]:
    """Results of a run of the main scene, by the names of MEASURED.

    Mean displacement along x and both lengths of contact of the aggregate are those at the end.  The peak stress is the
    99th percentile of the recovered effective stress in the cytoplasm, median over the frames of the last quarter: a
    single frame would depend on the peaks of less than a microsecond where a contact line advances.
    """
    end = outcome.series("ux_um")[0][-1]
    late = [frame.read() for frame in outcome.frames if frame.time >= (1.0 - LATE) * end]
    peaks = [np.percentile(f["effective_stress"][f["material"] != outcome.nucleus], PERCENTILE) for f in late]
    at_end = [outcome.at(column, end) for column in ("ux_um", "substrate_contact_um", "cell_contact_um")]
    return dict(zip(MEASURED, [*at_end, float(np.median(peaks))], strict=True))


class Plateau(NamedTuple):
    """start, length : [us];  ended : whether the contact grew on before the end of the curve."""

    start: float
    length: float
    ended: bool


def plateau(time: np.ndarray, contact: np.ndarray, start: float = START, step: float = STEP) -> Plateau:
    """The longest time [us] after `start` in which a length of contact [um] grows by less than `step`.

    It ends where the growth since its beginning, interpolated between samples, reaches `step`.
    """
    time, contact = time[time >= start], contact[time >= start]
    longest = Plateau(float(time[0]), 0.0, True)
    for i in range(len(time) - 1):
        beyond = np.flatnonzero(contact[i:] >= contact[i] + step)
        ended, end = len(beyond) > 0, time[-1]
        if ended:
            k = i + beyond[0]
            share = (contact[i] + step - contact[k - 1]) / (contact[k] - contact[k - 1])
            end = time[k - 1] + share * (time[k] - time[k - 1])
        if end - time[i] > longest.length:
            longest = Plateau(float(time[i]), float(end - time[i]), ended)
    return longest


def compare(results: Mapping[str, Mapping[str, Outcome]], listed: list[Choice], case: Case) -> list[dict[str, Any]]:
    """A row for each run of the main scene: choice, value, results, relative changes from the default."""
    default = results.get("default", {}).get("")
    first = measure(default) if default else {}
    rows = [_row("default", "", default, {})] if default else []
    for choice in listed:
        rows += [_row(choice.name, value, outcome, first) | {"default": choice.default(case)}
                 for value, outcome in results.get(choice.name, {}).items()]
    for row in rows:
        known = default and row["varied"] == "ranks"
        row["same_bits"] = ("yes" if row["state_hash"] == rows[0]["state_hash"] else "no") if known else ""
    return rows


def _row(name: str, value: str, outcome: Outcome, first: Mapping[str, float]) -> dict[str, Any]:
    found = measure(outcome)
    return {"varied": name, "value": value, "default": "", **found,
            **{f"{key}_change": found[key] / first[key] - 1.0 for key in first if first[key]},
            **{key: outcome.manifest[key] for key in ("steps", "worst_energy_error", "state_hash")}}


def spreading(results: Mapping[str, Mapping[str, Outcome]]) -> list[dict[str, Any]]:
    """A row for each spacing, also with a denser surface: plateau and largest step of a spreading cell."""
    rows = []
    for value, outcome in results.get("spreading", {}).items():
        time, contact = outcome.series("substrate_contact_um")
        found = plateau(time, contact)
        rows.append({"varied": "spreading", "value": value, "substrate_contact_um": float(contact[-1]),
                     "substrate_contact_um_at_start": float(np.interp(START, time, contact)),
                     "plateau_us": found.length, "plateau_start_us": found.start, "plateau_ended": found.ended,
                     "step_um": float(np.diff(contact[time >= START]).max())})
    return rows


# -------------------------------------------------------------------------------------------------------------- tables


def _report(rows: list[dict[str, Any]], curves: list[dict[str, Any]], case: Case) -> list[str]:
    """Both tables in aligned Markdown."""
    what = {choice.name: choice.what for choice in choices(False, case.seed)}
    lines = [[f"{what[row['varied']]} ({row['default']:g})" if row["default"] != "" else "default",
              row["value"] + {"yes": ", same bits", "no": ", OTHER BITS"}.get(row["same_bits"], ""),
              *(_changed(row, key) for key in MEASURED)] for row in rows]
    for line, above in reversed(list(zip(lines[1:], lines, strict=False))):
        line[0] = "" if line[0] == above[0] else line[0]
    return [*table(["varied (default)", "value", *MEASURED.values()], lines), "",
            f"Displacement and contacts (surfaces closer than {TOUCHING:g} ranges) at {case.time.end:g} µs.  Peak "
            f"stress: {PERCENTILE}th percentile of the",
            f"effective stress in the cytoplasm, median over the frames of the last {100 * LATE:g} % of the time.", "",
            *table(["one cell spreads: particles", f"contact at {START:g} µs [µm]", f"at {case.time.end:g} µs [µm]",
                     "largest plateau [µs]", "from [µs]", "largest step [µm]"],
                    [[row["value"], f"{row['substrate_contact_um_at_start']:.2f}", f"{row['substrate_contact_um']:.2f}",
                      f"{'' if row['plateau_ended'] else '> '}{row['plateau_us']:.1f}",
                      f"{row['plateau_start_us']:g}", f"{row['step_um']:.2f}"] for row in curves]), "",
            f"Plateau: longest time after {START:g} µs in which the contact grows by less than {STEP:g} µm; > if it "
            "lasts to the end.",
            "Step: largest growth from sample to sample.  A line that is pinned steps by segments; "
            "dense: twice as many particles along the surface."]


def _changed(row: Mapping[str, Any], key: str) -> str:
    change = row.get(f"{key}_change")
    return f"{row[key]:.4g}" + ("" if change is None else f" ({100 * change:+.1f} %)")
