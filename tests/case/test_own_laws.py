"""Laws from files of one's own: found by all ranks, resumed, swept, kept with their hash, refused with their line."""

from __future__ import annotations

import hashlib
import pickle
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scenes import CASES, ROOT

from cellmig.case import own_laws, registry
from cellmig.case.handbook import handbook
from cellmig.case.json_schema import json_schema
from cellmig.output.manifest import read_manifest
from cellmig.output.tables import read_table

pytestmark = pytest.mark.serial

LAW = ROOT / "examples/cortex_law.py"
CORTEX = 'cortex={law="stiffening", modulus="500 pN/um", rate=2}'
SHORT = ("--set", "particles.per_cell=60", "--set", "time.samples=4", "--set", "time.frames=1", "--until", "0.4 us",
         "--set", CORTEX)
RUN = (CASES["one_cell"], *SHORT)

Ended = subprocess.CompletedProcess


@pytest.fixture(scope="module")
def done(cellmig: Callable[..., Ended], tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """Runs with the law of the example on one rank and on two."""
    home = tmp_path_factory.mktemp("own")
    for ranks in (1, 2):
        ended = cellmig(ranks, *RUN, "--law", LAW, "--out", home / str(ranks), "--quiet")
        assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")
    return {ranks: home / str(ranks) for ranks in (1, 2)}


def test_a_law_in_a_file_acts_on_all_ranks_and_is_kept_with_its_hash(done: dict[int, Path]) -> None:
    manifests = [read_manifest(done[ranks]) for ranks in (1, 2)]
    assert manifests[0]["state_hash"] == manifests[1]["state_hash"]
    assert manifests[0]["laws"] == [{"file": str(LAW), "sha256": hashlib.sha256(LAW.read_bytes()).hexdigest()}]
    assert read_table(done[1] / "ledger.csv")["energy_error"].max() < 0.01  # so that its tension is that of its energy


def test_a_run_with_a_law_of_ones_own_goes_on_and_can_be_looked_at(cellmig: Callable[..., Ended], done: dict[int, Path],
                                                                  tmp_path: Path) -> None:
    law = tmp_path / "law.py"
    law.write_bytes(LAW.read_bytes())
    run = tmp_path / "run"
    stopped = cellmig(1, *RUN, "--law", law, "--out", run, "--quiet", "--wall-time", "1 s")
    assert stopped.returncode == 75, stopped
    moved = law.rename(tmp_path / "moved.py")
    missing = cellmig(1, "resume", run)
    assert missing.returncode == 2 and "law.py' cannot be read: No such file" in missing.stderr
    law.write_text(LAW.read_text(encoding="utf-8") + "# changed\n", encoding="utf-8")
    changed = cellmig(1, "resume", run)
    assert changed.returncode == 2 and "law.py' is not what it was in the run that is there" in changed.stderr
    resumed = cellmig(2, "resume", run, "--law", moved, "--quiet")
    assert (resumed.returncode, resumed.stderr) == (0, "")
    assert read_manifest(run)["state_hash"] == read_manifest(done[1])["state_hash"]
    looked = cellmig(1, "info", done[1])
    assert (looked.returncode, looked.stderr) == (0, "")


@pytest.mark.slow
def test_a_sweep_takes_a_law_to_all_its_runs(cellmig: Callable[..., Ended], tmp_path: Path) -> None:
    words = ("sweep", *RUN[:-4], "--set", "time.end=0.2 us", "--set", CORTEX, "--law", LAW, "--vary",
             "cortex.rate=200.0", "--out", tmp_path / "sweep")
    kept = []
    for _ in range(2):
        swept = cellmig(1, *words)
        assert swept.returncode == 0, swept
        (run,) = (tmp_path / "sweep/runs").iterdir()
        kept.append(read_manifest(run))
    assert kept[0]["case"]["cortex"]["rate"] == 200.0 and kept[0]["laws"][0]["file"] == str(LAW)
    assert kept[0]["run_id"] == kept[1]["run_id"]  # done already


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Laws that a test registers are forgotten after it."""
    monkeypatch.setattr(registry, "_LAWS", {kind: dict(registry.laws(kind)) for kind in registry.kinds()})
    monkeypatch.setattr(own_laws, "_included", {})


def test_the_law_of_the_example_is_in_the_schema_and_the_derivative_of_its_energy(registered: None) -> None:
    own_laws.include(LAW)
    own_laws.include(LAW)  # twice is once
    known = json_schema()["properties"]["cortex"]["properties"]["law"]["enum"]
    assert known == ["elastic", "line-tension", "stiffening"]
    assert "### cortex: `stiffening`" in handbook()
    cortex, s, h = registry.laws("cortex")["stiffening"](modulus=50.0, rate=2.0), np.linspace(0.6, 2.0, 15), 1e-5
    slope = (cortex.energy(s + h) - cortex.energy(s - h)) / (2 * h)
    assert np.abs(slope - cortex.tension(s)).max() < 1e-8 * np.abs(slope).max()  # measured 2e-10
    assert pickle.loads(pickle.dumps(cortex)) == cortex


HEAD = "from numpy import exp\nfrom cellmig.case.registry import law, quantity\n"
BODY = '    rate: float = quantity("", "rate")\n    def energy(self, stretch):\n        return {}\n' \
       "    def tension(self, stretch):\n        return {}\n"


@pytest.mark.parametrize(("text", "message"), [
    ("x = (1\n", "law.py:1: not Python: '(' was never closed"),
    ("import nothing_there\n", "law.py:1: ModuleNotFoundError"),
    (HEAD + "1 / 0\n", "law.py:3: ZeroDivisionError: division by zero"), (HEAD, "law.py' has no law"),
    (HEAD + '@law("history", "own")\nclass Own:\n    """Own."""\n',
     "the kind of law 'history' is called 'load_curve' now"),
    (HEAD + '@law("cortx", "own")\nclass Own:\n    """Own."""\n', "no kind of law 'cortx'; did you mean 'cortex'?"),
    (HEAD + '@law("cortex", "line-tension")\nclass Own:\n    """Own."""\n' + BODY.format("1.0", "1.0"),
     "there is a law 'line-tension' of the kind 'cortex' already"),
    (HEAD + '@law("cortex", "stiffening")\nclass Own:\n    """Own."""\n    energy = 1.0\n',
     "lacks what a law of the kind 'cortex' has: tension"),
    ("import sys\nsys.exit(3)\n", "law.py:2: SystemExit: 3"), (None, "law.py' cannot be read: No such file"),
])
def test_a_file_of_laws_that_cannot_be_used_is_told_with_its_line(registered: None, tmp_path: Path, text: str | None,
                                                                 message: str) -> None:
    if text is not None:
        (tmp_path / "law.py").write_text(text, encoding="utf-8")
    with pytest.raises(own_laws.LawFileError) as error:
        own_laws.include(tmp_path / "law.py")
    assert message in str(error.value)
    assert sorted(registry.laws("cortex")) == ["elastic", "line-tension"] and not own_laws.included()


def test_a_formula_of_ones_own_that_is_not_translated_ends_all_ranks_with_its_line(cellmig: Callable[..., Ended],
                                                                                  tmp_path: Path) -> None:
    (tmp_path / "law.py").write_text(LAW.read_text(encoding="utf-8").replace("* exp(", "* exp2("), encoding="utf-8")
    ended = cellmig(2, *RUN, "--law", tmp_path / "law.py", "--out", tmp_path / "run", "--quiet")
    line = 1 + LAW.read_text(encoding="utf-8").splitlines().index(
        "        return self.modulus * s * exp(self.rate * s * s)")
    assert ended.returncode == 2 and "Traceback" not in ended.stderr
    assert f"law.py:{line}: Stiffening.tension: 'return self.modulus * s * exp2(self.rate * s * s)' is not " \
           "translated to C: name 'exp2' is not defined" in ended.stderr
