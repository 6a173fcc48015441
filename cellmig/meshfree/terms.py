"""The terms of the momentum balance, equation (2) of Bai, Lin & Zeng (2019), that a scene has."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..case.gaps import outline
from ..case.pairs import Pairing, paired
from ..case.registry import laws
from ..case.schema import Case, particle_count
from ..geometry.polygons import convex
from ..geometry.surfaces import on_hull
from ..model.ground import fields_of
from ..model.protocols import Adhesion, Cortex, DirectorLaw, Field, Friction, LoadCurve, Medium, ProtrusionLaw
from ..model.seifert import WALL, BetweenCells, solid
from .boundary import load_curves_of

ETA, ZETA = "director gradients (eta)", "active stress (zeta)"
SIDES = {2: 2, 3: 8}  # directions in which a cell without polarity pushes, by the number of dimensions
SINGLE_FROM = 25_000  # particles of all kinds of cells: beyond, coefficients in double leave caches of 32 MB


@dataclass(frozen=True)
class Contacts:
    """Laws of contact between surfaces of cells; each keeps them apart, also where there are no bonds.

    Attributes
    ----------
    laws : tuple of Adhesion -- all that differ from each other.
    pairing : Pairing -- for each two cells, the number of their law.
    own : bool -- whether any cell can meet itself; its law is repulsion alone.
    frictions : tuple of Friction -- that of the bonds of each of the laws; none if no bonds drag.
    pushes : tuple of bool -- whether cells push off each other by the bonds of each of the laws; none if none do.
    """

    laws: tuple[Adhesion, ...]
    pairing: Pairing
    own: bool
    frictions: tuple[Friction, ...] = ()
    pushes: tuple[bool, ...] = ()

    @property
    def reach(self) -> np.ndarray:
        """Distances beyond which the laws do not act (laws,) [µm]: repulsion alone ends where bonds are at rest."""
        return np.array([law.cutoff if law.work else law.equilibrium_distance for law in self.laws])

    @property
    def coefficient(self) -> float:
        """Largest drag of fully bonded surfaces that slide along each other [Pa µs/µm]."""
        return max((law.coefficient for law in self.frictions), default=0.0)

    @property
    def thinnest(self) -> float:
        """Least equilibrium distance of the laws [µm]."""
        return min(law.equilibrium_distance for law in self.laws)

    def of_pair(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Number in `laws` of that between the cells a (k,) int and b (k,) int, in either order (k,) int."""
        return self.pairing.of(a, b)


@dataclass(frozen=True)
class Frictions:
    """Laws of friction on the substrate.

    Attributes
    ----------
    laws : tuple of Friction -- all that differ from each other.
    of_cell : (cells,) int -- number of the law of each cell.
    """

    laws: tuple[Friction, ...]
    of_cell: np.ndarray

    @property
    def coefficient(self) -> float:
        """Largest drag of fully bonded membrane [Pa µs/µm]."""
        return max(law.coefficient for law in self.laws)


NO_CONTACTS = Contacts((), Pairing(*np.zeros((3, 0), int)), False)


