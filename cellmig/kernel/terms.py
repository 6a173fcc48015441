"""The terms of a scene in C: which files it needs, which pointwise formulas, and when the step calls them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from ..meshfree.stabilisation import BulkDamping, Stabilisation
from ..meshfree.terms import Terms
from ..model.adhesion import CellAdhesion, SubstrateAdhesion, bonds_of
from ..model.continuum import Continuum
from ..model.cortex import CortexForce
from ..model.director import Anchor, Couple, numbers
from ..model.friction import FrictionForce, SurfaceFriction
from ..model.membranes import (
    CortexTension,
    ProtrusionPush,
    SlidingFriction,
    SurfacePush,
    SurfaceSliding,
    TriangleAdhesion,
)
from ..model.polyhedra import PolyhedronAdhesion
from ..model.pressure import Pressure, TrianglePressure
from ..model.protrusion import ProtrusionForce, PushOff
from ..model.triangles import TriangleBonds


@dataclass(frozen=True)
class SurfaceTerm:
    """Forces on surfaces: c/NAME.c has `add_NAME`, which calls its formula's methods as NAME_method.

    formula : from the terms of a scene, None where it lacks this one, a tuple where several laws may act;
    methods : of the formula, with names of their results where these have different shapes;
    in_fours : those of them that are computed for four points at a time;
    files : of c/, by default NAME.c;
    unit : the term with whose files these are compiled, by default its own name;
    moves : whether its force in a step differs from that at rest: c/ has add_NAME_in_motion.
    """

    name: str
    formula: Callable[[Terms], Any]
    methods: Mapping[str, tuple[str, ...]]
    in_fours: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    unit: str = ""
    moves: bool = False


def _of_contacts(t: Terms, dimension: int, formula: Callable[[Any], Any]) -> Any:
    return tuple(map(formula, t.contacts.laws)) if t.contacts and t.dimension == dimension else None


def _of_frictions(t: Terms, dimension: int, formula: Callable[[Any, Any], Any]) -> Any:
    if not t.sliding or not t.contacts or t.dimension != dimension:
        return None
    return tuple(formula(law, bonds) for law, bonds in zip(t.sliding, t.contacts.laws, strict=True))


def _of_pushes(t: Terms, dimension: int, formula: Callable[[Any, Any], Any]) -> Any:
    push = t.protrusion
    return _of_contacts(t, dimension, lambda bonds: formula(push, bonds)) if t.pushes_off and push else None


def _of_cortex(t: Terms) -> Any:
    law: Any = t.cortex
    return CortexForce(law) if t.dimension == 2 else CortexTension(law)


def _with_bonds(t: Terms, dimension: int, law: Any, formula: Callable[[Any, Any], Any]) -> Any:
    """The formula in a dimension of a law and of the bonds to the substrate; None where there is none."""
    if law is None or t.substrate is None or t.dimension != dimension:
        return None
    bonds: Any = t.substrate
    return formula(law, bonds_of(bonds) if dimension == 2 else TriangleBonds(bonds))


POLYHEDRA: dict[str, tuple[str, ...]] = {
    "face_kind": (), "edge_kind": (), **{name: ("load", "stored", "stiff") for name in ("face", "edge", "vertex")},
    **{f"{name}_{what}": (what,) for what in ("stiffness", "tangent") for name in ("face", "edge", "vertex")}}
# In the order in which forces are added up.
SURFACE_TERMS = (
    SurfaceTerm("substrate", lambda t: _with_bonds(t, 2, t.substrate, lambda _, bonds: SubstrateAdhesion(bonds)),
                {"facet": ("force", "energy", "impulse")}, files=("ligand.h", "substrate.c"), moves=True),
    SurfaceTerm("substrate", lambda t: _with_bonds(t, 3, t.substrate, lambda _, bonds: TriangleAdhesion(bonds)),
                {"facet": ("force", "energy"), "kind": ()}, ("facet", "kind"), files=("ligand.h", "substrate_space.c"),
                moves=True),
    SurfaceTerm("contact", lambda t: _of_contacts(t, 2, lambda law: CellAdhesion(bonds_of(law))),
                {"beside": ("along", "across"), "part": ("from", "to"), "edge": ("force", "energy"),
                 "edge_stiffness": (), "vertex_force": ("fx1", "fy1", "fx2", "fy2"), "vertex_energy": (),
                 "vertex_stiffness": (), "foot": ("foot", "away"), "short": ()}, ("vertex_force", "vertex_energy")),
    SurfaceTerm("contact", lambda t: _of_contacts(t, 3, lambda law: PolyhedronAdhesion(TriangleBonds(law))),
                POLYHEDRA, tuple(POLYHEDRA),
                files=("pieces.h", "polyhedra.h", "wedges.h", "cones.h", "actions.h", "overlaps.h", "faces.h",
                       "lines.h", "points.h", "serving.h", "near.h", "contact_space.c", "contact_blocks.c")),
    SurfaceTerm("sliding", lambda t: _of_frictions(t, 2, lambda law, bonds: SurfaceFriction(law, bonds_of(bonds))),
                {"force": ("force", "power")}, unit="contact"),
    SurfaceTerm("sliding", lambda t: _of_frictions(t, 3, lambda law, bonds: SurfaceSliding(law, TriangleBonds(bonds))),
                {"drag": ()}, files=("sliding_space.c", "sliding_blocks.c"), unit="contact"),
    SurfaceTerm("push_off", lambda t: _of_pushes(t, 2, lambda law, bonds: PushOff(law, bonds_of(bonds))),
                {"grip": (), "hold": (), "force": ()}, files=("aim.h", "push_off.h", "push_off.c"), unit="contact"),
    SurfaceTerm("push_off", lambda t: _of_pushes(t, 3, lambda law, bonds: SurfacePush(law, TriangleBonds(bonds))),
                {"grip": (), "hold": (), "edge": (), "force": ()},
                files=("aim.h", "push_off.h", "push_off_space.c", "push_off_blocks.c"), unit="contact"),
    SurfaceTerm("cortex", lambda t: t.cortex and _of_cortex(t), {"force": (), "energy": ()}),
    SurfaceTerm("friction", lambda t: tuple(
        _with_bonds(t, t.dimension, law, FrictionForce if t.dimension == 2 else SlidingFriction)
        for law in t.friction.laws) if t.friction and t.substrate else None, {"force": ()},
                files=("ligand.h", "friction.c")),
    SurfaceTerm("medium", lambda t: t.medium, {"force": ()}),
    SurfaceTerm("protrusion", lambda t: _with_bonds(t, 2, t.protrusion, ProtrusionForce),
                {"grip": (), "hold": (), "force": ()}, files=("aim.h", "push.h", "protrusion.c")),
    SurfaceTerm("protrusion", lambda t: _with_bonds(t, 3, t.protrusion, ProtrusionPush),
                {"grip": (), "grip_kind": (), "hold": (), "front": (), "edge": (), "kind": ()},
                ("grip", "grip_kind", "edge", "kind"), files=("aim.h", "push.h", "protrusion_space.c")),
    SurfaceTerm("loads", lambda t: None if t.load_curves is None else Pressure() if t.dimension == 2 else
                TrianglePressure(), {"force": ()}),
)


def present(name: str, terms: Terms) -> bool:
    """Whether a scene has the surface term of a name."""
    return any(term.name == name and term.formula(terms) is not None for term in SURFACE_TERMS)


def rubs(terms: Terms) -> bool:
    """Whether a scene has friction, on the substrate or between bodies."""
    return present("friction", terms) or present("sliding", terms)


# Formulas without parameters that other files call: object, C type of its numbers, method, name in C, results.
FORMULAS = ((BulkDamping(), "v4", "stress", "bulk_damping_stress", ("stress", "pressure", "rate")),
            (Stabilisation(), "v4", "stress", "stabilisation_stress", ("bent", "stress")),
            (Continuum(), "v4", "shear_stress", "shear_stress", ()),
            (Continuum(), "v4", "volume_ratio", "volume_ratio", ()))
ANCHORS = {2: ((Couple(), "double", "force", "couple_force", ()),),
           3: ((Anchor(), "double", "direction", "anchor_direction", ()),
               (Anchor(), "double", "reaction", "anchor_reaction", ("by_normal", "by_tangent")))}

# What the step calls at its stages, by the arguments that are there.
STAGES = {"int before_stress": "const KernelData *s", "void add_surface_forces": "const KernelData *s, "
          "double accounted_dt, double dt", "void add_forces_in_motion": "const KernelData *s, double dt",
          "int after_forces": "const KernelData *s, double dt",
          "void before_kick": "const KernelData *s", "void after_drift": "const KernelData *s, double kick, double dt",
          "void pass_time": "const KernelData *s, double dt",
          "void hold_rates": "const KernelData *s, double *out", "void account_holds": "const KernelData *s, double dt"}


@dataclass(frozen=True)
class Part:
    """A file of C that some scenes need, and what the stages of a step call of it, by their names.

    unit : the files with which it is compiled, by the name of one of them or of a term; "" for headers of all.
    """

    file: str
    needed: Callable[[Terms], bool]
    unit: str
    calls: dict[str, str] = field(default_factory=dict)


def _always(terms: Terms) -> bool:
    return True


def _of_dimensions(file: str, needed: Callable[[Terms], bool], unit: str) -> Iterator[Part]:
    """The files whose names have the place where they are needed."""
    yield Part(file.format("plane"), lambda t: t.dimension == 2 and needed(t), unit)
    yield Part(file.format("space"), lambda t: t.dimension == 3 and needed(t), unit)


def _of_surface(term: SurfaceTerm) -> Iterator[Part]:
    *others, file = term.files or (f"{term.name}.c",)
    unit = term.unit or term.name
    yield from (Part(name, lambda t: term.formula(t) is not None, unit) for name in others)
    call = f"add_{term.name}(s, s->force, 0, accounted_dt, dt);"
    moving = {"add_forces_in_motion": f"add_{term.name}_in_motion(s, dt);"} if term.moves else {}
    yield Part(file, lambda t: term.formula(t) is not None, unit, {"add_surface_forces": call} | moving)


# In the order in which they are compiled and called.  Files of a unit call those of another once in a stage at most:
# scenes share the units that are the same in them.
PARTS = (
    Part("layout.h", _always, ""),
    *_of_dimensions("{}.h", _always, ""),
    Part("surface.h", _always, ""),
    *(Part(name, _always, "step") for name in ("gather.h", "exchange.h", "deformation.c", "network.c", "stress.c",
                                               "divergence.c", "modes.c")),
    *(part for term in SURFACE_TERMS for part in _of_surface(term)),
    Part("rubbing.c", rubs, "rubbing", {"add_surface_forces": "complete_friction(s, accounted_dt, dt);"}),
    Part("drives.c", lambda t: t.guided, "drives", {"pass_time": "turn_drives(s, dt);"}),
    Part("boundary.c", lambda t: t.load_curves is not None, "loads", {
        "before_kick": "remember_boundary(s);",
        "after_drift": "stop_at_plates(s, kick, dt); hold(s, kick, dt);", "pass_time": "advance_clock(s, dt);",
        "hold_rates": "hold_rate(s, out);", "account_holds": "account_reactions(s, dt);"}),
    *_of_dimensions("director_{}.c", lambda t: t.has_director, "step"),
    *_of_dimensions("director_turns_{}.c", lambda t: t.director == "relaxing", "step"),
    Part("director_relaxes.c", lambda t: t.director == "relaxing", "step", {
        "before_stress": "if (director_ready(s)) return 1;", "after_forces": "if (director_step(s, dt)) return 1;"}),
    *(Part(name, _always, "step") for name in ("step.c", "diagnostics.c")),
)


def formulas(terms: Terms) -> tuple[tuple, ...]:
    """Those of FORMULAS, and of anchors where a director relaxes."""
    return FORMULAS + (ANCHORS[terms.dimension] if terms.director == "relaxing" else ())


def sizes(terms: Terms) -> dict[str, int]:
    """Constants of the C source: dimensions, and whether a scene has what needs no file of its own."""
    return {"D": terms.dimension, "M": numbers(terms.dimension), "STABILISED": terms.stabilised,
            "STIFFENED": terms.stiffened, "GRADED": terms.graded, "BENDS": terms.stabilised or terms.stiffened,
            "BULK_DAMPED": terms.bulk_damped, "ACTIVE": terms.active, "DIRECTOR": terms.has_director,
            "GUIDED": terms.guided, "SIDES": terms.sides,
            "CONSTRAINED": terms.load_curves is not None, "NETWORK": terms.network,
            "RENEWED": terms.renewal is not None,
            "LIGAND": terms.ligand is not None}
