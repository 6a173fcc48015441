"""Starts a program on several ranks with the installed mpiexec: `python -m cellmig.parallel.launch N COMMAND…`.

Open MPI 4 and 5 behave alike: settings are environment variables under the names of both versions, each of which
ignores those of the other; and the messages that mpiexec adds when a program fails are filtered here, as only Open MPI
4 has an option for that.  If mpiexec cannot start the ranks, its reason is printed and the exit code is 3.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from typing import IO

from ..exits import DONE, ENVIRONMENT, FAILED, INPUT_OUTPUT, INVALID_INPUT, STOPPED

# -P: Python imports no module from the current folder.
PYTHON = (sys.executable, "-P")
# Settings for containers, which run as root and have no ptrace; for more ranks than cores; and for ranks of one machine
# to reach each other.  Of each pair, the first name is Open MPI 4's, the second Open MPI 5's.
SETTINGS = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
            "OMPI_MCA_rmaps_base_oversubscribe": "1", "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
            "OMPI_MCA_btl_vader_single_copy_mechanism": "none", "OMPI_MCA_smsc": "^cma,knem,xpmem",
            "OMPI_MCA_reachable": "^netlink"}
# Variables that launchers set for a rank: processes that inherit them would take themselves for ranks, too.
_OF_RANKS = re.compile(r"OMPI_(?!MCA_|ALLOW_)|OPAL_|PMIX_|PRTE_(?!MCA_)|ORTE_|PMI_|MPI_LOCAL|MV2_COMM"
                       r"|SLURM_(STEP|PROCID)|OMPI_MCA_(ess|orte_(?!default_hostfile)|pmix|initial_wdir"
                       r"|mpi_oversubscribe|shmem_RUNTIME|PREFIXES|cpu_type|mca_base_component_path"
                       r"|num_procs)|CELLMIG_TERMINAL")
_RULE = b"-" * 40  # a message of Open MPI begins and ends with it
_MESSAGE = re.compile(b"^" + _RULE + b"-*\n.+?\n" + _RULE + b"-*\n", re.DOTALL | re.MULTILINE)
# In messages about the end of the program and about our signals, which the program reports itself, and about messages.
_REDUNDANT = (b"non-zero", b"MPI_ABORT was invoked", b"Forwarding signal", b"show_help.c")
_OURS = {DONE, INVALID_INPUT, ENVIRONMENT, FAILED, INPUT_OUTPUT, STOPPED}
_PATIENCE = 60.0  # time within which ranks have to start [s]


# Variables in which launchers state the number of ranks, and the rank: Open MPI, MPICH and relatives, MVAPICH, Slurm.
_SIZE = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "MPI_LOCALNRANKS", "MV2_COMM_WORLD_SIZE")
_RANK = ("OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK", "MPI_LOCALRANKID", "MV2_COMM_WORLD_RANK", "SLURM_PROCID")


def launcher_size() -> tuple[list[str], int]:
    """Environment variables that state how many ranks a launcher has started, and that number; MPI is not needed.

    SLURM_NTASKS counts only in a step that srun has started: in an allocation it is the room for tasks, not their
    number.
    """
    step = ["SLURM_STEP_NUM_TASKS"]
    if "SLURM_STEP_ID" in os.environ or _number("SLURM_PROCID"):
        step.append("SLURM_NTASKS")
    sizes = {name: number for name in (*_SIZE, *step) if (number := _number(name))}
    size = next(iter(sizes.values()), 1)
    return [name for name in sizes if sizes[name] == size], size


def launcher_rank() -> int:
    """Number of this rank as the launcher states it, 0 without a launcher."""
    return next((n for name in _RANK if (n := _number(name)) is not None), 0) if launcher_size()[1] > 1 else 0


def _number(name: str) -> int | None:
    return int(value) if (value := os.environ.get(name, "")).isdecimal() else None


def outside_mpi() -> dict[str, str]:
    """Environment for a new process that is no rank of this run."""
    return SETTINGS | {key: value for key, value in os.environ.items() if not _OF_RANKS.match(key)}


def mpiexec() -> str | None:
    """Path of the MPI launcher, preferably Open MPI's; None if there is none."""
    return shutil.which("mpiexec.openmpi") or shutil.which("mpiexec")


def on_ranks(ranks: int, command: Sequence[str]) -> list[str]:
    """Command line that runs `command` on several ranks; see `launch`."""
    return [*PYTHON, "-m", __name__, str(ranks), *command]