@dataclass(frozen=True)
class Terms:
    """Terms of a scene; one that is None, "none" or False is not compiled, stored or exchanged.

    Attributes
    ----------
    substrate, contact, protrusion, cortex, medium : law or None -- terms of the surface; `contact` is that of all pairs
        of cells without exceptions.
    slack : tuple of int -- cells whose surface has no cortex.
    friction : Frictions or None -- laws of all cells.
    ligand : Field or None -- density of bonds to the substrate over that of their law.
    contacts : Contacts or None -- laws of all pairs of cells, and of a cell with itself.
    director : str -- "none", "frozen" or "relaxing".
    director_law : law or None -- that of the case.
    active : bool -- whether there is an active stress -ζ h⊗h.
    graded : bool -- whether elastic moduli of a body vary from place to place.
    network : bool -- whether a material has a network whose bonds break and form again.
    stabilised, bulk_damped, stiffened : bool -- whether there are numerical viscosities, and a numerical stiffness.
    acceleration : tuple or None -- of the body force (2,) [µm/µs²].
    load_curves : tuple or None -- laws of kind load_curve of supports, loads and plates.
    single : bool -- whether the coefficients of neighbours are stored in single precision.
    dimension : int -- 2, plane strain, or 3.
    inertia : bool -- whether bodies have kinetic energy.
    renewal : float or None -- stretch of fluids at which the neighbours are found anew [-]; None if they never are.
    guided : bool -- whether pushes change in time by themselves.
    sides : int -- directions in which each cell pushes.
    skipped : dict -- by name of an absent term, the reason for the log.
    """

    substrate: Adhesion | None = None
    contact: Adhesion | None = None
    contacts: Contacts | None = None
    protrusion: ProtrusionLaw | None = None
    cortex: Cortex | None = None
    slack: tuple[int, ...] = ()
    friction: Frictions | None = None
    ligand: Field | None = None
    medium: Medium | None = None
    director: str = "none"
    director_law: DirectorLaw | None = None
    active: bool = False
    stabilised: bool = True
    bulk_damped: bool = True
    stiffened: bool = False
    network: bool = False
    graded: bool = False
    acceleration: tuple | None = None
    load_curves: tuple[LoadCurve, ...] | None = None
    single: bool = False
    dimension: int = 2
    inertia: bool = True
    renewal: float | None = None
    guided: bool = False
    sides: int = 1
    skipped: dict = field(default_factory=dict)

    @property
    def sliding(self) -> tuple[Friction, ...] | None:
        """Laws of friction between bodies, of each of the laws of contact; None without."""
        return (self.contacts.frictions if self.contacts is not None else ()) or None

    @property
    def frictions(self) -> tuple[Friction, ...]:
        """Laws of friction on the substrate and between bodies."""
        return (self.friction.laws if self.friction is not None else ()) + (self.sliding or ())

    @property
    def pushes_off(self) -> tuple[bool, ...] | None:
        """Whether cells push off other bodies by the bonds of each of the laws of contact; None if none do."""
        return (self.contacts.pushes if self.contacts is not None and self.protrusion is not None else ()) or None

    @property
    def reach(self) -> float:
        """Largest distance at which surfaces of cells act on each other [µm], 0 without contacts."""
        return float(self.contacts.reach.max()) if self.contacts is not None else 0.0

    @property
    def work_between(self) -> float:
        """Largest work of adhesion between cells w [pN/µm], 0 without contacts."""
        return max((law.work for law in self.contacts.laws), default=0.0) if self.contacts is not None else 0.0

    @property
    def lip_pull(self) -> float:
        """Force w/2 - 2T [pN/µm] that draws a straight lip of a cell along another one; 0 where it is held.

        w is the work of adhesion, half of whose bonds are counted on the membrane that is covered, and T the tension of
        both sides of the lip, here at twice their length.  Friction between cells holds lips, too.
        """
        tension = self.cortex.tension(2.0) if self.cortex is not None else 0.0
        return max(0.5 * self.work_between - 2.0 * tension, 0.0) if self.sliding is None else 0.0

    @property
    def low(self) -> float:
        """Largest height at which surfaces of cells act on the substrate or push [µm], 0 without one."""
        if self.substrate is None:
            return 0.0
        return max(self.substrate.cutoff, self.protrusion.height if self.protrusion is not None else 0.0)

    @property
    def on_gels(self) -> bool:
        """Whether bodies rub or push off each other."""
        return self.sliding is not None or self.pushes_off is not None

    @property
    def has_director(self) -> bool:
        """Whether the gradient of the director or its axis matters."""
        return self.director != "none" or self.active

    @property
    def director_acts(self) -> bool:
        """Whether it exerts stresses; without pruning it is computed in any case."""
        return not {ETA, ZETA} <= self.skipped.keys()


def find_terms(case: Case, prune: bool = True) -> Terms:
    """The terms of equation (2) that the case has, and why it lacks the others; without `prune`, all of them."""
    choice = _Choice(prune)
    return Terms(**_bonds(case, choice), **_pushes(case, choice), **_stresses(case, choice), **_others(case, choice),
                 slack=_slack(case), single=_single(case), dimension=case.dimension, renewal=_renewal(case),
                 network=any(hasattr(m, "network_renewed") for m in case.materials.values()), graded=_graded(case),
                 inertia=not (case.overdamped or case.static), skipped=choice.skipped)


class _Choice:
    """Which terms there are; skipped : by term, why it is not needed."""

    def __init__(self, prune: bool):
        self.skipped: dict[str, str] = {}
        self._prune = prune

    def unless(self, reason: str | None, term: str, value: Any, absent: Any = None) -> Any:
        """The `value` of a term, or what stands for its absence for the `reason`, if there is one."""
        if reason is None:
            return value
        self.skipped[term] = reason
        return absent if self._prune else value


