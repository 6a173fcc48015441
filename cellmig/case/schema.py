"""Sections and keys of a case, from whose declarations the reader, messages, JSON schema and reference follow."""

# ruff: noqa: RUF009 -- parameter() and its kin return dataclass fields
from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass, field
from typing import Any

from . import units
from .environment import Exchange, Ground
from .registry import parameter, quantity
from .time_unit import MICROSECOND, TimeUnit
from .values import declared, in_table, write

TS_TYPES = ("leapfrog", "auto", "overdamped", "static", "euler", "rk", "ssp", "basicsymplectic", "beuler", "cn",
            "theta", "alpha", "alpha2", "bdf", "arkimex", "rosw", "eimex", "mimex", "mprk", "glee", "glle", "discgrad",
            "irk", "dirk", "radau5", "sundials", "pseudo")


@dataclass(frozen=True, kw_only=True)
class Time:
    """Duration, time step and times of output."""

    end: float = quantity("us", "time at which the run ends", above=0)
    frames: int = parameter("number of frames, the fields of all particles, after the first, at equal intervals", 100,
                            minimum=1, maximum=1_000_000)
    samples: int = parameter("number of rows of history and ledger after the first, at equal intervals", 400, minimum=1,
                             maximum=1_000_000)
    step: float | str = quantity("us", "time step; \"auto\": a fraction of the largest stable step", "auto", above=0,
                                 words=("auto",))
    step_factor: float = quantity("", "fraction of the largest stable step for \"auto\"", 0.8, above=0, maximum=1)
    integrator: str = parameter("\"leapfrog\", a type of PETSc's TS, or \"auto\": of leapfrog and bdf the one that is "
                                "cheaper in a trial; \"overdamped\": motion without inertia, for minutes and hours; "
                                "\"static\": equilibria, one for each sample", "leapfrog",
                                known=TS_TYPES)


@dataclass(frozen=True, kw_only=True)
class Particles:
    """Resolution: either the number of particles or their spacing."""

    per_cell: int | None = parameter("number of particles of each cell", None, minimum=7, maximum=100_000_000)
    spacing: float | None = quantity("um", "mean distance of particles: square root of the area of one, in space cube "
                                     "root of its volume; the log has that inside a body, which is larger in space, "
                                     "as particles on the surface have half a volume", None, minimum=1e-6)
    dilation: float = quantity("", "support radius of the kernel over the spacing", 2.2, minimum=1.2, maximum=10)
    surface_refinement: float = quantity("", "density of particles along surfaces over that inside: contact lines "
                                         "advance in shorter steps",
                                         1.0, minimum=1, maximum=10)


@dataclass(frozen=True, kw_only=True)
class Numerics:
    """Parameters of the method, as opposed to the model."""

    bulk_viscosity: float = quantity("", "numerical bulk viscosity over ρ c h, with the speed of sound c", 0.05,
                                     minimum=0)
    renewal: float | str = quantity("", "stretch of a fluid at which its particles' neighbours are found anew, such as "
                                    "1.3, so that it may flow without limit; \"never\": they stay those of the start",
                                    "never", above=1, maximum=3, words=("never",))
    accuracy: str | None = parameter("error such as \"20 %\": those of per_cell, dilation, step_factor and the reduced "
                                     "bulk modulus that the case does not give are the cheapest with a measured error "
                                     "below it", None)


@dataclass(frozen=True, kw_only=True)
class Push:
    """What differs in the push of a cell, of all that [protrusion] names, from that of the others."""

    strength: float = quantity("", "factor of the push", 1.0, minimum=0)
    direction: tuple = quantity("", "direction along the substrate, of any length, in place of that of [protrusion]: "
                                "[1] or [-1], in space [x, y]", (), shape=(None,))
    begin: float = quantity("us", "time from which on it pushes", "0 us", minimum=0)
    end: float | None = quantity("us", "time at which it ceases to", None, above=0)


