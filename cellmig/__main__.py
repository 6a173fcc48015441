"""The command line: `[mpiexec -n N] python -m cellmig CASE.toml [--option …] [-petsc_option …]`."""

from __future__ import annotations

import argparse
import difflib
import json
import os
import re
import sys
import traceback
from pathlib import Path
from typing import Any

from . import __version__
from .case.messages import CaseError
from .parallel.arguments import split_arguments

DONE, DIFFERENT, WRONG, ENVIRONMENT, BROKEN, INPUT_OUTPUT, INTERRUPTED = 0, 1, 2, 3, 4, 5, 130


def _told_by_mpiexec(what: str, alone: int) -> int:
    """RANK or SIZE as Open MPI or MPICH tell it: known before MPI has started, and where it cannot start."""
    told = os.environ.get(f"OMPI_COMM_WORLD_{what}") or os.environ.get(f"PMI_{what}")
    return int(told) if told else alone


RANK, RANKS = _told_by_mpiexec("RANK", 0), _told_by_mpiexec("SIZE", 1)


class UsageError(Exception):
    """The call is wrong; the message is for the user."""


class Parser(argparse.ArgumentParser):
    """One rank speaks and all ranks end: a wrong call is an exception, help comes once."""

    def error(self, message: str) -> None:
        """Refuse the call."""
        raise UsageError(f"{message}\n{self.format_usage().strip()}\n'{self.prog} --help' tells more")

    def _print_message(self, message: str, file: Any = None) -> None:
        if RANK == 0:
            super()._print_message(message, file)


_HELP = """\
A case alone is run: 'cellmig run --help' lists its options.  On several ranks: mpiexec -n 4 cellmig …
Options with one dash are PETSc's: -ts_type rk, -ts_dt 1e-3 (in µs), -ts_monitor, -log_view …

exit codes: 0 done, 1 two runs differ, 2 the case or the call is wrong, 3 the environment is, 4 the numbers broke,
            5 input or output, 75 stopped on request"""


def parser() -> Parser:
    """All commands with their options."""
    top = Parser(prog="cellmig", usage="cellmig CASE.toml [OPTION …]\n       cellmig COMMAND [ARGUMENT …]",
                 description="Collective cell migration by a meshfree particle method.", epilog=_HELP,
                 formatter_class=argparse.RawDescriptionHelpFormatter)
    top.add_argument("--version", action="version", version=f"cellmig {__version__}")
    commands = top.add_subparsers(dest="command", required=True, parser_class=Parser, metavar="COMMAND", prog="cellmig")

    run = commands.add_parser("run", help="run a case", epilog="Options with one dash are PETSc's: -ts_type rk …",
                              description="Run a case.  A run that is already in the directory is moved aside.  ^C, "
                                          "SIGTERM and SIGUSR1 end a run with all its files whole.")
    run.add_argument("case", type=Path, help="case file")
    run.add_argument("--out", type=Path, metavar="DIR", help="directory of the run (default: output/<case name>)")
    run.add_argument("--until", metavar='"40 us"', help="end earlier or later than the case says")
    run.add_argument("--no-prune", action="store_true", help="compute also what the scene does not need: same bits")
    run.add_argument("--quiet", action="store_true", help="nothing on the screen but errors")
    _accuracy(run)
    _sets(run)

    validate = commands.add_parser("validate", help="check cases and say what a run will cost")
    validate.add_argument("cases", type=Path, nargs="+", metavar="case", help="case file")
    _accuracy(validate)
    _sets(validate)
    _looks(commands)
    return top


