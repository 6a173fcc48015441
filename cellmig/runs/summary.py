"""Descriptions of a case and its numerics for the log and for reports."""

from __future__ import annotations

import dataclasses
import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cellmig.case import units
from cellmig.case.gaps import Arrangement, arrangement
from cellmig.case.schema import Case
from cellmig.case.time_unit import MICROSECOND, TimeUnit
from cellmig.exits import DONE, STOPPED
from cellmig.meshfree.terms import Terms
from cellmig.model.ground import fields_of
from cellmig.model.protocols import Adhesion
from cellmig.model.seifert import solid
from cellmig.output.log import duration
from cellmig.solve.step import binding

from .estimates import LASTING, SMALL, Expected, expected, polarities

if TYPE_CHECKING:  # imports MPI, which opens ports to all addresses; `watch` is to listen to this machine alone
    from cellmig.simulation import Simulation

FLOATING = 5  # largest number of cells that a warning names
LISTED = 4  # the same of a pair, and of kinds of cells in space
WIDE = 104  # largest number of letters in a row of absent terms
COARSE = 0.05  # share of a body's volume that its particles may leave out
CRAWLING = 1e-7  # speed of a crawling cell [µm/µs]
# What a user may do after a run, by its exit code; {} is its directory.
NEXT = {DONE: "'cellmig report {}' makes a page of it", STOPPED: "'cellmig resume {}' goes on"}
FAR = 4.0  # displacement that a warning starts from, over the size of a cell; the paper's cells move by 1.5 sizes


def describe_volumes(J: Sequence[float | None]) -> str:
    """The least and the largest volume ratio of a run, which are huge numbers where it failed."""
    return " to ".join("unknown" if value is None else f"{value:.4f}" if abs(value) < 100.0 else f"{value:.4g}"
                       for value in J)


def describe_step(stable: dict[str, float], factor: float, fixed: float | None, unit: TimeUnit = MICROSECOND) -> str:
    """The time step and its reason; `stable` : steps by mechanism [µs];  `fixed` : the user's step [µs] or None."""
    mechanism, limit = binding(stable)
    if not fixed:
        return (f"about {1e3 * factor * limit:.3g} ns, {factor:g} of the stable one, which {mechanism} sets; follows "
                "the deformation")
    text = f"{unit.step(fixed)} as given, {fixed / limit:.3g} times the stable one, which {mechanism} sets"
    return text if fixed <= limit else f"{text}: TOO LARGE"


def describe_load_steps(case: Case) -> str:
    """The load steps of a static case."""
    return (f"{case.time.samples}, one for each sample; one that finds no equilibrium is cut; time is what loads "
            "depend on, nothing moves")


def describe_balance(load: Sequence[float]) -> list[tuple[str, str]]:
    """Rows about the work of ranks, `load` : of each over the mean; none of one rank."""
    return [("balance", f"the fullest rank has {max(load):.3f} of the mean work in a step, the emptiest "
                        f"{min(load):.3f}, as expected from neighbours, and contacts at the start")] * (len(load) > 1)


def measured_balance(simulation: Simulation) -> str:
    """Text of the measured work of ranks in steps beside the expected one, "" where there is none; collective."""
    m = simulation.mechanics
    work, load = simulation.comm.allgather(m.working), m.part.owners.load
    if len(work) == 1 or not any(work):
        return ""
    return (f"balance: the fullest rank had {len(work) * max(work) / sum(work):.3f} of the mean work in steps, "
            f"{max(load):.3f} as expected, by CPU time without waiting")


def describe_skipped(skipped: dict[str, str]) -> list[tuple[str, str]]:
    """Rows of absent terms by their reasons."""
    names = {why: [name for name, reason in skipped.items() if reason == why] for why in skipped.values()}
    texts = [f"{', '.join(those)}: {why}" for why, those in names.items()] or ["nothing"]
    rows = [line for text in texts for line in textwrap.wrap(text, WIDE, subsequent_indent="  ")]
    return [("" if number else "skipped", row) for number, row in enumerate(rows)]


def describe_bodies(case: Case, left_out: dict[int, float]) -> list[tuple[str, str]]:
    """Rows about the first cell of each kind in space; `left_out` : by its index, the volume beyond its triangles."""
    rows = []
    for n, share in list(left_out.items())[:LISTED]:
        cell = case.cells[n]
        size = " × ".join(f"{side:.3g}" for side in np.ptp(cell.shape.outline(720), axis=0))
        rows.append(("" if rows else "bodies", f"{cell.name}: {cell.shape.volume:.4g} µm³ within "
                     f"{cell.shape.surface_area:.4g} µm², {size} µm; its particles hold {100.0 * (1.0 - share):.3g} % "
                     "of that volume"))
        if abs(share) > COARSE:
            rows.append(("WARNING", f"the particles are too few for the shape of {cell.name}: more of them, or a "
                                    "smaller spacing, hold more of its volume"))
    return rows


