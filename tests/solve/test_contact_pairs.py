"""Contact by pairs of cells: each pair has its own bonds, and a cell's outline keeps itself apart."""

from __future__ import annotations

import numpy as np
import pytest
from numpy import where
from scenes import built, case, everywhere, forces

from cellmig.case import registry
from cellmig.case.load import from_dict
from cellmig.case.messages import CaseError
from cellmig.model.seifert import WALL

GAP = 0.014  # of neighbours in a row [µm]: bonds pull, and there is no repulsion


def row(*pairs: dict, **cells: object):
    """Three discs in a row, without a substrate, so far apart that bonds pull."""
    tree = case("paper", f'cells.0.pitch=[["{-10 - GAP} um", "0 um"]]', per_cell=150).resolved()
    del tree["adhesion"]["substrate"], tree["protrusion"]
    tree["adhesion"] |= {"pairs": list(pairs)} if pairs else {}
    tree["adhesion"]["cells"] |= cells
    return from_dict(tree)


def pulls(found) -> np.ndarray:
    """Force of the others along x on each of the cells [pN/µm]."""
    with built(found) as sim:
        on = everywhere(sim, sim.mechanics.surface_force("contact")[0])
        return np.bincount(sim.scene.cell, on[:, 0])


def test_a_pair_without_bonds_does_not_pull_and_others_pull_as_before() -> None:
    all_pull = pulls(row())
    assert all_pull[0] < -1.0 and all_pull[2] > 1.0  # Cell-1 is on the right
    one = pulls(row({"cells": ["Cell-1", "Cell-2"], "bond_density": "0 /um^2"}))
    assert one == pytest.approx([0.0, -all_pull[2], all_pull[2]], abs=1e-9)


def test_twice_the_bonds_of_a_pair_pull_twice_as_much() -> None:
    one = pulls(row())
    twice = pulls(row({"cells": ["Cell-2", "Cell-3"], "bond_density": "2000 /um^2"}))
    assert twice[2] == pytest.approx(2.0 * one[2], rel=1e-9) and twice[0] == pytest.approx(one[0], rel=1e-9)


def test_a_law_for_each_pair_is_that_of_all() -> None:
    every = [{"cells": [f"Cell-{a}", f"Cell-{b}"], "bond_density": "1500 /um^2"} for a, b in ((1, 2), (2, 3), (1, 3))]
    assert np.array_equal(pulls(row(*every)), pulls(row(bond_density="1500 /um^2")))


class Spring:
    """U = -σ (1 - s²), s = (r - ε)/(c - ε), up to the cutoff c: a law that only these tests know."""

    bond_density: float = registry.quantity("1/um^2", "bond density", minimum=0)
    well_depth: float = registry.quantity("pN um", "depth of the well", minimum=0)
    equilibrium_distance: float = registry.quantity("um", "equilibrium distance", above=0)
    cutoff: float = registry.quantity("um", "cutoff", "30 nm", above=0)

    @property
    def work(self):
        return self.bond_density * self.well_depth

    @property
    def cap(self):
        return 0.5 * self.equilibrium_distance

    @property
    def width(self):
        return self.cutoff - self.equilibrium_distance

    def stiffness(self, least):
        return 2.0 * self.bond_density * self.well_depth / self.width**2

    def potential(self, r):
        s = (r - self.equilibrium_distance) / self.width
        return where(s < 1.0, self.well_depth * (s * s - 1.0), 0.0)

    def slope(self, r):
        s = (r - self.equilibrium_distance) / self.width
        return where(s < 1.0, 2.0 * self.well_depth / self.width * s, 0.0)

    def primitive(self, r):
        s = (r - self.equilibrium_distance) / self.width
        return where(s < 1.0, self.well_depth * self.width * (s * s * s / 3.0 - s + 2.0 / 3.0), 0.0)