def _bonds(case: Case, choice: _Choice) -> dict[str, Any]:
    """Adhesion to the substrate and between cells, and contact of cells with themselves."""
    nothing: Any = laws("adhesion")["seifert"](bond_density=0.0, well_depth=0.0, equilibrium_distance=0.01)
    substrate = choice.unless(why((case.substrate is None, "the case has none")), "adhesion to the substrate",
                              solid(case.substrate) if case.substrate else nothing)
    between = case.contact or dataclasses.replace(nothing, equilibrium_distance=_thin(case))
    alone = len(case.cells) == 1
    contact = choice.unless(
        why((alone, "one cell alone"), (case.static and case.contact is None, "the case has none")),
        "adhesion between cells", nothing if alone or case.static else BetweenCells.of(solid(between)))
    # Lips on a substrate become so thin that their sides pass through each other, which walls outside make violent.
    lips = case.substrate is not None and case.substrate.work > 0.0
    never = why((case.static, "not in a static case"),
                (not case.static and not _meet_themselves(case), "solids of convex outline"),
                (lips and not any(pair.itself for pair in case.pairs), "on a substrate only if a pair names it"))
    own = choice.unless(never, "contact of a cell with itself", True, False)
    repels = [never is None and (not lips or pair.itself) for pair in case.pairs] + [never is None and not lips]
    contacts = _contacts(case, contact, between, own, repels) if contact or own else None
    return {"substrate": substrate, "contact": contact, "contacts": contacts}


def _pushes(case: Case, choice: _Choice) -> dict[str, Any]:
    """Protrusion, and whether pushes change."""
    push = case.protrusion
    protrusion = choice.unless(why((push is None, "the case has none"),
                                   (push is not None and not push.cells, "no cell protrudes"),
                                   (push is not None and push.protrusion_ratio == 0, "its ratio is zero"),
                                   (not _pushes_off(case), "no adhesion to the substrate")),
                               "protrusion", push or laws("protrusion")["edge"](cells=(), random=False))
    guided = choice.unless(None if case.guided and protrusion is not None else "pushes are the same at all times",
                           "guidance", True, False)
    return {"protrusion": protrusion, "guided": guided and protrusion is not None, "sides": _sides(case, protrusion)}


def _stresses(case: Case, choice: _Choice) -> dict[str, Any]:
    """Stresses in bodies besides those of the laws: of the director, active and numerical ones."""
    used, law = case.materials.values(), case.director
    eta, zeta = max(getattr(m, "eta", 0.0) for m in used), any(getattr(m, "zeta", 0.0) for m in used)
    uniform = law is None or law.uniform
    director = choice.unless(why((eta == 0, "eta is zero"), (uniform, "the director is uniform: its gradient is zero")),
                             ETA, "relaxing" if law is not None and law.mobility else "frozen", "none")
    active = choice.unless(None if zeta else "zeta is zero", ZETA, True, False)
    still = (case.static, "nothing moves in a static case")
    stabilised = choice.unless(why(still, (not any(m.stabilisation for m in used), "its viscosity is zero")),
                               "viscous stabilisation", True, False)
    stiffened = choice.unless(None if any(m.numerical_modulus for m in used) else "its modulus is zero",
                              "elastic stabilisation", True, False)
    damped = choice.unless(why(still, (case.overdamped, "there is no sound without inertia"),
                               (not case.numerics.bulk_viscosity, "its viscosity is zero")),
                           "bulk damping", True, False)
    return {"director": director, "director_law": law, "active": active, "stabilised": stabilised,
            "stiffened": stiffened, "bulk_damped": damped}


def _others(case: Case, choice: _Choice) -> dict[str, Any]:
    """Cortex, drags, ligands, body force, and what acts from outside."""
    cortex, medium, ligand, force = (
        choice.unless(None if value else "the case has none", term, value) for term, value in (
            ("cortex", case.cortex), ("drag of a medium", case.medium), ("ligands", fields_of(case).get("ligand")),
            ("body force", case.body_force if any(case.body_force or ()) else None)))
    rubs = any(case.friction_of(cell) is not None for cell in case.cells)
    friction = choice.unless(
        why((not rubs, "the case has none"), (case.substrate is None, "no adhesion to the substrate")),
        "friction on the substrate", _frictions(case) if rubs and case.substrate is not None else None)
    outside = choice.unless(None if (case.supports or case.loads or case.plates) else "the case has none",
                            "supports, loads, plates", load_curves_of(case))
    return {"cortex": cortex, "medium": medium, "ligand": ligand, "acceleration": force, "friction": friction,
            "load_curves": outside}


def why(*conditions: tuple[bool, str]) -> str | None:
    """The reason of the first condition that holds, None if none does."""
    return next((reason for holds, reason in conditions if holds), None)


def _graded(case: Case) -> bool:
    """Whether a body is not as stiff as its law."""
    return any(cell.relative_stiffness != 1.0 for cell in case.cells)


