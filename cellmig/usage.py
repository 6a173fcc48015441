"""The commands and their options, for argparse."""

from __future__ import annotations

import argparse
import difflib
import os
import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from .case.shipped import names
from .parallel.launch import launcher_rank, launcher_size
from .version import __version__

WIDTH = 80  # largest number of letters in a line of help
TENSION = "30 pN/um"  # cortical tension of neutrophils, Hochmuth (2000), J. Biomech. 33:15-22
RANK, RANKS = launcher_rank(), launcher_size()[1]


class UsageError(Exception):
    """Invalid command line; the message is for the user."""


class Help(argparse.RawDescriptionHelpFormatter):
    """Help with lines of at most WIDTH letters, or of the width of the terminal."""

    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **{"width": min(WIDTH, shutil.get_terminal_size().columns) - 2} | more)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        """Fill text, unless it has line breaks."""
        fill = argparse.HelpFormatter._fill_text
        return super()._fill_text(text, width, indent) if "\n" in text else fill(self, text, width, indent)


class Parser(argparse.ArgumentParser):
    """Parser for several ranks: errors are exceptions, and rank 0 alone prints help."""

    def __init__(self, **more: Any) -> None:
        super().__init__(**{"formatter_class": Help} | more)

    def error(self, message: str) -> None:
        """Raise UsageError."""
        raise UsageError(f"{message}\n{self.format_usage().strip()}\n'{self.prog} --help' tells more")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Raise UsageError for unknown words, in the parser of the command, which knows its options."""
        found, left = super().parse_known_args(args, namespace)
        if left:
            self.error(_not_known(left[0], args, self._option_string_actions))
        return found, left

    def _print_message(self, message: str, file: Any = None) -> None:
        if RANK == 0:
            super()._print_message(message, file)


_HELP = """\
To begin: 'cellmig cases' lists cases, 'cellmig cases one_cell' copies one here.
A case alone is run: 'cellmig run --help' lists its options.
On several ranks: mpiexec -n 4 cellmig CASE.toml
Options with one dash are PETSc's, such as -ts_type rk, -ts_dt 1e-3 (in µs).

