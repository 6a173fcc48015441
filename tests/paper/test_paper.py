"""The paper's claims: how they are judged, what is run for them and what is kept, what is left."""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace

import matplotlib.image
import numpy as np
import pytest

import cellmig.paper.paper as study_paper
from cellmig.case.load import load
from cellmig.case.shipped import FOLDER
from cellmig.case.units import number
from cellmig.commands import paper as command
from cellmig.output.manifest import read_manifest
from cellmig.paper.claims import CASES, CLAIMS
from cellmig.paper.paper import CONFIGURATIONS, paper, plan
from cellmig.runs import batch
from cellmig.runs.claims import AVERAGE, FAILS, HOLDS, UNKNOWN, Part, table
from cellmig.runs.outcome import Outcome, gap
from cellmig.usage import TENSION, UsageError, parse

pytestmark = pytest.mark.serial

SEEDS = (1, 2, 3)
RUN = {"case": {"materials": {"nucleus": {}, "cytoplasm": {}},
                "cells": [{"material": "cytoplasm", "nucleus": "nucleus"}] * 3},
       "protrusion_impulse_pN_us_per_um": 1e3}


@dataclass(frozen=True)
class Picture:
    """A frame that is held in memory."""

    time: float
    fields: dict

    def read(self):
        return self.fields


def outcome(end=10.0, stress=(2.0, 1.0, 2.0), touch=1.0, swing=10.0, factor=1.0, pictures=True):
    """Three discs that move by `end` [um] in 400 us, at constant acceleration, with Cell-2 swinging at 80 us."""
    time = np.arange(401.0)
    rows = {"ux_um": end * (time / 400) ** 2, "substrate_contact_um": 3 + time / 100,
            "cell_contact_um": np.where(time < 50, touch, 1.0 + time / 100), "area_um2": np.full(401, 78.0),
            "perimeter_um": np.full(401, 31.4), "sigma11_lower_centre_pa": swing * np.sin(2 * np.pi * time / 80)}
    history = {name: np.tile(values, 4) for name, values in rows.items()}
    history |= {"time_us": np.tile(time, 4), "cell": np.repeat(np.arange(4), 401),
                "effective_stress_pa": np.repeat([np.mean(stress), *stress], 401)}
    frames = [Picture(t, discs(stress, factor)) for t in np.arange(0.0, 401.0, 20.0)] if pictures else []
    return Outcome(history, RUN, frames)


def discs(stress, factor):
    """Fields of three discs, `factor` higher than wide, each with one stress all over."""
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    rim = 5 * np.column_stack([np.cos(angle), factor * np.sin(angle)])
    rings = np.concatenate([rim, 0.6 * rim, 0.2 * rim])
    X = np.concatenate([rings + np.array([x, 5.0]) for x in (10.0, 0.0, -10.0)])
    return {"X": X, "u": np.zeros_like(X), "cell": np.repeat([1, 2, 3], 180),
            "effective_stress": np.repeat(stress, 180),
            "surface": np.tile([*range(60), *[-1] * 120], 3), "material": np.tile(np.repeat([1, 1, 0], 60), 3)}


def in_space(end=10.0, factor=1.0, sphericity=0.99):
    """Three balls that move by `end` [um] in 200 us, `factor` higher than wide."""
    flat = outcome(end, pictures=False)
    history = {name.replace("contact_um", "contact_um2"): values for name, values in flat.history.items()}
    history |= {"time_us": 0.5 * history["time_us"], "z_um": np.full(4 * 401, 5.0),
                "sphericity": np.full(4 * 401, sphericity)}
    points = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, factor], [0, 0, -factor]])
    fields = {"X": 5.0 * np.tile(points, (3, 1)), "u": np.zeros((18, 3)), "cell": np.repeat([1, 2, 3], 6)}
    manifest = RUN | {"protrusion_impulse_pN_us": 2e3}
    return Outcome(history, manifest, [Picture(t, fields) for t in (0.0, 20.0, 200.0)])


def everything(ends):
    """Results of all cases, displacement [um] by configuration and seed."""
    return {name: {seed: outcome(end) for seed, end in zip(SEEDS, row, strict=False)} for name, row in ends.items()}


ORDER = {"three_only": [3, 3, 3], "one_three": [6, 6, 6], "two_three": [7, 7, 7], "all_protrude": [10, 10, 10]}