def describe_scene(case: Case, end: float) -> list[tuple[str, str]]:
    """Rows about initial positions and gaps, floating cells, and the motion to expect up to `end` [µs]."""
    found = arrangement(case)
    ranges = [f"{axis} from {low:.4g} to {high:.4g} µm" for axis, low, high in zip("xyz", *found.box, strict=False)]
    rows = [("scene", ", ".join(ranges))]
    lowest, gaps = int(found.heights.argmin()), []
    if case.substrate is not None:
        gaps.append(f"{length(found.heights[lowest])} to the substrate ({case.cells[lowest].name})")
    if found.gap is not None:
        names = " and ".join(case.cells[n].name for n in found.pair)
        gaps.append(f"{length(found.gap)} between cells ({names})")
    if gaps:
        rows.append(("least gaps", ", ".join(gaps)))
    rows += _amounts(case, found)
    return [*rows, *_floating(case, found), *_pressed(case, found), *([] if case.static else _motion(case, found, end))]


def _amounts(case: Case, found: Arrangement) -> list[tuple[str, str]]:
    """Rows about the fields of the case, below the cells at the start."""
    rows, (low, high) = [], found.box
    at = np.linspace(0.0, 1.0, 101)[:, None]
    x = np.concatenate([low + at * (high - low), low + np.where(np.arange(len(low)) % 2, 1.0 - at, at) * (high - low)])
    x[:, -1] = 0.0
    for name, law in fields_of(case).items():
        if not hasattr(law, "value"):
            volumes = " x ".join(map(str, law.volumes))
            rows.append(("" if rows else "fields", f"{name} diffuses, in {volumes} volumes"))
            continue
        values = law.value(x, 0.0) / units.number(f"1 {law.unit}", law.unit)
        what = f"{name} from {values.min():.4g} to {values.max():.4g} {law.unit}".rstrip()
        rows.append(("" if rows else "fields", f"{what} below the cells" + " at the start" * (not law.steady)))
    return rows


def _motion(case: Case, found: Arrangement, end: float) -> list[tuple[str, str]]:
    """Rows about drag and estimated speeds."""
    e = expected(case, found, end)
    unit = case.time_unit
    rows = _drag(case)
    if not e.fastest:
        return rows
    gone = length(float(f"{e.distance:.2g}"))
    speeds = [f"{unit.size * value:.2g} µm/{unit.label} {when}" for value, when in (
        (e.start, "at the start"), (e.spreading, "while cells spread"),
        (e.speed, f"at the end, {gone} from here")) if value]
    rows.append(("speeds", f"{', '.join(speeds)}: within a factor of 3"))
    force = "pN/µm" if case.dimension == 2 else "pN"
    pushed = f"by a push of {e.push:.2g} {force} a cell; " if e.push else ""
    rows.append(("", f"{pushed}{e.fastest / CRAWLING:.1g} times the 0.1 µm/s of a crawling cell"))
    if e.momentum is not None:
        rules = "inertia counts" if e.reynolds > SMALL else "viscosity rules"
        rows.append(("Reynolds", f"number {e.reynolds:.2g}, of the largest speed and {length(e.size)}: {rules}; "
                                 f"momentum spreads in {duration(1e-6 * e.momentum)}"))
        rows += _wrong_regime(case, e, end)
    if e.push > e.borne:
        rows.append(("WARNING", f"a push of {e.push:.2g} {force} a cell is more than the {e.borne:.2g} {force} that "
                                "its bonds bear on a contact of one diameter: it has no steady speed and slips; more "
                                "bonds, or a smaller protrusion.protrusion_ratio, hold it"))
    elif e.push * (p := polarities(case)).largest > e.borne:
        rows.append(("WARNING", f"with a polarity of {p.largest:.2g} a push of {p.largest * e.push:.2g} {force} a cell "
                                f"is more than the {e.borne:.2g} {force} that its bonds bear on a contact of one "
                                "diameter: it slips while its polarity is that large; a smaller gain, spread or "
                                "protrusion.protrusion_ratio, or more bonds, hold it"))
    elif e.distance > FAR * e.size and not case.overdamped:
        rows.append(("WARNING", f"the push carries cells {e.distance / e.size:.2g} times their size by the end: shapes "
                                "will be stretched beyond what particles resolve; a shorter time.end or a smaller "
                                "protrusion.protrusion_ratio leaves them in shape"))
    return rows


