"""How large polarities become, before a run: what cues give at the start, and what the bonds bear of the push."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import built, case

from cellmig.runs.estimates import polarities
from cellmig.runs.summary import describe_guidance, describe_scene

SLOW = ("time.end=10 min",)


@pytest.mark.serial
@pytest.mark.parametrize(("name", "size"), [("chemotaxis", 0.75), ("haptotaxis", 0.55), ("leader", 0.5)])
def test_the_cues_that_validate_tells_are_those_of_the_first_knot(name: str, size: float) -> None:
    found = case(name, *SLOW, per_cell=100)
    told = polarities(found)
    with built(found) as sim:
        parts = sum(part for part in sim.guidance.parts.values())
        assert np.abs(parts).max() == pytest.approx(told.cues, rel=0.2)  # measured 13 % (receptors), 0.3 %, 0
    assert told.cues == pytest.approx(size, rel=0.1)
    assert not told.unknown


@pytest.mark.serial
def test_a_polarity_is_told_with_its_chance_and_what_bonds_bear_of_it() -> None:
    rows = describe_guidance(case("chemotaxis", *SLOW))
    assert rows[1][1] == ("|p| up to about 1.8, a factor of the push: 1 at the start, 0.75 by cues as they are there, "
                          "1 by chance, two standard deviations; bonds bear the push of 6.8")
    rows = describe_guidance(case("self_generated", *SLOW))
    assert "2 by chance, two standard deviations, cue 0 may add 30 at most; bonds bear" in rows[1][1]
    rows = describe_guidance(case("self_generated", *SLOW, "polarity.law=switching"))
    assert rows[1][1].startswith("|p| = 1, a factor of the push, at all times; bonds bear")


@pytest.mark.serial
def test_a_cue_that_pushes_more_than_bonds_bear_is_warned_of() -> None:
    """The push of a polarity of 1 is 122 pN/µm, and bonds bear 824 pN/µm."""
    found = {gain: dict(describe_scene(case("chemotaxis", *SLOW, f"cues.0.gain={gain}"), 6e8)) for gain in (10, 100)}
    assert "WARNING" not in found[10]
    assert "with a polarity of 8.5 a push of 1e+03 pN/µm a cell is more than the 8.2e+02" in found[100]["WARNING"]
