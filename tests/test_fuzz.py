"""Thousands of mutated cases, meshes, tables of points and command lines: an error that says what, or a valid case."""

from __future__ import annotations

import contextlib
import io
import os
import random
import shutil
import signal
import sys
import time
import traceback
import tracemalloc
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from scenes import CASES

from cellmig.__main__ import main
from cellmig.case.load import load
from cellmig.case.messages import CaseError
from cellmig.case.schema import particle_count
from cellmig.meshfree.terms import find_terms
from cellmig.solve.start import discretise
from cellmig.usage import UsageError, parse

pytestmark = [pytest.mark.serial, pytest.mark.slow]

ROUNDS = int(os.environ.get("CELLMIG_FUZZ", 10_000))
SEED = int(os.environ.get("CELLMIG_FUZZ_SEED", 1))
SECONDS, LARGEST = 20, 400  # for one case;  particles of a scene that is discretised
OF_CASES = {"mesh": "cell.msh", "outline": "outline.csv", "surface": "cell_surface.stl",
            "tissue": "tissue.csv"}  # files that cases read
VALUES = """0 -1 1 7 91 1e308 -1e308 1e-320 nan inf -inf true "" "auto" "free" [] {} [[]] [1,2,3] 9223372036854775807
99999999999999999999999 "1 um" "-1 um" "0 um" "1e300 m" "1 us" "1e9 us" "1e-9 us" "1 Pa" "1 pN/um" "nan um" "5 furlong"
"1 um^99" "x um" "x**x um" "1/x um" "0.1*x um" "sqrt(-x) um" "exp(1000*x) um" "x**999999999 um" "9**9**9**9*x um"
"__import__('os').system('touch broken') um" "x.__class__ um" "(lambda: x)() um" "[x for x in y] um" "µm" "1 µm" 'é"'
["1 um","2 um"] [["1 um","2 um"]] [["0 um","0 um"],["1 um","0 um"],["0 um","1 um"]] [["0 um","0 um"],["0 um","0 um"]]
"nucleus" "cytoplasm" "Cell-1" ["Cell-1"] ["Cell-9"] [1000000] [3] [2,2] 1979-05-27 07:32:00 1979-05-27T07:32:00Z 0x7f
"../../../etc/passwd" "/etc/passwd" "/dev/zero" "/dev/stdin" "." "cell.msh" "outline.csv" "paper.toml" "leapfrog" "rk"
"static" "beuler" "disc" "ellipse" "rectangle" "polygon" "mesh" "nematic" "mooney-rivlin" "seifert" "ramp" "sine"
"relaxing" "frozen" "radial" "surface" "left" ["left"] ["surface"] 0.5 2.2 1e6 100000000""".split()
LINES = ["[[cells]]", "[cells]", "[adhesion.cells]", "[[adhesion.pairs]]", "[director]", "[time]", "[[loads]]",
         "[[supports]]", "[[plates]]", "[[probes]]", "[particles]", "[materials.nucleus]", "[cortex]", "[friction]",
         "[medium]", 'extends = "paper.toml"',
         'cells = ["Cell-1", "Cell-2"]', 'cells = [["Cell-{}"], "Cell-1"]', 'name = "x"', 'parts = ["surface"]',
         'traction = ["0 Pa", "1 Pa"]', 'pressure = "1 kPa"', "holes = [[", "}",
         'load_curve = { law = "sine", period = "1 us" }', 'holes = [["0 um", "0 um", "0.2 um"]]', "a = {b = {c = {}}}",
         'cutouts = [[["0 um", "0 um"], ["1 um", "0 um"], ["0 um", "1 um"]]]', "[" * 2000, "x = " + "[" * 500]


def mutated(text: str, chance: random.Random) -> str:
    """A case with some of its lines, keys, values or characters changed."""
    lines = text.splitlines()
    for _ in range(chance.choice([1, 1, 1, 2, 3, 8])):
        i = chance.randrange(len(lines)) if lines else 0
        way = chance.randrange(9)
        if not lines or way == 0:
            lines.insert(i, chance.choice(LINES))
        elif way == 1:
            del lines[i]
        elif way == 2:
            lines.insert(i, chance.choice(lines))
        elif way == 3:
            j = chance.randrange(len(lines))
            lines[i], lines[j] = lines[j], lines[i]
        elif way == 4 and lines[i]:
            k = chance.randrange(len(lines[i]))
            lines[i] = lines[i][:k] + chance.choice('"\'[]{}=,.#\\\0\t\n0e-é漢' + lines[i][k] * 3) + lines[i][k + 1:]
        elif way == 5 and "=" in lines[i]:
            key, _, value = lines[i].partition("=")
            lines[i] = f"{key[:-2]} = {value}"
        elif "=" in lines[i]:
            lines[i] = f"{lines[i].partition('=')[0]} = {chance.choice(VALUES)}"
    return "\n".join(lines)