def _looks(commands: Any) -> None:
    """The commands that look at runs and at this machine."""
    info = commands.add_parser("info", help="what a run was and did")
    info.add_argument("directory", type=Path, help="of a run")
    diff = commands.add_parser("diff", help="whether two runs are the same, and where they part")
    diff.add_argument("directories", type=Path, nargs=2, metavar="directory", help="of a run")
    diff.add_argument("--tolerance", type=float, default=0.0, help="relative; 0 (default) asks for the same bits")
    plot = commands.add_parser("plot", help="pictures of a run")
    plot.add_argument("directory", type=Path, help="of a run")
    plot.add_argument("--times", metavar='"20 us,204 us"', help="times of the snapshots")
    plot.add_argument("--field", default="effective_stress", help="what fills the shapes (default: effective_stress)")
    plot.add_argument("--out", type=Path, metavar="DIR", help="directory of the pictures (default: that of the run)")
    paper = commands.add_parser("paper", help="the paper's cases over many seeds: its claims, its figures")
    paper.add_argument("--out", type=Path, help="directory (default: output/paper, with --quick output/paper-quick, "
                       "followed by what is set)")
    paper.add_argument("--seeds", type=_count, help="random seeds of each case (default: 8, with --quick 3)")
    paper.add_argument("--jobs", type=_count, help="runs at a time (default: one for each core)")
    paper.add_argument("--quick", action="store_true", help="coarse: in minutes, to try it out")
    paper.add_argument("--only", metavar="R3,R4", help="these claims alone, and the runs that they need")
    _sets(paper)
    verify = commands.add_parser("verify", help="whether the program does what it should, and how far to trust it",
                                 description="References against exact and published solutions at three resolutions or "
                                             "more: error, order and verdict; exit code 1 if something does not hold. "
                                             "With --stress or --sensitivity, other checks.")
    verify.add_argument("--only", metavar="NAME,NAME", help="these references or groups of them alone")
    what = verify.add_mutually_exclusive_group()
    what.add_argument("--list", action="store_true", help="the references, their sources, and what theory expects")
    what.add_argument("--stress", type=_count, metavar="N", help="N random scenes: each ends stable, stops with a "
                      "message or is refused")
    what.add_argument("--sensitivity", action="store_true", help="how the main scene depends on spacing, time step and "
                      "other choices of the method")
    verify.add_argument("--seed", type=int, help="of the random scenes (default: 0)")
    verify.add_argument("--quick", action="store_true", help="coarse references or a coarse sensitivity: in minutes")
    verify.add_argument("--jobs", type=_count, help="processes at a time (default: one for each core)")
    verify.add_argument("--out", type=Path, metavar="DIR", help="directory (default: output/verify, output/stress, "
                        "output/sensitivity, with --quick output/verify-quick, output/sensitivity-quick)")
    _sets(verify)
    bench = commands.add_parser("bench", help="run time against error, and which settings are worth their time")
    what = bench.add_mutually_exclusive_group(required=True)
    what.add_argument("--error", action="store_true", help="over spacing, dilation, stabilisation, "
                      "integrator, step and modulus: the Pareto sets, and what the defaults should be")
    what.add_argument("--modulus", action="store_true", help="only what the reduced bulk modulus costs, half a minute")
    bench.add_argument("--quick", action="store_true", help="coarse, in two minutes, to try it out")
    bench.add_argument("--out", type=Path, metavar="DIR", help="directory (default: output/bench, with --quick "
                       "output/bench-quick)")
    commands.add_parser("schema", help="JSON schema of a case file, for editors")
    commands.add_parser("doctor", help="what this machine has and lacks")


def _accuracy(command: argparse.ArgumentParser) -> None:
    command.add_argument("--accuracy", metavar="5%", action="append", default=[], dest="sets",
                         type="numerics.accuracy={}".format,
                         help="as numerics.accuracy in a case: what it leaves open is the cheapest that was measured "
                         "below this error")


def _sets(command: argparse.ArgumentParser) -> None:
    command.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="sets",
                         help="change a value of the case: --set particles.per_cell=500 --set time.step='1 ns'")


COMMANDS = ("run", "validate", "info", "diff", "plot", "schema", "doctor", "paper", "verify", "bench")


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
    until = _time(options.until, "--until") if options.until else None
    case = load_together(options.case, options.sets, comm)
    from .study.run import Run, stop_requests

    directory = options.out or Path("output") / case.name
    with stop_requests() as asked:
        return Run(case, directory, comm, until=until, prune=not options.no_prune, quiet=options.quiet).go(asked)


def validate(options: argparse.Namespace) -> int:
    """Check cases; report what each will cost."""
    wrong = []
    for path in options.cases:
        try:
            case = _load(path, options.sets)
        except CaseError as error:
            wrong.append(error)
            continue
        from .study.preflight import report

        print(report(case), end="\n\n", flush=True)
    for error in wrong:
        print(f"cellmig: {error}", file=sys.stderr)
    return WRONG if wrong else DONE


def paper(options: argparse.Namespace) -> int:
    """The paper's claims against what is measured."""
    from .study.claims import CLAIMS
    from .study.paper import paper

    only = [key.strip().upper() for key in options.only.split(",")] if options.only else []
    if unknown := [key for key in only if key not in CLAIMS]:
        raise UsageError(f"--only: no claim '{unknown[0]}'; there are {', '.join(CLAIMS)}")
    if any(text.split("=")[0].strip() == "time.end" for text in options.sets):
        raise UsageError("--set time.end: the claims are of 400 us")
    name = "-".join(["paper-quick" if options.quick else "paper", *map(_in_a_name, options.sets)])
    return paper(options.out or Path("output") / name, options.seeds or (3 if options.quick else 8), options.jobs,
                 options.quick, only, options.sets)


def _in_a_name(text: str) -> str:
    """A change KEY=VALUE as part of the name of a directory."""
    return re.sub(r"[^\w.=-]+", "_", text.replace('"', "")).strip("_")