@pytest.mark.parametrize(("change", "verdict", "held"), [
    ({}, HOLDS, 3), ({"one_three": [6, 6, 7.5]}, AVERAGE, 2), ({"one_three": [8, 8, 6]}, FAILS, 1),
    ({"two_three": [7]}, HOLDS, 1), ({"two_three": []}, UNKNOWN, 0)])
def test_the_order_of_the_cases_holds_in_all_seeds_or_on_average_or_not(change, verdict, held):
    claim = CLAIMS["R3"](everything(ORDER | change))
    assert (claim.verdict, len(claim.held)) == (verdict, held)


@pytest.mark.parametrize(("values", "verdict"), [
    ({1: 1.0, 2: 2.0}, HOLDS), ({1: 1.0, 2: -0.5}, AVERAGE), ({1: -1.0, 2: 0.5}, FAILS), ({}, UNKNOWN),
    ({1: 1.0, 2: np.nan}, FAILS)])
def test_a_statement_is_judged_by_its_values_and_what_is_no_number_does_not_hold(values, verdict):
    assert Part("", values, above=0.0).verdict == verdict


def test_round_cells_that_spread_and_move_are_as_in_figure_2_and_tall_ones_are_not():
    assert CLAIMS["R1"]({"all_protrude": {1: outcome()}}).verdict == HOLDS
    assert CLAIMS["R1"]({"all_protrude": {1: outcome(factor=1.3)}}).verdict == FAILS
    assert CLAIMS["R1"]({"all_protrude": {1: outcome(pictures=False)}}).verdict == UNKNOWN


def test_a_stress_that_swings_oscillates_and_a_steady_one_does_not():
    swinging, steady = (CLAIMS["R2"]({"all_protrude": {1: outcome(swing=s)}}) for s in (10.0, 1e-6))
    assert swinging.verdict == HOLDS and 8 <= swinging.parts[0].values[1] <= 10  # 380 us of a period of 80 us
    assert steady.verdict == FAILS
    control = CLAIMS["R2"]({"all_protrude": {1: outcome(swing=10.0)}, "alone": {1: outcome(swing=20.0)}})
    assert any("in 0 of 1 seeds" in note for note in control.notes)


@pytest.mark.parametrize(("stress", "touch", "verdict"), [
    ((2.0, 1.0, 2.0), 0.0, HOLDS), ((2.0, 1.0, 2.0), 1.0, FAILS), ((2.0, 1.5, 1.0), 0.0, FAILS)])
def test_the_follower_is_least_stressed_and_apart_or_not(stress, touch, verdict):
    claim = CLAIMS["R4"]({"one_three": {1: outcome(stress=stress, touch=touch)}})
    assert claim.verdict == verdict
    assert claim.parts[2].values[1] == pytest.approx(stress[0] - stress[1])
    # Two discs of 5 um, 10 um apart, leave 10 - 2 * 3 um at a height of 1 um.
    assert gap(outcome(), 24.0, 1.0) == pytest.approx(4.0, abs=0.05)


def test_balls_are_judged_by_areas_and_sphericity_at_the_same_shares_of_their_time():
    claim = CLAIMS["R1"]({"all_protrude": {1: in_space()}})
    assert claim.verdict == HOLDS
    told = " ".join(part.text for part in claim.parts)
    assert "least sphericity of a cell at 20 us" in told and "134 us less 102 us [um2]" in told
    assert CLAIMS["R1"]({"all_protrude": {1: in_space(factor=1.3)}}).verdict == FAILS
    assert CLAIMS["R1"]({"all_protrude": {1: in_space(sphericity=0.9)}}).verdict == FAILS
    moves = CLAIMS["R3"]({name: {1: in_space(ends[0])} for name, ends in ORDER.items()})
    assert moves.verdict == HOLDS and moves.parts[0].what.startswith("displacement at 200 us")
    assert "impulse of 2 nN us; contact at 200 us 7 um2 with the substrate" in moves.notes[0]


@pytest.mark.parametrize(("key", "what", "factors"), [("R5", "adhesion", (0.5, 2, 4)), ("R6", "protrusion", (0.5, 2))])
def test_a_study_holds_where_every_step_up_is_faster(key, what, factors):
    ends = {"all_protrude": [10, 10]} | {f"{what}_x{f:g}": [10 * f, 10 * f] for f in factors}
    assert CLAIMS[key](everything(ends)).verdict == HOLDS
    assert CLAIMS[key](everything(ends | {f"{what}_x2": [9, 12]})).verdict == AVERAGE