def _slack(case: Case) -> tuple[int, ...]:
    """Cells without a cortex."""
    return tuple(n for n, cell in enumerate(case.cells) if not cell.cortex)


def _pushes_off(case: Case) -> bool:
    """Whether there are bonds that cells push off by, to the substrate or to other bodies."""
    return bool(case.substrate is not None and case.substrate.work) or any(pair.push for pair in case.pairs)


def _frictions(case: Case) -> Frictions:
    """Laws of friction of all cells, one without drag for those that have none."""
    known: dict[Any, int] = {}
    none = laws("friction")["bonds"](coefficient=0.0)
    of_cell = [known.setdefault(case.friction_of(cell) or none, len(known)) for cell in case.cells]
    return Frictions(tuple(known), np.array(of_cell))


def _single(case: Case) -> bool:
    """Whether coefficients are stored in single precision."""
    shapes = {(c.shape, c.material, c.nucleus) for c in case.cells}
    return sum(particle_count(case, shape) for shape, *_ in shapes) > SINGLE_FROM and _renewal(case) is None


def _sides(case: Case, push: Any) -> int:
    """Directions in which each protruding cell pushes: all if each side has a push of its own, one if none pushes."""
    every = push is not None and (push.basal or case.clutches is not None)
    return SIDES[case.dimension] if every else 1


def _renewal(case: Case) -> float | None:
    """Stretch [-] at which neighbours are found anew; None if they never are, or nothing flows."""
    stretch, flows = case.numerics.renewal, any(m.viscosity for m in case.materials.values())
    return None if isinstance(stretch, str) or case.static or not flows else stretch


def _contacts(case: Case, contact: Adhesion | None, between: Adhesion, own: bool, repels: list[bool]) -> Contacts:
    """Laws of all pairs of cells; `between` is that of most, and `contact` the same or None if no two cells meet.

    own : bool -- whether a cell has a law with itself;  repels : whether that does anything, by pair of the case, and
    at the end for cells that no pair names with themselves.
    """
    pairing, _ = paired([cell.name for cell in case.cells], case.pairs)
    given = [*(pair.law for pair in case.pairs), between]  # the last for number -1
    known: dict[tuple[Adhesion, Friction, bool], int] = {}
    none = laws("friction")["bonds"](coefficient=0.0)

    def number(law: Adhesion, friction: Friction | None = None, push: bool = False) -> int:
        return known.setdefault((law, friction or none, push), len(known))

    first = number(contact) if contact is not None else 0
    others = [number(BetweenCells.of(solid(pair.law)), pair.friction, pair.push) if contact is not None else 0
              for pair in case.pairs]
    between_kinds = np.array([*others, first])[pairing.between]
    of_own = [number(_repulsion(given[n], case.substrate, repels[n])) if own else 0 for n in pairing.own]
    bonds, frictions, pushes = zip(*known, strict=True)
    rubs = any(law.coefficient for law in frictions)
    return Contacts(bonds, Pairing(pairing.kind, between_kinds, np.array(of_own)), own, frictions if rubs else (),
                    pushes if any(pushes) else ())


def _repulsion(law: Adhesion, substrate: Adhesion | None, repels: bool) -> Adhesion:
    """Repulsion alone, up to the equilibrium distance of a law; as strong as the bonds of the substrate, which pull the
    second layer of a fold through the first.
    """
    strength = max(WALL, substrate.work if substrate is not None else 0.0) if repels else 0.0
    eps, depth = law.equilibrium_distance, 1.0 if repels else 0.0
    wall: Any = BetweenCells
    return wall(bond_density=strength, well_depth=depth, equilibrium_distance=eps, cutoff=eps, attraction=0.0)


def _meet_themselves(case: Case) -> bool:
    """Whether a cell can meet itself: fluids and what is not convex can."""
    bodies = {(c.shape, c.displacement, c.material) for c in case.cells}
    return any(case.materials[name].viscosity or not case.materials[name].shear_modulus
               or not (convex if case.dimension == 2 else on_hull)(outline(shape, displacement))
               for shape, displacement, name in bodies)


def _thin(case: Case) -> float:
    """Distance [µm] at which cells without adhesion repel: that of the substrate, else a thousandth of a cell."""
    if case.substrate:
        return case.substrate.equilibrium_distance
    return 1e-3 * min(size_of(c.shape) for c in case.cells)


def size_of(shape: Any) -> float:
    """Root of the area, or cube root of the volume, of a shape [µm]."""
    return float(shape.area**0.5 if shape.dimension == 2 else shape.volume ** (1.0 / 3.0))
