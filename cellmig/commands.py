"""The commands that one process carries out, with their imports at the last moment: start is quick."""

from __future__ import annotations

import argparse
import json
import re
import sys
from pathlib import Path
from typing import Any

from .case.messages import CaseError
from .exits import DIFFERENT, DONE, ENVIRONMENT, FAILED, INVALID_INPUT
from .laws import register
from .usage import UsageError


def validate(options: argparse.Namespace) -> int:
    """Check cases and estimate their cost."""
    wrong, broken, end = [], False, to_time(options.until, "--until") if options.until else None
    for path in options.cases:
        try:
            case = load_case(path, options.sets)
        except CaseError as error:
            wrong.append(error)
            continue
        from .case.times import until
        from .runs.preflight import examine

        went_on, text = examine(until(case, end), options.ranks, _to_stderr)
        print(text, end="\n\n", flush=True)
        broken = broken or not went_on
    for error in wrong:
        print(f"cellmig: {error}", file=sys.stderr)
    return INVALID_INPUT if wrong else FAILED if broken else DONE


def _to_stderr(text: str) -> None:
    """Tell what goes on."""
    print(f"cellmig: {text} …", file=sys.stderr, flush=True)


def sweep(options: argparse.Namespace) -> int:
    """Run a case with varied values."""
    from .runs.sweep import Sweep, array_script, sweep, variation

    try:
        varied = [variation(text) for text in options.vary]
    except ValueError as error:
        raise UsageError(f"--vary: {error}") from error
    if twice := [key for n, (key, _) in enumerate(varied) if key in dict(varied[:n])]:
        raise UsageError(f"--vary: '{twice[0]}' is given twice")
    out = options.out or Path("output") / f"sweep-{options.case.stem}"
    plan = Sweep(options.case, dict(varied), out, tuple(options.sets), options.ranks,
                 to_time(options.until, "--until") if options.until else None)
    if options.slurm:
        print(f"wrote {array_script(plan)}; it tells what to do with it")
        return DONE
    return sweep(plan, options.jobs, options.show.split(",") if options.show else ())


def paper(options: argparse.Namespace) -> int:
    """Judge the paper's claims by runs."""
    from .case.units import UnitError, number
    from .paper.claims import CLAIMS, IN_SPACE
    from .paper.paper import paper

    only = [key.strip().upper() for key in options.only.split(",")] if options.only else []
    if unknown := [key for key in only if key not in CLAIMS]:
        raise UsageError(f"--only: no claim '{unknown[0]}'; there are {', '.join(CLAIMS)}")
    if options.dimension == 3 and (flat := [key for key in only if key not in IN_SPACE]):
        raise UsageError(f"--only: '{flat[0]}' is judged in two dimensions; in three there are {', '.join(IN_SPACE)}")
    if any(text.split("=")[0].strip() == "time.end" for text in options.sets):
        raise UsageError("--set time.end: the claims are of 400 us")
    try:
        tension = None if options.tension is None else number(options.tension, "pN/um")
    except UnitError as error:
        raise UsageError(f"--tension: {error}") from error
    if tension is not None and not tension > 0.0:
        raise UsageError(f"--tension: '{options.tension}' is no tension")
    kind = ["3d"] * (options.dimension == 3) + ["quick"] * options.quick
    name = "-".join(["paper", *kind, *map(_in_a_name, options.sets)])
    return paper(options.out or Path("output") / name, options.seeds or (3 if options.quick else 8), options.jobs,
                 options.quick, only, options.sets, tension, options.dimension)


def guidance(options: argparse.Namespace) -> int:
    """Judge published facts on guidance by runs."""
    from .guidance.claims import CLAIMS
    from .guidance.guidance import guidance

    only = [key.strip().upper() for key in options.only.split(",")] if options.only else []
    if unknown := [key for key in only if key not in CLAIMS]:
        raise UsageError(f"--only: no claim '{unknown[0]}'; there are {', '.join(CLAIMS)}")
    name = "-".join(["guidance", *["quick"] * options.quick, *map(_in_a_name, options.sets)])
    return guidance(options.out or Path("output") / name, options.seeds or (3 if options.quick else 8), options.jobs,
                    options.quick, only, options.sets)


def _in_a_name(text: str) -> str:
    """A change KEY=VALUE as part of the name of a directory."""
    return re.sub(r"[^\w.=-]+", "_", text.replace('"', "")).strip("_")


def verify(options: argparse.Namespace) -> int:
    """Compare with references, run random scenes, or measure sensitivity to numerical choices."""
    if options.sets and not options.stress:
        raise UsageError("--set is for --stress")
    if options.dimension == 3 and not options.stress:
        raise UsageError("--dimension is for --stress")
    if options.integrator != "leapfrog" and not options.stress:
        raise UsageError("--integrator is for --stress")
    if not (options.stress or options.sensitivity):
        return _references(options)
    if options.only:
        raise UsageError("--only is for references")
    if options.sensitivity:
        if options.seed is not None:
            raise UsageError("--seed is for --stress; --sensitivity varies the seed of the case")
        from .verify.sensitivity import sensitivity

        out = options.out or Path("output") / ("sensitivity-quick" if options.quick else "sensitivity")
        return sensitivity(out, options.jobs, options.quick)
    if options.quick:
        raise UsageError("--quick is for --sensitivity; --stress takes fewer scenes")
    from .verify.random_scenes import stress

    return stress(options.out or Path("output/stress"), options.stress, options.seed or 0, options.jobs,
                  options.sets, options.dimension, options.integrator == "overdamped")


