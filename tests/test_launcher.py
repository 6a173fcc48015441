"""The two commands, with stand-ins for what they would install and start; and the tests' own behaviour on ranks."""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from scenes import ROOT

pytestmark = pytest.mark.serial

# Answers what the launcher asks of the venv's Python, and tells what else it was started with.
PYTHON = r"""#!/bin/bash
here=$(dirname "$0")
case "$1 ${2-}" in
    "-I -c") exit 0 ;;
    "-c "*) echo "$here/../site"; exit 0 ;;
    "-m cellmig.parallel.launch") exec "REAL" -P "$@" ;;
    "-m pip") echo "$*" >>"$here/../pip.log"; exit 0 ;;
esac
[[ ${LINGER-} ]] && { trap 'exit 75' USR1; echo up; for _ in {1..100}; do sleep 0.1; done; }
[[ ${OMPI_COMM_WORLD_RANK-0} == 0 ]] && echo "${CELLMIG_RANKS-${OMPI_COMM_WORLD_SIZE-1}}: $*"
[[ ${OMPI_COMM_WORLD_RANK-0} == 0 ]] || sleep 0.3  # the first that fails ends the others
exit "${CODE-0}"
""".replace("REAL", sys.executable)


class Launcher:
    """A copy of `run` in a directory of its own, with stand-ins for Python, dpkg, apt-get and id."""

    def __init__(self, directory: Path, environment: dict[str, str]) -> None:
        self.home, self.elsewhere, self.bin = (directory / name for name in ("the home", "elsewhere", "bin"))
        inside = ("cases", ".venv/bin", ".venv/site/pip")
        for path in (self.elsewhere, self.bin, *(self.home / name for name in inside)):
            path.mkdir(parents=True)
        shutil.copy(ROOT / "run", self.home)
        (self.home / "pyproject.toml").touch()
        (self.home / "cases/all_protrude.toml").touch()
        self.script(self.home / ".venv/bin/python", PYTHON)
        self.packages(missing=())
        self.environment = environment | {"PATH": f"{self.bin}:{environment['PATH']}"}

    @staticmethod
    def script(path: Path, text: str) -> None:
        """Write an executable."""
        path.write_text(text)
        path.chmod(0o755)

    def packages(self, missing: tuple[str, ...], user: int = 0) -> None:
        """Let dpkg know all packages but some, and `id` name the user."""
        names = "|".join(missing) or "none"
        self.script(self.bin / "dpkg-query", f"""#!/bin/bash
for name in "$@"; do case $name in -*|*'$'*|{names}) ;; *) echo "$name:installed" ;; esac; done\n""")
        self.script(self.bin / "apt-get", f'#!/bin/bash\necho "$*" >>"{self.bin}/apt.log"\n')
        self.script(self.bin / "id", f"#!/bin/bash\necho {user}\n")

    def command(self, *arguments: str, through: Path | None = None, **environment: str) -> dict:
        """What starts the launcher from elsewhere."""
        return {"args": [str(through or self.home / "run"), *arguments], "cwd": self.elsewhere, "text": True,
                "env": self.environment | environment, "stdin": subprocess.DEVNULL}

    def __call__(self, *arguments: str, **options: object) -> subprocess.CompletedProcess[str]:
        return subprocess.run(**self.command(*arguments, **options), capture_output=True, timeout=60)


@pytest.fixture
def launcher(tmp_path: Path, outside_mpi: dict[str, str]) -> Launcher:
    return Launcher(tmp_path, outside_mpi)


@pytest.fixture
def ready(launcher: Launcher) -> Launcher:
    """One that has been set up."""
    assert launcher("doctor").returncode == 0
    return launcher


@pytest.mark.parametrize("script", ["run", ".ci/run", ".ci/other-debian"])
def test_the_script_is_executable_and_bash_reads_it(script: str) -> None:
    assert (ROOT / script).stat().st_mode & 0o111
    assert subprocess.run(["bash", "-n", str(ROOT / script)]).returncode == 0


@pytest.mark.skipif(not shutil.which("shellcheck"), reason="no shellcheck here")
def test_shellcheck_has_nothing_to_say() -> None:
    scripts = [ROOT / name for name in ("run", ".ci/run", ".ci/other-debian")]
    found = subprocess.run(["shellcheck", *scripts], capture_output=True, text=True)
    assert found.returncode == 0, found.stdout


