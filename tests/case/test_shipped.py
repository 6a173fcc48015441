"""The cases and examples that come with cellmig: listed, copied with what they need, never over another file."""

from __future__ import annotations

from pathlib import Path

import pytest

from cellmig.case.load import load
from cellmig.case.messages import CaseError
from cellmig.case.shipped import FOLDER, copy, listing, names
from cellmig.commands import cases
from cellmig.laws import register
from cellmig.usage import UsageError, parse

pytestmark = pytest.mark.serial


@pytest.mark.parametrize("name", names())
def test_a_copy_is_all_that_a_case_needs(name: str, tmp_path: Path) -> None:
    copies = copy([name], tmp_path / "here")
    assert Path(name).stem == copies[0].stem and set(copies) == set((tmp_path / "here").iterdir())
    if copies[0].suffix == ".toml":
        register()
        load(copies[0])


def test_each_case_and_example_has_a_line_of_its_own() -> None:
    lines = [line.split(maxsplit=1) for line in listing().splitlines()]
    told = {words[0]: words[1] for words in lines if len(words) == 2}
    assert all(len(told[name]) > 10 for name in names())
    assert set(names()) >= {path.stem for path in FOLDER.glob("*.toml")} | {"first_look.py", "tour.ipynb"}


def test_a_file_that_is_another_is_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    (tmp_path / "paper.toml").write_text("title = 'mine'\n")
    with pytest.raises(UsageError, match=r"paper\.toml: there already, and not the same"):
        cases(parse(["cases", "all_protrude", "--to", str(tmp_path)]))
    assert [path.name for path in tmp_path.iterdir()] == ["paper.toml"]
    for _ in range(2):  # what is the same is left as it is
        assert cases(parse(["cases", "all_protrude", "two_three.toml", "--to", str(tmp_path / "new")])) == 0
    assert capsys.readouterr().out.split() == [str(tmp_path / "new" / f"{name}.toml")
                                               for name in ("all_protrude", "paper", "two_three")] * 2


def test_a_link_is_not_written_through_and_a_file_is_no_folder(tmp_path: Path) -> None:
    (tmp_path / "one_cell.toml").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(UsageError, match=r"one_cell\.toml: there already"):
        cases(parse(["cases", "one_cell", "--to", str(tmp_path)]))
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match=r"'.*file' is not a folder"):
        cases(parse(["cases", "one_cell", "--to", str(tmp_path / "file")]))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "one_cell.toml"]


def test_a_name_that_is_none_gets_the_nearest_one(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="did you mean 'nucleus'"):
        cases(parse(["cases", "nucleos", "--to", str(tmp_path)]))


@pytest.mark.parametrize(("words", "said"), [
    ([], "'cellmig cases' lists the cases to begin with"),
    (["two_three"], "'cellmig cases two_three' copies the case of this name to here"),
    (["mine"], "did you mean 'mine.toml'"),
])
def test_who_begins_without_a_case_file_is_told_where_to_get_one(words: list[str], said: str, tmp_path: Path,
                                                                  monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.toml").touch()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=said):
        parse(words)


@pytest.mark.parametrize("file", ["nucleus.toml", "nucleus"])
def test_a_case_that_is_not_here_but_comes_with_cellmig_is_told_of(file: str, tmp_path: Path) -> None:
    with pytest.raises(CaseError, match="no such file; 'cellmig cases nucleus' copies it to here"):
        load(tmp_path / file)
