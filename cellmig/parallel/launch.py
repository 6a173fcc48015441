"""Starts a program on several ranks, with the mpiexec that is there: `python -m cellmig.parallel.launch N COMMAND…`.

Open MPI 4 and 5 are served alike: settings go by environment under all the names that either knows (each passes over
those of the other), and what mpiexec adds when a program ends with another exit code than 0 is left out here, for only
Open MPI 4 has an option for that.  Where mpiexec cannot start the ranks, its reason is told and the exit code is 3.
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

from ..exits import BROKEN, DONE, ENVIRONMENT, INPUT_OUTPUT, STOPPED, WRONG

# Python that takes no module from the folder where it is started.
PYTHON = (sys.executable, "-P")
# What mpiexec needs in containers, which run as root and have no ptrace, for more ranks than cores, and to find that
# ranks of one machine reach each other; first Open MPI 4's name, then 5's.
SETTINGS = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
            "OMPI_MCA_rmaps_base_oversubscribe": "1", "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
            "OMPI_MCA_btl_vader_single_copy_mechanism": "none", "OMPI_MCA_smsc": "^cma,knem,xpmem",
            "OMPI_MCA_reachable": "^netlink"}
# What launchers tell a process that is a rank: those that it starts would believe that they are, too.
_TOLD = re.compile(r"OMPI_(?!MCA_|ALLOW_)|OPAL_|PMIX_|PRTE_(?!MCA_)|ORTE_|PMI_|MPI_LOCAL|MV2_COMM|SLURM_(STEP|PROCID)"
                   r"|OMPI_MCA_(ess|orte_(?!default_hostfile)|pmix|initial_wdir|mpi_oversubscribe|shmem_RUNTIME"
                   r"|PREFIXES|cpu_type|mca_base_component_path|num_procs)|CELLMIG_TERMINAL")
_RULE = b"-" * 40  # begins and ends what Open MPI says
# What it says of the program's own end and of our requests: the program tells these itself.
_KNOWN = (b"non-zero", b"MPI_ABORT was invoked", b"Forwarding signal")
_OURS = {DONE, WRONG, ENVIRONMENT, BROKEN, INPUT_OUTPUT, STOPPED}
_PATIENCE = 60.0  # s for ranks that are tried


# Where launchers tell a rank how many there are, and which it is: Open MPI, MPICH and its kin, MVAPICH.
_SIZE = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "MPI_LOCALNRANKS", "MV2_COMM_WORLD_SIZE")
_RANK = ("OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK", "MPI_LOCALRANKID", "MV2_COMM_WORLD_RANK", "SLURM_PROCID")


def launcher_size() -> tuple[list[str], int]:
    """How many ranks a launcher has started, and the variables that say so: known before MPI has started, or without.

    An allocation of Slurm has room for SLURM_NTASKS but one process, until srun starts the tasks of a step.
    """
    step = ["SLURM_STEP_NUM_TASKS"]
    if "SLURM_STEP_ID" in os.environ or _number("SLURM_PROCID"):
        step.append("SLURM_NTASKS")
    said = {name: number for name in (*_SIZE, *step) if (number := _number(name))}
    size = next(iter(said.values()), 1)
    return [name for name in said if said[name] == size], size


def launcher_rank() -> int:
    """Which of several ranks this is, as the launcher tells it."""
    return next((n for name in _RANK if (n := _number(name)) is not None), 0) if launcher_size()[1] > 1 else 0


def _number(name: str) -> int | None:
    return int(value) if (value := os.environ.get(name, "")).isdecimal() else None


def outside_mpi() -> dict[str, str]:
    """The environment of a process that is no rank of this run, even if this one is."""
    return SETTINGS | {key: value for key, value in os.environ.items() if not _TOLD.match(key)}


def mpiexec() -> str | None:
    """Path of the launcher, Open MPI's if there is a choice."""
    return shutil.which("mpiexec.openmpi") or shutil.which("mpiexec")


def on_ranks(ranks: int, command: Sequence[str]) -> list[str]:
    """The command that starts another on some ranks; an asked stop reaches them, a failure has a reason."""
    return [*PYTHON, "-m", __name__, str(ranks), *command]