exit codes: 0 done, 1 two runs differ, 2 the case or the command line is wrong,
            3 something is missing on the machine, 4 the simulation failed,
            5 input or output failed, 75 stopped on request: 'resume' continues"""


def parser() -> Parser:
    """The parser of all commands and options."""
    top = Parser(prog="cellmig", usage="cellmig CASE.toml [OPTION …]\n       cellmig COMMAND [ARGUMENT …]",
                 description="Collective cell migration by a meshfree particle method.", epilog=_HELP)
    top.add_argument("--version", action="version", version=f"cellmig {__version__}")
    commands = top.add_subparsers(dest="command", required=True, parser_class=Parser, metavar="COMMAND", prog="cellmig")

    run = commands.add_parser("run", help="run a case", epilog="Options with one dash are PETSc's: -ts_type rk.",
                              description="Run a case.  A run that is already in the directory is moved aside.  ^C, "
                                          "SIGTERM and SIGUSR1 end a run with complete files and a checkpoint.")
    run.add_argument("case", type=Path, help="case file")
    run.add_argument("--out", type=Path, metavar="DIR", help="directory of the run (default: output/<case name>)")
    run.add_argument("--from", type=Path, metavar="DIR", dest="origin", help="initial state: the last state "
                     "of the run in DIR, which has the same particles; all else may differ")
    _until(run)
    run.add_argument("--no-prune", action="store_true", help="compute terms that the scene lacks, too: same bits")
    run.add_argument("--quiet", action="store_true", help="print errors only")
    run.add_argument("--resume", choices=("auto",), help="auto: resume from the newest checkpoint in the directory, "
                     "if there is one, else begin; for batch scripts")
    _checkpoints(run)
    _accuracy(run)
    _sets(run)
    _laws(run)
    resume = commands.add_parser(
        "resume", help="continue a run that was stopped or killed, or extend it",
        epilog="Options with one dash are PETSc's: repeat those of the run.", description="Continue a run from its "
        "newest intact checkpoint, on any number of ranks, with the same bits as without the interruption.  Output "
        "after the checkpoint is written again.")
    resume.add_argument("directory", type=Path, help="of the run")
    resume.add_argument("--until", metavar='"800 us"', help="new end, earlier or later; a complete run continues")
    resume.add_argument("--quiet", action="store_true", help="print errors only")
    _checkpoints(resume)
    _laws(resume)

    validate = commands.add_parser("validate", help="check cases and estimate the cost of a run")
    validate.add_argument("cases", type=Path, nargs="+", metavar="case", help="case file")
    validate.add_argument("--ranks", type=_count, default=1, metavar="N", help="also what each of N ranks has: "
                          "cells, particles, work, memory")
    _until(validate)
    _accuracy(validate)
    _sets(validate)
    _laws(validate)
    _sweep(commands)
    _about_runs(commands)
    _studies(commands)
    _checks(commands)
    return top


def _sweep(commands: Any) -> None:
    """Add the command `sweep`."""
    sweep = commands.add_parser("sweep", help="runs of a case with varied values: one table, one picture",
                                description="Run a case for all combinations of values, as many at a time as there "
                                "are cores.  Complete runs are kept: the same command continues, and more values add "
                                "runs.  sweep.csv has a row for each run and cell at its end (cell 0 is the "
                                "aggregate).", epilog="cellmig sweep cases/all_protrude.toml --vary "
                                "adhesion.cells.bond_density='1000,2000,4000 /um^2' --vary seed=1:8")
    sweep.add_argument("case", type=Path, help="case file")
    sweep.add_argument("--vary", action="append", required=True, metavar="KEY=A,B,C", help="values of a key: a.b=1,2,4 "
                       "or a.b='1,2,4 kPa' or seed=1:8 (both ends included); again for another key")
    sweep.add_argument("--out", type=Path, metavar="DIR", help="directory (default: output/sweep-<case name>)")
    _until(sweep)
    sweep.add_argument("--jobs", type=_count, help="ranks at a time (default: one for each core)")
    sweep.add_argument("--ranks", type=_count, default=1, help="ranks of each run (default: 1)")
    sweep.add_argument("--show", metavar="COLUMN,COLUMN", help="columns of history.csv to draw")
    sweep.add_argument("--slurm", action="store_true", help="write a Slurm array of the runs instead of running")
    _accuracy(sweep)
    _sets(sweep)
    _laws(sweep)


def _about_runs(commands: Any) -> None:
    """Add the commands that tell what runs did."""
    info = commands.add_parser("info", help="summary of a run")
    info.add_argument("directory", type=Path, help="of a run")
    diff = commands.add_parser("diff", help="compare two runs: equal, or their first difference")
    diff.add_argument("directories", type=Path, nargs=2, metavar="directory", help="of a run")
    diff.add_argument("--tolerance", type=float, default=0.0, help="relative; 0, the default, for equal bits")
    tracks = commands.add_parser("tracks", help="how cells moved: speed, direction, persistence",
                                 description="How the cells of a run moved along the substrate, by cell and in the "
                                 "mean over cells with its standard error.  Cells of several runs, such as seeds, are "
                                 "pooled.")
    tracks.add_argument("directories", type=Path, nargs="+", metavar="directory", help="of a run")
    tracks.add_argument("--axis", choices=("x", "y"), default="x", help="of the forward migration index (default: x)")
    tracks.add_argument("--interval", metavar='"10 min"', help="between the positions that ways and speeds are made of "
                        "(default: that of the samples)")
    tracks.add_argument("--cells", metavar="NAME,NAME", help="these cells only, such as Leader-*")
    tracks.add_argument("--json", action="store_true", help="JSON instead of tables")
    plot = commands.add_parser("plot", help="pictures of a run")
    plot.add_argument("directory", type=Path, help="of a run")
    plot.add_argument("--times", metavar='"20 us,204 us"', help="times of the snapshots")
    plot.add_argument("--field", default="effective_stress", help="colours the shapes (default: effective_stress)")
    plot.add_argument("--background", metavar="NAME", help="field of the case behind the cells, or none (default: the "
                      "first)")
    plot.add_argument("--film", action="store_true", help="also a film of all frames: mp4 with ffmpeg, else gif")
    plot.add_argument("--format", default="png,pdf", metavar="png,pdf,svg", help="file formats (default: png,pdf)")
    plot.add_argument("--out", type=Path, metavar="DIR", help="directory of the pictures (default: that of the run)")
    report = commands.add_parser("report", help="one page of a run for a browser: its frames to play, its curves",
                                 description="Write one HTML file that needs nothing else: the frames of a run to play "
                                 "and ask for values, curves of its tables, what it was, cost and did.")
    report.add_argument("directory", type=Path, help="of a run, complete or not")
    report.add_argument("--out", type=_page, metavar="FILE.html", help="the file (default: report.html in that of "
                        "the run)")
    watch = commands.add_parser("watch", help="the same page of a run that goes on, served to this machine",
                                description="Serve the page of a run to browsers on this machine; it renews itself as "
                                "frames come.  Ctrl-C ends it; it leaves nothing behind.")
    watch.add_argument("directory", type=Path, help="of a run")
    watch.add_argument("--port", type=_port, default=0, help="of 127.0.0.1 (default: a free one)")


def _studies(commands: Any) -> None:
    """Add the commands that run many cases and judge claims."""
    paper = commands.add_parser("paper", help="the paper's cases over many seeds: its claims, its figures")
    paper.add_argument("--out", type=Path, help="directory (default: output/paper, with --quick output/paper-quick, "
                       "in space output/paper-3d, followed by what is set)")
    paper.add_argument("--seeds", type=_count, help="random seeds of each case (default: 8, with --quick 3)")
    paper.add_argument("--jobs", type=_count, help="runs at a time (default: one for each core)")
    paper.add_argument("--quick", action="store_true", help="coarse particles: takes minutes")
    paper.add_argument("--dimension", type=int, choices=(2, 3), default=2, help="3: three balls, for R1, R3, R5, R6")
    paper.add_argument("--only", metavar="R3,R4", help="these claims only, with the runs that they need")
    paper.add_argument("--tension", nargs="?", const=TENSION, metavar='"30 pN/um"', help="all of it as printed and "
                       f"again with this tension of the cells' surfaces, side by side (without a value: {TENSION}, as "
                       "measured of neutrophils)")
    _sets(paper)
    guidance = commands.add_parser(
        "guidance", help="published facts on chemotaxis and durotaxis over many seeds: claimed, measured, what holds")
    guidance.add_argument("--out", type=Path, help="directory (default: output/guidance, with --quick "
                          "output/guidance-quick, followed by what is set)")
    guidance.add_argument("--seeds", type=_count, help="random seeds of each case (default: 8, with --quick 3)")
    guidance.add_argument("--jobs", type=_count, help="runs at a time (default: one for each core)")
    guidance.add_argument("--quick", action="store_true", help="coarse particles, half the time: minutes")
    guidance.add_argument("--only", metavar="G1,G2", help="these claims only, with the runs that they need")
    _sets(guidance)


def _checks(commands: Any) -> None:
    """Add the commands that tell how right and how fast it is, and the schema."""
    verify = commands.add_parser("verify", help="compare with known solutions; other checks of correctness",
                                 description="References against exact and published solutions at three resolutions or "
                                             "more: errors, orders, verdicts; exit code 1 if one does not hold. "
                                             "With --stress or --sensitivity, other checks.")
    verify.add_argument("--only", metavar="NAME,NAME", help="these references or groups only")
    what = verify.add_mutually_exclusive_group()
    what.add_argument("--list", action="store_true", help="list references, sources, and orders expected by theory")
    what.add_argument("--stress", type=_count, metavar="N", help="N random scenes: each must run stably, stop with "
                      "a message or be refused")
    what.add_argument("--sensitivity", action="store_true", help="dependence of the main scene on spacing, time step "
                      "and other numerical choices")
    _scenes(verify)
    verify.add_argument("--quick", action="store_true", help="coarse references or sensitivity: takes minutes")
    verify.add_argument("--jobs", type=_count, help="processes at a time (default: one for each core)")
    verify.add_argument("--out", type=Path, metavar="DIR", help="directory (default: output/verify, output/stress, "
                        "output/sensitivity, with --quick output/verify-quick, output/sensitivity-quick)")
    _sets(verify)
    bench = commands.add_parser("bench", help="cost of steps; run time against error",
                           description="Cost of a step by term, on one and two ranks, compared with numpy and a "
                                       "plain loop; or one of these:")
    what = bench.add_mutually_exclusive_group()
    what.add_argument("--error", action="store_true", help="over spacing, dilation, stabilisation, "
                      "integrator, step and modulus: Pareto sets and a verdict on the defaults")
    what.add_argument("--modulus", action="store_true", help="error of the reduced bulk modulus only, half a minute")
    what.add_argument("--scaling", action="store_true", help="cost of steps on many ranks, by a model with "
                      "constants measured here, three minutes")
    what.add_argument("--cues", action="store_true", help="cost of polarity, fields and cues, three minutes")
    bench.add_argument("--problem", action="append", default=[], metavar="NAME", help="with --error: this problem only "
                       "(disc, drop, cell, scene, tension, twist, turn, ball); several times for several problems")
    bench.add_argument("--dimension", type=int, choices=(2, 3), default=2, help="3: the cost of a step in space, also "
                       "with --scaling")
    bench.add_argument("--quick", action="store_true", help="half a minute; with --error four minutes")
    bench.add_argument("--out", type=Path, metavar="DIR", help="directory (default: output/bench, in space "
                       "output/bench-3d, with --quick followed by -quick)")
    schema = commands.add_parser("schema", help="JSON schema of a case file, for editors")
    schema.add_argument("--markdown", action="store_true", help="a page of all keys and laws instead")
    _laws(schema)
    cases = commands.add_parser("cases", help="list the cases and examples that come with cellmig, or copy some here",
                                description="List the cases and examples that come with cellmig, or copy some of them "
                                "here, each with the files that it needs.  Nothing is overwritten.")
    cases.add_argument("names", nargs="*", metavar="NAME", help="of a case or an example to be copied")
    cases.add_argument("--all", action="store_true", help="copy all of them")
    cases.add_argument("--to", type=Path, metavar="DIR", default=Path("."),
                       help="folder of the copies (default: this one)")
    commands.add_parser("doctor", help="check this machine for what cellmig needs")


def _scenes(verify: argparse.ArgumentParser) -> None:
    verify.add_argument("--seed", type=int, help="of the random scenes (default: 0)")
    verify.add_argument("--dimension", type=int, choices=(2, 3), default=2, help="of the random scenes (default: 2)")
    verify.add_argument("--integrator", choices=("leapfrog", "overdamped"), default="leapfrog", help="of most random "
                        "scenes: overdamped ones are of minutes and hours (default: leapfrog)")


def _until(command: argparse.ArgumentParser) -> None:
    command.add_argument("--until", metavar='"40 us"', help="end in place of the case's")


def _checkpoints(command: argparse.ArgumentParser) -> None:
    command.add_argument("--wall-time", metavar='"2 h"', help="stop within this wall time, with a checkpoint and "
                         "exit code 75")
    command.add_argument("--checkpoint-wall", metavar='"10 min"', help="wall time between checkpoints (default: 5 min, "
                         "longer if they would take more than 2 %% of the time)")
    command.add_argument("--checkpoint-time", metavar='"5 us"', help="simulated time between checkpoints, besides")


def _accuracy(command: argparse.ArgumentParser) -> None:
    command.add_argument("--accuracy", metavar="20%", action="append", default=[], dest="sets",
                         type="numerics.accuracy={}".format,
                         help="as numerics.accuracy in a case: choices that the case leaves open are the cheapest ones "
                         "measured below this error")


def _sets(command: argparse.ArgumentParser) -> None:
    command.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="sets",
                         help="change a value of the case: --set particles.per_cell=500 --set time.step='1 ns'")


def _laws(command: argparse.ArgumentParser) -> None:
    command.add_argument("--law", action="append", default=[], type=Path, metavar="FILE.py", dest="laws",
                         help="a file of your own laws, which the case may name; repeat for others")


COMMANDS = ("run", "resume", "sweep", "validate", "info", "tracks", "diff", "plot", "report", "watch", "schema",
            "cases", "doctor", "paper", "guidance", "verify", "bench")


def what_first(words: list[str]) -> list[str]:
    """The words with the command or case file first, wherever it stands among the options."""
    if not words or not words[0].startswith("-"):
        return words
    for at, word in enumerate(words):
        before = words[at - 1] if at else ""
        value = before.startswith("--") and "=" not in before and before not in _alone()
        if not value and (word in COMMANDS or word.endswith(".toml")):
            return [word, *words[:at], *words[at + 1 :]]
    return words


def _alone() -> set[str]:
    """Options of all commands that take no value."""
    commands = next(a.choices for a in parser()._actions if isinstance(a.choices, dict))
    return {name for one in commands.values() for a in one._actions if a.nargs == 0 for name in a.option_strings}


def parse(words: list[str]) -> argparse.Namespace:
    """Parse the command line without PETSc's options; a case file as first word means `run`."""
    if not words:
        raise UsageError("expects a case file or a command: 'cellmig cases' lists the cases to begin with, "
                         "'cellmig --help' the commands")
    if words[0] not in COMMANDS and not words[0].startswith("-"):
        if words[0].endswith(".toml") or os.sep in words[0] or os.path.exists(words[0]):
            words = ["run", *words]
        else:
            near = difflib.get_close_matches(words[0], COMMANDS, 1)
            meant = f"; did you mean '{near[0]}'?" if near else f"; there are {', '.join(COMMANDS)}"
            if os.path.exists(f"{words[0]}.toml"):
                meant = f"; did you mean '{words[0]}.toml'?"
            elif words[0] in names():
                meant = f"; 'cellmig cases {words[0]}' copies the case of this name to here"
            raise UsageError(f"'{words[0]}' is neither a case file nor a command{meant}")
    return parser().parse_args(words)


def _not_known(word: str, words: Sequence[str], options: Iterable[str]) -> str:
    """Message about a word that no option takes."""
    before = words[words.index(word) - 1]
    if word.startswith("-"):
        near = difflib.get_close_matches(word.partition("=")[0], options, 1)
        return f"unknown option '{word}'" + (f"; did you mean '{near[0]}'?" if near else "")
    if before[:1].isdecimal():
        return f"'{word}' after '{before}' stands alone: put a value and its unit in quotes, \"{before} {word}\""
    return f"'{word}' is one word too many"


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expects a number from 1 on, not '{text}'")
    return int(text)


def _page(text: str) -> Path:
    """A file for a page; by its ending, so that no other file of a run is replaced."""
    path = Path(text)
    if path.suffix.lower() not in (".html", ".htm") or path.is_dir():
        raise argparse.ArgumentTypeError(f"expects the name of a file, such as '{path / 'report.html'}', not '{text}'")
    return path


def _port(text: str) -> int:
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"expects a number from 0 to 65535, not '{text}'")
    return int(text)