@dataclass(frozen=True, kw_only=True)
class Cell:
    """A cell, or equal cells in a row or grid; the parameters of the shape are keys of the same table."""

    name: str = parameter("name; \"{}\" in it is replaced by the number of a repeated cell")
    shape: Any = parameter("law of kind shape", kind="shape", inline=True)
    centre: tuple = parameter("position of the centre; with `rest`, x is enough, and in a [[colony]] none", unit="um",
                              minimum=-1e6, maximum=1e6, shape=("d",), least=1)
    rest: bool = parameter("whether the cell rests on the substrate: the last coordinate of `centre` is ignored, "
                           "and the lowest point is at the equilibrium distance of adhesion.substrate; of copies, the "
                           "first one", False)
    material: str = parameter("material of the cytoplasm, or of the whole body", refers="material")
    nucleus: str | None = parameter("material of the nucleus", None, refers="material")
    relative_stiffness: float = quantity("", "factor on the elastic moduli of a solid, from place to place; may be a "
                                         "formula of x, y (and z) [um] from the centre, such as \"1 + 0.02*x\"", 1.0,
                                         above=0, formula=True)
    cortex: bool = parameter("whether the surface has the tension of [cortex]; false for what is no cell, such as a "
                             "gel below cells", True)
    friction: Any = parameter("friction of this cell in place of that of [friction], such as "
                              "{ coefficient = \"3 kPa s/um\" }", None, kind="friction", default_law="bonds",
                              optional=True)
    push: Push | None = parameter("how its push differs, such as { strength = 2, begin = \"1 h\" }", None,
                                  record=Push)
    displacement: tuple = quantity("um", "initial displacement; may be formulas of x, y (and z) from the centre",
                                   (0.0, 0.0), shape=("d",), formula=True)
    velocity: tuple = quantity("um/us", "initial velocity; may be formulas of x, y (and z) from the centre", (0.0, 0.0),
                               shape=("d",), formula=True)
    velocity_gradient: tuple = quantity("1/us", "gradient A of an initial velocity A (X - centre), added to `velocity`",
                                        ((0.0, 0.0), (0.0, 0.0)), shape=("d", "d"))
    repeat: tuple = parameter("number of copies in each direction", (1,), items="count")
    pitch: tuple = quantity("um", "vector from copy to copy, one for each direction", (), shape=(None, "d"))


@dataclass(frozen=True, kw_only=True)
class Pair:
    """Cells whose adhesion to each other differs from that of all others."""

    cells: tuple = parameter("which cells with which, each a name or a list of names", items="pair")
    law: Any = parameter("law of kind adhesion; what is not given is as in adhesion.cells", kind="adhesion",
                         inline=True)
    friction: Any = parameter("friction of the bonds between them, such as { coefficient = \"3 kPa s/um\" }", None,
                              kind="friction", default_law="bonds", optional=True)
    push: bool = parameter("whether the cells of [protrusion] push off the others by the bonds between them, as off "
                           "the substrate, such as a gel", False)

    @property
    def itself(self) -> bool:
        """Whether this is one cell with itself."""
        left, right = self.cells
        return left == right and len(left) == 1


@dataclass(frozen=True, kw_only=True)
class OnPart:
    """Base class of what acts on a part of the surface of some cells."""

    name: str = parameter("unique name, with which columns of history.csv begin")
    cells: tuple = parameter("names of cells; by default all", (), items="cell")
    parts: tuple = parameter("named parts of the surface of the cells' shape, such as \"left\"; by default the whole "
                             "surface", (), items="part")
    box: tuple = quantity("um", "two opposite corners, from the cell's centre, of a box that contains the part", (),
                          shape=(None, "d"))

    def __post_init__(self) -> None:
        """Check the box.

        Raises ValueError unless it has two corners; the message is for the user.
        """
        if len(self.box) not in (0, 2):
            raise ValueError('box: expects two opposite corners, such as [["0 um", "0 um"], ["1 um", "2 um"]]')