def launch(ranks: int, command: Sequence[str]) -> int:
    """Run a command on some ranks: its exit code, or 3 if they could not be started.

    mpiexec kills its ranks a second after a SIGTERM but passes SIGUSR1 on, so a request to stop goes to them as
    SIGUSR1.  They sit in a process group of their own, where ^C does not reach; a second one stops them at once.
    """
    if not (launcher := mpiexec()):
        return _failed("there is no mpiexec: apt install openmpi-bin")
    start = [launcher, "-n", str(ranks)]
    asked: list[int] = []

    def stop(number: int, _: object) -> None:
        at_once = number == signal.SIGINT and len(asked) > 0
        asked.append(number)
        process.send_signal(signal.SIGTERM if at_once else signal.SIGUSR1)

    requests = (signal.SIGTERM, signal.SIGUSR1, signal.SIGINT)
    signal.pthread_sigmask(signal.SIG_BLOCK, requests)
    process = subprocess.Popen([*start, *command], stdin=subprocess.DEVNULL, stderr=subprocess.PIPE,
                               env=outside_mpi() | _terminal(), process_group=0,
                               preexec_fn=lambda: signal.pthread_sigmask(signal.SIG_UNBLOCK, requests))
    for number in requests:
        signal.signal(number, stop)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, requests)
    said = _Said(process.stderr)
    code = process.wait()
    said.join()
    process.stderr.close()
    code = 128 - code if code < 0 else code
    if code in _OURS or 128 < code <= 128 + signal.SIGRTMAX or asked:
        return code
    return _examined(code, ranks, start, said)


def _terminal() -> dict[str, str]:
    return {key: os.environ[key] for key in ("CELLMIG_TERMINAL",) if key in os.environ}


class _Said(threading.Thread):
    """Passes on, line by line, what comes from mpiexec and its ranks, but for what the program has told better."""

    def __init__(self, stream: IO[bytes]):
        super().__init__(daemon=True)
        self.stream, self.reason = stream, False
        self.start()

    def run(self) -> None:
        """Until the stream ends."""
        held, passed = [], True
        for line in self.stream:
            rule = line.strip().startswith(_RULE)
            if held or rule:
                held.append(line)
            elif passed or line.strip():  # Open MPI 5 ends what it says with an empty line
                passed = self._pass(line)
            if rule and len(held) > 1:
                passed = self._told(held)
                held = []
        self._told(held)

    def _told(self, lines: list[bytes]) -> bool:
        """A message of Open MPI's; whether it was passed on."""
        passed = self._pass(b"".join(lines))
        self.reason |= passed
        return passed

    def _pass(self, text: bytes) -> bool:
        wanted = not any(known in text for known in _KNOWN)
        if wanted:
            sys.stderr.buffer.write(text)
            sys.stderr.flush()
        return wanted and bool(text.strip())


def _examined(code: int, ranks: int, start: Sequence[str], said: _Said) -> int:
    """The exit code after an unusual end: 3 if ranks that do nothing but start MPI fail, too."""
    try:
        tried = subprocess.run([*start, *PYTHON, "-c", "from mpi4py import MPI"], stdin=subprocess.DEVNULL,
                               env=outside_mpi(), capture_output=True, timeout=_PATIENCE)
    except subprocess.TimeoutExpired:
        return _failed(f"mpiexec has not started {ranks} ranks within {_PATIENCE:g} s")
    if not tried.returncode:
        return code
    if not said.reason and tried.stderr.strip():
        print(tried.stderr.decode(errors="replace").strip(), file=sys.stderr)
    return _failed(f"mpiexec could not start {ranks} ranks (its exit code was {code}); 'cellmig doctor' tells what is "
                   "here")


def _failed(message: str) -> int:
    print(f"cellmig: {message}", file=sys.stderr, flush=True)
    return ENVIRONMENT


if __name__ == "__main__":
    sys.exit(launch(int(sys.argv[1]), sys.argv[2:]))