def _wrong_regime(case: Case, e: Expected, end: float) -> list[tuple[str, str]]:
    """A warning of inertia that does not matter up to `end` [µs], or that is left out though it does."""
    if case.overdamped and e.momentum and not e.fades(end):
        return [("WARNING", "inertia counts here, and \"overdamped\" leaves it out: it holds for small Reynolds "
                            "numbers and times far longer than momentum takes to spread; \"leapfrog\" has inertia")]
    if not case.overdamped and e.momentum and e.fades(end) and end > LASTING * e.momentum:
        return [("WARNING", f"the run lasts {end / e.momentum:.1g} times as long as momentum takes to spread: "
                            "time.integrator = \"overdamped\" leaves inertia out, and takes steps of the motion's own "
                            "time")]
    return []


def _drag(case: Case) -> list[tuple[str, str]]:
    """Rows about what holds cells back: friction, by kinds of cells, and a medium."""
    rows = []
    of_law: dict[Any, list[str]] = {}
    for cell in case.cells if case.substrate is not None else ():
        of_law.setdefault(case.friction_of(cell), []).append(cell.name)
    for law, names in of_law.items():
        whose = f"{_named(names)}: " if len(of_law) > 1 else ""
        rows.append(("" if rows else "drag", whose + _friction_text(law, case.time_unit)))
    if case.medium is not None:
        rows.append(("" if rows else "drag", f"of the medium ({case.medium.law}), on all of the surface"))
    return rows


def _friction_text(law: Any, unit: TimeUnit) -> str:
    """Text of a law of friction: its drag at low speed, and its largest traction if it has one."""
    if law is None:
        return "none: cells slide, and what is pushed goes ever faster; [friction] holds them back"
    text = f"{unit.number(law.coefficient):.4g} Pa {unit.label}/µm on bonded membrane that slides"
    if (largest := getattr(law, "largest", None)) is None:
        return text
    traction, fastest = largest
    slow, fast = (f"{unit.size * speed:.3g} µm/{unit.label}" for speed in (law.speed, fastest))
    return f"{text} far below {slow}; at most {traction:.3g} Pa, at {fast}, and less beyond"


def _floating(case: Case, found: Arrangement) -> list[tuple[str, str]]:
    """A warning of cells above the reach of adhesion, which is rarely intended."""
    number = len(found.floating)
    if not number:
        return []
    cells, it = ("a cell floats", "it") if number == 1 else (f"{number} cells float", "them")
    names = [f"'{case.cells[n].name}' by {length(found.heights[n])}" for n in found.floating[:FLOATING]]
    names += [f"{number - FLOATING} more"] if number > FLOATING else []
    reach = length(case.substrate.cutoff)
    return [("WARNING", f"{cells} above the substrate, beyond the {reach} that its bonds reach: no adhesion "
                        f"holds {it}: {', '.join(names)}; rest = true in the table of a cell sets it down")]


def _pressed(case: Case, found: Arrangement) -> list[tuple[str, str]]:
    """Warnings of bonds that are compressed at the start, which push the cells apart."""
    rows = []
    pressed = []
    if case.substrate is not None and case.substrate.work and found.heights.min() < case.substrate.cap:
        pressed.append((case.substrate, found.heights.min(), "adhesion to the substrate",
                        "rest = true sets a cell down at equilibrium, or set the centre of the lowest cell higher by"))
    if found.pressed is not None:
        gap, law = found.pressed
        pressed.append((law, gap, f"{'adhesion' if law.work else 'repulsion'} between cells",
                        "set the cells apart by a further"))
    for law, gap, term, remedy in pressed:
        eps = law.equilibrium_distance
        rows.append(("WARNING", f"{term} starts pressed, at a gap of {1e3 * gap:.3g} nm of its {1e3 * eps:g} nm: "
                                "its first steps are finer, and 1 % of the energy may be lost; "
                                f"{remedy} {1e3 * (eps - gap):.3g} nm"))
    return rows


def length(value: float) -> str:
    """A length [µm] as text, such as 10 nm or 1.2 µm."""
    return f"{1e3 * value:.3g} nm" if abs(value) < 0.1 else f"{value:.4g} µm"


def describe_laws(case: Case, simulation: Simulation) -> list[tuple[str, str]]:
    """Rows of the laws of a scene with their numerical parameters."""
    rows = []
    for name, law in case.materials.items():
        if law not in simulation.scene.materials:
            continue
        viscosity = law.numerical_viscosity(max(t.spacing for t in simulation.scene.templates)) / 1e3
        text = f"{law.law}, stabilised with {viscosity:.3g} mPa s"
        text += f" and {law.numerical_modulus / 1e3:.3g} kPa" if law.numerical_modulus else ""
        if hasattr(law, "reduced_bulk_modulus"):
            text += f", bulk modulus reduced from {law.bulk_modulus / 1e6:g} to {law.reduced_bulk_modulus / 1e6:g} MPa"
        rows.append((name, text))
    t = simulation.terms
    rows += [("substrate", text) for text in _law_text(t.substrate)] + describe_contacts(case, t)
    if t.protrusion is not None and case.protrusion:
        rows.append(("protrusion", f"{_named(case.protrusion.cells)}; ratio {t.protrusion.protrusion_ratio:g}, "
                                   f"height {t.protrusion.height:g} µm"))
    return rows + describe_guidance(case)