def launch(ranks: int, command: Sequence[str]) -> int:
    """Run a command on several ranks; returns its exit code, or 3 if the ranks could not be started.

    mpiexec kills its ranks a second after a SIGTERM but forwards SIGUSR1, so that SIGTERM and a first ^C are passed on
    as SIGUSR1, a second ^C as SIGTERM.  The ranks' own process group keeps the terminal's ^C from them.
    """
    if not (launcher := mpiexec()):
        return _failed("there is no mpiexec: apt install openmpi-bin")
    stop_signals: list[int] = []

    def stop(number: int, _: object) -> None:
        at_once = number == signal.SIGINT and len(stop_signals) > 0
        stop_signals.append(number)
        process.send_signal(signal.SIGTERM if at_once else signal.SIGUSR1)

    requests = (signal.SIGTERM, signal.SIGUSR1, signal.SIGINT)
    signal.pthread_sigmask(signal.SIG_BLOCK, requests)
    process = subprocess.Popen([launcher, "-n", str(ranks), *command], stdin=subprocess.DEVNULL, stderr=subprocess.PIPE,
                               env=outside_mpi() | _terminal(), process_group=0,
                               preexec_fn=lambda: signal.pthread_sigmask(signal.SIG_UNBLOCK, requests))
    for number in requests:
        signal.signal(number, stop)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, requests)
    assert process.stderr is not None  # it is a pipe
    messages = _Messages(process.stderr)
    code = process.wait()
    messages.join()
    process.stderr.close()
    code = 128 - code if code < 0 else code
    if code in _OURS or messages.told or 128 < code <= 128 + signal.SIGRTMAX or stop_signals:
        return code
    return _examined(code, ranks, launcher, messages.reasons)


def _terminal() -> dict[str, str]:
    return {key: os.environ[key] for key in ("CELLMIG_TERMINAL",) if key in os.environ}


class _Messages(threading.Thread):
    """Prints what mpiexec and its ranks write to stderr, line by line, without Open MPI's redundant messages."""

    def __init__(self, stream: IO[bytes]):
        super().__init__(daemon=True)
        self.stream, self.told = stream, False
        self.reasons: set[bytes] = set()
        self.start()

    def run(self) -> None:
        """Print until the stream ends."""
        held: list[bytes] = []
        passed = True
        for line in self.stream:
            rule = line.strip().startswith(_RULE)
            if held or rule:
                held.append(line)
            elif passed or line.strip():  # Open MPI 5 ends a message with an empty line
                passed = self._print(line)
            if rule and len(held) > 1:
                passed = self._message(held)
                held = []
        self._message(held)

    def _message(self, lines: list[bytes]) -> bool:
        """Handle a message of Open MPI's; returns whether it was printed."""
        message = b"".join(lines)
        passed = self._print(message)
        if passed:
            self.reasons.add(message)
        return passed

    def _print(self, text: bytes) -> bool:
        self.told |= text.startswith(b"cellmig: ")  # by a rank, which had started
        wanted = not any(part in text for part in _REDUNDANT)
        if wanted:
            sys.stderr.buffer.write(text)
            sys.stderr.flush()
        return wanted and bool(text.strip())


def _examined(code: int, ranks: int, launcher: str, reasons: set[bytes]) -> int:
    """The exit code after an unusual one: 3 if ranks that only import MPI fail as well."""
    trial = [*PYTHON, "-c", "from mpi4py import MPI"]
    # Where several ranks send messages at once, Open MPI 4 loses some: what one rank alone tells is printed, too.
    for size in (ranks, 1):
        try:
            tried = subprocess.run([launcher, "-n", str(size), *trial], stdin=subprocess.DEVNULL, env=outside_mpi(),
                                   capture_output=True, timeout=_PATIENCE)
        except subprocess.TimeoutExpired:
            return _failed(f"mpiexec has not started {size} ranks within {_PATIENCE:g} s")
        if not tried.returncode:
            break
        told = set(_MESSAGE.findall(tried.stderr)) if reasons else {tried.stderr.strip() + b"\n"} - {b"\n"}
        for reason in sorted(told - reasons):
            sys.stderr.buffer.write(reason)
        reasons |= told
    if size == ranks and not tried.returncode:
        return code
    return _failed(f"mpiexec could not start {ranks} ranks (its exit code was {code}); 'cellmig doctor' tells what is "
                   "here")


def _failed(message: str) -> int:
    print(f"cellmig: {message}", file=sys.stderr, flush=True)
    return ENVIRONMENT


if __name__ == "__main__":
    sys.exit(launch(int(sys.argv[1]), sys.argv[2:]))
