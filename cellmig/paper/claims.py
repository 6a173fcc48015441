"""The paper's claims R1 to R6: numbers measured for each random seed, bounds, verdicts.

The claims are those of Bai, Lin & Zeng, CMES 121(3), 2019, section 4.  Each consists of statements that one number
decides; the bounds are stated here and do not depend on the parameters of a case.  In space contacts are areas, and
only claims that do not need a section of the cells are judged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from cellmig.runs.claims import Claim, Part, text_of
from cellmig.runs.outcome import Outcome, aspect, gap, oscillation, roundness, stresses

ADHESION, PROTRUSION = (0.5, 1.0, 2.0, 4.0), (0.5, 1.0, 2.0)  # factors of the values of the paper's case
CASES = {"three_only": "{3}", "one_three": "{1,3}", "two_three": "{2,3}", "all_protrude": "{1,2,3}"}
END = 400.0  # of the paper's figures [us]
IN_SPACE = ("R1", "R3", "R5", "R6")  # claims that are judged in three dimensions, too

Results = Mapping[str, Mapping[int, Outcome]]  # outcomes by configuration and seed


def study(what: str, factor: float) -> str:
    """Name of the configuration with a multiple of the adhesion or protrusion; 1 is the paper's case."""
    return "all_protrude" if factor == 1.0 else f"{what}_x{factor:g}"


def judge(results: Results, keys: Iterable[str]) -> list[Claim]:
    """Claims with the values of `results`."""
    return [CLAIMS[key](results) for key in keys]


# ---------------------------------------------------------------------------------------------------------- helpers


def by_seed(results: Results, names: Iterable[str], number: Callable[..., float]) -> dict[int, float]:
    """`number(*outcomes)` for each seed that all these configurations have, unless it is None."""
    runs = [results.get(name, {}) for name in names]
    found = {seed: number(*(run[seed] for run in runs)) for seed in sorted(set.intersection(*map(set, runs)))}
    return {seed: float(value) for seed, value in found.items() if value is not None}


def mean_of(results: Results, name: str, number: Callable[[Outcome], float]) -> str:
    """Mean ± standard deviation of a number over the seeds of a configuration, as text."""
    return text_of(by_seed(results, [name], number).values())


def about(results: Results) -> tuple[int, float]:
    """Number of dimensions and end [us] of the runs; those of the paper without runs."""
    return next(((o.dimension, o.end) for runs in results.values() for o in runs.values()), (2, END))


def times(end: float) -> tuple[float, float, float]:
    """Times of Fig. 2 [us]: 20 us, and 204 and 268 us of runs that end at 400 us."""
    return 20.0, 0.51 * end, 0.67 * end


def moved(outcome: Outcome) -> float:
    """Mean displacement of the aggregate at the end [um]."""
    return outcome.at("ux_um", outcome.end)


def ordered(results: Results, names: list[str], labels: list[str]) -> list[Part]:
    """Statements that the displacement [um] grows from each of these configurations to the next."""
    end = about(results)[1]
    return [Part(f"displacement at {end:g} us of {labels[k + 1]} less that of {labels[k]} [um]",
                 by_seed(results, names[k:k + 2], lambda low, high: moved(high) - moved(low)), above=0.0)
            for k in range(len(names) - 1)]


def account(results: Results, names: list[str], labels: list[str]) -> list[str]:
    """Displacement, impulse and contact of each configuration, in the seeds that all of them have."""
    common = set.intersection(*(set(results.get(name, {})) for name in names))
    lines, (dimension, end) = [], about(results)
    impulse, unit = {2: ("nN us/um", "um"), 3: ("nN us", "um2")}[dimension]
    for name, label in zip(names, labels, strict=True) if common else ():
        runs = {name: {seed: results[name][seed] for seed in common}}
        push, on, between = (mean_of(runs, name, number) for number in (
            lambda o: 1e-3 * o.impulse, lambda o: o.at(o.contacts[0], o.end), lambda o: o.at(o.contacts[1], o.end)))
        apart = (f"the outer cells are apart from Cell-2 for {mean_of(runs, name, lambda o: o.separated)} of 2 x "
                 f"{end:g} us"
                 if any(o.separated for o in runs[name].values()) else "no cell ever parts")
        lines.append(f"{label}: moved {mean_of(runs, name, moved)} um by an impulse of {push} {impulse}; contact at "
                     f"{end:g} us {on} {unit} with the substrate, {between} {unit} between cells; {apart}")
    return lines


