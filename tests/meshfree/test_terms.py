"""The terms of a scene: which laws of contact its pairs of cells have, and whether a cell can meet itself."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import CASES, case

from cellmig.case.load import change, from_dict, load
from cellmig.meshfree.terms import find_terms
from cellmig.model.seifert import WALL, BetweenCells

pytestmark = pytest.mark.serial

ITSELF = "contact of a cell with itself"
SOLIDS, LIPS = "solids of convex outline", "on a substrate only if a pair names it"


def of(name: str, *sets: str):
    """Terms of a case with changes."""
    return find_terms(case(name, *sets))


def test_every_pair_of_cells_has_its_law_in_either_order_and_a_cell_with_itself_repels() -> None:
    found = case("paper", "adhesion.substrate.attraction=0", 'adhesion.pairs=['
                 '{cells = ["Cell-1", "Cell-2"], bond_density = "0 /um^2"}, '
                 '{cells = ["Cell-2", "Cell-3"], equilibrium_distance = "20 nm"}]')
    terms = find_terms(found)
    contacts = terms.contacts
    a, b = np.indices((3, 3))
    number = contacts.of_pair(a, b)
    assert (number == number.T).all() and contacts.own
    laws = [[contacts.laws[n] for n in row] for row in number]
    assert laws[0][2] == terms.contact == BetweenCells.of(found.contact)
    assert (laws[0][1].work, laws[0][1].bond_density * laws[0][1].well_depth) == (0.0, pytest.approx(WALL))
    assert laws[1][2].equilibrium_distance == 0.02
    for n in range(3):
        own = laws[n][n]
        assert (own.attraction, own.equilibrium_distance) == (0.0, 0.01)
        assert own.potential(np.array([0.01, 0.02])) == pytest.approx([0.0, 0.0], abs=1e-12)
        assert own.slope(0.009) < 0.0
    assert len(contacts.laws) == 4  # each once


def test_a_cell_that_is_named_with_itself_has_the_distance_of_that_law_and_repels() -> None:
    contacts = of("paper", 'adhesion.pairs=[{cells = ["Cell-2", "Cell-2"], equilibrium_distance = "30 nm"}]').contacts
    own = [contacts.laws[contacts.of_pair(n, n)] for n in range(3)]
    assert [law.equilibrium_distance for law in own] == [0.01, 0.03, 0.01]
    wall = [law.bond_density * law.well_depth for law in own]
    assert wall == pytest.approx([0.0, 240.0, 0.0])  # as the substrate pulls, but only of what is named


@pytest.mark.parametrize(("name", "sets", "own", "reason"), [
    ("one_cell", (), False, LIPS), ("paper", (), False, LIPS), ("nucleus", (), False, SOLIDS),
    ("paper", ("adhesion.substrate.attraction=0",), True, None),
    ("squeezed_disc", (), False, "not in a static case"), ("beam", (), False, "not in a static case"),
    ("nucleus", ('cells.0.displacement=["0 um", "x**2 um"]',), True, None)])
def test_fluids_and_what_is_not_convex_can_meet_themselves(name: str, sets: tuple, own: bool,
                                                            reason: str | None) -> None:
    terms = of(name, *sets)
    assert terms.skipped.get(ITSELF) == reason
    assert (terms.contacts is not None and terms.contacts.own) == own


def test_without_pruning_what_cannot_meet_has_laws_that_do_nothing() -> None:
    terms = find_terms(case("beam"), prune=False)
    assert terms.contacts.own and terms.skipped[ITSELF]
    for law in terms.contacts.laws:
        assert law.stiffness(0.0) == 0.0 and law.potential(0.001) == 0.0


def test_pairs_of_a_colony_are_told_apart_by_kind() -> None:
    found = load(CASES["colony"])
    names = [cell.name.split("-")[0] for cell in found.cells]
    contacts = find_terms(found).contacts
    work = {(a, b): contacts.laws[contacts.of_pair(i, j)].work for i, a in enumerate(names)
            for j, b in enumerate(names) if i != j}
    assert work == pytest.approx({("Red", "Red"): 24.0, ("Blue", "Blue"): 24.0, ("Red", "Blue"): 2.4,
                                  ("Blue", "Red"): 2.4})


def test_exceptions_of_equal_laws_are_one_law() -> None:
    tree = case("paper").resolved()
    tree["adhesion"]["pairs"] = [{"cells": ["Cell-1", "Cell-2"]},
                                 {"cells": ["Cell-1", "Cell-3"], "bond_density": "0 /um^2"},
                                 {"cells": ["Cell-2", "Cell-3"], "bond_density": "0 /um^2"}]
    contacts = find_terms(from_dict(tree)).contacts
    assert contacts.of_pair(0, 1) == 0 and contacts.of_pair(0, 2) == contacts.of_pair(2, 1) != 0
    one = change(from_dict(tree), {"adhesion.pairs": [], "adhesion.cells.bond_density": "0 /um^2"})
    assert contacts.laws[contacts.of_pair(0, 2)] == find_terms(one).contact