def test_the_table_says_verdict_reason_and_what_is_missing():
    lines = "\n".join(table([CLAIMS["R3"](everything(ORDER | {"one_three": [8, 8]}))], seeds=3))
    assert "0 of 2  does not hold" in lines and "why: displacement" in lines and "missing: 1 of 3 seeds" in lines
    assert "impulse of 1 ± 0 nN us/um" in lines


def test_every_claim_has_its_runs_and_every_run_is_a_case_that_loads(tmp_path):
    assert {key for c in CONFIGURATIONS.values() for key in c.claims} == set(CLAIMS)
    assert set(CASES) < set(CONFIGURATIONS)
    jobs = plan(tmp_path, 2, quick=False)
    cases = {key: job.load() for key, job in jobs.items()}
    base = cases["all_protrude", 2019]
    assert len(jobs) == 2 * len(CONFIGURATIONS) == len({job.directory for job in jobs.values()})
    assert base.particles.per_cell == 1485 and base.time.frames == 100
    ratio = base.protrusion.protrusion_ratio
    assert cases["adhesion_x4", 2020].contact.well_depth == pytest.approx(4 * base.contact.well_depth)
    assert cases["protrusion_x0.5", 2020].protrusion.protrusion_ratio == pytest.approx(0.5 * ratio)
    assert cases["adhesion_x4", 2020].seed == 2020 and cases["alone", 2019].protrusion.cells == ("Cell-1",)


def test_in_space_the_same_cells_of_three_balls_protrude(tmp_path):
    jobs = plan(tmp_path, 2, quick=True, dimension=3)
    cases = {key: job.load() for key, job in jobs.items()}
    assert len(jobs) == 2 * 9 and "alone" not in {name for name, _ in jobs}
    who = {name: ",".join(cell[-1] for cell in cases[name, 2019].protrusion.cells) for name in CASES}
    assert who == {name: cells.strip("{}") for name, cells in CASES.items()}
    assert all((case.dimension, case.time.end, case.particles.per_cell) == (3, 200.0, 300) for case in cases.values())
    base = cases["all_protrude", 2019]
    assert cases["adhesion_x2", 2020].contact.well_depth == pytest.approx(2 * base.contact.well_depth)
    assert {job.load().time.end for job in plan(tmp_path, 1, quick=False, dimension=3).values()} == {400.0}