def broken_bytes(content: bytes, chance: random.Random) -> bytes:
    """A file with bytes changed, cut, or doubled."""
    data = bytearray(content)
    for _ in range(chance.choice([1, 1, 3, 20])):
        i = chance.randrange(len(data)) if data else 0
        way = chance.randrange(4)
        if way == 0 and data:
            data[i] = chance.randrange(256)
        elif way == 1:
            del data[i : i + chance.choice([1, 5, 300, 10_000])]
        elif way == 2:
            data[i:i] = data[i : i + chance.choice([1, 5, 300])]
        else:
            data[i:i] = chance.choice([b"-", b"nan", b"1e999", b",", b"\n", b"\0", b"9" * 30, "é".encode()])
    return bytes(data)


class LateError(BaseException):
    """Nobody catches it by mistake."""


@contextlib.contextmanager
def in_time() -> Iterator[None]:
    """A case that takes too long is an error."""

    def late(*_: object) -> None:
        raise LateError(f"more than {SECONDS} s")

    old = signal.signal(signal.SIGALRM, late)
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, old)


def outcome(path: Path, sets: list[str]) -> str:
    """What becomes of a case: "error", "valid", "refused" when particles are laid out, "built"; else it raises."""
    try:
        case = load(path, sets)
    except CaseError as error:
        assert str(error).strip() and "Traceback" not in str(error) and error.mistakes
        return "error"
    if sum(particle_count(case, cell.shape) for cell in case.cells) > LARGEST:
        return "valid"
    try:
        discretise(case)
        find_terms(case)
    except CaseError as error:
        assert str(error).strip()
        return "refused"
    return "built"


@pytest.mark.timeout(0)
def test_a_mutated_case_is_valid_or_says_what_is_wrong(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    chance, found, bad, slowest, most = random.Random(SEED), Counter(), [], (0.0, ""), (0, "")
    for path in CASES["paper"].parent.iterdir():
        shutil.copy(path, tmp_path)
    originals = {name: (tmp_path / name).read_bytes() for name in OF_CASES.values()}
    listed = sorted(path.name for path in tmp_path.iterdir())
    tracemalloc.start()
    for number in range(ROUNDS):
        name = chance.choice(sorted(CASES))
        text, sets = CASES[name].read_text(), ["particles.per_cell=60"] * (chance.random() < 0.5)
        for other, content in originals.items():
            changed = other == OF_CASES.get(name) and chance.random() < 0.7
            (tmp_path / other).write_bytes(broken_bytes(content, chance) if changed else content)
        if chance.random() < 0.15:
            key = chance.choice(["time.end", "cells.0.radius", "cells.Cell-1.centre", "seed", "a..b", "", "=", "x",
                                 "particles", "cells", "materials.cytoplasm.eta", "extends", "time.step"])
            sets.append(f"{key}={chance.choice(VALUES)}")
        elif chance.random() < 0.85 or name not in OF_CASES:
            text = mutated(text, chance)
        case = tmp_path / f"{name}.toml"
        case.write_bytes(text.encode() if chance.random() < 0.97 else broken_bytes(text.encode(), chance))
        begin = time.monotonic()
        tracemalloc.reset_peak()
        try:
            with in_time(), warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()) as said:
                warnings.simplefilter("error")
                what = outcome(case, sets)
            assert not said.getvalue()
            found[what] += 1
        except (Exception, LateError) as error:
            found["anything else"] += 1
            last = traceback.extract_tb(error.__traceback__)[-1]
            bad.append((f"{type(error).__name__}: {error}"[:150], f"{Path(last.filename).name}:{last.lineno}", number))
            shutil.copy(case, case.with_name(f"bad-{number}"))
            Path(f"bad-{number}").rename(tmp_path.parent / f"bad-{number}.toml")
            with open(tmp_path.parent / f"bad-{number}.txt", "w") as file:
                file.write(f"{name} {sets}\n{traceback.format_exc()}")
            for other in originals:
                shutil.copy(tmp_path / other, tmp_path.parent / f"bad-{number}-{other}")
        slowest = max(slowest, (time.monotonic() - begin, f"{number} {name}"))
        most = max(most, (tracemalloc.get_traced_memory()[1], f"{number} {name}"))
        case.write_bytes(CASES[name].read_bytes())
    tracemalloc.stop()
    print(f"\n{ROUNDS} cases: {dict(found)}; slowest {slowest[0]:.1f} s ({slowest[1]}), memory "
          f"{most[0] / 1e6:.0f} MB ({most[1]})")
    print("\n".join(map(str, bad[:60])))
    assert sorted(path.name for path in tmp_path.iterdir()) == listed, "a case wrote a file"
    assert not bad


