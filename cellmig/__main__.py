"""The command line: `[mpiexec -n N] python -m cellmig CASE.toml [--option] [-petsc_option]`."""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import traceback
from pathlib import Path
from typing import Any

from .case.messages import CaseError, replace_unprintable
from .exits import DIFFERENT, DONE, ENVIRONMENT, FAILED, INPUT_OUTPUT, INTERRUPTED, INVALID_INPUT
from .laws import register
from .parallel.arguments import split_arguments, start_petsc
from .usage import COMMANDS, RANK, RANKS, UsageError, parse, what_first

# ---------------------------------------------------------------------------------------------------- commands


def run(options: argparse.Namespace, comm: Any) -> int:
    """Run a case on all ranks."""
    until = _time(options.until, "--until") if options.until else None
    case = load_together(options.case, options.sets, comm)
    from .output.directory import Claim
    from .runs.checkpointing import check_identity, is_done, read_run
    from .runs.ranks import check_ranks, size

    check_ranks(size(case), comm.size)

    directory, prune, state, claim = options.out or Path("output") / case.name, not options.no_prune, None, None
    end = case.time.end if until is None else until
    if options.resume:
        claim = Claim(directory, comm, make=True)
        manifest, state = read_run(claim, comm, options.quiet)
        if state:
            check_identity(state.about["run"], case, end, prune)
        elif is_done(manifest):
            check_identity(manifest, case, end, prune)
            return _done_already(directory, options)
    return _go(options, comm, case, directory, end, prune, state, claim, options.origin)


def resume(options: argparse.Namespace, comm: Any) -> int:
    """Resume the run in a directory on all ranks."""
    register()
    from .output.directory import Claim
    from .runs.checkpointing import is_done, new_end, origin, read_run

    until = _time(options.until, "--until") if options.until else None
    claim = Claim(options.directory, comm)
    manifest, state = read_run(claim, comm, options.quiet, done_too=until is not None)
    if is_done(manifest) and until in (None, manifest.get("end_us")):
        return _done_already(options.directory, options)
    case, end, prune = origin(options.directory, manifest, state)
    end = end if until is None else new_end(until, state, manifest, options.directory)
    return _go(options, comm, case, options.directory, end, prune, state, claim)


def _done_already(directory: Path, options: argparse.Namespace) -> int:
    if RANK == 0 and not options.quiet:
        print(f"'{directory}' is done already")
    return DONE


def _go(options: argparse.Namespace, comm: Any, case: Any, directory: Path, end: float, prune: bool,
        state: Any, claim: Any, origin: Path | None = None) -> int:
    from .runs.checkpointing import Intervals
    from .runs.run import Run, stop_requests

    wall = {name: _time(text, option) / 1e6 if text else None for name, option, text in (
        ("wall", "--checkpoint-wall", options.checkpoint_wall), ("limit", "--wall-time", options.wall_time))}
    simulated = _time(options.checkpoint_time, "--checkpoint-time") if options.checkpoint_time else None
    with stop_requests() as stop_signals:
        return Run(case, directory, comm, until=end, prune=prune, quiet=options.quiet, state=state,
                   intervals=Intervals(**wall, simulated=simulated), claim=claim, origin=origin).go(stop_signals)


def validate(options: argparse.Namespace) -> int:
    """Check cases and estimate their cost."""
    wrong, end = [], _time(options.until, "--until") if options.until else None
    for path in options.cases:
        try:
            case = _load(path, options.sets)
        except CaseError as error:
            wrong.append(error)
            continue
        from .case.times import until
        from .runs.preflight import report

        print(report(until(case, end)), end="\n\n", flush=True)
    for error in wrong:
        print(f"cellmig: {error}", file=sys.stderr)
    return INVALID_INPUT if wrong else DONE


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
                 _time(options.until, "--until") if options.until else None)
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
        raise UsageError(f"--only: no reference or group '{error.args[0]}'; 'verify --list' lists them") from error


def bench(options: argparse.Namespace) -> int:
    """Measure the cost of steps, or run time against error."""
    if options.problem and not options.error:
        raise UsageError("--problem belongs to --error")
    if options.modulus:
        if options.out:
            raise UsageError("--modulus writes nothing and knows no --out")
        from .bench import modulus

        print("\n".join(modulus.report(modulus.continuation(options.quick))))
        return DONE
    out = options.out or Path("output") / ("bench-quick" if options.quick else "bench")
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

        return bench_scaling(out)
    from .bench.speed import bench_speed

    return bench_speed(out, options.quick)