@dataclass(frozen=True, kw_only=True)
class Support(OnPart):
    """A part of the surface with a prescribed displacement, which its particles have exactly."""

    displacement: tuple = quantity("um", "displacement, or \"free\" in a direction; may be formulas of x, y "
                                   "(and z) from the centre", (0.0, 0.0), shape=("d",), words=("free",), formula=True)
    load_curve: Any = parameter("factor of the displacement in time", None, kind="load_curve", default_law="constant",
                                formerly="history")


@dataclass(frozen=True, kw_only=True)
class Load(OnPart):
    """A traction of constant direction, a pressure that follows the surface, or a body force."""

    traction: tuple | None = quantity("Pa", "force per reference area of the surface; may be formulas of x, y (and z) "
                                      "from the centre", None, shape=("d",), formula=True)
    pressure: float | None = quantity("Pa", "pressure on the deformed surface, positive inwards; may be a formula of "
                                      "x, y (and z), in the reference configuration, from the centre", None,
                                      formula=True)
    body: tuple | None = quantity("Pa/um", "force per reference volume; may be formulas of x, y (and z) from the "
                                  "centre", None, shape=("d",), formula=True)
    load_curve: Any = parameter("factor of the load in time", None, kind="load_curve", default_law="constant",
                                formerly="history")

    def __post_init__(self) -> None:
        """Check the load.

        Raises ValueError unless it is one of traction, pressure and body force; the message is for the user.
        """
        super().__post_init__()
        if sum(load is not None for load in (self.traction, self.pressure, self.body)) != 1:
            raise ValueError("expects one of traction, pressure and body")
        if self.body is not None and (self.parts or self.box):
            raise ValueError("body: acts on all of the cells; parts and box are for what acts on the surface")


@dataclass(frozen=True, kw_only=True)
class Plate:
    """A rigid frictionless half-plane, in space a half-space, that no particle can enter."""

    name: str = parameter("unique name, with which columns of history.csv begin")
    point: tuple = quantity("um", "a point of the face", shape=("d",))
    normal: tuple = quantity("", "outward normal of the face, of any length", shape=("d",))
    displacement: tuple = quantity("um", "displacement of the plate", (0.0, 0.0), shape=("d",))
    load_curve: Any = parameter("factor of the displacement in time", None, kind="load_curve", default_law="constant",
                                formerly="history")

    def __post_init__(self) -> None:
        """Check the normal.

        Raises ValueError if it is zero; the message is for the user.
        """
        if not any(self.normal):
            raise ValueError("normal: expects a direction, not zero")


@dataclass(frozen=True, kw_only=True)
class Probe(OnPart):
    """Position and displacement of a point, or their means over a part of the surface, recorded in history.csv."""

    point: tuple | None = quantity("um", "point in the reference configuration, from the cell's centre", None,
                                   shape=("d",))


def _section(cls: type, doc: str, **more: Any) -> Any:
    """A section; with `default` None if it is absent, and `at` a path."""
    default = {"default": more.pop("default")} if "default" in more else {}
    return field(**default, metadata={"doc": doc, "section": cls, **more})


def _many(kind: str, doc: str, such_as: str, default_law: str | None = None) -> Any:
    """Laws of a kind by name."""
    return field(default_factory=dict, metadata={"doc": doc, "kind": kind, "many": True, "such_as": such_as,
                                                 "default_law": default_law})


def _list(cls: type | str, doc: str, at: str = "") -> Any:
    extra = {"at": tuple(at.split("."))} if at else {}
    return field(default=(), metadata={"doc": doc, "items_of": cls, **extra})


def _laws(kind: str, doc: str, at: str = "") -> Any:
    """A list of laws of a kind, each in a table that names its law."""
    return _list(kind, doc, at)


def _law(kind: str, doc: str, at: str = "", default_law: str | None = None) -> Any:
    """A law of a kind at a dotted path; None if it is absent."""
    extra = {"at": tuple(at.split("."))} if at else {}
    return field(default=None, metadata={"doc": doc, "kind": kind, "default_law": default_law, **extra})


