"""Pairs of cells with adhesion of their own: which they are, what they take over, what is told if they are wrong."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
from scenes import CASES, case

from cellmig.case.json_schema import json_schema
from cellmig.case.load import change, from_dict, load
from cellmig.case.messages import CaseError
from cellmig.case.pairs import MOST_KINDS, paired
from cellmig.case.registry import laws
from cellmig.case.schema import Pair

pytestmark = pytest.mark.serial

ROW = 'cells.0.repeat=[6]'
A_LAW = laws("adhesion")["seifert"](bond_density=1.0, well_depth=1.0, equilibrium_distance=0.01)


def pairs(*tables: str) -> str:
    """A change of a case: its exceptions."""
    return f"adhesion.pairs=[{', '.join(f'{{{table}}}' for table in tables)}]"


def wrong(*tables: str) -> list[str]:
    """What is wrong with the exceptions of the paper's three cells."""
    with pytest.raises(CaseError) as caught:
        case("paper", pairs(*tables))
    return [str(m).partition("]: ")[2] for m in caught.value.mistakes]


def test_a_pair_differs_from_all_others_in_the_keys_that_it_gives() -> None:
    found = case("paper", pairs('cells = ["Cell-1", "Cell-2"], bond_density = "0 /um^2"'))
    pair, = found.pairs
    assert pair.cells == (("Cell-1",), ("Cell-2",))
    assert (pair.law.bond_density, pair.law.well_depth, pair.law.cutoff) == (0.0, 0.024, 0.5)
    assert found.contact.bond_density == 1000.0


def test_a_law_of_another_kind_takes_nothing_over(monkeypatch: pytest.MonkeyPatch) -> None:
    class Hook(type(A_LAW)):
        """Another law with the same keys."""

    from cellmig.case import registry
    monkeypatch.setattr(registry, "_LAWS", {kind: dict(known) for kind, known in registry._LAWS.items()})
    registry.law("adhesion", "hook")(Hook)
    told = wrong('cells = ["Cell-1", "Cell-2"], law = "hook", well_depth = "1 pN um"')
    assert [text.partition(":")[0] for text in told] == [f"adhesion.pairs.0.{key}" for key in
                                                         ("bond_density", "equilibrium_distance")]


def test_without_adhesion_of_all_a_pair_needs_a_whole_law() -> None:
    tree = case("paper").resolved()
    del tree["adhesion"]["cells"]
    tree["adhesion"]["pairs"] = [{"cells": ["Cell-1", "Cell-2"], "bond_density": "1000 /um^2"}]
    with pytest.raises(CaseError) as caught:
        from_dict(tree)
    assert [m.key.rpartition(".")[2] for m in caught.value.mistakes] == ["well_depth", "equilibrium_distance"]
    tree["adhesion"]["pairs"][0] |= {"well_depth": "0.024 pN um", "equilibrium_distance": "10 nm"}
    found = from_dict(tree)
    assert found.contact is None and found.pairs[0].law.work == pytest.approx(24.0)


@pytest.mark.parametrize(("cells", "named"), [
    ('"Cell-1", "Cell-2"', {(1, 2)}), ('"Cell-2", "Cell-2"', {(2, 2)}),
    ('"Cell-{}", "Cell-{}"', set(itertools.combinations(range(1, 7), 2))),
    ('"Cell-{}", "Cell-2"', {(1, 2), (2, 3), (2, 4), (2, 5), (2, 6)}),
    ('["Cell-1", "Cell-4"], ["Cell-4", "Cell-5"]', {(1, 4), (1, 5), (4, 5)})])
def test_names_stand_for_cells_for_copies_and_for_lists_of_them(cells: str, named: set) -> None:
    found = case("paper", ROW, pairs(f"cells = [{cells}]"))
    pairing, twice = paired([c.name for c in found.cells], found.pairs)
    a, b = np.array([(i, j) for i in range(6) for j in range(6)]).T
    of = pairing.of(a, b)
    assert not twice and (of == pairing.of(b, a)).all()
    assert {(i + 1, j + 1) for i, j, n in zip(a, b, of, strict=True) if n == 0 and i <= j} == named


def test_a_table_of_cells_is_named_wherever_cells_are() -> None:
    assert case("paper", 'protrusion.cells=["Cell-{}"]').protrusion.cells == ("Cell-1", "Cell-2", "Cell-3")


