"""The command line: `[mpiexec -n N] python -m cellmig CASE.toml [--option …] [-petsc_option …]`."""

from __future__ import annotations

import argparse
import difflib
import json
import os
import sys
import traceback
from pathlib import Path
from typing import Any

from . import __version__
from .case.messages import CaseError

DONE, WRONG, ENVIRONMENT, BROKEN, INPUT_OUTPUT = 0, 2, 3, 4, 5


class UsageError(Exception):
    """The call is wrong; the message is for the user."""


class Parser(argparse.ArgumentParser):
    """Reports a wrong call as an exception, so that one rank speaks and all ranks end."""

    def error(self, message: str) -> None:
        raise UsageError(f"{message}\n{self.format_usage().strip()}")


def parser() -> Parser:
    """All commands with their options."""
    top = Parser(prog="cellmig", description="Collective cell migration by a meshfree particle method.",
                 epilog="A case alone is run.  Options with one dash are PETSc's: -ts_type, -ts_dt, -log_view …")
    top.add_argument("--version", action="version", version=f"cellmig {__version__}")
    commands = top.add_subparsers(dest="command", required=True, parser_class=Parser, metavar="COMMAND")

    run = commands.add_parser("run", help="run a case")
    run.add_argument("case", type=Path)
    run.add_argument("--out", type=Path, help="directory of the run (default: output/<case name>)")
    run.add_argument("--until", metavar='"40 us"', help="end earlier or later than the case says")
    run.add_argument("--no-prune", action="store_true", help="compute also what the scene does not need")
    run.add_argument("--quiet", action="store_true", help="nothing on the screen")
    _sets(run)

    validate = commands.add_parser("validate", help="check cases and say what a run will cost")
    validate.add_argument("cases", type=Path, nargs="+", metavar="case")
    _sets(validate)

    info = commands.add_parser("info", help="what a run was and did")
    info.add_argument("directory", type=Path)
    diff = commands.add_parser("diff", help="whether two runs are the same, and where they part")
    diff.add_argument("directories", type=Path, nargs=2, metavar="directory")
    diff.add_argument("--tolerance", type=float, default=0.0, help="relative; 0 asks for the same bits")
    plot = commands.add_parser("plot", help="pictures of a run")
    plot.add_argument("directory", type=Path)
    plot.add_argument("--times", metavar='"20 us,204 us"', help="times of the snapshots")
    plot.add_argument("--field", default="effective_stress", help="what fills the shapes")
    plot.add_argument("--out", type=Path, help="directory of the pictures (default: that of the run)")
    commands.add_parser("schema", help="JSON schema of a case file, for editors")
    return top


def _sets(command: argparse.ArgumentParser) -> None:
    command.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="sets",
                         help="change a value of the case: particles.per_cell=500")


COMMANDS = ("run", "validate", "info", "diff", "plot", "schema")


def parse(words: list[str]) -> argparse.Namespace:
    """Our part of the command line; a case file as first word stands for `run`."""
    if words and words[0] not in COMMANDS and not words[0].startswith("-"):
        if words[0].endswith(".toml") or os.path.exists(words[0]):
            words = ["run", *words]
        else:
            near = difflib.get_close_matches(words[0], COMMANDS, 1)
            meant = f"; did you mean '{near[0]}'?" if near else f"; there are {', '.join(COMMANDS)}"
            raise UsageError(f"'{words[0]}' is neither a case file nor a command{meant}")
    return parser().parse_args(words)


# ---------------------------------------------------------------------------------------------------- commands


def run(options: argparse.Namespace, comm: Any) -> int:
    """Run a case on all ranks."""
    case = load_together(options.case, options.sets, comm)
    until = _time(options.until, "--until") if options.until else None
    from .study.run import Run

    directory = options.out or Path("output") / case.name
    return Run(case, directory, comm, until=until, prune=not options.no_prune, quiet=options.quiet).go()


def validate(options: argparse.Namespace) -> int:
    """Check cases; report what each will cost."""
    from .study.preflight import report

    wrong = []
    for path in options.cases:
        try:
            print(report(_load(path, options.sets)), end="\n\n", flush=True)
        except CaseError as error:
            wrong.append(error)
    for error in wrong:
        print(error, file=sys.stderr)
    return WRONG if wrong else DONE


def show(options: argparse.Namespace) -> int:
    """The commands that look at runs."""
    if options.command == "schema":
        _discover()
        from .case.json_schema import json_schema

        print(json.dumps(json_schema(), indent=2, ensure_ascii=False))
        return DONE
    if options.command == "plot":
        from .study.plot import plot

        times = [_time(t, "--times") for t in options.times.split(",")] if options.times else None
        for path in plot(options.directory, times, options.field, options.out):
            print(path)
        return DONE
    from .study.compare import diff, info

    if options.command == "info":
        print(info(options.directory))
        return DONE
    same, lines = diff(*options.directories, options.tolerance)
    print("\n".join(lines))
    return DONE if same else 1


def _time(text: str, option: str) -> float:
    from .case.units import UnitError, number

    try:
        value = number(text, "us")
    except UnitError as error:
        raise UsageError(f"{option}: {error}") from error
    if value <= 0:
        raise UsageError(f"{option}: '{text}' is not after the start")
    return value


def _discover() -> None:
    from . import meshfree, model
    from .case.registry import discover

    discover(model)
    discover(meshfree)


def _load(path: Path, sets: list[str]) -> Any:
    _discover()
    from .case.load import load

    return load(path, sets)


def load_together(path: Path, sets: list[str], comm: Any) -> Any:
    """The case, read by rank 0 for all; its mistakes are raised on all ranks."""
    case = None
    _discover()
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
    """Entry point: one rank speaks, all ranks end, with the exit code of the contract."""
    words = sys.argv[1:]
    serial = bool(words) and words[0] in COMMANDS and words[0] != "run"
    comm = None
    try:
        if serial:
            options = parse(words)
            code = validate(options) if options.command == "validate" else show(options)
        else:
            comm, words = start_petsc(words)
            code = run(parse(words), comm)
    except Exception as error:
        code = failure(error, comm)
    sys.exit(code)


def start_petsc(words: list[str]) -> tuple[Any, list[str]]:
    """Start MPI and PETSc; the communicator, and what of the command line is ours."""
    try:
        import petsc4py
        from mpi4py import MPI
    except ImportError as error:
        raise EnvironmentProblem(f"{error.name} is missing: ./run installs what is needed") from error
    from .parallel.arguments import split_arguments

    ours, theirs = split_arguments(words)
    petsc4py.init([sys.argv[0], *theirs])
    return MPI.COMM_WORLD, ours


class EnvironmentProblem(Exception):
    """Something that the program needs is not there; the message is for the user."""


def failure(error: Exception, comm: Any) -> int:
    """Say what went wrong, once; errors of the user's are known to all ranks, others end all ranks here."""
    codes = {"CaseError": WRONG, "UsageError": WRONG, "EnvironmentProblem": ENVIRONMENT, "CompilerError": ENVIRONMENT,
             "OutputError": INPUT_OUTPUT, "NumericsError": BROKEN}
    code = codes.get(type(error).__name__)
    if code is not None:
        if comm is None or comm.rank == 0:
            print(f"cellmig: {error}", file=sys.stderr, flush=True)
        return code
    traceback.print_exception(error)
    print("cellmig: this is a mistake of the program; please report it", file=sys.stderr, flush=True)
    if comm is not None and comm.size > 1:
        comm.Abort(1)
    return 1


if __name__ == "__main__":
    main()