WORDS = ["run", "resume", "validate", "info", "diff", "plot", "schema", "doctor", "paper", "verify", "bench", "x.toml",
         "nothing", "", "-", "--", "--out", "--until", "1 us", "40", "--set", "a.b=1", "=", "--no-prune", "--quiet",
         "-h", "--help", "--version", "--resume", "auto", "--wall-time", "2 h", "-1 h",
         "--checkpoint-wall", "--seed", "-3",
         "--seeds", "0", "1e9", "--jobs", "--only", "R1,R9", "--times", "--tolerance", "nan", "é", "\udcff", "--quick",
         "-ts_type", "rk", "-ts_dt", "--accuracy", "5%", "200%", "--modulus", "--error", "--stress", "/dev/null", "."]


def test_a_mutated_command_line_is_understood_or_refused():
    chance, found, bad = random.Random(SEED), Counter(), []
    for _ in range(ROUNDS):
        words = [chance.choice(WORDS) for _ in range(chance.randrange(1, 7))]
        try:
            with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
                parse(words)
            found["understood"] += 1
        except UsageError as error:
            assert str(error)
            found["refused"] += 1
        except SystemExit as end:
            assert end.code == 0
            found["help"] += 1
        except Exception as error:
            bad.append((words, repr(error)))
    print(f"\n{ROUNDS} command lines: {dict(found)}; anything else: {bad[:20]}")
    assert not bad


def test_a_mutated_command_line_of_what_only_looks_ends_with_a_code_of_the_contract(tmp_path, monkeypatch, capsys):
    """Commands that read a run, on directories that are none."""
    monkeypatch.chdir(tmp_path)
    chance, codes, bad = random.Random(SEED), Counter(), []
    manifests = {"a": "{}", "b": '{"case": 3}', "c": "[]", "d": "rubbish", "e": '{"exit_status": 0}'}
    for name, content in manifests.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "manifest.json").write_text(content)
    for _ in range(max(20, ROUNDS // 10)):
        for name in manifests:
            tables = [b"", b"x", b"time_us,cell\n1,\n", b"\xff\n", b",,\n", b"time_us,cell\n1,2\n", b"time_us\nnan\n"]
            (tmp_path / name / "history.csv").write_bytes(chance.choice(tables))
            (tmp_path / name / "ledger.csv").write_bytes(chance.choice(tables))
            indices = [b"", b"<x/>", b"<Xdmf><Domain>", b"\xff", b"<Xdmf><Domain><Grid><Grid/></Grid></Domain></Xdmf>"]
            (tmp_path / name / "cells.xdmf").write_bytes(chance.choice(indices))
        command = chance.choice(["info", "diff", "plot", "validate", "resume"])
        words = [command, *chance.choices([*"abcde", "nothing"], k=2 if command == "diff" else 1)]
        monkeypatch.setattr(sys, "argv", ["cellmig", *words])
        with pytest.raises(SystemExit) as end:
            main()
        said = capsys.readouterr().err
        if end.value.code not in (0, 1, 2, 5) or "Traceback" in said:
            bad.append((sys.argv[1:], said.strip().splitlines()[-4:]))
        codes[end.value.code] += 1
    print(f"\n{sum(codes.values())} calls on what is no run, by exit code: {dict(codes)}; anything else: {len(bad)}")
    print("\n".join(map(str, bad[:30])))
    assert not bad