def show(options: argparse.Namespace) -> int:
    """Commands that show runs, the schema or the state of this machine."""
    if options.command == "doctor":
        from .doctor import examine

        healthy, text = examine()
        print(text)
        return DONE if healthy else ENVIRONMENT
    if options.command == "schema":
        register()
        from .case.handbook import handbook
        from .case.json_schema import json_schema
        from .output.fields import handbook_of_fields

        unicode = "utf" in (sys.stdout.encoding or "").lower()  # else JSON escapes other characters
        page = (handbook() + handbook_of_fields() if options.markdown else
                json.dumps(json_schema(), indent=2, ensure_ascii=not unicode) + "\n")
        print(page, end="")
        return DONE
    if options.command == "plot":
        given = [_time(t, "--times") for t in options.times.split(",")] if options.times else None
        from .output.manifest import read_manifest, time_unit
        from .plot.plot import plot
        from .plot.style import FORMATS

        formats = [kind.strip().lower() for kind in options.format.split(",")]
        if unknown := [kind for kind in formats if kind not in FORMATS]:
            raise UsageError(f"--format: no format '{unknown[0]}'; there are {', '.join(FORMATS)}")
        unit = time_unit(read_manifest(options.directory))
        times = None if given is None else [unit.number(time) for time in given]
        pictures = plot(options.directory, times, options.field, options.out, formats, options.film,
                        options.background)
        print("\n".join(map(str, pictures)))
        return DONE
    if options.command == "tracks":
        from .runs.tracks import as_json, measure, report

        interval = _time(options.interval, "--interval") if options.interval else None
        found = measure(options.directories, interval, "xy".index(options.axis),
                        options.cells.split(",") if options.cells else ())
        print(as_json(found) if options.json else report(found))
        return DONE
    if options.command == "info":
        from .runs.info import info

        print(info(options.directory))
        return DONE
    from .runs.diff import diff

    same, lines = diff(*options.directories, options.tolerance)
    print("\n".join(lines))
    return DONE if same else DIFFERENT


def _time(text: str, option: str) -> float:
    from .case.units import UnitError, number

    try:
        value = number(text, "us")
    except UnitError as error:
        raise UsageError(f"{option}: {error}") from error
    if value < 0 or (value == 0 and option != "--times"):
        raise UsageError(f"{option}: '{text}' is not after the start")
    return value


def _include(files: list[Path]) -> None:
    """Register the user's own laws on every rank."""
    if files:
        from .case.own_laws import include

        register()
        for file in files:
            include(file)


def _load(path: Path, sets: list[str]) -> Any:
    register()
    from .case.load import load

    return load(path, sets)


def load_together(path: Path, sets: list[str], comm: Any) -> Any:
    """The case, read by rank 0 for all.  Raises CaseError on all ranks."""
    case = None
    register()
    if comm.rank == 0:
        try:
            case = _load(path, sets)
        except CaseError as error:
            case = error
    case = comm.bcast(case)
    if isinstance(case, CaseError):
        raise case
    return case


# ---------------------------------------------------------------------------------------------------- top level


def main() -> None:
    """Entry point: rank 0 prints, all ranks end with one of the documented exit codes."""
    words, comm = sys.argv[1:], None
    replace_unprintable()
    try:
        ours, petsc_options = split_arguments(words)
        ours = what_first(ours)
        serial = bool(ours) and ours[0] in COMMANDS and ours[0] not in ("run", "resume")
        if "-n" in petsc_options or "-np" in petsc_options:
            raise UsageError("-n is an option of './run' and of mpiexec: mpiexec -n 2 cellmig …")
        options = parse(what_first(words) if serial else ours)
        if not serial:
            from .runs.ranks import start_again

            start_again(options, words, lambda: _load(options.case, options.sets))
        if not serial or options.command in ("validate", "sweep", "paper", "guidance", "verify", "bench") or RANKS > 1:
            comm = start_petsc([] if serial else petsc_options)
        _include(getattr(options, "laws", ()))
        if not serial:
            code = (run if options.command == "run" else resume)(options, comm)
        else:  # other ranks have nothing to do
            command = {"validate": validate, "sweep": sweep, "paper": paper, "guidance": guidance, "verify": verify,
                       "bench": bench}
            code = command.get(options.command, show)(options) if RANK == 0 else DONE
        sys.stdout.flush()
    except BrokenPipeError:  # the reader, such as `head`, closed the pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = DONE
    except KeyboardInterrupt:
        code = INTERRUPTED
    except Exception as error:
        code = failure(error, comm)
    sys.exit(code)


def failure(error: Exception, comm: Any) -> int:
    """Print an error once and return its exit code; unexpected errors of one rank abort all ranks."""
    codes = {**dict.fromkeys(("CaseError", "UsageError", "OptionError", "LawError", "LawFileError"), INVALID_INPUT),
             **dict.fromkeys(("CompilerError", "InsufficientResources", "LaunchError"), ENVIRONMENT),
             "OutputError": INPUT_OUTPUT, "NumericsError": FAILED}
    code, message = codes.get(type(error).__name__), str(error)
    if isinstance(error, ImportError) and not (error.name or "").startswith("cellmig"):
        code, message = ENVIRONMENT, f"{error}; './run' installs what is needed, 'cellmig doctor' tells what is missing"
    elif code is None and isinstance(error, OSError) and RANKS == 1:
        code, message = INPUT_OUTPUT, f"{error.filename}: {error.strerror}" if error.filename else message
    if code is not None:
        if RANK == 0:
            print(f"cellmig: {message}", file=sys.stderr, flush=True)
        return code
    if isinstance(error, MemoryError):
        code, message = ENVIRONMENT, f"rank {RANK} has no memory left: take fewer particles, or more memory"
    else:
        traceback.print_exception(error)
        code, message = 1, "this is a mistake of the program; please report it"
    print(f"cellmig: {message}", file=sys.stderr, flush=True)
    if comm is not None and comm.size > 1:
        comm.Abort(code)
    return code


if __name__ == "__main__":
    main()
