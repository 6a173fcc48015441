"""Cues of a case: what is read, and every mistake with its line."""

from __future__ import annotations

import json

import pytest
from scenes import CASES

from cellmig.case.json_schema import json_schema
from cellmig.case.load import change, from_dict, load
from cellmig.case.messages import CaseError
from cellmig.laws import register

pytestmark = pytest.mark.serial

register()

POLAR = ['polarity={persistence="10 min"}', 'fields.c={formula="5 + 0.02*x nM"}']
GRADIENT = '{law="occupancy", field="c", affinity="10 nM", receptors=5e4}'


def cues(*tables: str, more: tuple[str, ...] = ()):
    """The crawling cell with a polarity, a field and some cues."""
    return load(CASES["crawl"], [*POLAR, *more, f"cues=[{', '.join(tables)}]"])


def test_cues_are_read_in_the_codes_units_and_in_their_order() -> None:
    found = cues(GRADIENT, '{law="motion", speed="0.6 um/min", cells=["Cell-1"], gain=2}',
                 '{law="given", vector=["tanh(x/50)*exp(-t_h)"]}').cues
    assert [cue.law for cue in found] == ["occupancy", "motion", "given"]
    assert found[0].affinity.value == pytest.approx(6.02214)  # molecules per µm³
    assert (found[0].gain, found[0].receptors, found[1].gain) == (50.0, 5e4, 2.0)
    assert found[1].speed == pytest.approx(1e-8)
    assert found[1].cells == ("Cell-1",)


def test_a_case_with_cues_is_written_and_read_back_and_changed() -> None:
    case = cues(GRADIENT, '{law="contact", field="ligand", affinity=0.5, reach="2 um"}',
                more=('substrate.ligand="0.5 + 0.001*x"',))
    assert from_dict(json.loads(json.dumps(case.resolved())), case.path) == case
    assert change(case, {"cues.0.affinity": "0.02 uM"}).cues[0].affinity.value == pytest.approx(12.04428)


def test_a_case_without_cues_has_none() -> None:
    assert load(CASES["crawl"]).cues == ()
    assert "cues" not in load(CASES["crawl"]).resolved()


@pytest.mark.parametrize(("table", "part"), [
    ('{gain=1}', "cues.0.law: missing: one of 'contact', 'given'"),
    ('{law="ocupancy"}', "cues.0.law: no cue law 'ocupancy'; did you mean 'occupancy'?"),
    ('{law="occupancy", field="c"}', "cues.0.affinity: missing: level K of the field"),
    ('{law="occupancy", field="d", affinity="10 nM"}', "cues.0.field: no field 'd'; there is 'c'"),
    ('{law="occupancy", field="ligand", affinity=0.5}', "cues.0.field: no field 'ligand'; there is 'c'"),
    ('{law="occupancy", field="c", affinity=10}',
     "cues.0.affinity: expects a level such as '1 nM', of the kind of 'c'"),
    ('{law="occupancy", field="c", affinity="10 kPa"}', "not '10 kPa'"),
    ('{law="occupancy", field="c", affinity="10 nMol"}',
     "cues.0.affinity: expects a level of the field, such as \"10 nM\", not '10 nMol'"),
    ('{law="occupancy", field="c", affinity="-1 nM"}', "cues.0.affinity: must be > 0, not '-1 nM'"),
    ('{law="occupancy", field="c", affinity="10 nM", receptors=0}', "cues.0.receptors: must be >= 30, not 0"),
    ('{law="contact", field="c"}', "cues.0: expects both field and affinity, or none of them"),
    ('{law="contact", cells=["Cell-2"]}', "cues.0.cells: no cell 'Cell-2'; did you mean 'Cell-1'?"),
    ('{law="neighbours", gain=-0.5}', "cues.0.gain: must be >= 0"),
    ('{law="neighbours", gain=6}, {law="neighbours", gain=6}', "cues.1.gain: with the other cues of neighbours, "
     "'Cell-1' has 12, and overshoots: at most 10 in all"),
    ('{law="motion", speed=1}', 'cues.0.speed: has no unit: write "1 um/us" if that is meant'),
    ('{law="given", vector=[1, 0]}', "cues.0.vector: expects a list such as [1], not [1, 0]"),
    ('{law="given", vector=["t*x"]}', "cues.0.vector: 't*x': the time has a unit: write t_s for seconds"),
])
def test_a_mistake_in_a_cue_is_told_with_what_would_be_right(table: str, part: str) -> None:
    with pytest.raises(CaseError) as error:
        cues(table)
    assert part in str(error.value)


def test_mistakes_in_several_cues_come_at_once() -> None:
    with pytest.raises(CaseError) as error:
        cues('{law="occupancy", field="d", affinity="x"}', '{law="motion"}', "3")
    assert [m.key for m in error.value.mistakes] == ["cues.0.field", "cues.0.affinity", "cues.1.speed", "cues.2"]


def test_cues_without_a_polarity_are_refused() -> None:
    with pytest.raises(CaseError, match=r"cues: turn the polarity of cells, of which there is none: add \[polarity\]"):
        load(CASES["crawl"], ['cues=[{law="contact"}]'])
    with pytest.raises(CaseError, match="cues: is a list of tables: write"):
        load(CASES["crawl"], ['cues={law="contact"}', *POLAR])


def test_a_cue_of_a_cell_that_has_no_polarity_is_refused() -> None:
    leader = ('cues=[{law="given", vector=[1], cells=["Cell-1"]}]', 'polarity.persistence="10 min"')
    for sets, what in ((['polarity.cells=["Cell-2"]'], "polarity"), (['protrusion.cells=["Cell-2"]'], "protrusion")):
        with pytest.raises(CaseError) as error:
            load(CASES["crawl_row"], [*leader, *sets])
        assert f"cues.0.cells: 'Cell-1' has no polarity to turn: name it in {what}.cells" in str(error.value)


def test_a_polarity_needs_what_cells_push_off() -> None:
    with pytest.raises(CaseError, match=r"polarity: cells push off \[adhesion.substrate\], of which there is none"):
        load(CASES["slab"], ['polarity.persistence="10 min"', 'protrusion.cells=["Cell-1"]'])


def test_a_mistake_in_the_protrusion_is_told_alone() -> None:
    with pytest.raises(CaseError) as error:
        load(CASES["crawl"], [*POLAR, "protrusion.basal=-1"])
    assert [m.key for m in error.value.mistakes] == ["protrusion.basal"]


def test_the_schema_of_cues_lists_their_laws() -> None:
    items = json_schema()["properties"]["cues"]["items"]
    assert {"occupancy", "contact", "neighbours", "motion", "given"} <= set(items["properties"]["law"]["enum"])
    occupancy = next(o for o in items["anyOf"] if o["properties"]["law"]["const"] == "occupancy")
    assert occupancy["properties"]["affinity"]["type"] == ["string", "number"]
    given = next(o for o in items["anyOf"] if o["properties"]["law"]["const"] == "given")
    assert (given["properties"]["vector"]["minItems"], given["properties"]["vector"]["maxItems"]) == (1, 2)