def test_a_case_with_pairs_written_and_read_is_the_same_and_follows_a_change_of_all() -> None:
    found = load(CASES["colony"])
    again = from_dict(json.loads(json.dumps(found.resolved())))
    assert again == found
    deeper = change(again, {"adhesion.cells.well_depth": "0.05 pN um"})
    assert (deeper.contact.work, deeper.pairs[0].law.work) == pytest.approx((50.0, 5.0))


@pytest.mark.parametrize(("tables", "told"), [
    (['cells = ["Cell-1", "Cel-2"]'], ["adhesion.pairs.0.cells: no cell 'Cel-2'; did you mean 'Cell-2'?"]),
    (['cells = ["Cell-1", "Cell-2"], energy = "1 pN um", bond_densty = "1 /um^2"'],
     ["adhesion.pairs.0.energy: is called 'well_depth' now",
      "adhesion.pairs.0.bond_densty: no such key; did you mean 'bond_density'?"]),
    (['cells = ["Cell-1"]'],
     ["adhesion.pairs.0.cells: expects a list such as [\"Cell-1\", \"Cell-2\"], not ['Cell-1']"]),
    (['cells = ["Cell-1", []]'], ["adhesion.pairs.0.cells: names no cell on one side"]),
    (['bond_density = "0 /um^2"'], ["adhesion.pairs.0.cells: missing: which cells with which, each a name or a list of "
                                    'names, such as cells = ["Cell-1", "Cell-2"]']),
    (['cells = ["Cell-1", "Cell-2"]', 'cells = ["Cell-{}", "Cell-{}"]', 'cells = ["Cell-3", "Cell-3"]'],
     ["adhesion.pairs.1.cells: 'Cell-1' and 'Cell-2' are named before, in adhesion.pairs.0"]),
    (['cells = ["Cell-3", "Cell-3"]', 'cells = ["Cell-3", "Cell-3"]'],
     ["adhesion.pairs.1.cells: 'Cell-3' and 'Cell-3' are named before, in adhesion.pairs.0"]),
    (['cells = ["Cell-1", "Cell-2"], cutoff = "1 nm"'],
     ["adhesion.pairs.0.equilibrium_distance: 0.01 um is above cutoff = 0.001 um: beyond the cutoff there would "
      "be no bond at its equilibrium"]),
    (["cells = 3", 'cells = [1, 2], law = "seifrt"'],
     ['adhesion.pairs.0.cells: expects a list such as ["Cell-1", "Cell-2"], not 3',
      "adhesion.pairs.1.cells: expects text in quotes, not 1",
      "adhesion.pairs.1.law: no adhesion law 'seifrt'; did you mean 'seifert'?"])])
def test_all_that_is_wrong_with_pairs_is_told_at_once(tables: list, told: list) -> None:
    assert sorted(wrong(*tables)) == sorted(told)


def test_a_mistake_has_its_line_and_one_in_the_law_of_all_is_told_once(tmp_path) -> None:
    path = tmp_path / "case.toml"
    path.write_text(f'extends = "{CASES["paper"]}"\n[adhesion.cells]\nwell_depth = "1 kg"\n\n[[adhesion.pairs]]\n'
                    'cells = ["Cell-1", "Cell-2"]\n[[adhesion.pairs]]\ncells = ["Cell-1", "Cell-9"]\n')
    with pytest.raises(CaseError) as caught:
        load(path)
    assert [(m.line, m.key) for m in caught.value.mistakes] == [(3, "adhesion.cells.well_depth"),
                                                                (8, "adhesion.pairs.1.cells")]


def test_pairs_that_tell_too_many_cells_apart_are_refused() -> None:
    names = [f"c{n}" for n in range(MOST_KINDS)]
    with pytest.raises(ValueError, match=f"tell {MOST_KINDS + 1} kinds of cells apart"):
        paired([*names, "other"], [Pair(cells=((name,), (name,)), law=A_LAW) for name in names])


def test_the_kinds_of_many_cells_are_few() -> None:
    red, blue = (tuple(f"{kind}-{n}" for n in range(50_000)) for kind in ("Red", "Blue"))
    pairing, twice = paired(red + blue, [Pair(cells=(red, blue), law=A_LAW)])
    assert pairing.between.tolist() == [[-1, 0], [0, -1]] and not twice


def test_editors_know_the_keys_of_pairs() -> None:
    item = json_schema()["properties"]["adhesion"]["properties"]["pairs"]["items"]["anyOf"][0]
    assert set(item["properties"]) >= {"cells", "law", "bond_density", "cutoff"}
    assert item["properties"]["cells"]["minItems"] == 2 and item["additionalProperties"] is False