@dataclass(frozen=True, kw_only=True)
class Case:
    """A case in the code's units (µm, µs, Pa), checked, with all copies of repeated cells; absent terms are None."""

    title: str = parameter("title of the case, one line", "")
    dimension: int = parameter("number of dimensions: 2, plane strain of cells seen from the side, or 3, where z "
                               "points away from the substrate", 2, minimum=2, maximum=3)
    seed: int = parameter("seed of all random numbers", 0, minimum=0, maximum=2**63 - 1)
    time: Time = _section(Time, "duration, time step and times of output; log, tables and pictures have times in the "
                         "unit of `end`: us, ms, s, min, h or d")
    particles: Particles = _section(Particles, "resolution: either the number of particles or their spacing")
    materials: dict = _many("material", "materials by name", "cytoplasm")
    cells: tuple = field(metadata={"doc": "the cells", "items_of": Cell})
    colony: tuple = _laws("colony", "where the copies of tables of [[cells]] go: in a lattice, at random, or as their "
                          "outlines were traced in a picture")
    substrate: Any = _law("adhesion", "adhesion to the substrate, y = 0 or z = 0", "adhesion.substrate", "seifert")
    contact: Any = _law("adhesion", "adhesion between cells", "adhesion.cells", "seifert")
    pairs: tuple = _list(Pair, "exceptions: cells whose adhesion to each other differs from adhesion.cells",
                         "adhesion.pairs")
    protrusion: Any = _law("protrusion", "push of the leading edge", default_law="edge")
    polarity: Any = _law("polarity", "polarity of the cells that protrude, along which they push; by default "
                         "protrusion.direction, for ever", default_law="relaxing")
    cortex: Any = _law("cortex", "tension of the cells' surfaces; by default none, as in the paper",
                       default_law="line-tension")
    friction: Any = _law("friction", "drag on the substrate; by default none, as in the paper", default_law="bonds")
    medium: Any = _law("medium", "drag of the liquid around the cells; by default none, as in the paper",
                       default_law="stokes")
    fields: dict = _many("field", "fields by name: amounts that vary from place to place, such as concentrations",
                         "CXCL12", "formula")
    exchange: tuple = _list(Exchange, "what cells secrete into diffusing fields, and take up from them")
    ground: Ground | None = _section(Ground, "what varies along the substrate: stiffness, density of ligands; by "
                                     "default nothing", default=None, at=("substrate",))
    director: Any = _law("director", "director field of the cytoplasm; by default uniform")
    body_force: tuple | None = parameter("acceleration due to a body force", None, unit="m/s^2", shape=("d",),
                                         at=("body_force", "acceleration"))
    supports: tuple = _list(Support, "prescribed displacements of parts of the cells' surfaces")
    loads: tuple = _list(Load, "tractions, pressures and body forces on the cells")
    plates: tuple = _list(Plate, "rigid frictionless plates")
    probes: tuple = _list(Probe, "points and parts of surfaces whose motion is recorded in history.csv")
    cues: tuple = _laws("cue", "what turns the polarity of cells; cues add")
    numerics: Numerics = _section(Numerics, "parameters of the method")
    path: str = field(default="", compare=False, metadata={"doc": "file that it came from", "hidden": True})
    formulas: dict = field(default_factory=dict, compare=False, metadata={
        "doc": "where formulas stand: (list, name of the item, key) to (file, line, dotted key)", "hidden": True})
    chosen: str = field(default="", compare=False, metadata={"doc": "what an accuracy chose", "hidden": True})
    time_unit: TimeUnit = field(default=MICROSECOND, metadata={"doc": "unit in which time.end is written",
                                                               "hidden": True})

    @property
    def name(self) -> str:
        """Name of the case: that of its file, without folder and extension."""
        return os.path.splitext(os.path.basename(self.path))[0] or "case"

    @property
    def static(self) -> bool:
        """Whether the case asks for equilibria instead of motion."""
        return self.time.integrator == "static"

    @property
    def overdamped(self) -> bool:
        """Whether the case asks for motion without inertia."""
        return self.time.integrator == "overdamped"

    @property
    def guided(self) -> bool:
        """Whether pushes change in time by themselves: by polarities, times of cells, what is near, the substrate."""
        push, ground = self.protrusion, self.ground
        return push is not None and bool(push.cells) and (
            self.polarity is not None or push.gate is not None
            or (ground is not None and (ground.ligand is not None or ground.response is not None))
            or any(c.push is not None and (c.push.begin or c.push.end is not None) for c in self.cells))

    @property
    def clutches(self) -> Any:
        """Law of the clutches by which cells pull on the substrate; None if none do."""
        response = self.ground.response if self.ground is not None else None
        return response if hasattr(response, "spring") else None

    @property
    def gels(self) -> frozenset[str]:
        """Names of the bodies that are no cells: without a cortex, or off which others push and which do not push."""
        push = set(self.protrusion.cells) if self.protrusion is not None else set()
        sides = [side for pair in self.pairs if pair.push for side in (pair.cells, pair.cells[::-1])]
        off = {name for left, right in sides if push.intersection(left) for name in right}
        return frozenset(cell.name for cell in self.cells if not cell.cortex) | (off - push)

    def friction_of(self, cell: Cell) -> Any:
        """Law of friction of a cell, None without."""
        return self.friction if cell.friction is None else cell.friction

    def resolved(self) -> dict:
        """Tables of a case file for this case, with all defaults; the inverse of `load.from_dict`."""
        tree: dict = {}
        for name, f in case_fields().items():
            value, table = getattr(self, name), tree
            *groups, key = case_path(f)
            if value is not None and value != {} and not (f.default == () and value == ()):
                for group in groups:
                    table = table.setdefault(group, {})
                table[key] = _written(f, value)
        tree["time"]["end"] = units.text(self.time.end, self.time_unit.symbol)
        of_all = tree.get("adhesion", {}).get("cells", {})
        for pair in tree.get("adhesion", {}).get("pairs", ()):
            if pair["law"] == of_all.get("law"):
                for key in [key for key, value in pair.items() if of_all.get(key) == value and key != "law"]:
                    del pair[key]
        return tree