def test_help_explains_the_calls_and_sets_nothing_up(launcher: Launcher) -> None:
    told = launcher("--help")
    assert told.returncode == 0
    assert "./run test" in told.stdout and "exit codes" in told.stdout
    assert not (launcher.home / ".venv/stamp").exists()


CASE = "{home}/cases/all_protrude.toml"


@pytest.mark.parametrize(("call", "started"), [
    ([], f"2: -m cellmig {CASE}"),
    (["-n", "3"], f"3: -m cellmig {CASE}"),
    (["--until", "2 us"], f"2: -m cellmig {CASE} --until 2 us"),
    (["-n", "1", "own.toml", "-ts_dt", "1"], "1: -m cellmig own.toml -ts_dt 1"),
    (["cases/all_protrude.toml"], f"auto: -m cellmig {CASE}"),  # the program looks how large the case is
    (["nowhere.toml"], "auto: -m cellmig nowhere.toml"),
    (["resume", "output/x"], "auto: -m cellmig resume output/x"),
    (["own.toml", "-n", "2"], "2: -m cellmig own.toml"),
    (["-n", "2", "--quiet", "own.toml"], "2: -m cellmig --quiet own.toml"),
    (["own.toml", "-n", "4000"], "4000: -m cellmig own.toml"),
    (["--set", "seed=1"], f"2: -m cellmig {CASE} --set seed=1"),
    (["run", "own.toml"], "auto: -m cellmig run own.toml"),
    (["resume", "--help"], "auto: -m cellmig resume --help"),
    (["validate", "own.toml", "cases/all_protrude.toml"], f"1: -m cellmig validate own.toml {CASE}"),
    (["-n", "2", "info", "output/x"], "2: -m cellmig info output/x"),
])
def test_a_call_starts_the_program_on_its_ranks(ready: Launcher, call: list[str], started: str) -> None:
    (ready.elsewhere / "own.toml").touch()
    done = ready(*call)
    assert done.stdout.splitlines() == [started.format(home=ready.home)]
    assert (done.returncode, done.stderr) == (0, "")


def test_it_works_through_a_symbolic_link(ready: Launcher) -> None:
    link = ready.elsewhere / "go"
    link.symlink_to(ready.home / "run")
    assert ready("-n", "1", through=link).stdout == f"1: -m cellmig {CASE.format(home=ready.home)}\n"


@pytest.mark.parametrize("ranks", ["1", "3"])
@pytest.mark.parametrize("code", [2, 4, 75])
def test_the_exit_code_of_the_program_is_that_of_the_launcher(ready: Launcher, ranks: str, code: int) -> None:
    done = ready("-n", ranks, CODE=str(code))
    assert (done.returncode, done.stderr) == (code, "")


def test_a_wrong_number_of_ranks_is_a_wrong_call(launcher: Launcher) -> None:
    done = launcher("-n", "two")
    assert done.returncode == 2
    assert "'two'" in done.stderr


@pytest.mark.parametrize("request_", [signal.SIGTERM, signal.SIGUSR1, signal.SIGINT])
def test_a_request_to_stop_lets_every_rank_end_by_itself(ready: Launcher, request_: signal.Signals) -> None:
    # Tests that run in the background ignore SIGINT, and what they start inherits that.
    heed = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    with subprocess.Popen(**ready.command(LINGER="1"), stdout=subprocess.PIPE, preexec_fn=heed) as process:
        assert process.stdout
        assert [process.stdout.readline() for _ in range(2)] == ["up\n", "up\n"]
        process.send_signal(request_)
        assert process.wait(timeout=20) == 75


def test_set_up_happens_once_and_again_when_something_changed(launcher: Launcher) -> None:
    log, stamp = launcher.home / ".venv/pip.log", launcher.home / ".venv/stamp"
    for _ in range(2):
        assert launcher("doctor").returncode == 0
    assert len(log.read_text().splitlines()) == 1
    (launcher.home / "pyproject.toml").write_text("changed")
    assert launcher("doctor").returncode == 0
    assert len(log.read_text().splitlines()) == 2
    stamp.unlink()
    assert launcher("doctor").returncode == 0
    assert len(log.read_text().splitlines()) == 3