# ----------------------------------------------------------------------------------------------------------- claims


def r1(results: Results) -> Claim:
    """Fig. 2: cells are round at 20 us, then their contacts grow, then they move and press on each other."""
    dimension, end = about(results)
    early, middle, late = times(end)
    unit, least = {2: ("um", "circularity 4 pi A/P^2"), 3: ("um2", "sphericity")}[dimension]

    def part(what: str, number: Callable[[Outcome], Any], **bounds: float) -> Part:
        return Part(what, by_seed(results, ["all_protrude"], number), **bounds)

    def grows(contact: int, last: float, first: float) -> Callable[[Outcome], float]:
        return lambda o: o.at(o.contacts[contact], last) - o.at(o.contacts[contact], first)

    def state(time: float) -> str:
        on, between, far = (mean_of(results, "all_protrude", number) for number in (
            lambda o: o.at(o.contacts[0], time), lambda o: o.at(o.contacts[1], time), lambda o: o.at("ux_um", time)))
        return (f"{time:g} us: contact {on} {unit} with the substrate, {between} {unit} between cells; moved {far} um")

    def speeds(o: Outcome) -> float:
        far = o.at("ux_um", middle)
        return (o.at("ux_um", late) - far) / (late - middle) - far / middle

    return Claim("R1", "all protrude: round at first, then spread, then moving, in growing contact (Fig. 2)", [
        part(f"least {least} of a cell at {early:g} us", lambda o: roundness(o, early), above=0.95),
        part(f"height/width at {early:g} us of the cell that is least round", lambda o: aspect(o, early), above=0.9,
             below=1.1),
        part(f"contact with the substrate, {middle:g} us less {early:g} us [{unit}]", grows(0, middle, early),
             above=0.0),
        part(f"contact with the substrate, {late:g} us less {middle:g} us [{unit}]", grows(0, late, middle), above=0.0),
        part(f"mean speed {middle:g}-{late:g} us less that before [um/us]", speeds, above=0.0),
        part(f"contact between cells, {late:g} us less {early:g} us [{unit}]", grows(1, late, early), above=0.0),
    ], why=[state(time) for time in (early, middle, late)])


def r2(results: Results) -> Claim:
    """Fig. 3: the stress of the middle cell oscillates.

    The figure does not show that its neighbours are the cause: the control is the same cell without neighbours.
    """
    swing = {seed: oscillation(outcome) for seed, outcome in results.get("all_protrude", {}).items()}
    alone = {seed: oscillation(outcome, cell=1) for seed, outcome in results.get("alone", {}).items()}
    notes = [f"{who}: standard deviation {text_of(s.deviation for s in found.values())} Pa, of the means over "
             f"10 us {text_of(s.slow for s in found.values())} Pa; sign changes "
             f"{text_of(s.changes for s in found.values())}; largest compression (push) "
             f"{text_of(s.push for s in found.values())} Pa, largest tension (pull) "
             f"{text_of(s.pull for s in found.values())} Pa"
             for who, found in (("Cell-2", swing), ("one cell alone, protruding", alone)) if found]
    if common := swing.keys() & alone.keys():
        more = sum(swing[seed].slow > alone[seed].slow for seed in common)
        notes.append(f"Cell-2 swings more than the cell alone (means over 10 us) in {more} of {len(common)} seeds: "
                     "only what it swings more can be push and pull of its neighbours")
    return Claim("R2", "sigma11 at the lower centre of Cell-2 oscillates (Fig. 3)", [
        Part("sign changes about its linear trend, 20-400 us, means over 10 us [-]",
             {seed: float(s.changes) for seed, s in swing.items()}, above=3.5),
        Part("its standard deviation over the mean effective stress of Cell-2 [-]",
             {seed: s.deviation / s.scale for seed, s in swing.items()}, above=1.0),
    ], notes)