def verify(options: argparse.Namespace) -> int:
    """The references; or random scenes, or the sensitivity of the main one."""
    if options.sets and not options.stress:
        raise UsageError("--set is for --stress")
    if not (options.stress or options.sensitivity):
        return _references(options)
    if options.only:
        raise UsageError("--only is for references")
    if options.sensitivity:
        if options.seed is not None:
            raise UsageError("--seed is for --stress; --sensitivity varies the seed of the case")
        from .study.sensitivity import sensitivity

        out = options.out or Path("output") / ("sensitivity-quick" if options.quick else "sensitivity")
        return sensitivity(out, options.jobs, options.quick)
    if options.quick:
        raise UsageError("--quick is for --sensitivity; --stress takes fewer scenes")
    from .study.stress import stress

    return stress(options.out or Path("output/stress"), options.stress, options.seed or 0, options.jobs,
                  options.sets)


def _references(options: argparse.Namespace) -> int:
    if options.seed is not None:
        raise UsageError("--seed is for --stress; references have no chance in them")
    from .study.verify import listing, verify

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
    """Run time against error."""
    if options.modulus:
        if options.out:
            raise UsageError("--out is for --error; --modulus writes nothing")
        from .study import modulus

        print("\n".join(modulus.said(modulus.continuation(options.quick))))
        return DONE
    from .study.error import bench_error

    return bench_error(options.out or Path("output") / ("bench-quick" if options.quick else "bench"), options.quick)


def show(options: argparse.Namespace) -> int:
    """The commands that look at runs and at this machine."""
    if options.command == "doctor":
        from .study.doctor import examine

        healthy, text = examine()
        print(text)
        return DONE if healthy else ENVIRONMENT
    if options.command == "schema":
        _discover()
        from .case.json_schema import json_schema

        print(json.dumps(json_schema(), indent=2, ensure_ascii=False))
        return DONE
    if options.command == "plot":
        times = [_time(t, "--times") for t in options.times.split(",")] if options.times else None
        from .study.plot import plot

        print("\n".join(map(str, plot(options.directory, times, options.field, options.out))))
        return DONE
    from .study.compare import diff, info

    if options.command == "info":
        print(info(options.directory))
        return DONE
    same, lines = diff(*options.directories, options.tolerance)
    print("\n".join(lines))
    return DONE if same else DIFFERENT


def _time(text: str, option: str) -> float:
    from .case.units import UnitError, number

    try:
        value = number(text, "us")
    except UnitError as error:
        raise UsageError(f"{option}: {error}") from error
    if value < 0 or (value == 0 and option == "--until"):
        raise UsageError(f"{option}: '{text}' is not after the start")
    return value


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expects a number from 1 on, not '{text}'")
    return int(text)


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
    words, comm = sys.argv[1:], None
    try:
        ours, petsc_options = split_arguments(words)
        serial = bool(ours) and ours[0] in COMMANDS and ours[0] != "run"
        options = parse(words if serial else ours)
        if not serial or options.command in ("validate", "paper", "verify", "bench") or RANKS > 1:
            comm = start_petsc([] if serial else petsc_options)
        if not serial:
            code = run(options, comm)
        else:  # nothing to share: other ranks than the first are idle
            command = {"validate": validate, "paper": paper, "verify": verify, "bench": bench}
            code = command.get(options.command, show)(options) if RANK == 0 else DONE
        sys.stdout.flush()
    except BrokenPipeError:  # whoever reads, such as `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = DONE
    except KeyboardInterrupt:
        code = INTERRUPTED
    except Exception as error:
        code = failure(error, comm)
    sys.exit(code)


def start_petsc(options: list[str]) -> Any:
    """Start MPI and PETSc with its options; returns the communicator of all ranks."""
    import petsc4py
    from mpi4py import MPI

    # PETSc's own handler meets a signal with a trace of its stack, even where a reader of the output has just left.
    handler = [] if "-no_signal_handler" in options else ["-no_signal_handler"]
    petsc4py.init([sys.argv[0], *options, *handler])
    return MPI.COMM_WORLD


def failure(error: Exception, comm: Any) -> int:
    """Say what went wrong, once; errors of the user's are known to all ranks, others end all ranks here."""
    codes = {"CaseError": WRONG, "UsageError": WRONG, "OptionError": WRONG, "CompilerError": ENVIRONMENT,
             "OutputError": INPUT_OUTPUT, "NumericsError": BROKEN}
    code, message = codes.get(type(error).__name__), str(error)
    if isinstance(error, ImportError) and not (error.name or "").startswith("cellmig"):
        code, message = ENVIRONMENT, f"{error}; './run' installs what is needed, 'cellmig doctor' tells what is missing"
    elif code is None and isinstance(error, OSError) and RANKS == 1:
        code, message = INPUT_OUTPUT, f"{error.filename}: {error.strerror}" if error.filename else message
    if code is not None:
        if RANK == 0:
            print(f"cellmig: {message}", file=sys.stderr, flush=True)
        return code
    traceback.print_exception(error)
    print("cellmig: this is a mistake of the program; please report it", file=sys.stderr, flush=True)
    if comm is not None and comm.size > 1:
        comm.Abort(1)
    return 1


if __name__ == "__main__":
    main()