def case_fields() -> dict[str, dataclasses.Field]:
    """Fields of a case that are keys or tables of its file, by name."""
    return {name: f for name, f in declared(Case).items() if "hidden" not in f.metadata}


def case_path(f: dataclasses.Field) -> tuple[str, ...]:
    """Path of a field of the case in its file: names of tables, then the key."""
    return f.metadata.get("at", (f.name,))


def _written(f: dataclasses.Field, value: Any) -> Any:
    if f.metadata.get("many"):
        return {name: _table(item) for name, item in value.items()}
    if "items_of" in f.metadata:
        return [_table(item) for item in value]
    return _table(value) if dataclasses.is_dataclass(value) else write(f, value)


def _table(item: Any) -> dict:
    """Table of a section, law or cell."""
    table = {"law": item.law} if hasattr(item, "law") else {}
    for name, f in declared(type(item)).items():
        value = getattr(item, name)
        if f.metadata.get("inline"):
            shape = _table(value)
            table |= {name: shape.pop("law"), **shape}
        elif value is not None:
            of_table = {"kind", "record"} & f.metadata.keys()
            table[name] = _table(value) if of_table else write(in_table(f, getattr(item, "unit", None)), value)
    return table


def particle_count(case: Case, shape: Any) -> int:
    """Number of particles of a cell of this shape."""
    p = case.particles
    if p.per_cell is not None:
        return p.per_cell
    return max(7, round(shape.area / p.spacing**2 if case.dimension == 2 else shape.volume / p.spacing**3))