def test_laws_of_different_kinds_stand_side_by_side_in_one_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pair has springs, of which the C differs: each pulls as where all pairs have its law."""
    monkeypatch.setattr(registry, "_LAWS", {kind: dict(known) for kind, known in registry._LAWS.items()})
    registry.law("adhesion", "test-spring")(Spring)
    spring = {"law": "test-spring", "bond_density": "1000 /um^2", "well_depth": "0.024 pN um",
              "equilibrium_distance": "10 nm"}
    tree = row().resolved()
    tree["adhesion"]["cells"] = spring
    mixed = row({"cells": ["Cell-2", "Cell-3"], **spring})
    found, springs, bonds = map(pulls, (mixed, from_dict(tree), row()))
    assert abs(springs[2] - bonds[2]) > 0.1
    assert found == pytest.approx([bonds[0], -bonds[0] - springs[2], springs[2]], rel=1e-9)


def test_a_law_between_cells_that_does_not_repel_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    class Rope(Spring):
        def slope(self, r):
            return where(r < self.equilibrium_distance, 0.0, super().slope(r))

    monkeypatch.setattr(registry, "_LAWS", {kind: dict(known) for kind, known in registry._LAWS.items()})
    registry.law("adhesion", "test-rope")(Rope)
    tree = row({"cells": ["Cell-1", "Cell-2"], "bond_density": "500 /um^2"}).resolved()
    for wrong in (tree["adhesion"]["cells"], tree["adhesion"]["pairs"][0]):
        wrong |= {"law": "test-rope", "well_depth": "0.024 pN um", "equilibrium_distance": "10 nm"}
        for key in ("attraction", "cutoff"):
            wrong.pop(key, None)
    with pytest.raises(CaseError) as error:
        from_dict(tree)
    for place in ("adhesion.cells.law", "adhesion.pairs.0.law"):
        assert f"{place}: 'test-rope' does not repel at 0.01 of its equilibrium distance" in str(error.value)


def test_the_energy_of_a_colony_closes_with_bonds_by_kind() -> None:
    with built(case("colony", per_cell=100)) as sim:
        sim.sample()
        sim.go(3.0)
        assert sim.sample()[1]["energy_error"] < 0.01  # measured 1e-3
        assert np.abs(forces(sim)).max() > 0.0


HOOK = [[0, 0], [6, 0], [6, 4], [0, 4], [0, 2.02], [5, 2.02], [5, 2.012], [0, 2.012]]  # a slit 8 nm wide [µm]


def test_both_sides_of_a_slit_repel_each_other_and_no_force_acts_on_the_whole() -> None:
    tree = case("nucleus", per_cell=300).resolved()
    tree["cells"][0] |= {"shape": "polygon", "corners": [[f"{x} um", f"{y} um"] for x, y in HOOK]}
    tree["cells"][0].pop("radius")
    tree["cells"][0].pop("velocity_gradient")
    tree["adhesion"] = {"cells": {"bond_density": "1000 /um^2", "well_depth": "0.024 pN um",
                                  "equilibrium_distance": "10 nm"}}
    with built(from_dict(tree)) as sim:
        assert sim.terms.contact is None and sim.terms.contacts.own
        force, energy = (everywhere(sim, one) for one in sim.mechanics.surface_force("contact"))
        x, y = sim.scene.X.T
        upper, lower = (np.abs(y - side) < 1e-3 for side in (2.02, 2.012))
        # The corners at the end of the slit are one particle, whose two segments are neighbours and do not repel.
        expected = x[upper].max() * WALL * -sim.terms.contacts.laws[0].slope(0.008)
        assert force[upper, 1].sum() == pytest.approx(expected, rel=1e-3)  # measured 3e-4, at the mouth
        assert force[upper, 1].sum() == pytest.approx(-force[lower, 1].sum(), rel=1e-6)  # measured 5e-9, the same
        assert energy.sum() > 0.0 and np.abs(force.sum(axis=0)).max() < 1e-9 * np.abs(force).max()


def drop() -> dict:
    """A drop in free space, which deforms."""
    tree = case("one_cell", per_cell=150).resolved()
    del tree["adhesion"]
    tree["cells"][0]["velocity_gradient"] = [["0.2 /us", "0 /us"], ["0 /us", "-0.2 /us"]]
    return tree | {"protrusion": {"cells": []}}


@pytest.mark.parametrize("tree", [drop(), case("nucleus", per_cell=150).resolved(), row().resolved()],
                         ids=["a drop", "a solid", "a row"])
def test_contact_that_is_computed_but_cannot_be_changes_no_bit(tree: dict) -> None:
    states = []
    for prune in (True, False):
        with built(from_dict(tree), prune=prune) as sim:
            sim.go(2.0)
            states.append((sim.integrator.steps, everywhere(sim, sim.mechanics.state.owned)))
    assert states[0][0] == states[1][0] and np.array_equal(states[0][1], states[1][1])


def test_contact_lengths_are_those_within_three_equilibrium_distances_of_each_pair() -> None:
    """The gap of 14 nm counts for bonds at 10 nm, not for those at 4 nm."""
    with built(row({"cells": ["Cell-2", "Cell-3"], "equilibrium_distance": "4 nm"})) as sim:
        _, *length = (cell["cell_contact_um"] for cell in sim.sample()[0])
    assert length[0] == pytest.approx(length[1]) and length[0] > 0.05 and length[2] == 0.0


def test_the_wall_of_a_cell_against_itself_does_not_shorten_the_step() -> None:
    """It is ten times as stiff as the bonds between cells, which set the step where cells touch."""
    with built(case("paper", 'adhesion.pairs=[{cells = ["Cell-1", "Cell-1"]}]', per_cell=150)) as sim:
        assert sim.terms.contacts.own
        between = sim.terms.contact
        steps = sim.control.stable(gaps=np.array([1.0, 0.94 * between.equilibrium_distance]))
        wall = sim.terms.contacts.laws[sim.terms.contacts.of_pair(0, 0)]
        assert wall.stiffness(0.0099) > 5.0 * between.stiffness(0.0099)
        bonds = 2.0 * between.stiffness(0.94 * between.equilibrium_distance) * sim.control._size_per_mass
        k = sim.control
        c, omega2 = k.stabilisation + k.viscous, k.elastic + k.stiffening + bonds
        assert 0.5 * c * steps["contact"] + 0.25 * omega2 * steps["contact"] ** 2 == pytest.approx(1.0, rel=1e-9)
