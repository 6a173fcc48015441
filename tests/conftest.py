"""What all tests share, on one rank and on several.

Every test runs on every rank.  After each of its phases the ranks tell each other how it went, so that they stay in
step: a test that fails on one rank has failed on all of them, and rank 0 reports it.  A rank that fails where the
others wait for it cannot be helped; after a while it ends the run with its message.
"""

from __future__ import annotations

import gc
import io
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from mpi4py import MPI

from cellmig.laws import register

register()
WORLD = MPI.COMM_WORLD.Dup()  # the tests' own messages keep clear of these
PATIENCE = float(os.environ.get("CELLMIG_TEST_PATIENCE", 60))  # s that a rank which failed waits for the others


# -------------------------------------------------------------------------------------------------------- fixtures


@pytest.fixture(scope="session")
def comm() -> MPI.Comm:
    """All ranks of this run."""
    return MPI.COMM_WORLD


@pytest.fixture
def shared_tmp() -> Iterator[Path]:
    """An empty directory that is the same one on all ranks; `tmp_path` is another on each."""
    path = WORLD.bcast(tempfile.mkdtemp(prefix="cellmig-") if WORLD.rank == 0 else None)
    yield Path(path)
    WORLD.Barrier()
    if WORLD.rank == 0:
        shutil.rmtree(path)


@pytest.fixture(scope="session")
def outside_mpi() -> dict[str, str]:
    """The environment for a program that starts ranks: what Open MPI told this process would confuse it."""
    from cellmig.parallel import launch

    return launch.outside_mpi()


@pytest.fixture(scope="session")
def on_ranks(outside_mpi: dict[str, str]) -> Callable[..., subprocess.CompletedProcess[str]]:
    """`on_ranks(2, "-m", "cellmig", …)`: Python on that many ranks, for serial tests; `env` adds to its environment.

    On one it is this Python itself, without mpiexec.
    """

    def start(ranks: int, *arguments: object, env: dict[str, str] | None = None, timeout: float = 240,
              **options: object) -> subprocess.CompletedProcess[str]:
        from cellmig.parallel import launch

        command = [sys.executable, *map(str, arguments)]
        return subprocess.run(launch.on_ranks(ranks, command) if ranks > 1 else command, env=outside_mpi | (env or {}),
                              text=True, stdin=subprocess.DEVNULL, capture_output=True, timeout=timeout, **options)

    return start


@pytest.fixture(scope="session")
def cellmig(on_ranks: Callable[..., subprocess.CompletedProcess[str]]) -> Callable[..., object]:
    """`cellmig(2, "resume", …)`: the program on some ranks."""
    return lambda ranks, *words, **more: on_ranks(ranks, "-m", "cellmig", *words, **more)


# ------------------------------------------------------------------------------------------------ what is selected


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out `slow` unless -m names it, and `serial` on several ranks (in addopts, any other -m would undo it)."""
    out = {name for name, no in {"slow": "slow" not in config.option.markexpr, "serial": WORLD.size > 1}.items() if no}
    left_out = [item for item in items if out & {mark.name for mark in item.iter_markers()}]
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item not in left_out]


def pytest_collection_finish() -> None:
    """What is there by now stays: collections of garbage need not look at it each time, half a second in all tests."""
    gc.collect()
    gc.freeze()


# --------------------------------------------------------------------------------------------- several ranks in step


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config: pytest.Config) -> None:
    """Time-outs come by thread on several ranks: a signal does not wake one that waits inside MPI."""
    if WORLD.size > 1:
        config.option.timeout_method = "thread"


@pytest.hookimpl(tryfirst=True)
def pytest_sessionstart(session: pytest.Session) -> None:
    """Rank 0 speaks for all."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if WORLD.rank > 0 and reporter:
        reporter._tw._file = io.StringIO()


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[None]:
    """Agree on how a phase of a test went: failed, if on any rank; skipped, if on any; else passed."""
    outcome = yield
    if WORLD.size == 1:
        return
    report = outcome.get_result()
    _meet(report)
    everyone = WORLD.allgather((report.outcome, report.longreprtext, report.longrepr if report.skipped else None))
    failures = [(rank, text) for rank, (how, text, _) in enumerate(everyone) if how == "failed"]
    skips = [reason for how, _, reason in everyone if how == "skipped"]
    if failures:
        report.outcome = "failed"
        report.longrepr = "\n".join(f"[rank {rank} of {WORLD.size}]\n{text}" for rank, text in failures)
    elif skips and report.passed:
        report.outcome, report.longrepr = "skipped", skips[0]
    if report.when == "teardown":
        gc.collect()  # PETSc's objects are destroyed collectively: at the same time on all ranks


def pytest_sessionfinish(exitstatus: int) -> None:
    """A rank that is interrupted or breaks down takes the others with it."""
    if WORLD.size > 1 and exitstatus in (pytest.ExitCode.INTERRUPTED, pytest.ExitCode.INTERNAL_ERROR):
        _abort(f"pytest ended with exit code {int(exitstatus)}")


def _meet(report: pytest.TestReport) -> None:
    """Wait for the other ranks; for PATIENCE only where this one has failed and they may wait for it forever."""
    arrived, since = WORLD.Ibarrier(), time.monotonic()
    while not arrived.Test():
        if report.failed and time.monotonic() - since > PATIENCE:
            _abort(f"{report.nodeid} failed here ({report.when}) while other ranks went on:\n{report.longreprtext}")
        time.sleep(1e-3)


def _abort(message: str) -> None:
    print(f"\n[rank {WORLD.rank} of {WORLD.size}] {message}", file=sys.__stderr__, flush=True)
    MPI.COMM_WORLD.Abort(1)