def describe_guidance(case: Case) -> list[tuple[str, str]]:
    """Rows of the polarity of cells and of the cues that turn it."""
    if case.polarity is None:
        return []
    law = case.polarity
    persistence, interval = (duration(1e-6 * time, 3) for time in (law.persistence, law.interval))
    rows = [("polarity", f"{law.law}, persistence {persistence}, spread {law.spread:g}; a knot every {interval}, "
                         f"{case.time.end / law.interval:.0f} in all")]
    rows += _polarities(case)
    for number, cue in enumerate(case.cues):
        of = f" of {cue.field}" if getattr(cue, "field", None) else ""
        who = f"; {_named(cue.cells)}" if cue.cells else ""
        rows.append(("cues" if not number else "", f"{number} {cue.law}{of}, gain {cue.gain:g}{who}"))
    return rows


def _polarities(case: Case) -> list[tuple[str, str]]:
    """Rows about how large polarities become, and which of them the bonds bear."""
    p, e = polarities(case), expected(case, arrangement(case), case.time.end)
    whence = ("at the start", "by cues as they are there", "by chance, two standard deviations")
    parts = [f"{size:.2g} {text}" for size, text in zip((p.start, p.cues, p.chance), whence, strict=True) if size]
    parts += [f"cue {number} may add {most:.3g} at most" for number, most in p.unknown]
    bears = f"; bonds bear the push of {e.borne / e.push:.2g}" if 0.0 < e.push and e.borne < math.inf else ""
    if case.polarity.law == "switching":
        return [("", f"|p| = {p.largest:.2g}, a factor of the push, at all times{bears}")]
    told = ", ".join(parts) or "nothing turns it"
    return [("", f"|p| up to about {p.largest:.2g}, a factor of the push: {told}{bears}")]


def describe_contacts(case: Case, terms: Terms) -> list[tuple[str, str]]:
    """Rows of the laws between cells: that of all pairs, and exceptions."""
    texts, own = _law_text(terms.contact), terms.contacts is not None and terms.contacts.own
    meet = bool(texts)
    for pair in case.pairs:
        left, right = map(_named, pair.cells)
        names = f"{left} with itself" if pair.itself else f"{left} with {right}"
        if own if pair.itself else meet:
            law = dataclasses.replace(pair.law, bond_density=0.0) if pair.itself else pair.law
            texts += [f"{names}: {text}" for text in _law_text(solid(law))]
        if meet and pair.friction is not None:
            texts.append(f"{names}: {_friction_text(pair.friction, case.time_unit)}")
    return [("" if number else "between cells", text) for number, text in enumerate(texts)]


def _law_text(law: Adhesion | None) -> list[str]:
    """Text of a law of adhesion, none if it does nothing."""
    if law is None or not law.stiffness(0.0):
        return []
    distance = f"{1e3 * law.equilibrium_distance:g} nm"
    return [f"{law.law}, work of adhesion {law.work:g} pN/µm, equilibrium distance {distance}" if law.work else
            f"no adhesion; surfaces closer than {distance} repel each other"]


def _named(names: Sequence[str]) -> str:
    """Names of cells, not all if there are many."""
    return ", ".join(names[:LISTED]) + (f" and {len(names) - LISTED} more" if len(names) > LISTED else "")


def span(values: list) -> str:
    """Smallest and largest value as text."""
    low, high = min(values), max(values)
    text = "{:.4g}" if isinstance(low, float) else "{}"
    return text.format(low) if low == high else f"{text.format(low)}-{text.format(high)}"


def describe_dissipation(entries: dict[str, float]) -> str:
    """Dissipation by viscosity, networks, friction and media, and artificial, of a row of the ledger, if any."""
    unit, text = ("pn", "pN") if "viscous_loss_pn" in entries else ("pn_um", "pN µm")
    parts = [(name, entries.get(f"{column}_{unit}", 0.0)) for name, column in (
        ("viscous", "viscous_loss"), ("of networks", "network_loss"), ("frictional", "friction_loss"),
        ("by the medium", "medium_loss"),
        ("artificial", "artificial_dissipation"))]
    total = sum(abs(value) for _, value in parts)
    if not total > 0.0:
        return ""
    share = 100.0 * abs(parts[-1][1]) / total
    told = ", ".join(f"{name} {value:.3g} {text}" for name, value in parts if value)
    return f"{told}: {share:.{0 if share > 10 else 1}f} % of it is artificial (docs/numerics.md)"