def _references(options: argparse.Namespace) -> int:
    if options.seed is not None:
        raise UsageError("--seed is for --stress; references have no chance in them")
    from .verify.verify import listing, verify

    only = [name.strip() for name in options.only.split(",")] if options.only else []
    try:
        if options.list:
            print("\n".join(listing(only)))
            return DONE
        out = options.out or Path("output") / ("verify-quick" if options.quick else "verify")
        return verify(out, only, options.quick, options.jobs)
    except KeyError as error:
        name, near = error.args
        meant = f"; did you mean '{near}'?" if near else "; 'verify --list' lists them"
        raise UsageError(f"--only: no reference or group '{name}'{meant}") from error


def bench(options: argparse.Namespace) -> int:
    """Measure the cost of steps, or run time against error."""
    if options.problem and not options.error:
        raise UsageError("--problem belongs to --error")
    if options.dimension == 3 and (options.error or options.modulus or options.cues):
        raise UsageError("--dimension is for the cost of a step, also with --scaling; of --error, the problems twist, "
                         "turn and ball are in space")
    if options.modulus:
        if options.out:
            raise UsageError("--modulus writes nothing and knows no --out")
        from .bench import modulus

        print("\n".join(modulus.report(modulus.continuation(options.quick))))
        return DONE
    name = "-".join(["bench", *["3d"] * (options.dimension == 3), *["quick"] * options.quick])
    out = options.out or Path("output") / name
    if options.error:
        from .bench.accuracy import bench_error
        from .bench.problems import PROBLEMS

        if unknown := [name for name in options.problem if name not in PROBLEMS]:
            raise UsageError(f"--problem: no problem '{unknown[0]}'; there are {', '.join(PROBLEMS)}")
        return bench_error(out, options.quick, options.problem)
    if options.cues:
        from .bench.cues import bench_cues

        return bench_cues(options.quick)
    if options.scaling:
        from .bench.scaling import bench_scaling

        return bench_scaling(out, options.dimension)
    from .bench.speed import bench_speed

    return bench_speed(out, options.quick, options.dimension)


def cases(options: argparse.Namespace) -> int:
    """List or copy the cases and examples that come with cellmig."""
    from .case.shipped import Different, NotShipped, copy, listing, names

    if not options.names and not options.all:
        print(listing())
        return DONE
    try:
        copies = copy(names() if options.all else options.names, options.to)
    except (NotShipped, Different) as error:
        raise UsageError(str(error)) from error
    print("\n".join(map(str, copies)))
    return DONE


def doctor(options: argparse.Namespace) -> int:
    """Tell what this machine has and lacks."""
    from .doctor import examine

    healthy, text = examine()
    print(text)
    return DONE if healthy else ENVIRONMENT


def schema(options: argparse.Namespace) -> int:
    """Print the schema of a case, as JSON or as a page."""
    register()
    from .case.handbook import handbook
    from .case.json_schema import json_schema
    from .output.fields import handbook_of_fields

    unicode = "utf" in (sys.stdout.encoding or "").lower()  # else JSON escapes other characters
    page = (handbook() + handbook_of_fields() if options.markdown else
            json.dumps(json_schema(), indent=2, ensure_ascii=not unicode) + "\n")
    print(page, end="")
    return DONE


def plot(options: argparse.Namespace) -> int:
    """Draw a run."""
    given = [to_time(t, "--times") for t in options.times.split(",")] if options.times else None
    from .output.manifest import read_manifest, time_unit
    from .plot.plot import plot
    from .plot.style import FORMATS

    formats = [kind.strip().lower() for kind in options.format.split(",")]
    if unknown := [kind for kind in formats if kind not in FORMATS]:
        raise UsageError(f"--format: no format '{unknown[0]}'; there are {', '.join(FORMATS)}")
    unit = time_unit(read_manifest(options.directory))
    times = None if given is None else [unit.number(time) for time in given]
    pictures = plot(options.directory, times, options.field, options.out, formats, options.film, options.background)
    print("\n".join(map(str, pictures)))
    return DONE


def tracks(options: argparse.Namespace) -> int:
    """Tell how cells moved."""
    from .runs.tracks import as_json, measure, report

    interval = to_time(options.interval, "--interval") if options.interval else None
    found = measure(options.directories, interval, "xy".index(options.axis),
                    options.cells.split(",") if options.cells else ())
    print(as_json(found) if options.json else report(found))
    return DONE


def info(options: argparse.Namespace) -> int:
    """Tell what a run was and did."""
    from .runs.info import info

    print(info(options.directory))
    return DONE


def report(options: argparse.Namespace) -> int:
    """Write the page of a run."""
    from .runs.report import report

    print(report(options.directory, options.out))
    return DONE


def watch(options: argparse.Namespace) -> int:
    """Serve the page of a run that goes on."""
    from .runs.report import watch

    watch(options.directory, options.port)
    return DONE


def diff(options: argparse.Namespace) -> int:
    """Compare two runs."""
    from .runs.diff import diff

    same, lines = diff(*options.directories, options.tolerance)
    print("\n".join(lines))
    return DONE if same else DIFFERENT


def to_time(text: str, option: str) -> float:
    """A time in an option [µs].  Raises UsageError."""
    from .case.units import UnitError, number

    try:
        value = number(text, "us")
    except UnitError as error:
        raise UsageError(f"{option}: {error}") from error
    if value < 0 or (value == 0 and option != "--times"):
        raise UsageError(f"{option}: '{text}' is not after the start")
    return value


def load_case(path: Path, sets: list[str]) -> Any:
    """The case in a file, with changes.  Raises CaseError."""
    register()
    from .case.load import load

    return load(path, sets)

COMMANDS = {command.__name__: command for command in (
    validate, sweep, paper, guidance, verify, bench, cases, doctor, schema, plot, report, watch, tracks, info, diff)}
PARALLEL = ("validate", "sweep", "paper", "guidance", "verify", "bench")  # those that build a scene, and need PETSc
