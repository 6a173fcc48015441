"""The checklist of a release, run: `./run release`.  What is committed is built, checked, installed and tried.

The sdist and the wheel are left in `dist/`.  Each step is told with its time and exit code; the exit code is 1 if one
failed.  Tools for the checks come from the package index into an environment that is removed afterwards.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from cellmig.parallel.launch import on_ranks, outside_mpi
from cellmig.version import __version__

ROOT = Path(__file__).resolve().parents[1]
TOOLS = ("build", "twine", "cffconvert", "check-wheel-contents", "validate-pyproject", "py-rattler-build", "spython")
RECIPE = """import sys, rattler_build as r
recipe = r.Stage0Recipe.from_file(sys.argv[1])
print(*recipe.render(r.VariantConfig.from_yaml("python_min: ['3.11']"), r.RenderConfig()))"""
TESTS = ("tests/model", "tests/case", "tests/test_python.py")
CALLS = ("--version", "doctor", "cases", "cases all_protrude", "validate all_protrude.toml",
         "all_protrude.toml --until '20 us'", "info output/all_protrude", "plot output/all_protrude",
         "report output/all_protrude")


class Checklist:
    """Steps, each a command with a title; what they say is shown where they fail."""

    def __init__(self) -> None:
        self.environment = {key: value for key, value in outside_mpi().items() if not key.startswith("PYTHON")}

    def step(self, title: str, *command: str | Path, cwd: Path, expected: int = 0) -> bool:
        """Run a command in a folder; whether it ended with the expected exit code."""
        begin = time.monotonic()
        done = subprocess.run(list(map(str, command)), cwd=cwd, env=self.environment, encoding="utf-8",
                              errors="replace", stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        right, wall = done.returncode == expected, time.monotonic() - begin
        print(f"{'ok' if right else 'FAILED':<7}{wall:7.1f} s  exit {done.returncode:<3}  {title}", flush=True)
        if not right:
            print(done.stdout)
        return right


def release(scratch: Path) -> bool:
    """Run all steps in a scratch folder; whether none failed."""
    checks = Checklist()
    source, dist, tools = scratch / "source", ROOT / "dist", scratch / "tools/bin"
    shutil.rmtree(dist, ignore_errors=True)
    right = [
        checks.step("nothing is left to commit", "git", "diff", "--quiet", "HEAD", cwd=ROOT),
        checks.step("a clean copy of what is committed", "git", "clone", "--quiet", ROOT, source, cwd=scratch),
        checks.step("all papers tell one version; every file travels", sys.executable, "-m", "pytest", "-q",
                    "tests/test_package.py", cwd=ROOT),
        checks.step("tools for the checks", sys.executable, "-m", "venv", scratch / "tools", cwd=scratch)
        and checks.step("  their packages", tools / "python", "-m", "pip", "install", "--quiet", *TOOLS, cwd=scratch)]
    if not all(right):
        return False
    right = [checks.step("sdist and wheel", tools / "python", "-m", "build", "--outdir", dist, source, cwd=scratch)]
    wheel, sdist = (dist / f"cellmig-{__version__}{end}" for end in ("-py3-none-any.whl", ".tar.gz"))
    right += [
        checks.step("metadata of both", tools / "twine", "check", "--strict", wheel, sdist, cwd=scratch),
        checks.step("contents of the wheel", tools / "check-wheel-contents", wheel, cwd=scratch),
        checks.step("pyproject.toml", tools / "validate-pyproject", source / "pyproject.toml", cwd=scratch),
        checks.step("CITATION.cff", tools / "cffconvert", "--validate", "-i", source / "CITATION.cff", cwd=scratch),
        checks.step("recipe for conda-forge", tools / "python", "-c", RECIPE, source / "packaging/recipe.yaml",
                    cwd=scratch),
        checks.step("definition for Apptainer", tools / "spython", "recipe", "--parser", "singularity",
                    source / "cluster/cellmig.def", cwd=scratch)]
    return all(right) and installed(checks, scratch, wheel)


def installed(checks: Checklist, scratch: Path, wheel: Path) -> bool:
    """Install the wheel into an environment of its own, and try it in an empty folder."""
    home, here = scratch / "environment", scratch / "empty"
    here.mkdir()
    program = home / "bin/cellmig"
    checks.environment["PATH"] = f"{home / 'bin'}{os.pathsep}{os.environ['PATH']}"
    right = [checks.step("an environment over the system's packages", "/usr/bin/python3", "-m", "venv",
                         "--system-site-packages", home, cwd=here),
             checks.step("pip install --no-deps cellmig", home / "bin/pip", "install", "--quiet", "--no-deps", wheel,
                         cwd=here)]
    for words in CALLS:
        right.append(checks.step(f"cellmig {words}", program, *shlex.split(words), cwd=here))
    run = on_ranks(2, [str(program), "all_protrude.toml", "--until", "20 us", "--out", "output/two"])
    right += [checks.step("the same on two ranks", *run, cwd=here),
              checks.step("has the same bits", program, "diff", "output/all_protrude", "output/two", cwd=here),
              checks.step("a case that is wrong is refused", program, "validate", "all_protrude.toml", "--set",
                          "time.ends=1", cwd=here, expected=2)]
    for name in ("tests", "cases", "examples", "docs"):
        shutil.copytree(scratch / "source" / name, here / name)
    shutil.copy(scratch / "source/pyproject.toml", here)
    right.append(checks.step(f"{' '.join(TESTS)} against what is installed", home / "bin/python", "-m", "pytest", "-q",
                             *TESTS, cwd=here))
    return all(right)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        whole = release(Path(place))
    print("\nall steps are done; the files are in dist/" if whole else "\na step failed")
    sys.exit(0 if whole else 1)