def r3(results: Results) -> Claim:
    """Fig. 4: the displacement depends on which cells protrude."""
    names, labels = list(CASES), list(CASES.values())
    parts = ordered(results, names, labels)
    return Claim("R3", "displacement by who protrudes: {3} < {1,3} < {2,3} < {1,2,3} (Fig. 4)", parts,
                 notes=account(results, names, labels))


def r4(results: Results) -> Claim:
    """Fig. 5: the follower has the smallest stress and at first no contact with the leader in front."""
    runs = results.get("one_three", {})
    stress = {seed: stresses(outcome, 250.0, END) for seed, outcome in runs.items()}
    stress = {seed: s for seed, s in stress.items() if s}
    parts = [Part(f"median stress 250-400 us of Cell-{leader} less that of Cell-2, {where} [Pa]",
                  {seed: s[where][leader] - s[where][2] for seed, s in stress.items()}, above=0.0)
             for where in ("whole cell", "cytoplasm at the bottom") for leader in (1, 3)]
    parts.append(Part("contact of Cell-1 with Cell-2 at 24 us [um]",
                      by_seed(results, ["one_three"], lambda o: o.at("cell_contact_um", 24.0, 1)), below=0.01))
    notes = [f"effective stress, median over 250-400 us, {where}: " + ", ".join(
        f"Cell-{cell} {text_of(s[where][cell] for s in stress.values())}" for cell in (1, 2, 3))
        + (" [-]" if where.startswith("share") else " Pa") for where in next(iter(stress.values()), {})]
    if notes:
        notes.append("the nucleus weighs in the whole cell by its share, and its stress has not converged")
    why = [_who_parts(results, name) for name in ("one_three", "all_protrude") if results.get(name)]
    return Claim("R4", "{1,3}: Cell-2 less stressed than Cells 1 and 3; Cells 1 and 2 apart at first (Fig. 5)",
                 parts, notes, why)


def _who_parts(results: Results, name: str) -> str:
    contact, width, first, last = (mean_of(results, name, number) for number in (
        lambda o: o.at("cell_contact_um", 24.0, 1), lambda o: gap(o, 24.0, 1.0), lambda o: o.apart(1),
        lambda o: o.apart(3)))
    return (f"{CASES[name]}: contact of Cell-1 with Cell-2 at 24 us {contact} um, gap between them 1 um above the "
            f"substrate {width} um; of 400 us Cell-1 is apart from Cell-2 for {first} us, Cell-3 for {last} us")


def r5(results: Results) -> Claim:
    """Fig. 6: the aggregate is faster with stronger adhesion between cells."""
    return _grows(results, "R5", "adhesion", ADHESION, "faster with stronger adhesion between cells (Fig. 6)")


def r6(results: Results) -> Claim:
    """Section 4.2: the aggregate is faster with stronger protrusion."""
    return _grows(results, "R6", "protrusion", PROTRUSION, "faster with stronger protrusion")


def _grows(results: Results, key: str, what: str, factors: tuple[float, ...], text: str) -> Claim:
    names, labels = [study(what, factor) for factor in factors], [f"x {factor:g}" for factor in factors]
    return Claim(key, text, ordered(results, names, labels), notes=account(results, names, labels))


CLAIMS = {"R1": r1, "R2": r2, "R3": r3, "R4": r4, "R5": r5, "R6": r6}