def test_the_study_in_space_leaves_figures_and_numbers(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(study_paper, "_QUICK", {3: ("particles.per_cell=60", "time.samples=4", "time.end=2 us")})
    assert paper(tmp_path, 1, 2, quick=True, only=["R6"], dimension=3) == 0
    text = capsys.readouterr().out
    assert "3 to go" in text and "displacement at 2 us of x 2" in text
    assert {path.name for path in tmp_path.glob("*.png")} == {"fig2.png", "protrusion.png"}
    rows = {name: list(csv.DictReader((tmp_path / f"{name}.csv").read_text().splitlines()))
            for name in ("claims", "runs")}
    assert {row["claim"] for row in rows["claims"]} == {"R1", "R3", "R5", "R6"}
    assert all(float(row["impulse_pn_us"]) > 0.0 for row in rows["runs"])
    monkeypatch.setattr(batch.Job, "start", lambda *_: pytest.fail("a run that is there was started again"))
    assert paper(tmp_path, 1, 2, quick=True, only=["R6"], dimension=3) == 0


def test_what_is_set_is_set_in_every_run_and_the_strengths_are_multiples_of_it(tmp_path):
    given = ('cortex.line_tension="20 pN/um"', "protrusion.protrusion_ratio=0.2", "particles.per_cell=200", "seed=7")
    cases = {key: job.load() for key, job in plan(tmp_path, 1, quick=True, given=given).items()}
    assert {case.particles.per_cell for case in cases.values()} == {200}  # before that of the quick version
    assert {case.cortex.line_tension for case in cases.values()} == {20.0}
    assert {seed for _, seed in cases} == {7}
    assert cases["protrusion_x2", 7].protrusion.protrusion_ratio == pytest.approx(0.4)
    assert cases["adhesion_x2", 7].protrusion.protrusion_ratio == pytest.approx(0.2)


def test_runs_with_something_set_are_kept_apart_by_its_name(monkeypatch):
    asked = []
    monkeypatch.setattr(study_paper, "paper", lambda *arguments: asked.append(arguments) or 0)
    tension = 'cortex.line_tension="20 pN/um"'
    assert command(parse(["paper", "--quick", "--set", tension])) == command(parse(["paper"])) == 0
    assert [str(out) for out, *_ in asked] == ["output/paper-quick-cortex.line_tension=20_pN_um", "output/paper"]
    assert [given for *_, given, _, _ in asked] == [[tension], []]
    with pytest.raises(UsageError, match="the claims are of 400 us"):
        command(parse(["paper", "--set", "time.end=20 us"]))


def test_the_study_runs_once_and_leaves_figures_and_numbers(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(study_paper, "_QUICK", {2: ("particles.per_cell=61", "time.samples=40")})
    only = ("R4", "R6")
    assert paper(tmp_path, 1, 2, quick=True, only=only) == 0
    text = capsys.readouterr().out
    assert "4 to go" in text and "R6  faster" in text and "R3" not in text
    for name in ("fig2", "fig3", "fig4", "fig5", "protrusion"):
        picture = matplotlib.image.imread(tmp_path / f"{name}.png")
        assert picture.shape[1] > 700 and np.ptp(picture[..., :3]) > 0.9  # not blank
        assert (tmp_path / f"{name}.pdf").read_bytes().startswith(b"%PDF")
    rows = {name: list(csv.DictReader((tmp_path / f"{name}.csv").read_text().splitlines()))
            for name in ("claims", "runs")}
    assert len(rows["runs"]) == 4 and all(float(row["ux_um_at_400us"]) > 0 for row in rows["runs"])
    assert {row["claim"] for row in rows["claims"] if row["verdict"] != UNKNOWN} >= {"R1", "R4", "R6"}

    monkeypatch.setattr(batch.Job, "start", lambda *_: pytest.fail("a run that is there was started again"))
    assert paper(tmp_path, 1, 2, quick=True, only=only) == 0
    assert text.split("\n\n")[1:] == capsys.readouterr().out.split("\n\n")[1:]


def test_a_tension_is_read_with_its_unit_and_is_the_measured_one_without_a_value(monkeypatch):
    asked = []
    monkeypatch.setattr(study_paper, "paper", lambda *arguments: asked.append(arguments[-2]) or 0)
    for words in ([], ["--tension"], ["--tension", "20 pN/um"], ["--tension", "0.01 mN/m"]):
        command(parse(["paper", *words]))
    assert asked == [None, 30.0, 20.0, pytest.approx(10.0)]
    for text, told in (("3", "has no unit"), ("1 kg", "wrong dimension"), ("0 pN/um", "is no tension")):
        with pytest.raises(UsageError, match=f"--tension: .*{told}"):
            command(parse(["paper", "--tension", text]))


def test_with_a_tension_all_is_done_as_printed_too_and_told_side_by_side(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(study_paper, "_QUICK", {2: ("particles.per_cell=61", "time.samples=40")})
    assert paper(tmp_path, 1, 2, quick=True, only=["R4"], tension=30.0) == 0
    text = capsys.readouterr().out
    assert text.index("the model as printed") < text.index("the model with 30 pN/um")
    table = text[text.rindex("claim "):].splitlines()
    assert table[0].split() == ["claim", "as", "printed", "with", "30", "pN/um"]
    assert table[2].startswith("R4  ") and table[2].count(" of 1") == 2 and len(table) == 2 + 1 + 5
    tensions = [read_manifest(place / "runs/one_three/seed2019")["case"].get("cortex", {}).get("line_tension")
                for place in (tmp_path, tmp_path / "tension-30")]
    assert tensions == [None, "30 pN/um"]
    assert (tmp_path / "claims.csv").exists() and (tmp_path / "tension-30/claims.csv").exists()


def test_the_cases_with_tension_are_the_papers_but_for_that():
    for name in CASES:
        printed, tense = (load(FOLDER / f"{name}{what}.toml") for what in ("", "_tension"))
        assert tense.cortex.line_tension == number(TENSION, "pN/um") and tense.title.startswith(printed.title)
        assert replace(tense, cortex=None, title=printed.title) == printed and printed.cortex is None


def test_a_claim_that_there_is_not_is_refused():
    with pytest.raises(UsageError, match="no claim 'R9'; there are R1"):
        command(parse(["paper", "--only", "R3,R9"]))
    with pytest.raises(UsageError, match="'R4' is judged in two dimensions; in three there are R1, R3, R5, R6"):
        command(parse(["paper", "--dimension", "3", "--only", "R3,R4"]))
