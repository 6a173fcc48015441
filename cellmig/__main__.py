"""The command line: `[mpiexec -n N] python -m cellmig CASE.toml [--option] [-petsc_option]`."""

from __future__ import annotations

import argparse
import os
import sys
import traceback
from pathlib import Path
from typing import Any

from .case.messages import CaseError, replace_unprintable
from .commands import COMMANDS, PARALLEL, load_case, to_time
from .exits import DONE, ENVIRONMENT, FAILED, INPUT_OUTPUT, INTERRUPTED, INVALID_INPUT
from .laws import register
from .parallel.arguments import split_arguments, start_petsc
from .parallel.ending import all_here, world
from .usage import RANK, RANKS, UsageError, parse, what_first

# ------------------------------------------------------------------------------------------ commands on all ranks


def run(options: argparse.Namespace, comm: Any) -> int:
    """Run a case on all ranks."""
    until = to_time(options.until, "--until") if options.until else None
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

    until = to_time(options.until, "--until") if options.until else None
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
    from .runs.run import Run
    from .runs.stops import stop_requests

    wall = {name: to_time(text, option) / 1e6 if text else None for name, option, text in (
        ("wall", "--checkpoint-wall", options.checkpoint_wall), ("limit", "--wall-time", options.wall_time))}
    simulated = to_time(options.checkpoint_time, "--checkpoint-time") if options.checkpoint_time else None
    with stop_requests() as stop_signals:
        return Run(case, directory, comm, until=end, prune=prune, quiet=options.quiet, state=state,
                   intervals=Intervals(**wall, simulated=simulated), claim=claim, origin=origin).go(stop_signals)


def _include(files: list[Path]) -> None:
    """Register the user's own laws on every rank."""
    if files:
        from .case.own_laws import include

        register()
        for file in files:
            include(file)


def load_together(path: Path, sets: list[str], comm: Any) -> Any:
    """The case, read by rank 0 for all.  Raises CaseError on all ranks."""
    case = None
    register()
    if comm.rank == 0:
        try:
            case = load_case(path, sets)
        except CaseError as error:
            case = error
    case = comm.bcast(case)
    if isinstance(case, CaseError):
        raise case
    return case


# ---------------------------------------------------------------------------------------------------- top level


def main() -> None:
    """Entry point: rank 0 prints, all ranks end with one of the documented exit codes."""
    words, together = sys.argv[1:], False
    replace_unprintable()
    try:
        ours, petsc_options = split_arguments(words)
        ours = what_first(ours)
        serial = bool(ours) and ours[0] in COMMANDS
        if "-n" in petsc_options or "-np" in petsc_options:
            raise UsageError("-n is an option of './run' and of mpiexec: mpiexec -n 2 cellmig …")
        options = parse(what_first(words) if serial else ours)
        if not serial:
            from .runs.ranks import start_again

            start_again(options, words, lambda: load_case(options.case, options.sets))
        together = not serial
        if together or options.command in PARALLEL or RANKS > 1:
            comm = start_petsc([] if serial else petsc_options)
        _include(getattr(options, "laws", ()))
        if not serial:
            code = (run if options.command == "run" else resume)(options, comm)
        else:  # other ranks have nothing to do
            code = COMMANDS[options.command](options) if RANK == 0 else DONE
        sys.stdout.flush()
    except BrokenPipeError:  # the reader, such as `head`, closed the pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = DONE
    except KeyboardInterrupt:
        code = INTERRUPTED
    except Exception as error:
        code = failure(error, together)
    sys.exit(code)


def failure(error: Exception, together: bool) -> int:
    """Print an error once and return its exit code.

    Unexpected errors of one rank abort all ranks, and so do expected ones that not all ranks of a run meet, in which
    they work `together`: the others would wait for this one.
    """
    codes = {**dict.fromkeys(("CaseError", "UsageError", "OptionError", "LawError", "LawFileError"), INVALID_INPUT),
             **dict.fromkeys(("CompilerError", "InsufficientResources", "LaunchError"), ENVIRONMENT),
             "OutputError": INPUT_OUTPUT, "NumericsError": FAILED}
    code, message, comm = codes.get(type(error).__name__), str(error), world()
    foreign = isinstance(error, ImportError) and not (error.name or "").startswith("cellmig")
    if foreign or "binary incompatibility" in message:  # of NumPy and a module that was compiled for another one
        code, message = ENVIRONMENT, f"{error}; 'cellmig doctor' tells what is missing, and how to install it"
    elif code is None and isinstance(error, OSError) and RANKS == 1:
        code, message = INPUT_OUTPUT, f"{error.filename}: {error.strerror}" if error.filename else message
    if code is not None:
        alone = comm is not None and together and not all_here(comm)
        if RANK == 0 or alone:
            print(f"cellmig: {f'rank {RANK} alone: ' * alone}{message}", file=sys.stderr, flush=True)
        if alone:
            comm.Abort(code)
        return code
    if isinstance(error, MemoryError):
        code, message = ENVIRONMENT, f"rank {RANK} has no memory left: take fewer particles, or more memory"
    else:
        traceback.print_exception(error)
        code, message = 1, "this is a mistake of the program; please report it"
    print(f"cellmig: {message}", file=sys.stderr, flush=True)
    if comm is not None:
        comm.Abort(code)
    return code


if __name__ == "__main__":
    main()