def test_set_up_asks_no_package_index(launcher: Launcher) -> None:
    launcher("doctor")
    asked = (launcher.home / ".venv/pip.log").read_text().split()
    assert {"--no-index", "--no-deps", "--no-build-isolation"} <= set(asked)


def test_root_gets_exactly_the_missing_packages(launcher: Launcher) -> None:
    launcher.packages(missing=("python3-pint", "gcc"))
    assert launcher("doctor").returncode == 0
    update, install = (launcher.bin / "apt.log").read_text().splitlines()
    assert update.endswith("update")
    assert install.endswith("install -y --no-install-recommends python3-pint gcc")


def test_others_are_told_the_missing_packages_and_the_command(launcher: Launcher) -> None:
    launcher.packages(missing=("python3-pint", "gcc"), user=1000)
    done = launcher("doctor")
    assert done.returncode == 3
    assert "missing: python3-pint gcc\n" in done.stderr
    assert "sudo apt-get update && sudo apt-get install" in done.stderr
    assert not (launcher.bin / "apt.log").exists()


def test_a_failed_installation_shows_why_and_exits_with_3(launcher: Launcher) -> None:
    launcher.packages(missing=("gcc",))
    launcher.script(launcher.bin / "apt-get", "#!/bin/bash\necho no route to host; exit 100\n")
    done = launcher("doctor")
    assert done.returncode == 3
    assert "no route to host" in done.stderr


@pytest.mark.parametrize(("serial", "parallel", "code"),
                         [(0, 0, 0), (1, 0, 1), (0, 1, 1), (0, 5, 0), (5, 0, 0), (5, 5, 5)])
def test_the_tests_fail_when_either_run_of_them_does(ready: Launcher, serial: int, parallel: int, code: int) -> None:
    python = PYTHON.replace('"${CODE-0}"', f"$([[ ${{OMPI_COMM_WORLD_SIZE-}} ]] && echo {parallel} || echo {serial})")
    ready.script(ready.home / ".venv/bin/python", python)
    done = ready("test", "-k", "word")
    one, three = done.stdout.splitlines()
    assert re.fullmatch(r"1: -m pytest -n \d+ --dist loadfile -k word", one) and three == "3: -m pytest -k word"
    assert done.returncode == code


# ----------------------------------------------------------------------------------------------- the tests on ranks

PROBE = """
import pytest

def test_one_rank_fails(comm):
    assert comm.rank != 1

def test_the_others_go_on(comm, shared_tmp):
    (shared_tmp / str(comm.rank)).touch()
    comm.barrier()
    assert len(list(shared_tmp.iterdir())) == comm.size

@pytest.mark.serial
def test_left_out_on_ranks():
    raise AssertionError

@pytest.mark.slow
def test_left_out_unless_asked_for():
    raise AssertionError
"""
HANG = """
def test_one_rank_fails_where_the_others_wait(comm):
    assert comm.rank != 1
    comm.barrier()
"""


@pytest.fixture
def probe(tmp_path: Path, on_ranks: Callable) -> Callable:
    """`probe(text)`: the tests in `text` under our conftest on 2 ranks."""

    def start(text: str) -> subprocess.CompletedProcess[str]:
        shutil.copy(ROOT / "tests/conftest.py", tmp_path)
        shutil.copy(ROOT / "pyproject.toml", tmp_path)
        (tmp_path / "test_probe.py").write_text(text)
        return on_ranks(2, "-m", "pytest", "--color=no", "test_probe.py", cwd=tmp_path, timeout=60,
                        env={"CELLMIG_TEST_PATIENCE": "1"})

    return start


def test_a_test_that_fails_on_one_rank_is_reported_once_and_the_rest_goes_on(probe: Callable) -> None:
    done = probe(PROBE)
    assert done.returncode == 1
    assert done.stdout.count("[rank 1 of 2]") == 1
    assert done.stdout.count("1 failed, 1 passed, 2 deselected") == 1


def test_a_rank_that_fails_where_the_others_wait_ends_the_run_with_its_message(probe: Callable) -> None:
    done = probe(HANG)
    assert done.returncode != 0
    assert "[rank 1 of 2] test_probe.py::test_one_rank_fails_where_the_others_wait failed here" in done.stderr
